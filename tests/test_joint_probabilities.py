"""Probabilities of joint events: against enumeration, recursion, counting and Stone Soup."""

import datetime
from math import comb, perm
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import block_diag

from kilnflight.association import (
    JPDA,
    Pairs,
    joint_probabilities,
)
from kilnflight.checks import InputError

sizes = st.tuples(st.integers(1, 5), st.integers(1, 5))
numbers = st.one_of(st.just(0.0), st.floats(1e-6, 1e6), st.sampled_from([0.5, 1.0]))


@pytest.fixture(scope="session")
def plain_probabilities(joint_events):
    """Eq. 2.64 as it stands: a sum over joint events."""

    def probabilities(likelihood, nonassignment):
        tracks, detections = likelihood.shape
        factors = np.column_stack([likelihood, nonassignment])  # index -1: missed
        sums = np.zeros((tracks, 1 + detections))
        for event in joint_events(tracks, detections):
            sums[range(tracks), np.array(event) + 1] += factors[range(tracks), event].prod()
        return sums / sums.sum(axis=1, keepdims=True)

    return probabilities


@given(sizes.flatmap(lambda size: arrays(np.float64, (size[0], size[1] + 1), elements=numbers)))
def test_against_enumeration(plain_probabilities, numbers):
    likelihood, missed = numbers[:, 1:], numbers[:, 0] + 1e-3
    expected = plain_probabilities(likelihood, missed)
    result = joint_probabilities(likelihood, missed)
    np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-12)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_sparse_groups_against_enumeration(plain_probabilities, seed):
    rng = np.random.default_rng(seed)
    likelihood = rng.exponential(1, (5, 6)) * (rng.random((5, 6)) < 0.35)
    missed = rng.exponential(1, 5)
    expected = plain_probabilities(likelihood, missed)
    np.testing.assert_allclose(joint_probabilities(likelihood, missed), expected, atol=1e-12)


def test_hundreds_of_random_cases_against_enumeration(plain_probabilities):
    rng = np.random.default_rng(0)
    for _ in range(300):
        size = rng.integers((1, 2), (5, 6))
        likelihood = rng.exponential(1, size) * (rng.random(size) < rng.uniform(0.2, 1))
        missed = rng.exponential(rng.choice([0.01, 0.3, 3.0]), size[0])
        expected = plain_probabilities(likelihood, missed)
        np.testing.assert_allclose(
            joint_probabilities(likelihood, missed), expected, rtol=0, atol=1e-12
        )


def chain(tracks, seed=0):
    """Track i shares detection i with the track before and i + 1 with the one after."""
    rng = np.random.default_rng(seed)
    likelihood = np.zeros((tracks, tracks + 1))
    index = np.arange(tracks)
    likelihood[index, index], likelihood[index, index + 1] = rng.exponential(1, (2, tracks))
    return likelihood, rng.exponential(0.3, tracks)


def chain_sums(left, right, missed):
    """Weight of all events of the first k tracks: detection k free, detection k used."""
    free, used = [1.0], [0.0]
    for take_left, take_right, none in zip(left, right, missed, strict=True):
        any_before = free[-1] + used[-1]
        free.append(free[-1] * take_left + any_before * none)
        used.append(any_before * take_right)
    return np.array(free), np.array(used)


def test_a_chain_of_forty():
    """More than 10^15 events; a recursion along the chain gives the answer."""
    likelihood, missed = chain(40)
    index = np.arange(40)
    left, right = likelihood[index, index], likelihood[index, index + 1]
    free, used = chain_sums(left, right, missed)
    back_free, back_used = (s[::-1] for s in chain_sums(right[::-1], left[::-1], missed[::-1]))
    total = free[-1] + used[-1]
    expected = np.column_stack(
        [
            (free + used)[:-1] * missed * (back_free + back_used)[1:],
            free[:-1] * left * (back_free + back_used)[1:],
            (free + used)[:-1] * right * back_free[1:],
        ]
    )
    result = joint_probabilities(likelihood, missed)
    result = np.column_stack([result[:, 0], result[index, 1 + index], result[index, 2 + index]])
    np.testing.assert_allclose(result, expected / total, rtol=1e-9)


def test_a_chain_of_any_length_fits():
    likelihood, missed = chain(300)
    result = joint_probabilities(likelihood, missed, most_states=2**12)  # warnings are errors
    np.testing.assert_allclose(result.sum(axis=1), 1.0)


