"""Joint events listed, the gate in flight, and what notebook 30 draws of them."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.experiments.association_cases import (
    NAMES,
    event_table,
    feasible_events,
    gate_table,
    interrupted_flight,
    most_events,
    sketched_outcomes,
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


def test_outcomes_of_the_sketches_are_read_off_the_weights():
    own = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0]])  # none, D1, D2, N1 of T1 and T2
    taken = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0]])
    shared = np.array([[0.1, 0.3, 0.6, 0], [0.2, 0, 0.8, 0]])
    clutter = np.array([[0.0, 0, 0, 1], [0, 0, 1, 0]])
    between = np.array([[0.0, 0.4, 0, 0.6], [0, 0, 1, 0]])
    weights = {("apart", name): own for name in NAMES}
    crowd, mixed = (taken, own, shared, shared), (clutter, clutter, between, between)
    weights |= {("crowded", name): part for name, part in zip(NAMES, crowd, strict=True)}
    weights |= {("clutter", name): part for name, part in zip(NAMES, mixed, strict=True)}
    assert sketched_outcomes(weights).tolist() == [True] * 6
    weights |= {("crowded", "NN"): own, ("clutter", "JPDA"): clutter}
    assert sketched_outcomes(weights).tolist() == [True, False, True, True, True, False]


def test_an_interrupted_flight_has_clutter_nearer_and_a_gap():
    table = interrupted_flight(0)
    particle = table[table["origin"] == "particle"]
    assert particle["frame"].tolist() == [0, 1, 2, 3, 4, 8, 9, 10, 11]
    assert particle.loc[particle["z"].isna(), "frame"].tolist() == [10]
    assert table["origin"].value_counts().to_dict() == {
        "other particle": 12, "particle": 9, "clutter": 1
    }  # fmt: skip
    nearer = table[table["origin"] == "clutter"]["z"].item() - particle["z"][3]
    assert nearer == pytest.approx(-2600)
