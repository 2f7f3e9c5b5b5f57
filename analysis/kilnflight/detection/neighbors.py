"""The k nearest neighbours of every point of a cloud, exactly, from cells of growing side."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.checks import InputError
from kilnflight.detection.cells import Cells, advance, rows_around, sort_into_cells

_BRUTE = 3_000_000  # distances that may as well be computed at once
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
    """Return a side whose cells hold, seen from their points, at most k / 2 on average."""
    side = longest / 100
    while side > longest / 1e6:
        starts = sort_into_cells(points, side, 1, where).starts
        if (np.diff(starts) ** 2.0).sum() <= len(points) * max(k / 2, 2.0):
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
    around = np.empty((3, len(squares)))
    distances, near = np.empty(len(squares)), np.empty((4, len(squares)))
    entries, place = np.empty(len(squares), np.int64), np.empty(len(squares), np.int64)
    for cell in range(len(keys)):
        count = 0
        for r in range(9):
            first[r] = advance(keys, first[r], keys[cell] + steps[r] - 1)
            ranges[r, 0] = starts[first[r]]
            ranges[r, 1] = starts[advance(keys, first[r], keys[cell] + steps[r] + 2)]
            count += ranges[r, 1] - ranges[r, 0]
        if count <= 2 * k and not last:
            continue  # hardly ever enough
        gathered = False
        for a in range(starts[cell], starts[cell + 1]):
            i = cells.order[a]
            if squares[i] < 0 and (last or -squares[i] <= side):
                if not gathered:  # the points of a cell share them
                    _gather(cells.points, ranges, around, entries)
                    gathered = True
                _measure(around, count, cells.points[a], distances)
                limit = np.inf if last else _wall(cells.points[a], low, side)
                others = _within(distances, entries, count, a, limit, near[0], place)
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
def _gather(points: Any, ranges: Any, around: Any, entries: Any) -> None:
    """Copy the points of some ranges side by side, so that `_measure` runs through them."""
    count = 0
    for r in range(len(ranges)):
        for b in range(ranges[r, 0], ranges[r, 1]):
            for axis in range(3):
                around[axis, count] = points[b, axis]
            entries[count] = b
            count += 1


@njit(cache=True)
def _measure(around: Any, count: int, point: Any, distances: Any) -> None:
    """Write the squared distance of ``count`` points to one; nothing else, so it vectorises."""
    xs, ys, zs = around[0, :count], around[1, :count], around[2, :count]
    for i in range(count):
        x, y, z = point[0] - xs[i], point[1] - ys[i], point[2] - zs[i]
        distances[i] = x * x + y * y + z * z


@njit(cache=True)
def _within(
    distances: Any, entries: Any, count: int, a: int, limit: float, near: Any, place: Any
) -> int:
    """Collect the points nearer than ``limit`` (squared) to point ``a``; return how many."""
    found = 0
    for i in range(count):
        near[found], place[found] = distances[i], entries[i]
        found += (distances[i] < limit) & (entries[i] != a)
    return found


@njit(cache=True)
def _kth(near: Any, count: int, k: int) -> float:
    """Return the k-th smallest of the first ``count`` distances in the first of four rows.

    Each round keeps the part that holds rank k, from one row to two others; it is written
    without asking, as a branch would be guessed wrong every other time.
    """
    here = 0
    while True:
        less, more = here % 3 + 1, (here + 1) % 3 + 1
        pivot, low, high = near[here, count // 2], 0, 0
        for i in range(count):
            value = near[here, i]
            near[less, low], near[more, high] = value, value
            low += value < pivot
            high += value > pivot
        if k <= low:
            here, count = less, low
        elif k > count - high:
            here, count, k = more, high, k - (count - high)
        else:
            return pivot


@njit(cache=True)
def _smallest(near: Any, place: Any, count: int, order: Any, chosen: Any) -> float:
    """Choose the points of the smallest distances; return the largest chosen one.

    The first row of ``near`` holds ``count`` squared distances, the others are for `_kth`;
    of equal distances the first points of the cloud are chosen.
    """
    k = len(chosen)
    largest = _kth(near, count, k)
    smaller = same = 0
    for i in range(count):
        chosen[smaller] = order[place[i]]
        smaller += near[0, i] < largest
        place[same] = place[i]
        same += near[0, i] == largest
    if smaller + same > k:
        chosen[smaller:] = np.sort(order[place[:same]])[: k - smaller]
    else:
        for i in range(same):
            chosen[smaller + i] = order[place[i]]
    return largest
