"""Intervals of the numbers about flights, on values made by hand."""

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
def test_it_is_the_interval_of_the_outcome(flight_values):
    table = confidence.median_table(
        {CELL: flight_values}, {CELL: flight_values}, np.random.default_rng(0)
    )
    named = outcomes(flight_values)[table["outcome"]]
    np.testing.assert_allclose(table["estimate"], named.to_numpy(), rtol=1e-12)
    np.testing.assert_allclose(table["true"], named.to_numpy(), rtol=1e-12)
    known = table.dropna(subset=["low", "high"])
    assert (table["low"].notna() == (table["number"] >= 6)).all()
    assert known["estimate"].between(known["low"], known["high"]).all()
    assert known["covers"].all()


def test_a_metre_of_few_has_a_median_but_no_interval():
    one = flights()
    few = one.velocity_m_s.copy()
    few[5:, 4], few[:5, 4] = np.nan, 3.0
    values = {CELL: one._replace(velocity_m_s=few)}
    table = confidence.median_table(values, values, np.random.default_rng(0)).set_index("outcome")
    for outcome in ("velocity 4-5 m (m/s)", "velocity last (m/s)"):
        row = table.loc[outcome]
        assert (row["number"], row["estimate"]) == (5, 3.0)
        assert row[["low", "high"]].isna().all()
        assert pd.isna(row["covers"])


def test_a_difference_resolved_with_our_numbers_need_not_be_with_those_of_the_thesis():
    draw = np.random.default_rng(0)
    groups = {
        ("wood chip", 4.5): draw.normal(0.30, 0.1, 400),
        ("confetti", 4.5): draw.normal(0.34, 0.1, 400),
        ("PE granule", 4.5): draw.normal(0.80, 0.1, 400),
    }
    first, second, third = groups
    pairs = [(first, second), (third, second), (first, ("paper shred", 4.5))]
    table = confidence.group_differences(groups, pairs, draw)
    assert table["resolved"].tolist() == [True, True]  # the third pair was not measured
    assert table["resolved_with_table_5_15"].tolist() == [False, True]
    text = confidence.in_words(table, "medians")
    assert "wood chip 4.5 < confetti 4.5 / PE granule 4.5 > confetti 4.5" in text
    assert text.endswith("with the numbers of Table 5.15: 1 of 2")
    assert confidence.trajectory_counts(groups) == {first: 7, second: 37, third: 25}
    assert confidence.in_words(confidence.group_differences(groups, [], draw), "medians") == ""


def lit(number, of):
    """Times of ignition; NaN: never."""
    return np.where(np.arange(of) < number, 0.1, np.nan)


def test_differences_of_shares_are_resolved_likewise():
    groups = {("confetti", 4.5): lit(100, 400), ("confetti", 5.0): lit(140, 400)}
    table = confidence.group_differences(
        groups, [tuple(groups)], np.random.default_rng(0), shares=True
    )
    assert table[["resolved", "resolved_with_table_5_15"]].to_numpy().tolist() == [[True, False]]
    assert "shares resolved: confetti 4.5 < confetti 5.0" in confidence.in_words(table, "shares")


def test_a_quantity_without_values_is_not_resolved():
    groups = {("confetti", 4.5): np.full(9, np.nan), ("confetti", 5.0): np.linspace(0, 1, 9)}
    table = confidence.group_differences(groups, [tuple(groups)], np.random.default_rng(0))
    assert table["resolved"].tolist() == [False]
    assert "none; not: confetti 4.5, confetti 5.0" in confidence.in_words(table, "medians")


def test_metres_before_the_first_detection_are_counted_and_left_out_beside():
    speed, seen = [8.0, 9.0, 10.0, 50.0, 40.0], [True, True, True, False, True]
    rows = {"fraction": CELL[0], "pressure_bar": CELL[1], "particle": range(5), "slice_m": 1.0}
    slices = pd.DataFrame({**rows, "velocity_m_s": speed, "observed": seen})
    other = slices.assign(slice_m=-1.0)  # behind the lance: not asked for
    velocity = np.array([[9.0, np.nan], [12.0, np.nan]])[:, [0, 1, 1, 1, 1]]
    true = {CELL: NONE._replace(velocity_m_s=velocity), ("confetti", 5.0): NONE}
    table = confidence.metres_before_detection(
        pd.concat([slices, other]), true, np.random.default_rng(0)
    )
    assert len(table) == 10
    assert table.loc[
        0, ["number", "before_detection", "too_fast", "too_fast_before_detection"]
    ].tolist() == [
        5,
        1,
        2,
        1,
    ]
    assert table.loc[0, ["median_m_s", "detected_m_s", "true_m_s"]].tolist() == [10.0, 9.5, 10.5]
    assert table["number"].iloc[1:].sum() == 0
    assert table["median_m_s"].iloc[1:].isna().all()


