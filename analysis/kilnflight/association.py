r"""Data association: which detection continues which track (thesis, sections 2.3 and 4.1.3).

    gated pairs of n tracks and m detections -> associator -> weights (n, 1 + m)

=================  ======================  ============================  ==================
associator         equation                default                       source
=================  ======================  ============================  ==================
`NearestNeighbor`  sec. 2.3.2, Fig. 2.20   a_0 0, C_NA 50                not printed
`GNN`              2.49, 2.50, 4.9         a_0 0.01 per point, C_NA 50   not printed
`PDA`              2.51 to 2.53, 4.10      P_D 0.9, a_0 0.01             not printed
                   to 4.13
`JPDA`             2.57 to 2.64, 4.10      P_D 0.9, a_0 0.01             not printed
                   to 4.13
=================  ======================  ============================  ==================

Column 0 is "missed", rows sum to 1. `NearestNeighbor` and `GNN` give rows of 0 and 1, `PDA`
and `JPDA` probabilities; one Kalman update serves all. A track with an empty gate, and every
track of a frame without detections, is missed with weight 1.
"""

from __future__ import annotations

import warnings
from bisect import bisect_left
from collections import defaultdict
from dataclasses import dataclass
from math import comb, perm
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from kilnflight.checks import (
    InputError,
    check_at_least,
    check_between,
    check_count,
    check_finite,
    check_kind,
    check_shape,
    is_number,
)

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]
Graph = dict[int, dict[int, float]]  # neighbours of each vertex, and the weights of the pairs

# States of the tables of one group, 8 bytes each: 256 MiB. 20 tracks that share 20 detections fit.
MOST_STATES = 2**25
MOST_STATES_JPDA = 2**20  # in a frame of a recording, for the sake of time
SMALL = 2**12  # states; summing them costs less than looking for a better order
TRIALS = 8
MOST_EVENTS = 2**20


class Pairs(NamedTuple):
    """All pairs of n tracks and m detections of one frame, after the gate (section 4.1.2)."""

    distance_squared: Array
    """(n, m) squared Mahalanobis distance; inf outside the gate."""
    log_determinant: Array
    """(n,) ln |S_i|, S_i the residual covariance in px^2 (Eq. 2.50)."""
    size_difference: Array
    """(n, m) |N_d - N_p|, number of 3D points (Eq. 4.9); 0 where unknown."""
    gate_area: Array
    """(n,) V(i), area of the elliptical gate in px^2 (Eq. 4.13)."""
    gate_probability: float
    """P_G, probability that a particle's detection lies in its elliptical gate; 0: gate of 0."""
    dimensions: int = 2
    """d, of the positions; S is (d, d) and V(i) a volume where d is 3."""


class Associator(Protocol):
    """Turn gated pairs into weights."""

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (tracks, 1 + detections); column 0 = missed."""


@dataclass(frozen=True)
class NearestNeighbor:
    """Give each track its nearest detection, whatever the others do.

    If two tracks have the same nearest detection, the nearer one takes it and the other goes
    without, even if another detection is in its gate (Fig. 2.20, middle). At equal cost
    the first track and the first detection win.

    Parameters
    ----------
    size_weight
        a_0 of Eq. 4.9; 0 asks for distance alone, as section 2.3.2 does.
    nonassignment_cost
        C_NA; a pair that costs more is impossible.

    Notes
    -----
    "Nearest" is the least cost of Eq. 4.9. Within one track ln |S| is the same for all its
    detections; between tracks it keeps one with a wide gate from taking everything.
    """

    size_weight: float = 0.0  # per 3D point; section 2.3.2 knows no size
    nonassignment_cost: float = 50.0  # not printed; see GNN

    def __post_init__(self) -> None:
        """Refuse parameters that are no costs."""
        _check_costs(self)

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m) of 0 and 1; column 0 = missed."""
        costs = _costs(pairs, self)
        detection = np.full(len(costs), -1)
        if costs.size:
            nearest, least = costs.argmin(axis=1), costs.min(axis=1)
            order = np.argsort(least, kind="stable")  # the first to name a detection has it
            order = order[np.isfinite(least[order])]
            winners = order[np.unique(nearest[order], return_index=True)[1]]
            detection[winners] = nearest[winners]
        return one_hot(detection, costs.shape[1])


