"""The sorter that takes one picture at a time, against the 5 ms of a frame at 200 Hz.

Spheres at the published feed rate, in pictures of full size. Latency is the time from a picture to
its decision, by stage. Rendering is left out. The time of the processor stands beside the elapsed
time: what is more in the latter is other processes' work on the same machine.
"""

from __future__ import annotations

import gc
import time
from itertools import product

import cv2
import numpy as np
import pandas as pd
from measure import Row

from kilnflight.belt.camera import FindCorners, calibrate_camera
from kilnflight.belt.models import CV, LateralCV
from kilnflight.belt.online import OnlineSorter
from kilnflight.belt.pictures import MeasureSpots, Spots, average
from kilnflight.belt.tracker import BELT_FRAME_S
from kilnflight.belt.valves import ValveBar
from kilnflight.experiments.belt_2016 import simulate_bodies
from kilnflight.project import figures
from kilnflight.sorter.machine import BULKS
from kilnflight.sorter.rendering import Pictures

SPHERES, FRAMES = 4000, 3000  # 4000 in 15 s, of which the last frames are of an emptying belt
STAGES = ("measure", "track", "predict", "plan")
CLOCKS = {"elapsed": time.perf_counter, "processor": time.thread_time}


def sorter(pictures: Pictures, split: bool) -> OnlineSorter:
    """Return a sorter that is calibrated with the first second."""
    background = average(pictures.frames(range(0, 1000, 10)))
    spots = Spots(split=split).calibrated(pictures.frames(range(200, 220)), background)
    measure = MeasureSpots(background, spots, calibrate_camera(FindCorners()(background)))
    return OnlineSorter(measure, CV(), LateralCV(), ValveBar())


def timed(online: OnlineSorter, picture: np.ndarray, frame: int) -> np.ndarray:
    """Return the times (stages, clocks) of a frame in s, by the calls of the sorter itself."""
    clock = [[read() for read in CLOCKS.values()]]
    measured = online.measure(picture, frame)
    clock.append([read() for read in CLOCKS.values()])
    step = online.track(measured[:, 4:], frame)
    clock.append([read() for read in CLOCKS.values()])
    predicted = online.predict(step.tracks)
    clock.append([read() for read in CLOCKS.values()])
    online.schedule.step((frame + 1) * BELT_FRAME_S, predicted)
    online.belt(step.tracks)
    clock.append([read() for read in CLOCKS.values()])
    return np.diff(clock, axis=0)


def table(bodies: pd.DataFrame, frames: int) -> pd.DataFrame:
    """Return the latency by way of finding spots, clock and stage."""
    cv2.setNumThreads(1)  # one core for the sorter
    pictures = Pictures(bodies, BULKS["spheres"], 0)
    sorters = {"as published": sorter(pictures, False), "split": sorter(pictures, True)}
    gc.collect()
    gc.freeze()  # a collection looks at what the sorter makes, not at all that was imported
    numbered = enumerate(pictures.frames(range(frames)))
    times = [[timed(each, picture, k) for each in sorters.values()] for k, picture in numbered]
    gc.unfreeze()
    milliseconds = 1000.0 * np.array(times)  # (frames, sorters, stages, clocks)
    rows = []
    for (s, way), (c, clock) in product(enumerate(sorters), enumerate(CLOCKS)):
        by_stage = dict(zip(STAGES, milliseconds[:, s, :, c].T, strict=True))
        for stage, one in (by_stage | {"all": milliseconds[:, s, :, c].sum(axis=1)}).items():
            late = int((one > 1000.0 * BELT_FRAME_S).sum())
            rows.append((way, clock, stage, frames, *np.quantile(one, [0.5, 0.999, 1.0]), late))
    columns = ["spots", "clock", "stage", "frames", "median_ms", "q999_ms", "worst_ms", "late"]
    return pd.DataFrame(rows, columns=columns)


def rows() -> list[Row]:
    """Return nothing to compare: no peer does the same. `save` has the table."""
    return []


def save() -> None:
    """Save the latency of a frame by stage."""
    data = table(simulate_bodies("spheres", SPHERES, 2020), FRAMES)
    print(data.to_string())
    caption = (
        "Latency of the sorter that takes one picture at a time: median, 99.9 % and worst of the "
        "frames, by stage, and how many frames take more than 5 ms (200 Hz). Simulated spheres at "
        "the published feed rate. Elapsed time has other processes in it, the processor's has not."
    )
    origin = figures.trace("benchmarks/bench_belt_online", {"scale": "full"}, mark="")
    figures.save("benchmark-belt-online", data, caption=caption, provenance=origin)


if __name__ == "__main__":
    save()
