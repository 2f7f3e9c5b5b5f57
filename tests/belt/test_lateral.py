import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight import belt
from kilnflight.belt.lateral import CA, CADSC, CV, Ratio, Straight
from kilnflight.checks import InputError
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST

motion = st.tuples(st.floats(0, 180), st.floats(-300, 300), st.floats(-3000, 3000))


def last_of(rows):
    table = pd.DataFrame(
        [(i, 0.5, 623.0, y, 1000.0, v, 0.0, a) for i, (y, v, a) in enumerate(rows)],
        columns=BELT_LAST.names,
    )
    return table if len(rows) else BELT_LAST.empty()


def arrived(velocities):
    rows = [(i, 0.65, 90.0, v) for i, v in enumerate(velocities)]
    return pd.DataFrame(rows, columns=BELT_ARRIVAL.names)


def calibrated(model):
    return model.calibrated(last_of([(90.0, 100.0, 0.0)]), arrived([50.0]))


def test_the_models_are_those_of_the_paper():
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
    still = last_of([(42.0, 0.0, 0.0)])
    np.testing.assert_allclose(calibrated(model)(still, np.array([0.1])), [42.0])


@pytest.mark.parametrize("model", belt.LATERAL_MODELS, ids=lambda model: model.name)
def test_no_particles_and_wrong_shapes(model):
    fitted = calibrated(model)
    assert fitted(BELT_LAST.empty(), np.empty(0)).shape == (0,)
    with pytest.raises(InputError, match="remaining_s"):
        fitted(last_of([(42.0, 0.0, 0.0)]), np.zeros(2))


@given(motion, st.floats(0.0, 0.3))
def test_each_model_in_plain_code(particle, time):
    y, v, a = particle
    last, left = last_of([particle]), np.array([time])
    assert Straight()(last, left)[0] == y
    assert CV()(last, left)[0] == pytest.approx(y + v * time)
    assert CA()(last, left)[0] == pytest.approx(y + v * time + a * time**2 / 2)
    until = min(time, -v / a) if v * a < 0 else time
    assert CADSC()(last, left)[0] == pytest.approx(y + v * until + a * until**2 / 2)
    # the velocity falls evenly from v to r v: the mean of both counts
    assert Ratio(share=0.5)(last, left)[0] == pytest.approx(y + time * (v + 0.5 * v) / 2)


@given(motion, st.floats(0.0, 0.3), st.floats(0.0, 0.3))
def test_without_sign_changes_nothing_turns_back(particle, one, two):
    _, v, _ = particle
    early, late = (CADSC()(last_of([particle]), np.array([t]))[0] for t in sorted([one, two]))
    if v > 0:
        assert late >= early - 1e-9
    if v < 0:
        assert late <= early + 1e-9


def test_ratio_takes_the_median_quotient_of_those_that_move():
    last = last_of([(90.0, v, 0.0) for v in (100.0, -50.0, 0.0, 10.0)])
    fitted = Ratio().calibrated(last, arrived([80.0, -10.0, 7.0, 4.0]))
    assert fitted.share == pytest.approx(0.4)


def test_ratio_says_when_it_cannot_be_calibrated():
    with pytest.raises(InputError, match="no calibration particle moves"):
        Ratio().calibrated(last_of([(90.0, 0.0, 0.0)]), arrived([1.0]))
    with pytest.raises(InputError, match="same particles"):
        Ratio().calibrated(last_of([(90.0, 1.0, 0.0)]), arrived([1.0, 2.0]))
    with pytest.raises(InputError, match="not calibrated"):
        Ratio()(last_of([(90.0, 1.0, 0.0)]), np.array([0.1]))


def test_a_time_before_the_last_observation_is_told():
    for wrong in (np.array([-0.1]), [0.1]):
        with pytest.raises(InputError, match="remaining_s"):
            CV()(last_of([(90.0, 10.0, 0.0)]), wrong)


def test_without_a_time_there_is_no_place():
    last, left = last_of([(90.0, 10.0, -5.0)]), np.array([np.nan])
    assert np.isnan(CV()(last, left)).all()
    assert np.isnan(CA()(last, left)).all()
