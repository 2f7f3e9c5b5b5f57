r"""Data association: the detections that continue the tracks.

    gated pairs of n tracks and m detections -> associator -> weights (n, 1 + m)

=================  ==========================  ==================================
associator         equation                    default, none of them printed
=================  ==========================  ==================================
`NearestNeighbor`  sec. 2.3.2, Fig. 2.20       a_0 0, C_NA 50
`GNN`              2.49, 2.50, 4.9             a_0 0.01 per 3D point, C_NA 50
`PDA`              2.51 to 2.53, 4.10 to 4.13  P_D 0.9, a_0 0.01
`JPDA`             2.57 to 2.64, 4.10 to 4.13  P_D 0.9, a_0 0.01
=================  ==========================  ==================================

Column 0 is "missed". Rows sum to 1, of 0 and 1 (`NearestNeighbor`, `GNN`) or of probabilities.
A track with an empty gate is missed with weight 1.
"""

from __future__ import annotations

import warnings
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment
from scipy.special import softmax

from kilnflight.checks import (
    InputError,
    check_at_least,
    check_between,
    check_count,
    check_finite,
    check_inside,
    check_kind,
    check_shape,
    is_number,
)

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]

MOST_STATES = 2**25  # of the tables of one group, 8 bytes each: 20 tracks sharing 20 detections fit
MOST_STATES_JPDA = 2**20  # in a frame of a recording, for the sake of time
SMALL = 2**12  # states; summing them costs less than trying other orders


class Pairs(NamedTuple):
    """Gated pairs of the n tracks and m detections of one frame."""

    distance_squared: Array  # (n, m) squared Mahalanobis distance; inf outside the gate
    log_determinant: Array  # (n,) ln |S_i|, S_i the residual covariance in px^2 (Eq. 2.50)
    size_difference: Array  # (n, m) |N_d - N_p|, 3D points (Eq. 4.9); 0 where unknown
    gate_area: Array  # (n,) V(i), of the elliptical gate in px^2 (Eq. 4.13); a volume if d is 3
    gate_probability: float  # P_G, that a particle's detection lies in the ellipse
    dimensions: int = 2  # d, of the positions; S is (d, d)


Associator = Callable[[Pairs], Array]  # weights (tracks, 1 + detections); column 0 = missed


@dataclass(frozen=True)
class _ByCost:
    """Give each track one detection or none, by the costs of Eq. 4.9."""

    # a_0, per 3D point: 100 points weigh as one unit of squared distance. In the twin half of the
    # particles change by 7 points or less from frame to frame, one in twenty by more than 200.
    size_weight: float = 0.01
    # C_NA, cost of a missed track; pairs that cost more are impossible. It is above the gate's
    # d^2 (16) + ln|S| of a track lost for some frames (18) + a_0 times some hundred points, so the
    # gate decides.
    nonassignment_cost: float = 50.0

    def __post_init__(self) -> None:
        """Refuse parameters that are no costs."""
        where, cost = type(self).__name__, self.nonassignment_cost
        check_at_least(self.size_weight, 0, f"{where}: size_weight")
        if not is_number(cost):
            raise InputError(f"{where}: nonassignment_cost is {cost!r}, expected a finite number.")

    def _costs(self, pairs: Pairs) -> Array:
        """Return the cost (n, m) of each pair by Eq. 4.9.

        Inf outside the gate and above C_NA. Taken is ln |S| (Eq. 2.50), not ln |P| as printed.
        """
        pairs = _checked(pairs)
        costs = pairs.distance_squared + pairs.log_determinant[:, None]
        costs += self.size_weight * pairs.size_difference
        return np.where(costs > self.nonassignment_cost, np.inf, costs)


