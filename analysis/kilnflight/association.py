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

C_NA is the cost of a missed track (non-assignment), a_0 the weight of a difference in 3D points,
P_D the probability of detection. Column 0 is "missed", column 1 + j is detection j. Rows sum to 1,
of 0 and 1 (`NearestNeighbor`, `GNN`) or of probabilities.
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
from kilnflight.checks import InputError, check_finite, check_number


class Pairs(NamedTuple):
    """Gated pairs of n tracks and m detections of one frame, in d dimensions.

    Lengths are px in the kiln (d = 2) and mm on the belt. `kilnflight.tracking.filter.Gate` makes
    them; associators read them only.
    """

    distance_squared: Array  # (n, m) squared Mahalanobis distance d^2; inf outside the gate
    log_determinant: Array  # (n,) ln |S_i|, S_i the residual covariance in px^2 (Eq. 2.50)
    size_difference: Array  # (n, m) |N_d - N_p|, 3D points (Eq. 4.9); 0 where unknown
    gate_area: Array  # (n,) V(i), of the elliptical gate in px^2 (Eq. 4.13); a volume if d is 3
    gate_probability: float  # P_G, share of a particle's detections within the ellipse
    expected: Array  # (n, d) predicted positions, px
    residual: Array  # (n, d, d) S, px^2
    factor: Array  # (n, d, d) Cholesky factors L of S = L L'


Associator = Callable[[Pairs], Array]  # weights (n, 1 + m); column 0 = missed
_Orders = list[tuple[list[int], float]]  # per group: vertices in order, number of table entries


@dataclass(frozen=True)
class GNN:
    """Find the assignment of least global cost (Eqs 2.49 and 4.9).

    Global nearest neighbour, one of the two trackers of the thesis (Table 5.17). A missed track
    costs C_NA, the cost of non-assignment. Each track has a column of its own for it, so the
    optimum of the thesis's square cost matrix needs no large C (Eq. 2.50). A pair is impossible
    above C_NA; a pair of exactly C_NA is taken (section 4.1.3).
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
        """Return the optimal weights (n, 1 + m) of 0 and 1.

        Column 0 = missed, column 1 + j = detection j.
        """
        costs = self._costs(pairs)
        return one_hot(assign(costs, np.full(len(costs), self.nonassignment_cost)), costs.shape[1])

    def _costs(self, pairs: Pairs) -> Array:
        """Return the cost (n, m) of each pair, without unit (Eq. 4.9).

        It is inf outside the gate and above C_NA. Else it is ``d^2 + ln |S| + a_0 |N_d - N_p|``.
        N_d and N_p are the numbers of 3D points of the detection and, as last known, of the track.
        Eq. 4.9 prints ``ln |P|``, P the covariance of the state, but takes the term from Eq. 2.50:
        ``ln |S|``, S the residual covariance. d^2 is measured in S, too.
        """
        costs = pairs.distance_squared + pairs.log_determinant[:, None]
        costs += self.size_weight * pairs.size_difference
        return np.where(costs > self.nonassignment_cost, np.inf, costs)


@dataclass(frozen=True)
class NearestNeighbor(GNN):
    """Give each track its nearest detection (section 2.3.2).

    "Nearest" is the least cost of Eq. 4.9 with a_0 = 0; its ``ln |S|`` is a penalty for wide gates.
    Where several tracks have the same nearest detection, the pair of least cost takes it. The
    other tracks are missed: they get no second choice (T_2 in Fig. 2.20, middle). At equal cost the
    first track and the first detection win; the thesis does not say.
    """

    size_weight: float = 0.0  # a_0; section 2.3.2 does not use the size

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m) of 0 and 1, at most one detection per track.

        Column 0 = missed, column 1 + j = detection j, given to at most one track. Pairs outside the
        gate or above C_NA, the cost of non-assignment, are impossible.
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
    """Weight the detections of each track on its own (Eqs 4.10 to 4.13).

    Eq. 4.11 prints e_j = exp(-c / 2) with the cost c of Eq. 4.9. Here c is without ``ln |S|``, as
    in the source [47]: b of Eq. 4.12 has the determinant already, and e_j / b would have a unit. In
    the second line of Eq. 4.10 "i = 0" means j = 0, no detection. m(i) of Eq. 4.13 counts the
    detections within both limits of the gate, in the image and in depth.
    """

    # P_D, "appropriately large": a little above the detector's recall of 0.86 (Table 5.11).
    detection_probability: float = 0.9
    size_weight: float = 0.01  # a_0 per 3D point, as for GNN

    def __post_init__(self) -> None:
        name, probability = type(self).__name__, self.detection_probability
        check_number(probability, f"{name}: detection_probability", above=0, below=1)
        check_number(self.size_weight, f"{name}: size_weight", least=0)

    def __call__(self, pairs: Pairs) -> Array:
        """Return the weights beta (n, 1 + m) of Eq. 4.10.

        Rows sum to 1. Column 0 = missed, column 1 + j = detection j.
        """
        log_e, log_b = self._logs(pairs)
        return softmax(np.column_stack([log_b, log_e]), axis=1)

    def _logs(self, pairs: Pairs) -> tuple[Array, Array]:
        """Return the log weights ln e_j (n, m) of pairs and ln b (n,) of missed tracks.

        Eqs 4.11 to 4.13. Outside the gate ln e_j is -inf. With an empty gate the track is missed
        for certain; ln b is then 0, since any finite value gives weight 1.
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
    """Weight detections jointly: each belongs to at most one track (Eq. 2.64).

    The weight of a joint event, open in section 4.1.3, is the product of e_j of its pairs and b of
    its missed tracks. This equals `PDA` where no detection is shared. `joint_probabilities` sums
    over all joint events. Tracks that share detections form a group. Above 2^20 table entries (15
    tracks that all share 31 detections) a group loses its weakest pairs, with a warning.
    """

    def __call__(self, pairs: Pairs) -> Array:
        """Return the weights (n, 1 + m), summed over all joint events.

        Rows sum to 1. Column 0 = missed, column 1 + j = detection j.
        """
        return _marginals(*self._logs(pairs), 2**20)  # table entries; 0.1 s a frame


