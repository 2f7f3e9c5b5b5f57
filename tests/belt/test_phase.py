"""Last observations, arrivals, and deviations of predictions."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.cbook import boxplot_stats
from tests.definitions import belt as plain

from kilnflight.belt import ARRIVAL_MODELS, COMBINATIONS, PredictionPhase
from kilnflight.belt.camera import Area
from kilnflight.belt.phase import (
    SUMMARY,
    arrival_deviations,
    evaluate,
    last_states,
    lateral_deviations,
    observe_followed,
    summarise_deviations,
)
from kilnflight.belt.tracker import LEFT, Appearance, BeltTracker, constant_velocity
from kilnflight.checks import InputError
from kilnflight.simulated.belt import friction
from kilnflight.tables import BELT_TRACKS

PHASE = PredictionPhase()


@st.composite
def some_tracks(draw):
    """Tracks with gaps, late starts and early ends."""
    parts = [BELT_TRACKS.empty()]
    for particle in draw(st.lists(st.integers(0, 50), unique=True, max_size=4)):
        generator = np.random.default_rng(draw(st.integers(0, 99)))
        x = (
            draw(st.floats(380.0, 640.0))
            + generator.uniform(5, 30, generator.integers(1, 30)).cumsum()
        )
        frame = draw(st.integers(0, 9)) + np.arange(len(x))
        keep = generator.random(len(x)) > 0.02
        table = pd.DataFrame(
            {"frame": frame, "particle": particle, "time_s": frame / 100}
        )
        parts.append(table.assign(x=x, y=np.sin(x))[keep])
    shuffled = pd.concat(parts).sample(frac=1.0, random_state=1)
    return shuffled.astype({"frame": int, "particle": int})


@settings(max_examples=15)
@given(some_tracks())
def test_observations_are_those_of_the_definition(tracks):
    rows, reasons = plain.observe(
        tracks, PHASE.start_mm, PHASE.target_mm, PHASE.extrapolated_mm
    )
    last, arrival, left_out = PHASE.observe(tracks)
    assert list(left_out.values()) == reasons
    assert (
        last["particle"].tolist()
        == arrival["particle"].tolist()
        == [row[0] for row in rows]
    )
    states = last[["time_s", "velocity_x_mm_s", "acceleration_x_mm_s2"]]
    observed = np.column_stack([states, arrival[["time_s", "y"]]])
    expected = np.array([row[1:] for row in rows]).reshape(-1, 5)
    np.testing.assert_allclose(observed, expected, rtol=1e-6, atol=1e-4)


def test_states_are_carried_to_the_start_by_their_own_acceleration(
    constant_acceleration,
):
    observed = PHASE.observe(constant_acceleration)
    carried = PHASE.carry(observed)
    np.testing.assert_allclose(carried.last["x"], PHASE.start_mm)
    before, after = observed.last, carried.last
    wait = after["time_s"] - before["time_s"]
    assert wait.between(0, 0.01).all()
    gained = wait * before["acceleration_x_mm_s2"]
    np.testing.assert_allclose(
        after["velocity_x_mm_s"] - before["velocity_x_mm_s"], gained
    )
    stops = observed._replace(
        last=before.assign(velocity_x_mm_s=1.0, acceleration_x_mm_s2=-1e3)
    )
    pd.testing.assert_frame_equal(PHASE.carry(stops).last, stops.last)


def test_a_track_that_ends_before_the_edge_arrives_on_its_parabola(
    constant_acceleration,
):
    before = constant_acceleration[constant_acceleration["x"] < 788.0]
    arrival, left_out = PHASE.observe(before)[1:]
    assert not any(left_out.values())
    way = 788.0 - 400.0
    times = [
        start / 100 + (np.sqrt(v**2 + 2 * a * way) - v) / a
        if a
        else start / 100 + way / v
        for start, v, a in ((0, 1000.0, 1500.0), (7, 1200.0, 800.0), (2, 900.0, 0.0))
    ]
    np.testing.assert_allclose(arrival["time_s"], times, rtol=0, atol=1e-9)
    since = arrival["time_s"].iloc[0]
    assert arrival["y"].iloc[0] == pytest.approx(90.0 + 50.0 * since - 50.0 * since**2)
    assert arrival["velocity_y_mm_s"].iloc[0] == pytest.approx(50.0 - 100.0 * since)
    short = before[before["x"] < 788.0 - PHASE.extrapolated_mm]
    assert PHASE.observe(short).left_out["target never reached"] == 3


@settings(max_examples=15)
@given(st.lists(st.floats(-100, 100), min_size=1, max_size=40))
def test_a_summary_is_the_box_plot_of_matplotlib(values):
    summary, expected = summarise_deviations(np.array(values)), boxplot_stats(values)[0]
    for name, key in {"median": "med", "q25": "q1", "q75": "q3"}.items():
        assert summary[name] == pytest.approx(expected[key])
    assert summary["mae"] == pytest.approx(np.mean(np.abs(values)))


def test_whiskers_and_particles_without_a_prediction_by_hand():
    summary = summarise_deviations(
        np.array([-9.0, -1.0, np.nan, 0.0, 0.0, 1.0, 1.5, 50.0])
    )
    assert (summary["whisker_low"], summary["whisker_high"]) == (-1.0, 1.5)
    assert (summary["n"], summary["unpredicted"], summary["median"]) == (7, 1, 0.0)
    with pytest.raises(InputError, match="deviation"):
        summarise_deviations(np.array([np.nan]))


@pytest.fixture(scope="module")
def observed():
    small = friction.FrictionBelt(particles=120, feed_s=1.0)
    return PHASE.observe(small(np.random.default_rng(1)))


def test_calibration_particles_are_not_evaluated(observed):
    calibration = np.zeros(len(observed.last), dtype=bool)
    calibration[[3, 4, 9]] = True
    for deviations in (arrival_deviations, lateral_deviations):
        for _, deviation in deviations(observed, PHASE, calibration):
            assert len(deviation) == len(observed.last) - 3
    # a particle that accelerates arrives earlier than constant velocity predicts
    assert np.median(dict(arrival_deviations(observed, PHASE, calibration))["CV"]) > 0


def test_every_model_is_evaluated_and_more_draws_keep_the_first(observed):
    few, more = (evaluate(observed, PHASE, arrival_deviations, n, 1) for n in (2, 3))
    assert few["model"].unique().tolist() == [model.name for model in ARRIVAL_MODELS]
    pd.testing.assert_frame_equal(few, more[more["draw"] < 2])
    assert not few["mae"].equals(
        evaluate(observed, PHASE, arrival_deviations, 2, 2)["mae"]
    )
    lateral = evaluate(observed, PHASE, lateral_deviations, 2, 1)
    assert lateral["model"].unique().tolist() == [name for name, _, _ in COMBINATIONS]
    assert list(lateral.columns) == ["draw", "model", *SUMMARY]
    with pytest.raises(InputError, match="observed"):
        evaluate(
            observed._replace(last=observed.last[:99]), PHASE, arrival_deviations, 1, 1
        )


def test_filtered_states_come_with_measured_arrivals(constant_acceleration):
    area, names = Area(end_mm=900.0), ["frame", "x", "y"]
    tracker = BeltTracker(constant_velocity(), Appearance(area, entry_mm=25.0), 0.01)
    followed = tracker(constant_acceleration[names])
    observed = observe_followed(followed, constant_acceleration[names], PHASE, 0.01)
    expected = PHASE.observe(constant_acceleration)
    for ours, theirs in zip(observed[:2], expected[:2], strict=True):
        assert len(ours) == 3
        times = ours["time_s"].sort_values(), theirs["time_s"].sort_values()
        np.testing.assert_allclose(*times, atol=1e-9)
    assert followed.ends["valid"].all()
    assert len(last_states(followed, 0.01)) == (followed.ends["reason"] == LEFT).sum()
