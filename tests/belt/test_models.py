"""When and where: models against plain code and answers by hand."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from tests.definitions.belt import limited_time

from kilnflight import belt
from kilnflight.belt import models
from kilnflight.checks import InputError
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST

TARGET = 773.0
accelerations = st.floats(-5000, 5000).map(lambda a: a if abs(a) > 1e-3 else 0.0)
state = st.tuples(st.floats(400, 760), st.floats(50, 2500), accelerations)
few = settings(max_examples=15)


def last_of(*rows, axis="x"):
    """Particles at 0.5 s by place, velocity and acceleration along an axis."""
    empty = pd.DataFrame(0.0, range(len(rows)), BELT_LAST.names)
    table = empty.assign(
        particle=range(len(rows)), time_s=0.5, x=623.0, velocity_x_mm_s=1000.0
    )
    names = [axis, f"velocity_{axis}_mm_s", f"acceleration_{axis}_mm_s2"]
    table[names] = np.reshape(np.array(rows, dtype=float), (-1, 3))
    return table


def arrivals(*times, velocities=None):
    velocities = [0.0] * len(times) if velocities is None else velocities
    rows = [
        (i, t, 90.0, v) for i, (t, v) in enumerate(zip(times, velocities, strict=True))
    ]
    return pd.DataFrame(rows, columns=BELT_ARRIVAL.names)


ONE = last_of((623.0, 1000.0, 0.0))
by_name = pytest.mark.parametrize(
    "model", belt.ARRIVAL_MODELS, ids=lambda model: model.name
)
lateral_by_name = pytest.mark.parametrize(
    "model", belt.LATERAL_MODELS, ids=lambda model: model.name
)


def test_models_and_combinations_are_those_of_the_paper():
    assert [model.name for model in belt.ARRIVAL_MODELS] == [
        "IV",
        "CV",
        "CVBC",
        "CA",
        "CALV",
        "IA",
    ]
    names = [model.name for model in belt.LATERAL_MODELS]
    assert names == ["Straight", "CV", "CA", "CADSC", "Ratio"]
    names = ["Straight", "CV-CV", "CA-CA", "LV-DSC", "IA-CV", "IA-CA", "IA-Ratio"]
    assert [name for name, _, _ in belt.COMBINATIONS] == names


@by_name
def test_every_model_predicts_a_particle_of_constant_velocity(model):
    fitted = model.calibrated(ONE, arrivals(0.65), TARGET)
    np.testing.assert_allclose(fitted(ONE, TARGET), [0.65])
    assert fitted(BELT_LAST.empty(), TARGET).shape == (0,)
    arrays = {name: ONE[name].to_numpy() for name in ONE}
    assert fitted(arrays, TARGET).tolist() == fitted(ONE, TARGET).tolist()


@few
@given(state)
def test_eq_6_is_the_first_time_that_eq_5_is_fulfilled(particle):
    x, velocity, acceleration = particle
    predicted = models.CA()(last_of(particle), TARGET)[0] - 0.5

    def left(t):
        return velocity * t + acceleration * t * t / 2 - (TARGET - x)

    assume(abs(velocity**2 + 2 * acceleration * (TARGET - x)) > 1.0)
    turn = -velocity / acceleration if acceleration < 0 else 1e3
    if left(turn) < 0:
        assert np.isnan(predicted)
    else:
        assert predicted == pytest.approx(brentq(left, 0.0, turn, xtol=1e-14), rel=1e-6)


@pytest.mark.parametrize(
    ("velocity", "acceleration", "time"),
    [
        (-100.0, 400.0, 1.0),  # moves back first: the positive root
        (100.0, -200.0, np.nan),  # stops half way: no root
        (0.0, 0.0, np.nan),  # never moves
        (100.0, 1e-12, 1.0),  # no cancellation
        (200.0, -200.0, 1.0),  # comes to rest exactly there
    ],
)
def test_roots_by_hand(velocity, acceleration, time):
    predicted = models.time_to_cover(
        *(np.array([v]) for v in (100.0, velocity, acceleration))
    )
    np.testing.assert_allclose(predicted, [time])


@pytest.mark.parametrize(
    "motion",
    [
        (1400.0, 3000.0),  # reaches the limit on the way
        (1000.0, 500.0),  # never reaches it
        (1600.0, 2000.0),  # faster than the limit already
        (1600.0, -800.0),
        (300.0, -800.0),  # stops before the target
    ],
)
def test_calv_is_acceleration_up_to_a_limit(motion):
    expected = limited_time(150.0, *motion, limit=1500.0)
    predicted = models.CALV()(last_of((623.0, *motion)), TARGET) - 0.5
    np.testing.assert_allclose(predicted, [expected], atol=2e-5)
    with pytest.raises(InputError, match="limit_mm_s"):
        models.CALV(limit_mm_s=0.0)


def test_calibration_takes_medians():
    last = last_of(*[(623.0, 1000.0, 0.0)] * 3)
    arrived = arrivals(0.60, 0.62, 0.70)
    assert models.IV().calibrated(last, arrived, TARGET).velocity_mm_s == pytest.approx(
        150 / 0.12
    )
    assert models.CVBC().calibrated(last, arrived, TARGET).bias_s == pytest.approx(
        -0.03
    )
    optimal = 2 * (150 - 1000 * 0.12) / 0.12**2
    fitted = models.IA().calibrated(last, arrived, TARGET)
    assert fitted.acceleration_mm_s2 == pytest.approx(optimal)
    np.testing.assert_allclose(fitted(last, TARGET), [0.62] * 3)


def test_cvbc_leaves_out_particles_without_a_prediction_by_cv():
    last, still = (
        last_of((623.0, 1000.0, 0.0), (623.0, 0.0, 9.0)),
        last_of((623.0, 0.0, 9.0)),
    )
    assert models.CVBC().calibrated(
        last, arrivals(0.66, 0.9), TARGET
    ).bias_s == pytest.approx(0.01)
    with pytest.raises(InputError, match="last"):
        models.CVBC().calibrated(still, arrivals(0.9), TARGET)


@lateral_by_name
def test_a_particle_without_lateral_motion_stays(model):
    fitted = model.calibrated(
        last_of((90.0, 100.0, 0.0), axis="y"), arrivals(0.65, velocities=[50.0])
    )
    still = last_of((42.0, 0.0, 0.0), axis="y")
    np.testing.assert_allclose(fitted(still, np.array([0.1])), [42.0])
    assert fitted(BELT_LAST.empty(), np.empty(0)).shape == (0,)
    for wrong in (np.zeros(2), np.array([-0.1]), 0.1):
        with pytest.raises(InputError, match="remaining_s"):
            fitted(still, wrong)


motion = st.tuples(st.floats(0, 180), st.floats(-300, 300), st.floats(-3000, 3000))


@few
@given(motion, st.floats(0.0, 0.3))
def test_each_lateral_model_in_plain_code(particle, time):
    y, v, a = particle
    last, left = last_of(particle, axis="y"), np.array([time])
    assert models.Straight()(last, left)[0] == y
    assert models.LateralCV()(last, left)[0] == pytest.approx(y + v * time)
    assert models.LateralCA()(last, left)[0] == pytest.approx(
        y + v * time + a * time**2 / 2
    )
    until = min(time, -v / a) if v * a < 0 else time
    assert models.CADSC()(last, left)[0] == pytest.approx(
        y + v * until + a * until**2 / 2
    )
    # the velocity falls evenly from v to r v: the mean of both counts
    assert models.Ratio(share=0.5)(last, left)[0] == pytest.approx(
        y + time * (v + 0.5 * v) / 2
    )


def test_ratio_takes_the_median_quotient_of_those_that_move():
    last = last_of(*((90.0, v, 0.0) for v in (100.0, -50.0, 0.0, 10.0)), axis="y")
    after = arrivals(0.6, 0.6, 0.6, 0.6, velocities=[80.0, -10.0, 7.0, 4.0])
    assert models.Ratio().calibrated(last, after).share == pytest.approx(0.4)
    with pytest.raises(InputError, match="last"):
        models.Ratio().calibrated(last_of((90.0, 0.0, 0.0), axis="y"), arrivals(0.6))
    with pytest.raises(InputError, match="not calibrated"):
        models.Ratio()(last, np.full(4, 0.1))


@lateral_by_name
@pytest.mark.parametrize(
    "remaining",
    [
        ["0.1", "0.2"],
        "0.1",
        [0.1, "a"],
        [[0.1], [0.1, 0.2]],
        [[0.1], [0.2]],
        [0.1],
        0.1,
        [0.1, -0.1],
        [0.1, np.inf],
        [0.1, None, 0.2],
        [True, False],
        np.ma.masked_array([0.1, 0.2], [False, True]),
        None,
    ],
    ids=str,
)
def test_times_that_are_no_numbers_of_each_particle_are_refused(model, remaining):
    last = last_of((90.0, 10.0, 0.0), (20.0, 10.0, 0.0), axis="y")
    fitted = model.calibrated(last, arrivals(0.6, 0.6, velocities=[5.0, 5.0]))
    assert fitted(last, [0.1, np.nan])[0] == fitted(last, np.array([0.1, 0.2]))[0]
    with pytest.raises(InputError, match="remaining_s"):
        fitted(last, remaining)


@pytest.mark.parametrize(
    ("model", "values"),
    [
        (models.IV, [0.0, -1.0, np.inf, "1", None, [1.0]]),
        (models.CVBC, [np.inf, "1", None, (1.0,)]),
        (models.IA, [np.inf, "1", None, True]),
        (models.Ratio, [np.inf, "1", None, True]),
        (models.CALV, [0.0, np.nan, np.inf, "1", None]),
    ],
)
def test_a_parameter_that_no_calibration_gives_is_refused(model, values):
    for value in values:
        with pytest.raises(InputError, match=model.__name__):
            model(value)
