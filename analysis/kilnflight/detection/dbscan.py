"""Density-based clusters of a point cloud (thesis, section 2.2.4).

Points are sorted into cubic cells, so that neighbours are found in adjacent cells only. Cells are
numbered along z, then y, then x, with empty cells after each row and each layer. So a cell and
those within a few steps along z have consecutive numbers, in any row around. The occupied ones are
consecutive entries of `Cells.keys`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from numba import njit
from scipy.spatial import cKDTree

from kilnflight.checks import InputError, check_count, check_finite, check_positive, check_shape

NOISE = -1
LARGEST = 2_000_000  # cells per axis whose numbers fit 63 bits and whose borders stay exact
FARTHEST = 1e100  # mm; squares of distances stay finite
_BITS = 13  # of a key per pass of the radix sort
_DIGITS = 1 << _BITS
REACH = 2  # cells between points that are within eps


def check_points_mm(points: npt.ArrayLike, where: str) -> npt.NDArray[np.float64]:
    """Return (n, 3) finite points as float64, or raise an `InputError`."""
    cloud = np.ascontiguousarray(check_finite(points, where))
    if cloud.size == 0 and cloud.ndim < 2:
        return np.empty((0, 3))
    check_shape(cloud, (None, 3), where)
    if cloud.size and max(cloud.max(), -cloud.min()) > FARTHEST:
        raise InputError(f"{where}: coordinates beyond {FARTHEST:g} mm. Remove such points.")
    return cloud


def numbered_by_first_point(groups: npt.NDArray[np.integer]) -> npt.NDArray[np.intp]:
    """Return labels numbered in the order of their first point.

    Groups below 0 are noise.
    """
    labels = np.full(len(groups), NOISE, np.intp)
    kept = groups >= 0
    labels[kept] = pd.factorize(groups[kept])[0]
    return labels


@dataclass(frozen=True)
class DBSCAN:
    """Cluster points that reach each other through core points.

    A core point has at least ``min_points`` points, itself included, within ``eps``. Core
    points within ``eps`` of each other share a cluster. Another point within ``eps`` of a
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
    The thesis asks for "more than minPts" points, the query point among them. But it also calls a
    point core when the distance to its minPts-th neighbour, itself included, is at most eps. The
    second is Ester's and scikit-learn's definition and is taken. A border point of several
    clusters goes to the first of them, in the order of the points.

    Section 5.1.3 removes the kiln's wall by a pass of its own, "with the highest precision",
    minPts 10 and eps 50 mm. By Table 5.8 the most precise set is 15 and 70 mm. The second
    pass takes 10 and 15 mm. Sources: section 2.2.4 and Table 5.8, thesis.
    """

    eps: float = 50.0  # mm, best F1 of Table 5.8
    min_points: int = 10  # points, best F1 of Table 5.8

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
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
        cloud = check_points_mm(points, "DBSCAN: points")
        if len(cloud) == 0:
            return np.empty(0, dtype=np.intp)
        # Two points of one cell are within eps; two within eps are at most two cells apart.
        # The small margin keeps both true after rounding.
        cells = sort_into_cells(cloud, self.eps / np.sqrt(3.0) * (1 - 1e-8))
        limit = float(self.eps * self.eps)
        core = _core_points(cells, limit, int(self.min_points))
        return np.asarray(_labels(cells, core, _connected_cells(cells, core, limit), limit))


@dataclass(frozen=True)
class ScikitDBSCAN(DBSCAN):
    """Cluster points as `DBSCAN` does, with scikit-learn.

    Parameters and labels are the same. It holds the neighbours of all points at once and is far
    slower on the cloud of a frame. It checks `DBSCAN` on other data.
    """

    def __call__(self, points: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Return the cluster of each point, as `DBSCAN` does."""
        from sklearn import cluster  # slow to import, and seldom needed

        cloud = check_points_mm(points, "DBSCAN: points")
        if len(cloud) == 0:
            return np.empty(0, dtype=np.intp)
        peer = cluster.DBSCAN(eps=float(self.eps), min_samples=int(self.min_points))
        return np.asarray(peer.fit_predict(cloud), dtype=np.intp)


