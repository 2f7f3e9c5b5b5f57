r"""Data association: the detections that continue the tracks.

    p gated pairs of n tracks and m detections -> associator -> weights (p,)

=================  ==========================  ==================================
associator         equation                    default, none of them printed
=================  ==========================  ==================================
`NearestNeighbor`  sec. 2.3.2, Fig. 2.20       a_0 0, C_NA 50
`GNN`              2.49, 2.50, 4.9             a_0 0.01 per 3D point, C_NA 50
`PDA`              2.51 to 2.53, 4.10 to 4.13  P_D 0.9, a_0 0.01
`JPDA`             2.57 to 2.64, 4.10 to 4.13  P_D 0.9, a_0 0.01
=================  ==========================  ==================================

C_NA is the cost of a missed track (non-assignment), a_0 the weight of a difference in
3D points, P_D the probability of detection. A weight belongs to a pair within the gate;
all others have none. Weights are flags (`NearestNeighbor`, `GNN`) or probabilities. The
weight of "missed" is what those of a track's pairs leave of 1. So a track with an empty
gate is missed with weight 1.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csgraph, csr_array

from kilnflight.arrays import Array, Flags, Index
from kilnflight.checks import InputError, check_finite, check_number


class Pairs(NamedTuple):
    """The p gated pairs of n tracks and m detections of one frame, in d dimensions.

    Lengths are px in the kiln (d = 2) and mm on the belt.
    `kilnflight.tracking.filter.Gate` makes them; associators read them only.
    """

    track: Index  # (p,) ascending
    detection: Index  # (p,) ascending within a track
    distance_squared: Array  # (p,) squared Mahalanobis distance d^2
    size_difference: Array  # (p,) |N_d - N_p|, 3D points (Eq. 4.9); 0 where unknown
    # (p, d) L^-1 (detection - prediction), in standard deviations; its norm is d
    innovation: Array
    log_determinant: (
        Array  # (n,) ln |S_i|, S_i the residual covariance in px^2 (Eq. 2.50)
    )
    # (n,) V(i), of the elliptical gate in px^2 (Eq. 4.13); a volume if d is 3
    gate_area: Array
    gate_probability: float  # P_G, share of a particle's detections within the ellipse
    expected: Array  # (n, d) predicted positions, px
    residual: Array  # (n, d, d) S, px^2
    root: Array  # (n, d, d) L^-1, inverse of the Cholesky factor of S = L L'
    detections: int  # m


Associator = Callable[
    [Pairs], Array | Flags
]  # weights (p,): probabilities, or flags for 0 and 1
_Graph = dict[int, dict[int, float]]  # weight of each edge, from both of its vertices


@dataclass(frozen=True)
class GNN:
    """Find the assignment of least global cost (Eqs 2.49 and 4.9).

    Global nearest neighbour, one of the two trackers of the thesis (Table 5.17). A
    missed track costs C_NA, the cost of non-assignment. Each track has a column of its
    own for it, so the optimum of the thesis's square cost matrix needs no large C (Eq.
    2.50). A pair is impossible above C_NA; a pair of exactly C_NA is taken (section
    4.1.3).
    """

    # a_0, per 3D point: 100 points weigh as one unit of squared distance. In the twin
    # half of the particles change by 7 points or less from frame to frame, one in
    # twenty by more than 200.
    size_weight: float = 0.01
    # C_NA, cost of a missed track; pairs of higher cost are impossible. It is above the
    # gate's d^2 (16) + ln|S| of a track lost for some frames (18) + a_0 times some
    # hundred points, so the gate decides.
    nonassignment_cost: float = 50.0

    def __post_init__(self) -> None:
        check_number(self.size_weight, f"{type(self).__name__}: size_weight", least=0)
        check_number(
            self.nonassignment_cost, f"{type(self).__name__}: nonassignment_cost"
        )

    def __call__(self, pairs: Pairs) -> Flags:
        """Return the pairs (p,) of the optimum."""
        missed = np.full(len(pairs.expected), self.nonassignment_cost)
        return assign(*pairs[:2], self._costs(pairs), missed)

    def _costs(self, pairs: Pairs) -> Array:
        """Return the cost (p,) of each pair, ``d^2 + ln |S| + a_0 |N_d - N_p|`` (Eq.
        4.9).

        N_d and N_p are the numbers of 3D points of the detection and, as last known, of
        the track. Eq. 4.9 prints ``ln |P|``, P the covariance of the state, but takes
        the term from Eq. 2.50: ``ln |S|``, S the residual covariance. d^2 is measured
        in S, too.
        """
        costs = pairs.distance_squared + pairs.log_determinant[pairs.track]
        return costs + self.size_weight * pairs.size_difference


@dataclass(frozen=True)
class NearestNeighbor(GNN):
    """Give each track its nearest detection (section 2.3.2).

    "Nearest" is the least cost of Eq. 4.9 with a_0 = 0; its ``ln |S|`` is a penalty for
    wide gates. Where several tracks have the same nearest detection, the pair of least
    cost takes it. The other tracks are missed: they get no second choice (T_2 in Fig.
    2.20, middle). At equal cost the first track and the first detection win; the thesis
    does not say.
    """

    size_weight: float = 0.0  # a_0; section 2.3.2 does not use the size

    def __call__(self, pairs: Pairs) -> Flags:
        """Return the pairs (p,) that are taken, at most one of each track and
        detection.
        """
        costs = self._costs(pairs)
        order = np.argsort(costs, kind="stable")[
            : (costs <= self.nonassignment_cost).sum()
        ]
        for side in pairs[:2]:  # the cheapest of each that is left
            order = order[np.sort(np.unique(side[order], return_index=True)[1])]
        return np.isin(np.arange(len(costs)), order)


@dataclass(frozen=True)
class PDA:
    """Weight the detections of each track on its own (Eqs 4.10 to 4.13).

    Eq. 4.11 prints e_j = exp(-c / 2) with the cost c of Eq. 4.9. Here c is without ``ln
    |S|``, as in the source [47]: b of Eq. 4.12 has the determinant already, and e_j / b
    would have a unit. In the second line of Eq. 4.10 "i = 0" means j = 0, no detection.
    m(i) of Eq. 4.13 counts the detections within both limits of the gate, in the image
    and in depth.
    """

    # P_D, "appropriately large": a little above the detector's recall of 0.86 (Table
    # 5.11).
    detection_probability: float = 0.9
    size_weight: float = 0.01  # a_0 per 3D point, as for GNN

    def __post_init__(self) -> None:
        name = type(self).__name__
        check_number(
            self.detection_probability,
            f"{name}: detection_probability",
            above=0,
            below=1,
        )
        check_number(self.size_weight, f"{name}: size_weight", least=0)

    def __call__(self, pairs: Pairs) -> Array:
        """Return the weights beta (p,) of Eq. 4.10."""
        log_e, log_b = self._logs(pairs)
        np.logaddexp.at(log_b, pairs.track, log_e)  # now of the sum
        return np.asarray(np.exp(log_e - log_b[pairs.track]))

    def _logs(self, pairs: Pairs) -> tuple[Array, Array]:
        """Return the log weights ln e_j (p,) of pairs and ln b (n,) of missed tracks.

        Eqs 4.11 to 4.13. With an empty gate the track is missed for certain; ln b is
        then 0, since any finite value gives weight 1.
        """
        log_e = -0.5 * (
            pairs.distance_squared + self.size_weight * pairs.size_difference
        )
        p_d = self.detection_probability
        p_g = pairs.gate_probability
        spread = np.exp(0.5 * pairs.log_determinant) * (2 * np.pi) ** (
            pairs.expected.shape[1] / 2
        )
        count = np.bincount(pairs.track, minlength=len(spread))
        b = count / np.maximum(pairs.gate_area, 1e-300) * spread * (1 - p_d * p_g) / p_d
        return log_e, np.log(np.where(count > 0, b, 1.0))


@dataclass(frozen=True)
class JPDA(PDA):
    """Weight detections jointly: each belongs to at most one track (Eq. 2.64).

    The weight of a joint event, open in section 4.1.3, is the product of e_j of its
    pairs and b of its missed tracks. This equals `PDA` where no detection is shared.
    `joint_probabilities` sums over all joint events. Tracks that share detections form
    a group. Above 2^20 table entries (15 tracks that all share 31 detections) a group
    loses its weakest pairs, with a warning.
    """

    def __call__(self, pairs: Pairs) -> Array:
        """Return the weights (p,), summed over all joint events."""
        return _marginals(*pairs[:2], *self._logs(pairs), 2**20)[
            0
        ]  # table entries; 0.1 s a frame


def assign(track: Index, detection: Index, cost: Array, missed: Array) -> Flags:
    """Return which pairs (p,) are taken at the least total cost.

    ``cost`` (p,) is that of a pair, ``missed`` (n,) that of a track without detection.
    Costs may be negative. ``detection`` ascends within a ``track``. At equal cost a
    track takes a detection rather than none, as only costs above C_NA exclude a pair
    (section 4.1.3).
    """
    every = np.arange(len(missed))
    i = np.concatenate([track, every])
    costs = np.concatenate([cost, missed])
    j = np.concatenate([detection, every + (detection.max(initial=-1) + 1)])
    order = np.lexsort((costs, i))
    taken = np.zeros(len(i), np.bool_)
    best = order[np.searchsorted(i, every, sorter=order)]  # the cheapest of each track
    taken[best], wanted = True, j[best]
    rivals = np.bincount(wanted, minlength=1)[wanted] > 1
    if (
        rivals.any()
    ):  # solve those and, step by step, the tracks whose detection they may take
        reached = np.zeros(j.max() + 1, np.bool_)
        before = 0
        while rivals.sum() > before:
            before = rivals.sum()
            reached[j[rivals[i]]] = True
            rivals = reached[wanted]
        inside = np.flatnonzero(rivals[i])
        row, column = (np.cumsum(each) - 1 for each in (rivals, reached))
        taken[inside] = _cheapest(row[i[inside]], column[j[inside]], costs[inside])
    return taken[: len(cost)]


def _cheapest(row: Index, column: Index, costs: Array) -> Flags:
    """Return which entries (q,) of a sparse table make the least sum, one in each row."""
    if (row.max() + 1) * (column.max() + 1) > 2**20:  # 8 MB
        table = csr_array(
            (costs - costs.min() + 1.0, (row, column))
        )  # 0 would be no entry
        return csgraph.min_weight_full_bipartite_matching(table)[1][row] == column
    dense = np.full((row.max() + 1, column.max() + 1), np.inf)
    dense[row, column] = costs
    return np.asarray(linear_sum_assignment(dense)[1][row] == column)


def joint_probabilities(
    likelihood: npt.ArrayLike, nonassignment: npt.ArrayLike, most_states: int = 2**25
) -> Array:
    """Return the probability of each pair, summed over all joint events (Eq. 2.64).

    The weight of a joint event is the product of the likelihoods of its pairs and of
    the nonassignment of its missed tracks. Each detection is in at most one pair.

    Parameters
    ----------
    likelihood
        (n, m) likelihood of each track's pairs with m detections; 0 outside the gate. A
        track's row and its nonassignment may have any common scale.
    nonassignment
        (n,) weight of a track without detection; 0 if it must have one.
    most_states
        Limit of table entries per group of tracks that share detections, 8 bytes each.
        Twenty tracks that share 20 detections fit. Above it the weakest pairs are left
        out, with a warning.

    Returns
    -------
    ndarray
        (n, 1 + m) probabilities; rows sum to 1. Column 0 = missed, column 1 + j =
        detection j.

    Raises
    ------
    InputError
        If shapes do not fit, a number is negative or not finite, or no event is
        possible.

    >>> joint_probabilities([[1.0], [1.0]], [1.0, 1.0]).round(3).tolist()
    [[0.667, 0.333], [0.667, 0.333]]
    """
    check_number(most_states, "joint probabilities: most_states", least=4, whole=True)
    pairs = check_finite(
        likelihood, "likelihood (tracks, detections)", (None, None), most=np.inf
    )
    missed = check_finite(
        nonassignment, "nonassignment of tracks", pairs.shape[:1], most=np.inf
    )
    for name, values in (("likelihood", pairs), ("nonassignment", missed)):
        check_number(values.min(initial=0.0), f"{name} (not its logarithm)", least=0)
    i, j = pairs.nonzero()
    result = np.zeros((len(missed), 1 + pairs.shape[1]))
    logs = (
        np.log(pairs[i, j]),
        np.log(missed, np.full(len(missed), -np.inf), where=missed > 0),
    )
    result[i, 1 + j], result[:, 0] = _marginals(i, j, *logs, most_states)
    return result


def _marginals(
    i: Index, j: Index, pairs: Array, missed: Array, most: int
) -> tuple[Array, Array]:
    """Return the probabilities of p pairs (p,) and of n missed tracks (n,), from
    logarithms.

    Pairs are of tracks ``i`` and detections ``j``; ``most`` is the limit of table
    entries. The n tracks and, after them, the m detections are vertices of a graph. Its
    edges are the pairs whose detection several tracks can have. ``chances`` holds the
    probabilities of edges and, as (v, v), of vertices without one.
    """
    n = len(missed)
    chances = dict[tuple[int, int], float]()
    pairs, missed, unused, best = _scaled(i, j, pairs, missed)
    pairs, shared, graph, orders = _thinned(
        i, n + j, pairs, np.append(missed, unused), best, most
    )
    alone = missed + np.bincount(i, np.where(shared, 0.0, pairs), n)
    for order, _ in orders:
        _sum_events(order, graph, np.append(alone, unused), chances)
    scale = np.array([chances.get((v, v), 1.0) for v in range(n)]) / np.maximum(
        alone, 2.3e-308
    )
    pairs = pairs * scale[i]
    missed = missed * scale
    pairs[shared] = [
        chances[edge] for edge in zip(i[shared], n + j[shared], strict=True)
    ]
    total = missed + np.bincount(i, pairs, n)
    return pairs / total[i], missed / total


def _scaled(i: Index, j: Index, log_pairs: Array, log_missed: Array) -> tuple[Any, ...]:
    """Return weights scaled so that the best joint event has weight 1, and that event.

    Weights are of pairs (p,), of missed tracks (n,) and of unused detections (m,). The
    event is which pairs (p,) it has. Factors are the dual prices of the best assignment
    (Bellman and Ford); they leave probabilities unchanged. No weight exceeds 1, so none
    overflows, and weights that underflow are negligible.
    """
    row_price = -log_missed
    column_price = np.zeros(j.max(initial=-1) + 1)
    best = assign(
        i, j, -log_pairs, np.minimum(row_price, 1e7)
    )  # dearer than all others together
    if np.isinf(np.delete(row_price, i[best])).any():
        raise InputError("nonassignment: with so many 0, no joint event is possible.")
    for _ in row_price:
        row_price[i[best]] = -log_pairs[best] - column_price[j[best]]
        before = column_price.copy()
        np.minimum.at(column_price, j, -log_pairs - row_price[i])
        if (before == column_price).all():
            break
    pairs = np.exp(np.minimum(0.0, log_pairs + row_price[i] + column_price[j]))
    return (
        pairs,
        np.exp(np.minimum(0.0, log_missed + row_price)),
        np.exp(column_price),
        best,
    )


def _thinned(
    i: Index, j: Index, pairs: Array, single: Array, best: Flags, most: int
) -> Any:
    """Return the pairs (p,) without the weakest of large groups, and the graph of the
    others.

    Edges of the graph are pairs whose detection several tracks can have. A single
    track's detection needs none if its weight unused is 1: the pair then depends on no
    other. A group is a connected part. Pairs are set to 0, a thirtieth at a time, until
    no group needs more than ``most`` table entries. Those of the ``best`` event (p,)
    are removed last, so that an event remains possible. Large groups are tried from
    eight more starts, as the size of their tables depends on the order; the smallest is
    kept.

    Returns
    -------
    tuple
        Weights of the pairs (p,), which are edges (p,), the graph, and by group the
        elimination order of its vertices and the number of table entries.
    """
    kept = pairs.copy()
    dense = [-1]
    while dense:
        inside = np.flatnonzero((kept > 0) & np.isin(i, dense))
        weakest = inside[np.argsort((pairs + best)[inside], kind="stable")]
        kept[weakest[: 1 + len(weakest) // 30]] = 0.0
        there = kept > 0
        graph = _Graph()
        orders = list[Any]()
        ordered = set[int]()
        shared = there & (
            (np.bincount(j, there, len(single))[j] > 1) | (single[j] < 1.0)
        )
        for v, u, weight in zip(
            *(each[shared].tolist() for each in (i, j, kept)), strict=True
        ):
            graph.setdefault(v, {})[u] = graph.setdefault(u, {})[v] = weight
        for start in (near := {v: set(edges) for v, edges in graph.items()}):
            if start not in ordered:
                order, states = first = _order(near, start, most)
                begin = (
                    np.linspace(0, len(order) - 1, 8, dtype=int)
                    if states > 2**12
                    else ()
                )
                trials = [first, *(_order(near, order[k], most) for k in begin)]
                orders.append(min(trials, key=lambda trial: trial[1]))
                ordered.update(order)
        dense = [v for order, states in orders if states > most for v in order]
    if (kept < pairs).any():
        # One text, so Python shows it once.
        warnings.warn(
            "joint probabilities: weak pairs in a crowd are left out", stacklevel=4
        )
    return kept, shared, graph, orders


def _order(near: dict[int, set[int]], start: int, most: int) -> tuple[list[int], float]:
    """Return a greedy elimination order of a group's vertices, and its table entries.

    ``near`` holds each vertex's neighbours. The vertex removed next is the one by which
    the frontier grows least. The frontier are the remaining vertices with a removed
    neighbour; a table has 2^size(frontier) entries. Above ``most`` entries the rest is
    in any order.
    """
    order = list[int]()
    frontier = set[int]()
    candidates = {start}
    states = 0.0
    while candidates:
        touched = frontier.union(order)
        growth = {v: len(near[v] - touched) - (v in frontier) for v in candidates}
        order.append(min(growth, key=lambda v: (growth[v], v not in frontier, v)))
        frontier = frontier.union(near[order[-1]]).difference(order)
        candidates = frontier.union(*(near[v] for v in frontier)).difference(order)
        states += 2.0 ** len(frontier)
        while candidates and states > most:  # too large: only its members are asked for
            order.extend(candidates)
            candidates = (
                set[int]().union(*(near[v] for v in candidates)).difference(order)
            )
    return order, states


def _sum_events(
    order: list[int], graph: _Graph, single: Array, chances: dict[Any, float]
) -> None:
    """Write the probabilities of one group's edges and vertices into ``chances``.

    ``graph`` has the weights of edges, ``single`` those of vertices without an edge.
    Vertices are removed in ``order``: unmatched, or matched with a remaining neighbour.
    The table has an axis for each frontier vertex (0: free, 1: matched) and holds the
    summed weight of the partial events. A backward pass multiplies it by the weight of
    all their completions.
    """
    table = np.ones(())
    frontier = list[int]()
    steps = list[Any]()
    for k, vertex in enumerate(order):
        near = [other for other in order[k + 1 :] if other in graph[vertex]]
        every = [
            *frontier,
            *(other for other in (vertex, *near) if other not in frontier),
        ]
        wide = np.zeros((2,) * len(every))
        axis = every.index(vertex)
        shape = (*table.shape, -1)
        wide.reshape(shape)[..., 0] = table
        free, taken = np.moveaxis(wide, axis, 0)
        frontier = [other for other in every if other != vertex]
        table = single[vertex] * free + taken
        halves: Any = {other: (slice(None),) * frontier.index(other) for other in near}
        for other, half in halves.items():
            table[*half, 1] += graph[vertex][other] * free[*half, 0]
        table /= table.max()
        steps.append((vertex, halves, axis, shape, free, taken))
    follows = np.ones(())
    for vertex, halves, axis, shape, free, taken in reversed(steps):
        before = single[vertex] * (follows := follows / follows.max())
        shares = {vertex: (free * before).sum()}
        for other, half in halves.items():
            ahead = graph[vertex][other] * follows[*half, 1]
            shares[other] = (free[*half, 0] * ahead).sum()
            before[*half, 0] += ahead
        total = sum(shares.values()) + (taken * follows).sum()
        for other, share in shares.items():
            chances[vertex, other] = chances[other, vertex] = float(share / total)
        follows = np.stack([before, follows], axis=axis).reshape(shape)[..., 0]


ASSOCIATORS: tuple[Associator, ...] = (NearestNeighbor(), GNN(), PDA(), JPDA())
