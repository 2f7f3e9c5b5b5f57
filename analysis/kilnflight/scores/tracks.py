"""Similarity of two sets of tracks: alpha, beta, JSC, JSC_theta.

Eqs 5.1 to 5.7 of the thesis are the measures of the particle tracking challenge
(Chenouard et al., Nature Methods 11, 2014), and are counted as the challenge counts
them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from kilnflight.arrays import Array, Index, Whole
from kilnflight.checks import InputError, check_columns, check_finite, check_number
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
        gates), ``tp``, ``fp`` (positions of its partner) and ``paired``. All measures
        are sums over these rows and those of `false_tracks`.
    false_tracks
        One row per candidate without a partner: ``length`` in frames and ``positions``.
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
    columns: Sequence[str] = ("row", "col"),
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
        The coordinates, any number of them.
    bridged
        Whether a gap of a track is bridged by a straight line, as the challenge does.
        If not, the track has no position there: a frame of neither track costs nothing,
        one of a single track the gate (section 5.2.2 of the thesis, whose truth is NaN
        where nothing is seen).

    Raises
    ------
    InputError
        If a column is missing or there twice, a frame or particle is no whole number, a
        particle is below -1, a position is not finite, a track has two positions in a
        frame, the gate is not above 0, ``columns`` is empty or names one twice, or the
        truth holds no track (alpha would be 0 / 0). Without candidate tracks all four
        measures are 0.

    Notes
    -----
    A track lasts from its first to its last frame. If ``bridged``, frames between
    without a row are interpolated linearly and count for the length. Such a virtual
    position of the truth can be matched, as the particle was there. A virtual position
    of a candidate matches nothing, and is no false positive between the ends of its
    partner. Beyond these ends every frame of a candidate is false. A true track's dummy
    is an empty track, its partner if it has none (Eq. 5.3); it costs the gate in every
    frame. A pair must be better than the dummy: ties are not pairs. Of equally good
    assignments the one taken depends on the positions alone, not on the order of rows
    or the numbers of particles.

    Examples
    --------
    >>> true = pd.DataFrame({"frame": range(4), "particle": 0, "row": 0.0, "col": range(4)})
    >>> score = score_tracks(true, true.assign(row=2.5)[:3], gate=5.0)
    >>> score.alpha, score.beta, score.jsc, score.jsc_theta
    (0.375, 0.375, 0.75, 1.0)
    """
    check_number(gate, "score_tracks: gate", above=0)
    axes = (
        []
        if isinstance(columns, str) or not isinstance(columns, Iterable)
        else [*columns]
    )
    if not axes or len(set(axes)) < len(axes):
        raise InputError(
            f"score_tracks: columns {columns!r}; pass a list of names, each once."
        )
    true = _read_tracks(truth, axes, "score_tracks: truth", bridged)
    other = _read_tracks(candidate, axes, "score_tracks: candidate", bridged)
    if not true:
        raise InputError("score_tracks: truth holds no track, so alpha is 0 / 0.")
    gain, matched, false = _compare(true, other, gate)
    worth = np.where(gain > TIE, gain, 0.0)  # 0: as good as the dummy
    row, col = linear_sum_assignment(worth, maximize=True)
    better = worth[row, col] > 0
    row = row[better]
    col = col[better]
    units, spurious = _by_track(true, other, (row, col), (gain, matched, false))
    length = int(units["length"].sum())
    total = float(gain[row, col].sum())
    tp = units["tp"].sum()
    pairs = {
        "truth": np.array([track.particle for track in true], dtype=np.int64)[row],
        "candidate": np.array([track.particle for track in other], dtype=np.int64)[col],
        "distance": gate
        * np.maximum(units["length"].to_numpy()[row] - gain[row, col], 0.0),
    }
    return TrackScore(
        alpha=total / length,
        beta=total / (length + int(spurious["length"].sum())),
        tp=int(tp),
        fn=length - int(tp),
        fp=int(units["fp"].sum() + spurious["positions"].sum()),
        tp_tracks=len(row),
        fn_tracks=len(true) - len(row),
        fp_tracks=len(spurious),
        pairs=pd.DataFrame(pairs).sort_values("truth", ignore_index=True),
        true_tracks=units,
        false_tracks=spurious,
    )


