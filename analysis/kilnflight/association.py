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
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment
from scipy.special import softmax

from kilnflight.arrays import Array, Flags, Integers
from kilnflight.checks import InputError, check_finite, check_number, check_shape


class Pairs(NamedTuple):
    """Gated pairs of n tracks and m detections of one frame, in d dimensions of the image."""

    distance_squared: Array  # (n, m) squared Mahalanobis distance; inf outside the gate
    log_determinant: Array  # (n,) ln |S_i|, S_i the residual covariance in px^2 (Eq. 2.50)
    size_difference: Array  # (n, m) |N_d - N_p|, 3D points (Eq. 4.9); 0 where unknown
    gate_area: Array  # (n,) V(i), of the elliptical gate in px^2 (Eq. 4.13); a volume if d is 3
    gate_probability: float  # P_G, share of a particle's detections within the ellipse
    expected: Array  # (n, d) predicted positions, px
    residual: Array  # (n, d, d) S, px^2
    factor: Array  # (n, d, d) Cholesky factors L of S = L L'


Associator = Callable[[Pairs], Array]  # weights (n, 1 + m); column 0 = missed
_Orders = list[tuple[list[int], float]]  # of groups: vertices, number of states


@dataclass(frozen=True)
class GNN:
    """Find the assignment of least global cost (Eqs 2.49 and 4.9).

    Each track has a column of its own, which costs C_NA. This gives the optimum of the thesis's
    square problem without a large C. A pair of exactly C_NA is taken.
    """

    # a_0, per 3D point: 100 points weigh as one unit of squared distance. In the twin half of the
    # particles change by 7 points or less from frame to frame, one in twenty by more than 200.
    size_weight: float = 0.01
    # C_NA, cost of a missed track; pairs of higher cost are impossible. It is above the gate's
    # d^2 (16) + ln|S| of a track lost for some frames (18) + a_0 times some hundred points, so the
    # gate decides.
    nonassignment_cost: float = 50.0

    def __post_init__(self) -> None:
        check_number(self.size_weight, f"{type(self).__name__}: size_weight", least=0)
        check_number(self.nonassignment_cost, f"{type(self).__name__}: nonassignment_cost")

    def __call__(self, pairs: Pairs) -> Array:
        """Return the optimal weights (n, 1 + m) of 0 and 1; column 0 = missed."""
        costs = self._costs(pairs)
        return one_hot(assign(costs, np.full(len(costs), self.nonassignment_cost)), costs.shape[1])

    def _costs(self, pairs: Pairs) -> Array:
        """Return the cost (n, m) of each pair by Eq. 4.9, without unit.

        It is d^2 + ln |S| + a_0 times the difference in 3D points, and inf outside the gate and
        above C_NA. Eq. 4.9 prints P; d^2 is measured in S, so S is taken, as in Eq. 2.50.
        """
        costs = pairs.distance_squared + pairs.log_determinant[:, None]
        costs += self.size_weight * pairs.size_difference
        return np.where(costs > self.nonassignment_cost, np.inf, costs)


