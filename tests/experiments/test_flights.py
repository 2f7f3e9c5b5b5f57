"""Medians, shares and printed numbers of flights made by hand."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import flights
from kilnflight.experiments.campaigns import Measurement
from kilnflight.project import claims
from kilnflight.scores import intervals
from kilnflight.scores.flights import FlightValues, outcomes
from kilnflight.scores.intervals import Interval
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR

CELL = ("confetti", 4.5)
NONE = FlightValues(np.empty(0), np.empty((0, 5)), np.empty(0), np.empty(0))


def flown(count=60, seed=0):
    draw = np.random.default_rng(seed)
    velocity = draw.normal(8.0, 1.0, (count, 5))
    velocity[draw.random((count, 5)) < [0.0, 0.3, 0.6, 0.9, 1.0]] = np.nan
    ignition = np.where(draw.random(count) < 0.5, draw.random(count) * 0.5, np.nan)
    return FlightValues(draw.gamma(9.0, 0.04, count), velocity, ignition, draw.random(count) * 3)


def medians(measured, true=None):
    return flights.median_table(
        {CELL: measured}, {CELL: true or measured}, np.random.default_rng(0)
    )


@pytest.mark.parametrize("values", [flown(), flown(3), NONE])
def test_medians_are_those_of_the_outcomes_and_six_have_an_interval(values):
    table = medians(values)
    named = outcomes(values)[table["outcome"]]
    np.testing.assert_allclose(table["estimate"], named.to_numpy(), rtol=1e-12)
    np.testing.assert_allclose(table["true"], named.to_numpy(), rtol=1e-12)
    assert (table["low"].notna() == (table["number"] >= 6)).all()
    known = table.dropna(subset=["low", "high"])
    assert known["estimate"].between(known["low"], known["high"]).all()
    assert known["covers"].all()
    assert table.loc[table["low"].isna(), "covers"].isna().all()


def test_an_interval_need_not_hold_the_true_median():
    late = flown()._replace(dwell_s=flown().dwell_s + 1)
    table = medians(flown(), late).set_index("outcome")
    assert not table.loc["dwell median (s)", "covers"]
    assert table.loc["velocity 0-1 m (m/s)", "covers"]


@pytest.mark.parametrize(
    ("outcome", "number", "of"),
    [("ignited (%)", 3, 8), ("ignited < 0.1 s (%)", 2, 8), ("ignited < 0.1 s (% of ignited)", 2, 3),
     ("dwell > 0.4 s (%)", 1, 4), ("remaining 2 m (%)", 6, 8)],
)  # fmt: skip
def test_shares_have_wilsons_interval_of_what_is_counted(outcome, number, of):
    ignition = np.array([0.05, 0.1, 0.3, *[np.nan] * 5])
    far = np.array([1.0, 1.5, *[2.5] * 6])
    values = FlightValues(np.array([0.2, 0.3, 0.35, 0.5]), np.full((8, 5), np.nan), ignition, far)
    found = flights.interval_of(values, outcome, np.random.default_rng(0))
    np.testing.assert_allclose(found[:3], 100 * np.array(intervals.share(number, of)[:3]))


def test_a_share_with_lost_flights_is_of_no_whole_number_of_particles():
    """Kaplan and Meier: one of five ends at 1.5 m, one is lost, one of the other three ends."""
    lost = np.array([False, True, False, False, False])
    far, unseen = np.array([1.5, 2.2, 2.5, 3.5, 3.5]), np.full((5, 5), np.nan)
    made = flown(5)._replace(reached_m=far, velocity_m_s=unseen, lost=lost)
    found = flights.interval_of(made, "remaining 3 m (%)", np.random.default_rng(0))
    assert found.estimate == pytest.approx(100 * 4 / 5 * 2 / 3)
    assert found.low <= found.estimate <= found.high


def test_of_no_flight_nothing_is_known():
    for outcome in ("ignited (%)", "remaining 2 m (%)", "dwell median (s)", "dwell longest (s)"):
        found = flights.interval_of(NONE, outcome, np.random.default_rng(0))
        assert np.isnan(found.estimate)
        assert np.isinf([found.low, found.high]).all()


def test_every_printed_number_has_an_outcome_and_a_row_for_each_fraction():
    printed = claims.published("flight")
    numbers = printed.dropna(subset=["value_low", "value_high"], how="all")
    assert set(numbers.loc[numbers["outcome"].isna(), "quantity"]) == {"sequence_length"}
    table = flights.printed_numbers()
    assert set(table["outcome"]) <= set(outcomes(flown()).index)
    dwell = table[table["outcome"] == "dwell median (s)"]
    assert dwell["fraction"].tolist() == list(FRACTIONS)
    most = table[table["outcome"] == "dwell > 0.4 s (%)"]
    assert most[["low", "high"]].to_numpy().tolist() == [[50, 100]] * 2


@pytest.mark.parametrize(
    ("low", "high", "text", "ours", "holds"),
    [
        (7.4, 7.4, "7.4 m/s", (7.0, 6.8, 7.36), True),  # as exactly as it is printed
        (7.4, 7.4, "7.4 m/s", (7.0, 6.8, 7.3), False),
        (7.4, 7.4, "7.4 m/s", (7.0, -np.inf, np.inf), None),
        (0.3, 0.5, "0.3 s-0.5 s", (0.31, 0.2, 0.4), True),
        (0.3, 0.5, "0.3 s-0.5 s", (0.29, 0.2, 0.4), None),
        (0.3, 0.5, "0.3 s-0.5 s", (0.2, 0.1, 0.25), False),
        (30.0, 50.0, "more than 30%", (80.0, 70.0, 90.0), True),
        (np.nan, 8.0, "decreases", (9.0, 8.5, 9.5), False),
        (75.0, 100.0, "the vast majority", (10.0, 5.0, 15.0), None),
        (0.3, 0.5, "0.3 s-0.5 s", (np.nan, -np.inf, np.inf), False),
    ],
)
def test_numbers_are_held_by_intervals_and_bounds_by_numbers(low, high, text, ours, holds):
    assert flights.agrees(low, high, text, Interval(*ours, (9,))) is holds


def test_printed_numbers_stand_beside_those_of_the_campaigns_there_are():
    table = flights.beside_printed({CELL: flown()}, np.random.default_rng(0))
    assert set(table["fraction"]) == {"confetti"}
    row = table.set_index("outcome").loc["velocity 0-1 m (m/s)"]
    assert row["measured_low"] <= row["measured"] <= row["measured_high"]
    assert row["agrees"] is False or row["agrees"] is True
    assert flights.beside_printed({}, np.random.default_rng(0)).empty


def test_claims_on_all_campaigns_are_open_without_six_flights_in_each():
    keys = [(name, bar) for name in FRACTIONS for bar in PRESSURES_BAR]
    rows = [(*key, True, "") for key in keys for _ in range(6)]
    table = pd.DataFrame(rows, columns=["fraction", "pressure_bar", "from_lance", "refused"])
    assert flights.if_complete(table, {"vel-1": False}) == {"vel-1": False}
    assert flights.if_complete(table.head(-1), {"vel-1": False}) == {"vel-1": None}


def test_medians_of_the_regression_have_intervals_where_there_are_enough_of_them():
    keys = {"fraction": "confetti", "pressure_bar": 4.5}
    columns = [name.format(axis) for name in flights.FIT_MEASURES for axis in "xyz"]
    single = pd.DataFrame({**keys, **dict.fromkeys(columns, 1.0)}, index=[0])
    many = pd.concat([single.assign(particle=k, rmse_z_mm=10.0 * k) for k in range(21)])
    started = [k < 20 for k in range(21)]
    made = pd.DataFrame({**keys, "refused": "", "particle": range(21), "from_lance": started})

    def table(some):
        tables = Measurement(None, many, some, None)
        return flights.regression_table(tables, np.random.default_rng(0)).set_index("axis")

    deep = table(made).loc["z"]
    assert (deep["tracks"], deep["rmse_mm"], deep["rmse_mm_published"]) == (20, 95.0, 140.15)
    assert 0.0 < deep["rmse_mm_low"] < 95.0 < deep["rmse_mm_high"] < 190.0
    assert table(made.head(3))["rmse_mm_low"].isna().all()
