"""The Kalman filter of one track, as printed in section 2.3 of the thesis."""

import numpy as np


def predict(state, covariance, f, q):
    """Return Eqs 2.44 and 2.45."""
    return f @ state, f @ covariance @ f.T + q


def update(state, covariance, measurements, weights, h, r):
    """Return Eqs 2.52 to 2.56."""
    s = r + h @ covariance @ h.T
    gain = covariance @ h.T @ np.linalg.inv(s)
    apart = measurements - h @ state
    mean = weights[1:] @ apart
    spread = (weights[1:, None] * apart).T @ apart - np.outer(mean, mean)
    updated = covariance - gain @ s @ gain.T
    mixed = (
        weights[0] * covariance + (1 - weights[0]) * updated + gain @ spread @ gain.T
    )
    return state + gain @ mean, mixed