def test_a_group_fits_beside_others_as_if_it_were_alone():
    rng = np.random.default_rng(0)
    groups = [(rng.random((14, 14)) < share).astype(float) for share in (0.3, 0.5, 0.4)]
    alone = [joint_probabilities(group, np.ones(14), most_states=2**16) for group in groups]
    result = joint_probabilities(block_diag(*groups), np.ones(42), most_states=2**16)
    np.testing.assert_allclose(result[:, 1:], block_diag(*(a[:, 1:] for a in alone)), rtol=1e-12)
    np.testing.assert_allclose(result[:, 0], np.concatenate([a[:, 0] for a in alone]), rtol=1e-12)
    with pytest.warns(UserWarning, match="14 tracks share"):  # the densest alone, with fewer
        joint_probabilities(groups[1], np.ones(14), most_states=2**15)


@pytest.mark.parametrize(("tracks", "detections"), [(14, 14), (3, 40), (40, 3), (20, 20)])
def test_all_in_all_gates(tracks, detections):
    """All weights 1: events with k pairs are C(n, k) m! / (m - k)!, and all tracks are alike."""
    counts = [comb(tracks, k) * perm(detections, k) for k in range(tracks + 1)]
    matched = sum(k * count for k, count in enumerate(counts)) / sum(counts) / tracks
    result = joint_probabilities(np.ones((tracks, detections)), np.ones(tracks))
    np.testing.assert_allclose(result[:, 0], 1 - matched, rtol=1e-9)
    np.testing.assert_allclose(result[:, 1:], matched / detections, rtol=1e-9)


