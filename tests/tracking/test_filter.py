"""Motion, Kalman filter and gate, held against the printed equations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2
from tests.definitions import kalman
from tests.definitions.pairs import table

from kilnflight.checks import InputError
from kilnflight.tracking import filter as filtering
from kilnflight.tracking.filter import (
    ConstantAcceleration,
    ConstantVelocity,
    Detected,
    Gate,
)

seeds = st.integers(0, 2**32 - 1)
spans = st.integers(0, 300).map(lambda number: number / 10)  # frames
motions = pytest.mark.parametrize(
    "motion", [ConstantVelocity(), ConstantAcceleration()]
)
NAN = np.nan


def test_the_matrices_of_the_page():
    """Eq. 4.4."""
    motion = ConstantVelocity()
    expected = [[1, 0, 3, 0], [0, 1, 0, 3], [0, 0, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_array_equal(motion.transition(3.0), expected)
    np.testing.assert_array_equal(motion.measurement_noise(), [[4, 0], [0, 4]])
    np.testing.assert_allclose(
        motion.process_noise(3.0)[::2, ::2], [[9, 4.5], [4.5, 3]]
    )
    thrown = ConstantAcceleration().transition(4.0) @ [1.0, 2.0, 10.0, -5.0, 0.5, 1.0]
    np.testing.assert_allclose(thrown, [45.0, -10.0, 12.0, -1.0, 0.5, 1.0])


@motions
@given(first=spans, second=spans)
def test_two_steps_are_one(motion, first, second):
    later = motion.transition(second)
    np.testing.assert_allclose(
        later @ motion.transition(first), motion.transition(first + second), atol=1e-9
    )
    noise = later @ motion.process_noise(first) @ later.T + motion.process_noise(second)
    np.testing.assert_allclose(noise, motion.process_noise(first + second), atol=1e-9)


@motions
@given(
    seed=seeds,
    count=st.integers(0, 4),
    detections=st.integers(0, 5),
    span=st.integers(1, 20),
)
def test_the_equations_as_printed(motion, seed, count, detections, span):
    generator = np.random.default_rng(seed)
    f, q = motion.transition(span), motion.process_noise(span)
    h, r = np.eye(2, len(f)), motion.measurement_noise()
    state = generator.normal(0, 50, (count, len(f)))
    roots = generator.normal(0, 3, (count, *f.shape))
    covariance = roots @ roots.mT + 0.1 * np.eye(len(f))
    moved, spread = filtering.predict(state, covariance, f, q)
    positions = generator.normal(0, 50, (detections, 2))
    weights = generator.dirichlet(np.full(1 + detections, 0.5), count)
    weights[:1] = np.eye(1, 1 + detections)  # missed: the prediction bit by bit
    residual = covariance[:, :2, :2] + r
    pairs = Gate(1e6, np.inf)(
        state[:, :2], residual, Detected(positions)
    )  # all of them
    after, left = filtering.update(state, covariance, pairs, weights[:, 1:].ravel())
    np.testing.assert_array_equal(after[:1], state[:1])
    np.testing.assert_array_equal(left[:1], covariance[:1])
    for i in range(count):
        expected = kalman.predict(state[i], covariance[i], f, q)
        np.testing.assert_allclose(moved[i], expected[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(spread[i], expected[1], rtol=1e-9, atol=1e-9)
        expected = kalman.update(state[i], covariance[i], positions, weights[i], h, r)
        np.testing.assert_allclose(after[i], expected[0], rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(left[i], expected[1], rtol=1e-7, atol=1e-6)


BALLS = {1: 2.0, 2: np.pi, 3: 4 / 3 * np.pi}  # volume of the unit ball


@pytest.mark.parametrize("d", BALLS)
@given(seed=seeds, n=st.integers(0, 6), m=st.integers(0, 6), tenths=st.integers(0, 60))
def test_eq_4_8_pair_by_pair(d, seed, n, m, tenths):
    rng, distance = np.random.default_rng(seed), tenths / 10
    roots = rng.normal(0, 2, (n, d, d))
    residual = roots @ roots.mT + 0.2 * np.eye(d)
    depth, seen = rng.uniform(1000, 5000, n), rng.uniform(1000, 5000, m)
    depth[rng.random(n) < 0.3], seen[rng.random(m) < 0.3] = NAN, NAN
    sizes, counts = rng.integers(1, 50, n) * 1.0, rng.integers(1, 50, m) * 1.0
    expected, detected = rng.normal(0, 4, (n, d)), rng.normal(0, 4, (m, d))
    pairs = Gate(distance)(
        expected, residual, Detected(detected, seen, counts), depth, sizes
    )
    assert pairs.gate_probability == pytest.approx(chi2.cdf(distance**2, d))
    squares, steps = (
        table(pairs, pairs.distance_squared, np.inf),
        table(pairs, pairs.size_difference),
    )
    for i in range(n):
        assert pairs.log_determinant[i] == pytest.approx(
            np.linalg.slogdet(residual[i])[1]
        )
        area = BALLS[d] * distance**d * np.sqrt(np.linalg.det(residual[i]))
        assert pairs.gate_area[i] == pytest.approx(area, abs=1e-9)
        for j in range(m):
            apart = detected[j] - expected[i]
            square = apart @ np.linalg.inv(residual[i]) @ apart
            inside = square < distance**2 and not abs(depth[i] - seen[j]) >= 1500
            assert squares[i, j] == pytest.approx(
                square if inside else np.inf, rel=1e-6
            )
            assert steps[i, j] == (abs(sizes[i] - counts[j]) if inside else 0)


@pytest.mark.parametrize("d", BALLS)
def test_a_covariance_that_is_singular_is_refused(d):
    residual = np.ones((1, d, d)) - (d == 1)
    with pytest.raises(InputError, match="singular"):
        Gate()(np.zeros((1, d)), residual, Detected(np.zeros((1, d))))


def test_the_limits_of_the_gate_are_outside_and_unknown_numbers_pass():
    at, unit, depth = (
        np.zeros((1, 2)),
        np.eye(2)[None],
        np.array([500.0, 500, 600, 599, NAN]),
    )
    places = np.array([[0, 2], [0, 1.999], [0, 1], [0, 1], [0, 1]])
    pairs = Gate(2.0, 100.0)(
        at, unit, Detected(places, depth), np.array([500.0]), at[:, 0]
    )
    assert pairs.detection.tolist() == [1, 3, 4]
    assert not pairs.size_difference.any()
    assert not len(Gate(0.0)(at, unit, Detected(at)).track)
    far = Gate(1e6, np.inf)(
        at, unit, Detected(np.array([[9e5, 0]]), depth[:1]), np.array([1e9])
    )
    assert far.distance_squared == pytest.approx(8.1e11)
