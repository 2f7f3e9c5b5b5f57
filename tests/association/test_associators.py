"""What every associator keeps to, and what it refuses."""

import numpy as np
import pytest

from kilnflight.association import ASSOCIATORS, GNN, JPDA, PDA, NearestNeighbor
from kilnflight.checks import InputError
from kilnflight.tracking.gate import Detected, Gate, Predicted

every = pytest.mark.parametrize("associator", ASSOCIATORS, ids=lambda a: type(a).__name__)
SHARING = (PDA,)  # PDA alone lets tracks share a detection


@every
@pytest.mark.parametrize(("tracks", "detections"), [(0, 0), (0, 3), (3, 0), (2, 2)])
def test_nothing_in_the_gates_is_a_miss(associator, make_pairs, tracks, detections):
    far = make_pairs(np.zeros((tracks, 2)), np.full((detections, 2), 1000.0))
    weights = associator(far)
    assert weights.dtype == np.float64
    np.testing.assert_array_equal(weights, np.eye(1, 1 + detections).repeat(tracks, axis=0))


@every
@pytest.mark.parametrize("seed", range(5))
def test_rows_sum_to_one_and_detections_are_not_given_twice(associator, crowd, seed):
    pairs = crowd(seed)
    weights = associator(pairs)
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-12)
    assert (weights[:, 1:][np.isinf(pairs.distance_squared)] == 0).all()
    if not isinstance(associator, SHARING):
        assert (weights[:, 1:].sum(axis=0) <= 1 + 1e-12).all()


@every
@pytest.mark.parametrize("seed", range(5))
def test_order_of_tracks_and_detections_does_not_matter(associator, crowd, seed):
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
def test_the_input_is_left_as_it_was(associator, crowd):
    pairs = crowd(3)
    before = [np.copy(field) for field in pairs]
    associator(pairs)
    for field, copy in zip(pairs, before, strict=True):
        np.testing.assert_array_equal(field, copy)


@every
def test_one_track_on_its_detection_takes_it(associator, make_pairs):
    weights = associator(make_pairs([[0, 0]], [[0.5, 0], [900, 0]]))
    assert weights[0].argmax() == 1
    assert weights[0, 2] == 0


@every
def test_two_identical_detections(associator, make_pairs):
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
        ("distance_squared", -1.0, "expected 0 or more"),
        ("log_determinant", np.inf, r"log_determinant at index \(0,\)"),
        ("size_difference", np.nan, "size_difference"),
        ("size_difference", -1.0, "size_difference"),
        ("gate_area", 0.0, "above 0 where the gate holds a detection"),
        ("gate_area", np.nan, "gate_area"),
    ],
)
def test_bad_numbers_are_refused(associator, crowd, field, value, message):
    pairs = crowd(0)
    array = getattr(pairs, field).copy()
    array.flat[0] = value
    with pytest.raises(InputError, match=message):
        associator(pairs._replace(**{field: array}))


@every
def test_bad_shapes_and_probabilities_are_refused(associator, crowd):
    pairs = crowd(0)
    for field in ("log_determinant", "size_difference", "gate_area"):
        with pytest.raises(InputError, match=f"{field} has shape"):
            associator(pairs._replace(**{field: getattr(pairs, field)[:-1]}))
    with pytest.raises(InputError, match="tracks, detections"):
        associator(pairs._replace(distance_squared=np.zeros(3)))
    for probability in (-0.1, 1.1, np.nan, None, "1"):
        with pytest.raises(InputError, match="gate_probability"):
            associator(pairs._replace(gate_probability=probability))


@pytest.mark.parametrize("kind", [PDA, JPDA])
@pytest.mark.parametrize("value", [0.0, 1.0, -0.1, np.nan, "0.9", None])
def test_a_detection_probability_that_is_none(kind, value):
    with pytest.raises(InputError, match="detection_probability"):
        kind(detection_probability=value)


@pytest.mark.parametrize("kind", [NearestNeighbor, GNN, PDA, JPDA])
@pytest.mark.parametrize("value", [-1.0, np.inf, np.nan, "a", None])
def test_a_size_weight_that_is_none(kind, value):
    with pytest.raises(InputError, match="size_weight"):
        kind(size_weight=value)


@pytest.mark.parametrize("kind", [NearestNeighbor, GNN])
@pytest.mark.parametrize("value", [np.inf, np.nan, "a", None])
def test_a_cost_that_is_none(kind, value):
    with pytest.raises(InputError, match="nonassignment_cost"):
        kind(nonassignment_cost=value)


def test_tables_that_hold_nothing():
    for bad in (3, 4.5, "a", None, True, 2**33):
        with pytest.raises(InputError, match="most_states"):
            JPDA(most_states=bad)


@pytest.mark.parametrize("kind", [PDA, JPDA])
def test_a_choice_that_is_none(kind):
    with pytest.raises(InputError, match="printed_determinant: must be a bool, got 'no'"):
        kind(printed_determinant="no")


@every
def test_a_gate_of_nought_leaves_every_track_missed(associator):
    at = np.zeros((2, 2))
    unknown = np.full(2, np.nan)
    predicted = Predicted(at, np.tile(np.eye(2), (2, 1, 1)), unknown, unknown)
    pairs = Gate(distance=0)(predicted, Detected(at, unknown, unknown))
    assert pairs.gate_probability == 0.0
    assert associator(pairs).tolist() == [[1, 0, 0]] * 2


@every
def test_what_are_no_pairs(associator, crowd):
    with pytest.raises(InputError, match="must be a Pairs"):
        associator(None)
    with pytest.raises(InputError, match="pairs: dimensions"):
        associator(crowd(0)._replace(dimensions=0))