def one_hot(detection: Integers, detections: int) -> Array:
    """Return weights (n, 1 + m) of 0 and 1 for one detection per track.

    ``detection`` (n,) is an index below m = ``detections``, or -1: missed, column 0.
    """
    weights = np.zeros((len(detection), 1 + detections))
    weights[np.arange(len(detection)), 1 + detection] = 1.0
    return weights


def assign(cost: Array, missed: Array) -> Integers:
    """Return the detection (n,) of each track at the least total cost; -1: none.

    ``cost`` (n, m) is that of a pair, inf if impossible; ``missed`` (n,) is that of a track without
    detection. Costs may be negative. At equal cost a track takes a detection rather than none, as
    only costs above C_NA exclude a pair (section 4.1.3). ``ValueError``: no assignment is possible.
    """
    tracks, detections = cost.shape
    alone = np.where(np.eye(tracks, dtype=np.bool_), missed, np.inf)
    column = linear_sum_assignment(np.hstack([cost, alone]))[1]
    return np.where(column < detections, column, -1)


def joint_probabilities(
    likelihood: npt.ArrayLike, nonassignment: npt.ArrayLike, most_states: int = 2**25
) -> Array:
    """Return the probability of each pair, summed over all joint events (Eq. 2.64).

    The weight of a joint event is the product of the likelihoods of its pairs and of the
    nonassignment of its missed tracks. Each detection is in at most one pair.

    Parameters
    ----------
    likelihood
        (n, m) likelihood of each track's pairs with m detections; 0 outside the gate. A track's
        row and its nonassignment may have any common scale.
    nonassignment
        (n,) weight of a track without detection; 0 if it must have one.
    most_states
        Limit of table entries per group of tracks that share detections, 8 bytes each. Twenty
        tracks that share 20 detections fit. Above it the weakest pairs are left out, with a
        warning.

    Returns
    -------
    ndarray
        (n, 1 + m) probabilities; rows sum to 1. Column 0 = missed, column 1 + j = detection j.

    Raises
    ------
    InputError
        If shapes do not fit, a number is negative or not finite, or no event is possible.

    >>> joint_probabilities([[1.0], [1.0]], [1.0, 1.0]).round(3).tolist()
    [[0.667, 0.333], [0.667, 0.333]]
    """
    check_number(most_states, "joint probabilities: most_states", least=4, whole=True)
    pairs = check_finite(likelihood, "likelihood (tracks, detections)", (None, None))
    missed = check_finite(nonassignment, "nonassignment, one per track", pairs.shape[:1])
    for name, values in (("likelihood", pairs), ("nonassignment", missed)):
        check_number(values.min(initial=0.0), f"{name} (not its logarithm)", least=0)
    with np.errstate(divide="ignore"):
        return _marginals(np.log(pairs), np.log(missed), most_states)


