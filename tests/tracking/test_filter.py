"""Motion, Kalman filter and gate, held against the printed equations and filterpy."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.definitions import kalman

from kilnflight.checks import InputError
from kilnflight.tracking.filter import (
    ConstantAcceleration,
    ConstantVelocity,
    Detected,
    Gate,
    predict,
    residual_covariance,
    update,
)

seeds = st.integers(0, 2**32 - 1)
spans = st.integers(0, 300).map(lambda tenths: tenths / 10)  # frames
motions = pytest.mark.parametrize("motion", [ConstantVelocity(), ConstantAcceleration()])
NAN = np.nan


def matrices(motion, span):
    """F, Q, H, R of a motion."""
    moves = motion.transition(span), motion.process_noise(span)
    return *moves, motion.measurement(), motion.measurement_noise()


def some_tracks(motion, count, generator):
    """States of any position, with any covariances."""
    k = len(motion.transition(1.0))
    roots = generator.normal(0, 3, (count, k, k))
    return generator.normal(0, 50, (count, k)), roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(k)


def updated(state, covariance, positions, weights, h, r):
    """The update with the Cholesky factors of this covariance."""
    factor = np.linalg.cholesky(residual_covariance(covariance, h, r))
    return update(state, covariance, factor, positions, weights, h)


def test_the_matrices_of_the_page():
    """Eq. 4.4, and H of section 4.1.4."""
    motion = ConstantVelocity()
    expected = [[1, 0, 3, 0], [0, 1, 0, 3], [0, 0, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_array_equal(motion.transition(3.0), expected)
    np.testing.assert_array_equal(motion.measurement(), [[1, 0, 0, 0], [0, 1, 0, 0]])
    np.testing.assert_array_equal(motion.measurement_noise(), [[4, 0], [0, 4]])
    thrown = ConstantAcceleration().transition(4.0) @ [1.0, 2.0, 10.0, -5.0, 0.5, 1.0]
    np.testing.assert_allclose(thrown, [45.0, -10.0, 12.0, -1.0, 0.5, 1.0])


@motions
@settings(max_examples=15)
@given(first=spans, second=spans)
def test_two_steps_are_one(motion, first, second):
    later = motion.transition(second)
    np.testing.assert_allclose(
        later @ motion.transition(first), motion.transition(first + second), atol=1e-9
    )
    noise = later @ motion.process_noise(first) @ later.T + motion.process_noise(second)
    np.testing.assert_allclose(noise, motion.process_noise(first + second), atol=1e-9)


@motions
@pytest.mark.parametrize("span", [0.1, 1.0, 7.3])
def test_noise_is_the_integral_of_the_disturbance(motion, span):
    """F q F' over the span, by Gauss-Legendre (exact for polynomials)."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    k = len(motion.transition(1.0))
    density = np.zeros((k, k))
    density[-2:, -2:] = motion.process_noise(1.0)[-2:, -2:]
    total = sum(
        weight * span / 2 * motion.transition(t) @ density @ motion.transition(t).T
        for weight, t in zip(weights, span * (nodes + 1) / 2, strict=True)
    )
    np.testing.assert_allclose(motion.process_noise(span), total, rtol=1e-9)


