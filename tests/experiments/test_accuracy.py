"""Measured beside true, made by hand."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import accuracy, error_budget
from kilnflight.experiments.accuracy import compare, errors
from kilnflight.experiments.error_budget import FlightTables
from kilnflight.experiments.tracking import true_particles

TRUE = pd.DataFrame(
    {
        "particle": [10, 11, 12, 13],
        "ending": ["burnt out", "landed", "landed", "landed"],
        "dwell_s": [0.3, 0.4, 0.5, 0.6],
        "velocity_m_s": [5.0, 6.0, 7.0, 8.0],
        "ignition_s": [0.1, np.nan, np.nan, 0.2],
        "whole": [True, True, True, False],
        "measurable": [True, True, False, True],
    }
)
FLIGHTS = pd.DataFrame(
    {
        "particle": [1, 2, 3, 4],
        "from_lance": [True, True, True, False],
        "ending": ["landed", "lost", "lost", "lost"],
        "dwell_s": [0.32, 0.35, 0.7, 0.1],
        "ignition_s": [0.15, np.nan, 0.3, np.nan],
        "first_s": [0.0, 0.0, 0.0, 0.0],
        "last_s": [0.3, 0.2, 0.5, 0.1],
    }
)
SLICES = pd.DataFrame({"particle": [1, 3], "slice_m": [1.0, 1.0], "velocity_m_s": [5.5, 9.0]})
OWNERS = pd.Series({1: 10, 2: 10, 3: -1, 4: 11})


def test_the_longest_track_of_a_particle_counts_and_false_flights_come_last():
    both = compare(FlightTables(FLIGHTS, SLICES, OWNERS), TRUE)
    assert both["particle"].tolist() == [10, 11, 12, -1]
    assert both["track"].tolist() == [1, -1, -1, 3]
    assert both.loc[0, ["measured_dwell_s", "true_dwell_s"]].tolist() == [0.32, 0.3]
    assert both["true_dwell_s"].notna().tolist() == [True, True, True, False]


def test_endings_stand_by_the_true_ones_and_every_particle_once():
    both = compare(FlightTables(FLIGHTS, SLICES, OWNERS), TRUE)
    both = both.assign(fraction="chip", pressure_bar=4.5)
    found = accuracy.ending_table(both).set_index("true").drop(columns=["fraction", "pressure_bar"])
    assert found.index.tolist() == ["burnt out", "landed unlit"]
    assert found.loc["burnt out"].to_dict() == {
        **{"landed unlit": 0, "landed burning": 1, "burnt out": 0, "lost": 0},
        "not measured": 0,
    }
    assert found.loc["landed unlit", "not measured"] == 2
    assert found.to_numpy().sum() == 3  # a false flight has no true ending


def test_errors_are_those_of_measurable_particles():
    found = errors(compare(FlightTables(FLIGHTS, SLICES, OWNERS), TRUE))
    assert (found["true"], found["found"], found["spurious"]) == (2, 1, 1)
    assert found["dwell_s_bias"] == pytest.approx(0.02)
    assert found["velocity_m_s_bias"] == pytest.approx(0.5)
    assert found["ignition_s_bias"] == pytest.approx(0.05)
    assert (found["lit"], found["lit_told"], found["unlit"]) == (1, 1, 0)
    assert found["found_low"] < 0.5 < found["found_high"]
    assert np.isnan(found["dwell_s_low"])  # of one particle nothing is sure


def test_shorter_tracks_of_a_particle_do_not_count_twice():
    for last, longest in (([0.1, 0.3, 0.5, 0.1], 2), ([0.3, 0.2, 0.5, 0.1], 1)):
        tables = FlightTables(FLIGHTS.assign(last_s=last), SLICES, OWNERS)
        assert compare(tables, TRUE)["track"].tolist() == [longest, -1, -1, 3]


def test_without_any_flight_nothing_is_found_and_nothing_is_known():
    found = errors(compare(FlightTables(FLIGHTS[:0], SLICES[:0], OWNERS[:0]), TRUE))
    assert (found["found"], found["spurious"]) == (0, 0)
    assert np.isnan(found["dwell_s_bias"])


def test_detections_belong_to_the_nearest_true_position_within_the_gate():
    true = pd.DataFrame(
        {"frame": [0, 0, 1], "particle": [7, 8, 7], "row": [10.0, 50, 12], "col": 5.0}
    )
    seen = pd.DataFrame({"frame": [0, 0, 1, 2], "row": [11.0, 90, 13, 12], "col": 5.0})
    assert true_particles(seen, true).tolist() == [7, -1, 7, -1]


def test_a_track_belongs_to_whom_at_least_half_of_it_belongs():
    tracks = pd.DataFrame({"particle": [1, 1, 1, 2, 2, 2, -1]})
    owner = np.array([7, 7, -1, 7, 8, 9, 7])
    assert error_budget.particle_of_track(tracks, owner).to_dict() == {1: 7, 2: -1}


def test_the_true_depth_replaces_the_measured_one_where_the_owner_is_known():
    true = pd.DataFrame({"frame": [0, 1], "particle": 7, "x": 1.0, "y": 2.0, "z": [6000.0, 5900.0]})
    tracks = pd.DataFrame({"frame": [0, 1, 1], "x": np.nan, "y": np.nan, "z": [1.0, 2.0, 3.0]})
    found = error_budget.with_true_depth(tracks, np.array([7, 7, -1]), true)
    assert found["z"].tolist() == [6000.0, 5900.0, 3.0]


def test_every_quantity_has_a_unit():
    assert list(accuracy.QUANTITIES) == ["dwell_s", "velocity_m_s", "ignition_s"]


def test_every_flight_from_the_lance_is_accounted_for_once():
    found = accuracy.account_flights(FlightTables(FLIGHTS, SLICES, OWNERS), TRUE)
    assert found == {"flights": 3, "found": 1, "duplicates": 1, "cut": 0, "spurious": 1}
    parts = [found[name] for name in ("found", "duplicates", "cut", "spurious")]
    assert sum(parts) == found["flights"]
