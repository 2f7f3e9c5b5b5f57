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

import warnings
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csgraph, csr_array

from kilnflight.arrays import Array, ArrayLike, Flags, Index, Pair, Shape, TwoInts
from kilnflight.checks import (
    InputError,
    NotNegative,
    Number,
    Range,
    Settings,
    check_finite,
    check_number,
)
from kilnflight.compiled import compiled


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
    # (n,) ln |S_i|, S_i the residual covariance in px^2 (Eq. 2.50)
    log_determinant: Array
    # (n,) V(i), of the elliptical gate in px^2 (Eq. 4.13); a volume if d is 3
    gate_area: Array
    gate_probability: float  # P_G, share of a particle's detections within the ellipse
    expected: Array  # (n, d) predicted positions, px
    residual: Array  # (n, d, d) S, px^2
    root: Array  # (n, d, d) L^-1, inverse of the Cholesky factor of S = L L'
    detections: int  # m


# An associator returns weights (p,): probabilities, or flags for 0 and 1.
Associator = Callable[[Pairs], Array | Flags]
SMALLEST = 2.3e-308  # no smaller float has all its digits
MOST_ENTRIES = 2**20  # entries in the tables of one group; they take 0.1 s a frame
LARGE = 2**12  # table entries above which it pays to look for a better order
_Graph = dict[int, dict[int, float]]  # weight of each edge, from both of its vertices


class GNN(Settings):
    """Find the assignment of least global cost (Eqs 2.49 and 4.9).

    Global nearest neighbour, one of the two trackers of the thesis (Table 5.17). A
    missed track costs C_NA, the cost of non-assignment. Each track has a column of its
    own for it, so the optimum of the thesis's square cost matrix needs no large C (Eq.
    2.50). A pair is impossible above C_NA; a pair of exactly C_NA is taken (section
    4.1.3).

    Parameters
    ----------
    size_weight
        a_0, cost per 3D point of difference; not printed. The default weighs 100 points
        as one unit of squared distance. In the twin half of the particles change by 7
        points or less from frame to frame, one in twenty by more than 200.
    nonassignment_cost
        C_NA, cost of a missed track; not printed. The default is above the gate's d^2
        (16) + ln|S| of a track lost for some frames (18) + a_0 times some hundred
        points, so the gate decides.

    Examples
    --------
    Both tracks are nearest to the first detection; one of them takes the second.

    >>> from kilnflight.tracking.filter import Detected, Gate
    >>> seen = Detected(np.array([[0.0, -6.0], [0.0, 5.0]]))
    >>> predicted = np.array([[0.0, 0.0], [0.0, 12.0]])
    >>> pairs = Gate()(predicted, np.stack([25 * np.eye(2)] * 2), seen)
    >>> taken = GNN()(pairs)
    >>> np.stack([pairs.track, pairs.detection])[:, taken].tolist()
    [[0, 1], [0, 1]]
    """

    size_weight: NotNegative = 0.01
    nonassignment_cost: Number = 50.0

    def __call__(self, pairs: Pairs) -> Flags:
        """Return the pairs (p,) of the optimum."""
        missed = np.full(len(pairs.expected), self.nonassignment_cost)
        return assign(pairs.track, pairs.detection, self._costs(pairs), missed)

    def _costs(self, pairs: Pairs) -> Array:
        """Return the costs (p,) ``d^2 + ln |S| + a_0 |N_d - N_p|`` (Eq. 4.9).

        N_d and N_p are the numbers of 3D points of the detection and, as last known, of
        the track. Eq. 4.9 prints ``ln |P|``, P the covariance of the state, but takes
        the term from Eq. 2.50: ``ln |S|``, S the residual covariance. d^2 is measured
        in S, too.
        """
        costs = pairs.distance_squared + pairs.log_determinant[pairs.track]
        return costs + self.size_weight * pairs.size_difference