@dataclass(frozen=True)
class NearestNeighbor(_ByCost):
    """Give each track its nearest detection, whatever the others do.

    Of two tracks with the same nearest detection the nearer one takes it and the other goes
    without (Fig. 2.20, middle). At equal cost the first track and the first detection win.
    "Nearest" is the least cost of Eq. 4.9; its ln |S| keeps a wide gate from taking everything.
    """

    size_weight: float = 0.0  # section 2.3.2 knows no size

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m) of 0 and 1; column 0 = missed."""
        costs = self._costs(pairs)
        detection = np.full(len(costs), -1)
        if costs.size:
            nearest, least = costs.argmin(axis=1), costs.min(axis=1)
            order = np.argsort(least, kind="stable")  # the nearest track comes first
            order = order[np.isfinite(least[order])]
            winners = order[np.unique(nearest[order], return_index=True)[1]]
            detection[winners] = nearest[winners]
        return one_hot(detection, costs.shape[1])


@dataclass(frozen=True)
class GNN(_ByCost):
    """Find the assignment of least global cost (Eqs 2.49 and 4.9).

    A column of its own per track, which costs C_NA, gives the optimum of the thesis's square
    problem without a large C. A pair of exactly C_NA is taken.
    """

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m) of 0 and 1; column 0 = missed."""
        costs = self._costs(pairs)
        missed = np.full(len(costs), float(self.nonassignment_cost))
        return one_hot(assign(costs, missed), costs.shape[1])


@dataclass(frozen=True)
class _ByLikelihood:
    """Weight detections by the likelihoods of Eqs 4.11 to 4.13."""

    # P_D, "appropriately large": a little above the detector's recall of 0.86 (Table 5.11).
    detection_probability: float = 0.9
    size_weight: float = 0.01  # a_0 per 3D point, as of GNN

    def __post_init__(self) -> None:
        """Refuse parameters that are no probabilities."""
        where = type(self).__name__
        check_at_least(self.size_weight, 0, f"{where}: size_weight")
        # A track can always be missed, and is never only missed.
        check_inside(self.detection_probability, 0, 1, f"{where}: detection_probability")

    def _logs(self, pairs: Pairs) -> tuple[Array, Array]:
        """Return ln e_j (n, m) and ln b (n,) of Eqs 4.11 to 4.13.

        Outside the gate ln e_j is -inf. With an empty gate, a certain miss, ln b is 0.
        """
        pairs = _checked(pairs)
        log_e = -0.5 * (pairs.distance_squared + self.size_weight * pairs.size_difference)
        p_d, p_g = self.detection_probability, pairs.gate_probability
        # ln |2 pi S|^(1/2)
        log_spread = 0.5 * (pairs.dimensions * np.log(2 * np.pi) + pairs.log_determinant)
        count = np.isfinite(pairs.distance_squared).sum(axis=1)
        density = np.where(count > 0, count, 1) / pairs.gate_area
        log_b = np.log(density) + log_spread + np.log((1 - p_d * p_g) / p_d)
        return log_e, np.where(count > 0, log_b, 0.0)


@dataclass(frozen=True)
class PDA(_ByLikelihood):
    """Weight each track's detections as if it were alone (Eqs 4.10 to 4.13).

    Taken is e_j = exp(-(d^2 + a_0 |N_d - N_p|) / 2), the source's form [47]. As printed, the
    determinant enters twice, and e_j against b is not free of units. The second line of Eq. 4.10
    prints "i = 0" for no detection, j = 0. m(i) counts the whole gate, depth included.
    """

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m); rows sum to 1, column 0 = missed."""
        log_e, log_b = self._logs(pairs)
        return softmax(np.column_stack([log_b, log_e]), axis=1)


@dataclass(frozen=True)
class JPDA(_ByLikelihood):
    """Weight detections jointly: each belongs to at most one track.

    `joint_probabilities` sums over all joint events, Eq. 2.64. It warns where a group is too
    dense: more than 2^20 states (15 tracks that all share 31 detections; 0.1 s per frame). The
    weight of an event, open in section 4.1.3, is the product of e_j of its pairs and b of its
    missed tracks: `PDA` where nothing is shared.
    """

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m); rows sum to 1, column 0 = missed."""
        return _marginals(*self._logs(pairs), MOST_STATES_JPDA)


def one_hot(detection: Integers, detections: int) -> Array:
    """Return weights (n, 1 + m) of one detection per track, or none (-1)."""
    weights = np.zeros((len(detection), 1 + detections))
    weights[np.arange(len(detection)), 1 + detection] = 1.0
    return weights