def k_distances(points: npt.ArrayLike, k: int = 6) -> npt.NDArray[np.float64]:
    """Return the distance of each point to its k-th neighbour.

    The distances descend, as in Fig. 2.19 of the thesis. The query point counts as the first, as
    in section 2.2.4. At ``k = min_points`` the points whose distance is at most eps are the core
    points of `DBSCAN`.

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
    cloud = check_points_mm(points, "k-distances: points")
    if k != int(k) or k < 1 or (len(cloud) and k > len(cloud)):
        raise InputError(
            f"k-distances: k is {k}, expected a whole number from 1 to the {len(cloud)} points."
        )
    if len(cloud) == 0:
        return np.empty(0)
    distances = np.asarray(cKDTree(cloud).query(cloud, k=[int(k)])[0])
    return np.sort(distances[:, 0])[::-1]


class Cells(NamedTuple):
    """Points in the order of their cells.

    Attributes
    ----------
    order
        (n,) positions in the caller's cloud; within a cell ascending.
    points
        (n, 3) the points in that order, float64.
    keys
        (m,) numbers of the occupied cells, ascending.
    starts
        (m + 1,) first point of each occupied cell.
    steps
        (25,) steps from a cell's number to the rows within reach, the nearest first.
    """

    order: npt.NDArray[np.int64]
    points: npt.NDArray[np.float64]
    keys: npt.NDArray[np.int64]
    starts: npt.NDArray[np.int64]
    steps: npt.NDArray[np.int64]


def sort_into_cells(points: npt.NDArray[np.float64], side: float) -> Cells:
    """Return points (n, 3) sorted into cubic cells.

    There must be a point. Cells are counted from the smallest x, y and z. After each row and each
    layer `REACH` cells stay empty.

    Raises
    ------
    InputError
        If the cloud is more than two million cells long.
    """
    # each axis for itself: along narrow rows numpy is slow
    low, high = (np.array([edge(axis) for axis in points.T]) for edge in (np.min, np.max))
    extent = float((high - low).max())
    if not extent <= side * LARGEST:
        raise InputError(
            f"DBSCAN: points: a cloud of {extent:.3g} mm has more than {LARGEST} cells of "
            f"{side:.3g} mm along an axis. Remove far points or take larger cells."
        )
    along = ((high - low) / side).astype(np.int64) + 1 + REACH
    row, layer = int(along[2]), int(along[1] * along[2])
    keys = _number(points, low, side, layer, row)
    keys, order = _radix_sort(keys, layer * int(along[0]))
    sorted_points, occupied, starts = _gather(points, keys, order)
    around = np.arange(-REACH, REACH + 1)
    steps = np.add.outer(around * layer, around * row).ravel()
    nearest = np.argsort(np.add.outer(around**2, around**2).ravel(), kind="stable")
    return Cells(order, sorted_points, occupied, starts, steps[nearest])


@njit(cache=True)
def advance(keys: Any, start: int, bound: int) -> int:
    """Return the index of the first of ascending ``keys`` not below a bound.

    The search begins at ``start``.
    """
    while start < len(keys) and keys[start] < bound:
        start += 1
    return start


@njit(cache=True)
def root_of(parents: Any, member: int) -> int:
    """Return the root of a member's set, halving the way to it."""
    while parents[member] != member:
        parents[member] = parents[parents[member]]
        member = parents[member]
    return member


@njit(cache=True)
def unite(parents: Any, member: int, other: int) -> bool:
    """Join two sets under the lower root; return whether they differed."""
    first, second = root_of(parents, member), root_of(parents, other)
    parents[max(first, second)] = min(first, second)
    return first != second


@njit(cache=True)
def _number(points: Any, low: Any, side: float, layer: int, row: int) -> Any:
    """Return the number of each point's cell."""
    keys = np.empty(len(points), np.int64)
    for i in range(len(points)):
        x = np.int64((points[i, 0] - low[0]) / side)
        y = np.int64((points[i, 1] - low[1]) / side)
        keys[i] = x * layer + y * row + np.int64((points[i, 2] - low[2]) / side)
    return keys


@njit(cache=True)
def _radix_sort(keys: Any, bound: int) -> Any:
    """Return keys in [0, bound] sorted, with their stable order."""
    order = np.arange(len(keys))
    other_order, other_keys = np.empty_like(order), np.empty_like(keys)
    shift = 0
    while bound >> shift:
        places = np.zeros(_DIGITS + 1, np.int64)
        for i in range(len(keys)):
            places[((keys[i] >> shift) & (_DIGITS - 1)) + 1] += 1
        places = np.cumsum(places)
        for i in range(len(keys)):
            digit = (keys[i] >> shift) & (_DIGITS - 1)
            place = places[digit]
            places[digit] = place + 1
            other_keys[place] = keys[i]
            other_order[place] = order[i]
        keys, other_keys = other_keys, keys
        order, other_order = other_order, order
        shift += _BITS
    return keys, order


