"""Run every benchmark of this folder, print the ratios, write figures/benchmarks.csv."""

from __future__ import annotations

import importlib
from pathlib import Path

import pandas as pd

from kilnflight.project import figures


def main() -> None:
    """Run (called by make bench)."""
    rows = []
    for path in sorted(Path(__file__).parent.glob("bench_*.py")):
        module = importlib.import_module(path.stem)
        for row in module.rows():
            print(
                f"{row.step}, {row.size} {row.unit}: {1000 * row.ours_s:.1f} ms, "
                f"{row.ratio:.1f} x faster than {row.peer}",
                flush=True,
            )
            rows.append(row)
    table = pd.DataFrame(rows)
    caption = (
        "Time of our implementation and of a peer with the same result, best of three runs in "
        "turns on the same machine; the ratio is peer over ours."
    )
    origin = figures.trace("benchmarks/run", {"scale": "full"}, mark="")
    figures.save("benchmarks", table, caption=caption, provenance=origin)


if __name__ == "__main__":
    main()
