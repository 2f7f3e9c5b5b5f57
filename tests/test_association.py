"""Associators: what each keeps to and refuses, and each against its equations in plain code."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from kilnflight.association import (
    ASSOCIATORS,
    GNN,
    JPDA,
    PDA,
    NearestNeighbor,
    Pairs,
    assign,
)
from kilnflight.checks import InputError
from kilnflight.tracking.gate import Detected, Gate, Predicted

every = pytest.mark.parametrize("associator", ASSOCIATORS, ids=lambda a: type(a).__name__)
SHARING = (PDA,)  # PDA alone lets tracks share a detection
GATE = 16.0  # squared Mahalanobis distance


def make_pairs(tracks, detections, sigma=5.0, size=None):
    """Pairs of round gates of one sigma, in px, at places (n, 2) and (m, 2)."""
    tracks = np.reshape(np.asarray(tracks, dtype=float), (-1, 2))
    detections = np.reshape(np.asarray(detections, dtype=float), (-1, 2))
    distance = ((tracks[:, None] - detections[None]) ** 2).sum(axis=2) / sigma**2
    distance[distance >= GATE] = np.inf
    return Pairs(
        distance_squared=distance,
        log_determinant=np.full(len(tracks), np.log(sigma**4)),
        size_difference=np.zeros(distance.shape) if size is None else np.asarray(size, float),
        gate_area=np.full(len(tracks), np.pi * GATE * sigma**2),
        gate_probability=1 - np.exp(-GATE / 2),
    )


def crowd(seed, count=12, box=60.0):
    """Pairs of as many tracks as detections near them, in a box of px."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, box, (count, 2))
    return make_pairs(places, rng.permutation(places + rng.normal(0, 5, places.shape)))


@every
@pytest.mark.parametrize(("tracks", "detections"), [(0, 0), (0, 3), (3, 0), (2, 2)])
def test_nothing_in_the_gates_is_a_miss(associator, tracks, detections):
    far = make_pairs(np.zeros((tracks, 2)), np.full((detections, 2), 1000.0))
    weights = associator(far)
    assert weights.dtype == np.float64
    np.testing.assert_array_equal(weights, np.eye(1, 1 + detections).repeat(tracks, axis=0))


@every
@pytest.mark.parametrize("seed", range(5))
def test_rows_sum_to_one_and_detections_are_not_given_twice(associator, seed):
    pairs = crowd(seed)
    weights = associator(pairs)
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-12)
    assert (weights[:, 1:][np.isinf(pairs.distance_squared)] == 0).all()
    if not isinstance(associator, SHARING):
        assert (weights[:, 1:].sum(axis=0) <= 1 + 1e-12).all()


@every
@pytest.mark.parametrize("seed", range(5))
def test_order_of_tracks_and_detections_does_not_matter(associator, seed):
    pairs = crowd(seed)
    rng = np.random.default_rng(seed)
    rows, columns = rng.permutation(12), rng.permutation(12)
    mixed = pairs._replace(
        distance_squared=pairs.distance_squared[rows][:, columns],
        size_difference=pairs.size_difference[rows][:, columns],
        log_determinant=pairs.log_determinant[rows],
        gate_area=pairs.gate_area[rows],
    )
    expected = associator(pairs)[rows][:, np.concatenate([[0], 1 + columns])]
    np.testing.assert_allclose(associator(mixed), expected, rtol=1e-9, atol=1e-15)


@every
def test_the_input_is_left_as_it_was(associator):
    pairs = crowd(3)
    before = [np.copy(field) for field in pairs]
    associator(pairs)
    for field, copy in zip(pairs, before, strict=True):
        np.testing.assert_array_equal(field, copy)


@every
def test_one_track_on_its_detection_takes_it(associator):
    weights = associator(make_pairs([[0, 0]], [[0.5, 0], [900, 0]]))
    assert weights[0].argmax() == 1
    assert weights[0, 2] == 0


