"""Tracks as arrays, and how far any two of them are apart (Eqs 5.1 and 5.2, thesis)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pandas as pd
from numba import njit

from kilnflight.checks import InputError, check_columns, check_finite, check_whole

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Indices = npt.NDArray[np.intp]


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

    def beyond(self, row: Indices, other: Tracks, col: Indices) -> Integers:
        """Return in how many frames tracks ``col`` of another set lie before or after ``row``.

        The tracks of a pair must have a frame in common.
        """
        before = np.maximum(self.first[row] - other.first[col], 0)
        return before + np.maximum(other.last[col] - self.last[row], 0)


def read_tracks(table: pd.DataFrame, columns: Sequence[str], where: str) -> Tracks:
    """Return the tracks of a table; rows of particle -1 are in none."""
    check_columns(table, ["frame", "particle", *columns], where)
    particle = check_whole(table["particle"], f"{where}: column particle")
    if (particle < -1).any():
        raise InputError(
            f"{where}: particle {particle.min()}; tracks are numbered from 0, -1 is in no track."
        )
    frame = check_whole(table["frame"], f"{where}: column frame")
    order = np.lexsort((frame, particle))
    order = order[np.count_nonzero(particle < 0) :]
    particle, frame = particle[order], frame[order]
    axes = [check_finite(table[name].to_numpy()[order], f"{where}, {name}") for name in columns]
    points = np.column_stack(axes) + 0.0  # no -0.0
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
    ends = list(pairwise(tracks.bounds.tolist()))
    keys = [(tracks.frames[a:b].tobytes(), tracks.points[a:b].tobytes()) for a, b in ends]
    order = sorted(range(len(ends)), key=keys.__getitem__)
    taken = np.concatenate([np.empty(0, np.intp), *(np.arange(*ends[k]) for k in order)])
    return Tracks(
        tracks.particles[order],
        np.append(0, np.diff(tracks.bounds)[order].cumsum()).astype(np.int64),
        tracks.frames[taken],
        tracks.points[taken],
    )


def gains(true: Tracks, seen: Tracks, gate: float) -> tuple[Array, Integers]:
    """Return what each pair saves against the dummy, in gates, and its matches, both (n, m).

    The dummy costs the gate per true frame. A match saves gate - distance of it, a frame of the
    candidate beyond the ends of the true track costs a gate more, all else costs the same. So
    only positions that match need to be visited.
    """
    shown = np.unique(seen.frames)
    place = np.searchsorted(shown, seen.frames)
    at, track, points = _filled(true, shown)
    order = np.argsort(points[:, 0])
    small = at[order].astype(np.min_scalar_type(len(shown)))  # numpy sorts small integers faster
    order = order[np.argsort(small, kind="stable")]
    starts = np.searchsorted(at[order], np.arange(len(shown) + 1))
    candidate = np.repeat(np.arange(len(seen.particles)), np.diff(seen.bounds))
    saved = np.zeros((len(true.particles), len(seen.particles)))
    matched = np.zeros(saved.shape, dtype=np.int64)
    ours = (starts, track[order], points[order])
    _match(*ours, place, candidate, seen.points, float(gate), saved, matched)
    row, col = np.nonzero(matched)
    saved[row, col] -= true.beyond(row, seen, col)
    return saved, matched


def _filled(tracks: Tracks, shown: Integers) -> tuple[Integers, Integers, Array]:
    """Return the tracks in the frames ``shown`` between their ends, gaps filled by straight lines.

    Position in ``shown`` (k,), number of the track (k,) and coordinates (k, dimensions).
    """
    begin = np.searchsorted(shown, tracks.first)
    end = np.searchsorted(shown, tracks.last, side="right")
    size = end - begin
    track = np.repeat(np.arange(len(size)), size)
    at = np.arange(size.sum()) - np.repeat(size.cumsum() - size, size) + begin[track]
    points = np.empty((len(at), tracks.points.shape[1]))
    _fill(tracks.bounds, tracks.frames, tracks.points, shown[at], track, points)
    return at, track, points


@njit(cache=True)
def _fill(
    bounds: Integers, frames: Integers, points: Array, wanted: Integers, track: Integers, out: Array
) -> None:
    """Write where each track is in the wanted frames, which ascend within a track."""
    row = 0
    for s in range(len(wanted)):
        row = max(row, bounds[track[s]])
        while frames[row] < wanted[s]:
            row += 1
        for d in range(points.shape[1]):
            out[s, d] = points[row, d]
            if frames[row] > wanted[s]:
                share = (frames[row] - wanted[s]) / (frames[row] - frames[row - 1])
                out[s, d] += share * (points[row - 1, d] - points[row, d])


@njit(cache=True)
def _match(
    starts: Integers,
    track: Integers,
    points: Array,
    place: Integers,
    candidate: Integers,
    seen: Array,
    gate: float,
    saved: Array,
    matched: Integers,
) -> None:
    """Add up what the matches of each pair save; points of a frame ascend in coordinate 0."""
    for s in range(len(seen)):
        low, end = starts[place[s]], starts[place[s] + 1]
        high = end
        while low < high:  # the first point less than the gate below
            middle = (low + high) // 2
            if seen[s, 0] - points[middle, 0] < gate:
                high = middle
            else:
                low = middle + 1
        while low < end and points[low, 0] - seen[s, 0] < gate:
            squared = 0.0
            for d in range(points.shape[1]):
                squared += (points[low, d] - seen[s, d]) ** 2
            distance = np.sqrt(squared)
            if distance < gate:
                saved[track[low], candidate[s]] += 1.0 - distance / gate
                matched[track[low], candidate[s]] += 1
            low += 1
