"""Nearest neighbour: what Fig. 2.20 shows."""

import numpy as np

from kilnflight.association import GNN, NearestNeighbor


def test_the_nearer_track_takes_it_and_the_other_goes_without(make_pairs):
    """Fig. 2.20, middle, and Fig. 2.21 (b): D2 lies nearer to T1, but belongs to T2."""
    pairs = make_pairs([[0, 0], [0, 12]], [[0, -6], [0, 5]])
    assert NearestNeighbor()(pairs).tolist() == [[0, 0, 1], [1, 0, 0]]
    assert GNN()(pairs).tolist() == [[0, 1, 0], [0, 0, 1]]


def test_noise_nearest_to_the_prediction_is_taken_by_both(make_pairs):
    """Fig. 2.20, right, and Fig. 2.21 (c)."""
    pairs = make_pairs([[0, 0]], [[0, 1], [0, 4]])
    for associator in (NearestNeighbor(), GNN()):
        assert associator(pairs).tolist() == [[0, 1, 0]]


def test_equal_costs_go_to_the_first(make_pairs):
    pairs = make_pairs([[0, 0], [0, 4]], [[0, 2]])
    assert NearestNeighbor()(pairs).tolist() == [[0, 1], [1, 0]]


def test_size_counts_when_it_is_asked_for(make_pairs):
    pairs = make_pairs([[0, 0]], [[0, 1], [0, 2]], size=[[500, 0]])
    assert NearestNeighbor()(pairs).tolist() == [[0, 1, 0]]
    assert NearestNeighbor(size_weight=0.01)(pairs).tolist() == [[0, 0, 1]]


def test_a_wide_gate_does_not_make_a_track_near(make_pairs):
    pairs = make_pairs([[0, 0], [0, 4]], [[0, 2.1]])
    lost = pairs._replace(
        distance_squared=pairs.distance_squared / np.array([[1.0], [100.0]]),
        log_determinant=pairs.log_determinant + np.array([0.0, 2 * np.log(100.0)]),
    )
    assert NearestNeighbor()(lost).tolist() == [[0, 1], [1, 0]]


def test_a_pair_dearer_than_the_cost_of_a_miss_is_impossible(make_pairs):
    pairs = make_pairs([[0, 0]], [[0, 5]])
    cost = 1.0 + np.log(5.0**4)
    assert NearestNeighbor(nonassignment_cost=cost)(pairs).tolist() == [[0, 1]]
    assert NearestNeighbor(nonassignment_cost=cost - 1e-9)(pairs).tolist() == [[1, 0]]
