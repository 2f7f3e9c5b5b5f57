"""From detections to tracks: predict, gate, associate, update, start, stop (thesis, 4.1).

One loop over frames serves every associator and every motion model; within a frame all
tracks are arrays. What is linked is the detections themselves: the filter decides, but no
filtered position is ever handed on (section 5.2.3).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from numba import njit

from kilnflight import kalman
from kilnflight.association import GNN, Associator, Pairs
from kilnflight.checks import InputError, check_columns
from kilnflight.gating import Detected, Gate, Predicted
from kilnflight.motion import ConstantVelocity, Motion
from kilnflight.tables import DETECTIONS, Table

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

NEEDED = Table("detections to track", DETECTIONS.columns[:3])  # frame, row, col


@dataclass(frozen=True)
class Management:
    """When a track is given up, Eq. 4.14: seen too seldom, or not for too long.

    Notes
    -----
    No value is printed. ``invisible``: five frames are 15 ms, in which a particle of
    30 px/frame that brakes by 0.3 px/frame^2 leaves its prediction by some 5 px; longer
    gaps, up to 15 frames, are closed afterwards (t_eps,CONNECT of Table 5.16).
    ``visibility``: detectors find half of the particles that do not burn and nearly all of
    those that do (Table 5.6), so a true track lies above 0.4 but for bad luck. As any
    miss in the second frame makes 0.5 and in the third 1/3, it is tested from
    ``visibility_age`` on only. Frames that have no detection at all count like any other.
    """

    visibility: float = 0.4  # v_eps, share of the frames of its life; not printed
    invisible: int = 5  # CIC_eps, frames in a row; not printed
    visibility_age: int = 4  # frames of life from which visibility is tested; not printed

    def __post_init__(self) -> None:
        """Refuse what is no share and no number of frames."""
        if not 0 <= self.visibility <= 1:
            raise InputError(f"Management: visibility must be 0 to 1, got {self.visibility}.")
        for name in ("invisible", "visibility_age"):
            if not getattr(self, name) >= 0:
                raise InputError(f"Management: {name} must be 0 or above; {getattr(self, name)}.")

    def keeps(self, seen: Integers, age: Integers, missed: Integers) -> npt.NDArray[np.bool_]:
        """Return which tracks live on, by times seen, frames of life, frames since last seen."""
        seldom = (age >= self.visibility_age) & (seen < self.visibility * age)
        return ~(seldom | (missed > self.invisible))


class Tracks(NamedTuple):
    """The n tracks that are alive, as they stood in the frame ``step`` last looked at."""

    particle: Integers  # (n,), ids in order of birth
    state: Array  # (n, k)
    covariance: Array  # (n, k, k)
    depth_mm: Array  # (n,), last known; NaN: never known
    points: Array  # (n,), last known number of 3D points; NaN: never known
    born: Integers  # (n,), frame
    last: Integers  # (n,), frame of the last recorded detection
    seen: Integers  # (n,), number of recorded detections, V in Eq. 4.14


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
        Columns frame (int), row, col (px); z (mm) and points are used where present. NaN
        in z, and NaN or 0 in points, mean unknown. Other columns are carried along.
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
        If a column is missing, frames are not integers, or a position is not finite; the
        message names the row.

    Notes
    -----
    Within a frame, detections are taken by row, col, z, points, so neither tracks nor ids
    depend on the order of the table; rows equal in all of these are taken as they stand.
    """
    left_out = np.zeros(len(detections), dtype=bool)
    if isinstance(detections, pd.DataFrame) and "particle" in detections.columns:
        left_out = (detections["particle"] == -1).to_numpy()
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
    frames, rows, found = _read(detections)
    if not len(frames):
        return
    starts = np.flatnonzero(np.diff(frames, prepend=frames[:1] - 1))
    measurement, noise = motion.measurement(), motion.measurement_noise()
    tracks, started = _born(motion, 0, 0, _take(found, slice(0, 0))), 0
    before = int(frames[0])
    for start, stop in zip(starts, np.append(starts[1:], len(frames)), strict=True):
        frame, here = int(frames[start]), _take(found, slice(start, stop))
        gap = float(frame - before)
        old = _living(tracks, management, frame - 1)
        state, covariance = kalman.predict(
            old.state, old.covariance, motion.transition(gap), motion.process_noise(gap)
        )
        old = old._replace(state=state, covariance=covariance)
        residual = kalman.residual_covariance(covariance, measurement, noise)
        positions = state @ measurement.T
        pairs = gate(Predicted(positions, residual, old.depth_mm, old.points), here)
        weights = associator(pairs) if _any_inside(pairs) else _missed(pairs)
        owner = _record(weights)
        state, covariance = kalman.update(
            state, covariance, here.positions, weights, measurement, noise
        )
        new = _born(motion, frame, started, _take(here, owner < 0))
        seen = _seen(old._replace(state=state, covariance=covariance), here, owner, frame)
        particle = np.empty(len(owner), dtype=np.int64)
        particle[owner >= 0] = old.particle[owner[owner >= 0]]
        particle[owner < 0] = new.particle
        yield Step(frame, rows[start:stop], old, residual, pairs, weights, particle)
        tracks = _joined(seen, new)
        started, before = started + len(new.particle), frame


