"""Medians, shares and printed numbers of flights made by hand."""

import numpy as np
import pytest

from kilnflight.experiments.flights import comparison
from kilnflight.scores import intervals
from kilnflight.scores.flights import (
    DWELL,
    DWELL_OUTCOMES,
    OUTCOMES,
    VELOCITIES,
    FlightValues,
    outcomes,
)


def whole(dwell_s, velocity_m_s, ignition_s, reached_m):
    """Return values of flights none of which was lost."""
    lost = np.zeros(len(reached_m), np.bool_)
    return FlightValues(dwell_s, velocity_m_s, ignition_s, reached_m, lost)


NONE = whole(np.empty(0), np.empty((0, 5)), np.empty(0), np.empty(0))


def flown(count=60, seed=0):
    draw = np.random.default_rng(seed)
    velocity = draw.normal(8.0, 1.0, (count, 5))
    velocity[draw.random((count, 5)) < [0.0, 0.3, 0.6, 0.9, 1.0]] = np.nan
    ignition = np.where(draw.random(count) < 0.5, draw.random(count) * 0.5, np.nan)
    return whole(
        draw.gamma(9.0, 0.04, count), velocity, ignition, draw.random(count) * 3
    )


def shifted(values, by):
    return values._replace(
        dwell_s=values.dwell_s + by, velocity_m_s=values.velocity_m_s + 8 * by
    )


@pytest.mark.parametrize(
    ("by", "verdicts"),
    [(0.0, {"recovered"}), (0.3, {"biased"}), (0.03, {"open", "recovered"})],
)
def test_a_median_is_recovered_if_the_interval_of_its_error_is_within_ten_percent(
    by, verdicts
):
    key = ("confetti", 4.5)
    true, measured = {key: flown(4000)}, {key: shifted(flown(4000), by)}
    draws = np.random.default_rng(0)
    table = comparison.recovery(
        measured, true, [VELOCITIES[0], DWELL], draws
    ).set_index("outcome")
    np.testing.assert_allclose(table["measured"] - table["true"], table["error"])
    np.testing.assert_allclose(table["measured"], outcomes(measured[key])[table.index])
    assert set(table["verdict"]) <= verdicts
    few = comparison.recovery({key: flown(3)}, true, [DWELL], draws)
    assert few["verdict"].tolist() == ["open"]
    assert comparison.recovered(few) is None
    assert (
        comparison.recovery({key: NONE}, true, DWELL_OUTCOMES, draws)["verdict"]
        .eq("open")
        .all()
    )


def test_an_order_holds_if_no_interval_of_a_difference_holds_zero():
    one, other = ("wood chip", 4.5), ("confetti", 4.5)
    values, draws = (
        {one: flown(200), other: shifted(flown(200), 0.2)},
        np.random.default_rng(0),
    )
    for pairs, answer in (
        ([(other, one)], True),
        ([(one, other)], False),
        ([(one, one)], None),
    ):
        table = comparison.differences(values, values, DWELL, pairs, draws)
        assert comparison.all_above(table) is answer
        np.testing.assert_allclose(table["measured"], table["true"], atol=1e-12)


@pytest.mark.parametrize(
    ("label", "number", "of"),
    [
        ("ignited < 0.1 s (%)", 2, 8),
        ("ignited < 0.1 s (% of ignited)", 2, 3),
        ("dwell > 0.4 s (%)", 1, 4),
        ("remaining 2 m (%)", 6, 8),
    ],
)
def test_shares_have_wilsons_interval_of_what_is_counted(label, number, of):
    ignition = np.array([0.05, 0.1, 0.3, *[np.nan] * 5])
    far = np.array([1.0, 1.5, *[2.5] * 6])
    values = whole(
        np.array([0.2, 0.3, 0.35, 0.5]), np.full((8, 5), np.nan), ignition, far
    )
    outcome = next(each for each in OUTCOMES if each.label == label)
    found = comparison.interval_of(values, outcome, np.random.default_rng(0))
    np.testing.assert_allclose(
        found[:3], 100 * np.array(intervals.share(number, of)[:3])
    )
