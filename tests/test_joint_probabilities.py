"""Probabilities of joint events: against enumeration, recursion, and counting."""

from math import comb, perm

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import block_diag
from tests.definitions.joint_events import joint_probabilities as plain_probabilities

from kilnflight.association import joint_probabilities

seeds = st.integers(0, 2**32 - 1)


@given(
    seeds, st.integers(1, 5), st.integers(1, 5), st.floats(0.2, 1), st.floats(-250, 250)
)
def test_against_enumeration_on_any_scale_of_a_track(
    seed, tracks, detections, share, power
):
    rng = np.random.default_rng(seed)
    likelihood = rng.exponential(1, (tracks, detections))
    likelihood *= rng.random(likelihood.shape) < share
    missed = rng.exponential(rng.choice([0.01, 0.3, 3.0]), tracks)
    expected = plain_probabilities(likelihood, missed)
    scale = 10.0 ** (power * rng.uniform(0, 1, tracks))
    for each in (1.0, scale):
        result = joint_probabilities((likelihood.T * each).T, missed * each)
        np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-12)


def chain_sums(left, right, missed):
    """Weights of all events of the first k tracks: detection k free, and used."""
    free, used = [1.0], [0.0]
    for take_left, take_right, none in zip(left, right, missed, strict=True):
        before = free[-1] + used[-1]
        free.append(free[-1] * take_left + before * none)
        used.append(before * take_right)
    return np.array(free), np.array(used)


def test_a_chain_of_forty():
    """More than 10^15 events; a recursion along the chain gives the answer."""
    rng, index = np.random.default_rng(0), np.arange(40)
    likelihood, missed = np.zeros((40, 41)), rng.exponential(0.3, 40)
    left, right = rng.exponential(1, (2, 40))
    likelihood[index, index], likelihood[index, index + 1] = left, right
    free, used = chain_sums(left, right, missed)
    back_free, back_used = (
        s[::-1] for s in chain_sums(right[::-1], left[::-1], missed[::-1])
    )
    before, after = (free + used)[:-1], (back_free + back_used)[1:]
    expected = [
        before * missed * after,
        free[:-1] * left * after,
        before * right * back_free[1:],
    ]
    result = joint_probabilities(
        likelihood, missed, most_states=2**12
    )  # warnings are errors
    found = [result[:, 0], result[index, 1 + index], result[index, 2 + index]]
    np.testing.assert_allclose(found, np.array(expected) / (free + used)[-1], rtol=1e-9)


@pytest.mark.parametrize(
    ("tracks", "detections"), [(14, 14), (3, 40), (40, 3), (18, 18)]
)
def test_all_in_all_gates(tracks, detections):
    """All weights 1: events with k pairs are C(n, k) m! / (m - k)!, and all tracks are
    alike.
    """
    counts = [comb(tracks, k) * perm(detections, k) for k in range(tracks + 1)]
    matched = sum(k * count for k, count in enumerate(counts)) / sum(counts) / tracks
    result = joint_probabilities(np.ones((tracks, detections)), np.ones(tracks))
    np.testing.assert_allclose(result[:, 0], 1 - matched, rtol=1e-9)
    np.testing.assert_allclose(result[:, 1:], matched / detections, rtol=1e-9)


def test_extreme_likelihoods_and_tracks_that_must_have_a_detection():
    """Every event of the first three tracks weighs about 1e-600."""
    tiny = np.full((3, 3), 1e-300)
    tiny[:, 0] = 1.0
    result = joint_probabilities(tiny, np.zeros(3))
    np.testing.assert_allclose(
        result, np.column_stack([np.zeros(3), np.full((3, 3), 1 / 3)])
    )
    mixed = joint_probabilities([[1e300, 1e-300], [1e300, 0.0]], [1e-300, 1e300])
    np.testing.assert_allclose(mixed, [[0, 1, 0], [1, 0, 0]], atol=1e-12)


def test_dense_groups_alone_leave_out_their_weakest_pairs():
    """Exact for the pairs that stay, and near to the whole; the other group is
    untouched.
    """
    rng = np.random.default_rng(1)
    likelihood = rng.exponential(1, (5, 5)) * 1e-6 + np.eye(5)
    likelihood[0, 1] = 0.5
    missed, both = np.full(7, 0.1), block_diag(likelihood, np.full((2, 2), 1e-9))
    with pytest.warns(UserWarning, match="joint probabilities") as caught:
        result = joint_probabilities(both, missed, most_states=24)
    assert len(caught) == 1
    kept = np.where(result[:5, 1:6] > 0, likelihood, 0.0)
    assert (kept.diagonal() > 0).all()
    assert kept[0, 1] > 0
    assert 0 < (kept == 0).sum() < 20
    exact, whole = (
        plain_probabilities(each, missed[:5]) for each in (kept, likelihood)
    )
    np.testing.assert_allclose(result[:5, :6], exact, rtol=1e-9)
    np.testing.assert_allclose(result[:5, :6], whole, atol=1e-4)
    alone = joint_probabilities(both[5:, 5:], missed[5:])
    np.testing.assert_allclose(result[5:, 6:], alone[:, 1:], rtol=1e-12)
