"""Validation matrix and feasibility matrices of Fig. 2.23."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.association import feasible_events, most_events, validation_matrix
from kilnflight.checks import InputError

FIGURE_2_23 = [[1, 1, 0], [1, 1, 1], [1, 0, 1], [1, 0, 1]]


def test_figure_2_23_has_eleven_matrices():
    matrices = feasible_events(FIGURE_2_23)
    assert matrices.shape == (11, 4, 3)
    assert len(np.unique(matrices.reshape(11, -1), axis=0)) == 11
    assert (matrices.sum(axis=2) == 1).all()  # Eq. 2.60: each detection once
    assert (matrices[:, :, 1:].sum(axis=1) <= 1).all()  # Eq. 2.61: each track at most once
    assert (matrices <= np.array(FIGURE_2_23)).all()
    assert matrices[0].tolist() == [[1, 0, 0]] * 4  # Omega_1
    omega_3 = [[0, 1, 0], [0, 0, 1], [1, 0, 0], [1, 0, 0]]
    assert (matrices == omega_3).all(axis=(1, 2)).any()


def test_the_validation_matrix_of_gates(make_pairs):
    pairs = make_pairs([[0, 0], [0, 20]], [[0, -10], [0, 10], [0, 25], [5, 25]])
    assert validation_matrix(pairs).tolist() == FIGURE_2_23


@given(st.integers(0, 4), st.integers(0, 4))
def test_the_bound_is_reached_by_a_matrix_of_ones(tracks, detections):
    matrices = feasible_events(np.ones((detections, 1 + tracks)))
    assert len(matrices) == most_events(tracks, detections)


@given(st.integers(0, 2**32 - 1))
def test_events_are_those_found_by_trying_all(events, seed):
    gates = np.random.default_rng(seed).random((3, 4)) < 0.6  # tracks, detections
    matrices = feasible_events(np.column_stack([np.ones(4), gates.T]))
    inside = [
        event
        for event in events(3, 4)
        if all(detection < 0 or gates[track, detection] for track, detection in enumerate(event))
    ]
    assert len(matrices) == len(inside)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        ([[0, 1]], "column 0"),
        ([[1, 2]], "of 0 and 1"),
        ([1, 1], "of 0 and 1"),
        ([[1.0, np.nan]], "of 0 and 1"),
        (np.ones((12, 13)), "more than 1048576 feasible events"),
    ],
)
def test_matrices_that_are_none(matrix, message):
    with pytest.raises(InputError, match=message):
        feasible_events(matrix)


@pytest.mark.parametrize("numbers", [(-1, 2), (2, -1), (1.5, 2), ("a", 2), (2, None)])
def test_numbers_that_are_none(numbers):
    with pytest.raises(InputError, match="must be a whole number from 0"):
        most_events(*numbers)
