"""Sums over all joint events without listing them (thesis, Eq. 2.64).

Tracks and detections leave the graph of gated pairs one by one, in the order of a
`kilnflight.association.elimination.Plan`. A table holds, for each set of frontier vertices
that are already matched, the summed weight of the events so far. Taking out a vertex leaves
it unmatched or matches it with one of its remaining neighbours. A pass forwards and one
backwards give the probability of every edge. No number is ever subtracted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from kilnflight.association.elimination import Plan, states


@njit(cache=True)
def _forwards(plan: Plan, step: int, alone: float, before: Any, after: Any) -> None:
    """Fill the table after a step from the one before, scaled to a largest entry of 1."""
    bit, first, last = plan.bit[step], plan.starts[step], plan.starts[step + 1]
    after[:] = 0.0
    for state in range(1 << plan.kept[step]):
        free = state
        if bit >= 0:
            free = ((state >> bit) << (bit + 1)) | (state & ((1 << bit) - 1))
            after[state] += before[free | (1 << bit)]
        value = before[free]
        if value == 0.0:
            continue  # no event leads here
        after[state] += alone * value
        for edge in range(first, last):
            taken = 1 << plan.edges[edge, 1]
            if not state & taken:
                after[state | taken] += plan.weights[edge] * value
    after /= after.max()


@njit(cache=True)
def _backwards(
    plan: Plan, step: int, alone: float, before: Any, rest: Any, rest_before: Any, chances: Any
) -> float:
    """Fill ``rest_before`` from ``rest``: the weight of all that follows a state.

    Writes the probability of each of the step's edges to ``chances`` and returns that of
    its vertex being left alone.
    """
    bit, first, last = plan.bit[step], plan.starts[step], plan.starts[step + 1]
    left_alone = total = 0.0
    for state in range(1 << plan.kept[step]):
        free = state
        if bit >= 0:
            free = ((state >> bit) << (bit + 1)) | (state & ((1 << bit) - 1))
            rest_before[free | (1 << bit)] = rest[state]
            total += before[free | (1 << bit)] * rest[state]
        value = before[free]
        if value == 0.0:
            rest_before[free] = 0.0
            continue
        ahead = alone * rest[state]
        left_alone += value * ahead
        for edge in range(first, last):
            taken = 1 << plan.edges[edge, 1]
            if not state & taken:
                matched = plan.weights[edge] * rest[state | taken]
                chances[edge] += value * matched
                ahead += matched
        rest_before[free] = ahead
        total += value * ahead
    for edge in range(first, last):
        chances[edge] /= total
    rest_before /= rest_before.max()
    return left_alone / total


@njit(cache=True)
def sum_events(plan: Plan, alone: Any, tracks: int, weights: Any) -> None:
    """Write the probability of every pair and miss to ``weights`` (tracks, 1 + detections).

    ``alone`` is the factor of each vertex that is left unmatched.
    """
    tables = np.empty(int(states(plan)))
    offsets = np.empty(len(plan.vertex) + 1, np.int64)
    widest = plan.width.max() if len(plan.width) else 0
    rest, spare = np.empty(1 << widest), np.empty(1 << widest)
    chances = np.zeros(len(plan.weights))
    begin = 0
    for end in range(len(plan.vertex)):
        if end == begin:
            offsets[begin] = 0
            tables[0] = 1.0
        middle = offsets[end] + (1 << plan.width[end - 1] if end > begin else 1)
        offsets[end + 1] = middle
        after = tables[middle : middle + (1 << plan.width[end])]
        _forwards(plan, end, alone[plan.vertex[end]], tables[offsets[end] : middle], after)
        if plan.width[end] > 0:
            continue
        rest[0] = 1.0
        for step in range(end, begin - 1, -1):
            vertex = plan.vertex[step]
            size = offsets[step + 1] - offsets[step]
            before = tables[offsets[step] : offsets[step + 1]]
            follows = rest[: 1 << plan.width[step]]
            unmatched = _backwards(
                plan, step, alone[vertex], before, follows, spare[:size], chances
            )
            if vertex < tracks:
                weights[vertex, 0] = unmatched
            for edge in range(plan.starts[step], plan.starts[step + 1]):
                other = plan.edges[edge, 0]
                weights[min(vertex, other), 1 + max(vertex, other) - tracks] = chances[edge]
            rest, spare = spare, rest
        begin = end + 1