def _marginals(log_likelihood: Array, log_nonassignment: Array, most_states: int) -> Array:
    """Return `joint_probabilities` (n, 1 + m) from logarithms (-inf for 0).

    Arguments are (n, m), (n,) and a limit of table entries. The n tracks and, after them, the m
    detections are vertices of a graph. ``weights`` (n + m, n + m) holds the pairs whose detection
    several tracks can have, and on its diagonal the weight of each vertex without such a pair.
    ``chances``, of the same shape, holds their probabilities.
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
    """Return weights scaled so that the best joint event has weight 1, and that event.

    Weights are of pairs (n, m), of missed tracks (n,) and of unused detections (m,). The event is
    the detection (n,) of each track, -1: none. Factors are the dual prices of the best assignment
    (Bellman and Ford); they leave probabilities unchanged. No weight exceeds 1, so none overflows,
    and weights that underflow are negligible.
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
    """Return the pairs (n, m) that need a table of joint events.

    These are pairs whose detection several tracks can have. A single track's detection needs none
    if its weight ``unused`` (m,) is 1: the pair then depends on no other.
    """
    return (pairs > 0) & (((pairs > 0).sum(axis=0) > 1) | (unused < 1.0))


def _orders(pairs: Array, unused: Array, most: int) -> _Orders:
    """Return the elimination order of each group's vertices, and its table entries.

    A group is a connected part of the graph of `_shared` pairs (n, m). Vertices below n are tracks,
    the others detections. Large groups are tried from eight more starts, as the size of the tables
    depends on the order; the smallest is kept.
    """
    near: dict[int, set[int]] = {}
    for track, detection in np.argwhere(_shared(pairs, unused)).tolist():
        near.setdefault(track, set()).add(len(pairs) + detection)
        near.setdefault(len(pairs) + detection, set()).add(track)
    orders, ordered = _Orders(), set[int]()
    for start in near:
        if start not in ordered:
            order, states = first = _order(near, start, most)
            begin = np.linspace(0, len(order) - 1, 8, dtype=int) if states > 2**12 else ()
            trials = [first, *(_order(near, order[k], most) for k in begin)]
            orders.append(min(trials, key=lambda trial: trial[1]))
            ordered.update(order)
    return orders


def _order(near: dict[int, set[int]], start: int, most: int) -> tuple[list[int], float]:
    """Return a greedy elimination order of a group's vertices, and its table entries.

    ``near`` holds each vertex's neighbours. The vertex removed next is the one by which the
    frontier grows least. The frontier are the remaining vertices with a removed neighbour; a table
    has 2^size(frontier) entries. Above ``most`` entries the rest is in any order.
    """
    order, frontier, candidates, states = list[int](), set[int](), {start}, 0.0
    while candidates:
        touched = frontier.union(order)
        growth = {v: len(near[v] - touched) - (v in frontier) for v in candidates}
        order.append(min(growth, key=lambda v: (growth[v], v not in frontier, v)))
        frontier = (frontier | near[order[-1]]).difference(order)
        candidates = frontier.union(*(near[v] for v in frontier)).difference(order)
        states += 2.0 ** len(frontier)
        while candidates and states > most:  # too large: only its members are asked for
            order.extend(candidates)
            candidates = set[int]().union(*(near[v] for v in candidates)).difference(order)
    return order, states


def _sum_events(order: list[int], weights: Array, chances: Array) -> None:
    """Write the probabilities of one group's pairs into ``chances`` (n + m, n + m).

    ``weights`` and ``chances`` hold pairs and, on the diagonal, vertices without a pair. Vertices
    are removed in ``order``: unmatched, or matched with a remaining neighbour. The table has an
    axis for each frontier vertex (0: free, 1: matched) and holds the summed weight of the partial
    events. A backward pass multiplies it by the weight of all their completions.
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
    """Return the pairs (n, m) without the weakest of large groups, and the orders.

    Pairs are set to 0, a thirtieth at a time, until no group in `_orders` has more than ``most``
    table entries. Pairs of the ``best`` event (n,) are removed last, so that an event remains
    possible.
    """
    kept, orders = pairs.copy(), _orders(pairs, unused, most)
    strength = pairs + (best[:, None] == np.arange(pairs.shape[1]))
    while dense := [v for order, states in orders if states > most for v in order]:
        inside = np.flatnonzero((kept > 0) & np.isin(np.arange(len(pairs)), dense)[:, None])
        weakest = inside[np.argsort(strength.flat[inside], kind="stable")]
        kept.flat[weakest[: 1 + len(weakest) // 30]] = 0.0
        orders = _orders(kept, unused, most)
    if (kept < pairs).any():
        # One text, so Python shows it once.
        what = "the least likely pairs of crowded particles are left out"
        warnings.warn(f"joint probabilities: {what}", stacklevel=4)
    return kept, orders


ASSOCIATORS: tuple[Associator, ...] = (NearestNeighbor(), GNN(), PDA(), JPDA())
