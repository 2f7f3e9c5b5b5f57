"""The belt's tracker with 100 particles in view, without and with pictures, against
peers.

Without pictures: the same tracker written with scipy, a filterpy object per track. With
pictures: finding particles and tracking them, rendering excluded, against scipy.ndimage
and that tracker. Links are checked before anything is timed: against the truth, with
pictures against each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
from filterpy.kalman import KalmanFilter
from measure import Row, check_links, compare
from scipy import ndimage
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from kilnflight.belt.camera import TRACKED, calibrate_camera, find_corners
from kilnflight.belt.models import Predictor
from kilnflight.belt.online import ValveSchedule, sort_spots
from kilnflight.belt.pictures import LEAST_PX, MeasureSpots, Spots, average
from kilnflight.belt.tracker import (
    BELT_FRAME_S,
    MISSED,
    Appearance,
    BeltTracker,
    constant_velocity,
)
from kilnflight.belt.valves import ValveBar
from kilnflight.simulated.belt.rendering import BULKS, Pictures
from kilnflight.tracking.filter import Motion

IN_VIEW = 100
VELOCITY = 1300.0  # mm/s: 46 frames to the end of the observed region
TRACKER = BeltTracker()
MOTION = constant_velocity()
cv2.setNumThreads(1)  # frames per second are told of one core


def bodies(
    frames: int, in_view: int = IN_VIEW, rate: float = 1 / BELT_FRAME_S, lanes: int = 16
) -> pd.DataFrame:
    """Return particles that move evenly, none nearer to another than 6 mm."""
    rng = np.random.default_rng(frames)
    life = 300.0 / VELOCITY * rate  # frames
    count = int(in_view * (frames / life + 1))
    start = np.linspace(-life, frames, count)
    turns = np.tile(np.arange(lanes), count // lanes + 1).reshape(-1, lanes)
    lane = rng.permuted(turns, axis=1)
    y = 10.0 + 10.6 * lane.ravel()[:count] + rng.uniform(-1, 1, count)
    frame = np.ceil(start)[:, None] + np.arange(int(life) + 12)
    x = 388.0 + (frame - start[:, None]) * VELOCITY / rate
    table = pd.DataFrame({"frame": frame.ravel().astype(int), "x": x.ravel()})
    table["y"] = np.repeat(y, x.shape[1])
    table["truth"] = np.repeat(np.arange(count), x.shape[1])
    table = table[(table["frame"] >= 0) & (table["frame"] < frames)]
    return table.sort_values(["frame", "x"], ignore_index=True)


def measured(frames: int) -> pd.DataFrame:
    """Return what a camera measures of them, good to 0.1 mm."""
    table = bodies(frames)
    table[["x", "y"]] += np.random.default_rng(1).normal(0, 0.1, (len(table), 2))
    return table[TRACKED.contains(table[["x", "y"]].to_numpy())].reset_index(drop=True)


def sorter(in_view: int, frames: int, rate: float, lanes: int) -> Row:
    """Return the comparison of a sorter, to the commands of its valves.

    The peer only tracks. Time stands still, so each command is given.
    """
    area = replace(TRACKED, width_mm=10.6 * lanes + 10)
    table = bodies(frames, in_view, rate, lanes)
    table[["x", "y"]] += np.random.default_rng(1).normal(0, 0.1, (len(table), 2))
    table = table[area.contains(table[["x", "y"]].to_numpy())].reset_index(drop=True)
    spots = [
        (number, rows[["x", "y"]].to_numpy()) for number, rows in table.groupby("frame")
    ]
    tracker = BeltTracker(MOTION, Appearance(area), 1 / rate)
    bar = ValveBar(2 * lanes, area.width_mm, deviations=2.0)

    def sort() -> list:
        schedule = ValveSchedule(bar)
        return list(
            sort_spots(spots, Predictor(), schedule, tracker, clock=lambda: 0.0)
        )

    if not any(decision.due for decision in sort()):
        raise AssertionError("the sorter commands no valve")
    return compare(
        (
            f"belt sorter to valves, {in_view} particles in view",
            "frames",
            frames,
            "scipy and filterpy, tracking alone",
        ),
        sort,
        lambda: with_scipy(table, MOTION, 1 / rate),
        repeats=3,
    )


def with_ours(table: pd.DataFrame) -> np.ndarray:
    """Return the track of each measurement, -1: none."""
    states = TRACKER(table).states
    seen = states[states["row"] >= 0]
    result = np.full(len(table), -1)
    result[seen["row"]] = seen["particle"]
    return result


def with_scipy(
    table: pd.DataFrame, motion: Motion = MOTION, frame_s: float = BELT_FRAME_S
) -> np.ndarray:
    """Return the same by scipy's assignment of the whole matrix and filterpy
    objects.
    """
    looks = Appearance()
    missed = MISSED
    tracks: list[tuple[int, KalmanFilter, int]] = []
    result = np.full(len(table), -1)
    names = 0
    for _, rows in table.groupby("frame").indices.items():
        seen = table[["x", "y"]].to_numpy()[rows]
        new = looks.new(seen)
        n = len(tracks)
        m = len(seen)
        whole = np.zeros((n + m, m + n))
        whole[n:, :m] = 1e9
        whole[:n, m:] = 1e9
        whole[n + np.arange(m), np.arange(m)] = -np.log(new)
        for i, (_, one, _) in enumerate(tracks):
            one.predict()
            s = one.H @ one.P @ one.H.T + one.R
            expected = (one.H @ one.x)[None]
            square = cdist(expected, seen, "mahalanobis", VI=np.linalg.inv(s))[0] ** 2
            cost = (
                square / 2
                + np.log(2 * np.pi * np.sqrt(np.linalg.det(s)))
                - np.log(1 - missed)
            )
            whole[i, :m] = np.where(square < 16, cost, 1e9)
            whole[i, m + i] = -np.log(
                looks.unobserved_likelihood(expected, s[None])[0][0]
            )
        row, column = linear_sum_assignment(whole)
        takes = dict(zip(row.tolist(), column.tolist(), strict=True))
        kept = []
        for i, (name, one, misses) in enumerate(tracks):
            if takes[i] < m:
                one.update(seen[takes[i]])
                result[rows[takes[i]]] = name
            if takes[i] < m or misses < 3:
                kept.append((name, one, 0 if takes[i] < m else misses + 1))
        for j in np.flatnonzero(result[rows] < 0):
            kept.append((names, _filter(seen[j], motion, frame_s), 0))
            result[rows[j]] = names
            names += 1
        tracks = kept
    return result


def _filter(place: np.ndarray, motion: Motion, frame_s: float) -> KalmanFilter:
    one = KalmanFilter(dim_x=4, dim_z=2)
    one.x, one.P = motion.initial()
    one.x[:2] = place
    one.F = motion.transition(frame_s)
    one.Q = motion.process_noise(frame_s)
    one.H = np.eye(2, 4)
    one.R = motion.measurement_noise()
    return one


def without_pictures(name: str, peer: Callable, frames: int) -> Row:
    """Return one comparison on measured positions."""
    table = measured(frames)
    for tracker in (with_ours, peer):
        check_links(table, tracker(table), tracker.__name__)
    what = ("belt tracker, 100 particles in view", "frames", frames, name)
    return compare(what, lambda: with_ours(table), lambda: peer(table))


def with_pictures(frames: int = 30) -> Row:
    """Return the comparison from pictures on; the particles found are the same."""
    truth = bodies(frames).assign(particle=lambda one: one["truth"])
    truth["time_s"] = truth["frame"] * BELT_FRAME_S
    recording = Pictures(truth, BULKS["spheres"], 0)
    pictures = list(recording.frames(range(frames)))
    background = average(
        replace(recording, tracks=truth[:1].assign(x=-1e4)).frames([0])
    )
    calibration = calibrate_camera(find_corners(background))
    spots = Spots()
    measure = MeasureSpots(background, spots, calibration)

    def by_scipy() -> pd.DataFrame:
        parts = []
        for frame, picture in enumerate(pictures):
            mask = np.abs(picture.astype(np.int16) - background) > spots.threshold
            labels, count = ndimage.label(mask, np.ones((3, 3)))
            index = np.arange(1, count + 1)
            area = ndimage.sum_labels(mask, labels, index)
            places = np.array(ndimage.center_of_mass(mask, labels, index)).reshape(
                -1, 2
            )
            places = calibration.millimetres(places[area >= LEAST_PX])
            parts.append(pd.DataFrame(places, columns=["x", "y"]).assign(frame=frame))
        every = pd.concat(parts, ignore_index=True)
        inside = TRACKED.contains(every[["x", "y"]].to_numpy())
        return every[inside].reset_index(drop=True)

    ours = measure.table(pictures)
    order = ["frame", "x", "y"]
    both = [one[order].sort_values(order).to_numpy() for one in (ours, by_scipy())]
    np.testing.assert_allclose(*both)
    check_links(ours.assign(truth=with_scipy(ours)), with_ours(ours), "with pictures")
    what = (
        "belt pictures to tracks, 100 in view",
        "frames",
        frames,
        "scipy.ndimage, filterpy",
    )
    return compare(
        what,
        lambda: with_ours(measure.table(pictures)),
        lambda: with_scipy(by_scipy()),
    )


def rows() -> list[Row]:
    """Return every comparison."""
    return [
        without_pictures("scipy and filterpy, one object per track", with_scipy, 100),
        with_pictures(),
        sorter(118, frames=120, rate=1000.0, lanes=16),
        sorter(1000, frames=20, rate=200.0, lanes=140),
    ]
