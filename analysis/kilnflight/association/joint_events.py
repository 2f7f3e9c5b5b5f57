"""Exact probabilities of association over all joint events (thesis, Eqs 2.63 and 2.64)."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from kilnflight.association.assignment import assign
from kilnflight.association.elimination import graph_of, make_plan, states
from kilnflight.association.event_sums import sum_events
from kilnflight.association.pairs import Array
from kilnflight.checks import InputError, check_between, check_count, check_finite, check_shape

# States of all tables of one group, 8 bytes each: 256 MiB. 20 tracks that all share the same
# 20 detections fit exactly (20 tables of 2^20 states), in 1.6 s; a group at the bound takes 4 s.
MOST_STATES = 2**25


def joint_probabilities(
    likelihood: npt.ArrayLike, nonassignment: npt.ArrayLike, most_states: int = MOST_STATES
) -> Array:
    """Return the probability of each track's detection over all joint events, Eq. 2.64, thesis.

    The weight of a joint event is the product of the likelihoods of its pairs and of the
    nonassignment of its tracks without detection; each detection is in at most one pair.
    Events are summed, not listed: the cost grows with the number of tracks and, for each
    group, with 2 to the number of tracks and detections that its early and late parts share.

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
    check_states(most_states, "joint probabilities")
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
    return marginals(_log(pairs), _log(missed), most_states)


def check_states(most_states: int, where: str) -> None:
    """Raise an `InputError` unless a single pair fits into the tables."""
    check_count(most_states, f"{where}: most_states", least=4)
    check_between(most_states, 4, 2**32, f"{where}: most_states")


def _log(values: Array) -> Array:
    """Return the logarithm, -inf for 0."""
    return np.log(values, out=np.full(values.shape, -np.inf), where=values > 0)


def marginals(log_likelihood: Array, log_nonassignment: Array, most_states: int) -> Array:
    """Return `joint_probabilities` of logarithms (-inf for 0)."""
    weights, stuck, fits = _solve(log_likelihood, log_nonassignment, float(most_states))
    if stuck >= 0:
        raise InputError(
            f"no joint event is possible: track {stuck} must have a detection (nonassignment 0) "
            "but finds none that other such tracks can spare. Give it a nonassignment above 0."
        )
    if not fits:
        thinned = _thin(log_likelihood, log_nonassignment, most_states)
        weights = _solve(thinned, log_nonassignment, np.inf)[0]
    return np.asarray(weights, dtype=np.float64)


@njit(cache=True)
def _factors(log_likelihood: Any, log_nonassignment: Any) -> Any:
    """Return scaled weights of pairs, of vertices left alone, the best event and a stuck track.

    Tracks and detections get the prices of the cheapest assignment as factors. All events
    change by the same factor, the best weighs 1 as the product of ones, and no weight of
    a pair or of a miss is above 1: nothing overflows, and what underflows does not count.
    """
    tracks, detections = log_likelihood.shape
    best, row_price, column_price, stuck = assign(-log_likelihood, -log_nonassignment)
    pairs = np.zeros((tracks, detections))
    alone = np.empty(tracks + detections)
    for track in range(tracks):
        alone[track] = np.exp(min(0.0, log_nonassignment[track] + row_price[track]))
        for detection in range(detections):
            log = log_likelihood[track, detection]
            if log > -np.inf:
                log += row_price[track] + column_price[detection]
                pairs[track, detection] = np.exp(min(0.0, log))
    for detection in range(detections):
        alone[tracks + detection] = np.exp(column_price[detection])
    return pairs, alone, best, stuck


@njit(cache=True)
def _solve(log_likelihood: Any, log_nonassignment: Any, most_states: float) -> Any:
    """Return the probabilities, the stuck track or -1, and whether the tables fit."""
    tracks, detections = log_likelihood.shape
    weights = np.zeros((tracks, 1 + detections))
    weights[:, 0] = 1.0
    pairs, alone, _, stuck = _factors(log_likelihood, log_nonassignment)
    if stuck >= 0:
        return weights, stuck, True
    plan = make_plan(graph_of(pairs))
    if states(plan) > most_states:
        return weights, stuck, False
    sum_events(plan, alone, tracks, weights)
    for track in range(tracks):
        weights[track] /= weights[track].sum()
    return weights, stuck, True


def _thin(log_likelihood: Array, log_nonassignment: Array, most_states: int) -> Array:
    """Return the logarithms without the weakest pairs of each group that does not fit."""
    pairs, _, best, _ = _factors(log_likelihood, log_nonassignment)
    tracks = len(pairs)
    row, column = np.nonzero(pairs)
    size = sum(pairs.shape)
    links = coo_array((np.ones(len(row)), (row, tracks + column)), shape=(size, size))
    group = connected_components(links, directed=False)[1][:tracks]
    thinned = log_likelihood.copy()
    for label in np.unique(group):
        own = np.where((group == label)[:, None], pairs, 0.0)
        if states(make_plan(graph_of(own))) <= most_states:
            continue
        track, detection = np.nonzero(own)
        weakest_last = np.lexsort((-own[track, detection], best[track] != detection))
        track, detection = track[weakest_last], detection[weakest_last]
        kept = _most_that_fit(own, track, detection, most_states)
        thinned[track[kept:], detection[kept:]] = -np.inf
        warnings.warn(
            f"joint probabilities: {np.sum(group == label)} tracks share detections too densely "
            f"to be summed exactly; {len(track) - kept} of {len(track)} pairs left out, whose "
            f"events weigh at most {own[track[kept], detection[kept]]:.1e} of the best. "
            "Narrow the gate or raise most_states.",
            UserWarning,
            stacklevel=4,
        )
    return thinned


def _most_that_fit(
    pairs: Array, track: npt.NDArray[np.intp], detection: npt.NDArray[np.intp], most_states: int
) -> int:
    """Return how many of the pairs, from the first, make tables that fit, by bisection."""
    fits, too_many = 0, len(track)
    while too_many - fits > 1:
        middle = (fits + too_many) // 2
        some = np.zeros_like(pairs)
        some[track[:middle], detection[:middle]] = pairs[track[:middle], detection[:middle]]
        if states(make_plan(graph_of(some))) <= most_states:
            fits = middle
        else:
            too_many = middle
    return fits
