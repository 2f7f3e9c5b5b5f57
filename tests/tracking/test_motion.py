import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.tracking.motion import MOTIONS, ConstantAcceleration, ConstantVelocity

frames = st.floats(0.0, 30.0)
motions = pytest.mark.parametrize("motion", MOTIONS, ids=lambda m: type(m).__name__)


def test_the_matrices_of_the_page():
    """Eq. 4.4, and H of section 4.1.4."""
    motion = ConstantVelocity()
    expected = [[1, 0, 3, 0], [0, 1, 0, 3], [0, 0, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_array_equal(motion.transition(3.0), expected)
    np.testing.assert_array_equal(motion.measurement(), [[1, 0, 0, 0], [0, 1, 0, 0]])
    np.testing.assert_array_equal(motion.measurement_noise(), [[4, 0], [0, 4]])


def test_a_throw_is_uniform_acceleration():
    motion = ConstantAcceleration()
    state = np.array([1.0, 2.0, 10.0, -5.0, 0.5, 1.0])
    moved = motion.transition(4.0) @ state
    np.testing.assert_allclose(moved, [45.0, -10.0, 12.0, -1.0, 0.5, 1.0])


@motions
@given(first=frames, second=frames)
def test_two_steps_are_one(motion, first, second):
    """Else a gap would depend on how many frames of it had detections."""
    later = motion.transition(second)
    np.testing.assert_allclose(later @ motion.transition(first), motion.transition(first + second))
    noise = later @ motion.process_noise(first) @ later.T + motion.process_noise(second)
    np.testing.assert_allclose(noise, motion.process_noise(first + second), atol=1e-9)


@motions
@given(span=st.floats(0.1, 10.0))
def test_noise_is_what_the_disturbance_adds_up_to(motion, span):
    """Against the integral of F q F' over the span, by Gauss-Legendre (exact: a polynomial)."""
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
def test_a_particle_detected_once_is_where_it_was_detected(motion):
    positions = np.array([[3.0, 4.0], [5.0, 6.0]])
    state, covariance = motion.initial(positions)
    np.testing.assert_array_equal(state @ motion.measurement().T, positions)
    detected = motion.measurement() @ covariance @ motion.measurement().T
    np.testing.assert_array_equal(detected, [motion.measurement_noise()] * 2)
    assert [a.shape[0] for a in motion.initial(np.empty((0, 2)))] == [0, 0]


def test_three_dimensions_and_a_belt():
    motion = ConstantVelocity(velocity=(79.0, 0.0, 1.0))
    assert motion.measurement().shape == (3, 6)
    np.testing.assert_array_equal(motion.initial(np.zeros((1, 3)))[0], [[0, 0, 0, 79, 0, 1]])


@pytest.mark.parametrize("model", [ConstantVelocity, ConstantAcceleration])
@pytest.mark.parametrize(
    "bad", [{"velocity_sd": 0.0}, {"measurement_sd": np.nan}, {"velocity_sd": "a"}]
)
def test_invalid_noise_is_refused(model, bad):
    with pytest.raises(InputError, match=f"{model.__name__}: {next(iter(bad))}: must be"):
        model(**bad)


def test_an_invalid_velocity_is_refused():
    with pytest.raises(InputError, match="velocity is empty"):
        ConstantVelocity(velocity=())
    with pytest.raises(InputError, match="not finite"):
        ConstantAcceleration(velocity=(np.nan, 0.0))
    for bad in (3.0, ((1, 2), (3, 4))):
        with pytest.raises(InputError, match="velocity, one number per dimension: shape"):
            ConstantVelocity(velocity=bad)
    for bad in ("ab", ("1", "2"), None, (1j, 0)):
        with pytest.raises(InputError, match="velocity"):
            ConstantVelocity(velocity=bad)
    with pytest.raises(InputError, match=r"is beyond 1e[+]30"):
        ConstantVelocity(velocity=(1e200, 0.0))
    with pytest.raises(InputError, match=r"shape \(1, 3\), expected \(n, 2\)"):
        ConstantVelocity().initial(np.zeros((1, 3)))


@pytest.mark.parametrize("model", [ConstantVelocity, ConstantAcceleration])
def test_noise_whose_powers_are_no_numbers_is_refused(model):
    with pytest.raises(InputError, match=r"measurement_sd: must be"):
        model(measurement_sd=1e200)


@motions
@pytest.mark.parametrize("bad", [-1, np.nan, 1e200, "1", None])
def test_a_time_that_is_invalid_is_refused(motion, bad):
    with pytest.raises(InputError, match="process_noise: frames: must be"):
        motion.process_noise(bad)
    with pytest.raises(InputError, match="transition: frames: must be"):
        motion.transition(bad)
