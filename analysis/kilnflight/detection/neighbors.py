"""The k nearest neighbours of every point of a cloud, exactly, from cells of growing side."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.checks import InputError
from kilnflight.detection.cells import Cells, advance, rows_around, sort_into_cells

_BRUTE = 30_000_000  # distances that may as well be computed at once
_GROWTH = 1.7  # of the side from one round to the next
_EAGER = 0.6  # side at which a point is tried again, as a share of the expected distance


class Neighbors(NamedTuple):
    """The nearest neighbours of n points, each without itself.

    Attributes
    ----------
    indices
        (n, k) in no particular order; of equally distant points the first ones of the cloud.
    squares
        (n,) squared distance to the k-th. While it is looked for: minus the side of cells
        that is worth a try.
    """

    indices: npt.NDArray[np.int32]
    squares: npt.NDArray[np.float64]


def nearest_neighbors(points: npt.NDArray[np.float64], k: int, where: str) -> Neighbors:
    """Return the ``k`` nearest other points of each of (n, 3) finite points.

    A point whose cell and the 26 around it hold k others within the distance to their
    outer walls is settled; the others wait for the next round, with larger cells.

    Raises
    ------
    InputError
        If there are not more than ``k`` points.
    """
    count = len(points)
    if count <= k:
        raise InputError(f"{where}: {count} points have no {k} neighbours; lower k.")
    found = Neighbors(np.empty((count, k), np.int32), np.empty(count))
    low, longest = points.min(axis=0), float(np.ptp(points, axis=0).max())
    side = _first_side(points, k, longest, where)
    waiting = count
    found.squares[:] = -max(side, np.finfo(np.float64).tiny)  # below 0: waits
    while waiting:
        last = waiting * count < _BRUTE or not 0 < side < longest
        side = max(2.0 * longest, 1.0) if last else side
        cells = sort_into_cells(points, side, 1, where)
        steps = rows_around(cells.layer, cells.row, 1)
        _settle(cells, steps, low, side, last, *found)
        waiting = int(np.count_nonzero(found.squares < 0))
        side *= _GROWTH
    return found


def _first_side(points: npt.NDArray[np.float64], k: int, longest: float, where: str) -> float:
    """Return a side whose cells hold, seen from their points, at most k / 4 on average."""
    side = longest / 100
    while side > longest / 1e6:
        starts = sort_into_cells(points, side, 1, where).starts
        if (np.diff(starts) ** 2.0).sum() <= len(points) * max(k / 4, 2.0):
            break
        side /= 2
    return side


@njit(cache=True)
def _settle(
    cells: Cells, steps: Any, low: Any, side: float, last: bool, indices: Any, squares: Any
) -> None:
    """Find the neighbours of waiting points where the cells around them are sure to hold all."""
    keys, starts, k = cells.keys, cells.starts, indices.shape[1]
    first, ranges = np.zeros(9, np.int64), np.empty((9, 2), np.int64)
    near, place = np.empty(len(squares)), np.empty(len(squares), np.int64)
    for cell in range(len(keys)):
        around = 0
        for r in range(9):
            first[r] = advance(keys, first[r], keys[cell] + steps[r] - 1)
            ranges[r, 0] = starts[first[r]]
            ranges[r, 1] = starts[advance(keys, first[r], keys[cell] + steps[r] + 2)]
            around += ranges[r, 1] - ranges[r, 0]
        if around <= 2 * k and not last:
            continue  # hardly ever enough
        for a in range(starts[cell], starts[cell + 1]):
            i = cells.order[a]
            if squares[i] < 0 and (last or -squares[i] <= side):
                limit = np.inf if last else _wall(cells.points[a], low, side)
                others = _within(cells.points, ranges, a, limit, near, place)
                if others >= k:
                    squares[i] = _smallest(near, place, others, cells.order, indices[i])
                else:  # on a surface the k-th is expected at this distance
                    squares[i] = -_EAGER * np.sqrt(limit * k / max(others, 1))


@njit(cache=True)
def _wall(point: Any, low: Any, side: float) -> float:
    """Return the squared distance to the nearest outer wall of the 27 cells, rounded down."""
    nearest = side
    for axis in range(3):
        inside = (point[axis] - low[axis]) / side
        inside -= np.floor(inside)
        nearest = min(nearest, side * min(inside, 1.0 - inside))
    return ((side + nearest) * (1 - 1e-8)) ** 2


@njit(cache=True)
def _within(points: Any, ranges: Any, a: int, limit: float, near: Any, place: Any) -> int:
    """Collect the points at most ``limit`` (squared) from point ``a``; return how many."""
    found = 0
    for r in range(len(ranges)):
        for b in range(ranges[r, 0], ranges[r, 1]):
            x = points[a, 0] - points[b, 0]
            y = points[a, 1] - points[b, 1]
            z = points[a, 2] - points[b, 2]
            near[found] = x * x + y * y + z * z
            place[found] = b
            found += near[found] <= limit and b != a
    return found


@njit(cache=True)
def _select(near: Any, place: Any, count: int, k: int) -> None:
    """Move the ``k`` smallest of ``count`` distances to the front, the largest of them last.

    Hoare's selection: each round keeps the part that holds rank k.
    """
    low, high = 0, count - 1
    while low < high:
        pivot = near[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while near[i] < pivot:
                i += 1
            while near[j] > pivot:
                j -= 1
            if i <= j:
                near[i], near[j] = near[j], near[i]
                place[i], place[j] = place[j], place[i]
                i += 1
                j -= 1
        if k - 1 <= j:
            high = j
        elif k - 1 >= i:
            low = i
        else:
            return


@njit(cache=True)
def _smallest(near: Any, place: Any, count: int, order: Any, chosen: Any) -> float:
    """Choose the smallest of ``count`` squared distances; return the largest chosen one."""
    k = len(chosen)
    _select(near, place, count, k)
    largest = near[k - 1]
    ties = False
    for i in range(k, count):
        ties |= near[i] == largest
    if not ties:
        for i in range(k):
            chosen[i] = order[place[i]]
        return largest
    smaller, equal = 0, np.empty(count, order.dtype)
    same = 0
    for i in range(count):
        if near[i] < largest:
            chosen[smaller] = order[place[i]]
            smaller += 1
        elif near[i] == largest:
            equal[same] = order[place[i]]
            same += 1
    first = np.sort(equal[:same])
    for i in range(smaller, k):
        chosen[i] = first[i - smaller]
    return largest