@dataclass(frozen=True)
class GNN:
    """Find the assignment of least global cost, Eqs 2.49 and 4.9 with the threshold C_NA.

    Parameters
    ----------
    size_weight
        a_0 of Eq. 4.9, cost of one 3D point of difference.
    nonassignment_cost
        C_NA: what a track without a detection costs, and above which a pair is impossible.

    Notes
    -----
    The thesis sets pairs outside the gate to a large C and pairs above C_NA to C_NA, then
    solves the square problem. An assigned C_NA is a track without detection, so one column of
    its own per track gives the same optimum without C. A pair of exactly C_NA is taken.
    """

    # Not printed. Between frames of the twin half of the particles change by 7 points or less,
    # one in twenty by more than 200 (particles of 60 points): 100 points weigh as one unit of
    # squared distance, so size settles near ties and overexposure does not end a track.
    size_weight: float = 0.01
    # Not printed. Above the gate's d^2 (about 16) + ln|S| of a track lost for some frames
    # (100 px on both axes: 18) + a_0 times some hundred points: the gate decides, not C_NA.
    nonassignment_cost: float = 50.0

    def __post_init__(self) -> None:
        """Refuse parameters that are no costs."""
        _check_costs(self)

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m) of 0 and 1; column 0 = missed."""
        costs = _costs(pairs, self)
        missed = np.full(len(costs), float(self.nonassignment_cost))
        return one_hot(assign(costs, missed), costs.shape[1])


@dataclass(frozen=True)
class PDA:
    """Weight all detections in a track's gate as if it were alone, Eqs 4.10 to 4.13.

    Parameters
    ----------
    detection_probability
        P_D of Eq. 4.12.
    size_weight
        a_0 of Eq. 4.9, as in `GNN`.
    printed_determinant
        Whether Eq. 4.11 keeps the ln |S| of Eq. 4.9.

    Notes
    -----
    Eq. 4.11 takes c_ij of Eq. 4.9, whose ln |P| divides e_j by |P|^(1/2), while Eq. 4.12
    multiplies b by the same: the determinant enters twice, and e_j against b is not free
    of units. By default e_j = exp(-(d^2 + a_0 |N_d - N_p|) / 2), the source's form [47];
    ``printed_determinant=True`` computes what is printed (with S in px^2).

    The second line of Eq. 4.10 prints "i = 0"; it is the weight of no detection, j = 0.
    m(i) counts the candidates of the whole gate, depth included, V(i) is the ellipse.
    """

    # Not printed, but "appropriately large": a little above the detector's recall of 0.86
    # (Table 5.11, SIFT and DBSCAN combined).
    detection_probability: float = 0.9
    size_weight: float = 0.01  # per 3D point, not printed; see GNN
    printed_determinant: bool = False

    def __post_init__(self) -> None:
        """Refuse parameters that are no probabilities."""
        _check_probabilities(self)

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m); rows sum to 1, column 0 = missed."""
        log_e, log_b = _log_likelihoods(pairs, self)
        logs = np.column_stack([log_b, log_e])
        return _per_row(np.exp(logs - logs.max(axis=1, keepdims=True)))


@dataclass(frozen=True)
class JPDA:
    """Weight detections jointly: each belongs to at most one track.

    The likelihoods and parameters are those of `PDA`; Eq. 2.64 sums them over all joint
    events, exactly (`joint_probabilities`).

    Warns
    -----
    UserWarning
        If a group of tracks is too dense to be exact and pairs were left out.

    Notes
    -----
    "The probability regarding the joint events are computed following definitions in
    Chapter 2.3.4" without saying from what: the weight of a joint event is taken as the
    product of e_j of its pairs and b of its tracks without detection, so that a track that
    shares no detection gets the probabilities of `PDA`.

    A group may have 2^20 states (15 tracks that all share 31 detections), fewer than in
    `joint_probabilities`: they cost about 0.1 s per frame.
    """

    detection_probability: float = 0.9  # as in PDA
    size_weight: float = 0.01
    printed_determinant: bool = False

    def __post_init__(self) -> None:
        """Refuse parameters that are no probabilities."""
        _check_probabilities(self)

    def __call__(self, pairs: Pairs) -> Array:
        """Return weights (n, 1 + m); rows sum to 1, column 0 = missed."""
        return _marginals(*_log_likelihoods(pairs, self), MOST_STATES_JPDA)


