import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.tracking import kalman
from kilnflight.tracking.motion import MOTIONS, ConstantVelocity

seeds = st.integers(0, 2**32 - 1)
motions = pytest.mark.parametrize("motion", MOTIONS, ids=lambda m: type(m).__name__)
KILN = ConstantVelocity()


def some_tracks(motion, count, generator):
    """Tracks of any position and any covariance that is one."""
    k = len(motion.transition(1.0))
    roots = generator.normal(0, 3, (count, k, k))
    return generator.normal(0, 50, (count, k)), roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(k)


def some_weights(tracks, detections, generator):
    weights = generator.gamma(0.3, size=(tracks, 1 + detections)) + 1e-9
    return weights / weights.sum(axis=1, keepdims=True)


def predict_by_the_page(state, covariance, f, q):
    """Eqs 2.44 and 2.45 for one track."""
    return f @ state, f @ covariance @ f.T + q


def update_by_the_page(state, covariance, measurements, weights, h, r):
    """Eqs 2.52 to 2.56 for one track, as printed."""
    s = r + h @ covariance @ h.T
    gain = covariance @ h.T @ np.linalg.inv(s)
    apart = measurements - h @ state
    mean = weights[1:] @ apart
    spread = (weights[1:, None] * apart).T @ apart - np.outer(mean, mean)
    updated = covariance - gain @ s @ gain.T
    mixed = weights[0] * covariance + (1 - weights[0]) * updated + gain @ spread @ gain.T
    return state + gain @ mean, mixed