def _read(table: pd.DataFrame) -> tuple[Integers, Integers, Detected]:
    """Return frames, rows by position, and detections, sorted by frame and place."""
    check_columns(table, NEEDED.names, NEEDED.name)
    needed = NEEDED.check(table[NEEDED.names]) if len(table) else table[NEEDED.names]
    frames = needed["frame"].to_numpy(dtype=np.int64)
    positions = needed[["row", "col"]].to_numpy(dtype=np.float64)
    depth, points = _optional(table, "z"), _optional(table, "points")
    points = np.where(points > 0, points, np.nan)
    rows = np.lexsort((points, depth, positions[:, 1], positions[:, 0], frames))
    found = Detected(np.ascontiguousarray(positions[rows]), depth[rows], points[rows])
    return frames[rows], rows, found


def _optional(table: pd.DataFrame, name: str) -> Array:
    """Return a column as floats, NaN where nothing is known."""
    if name not in table.columns:
        return np.full(len(table), np.nan)
    try:
        values = table[name].to_numpy(dtype=np.float64, na_value=np.nan)
    except (TypeError, ValueError) as error:
        raise InputError(f"{NEEDED.name}: column {name} is not made of numbers.") from error
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


def _living(tracks: Tracks, management: Management, frame: int) -> Tracks:
    """Return the tracks that Eq. 4.14 keeps at the end of ``frame``."""
    age, missed = frame - tracks.born + 1, frame - tracks.last
    keep = management.keeps(tracks.seen, age, missed)
    return tracks if keep.all() else Tracks._make(values[keep] for values in tracks)


@njit(cache=True)
def _record(weights: Any) -> Any:
    """Return the track (m,) that each detection is recorded for, -1: none.

    Pairs whose weight beats the track's own "missed", largest weight first; a track or a
    detection that is taken is passed over. Of equal weights the older track's, and of
    these the first detection's, comes first. Rows of 0 and 1 are read off as they are.
    """
    tracks, detections = weights.shape[0], weights.shape[1] - 1
    owner, free = np.full(detections, -1, np.int64), np.ones(tracks, np.bool_)
    pairs = np.empty((tracks * detections, 2), np.int64)
    count = 0
    for i in range(tracks):
        for j in range(detections):
            if weights[i, j + 1] > weights[i, 0]:
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


def _joined(old: Tracks, new: Tracks) -> Tracks:
    return Tracks._make(np.concatenate(both) for both in zip(old, new, strict=True))


def _seen(tracks: Tracks, here: Detected, owner: Integers, frame: int) -> Tracks:
    """Return the tracks with what their recorded detections tell: when, how deep, how large."""
    recorded = np.flatnonzero(owner >= 0)
    mine = owner[recorded]
    last, seen = tracks.last.copy(), tracks.seen.copy()
    last[mine] = frame
    seen[mine] += 1
    depth, points = tracks.depth_mm.copy(), tracks.points.copy()
    for kept, told in ((depth, here.depth_mm[recorded]), (points, here.points[recorded])):
        known = ~np.isnan(told)
        kept[mine[known]] = told[known]
    return tracks._replace(depth_mm=depth, points=points, last=last, seen=seen)


def _born(motion: Motion, frame: int, started: int, alone: Detected) -> Tracks:
    """Return one new track for each detection that is in none (section 4.1.4)."""
    state, covariance = motion.initial(alone.positions)
    count = len(state)
    return Tracks(
        started + np.arange(count),
        state,
        covariance,
        alone.depth_mm,
        alone.points,
        np.full(count, frame),
        np.full(count, frame),
        np.ones(count, dtype=np.int64),
    )
