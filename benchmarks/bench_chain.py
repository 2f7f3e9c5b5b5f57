"""The whole chain of a campaign, from frames to flights: cost by number of frames, and memory.

Full resolution, one process, rendering of the twin included. There is no peer: a ratio of 1 is
linear cost. Short stretches pay for the 150 frames around them.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from resource import RUSAGE_SELF, getrusage

from measure import Row

from kilnflight import kiln
from kilnflight.detection.wall import Cylinder
from kilnflight.experiments import campaigns
from kilnflight.experiments.campaigns import LearnedSettings

LENGTHS = (30, 100, 300)  # frames of confetti at 4.5 bar
# About what the labelled frames teach (`lessons`), which is not measured here.
LEARNED = LearnedSettings(283.0, Cylinder((68.0, 451.0, 8382.0), (0.0, 0.0, 1.0), 700.0), 713.0)


def chain(frames: int) -> tuple[float, float]:
    """Return the seconds from frames to flights, and the peak of memory in MiB."""
    one = campaigns.campaigns("full", LEARNED)[2].run
    with tempfile.TemporaryDirectory() as folder:
        part = replace(one.detection, start=1000, stop=1000 + frames, folder=Path(folder))
        start = time.perf_counter()
        kiln.make_tables([replace(one, detection=part)])
        return time.perf_counter() - start, getrusage(RUSAGE_SELF).ru_maxrss / 1024


def rows() -> list[Row]:
    """Return the times, each length in a process of its own."""
    found, each = [], 0.0
    for frames in LENGTHS:
        command = [sys.executable, __file__, str(frames)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        seconds, peak = map(float, done.stdout.split())
        print(f"chain over {frames} frames: {seconds:.0f} s, peak {peak:.0f} MiB")
        each = each or seconds / frames
        linear = each * frames
        row = ("whole chain", "frames", frames, seconds, linear, linear / seconds)
        found.append(Row(*row, f"its own {LENGTHS[0]} frames, scaled"))
    return found


if __name__ == "__main__":
    print(*chain(int(sys.argv[1])))
