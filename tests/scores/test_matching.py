from itertools import permutations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from kilnflight.scores.detections import pair

places = st.lists(st.tuples(st.integers(0, 120), st.integers(0, 60)), max_size=5)


def best_of_all(first, second, gate):
    """Number of pairs and sum of distances of the best of every possible assignment."""
    if len(first) > len(second):
        first, second = second, first
    best = (0, 0.0)
    for order in permutations(range(len(second)), len(first)):
        distances = [np.hypot(*np.subtract(first[i], second[j])) for i, j in enumerate(order)]
        within = [d for d in distances if d <= gate]
        best = min(best, (-len(within), sum(within)))
    return -best[0], best[1]


@settings(deadline=None)
@given(places, places, st.integers(1, 80))
def test_no_other_assignment_is_better(first, second, gate):
    one, two = (np.array(x, dtype=float).reshape(-1, 2) for x in (first, second))
    pairs = pair(one, two, gate)
    distances = np.hypot(*(one[pairs[:, 0]] - two[pairs[:, 1]]).T)
    assert (distances <= gate).all()
    assert all(len(np.unique(column)) == len(pairs) for column in pairs.T)
    count, cost = best_of_all(first, second, gate)
    assert len(pairs) == count
    np.testing.assert_allclose(distances.sum(), cost)


def test_hundreds_are_assigned_as_the_whole_matrix_of_eq_3_4():
    generator = np.random.default_rng(0)
    for size in (50, 300):
        first = generator.uniform(0, 1000, (size, 2))
        second = generator.uniform(0, 1000, (size + 70, 2))
        distance = cdist(first, second)
        cost = np.where(distance <= 45, distance, 1e6)
        row, col = linear_sum_assignment(cost)
        expected = np.stack([row, col], axis=1)[cost[row, col] < 1e6]
        found = pair(first, second, 45.0)
        np.testing.assert_array_equal(found[np.argsort(found[:, 0])], expected)


def test_equal_places_are_paired_once_each():
    found = pair(np.zeros((3, 2)), np.zeros((2, 2)), 1.0)
    assert len(found) == len(np.unique(found[:, 0])) == len(np.unique(found[:, 1])) == 2


def test_nothing_pairs_with_nothing():
    for first, second in ((0, 0), (0, 3), (3, 0)):
        found = pair(np.zeros((first, 2)), np.zeros((second, 2)), 1.0)
        assert found.shape == (0, 2)
        assert found.dtype == np.intp
    assert pair(np.zeros((1, 2)), np.ones((1, 2)), 1.0).shape == (0, 2)
