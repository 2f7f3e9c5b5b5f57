"""Measured beside true, made by hand; steps of the chain replaced by the truth."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.detection.wall import Cylinder
from kilnflight.experiments.flights import campaigns
from kilnflight.experiments.flights.accuracy import FlightTables, compare, errors
from kilnflight.experiments.flights.campaigns import LearnedSettings
from kilnflight.publication import notebooks

LEARNED = LearnedSettings(
    300.0, Cylinder((0.0, 400.0, 7000.0), (0.0, 0.0, 1.0), 700.0), 740.0
)
TRUE = pd.DataFrame(
    {
        "particle": [0, 11, 12],
        "true_ending": ["burnt out", "landed", "landed"],
        "true_dwell_s": [0.3, 0.4, 0.5],
        "true_velocity_m_s": [5.0, 6.0, 7.0],
        "true_ignition_s": [0.1, np.nan, np.nan],
        "measurable": [True, True, False],
    }
)
FLIGHTS = pd.DataFrame(
    {
        "particle": [1, 2, 3, 4],
        "from_lance": [True, True, True, False],
        "ending": ["landed", "lost", "lost", "lost"],
        "dwell_s": [0.32, 0.35, 0.7, 0.1],
        "ignition_s": [0.15, np.nan, 0.3, np.nan],
        "first_s": 0.0,
        "last_s": [0.3, 0.2, 0.5, 0.1],
        "refused": "",
    }
)
SLICES = pd.DataFrame(
    {"particle": [1, 3], "slice_m": [1.0, 1.0], "velocity_m_s": [5.5, 9.0]}
)


@pytest.fixture(scope="module")
def chapter():
    """The functions of the notebook that replaces one step after the other."""
    return notebooks.borrow("56_accuracy")


def test_flights_beside_the_truth():
    owners = pd.Series({1: 0, 2: 0, 3: -1, 4: 11})
    both = compare(FlightTables(FLIGHTS, SLICES, owners), TRUE)
    assert both["particle"].tolist() == [0, 11, 12, -1]  # false flights come last
    assert both["track"].tolist() == [1, -1, -1, 3]  # the longest of a particle
    assert both.loc[0, ["measured_dwell_s", "true_dwell_s"]].tolist() == [0.32, 0.3]
    assert both["true_dwell_s"].notna().tolist() == [True, True, True, False]
    row = errors(both)
    names = ["measurable_particles", "detected_particles", "false_flights"]
    assert [row[name] for name in names] == [2, 1, 1]
    assert row["dwell_s_bias"] == pytest.approx(0.02)
    assert row["velocity_m_s_bias"] == pytest.approx(0.5)
    assert row["ignition_s_bias"] == pytest.approx(0.05)
    assert (row["lit"], row["lit_detected"], row["unlit"]) == (1, 1, 0)
    assert row["detected_low"] < 0.5 < row["detected_high"]
    assert np.isnan(row["dwell_s_low"])  # one particle has no interval


def test_true_places_replace_those_of_known_owners_and_links_lose_depths_of_no_gate(
    chapter,
):
    true = pd.DataFrame(
        {"frame": [0, 1], "particle": 7, "x": 1.0, "y": 2.0, "z": [6000.0, 5900.0]}
    )
    tracks = pd.DataFrame({"frame": [0, 1, 1], "particle": 3, "x": 8.0, "y": 9.0})
    tracks = tracks.assign(z=[7499.0, 7400.0, 9000.0])
    linked, deep = chapter.with_truth(tracks, np.array([7, 7, -1]), true)
    assert deep["z"].tolist() == [6000.0, 5900.0, 9000.0]
    assert linked["particle"].tolist() == [7, 7, -1]
    np.testing.assert_equal(linked["z"].to_numpy(), [7499.0, np.nan, 9000.0])


def test_each_step_takes_away_the_error_of_that_step_alone(monkeypatch, chapter):
    monkeypatch.setitem(campaigns.FRAMES, "quick", 40)
    campaign = campaigns.campaigns("quick", LEARNED, scenario="small")[1]
    true = campaigns.true_positions(campaign)
    true["gray"] = np.where(true["label"] == 2, chapter.FULL_SCALE, chapter.UNLIT_GRAY)

    def starts(tracks):
        fits = chapter.fit_tracks(campaign.run, tracks)
        replaced = dict(chapter.replace_steps(campaign, tracks, fits))
        for tables in replaced.values():
            assert set(tables.flights["particle"]) <= set(tables.particles.index)
        return {
            name: tables.flights["t0_s"].to_numpy() for name, tables in replaced.items()
        }

    exact = starts(true)[chapter.WHOLE]
    found = starts(
        true.assign(z=true["z"] + np.where(true["frame"] % 2, 300.0, -200.0))
    )
    for name in ("true depth", "true trajectories", "true positions and links"):
        np.testing.assert_allclose(found[name], exact, err_msg=name)
    for name in ("true links", "weighted axes", chapter.WHOLE):
        assert np.abs(found[name] - exact).max() > 1e-4, name


def test_ignition_is_found_where_true_positions_begin_to_burn(monkeypatch, chapter):
    monkeypatch.setitem(campaigns.FRAMES, "quick", 120)
    campaign = campaigns.campaigns("quick", LEARNED, scenario="small")[1]
    true = campaigns.true_positions(campaign).assign(gray=0.0)
    step, tables = next(chapter.replace_steps(campaign, true, {}))
    assert step == "true positions and links"
    flights = tables.flights.set_index("particle")
    found = (
        flights["t0_s"] + flights["ignition_s"]
    ).dropna()  # on the recording's clock
    life = campaigns.twin_of(campaign).life
    ignited = pd.Series(
        life.release_s + life.flights.ignition_s, life.table["particle"]
    )
    assert len(found) > 3
    np.testing.assert_allclose(found, ignited[found.index], atol=0.003)  # one frame