@every
def test_two_identical_detections(associator):
    weights = associator(make_pairs([[0, 0]], [[1, 1], [1, 1]]))
    if isinstance(associator, (GNN, NearestNeighbor)):
        assert weights.tolist() == [[0, 1, 0]]
    else:
        assert weights[0, 1] == pytest.approx(weights[0, 2], rel=1e-12)


@every
@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("distance_squared", np.nan, r"distance_squared at index \(0, 0\) is nan"),
        ("distance_squared", -1.0, "not 0 or more"),
        ("log_determinant", np.inf, r"log_determinant at index \(0,\)"),
        ("size_difference", np.nan, "size_difference"),
        ("size_difference", -1.0, "size_difference"),
        ("gate_area", 0.0, "not above 0"),
        ("gate_area", np.nan, "gate_area"),
    ],
)
def test_bad_numbers_are_refused(associator, field, value, message):
    pairs = crowd(0)
    array = getattr(pairs, field).copy()
    array.flat[0] = value
    with pytest.raises(InputError, match=message):
        associator(pairs._replace(**{field: array}))


@every
def test_bad_shapes_and_probabilities_are_refused(associator):
    pairs = crowd(0)
    for field in ("log_determinant", "size_difference", "gate_area"):
        with pytest.raises(InputError, match=f"{field}: shape"):
            associator(pairs._replace(**{field: getattr(pairs, field)[:-1]}))
    with pytest.raises(InputError, match="tracks, detections"):
        associator(pairs._replace(distance_squared=np.zeros(3)))
    for probability in (-0.1, 1.1, np.nan, None, "1"):
        with pytest.raises(InputError, match="gate_probability"):
            associator(pairs._replace(gate_probability=probability))


@pytest.mark.parametrize("kind", [PDA, JPDA])
@pytest.mark.parametrize("value", [0.0, 1.0, -0.1, np.nan, "0.9", None])
def test_a_detection_probability_outside_0_and_1_is_refused(kind, value):
    with pytest.raises(InputError, match="detection_probability"):
        kind(detection_probability=value)


@pytest.mark.parametrize("kind", [NearestNeighbor, GNN, PDA, JPDA])
@pytest.mark.parametrize("value", [-1.0, np.inf, np.nan, "a", None])
def test_an_invalid_size_weight_is_refused(kind, value):
    with pytest.raises(InputError, match="size_weight"):
        kind(size_weight=value)


@pytest.mark.parametrize("kind", [NearestNeighbor, GNN])
@pytest.mark.parametrize("value", [np.inf, np.nan, "a", None])
def test_an_invalid_cost_is_refused(kind, value):
    with pytest.raises(InputError, match="nonassignment_cost"):
        kind(nonassignment_cost=value)


@every
def test_a_gate_of_width_zero_leaves_every_track_missed(associator):
    at = np.zeros((2, 2))
    pairs = Gate(distance=0)(Predicted(at, np.tile(np.eye(2), (2, 1, 1))), Detected(at))
    assert pairs.gate_probability == 0.0
    assert associator(pairs).tolist() == [[1, 0, 0]] * 2


@every
def test_arguments_that_are_no_pairs_are_refused(associator):
    with pytest.raises(InputError, match="must be a Pairs"):
        associator(None)
    with pytest.raises(InputError, match="pairs: dimensions"):
        associator(crowd(0)._replace(dimensions=0))


def test_the_nearer_track_takes_it_and_the_other_goes_without():
    """Fig. 2.20, middle, and Fig. 2.21 (b): D2 lies nearer to T1, but belongs to T2."""
    pairs = make_pairs([[0, 0], [0, 12]], [[0, -6], [0, 5]])
    assert NearestNeighbor()(pairs).tolist() == [[0, 0, 1], [1, 0, 0]]
    assert GNN()(pairs).tolist() == [[0, 1, 0], [0, 0, 1]]


def test_noise_nearest_to_the_prediction_is_taken_by_both():
    """Fig. 2.20, right, and Fig. 2.21 (c)."""
    pairs = make_pairs([[0, 0]], [[0, 1], [0, 4]])
    for associator in (NearestNeighbor(), GNN()):
        assert associator(pairs).tolist() == [[0, 1, 0]]