@motions
@settings(deadline=None)
@given(seed=seeds, count=st.integers(0, 4), detections=st.integers(0, 5), gap=st.integers(1, 20))
def test_the_equations_as_printed(motion, seed, count, detections, gap):
    generator = np.random.default_rng(seed)
    state, covariance = some_tracks(motion, count, generator)
    f, q, h, r = of(motion, gap)
    moved, spread = kalman.predict(state, covariance, f, q)
    for i in range(count):
        expected = predict_by_the_page(state[i], covariance[i], f, q)
        np.testing.assert_allclose(moved[i], expected[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(spread[i], expected[1], rtol=1e-9, atol=1e-9)
    positions, weights = generator.normal(0, 50, (detections, 2)), None
    weights = some_weights(count, detections, generator)
    after, left = kalman.update(state, covariance, positions, weights, h, r)
    for i in range(count):
        expected = update_by_the_page(state[i], covariance[i], positions, weights[i], h, r)
        np.testing.assert_allclose(after[i], expected[0], rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(left[i], expected[1], rtol=1e-7, atol=1e-6)


def of(motion, gap):
    """F, Q, H, R of a motion model."""
    matrices = motion.transition(float(gap)), motion.process_noise(float(gap))
    return *matrices, motion.measurement(), motion.measurement_noise()


@motions
@settings(deadline=None)
@given(seed=seeds)
def test_one_track_after_the_other_in_filterpy_is_the_same(motion, seed):
    generator = np.random.default_rng(seed)
    state, covariance = some_tracks(motion, 3, generator)
    peers = []
    for i in range(3):
        peer = KalmanFilter(dim_x=state.shape[1], dim_z=2)
        peer.x, peer.P = state[i].copy(), covariance[i].copy()
        peers.append(peer)
    for gap in (1, 4, 1):
        f, q, h, r = of(motion, gap)
        positions = state @ h.T + generator.normal(0, 5, (3, 2))
        choice = generator.permutation(4)[:3]  # 0: missed
        state, covariance = kalman.predict(state, covariance, f, q)
        weights = np.eye(4)[choice]
        state, covariance = kalman.update(state, covariance, positions, weights, h, r)
        for peer, chosen in zip(peers, choice, strict=True):
            peer.predict(F=f, Q=q)
            peer.update(positions[chosen - 1] if chosen else None, R=r, H=h)
    for i, peer in enumerate(peers):
        np.testing.assert_allclose(state[i], peer.x, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(covariance[i], peer.P, rtol=1e-7, atol=1e-7)


@settings(deadline=None)
@given(seed=seeds)
def test_missed_leaves_the_prediction_bit_by_bit(seed):
    generator = np.random.default_rng(seed)
    state, covariance = some_tracks(KILN, 2, generator)
    weights = np.array([[1.0, 0.0], [0.0, 1.0]])
    _, _, h, r = of(KILN, 1)
    after, left = kalman.update(state, covariance, np.zeros((1, 2)), weights, h, r)
    np.testing.assert_array_equal(after[0], state[0])
    np.testing.assert_array_equal(left[0], covariance[0])
    assert (after[1] != state[1]).any()


@motions
@settings(deadline=None)
@given(seed=seeds)
def test_covariances_stay_covariances(motion, seed):
    """For 60 frames of any weights, measurements that come a million px apart included."""
    generator = np.random.default_rng(seed)
    state, covariance = some_tracks(motion, 3, generator)
    f, q, h, r = of(motion, 2)
    for _ in range(60):
        state, covariance = kalman.predict(state, covariance, f, q)
        positions = generator.normal(0, 10.0 ** generator.integers(0, 7), (3, 2))
        weights = some_weights(3, 3, generator)
        state, covariance = kalman.update(state, covariance, positions, weights, h, r)
        np.testing.assert_array_equal(covariance, covariance.transpose(0, 2, 1))
        values = np.linalg.eigvalsh(covariance)
        assert (values[:, 0] >= -1e-12 * values[:, -1]).all()


def test_all_but_missed_does_not_take_a_measurement():
    """A weight of nearly 1 on "missed" and none elsewhere: a row of one entry, column 0."""
    state, covariance = some_tracks(KILN, 1, np.random.default_rng(0))
    _, _, h, r = of(KILN, 1)
    weights = np.array([[1.0 - 1e-7, 0.0]])
    after, _ = kalman.update(state, covariance, np.full((1, 2), 1e9), weights, h, r)
    np.testing.assert_array_equal(after, state)


def test_what_is_known_for_sure_stays_known():
    """A covariance of nought, a semi-definite one, is no error as long as S has noise."""
    _, _, h, r = of(KILN, 1)
    args = np.zeros((1, 4)), np.zeros((1, 4, 4)), np.ones((1, 2)), np.array([[0.0, 1.0]]), h
    after, left = kalman.update(*args, r)
    assert not after.any()
    assert not left.any()
    with pytest.raises(InputError, match="of track 0 is singular"):
        kalman.update(*args, np.zeros((2, 2)))


def test_a_singular_residual_names_its_track():
    state, covariance = np.zeros((3, 4)), np.tile(np.eye(4), (3, 1, 1))
    covariance[1, :2, :2] = 1.0
    weights = np.array([[0.0, 1.0]] * 3)
    _, _, h, _ = of(KILN, 1)
    with pytest.raises(InputError, match="of track 1 is singular"):
        kalman.update(state, covariance, np.ones((1, 2)), weights, h, np.zeros((2, 2)))
    covariance[1] = np.nan
    with pytest.raises(InputError, match="of track 1 is singular"):
        kalman.update(state, covariance, np.ones((1, 2)), weights, h, np.eye(2))


@pytest.mark.parametrize("bad", [[0.5, 0.4], [1.5, -0.5], [np.nan, 1.0]])
def test_weights_that_are_invalid_are_refused(bad):
    state, covariance = np.zeros((2, 4)), np.tile(np.eye(4), (2, 1, 1))
    weights = np.array([[1.0, 0.0], bad])
    _, _, h, r = of(KILN, 1)
    with pytest.raises(InputError, match="weights of track 1 are negative, not finite, or do not"):
        kalman.update(state, covariance, np.ones((1, 2)), weights, h, r)