def one_hot(detection: Integers, detections: int) -> Array:
    """Return weights (n, 1 + m) of tracks that take one detection each, or none (-1)."""
    weights = np.zeros((len(detection), 1 + detections))
    weights[np.arange(len(detection)), 1 + detection] = 1.0
    return weights


def assign(cost: Array, missed: Array) -> Integers:
    """Return the detection (n,) of each track, -1: none, in the assignment of least cost.

    ``cost`` is (n, m), inf where a pair is impossible, ``missed`` (n,) that of a track without
    detection. At equal cost a track takes a detection rather than none, and the first one
    (Kuhn-Munkres, section 2.3.2).
    """
    tracks, detections = cost.shape
    alone = np.full((tracks, tracks), np.inf)
    np.fill_diagonal(alone, missed)
    column = linear_sum_assignment(np.hstack([cost, alone]))[1]
    return np.where(column < detections, column, -1)


def joint_probabilities(
    likelihood: npt.ArrayLike, nonassignment: npt.ArrayLike, most_states: int = MOST_STATES
) -> Array:
    """Return the probability of each track's detection over all joint events, Eq. 2.64, thesis.

    The weight of a joint event is the product of the likelihoods of its pairs and of the
    nonassignment of its tracks without detection; each detection is in at most one pair.
    Events are summed, not listed: the cost grows with the number of tracks and, for each
    group, with 2 to the number of detections that its early and late tracks share.

    Parameters
    ----------
    likelihood
        (tracks, detections), 0 outside the gate. Any scale: a factor common to a track's
        likelihoods and nonassignment changes nothing.
    nonassignment
        (tracks,) weight of a track without detection; 0 if it must have one.
    most_states
        States of the tables of one group that are summed exactly (the default suffices for
        20 tracks sharing all of 20 detections, or chains of any length).

    Returns
    -------
    ndarray
        (tracks, 1 + detections); rows sum to 1, column 0 = missed.

    Raises
    ------
    InputError
        If shapes do not fit, a number is negative or not finite, or no event is possible.

    Warns
    -----
    UserWarning
        If a group needs more than ``most_states``. Pairs are then left out, those first
        whose every event weighs least against the best event of all, until it fits; the
        pairs of the best event stay, and the rest is exact for the pairs that are left.

    Examples
    --------
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
    """Return `joint_probabilities` of logarithms (-inf for 0)."""
    pairs, missed, unused, best = _scaled(log_likelihood, log_nonassignment)
    plans = _plans(pairs, unused)
    if any(plan.states > most_states for plan in plans):
        for plan in plans:
            if plan.states > most_states:
                _thin(pairs, unused, best, plan, most_states)
        plans = _plans(pairs, unused)
    unshared = np.column_stack([missed, np.where(_shared(pairs, unused), 0.0, pairs)])
    alone = unshared.sum(axis=1)  # weight of a track without a detection that others can have
    unshared /= np.where(alone > 0, alone, 1.0)[:, None]
    left, matched = np.ones(sum(pairs.shape)), np.zeros_like(pairs)
    for plan in plans:
        _sum_events(plan, [*alone.tolist(), *unused.tolist()], left, matched)
    unshared *= left[: len(pairs), None]
    unshared[:, 1:] += matched
    return _per_row(unshared)


def _scaled(
    log_likelihood: Array, log_nonassignment: Array
) -> tuple[Array, Array, Array, Integers]:
    """Return weights of pairs, of tracks and of detections left alone, and the best event.

    Tracks and detections get the dual prices of the best event as factors. All events change
    by the same factor, the best is a product of ones, and no weight is above 1: nothing
    overflows, and what underflows does not count. A price of a detection is 0 or below, 0 if
    one track alone can have it (shortest paths from the unused, by Bellman and Ford).
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