class NearestNeighbor(GNN):
    """Give each track its nearest detection (section 2.3.2).

    "Nearest" is the least cost of Eq. 4.9 with a_0 = 0; its ``ln |S|`` is a penalty for
    wide gates. Where several tracks have the same nearest detection, the pair of least
    cost takes it. The other tracks are missed: they get no second choice (T_2 in Fig.
    2.20, middle). At equal cost the first track and the first detection win; the thesis
    does not say.

    Parameters
    ----------
    size_weight
        a_0, cost per 3D point of difference; section 2.3.2 does not use the size.
    nonassignment_cost
        C_NA, cost above which a pair is impossible, as for `GNN`.

    Examples
    --------
    Both tracks are nearest to the second detection; the farther track gets none.

    >>> from kilnflight.tracking.filter import Detected, Gate
    >>> seen = Detected(np.array([[0.0, -6.0], [0.0, 5.0]]))
    >>> predicted = np.array([[0.0, 0.0], [0.0, 12.0]])
    >>> pairs = Gate()(predicted, np.stack([25 * np.eye(2)] * 2), seen)
    >>> taken = NearestNeighbor()(pairs)
    >>> np.stack([pairs.track, pairs.detection])[:, taken].tolist()
    [[0], [1]]
    """

    size_weight: NotNegative = 0.0

    def __call__(self, pairs: Pairs) -> Flags:
        """Return the taken pairs (p,), at most one per track and detection."""
        costs = self._costs(pairs)
        possible = (costs <= self.nonassignment_cost).sum()
        order = np.argsort(costs, kind="stable")[:possible]
        for side in (pairs.track, pairs.detection):
            cheapest = np.unique(side[order], return_index=True)[1]
            order = order[np.sort(cheapest)]
        return np.isin(np.arange(len(costs)), order)


class PDA(Settings):
    """Weight the detections of each track on its own (Eqs 4.10 to 4.13).

    Eq. 4.11 prints e_j = exp(-c / 2) with the cost c of Eq. 4.9. Here c is without ``ln
    |S|``, as in the source [47]: b of Eq. 4.12 has the determinant already, and e_j / b
    would have a unit. In the second line of Eq. 4.10 "i = 0" means j = 0, no detection.
    m(i) of Eq. 4.13 counts the detections within both limits of the gate, in the image
    and in depth.

    Parameters
    ----------
    detection_probability
        P_D, "appropriately large"; not printed. The default is a little above the
        detector's recall of 0.86 (Table 5.11).
    size_weight
        a_0 per 3D point of difference, as for `GNN`.

    Examples
    --------
    One track, two detections at 1 and 2 standard deviations.

    >>> from kilnflight.tracking.filter import Detected, Gate
    >>> seen = Detected(np.array([[0.0, 5.0], [10.0, 0.0]]))
    >>> pairs = Gate()(np.zeros((1, 2)), 25 * np.eye(2)[None], seen)
    >>> PDA()(pairs).round(3).tolist()
    [0.788, 0.176]
    """

    detection_probability: Annotated[float, Range(above=0, below=1)] = 0.9
    size_weight: NotNegative = 0.01

    def __call__(self, pairs: Pairs) -> Array:
        """Return the weights beta (p,) of Eq. 4.10."""
        log_e, log_sum = self._logs(pairs)
        np.logaddexp.at(log_sum, pairs.track, log_e)
        return np.exp(log_e - log_sum[pairs.track])

    def _logs(self, pairs: Pairs) -> Pair:
        """Return the log weights ln e_j (p,) of pairs and ln b (n,) of missed tracks.

        Eqs 4.11 to 4.13. With an empty gate the track is missed for certain; ln b is
        then 0, since any finite value gives weight 1.
        """
        size = self.size_weight * pairs.size_difference
        log_e = -0.5 * (pairs.distance_squared + size)
        n, d = pairs.expected.shape
        spread = np.exp(0.5 * pairs.log_determinant) * (2 * np.pi) ** (d / 2)
        count = np.bincount(pairs.track, minlength=n)
        density = count / np.maximum(pairs.gate_area, 1e-300)
        p_d = self.detection_probability
        b = density * spread * (1 - p_d * pairs.gate_probability) / p_d
        return log_e, np.log(np.where(count > 0, b, 1.0))


class JPDA(PDA):
    """Weight detections jointly: each belongs to at most one track (Eq. 2.64).

    The weight of a joint event, open in section 4.1.3, is the product of e_j of its
    pairs and b of its missed tracks. This equals `PDA` where no detection is shared.
    `joint_probabilities` sums over all joint events. Tracks that share detections form
    a group. Above `MOST_ENTRIES` table entries (15 tracks that all share 31 detections)
    a group loses its weakest pairs, with a warning.

    Parameters
    ----------
    detection_probability, size_weight
        As for `PDA`.

    Examples
    --------
    Two tracks share one detection, which `PDA` would give to each of them.

    >>> from kilnflight.tracking.filter import Detected, Gate
    >>> places = np.array([[0.0, 0.0], [0.0, 4.0]])
    >>> seen = Detected(np.array([[0.0, 2.0]]))
    >>> pairs = Gate()(places, np.stack([25 * np.eye(2)] * 2), seen)
    >>> JPDA()(pairs).round(3).tolist()
    [0.496, 0.496]
    """

    def __call__(self, pairs: Pairs) -> Array:
        """Return the weights (p,), summed over all joint events."""
        log_e, log_b = self._logs(pairs)
        sides = pairs.track, pairs.detection
        return _marginals(*sides, log_e, log_b, MOST_ENTRIES)[0]


