"""The association of tracks and measurements with extra rows and columns (2016, Fig. 3).

All likelihoods are taken as -ln, so the likeliest association is the cheapest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.association import Pairs, assign

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]


def pair_costs(pairs: Pairs, missed: float) -> Array:
    """Return -ln of (1 - missed) N(z; prediction, S), (n, m); inf outside the gate."""
    return _pair_costs(*pairs[:2], float(missed), pairs.dimensions)


def associate(costs: Array, gone: Array, new: Array) -> Integers:
    """Return the measurement of each track, -1 for none, in the likeliest association.

    Parameters
    ----------
    costs
        (n, m) from `pair_costs`.
    gone
        (n,) likelihood that a track is not observed.
    new
        (m,) likelihood that a measurement stems from a track not known yet, per mm^2 as are
        the pairs.

    Notes
    -----
    Each measurement has an extra row and each track an extra column of its own, so all of
    ``new`` is paid but for the measurements that go to a track. Taking it off the pairs gives
    the same optimum from the (n, m) part alone; `matrix` writes the whole one out.
    """
    return assign(_relative(costs, new), _negative_log(gone))


def matrix(costs: Array, gone: Array, new: Array) -> Array:
    """Return the matrix of Fig. 3, (n + m, m + n), inf where a pair is impossible.

    Notes
    -----
    Rows n on are "new", each for one measurement; columns m on are "not observed", each for
    one track. The paper leaves open what fills the corner of both; it is free (0, likelihood
    1), so that what one solution needs of it costs nothing.
    """
    n, m = costs.shape
    whole = np.full((n + m, m + n), np.inf)
    whole[:n, :m] = costs
    whole[n + np.arange(m), np.arange(m)] = -np.log(new)
    whole[np.arange(n), m + np.arange(n)] = -np.log(gone)
    whole[n:, m:] = 0.0
    return whole


@njit(cache=True)
def _pair_costs(squares: Any, logs: Any, missed: float, dimensions: int) -> Any:
    costs = np.empty(squares.shape)
    constant = dimensions * np.log(2.0 * np.pi)
    for i in range(len(costs)):
        first = 0.5 * (logs[i] + constant) - np.log(1.0 - missed)
        for j in range(costs.shape[1]):
            costs[i, j] = first + 0.5 * squares[i, j]
    return costs


@njit(cache=True)
def _relative(costs: Any, new: Any) -> Any:
    relative, logs = np.empty(costs.shape), np.log(new)
    for i in range(len(costs)):
        for j in range(costs.shape[1]):
            relative[i, j] = costs[i, j] + logs[j]
    return relative


@njit(cache=True)
def _negative_log(values: Any) -> Any:
    return -np.log(values)
