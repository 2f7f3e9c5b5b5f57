"""Pair places with places by the Hungarian method, within a gate (thesis, Eq. 3.4)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


def pair(first: Array, second: Array, gate: float) -> Indices:
    """Return the rows (k, 2) of ``first`` (n, d) and ``second`` (m, d) that belong together.

    As many pairs as possible that are no farther apart than ``gate``; of these assignments
    the one with the smallest sum of distances. Clusters that no gate connects are assigned
    one by one: the best of the whole is the best of each.
    """
    if not len(first) or not len(second):
        return np.empty((0, 2), dtype=np.intp)
    near = KDTree(first).sparse_distance_matrix(KDTree(second), gate, output_type="ndarray")
    one, other, cost = near["i"].astype(np.intp), near["j"].astype(np.intp), near["v"]
    size = len(first) + len(second)
    links = coo_array((np.ones(len(one)), (one, other + len(first))), shape=(size, size))
    cluster = connected_components(links, directed=False)[1][one]
    lonely = np.bincount(cluster, minlength=size)[cluster] == 1
    pairs = [np.stack([one[lonely], other[lonely]], axis=1)]
    crowded = np.flatnonzero(~lonely)
    crowded = crowded[np.argsort(cluster[crowded], kind="stable")]
    cuts = np.flatnonzero(np.diff(cluster[crowded])) + 1
    pairs += [_hungarian(one[k], other[k], cost[k]) for k in np.split(crowded, cuts) if len(k)]
    return np.concatenate(pairs)


def _hungarian(one: Indices, other: Indices, cost: Array) -> Indices:
    """Return the best assignment of one cluster of allowed pairs."""
    rows, row = np.unique(one, return_inverse=True)
    columns, column = np.unique(other, return_inverse=True)
    # C_max: more than all allowed distances together, so that no pair is given up for them.
    forbidden = 1.0 + cost.max() * min(len(rows), len(columns))
    matrix = np.full((len(rows), len(columns)), forbidden)
    matrix[row, column] = cost
    row, column = linear_sum_assignment(matrix)
    allowed = matrix[row, column] < forbidden
    return np.stack([rows[row[allowed]], columns[column[allowed]]], axis=1)
