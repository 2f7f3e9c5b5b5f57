"""Medians, shares and printed numbers of flights made by hand."""

import numpy as np
import pytest

from kilnflight.experiments import flights
from kilnflight.scores import intervals
from kilnflight.scores.flights import FlightValues, outcomes
from kilnflight.scores.intervals import Interval

NONE = FlightValues(np.empty(0), np.empty((0, 5)), np.empty(0), np.empty(0))


def flown(count=60, seed=0):
    draw = np.random.default_rng(seed)
    velocity = draw.normal(8.0, 1.0, (count, 5))
    velocity[draw.random((count, 5)) < [0.0, 0.3, 0.6, 0.9, 1.0]] = np.nan
    ignition = np.where(draw.random(count) < 0.5, draw.random(count) * 0.5, np.nan)
    return FlightValues(draw.gamma(9.0, 0.04, count), velocity, ignition, draw.random(count) * 3)


@pytest.mark.parametrize("values", [flown(), flown(3), NONE])
def test_medians_are_those_of_the_outcomes_and_six_have_an_interval(values):
    cell = {("confetti", 4.5): values}
    table = flights.median_table(cell, cell, np.random.default_rng(0))
    named = outcomes(values)[table["outcome"]]
    np.testing.assert_allclose(table["estimate"], named.to_numpy(), rtol=1e-12)
    np.testing.assert_allclose(table["true"], named.to_numpy(), rtol=1e-12)
    assert (table["low"].notna() == (table["number"] >= 6)).all()
    known = table.dropna(subset=["low", "high"])
    assert known["estimate"].between(known["low"], known["high"]).all()
    assert known["covers"].all()


@pytest.mark.parametrize(
    ("outcome", "number", "of"),
    [
        ("ignited < 0.1 s (%)", 2, 8),
        ("ignited < 0.1 s (% of ignited)", 2, 3),
        ("dwell > 0.4 s (%)", 1, 4),
        ("remaining 2 m (%)", 6, 8),
    ],
)
def test_shares_have_wilsons_interval_of_what_is_counted(outcome, number, of):
    ignition = np.array([0.05, 0.1, 0.3, *[np.nan] * 5])
    far = np.array([1.0, 1.5, *[2.5] * 6])
    values = FlightValues(np.array([0.2, 0.3, 0.35, 0.5]), np.full((8, 5), np.nan), ignition, far)
    found = flights.interval_of(values, outcome, np.random.default_rng(0))
    np.testing.assert_allclose(found[:3], 100 * np.array(intervals.share(number, of)[:3]))


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
