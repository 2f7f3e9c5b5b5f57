"""What a bar of valves hits."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.belt.valves import Separation, ValveBar, ValveSchedule
from kilnflight.checks import InputError
from kilnflight.tables import BELT_PREDICTED, VALVE_EVENTS

BAR = ValveBar(valves=18, open_s=0.01)  # 10 mm wide, 5 ms to either side


def world(seed, count=40):
    rng = np.random.default_rng(seed)
    chosen = rng.random(count) < 0.4
    true = rng.uniform(0, 0.3, count), rng.uniform(0, 180, count)
    predicted = true[0] + rng.normal(0, 0.004, count), true[1] + rng.normal(0, 4, count)
    return chosen, predicted, true


def table(pair, names=BELT_PREDICTED.names):
    """Times and places as a table, particles numbered through."""
    return pd.DataFrame(dict(zip(names, (np.arange(len(pair[0])), *pair), strict=True)))


def separate(bar, chosen, predicted, true):
    return bar(table(predicted)[chosen], table(true), chosen)


def by_definition(bar, chosen, predicted, true):
    """Every valve against every particle, in plain code."""
    pitch = bar.belt_mm / bar.valves
    width = pitch if bar.valve_mm is None else bar.valve_mm
    hit = np.zeros(len(chosen), dtype=bool)
    for i in np.flatnonzero(chosen):
        if not (np.isfinite(predicted[0][i]) and np.isfinite(predicted[1][i])):
            continue
        valve = min(range(bar.valves), key=lambda k: abs((k + 0.5) * pitch - predicted[1][i]))
        for j in range(len(chosen)):
            across = abs((valve + 0.5) * pitch - true[1][j]) <= width / 2
            hit[j] |= across and abs(predicted[0][i] - true[0][j]) <= bar.open_s / 2
    return hit


@settings(deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 5, 18, 64]),
    st.sampled_from([None, 3.0, 25.0]),
    st.sampled_from([0.0, 0.004, 0.02]),
)
def test_hits_are_those_of_the_definition(seed, valves, width, open_s):
    bar = ValveBar(valves=valves, valve_mm=width, open_s=open_s)
    chosen, predicted, true = world(seed)
    predicted[0][::7] = np.nan
    separation = separate(bar, chosen, predicted, true)
    np.testing.assert_array_equal(separation.hit, by_definition(bar, chosen, predicted, true))
    events = bar.events(table(predicted)[chosen])  # the table leads to the same
    np.testing.assert_array_equal(separation.hit, bar.hits(events, *true))


def test_by_hand():
    chosen = np.array([True, False, False, True])
    true = np.array([0.1, 0.102, 0.1, 0.3]), np.array([15.0, 16.0, 35.0, 90.0])
    predicted = np.array([0.1, 9.0, 9.0, 0.32]), np.array([12.0, 16.0, 35.0, 90.0])
    separation = separate(BAR, chosen, predicted, true)
    assert separation.hit.tolist() == [True, True, False, False]
    assert (separation.hit_share, separation.inadvertent_share) == (0.5, 0.5)
    assert (separation.purity_blown_out, separation.purity_left) == (0.5, 0.5)
    every = Separation(separation.hit, np.ones(4, dtype=bool))
    assert (every.purity_blown_out, every.purity_left) == (1.0, 0.0)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_perfect_predictions_hit_all_and_longer_times_never_fewer(seed):
    chosen, predicted, true = world(seed)
    assert separate(BAR, chosen, true, true).hit[chosen].all()
    longer = replace(BAR, open_s=0.03)
    hits = [separate(bar, chosen, predicted, true).hit for bar in (BAR, longer)]
    assert (hits[1] >= hits[0]).all()


def test_without_particles_or_prediction_nothing_is_hit():
    none, empty = np.zeros(0, dtype=bool), (np.zeros(0), np.zeros(0))
    separation = separate(BAR, none, empty, empty)
    assert len(separation.hit) == 0
    assert np.isnan(separation.hit_share)
    assert np.isnan(separation.inadvertent_share)
    assert np.isnan(separation.purity_blown_out)
    assert np.isnan(separation.purity_left)
    chosen, _, true = world(1)
    unknown = np.full(40, np.nan)
    nobody = separate(BAR, chosen, (unknown, unknown), true)
    assert not nobody.hit.any()
    assert np.isnan(nobody.purity_blown_out)


def test_what_cannot_be_separated_is_told():
    chosen, predicted, true = world(2)
    with pytest.raises(InputError, match="chosen: shape"):
        BAR(table(predicted), table(true), chosen[:3])
    with pytest.raises(InputError, match="not finite"):
        separate(BAR, chosen, predicted, (true[0], true[1] * np.nan))
    with pytest.raises(InputError, match="True and False"):
        BAR(table(predicted), table(true), chosen.astype(int))
    with pytest.raises(InputError, match="time_s missing"):
        BAR(table(predicted).drop(columns="time_s"), table(true), chosen)
    for wrong in ({"valves": 0}, {"belt_mm": 0.0}, {"valve_mm": -1.0}, {"bar_mm": 0.0}):
        with pytest.raises(InputError, match=f"ValveBar: {next(iter(wrong))}"):
            ValveBar(**wrong)
    for wrong in ({"open_s": -0.1}, {"dead_s": np.inf}, {"latency_s": -1}, {"delay_s": np.nan}):
        with pytest.raises(InputError, match=f"ValveBar: {next(iter(wrong))}"):
            ValveBar(**wrong)


def arrivals(*rows):
    """Predictions by time and place, particles numbered through."""
    time, y = np.array(rows, dtype=np.float64).reshape(-1, 2).T
    return pd.DataFrame({"particle": np.arange(len(rows)), "time_s": time, "y": y})


def event_rows(events):
    VALVE_EVENTS.check(events)
    return [
        (int(row.valve), round(row.open_s, 6), round(row.close_s, 6)) for row in events.itertuples()
    ]


def test_commands_come_a_latency_before_the_window_and_near_windows_are_merged():
    bar = replace(BAR, latency_s=0.03, delay_s=0.002, dead_s=0.004)
    predicted = arrivals((0.2, 15), (0.213, 15), (0.228, 15), (0.2, 25), (np.nan, 5), (0.3, np.nan))
    first, third = (1, 0.167, 0.190), (1, 0.195, 0.205)  # a pause of 3 ms is bridged, 5 ms is not
    assert event_rows(bar.events(predicted)) == [first, (2, 0.167, 0.177), third]
    true = np.array([0.1971, 0.1969, 0.2185, 0.2225]), np.array([15.0, 15, 15, 15])
    assert bar.hits(bar.events(predicted), *true).tolist() == [True, False, True, False]


def test_a_particle_beside_a_narrow_bar_is_never_hit():
    bar = replace(BAR, valves=4, bar_mm=40.0)  # 70 to 110 mm
    assert bar.middles_mm.tolist() == [75, 85, 95, 105]
    true = np.full(4, 0.1), np.array([69.0, 71.0, 109.0, 150.0])
    schedule = ValveSchedule(bar)
    schedule.step(0.0, arrivals(*zip(*true, strict=True)))
    assert (schedule.out_of_reach, schedule.due(0.2)["valve"].tolist()) == (2, [0, 3])
    every = np.ones(4, dtype=bool)
    assert separate(bar, every, true, true).hit.tolist() == [False, True, True, False]
    beyond_the_wall = BAR.events(arrivals((0.1, -20), (0.1, 200)))
    assert beyond_the_wall["valve"].tolist() == [0, 17]


def test_no_particle_gives_no_event():
    none = BELT_PREDICTED.empty()
    assert VALVE_EVENTS.check(BAR.events(none)).empty
    assert VALVE_EVENTS.check(ValveSchedule(BAR).step(0.0, none)).empty
    assert not BAR.hits(BAR.events(none), np.array([0.1]), np.array([5.0])).any()


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.003, 0.02]), st.integers(1, 30))
def test_a_schedule_gives_the_events_that_are_known_in_advance(seed, dead_s, valves):
    rng = np.random.default_rng(seed)
    bar = ValveBar(valves, latency_s=0.01, delay_s=0.001, dead_s=dead_s)
    predicted = arrivals(*zip(rng.uniform(0, 0.3, 60), rng.uniform(0, 180, 60), strict=True))
    opens = predicted["time_s"] + 0.001 - 0.01 - bar.open_s / 2
    known = opens - dead_s - rng.exponential(0.03, 60)  # just in time, or earlier
    schedule, before, parts = ValveSchedule(bar), -np.inf, []
    for now in [*np.sort(known), np.inf]:
        parts.append(schedule.step(now, predicted[(known > before) & (known <= now)]))
        before = now
    events = pd.concat(parts).sort_values(["open_s", "valve"], ignore_index=True)
    pd.testing.assert_frame_equal(events, bar.events(predicted))
    assert schedule.late == schedule.never == 0


def test_what_is_known_too_late_opens_late_or_never():
    bar, none = replace(BAR, dead_s=0.02), BELT_PREDICTED.empty()  # windows of 10 ms
    schedule = ValveSchedule(bar)
    schedule.step(0.1, arrivals((0.101, 5), (0.090, 15), (0.2, 25)))
    assert (schedule.late, schedule.never) == (1, 1)
    assert schedule.due(0.103)["valve"].tolist() == [0]
    assert event_rows(schedule.step(0.11, none)) == [(0, 0.1, 0.106)]
    schedule.step(0.12, arrivals((0.124, 5)))  # in time, but valve 0 has a pause until 126 ms
    assert (schedule.late, schedule.never) == (2, 1)
    assert event_rows(schedule.step(np.inf, none)) == [(0, 0.126, 0.129), (2, 0.195, 0.205)]
    with pytest.raises(InputError, match="in order"):
        schedule.step(0.2, none)


def test_an_open_valve_stays_open_for_the_next_particle():
    schedule, none = ValveSchedule(BAR), BELT_PREDICTED.empty()
    schedule.step(0.0, arrivals((0.1, 5)))
    assert schedule.step(0.1, arrivals((0.108, 5))).empty
    assert schedule.due(0.109)["valve"].tolist() == [0]
    assert event_rows(schedule.step(0.2, none)) == [(0, 0.095, 0.113)]
    assert schedule.due(0.21).empty


def test_what_is_due_is_cut_to_the_time_asked_for():
    schedule = ValveSchedule(BAR)  # windows of 10 ms
    schedule.step(0.0, table(([0.1, 0.2], [5.0, 15.0])))
    assert VALVE_EVENTS.check(schedule.due(0.05)).empty
    assert schedule.due(0.1).to_numpy().tolist() == [[0, pytest.approx(0.095), 0.1]]
    schedule.step(0.1, BELT_PREDICTED.empty())
    assert schedule.due(0.102).to_numpy().tolist() == [[0, 0.1, 0.102]]
    assert schedule.due(np.inf)["valve"].tolist() == [0, 1]
    for wrong in (0.09, np.nan):
        with pytest.raises(InputError, match="due until"):
            schedule.due(wrong)
