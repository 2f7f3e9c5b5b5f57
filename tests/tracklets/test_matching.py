import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from kilnflight.checks import InputError
from kilnflight.tracklets import DualNearest, Hungarian, Pairs, listed

C = np.inf
MATCHINGS = (DualNearest(), Hungarian())


def chosen(matching, matrix):
    pairs = listed(matrix)
    found = matching(pairs)
    return sorted(zip(pairs.one[found].tolist(), pairs.other[found].tolist(), strict=True))


def test_munkres_gives_up_the_nearest_pair_and_dnn_does_not():
    """As in Fig. 4.14, whose numbers the text does not give: 1-2 is best, Munkres takes 1-3."""
    matrix = np.full((4, 4), C)
    matrix[0, 1], matrix[0, 2], matrix[3, 1] = 1.0, 5.0, 4.0
    assert chosen(DualNearest(), matrix) == [(0, 1)]
    assert chosen(Hungarian(), matrix) == [(0, 2), (3, 1)]


def test_a_tracklet_has_one_nearest_neighbour_on_either_side():
    matrix = np.full((3, 3), C)
    matrix[0, 1], matrix[1, 2] = 2.0, 1.0
    assert chosen(DualNearest(), matrix) == [(1, 2)]
    assert chosen(Hungarian(), matrix) == [(0, 1), (1, 2)]


@pytest.mark.parametrize("matching", MATCHINGS)
def test_nothing_possible_is_nothing(matching):
    for size in (0, 3):
        found = matching(listed(np.full((size, size), C)))
        assert found.shape == (0,)
        assert found.dtype == np.int64
    assert chosen(matching, [[C, 0.0], [C, C]]) == [(0, 1)]


def random_matrix(seed, size, levels):
    rng = np.random.default_rng(seed)
    matrix = rng.integers(0, levels, (size, size)).astype(float)
    matrix[rng.random((size, size)) < 0.6] = C
    return np.triu(matrix, 1) + np.tril(np.full((size, size), C))


matrices = st.builds(
    random_matrix, st.integers(0, 2**32 - 1), st.integers(1, 9), st.sampled_from([3, 10**6])
)


@given(matrices)
def test_dual_nearest_is_mutual_and_holds_the_cheapest(matrix):
    either = np.minimum(matrix, matrix.T)
    nearest = either.argmin(axis=1)
    expected = [
        (i, int(k))
        for i, k in enumerate(nearest)
        if i < k and nearest[k] == i and np.isfinite(either[i, k])
    ]
    assert chosen(DualNearest(), matrix) == expected
    if np.isfinite(matrix).any():
        assert min(matrix[i, k] for i, k in expected) == matrix.min()


@given(matrices)
def test_hungarian_costs_what_scipy_costs(matrix):
    one, other = linear_sum_assignment(np.where(np.isfinite(matrix), matrix, 1e9))
    costs = matrix[one, other]
    found = chosen(Hungarian(), matrix)
    assert len(found) == np.isfinite(costs).sum()
    assert sum(matrix[i, k] for i, k in found) == pytest.approx(costs[np.isfinite(costs)].sum())


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        ([1, 2], "cost matrix: shape"),
        (np.zeros((2, 3)), "cost matrix: shape"),
        ([["a"]], "cost matrix: it holds"),
        ([[C, -1.0], [C, C]], "tracklets 0 and 1 cost -1.0"),
        ([[C, np.nan], [C, C]], "tracklets 0 and 1 cost nan"),
        (-np.ones((2, 2)) * C, "cost -inf"),
    ],
)
def test_costs_that_are_none(matrix, message):
    with pytest.raises(InputError, match=message):
        listed(matrix)


@pytest.mark.parametrize("matching", MATCHINGS)
@pytest.mark.parametrize("cost", [-1.0, np.nan, C])
def test_a_list_with_costs_that_are_none(matching, cost):
    with pytest.raises(InputError, match="tracklets 3 and 4 cost"):
        matching(Pairs(np.array([3]), np.array([4]), np.array([cost])))
