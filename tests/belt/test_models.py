"""When and where: models against plain code, and columns that are checked once."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import brentq

from kilnflight import belt
from kilnflight.belt.models import (
    CA,
    CADSC,
    CALV,
    CV,
    CVBC,
    IA,
    ID,
    IV,
    LateralCA,
    LateralCV,
    Ratio,
    Straight,
    checked,
    select,
    time_to_cover,
)
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
    last = last_of([(623.0, 1000.0, 0.0)])
    fitted = model.calibrated(last, arrivals([0.65]), TARGET)
    assert fitted(BELT_LAST.empty(), TARGET).shape == (0,)


@pytest.mark.parametrize("model", belt.ARRIVAL_MODELS, ids=lambda model: model.name)
def test_a_particle_beyond_the_target_is_an_error(model):
    last = last_of([(623.0, 1000.0, 0.0)])
    fitted = model.calibrated(last, arrivals([0.65]), TARGET)
    with pytest.raises(InputError, match="particle 0 was last observed at or beyond"):
        fitted(last_of([(773.0, 1000.0, 0.0)]), TARGET)


@pytest.mark.parametrize(
    ("starts", "equal"), [((623.0,) * 3, True), ((613.0, 623.0, 618.0), False)]
)
def test_identical_delay_is_identical_velocity_where_all_start_at_one_place(starts, equal):
    """Arrivals after 0.10, 0.12 and 0.15 s: the median delay, and a median velocity."""
    last, times = last_of([(x, 1000.0, 0.0) for x in starts]), arrivals([0.60, 0.62, 0.65])
    same, velocity = (model.calibrated(last, times, TARGET) for model in (ID(), IV()))
    np.testing.assert_allclose(same(last, TARGET), 0.62)
    apart = np.abs(same(last, TARGET) - velocity(last, TARGET)).max()
    assert (apart < 1e-12) == equal
    with pytest.raises(InputError, match="ID is not calibrated"):
        ID()(last, TARGET)


@given(state)
def test_eq_6_is_the_first_time_that_eq_5_is_fulfilled(particle):
    x, velocity, acceleration = particle
    predicted = CA()(last_of([particle]), TARGET)[0] - 0.5

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
    predicted = time_to_cover(*(np.array([v]) for v in (100.0, velocity, acceleration)))
    np.testing.assert_allclose(predicted, [time])


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
    arrived = arrivals([0.60, 0.62, 0.70])
    assert IV().calibrated(last, arrived, TARGET).velocity_mm_s == pytest.approx(150 / 0.12)
    assert CVBC().calibrated(last, arrived, TARGET).bias_s == pytest.approx(-0.03)
    optimal = 2 * (150 - 1000 * 0.12) / 0.12**2
    assert IA().calibrated(last, arrived, TARGET).acceleration_mm_s2 == pytest.approx(optimal)


@given(st.lists(state, min_size=1, max_size=6), st.floats(0.05, 0.5))
def test_identical_acceleration_predicts_its_median_particle_exactly(rows, duration):
    last = last_of(rows[:1])
    assume(2 * (TARGET - rows[0][0]) / duration > rows[0][1])  # still moving on at the target
    arrived = arrivals([0.5 + duration])
    fitted = IA().calibrated(last, arrived, TARGET)
    np.testing.assert_allclose(fitted(last, TARGET), arrived["time_s"], rtol=1e-9)


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
    for velocity in (-5.0, "fast", None):
        with pytest.raises(InputError, match="IV: velocity_mm_s"):
            IV(velocity)


def test_a_limit_is_a_velocity():
    with pytest.raises(InputError, match="limit_mm_s"):
        replace(CALV(), limit_mm_s=0.0)


def test_a_particle_that_does_not_move_has_no_arrival_by_constant_velocity():
    assert np.isnan(CV()(last_of([(623.0, 0.0, 9.0)]), TARGET)).all()


motion = st.tuples(st.floats(0, 180), st.floats(-300, 300), st.floats(-3000, 3000))


def lateral_of(rows):
    table = pd.DataFrame(
        [(i, 0.5, 623.0, y, 1000.0, v, 0.0, a) for i, (y, v, a) in enumerate(rows)],
        columns=BELT_LAST.names,
    )
    return table if len(rows) else BELT_LAST.empty()


def arrived(velocities):
    rows = [(i, 0.65, 90.0, v) for i, v in enumerate(velocities)]
    return pd.DataFrame(rows, columns=BELT_ARRIVAL.names)


def calibrated_across(model):
    return model.calibrated(lateral_of([(90.0, 100.0, 0.0)]), arrived([50.0]))


def test_the_lateral_models_are_those_of_the_paper():
    assert [model.name for model in belt.LATERAL_MODELS] == [
        "Straight",
        "CV",
        "CA",
        "CADSC",
        "Ratio",
    ]


def test_the_combinations_are_those_of_fig_10():
    names = ["Straight", "CV-CV", "CA-CA", "LV-DSC", "IA-CV", "IA-CA", "IA-Ratio"]
    assert [name for name, _, _ in belt.COMBINATIONS] == names
    for name, arrival, lateral in belt.COMBINATIONS[1:]:
        first, second = name.split("-")
        assert (arrival.name.removeprefix("CA") if first == "LV" else arrival.name) == first
        assert lateral.name.endswith(second)


@pytest.mark.parametrize("model", belt.LATERAL_MODELS, ids=lambda model: model.name)
def test_a_particle_without_lateral_motion_stays(model):
    still = lateral_of([(42.0, 0.0, 0.0)])
    np.testing.assert_allclose(calibrated_across(model)(still, np.array([0.1])), [42.0])


@pytest.mark.parametrize("model", belt.LATERAL_MODELS, ids=lambda model: model.name)
def test_no_particles_and_wrong_shapes(model):
    fitted = calibrated_across(model)
    assert fitted(BELT_LAST.empty(), np.empty(0)).shape == (0,)
    with pytest.raises(InputError, match="remaining_s"):
        fitted(lateral_of([(42.0, 0.0, 0.0)]), np.zeros(2))


@given(motion, st.floats(0.0, 0.3))
def test_each_model_in_plain_code(particle, time):
    y, v, a = particle
    last, left = lateral_of([particle]), np.array([time])
    assert Straight()(last, left)[0] == y
    assert LateralCV()(last, left)[0] == pytest.approx(y + v * time)
    assert LateralCA()(last, left)[0] == pytest.approx(y + v * time + a * time**2 / 2)
    until = min(time, -v / a) if v * a < 0 else time
    assert CADSC()(last, left)[0] == pytest.approx(y + v * until + a * until**2 / 2)
    # the velocity falls evenly from v to r v: the mean of both counts
    assert Ratio(share=0.5)(last, left)[0] == pytest.approx(y + time * (v + 0.5 * v) / 2)


@given(motion, st.floats(0.0, 0.3), st.floats(0.0, 0.3))
def test_without_sign_changes_nothing_turns_back(particle, first_s, second_s):
    _, v, _ = particle
    early, late = (
        CADSC()(lateral_of([particle]), np.array([t]))[0] for t in sorted([first_s, second_s])
    )
    if v > 0:
        assert late >= early - 1e-9
    if v < 0:
        assert late <= early + 1e-9


def test_ratio_takes_the_median_quotient_of_those_that_move():
    last = lateral_of([(90.0, v, 0.0) for v in (100.0, -50.0, 0.0, 10.0)])
    fitted = Ratio().calibrated(last, arrived([80.0, -10.0, 7.0, 4.0]))
    assert fitted.share == pytest.approx(0.4)


def test_ratio_says_when_it_cannot_be_calibrated():
    with pytest.raises(InputError, match="no calibration particle moves"):
        Ratio().calibrated(lateral_of([(90.0, 0.0, 0.0)]), arrived([1.0]))
    with pytest.raises(InputError, match="same particles"):
        Ratio().calibrated(lateral_of([(90.0, 1.0, 0.0)]), arrived([1.0, 2.0]))
    with pytest.raises(InputError, match="not calibrated"):
        Ratio()(lateral_of([(90.0, 1.0, 0.0)]), np.array([0.1]))


def test_a_time_before_the_last_observation_is_told():
    for wrong in (np.array([-0.1]), [0.1]):
        with pytest.raises(InputError, match="remaining_s"):
            LateralCV()(lateral_of([(90.0, 10.0, 0.0)]), wrong)


def test_without_a_time_there_is_no_place():
    last, left = lateral_of([(90.0, 10.0, -5.0)]), np.array([np.nan])
    assert np.isnan(LateralCV()(last, left)).all()
    assert np.isnan(LateralCA()(last, left)).all()


FIRST = (1, 0.5, 623.0, 90.0, 1400.0, 20.0, 300.0, -50.0)
SECOND = (2, 0.6, 620.0, 80.0, 1450.0, -9.0, 0.0, 1.0)
LAST = pd.DataFrame([FIRST, SECOND], columns=BELT_LAST.names)
ARRIVED = pd.DataFrame([(1, 0.605, 92.0, 15.0), (2, 0.71, 79.0, -8.0)], columns=BELT_ARRIVAL.names)


def test_columns_are_those_of_the_tables_and_not_checked_again():
    last, arrived = checked(LAST, BELT_LAST), checked(ARRIVED, BELT_ARRIVAL)
    assert list(last) == BELT_LAST.names
    assert list(arrived) == BELT_ARRIVAL.names
    assert checked(last, BELT_LAST) is last
    assert checked(arrived, BELT_ARRIVAL) is arrived
    assert select(last, np.array([False, True]))["particle"].tolist() == [2]
    assert [len(column) for column in checked(BELT_LAST.empty(), BELT_LAST).values()] == [0] * 8


def test_a_table_without_a_column_is_refused():
    with pytest.raises(InputError, match="velocity_x_mm_s"):
        checked(LAST.drop(columns="velocity_x_mm_s"), BELT_LAST)


@pytest.mark.parametrize("model", belt.ARRIVAL_MODELS, ids=lambda model: model.name)
def test_arrival_models_say_the_same_of_tables_and_columns(model):
    last, arrived = checked(LAST, BELT_LAST), checked(ARRIVED, BELT_ARRIVAL)
    assert model.calibrated(last, arrived, 773.0) == model.calibrated(LAST, ARRIVED, 773.0)
    fitted = model.calibrated(LAST, ARRIVED, 773.0)
    assert fitted(last, 773.0).tolist() == fitted(LAST, 773.0).tolist()


@pytest.mark.parametrize("model", belt.LATERAL_MODELS, ids=lambda model: model.name)
def test_lateral_models_say_the_same_of_tables_and_columns(model):
    last, arrived, left = (
        checked(LAST, BELT_LAST),
        checked(ARRIVED, BELT_ARRIVAL),
        np.array([0.1, 0.11]),
    )
    assert model.calibrated(last, arrived) == model.calibrated(LAST, ARRIVED)
    fitted = model.calibrated(LAST, ARRIVED)
    assert fitted(last, left).tolist() == fitted(LAST, left).tolist()
