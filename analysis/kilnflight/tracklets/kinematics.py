"""Velocities, turns and regularity of a path (Eqs 4.16, 4.17 and 4.19, thesis).

A path is its ``frame`` (n,), ascending, and its ``place`` (n, 2 or more): row, col, ...
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit


@njit(cache=True)
def velocity(frame: Any, place: Any, one: int, two: int) -> tuple[float, float]:
    """Return the velocity from one point to another in px/frame (Eq. 4.17, thesis)."""
    step = frame[two] - frame[one]
    return (place[two, 0] - place[one, 0]) / step, (place[two, 1] - place[one, 1]) / step


@njit(cache=True)
def turn(before: tuple[float, float], after: tuple[float, float]) -> tuple[float, float]:
    """Return angle in degrees and difference in px/frame of two velocities (Eq. 4.19, thesis).

    A velocity of zero has no direction: the angle is then 0.
    """
    across = before[0] * after[1] - before[1] * after[0]
    along = before[0] * after[0] + before[1] * after[1]
    change = math.hypot(after[0] - before[0], after[1] - before[1])
    if across == 0.0 and along == 0.0:  # the arctangent of 0 and -0 would be 180 degrees
        return 0.0, change
    return math.degrees(math.atan2(abs(across), along)), change


@njit(cache=True)
def mean_speed(frame: Any, place: Any) -> float:
    """Return the mean magnitude of the velocities in px/frame (Eq. 4.16, thesis).

    It is 0 for a single point.
    """
    total = 0.0
    for i in range(len(frame) - 1):
        down, right = velocity(frame, place, i, i + 1)
        total += math.hypot(down, right)
    return total / max(len(frame) - 1, 1)


@njit(cache=True)
def regularity(frame: Any, place: Any) -> float:
    """Return the correlation of a path with its second-degree polynomials row(t), col(t).

    Of least squares polynomials with a constant term, the correlation with the data, pooled
    over both centred coordinates, is the root of explained over total sum of squares. Up
    to three points it is 1, and likewise for a path that stays where it is.
    """
    count = len(frame)
    if count <= 3:
        return 1.0
    time = (frame - frame[0]) / (frame[-1] - frame[0]) - 0.5
    straight = time - time.mean()
    square = straight * straight
    bent = (
        square
        - square.mean()
        - straight * ((square * straight).sum() / (straight * straight).sum())
    )
    total, left = 0.0, 0.0
    for axis in range(2):
        centred = place[:, axis] - place[0, axis]  # exactly 0 for what does not move
        centred = centred - centred.mean()
        total += (centred * centred).sum()
        for base in (straight, bent):
            centred = centred - base * ((centred * base).sum() / (base * base).sum())
        left += (centred * centred).sum()
    if total <= 0.0:
        return 1.0
    return math.sqrt(max(1.0 - left / total, 0.0))


@njit(cache=True)
def step_in_depth(frame: Any, depth: Any) -> tuple[float, float]:
    """Return mean and largest change of depth in mm/frame (Eq. 4.23, thesis).

    Points without a depth are skipped; both are 0 where fewer than two have one.
    """
    last, count, total, largest = -1, 0, 0.0, 0.0
    for i in range(len(frame)):
        if np.isnan(depth[i]):
            continue
        if last >= 0:
            change = abs(depth[i] - depth[last]) / (frame[i] - frame[last])
            total, largest, count = total + change, max(largest, change), count + 1
        last = i
    return total / max(count, 1), largest
