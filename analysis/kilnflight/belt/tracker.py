"""Multitarget tracking on the belt (2016 paper, section II.B).

predict, gate, associate with extra rows and columns, update, score, start, stop

Filter, gate and assignment are those of the kiln's tracker; what is the belt's own is where
tracks begin and end, and the score that tells particles from dirt. Lengths are in mm, times
in s.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from numba import njit

from kilnflight.association import one_hot
from kilnflight.belt.appearance import Appearance
from kilnflight.belt.association import associate, pair_costs
from kilnflight.belt.filters import BELT_FRAME_S, constant_velocity
from kilnflight.checks import (
    InputError,
    check_between,
    check_columns,
    check_count,
    check_offers,
    check_positive,
)
from kilnflight.tables import BELT_ENDS, BELT_STATES, Column, Table
from kilnflight.tracking import kalman
from kilnflight.tracking.gate import Detected, Gate, Predicted
from kilnflight.tracking.motion import Motion

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]

MEASURED = Table(
    "measurements on the belt",
    (
        Column("frame", int, "1", "frame of the camera"),
        Column("x", float, "mm", "along the belt"),
        Column("y", float, "mm", "across the belt"),
    ),
)
LEFT, BACK, SIDEWAYS = "left at the end", "left at the start", "left sideways"
LOST, RUNNING = "lost", "recording ends"
REASONS = (LEFT, BACK, SIDEWAYS, LOST, RUNNING)


_MOTION, _APPEARANCE, _GATE = constant_velocity(), Appearance(), Gate()


class Followed(NamedTuple):
    """What became of a recording."""

    states: pd.DataFrame  # kilnflight.tables.BELT_STATES
    ends: pd.DataFrame  # kilnflight.tables.BELT_ENDS, and reason: one of REASONS


class Step(NamedTuple):
    """One frame, for whoever wants to look (Fig. 3)."""

    frame: int
    rows: Integers  # (m,), rows of the table of measurements
    names: Integers  # (n,), tracks known before
    costs: Array  # (n, m)
    gone: Array  # (n,)
    new: Array  # (m,)
    column: Integers  # (n,), measurement of each track, -1: missed
    after: Tracks  # once updated, before any is taken out


class Tracks(NamedTuple):
    """The n tracks that are alive."""

    particle: Integers  # (n,)
    state: Array  # (n, k), mm, mm/s (and mm/s^2)
    covariance: Array  # (n, k, k)
    row: Integers  # (n,), of the last frame's measurement, -1: missed
    score: Array  # (n,)
    best: Array  # (n,), highest score so far
    valid: npt.NDArray[np.bool_]  # (n,), whether it has ever reached the upper threshold
    outside: Array  # (n,), probability that the prediction lies outside the area


@dataclass(frozen=True)
class BeltTracker:
    """Global nearest neighbour with likelihoods of appearing and leaving, and track scores.

    A track's score is the log likelihood ratio of a particle against dirt (Blackman and
    Popoli, ch. 6): at its start that of a new particle at this place, with each measurement
    ln((1 - missed) N / clutter), with each miss ln(gone). It is valid from ln((1 - b) / a) on,
    and lost when the score has fallen below its best by more than ln((1 - a) / b).

    Notes
    -----
    The paper names the score and its purpose, no thresholds. A missed track that is outside
    with a probability above one half has left; that is no loss.
    """

    motion: Motion = _MOTION
    appearance: Appearance = _APPEARANCE
    gate: Gate = _GATE  # "beyond a certain Mahalanobis distance": 4, as in the kiln
    frame_s: float = BELT_FRAME_S
    false_valid: float = 1e-4  # a: share of dirt tracks that become valid; assumption
    false_lost: float = 1e-6  # b: share of particles given up; six misses in a row; assumption

    def __post_init__(self) -> None:
        """Refuse parts that are none."""
        moves = ("transition", "process_noise", "measurement", "measurement_noise", "initial")
        check_offers(self.motion, moves, "BeltTracker: motion")
        check_offers(self.appearance, ("new", "gone"), "BeltTracker: appearance")
        check_offers(self.gate, ("__call__",), "BeltTracker: gate")
        check_positive(self.frame_s, "BeltTracker: frame_s")
        check_between(self.false_valid, 1e-12, 0.5, "BeltTracker: false_valid")
        check_between(self.false_lost, 1e-12, 0.5, "BeltTracker: false_lost")

    def __call__(self, measured: pd.DataFrame, frames: int | None = None) -> Followed:
        """Return the states of all tracks in all frames, and how each ended.

        Parameters
        ----------
        measured
            Columns frame, x, y (mm), as `kilnflight.tables.BELT_SPOTS`; outside the area they
            are passed over.
        frames
            How many frames the camera took, so that tracks may end after the last measurement;
            None: up to that one.

        Raises
        ------
        InputError
            If a column is missing or holds what is no number, if one frame has two measurements
            at the same place, which would make two tracks of one particle, or if ``frames`` is no
            whole number from 0.
        """
        numbers, parts = [], []
        for step in self.steps(measured, frames):
            numbers.append(np.full(len(step.after.particle), step.frame))
            parts.append(step.after)
        if not parts:
            return Followed(BELT_STATES.empty(), BELT_ENDS.empty().assign(reason=""))
        every = Tracks._make(np.concatenate(one) for one in zip(*parts, strict=True))
        frame = np.concatenate(numbers)
        return Followed(_states(frame, every), self._ends(frame, every))

    def steps(self, measured: pd.DataFrame, frames: int | None = None) -> Iterator[Step]:
        """Yield what happens in each frame from the first measurement on; same arguments."""
        if frames is not None:
            check_count(frames, "BeltTracker: frames", least=0)
        at, rows, places = self._read(measured)
        if not len(at):
            return
        motion, dimension = self.motion, self.motion.measurement()
        noise = motion.measurement_noise()
        moves = motion.transition(self.frame_s), motion.process_noise(self.frame_s)
        numbers = np.arange(at[0], max(at[-1] + 1, int(frames or 0)))
        starts = np.searchsorted(at, numbers)
        stops = np.append(starts[1:], len(at))
        tracks, started = _nothing(motion), 0
        for frame, start, stop in zip(numbers.tolist(), starts, stops, strict=True):
            here, names = places[start:stop], rows[start:stop]
            state, covariance = kalman.predict(tracks.state, tracks.covariance, *moves)
            residual = kalman.residual_covariance(covariance, dimension, noise)
            expected = state @ dimension.T
            pairs = self.gate(_predicted(expected, residual), _detected(here))
            gone, outside = self.appearance.gone(expected, residual)
            new = self.appearance.new(here)
            costs = pair_costs(pairs, self.appearance.missed)
            column = associate(costs, gone, new)
            weights = one_hot(column, len(here))
            state, covariance = kalman.update(state, covariance, here, weights, dimension, noise)
            row = np.append(names, -1)[column]
            score = self._scored(tracks, costs, gone, column)
            best = np.maximum(tracks.best, score)
            valid = best >= self.thresholds[0]
            known = tracks.particle
            updated = Tracks(known, state, covariance, row, score, best, valid, outside)
            fresh = self._born(started, here, names, new, column)
            after = _joined(updated, fresh)
            yield Step(frame, names, tracks.particle, costs, gone, new, column, after)
            over = self._over(after)
            tracks = _kept(after, ~over) if over.any() else after
            started += len(fresh.particle)

    @property
    def thresholds(self) -> tuple[float, float]:
        """The score from which a track is valid, and the fall by which it is lost."""
        a, b = self.false_valid, self.false_lost
        return float(np.log((1 - b) / a)), float(np.log((1 - a) / b))

    def _read(self, measured: pd.DataFrame) -> tuple[Integers, Integers, Array]:
        """Return frames, rows and places of the measurements inside, by frame and place."""
        check_columns(measured, MEASURED.names, MEASURED.name)
        table = MEASURED.check(measured[MEASURED.names]) if len(measured) else MEASURED.empty()
        places = table[["x", "y"]].to_numpy(np.float64)
        frames = table["frame"].to_numpy(np.int64)
        if len(frames) and frames.max() - frames.min() > 100 * len(frames) + 10000:
            raise InputError(
                f"{MEASURED.name}: frames run from {frames.min()} to {frames.max()} with "
                f"{len(frames)} measurements; count the frames of one recording."
            )
        inside = np.flatnonzero(self.appearance.area.holds(places))
        order = inside[np.lexsort((places[inside, 1], places[inside, 0], frames[inside]))]
        _check_once(frames[order], places[order], order)
        return frames[order], order, np.ascontiguousarray(places[order])

    def _scored(self, tracks: Tracks, costs: Array, gone: Array, column: Integers) -> Array:
        clutter = float(np.log(self.appearance.clutter_density))
        score: Array = _scores(tracks.score, costs, gone, column, clutter)
        return score

    def _born(
        self, started: int, here: Array, names: Integers, new: Array, column: Integers
    ) -> Tracks:
        """Return a track for each measurement that went to none."""
        alone = np.ones(len(here), dtype=bool)
        alone[column[column >= 0]] = False
        state, covariance = self.motion.initial(here[alone])
        score = np.log(new[alone] / self.appearance.clutter_density)
        particle = started + np.arange(len(state))
        valid = score >= self.thresholds[0]
        inside = np.zeros(len(state))
        return Tracks(particle, state, covariance, names[alone], score, score, valid, inside)

    def _over(self, tracks: Tracks) -> npt.NDArray[np.bool_]:
        missed = tracks.row < 0
        lost = tracks.best - tracks.score > self.thresholds[1]
        return missed & ((tracks.outside > 0.5) | lost)

    def _ends(self, frame: Integers, tracks: Tracks) -> pd.DataFrame:
        """Return why each track ended: out at an end or over a side, lost, or not at all."""
        order = np.lexsort((frame, tracks.particle))
        last = order[np.append(np.diff(tracks.particle[order]) != 0, True)]
        ended, area, (x, y) = _kept(tracks, last), self.appearance.area, tracks.state[last, :2].T
        sideways = ((y < 0) | (y > area.width_mm)) & (x < area.end_mm)
        # What is outside by probability may lie just inside: the nearer end decides.
        way = np.where(2.0 * x < area.start_mm + area.end_mm, BACK, LEFT)
        reason = np.where(ended.outside > 0.5, np.where(sideways, SIDEWAYS, way), LOST)
        reason = np.where(self._over(ended), reason, RUNNING)
        columns = (ended.particle, frame[last], ended.valid.astype(np.int64))
        table = pd.DataFrame(dict(zip(BELT_ENDS.names, columns, strict=True)))
        return table.assign(reason=reason)


def _check_once(frames: Integers, places: Array, rows: Integers) -> None:
    """Raise an `InputError` if a measurement is there twice; sorted by frame and place."""
    again = (np.diff(frames) == 0) & (np.diff(places, axis=0) == 0).all(axis=1)
    if again.any():
        k = int(np.argmax(again))
        raise InputError(
            f"{MEASURED.name}: frame {frames[k]} has two measurements at x {places[k, 0]:g}, "
            f"y {places[k, 1]:g} mm (rows {rows[k]} and {rows[k + 1]}); they would be two tracks "
            "of one particle. Keep one of them (pandas: drop_duplicates)."
        )


def _predicted(expected: Array, residual: Array) -> Predicted:
    unknown = np.full(len(expected), np.nan)
    return Predicted(expected, residual, unknown, unknown)


def _detected(here: Array) -> Detected:
    unknown = np.full(len(here), np.nan)
    return Detected(here, unknown, unknown)


@njit(cache=True)
def _scores(score: Any, costs: Any, gone: Any, column: Any, clutter: float) -> Any:
    result = score.copy()
    for i in range(len(score)):
        if column[i] >= 0:
            result[i] -= costs[i, column[i]] + clutter
        else:
            result[i] += np.log(gone[i])
    return result


def _nothing(motion: Motion) -> Tracks:
    state, covariance = motion.initial(np.empty((0, 2)))
    none, whole = np.empty(0), np.empty(0, dtype=np.int64)
    return Tracks(whole, state, covariance, whole, none, none, np.empty(0, dtype=bool), none)


def _joined(old: Tracks, new: Tracks) -> Tracks:
    if not len(new.particle):
        return old
    return Tracks._make(np.concatenate(both) for both in zip(old, new, strict=True))


def _kept(tracks: Tracks, keep: npt.NDArray[np.bool_]) -> Tracks:
    return Tracks._make(array[keep] for array in tracks)


def _states(frame: Integers, tracks: Tracks) -> pd.DataFrame:
    state = np.zeros((len(frame), 6))
    state[:, : tracks.state.shape[1]] = tracks.state
    valid = tracks.valid.astype(np.int64)
    columns = (frame, tracks.particle, tracks.row, valid, tracks.score, *state.T)
    return pd.DataFrame(dict(zip(BELT_STATES.names, columns, strict=True)))