class _Plan(NamedTuple):
    """The order in which tracks and detections of one group leave the graph of shared pairs."""

    vertices: list[int]  # track i is i, detection j is tracks + j
    graph: Graph
    states: float  # of all tables together


def _shared(pairs: Array, unused: Array) -> npt.NDArray[np.bool_]:
    """Return the pairs (n, m) whose detection several tracks can have.

    A detection that only one can have needs no table, unless its weight unused is below 1.
    """
    inside = pairs > 0
    return inside & ((inside.sum(axis=0) > 1) | (unused < 1.0))


def _plans(pairs: Array, unused: Array) -> list[_Plan]:
    """Return a plan for each group of tracks that share detections.

    Where tables would be large, the best of some beginnings is taken.
    """
    graph: Graph = defaultdict(dict)
    tracks, detections = np.nonzero(_shared(pairs, unused))
    for i, j in zip(tracks.tolist(), detections.tolist(), strict=True):
        graph[i][len(pairs) + j] = graph[len(pairs) + j][i] = float(pairs[i, j])
    plans, planned = list[_Plan](), set[int]()
    for vertex in graph:
        if vertex not in planned:
            plan = _planned(graph, vertex)
            if plan.states > SMALL:
                begin = np.linspace(0, len(plan.vertices) - 1, TRIALS, dtype=int)
                others = [_planned(graph, plan.vertices[k]) for k in begin]
                plan = min([plan, *others], key=lambda trial: trial.states)
            plans.append(plan)
            planned.update(plan.vertices)
    return plans


def _planned(graph: Graph, vertex: int) -> _Plan:
    """Return the plan of a vertex's group that begins with it.

    The frontier are vertices that have lost a neighbour. Next comes the vertex, of the frontier
    or beside it, whose leaving lets the frontier grow least.
    """
    touched, frontier, beside = set[int](), set[int](), {vertex}
    vertices, states = list[int](), 0.0
    while frontier or beside:
        growth = {other: len(graph[other].keys() - touched) - 1.0 for other in frontier}
        growth |= {other: len(graph[other].keys() - touched) + 0.5 for other in beside}
        vertex = min(growth, key=lambda other: (growth[other], other))
        vertices.append(vertex)
        opened = graph[vertex].keys() - touched
        touched |= opened | {vertex}
        frontier = (frontier | opened) - {vertex}
        beside = beside.union(graph[vertex], *(graph[other] for other in opened)) - touched
        states += 2.0 ** len(frontier)
    return _Plan(vertices, graph, states)


def _sum_events(plan: _Plan, alone: list[float], left: Array, matched: Array) -> None:
    """Write the probabilities of a group's vertices alone to ``left``, of pairs to ``matched``.

    Vertices leave the graph one by one: alone, or matched with a neighbour that is still there.
    A table holds, for each set of frontier vertices that are already matched, the summed weight
    of the events so far; a bit is a vertex. A second pass, backwards, has the weight of all that
    can follow a set. No number is ever subtracted.
    """
    table, bits, steps = np.ones(1), list[int](), list[Any]()
    for k, vertex in enumerate(plan.vertices):
        near = {other: plan.graph[vertex].get(other, 0.0) for other in plan.vertices[k + 1 :]}
        near = {other: weight for other, weight in near.items() if weight}
        bit, free, taken = -1, table, np.zeros(1)
        if vertex in bits:
            bit = bits.index(vertex)
            free, taken = np.moveaxis(_halves(table, bit), 1, 0).reshape(2, -1)
        kept = [other for other in bits if other != vertex]
        bits = kept + [other for other in near if other not in kept]
        size = len(free)
        free = np.concatenate([free, np.zeros((size << (len(bits) - len(kept))) - size)])
        table = alone[vertex] * free
        table[:size] += taken
        for other, weight in near.items():
            place = bits.index(other)
            _halves(table, place)[:, 1] += weight * _halves(free, place)[:, 0]
        table /= table.max()
        steps.append((vertex, near, bits, bit, size, free, taken))
    follows = np.ones(1)
    for vertex, near, bits, bit, size, free, taken in reversed(steps):
        before = alone[vertex] * follows
        chances = [free @ before, taken @ follows[: len(taken)]]
        for other, weight in near.items():
            place = bits.index(other)
            ahead = weight * _halves(follows, place)[:, 1]
            _halves(before, place)[:, 0] += ahead
            chances.append((_halves(free, place)[:, 0] * ahead).sum())
        total = sum(chances)
        left[vertex] = chances[0] / total
        for other, chance in zip(near, chances[2:], strict=True):
            matched[min(vertex, other), max(vertex, other) - len(matched)] = chance / total
        if bit < 0:
            follows = before[:size]
        else:
            pieces = [part[:size].reshape(-1, 1 << bit) for part in (before, follows)]
            follows = np.stack(pieces, axis=1).ravel()
        follows = follows / follows.max()


