"""GNN against every assignment there is, and against scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment

from kilnflight.association import GNN
from kilnflight.association.assignment import assign

costs = arrays(
    np.float64,
    st.tuples(st.integers(1, 5), st.integers(1, 5)),
    elements=st.one_of(st.integers(-4, 4).map(float), st.floats(-20, 20), st.just(np.inf)),
)


def total(column_of, cost, missed):
    """The global cost of an assignment."""
    return sum(
        missed[row] if column < 0 else cost[row, column] for row, column in enumerate(column_of)
    )


@given(costs, st.lists(st.floats(-5, 20), min_size=5, max_size=5))
def test_no_assignment_is_cheaper(events, cost, missed):
    missed = np.array(missed[: len(cost)])
    column_of, row_price, column_price, stuck = assign(cost, missed)
    assert stuck == -1
    used = column_of[column_of >= 0]
    assert len(set(used)) == len(used)
    best = min(total(event, cost, missed) for event in events(*cost.shape))
    assert total(column_of, cost, missed) == pytest.approx(best, abs=1e-9)
    # The prices prove it.
    assert (cost - row_price[:, None] - column_price >= -1e-9).all()
    assert (missed - row_price >= -1e-9).all()
    assert (column_price <= 0).all()
    assert row_price.sum() + column_price.sum() == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize(("tracks", "detections"), [(60, 60), (100, 40), (30, 90)])
def test_large_frames_against_scipy(tracks, detections):
    rng = np.random.default_rng(tracks)
    cost = rng.normal(0, 10, (tracks, detections))
    cost[rng.random(cost.shape) < 0.7] = np.inf
    missed = rng.normal(10, 3, tracks)
    private = np.where(np.eye(tracks, dtype=bool), missed, 1e6)
    square = np.column_stack([np.where(np.isinf(cost), 1e6, cost), private])
    row, column = linear_sum_assignment(square)
    expected = square[row, column].sum()
    assert total(assign(cost, missed)[0], cost, missed) == pytest.approx(expected, rel=1e-12)


def test_a_row_that_must_have_a_column_and_finds_none_is_named():
    cost = np.array([[1.0], [1.0], [2.0]])
    assert assign(cost, np.array([np.inf, 5.0, np.inf]))[3] == 2


def test_the_cost_is_equation_4_9(make_pairs):
    """One track, two detections: distance, determinant and size worth exactly C_NA."""
    pairs = make_pairs([[0, 0]], [[0, 5], [900, 900]], size=[[300, 0]])
    cost = 1.0 + np.log(5.0**4) + 0.02 * 300
    assert GNN(size_weight=0.02, nonassignment_cost=cost + 1e-9)(pairs).tolist() == [[0, 1, 0]]
    assert GNN(size_weight=0.02, nonassignment_cost=cost - 1e-9)(pairs).tolist() == [[1, 0, 0]]


def test_the_penalty_of_an_uncertain_track(make_pairs):
    """Section 2.3.2: the lost track has the smaller distance, but ln |S| tells them apart."""
    pairs = make_pairs([[0, 0], [0, 0]], [[0, 2]])
    lost = pairs._replace(
        distance_squared=np.array([[0.16], [0.01]]),
        log_determinant=pairs.log_determinant + np.array([0.0, 3.0]),
    )
    assert GNN()(lost).tolist() == [[0, 1], [1, 0]]
