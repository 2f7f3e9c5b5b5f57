"""Deviations of predictions, velocities along the belt, and what a tracker knew last."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.cbook import boxplot_stats

from kilnflight.belt import ARRIVAL_MODELS, COMBINATIONS, PredictionPhase
from kilnflight.belt.evaluation import (
    SUMMARY,
    Evaluation,
    arrival_deviations,
    last_states,
    lateral_deviations,
    summarise_deviations,
)
from kilnflight.belt.tracker import Followed
from kilnflight.checks import InputError
from kilnflight.sorter import friction
from kilnflight.tables import BELT_STATES

PHASE = PredictionPhase()


@pytest.fixture(scope="module")
def observed():
    small = friction.FrictionBelt(particles=300, feed_s=2.0)
    return PHASE.observe(small(np.random.default_rng(1)))


@given(st.lists(st.floats(-100, 100), min_size=1, max_size=40))
def test_a_summary_is_the_box_plot_of_matplotlib(values):
    summary, expected = summarise_deviations(np.array(values)), boxplot_stats(values)[0]
    for name, key in {"median": "med", "q25": "q1", "q75": "q3"}.items():
        assert summary[name] == pytest.approx(expected[key])
    assert summary["mae"] == pytest.approx(np.mean(np.abs(values)))


def test_whiskers_end_at_the_last_value_within_reach():
    summary = summarise_deviations(np.array([-9.0, -1.0, 0.0, 0.0, 1.0, 1.5, 50.0]))
    assert (summary["whisker_low"], summary["whisker_high"]) == (-1.0, 1.5)


def test_what_has_no_prediction_is_counted_and_left_out():
    summary = summarise_deviations(np.array([1.0, np.nan, 3.0]))
    assert (summary["n"], summary["unpredicted"], summary["median"]) == (2, 1, 2.0)
    with pytest.raises(InputError, match="no particle has a prediction"):
        summarise_deviations(np.array([np.nan]))


def test_positive_means_earlier_than_predicted(observed):
    """A particle that accelerates arrives earlier than constant velocity predicts."""
    none = np.zeros(len(observed.last), dtype=bool)
    none[0] = True
    by_model = dict(arrival_deviations(observed, PHASE, none))
    assert np.median(by_model["CV"]) > 0


def test_calibration_particles_are_not_evaluated(observed):
    calibration = np.zeros(len(observed.last), dtype=bool)
    calibration[[3, 4, 9]] = True
    for deviations in (arrival_deviations, lateral_deviations):
        for _, deviation in deviations(observed, PHASE, calibration):
            assert len(deviation) == len(observed.last) - 3


def test_every_model_and_combination_is_there(observed):
    evaluation = Evaluation(draws=2, share=0.05)
    arrival = evaluation(observed, PHASE, arrival_deviations, 1)
    assert arrival["model"].unique().tolist() == [model.name for model in ARRIVAL_MODELS]
    lateral = evaluation(observed, PHASE, lateral_deviations, 1)
    assert lateral["model"].unique().tolist() == [name for name, _, _ in COMBINATIONS]
    assert list(lateral.columns) == ["draw", "model", *SUMMARY]


def test_the_same_seed_gives_the_same_and_more_draws_keep_the_first(observed):
    few = Evaluation(draws=2, share=0.05)(observed, PHASE, arrival_deviations, 1)
    more = Evaluation(draws=4, share=0.05)(observed, PHASE, arrival_deviations, 1)
    pd.testing.assert_frame_equal(few, more[more["draw"] < 2])
    other = Evaluation(draws=2, share=0.05)(observed, PHASE, arrival_deviations, 2)
    assert not few["mae"].equals(other["mae"])


def test_the_calibration_takes_at_most_its_share(observed):
    sizes = []

    def deviations(_observed, _phase, calibration):
        sizes.append(calibration.sum())
        yield "x", np.array([1.0])

    Evaluation(draws=3, share=0.01)(observed, PHASE, deviations, 1)
    assert sizes == [int(0.01 * len(observed.last))] * 3


def test_too_few_particles_and_wrong_settings_are_told(observed):
    with pytest.raises(InputError, match="less than one"):
        Evaluation(share=0.001)(observed, PHASE, arrival_deviations, 1)
    for wrong in ({"share": 0.0}, {"share": 1.0}, {"draws": 0}):
        with pytest.raises(InputError, match="Evaluation"):
            Evaluation(**wrong)


def test_only_valid_tracks_that_entered_the_phase_are_predicted():
    states = pd.DataFrame([[0] * 11] * 3, columns=BELT_STATES.names)
    states["particle"] = [0, 1, 2]
    ends = pd.DataFrame({"particle": [0, 1, 2], "frame": 0, "valid": [1, 0, 1]})
    ends["reason"] = ["left at the end", "left at the end", "lost"]
    assert last_states(Followed(states, ends), 0.005)["particle"].tolist() == [0]
    with pytest.raises(InputError, match="frame_s"):
        last_states(Followed(states, ends), 0.0)