@njit(cache=True)
def _gather(points: Any, keys: Any, order: Any) -> Any:
    """Return the sorted points, the occupied cells and their starts."""
    count = len(order)
    gathered = np.empty((count, 3))
    occupied, starts = np.empty(count, np.int64), np.empty(count + 1, np.int64)
    cells = 0
    for i in range(count):
        for axis in range(3):
            gathered[i, axis] = points[order[i], axis]
        if i == 0 or keys[i] != keys[i - 1]:
            occupied[cells], starts[cells] = keys[i], i
            cells += 1
    starts[cells] = count
    return gathered, occupied[:cells].copy(), starts[: cells + 1].copy()


@njit(cache=True)
def _near(points: Any, a: int, b: int, limit: float) -> bool:
    """Return whether two points are at most eps apart."""
    x = points[a, 0] - points[b, 0]
    y = points[a, 1] - points[b, 1]
    z = points[a, 2] - points[b, 2]
    return x * x + y * y + z * z <= limit


@njit(cache=True)
def _count_near(axes: Any, a: int, begin: int, end: int, limit: float) -> int:
    """Return the number of sorted points in a range within eps of point a."""
    x, y, z = axes
    point_x, point_y, point_z = x[a], y[a], z[a]
    count = 0
    for b in range(begin, end):
        along_x, along_y, along_z = point_x - x[b], point_y - y[b], point_z - z[b]
        count += along_x * along_x + along_y * along_y + along_z * along_z <= limit
    return count


@njit(cache=True)
def _core_points(cells: Cells, limit: float, min_points: int) -> Any:
    """Return whether each sorted point is a core point.

    The cells within reach in one row are consecutive in the order of the points. The nearest rows
    decide most points, so that the others are not read.
    """
    points, keys, starts, steps = cells.points, cells.keys, cells.starts, cells.steps
    axes = (points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy())
    first = np.zeros(25, np.int64)
    begin, end = np.zeros(25, np.int64), np.zeros(25, np.int64)
    core = np.ones(len(points), np.bool_)
    for cell in range(len(keys)):
        if starts[cell + 1] - starts[cell] >= min_points:
            continue
        known = 0
        for a in range(starts[cell], starts[cell + 1]):
            neighbours = 0
            for r in range(25):
                if r == known:
                    first[r] = advance(keys, first[r], keys[cell] + steps[r] - 2)
                    begin[r] = starts[first[r]]
                    end[r] = starts[advance(keys, first[r], keys[cell] + steps[r] + 3)]
                    known += 1
                neighbours += _count_near(axes, a, begin[r], end[r], limit)
                if neighbours >= min_points:
                    break
            core[a] = neighbours >= min_points
    return core


@njit(cache=True)
def _touch(points: Any, starts: Any, core: Any, cell: int, other: int, limit: float) -> bool:
    """Return whether core points of two cells are at most eps apart."""
    for a in range(starts[cell], starts[cell + 1]):
        if core[a]:
            for b in range(starts[other], starts[other + 1]):
                if core[b] and _near(points, a, b, limit):
                    return True
    return False


@njit(cache=True)
def _connected_cells(cells: Cells, core: Any, limit: float) -> Any:
    """Return the forest of cells whose core points share a cluster.

    Adjacent cells come first, so that most cells two steps apart are connected already.
    """
    keys, starts, steps = cells.keys, cells.starts, cells.steps
    parents = np.arange(len(keys))
    for reach in range(1, 3):
        first = np.zeros(25, np.int64)
        for cell in range(len(keys)):
            root = root_of(parents, cell)
            for r in range(9 if reach == 1 else 25):
                if steps[r] < 0:
                    continue  # the other cell finds this one
                low = max(keys[cell] + steps[r] - reach, keys[cell] + 1)
                first[r] = advance(keys, first[r], low)
                other = first[r]
                while other < len(keys) and keys[other] <= keys[cell] + steps[r] + reach:
                    apart = root != root_of(parents, other)
                    if apart and _touch(cells.points, starts, core, cell, other, limit):
                        unite(parents, cell, other)
                        root = root_of(parents, cell)
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
def _labels(cells: Cells, core: Any, parents: Any, limit: float) -> Any:
    """Return the label of each point of the caller's cloud."""
    points, keys, starts, steps = cells.points, cells.keys, cells.starts, cells.steps
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
