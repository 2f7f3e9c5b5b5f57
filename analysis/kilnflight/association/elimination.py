"""In which order tracks and detections leave the graph of gated pairs.

A joint event is a matching of the graph whose vertices are tracks and detections and whose
edges are the gated pairs. `kilnflight.association.event_sums` takes the vertices out one by
one; its tables have one bit for each vertex of the frontier, those still in the graph that
have lost a neighbour. A good order keeps the frontier small.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

UNTOUCHED, FRONTIER, OUT = 0, 1, 2
TRIALS = 8
SMALL = 2**12  # states; summing them costs less than looking for a better order


class Graph(NamedTuple):
    """Neighbours of vertex v: ``others[starts[v]:starts[v + 1]]``, and the weights of the edges."""

    starts: Any
    others: Any
    weights: Any


class Plan(NamedTuple):
    """The order of elimination; bits number the frontier's vertices in a table's index."""

    vertex: Any  # (steps,) the vertex taken out
    bit: Any  # (steps,) its bit in the table before, -1 if it was not in the frontier
    kept: Any  # (steps,) bits of the table before that stay, its own not counted
    width: Any  # (steps,) bits of the table after; 0 ends a connected component
    starts: Any  # (steps + 1,) where a step's edges begin
    edges: Any  # (edges, 2) vertex at the other end, its bit in the table after
    weights: Any  # (edges,)


class Work(NamedTuple):
    """What planning keeps of each vertex."""

    state: Any  # UNTOUCHED, FRONTIER or OUT
    fresh: Any  # its untouched neighbours
    frontier: Any  # the frontier's vertices, in the order of their bits
    members: Any  # of the component at hand
    mark: Any  # by which search it was found last


@njit(cache=True)
def graph_of(weights: Any) -> Graph:
    """Return the graph of a matrix (tracks, detections); 0 is no edge. Tracks come first."""
    tracks, detections = weights.shape
    starts = np.zeros(tracks + detections + 1, np.int64)
    for track in range(tracks):
        for detection in range(detections):
            if weights[track, detection] > 0:
                starts[track + 1] += 1
                starts[tracks + detection + 1] += 1
    starts = np.cumsum(starts)
    fill = starts[:-1].copy()
    others = np.empty(starts[-1], np.int64)
    values = np.empty(starts[-1])
    for track in range(tracks):
        for detection in range(detections):
            if weights[track, detection] > 0:
                for one, other in ((track, tracks + detection), (tracks + detection, track)):
                    others[fill[one]] = other
                    values[fill[one]] = weights[track, detection]
                    fill[one] += 1
    return Graph(starts, others, values)


@njit(cache=True)
def _breadth_first(graph: Graph, root: int, members: Any, mark: Any, stamp: int) -> int:
    """List a root's component in ``members``, nearest first, and return its size."""
    members[0] = root
    mark[root] = stamp
    size = 1
    at = 0
    while at < size:
        vertex = members[at]
        for k in range(graph.starts[vertex], graph.starts[vertex + 1]):
            other = graph.others[k]
            if mark[other] != stamp:
                mark[other] = stamp
                members[size] = other
                size += 1
        at += 1
    return size


@njit(cache=True)
def _touch(graph: Graph, vertex: int, fresh: Any) -> None:
    """Tell the neighbours of a vertex that it is no longer untouched."""
    for k in range(graph.starts[vertex], graph.starts[vertex + 1]):
        fresh[graph.others[k]] -= 1


@njit(cache=True)
def _cheapest(graph: Graph, members: Any, state: Any, fresh: Any) -> int:
    """Return the vertex whose leaving lets the frontier grow least; the frontier's own first.

    Only vertices in the frontier or next to it, so that the tables stay about one region.
    """
    best, least = -1, np.inf
    for vertex in members:
        if state[vertex] == FRONTIER:
            growth = fresh[vertex] - 1.0
        elif state[vertex] == UNTOUCHED:
            degree = graph.starts[vertex + 1] - graph.starts[vertex]
            if fresh[vertex] == degree:
                continue
            growth = fresh[vertex] + 0.5
        else:
            continue
        if growth < least:
            best, least = vertex, growth
    return members[0] if best < 0 else best


