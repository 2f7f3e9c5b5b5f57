"""Tracks as arrays, and how far any two of them are apart (Eqs 5.1 and 5.2, thesis)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pandas as pd
from numba import njit

from kilnflight.checks import InputError, check_columns, check_finite

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Tracks:
    """Tracks one after the other: ``bounds[k]`` to ``bounds[k + 1]`` are the rows of track k."""

    particles: Integers  # (n,)
    bounds: Integers  # (n + 1,)
    frames: Integers  # (rows,)
    points: Array  # (rows, dimensions)

    @property
    def first(self) -> Integers:
        """First frame of each track."""
        return self.frames[self.bounds[:-1]]

    @property
    def last(self) -> Integers:
        """Last frame of each track."""
        return self.frames[self.bounds[1:] - 1]

    @property
    def lengths(self) -> Integers:
        """Frames from first to last, with those in which there is no row."""
        return self.last - self.first + 1


def read_tracks(table: pd.DataFrame, columns: Sequence[str], where: str) -> Tracks:
    """Return the tracks of a table; rows of particle -1 are in none."""
    if not columns:
        raise InputError(f"{where}: no columns to measure distances in; name at least one.")
    check_columns(table, ["frame", "particle", *columns], where)
    particle = _whole(table["particle"], f"{where}, column particle")
    if (particle < -1).any():
        raise InputError(
            f"{where}: particle {particle.min()}; tracks are numbered from 0, -1 is in no track."
        )
    kept = np.flatnonzero(particle >= 0)
    frame = _whole(table["frame"], f"{where}, column frame")[kept]
    points = check_finite(table[list(columns)].to_numpy()[kept], where)
    particle = particle[kept]
    order = np.lexsort((frame, particle))
    particle, frame, points = particle[order], frame[order], points[order] + 0.0  # no -0.0
    twice = np.flatnonzero((np.diff(particle) == 0) & (np.diff(frame) == 0))
    if len(twice):
        raise InputError(
            f"{where}: particle {particle[twice[0]]} has two rows in frame {frame[twice[0]]}. A "
            "track is at one place at a time; keep one of them."
        )
    bounds = np.append(np.flatnonzero(np.diff(particle, prepend=-1)), len(particle))
    return _ordered(Tracks(particle[bounds[:-1]], bounds, frame, points))


def _ordered(tracks: Tracks) -> Tracks:
    """Return the tracks in an order that depends on nothing but their frames and positions."""
    rows = [slice(*ends) for ends in pairwise(tracks.bounds)]
    keys = [(tracks.frames[one].tobytes(), tracks.points[one].tobytes()) for one in rows]
    order = sorted(range(len(rows)), key=keys.__getitem__)
    taken = np.concatenate([np.r_[rows[k]] for k in order] or [np.empty(0, np.intp)])
    return Tracks(
        tracks.particles[order],
        np.append(0, np.diff(tracks.bounds)[order].cumsum()).astype(np.int64),
        tracks.frames[taken],
        tracks.points[taken],
    )


def _whole(values: pd.Series, where: str) -> Integers:
    """Return whole numbers as int64, whatever type holds them, or raise an `InputError`."""
    numbers = check_finite(values, where)
    bad = np.flatnonzero((numbers != np.floor(numbers)) | (np.abs(numbers) > 2**53))
    if len(bad):
        raise InputError(f"{where}: {numbers[bad[0]]} in row {bad[0]} is no whole number.")
    return numbers.astype(np.int64)


@njit(cache=True)
def gains(
    bounds: Integers,
    frames: Integers,
    points: Array,
    seen_bounds: Integers,
    seen_frames: Integers,
    seen_points: Array,
    gate: float,
) -> tuple[Array, Integers]:
    """Return what each pair saves against the dummy, in gates, and its matches, both (n, m).

    The dummy costs the gate per true frame. A match saves gate - distance of it, a frame of the
    candidate beyond the ends of the true track costs a gate more, all else costs the same. So
    frames without a match need not be visited, nor gaps be filled.
    """
    n, m = len(bounds) - 1, len(seen_bounds) - 1
    gain, matched = np.zeros((n, m)), np.zeros((n, m), np.int64)
    for i in range(n):
        first, last = frames[bounds[i]], frames[bounds[i + 1] - 1]
        for j in range(m):
            begin, end = seen_bounds[j], seen_bounds[j + 1]
            if seen_frames[begin] > last or seen_frames[end - 1] < first:
                continue
            k = bounds[i]
            for s in range(begin, end):
                if seen_frames[s] < first or seen_frames[s] > last:
                    continue
                while frames[k] < seen_frames[s]:
                    k += 1
                distance = _distance(frames, points, k, seen_frames[s], seen_points, s)
                if distance < gate:
                    gain[i, j] += 1.0 - distance / gate
                    matched[i, j] += 1
            gain[i, j] -= max(first - seen_frames[begin], 0) + max(seen_frames[end - 1] - last, 0)
    return gain, matched


@njit(cache=True)
def _distance(
    frames: Integers, points: Array, k: int, frame: int, seen_points: Array, s: int
) -> float:
    """Return the distance of a point from a track, whose first row not before ``frame`` is k."""
    share = 0.0  # of the way back to the row before, if the track has no row in this frame
    if frames[k] > frame:
        share = (frames[k] - frame) / (frames[k] - frames[k - 1])
    squared = 0.0
    for d in range(points.shape[1]):
        place = points[k, d]
        if share > 0.0:
            place += share * (points[k - 1, d] - place)
        squared += (place - seen_points[s, d]) ** 2
    return float(np.sqrt(squared))
