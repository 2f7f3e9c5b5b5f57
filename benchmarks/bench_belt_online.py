"""The sorter that takes one picture at a time, against the 5 ms of a frame at 200 Hz.

Spheres of the friction model at the published feed rate, in pictures of full size. Latency is the
time from a picture to its decision: of the whole call, by two ways of finding spots, and by stage
with the published one. The three take turns in who comes first. Rendering is left out, and so are
frames without a particle. The time of the processor stands beside the elapsed time: what is more in
the latter is other processes' work on the same machine.
"""

from __future__ import annotations

import gc
import time

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
from kilnflight.experiments.belt_2020 import load_tracks, resample
from kilnflight.project import figures
from kilnflight.sorter.bulk import BULKS
from kilnflight.sorter.rendering import Pictures

SPHERES, FRAMES = 3713, 3000  # of a feed, 15 s
FEEDS = 4  # so that 99.9 % is not the third worst frame but the twelfth
STAGES = ("measure", "track", "predict", "plan")
CLOCKS = {"elapsed": time.perf_counter, "processor": time.thread_time}


def sorter(pictures: Pictures, split: bool) -> OnlineSorter:
    """Return a sorter that is calibrated with the first second."""
    background = average(pictures.frames(range(0, 1000, 10)))
    spots = Spots(split=split).calibrated(pictures.frames(range(200, 220)), background)
    measure = MeasureSpots(background, spots, calibrate_camera(FindCorners()(background)))
    return OnlineSorter(measure, CV(), LateralCV(), ValveBar())


def whole(online: OnlineSorter, picture: np.ndarray, frame: int) -> tuple[np.ndarray, int]:
    """Return the time (1, clocks) of a frame in s, and how many particles are in it."""
    before = [read() for read in CLOCKS.values()]
    decision = online(picture, frame)
    after = [read() for read in CLOCKS.values()]
    return np.array([after]) - before, len(decision.measured)


def by_stage(online: OnlineSorter, picture: np.ndarray, frame: int) -> tuple[np.ndarray, int]:
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
    return np.diff(clock, axis=0), len(measured)


WAYS = {"whole, as published": (whole, False), "whole, split": (whole, True)}
WAYS |= {"by stage, as published": (by_stage, False)}


def of_feed(seed: int, spheres: int, frames: int) -> pd.DataFrame:
    """Return the latency in ms of each frame of a feed, by way, stage and clock."""
    tracks = resample(load_tracks({}, seed, spheres)["spheres"], 200.0)
    pictures = Pictures(tracks, BULKS["spheres"], 0)
    sorters = {way: sorter(pictures, split) for way, (_, split) in WAYS.items()}
    times, counts = {way: [] for way in WAYS}, []
    for k, picture in enumerate(pictures.frames(range(frames))):
        order = np.roll(list(WAYS), k)
        for way in order:
            seconds, count = WAYS[way][0](sorters[way], picture, k)
            times[way].append(1000.0 * seconds)
        counts.append(count)
    tables = []
    for way, values in times.items():
        stages = STAGES if way.startswith("by stage") else ("all",)
        columns = pd.MultiIndex.from_product([[way], stages, CLOCKS])
        tables.append(pd.DataFrame(np.reshape(values, (len(values), -1)), columns=columns))
    return pd.concat(tables, axis=1)[np.array(counts) > 0]


def table(spheres: int, frames: int, feeds: int) -> pd.DataFrame:
    """Return the latency by way of finding spots, stage and clock."""
    cv2.setNumThreads(1)  # one core for the sorter
    gc.collect()
    gc.freeze()  # a collection looks at what the sorter makes, not at all that was imported
    latency = pd.concat([of_feed(2020 + feed, spheres, frames) for feed in range(feeds)])
    gc.unfreeze()
    rows = latency.quantile([0.5, 0.999, 1.0]).T
    rows.columns = ["median_ms", "q999_ms", "worst_ms"]
    late = (latency > 1000.0 * BELT_FRAME_S).sum()
    rows = rows.assign(frames=len(latency), late=late)
    return rows.rename_axis(["way", "stage", "clock"]).reset_index()


def rows() -> list[Row]:
    """Return nothing to compare: no peer does the same. `save` has the table."""
    return []


def save() -> None:
    """Save the latency of a frame by stage."""
    data = table(SPHERES, FRAMES, FEEDS)
    print(data.to_string())
    caption = (
        "Latency of the sorter that takes one picture at a time: median, 99.9 % and worst of the "
        "frames, by stage, and how many frames take more than 5 ms (200 Hz). Simulated spheres at "
        "the published feed rate, frames with a particle only. Elapsed time has other processes in "
        "it, the processor's has not."
    )
    origin = figures.trace("benchmarks/bench_belt_online", {"scale": "full"}, mark="")
    figures.save("benchmark-belt-online", data, caption=caption, provenance=origin)


if __name__ == "__main__":
    save()