@dataclass(frozen=True)
class NearestNeighbor(GNN):
    """Give each track its nearest detection.

    "Nearest" is the least cost of Eq. 4.9; its ln |S| is a penalty for wide gates. Of two tracks
    with the same nearest detection the nearer one takes it. The other is missed, without a second
    choice (Fig. 2.20, middle). At equal cost the first track and the first detection win.
    """

    size_weight: float = 0.0  # section 2.3.2 knows no size

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m) of 0 and 1, at most one detection a track.

        Column 0 = missed. Detections outside the gate or above C_NA are never taken.
        """
        costs = np.column_stack([np.full(len(pairs.expected), np.inf), self._costs(pairs)])
        nearest = costs.argmin(axis=1) - 1  # -1: none is possible
        order = np.argsort(costs.min(axis=1), kind="stable")  # the nearest track comes first
        winners = order[np.unique(nearest[order], return_index=True)[1]]
        detection = np.full(len(costs), -1)
        detection[winners] = nearest[winners]
        return one_hot(detection, costs.shape[1] - 1)


@dataclass(frozen=True)
class PDA:
    """Weight the detections of each track alone (Eqs 4.10 to 4.13).

    Taken is e_j = exp(-(d^2 + a_0 |N_d - N_p|) / 2), the source's form [47]. As printed, the
    determinant enters twice, and e_j against b is not free of units. The second line of Eq. 4.10
    prints "i = 0" for no detection, j = 0. m(i) counts the whole gate, depth included.
    """

    # P_D, "appropriately large": a little above the detector's recall of 0.86 (Table 5.11).
    detection_probability: float = 0.9
    size_weight: float = 0.01  # a_0 per 3D point, as for GNN

    def __post_init__(self) -> None:
        name, probability = type(self).__name__, self.detection_probability
        check_number(probability, f"{name}: detection_probability", above=0, below=1)
        check_number(self.size_weight, f"{name}: size_weight", least=0)

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m); rows sum to 1, column 0 = missed."""
        log_e, log_b = self._logs(pairs)
        return softmax(np.column_stack([log_b, log_e]), axis=1)

    def _logs(self, pairs: Pairs) -> tuple[Array, Array]:
        """Return ln e_j (n, m) and ln b (n,) of Eqs 4.11 to 4.13.

        Outside the gate ln e_j is -inf. With an empty gate, a certain miss, ln b is 0.
        """
        log_e = -0.5 * (pairs.distance_squared + self.size_weight * pairs.size_difference)
        p_d, p_g = self.detection_probability, pairs.gate_probability
        # ln |2 pi S|^(1/2)
        log_spread = 0.5 * (pairs.expected.shape[1] * np.log(2 * np.pi) + pairs.log_determinant)
        count = np.isfinite(pairs.distance_squared).sum(axis=1)
        density = np.where(count > 0, count, 1) / np.where(count > 0, pairs.gate_area, 1.0)
        log_b = np.log(density) + log_spread + np.log((1 - p_d * p_g) / p_d)
        return log_e, np.where(count > 0, log_b, 0.0)


