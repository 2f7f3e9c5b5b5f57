"""Hits of a bar of valves."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.definitions.belt import valve_hits

from kilnflight.belt.valves import Separation, ValveBar
from kilnflight.checks import InputError
from kilnflight.tables import BELT_PREDICTED

BAR = ValveBar(valves=18, open_s=0.01)  # 10 mm wide, 5 ms to either side


def world(seed, count=40):
    rng = np.random.default_rng(seed)
    chosen = rng.random(count) < 0.4
    true = rng.uniform(0, 0.3, count), rng.uniform(0, 180, count)
    predicted = true[0] + rng.normal(0, 0.004, count), true[1] + rng.normal(0, 4, count)
    return chosen, predicted, true


def table(pair):
    """Times and places as a table, particles numbered through."""
    columns = (np.arange(len(pair[0])), *pair)
    return pd.DataFrame(dict(zip(BELT_PREDICTED.names, columns, strict=True)))


def separate(bar, chosen, predicted, true):
    return bar(table(predicted)[chosen], table(true), chosen)


@settings(max_examples=15)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 5, 18, 64]),
    st.sampled_from([1e-6, 0.004, 0.02]),
)
def test_hits_are_those_of_the_definition(seed, valves, open_s):
    bar = ValveBar(valves=valves, open_s=open_s)
    chosen, predicted, true = world(seed)
    predicted[0][::7], predicted[1][3::7] = np.nan, np.nan
    separation = separate(bar, chosen, predicted, true)
    expected = valve_hits(bar, chosen, predicted, true)
    np.testing.assert_array_equal(separation.hit, expected)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_perfect_predictions_hit_all_and_longer_times_never_fewer(seed):
    chosen, predicted, true = world(seed)
    assert separate(BAR, chosen, true, true).hit[chosen].all()
    hits = [
        separate(replace(BAR, open_s=s), chosen, predicted, true).hit
        for s in (0.01, 0.03)
    ]
    assert (hits[1] >= hits[0]).all()


def test_without_particles_or_prediction_nothing_is_hit():
    none, empty = np.zeros(0, dtype=bool), (np.zeros(0), np.zeros(0))
    separation = separate(BAR, none, empty, empty)
    assert len(separation.hit) == 0
    assert np.isnan([separation.hit_share, separation.inadvertent_share]).all()
    shares = Separation(
        np.array([True, True, False, False]), np.array([True, False, False, True])
    )
    assert (shares.hit_share, shares.inadvertent_share) == (0.5, 0.5)
    chosen, _, true = world(1)
    unknown = np.full(40, np.nan)
    assert not separate(BAR, chosen, (unknown, unknown), true).hit.any()


def test_commands_come_a_latency_before_the_window_and_near_windows_are_merged():
    bar = replace(BAR, latency_s=0.03, delay_s=0.002, dead_s=0.004)
    times = np.array([0.2, 0.213, 0.228, 0.2, np.nan, 0.3])
    events = bar.events(table((times, np.array([15, 15, 15, 25, 5, np.nan]))))
    # a pause of 3 ms is bridged, one of 5 ms is not
    expected = [[1, 1, 2], [0.167, 0.195, 0.167], [0.190, 0.205, 0.177]]
    np.testing.assert_allclose(np.array(events), expected)
    true = np.array([0.1971, 0.1969, 0.2185, 0.2225])
    assert bar.hits(events, true, np.full(4, 15.0)).tolist() == [
        True,
        False,
        True,
        False,
    ]


@pytest.mark.parametrize(
    "wrong",
    [
        {"valves": 0},
        {"valves": 1.5},
        {"valves": 10**9},
        {"belt_mm": 0.0},
        {"open_s": 0.0},
        {"open_s": -0.001},
        {"open_s": np.nan},
        {"latency_s": -0.001},
        {"delay_s": np.inf},
        {"dead_s": "0"},
    ],
    ids=str,
)
def test_what_a_valve_cannot_do_is_refused(wrong):
    (name,) = wrong
    with pytest.raises(InputError, match=name):
        ValveBar(**wrong)


@pytest.mark.parametrize("chosen", [[0, 1], [1.0, 0.0], ["yes", "no"], [None, True]])
def test_particles_are_chosen_by_true_and_false(chosen):
    true = np.array([0.1, 0.2]), np.array([90.0, 20.0])
    assert ValveBar()(table(true), table(true), [True, False]).hit_share == 1.0
    with pytest.raises(InputError, match="chosen"):
        ValveBar()(table(true), table(true), chosen)


def test_times_and_places_of_predictions_are_numbers():
    for name in ("time_s", "y"):
        wrong = table((np.array([0.1]), np.array([90.0]))).assign(**{name: "0.1"})
        with pytest.raises(InputError, match=name):
            ValveBar().events(wrong)
