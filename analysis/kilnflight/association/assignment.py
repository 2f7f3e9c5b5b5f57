"""Cheapest assignment of tracks to detections, and its prices (Kuhn-Munkres, section 2.3.2)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True)
def assign(cost: Any, missed: Any) -> Any:
    """Return the cheapest assignment in which a row takes one column or stays without.

    Rows are added one by one along the cheapest augmenting path. A path ends at a free
    column or at a row that is given up, so clusters that share no column never meet, and
    a row that nobody competes with costs one look at its columns.

    Parameters
    ----------
    cost
        (n, m) float64; inf where a pair is impossible.
    missed
        (n,) float64, cost of a row that stays without; inf where it must take a column.

    Returns
    -------
    column_of
        (n,) column of each row, -1 without. At equal cost a row takes a column rather
        than none, and the first one.
    row_price, column_price
        Dual prices (n,) and (m,): every pair costs at least the sum of its two prices, a
        row without at least its price, and column prices are 0 or below; all three are
        equalities in the assignment returned (unused columns have price 0).
    stuck
        The first row for which no assignment exists, -1 if all is well.
    """
    rows, columns = cost.shape
    column_of = np.full(rows, -1)
    row_of = np.full(columns, -1)
    row_price = np.zeros(rows)
    column_price = np.zeros(columns)
    distance = np.empty(columns)
    origin = np.empty(columns, np.int64)
    scanned = np.empty(columns, np.bool_)
    for start in range(rows):
        # First edges may be of any sign: every path has exactly one, so its order holds.
        length, end, given_up = _shortest_path(
            start, cost, missed, row_price, column_price, row_of, distance, origin, scanned
        )
        if not length < np.inf:
            return column_of, row_price, column_price, start
        row_price[start] += length
        for column in range(columns):
            if scanned[column] and row_of[column] >= 0:
                row_price[row_of[column]] += length - distance[column]
                column_price[column] -= length - distance[column]
        if end < 0:
            end = column_of[given_up]
            column_of[given_up] = -1
            if given_up == start:
                continue
        row = -1
        while row != start:
            row = origin[end]
            row_of[end] = row
            column_of[row], end = end, column_of[row]
    return column_of, row_price, column_price, -1


@njit(cache=True)
def _shortest_path(
    start: int,
    cost: Any,
    missed: Any,
    row_price: Any,
    column_price: Any,
    row_of: Any,
    distance: Any,
    origin: Any,
    scanned: Any,
) -> Any:
    """Return length of the path, the free column at its end, or -1 and the row given up."""
    distance[:] = np.inf
    scanned[:] = False
    row, length = start, 0.0
    shortest_exit, given_up = np.inf, -1
    while True:
        leave = length + missed[row] - row_price[row]
        if leave < shortest_exit:
            shortest_exit, given_up = leave, row
        best, nearest = np.inf, -1
        for column in range(len(distance)):
            if scanned[column]:
                continue
            reach = length + cost[row, column] - row_price[row] - column_price[column]
            if reach < distance[column]:
                distance[column] = reach
                origin[column] = row
            if distance[column] < best:
                best, nearest = distance[column], column
        if nearest < 0 or shortest_exit < best:
            return shortest_exit, -1, given_up
        scanned[nearest] = True
        length = best
        row = row_of[nearest]
        if row < 0:
            return length, nearest, -1
