"""Steps of the chain replaced by the truth, on tracks that are known to be true or not."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.detection.wall import Cylinder
from kilnflight.experiments import campaigns, error_budget
from kilnflight.experiments.campaigns import Settings

LEARNED = Settings(300.0, Cylinder((0.0, 400.0, 7000.0), (0.0, 0.0, 1.0), 700.0), 740.0)


@pytest.fixture
def campaign(monkeypatch):
    monkeypatch.setitem(campaigns.FRAMES, "quick", (100, 60))
    return campaigns.campaigns("quick", LEARNED, scenario="small")[1]


def seen(campaign):
    true = error_budget.true_positions(campaign)
    return true.assign(
        gray=np.where(true["label"] == 2, error_budget.LIT_GRAY, error_budget.UNLIT_GRAY)
    )


def flights(campaign, tracks):
    found = dict(error_budget.replace_steps(campaign, tracks))
    assert tuple(found) == error_budget.STEPS
    for one in found.values():
        assert set(one.flights["particle"]) <= set(one.particles.index)
    return {name: one.flights.reset_index(drop=True) for name, one in found.items()}


def test_true_tracks_fly_the_same_whatever_is_replaced(campaign):
    true = seen(campaign)
    found = flights(campaign, true)
    assert len(found["whole chain"]) > 3
    for name in ("true links", "true depth", "true trajectories"):
        pd.testing.assert_frame_equal(found[name], found["whole chain"])


def test_trajectories_that_are_there_are_not_worked_out_again(campaign):
    true = seen(campaign)
    own = error_budget.fit_tracks(campaign.run, true)
    given = dict(error_budget.replace_steps(campaign, true, own))
    for name, one in error_budget.replace_steps(campaign, true):
        pd.testing.assert_frame_equal(given[name].flights, one.flights)
    none = dict(error_budget.replace_steps(campaign, true, {}))
    assert not none["whole chain"].flights["from_lance"].any()
    assert len(none["true positions and links"].flights) > 3


def test_each_step_takes_away_the_error_of_that_step_alone(campaign):
    true = seen(campaign)
    exact = flights(campaign, true)["whole chain"]
    wrong = true.assign(z=true["z"] + np.where(true["frame"] % 2, 300.0, -200.0))
    found = flights(campaign, wrong)
    for name in ("true depth", "true trajectories", "true positions and links"):
        ours = found[name]["t0_s"]
        np.testing.assert_allclose(ours, exact["t0_s"], err_msg=name)
    for name in ("true links", "weighted axes", "weighted, robust", "whole chain"):
        assert np.abs(found[name]["t0_s"] - exact["t0_s"]).max() > 1e-4, name


def test_links_that_are_wrong_are_mended_where_links_are_true(campaign):
    true = seen(campaign)
    late = true["frame"] > true.groupby("particle")["frame"].transform("median")
    torn = true.assign(particle=2 * true["particle"] + late)
    found = flights(campaign, torn)
    assert len(found["whole chain"]) > len(found["true links"])
    pd.testing.assert_frame_equal(found["true links"], found["true positions and links"])


def test_a_track_without_depth_has_no_trajectory_that_could_be_replaced(campaign):
    true = seen(campaign)
    blind = true["particle"].iloc[0]
    unknown = true["particle"].to_numpy() == blind
    dark = true.assign(**{axis: true[axis].mask(unknown) for axis in "xyz"})
    found = flights(campaign, dark)
    assert blind not in set(found["true trajectories"]["particle"])
    assert blind in set(found["true depth"]["particle"])
    assert len(found["true trajectories"]) == len(found["whole chain"])


def test_a_depth_that_no_gate_lets_pass_is_not_the_particles():
    true = pd.DataFrame({"frame": [0, 1], "particle": 7, "z": [6000.0, 5900.0]})
    tracks = pd.DataFrame({"frame": [0, 1, 1], "x": 1.0, "y": 2.0, "z": [7499.0, 7400.0, 9000.0]})
    found = error_budget.link_by_truth(tracks, np.array([7, 7, -1]), true)
    assert found["particle"].tolist() == [7, 7, -1]
    np.testing.assert_equal(found["z"].to_numpy(), [7499.0, np.nan, 9000.0])
    np.testing.assert_equal(found["x"].to_numpy(), [1.0, np.nan, 1.0])
