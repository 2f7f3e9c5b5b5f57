"""Similarity of two sets of tracks: alpha, beta, JSC, JSC_theta.

Eqs 5.1 to 5.7 of the thesis are the measures of the particle tracking challenge
(Chenouard et al., Nature Methods 11, 2014), and are counted as the challenge counts
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from kilnflight.arrays import Array, Index, Numbers, Texts, Whole
from kilnflight.checks import (
    InputError,
    check_columns,
    check_finite,
    check_flags,
    check_number,
)
from kilnflight.scores.identities import identities
from kilnflight.tables import order_tracks, plain, with_pixels

TIE = 1e-9  # gates; smaller gains over the dummy are rounding: a tie, which is no pair


@dataclass(frozen=True, eq=False)
class TrackScore:
    """Measures of candidate tracks against true ones.

    Parameters
    ----------
    alpha
        Eq. 5.4: 1 if every true track is matched; ignores spurious tracks.
    beta
        Eq. 5.5: alpha, lowered by spurious tracks; never above alpha.
    tp, fn, fp
        Positions that match, that were missed, that are false (Eq. 5.6, as the
        challenge counts).
    tp_tracks, fn_tracks, fp_tracks
        True tracks with a partner, without one, and candidate tracks without one (Eq.
        5.7).
    pairs
        One row per pair, by true particle: ``truth``, ``candidate`` (particles) and
        ``distance`` (Eq. 5.2, summed over frames, in the unit of the gate).
    true_tracks
        One row per true track: ``length`` in frames, ``gain`` (by its partner, in
        gates), ``tp``, ``fp`` (positions of its partner), ``paired``, and the particles
        ``truth`` and ``candidate``. All measures are sums over these rows and those of
        `false_tracks`.
    false_tracks
        One row per candidate without a partner: ``length`` in frames and ``positions``.
    hota
        Higher order tracking accuracy (Luiten et al., Int. J. Comput. Vis. 129, 2021).
        Positions are alike by 1 - distance / gate; it is the mean over the thresholds
        0.05 to 0.95.
    mota
        Multiple object tracking accuracy (Bernardin and Stiefelhagen 2008): 1 - (missed
        + false + switches) / true positions; below 0 where most is wrong. Neither
        bridges gaps.

    Examples
    --------
    >>> true = pd.DataFrame({"frame": range(4), "particle": 0, "row": 0.0, "col": 1.0})
    >>> false = true.assign(particle=1, row=50.0)
    >>> score = score_tracks(true, pd.concat([true, false]), gate=5.0)
    >>> score.tp, score.fp, score.jsc
    (4, 4, 0.5)
    """

    alpha: float
    beta: float
    tp: int
    fn: int
    fp: int
    tp_tracks: int
    fn_tracks: int
    fp_tracks: int
    pairs: pd.DataFrame
    true_tracks: pd.DataFrame
    false_tracks: pd.DataFrame
    hota: float = 0.0
    mota: float = 0.0

    @property
    def jsc(self) -> float:
        """Return the Jaccard index of positions (Eq. 5.6), as the challenge counts."""
        return self.tp / (self.tp + self.fn + self.fp)

    @property
    def jsc_theta(self) -> float:
        """Return the Jaccard index of tracks (Eq. 5.7)."""
        return self.tp_tracks / (self.tp_tracks + self.fn_tracks + self.fp_tracks)


def score_tracks(
    truth: pd.DataFrame,
    candidate: pd.DataFrame,
    gate: float,
    columns: Texts = ("row", "col"),
    bridged: bool = True,
) -> TrackScore:
    """Pair candidate tracks with true ones at the least total distance, and count.

    Parameters
    ----------
    truth, candidate
        Tables with ``frame``, ``particle`` and ``columns``; one row is one position.
        Rows of particle -1 are in no track. Positions in px may be ``y``, ``x`` instead
        of ``row``, ``col``.
    gate
        Distance from which on two positions do not match (Eq. 5.1), in units of
        ``columns``. A distance of exactly the gate is no match.
    columns
        Names of the coordinates, any number of them.
    bridged
        Whether a gap of a track is bridged by a straight line, as the challenge does.
        If not, the track has no position there: a frame without either track costs
        nothing, a frame with one alone costs the gate (section 5.2.2 of the thesis,
        whose truth is NaN where nothing is seen).

    Returns
    -------
    TrackScore
        Measures, counts and a table of the pairs. Without candidate tracks all four
        measures are 0.

    Raises
    ------
    InputError
        If a column is missing or there twice, a frame or particle is no whole number, a
        particle is below -1, a position is not finite, a track has two positions in a
        frame, the gate is not above 0, ``columns`` is empty or names one twice, or the
        truth holds no track (alpha would be 0 / 0).

    Notes
    -----
    A track lasts from its first to its last frame. If ``bridged``, frames between
    without a row are interpolated linearly and count for the length. Such a virtual
    position of the truth can be matched, as the particle was there. A virtual position
    of a candidate matches nothing, and is no false positive between the ends of its
    partner. Beyond these ends every frame of a candidate is false.

    A true track without a partner is paired with a dummy, an empty track, which costs
    the gate in every frame (Eq. 5.3). A pair must be better than the dummy: ties are
    not pairs.

    Of equally good assignments the one taken depends on the positions alone, not on the
    order of rows or the numbers of particles.

    Examples
    --------
    >>> true = pd.DataFrame({"frame": range(4), "col": range(4)})
    >>> true = true.assign(particle=0, row=0.0)
    >>> score = score_tracks(true, true.assign(row=2.5)[:3], gate=5.0)
    >>> score.alpha, score.beta, score.jsc, score.jsc_theta
    (0.375, 0.375, 0.75, 1.0)
    """
    check_number(gate, "score_tracks: gate", above=0)
    if isinstance(columns, str) or not 0 < len(set(columns)) == len(columns):
        raise InputError(
            f"score_tracks: columns {columns!r}; pass a list of names, each once."
        )
    check_flags("score_tracks: bridged", bridged)
    true = _read_tracks(truth, columns, "score_tracks: truth", bridged)
    other = _read_tracks(candidate, columns, "score_tracks: candidate", bridged)
    if not true:
        raise InputError("score_tracks: truth holds no track, so alpha is 0 / 0.")
    compared = _compare(true, other, gate)
    i, j = _assigned(compared.gain)  # the paired true and candidate tracks
    by_true = _true_tracks(true, other, i, j, compared)
    unpaired = np.setdiff1d(np.arange(len(other)), j)
    sizes = [(other[k].length, len(other[k].frames)) for k in unpaired]
    spurious = pd.DataFrame(sizes, columns=["length", "positions"], dtype=np.int64)
    length, tp, fp = by_true[["length", "tp", "fp"]].sum().tolist()
    frames, positions = spurious.sum().tolist()
    gain = float(compared.gain[i, j].sum())
    # The gain of a pair is what it costs less than the dummy (Eq. 5.2).
    cost = gate * (by_true["length"] - by_true["gain"])
    pairs = by_true.assign(distance=cost.clip(0))  # against rounding
    pairs = pairs.loc[pairs["paired"], ["truth", "candidate", "distance"]]
    return TrackScore(
        alpha=gain / length,
        beta=gain / (length + frames),
        tp=tp,
        fn=length - tp,
        fp=fp + positions,
        tp_tracks=len(i),
        fn_tracks=len(true) - len(i),
        fp_tracks=len(spurious),
        pairs=pairs.sort_values("truth", ignore_index=True),
        true_tracks=by_true,
        false_tracks=spurious,
        **_identities(true, other, gate),
    )


def _identities(true: Sequence[Track], other: Sequence[Track], gate: float) -> Numbers:
    """Return HOTA and MOTA by name; both are 0 without candidates."""
    if not other:
        return {}
    return identities(_by_frame(true), _by_frame(other), gate)


def _assigned(gain: Array) -> tuple[Index, Index]:
    """Return true tracks i, others j (k,) of the pairs of largest total gain (n, m)."""
    worth = np.where(gain > TIE, gain, 0.0)  # 0: as good as the dummy
    i, j = linear_sum_assignment(worth, maximize=True)
    better = worth[i, j] > 0
    return i[better], j[better]


def _true_tracks(
    true: Sequence[Track],
    other: Sequence[Track],
    i: Index,
    j: Index,
    compared: Compared,
) -> pd.DataFrame:
    """Return the table ``true_tracks`` of `TrackScore` for pairs i, j (k,)."""
    partners = {
        "candidate": np.array([track.particle for track in other], np.int64)[j],
        "gain": compared.gain[i, j],
        "tp": compared.matched[i, j],
        "fp": compared.false[i, j],
    }
    table = pd.DataFrame(partners, index=i).reindex(range(len(true)), fill_value=0)
    table.insert(0, "length", [track.length for track in true])
    truth = [track.particle for track in true]
    return table.assign(paired=table.index.isin(i), truth=truth)


class Track(NamedTuple):
    """The n positions of one particle by ascending frame."""

    particle: int
    frames: Whole  # (n,)
    points: Array  # (n, d) coordinates, in the unit of the gate
    bridged: bool  # whether it has a position in its gaps

    @property
    def length(self) -> int:
        """Return the number of frames in which it has a position."""
        if not self.bridged:
            return len(self.frames)
        return int(self.frames[-1] - self.frames[0]) + 1

    def distance(self, frames: Whole, points: Array) -> Array:
        """Return the distance of points (k, d) in frames (k,); gaps are straight."""
        line = [np.interp(frames, self.frames, axis) for axis in self.points.T]
        return np.linalg.norm(points - np.column_stack(line), axis=1)


def _read_tracks(
    table: pd.DataFrame, columns: Texts, where: str, bridged: bool
) -> list[Track]:
    """Return the tracks of a table, ordered by frames and positions.

    The order does not depend on the rows or on the numbers of particles, and decides
    between equally good assignments. ``columns`` name the coordinates, ``where`` the
    table in errors.
    """
    table = with_pixels(table) if {"row", "col"} <= set(columns) else plain(table)
    check_columns(table, columns, where)
    order, particle, frame = order_tracks(table, where)
    table = table.iloc[order]
    axes = [check_finite(table[name], f"{where}, {name}") for name in columns]
    points = np.column_stack(axes) + 0.0  # no -0.0
    names, starts = np.unique(particle, return_index=True)
    frames = np.split(frame, starts[1:])
    places = np.split(points, starts[1:])
    parts = zip(names.tolist(), frames, places, strict=False)
    tracks = [Track(*part, bridged) for part in parts]
    return sorted(
        tracks, key=lambda track: (track.frames.tobytes(), track.points.tobytes())
    )


class Compared(NamedTuple):
    """Comparison of every true track with every candidate, (n true, m other) each."""

    gain: Array  # cost of the dummy minus that of the pair, in gates (Eqs 5.1 and 5.2)
    matched: Whole  # frames in which positions match
    false: Whole  # positions of the candidate that are false


def _by_frame(tracks: Sequence[Track]) -> tuple[Whole, Array, Index]:
    """Return frames (k,), points (k, d) and tracks (k,) of all positions, by frame."""
    frames = np.concatenate([track.frames for track in tracks])
    points = np.concatenate([track.points for track in tracks])
    names = np.repeat(np.arange(len(tracks)), [len(track.frames) for track in tracks])
    order = np.argsort(frames, kind="stable")
    return frames[order], points[order], names[order]


def _compare(true: Sequence[Track], other: Sequence[Track], gate: float) -> Compared:
    """Return gains, matches and false positions of all pairs.

    The dummy, an empty track, costs the gate per true frame. A match gains gate -
    distance. A frame of the candidate beyond the ends of the true track costs one gate;
    other frames cost as much as the dummy's. If gaps are not bridged, each of its
    positions where the true track has none costs one. Pairs without a match have a gain
    of 0.
    """
    m = len(other)
    shape = (len(true), m)
    gain = np.zeros(shape)
    matched = np.zeros(shape, np.int64)
    false = np.zeros(shape, np.int64)
    if not other:
        return Compared(gain, matched, false)
    frames, points, candidate = _by_frame(other)
    sizes = np.bincount(candidate)
    first = np.array([track.frames[0] for track in other])
    last = np.array([track.frames[-1] for track in other])
    for k, track in enumerate(true):
        begin, end = track.frames[[0, -1]]
        rows = slice(*np.searchsorted(frames, [begin, end + 1]))
        seen = track.bridged | np.isin(frames[rows], track.frames)
        distance = track.distance(frames[rows], points[rows])
        near = (distance < gate) & seen
        tracks = candidate[rows]
        matched[k] = np.bincount(tracks[near], minlength=m)
        within = np.bincount(tracks[seen], minlength=m)
        beyond = sizes - within
        if track.bridged:
            beyond = np.maximum(begin - first, 0) + np.maximum(last - end, 0)
        false[k] = within - matched[k] + beyond
        gain[k] = np.bincount(tracks[near], 1.0 - distance[near] / gate, m)
        gain[k] -= np.where(matched[k] > 0, beyond, 0)
    return Compared(gain, matched, false)
