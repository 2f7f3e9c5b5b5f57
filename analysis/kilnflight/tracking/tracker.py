"""From detections to tracks: predict, gate, associate, update, start, stop (thesis, 4.1).

One loop over frames serves every associator and every motion model; within a frame all
tracks are arrays. What is linked is the detections themselves: the filter decides, but no
filtered position is ever handed on (section 5.2.3).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from numba import njit

from kilnflight.association import GNN, Associator, Pairs
from kilnflight.checks import (
    InputError,
    check_columns,
    check_offers,
    check_whole,
    is_real,
    known_numbers,
)
from kilnflight.tables import DETECTIONS, Table
from kilnflight.tracking import kalman
from kilnflight.tracking.gate import Detected, Gate, Predicted
from kilnflight.tracking.motion import ConstantVelocity, Motion
from kilnflight.tracking.tracklist import Management, Tracks, born, joined, living, seen

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

__all__ = ["Management", "Step", "Tracks", "record", "steps", "track"]

NEEDED = Table("detections to track", DETECTIONS.columns[:3])  # frame, row, col


class Step(NamedTuple):
    """What happened in one frame, for whoever wants to look (Figs 4.2 and 2.20 to 2.22)."""

    frame: int
    rows: Integers  # (m,), rows of the table, by position; the m detections in this order
    predicted: Tracks  # the n tracks after prediction, before update
    residual_covariance: Array  # (n, 2, 2), S: ellipses of the gates
    pairs: Pairs
    weights: Array  # (n, 1 + m)
    particle: Integers  # (m,), the track each detection went to or started


_GNN = GNN()
_MOTION = ConstantVelocity()
_GATE = Gate()
_MANAGEMENT = Management()


def track(
    detections: pd.DataFrame,
    associator: Associator = _GNN,
    motion: Motion = _MOTION,
    gate: Gate = _GATE,
    management: Management = _MANAGEMENT,
) -> pd.DataFrame:
    """Return ``detections`` with a column ``particle``: 0, 1, ... in order of birth.

    Parameters
    ----------
    detections
        Columns frame (whole numbers, which floats may hold), row, col (px); z (mm) and points
        are used where present. NaN in z, and NaN or 0 in points, mean unknown. Other columns
        are carried along.
    associator, motion, gate, management
        Who gets what, how particles move, what is possible, when tracks end.

    Returns
    -------
    table
        The same rows in the same order, with the same index. Every detection is in exactly
        one track; one that no other follows is a track of its own. Rows that already have
        ``particle`` -1 stay so and are left out; any other particle is overwritten.

    Raises
    ------
    InputError
        If a column is missing or there twice, a frame is no whole number, a position is not
        finite, or an associator and the like is none (a class, say); the
        message names the row.

    Notes
    -----
    The thesis does not say which detection a probabilistic track is recorded with. Here: one
    whose weight beats the track's own "missed"; and one that more probably belongs to some
    track than to none goes to the track it weighs most for. Otherwise several tracks that
    share a particle would each call it missed, and it would start one more. Largest weight
    first; a track or detection that is taken is passed over.

    Within a frame, detections are taken by row, col, z, points, so neither tracks nor ids
    depend on the order of the table; rows equal in all of these are taken as they stand.
    """
    check_columns(detections, NEEDED.names, NEEDED.name)
    left_out = np.zeros(len(detections), dtype=bool)
    if "particle" in detections.columns:
        check_columns(detections, ["particle"], NEEDED.name)
        left_out = (detections["particle"] == -1).to_numpy(dtype=bool, na_value=False)
    particle = np.full(len(detections), -1, dtype=np.int64)
    wanted = np.flatnonzero(~left_out)
    for step in steps(detections[~left_out], associator, motion, gate, management):
        particle[wanted[step.rows]] = step.particle
    return detections.assign(particle=particle)


def steps(
    detections: pd.DataFrame,
    associator: Associator = _GNN,
    motion: Motion = _MOTION,
    gate: Gate = _GATE,
    management: Management = _MANAGEMENT,
) -> Iterator[Step]:
    """Yield what `track` does in each frame that has detections; same arguments."""
    _check_parts(associator, motion, gate, management)
    frames, rows, found = _read(detections)
    if not len(frames):
        return
    starts = np.flatnonzero(np.diff(frames, prepend=frames[:1] - 1))
    measurement, noise = motion.measurement(), motion.measurement_noise()
    tracks, started = born(motion, 0, 0, _take(found, slice(0, 0))), 0
    before, gap = int(frames[0]), -1
    for start, stop in zip(starts, np.append(starts[1:], len(frames)), strict=True):
        frame, here = int(frames[start]), _take(found, slice(start, stop))
        old = living(tracks, management, frame - 1)
        if frame - before != gap:
            gap = frame - before
            moves = motion.transition(float(gap)), motion.process_noise(float(gap))
        state, covariance = kalman.predict(old.state, old.covariance, *moves)
        old = old._replace(state=state, covariance=covariance)
        residual = kalman.residual_covariance(covariance, measurement, noise)
        predicted = Predicted(state @ measurement.T, residual, old.depth_mm, old.points)
        pairs = gate(predicted, here)
        weights = associator(pairs) if _any_inside(pairs) else _missed(pairs)
        state, covariance = kalman.update(
            state, covariance, here.positions, weights, measurement, noise
        )
        owner = record(weights)
        particle = _named(owner, old.particle, started)
        new = born(motion, frame, started, _take(here, owner < 0))
        yield Step(frame, rows[start:stop], old, residual, pairs, weights, particle)
        tracks = joined(seen(old, state, covariance, here, owner, frame), new)
        started, before = started + len(new.particle), frame


def _check_parts(
    associator: Associator, motion: Motion, gate: Gate, management: Management
) -> None:
    """Refuse what is none of the four, such as a class in place of its instance."""
    moves = ("transition", "process_noise", "measurement", "measurement_noise", "initial")
    check_offers(associator, ("__call__",), "track: associator")
    check_offers(motion, moves, "track: motion")
    check_offers(gate, ("__call__",), "track: gate")
    check_offers(management, ("keeps",), "track: management")


def _read(table: pd.DataFrame) -> tuple[Integers, Integers, Detected]:
    """Return frames, rows by position, and detections, sorted by frame and place."""
    check_columns(table, NEEDED.names, NEEDED.name)
    frames = check_whole(table["frame"], f"{NEEDED.name}: column frame")
    needed = table[NEEDED.names].assign(frame=frames)
    for name in NEEDED.names[1:]:
        if len(table) and not is_real(table[name]):
            raise InputError(
                f"{NEEDED.name}: column {name} holds {table[name].dtype}, not numbers."
            )
    positions = (NEEDED.check(needed) if len(table) else needed)[["row", "col"]].to_numpy(float)
    depth, points = _optional(table, "z"), _optional(table, "points")
    points = np.where(points > 0, points, np.nan)
    extra = [values for values in (points, depth) if not np.isnan(values).all()]
    rows = np.lexsort((*extra, positions[:, 1], positions[:, 0], frames))
    found = Detected(np.ascontiguousarray(positions[rows]), depth[rows], points[rows])
    return frames[rows], rows, found


def _optional(table: pd.DataFrame, name: str) -> Array:
    """Return a column as floats, NaN where nothing is known."""
    if name not in table.columns:
        return np.full(len(table), np.nan)
    check_columns(table, [name], NEEDED.name)
    values = known_numbers(table[name], f"{NEEDED.name}: column {name}")
    if np.isinf(values).any():
        where = table.index[int(np.argmax(np.isinf(values)))]
        raise InputError(f"{NEEDED.name}: {name} is infinite in row {where}; use NaN for unknown.")
    return values


def _take(found: Detected, which: Any) -> Detected:
    return Detected(found.positions[which], found.depth_mm[which], found.points[which])


def _any_inside(pairs: Pairs) -> bool:
    return bool(np.isfinite(pairs.distance_squared).any())


def _missed(pairs: Pairs) -> Array:
    """Return the weights where no gate holds a detection: there is nothing to associate."""
    tracks, detections = pairs.distance_squared.shape
    return np.eye(1, 1 + detections).repeat(tracks, axis=0)


@njit(cache=True)
def record(weights: Any) -> Any:
    """Return the track (m,) that each detection is recorded for, -1: none.

    See `track`. Of equal weights the older track's, and of these the first detection's,
    comes first. Rows of 0 and 1 are read off as they are.
    """
    tracks, detections = weights.shape[0], weights.shape[1] - 1
    first, total = np.full(detections, -1, np.int64), np.zeros(detections)
    for i in range(tracks):
        for j in range(detections):
            total[j] += weights[i, j + 1]
            if first[j] < 0 or weights[i, j + 1] > weights[first[j], j + 1]:
                first[j] = i
    owner, free = np.full(detections, -1, np.int64), np.ones(tracks, np.bool_)
    pairs = np.empty((tracks * detections, 2), np.int64)
    count = 0
    for i in range(tracks):
        for j in range(detections):
            sure = total[j] > 0.5 and first[j] == i
            if sure or weights[i, j + 1] > weights[i, 0]:
                pairs[count, 0], pairs[count, 1] = i, j
                count += 1
    value = np.empty(count)
    for p in range(count):
        value[p] = -weights[pairs[p, 0], pairs[p, 1] + 1]
    for p in np.argsort(value, kind="mergesort"):
        i, j = pairs[p]
        if free[i] and owner[j] < 0:
            owner[j] = i
            free[i] = False
    return owner


@njit(cache=True)
def _named(owner: Any, particle: Any, started: int) -> Any:
    """Return the particle of each detection; those of no track get the next ids."""
    names = np.empty(len(owner), np.int64)
    for j in range(len(owner)):
        if owner[j] >= 0:
            names[j] = particle[owner[j]]
        else:
            names[j] = started
            started += 1
    return names
