"""Run every benchmark; write benchmarks.csv, cost-by-step.csv, growth.csv and
scale-out.csv into figures/.
"""

from __future__ import annotations

import importlib
from pathlib import Path

import bench_kiln
import growth
import pandas as pd
from measure import Row

from kilnflight.publication import figures


def main() -> None:
    """Run (called by make bench)."""
    rows = []
    for path in sorted(Path(__file__).parent.glob("bench_*.py")):
        module = importlib.import_module(path.stem)
        for row in module.rows():
            times = (
                f"{row.ratio:.3g} times our time ({row.lowest:.3g} to "
                f"{row.highest:.3g})"
            )
            print(
                f"{row.step}, {row.size} {row.unit}: {row.peer} takes {times}",
                flush=True,
            )
            rows.append((*row[:4], *(float(f"{each:.3g}") for each in row[4:])))
    origin = figures.trace("benchmarks/run", {"scale": "full"}, mark="")
    caption = (
        "Time of other programs over ours. Median, lowest and highest ratio of five "
        "runs in turns, on one core."
    )
    table = pd.DataFrame(rows, columns=Row._fields)
    figures.save("benchmarks", table, caption=caption, provenance=origin)
    caption = (
        "Time of each step of combined detection, the limit that memory sets, and its "
        "share of a frame, ours and the peer's, one core."
    )
    figures.save("cost-by-step", bench_kiln.steps(), caption=caption, provenance=origin)
    caption = (
        "Time for one frame, point or detection over that of the smallest size, and "
        "the peak of memory. Points: shortest of five runs; detections, with the share "
        "of their links that is right: of three; frames and workers: one run. Workers "
        "of Dask: speed-up over one, share of the command's time in which they detect, "
        "how many a network of 1 GB/s keeps busy."
    )
    measured, modelled = growth.tables()
    figures.save("growth", measured, caption=caption, provenance=origin)
    caption = (
        "Speed-up of kilnflight run over one worker, by a model: workers take chunk "
        "after chunk; tracks, fits and pictures are one process's. Measured are its "
        "inputs, the four times on the right."
    )
    figures.save("scale-out", modelled, caption=caption, provenance=origin)


if __name__ == "__main__":
    main()