def test_equal_costs_go_to_the_first():
    pairs = make_pairs([[0, 0], [0, 4]], [[0, 2]])
    assert NearestNeighbor()(pairs).tolist() == [[0, 1], [1, 0]]


def test_size_counts_when_it_is_asked_for():
    pairs = make_pairs([[0, 0]], [[0, 1], [0, 2]], size=[[500, 0]])
    assert NearestNeighbor()(pairs).tolist() == [[0, 1, 0]]
    assert NearestNeighbor(size_weight=0.01)(pairs).tolist() == [[0, 0, 1]]


def test_a_wide_gate_does_not_make_a_track_near():
    pairs = make_pairs([[0, 0], [0, 4]], [[0, 2.1]])
    lost = pairs._replace(
        distance_squared=pairs.distance_squared / np.array([[1.0], [100.0]]),
        log_determinant=pairs.log_determinant + np.array([0.0, 2 * np.log(100.0)]),
    )
    assert NearestNeighbor()(lost).tolist() == [[0, 1], [1, 0]]


def test_a_pair_dearer_than_the_cost_of_a_miss_is_impossible():
    pairs = make_pairs([[0, 0]], [[0, 5]])
    cost = 1.0 + np.log(5.0**4)
    assert NearestNeighbor(nonassignment_cost=cost)(pairs).tolist() == [[0, 1]]
    assert NearestNeighbor(nonassignment_cost=cost - 1e-9)(pairs).tolist() == [[1, 0]]


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
def test_no_assignment_is_cheaper(joint_events, cost, missed):
    missed = np.array(missed[: len(cost)])
    detection = assign(cost, missed)
    used = detection[detection >= 0]
    assert len(set(used)) == len(used)
    best = min(total(event, cost, missed) for event in joint_events(*cost.shape))
    assert total(detection, cost, missed) == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize(("tracks", "detections"), [(60, 60), (100, 40), (30, 90)])
def test_large_frames_against_another_solver(tracks, detections):
    """SciPy's solver for sparse graphs, another algorithm, on the pairs that are possible."""
    rng = np.random.default_rng(tracks)
    cost = rng.normal(0, 10, (tracks, detections))
    cost[rng.random(cost.shape) < 0.7] = np.inf
    missed = rng.normal(10, 3, tracks)
    possible = np.column_stack([np.isfinite(cost), np.eye(tracks, dtype=bool)])
    row, column = np.nonzero(possible)
    price = np.column_stack([cost, np.diag(missed)])[row, column]
    row, column = min_weight_full_bipartite_matching(csr_array((price, (row, column))))
    expected = total(np.where(column < detections, column, -1), cost, missed)
    detection = assign(cost, missed)
    used = detection[detection >= 0]
    assert len(set(used)) == len(used) > 0
    assert total(detection, cost, missed) == pytest.approx(expected, rel=1e-12)


def test_at_equal_cost_the_first_detection_is_taken_rather_than_none():
    assert assign(np.ones((3, 4)), np.ones(3)).tolist() == [0, 1, 2]


def test_the_cost_is_equation_4_9():
    """One track, two detections: distance, determinant and size worth exactly C_NA."""
    pairs = make_pairs([[0, 0]], [[0, 5], [900, 900]], size=[[300, 0]])
    cost = 1.0 + np.log(5.0**4) + 0.02 * 300
    assert GNN(size_weight=0.02, nonassignment_cost=cost + 1e-9)(pairs).tolist() == [[0, 1, 0]]
    assert GNN(size_weight=0.02, nonassignment_cost=cost - 1e-9)(pairs).tolist() == [[1, 0, 0]]


def test_the_penalty_of_an_uncertain_track():
    """Section 2.3.2: the lost track has the smaller distance, but ln |S| tells them apart."""
    pairs = make_pairs([[0, 0], [0, 0]], [[0, 2]])
    lost = pairs._replace(
        distance_squared=np.array([[0.16], [0.01]]),
        log_determinant=pairs.log_determinant + np.array([0.0, 3.0]),
    )
    assert GNN()(lost).tolist() == [[0, 1], [1, 0]]


