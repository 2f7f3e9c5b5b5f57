"""Cells made by hand: what counts, what is said beside it, what can be decided."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import results
from kilnflight.experiments.campaigns import Measurement
from kilnflight.project import claims
from kilnflight.regression import Regression, regress_all
from kilnflight.scores.flights import FlightValues
from kilnflight.tables import FLIGHTS
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR

EXIT = (0.0, 0.0, 6500.0)
CELL = ("confetti", 4.5)


def track(particle, speed, start=0, count=40):
    frame = np.arange(start + 2, start + 2 + count)
    t = (frame - start) / 100.0
    places = {"x": 300.0 * t, "y": 4900.0 * t**2, "z": 6500.0 - 1000.0 * speed * t}
    return pd.DataFrame({"particle": particle, "frame": frame, **places})


def flight(particle, dwell, from_lance=True, ignition=np.nan):
    row = dict.fromkeys(FLIGHTS.names, 0.0) | {"particle": particle, "dwell_s": dwell}
    row |= {"end_s": 0.3, "ending": "landed", "ignition": "none", "ignition_s": ignition}
    return row | {"from_lance": from_lance}


def with_cell(table, cell=CELL):
    return table.assign(fraction=cell[0], pressure_bar=cell[1])


TRAJECTORIES = regress_all(
    pd.concat([track(1, 5.0), track(2, 8.0), track(3, 5.0)]), EXIT, 100.0, Regression(highest=2)
)
FLOWN = pd.DataFrame([flight(1, 0.3), flight(2, 0.4, ignition=0.1), flight(3, 9.0, False)])
SLICED = pd.DataFrame(
    {"particle": [1, 2, 2, 2], "slice_m": [1.0, -1.0, 1.0, 2.0], "velocity_m_s": [5.0, -3.0, 8, 7]}
)


def test_only_flights_from_the_lance_count_and_slices_behind_it_do_not():
    found = results.of_flights(TRAJECTORIES, FLOWN, SLICED)
    assert found.dwell_s.tolist() == [0.3, 0.4]
    np.testing.assert_equal(found.velocity_m_s[:, :3], [[5, np.nan, np.nan], [8, 7, np.nan]])
    np.testing.assert_equal(found.ignition_s, [np.nan, 0.1])
    np.testing.assert_allclose(found.reached_m, [1.5, 2.4], rtol=1e-3)


def measured(cells):
    parts = [TRAJECTORIES.assign(particle=TRAJECTORIES["particle"]), FLOWN, SLICED]
    tables = [pd.concat([with_cell(one, cell) for cell in cells]) for one in parts]
    return Measurement(with_cell(track(1, 5.0)), *tables)


def test_cells_and_their_table_have_one_row_each():
    found = results.by_campaign(measured([CELL]))
    assert list(found) == [CELL]
    row = results.outcome_table(found).iloc[0]
    assert (row["particles"], row["dwell median (s)"]) == (2, pytest.approx(0.35))


def test_printed_numbers_stand_beside_truth_and_measurement():
    found = results.by_campaign(measured([CELL]))
    said = results.beside_published(found, found, ["dwell"])
    assert set(said["fraction"]) == {"confetti"}
    np.testing.assert_array_equal(said["true"], said["measured"])


def test_a_printed_number_holds_within_its_bounds_or_its_unit():
    rows = [("velocity 0-1 m (m/s)", 7.4, 7.4, 7.8), ("remaining 1 m (%)", 90.0, 100.0, 89.0)]
    said = pd.DataFrame(rows, columns=["outcome", "low", "high", "measured"])
    said = said.assign(fraction="confetti", pressure_bar=4.5)
    assert list(results.conditions(said, CELL).values()) == [True, False]
    assert results.conditions(said, ("PE granule", 4.5)) == {"nothing measured": False}


def test_a_claim_about_eight_cells_is_not_decided_on_one():
    (verdict,) = results.judge_all(measured([CELL]), {"dwell-1": 0.4})
    assert verdict.verdict == claims.NOT_DECIDABLE
    assert "eight cells" in verdict.reason


def test_pairs_differ_in_fraction_or_pressure_but_not_in_both():
    cells = [("a", 4.5), ("a", 5.0), ("b", 4.5), ("b", 5.0)]
    nothing = FlightValues(np.empty(0), np.empty((0, 5)), np.empty(0), np.empty(0))
    pairs = results.pairs_to_compare(dict.fromkeys(cells, nothing))
    assert len(pairs) == 4
    assert (("a", 4.5), ("b", 5.0)) not in pairs


def test_what_is_beyond_chance_stands_in_the_reason_and_leaves_the_verdict():
    every = measured([(name, bar) for name in FRACTIONS for bar in PRESSURES_BAR])
    flights = pd.concat([every.flights.assign(particle=k) for k in range(results.LEAST_FLIGHTS)])
    many, given = every._replace(flights=flights), {"dwell-1": 0.4, "dwell-2": {"first": True}}
    plain = results.judge_all(many, given, "a note")
    told = results.judge_all(many, given, "a note", {"dwell-2": "medians resolved: none"})
    assert [one.verdict for one in told] == [one.verdict for one in plain]
    assert [one.reason for one in told] == ["a note", "a note; medians resolved: none"]