def _halves(table: Array, bit: int) -> Array:
    """Return a view (..., 2, ...) of a table, without and with a bit."""
    return table.reshape(-1, 2, 1 << bit)


def _thin(pairs: Array, unused: Array, best: Integers, plan: _Plan, most_states: int) -> None:
    """Set the weakest pairs of a group that does not fit to 0, those of the best event last."""
    group = np.isin(np.arange(len(pairs)), plan.vertices)
    tracks, detections = np.nonzero(pairs * group[:, None])
    strongest = np.lexsort((-pairs[tracks, detections], best[tracks] != detections))
    tracks, detections = tracks[strongest], detections[strongest]
    weights = pairs[tracks, detections]

    def is_dense(count: int) -> bool:
        thinned = np.zeros_like(pairs)
        thinned[tracks[:count], detections[:count]] = weights[:count]
        return any(part.states > most_states for part in _plans(thinned, unused))

    count = bisect_left(range(1, len(tracks) + 1), True, key=is_dense)
    pairs[tracks[count:], detections[count:]] = 0.0
    warnings.warn(
        f"joint probabilities: {group.sum()} tracks share detections too densely to be summed "
        f"exactly; {len(tracks) - count} of {len(tracks)} pairs left out, whose events weigh at "
        f"most {weights[count]:.1e} of the best. Narrow the gate or raise most_states.",
        UserWarning,
        stacklevel=4,
    )


def feasible_events(validation: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    """Return every feasibility matrix of a validation matrix, Eqs 2.58 to 2.61, thesis.

    For figures and for counting; `joint_probabilities` never lists events.

    Parameters
    ----------
    validation
        (m, 1 + n) of 0 and 1: which detection lies in the gate of which track. Column 0
        is "no track" and holds ones (Eq. 2.57).

    Returns
    -------
    ndarray
        (events, m, 1 + n) uint8: one 1 per row, at most one per column but column 0. The
        first is the event without any pair; the order is that of the detections' tracks.

    Raises
    ------
    InputError
        If the matrix is not as described or has more than 2^20 events.

    Examples
    --------
    >>> len(feasible_events([[1, 1, 0], [1, 1, 1], [1, 0, 1], [1, 0, 1]]))  # Fig. 2.23
    11
    """
    omega = np.asarray(validation)
    if omega.ndim != 2 or not (np.isin(omega, (0, 1)).all() and (omega[:, :1] == 1).all()):
        raise InputError(
            f"validation matrix: shape {omega.shape}, expected (detections, 1 + tracks) of 0 and "
            "1, column 0 ('no track') of ones."
        )
    tracks = np.zeros((1, 0), dtype=np.intp)  # (events so far, detections so far)
    for row in omega:
        choices = np.flatnonzero(row)
        before = np.repeat(tracks, len(choices), axis=0)
        choice = np.tile(choices, len(tracks))
        taken = (before == choice[:, None]).any(axis=1) & (choice > 0)
        tracks = np.column_stack([before, choice])[~taken]
        if len(tracks) > MOST_EVENTS:
            raise InputError(
                f"validation matrix {omega.shape}: more than {MOST_EVENTS} feasible events; list "
                "those of a smaller group (joint_probabilities needs no list)."
            )
    return (tracks[:, :, None] == np.arange(omega.shape[1])).astype(np.uint8)


def most_events(tracks: int, detections: int) -> int:
    """Return the number of feasible events if all detections are in all gates, Eq. 2.62, thesis.

    Notes
    -----
    With fewer detections than tracks, the factorials of negative numbers that Eq. 2.62 then
    contains stand for no event.

    Examples
    --------
    >>> most_events(2, 4)
    21
    """
    check_count(tracks, "most_events: tracks", least=0)
    check_count(detections, "most_events: detections", least=0)
    return 1 + sum(comb(tracks, i) * perm(detections, tracks - i) for i in range(tracks))


def _per_row(weights: Array) -> Array:
    """Return weights divided by the sum of their row."""
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), dtype=np.float64)