def test_without_any_metre_the_sentence_says_so():
    made = {CELL: NONE}
    none = pd.DataFrame(
        columns=["fraction", "pressure_bar", "particle", "slice_m", "velocity_m_s", "observed"]
    )
    table = confidence.metres_before_detection(none, made, np.random.default_rng(0))
    assert confidence.describe_before_detection(table).startswith("No metre was passed")


def test_metres_before_detection_are_described():
    rows = [(1, 10, 4, 8.0, 7.5), (3, 6, 0, 5.0, 5.25), (4, 3, 2, 4.0, 9.0), (5, 1, 1, 3.0, np.nan)]
    columns = ["metre", "number", "before_detection", "median_m_s", "detected_m_s"]
    assert confidence.describe_before_detection(pd.DataFrame(rows, columns=columns)) == (
        "Of 20 metres 7 were passed before the particle was detected, beyond 3 m 3 of 4. Without "
        "them no median of the first three moves by more than 0.50 m/s."
    )


def test_slices_behind_the_lance_are_counted():
    keys = dict(zip(confidence.KEYS, CELL, strict=True))
    slices = pd.DataFrame({**keys, "particle": [1, 1, 2, 2], "slice_m": [-1.0, -2.0, -1.0, 1.0]})
    table = confidence.slices_behind_lance(slices.assign(velocity_m_s=[-3.0, -1.0, -2.0, 9.0]))
    assert table.loc[CELL].tolist() == [3, 2, -2.0]


def test_coverage_and_differences_are_described():
    outcomes = ["dwell median (s)", "velocity 2-3 m (m/s)", "velocity 3-4 m (m/s)"]
    medians = pd.DataFrame({"outcome": outcomes, "low": 1.0, "true": 2.0})
    medians["covers"] = [True, False, True]
    text = "Intervals cover the truth in 1 of 2 cases."  # the fourth metre does not count
    assert confidence.describe_coverage(medians) == text
    unknown = medians.assign(low=np.nan, outcome="ignition median (s)")
    assert confidence.describe_coverage(pd.concat([medians, unknown])) == text
    rows = [(1.0, 2.0, True, True), (1.0, -2.0, True, False), (-1.0, 0.0, True, False)]
    rows += [(1.0, -1.0, False, False)]
    columns = ["estimate", "true", "resolved", "resolved_with_table_5_15"]
    assert confidence.describe_resolved(pd.DataFrame(rows, columns=columns)) == (
        "Of 4 comparisons 3 look significant; 2 of them are wrong. "
        "With as few flights as in Table 5.15 it is 1."
    )


def test_as_large_a_part_of_table_5_15_has_a_value():
    values = np.where(np.arange(80) % 4 == 0, np.linspace(0, 1, 80), np.nan)
    groups = {("confetti", 4.5): values, ("PE granule", 4.5): values + 5}
    table = confidence.group_differences(groups, [tuple(groups)], np.random.default_rng(0))
    assert table["number"].tolist() == [40]  # a quarter of 80, twice
    # a quarter of 37 and of 25 trajectories are 9 and 6: just enough for an interval
    assert table[["resolved", "resolved_with_table_5_15"]].to_numpy().tolist() == [[True, True]]
    few = {key: one[:20] for key, one in groups.items()}
    few[("wood chip", 4.5)] = few.pop(("PE granule", 4.5))  # a quarter of 7 are 2: too few
    table = confidence.group_differences(few, [tuple(few)], np.random.default_rng(0))
    assert table["resolved_with_table_5_15"].tolist() == [False]


def test_true_differences_stand_beside():
    groups = {("confetti", 4.5): np.linspace(0, 1, 9), ("confetti", 5.0): np.linspace(1, 2, 9)}
    table = confidence.group_differences(groups, [tuple(groups)], np.random.default_rng(0), groups)
    assert table["true"].tolist() == table["estimate"].tolist() == [-1.0]
    groups = {("confetti", 4.5): lit(40, 100), ("confetti", 5.0): lit(10, 100)}
    table = confidence.group_differences(
        groups, [tuple(groups)], np.random.default_rng(0), groups, shares=True
    )
    assert table["true"].tolist() == [pytest.approx(0.3)]