@given(st.integers(0, 2**32 - 1), st.floats(-250, 250))
def test_the_scale_of_a_track_does_not_matter(seed, power):
    rng = np.random.default_rng(seed)
    likelihood, missed = rng.exponential(1, (4, 5)), rng.exponential(1, 4)
    scale = 10.0 ** (power * rng.uniform(0, 1, 4))
    expected = joint_probabilities(likelihood, missed)
    result = joint_probabilities(likelihood * scale[:, None], missed * scale)
    np.testing.assert_allclose(result, expected, rtol=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_probabilities(seed):
    rng = np.random.default_rng(seed)
    likelihood = rng.exponential(1, (30, 30)) * (rng.random((30, 30)) < 0.08)
    likelihood = 10.0 ** rng.uniform(-20, 20, likelihood.shape) * likelihood
    result = joint_probabilities(likelihood, 10.0 ** rng.uniform(-20, 20, 30))
    assert (result >= 0).all()
    np.testing.assert_allclose(result.sum(axis=1), 1.0, rtol=1e-12)
    assert (result[:, 1:].sum(axis=0) <= 1 + 1e-12).all()
    assert (result[:, 1:][likelihood == 0] == 0).all()


def test_extreme_likelihoods():
    """Three tracks that must share out: every event weighs about 1e-600 or 1e+300."""
    tiny = np.full((3, 3), 1e-300)
    tiny[:, 0] = 1.0
    result = joint_probabilities(tiny, np.zeros(3))
    np.testing.assert_allclose(result, np.column_stack([np.zeros(3), np.full((3, 3), 1 / 3)]))
    mixed = joint_probabilities([[1e300, 1e-300], [1e300, 0.0]], [1e-300, 1e300])
    np.testing.assert_allclose(mixed, [[0, 1, 0], [1, 0, 0]], atol=1e-12)
    subnormal = joint_probabilities([[5e-324]], [5e-324])
    np.testing.assert_allclose(subnormal, [[0.5, 0.5]])


def test_a_track_that_must_have_a_detection(plain_probabilities):
    likelihood = np.array([[1.0, 2.0, 0.0], [3.0, 1.0, 4.0]])
    missed = np.array([0.0, 0.5])
    expected = plain_probabilities(likelihood, missed)
    np.testing.assert_allclose(joint_probabilities(likelihood, missed), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("likelihood", "missed", "message"),
    [
        ([[1.0], [1.0]], [0.0, 0.0], "no joint event is possible: track [01] must"),
        (np.zeros((1, 0)), [0.0], "no joint event is possible: track 0"),
        ([[np.nan]], [1.0], "likelihood: 1 value"),
        ([[np.inf]], [1.0], "likelihood: 1 value"),
        ([[1.0]], [np.nan], "nonassignment: 1 value"),
        ([[1.0, -2.0]], [1.0], r"likelihood: -2.0 at index \(0, 1\)"),
        ([[1.0]], [-1.0], "nonassignment: -1.0"),
        ([[1.0]], [1.0, 1.0], "nonassignment, one per track"),
        ([1.0], [1.0], r"likelihood \(tracks, detections\)"),
        ([["a"]], [1.0], "not made of numbers"),
    ],
)
def test_invalid_input_is_refused(likelihood, missed, message):
    with pytest.raises(InputError, match=message):
        joint_probabilities(likelihood, missed)


@pytest.mark.parametrize("bad", ["a", None, 3, 4.5, True])
def test_an_invalid_bound_is_refused(bad):
    with pytest.raises(InputError, match="joint probabilities: most_states"):
        joint_probabilities([[1.0]], [1.0], most_states=bad)


def test_the_tracker_gives_up_being_exact_before_the_function_does():
    """18 tracks that all share 18 detections: 2^22 states."""
    crowded = Pairs(np.zeros((18, 18)), np.zeros(18), np.zeros((18, 18)), np.ones(18), 0.99)
    message = "18 tracks share detections too densely.* Narrow the gate"
    with pytest.warns(UserWarning, match=message):
        weights = JPDA()(crowded)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    joint_probabilities(np.ones((18, 18)), np.ones(18))  # warnings are errors here


def test_empty_is_normal():
    assert joint_probabilities(np.zeros((0, 3)), np.zeros(0)).shape == (0, 4)
    assert joint_probabilities(np.zeros((2, 0)), np.ones(2)).tolist() == [[1.0], [1.0]]
    assert joint_probabilities(np.zeros((1, 2)), [1.0]).tolist() == [[1.0, 0.0, 0.0]]


def test_a_group_too_dense_leaves_out_what_weighs_least(plain_probabilities):
    rng = np.random.default_rng(1)
    likelihood = rng.exponential(1, (5, 5)) * 1e-6 + np.eye(5)
    likelihood[0, 1] = 0.5
    missed = np.full(5, 0.1)
    with pytest.warns(UserWarning, match="5 tracks share detections too densely") as caught:
        result = joint_probabilities(likelihood, missed, most_states=24)
    assert len(caught) == 1
    kept = np.where(result[:, 1:] > 0, likelihood, 0.0)
    assert (kept.diagonal() > 0).all()
    assert kept[0, 1] > 0
    assert 0 < (kept == 0).sum() < 20
    # Exact for what is left, and near to the whole.
    np.testing.assert_allclose(result, plain_probabilities(kept, missed), rtol=1e-9)
    np.testing.assert_allclose(result, plain_probabilities(likelihood, missed), atol=1e-4)


def test_only_the_group_that_is_too_dense_is_thinned():
    likelihood = np.zeros((32, 32))
    likelihood[:30, :30] = 1.0
    likelihood[30:, 30:] = 1e-9
    with pytest.warns(UserWarning, match="30 tracks share"):
        result = joint_probabilities(likelihood, np.ones(32), most_states=2**16)
    np.testing.assert_allclose(result.sum(axis=1), 1.0)
    alone = joint_probabilities(likelihood[30:, 30:], np.ones(2))
    np.testing.assert_allclose(result[30:, 31:], alone[:, 1:], rtol=1e-12)


def by_stone_soup(likelihood, nonassignment, associator):
    """Return the same by Stone Soup, whose hypothesiser is told the likelihoods."""
    from stonesoup.types.detection import Detection, MissedDetection
    from stonesoup.types.hypothesis import SingleProbabilityHypothesis
    from stonesoup.types.multihypothesis import MultipleHypothesis
    from stonesoup.types.track import Track

    now = datetime.datetime(2023, 1, 1)
    tracks = [Track() for _ in likelihood]
    detections = [Detection([column, 0.0], now) for column in range(likelihood.shape[1])]
    hypotheses = {
        track: MultipleHypothesis(
            [SingleProbabilityHypothesis(None, MissedDetection(timestamp=now), missed)]
            + [
                SingleProbabilityHypothesis(None, detection, value)
                for detection, value in zip(detections, row, strict=True)
                if value > 0
            ]
        )
        for track, row, missed in zip(tracks, likelihood, nonassignment, strict=True)
    }
    ready = SimpleNamespace(hypothesise=lambda track, *args, **more: hypotheses[track])
    result = associator(ready).associate(tracks, set(detections), now)
    weights = np.zeros((len(tracks), 1 + len(detections)))
    for row, track in zip(weights, tracks, strict=True):
        for hypothesis in result[track]:
            at = 1 + detections.index(hypothesis.measurement) if hypothesis else 0
            row[at] = float(hypothesis.probability)
    return weights


@pytest.mark.parametrize("name", ["JPDA", "JPDAwithEHM2"])
def test_stone_soup_gives_the_same_probabilities(name):
    associators = pytest.importorskip(
        "stonesoup.dataassociator.probability", reason="Stone Soup is not installed (extra: peer)"
    )
    rng = np.random.default_rng(4)
    likelihood = rng.exponential(1, (4, 5)) * (rng.random((4, 5)) < 0.6)
    missed = rng.exponential(0.5, 4)
    expected = by_stone_soup(likelihood, missed, getattr(associators, name))
    np.testing.assert_allclose(joint_probabilities(likelihood, missed), expected, atol=1e-9)