def _costs(pairs: Pairs, associator: NearestNeighbor | GNN) -> Array:
    """Return the cost of each pair by Eq. 4.9, (n, m); inf outside the gate and above C_NA.

    Eq. 4.9 prints ln |P|; section 2.3.2, from which the term is "directly adopted", calls
    it the residual covariance S (Eq. 2.50), and S is what scales d^2. S is taken.
    """
    pairs = _checked(pairs)
    costs = pairs.distance_squared + pairs.log_determinant[:, None]
    costs += associator.size_weight * pairs.size_difference
    return np.where(costs > associator.nonassignment_cost, np.inf, costs)


def _log_likelihoods(pairs: Pairs, associator: PDA | JPDA) -> tuple[Array, Array]:
    """Return ln e_j (n, m), -inf outside the gate, and ln b (n,): Eqs 4.11 to 4.13, thesis.

    A track whose gate is empty has no density of detections (Eq. 4.13 gives 0); it is
    missed for certain, so its ln b is set to 0.
    """
    pairs = _checked(pairs)
    log_e = -0.5 * (pairs.distance_squared + associator.size_weight * pairs.size_difference)
    if associator.printed_determinant:
        log_e -= 0.5 * pairs.log_determinant[:, None]
    p_d, p_g = associator.detection_probability, pairs.gate_probability
    m = np.isfinite(pairs.distance_squared).sum(axis=1)
    log_spread = 0.5 * (pairs.dimensions * np.log(2 * np.pi) + pairs.log_determinant)
    log_b = np.zeros(len(m))  # log_spread: ln |2 pi S|^(1/2)
    log_density = np.log(m[m > 0] / pairs.gate_area[m > 0])
    log_b[m > 0] = log_density + log_spread[m > 0] + np.log((1 - p_d * p_g) / p_d)
    return log_e, log_b


def _checked(pairs: Pairs) -> Pairs:
    """Return the pairs as float64 arrays, or raise an `InputError` that names the bad field."""
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


def _check_costs(associator: NearestNeighbor | GNN) -> None:
    """Raise an `InputError` unless the parameters of Eq. 4.9 and C_NA can be used."""
    where, cost = type(associator).__name__, associator.nonassignment_cost
    check_at_least(associator.size_weight, 0, f"{where}: size_weight")
    if not is_number(cost):
        raise InputError(f"{where}: nonassignment_cost is {cost!r}, expected a finite number.")


def _check_probabilities(associator: PDA | JPDA) -> None:
    """Raise an `InputError` unless P_D lies between 0 and 1 and a_0 is a weight."""
    where, share = type(associator).__name__, associator.detection_probability
    check_at_least(associator.size_weight, 0, f"{where}: size_weight")
    check_kind(associator.printed_determinant, bool, f"{where}: printed_determinant")
    if not (is_number(share) and 0 < share < 1):
        raise InputError(
            f"{where}: detection_probability is {share!r}, expected between 0 and 1, both "
            "excluded: a track can always be missed, and never only missed."
        )


ASSOCIATORS: tuple[Associator, ...] = (NearestNeighbor(), GNN(), PDA(), JPDA())