def test_an_interval_covers_the_true_median_or_not():
    few, many = flights(3), flights(60)
    keys = CELL, ("confetti", 5.0)
    measured, true = dict(zip(keys, (few, many), strict=True)), dict.fromkeys(keys, many)
    table = confidence.median_table(measured, true, np.random.default_rng(0))
    assert len(table) == 2 * 8
    dwell = table[table["outcome"] == "dwell median (s)"]
    assert dwell["low"].isna().tolist() == [True, False]
    assert dwell["covers"].tolist() == [pd.NA, True]
    assert dwell["true_number"].tolist() == [60, 60]


def test_medians_say_of_how_many_and_one_flight_is_too_few():
    values = {CELL: flights(60), ("wood chip", 4.5): flights(1), ("confetti", 5.0): flights(60)}
    median = np.median(flights(60).dwell_s)
    assert confidence.medians_in_words(values, "dwell median (s)", 2) == (
        f"at 4.5 bar (in brackets: of how many flights): confetti {median:.2f} (60), "
        "wood chip too few (1)"
    )


def test_pairs_differ_in_fraction_or_pressure_but_not_in_both():
    values = {(name, bar): flights() for name in ("confetti", "PE granule") for bar in (4.5, 5.0)}
    table = confidence.all_differences(values, values, np.random.default_rng(0))
    pairs = list(zip(table["first"], table["second"], strict=True))
    assert len(set(pairs)) == 4
    assert len(pairs) == 3 * 4
    assert (("confetti", 4.5), ("PE granule", 5.0)) not in pairs
    assert not table["resolved"].any()
    assert (table["true"] == 0).all()


def test_medians_of_the_regression_have_intervals_where_there_are_enough_of_them():
    keys = {"fraction": "confetti", "pressure_bar": 4.5}
    columns = [name.format(axis) for name in confidence.FIT_MEASURES for axis in "xyz"]
    single = pd.DataFrame({**keys, **dict.fromkeys(columns, 1.0)}, index=[0])
    many = pd.concat([single.assign(particle=k, rmse_z_mm=10.0 * k) for k in range(21)])
    flown = pd.DataFrame(
        {**keys, "refused": "", "particle": range(21), "from_lance": [k < 20 for k in range(21)]}
    )
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


def test_shares_that_ignite_have_wilsons_interval_and_none_of_nobody():
    ignition_s = np.array([0.05, 0.1, 0.15, 0.3, np.nan, np.nan, np.nan])
    values = {CELL: NONE._replace(ignition_s=ignition_s), ("confetti", 5.0): NONE}
    table = confidence.ignited_shares({"true": values, "measured": values})
    assert table["source"].tolist() == ["true"] * 6 + ["measured"] * 6
    assert table["within_s"].tolist() == [0.1, 0.2, ""] * 4
    assert table["number"].tolist() == [7, 7, 7, 0, 0, 0] * 2
    for row, number in enumerate((2, 3, 4)):
        wilson = intervals.share(number, 7)
        assert wilson.estimate == number / 7
        np.testing.assert_allclose(
            table.loc[row, ["estimate", "low", "high"]].astype(float), wilson[:3]
        )
    assert table.loc[3:5, "estimate"].isna().all()


def test_distances_of_distributions_are_nought_one_or_unknown():
    one = NONE._replace(dwell_s=np.array([0.1, 0.2, np.nan]), velocity_m_s=np.full((2, 5), 4.0))
    other = one._replace(velocity_m_s=np.full((3, 5), 9.0))
    keys = CELL, ("confetti", 5.0)
    table = confidence.distribution_distances(
        dict.fromkeys(keys, one), dict(zip(keys, (other, NONE), strict=True))
    )
    assert table["quantity"].tolist() == ["dwell time", "velocity 0-1 m"] * 2
    assert table["simulated"].tolist() == [2, 2, 2, 2]
    assert table["measured"].tolist() == [2, 3, 0, 0]
    assert table["distance"].tolist()[:2] == [0.0, 1.0]
    assert table["p"].tolist()[:2] == [1.0, pytest.approx(2 / 10)]  # 2 of C(5, 2) orders
    assert table.loc[2:, ["distance", "p"]].isna().all(axis=None)


def test_a_share_with_lost_flights_is_of_no_whole_number_of_particles():
    """Kaplan and Meier: one of five ends at 1.5 m, one is lost, one of the other three ends."""
    lost = np.array([False, True, False, False, False])
    far, unseen = np.array([1.5, 2.2, 2.5, 3.5, 3.5]), np.full((5, 5), np.nan)
    made = flights(5)._replace(reached_m=far, velocity_m_s=unseen, lost=lost)
    each = confidence.interval_of(made, "remaining 3 m (%)", np.random.default_rng(0))
    assert each.estimate == pytest.approx(100 * 4 / 5 * 2 / 3)
    assert each.low <= each.estimate <= each.high
