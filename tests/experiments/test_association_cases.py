"""Joint events listed, the gate in flight, and what notebook 30 draws of them."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.experiments.association_cases import (
    event_table,
    feasible_events,
    gate_table,
    most_events,
)

FIGURE_2_23 = [[1, 1, 0], [1, 1, 1], [1, 0, 1], [1, 0, 1]]


def joint_events(tracks, detections):
    """Yield every joint event, by trying all: the detection of each track, or -1."""
    for event in product(range(-1, detections), repeat=tracks):
        used = [detection for detection in event if detection >= 0]
        if len(set(used)) == len(used):
            yield event


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


@given(st.integers(0, 4), st.integers(0, 4))
def test_the_bound_is_reached_by_a_matrix_of_ones(tracks, detections):
    matrices = feasible_events(np.ones((detections, 1 + tracks)))
    assert len(matrices) == most_events(tracks, detections)


@given(st.integers(0, 2**32 - 1))
def test_events_are_those_found_by_trying_all(seed):
    gates = np.random.default_rng(seed).random((3, 4)) < 0.6  # tracks, detections
    matrices = feasible_events(np.column_stack([np.ones(4), gates.T]))
    inside = [
        event
        for event in joint_events(3, 4)
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
def test_invalid_matrices_are_refused(matrix, message):
    with pytest.raises(InputError, match=message):
        feasible_events(matrix)


@pytest.mark.parametrize("numbers", [(-1, 2), (2, -1), (1.5, 2), ("a", 2), (2, None)])
def test_invalid_numbers_are_refused(numbers):
    with pytest.raises(InputError, match="must be a whole number from 0"):
        most_events(*numbers)


def test_the_sum_over_events_is_the_joint_probability():
    table = event_table(np.array(FIGURE_2_23, dtype=np.uint8))
    np.testing.assert_allclose(table["joint"], table["sum_over_events"], rtol=1e-12)
    assert table[["track", "detection"]].iloc[[0, -1]].to_numpy().tolist() == [
        ["T1", "none"],
        ["T2", "D4"],
    ]
    assert sum(name.startswith("event_") for name in table.columns) == 11


def test_a_detection_at_another_depth_is_in_the_ellipse_only():
    frame = np.arange(6)
    path = pd.DataFrame({"frame": frame, "row": 3.0 * frame, "col": 20.0 * frame, "z": 5000.0})
    near = path[path["frame"] == 4].assign(row=13.0, z=2000.0)
    table = gate_table(pd.concat([path, near], ignore_index=True))
    assert table["frame"].min() == 1
    assert table["in_ellipse"].all()
    assert table.loc[~table["in_gate"], "z"].tolist() == [2000.0]
