"""May two tracklets be joined, and at what cost (Eqs 4.21 to 4.24, thesis, section 4.2.3)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from kilnflight.tracklets.kinematics import (
    mean_speed,
    regularity,
    step_in_depth,
    turn,
    velocity,
)


class Limits(NamedTuple):
    """What a pair must keep to; gap, overlap and depth below, speed and regularity above.

    Attributes
    ----------
    gap
        Frames from the end of the one to the start of the other; 0: they must overlap.
    overlap
        Common frames of a pair that overlaps in time.
    distance
        Mean distance in the common frames, px; below infinity, there must be such frames.
    nested
        1 if the later tracklet may end before the earlier one does, else 0.
    angle, change, speed, regularity
        Of Eqs 4.18 and 4.15, for the connected part.
    depth
        Change of depth, mm/frame, Eq. 4.22.
    """

    gap: float
    overlap: float
    distance: float
    nested: float
    angle: float
    change: float
    speed: float
    regularity: float
    depth: float


class Weights(NamedTuple):
    """Factors a to e of Eq. 4.24."""

    angle: float
    change: float
    depth: float
    gap: float
    overlap: float


class Pool(NamedTuple):
    """Points of all tracklets; tracklet s has those from begin[s] up to end[s].

    Tracklets are in the order of their ``first`` frame; one that was joined to another
    keeps its number and has no points. The number of a joined pair is the lower of the two.
    """

    rows: Any
    frame: Any
    place: Any
    begin: Any
    end: Any
    first: Any


@njit(cache=True)
def candidates(pool: Any, changed: Any, limits: Any, weights: Any) -> Any:
    """Return the pairs that may be joined and that hold a changed tracklet.

    Returns
    -------
    tuple
        Earlier and later tracklet (p,) int64 and cost without the last term (p,) float64.

    Notes
    -----
    Eq. 4.18 sets no limit to the distance along the flight, so none is used to
    preselect: time alone does, by the sorted first frames.
    """
    earlier, later, costs = [np.int64(0)][:0], [np.int64(0)][:0], [0.0][:0]
    frame, place = np.empty(6, np.int64), np.empty((6, 3))
    for s in range(len(pool.begin)):
        if pool.begin[s] == pool.end[s]:
            continue
        last = pool.frame[pool.end[s] - 1]
        for t in range(s + 1, len(pool.begin)):
            if pool.first[t] > last and pool.first[t] - last >= limits.gap:
                break
            if pool.begin[t] == pool.end[t] or not (changed[s] or changed[t]):
                continue
            i, k = s, t
            if pool.first[s] == pool.first[t] and pool.frame[pool.end[t] - 1] < last:
                i, k = t, s
            cost = _cost(pool, i, k, limits, weights, frame, place)
            if cost < np.inf:
                earlier.append(np.int64(i))
                later.append(np.int64(k))
                costs.append(cost)
    return np.array(earlier), np.array(later), np.array(costs)


@njit(cache=True)
def _cost(pool: Any, i: int, k: int, limits: Any, weights: Any, frame: Any, place: Any) -> float:
    """Return the first five terms of Eq. 4.24; infinite where i and k may not be joined."""
    gap = pool.first[k] - pool.frame[pool.end[i] - 1]
    if pool.frame[pool.end[k] - 1] <= pool.frame[pool.end[i] - 1] and limits.nested == 0.0:
        return np.inf
    common, first, last, distance = _overlap(pool, i, k)
    if gap <= 0 and (common >= limits.overlap or distance > limits.distance):  # Eq. 4.21
        return np.inf
    if common > 0:
        count = _part(pool, i, first + 1, k, last, frame, place)
    else:
        count = _part(pool, i, first, k, last, frame, place)
    turned = _judge(frame[:count], place[:count], limits, weights)
    return turned + weights.overlap * common + weights.gap * max(gap, 0)


@njit(cache=True)
def _overlap(pool: Any, i: int, k: int) -> tuple[int, int, int, float]:
    """Return what two tracklets have in common, and where their connected part lies.

    Returns
    -------
    tuple
        Number of common frames; position in the pool of the first common point of i and of
        the last one of k; mean distance in the common frames. Without common frames: the
        end of the points of i before k begins, the first point of k after i ends, and an
        infinite distance.
    """
    one = pool.begin[i] + np.searchsorted(pool.frame[pool.begin[i] : pool.end[i]], pool.first[k])
    two, before = pool.begin[k], one
    common, first, last, total = 0, 0, 0, 0.0
    while one < pool.end[i] and two < pool.end[k]:
        if pool.frame[one] == pool.frame[two]:
            if common == 0:
                first = one
            last, common = two, common + 1
            total += math.hypot(
                pool.place[one, 0] - pool.place[two, 0], pool.place[one, 1] - pool.place[two, 1]
            )
            one, two = one + 1, two + 1
        elif pool.frame[one] < pool.frame[two]:
            one += 1
        else:
            two += 1
    if common > 0:
        return common, first, last, total / common
    end = pool.frame[pool.end[i] - 1]
    while two < pool.end[k] and pool.frame[two] <= end:
        two += 1
    return 0, before, two, np.inf


@njit(cache=True)
def _part(pool: Any, i: int, until: int, k: int, since: int, frame: Any, place: Any) -> int:
    """Fill in the connected part (Fig. 4.10): three points of i, three of k; return how many.

    A single common frame is one point, the mean of both.
    """
    count = 0
    for point in range(max(pool.begin[i], until - 3), until):
        frame[count] = pool.frame[point]
        _put(pool.place[point], place[count])
        count += 1
    for point in range(since, min(since + 3, pool.end[k])):
        if count > 0 and frame[count - 1] == pool.frame[point]:
            _put_mean(place[count - 1], pool.place[point], place[count - 1])
        else:
            frame[count] = pool.frame[point]
            _put(pool.place[point], place[count])
            count += 1
    return count


@njit(cache=True)
def _put(one: Any, place: Any) -> None:
    """Fill in a place, as much of it as is wanted; a slice assigned is slow to compile."""
    for axis in range(len(place)):
        place[axis] = one[axis]


@njit(cache=True)
def _put_mean(one: Any, two: Any, place: Any) -> None:
    """Fill in the mean of two places; what only one knows is taken from it."""
    for axis in range(len(place)):
        if np.isnan(one[axis]):
            place[axis] = two[axis]
        elif np.isnan(two[axis]):
            place[axis] = one[axis]
        else:
            place[axis] = (one[axis] + two[axis]) / 2


@njit(cache=True)
def _judge(frame: Any, place: Any, limits: Any, weights: Any) -> float:
    """Return the first three terms of Eq. 4.24; infinite where the part breaks a limit."""
    angles, changes = 0.0, 0.0
    for i in range(1, len(frame) - 1):
        before, after = velocity(frame, place, i - 1, i), velocity(frame, place, i, i + 1)
        angle, change = turn(before, after)
        if angle > limits.angle and change > limits.change:
            return np.inf
        angles, changes = angles + angle, changes + change
    if not mean_speed(frame, place) > limits.speed:
        return np.inf
    if not regularity(frame, place) > limits.regularity:
        return np.inf
    depth, largest = step_in_depth(frame, place[:, 2])
    if not largest < limits.depth:
        return np.inf
    turns = max(len(frame) - 2, 1)
    return (weights.angle * angles + weights.change * changes) / turns + weights.depth * depth


@njit(cache=True)
def merged(pool: Any, i: int, k: int) -> tuple[Any, Any, Any]:
    """Return rows, frames and places of two tracklets as one.

    In a common frame the place is the mean of both; the row is that of the first, unless
    only the second has a depth.
    """
    size = pool.end[i] - pool.begin[i] + pool.end[k] - pool.begin[k]
    rows, frame = np.empty(size, np.int64), np.empty(size, np.int64)
    place = np.empty((size, pool.place.shape[1]))
    one, two, count = pool.begin[i], pool.begin[k], 0
    while one < pool.end[i] or two < pool.end[k]:
        alone = two == pool.end[k] or (one < pool.end[i] and pool.frame[one] < pool.frame[two])
        if alone:
            source, one = one, one + 1
        elif one == pool.end[i] or pool.frame[two] < pool.frame[one]:
            source, two = two, two + 1
        else:
            blind = np.isnan(pool.place[one, 2]) and not np.isnan(pool.place[two, 2])
            source = two if blind else one
            _put_mean(pool.place[one], pool.place[two], place[count])
            rows[count], frame[count], count = pool.rows[source], pool.frame[source], count + 1
            one, two = one + 1, two + 1
            continue
        rows[count], frame[count] = pool.rows[source], pool.frame[source]
        _put(pool.place[source], place[count])
        count += 1
    return rows[:count], frame[:count], place[:count]