@njit(cache=True)
def make_plan(graph: Graph) -> Plan:
    """Return an order of elimination, one connected component after the other.

    Each begins far from its first vertex; where its tables would be large, the best of
    some other beginnings is taken. A component's order does not depend on the others.
    """
    vertices = len(graph.starts) - 1
    plan = Plan(
        np.empty(vertices, np.int64),
        np.empty(vertices, np.int64),
        np.empty(vertices, np.int64),
        np.empty(vertices, np.int64),
        np.zeros(vertices + 1, np.int64),
        np.empty((len(graph.others) // 2, 2), np.int64),
        np.empty(len(graph.others) // 2),
    )
    work = Work(
        np.zeros(vertices, np.int64),
        graph.starts[1:] - graph.starts[:-1],
        np.empty(vertices, np.int64),
        np.empty(vertices, np.int64),
        np.full(vertices, -1),
    )
    found = np.empty(vertices, np.int64)
    step: Any = np.int64(0)  # of a plain 0, numba compiles what it is given to twice
    for seed in range(vertices):
        if work.state[seed] == OUT or graph.starts[seed] == graph.starts[seed + 1]:
            continue
        size = _breadth_first(graph, seed, found, work.mark, vertices + seed)
        best, fewest = 0, np.inf
        for trial in range(TRIALS + 1):
            # The last found is far from the seed. After all trials the best is done again.
            chosen = trial if trial < TRIALS else best
            root = found[(size - 1) * (TRIALS - chosen) // TRIALS]
            total = _plan_component(graph, root, size, plan, step, work, trial)
            if trial == 0 and total <= SMALL:
                break
            if total < fewest:
                best, fewest = chosen, total
        step += size
    return Plan(
        plan.vertex[:step],
        plan.bit[:step],
        plan.kept[:step],
        plan.width[:step],
        plan.starts[: step + 1],
        plan.edges,
        plan.weights,
    )


@njit(cache=True)
def _plan_component(
    graph: Graph, root: int, size: int, plan: Plan, step: int, work: Work, trial: int
) -> float:
    """Write the order of a root's component from ``step`` on; return the states it needs."""
    members = work.members[:size]
    stamp = (1 + trial) * 2 * len(work.mark) + root  # below are the stamps of seeds
    _breadth_first(graph, root, members, work.mark, stamp)
    for vertex in members:
        work.state[vertex] = UNTOUCHED
        work.fresh[vertex] = graph.starts[vertex + 1] - graph.starts[vertex]
    width: Any = np.int64(0)
    total = 1.0
    for k in range(size):
        vertex = _cheapest(graph, members, work.state, work.fresh)
        width = _take_out(
            graph, vertex, work.state, work.fresh, work.frontier, width, plan, step + k
        )
        total += 2.0**width
    return total


@njit(cache=True)
def _take_out(
    graph: Graph,
    vertex: int,
    state: Any,
    fresh: Any,
    frontier: Any,
    width: int,
    plan: Plan,
    step: int,
) -> int:
    """Take a vertex out, note the step in the plan, and return the frontier's new width."""
    plan.vertex[step] = vertex
    plan.bit[step] = -1
    if state[vertex] == FRONTIER:
        bit = 0
        while frontier[bit] != vertex:
            bit += 1
        plan.bit[step] = bit
        width -= 1
        for k in range(bit, width):
            frontier[k] = frontier[k + 1]
    else:
        _touch(graph, vertex, fresh)
    state[vertex] = OUT
    plan.kept[step] = width
    edge = plan.starts[step]
    for k in range(graph.starts[vertex], graph.starts[vertex + 1]):
        other = graph.others[k]
        if state[other] == OUT:
            continue
        if state[other] == UNTOUCHED:
            state[other] = FRONTIER
            frontier[width] = other
            width += 1
            _touch(graph, other, fresh)
        bit = 0
        while frontier[bit] != other:
            bit += 1
        plan.edges[edge, 0] = other
        plan.edges[edge, 1] = bit
        plan.weights[edge] = graph.weights[k]
        edge += 1
    plan.starts[step + 1] = edge
    plan.width[step] = width
    return width


@njit(cache=True)
def states(plan: Plan) -> float:
    """Return the number of states in the tables of the largest component."""
    most = total = 1.0
    for width in plan.width:
        total += 2.0**width
        most = max(most, total)
        if width == 0:
            total = 1.0
    return most
