from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import brentq

from kilnflight import belt
from kilnflight.belt.arrival import CA, CALV, CV, CVBC, IA, IV, time_to_cover
from kilnflight.checks import InputError
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST

TARGET = 773.0
accelerations = st.floats(-5000, 5000).map(lambda a: a if abs(a) > 1e-3 else 0.0)
state = st.tuples(st.floats(400, 760), st.floats(50, 2500), accelerations)


def last_of(rows):
    table = pd.DataFrame(
        [(i, 0.5, x, 90.0, v, 0.0, a, 0.0) for i, (x, v, a) in enumerate(rows)],
        columns=BELT_LAST.names,
    )
    return table if len(rows) else BELT_LAST.empty()


def arrivals(times):
    rows = [(i, t, 90.0, 0.0) for i, t in enumerate(times)]
    return pd.DataFrame(rows, columns=BELT_ARRIVAL.names)


def test_the_models_are_those_of_the_paper():
    assert [model.name for model in belt.ARRIVAL_MODELS] == ["IV", "CV", "CVBC", "CA", "CALV", "IA"]


@pytest.mark.parametrize("model", belt.ARRIVAL_MODELS, ids=lambda model: model.name)
def test_every_model_predicts_a_particle_of_constant_velocity(model):
    last = last_of([(623.0, 1000.0, 0.0)])
    fitted = model.calibrated(last, arrivals([0.65]), TARGET)
    np.testing.assert_allclose(fitted(last, TARGET), [0.65])


@pytest.mark.parametrize("model", belt.ARRIVAL_MODELS, ids=lambda model: model.name)
def test_every_model_takes_no_particles(model):
    one = last_of([(623.0, 1000.0, 0.0)])
    fitted = model.calibrated(one, arrivals([0.65]), TARGET)
    assert fitted(BELT_LAST.empty(), TARGET).shape == (0,)


@pytest.mark.parametrize("model", belt.ARRIVAL_MODELS, ids=lambda model: model.name)
def test_a_particle_beyond_the_target_is_an_error(model):
    one = last_of([(623.0, 1000.0, 0.0)])
    fitted = model.calibrated(one, arrivals([0.65]), TARGET)
    with pytest.raises(InputError, match="particle 0 was last observed at or beyond"):
        fitted(last_of([(773.0, 1000.0, 0.0)]), TARGET)


@given(state)
def test_eq_6_is_the_first_time_that_eq_5_is_fulfilled(particle):
    x, velocity, acceleration = particle
    found = CA()(last_of([particle]), TARGET)[0] - 0.5

    def left(t):
        return velocity * t + acceleration * t * t / 2 - (TARGET - x)

    assume(abs(velocity**2 + 2 * acceleration * (TARGET - x)) > 1.0)
    turn = -velocity / acceleration if acceleration < 0 else 1e3
    if left(turn) < 0:
        assert np.isnan(found)
    else:
        assert found == pytest.approx(brentq(left, 0.0, turn, xtol=1e-14), rel=1e-6)


@pytest.mark.parametrize(
    ("velocity", "acceleration", "time"),
    [
        (0.0, 200.0, 1.0),  # from rest
        (-100.0, 400.0, 1.0),  # moves back first: the positive root
        (100.0, -200.0, np.nan),  # stops half way: no root
        (0.0, 0.0, np.nan),  # never moves
        (-100.0, 0.0, np.nan),  # moves away
        (100.0, 1e-12, 1.0),  # no cancellation
        (200.0, -200.0, 1.0),  # comes to rest exactly there
    ],
)
def test_roots_by_hand(velocity, acceleration, time):
    found = time_to_cover(*(np.array([v]) for v in (100.0, velocity, acceleration)))
    np.testing.assert_allclose(found, [time])


def calv_step_by_step(x, velocity, acceleration, limit, step=1e-5):
    """Integrate: accelerate until the limit, then keep it."""
    time = 0.0
    while x < TARGET and time < 3.0:
        # a particle that is faster than the limit keeps its velocity unless it slows down
        if acceleration > 0:
            gain = min(acceleration * step, max(limit - velocity, 0.0))
        else:
            gain = acceleration * step
        x += (velocity + gain / 2) * step
        velocity += gain
        if velocity < 0:
            return np.nan
        time += step
    return time