def assign(cost: Array, missed: Array) -> Integers:
    """Return each track's detection (n,) at the least cost, -1: none.

    ``cost`` is (n, m), inf where a pair is impossible, ``missed`` (n,) that of a missed track.
    At equal cost a track takes the first detection rather than none (section 2.3.2).
    """
    tracks, detections = cost.shape
    alone = np.full((tracks, tracks), np.inf)
    np.fill_diagonal(alone, missed)
    column = linear_sum_assignment(np.hstack([cost, alone]))[1]
    return np.where(column < detections, column, -1)


def joint_probabilities(
    likelihood: npt.ArrayLike, nonassignment: npt.ArrayLike, most_states: int = MOST_STATES
) -> Array:
    """Return each track's probabilities over all joint events (Eq. 2.64).

    The weight of a joint event is the product of the likelihoods of its pairs and of the
    nonassignment of its missed tracks. Each detection is in at most one pair.

    Parameters
    ----------
    likelihood
        (tracks, detections), 0 outside the gate, on any scale common to a track's row.
    nonassignment
        (tracks,) weight of a track without detection; 0 if it must have one.
    most_states
        Limit of the tables of one group; above, the pairs whose events weigh least are left
        out, with a warning.

    Returns
    -------
    ndarray
        (tracks, 1 + detections); rows sum to 1, column 0 = missed.

    Raises
    ------
    InputError
        If shapes do not fit, a number is negative or not finite, or no event is possible.

    >>> joint_probabilities([[1.0], [1.0]], [1.0, 1.0]).round(3).tolist()
    [[0.667, 0.333], [0.667, 0.333]]
    """
    check_count(most_states, "joint probabilities: most_states", least=4)
    pairs = check_finite(likelihood, "likelihood")
    missed = check_finite(nonassignment, "nonassignment")
    check_shape(pairs, (None, None), "likelihood (tracks, detections)")
    check_shape(missed, pairs.shape[:1], "nonassignment, one per track")
    for name, values in (("likelihood", pairs), ("nonassignment", missed)):
        if (values < 0).any():
            index = tuple(int(i) for i in np.argwhere(values < 0)[0])
            raise InputError(
                f"{name}: {values[index]} at index {index}; likelihoods are 0 (impossible) or "
                "above. Pass likelihoods, not their logarithms."
            )
    with np.errstate(divide="ignore"):
        return _marginals(np.log(pairs), np.log(missed), most_states)


