"""States of all tracks one step later (thesis, Eqs 2.44 and 2.45)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from kilnflight.checks import check_shape
from kilnflight.kalman.matrices import Array, check_state, mirror, numbers


def predict(
    state: Array, covariance: Array, transition: Array, process_noise: Array
) -> tuple[Array, Array]:
    """Return state (n, k) and covariance (n, k, k) of all tracks one step later.

    Parameters
    ----------
    state, covariance
        Of n tracks, (n, k) and (n, k, k); covariances symmetric.
    transition, process_noise
        F and Q, (k, k), the same for all tracks.

    Raises
    ------
    InputError
        If a shape does not fit or a number is not finite.

    Notes
    -----
    Eqs 2.44 and 2.45, with B u = 0. Eq. 2.45 prints the prior covariance on its right,
    but the text below it says posterior, and so does Eq. 4.6; that is what is taken.
    One half is computed and mirrored, so a covariance stays exactly symmetric.
    """
    state, covariance = numbers(state, "predict: state"), numbers(covariance, "predict: covariance")
    transition = numbers(transition, "predict: transition")
    process_noise = numbers(process_noise, "predict: process_noise")
    k = check_state(state, covariance)
    check_shape(transition, (k, k), "transition")
    check_shape(process_noise, (k, k), "process_noise")
    # Most of F is nought; where it is not is looked up here, since numba compiles that slowly.
    return _predict(state, covariance, transition, process_noise, *np.nonzero(transition))


@njit(cache=True)
def _predict(
    state: Any, covariance: Any, transition: Any, noise: Any, rows: Any, columns: Any
) -> Any:
    moved, spread = np.zeros(state.shape), np.empty(covariance.shape)
    half = np.empty(transition.shape)
    for i in range(len(state)):
        half[:] = 0.0
        for a in range(len(half)):
            for b in range(a + 1):
                spread[i, a, b] = noise[a, b]
        for e in range(len(rows)):
            a, c, share = rows[e], columns[e], transition[rows[e], columns[e]]
            moved[i, a] += share * state[i, c]
            for b in range(len(half)):
                half[b, a] += share * covariance[i, b, c]
        for e in range(len(rows)):
            a, c, share = rows[e], columns[e], transition[rows[e], columns[e]]
            for b in range(a + 1):
                spread[i, a, b] += share * half[c, b]
        mirror(spread[i])
    return moved, spread
