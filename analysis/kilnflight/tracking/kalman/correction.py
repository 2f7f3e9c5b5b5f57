"""States of all tracks after the measurements of a frame (thesis, Eqs 2.46-2.48, 2.52-2.56)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from kilnflight.checks import InputError, check_finite, check_shape
from kilnflight.tracking.kalman.innovation import (
    add_innovation,
    add_sandwich,
    correct,
    root_of,
    scatter_of,
    used_of,
    whiten,
)
from kilnflight.tracking.kalman.matrices import Array, check_state, finite, mirror, rows

Rows = tuple[tuple[float, ...], ...]


def update(
    state: Array,
    covariance: Array,
    measurements: Array,
    weights: Array,
    measurement: Array,
    noise: Array,
) -> tuple[Array, Array]:
    """Return state (n, k) and covariance (n, k, k) after the measurements of one frame.

    Parameters
    ----------
    state, covariance
        Predictions of n tracks, (n, k) and (n, k, k).
    measurements
        Positions in this frame, (m, d).
    weights
        (n, 1 + m): how much each measurement belongs to each track; column 0 is "missed".
        Rows sum to 1. A one-hot row is the textbook update (Eqs 2.46-2.48), weight 1 on
        "missed" gives the prediction back, bit by bit.
    measurement, noise
        H (d, k) and R (d, d).

    Raises
    ------
    InputError
        If a shape does not fit, weights are no weights, or the residual covariance
        S = H P H' + R of a track is singular; the message names the track.

    Notes
    -----
    Eqs 2.52-2.56. One half of a covariance is computed and mirrored, so it stays exactly
    symmetric. Eq. 2.55 is taken as printed, by Cholesky's factor of S; it is positive
    semi-definite but for rounding, some 1e-16 of the prediction's covariance. Eq. 2.56 is
    computed as the scatter of the innovations about their mean, "missed" counting as an
    innovation of nought: the printed term, as a sum of what cannot be negative.
    """
    h, r = _checked(state, covariance, measurements, measurement, noise)
    check_shape(weights, (len(state), 1 + len(measurements)), "weights")
    moved, spread, code = _update(state, covariance, measurements, weights, h, r)
    if code < 0:
        row = weights[-code - 1]
        raise InputError(
            f"update: weights of track {-code - 1} are negative, not finite, or do not sum to 1 "
            f"(sum {row.sum()}, least {row.min()}). Divide each row by its sum."
        )
    _refuse_singular(code)
    return moved, spread


def _checked(
    state: Array, covariance: Array, measurements: Array, measurement: Array, noise: Array
) -> tuple[Rows, Rows]:
    """Return H and R as rows, or raise an `InputError` if something does not fit."""
    k, d = check_state(state, covariance), len(measurement)
    check_shape(measurement, (d, k), "measurement")
    check_shape(noise, (d, d), "noise")
    check_shape(measurements, (None, d), "measurements")
    if not finite(measurements):  # the quick look first
        check_finite(measurements, "measurements")
    return rows(measurement, "measurement"), rows(noise, "noise")


def _refuse_singular(code: int) -> None:
    """Raise an `InputError` about track code - 1 unless the code is 0."""
    if code:
        raise InputError(
            f"update: the residual covariance S = H P H' + R of track {code - 1} is singular. "
            "Give the measurements some noise R, or the track a covariance without NaN."
        )


@njit(cache=True)
def _update(state: Any, covariance: Any, positions: Any, weights: Any, h: Any, r: Any) -> Any:
    """Update every track; the third result is 0, i + 1 a singular track, -i - 1 bad weights."""
    d, k = len(h), len(h[0])
    moved, spread = state.copy(), covariance.copy()
    lower, root, mean, scatter = np.zeros((d, d)), np.empty((k, d)), np.empty(d), np.empty((d, d))
    for i in range(len(state)):
        used, place = used_of(weights[i])
        if used < 0:
            return moved, spread, -i - 1
        if weights[i, 0] == 1.0:
            continue
        if not root_of(covariance, i, h, r, lower, root):
            return moved, spread, i + 1
        mean[:] = 0.0
        first, last = (max(place, 1), place + 1) if used == 1 else (1, weights.shape[1])
        for j in range(first, last):
            if weights[i, j] > 0.0:
                add_innovation(state, i, positions, j - 1, weights[i, j], h, mean)
        whiten(lower, mean, h)
        correct(moved, spread, i, root, mean, 1.0 - weights[i, 0], h)
        if used > 1:
            scatter_of(state, i, positions, weights, lower, mean, h, scatter)
            add_sandwich(root, scatter, spread[i])  # Eq. 2.56
            mirror(spread[i])
    return moved, spread, 0
