"""Facts of the twin: their table, their tolerance, and how they are counted."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import statements, twin_statements
from kilnflight.experiments.twin_calibration import LIMITS, SEARCH
from kilnflight.scores.flights import FlightValues
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR

KEYS = [(name, bar) for name in FRACTIONS for bar in PRESSURES_BAR]
SPEED = {"wood chip": 13.5, "confetti": 7.4, "paper shred": 5.2, "PE granule": 8.5}


def flights(name, faster=1.0, count=20):
    velocity = np.full((count, 5), faster * SPEED[name])
    nothing = np.full(count, np.nan)
    return FlightValues(np.full(count, 0.4), velocity, nothing, np.full(count, 3.5))


@pytest.fixture
def values():
    return {key: flights(key[0]) for key in KEYS}


def test_every_fact_has_bounds_a_tolerance_and_a_place():
    table = twin_statements.facts()
    assert set(map(tuple, table[["fraction", "pressure_bar"]].to_numpy())) == set(KEYS)
    assert table["fact"].nunique() == 5
    assert (table["low"] <= table["high"]).all()
    assert np.isfinite(table["tolerance"]).all()
    assert (table["tolerance"] > 0).all()
    percent = table["outcome"].str.contains("%")
    assert table.loc[percent, "low"].min() >= 0
    assert table.loc[percent, "high"].max() <= 100
    assert table[["where", "quote"]].notna().all(axis=None)
    assert set(table["outcome"]) <= set(statements.statements()["outcome"])


def test_what_is_left_out_says_why():
    table = twin_statements.sentences()
    left = table[table["left_out"].notna()]
    assert len(left) + len(twin_statements.facts()) == len(table)
    assert left["fact"].isna().all()


def test_the_reasons_count_every_sentence_that_is_left_out():
    table = twin_statements.left_out()
    every = twin_statements.sentences()["left_out"].notna().sum()
    assert table["sentences"].sum() == every
    assert table["reason"].is_unique
    assert table["example"].notna().all()


def test_the_error_of_a_share_is_binomial_and_that_of_a_speed_has_the_length():
    """By hand: 25 flights, 50 % with one more of each, and 8 m/s of 25 with 30 % spread."""
    rows = pd.DataFrame({"outcome": ["ignited (%)", "velocity 0-1 m (m/s)"]})
    error = twin_statements.end_tolerance(rows, np.array([50.0, 8.0]), np.array([25.0, 25.0]))
    of_median = np.sqrt(np.pi / 2) * 0.3 * 8.0 / 5.0
    assert error[0] == pytest.approx(100 * np.sqrt(0.5 * 0.5 / 25))
    assert error[1] == pytest.approx(np.hypot(of_median, 0.8))


def test_a_fact_holds_within_two_tolerances_of_its_bounds(values):
    rows = twin_statements.facts()
    row = rows[(rows["fraction"] == "confetti") & rows["outcome"].str.startswith("velocity 0-1")]
    number = row.index[row["pressure_bar"] == 4.5][0]
    high, tolerance = rows.loc[number, ["high", "tolerance"]]
    for deviations, expected in ((1.9, True), (2.1, False)):
        faster = (high + deviations * tolerance) / SPEED["confetti"]
        moved = {**values, ("confetti", 4.5): flights("confetti", faster)}
        score = twin_statements.z_scores(rows, twin_statements.answers(rows, moved))
        assert score[number] == pytest.approx(deviations)
        assert twin_statements.holding(rows, moved)[number] == expected


def test_alike_all_fractions_have_one_value_and_no_order(values):
    alike = twin_statements.all_alike(values)
    rows = twin_statements.facts()
    speed = rows["outcome"].str.startswith("velocity 0-1")
    answered = twin_statements.answers(rows, alike)[speed]
    assert answered.groupby(rows["pressure_bar"]).nunique().eq(1).all()
    assert not twin_statements.in_order(twin_statements.rankings(), alike).any()


def test_inputs_of_the_prior_lie_within_the_limits_and_are_reproducible():
    drawn, again = (twin_statements.prior(SEARCH, 50, seed=1) for _ in range(2))
    assert drawn == again
    for name, (low, high) in LIMITS.items():
        inside = np.array([getattr(each, name) for each in drawn])
        assert low <= inside.min() < inside.max() <= high


def test_without_a_measurement_nothing_is_measured_and_nothing_judged(values):
    table = twin_statements.statement_table({}, values, [values, values])
    assert list(table.columns) == twin_statements.COLUMNS
    assert table[["measured", "z", "holds"]].isna().all(axis=None)
    whole = twin_statements.statement_table(values, values, [values])
    assert (whole["holds"] == (whole["null_prior"] == 1.0)).all()
    assert whole["measured"].equals(whole["true"])
    slow = {key: flights(key[0], 0.2) for key in KEYS}  # far below the printed velocities
    assert twin_statements.statement_table(slow, values, [values])["z"].max() > 2
    assert twin_statements.statement_table(slow, values, [values])["z"].min() >= 0


def test_counts_are_means_over_draws(values):
    slow = {key: flights(key[0], 0.2) for key in KEYS}
    counts = twin_statements.count_holding({"a": [values], "b": [slow], "both": [values, slow]})
    held = counts.set_index("version")["facts_hold"]
    assert held["a"] > held["b"]
    assert held["both"] == pytest.approx((held["a"] + held["b"]) / 2)
    assert (counts["cells_hold"] <= counts["cells"]).all()


def test_what_no_fit_read_is_counted_apart(values):
    counts = twin_statements.count_holding({"a": [values]}).iloc[0]
    assert 0 < counts["held_out"] < counts["facts"]
    assert counts["held_out_hold"] <= min(counts["held_out"], counts["facts_hold"])


def test_the_old_count_is_that_of_notebook_12(values):
    every = statements.statements()
    rows = every[every["use"] == statements.HELD_OUT]
    off = statements.misfits(rows, statements.answer(rows, statements.outcome_table(values)))
    counted = twin_statements.count_holding({"a": [values], "none": [{}]}).set_index("version")
    assert counted.loc["a", "statements_hold"] == (off == 0).sum()
    assert counted.loc["a", "median_misfit"] == off.median()
    assert counted.loc["none", ["facts_hold", "orders_hold", "statements"]].eq(0).all()


def test_the_counts_are_told_with_both_null_models(values):
    slow = {key: flights(key[0], 0.2) for key in KEYS}
    first, second, measured, same, prior = twin_statements.VERSIONS
    runs = {first: [slow], second: [values], measured: [{}], prior: [slow, slow]}
    runs |= {same: [twin_statements.all_alike(values)]}
    free = twin_statements.facts_that_can_fail(
        twin_statements.statement_table({}, values, [slow, slow])
    )
    told = twin_statements.describe_counts(twin_statements.count_holding(runs), free)
    assert " 0 hold as measured and " in told
    assert (
        "as measured the second look has no skill and on the truth the second look has some" in told
    )
    runs[prior] = [values]
    told = twin_statements.describe_counts(twin_statements.count_holding(runs), free)
    assert "on the truth the second look has no skill" in told


def test_what_holds_in_every_draw_cannot_fail(values):
    slow = {key: flights(key[0], 0.2) for key in KEYS}
    same = twin_statements.statement_table(values, values, [values]).assign(null_prior=1.0)
    assert twin_statements.facts_that_can_fail(same).iloc[0].tolist() == [
        len(same),
        len(same),
        0,
        0,
        0.0,
    ]
    table = twin_statements.statement_table(values, values, [values, slow])
    row = twin_statements.facts_that_can_fail(table).iloc[0]
    free = table[table["null_prior"] < 1]
    assert 0 < row["can_fail"] == len(free)
    assert row["can_fail"] + row["hold_in_every_draw"] == len(table)
    assert row["measured"] == free["holds"].sum()
    assert row["draws_mean"] == pytest.approx(free["null_prior"].sum())


def test_draws_of_the_prior_are_flown_whatever_the_processes(monkeypatch):
    monkeypatch.setattr(twin_statements, "true_values", lambda kiln, *_: kiln)
    flown = twin_statements.prior_values(SEARCH, lambda each: each, 3, 5, 1, jobs=1)
    assert flown == twin_statements.prior(SEARCH, 3, 1)


def test_versions_stand_side_by_side(values):
    slow = {key: flights(key[0], 0.2) for key in KEYS}
    part = {("confetti", 4.5): values["confetti", 4.5]}
    table = twin_statements.side_by_side({"first": values, "slow": slow, "part": part})
    known = table["part_holds"].notna()
    assert (known == ((table["fraction"] == "confetti") & (table["pressure_bar"] == 4.5))).all()
    assert table["first_holds"].sum() > table["slow_holds"].sum()
    speed = table["outcome"].str.startswith("velocity 0-1")
    assert (table.loc[speed, "slow_z"] < 0).all()
