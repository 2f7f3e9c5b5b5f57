"""Density-based clusters of a point cloud (thesis, section 2.2.4).

Points are sorted into cubic cells, so that neighbours are found in adjacent cells only.
Cells are numbered along z, then y, then x, with empty cells after each row and each
layer. So a cell and those within a few steps along z have consecutive numbers, in any
row around. The occupied ones are consecutive entries of `_Cells.keys`.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from kilnflight.arrays import Array, ArrayLike, Flags, Index, Whole
from kilnflight.checks import (
    Count,
    InputError,
    Positive,
    Settings,
    check_finite,
    check_number,
)
from kilnflight.compiled import compiled
from kilnflight.detection.disjoint import find_root, unite

NOISE = -1
# Cells per axis whose numbers fit 63 bits and whose borders stay exact.
_LARGEST = 2_000_000
_REACH = 2  # cells between points that are within eps
_ROWS = 25  # rows of cells within `_REACH`, 5 x 5
_ADJACENT_ROWS = 9  # the first of them: a cell's own row and those that touch it


class DBSCAN(Settings):
    """Cluster points that reach each other through core points.

    A core point has at least ``min_points`` points, itself included, within ``eps``.
    Core points within ``eps`` of each other share a cluster. Another point within
    ``eps`` of a core point is a border point of its cluster; the rest is noise.

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
    The thesis asks for "more than minPts" points, the query point among them. But it
    also calls a point core when the distance to its minPts-th neighbour, itself
    included, is at most eps. The second is Ester's and scikit-learn's definition and is
    taken. A border point of several clusters goes to the first of them, in the order of
    the points.

    Section 5.1.3 removes the kiln's wall by a pass of its own, "with the highest
    precision", minPts 10 and eps 50 mm. By Table 5.8 the most precise set is 15 and 70
    mm. The second pass takes 10 and 15 mm. Sources: section 2.2.4 and Table 5.8,
    thesis.

    `sklearn.cluster.DBSCAN` gives the same labels. On the 187,000 points of a frame,
    both passes take it 91 times as long (benchmarks.csv): it lists every pair of
    neighbours, here most cells are decided as a whole.

    Examples
    --------
    >>> line = [[0, 0, 0], [9, 0, 0], [18, 0, 0], [500, 0, 0]]
    >>> DBSCAN(eps=10.0, min_points=2)(line).tolist()
    [0, 0, 0, -1]
    """

    eps: Positive = 50.0  # mm, best F1 of Table 5.8
    min_points: Count = 10  # points, best F1 of Table 5.8

    def __call__(self, points: ArrayLike) -> Index:
        """Return the cluster of each of (n, 3) points in mm; noise is -1.

        Clusters are numbered in the order of their first core point.

        Raises
        ------
        InputError
            If the points are not (n, 3) finite numbers.
        """
        cloud = check_finite(points, "DBSCAN: points", (None, 3))
        if len(cloud) == 0:
            return np.empty(0, np.intp)
        # Two points of one cell are within eps; two within eps are at most two cells
        # apart. The small margin keeps both true after rounding.
        cells = _sort_into_cells(cloud, self.eps / np.sqrt(3.0) * (1 - 1e-8))
        limit = float(self.eps * self.eps)
        core = _core_points(cells, limit, self.min_points)
        inner = _only(cells, core)
        roots = _connected_cells(inner, limit)
        first = np.full(len(roots), len(cloud))  # core point of each root's cluster
        np.minimum.at(first, roots, inner.order[inner.starts[:-1]])
        rank = np.empty_like(roots)
        rank[np.argsort(first)] = np.arange(len(roots))
        numbers = rank[roots]
        labels = np.full(len(cloud), NOISE, np.intp)
        labels[inner.order] = np.repeat(numbers, np.diff(inner.starts))
        _add_borders(cells, inner, numbers, limit, labels)
        return labels


def k_distances(points: ArrayLike, k: int) -> Array:
    """Return the distances of all points to their k-th neighbours in mm, descending.

    Their bend shows a good eps (Fig. 2.19 of the thesis). The query point counts as the
    first, as in section 2.2.4. At ``k = min_points`` the points whose distance is at
    most eps are the core points of `DBSCAN`.

    Parameters
    ----------
    points
        (n, 3) mm.
    k
        Neighbours, from 1 to n, such as 6, twice the dimension (section 2.2.4).

    Raises
    ------
    InputError
        If the points are not (n, 3) finite numbers or there are fewer than ``k`` of
        them.
    """
    cloud = check_finite(points, "k-distances: points", (None, 3))
    check_number(k, "k-distances: k", least=1, most=len(cloud) or np.inf, whole=True)
    distances = cKDTree(cloud).query(cloud, k=[int(k)])[0]
    return np.sort(np.ravel(distances))[::-1]


class _Cells(NamedTuple):
    """Points in the order of their cells.

    Attributes
    ----------
    order
        (n,) indices in the caller's cloud; within a cell ascending.
    points
        (n, 3) the points in that order, in mm.
    keys
        (m,) numbers of the occupied cells, ascending.
    starts
        (m + 1,) index in ``points`` of each occupied cell's first point; last, n.
    steps
        (25,) differences from the number of a cell to that of the cell at the same z in
        another row. The rows are the 5 x 5 within `_REACH`: first its own, then the 8
        adjacent ones.
    """

    order: Whole
    points: Array
    keys: Whole
    starts: Whole
    steps: Whole


def _sort_into_cells(points: Array, side: float) -> _Cells:
    """Return points (n, 3) sorted into cubic cells; ``side`` is a cell's in mm.

    Cells are counted from the smallest x, y and z. After each row and each layer
    `_REACH` cells stay empty, so that a step beyond an end meets no cell of the next
    one.
    """
    # Each axis has its own minimum: along narrow rows numpy is slow.
    low = np.array([axis.min() for axis in points.T])
    high = np.array([axis.max() for axis in points.T])
    if not (high - low).max() <= side * _LARGEST:
        raise InputError(
            f"DBSCAN: points: a cloud of {(high - low).max():.3g} mm has more than "
            f"{_LARGEST} cells of {side:.3g} mm along an axis. Remove far points or "
            "enlarge eps."
        )
    along = ((high - low) / side).astype(np.int64) + 1 + _REACH
    row = along[2]
    layer = along[1] * along[2]
    keys = _number(points, low, side, layer, row)
    order = _stable_order(keys)
    keys = keys.take(order)
    starts = np.flatnonzero(np.append(True, keys[1:] != keys[:-1]))
    around = np.arange(-_REACH, _REACH + 1)
    steps = np.add.outer(around * layer, around * row).ravel()
    nearest = np.argsort(np.add.outer(around**2, around**2).ravel(), kind="stable")
    return _Cells(
        order=order,
        points=points.take(order, axis=0),
        keys=keys[starts],
        starts=np.append(starts, len(keys)),
        steps=steps[nearest],
    )


def _stable_order(keys: Any) -> Any:
    """Return the stable order (n,) of keys (n,) from 0 on, by 16 bits at a time.

    numpy counts 16 bits and compares 64, which takes ten times as long.
    """
    order = np.argsort(keys.astype(np.uint16), kind="stable")
    higher = keys >> 16
    while higher.any():
        digits = higher.take(order).astype(np.uint16)
        order = order.take(np.argsort(digits, kind="stable"))
        higher = higher >> 16
    return order


@compiled
def _number(points: Any, low: Any, side: float, layer: int, row: int) -> Any:
    """Return the number (n,) of each point's cell, int64.

    ``points`` (n, 3), their smallest coordinates ``low`` (3,) and ``side`` are in mm.
    ``layer`` and ``row`` are the numbers of cells of one layer and of one row, empty
    ones included.
    """
    keys = np.empty(len(points), np.int64)
    for i in range(len(points)):
        x = np.int64((points[i, 0] - low[0]) / side)
        y = np.int64((points[i, 1] - low[1]) / side)
        keys[i] = x * layer + y * row + np.int64((points[i, 2] - low[2]) / side)
    return keys


@compiled
def _advance(keys: Any, start: int, bound: int) -> int:
    """Return the index of the first key not below ``bound``, from ``start`` on.

    ``keys`` (m,) ascend; m if all are below.
    """
    while start < len(keys) and keys[start] < bound:
        start += 1
    return start


@compiled
def _near(points: Any, a: int, low: Any, high: Any, b: int, limit: float) -> bool:
    """Return whether one of the points (n, 3) is within eps of a box.

    ``limit`` is eps^2. The box is from ``low[b]`` to ``high[b]``, (m, 3) in mm; of a
    point both are the same. The gap to a box is never larger than to a point in it,
    after rounding, too.
    """
    square = 0.0
    for axis in range(3):
        place = points[a, axis]
        gap = place - min(max(place, low[b, axis]), high[b, axis])
        square += gap * gap
    return square <= limit


@compiled
def _core_points(cells: _Cells, limit: float, min_points: int) -> Any:
    """Return whether each of ``cells.points`` is a core point, (n,).

    ``limit`` is eps^2 in mm^2. A cell with ``min_points`` points has core points only,
    as any two of its points are within eps. The cells within reach in one row are
    consecutive in the order of the points. The nearest rows decide most points, so that
    the others are not read.
    """
    keys = cells.keys
    starts = cells.starts
    steps = cells.steps
    points = cells.points
    first = np.zeros(_ROWS, np.int64)
    begin = np.zeros(_ROWS, np.int64)
    end = np.zeros(_ROWS, np.int64)
    core = np.ones(len(points), np.bool_)
    for cell in range(len(keys)):
        own = range(starts[cell], starts[cell + 1])
        if len(own) >= min_points:
            continue
        known = 0
        for a in own:
            neighbours = 0
            for r in range(_ROWS):
                if r == known:
                    first[r] = _advance(keys, first[r], keys[cell] + steps[r] - _REACH)
                    begin[r] = starts[first[r]]
                    end[r] = starts[
                        _advance(keys, first[r], keys[cell] + steps[r] + _REACH + 1)
                    ]
                    known += 1
                for b in range(begin[r], end[r]):
                    neighbours += _near(points, a, points, points, b, limit)
                    if neighbours >= min_points:
                        break
                if neighbours >= min_points:
                    break
            core[a] = neighbours >= min_points
    return core


def _only(cells: _Cells, core: Flags) -> _Cells:
    """Return the core points, marked by ``core`` (n,), in cells that are not empty."""
    sizes = np.add.reduceat(core, cells.starts[:-1], dtype=np.int64)
    kept = sizes > 0
    return _Cells(
        order=cells.order[core],
        points=cells.points.compress(core, axis=0),
        keys=cells.keys[kept],
        starts=np.concatenate([[0], np.cumsum(sizes[kept])]),
        steps=cells.steps,
    )


@compiled
def _boxes(cells: _Cells) -> Any:
    """Return the smallest and the largest x, y, z of each cell's points, (m, 3) in mm.

    Compiled: `numpy.minimum.reduceat` takes 4 ms of a frame for groups of few points.
    """
    low = np.full((len(cells.keys), 3), np.inf)
    high = np.full((len(cells.keys), 3), -np.inf)
    for cell in range(len(low)):
        for a in range(cells.starts[cell], cells.starts[cell + 1]):
            for axis in range(3):
                low[cell, axis] = min(low[cell, axis], cells.points[a, axis])
                high[cell, axis] = max(high[cell, axis], cells.points[a, axis])
    return low, high


@compiled
def _reaches(cells: _Cells, a: int, inner: _Cells, other: int, limit: float) -> bool:
    """Return whether point ``a`` is within eps of a point of the cell ``other``.

    ``a`` is an index in ``cells.points``, ``other`` one in ``inner.keys``, and
    ``limit`` is eps^2 in mm^2.
    """
    for b in range(inner.starts[other], inner.starts[other + 1]):
        if _near(cells.points, a, inner.points, inner.points, b, limit):
            return True
    return False


@compiled
def _touch(
    cells: _Cells, low: Any, high: Any, cell: int, other: int, limit: float
) -> bool:
    """Return whether a point of one cell is within eps of one of another cell.

    ``cell`` and ``other`` are indices in the keys of ``cells``, ``low`` and ``high``
    (m, 3) their `_boxes`, and ``limit`` is eps^2 in mm^2. Few points are near the
    other's box.
    """
    for a in range(cells.starts[cell], cells.starts[cell + 1]):
        near = _near(cells.points, a, low, high, other, limit)
        if near and _reaches(cells, a, cells, other, limit):
            return True
    return False


@compiled
def _connected_cells(cells: _Cells, limit: float) -> Any:
    """Return the first cell (m,) of each cell's cluster, an index in ``cells.keys``.

    Cells, of core points only, are connected where points are within eps; ``limit`` is
    eps^2 in mm^2. Adjacent cells come first, so that most cells two steps apart are
    connected already.
    """
    keys = cells.keys
    steps = cells.steps
    parents = np.arange(len(keys))
    lowest, highest = _boxes(cells)
    for reach, rows in ((1, _ADJACENT_ROWS), (_REACH, _ROWS)):
        first = np.zeros(_ROWS, np.int64)
        for cell in range(len(keys)):
            for r in range(rows):
                if steps[r] < 0:
                    continue  # the other cell finds this one
                low = max(keys[cell] + steps[r] - reach, keys[cell] + 1)
                first[r] = _advance(keys, first[r], low)
                other = first[r]
                last = keys[cell] + steps[r] + reach
                while other < len(keys) and keys[other] <= last:
                    # Most have one parent, and then one root.
                    if parents[cell] != parents[other]:
                        root = find_root(parents, cell)
                        its = find_root(parents, other)
                        if root != its and _touch(
                            cells, lowest, highest, cell, other, limit
                        ):
                            unite(parents, root, its)
                    other += 1
        for cell in range(len(keys)):
            parents[cell] = find_root(parents, cell)
    return parents


@compiled
def _add_borders(
    cells: _Cells, inner: _Cells, numbers: Any, limit: float, labels: Any
) -> None:
    """Write the clusters of border points into ``labels`` (n,), in place.

    Labels are in the order of the caller's cloud; core points have theirs. ``inner``
    are those of ``cells`` with core points, of these only, and ``numbers`` (m,) their
    clusters. ``limit`` is eps^2 in mm^2. The lowest of several clusters is taken.
    """
    keys = inner.keys
    steps = inner.steps
    first = np.zeros(_ROWS, np.int64)
    for cell in range(len(cells.keys)):
        for a in range(cells.starts[cell], cells.starts[cell + 1]):
            if labels[cells.order[a]] != NOISE:
                continue
            best = NOISE
            for r in range(_ROWS):
                first[r] = _advance(
                    keys, first[r], cells.keys[cell] + steps[r] - _REACH
                )
                last = _advance(
                    keys, first[r], cells.keys[cell] + steps[r] + _REACH + 1
                )
                for other in range(first[r], last):
                    lower = best == NOISE or numbers[other] < best
                    if lower and _reaches(cells, a, inner, other, limit):
                        best = numbers[other]
            labels[cells.order[a]] = best