def assign(track: Index, detection: Index, cost: Array, missed: Array) -> Flags:
    """Return which pairs (p,) are taken at the least total cost.

    At equal cost a track takes a detection rather than none, as only costs above C_NA
    exclude a pair (section 4.1.3).

    Parameters
    ----------
    track, detection
        (p,) sides of the pairs; ``detection`` ascends within a ``track``.
    cost
        (p,) of a pair; may be negative.
    missed
        (n,) cost of a track without detection.
    """
    every = np.arange(len(missed))
    j = np.concatenate([detection, every + (detection.max(initial=-1) + 1)])
    cheapest = _cheapest_of_each(track, cost, missed)
    wanted = j[cheapest]
    taken = np.zeros(len(j), bool)
    taken[cheapest] = True
    rivals = np.bincount(wanted, minlength=1)[wanted] > 1
    if rivals.any():
        i = np.concatenate([track, every])
        costs = np.concatenate([cost, missed])
        reached = np.zeros(j.max() + 1, bool)
        before = 0
        # Tracks whose wanted detection a rival may take become rivals themselves.
        while rivals.sum() > before:
            before = rivals.sum()
            reached[j[rivals[i]]] = True
            rivals = reached[wanted]
        inside = np.flatnonzero(rivals[i])
        row = np.cumsum(rivals) - 1
        column = np.cumsum(reached) - 1
        taken[inside] = _cheapest(row[i[inside]], column[j[inside]], costs[inside])
    return taken[: len(cost)]


@compiled
def _cheapest_of_each(track: Any, cost: Any, missed: Any) -> Any:
    """Return the index (n,) of each track's cheapest pair; p and more: it is missed.

    Compiled, five times faster than a sort for 60 tracks.
    """
    least = missed.astype(np.float64)
    chosen = np.arange(len(missed)) + len(cost)
    for pair, i in enumerate(track):
        missing = chosen[i] >= len(cost)
        if cost[pair] < least[i] or (missing and cost[pair] == least[i]):
            least[i] = cost[pair]
            chosen[i] = pair
    return chosen


def _cheapest(row: Index, column: Index, costs: Array) -> Flags:
    """Return which entries (q,) of a sparse table make the least sum, one per row."""
    shape = (row.max() + 1, column.max() + 1)
    if shape[0] * shape[1] > 2**20:  # 8 MB
        # A cost of 0 would be no entry.
        table = csr_array((costs - costs.min() + 1.0, (row, column)))
        return csgraph.min_weight_full_bipartite_matching(table)[1][row] == column
    dense = np.full(shape, np.inf)
    dense[row, column] = costs
    return linear_sum_assignment(dense)[1][row] == column


