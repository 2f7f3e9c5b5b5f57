"""Linear Kalman filter of all tracks at once.

Sections 2.3.1 and 2.3.3 of the thesis. A state is one row of an (n, k) array, its covariance one
(k, k) slice of an (n, k, k) array. The update takes association weights, so one function serves
the textbook filter (rows of 0 and 1) and probabilistic data association (rows of probabilities).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError

Array = npt.NDArray[np.float64]

SINGULAR = 1e-13  # a determinant below this share of the variances' product is rounding
ROW_SUM = 1e-6  # how far weights of one track may be from summing to 1


def predict(
    state: Array, covariance: Array, transition: Array, process_noise: Array
) -> tuple[Array, Array]:
    """Return state and covariance of all tracks one step later.

    Parameters
    ----------
    state, covariance
        Of n tracks, (n, k) and (n, k, k); covariances symmetric.
    transition, process_noise
        F and Q, (k, k), the same for all tracks.

    Notes
    -----
    Eqs 2.44 and 2.45, with B u = 0. Eq. 2.45 prints the prior covariance on its right, but the
    text below it says posterior, and so does Eq. 4.6. The posterior is taken here.
    """
    spread = transition @ covariance @ transition.T + process_noise
    return state @ transition.T, _symmetric(spread)


def residual_covariance(covariance: Array, measurement: Array, noise: Array) -> Array:
    """Return S = H P H' + R, (n, d, d), of covariances (n, k, k)."""
    return _symmetric(measurement @ covariance @ measurement.T + noise)


def factor(residual: Array) -> Array:
    """Return Cholesky's factors L (n, d, d) of residual covariances.

    Each is lower triangular, with S = L L'.

    Raises
    ------
    InputError
        If one is singular or not finite; the message names the track.
    """
    variances = np.diagonal(residual, axis1=1, axis2=2).prod(axis=1)
    with np.errstate(invalid="ignore"):  # NaN is not sound
        sound = np.linalg.det(residual) > SINGULAR * variances
    if not sound.all():
        raise InputError(
            f"the residual covariance of track {np.argmin(sound)} is singular or not finite "
            "(S = H P H' + R). Give the motion model some measurement noise R, or the track a "
            "covariance without NaN."
        )
    return np.asarray(np.linalg.cholesky(residual), dtype=np.float64)


def update(
    state: Array,
    covariance: Array,
    measurements: Array,
    weights: Array,
    measurement: Array,
    noise: Array,
) -> tuple[Array, Array]:
    """Return state and covariance after the measurements of one frame.

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
        If weights are no weights, or the residual covariance of a track is singular.

    Notes
    -----
    Eqs 2.52-2.56. Eq. 2.55 is taken as printed, by Cholesky's factor L of S. With W' = L^-1 H P,
    the gain is K = W L^-1 and K S K' = W W'. Eq. 2.56 is computed as the scatter of the
    innovations about their mean, "missed" counting as an innovation of zero. This is the printed
    term, as a sum of squares.
    """
    sums = weights.sum(axis=1)
    sound = (weights >= 0).all(axis=1) & (np.abs(sums - 1.0) <= ROW_SUM)
    if not sound.all():
        i = int(np.argmin(sound))
        raise InputError(
            f"update: weights of track {i} are negative, not finite, or do not sum to 1 (sum "
            f"{sums[i]}, least {weights[i].min()}). Divide each row by its sum."
        )
    lower = factor(residual_covariance(covariance, measurement, noise))
    root = np.linalg.solve(lower, measurement @ covariance)  # W' (n, d, k)
    expected = (state @ measurement.T)[:, :, None]
    shares = weights[:, 1:, None]
    mean = np.linalg.solve(lower, measurements.T @ shares - shares.sum(axis=1)[:, None] * expected)
    moved = state + (root.mT @ mean)[:, :, 0]  # Eqs 2.46 and 2.52
    spread = covariance - (1.0 - weights[:, :1, None]) * (root.mT @ root)  # Eq. 2.54 with 2.55
    several = np.flatnonzero((weights > 0).sum(axis=1) > 1)
    if len(several):
        innovations = np.linalg.solve(lower[several], measurements.T - expected[several])
        apart = np.concatenate([0.0 * mean[several], innovations], axis=2) - mean[several]
        scatter = (weights[several, None] * apart) @ apart.mT
        spread[several] += root[several].mT @ scatter @ root[several]  # Eq. 2.56
    missed = weights[:, 0] == 1.0
    moved[missed] = state[missed]
    spread = _symmetric(spread)
    spread[missed] = covariance[missed]
    return moved, spread


def _symmetric(matrices: Array) -> Array:
    """Return the mean of matrices (n, k, k) and their transposes.

    It is exactly symmetric.
    """
    return np.asarray(0.5 * (matrices + matrices.mT), dtype=np.float64)
