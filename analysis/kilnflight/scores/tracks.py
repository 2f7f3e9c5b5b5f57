"""Similarity of two sets of tracks: alpha, beta, JSC, JSC_theta.

Eqs 5.1 to 5.7 of the thesis are the measures of the particle tracking challenge (Chenouard et al.,
Nature Methods 11, 2014). They are counted as the challenge counts them. This module needs nothing
of the package but `checks`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import linear_sum_assignment

from kilnflight.checks import InputError, check_columns, check_finite, check_positive, order_tracks

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
# Frames. A pair that is better than the dummy by rounding only is a tie, and ties go to the dummy.
TIE = 1e-9


@dataclass(frozen=True, eq=False)
class TrackScore:
    """Measures of candidate tracks against true ones.

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
    true_tracks
        One row per true track: ``length`` in frames, ``gain`` (what its partner saves, in gates),
        ``tp``, ``fp`` (positions of its partner) and ``paired``. All measures are sums over them
        and `false_tracks`.
    false_tracks
        One row per candidate without a partner: ``length`` in frames and ``positions``.
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
    true_tracks: pd.DataFrame
    false_tracks: pd.DataFrame

    @property
    def jsc(self) -> float:
        """Return the Jaccard index of positions (Eq. 5.6).

        False positives are counted as the challenge counts them.
        """
        return self.tp / (self.tp + self.fn + self.fp)

    @property
    def jsc_spurious_only(self) -> float:
        """Return Eq. 5.6 with false positives of spurious tracks alone.

        It is never below `jsc`.
        """
        return self.tp / (self.tp + self.fn + self.fp_spurious_only)

    @property
    def jsc_theta(self) -> float:
        """Return the Jaccard index of tracks (Eq. 5.7)."""
        return self.tp_tracks / (self.tp_tracks + self.fn_tracks + self.fp_tracks)


