"""Density-based clusters of a point cloud (thesis, section 2.2.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.spatial import cKDTree

from kilnflight.checks import InputError, check_count, check_positive
from kilnflight.detection.cells import (
    NOISE,
    Cells,
    advance,
    check_points,
    root_of,
    rows_around,
    sort_into_cells,
    unite,
)

REACH = 2  # cells between points that are within eps


@dataclass(frozen=True)
class DBSCAN:
    """Clusters of points that reach each other through core points.

    A core point has at least ``min_points`` points, itself included, within ``eps``. Core
    points within ``eps`` of each other share a cluster; another point within ``eps`` of a
    core point is a border point of its cluster; the rest is noise.

    Parameters
    ----------
    eps
        Radius in mm; the border belongs to it.
    min_points
        Points that make a core point.

    Raises
    ------
    InputError
        If ``eps`` is not above 0 or ``min_points`` is no whole number from 1.

    Notes
    -----
    The thesis asks for "more than minPts" points including the query point, but calls a
    point core when the distance to its minPts-th neighbour, the query point included, is at
    most eps. The second is Ester's and scikit-learn's definition and is taken. A border
    point of several clusters goes to the first of them, in the order of the points.

    Section 5.1.3 removes the kiln's wall by a pass of its own, "with the highest precision",
    minPts 10 and eps 50 mm; by Table 5.8 the most precise set is 15 and 70 mm. The second
    pass takes 10 and 15 mm. Sources: section 2.2.4 and Table 5.8, thesis.
    """

    eps: float = 50.0  # mm, best F1 of Table 5.8
    min_points: int = 10  # points, best F1 of Table 5.8

    def __post_init__(self) -> None:
        """Refuse a radius or a number of points that makes no neighbourhood."""
        check_positive(self.eps, "DBSCAN: eps in mm")
        check_count(self.min_points, "DBSCAN: min_points")

    def __call__(self, points: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Return the cluster of each of (n, 3) points in mm; noise is -1.

        Clusters are numbered in the order of their first core point.

        Raises
        ------
        InputError
            If the points are not (n, 3) finite numbers.
        """
        cloud = check_points(points, "DBSCAN: points")
        if len(cloud) == 0:
            return np.empty(0, dtype=np.intp)
        # Two points of one cell are within eps; two within eps are at most two cells apart.
        # The small margin keeps both true after rounding.
        side = self.eps / np.sqrt(3.0) * (1 - 1e-8)
        cells = sort_into_cells(cloud, side, REACH, "DBSCAN: points")
        steps = rows_around(cells.layer, cells.row, REACH)
        limit, wanted = float(self.eps * self.eps), int(self.min_points)
        core = _core_points(cells, steps, limit, wanted)
        parents = _connected_cells(cells, steps, core, limit)
        return _labels(cells, steps, core, parents, limit)


def k_distances(points: npt.ArrayLike, k: int = 6) -> npt.NDArray[np.float64]:
    """Return the distance of each point to its k-th neighbour, descending (Fig. 2.19, thesis).

    The query point counts as the first, as in section 2.2.4: at ``k = min_points`` the
    points whose distance is at most eps are the core points of `DBSCAN`.

    Parameters
    ----------
    points
        (n, 3) mm.
    k
        Neighbours, from 1 to n; the default is twice the dimension (section 2.2.4).

    Returns
    -------
    ndarray
        (n,) distances in mm, the largest first.

    Raises
    ------
    InputError
        If the points are not (n, 3) finite numbers or there are fewer than ``k`` of them.
    """
    cloud = check_points(points, "k-distances: points")
    if k != int(k) or k < 1 or (len(cloud) and k > len(cloud)):
        raise InputError(
            f"k-distances: k is {k}, expected a whole number from 1 to the {len(cloud)} points."
        )
    if len(cloud) == 0:
        return np.empty(0)
    distances = np.asarray(cKDTree(cloud).query(cloud, k=[int(k)])[0])
    return np.sort(distances[:, 0])[::-1]


@njit(cache=True)
def _near(points: Any, a: int, b: int, limit: float) -> bool:
    """Tell whether two points are at most eps apart."""
    x = points[a, 0] - points[b, 0]
    y = points[a, 1] - points[b, 1]
    z = points[a, 2] - points[b, 2]
    return x * x + y * y + z * z <= limit


@njit(cache=True)
def _count_near(axes: Any, a: int, begin: int, end: int, limit: float) -> int:
    """Count the sorted points from ``begin`` to ``end`` that are at most eps from point a."""
    x, y, z = axes
    own_x, own_y, own_z = x[a], y[a], z[a]
    found = 0
    for b in range(begin, end):
        along_x, along_y, along_z = own_x - x[b], own_y - y[b], own_z - z[b]
        found += along_x * along_x + along_y * along_y + along_z * along_z <= limit
    return found


