"""Points sorted into cubic cells, so that neighbours are found in adjacent cells only.

Cells are numbered along z, then y, then x, with empty cells after each row and each layer:
the cells within a few steps along z of a cell, in any row around it, then have consecutive
numbers, and the occupied ones of them are consecutive entries of `Cells.keys`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.checks import InputError, check_finite, check_shape

NOISE = -1
LARGEST = 2_000_000  # cells per axis whose numbers fit 63 bits and whose borders stay exact
FARTHEST = 1e100  # mm; squares of distances stay finite
_BITS = 13  # of a key per pass of the radix sort
_DIGITS = 1 << _BITS


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
    layer, row
        Steps in the number of a cell for one step along x and along y.
    """

    order: npt.NDArray[np.int64]
    points: npt.NDArray[np.float64]
    keys: npt.NDArray[np.int64]
    starts: npt.NDArray[np.int64]
    layer: int
    row: int


def check_points(points: npt.ArrayLike, where: str) -> npt.NDArray[np.float64]:
    """Return (n, 3) finite points as float64, or raise an `InputError`."""
    cloud = np.ascontiguousarray(check_finite(points, where))
    if cloud.size == 0 and cloud.ndim < 2:
        return np.empty((0, 3))
    check_shape(cloud, (None, 3), where)
    if cloud.size and max(cloud.max(), -cloud.min()) > FARTHEST:
        raise InputError(f"{where}: coordinates beyond {FARTHEST:g} mm. Remove such points.")
    return cloud


def sort_into_cells(points: npt.NDArray[np.float64], side: float, reach: int, where: str) -> Cells:
    """Return the points sorted into cubes of ``side``, counted from the smallest x, y and z.

    Parameters
    ----------
    points
        (n, 3), at least one.
    side
        In the unit of the points.
    reach
        Steps to the farthest neighbour cell that is asked for: so many cells after each
        row and layer stay empty.
    where
        What to call the points in an error.

    Raises
    ------
    InputError
        If the cloud is more than two million cells long.
    """
    low, high = _bounds(points)
    extent = float((high - low).max())
    if not extent <= side * LARGEST:
        raise InputError(
            f"{where}: a cloud of {extent:.3g} mm has more than {LARGEST} cells of {side:.3g} mm "
            "along an axis. Remove far points or take larger cells."
        )
    along = ((high - low) / side).astype(np.int64) + 1 + reach
    row, layer = int(along[2]), int(along[1] * along[2])
    keys = _number(points, low, side, layer, row)
    keys, order = _radix_sort(keys, layer * int(along[0]))
    sorted_points, occupied, starts = _gather(points, keys, order)
    return Cells(order, sorted_points, occupied, starts, layer, row)


def rows_around(layer: int, row: int, reach: int) -> npt.NDArray[np.int64]:
    """Return the steps from a cell to the rows at most ``reach`` away, the nearest first."""
    along = np.arange(-reach, reach + 1)
    squares = (along.reshape(-1, 1) ** 2 + along.reshape(1, -1) ** 2).ravel()
    steps = (along.reshape(-1, 1) * layer + along.reshape(1, -1) * row).ravel()
    return np.asarray(steps[np.argsort(squares, kind="stable")], dtype=np.int64)


@njit(cache=True)
def advance(keys: Any, start: int, wanted: int) -> int:
    """Return the first entry from ``start`` on of the ascending ``keys`` that is >= ``wanted``."""
    while start < len(keys) and keys[start] < wanted:
        start += 1
    return start


@njit(cache=True)
def root_of(parents: Any, member: int) -> int:
    """Return the member that stands for the set of ``member``, halving the way to it."""
    while parents[member] != member:
        parents[member] = parents[parents[member]]
        member = parents[member]
    return member


@njit(cache=True)
def unite(parents: Any, one: int, other: int) -> bool:
    """Join the sets of two members under the lower root; tell whether they were apart."""
    first, second = root_of(parents, one), root_of(parents, other)
    parents[max(first, second)] = min(first, second)
    return first != second


@njit(cache=True)
def roots(parents: Any) -> Any:
    """Return the root of every member."""
    found = np.empty_like(parents)
    for member in range(len(parents)):
        found[member] = root_of(parents, member)
    return found


@njit(cache=True)
def number_by_first_point(groups: Any, count: int) -> Any:
    """Return labels 0, 1, ... in the order of the first point; groups below 0 are noise.

    ``groups`` holds numbers below ``count``.
    """
    numbers = np.full(count, NOISE)
    labels = np.full(len(groups), NOISE, np.intp)
    found = 0
    for i in range(len(groups)):
        if groups[i] >= 0:
            if numbers[groups[i]] == NOISE:
                numbers[groups[i]] = found
                found += 1
            labels[i] = numbers[groups[i]]
    return labels


@njit(cache=True)
def _bounds(points: Any) -> Any:
    """Return the smallest and the largest x, y and z."""
    low, high = points[0].copy(), points[0].copy()
    for i in range(len(points)):
        for axis in range(3):
            low[axis] = min(low[axis], points[i, axis])
            high[axis] = max(high[axis], points[i, axis])
    return low, high


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
    """Return the sorted ``keys``, all in [0, bound], and their stable order."""
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
    """Return the sorted points, the occupied cells and where they start."""
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