def _by_track(
    true: Sequence[Track],
    other: Sequence[Track],
    pairs: tuple[Index, Index],
    compared: tuple[Array, Whole, Whole],
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the tables ``true_tracks`` and ``false_tracks`` of `TrackScore`.

    ``pairs`` are the indices (k,) in ``true`` and in ``other`` of each pair.
    ``compared`` are the three arrays (n true, m other) of `_compare`.
    """
    gain, matched, false = (values[pairs] for values in compared)
    units = pd.DataFrame(
        {"length": [t.length for t in true], "gain": 0.0, "tp": 0, "fp": 0}
    )
    units["paired"] = False
    units.loc[pairs[0], "gain"] = gain
    units.loc[pairs[0], "tp"] = matched
    units.loc[pairs[0], "fp"] = false
    units.loc[pairs[0], "paired"] = True
    alone = [other[k] for k in np.setdiff1d(np.arange(len(other)), pairs[1])]
    sizes = [(track.length, len(track.frames)) for track in alone]
    return units, pd.DataFrame(sizes, columns=["length", "positions"], dtype=np.int64)


class Track(NamedTuple):
    """The n positions of one particle by ascending frame."""

    particle: int
    frames: Whole  # (n,)
    points: Array  # (n, d) coordinates, in the unit of the gate
    bridged: bool  # whether it has a position in its gaps

    @property
    def length(self) -> int:
        """Return the number of frames in which it has a position."""
        return (
            int(self.frames[-1] - self.frames[0]) + 1
            if self.bridged
            else len(self.frames)
        )


def _read_tracks(
    table: pd.DataFrame, columns: Sequence[str], where: str, bridged: bool
) -> list[Track]:
    """Return the tracks of a table, ordered by frames and positions.

    The order does not depend on the rows or on the numbers of particles, and decides
    between equally good assignments. ``columns`` name the coordinates, ``where`` the
    table in errors.
    """
    table = with_pixels(table) if {"row", "col"} <= set(columns) else plain(table)
    check_columns(table, columns, where)
    order, particle, frame = order_tracks(table, where)
    axes = [
        check_finite(table[name].to_numpy()[order], f"{where}, {name}")
        for name in columns
    ]
    points = np.column_stack(axes) + 0.0  # no -0.0
    names, starts = np.unique(particle, return_index=True)
    frames = np.split(frame, starts[1:])
    places = np.split(points, starts[1:])
    tracks = map(Track, names.tolist(), frames, places, repeat(bridged))
    return sorted(
        tracks, key=lambda track: (track.frames.tobytes(), track.points.tobytes())
    )


def _compare(
    true: Sequence[Track], other: Sequence[Track], gate: float
) -> tuple[Array, Whole, Whole]:
    """Return gains, matches and false positions of all pairs, (n true, m other) each.

    A gain, in gates, is the cost of the dummy minus that of a pair (Eqs 5.1 and 5.2).
    The dummy, an empty track, costs the gate per true frame. A match gains gate -
    distance. A frame of the candidate beyond the ends of the true track costs one gate;
    other frames cost as much as the dummy's. If gaps are not bridged, each of its
    positions where the true track has none costs one. Matches and false positions are
    numbers of frames. Pairs without a match have a gain of 0.
    """
    shape = len(true), len(other)
    saved = np.zeros(shape)
    matched = np.zeros(shape, np.int64)
    false = np.zeros(shape, np.int64)
    if not other:
        return saved, matched, false
    frames = np.concatenate([track.frames for track in other])
    order = np.argsort(frames, kind="stable")
    frames = frames[order]
    points = np.concatenate([track.points for track in other])[order]
    sizes = np.array([len(track.frames) for track in other])
    number = np.repeat(np.arange(shape[1]), sizes)[order]
    first, last = (np.array([track.frames[end] for track in other]) for end in (0, -1))
    for k, (_, at, places, bridged) in enumerate(true):
        rows = slice(*np.searchsorted(frames, [at[0], at[-1] + 1]))
        line = [
            np.interp(frames[rows], at, axis) for axis in places.T
        ]  # gaps are straight
        distance = np.linalg.norm(points[rows] - np.column_stack(line), axis=1)
        seen = bridged | np.isin(frames[rows], at)
        tracks = number[rows]
        near = (distance < gate) & seen
        matched[k] = np.bincount(tracks[near], minlength=shape[1])
        within = np.bincount(tracks[seen], minlength=shape[1])
        beyond = sizes - within
        if bridged:
            beyond = np.maximum(at[0] - first, 0) + np.maximum(last - at[-1], 0)
        false[k] = within - matched[k] + beyond
        gain = np.bincount(
            tracks[near], 1.0 - distance[near] / gate, minlength=shape[1]
        )
        saved[k] = gain - np.where(matched[k] > 0, beyond, 0)
    return saved, matched, false
