"""Associators: what all keep to, and each against its equations in plain code."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tests.definitions.joint_events import joint_events
from tests.definitions.pairs import weighed

from kilnflight.association import ASSOCIATORS, GNN, JPDA, PDA, NearestNeighbor, assign
from kilnflight.tracking.filter import Detected, Gate

every = pytest.mark.parametrize(
    "associator", ASSOCIATORS, ids=lambda a: type(a).__name__
)


def make_pairs(tracks, detections, sigma=5.0, points=(0.0,)):
    """Pairs of round gates of one sigma, in px, at places (n, 2) and (m, 2)."""
    expected, detected = np.array(tracks, float), np.array(detections, float)
    residual = np.broadcast_to(sigma**2 * np.eye(2), (len(expected), 2, 2))
    seen = Detected(detected, points=np.broadcast_to(points, len(detected)))
    return Gate()(expected, residual, seen, points=np.zeros(len(expected)))


def crowd(seed, count=12, box=60.0):
    """As many tracks as detections near them, in a box of px."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, box, (count, 2))
    return places, rng.permutation(places + rng.normal(0, 5, places.shape))


@every
@pytest.mark.parametrize(("tracks", "detections"), [(0, 0), (0, 3), (3, 0), (2, 2)])
def test_nothing_in_the_gates_is_a_miss(associator, tracks, detections):
    far = make_pairs(np.zeros((tracks, 2)), np.full((detections, 2), 1000.0))
    weights = weighed(associator, far)
    np.testing.assert_array_equal(
        weights, np.eye(1, 1 + detections).repeat(tracks, axis=0)
    )


@every
@pytest.mark.parametrize("seed", range(3))
def test_weights_and_their_independence_of_the_order(associator, seed):
    places, detections = crowd(seed)
    pairs = make_pairs(places, detections)
    weights = weighed(associator, pairs)
    assert (associator(pairs) >= 0).all()
    assert (weights[:, 0] > -1e-12).all()
    if not isinstance(associator, PDA):  # PDA alone lets tracks share a detection
        assert (weights[:, 1:].sum(axis=0) <= 1 + 1e-12).all()
    rows, columns = np.random.default_rng(seed).permuted(
        np.tile(np.arange(12), (2, 1)), axis=1
    )
    mixed = weighed(associator, make_pairs(places[rows], detections[columns]))
    expected = weights[rows][:, np.concatenate([[0], 1 + columns])]
    np.testing.assert_allclose(mixed, expected, rtol=1e-9, atol=1e-15)


def test_situations_of_figs_2_20_and_2_21():
    """D2 lies nearer to T1, but belongs to T2; noise nearest to the prediction is
    taken.
    """
    middle = make_pairs([[0, 0], [0, 12]], [[0, -6], [0, 5]])
    assert weighed(NearestNeighbor(), middle).tolist() == [[0, 0, 1], [1, 0, 0]]
    assert weighed(GNN(), middle).tolist() == [[0, 1, 0], [0, 0, 1]]
    right = make_pairs([[0, 0]], [[0, 1], [0, 4]])
    for associator in (NearestNeighbor(), GNN()):
        assert weighed(associator, right).tolist() == [[0, 1, 0]]
    tie = make_pairs([[0, 0], [0, 4]], [[0, 2]])
    assert weighed(NearestNeighbor(), tie).tolist() == [[0, 1], [1, 0]]


@pytest.mark.parametrize("kind", [NearestNeighbor, GNN])
def test_the_cost_is_eq_4_9(kind):
    """One track, two detections: distance, determinant and size worth exactly C_NA."""
    pairs = make_pairs([[0, 0]], [[0, 5], [900, 900]], points=[300, 0])
    cost = 1.0 + np.log(5.0**4) + 0.02 * 300
    for nonassignment, weights in ((cost + 1e-9, [0, 1, 0]), (cost - 1e-9, [1, 0, 0])):
        assert weighed(kind(0.02, nonassignment), pairs).tolist() == [weights]
    lost = make_pairs(
        [[0, 0], [0, 0]], [[0, 2]]
    )._replace(  # near, but with a wide gate
        distance_squared=np.array([0.16, 0.01]), log_determinant=np.array([6.0, 9.0])
    )
    assert weighed(kind(), lost).tolist() == [[0, 1], [1, 0]]


@given(arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(1, 5)),
              elements=st.integers(-40, 41).map(lambda n: n / 2 if n < 41 else np.inf)),
       st.lists(st.integers(-10, 40), min_size=4, max_size=4))  # fmt: skip
def test_no_assignment_is_cheaper(cost, missed):
    def total(event):
        return sum(
            cost[row, k] if k >= 0 else missed[row] for row, k in enumerate(event)
        )

    track, detection = np.isfinite(cost).nonzero()
    taken = assign(
        track, detection, cost[track, detection], np.array(missed[: len(cost)], float)
    )
    assert np.bincount(detection[taken], minlength=1).max() <= 1
    event = np.full(len(cost), -1)
    event[track[taken]] = detection[taken]
    assert total(event) == min(total(event) for event in joint_events(*cost.shape))


def test_of_equal_costs_the_first_pair_is_taken_and_none_is_missed():
    track, detection = np.array([0, 0, 1]), np.array([0, 1, 2])
    cost, missed = np.array([3.0, 3.0, 5.0]), np.array([4.0, 5.0])
    assert assign(track, detection, cost, missed).tolist() == [True, False, True]


def test_pda_is_the_printed_equations():
    """Eqs 4.10 to 4.13 of one track, in numbers; likelihoods too small for a float are
    misses.
    """
    size, p_d, sigma = [120.0, 30.0, 0.0], 0.8, 5.0
    pairs = make_pairs([[0, 0]], [[0, 3], [4, 0], [900, 0]], points=size)
    e = [math.exp(-0.5 * (d / 25 + 0.02 * n)) for d, n in ((9, 120), (16, 30))]
    density, p_g = 2 / (math.pi * 16 * sigma**2), 1 - math.exp(-8)
    b = density * 2 * math.pi * sigma**2 * (1 - p_d * p_g) / p_d
    expected = np.array([[b, *e, 0.0]]) / (b + sum(e))
    for kind in (PDA, JPDA):
        np.testing.assert_allclose(
            weighed(kind(p_d, 0.02), pairs), expected, rtol=1e-12
        )
    tiny = make_pairs([[0, 0]], [[0, 1], [0, 2]], points=[1e7, 1e7])
    np.testing.assert_allclose(weighed(PDA(), tiny), [[1.0, 0.0, 0.0]])
