"""Run every benchmark of this folder; write figures/benchmarks.csv and figures/growth.csv."""

from __future__ import annotations

import importlib
from pathlib import Path

import bench_kiln
import growth
import pandas as pd
from measure import Row

from kilnflight.project import figures


def main() -> None:
    """Run (called by make bench)."""
    rows = []
    for path in sorted(Path(__file__).parent.glob("bench_*.py")):
        module = importlib.import_module(path.stem)
        for row in module.rows():
            times = f"{row.ratio:.3g} times our time ({row.lowest:.3g} to {row.highest:.3g})"
            print(f"{row.step}, {row.size} {row.unit}: {row.peer} takes {times}", flush=True)
            rows.append((*row[:4], *(float(f"{each:.3g}") for each in row[4:])))
    origin = figures.trace("benchmarks/run", {"scale": "full"}, mark="")
    caption = (
        "Time of other programs over ours. Median, lowest and highest ratio of five runs in turns "
        "on one core."
    )
    table = pd.DataFrame(rows, columns=Row._fields)
    figures.save("benchmarks", table, caption=caption, provenance=origin)
    caption = "Share of each step in the time of combined detection, one core."
    figures.save("cost-by-step", bench_kiln.steps(), caption=caption, provenance=origin)
    caption = (
        "Time for one frame, point, detection or chunk by that of the smallest size. 1 is linear "
        "growth. Two workers of Dask halve the time of a chunk at best; the last columns say how "
        "many workers its scheduler, or a network of 1 GB/s, keep at work."
    )
    figures.save("growth", growth.table(), caption=caption, provenance=origin)


if __name__ == "__main__":
    main()