def _marginals(log_likelihood: Array, log_nonassignment: Array, most_states: int) -> Array:
    """Return `joint_probabilities` of logarithms (-inf for 0).

    Tracks and, after them, detections are vertices of a graph. ``weights`` holds its edges, the
    pairs whose detection several tracks can have, and on the diagonal the vertices alone.
    """
    pairs, missed, unused, best = _scaled(log_likelihood, log_nonassignment)
    orders = _orders(pairs, unused)
    dense = [order for order, states in orders if states > most_states]
    for order in dense:
        _thin(pairs, unused, best, order, most_states)
    shared, tracks = _shared(pairs, unused), len(pairs)
    alone = np.column_stack([missed, np.where(shared, 0.0, pairs)])
    weights = np.diag(np.concatenate([alone.sum(axis=1), unused]))
    weights[:tracks, tracks:] = np.where(shared, pairs, 0.0)
    weights[tracks:, :tracks] = weights[:tracks, tracks:].T
    chances = np.eye(len(weights))
    for order, _ in _orders(pairs, unused) if dense else orders:
        _sum_events(order, weights, chances)
    total = np.maximum(alone.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    probabilities: Array = alone * chances.diagonal()[:tracks, None] / total
    probabilities[:, 1:] += chances[:tracks, tracks:]
    return probabilities / probabilities.sum(axis=1, keepdims=True)


def _scaled(
    log_likelihood: Array, log_nonassignment: Array
) -> tuple[Array, Array, Array, Integers]:
    """Return weights scaled by the best joint event, and that event.

    Factors are the dual prices of the best event (Bellman and Ford). It becomes a product of
    ones, and no weight is above 1: nothing overflows, and what underflows does not count.
    """
    try:
        best = assign(-log_likelihood, -log_nonassignment)
    except ValueError as error:
        possible = np.where(np.isfinite(log_likelihood), 0.0, np.inf)
        forced = np.where(np.isfinite(log_nonassignment), 0.0, 1.0)
        stuck = np.flatnonzero((assign(possible, forced) < 0) & (forced > 0))[0]
        raise InputError(
            f"no joint event is possible: track {stuck} must have a detection (nonassignment 0) "
            "but finds none that other such tracks can spare. Give it a nonassignment above 0."
        ) from error
    paired, column_price = best >= 0, np.zeros(log_likelihood.shape[1])
    costs, row_price = -log_likelihood[paired, best[paired]], -log_nonassignment
    for _ in range(len(best)):
        row_price[paired] = costs - column_price[best[paired]]
        spare = -log_likelihood - row_price[:, None]
        lower = np.minimum(column_price, spare.min(axis=0, initial=np.inf))
        if (lower == column_price).all():
            break
        column_price = lower
    pairs = np.exp(np.minimum(0.0, log_likelihood + row_price[:, None] + column_price))
    missed = np.exp(np.minimum(0.0, log_nonassignment + row_price))
    return pairs, missed, np.exp(column_price), best


def _shared(pairs: Array, unused: Array) -> npt.NDArray[np.bool_]:
    """Return the pairs (n, m) whose detection several tracks can have.

    A detection that only one can have needs no table, unless its weight unused is below 1.
    """
    inside = pairs > 0
    return inside & ((inside.sum(axis=0) > 1) | (unused < 1.0))


def _orders(pairs: Array, unused: Array) -> list[tuple[list[int], float]]:
    """Return each group's order of elimination and number of states."""
    near: dict[int, set[int]] = {}
    for track, detection in np.argwhere(_shared(pairs, unused)).tolist():
        near.setdefault(track, set()).add(len(pairs) + detection)
        near.setdefault(len(pairs) + detection, set()).add(track)
    orders, ordered = list[tuple[list[int], float]](), set[int]()
    for vertex in near:
        if vertex not in ordered:
            order, states = _order(near, vertex)
            if states > SMALL:  # the best of some beginnings
                begin = np.linspace(0, len(order) - 1, 8, dtype=int)
                trials = [(order, states), *(_order(near, order[k]) for k in begin)]
                order, states = min(trials, key=itemgetter(1))
            orders.append((order, states))
            ordered.update(order)
    return orders


def _order(near: dict[int, set[int]], start: int) -> tuple[list[int], float]:
    """Return the order in which a group's vertices leave, and its states.

    Next leaves the vertex that lets the frontier, those that have lost a neighbour, grow least.
    """
    order, frontier, candidates, states = list[int](), set[int](), {start}, 0.0
    while candidates:
        touched = frontier.union(order)
        growth = {v: len(near[v] - touched) - (v in frontier) for v in candidates}
        order.append(min(growth, key=lambda v: (growth[v], v not in frontier, v)))
        frontier = (frontier | near[order[-1]]).difference(order)
        candidates = frontier.union(*(near[v] for v in frontier)).difference(order)
        states += 2.0 ** len(frontier)
    return order, states


def _sum_events(order: list[int], weights: Array, chances: Array) -> None:
    """Write a group's probabilities: of pairs, and on the diagonal of none.

    Vertices leave the graph one by one: alone, or matched with a neighbour that is still there.
    A table has an axis for each frontier vertex (0: free, 1: matched) and holds the summed weight
    of the events so far. A second pass, backwards, has the weight of all that can follow.
    """
    table, frontier, steps = np.ones(()), list[int](), list[Any]()
    for k, vertex in enumerate(order):
        near = [other for other in order[k + 1 :] if weights[vertex, other] > 0]
        new = [other for other in near if other not in frontier]
        wide = np.zeros((2,) * (len(frontier) + len(new)))
        unmatched: Any = (..., *[0] * len(new))
        wide[unmatched] = table
        axis = frontier.index(vertex) if vertex in frontier else None
        free, taken = (wide, np.zeros(())) if axis is None else np.moveaxis(wide, axis, 0)
        frontier = [other for other in frontier + new if other != vertex]
        table = weights[vertex, vertex] * free + taken
        halves: Any = {other: (slice(None),) * frontier.index(other) for other in near}
        for other, half in halves.items():
            table[*half, 1] += weights[vertex, other] * free[*half, 0]
        table /= table.max()
        steps.append((vertex, halves, axis, unmatched, free, taken))
    follows = np.ones(())
    for vertex, halves, axis, unmatched, free, taken in reversed(steps):
        before = weights[vertex, vertex] * follows
        shares = {vertex: (free * before).sum()}
        for other, half in halves.items():
            ahead = weights[vertex, other] * follows[*half, 1]
            shares[other] = (free[*half, 0] * ahead).sum()
            before[*half, 0] += ahead
        total = sum(shares.values()) + (taken * follows).sum()
        for other, share in shares.items():
            chances[vertex, other] = chances[other, vertex] = share / total
        follows = (before if axis is None else np.stack([before, follows], axis=axis))[unmatched]
        follows = follows / follows.max()


def _thin(pairs: Array, unused: Array, best: Integers, group: list[int], most_states: int) -> None:
    """Set the weakest pairs of a dense group to 0, the best event's last."""
    inside = np.isin(np.arange(len(pairs)), group)
    tracks, detections = np.nonzero(pairs * inside[:, None])
    weakness = -pairs[tracks, detections] - (best[tracks] == detections)
    strongest = np.argsort(weakness, kind="stable")
    tracks, detections = tracks[strongest], detections[strongest]
    weights = pairs[tracks, detections]

    def is_dense(count: int) -> bool:
        thinned = np.zeros_like(pairs)
        thinned[tracks[:count], detections[:count]] = weights[:count]
        return any(states > most_states for _, states in _orders(thinned, unused))

    count = bisect_left(range(1, len(tracks) + 1), True, key=is_dense)
    pairs[tracks[count:], detections[count:]] = 0.0
    warnings.warn(
        f"joint probabilities: {inside.sum()} tracks share detections too densely to be summed "
        f"exactly; {len(tracks) - count} of {len(tracks)} pairs left out, whose events weigh at "
        f"most {weights[count]:.1e} of the best. Narrow the gate; `joint_probabilities` also takes "
        "more states.",
        UserWarning,
        stacklevel=4,
    )


def _checked(pairs: Pairs) -> Pairs:
    """Return the pairs as float64 arrays, or raise an `InputError`."""
    check_kind(pairs, Pairs, "pairs")
    distance, determinant, size, area = (np.asarray(field, np.float64) for field in pairs[:4])
    check_shape(distance, (None, None), "pairs: distance_squared (tracks, detections)")
    empty = np.isinf(distance).all(axis=1)
    area = np.where(empty, 1.0, area) if area.shape == empty.shape else area  # none is needed
    for name, array, shape, good, expected in (
        ("distance_squared", distance, distance.shape, distance >= 0, "0 or more"),
        ("log_determinant", determinant, empty.shape, np.isfinite(determinant), "finite"),
        ("size_difference", size, distance.shape, (size >= 0) & (size < np.inf), "0 or more"),
        ("gate_area", area, empty.shape, (area > 0) & (area < np.inf), "above 0"),
    ):
        check_shape(array, shape, f"pairs: {name}")
        if not good.all():
            index = tuple(int(i) for i in np.argwhere(~good)[0])
            raise InputError(f"pairs: {name} at index {index} is {array[index]}, not {expected}.")
    check_between(pairs.gate_probability, 0, 1, "pairs: gate_probability")
    check_count(pairs.dimensions, "pairs: dimensions")
    return Pairs(distance, determinant, size, area, pairs.gate_probability, pairs.dimensions)


ASSOCIATORS: tuple[Associator, ...] = (NearestNeighbor(), GNN(), PDA(), JPDA())