def equations_in_plain_code(distance, size, sigma, area, p_g, p_d, a_0):
    """Weights of one track of a round gate: [beta_0, beta_1, ...]."""
    determinant = sigma**4
    power = [d + a_0 * n for d, n in zip(distance, size, strict=True)]
    e = [math.exp(-0.5 * c) for c in power]
    density = len(e) / area
    spread = math.sqrt((2 * math.pi) ** 2 * determinant)  # |2 pi S|^(1/2) of a 2 x 2 matrix
    b = density * spread * (1 - p_d * p_g) / p_d
    return np.array([b, *e]) / (b + sum(e))


def test_the_equations():
    size = [[120.0, 30.0, 0.0]]
    pairs = make_pairs([[0, 0]], [[0, 3], [4, 0], [900, 0]], size=size)
    beta = PDA(detection_probability=0.8, size_weight=0.02)(pairs)
    expected = equations_in_plain_code(
        [9 / 25, 16 / 25], size[0][:2], 5.0, float(pairs.gate_area[0]), pairs.gate_probability,
        0.8, 0.02,
    )  # fmt: skip
    np.testing.assert_allclose(beta[0], [*expected, 0.0], rtol=1e-12)


def test_units_do_not_matter():
    """The same scene in pixels half as wide."""
    scene = [np.array([[0.0, 0.0]]), np.array([[0.0, 3.0], [4.0, 0.0]])]
    coarse = PDA()(make_pairs(*scene))
    fine = PDA()(make_pairs(*(2 * places for places in scene), sigma=10.0))
    np.testing.assert_allclose(coarse, fine, rtol=1e-12)


def test_tracks_do_not_see_each_other():
    both = PDA()(make_pairs([[0, 0], [0, 6]], [[0, 2], [0, 4]]))
    alone = PDA()(make_pairs([[0, 0]], [[0, 2], [0, 4]]))
    np.testing.assert_allclose(both[0], alone[0], rtol=1e-12)
    np.testing.assert_allclose(both[1], alone[0, [0, 2, 1]], rtol=1e-12)


def test_likelihoods_too_small_for_a_float():
    pairs = make_pairs([[0, 0]], [[0, 1], [0, 2]], size=[[1e7, 1e7]])
    np.testing.assert_allclose(PDA()(pairs), [[1.0, 0.0, 0.0]])


def test_in_three_dimensions_by_hand():
    """Eq. 4.12 with |2 pi S|^(1/2) = (2 pi)^(3/2) 8 for S = 4 I, and a ball of four sigmas."""
    predicted = Predicted(np.zeros((1, 3)), 4.0 * np.eye(3)[None])
    pairs = Gate(4.0)(predicted, Detected(np.array([[2.0, 0.0, 0.0]])))
    assert pairs.dimensions == 3
    p_g = math.erf(4 / math.sqrt(2)) - math.sqrt(2 / math.pi) * 4 * math.exp(-8)  # chi, 3 degrees
    density = 1 / (4 / 3 * math.pi * (4 * 2) ** 3)
    b = density * (2 * math.pi) ** 1.5 * 8 * (1 - 0.9 * p_g) / 0.9
    e = math.exp(-0.5)
    np.testing.assert_allclose(PDA()(pairs), [[b / (b + e), e / (b + e)]], rtol=1e-12)
    np.testing.assert_allclose(JPDA()(pairs), [[b / (b + e), e / (b + e)]], rtol=1e-12)


def test_jpda_is_pda_where_nothing_is_shared():
    pairs = make_pairs([[0, 0], [500, 0]], [[0, 2], [500, 4], [503, 0]])
    np.testing.assert_allclose(JPDA()(pairs), PDA()(pairs), rtol=1e-12)


def test_jpda_keeps_two_close_tracks_apart():
    pairs = make_pairs([[0, 0], [0, 6]], [[0, 0], [0, 6]])
    first, joint = PDA()(pairs), JPDA()(pairs)
    assert joint[0, 1] > first[0, 1] > first[0, 2] > joint[0, 2]
