"""How alike two sets of tracks are: alpha, beta, JSC, JSC_theta (Eqs 5.1 to 5.7, thesis).

The measures of the particle tracking challenge (Chenouard et al., Nature Methods 11, 2014),
counted as the challenge counts them. This module needs nothing of the package but `checks`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from kilnflight.checks import (
    InputError,
    check_columns,
    check_finite,
    check_positive,
    check_whole,
)

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Indices = npt.NDArray[np.intp]
# Frames. A pair that is better than the dummy by rounding only is a tie, and ties go to the dummy.
TIE = 1e-9


@dataclass(frozen=True, eq=False)
class TrackScore:
    """Candidate tracks held against true ones.

    Parameters
    ----------
    alpha
        Eq. 5.4: 1 if every true track has its like, 0 if none has; blind to spurious tracks.
    beta
        Eq. 5.5: alpha, lowered by spurious tracks; never above alpha.
    tp, fn, fp
        Positions that match, that were missed, that are false (Eq. 5.6, as the challenge counts).
    fp_spurious_only
        False positions in the narrower wording of the thesis: those of spurious tracks alone.
    tp_tracks, fn_tracks, fp_tracks
        True tracks with a partner, without one, and candidate tracks without one (Eq. 5.7).
    pairs
        One row per pair, by true particle: ``truth``, ``candidate`` (particles) and
        ``distance`` (Eq. 5.2, in units of the gate's).
    """

    alpha: float
    beta: float
    tp: int
    fn: int
    fp: int
    fp_spurious_only: int
    tp_tracks: int
    fn_tracks: int
    fp_tracks: int
    pairs: pd.DataFrame

    @property
    def jsc(self) -> float:
        """Eq. 5.6, Jaccard index of positions, as the challenge counts."""
        return self.tp / (self.tp + self.fn + self.fp)

    @property
    def jsc_spurious_only(self) -> float:
        """Eq. 5.6 with the thesis's narrower false positives; never below `jsc`."""
        return self.tp / (self.tp + self.fn + self.fp_spurious_only)

    @property
    def jsc_theta(self) -> float:
        """Eq. 5.7, Jaccard index of tracks."""
        return self.tp_tracks / (self.tp_tracks + self.fn_tracks + self.fp_tracks)


def score_tracks(
    truth: pd.DataFrame,
    candidate: pd.DataFrame,
    gate: float,
    columns: Sequence[str] = ("row", "col"),
) -> TrackScore:
    """Pair candidate tracks with true ones at the least distance and measure what is left.

    Parameters
    ----------
    truth, candidate
        Tables with ``frame``, ``particle`` and ``columns``; one row is one position. Rows of
        particle -1 are in no track and left out, in both tables.
    gate
        Distance from which on two positions do not match (Eq. 5.1), in units of ``columns``.
        A distance of exactly the gate is no match.
    columns
        The coordinates, any number of them.

    Raises
    ------
    InputError
        If a column is missing or there twice, a frame or particle is no whole number, a
        particle is below -1, a position is not finite, a track has two positions in a frame,
        the gate is not above 0, ``columns`` is no list of names or names one twice, or the
        truth holds no track (alpha would be 0 / 0). No candidate tracks is a normal case:
        all four measures are 0.

    Notes
    -----
    A track lasts from its first to its last frame. In frames between in which it has no row it
    is interpolated linearly; such a virtual position counts for the track's length. A virtual
    position of the truth can be matched, as the particle was there; a virtual position of a
    candidate matches nothing and is no false positive between the ends of its partner, for
    nothing was claimed. Beyond the ends of its partner every frame of a candidate is false.
    A pair must be better than the true track's dummy, or there is none: ties are not pairs.
    Where several assignments are equally good, which one is taken depends on the positions
    alone, not on the order of rows or the numbers of the particles.

    Examples
    --------
    >>> true = pd.DataFrame({"frame": range(4), "particle": 0, "row": 0.0, "col": range(4)})
    >>> score = score_tracks(true, true.assign(row=2.5)[:3], gate=5.0)
    >>> score.alpha, score.beta, score.jsc, score.jsc_theta
    (0.375, 0.375, 0.75, 1.0)
    """
    check_positive(gate, "score_tracks: gate")
    axes = _axes(columns)
    true = read_tracks(truth, axes, "score_tracks: truth")
    other = read_tracks(candidate, axes, "score_tracks: candidate")
    if not len(true.particles):
        raise InputError(
            "score_tracks: truth holds no track, so alpha is 0 / 0. Score only sequences in "
            "which a particle was followed."
        )
    gain, matched = gains(true, other, gate)
    worth = np.where(gain > TIE, gain, 0.0)  # 0: as good as the dummy, which is taken then
    row, col = linear_sum_assignment(worth, maximize=True)
    better = worth[row, col] > 0
    row, col = row[better], col[better]
    return _score(true, other, (row, col), gain[row, col], matched[row, col], gate)


def _axes(columns: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the coordinates, each once."""
    if isinstance(columns, str) or not isinstance(columns, Iterable):
        raise InputError(f"score_tracks: columns {columns!r}; pass a list of names.")
    axes = tuple(columns)
    if not axes:
        raise InputError("score_tracks: no columns to measure distances in; name at least one.")
    if len(set(axes)) < len(axes):
        raise InputError(f"score_tracks: columns {axes} name one twice; it would count double.")
    return axes


def _score(
    true: Tracks,
    other: Tracks,
    pair: tuple[Indices, Indices],
    gain: Array,
    matched: Integers,
    gate: float,
) -> TrackScore:
    """Count; ``gain`` is (dummy's distance - pair's distance) / gate, one per pair."""
    row, col = pair
    spurious = np.setdiff1d(np.arange(len(other.particles)), col)
    length = int(true.lengths.sum())
    tp = int(matched.sum())
    sizes = np.diff(other.bounds)
    begin, end = np.full(len(sizes), 0), np.full(len(sizes), -1)  # of the partner; none: empty
    begin[col], end[col] = true.first[row], true.last[row]
    after, before = np.repeat(begin, sizes) <= other.frames, other.frames <= np.repeat(end, sizes)
    inside = int((after & before).sum())
    of_spurious = int(sizes[spurious].sum())
    by_truth = np.argsort(true.particles[row])
    distance = gate * np.maximum(true.lengths[row] - gain, 0.0)
    names = {"truth": true.particles[row], "candidate": other.particles[col], "distance": distance}
    total = float(gain.sum())
    return TrackScore(
        alpha=total / length,
        beta=total / (length + int(other.lengths[spurious].sum())),
        tp=tp,
        fn=length - tp,
        fp=inside - tp + int(true.beyond(row, other, col).sum()) + of_spurious,
        fp_spurious_only=of_spurious,
        tp_tracks=len(row),
        fn_tracks=len(true.particles) - len(row),
        fp_tracks=len(spurious),
        pairs=pd.DataFrame({name: values[by_truth] for name, values in names.items()}),
    )


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


def gains(true: Tracks, candidate: Tracks, gate: float) -> tuple[Array, Integers]:
    """Return what each pair saves against the dummy, in gates, and its matches, both (n, m).

    The dummy costs the gate per true frame. A match saves gate - distance of it, a frame of the
    candidate beyond the ends of the true track costs a gate more, all else costs the same. So
    only positions that match need to be visited.
    """
    shape = len(true.particles), len(candidate.particles)
    if not shape[1]:
        return np.zeros(shape), np.zeros(shape, dtype=np.int64)
    frames = np.unique(candidate.frames)
    place, track, points = _filled(true, frames)
    # Frames as one coordinate more, farther apart than the gate.
    trees = [
        KDTree(np.column_stack([2 * gate * frame, points]))
        for frame, points in (
            (place, points),
            (np.searchsorted(frames, candidate.frames), candidate.points),
        )
    ]
    near = trees[0].sparse_distance_matrix(trees[1], gate, output_type="ndarray")
    near = near[near["v"] < gate]
    other = np.repeat(np.arange(shape[1]), np.diff(candidate.bounds))
    pair = track[near["i"]] * shape[1] + other[near["j"]]
    size = shape[0] * shape[1]
    saved: Array = np.bincount(pair, 1.0 - near["v"] / gate, minlength=size).astype(np.float64)
    saved = saved.reshape(shape)
    matched: Integers = np.bincount(pair, minlength=size).astype(np.int64).reshape(shape)
    row, col = np.nonzero(matched)
    saved[row, col] -= true.beyond(row, candidate, col)
    return saved, matched


def _filled(tracks: Tracks, frames: Integers) -> tuple[Integers, Integers, Array]:
    """Return the tracks in these frames between their ends, gaps filled by straight lines.

    Position in ``frames`` (k,), number of the track (k,) and coordinates (k, dimensions).
    """
    begin = np.searchsorted(frames, tracks.first)
    end = np.searchsorted(frames, tracks.last, side="right")
    place, points = [np.empty(0, np.int64)], [np.empty((0, tracks.points.shape[1]))]
    for k, (a, b) in enumerate(pairwise(tracks.bounds.tolist())):
        at = np.arange(begin[k], end[k])
        line = [np.interp(frames[at], tracks.frames[a:b], axis) for axis in tracks.points[a:b].T]
        place.append(at)
        points.append(np.column_stack(line))
    track = np.repeat(np.arange(len(begin)), end - begin)
    return np.concatenate(place), track, np.concatenate(points)
