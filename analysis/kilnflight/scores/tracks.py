"""How alike two sets of tracks are: alpha, beta, JSC, JSC_theta (Eqs 5.1 to 5.7, thesis).

The measures of the particle tracking challenge (Chenouard et al., Nature Methods 11, 2014),
counted as the challenge counts them. This module and `spans` need nothing of the package but
`checks`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import linear_sum_assignment

from kilnflight.checks import InputError, check_positive
from kilnflight.scores.spans import Tracks, gains, read_tracks

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
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
    seen = read_tracks(candidate, axes, "score_tracks: candidate")
    if not len(true.particles):
        raise InputError(
            "score_tracks: truth holds no track, so alpha is 0 / 0. Score only sequences in "
            "which a particle was followed."
        )
    gain, matched = gains(true, seen, gate)
    worth = np.where(gain > TIE, gain, 0.0)  # 0: as good as the dummy, which is taken then
    row, col = linear_sum_assignment(worth, maximize=True)
    better = worth[row, col] > 0
    row, col = row[better], col[better]
    return _score(true, seen, (row, col), gain[row, col], matched[row, col], gate)


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
    seen: Tracks,
    pair: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]],
    gain: Array,
    matched: Integers,
    gate: float,
) -> TrackScore:
    """Count; ``gain`` is (dummy's distance - pair's distance) / gate, one per pair."""
    row, col = pair
    spurious = np.setdiff1d(np.arange(len(seen.particles)), col)
    length = int(true.lengths.sum())
    tp = int(matched.sum())
    sizes = np.diff(seen.bounds)
    begin, end = np.full(len(sizes), 0), np.full(len(sizes), -1)  # of the partner; none: empty
    begin[col], end[col] = true.first[row], true.last[row]
    after, before = np.repeat(begin, sizes) <= seen.frames, seen.frames <= np.repeat(end, sizes)
    inside = int((after & before).sum())
    of_spurious = int(sizes[spurious].sum())
    by_truth = np.argsort(true.particles[row])
    distance = gate * np.maximum(true.lengths[row] - gain, 0.0)
    names = {"truth": true.particles[row], "candidate": seen.particles[col], "distance": distance}
    total = float(gain.sum())
    return TrackScore(
        alpha=total / length,
        beta=total / (length + int(seen.lengths[spurious].sum())),
        tp=tp,
        fn=length - tp,
        fp=inside - tp + int(true.beyond(row, seen, col).sum()) + of_spurious,
        fp_spurious_only=of_spurious,
        tp_tracks=len(row),
        fn_tracks=len(true.particles) - len(row),
        fp_tracks=len(spurious),
        pairs=pd.DataFrame({name: values[by_truth] for name, values in names.items()}),
    )