def score_tracks(
    truth: pd.DataFrame,
    candidate: pd.DataFrame,
    gate: float,
    columns: Sequence[str] = ("row", "col"),
) -> TrackScore:
    """Pair candidate tracks with true ones and measure the difference.

    Pairs have the least total distance.

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
    A track lasts from its first to its last frame. In frames between in which it has no row it is
    interpolated linearly; such a virtual position counts for the track's length. A virtual
    position of the truth can be matched, as the particle was there. A virtual position of a
    candidate matches nothing and is no false positive between the ends of its partner. Beyond the
    ends of its partner every frame of a candidate is false. A pair must be better than the true
    track's dummy, or there is none: ties are not pairs. Where several assignments are equally
    good, which one is taken depends on the positions alone, not on the order of rows or the
    numbers of the particles.

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
    if not true:
        raise InputError(
            "score_tracks: truth holds no track, so alpha is 0 / 0. Score only sequences in "
            "which a particle was followed."
        )
    gain, matched, false = compare_pairs(true, other, gate)
    worth = np.where(gain > TIE, gain, 0.0)  # 0: as good as the dummy, which is taken then
    row, col = linear_sum_assignment(worth, maximize=True)
    better = worth[row, col] > 0
    row, col = row[better], col[better]
    lengths = np.array([track.length for track in true])
    units = _true_tracks(lengths, (row, col), gain, matched, false)
    taken = set(col.tolist())
    spurious = _false_tracks([track for k, track in enumerate(other) if k not in taken])
    of_spurious = int(spurious["positions"].sum())
    length, total, tp = int(lengths.sum()), float(gain[row, col].sum()), int(units["tp"].sum())
    pairs = {
        "truth": np.array([track.particle for track in true], dtype=np.int64)[row],
        "candidate": np.array([track.particle for track in other], dtype=np.int64)[col],
        "distance": gate * np.maximum(lengths[row] - gain[row, col], 0.0),
    }
    return TrackScore(
        alpha=total / length,
        beta=total / (length + int(spurious["length"].sum())),
        tp=tp,
        fn=length - tp,
        fp=int(units["fp"].sum()) + of_spurious,
        fp_spurious_only=of_spurious,
        tp_tracks=len(row),
        fn_tracks=len(true) - len(row),
        fp_tracks=len(spurious),
        pairs=pd.DataFrame(pairs).sort_values("truth", ignore_index=True),
        true_tracks=units,
        false_tracks=spurious,
    )


def _true_tracks(
    lengths: Integers,
    pairs: tuple[Integers, Integers],
    gain: Array,
    matched: Integers,
    false: Integers,
) -> pd.DataFrame:
    """Return what each true track adds to the sums of the measures."""
    table = pd.DataFrame({"length": lengths, "gain": 0.0, "tp": 0, "fp": 0, "paired": False})
    row = pairs[0]
    table.loc[row, "gain"] = gain[pairs]
    table.loc[row, "tp"], table.loc[row, "fp"] = matched[pairs], false[pairs]
    table.loc[row, "paired"] = True
    return table


def _false_tracks(tracks: Sequence[Track]) -> pd.DataFrame:
    """Return what each track without a partner adds to the sums of the measures."""
    sizes = [(track.length, len(track.frames)) for track in tracks]
    return pd.DataFrame(sizes, columns=["length", "positions"], dtype=np.int64)


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


class Track(NamedTuple):
    """The positions of one particle by ascending frame."""

    particle: int
    frames: Integers  # (n,)
    points: Array  # (n, dimensions)

    @property
    def length(self) -> int:
        """Return the number of frames from first to last.

        Frames without a row count.
        """
        return int(self.frames[-1] - self.frames[0]) + 1


def read_tracks(table: pd.DataFrame, columns: Sequence[str], where: str) -> list[Track]:
    """Return the tracks of a table, ordered by frames and positions.

    Rows of particle -1 are in no track.
    """
    check_columns(table, ["frame", "particle", *columns], where)
    order, particle, frame = order_tracks(table, where)
    axes = [check_finite(table[name].to_numpy()[order], f"{where}, {name}") for name in columns]
    points = np.column_stack(axes) + 0.0  # no -0.0
    names, starts = np.unique(particle, return_index=True)
    frames, places = np.split(frame, starts[1:]), np.split(points, starts[1:])
    tracks = map(Track, names.tolist(), frames, places)
    return sorted(tracks, key=lambda track: (track.frames.tobytes(), track.points.tobytes()))


def compare_pairs(
    true: Sequence[Track], other: Sequence[Track], gate: float
) -> tuple[Array, Integers, Integers]:
    """Return gains, matches and false positions of all pairs.

    Three arrays (n true, m other). A gain, in gates, is what a pair costs less than the dummy,
    which costs the gate per true frame. A match gains gate - distance. A frame of the candidate
    beyond the ends of the true track costs a gate more; all else costs the same.
    """
    shape = len(true), len(other)
    saved, matched, false = np.zeros(shape), np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    if not other:
        return saved, matched, false
    frames = np.concatenate([track.frames for track in other])
    order = np.argsort(frames, kind="stable")
    frames, points = frames[order], np.concatenate([track.points for track in other])[order]
    number = np.repeat(np.arange(shape[1]), [len(track.frames) for track in other])[order]
    first, last = (np.array([track.frames[end] for track in other]) for end in (0, -1))
    for k, (_, at, places) in enumerate(true):
        rows = slice(*np.searchsorted(frames, [at[0], at[-1] + 1]))
        line = [np.interp(frames[rows], at, axis) for axis in places.T]  # gaps are straight
        distance = np.linalg.norm(points[rows] - np.column_stack(line), axis=1)
        near, tracks = distance < gate, number[rows]
        matched[k] = np.bincount(tracks[near], minlength=shape[1])
        beyond = np.maximum(at[0] - first, 0) + np.maximum(last - at[-1], 0)
        false[k] = np.bincount(tracks, minlength=shape[1]) - matched[k] + beyond
        gain = np.bincount(tracks[near], 1.0 - distance[near] / gate, minlength=shape[1])
        saved[k] = gain - np.where(matched[k] > 0, beyond, 0)
    return saved, matched, false
