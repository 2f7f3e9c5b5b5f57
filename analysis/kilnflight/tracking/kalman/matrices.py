"""Shapes and small matrices that prediction and correction share."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.checks import InputError, check_finite, check_shape

Array = npt.NDArray[np.float64]

SINGULAR = 1e-13  # a pivot below this share of its diagonal is rounding, not a variance


def check_state(state: Array, covariance: Array) -> int:
    """Return k, or raise an `InputError` unless the shapes are (n, k) and (n, k, k)."""
    k = state.shape[-1] if state.ndim else 0
    if covariance.shape != (*state.shape, k) or state.ndim != 2:
        check_shape(state, (None, k), "state")
        check_shape(covariance, (len(state), k, k), "covariance")
    return k


def floats(values: npt.ArrayLike, where: str) -> Array:
    """Return an array of float64: as it is if it is one already, else checked to be finite."""
    if isinstance(values, np.ndarray) and values.dtype == np.float64:
        ready: Array = values
        return ready
    return check_finite(values, where)


def rows(matrix: Array, where: str) -> tuple[tuple[float, ...], ...]:
    """Return a matrix as a tuple of its rows: the compiler then knows its size.

    What loops over d and k costs per track is mostly not knowing how often; with tuples they
    are unrolled, once for every pair of sizes that occurs.
    """
    if not matrix.size:
        raise InputError(f"{where} is empty, of shape {matrix.shape}; give it rows and columns.")
    return tuple(map(tuple, matrix.tolist()))


@njit(cache=True, fastmath={"reassoc"})
def finite(values: Any) -> bool:
    """Return whether all numbers are finite: nought times any other is none."""
    total = 0.0
    for value in values.flat:
        total += 0.0 * value
    return total == 0.0


@njit(cache=True)
def mirror(matrix: Any) -> None:
    """Copy the lower half of a square matrix to its upper half."""
    for a in range(len(matrix)):
        for b in range(a):
            matrix[b, a] = matrix[a, b]


@njit(cache=True, inline="always")
def factor(matrix: Any, lower: Any) -> bool:
    """Fill ``lower`` with Cholesky's factor of a small matrix; return whether there is one."""
    for a in range(matrix.shape[0]):
        for b in range(a + 1):
            rest = matrix[a, b]
            for c in range(b):
                rest -= lower[a, c] * lower[b, c]
            if a > b:
                lower[a, b] = rest / lower[b, b]
            elif rest > SINGULAR * matrix[a, a]:  # false for NaN, too
                lower[a, a] = np.sqrt(rest)
            else:
                return False
    return True


@njit(cache=True)
def residual_covariance(covariance: Any, measurement: Any, noise: Any) -> Any:
    """Return S = H P H' + R, (n, d, d), of covariances (n, k, k)."""
    d, k = measurement.shape
    residual, half = np.empty((len(covariance), d, d)), np.empty(k)
    for i in range(len(covariance)):
        for a in range(d):
            half[:] = 0.0
            for c in range(k):
                if measurement[a, c] != 0.0:
                    for e in range(k):
                        half[e] += measurement[a, c] * covariance[i, c, e]
            for b in range(a, d):
                value = noise[a, b]
                for e in range(k):
                    value += half[e] * measurement[b, e]
                residual[i, a, b] = value
                residual[i, b, a] = value
    return residual