@motions
@settings(max_examples=15)
@given(seed=seeds, count=st.integers(0, 4), detections=st.integers(0, 5), span=st.integers(1, 20))
def test_the_equations_as_printed(motion, seed, count, detections, span):
    generator = np.random.default_rng(seed)
    state, covariance = some_tracks(motion, count, generator)
    f, q, h, r = matrices(motion, float(span))
    moved, spread = predict(state, covariance, f, q)
    positions = generator.normal(0, 50, (detections, 2))
    weights = generator.dirichlet(np.full(1 + detections, 0.5), count)
    after, left = updated(state, covariance, positions, weights, h, r)
    for i in range(count):
        expected = kalman.predict(state[i], covariance[i], f, q)
        np.testing.assert_allclose(moved[i], expected[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(spread[i], expected[1], rtol=1e-9, atol=1e-9)
        expected = kalman.update(state[i], covariance[i], positions, weights[i], h, r)
        np.testing.assert_allclose(after[i], expected[0], rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(left[i], expected[1], rtol=1e-7, atol=1e-6)


@motions
def test_filterpy_does_the_same_one_track_at_a_time(motion):
    generator = np.random.default_rng(0)
    state, covariance = some_tracks(motion, 3, generator)
    peers = []
    for i in range(3):
        peer = KalmanFilter(dim_x=state.shape[1], dim_z=2)
        peer.x, peer.P = state[i].copy(), covariance[i].copy()
        peers.append(peer)
    for span in (1.0, 4.0, 1.0):
        f, q, h, r = matrices(motion, span)
        positions = state @ h.T + generator.normal(0, 5, (3, 2))
        choice = generator.permutation(4)[:3]  # 0: missed
        state, covariance = predict(state, covariance, f, q)
        missed = state.copy()
        state, covariance = updated(state, covariance, positions, np.eye(4)[choice], h, r)
        np.testing.assert_array_equal(state[choice == 0], missed[choice == 0])  # bit by bit
        for peer, chosen in zip(peers, choice, strict=True):
            peer.predict(F=f, Q=q)
            peer.update(positions[chosen - 1] if chosen else None, R=r, H=h)
    for i, peer in enumerate(peers):
        np.testing.assert_allclose(state[i], peer.x, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(covariance[i], peer.P, rtol=1e-7, atol=1e-7)


@motions
def test_covariances_stay_covariances(motion):
    """Over 60 frames of any weights, with detections up to a million px apart."""
    generator = np.random.default_rng(1)
    state, covariance = motion.initial(np.zeros((3, 2)))
    f, q, h, r = matrices(motion, 2.0)
    for _ in range(60):
        state, covariance = predict(state, covariance, f, q)
        positions = generator.normal(0, 10.0 ** generator.integers(0, 7), (3, 2))
        weights = generator.dirichlet(np.full(4, 0.3), 3)
        state, covariance = updated(state, covariance, positions, weights, h, r)
        np.testing.assert_array_equal(covariance, covariance.transpose(0, 2, 1))
        values = np.linalg.eigvalsh(covariance)
        assert (values[:, 0] >= -1e-12 * values[:, -1]).all()


@settings(max_examples=15)
@given(seed=seeds, n=st.integers(0, 6), m=st.integers(0, 6), distance=st.floats(0, 6))
def test_eq_4_8_pair_by_pair(seed, n, m, distance):
    rng = np.random.default_rng(seed)
    roots = rng.normal(0, 2, (n, 2, 2))
    residual = roots @ roots.transpose(0, 2, 1) + 0.2 * np.eye(2)
    depth, seen = rng.uniform(1000, 5000, n), rng.uniform(1000, 5000, m)
    depth[rng.random(n) < 0.3], seen[rng.random(m) < 0.3] = NAN, NAN
    sizes, counts = rng.integers(1, 50, n) * 1.0, rng.integers(1, 50, m) * 1.0
    expected, detected = rng.normal(0, 4, (n, 2)), rng.normal(0, 4, (m, 2))
    pairs = Gate(distance)(expected, residual, Detected(detected, seen, counts), depth, sizes)
    assert pairs.gate_probability == pytest.approx(1 - np.exp(-(distance**2) / 2))
    for i in range(n):
        assert pairs.log_determinant[i] == pytest.approx(np.linalg.slogdet(residual[i])[1])
        area = np.pi * distance**2 * np.sqrt(np.linalg.det(residual[i]))
        assert pairs.gate_area[i] == pytest.approx(area, abs=1e-9)
        for j in range(m):
            apart = detected[j] - expected[i]
            square = apart @ np.linalg.inv(residual[i]) @ apart
            inside = square < distance**2 and not abs(depth[i] - seen[j]) >= 1500
            assert pairs.distance_squared[i, j] == pytest.approx(
                square if inside else np.inf, rel=1e-6
            )
            assert pairs.size_difference[i, j] == (abs(sizes[i] - counts[j]) if inside else 0)


def test_the_limits_of_the_gate_are_outside_and_unknown_numbers_pass():
    at, unit = np.zeros((1, 2)), np.eye(2)[None]
    depth = np.array([500.0, 500, 600, 599, NAN])
    places = np.array([[0, 2], [0, 1.999], [0, 1], [0, 1], [0, 1]])
    pairs = Gate(2.0, 100.0)(at, unit, Detected(places, depth), np.array([500.0]), at[:, 0])
    assert np.isfinite(pairs.distance_squared).tolist() == [[False, True, False, True, True]]
    assert not pairs.size_difference.any()
    assert np.isinf(Gate(0.0)(at, unit, Detected(at)).distance_squared).all()
    far = Gate(1e6, np.inf)(at, unit, Detected(np.array([[9e5, 0]]), depth[:1]), np.array([1e9]))
    assert far.distance_squared == pytest.approx(8.1e11)


@pytest.mark.parametrize(
    ("make", "name", "bad"),
    [
        (Gate, "distance", [-1.0, NAN, np.inf, "4", None]),
        (Gate, "depth_mm", [-1.0, NAN, "4", None]),
        (ConstantVelocity, "velocity", [(NAN, 0.0), (), 3.0, ("a", "b"), None]),
        (ConstantVelocity, "measurement_sd", [0.0, -1.0, NAN, "2"]),
        (ConstantAcceleration, "acceleration_sd", [0.0, np.inf, None]),
    ],
)
def test_bad_input_names_the_argument(make, name, bad):
    for value in bad:
        with pytest.raises(InputError, match=name):
            make(**{name: value})


def test_a_singular_covariance_is_an_input_error():
    at = np.zeros((2, 2))
    with pytest.raises(InputError, match="motion"):
        Gate()(at, np.stack([np.eye(2), np.ones((2, 2))]), Detected(at))
