"""Every number that is said of flights has an interval, made by hand where one can."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import confidence
from kilnflight.experiments.campaigns import Measurement
from kilnflight.scores import intervals
from kilnflight.scores.flights import FlightValues, outcomes

CELL = ("confetti", 4.5)
NONE = FlightValues(np.empty(0), np.empty((0, 5)), np.empty(0), np.empty(0))


def flights(count=60, seed=0):
    draw = np.random.default_rng(seed)
    velocity = draw.normal(8.0, 1.0, (count, 5))
    velocity[draw.random((count, 5)) < [0.0, 0.3, 0.6, 0.9, 1.0]] = np.nan
    ignition = np.where(draw.random(count) < 0.5, draw.random(count) * 0.5, np.nan)
    return FlightValues(draw.gamma(9.0, 0.04, count), velocity, ignition, draw.random(count) * 3)


@pytest.mark.parametrize("flight_values", [flights(), flights(3), NONE])
def test_it_is_the_interval_of_the_number_that_is_told(flight_values):
    found = confidence.outcome_intervals(flight_values, np.random.default_rng(0))
    told = outcomes(flight_values)
    assert list(found) == list(told.index)
    estimates = [interval.estimate for interval in found.values()]
    np.testing.assert_allclose(estimates, told.to_numpy(), rtol=1e-12)
    for one in found.values():
        assert np.isnan(one.estimate) or one.low <= one.estimate <= one.high


def test_shares_are_in_per_cent_and_few_values_have_no_interval():
    times = np.array([0.1, 0.35, 0.4, 0.4, 0.5, 0.6, 0.7])
    found = confidence.outcome_intervals(NONE._replace(dwell_s=times), np.random.default_rng(0))
    wilson = intervals.share(5, 7)
    share = found["dwell > 0.4 s (%)"]
    assert share[:3] == pytest.approx([100 * value for value in wilson[:3]])
    assert found["dwell 0.3-0.4 s (%)"].estimate == pytest.approx(100 * 3 / 7)
    assert np.isfinite(found["dwell median (s)"].low)  # seven are enough for a median
    assert np.isinf(found["dwell q25 (s)"].low)  # and too few for a quartile
    assert np.isinf(found["dwell longest (s)"].high)
    assert found["dwell spread (s)"].estimate == pytest.approx(0.55 - 0.375)
    assert np.isinf(found["dwell spread (s)"].high)
    assert np.isnan(found["ignited (%)"].estimate)


def test_a_metre_of_few_has_a_median_but_no_interval():
    one = flights()
    few = one.velocity_m_s.copy()
    few[5:, 4], few[:5, 4] = np.nan, 3.0
    found = confidence.outcome_intervals(one._replace(velocity_m_s=few), np.random.default_rng(0))
    assert found["velocity 4-5 m (m/s)"] == (3.0, -np.inf, np.inf, (5,))
    assert found["remaining 5 m (%)"].numbers == (60,)
    assert found["spread 4-5 m (m/s)"] == (0.0, -np.inf, np.inf, (5,))
    wide = found["spread 0-1 m (m/s)"]  # of a normal distribution 1.349 standard deviations
    assert wide.low < 1.349 < wide.high < 2.0


def test_a_table_has_a_row_for_every_number_and_cell():
    found = {CELL: flights(), ("confetti", 5.0): flights(seed=1)}
    rows = confidence.interval_table(
        found, found, ["remaining", "landed"], np.random.default_rng(0)
    )
    assert len(rows) == 2 * 6
    np.testing.assert_allclose(rows["estimate"], rows["true"])
    assert (rows["low"] <= rows["estimate"]).all()
    none = confidence.interval_table({}, {}, ["dwell"], np.random.default_rng(0))
    assert list(none.columns)[:3] == ["fraction", "pressure_bar", "outcome"]


def test_intervals_stand_behind_the_column_they_belong_to():
    names = ["dwell median (s)", "dwell longest (s)"]
    said = pd.DataFrame({"fraction": "confetti", "pressure_bar": 4.5, "outcome": names})
    said = said.assign(measured=0.3, use="held out").iloc[::-1]
    certain = confidence.interval_table(
        {CELL: flights()}, {CELL: NONE}, ["dwell"], np.random.default_rng(0)
    )
    wide = confidence.with_intervals(said, certain)
    assert list(wide.columns[-4:]) == ["measured", "measured_low", "measured_high", "use"]
    assert wide["measured_low"].isna().tolist() == [True, False]
    assert wide["measured_low"].iloc[1] == certain.set_index("outcome")["low"][names[0]]
    assert "measured_low" not in said


def test_what_is_told_apart_with_our_numbers_need_not_be_with_the_theses():
    draw = np.random.default_rng(0)
    groups = {
        ("wood chip", 4.5): draw.normal(0.30, 0.1, 400),
        ("confetti", 4.5): draw.normal(0.34, 0.1, 400),
        ("PE granule", 4.5): draw.normal(0.80, 0.1, 400),
    }
    first, second, third = groups
    pairs = [(first, second), (third, second), (first, ("paper shred", 4.5))]
    table = confidence.resolved_differences(groups, pairs, draw)
    assert table["resolved"].tolist() == [True, True]  # the third pair was not measured
    assert table["resolved_with_table_5_15"].tolist() == [False, True]
    said = confidence.in_words(table, "medians")
    assert "wood chip 4.5 < confetti 4.5 / PE granule 4.5 > confetti 4.5" in said
    assert said.endswith("with the numbers of Table 5.15: 1 of 2")
    assert confidence.trajectory_counts(groups) == {first: 7, second: 37, third: 25}
    assert confidence.in_words(confidence.resolved_differences(groups, [], draw), "medians") == ""


def test_shares_are_told_apart_likewise():
    counts = {("confetti", 4.5): (100, 400), ("confetti", 5.0): (140, 400)}
    table = confidence.resolved_share_differences(counts, [tuple(counts)])
    assert table[["resolved", "resolved_with_table_5_15"]].to_numpy().tolist() == [[True, False]]
    assert "shares resolved: confetti 4.5 < confetti 5.0" in confidence.in_words(table, "shares")


def test_a_quantity_that_nobody_has_is_not_told_apart():
    groups = {("confetti", 4.5): np.full(9, np.nan), ("confetti", 5.0): np.linspace(0, 1, 9)}
    table = confidence.resolved_differences(groups, [tuple(groups)], np.random.default_rng(0))
    assert table["resolved"].tolist() == [False]
    assert "none; not: confetti 4.5, confetti 5.0" in confidence.in_words(table, "medians")


def test_metres_that_nobody_saw_are_counted_and_left_out_beside():
    speed, seen = [8.0, 9.0, 10.0, 50.0, 40.0], [True, True, True, False, True]
    rows = {"fraction": CELL[0], "pressure_bar": CELL[1], "particle": range(5), "slice_m": 1.0}
    slices = pd.DataFrame({**rows, "velocity_m_s": speed, "observed": seen})
    other = slices.assign(slice_m=-1.0)  # behind the lance: not asked for
    velocity = np.array([[9.0, np.nan], [12.0, np.nan]])[:, [0, 1, 1, 1, 1]]
    true = {CELL: NONE._replace(velocity_m_s=velocity), ("confetti", 5.0): NONE}
    table = confidence.unseen_metres(pd.concat([slices, other]), true, np.random.default_rng(0))
    assert len(table) == 10
    assert table.loc[0, ["number", "unseen", "too_fast", "too_fast_unseen"]].tolist() == [
        5,
        1,
        2,
        1,
    ]
    assert table.loc[0, ["median_m_s", "seen_m_s", "true_m_s"]].tolist() == [10.0, 9.5, 10.5]
    assert table["number"].iloc[1:].sum() == 0
    assert table["median_m_s"].iloc[1:].isna().all()


def test_as_large_a_part_of_table_5_15_has_a_value():
    values = np.where(np.arange(80) % 4 == 0, np.linspace(0, 1, 80), np.nan)
    groups = {("confetti", 4.5): values, ("PE granule", 4.5): values + 5}
    table = confidence.resolved_differences(groups, [tuple(groups)], np.random.default_rng(0))
    assert table["number"].tolist() == [40]  # a quarter of 80, twice
    # a quarter of 37 and of 25 trajectories are 9 and 6: just enough for an interval
    assert table[["resolved", "resolved_with_table_5_15"]].to_numpy().tolist() == [[True, True]]
    few = {key: one[:20] for key, one in groups.items()}
    few[("wood chip", 4.5)] = few.pop(("PE granule", 4.5))  # a quarter of 7 are 2: too few
    table = confidence.resolved_differences(few, [tuple(few)], np.random.default_rng(0))
    assert table["resolved_with_table_5_15"].tolist() == [False]


def test_true_differences_stand_beside():
    groups = {("confetti", 4.5): np.linspace(0, 1, 9), ("confetti", 5.0): np.linspace(1, 2, 9)}
    table = confidence.resolved_differences(
        groups, [tuple(groups)], np.random.default_rng(0), groups
    )
    assert table["true"].tolist() == table["estimate"].tolist() == [-1.0]
    counts = {("confetti", 4.5): (40, 100), ("confetti", 5.0): (10, 100)}
    table = confidence.resolved_share_differences(counts, [tuple(counts)], counts)
    assert table["true"].tolist() == [pytest.approx(0.3)]


def test_an_interval_covers_the_true_median_or_not():
    few, many = flights(3), flights(60)
    keys = CELL, ("confetti", 5.0)
    table = confidence.coverage(
        dict(zip(keys, (few, many), strict=True)),
        dict.fromkeys(keys, many),
        np.random.default_rng(0),
    )
    assert len(table) == 2 * 5
    dwell = table[table["quantity"] == "dwell_s"]
    assert dwell["low"].isna().tolist() == [True, False]
    assert dwell["covers"].tolist() == [False, True]


def test_medians_of_the_regression_have_intervals_where_there_are_enough_of_them():
    keys = {"fraction": "confetti", "pressure_bar": 4.5}
    columns = [name.format(axis) for name in confidence.FIT_MEASURES for axis in "xyz"]
    single = pd.DataFrame({**keys, **dict.fromkeys(columns, 1.0)}, index=[0])
    many = pd.concat([single.assign(particle=k, rmse_z_mm=10.0 * k) for k in range(21)])
    flown = pd.DataFrame({**keys, "particle": range(21), "from_lance": [k < 20 for k in range(21)]})
    table = confidence.regression_table(
        Measurement(None, many, flown, None), np.random.default_rng(0)
    ).set_index("axis")
    deep = table.loc["z"]
    assert (deep["tracks"], deep["rmse_mm"]) == (20, 95.0)
    assert 0.0 < deep["rmse_mm_low"] < 95.0 < deep["rmse_mm_high"] < 190.0
    few = confidence.regression_table(
        Measurement(None, many, flown.head(3), None), np.random.default_rng(0)
    )
    assert few["rmse_mm_low"].isna().all()