def joint_probabilities(
    likelihood: ArrayLike, nonassignment: ArrayLike, most_states: int = 2**25
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

    Examples
    --------
    Two tracks share one detection: of three joint events each has one third.

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
    with np.errstate(divide="ignore"):  # ln 0 is -inf, as it should be
        log_missed = np.log(missed)
    result = np.zeros((len(missed), 1 + pairs.shape[1]))
    result[i, 1 + j], result[:, 0] = _marginals(
        i, j, np.log(pairs[i, j]), log_missed, most_states
    )
    return result


def _marginals(
    i: Index, j: Index, log_pairs: Array, log_missed: Array, most: int
) -> Pair:
    """Return the probabilities of p pairs (p,) and of n missed tracks (n,), of JPDA.

    They are exact unless a group exceeds ``most``.

    The n tracks and, after them, the m detections are vertices of a graph. Its edges
    are the pairs that depend on others (`_thinned`). All that a track can do outside
    the graph, to be missed or to take a detection of its own, is one weight, ``alone``.
    The graph gives its probability, which is then shared out in proportion.

    Parameters
    ----------
    i, j
        (p,) tracks and detections of the pairs.
    log_pairs, log_missed
        (p,) and (n,) logarithms of the weights of pairs and of missed tracks.
    most
        Limit of table entries per group.
    """
    n = len(log_missed)
    weights = _scaled(i, j, log_pairs, log_missed)
    thinned = _thinned(i, j, weights, most)
    pairs = thinned.pairs
    shared = thinned.shared
    alone = weights.missed + np.bincount(i, np.where(shared, 0.0, pairs), n)
    single = np.append(alone, weights.unused)
    # By edge, and (v, v) for a vertex v without an edge.
    chances = dict[TwoInts, float]()
    for order in thinned.orders:
        chances |= _sum_events(order, thinned.graph, single)
    without = np.array([chances.get((v, v), 1.0) for v in range(n)])
    scale = without / np.maximum(alone, SMALLEST)
    pairs = pairs * scale[i]
    missed = weights.missed * scale
    edges = zip(i[shared], n + j[shared], strict=True)
    pairs[shared] = [chances[edge] for edge in edges]
    total = missed + np.bincount(i, pairs, n)  # 1 but for rounding
    return pairs / total[i], missed / total


class _Scaled(NamedTuple):
    """Weights of p pairs, n tracks and m detections; the best joint event has 1."""

    pairs: Array  # (p,)
    missed: Array  # (n,) of a track without detection
    unused: Array  # (m,) of a detection without track
    best: Flags  # (p,) pairs of the best event


def _scaled(i: Index, j: Index, log_pairs: Array, log_missed: Array) -> _Scaled:
    """Return weights scaled so that the best joint event has weight 1.

    Factors are the dual prices of the best assignment (Bellman and Ford); they leave
    probabilities unchanged. No weight exceeds 1, so none overflows, and weights that
    underflow are negligible.
    """
    row_price = -log_missed
    column_price = np.zeros(j.max(initial=-1) + 1)
    # 1e7 is dearer than all other pairs together.
    best = assign(i, j, -log_pairs, np.minimum(row_price, 1e7))
    if np.isinf(np.delete(row_price, i[best])).any():
        raise InputError("nonassignment: with so many 0, no joint event is possible.")
    for _ in row_price:
        row_price[i[best]] = -log_pairs[best] - column_price[j[best]]
        before = column_price.copy()
        np.minimum.at(column_price, j, -log_pairs - row_price[i])
        if (before == column_price).all():
            break
    log_pairs = log_pairs + row_price[i] + column_price[j]
    return _Scaled(
        pairs=np.exp(np.minimum(0.0, log_pairs)),
        missed=np.exp(np.minimum(0.0, log_missed + row_price)),
        unused=np.exp(column_price),
        best=best,
    )


class _Thinned(NamedTuple):
    """What is left of p pairs, as a graph of tracks and detections."""

    pairs: Array  # (p,) weights; 0: left out
    shared: Flags  # (p,) pairs that are edges of the graph
    graph: _Graph
    orders: list[list[int]]  # elimination order of each group


def _thinned(i: Index, j: Index, weights: _Scaled, most: int) -> _Thinned:
    """Return the pairs (p,) without the weakest of large groups, and their graph.

    A group is a connected part of the graph. Weights are set to 0, a thirtieth of a
    group's pairs at a time, until no group needs more than ``most`` table entries.
    Pairs of the best event are removed last, so that an event remains possible.
    """
    kept = weights.pairs.copy()
    while True:
        there = kept > 0
        tracks = np.bincount(j, there, len(weights.unused))
        # A pair depends on no other if its detection is its track's alone and has
        # weight 1 unused.
        shared = there & ((tracks[j] > 1) | (weights.unused[j] < 1.0))
        graph = _linked(i[shared], len(weights.missed) + j[shared], kept[shared])
        orders = _orders(graph, most)
        dense = [v for order, states in orders if states > most for v in order]
        if not dense:
            break
        inside = np.flatnonzero(there & np.isin(i, dense))
        strength = (weights.pairs + weights.best)[inside]
        weakest = inside[np.argsort(strength, kind="stable")]
        kept[weakest[: 1 + len(weakest) // 30]] = 0.0
    if (kept < weights.pairs).any():
        # One text, so Python shows it once.
        warnings.warn(
            "joint probabilities: weak pairs in a crowd are left out", stacklevel=4
        )
    return _Thinned(
        pairs=kept, shared=shared, graph=graph, orders=[order for order, _ in orders]
    )


def _linked(first: Index, second: Index, weights: Array) -> _Graph:
    """Return the graph whose edges (q,) join ``first`` and ``second``."""
    graph = _Graph()
    edges = zip(first.tolist(), second.tolist(), weights.tolist(), strict=True)
    for v, u, weight in edges:
        graph.setdefault(v, {})[u] = weight
        graph.setdefault(u, {})[v] = weight
    return graph


def _orders(graph: _Graph, most: int) -> list[tuple[list[int], float]]:
    """Return the elimination order of each group, and its number of table entries.

    The number depends on the first vertex. `LARGE` groups are tried from eight more
    starts; the smallest is kept.
    """
    orders = []
    ordered = set[int]()
    for start in graph:
        if start in ordered:
            continue
        trials = [_order(graph, start, most)]
        order, states = trials[0]
        ordered.update(order)
        if states > LARGE:
            starts = np.linspace(0, len(order) - 1, 8, dtype=int)
            trials += [_order(graph, order[k], most) for k in starts]
        orders.append(min(trials, key=lambda trial: trial[1]))
    return orders


def _order(graph: _Graph, start: int, most: int) -> tuple[list[int], float]:
    """Return a greedy elimination order of a group's vertices, and its table entries.

    The vertex removed next is the one by which the frontier grows least. The frontier
    are the remaining vertices with a removed neighbour; a table has 2^size(frontier)
    entries. Above ``most`` entries the rest is in any order.
    """
    order = list[int]()
    frontier = set[int]()
    candidates = {start}
    states = 0.0
    while candidates:
        touched = frontier.union(order)
        growth = {v: len(set(graph[v]) - touched) - (v in frontier) for v in candidates}
        order.append(min(growth, key=lambda v: (growth[v], v not in frontier, v)))
        frontier = frontier.union(graph[order[-1]]).difference(order)
        candidates = frontier.union(*(graph[v] for v in frontier)).difference(order)
        states += 2.0 ** min(len(frontier), 1000)  # floats end at 2^1024
        while candidates and states > most:  # too large: the members alone matter
            order.extend(candidates)
            around = set[int]().union(*(graph[v] for v in candidates))
            candidates = around.difference(order)
    return order, states


class _Removal(NamedTuple):
    """The removal of one vertex from the table of `_sum_events`."""

    vertex: int
    halves: dict[int, Any]  # index of the axis before that of each neighbour
    axis: int  # axis that the vertex adds
    shape: Shape  # shape of the table with all vertices, new ones in one axis
    free: Array  # weights of the events that leave the vertex to its neighbours
    taken: Array  # weights of the events in which it is matched already


def _sum_events(order: list[int], graph: _Graph, single: Array) -> dict[TwoInts, float]:
    """Return the probabilities of one group's edges and, as (v, v), single vertices.

    ``graph`` has the weights of edges, ``single`` those of vertices without an edge. A
    backward pass over the removals multiplies the weights of partial events by the
    weight of all their completions.
    """
    chances = {}
    follows = np.ones(())
    for step in reversed(_removals(order, graph, single)):
        vertex = step.vertex
        follows = follows / follows.max()
        before = single[vertex] * follows
        shares = {vertex: (step.free * before).sum()}
        for other, half in step.halves.items():
            ahead = graph[vertex][other] * follows[*half, 1]
            shares[other] = (step.free[*half, 0] * ahead).sum()
            before[*half, 0] += ahead
        total = sum(shares.values()) + (step.taken * follows).sum()
        for other, share in shares.items():
            edge = min(vertex, other), max(vertex, other)
            chances[edge] = share / total
        both = np.stack([before, follows], axis=step.axis)
        follows = both.reshape(step.shape)[..., 0]
    return chances


def _removals(order: list[int], graph: _Graph, single: Array) -> list[_Removal]:
    """Return the removals of one group's vertices in ``order``.

    A vertex is unmatched, or matched with a remaining neighbour. The table has an axis
    for each frontier vertex (0: free, 1: matched) and holds the summed weight of the
    partial events.
    """
    table = np.ones(())
    frontier = list[int]()
    removals = []
    for k, vertex in enumerate(order):
        near = [other for other in order[k + 1 :] if other in graph[vertex]]
        new = [other for other in (vertex, *near) if other not in frontier]
        every = frontier + new
        wide = np.zeros((2,) * len(every))
        shape = (*table.shape, -1)
        wide.reshape(shape)[..., 0] = table
        axis = every.index(vertex)
        free, taken = np.moveaxis(wide, axis, 0)
        frontier = [other for other in every if other != vertex]
        halves: Any = {other: (slice(None),) * frontier.index(other) for other in near}
        removals.append(
            _Removal(
                vertex=vertex,
                halves=halves,
                axis=axis,
                shape=shape,
                free=free,
                taken=taken,
            )
        )
        table = single[vertex] * free + taken
        for other, half in halves.items():
            table[*half, 1] += graph[vertex][other] * free[*half, 0]
        table /= table.max()
    return removals


ASSOCIATORS: tuple[Associator, ...] = (NearestNeighbor(), GNN(), PDA(), JPDA())
