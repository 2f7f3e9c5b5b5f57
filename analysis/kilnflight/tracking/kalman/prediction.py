"""States of all tracks one step later (thesis, Eqs 2.44 and 2.45)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from kilnflight.checks import check_finite, check_shape
from kilnflight.tracking.kalman.matrices import Array, check_state, finite, floats, rows


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
    names = ("state", "covariance", "transition", "process_noise")
    given = (state, covariance, transition, process_noise)
    arrays = [floats(one, f"predict: {name}") for one, name in zip(given, names, strict=True)]
    x, p, f, q = arrays
    k = check_state(x, p)
    check_shape(f, (k, k), "transition")
    check_shape(q, (k, k), "process_noise")
    moved, spread, sound = _predict(x, p, f, q, rows(f, "transition"))
    if not sound:
        for one, name in zip(arrays, names, strict=True):
            check_finite(one, f"predict: {name}")
    return moved, spread


@njit(cache=True)
def _predict(state: Any, covariance: Any, transition: Any, noise: Any, f: Any) -> Any:
    """Predict every track by F as rows; the third result is whether all numbers are finite."""
    k = len(f)
    moved, spread, half = np.empty(state.shape), np.empty(covariance.shape), np.empty((k, k))
    for i in range(len(state)):
        for a in range(k):
            value = 0.0
            for c in range(k):
                value += f[a][c] * state[i, c]  # Eq. 2.44
            moved[i, a] = value
            for b in range(k):
                value = 0.0
                for c in range(k):
                    value += f[a][c] * covariance[i, c, b]
                half[a, b] = value
        for a in range(k):
            for b in range(a + 1):
                value = noise[a, b]
                for c in range(k):
                    value += half[a, c] * f[b][c]  # Eq. 2.45
                spread[i, a, b] = value
                spread[i, b, a] = value
    sound = finite(state) and finite(covariance) and finite(transition) and finite(noise)
    return moved, spread, sound
