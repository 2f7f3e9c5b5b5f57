"""Validation matrix and its feasibility matrices, written out (thesis, section 2.3.4).

For figures and for counting. `joint_probabilities` never lists events.
"""

from __future__ import annotations

from math import comb, perm

import numpy as np
import numpy.typing as npt

from kilnflight.association.pairs import Pairs, check_pairs
from kilnflight.checks import InputError, check_count

MOST_EVENTS = 2**20

Matrices = npt.NDArray[np.uint8]


def validation_matrix(pairs: Pairs) -> Matrices:
    """Return Omega (m, 1 + n) of 0 and 1, Eq. 2.57, thesis: rows are detections, column 0 none."""
    inside = np.isfinite(check_pairs(pairs).distance_squared).T
    return np.column_stack([np.ones(len(inside), dtype=np.uint8), inside.astype(np.uint8)])


def feasible_events(validation: npt.ArrayLike) -> Matrices:
    """Return every feasibility matrix of a validation matrix, Eqs 2.58 to 2.61, thesis.

    Parameters
    ----------
    validation
        (m, 1 + n) of 0 and 1: which detection lies in the gate of which track. Column 0
        is "no track" and holds ones (Eq. 2.57).

    Returns
    -------
    ndarray
        (events, m, 1 + n) uint8: one 1 per row, at most one per column but column 0. The
        first is the event without any pair; the order is that of the detections' tracks.

    Raises
    ------
    InputError
        If the matrix is not as described or has more than 2^20 events.

    Examples
    --------
    >>> len(feasible_events([[1, 1, 0], [1, 1, 1], [1, 0, 1], [1, 0, 1]]))  # Fig. 2.23
    11
    """
    omega = np.asarray(validation)
    if omega.ndim != 2 or omega.shape[1] < 1 or not np.isin(omega, (0, 1)).all():
        raise InputError(
            f"validation matrix: shape {omega.shape}, expected (detections, 1 + tracks) of 0 and 1."
        )
    if not (omega[:, 0] == 1).all():
        raise InputError("validation matrix: column 0 is 'no track' and must hold ones.")
    tracks = np.zeros((1, 0), dtype=np.intp)  # (events so far, detections so far)
    for row in omega:
        choices = np.flatnonzero(row)
        grown = np.column_stack(
            [np.repeat(tracks, len(choices), axis=0), np.tile(choices, len(tracks))]
        )
        taken = (grown[:, :-1] == grown[:, -1:]).any(axis=1) & (grown[:, -1] > 0)
        tracks = grown[~taken]
        if len(tracks) > MOST_EVENTS:
            raise InputError(
                f"validation matrix {omega.shape}: more than {MOST_EVENTS} feasible events; list "
                "those of a smaller group (joint_probabilities needs no list)."
            )
    return (tracks[:, :, None] == np.arange(omega.shape[1])).astype(np.uint8)


def most_events(tracks: int, detections: int) -> int:
    """Return the number of feasible events if all detections are in all gates, Eq. 2.62, thesis.

    Notes
    -----
    With fewer detections than tracks, the factorials of negative numbers that Eq. 2.62 then
    contains stand for no event.

    Examples
    --------
    >>> most_events(2, 4)
    21
    """
    check_count(tracks, "most_events: tracks", least=0)
    check_count(detections, "most_events: detections", least=0)
    n, m = int(tracks), int(detections)
    return 1 + sum(comb(n, i) * perm(m, n - i) for i in range(n))