@pytest.mark.parametrize(
    "particle",
    [
        (623.0, 1400.0, 3000.0),  # reaches the limit on the way
        (623.0, 1000.0, 500.0),  # never reaches it
        (623.0, 1400.0, 0.0),
        (623.0, 1400.0, -2000.0),
        (623.0, 1600.0, 2000.0),  # faster than the limit already
        (623.0, 1600.0, -800.0),
        (623.0, 300.0, -800.0),  # stops before the target
    ],
)
def test_calv_is_acceleration_up_to_a_limit(particle):
    expected = calv_step_by_step(*particle, limit=1500.0)
    np.testing.assert_allclose(CALV()(last_of([particle]), TARGET) - 0.5, [expected], atol=2e-5)


@given(st.lists(state, min_size=1, max_size=5))
def test_calv_lies_between_ca_and_the_limit(rows):
    last = last_of(rows)
    free, limited = CA()(last, TARGET), CALV()(last, TARGET)
    known = np.isfinite(free)
    np.testing.assert_array_equal(known, np.isfinite(limited))
    assert (limited[known] >= free[known] - 1e-12).all()
    np.testing.assert_allclose(CALV(limit_mm_s=1e9)(last, TARGET), free)


@pytest.mark.parametrize("acceleration", [5e-324, 1e-278, -5e-324])
def test_an_acceleration_next_to_nothing_is_constant_velocity(acceleration):
    last = last_of([(623.0, 1000.0, acceleration)])
    for model in (CA(), CALV()):
        np.testing.assert_allclose(model(last, TARGET), [0.65])


def test_calibration_takes_medians():
    last = last_of([(623.0, 1000.0, 0.0)] * 3)
    seen = arrivals([0.60, 0.62, 0.70])
    assert IV().calibrated(last, seen, TARGET).velocity_mm_s == pytest.approx(150 / 0.12)
    assert CVBC().calibrated(last, seen, TARGET).bias_s == pytest.approx(-0.03)
    optimal = 2 * (150 - 1000 * 0.12) / 0.12**2
    assert IA().calibrated(last, seen, TARGET).acceleration_mm_s2 == pytest.approx(optimal)


@given(st.lists(state, min_size=1, max_size=6), st.floats(0.05, 0.5))
def test_identical_acceleration_predicts_its_median_particle_exactly(rows, duration):
    last = last_of(rows[:1])
    assume(2 * (TARGET - rows[0][0]) / duration > rows[0][1])  # still moving on at the target
    seen = arrivals([0.5 + duration])
    fitted = IA().calibrated(last, seen, TARGET)
    np.testing.assert_allclose(fitted(last, TARGET), seen["time_s"], rtol=1e-9)


@pytest.mark.parametrize("model", [IV(), CVBC(), IA()], ids=lambda model: model.name)
def test_what_needs_calibration_says_so(model):
    with pytest.raises(InputError, match=rf"{model.name} is not calibrated"):
        model(last_of([(623.0, 1000.0, 0.0)]), TARGET)


@pytest.mark.parametrize("model", [IV(), CVBC(), IA()], ids=lambda model: model.name)
def test_calibration_needs_the_same_particles(model):
    last = last_of([(623.0, 1000.0, 0.0)] * 2)
    with pytest.raises(InputError, match="same particles in the same order"):
        model.calibrated(last, arrivals([0.6]), TARGET)
    with pytest.raises(InputError, match="at least one particle"):
        model.calibrated(BELT_LAST.empty(), BELT_ARRIVAL.empty(), TARGET)


def test_cvbc_leaves_out_what_cv_never_brings():
    last = last_of([(623.0, 1000.0, 0.0), (623.0, 0.0, 0.0)])
    assert CVBC().calibrated(last, arrivals([0.66, 0.9]), TARGET).bias_s == pytest.approx(0.01)
    with pytest.raises(InputError, match="no calibration particle"):
        CVBC().calibrated(last_of([(623.0, 0.0, 0.0)]), arrivals([0.9]), TARGET)


def test_what_arrives_before_it_was_seen_is_told():
    last = last_of([(623.0, 1000.0, 0.0)])
    for model in (IV(), IA(), CVBC()):
        with pytest.raises(InputError, match="particle 0 arrives before"):
            model.calibrated(last, arrivals([0.5]), TARGET)


def test_a_target_and_a_shared_velocity_are_numbers_that_arrive():
    with pytest.raises(InputError, match="target_mm"):
        CV()(last_of([(623.0, 1000.0, 0.0)]), np.nan)
    with pytest.raises(InputError, match="IV: velocity_mm_s"):
        IV(-5.0)


def test_a_limit_is_a_velocity():
    with pytest.raises(InputError, match="limit_mm_s"):
        replace(CALV(), limit_mm_s=0.0)


def test_a_particle_that_does_not_move_has_no_arrival_by_constant_velocity():
    assert np.isnan(CV()(last_of([(623.0, 0.0, 9.0)]), TARGET)).all()