@dataclass(frozen=True)
class JPDA(PDA):
    """Weight detections jointly: each belongs to at most one track.

    `joint_probabilities` sums over all joint events, Eq. 2.64. Groups of more than 2^20 states are
    thinned with a warning (15 tracks that all share 31 detections). The weight of an event, open
    in section 4.1.3, is the product of e_j of its pairs and b of its missed tracks. This equals
    `PDA` where no detection is shared.
    """

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m); rows sum to 1, column 0 = missed."""
        return _marginals(*self._logs(pairs), 2**20)  # states; 0.1 s a frame


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
    alone = np.where(np.eye(tracks, dtype=np.bool_), missed, np.inf)
    column = linear_sum_assignment(np.hstack([cost, alone]))[1]
    return np.where(column < detections, column, -1)


def joint_probabilities(
    likelihood: npt.ArrayLike, nonassignment: npt.ArrayLike, most_states: int = 2**25
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
        Limit of the tables of one group, 8 bytes each; 20 tracks that share 20 detections fit.
        Above it the weakest pairs are left out, with a warning.

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
    check_number(most_states, "joint probabilities: most_states", least=4, whole=True)
    pairs = check_finite(likelihood, "likelihood")
    missed = check_finite(nonassignment, "nonassignment")
    check_shape(pairs, (None, None), "likelihood (tracks, detections)")
    check_shape(missed, pairs.shape[:1], "nonassignment, one per track")
    for name, values in (("likelihood", pairs), ("nonassignment", missed)):
        check_number(values.min(initial=0.0), f"{name} (not its logarithm)", least=0)
    with np.errstate(divide="ignore"):
        return _marginals(np.log(pairs), np.log(missed), most_states)


def _marginals(log_likelihood: Array, log_nonassignment: Array, most_states: int) -> Array:
    """Return `joint_probabilities` of logarithms (-inf for 0).

    Tracks and, after them, detections are vertices of a graph. ``weights`` holds its edges, the
    pairs whose detection several tracks can have, and on the diagonal the vertices alone.
    """
    pairs, missed, unused, best = _scaled(log_likelihood, log_nonassignment)
    pairs, orders = _thinned(pairs, unused, best, most_states)
    shared, tracks = _shared(pairs, unused), len(pairs)
    alone = np.column_stack([missed, np.where(shared, 0.0, pairs)])
    weights = np.diag(np.concatenate([alone.sum(axis=1), unused]))
    weights[:tracks, tracks:] = np.where(shared, pairs, 0.0)
    weights[tracks:, :tracks] = weights[:tracks, tracks:].T
    chances = np.eye(len(weights))
    for order, _ in orders:
        _sum_events(order, weights, chances)
    total = np.maximum(alone.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    probabilities: Array = alone * chances.diagonal()[:tracks, None] / total
    probabilities[:, 1:] += chances[:tracks, tracks:]
    return probabilities / probabilities.sum(axis=1, keepdims=True)


def _scaled(log_pairs: Array, log_missed: Array) -> tuple[Array, Array, Array, Integers]:
    """Return weights scaled by the best joint event, and that event.

    Factors are the dual prices of the best event (Bellman and Ford). Its weights become 1, and no
    weight is above 1: nothing overflows, and what underflows does not count.
    """
    try:
        best = assign(-log_pairs, -log_missed)
    except ValueError as error:
        raise InputError("nonassignment: with so many 0, no joint event is possible.") from error
    paired, column_price = best >= 0, np.zeros(log_pairs.shape[1])
    costs, row_price = -log_pairs[paired, best[paired]], -log_missed
    for _ in range(len(best)):
        row_price[paired] = costs - column_price[best[paired]]
        lower = np.minimum(column_price, (-log_pairs - row_price[:, None]).min(axis=0, initial=0))
        if (lower == column_price).all():
            break
        column_price = lower
    pairs = np.exp(np.minimum(0.0, log_pairs + row_price[:, None] + column_price))
    return pairs, np.exp(np.minimum(0.0, log_missed + row_price)), np.exp(column_price), best


def _shared(pairs: Array, unused: Array) -> Flags:
    """Return the pairs (n, m) whose detection several tracks can have.

    A detection that only one can have needs no table, unless its weight unused is below 1.
    """
    return (pairs > 0) & (((pairs > 0).sum(axis=0) > 1) | (unused < 1.0))


def _orders(pairs: Array, unused: Array) -> _Orders:
    """Return the order in which the vertices of each group leave, and its number of states."""
    near: dict[int, set[int]] = {}
    for track, detection in np.argwhere(_shared(pairs, unused)).tolist():
        near.setdefault(track, set()).add(len(pairs) + detection)
        near.setdefault(len(pairs) + detection, set()).add(track)
    orders, ordered = _Orders(), set[int]()
    for start in near:
        if start not in ordered:
            order, states = first = _order(near, start)
            begin = np.linspace(0, len(order) - 1, 8, dtype=int) if states > 2**12 else ()
            trials = [first, *(_order(near, order[k]) for k in begin)]
            orders.append(min(trials, key=lambda trial: trial[1]))
            ordered.update(order)
    return orders


def _order(near: dict[int, set[int]], start: int) -> tuple[list[int], float]:
    """Return the order in which the vertices of one group leave, and its number of states.

    Next leaves the vertex by which the frontier grows least. The frontier are the vertices that
    have lost a neighbour.
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


def _thinned(pairs: Array, unused: Array, best: Integers, most: int) -> tuple[Array, _Orders]:
    """Return the pairs without the weakest of dense groups, and `_orders`.

    Those of the best event go last.
    """
    kept, orders = pairs.copy(), _orders(pairs, unused)
    strength = pairs + (best[:, None] == np.arange(pairs.shape[1]))
    while dense := [v for order, states in orders if states > most for v in order]:
        inside = (kept > 0) & np.isin(np.arange(len(pairs)), dense)[:, None]
        weakest = np.argsort(np.where(inside, strength, np.inf), axis=None, kind="stable")
        kept.flat[weakest[: 1 + inside.sum() // 30]] = 0.0
        orders = _orders(kept, unused)
    if len(lost := pairs[kept < pairs]):
        what = f"{len(lost)} pairs of dense groups left out, weight up to {lost.max():.1e}"
        warnings.warn(f"joint probabilities: {what}", stacklevel=4)
    return kept, orders


ASSOCIATORS: tuple[Associator, ...] = (NearestNeighbor(), GNN(), PDA(), JPDA())
