"""Which tracklets to join, given what each pair costs (thesis, section 4.2.3, Fig. 4.14)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from kilnflight.checks import InputError, check_shape

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


class Pairs(NamedTuple):
    """A cost matrix as the list of its possible pairs; the others cost C, as in Fig. 4.14.

    Of thousands of tracklets a handful of pairs are possible, so the matrix is never made.

    Attributes
    ----------
    one, other
        (p,) earlier and later tracklet.
    cost
        (p,) finite and at least 0.
    """

    one: Indices
    other: Indices
    cost: Floats


def listed(matrix: npt.ArrayLike) -> Pairs:
    """Return the pairs of a square cost matrix, infinite where a pair is impossible.

    Entry [i, k] is the cost of tracklet i followed by tracklet k.

    Raises
    ------
    InputError
        If the matrix is not square, or a cost is negative or not a number.
    """
    cost = np.asarray(matrix)
    if cost.dtype.kind not in "iuf":
        raise InputError(f"cost matrix: it holds {cost.dtype}, expected numbers.")
    check_shape(cost, (None, None), "cost matrix")
    check_shape(cost, (len(cost), len(cost)), "cost matrix")
    one, other = np.nonzero(cost != np.inf)
    return check_pairs(Pairs(one, other, cost[one, other].astype(np.float64)))


def check_pairs(pairs: Pairs) -> Pairs:
    """Return the pairs, or raise an `InputError` if a cost is negative or not finite.

    A cost below 0 would make it cheaper to join than to do nothing, which no term of
    Eq. 4.24 does.
    """
    bad = np.flatnonzero(~((pairs.cost >= 0) & (pairs.cost < np.inf)))
    if len(bad):
        one, other, cost = (values[bad[0]] for values in pairs)
        raise InputError(
            f"pairs: tracklets {one} and {other} cost {cost}; expected 0 or above and finite, "
            "inf in a matrix where a pair is impossible."
        )
    return pairs


class Matching(Protocol):
    """What picks the pairs of one iteration."""

    def __call__(self, pairs: Pairs) -> Indices:
        """Return which of the pairs to join, as positions in the list, ascending."""
        ...


@dataclass(frozen=True)
class DualNearest:
    """Pairs of which each is the other's nearest neighbour (DNN).

    Notes
    -----
    A tracklet has one nearest neighbour, before or after it, so that each iteration joins
    it at most once; of equally near ones the first. Where anything can be joined, the
    cheapest pair is. Source: section 4.2.3, thesis.
    """

    def __call__(self, pairs: Pairs) -> Indices:
        """Return which of the pairs to join, as positions in the list, ascending."""
        size = len(check_pairs(pairs).cost)
        tracklet = np.append(pairs.one, pairs.other)
        neighbour = np.append(pairs.other, pairs.one)
        number = np.tile(np.arange(size), 2)
        order = np.lexsort((number, neighbour, np.tile(pairs.cost, 2), tracklet))
        first = np.append(True, np.diff(tracklet[order]) != 0)[: 2 * size]
        chosen = np.bincount(number[order[first]], minlength=size)
        return np.flatnonzero(chosen == 2)


@dataclass(frozen=True)
class Hungarian:
    """As many pairs as possible at the smallest sum of costs (Kuhn-Munkres, GNN).

    The alternative of Fig. 4.14. Here a tracklet may get one before and one after it.
    """

    def __call__(self, pairs: Pairs) -> Indices:
        """Return which of the pairs to join, as positions in the list, ascending."""
        if not len(check_pairs(pairs).cost):
            return np.empty(0, dtype=np.int64)
        rows, row = np.unique(pairs.one, return_inverse=True)
        columns, column = np.unique(pairs.other, return_inverse=True)
        # A column of its own for each row that stays alone, dearer than all pairs together.
        # Everything costs 1 more, because a sparse matrix does not hold zeros.
        alone = 1.0 + (1.0 + pairs.cost.max()) * (1 + min(len(rows), len(columns)))
        cost = np.append(pairs.cost + 1.0, np.full(len(rows), alone))
        row = np.append(row, np.arange(len(rows)))
        column = np.append(column, len(columns) + np.arange(len(rows)))
        shape = (len(rows), len(columns) + len(rows))
        graph = coo_array((cost, (row, column)), shape=shape).tocsr()
        matched = np.full(len(rows), -1)
        one, other = min_weight_full_bipartite_matching(graph)
        matched[one] = other
        return np.flatnonzero(matched[row[: len(pairs.cost)]] == column[: len(pairs.cost)])
