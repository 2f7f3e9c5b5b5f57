"""Nearest neighbours of all points of a cloud at once.

Points are halved along the longest side of their box until few are left in a leaf. All points of a
leaf share one search: where the ball around the leaf's middle that holds k + 1 points ends, no
point of the leaf has its k-th neighbour much farther away. So the candidates of all of them are
gathered once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

LEAF = 8  # points; larger ones share more, but have more candidates for each
MARGIN = 1 + 1e-9  # of a distance, more than rounding takes away
LEAST = 1e-300  # of a squared distance, beside which what rounds to 0 is nothing


class Tree(NamedTuple):
    """Points in the order of their leaves.

    Nodes are numbered from the root, 0; those within node i are 2 i + 1 and 2 i + 2. All leaves are
    equally deep.

    Attributes
    ----------
    points
        (n, 3) in the order of the leaves.
    order
        (n,) their positions in the caller's cloud.
    starts, stops
        (nodes,) first point of each node, and the one after its last.
    boxes
        (nodes, 2, 3) lowest and highest corner of each node's points.
    """

    points: Any
    order: Any
    starts: Any
    stops: Any
    boxes: Any


class Room(NamedTuple):
    """Memory that is used again and again.

    Attributes
    ----------
    stack
        (128,) nodes to look at.
    found, places, every
        (n,), (3, n), (n,) candidates of a leaf: positions in the tree's order, places, and squared
        distances from one point of the leaf.
    squares, members
        (n + 1,) those of them that are near it.
    """

    stack: Any
    found: Any
    places: Any
    every: Any
    squares: Any
    members: Any


def nearest_neighbors(
    cloud: npt.NDArray[np.float64], k: int
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]:
    """Return the nearest points (n, k) in any order, and the squared k-th distance (n,).

    There must be more than ``k`` points; none is its own neighbour. Of equally distant points the
    first ones of the cloud count.
    """
    points = np.array(cloud, dtype=np.float64, order="C")
    levels = max(int(np.ceil(np.log2(len(points) / LEAF))), 0)
    nearest, squares = _nearest(_grown(points, levels), k)
    return np.asarray(nearest), np.asarray(squares)


@njit(cache=True)
def _grown(points: Any, levels: int) -> Tree:
    """Return the tree of points, which are put in its order."""
    order, nodes = np.arange(len(points)), 2 ** (levels + 1) - 1
    starts, stops = np.zeros(nodes, np.int64), np.full(nodes, len(points))
    boxes = np.empty((nodes, 2, 3))
    for node in range(nodes):
        start, stop = starts[node], stops[node]
        for axis in range(3):
            low, high = points[start, axis], points[start, axis]
            for a in range(start + 1, stop):
                low, high = min(low, points[a, axis]), max(high, points[a, axis])
            boxes[node, 0, axis], boxes[node, 1, axis] = low, high
        if 2 * node + 2 < nodes:
            middle = (start + stop) // 2
            longest = int(np.argmax(boxes[node, 1] - boxes[node, 0]))
            _halve(points, order, (start, stop, middle), longest)
            starts[2 * node + 1], stops[2 * node + 1] = start, middle
            starts[2 * node + 2], stops[2 * node + 2] = middle, stop
    return Tree(points, order, starts, stops, boxes)


@njit(cache=True)
def _halve(points: Any, order: Any, piece: tuple[int, int, int], axis: int) -> None:
    """Put what is lower along an axis before the middle of a piece: start, stop and middle."""
    left, right, middle = piece[0], piece[1] - 1, piece[2]
    while left < right:
        pivot, i, j = points[(left + right) // 2, axis], left, right
        while i <= j:
            while points[i, axis] < pivot:
                i += 1
            while points[j, axis] > pivot:
                j -= 1
            if i <= j:
                for c in range(3):
                    points[i, c], points[j, c] = points[j, c], points[i, c]
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
        if middle <= j:
            right = j
        elif middle >= i:
            left = i
        else:
            return


@njit(cache=True)
def _select(values: Any, members: Any, count: int, k: int) -> float:
    """Return the k-th smallest of the first values, from 0; no later one is smaller then.

    Values and their members are put in this order.
    """
    left, right = 0, count - 1
    while left < right:
        pivot, i, j = values[(left + right) // 2], left, right
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                members[i], members[j] = members[j], members[i]
                i, j = i + 1, j - 1
        if k <= j:
            right = j
        elif k >= i:
            left = i
        else:
            break
    return float(values[k])


@njit(cache=True)
def _apart(one: Any, other: Any) -> float:
    """Return the distance of two places, rounded up."""
    x, y, z = one[0] - other[0], one[1] - other[1], one[2] - other[2]
    return float(np.sqrt(x * x + y * y + z * z) * MARGIN)


@njit(cache=True)
def _gather(tree: Tree, middle: Any, reach: float, room: Room) -> int:
    """Write the points of all leaves within reach of a place; return their number."""
    stack, found, places = room.stack, room.found, room.places
    count, waiting, limit = 0, 1, reach * reach * MARGIN + LEAST
    stack[0] = 0
    while waiting:
        waiting -= 1
        node, apart = stack[waiting], 0.0
        for axis in range(3):
            below, above = tree.boxes[node, 0, axis], tree.boxes[node, 1, axis]
            out = max(below - middle[axis], middle[axis] - above, 0.0)
            apart += out * out
        if apart > limit:
            continue
        if 2 * node + 2 < len(tree.starts):
            stack[waiting], stack[waiting + 1] = 2 * node + 1, 2 * node + 2
            waiting += 2
            continue
        for a in range(tree.starts[node], tree.stops[node]):
            found[count] = a
            for axis in range(3):
                places[axis, count] = tree.points[a, axis]
            count += 1
    return count


@njit(cache=True)
def _holding(tree: Tree, leaf: int, k: int, middle: Any, room: Room) -> float:
    """Return a distance from the middle of a leaf within which are more than k points."""
    node = leaf
    while tree.stops[node] - tree.starts[node] <= k:
        node = (node - 1) // 2
    squares, farthest = room.squares, tree.stops[node] - tree.starts[node]
    for i in range(farthest):
        away = _apart(tree.points[tree.starts[node] + i], middle)
        squares[i] = away
    return _select(squares, room.members, farthest, k)


@njit(cache=True)
def _near(place: Any, count: int, limit: float, room: Room) -> int:
    """Write squared distances of candidates within a limit, and which; return their number."""
    xs, ys, zs = room.places[0, :count], room.places[1, :count], room.places[2, :count]
    squares, every, members, near = room.squares, room.every, room.members, 0
    place_x, place_y, place_z = place[0], place[1], place[2]
    for i in range(count):
        x, y, z = place_x - xs[i], place_y - ys[i], place_z - zs[i]
        every[i] = x * x + y * y + z * z
    for i in range(count):
        squares[near], members[near] = every[i], room.found[i]
        near += every[i] <= limit
    return near


@njit(cache=True)
def _nearest(tree: Tree, k: int) -> tuple[Any, Any]:
    """Return the nearest points and the squared k-th distance of each, in the caller's order.

    If p has k neighbours within a distance, q has as many within that and the distance of p and q.
    So each point tells the next one how far to look.
    """
    points, order, size = tree.points, tree.order, len(tree.points)
    nearest, kth = np.empty((size, k), np.int32), np.empty(size)
    room = Room(
        np.empty(128, np.int64),
        np.empty(size, np.int64),
        np.empty((3, size)),
        np.empty(size),
        np.empty(size + 1),
        np.empty(size + 1, np.int64),
    )
    last, known = 0, np.inf
    for leaf in range(len(tree.starts) // 2, len(tree.starts)):
        middle = (tree.boxes[leaf, 0] + tree.boxes[leaf, 1]) / 2
        holding, reach = _holding(tree, leaf, k, middle, room), 0.0
        for a in range(tree.starts[leaf], tree.stops[leaf]):
            away = _apart(points[a], middle)
            reach = max(reach, away + min(known + _apart(points[a], points[last]), holding + away))
        count = _gather(tree, middle, reach * MARGIN, room)
        for a in range(tree.starts[leaf], tree.stops[leaf]):
            within = min(
                known + _apart(points[a], points[last]), holding + _apart(points[a], middle)
            )
            near = _near(points[a], count, within * within * MARGIN + LEAST, room)
            for i in range(near):
                if room.members[i] == a:
                    room.squares[i] = -1.0  # itself comes first
            kth[order[a]] = _select(room.squares, room.members, near, k)
            last, known = a, np.sqrt(kth[order[a]]) * MARGIN
            _write(room, a, near, order, nearest[order[a]])
    return nearest, kth


@njit(cache=True)
def _write(room: Room, a: int, near: int, order: Any, row: Any) -> None:
    """Write the k nearest of selected candidates; of equally far ones the first."""
    squares, members, k, count = room.squares, room.members, len(row), 0
    for i in range(k + 1):
        if members[i] != a:
            row[count] = order[members[i]]
            count += 1
    limit, equal = squares[k], 0
    for i in range(k + 1, near):
        equal += squares[i] == limit
    if equal:
        closer = members[: k + 1][(squares[: k + 1] < limit) & (members[: k + 1] != a)]
        row[: len(closer)] = order[closer]
        ties = order[members[:near][squares[:near] == limit]]
        row[len(closer) :] = np.sort(ties)[: k - len(closer)]
