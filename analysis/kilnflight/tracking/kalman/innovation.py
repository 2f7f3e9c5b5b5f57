"""One track and the measurements of a frame: the compiled parts of the correction.

They are put into the loops over the tracks as they stand (``inline``): a call per track would
cost as much as what it does. ``h`` and ``r`` are H and R as tuples of rows, which tell the
compiler the sizes d and k (`kilnflight.tracking.kalman.matrices.rows`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from kilnflight.tracking.kalman.matrices import factor

_ROW_SUM = 1e-6  # how far weights of one track may be from summing to 1


@njit(cache=True, fastmath={"reassoc"})
def used_of(weights: Any) -> tuple[int, int]:
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


@njit(cache=True, inline="always")
def root_of(covariance: Any, i: int, h: Any, r: Any, lower: Any, root: Any) -> bool:
    """Fill ``lower`` with L, S = H P H' + R = L L', and ``root`` with W = P H' L^-T.

    Then K = W L^-1 (Eq. 2.47) and K S K' = W W'. The diagonal of L is kept as reciprocals,
    since a division takes as long as ten products. False if S is singular.
    """
    d, k = len(h), len(h[0])
    for c in range(d):
        for a in range(k):
            value = 0.0
            for e in range(k):
                value += covariance[i, a, e] * h[c][e]
            root[a, c] = value
    for c in range(d):
        for e in range(c + 1):
            value = r[c][e]
            for a in range(k):
                value += h[c][a] * root[a, e]
            lower[c, e] = value
    if not factor(lower, lower):
        return False
    for c in range(d):
        lower[c, c] = 1.0 / lower[c, c]
    for a in range(k):
        whiten(lower, root[a], h)
    return True


@njit(cache=True, inline="always")
def whiten(lower: Any, vector: Any, h: Any) -> None:
    """Replace v by L^-1 v, L as `root_of` leaves it; ``h`` tells the compiler how long v is."""
    for c in range(len(h)):
        for e in range(c):
            vector[c] -= lower[c, e] * vector[e]
        vector[c] *= lower[c, c]


@njit(cache=True, inline="always")
def add_innovation(
    state: Any, i: int, positions: Any, j: int, share: float, h: Any, out: Any
) -> None:
    """Add to ``out`` the share of the innovation, z_j - H x_i."""
    for c in range(len(h)):
        apart = positions[j, c]
        for a in range(len(h[c])):
            apart -= h[c][a] * state[i, a]
        out[c] += share * apart


@njit(cache=True, inline="always")
def correct(moved: Any, spread: Any, i: int, root: Any, mean: Any, seen: float, h: Any) -> None:
    """Add K mu to the state, take the share ``seen`` of K S K' from the covariance."""
    d, k = len(h), len(h[0])
    for a in range(k):
        for c in range(d):
            moved[i, a] += root[a, c] * mean[c]  # Eqs 2.46 and 2.52
        for b in range(a + 1):
            value = spread[i, a, b]
            for c in range(d):
                value -= seen * root[a, c] * root[b, c]  # Eq. 2.54 with Eq. 2.55
            spread[i, a, b] = value
            spread[i, b, a] = value


@njit(cache=True, inline="always")
def scatter_of(
    state: Any, i: int, positions: Any, weights: Any, lower: Any, mean: Any, h: Any, scatter: Any
) -> None:
    """Fill ``scatter`` with the bracket of Eq. 2.56, whitened as ``mean`` is."""
    scatter[:] = 0.0
    apart = np.empty(len(h))
    for j in range(weights.shape[1]):
        if weights[i, j] > 0.0:
            apart[:] = 0.0
            if j:
                add_innovation(state, i, positions, j - 1, 1.0, h, apart)
            whiten(lower, apart, h)
            for c in range(len(h)):
                for e in range(len(h)):
                    scatter[c, e] += weights[i, j] * (apart[c] - mean[c]) * (apart[e] - mean[e])


@njit(cache=True, inline="always")
def add_sandwich(outer: Any, inner: Any, out: Any) -> None:
    """Add A B A' to the lower half of ``out``."""
    rows, columns = outer.shape
    for a in range(rows):
        for b in range(a + 1):
            for c in range(columns):
                for e in range(columns):
                    out[a, b] += outer[a, c] * inner[c, e] * outer[b, e]
