"""The whole chain of a campaign, from frames to flights: cost and memory by number of frames."""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import pandas as pd
from measure import Row

from kilnflight import kiln
from kilnflight.detection.wall import Cylinder
from kilnflight.experiments import campaigns
from kilnflight.experiments.campaigns import Settings
from kilnflight.project import figures

LENGTHS = (30, 100, 300)  # frames of confetti at 4.5 bar, with the 150 around them to subtract
# About what the labelled frames teach (`lessons`), which is not measured here.
LEARNED = Settings(283.0, Cylinder((68.0, 451.0, 8382.0), (0.0, 0.0, 1.0), 700.0), 713.0)


def rows() -> list[Row]:
    """Return nothing: there is no peer that goes from frames to flights."""
    return []


def chain(frames: int) -> tuple[float, float, float]:
    """Return seconds to detect, seconds for what follows, and the peak of memory in MiB."""
    one = campaigns.campaigns("full", LEARNED)[2].run
    with tempfile.TemporaryDirectory() as folder:
        part = replace(one.detection, start=1000, stop=1000 + frames, folder=Path(folder))
        run = replace(one, detection=part)
        begin = time.perf_counter()
        part.detections()
        detected = time.perf_counter()
        kiln.make_tables([run])
        done = time.perf_counter()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return detected - begin, done - detected, peak


def save() -> None:
    """Save speed and peak memory against the number of frames."""
    table = []
    for frames in LENGTHS:
        command = [sys.executable, __file__, str(frames)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        found, rest, peak = map(float, done.stdout.split())
        table.append((frames, found, rest, found / frames, peak))
        print(f"chain over {frames} frames: {found:.0f} + {rest:.1f} s, peak {peak:.0f} MiB")
    columns = ["frames", "detection_s", "rest_s", "detection_s_per_frame", "peak_mib"]
    caption = (
        "The chain from frames to flights, one process, full resolution, rendering of the twin "
        "included: detection, then tracking, post-processing, regression and flights, and the peak "
        "of memory, by number of frames. Short stretches pay for the 150 frames around them."
    )
    origin = figures.trace("benchmarks/bench_chain", {"scale": "full"}, mark="")
    data = pd.DataFrame(table, columns=columns)
    figures.save("benchmark-chain", data, caption=caption, provenance=origin)


if __name__ == "__main__":
    print(*chain(int(sys.argv[1])))
