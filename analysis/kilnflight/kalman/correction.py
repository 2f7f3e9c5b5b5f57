"""States of all tracks after the measurements of a frame (thesis, Eqs 2.46-2.48, 2.52-2.56)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from kilnflight.checks import InputError, check_finite, check_shape
from kilnflight.kalman.matrices import Array, check_state, factor, mirror, residual_covariance

_ROW_SUM = 1e-6  # how far weights of one track may be from summing to 1


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
    k, d = check_state(state, covariance), len(measurement)
    check_shape(measurement, (d, k), "measurement")
    check_shape(noise, (d, d), "noise")
    check_shape(measurements, (None, d), "measurements")
    check_shape(weights, (len(state), 1 + len(measurements)), "weights")
    if not np.isfinite(measurements).all():  # the quick look first
        check_finite(measurements, "measurements")
    result = _update(
        state, covariance, state @ measurement.T, measurements, weights, measurement, noise
    )
    _refuse(result[2], weights)
    return result[0], result[1]


def _refuse(code: int, weights: Array) -> None:
    """Word the code of `_update`: 0 is good, +i + 1 a singular track, -i - 1 bad weights."""
    if code > 0:
        raise InputError(
            f"update: the residual covariance S = H P H' + R of track {code - 1} is singular. "
            "Give the measurements some noise R, or the track a covariance without NaN."
        )
    if code < 0:
        row = weights[-code - 1]
        raise InputError(
            f"update: weights of track {-code - 1} are negative, not finite, or do not sum to 1 "
            f"(sum {row.sum()}, least {row.min()}). Divide each row by its sum."
        )


@njit(cache=True)
def _update(
    state: Any,
    covariance: Any,
    expected: Any,
    positions: Any,
    weights: Any,
    measurement: Any,
    noise: Any,
) -> Any:
    """Update every track; the third result is 0, or tells `_refuse` of a bad track."""
    d, k = measurement.shape
    moved, spread = state.copy(), covariance.copy()
    residual = residual_covariance(covariance, measurement, noise)
    lower, root, mean, scatter = np.zeros((d, d)), np.empty((k, d)), np.empty(d), np.empty((d, d))
    for i in range(len(state)):
        used, place = _used(weights[i])
        if used < 0:
            return moved, spread, -i - 1
        missed = weights[i, 0]
        if missed == 1.0:
            continue
        if not factor(residual[i], lower):
            return moved, spread, i + 1
        _root(covariance, i, measurement, lower, root)
        _innovation(expected, positions, weights, i, used, place, lower, mean)
        for a in range(k):
            for c in range(d):
                moved[i, a] += root[a, c] * mean[c]  # Eqs 2.46 and 2.52
                for b in range(a + 1):  # Eq. 2.54 with Eq. 2.55
                    spread[i, a, b] -= (1.0 - missed) * root[a, c] * root[b, c]
        if used > 1:
            _scatter(expected, positions, weights, i, lower, mean, scatter)
            _add_sandwich(root, scatter, spread[i])  # Eq. 2.56
        mirror(spread[i])
    return moved, spread, 0


@njit(cache=True, fastmath={"reassoc"})
def _used(weights: Any) -> tuple[int, int]:
    """Return how many weights are not nought, and the place of their centre of mass.

    Where only one is used, that is its place: no need to look for it. The count is -1 if
    the weights are no distribution.
    """
    total, bad, used, place = 0.0, 0, 0, 0.0
    for j in range(len(weights)):
        total += weights[j]
        place += j * weights[j]
        bad += not weights[j] >= 0.0  # negative or NaN
        used += weights[j] != 0.0
    if bad > 0 or not abs(total - 1.0) <= _ROW_SUM:
        return -1, 0
    return used, int(place + 0.5)


@njit(cache=True)
def _root(covariance: Any, i: int, measurement: Any, lower: Any, root: Any) -> None:
    """Fill ``root`` with W = P H' L^-T, S = L L': then K = W L^-1 (Eq. 2.47), K S K' = W W'."""
    k, d = root.shape
    for c in range(d):
        scale = 1.0 / lower[c, c]
        for a in range(k):
            value = 0.0
            for e in range(k):
                value += covariance[i, a, e] * measurement[c, e]
            for e in range(c):
                value -= lower[c, e] * root[a, e]
            root[a, c] = value * scale


@njit(cache=True)
def _innovation(
    expected: Any,
    positions: Any,
    weights: Any,
    i: int,
    used: int,
    place: int,
    lower: Any,
    mean: Any,
) -> None:
    """Fill ``mean`` with the weighted innovation (Eq. 2.53), whitened: L^-1 mu."""
    mean[:] = 0.0
    left, j = used - (weights[i, 0] > 0.0), place - 1 if used == 1 else 0
    while left:
        j += 1
        if weights[i, j] > 0.0:
            left -= 1
            for c in range(len(mean)):
                mean[c] += weights[i, j] * (positions[j - 1, c] - expected[i, c])
    _whiten(lower, mean)


@njit(cache=True)
def _whiten(lower: Any, vector: Any) -> None:
    """Replace v by L^-1 v."""
    for c in range(len(vector)):
        for e in range(c):
            vector[c] -= lower[c, e] * vector[e]
        vector[c] /= lower[c, c]


@njit(cache=True)
def _scatter(
    expected: Any, positions: Any, weights: Any, i: int, lower: Any, mean: Any, scatter: Any
) -> None:
    """Fill ``scatter`` with the bracket of Eq. 2.56, whitened as ``mean`` is."""
    scatter[:] = 0.0
    apart = np.empty(len(mean))
    for j in range(weights.shape[1]):
        if weights[i, j] > 0.0:
            for c in range(len(mean)):
                apart[c] = positions[j - 1, c] - expected[i, c] if j else 0.0
            _whiten(lower, apart)
            for c in range(len(mean)):
                for e in range(len(mean)):
                    scatter[c, e] += weights[i, j] * (apart[c] - mean[c]) * (apart[e] - mean[e])


@njit(cache=True)
def _add_sandwich(outer: Any, inner: Any, out: Any) -> None:
    """Add A B A' to the lower half of ``out``."""
    rows, columns = outer.shape
    for a in range(rows):
        for b in range(a + 1):
            for c in range(columns):
                for e in range(columns):
                    out[a, b] += outer[a, c] * inner[c, e] * outer[b, e]