@njit(cache=True)
def _core_points(cells: Cells, steps: Any, limit: float, wanted: int) -> Any:
    """Tell of each sorted point whether it is a core point.

    The cells within reach in one row are neighbours in the order of the points, the point's
    own among them; most points know after the nearest rows, so that others are not looked up.
    """
    points, keys, starts = cells.points, cells.keys, cells.starts
    axes = (points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy())
    first = np.zeros(25, np.int64)
    begin, end = np.zeros(25, np.int64), np.zeros(25, np.int64)
    core = np.ones(len(points), np.bool_)
    for cell in range(len(keys)):
        if starts[cell + 1] - starts[cell] >= wanted:
            continue
        known = 0
        for a in range(starts[cell], starts[cell + 1]):
            found = 0
            for r in range(25):
                if r == known:
                    first[r] = advance(keys, first[r], keys[cell] + steps[r] - 2)
                    begin[r] = starts[first[r]]
                    end[r] = starts[advance(keys, first[r], keys[cell] + steps[r] + 3)]
                    known += 1
                found += _count_near(axes, a, begin[r], end[r], limit)
                if found >= wanted:
                    break
            core[a] = found >= wanted
    return core


@njit(cache=True)
def _touch(points: Any, starts: Any, core: Any, one: int, other: int, limit: float) -> bool:
    """Tell whether core points of two cells are at most eps apart."""
    for a in range(starts[one], starts[one + 1]):
        if core[a]:
            for b in range(starts[other], starts[other + 1]):
                if core[b] and _near(points, a, b, limit):
                    return True
    return False


@njit(cache=True)
def _connected_cells(cells: Cells, steps: Any, core: Any, limit: float) -> Any:
    """Return the forest of cells whose core points share a cluster.

    Adjacent cells first: then most cells two steps apart are known to be connected.
    """
    keys, starts = cells.keys, cells.starts
    parents = np.arange(len(keys))
    for reach in range(1, 3):
        first = np.zeros(25, np.int64)
        for cell in range(len(keys)):
            own = root_of(parents, cell)
            for r in range(9 if reach == 1 else 25):
                if steps[r] < 0:
                    continue  # the other cell finds this one
                low = max(keys[cell] + steps[r] - reach, keys[cell] + 1)
                first[r] = advance(keys, first[r], low)
                other = first[r]
                while other < len(keys) and keys[other] <= keys[cell] + steps[r] + reach:
                    apart = own != root_of(parents, other)
                    if apart and _touch(cells.points, starts, core, cell, other, limit):
                        unite(parents, cell, other)
                        own = root_of(parents, cell)
                    other += 1
    return parents


@njit(cache=True)
def _number_clusters(cells: Cells, core: Any, parents: Any) -> Any:
    """Return the cluster of each cell with core points, -1 for the others."""
    firsts = np.full(len(parents), len(core))  # of a root: first core point of its cluster
    for cell in range(len(parents)):
        for a in range(cells.starts[cell], cells.starts[cell + 1]):
            if core[a]:
                root = root_of(parents, cell)
                firsts[root] = min(firsts[root], cells.order[a])
                break  # the points of a cell keep their order
    roots = np.flatnonzero(firsts < len(core))
    numbers = np.full(len(parents), NOISE)
    for rank, root in enumerate(roots[np.argsort(firsts[roots])]):
        numbers[root] = rank
    for cell in range(len(parents)):
        numbers[cell] = numbers[root_of(parents, cell)]
    return numbers


@njit(cache=True)
def _labels(cells: Cells, steps: Any, core: Any, parents: Any, limit: float) -> Any:
    """Return the label of each point of the caller's cloud."""
    points, keys, starts = cells.points, cells.keys, cells.starts
    numbers = _number_clusters(cells, core, parents)
    first = np.zeros(25, np.int64)
    labels = np.empty(len(points), np.intp)
    for cell in range(len(keys)):
        for a in range(starts[cell], starts[cell + 1]):
            best = numbers[cell]
            if not core[a]:
                for r in range(25):
                    first[r] = advance(keys, first[r], keys[cell] + steps[r] - 2)
                    other = first[r]
                    while other < len(keys) and keys[other] <= keys[cell] + steps[r] + 2:
                        number = numbers[other]
                        if number >= 0 and (best < 0 or number < best):
                            for b in range(starts[other], starts[other + 1]):
                                if core[b] and _near(points, a, b, limit):
                                    best = number
                                    break
                        other += 1
            labels[cells.order[a]] = best
    return labels
