"""What a bar of valves hits."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.belt import PredictionPhase, evaluation
from kilnflight.belt.friction import MATERIALS
from kilnflight.belt.valves import MODELS, ValveBar, along, hit_shares, mean_hit_shares
from kilnflight.checks import InputError

BAR = ValveBar(valves=18, open_s=0.01)  # 10 mm wide, 5 ms to either side


def world(seed, count=40):
    rng = np.random.default_rng(seed)
    chosen = rng.random(count) < 0.4
    true = rng.uniform(0, 0.3, count), rng.uniform(0, 180, count)
    predicted = true[0] + rng.normal(0, 0.004, count), true[1] + rng.normal(0, 4, count)
    return chosen, predicted, true


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
    separation = bar(chosen, predicted, true)
    np.testing.assert_array_equal(separation.hit, by_definition(bar, chosen, predicted, true))


def test_by_hand():
    chosen = np.array([True, False, False, True])
    true = np.array([0.1, 0.102, 0.1, 0.3]), np.array([15.0, 16.0, 35.0, 90.0])
    predicted = np.array([0.1, 9.0, 9.0, 0.32]), np.array([12.0, 16.0, 35.0, 90.0])
    separation = BAR(chosen, predicted, true)
    assert separation.hit.tolist() == [True, True, False, False]
    assert (separation.hit_share, separation.inadvertent_share) == (0.5, 0.5)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_perfect_predictions_hit_all_and_longer_times_never_fewer(seed):
    chosen, predicted, true = world(seed)
    assert BAR(chosen, true, true).hit[chosen].all()
    longer = replace(BAR, open_s=0.03)
    assert (longer(chosen, predicted, true).hit >= BAR(chosen, predicted, true).hit).all()


def test_without_particles_or_prediction_nothing_is_hit():
    none, empty = np.zeros(0, dtype=bool), (np.zeros(0), np.zeros(0))
    separation = BAR(none, empty, empty)
    assert len(separation.hit) == 0
    assert np.isnan(separation.hit_share)
    assert np.isnan(separation.inadvertent_share)
    chosen, _, true = world(1)
    unknown = np.full(40, np.nan)
    assert not BAR(chosen, (unknown, unknown), true).hit.any()


def test_what_cannot_be_separated_is_told():
    chosen, predicted, true = world(2)
    with pytest.raises(InputError, match="predicted places"):
        BAR(chosen, (predicted[0], predicted[1][:3]), true)
    with pytest.raises(InputError, match="not finite"):
        BAR(chosen, predicted, (true[0], true[1] * np.nan))
    with pytest.raises(InputError, match="True and False"):
        BAR(chosen.astype(int), predicted, true)
    for wrong in ({"valves": 0}, {"belt_mm": 0.0}, {"valve_mm": -1.0}, {"open_s": -0.1}):
        with pytest.raises(InputError, match=f"ValveBar: {next(iter(wrong))}"):
            ValveBar(**wrong)


PHASE = PredictionPhase()
BARS = [ValveBar(valves=32, open_s=time) for time in (0.002, 0.01)]


@pytest.fixture(scope="module")
def observed():
    few = replace(MATERIALS["cuboids"], particles=400, feed_s=2.0)
    return PHASE.observe(few(np.random.default_rng(0)))


def test_every_model_and_bar_has_a_row(observed):
    table = hit_shares(observed, PHASE, BARS, seed=1)
    assert len(table) == len(MODELS) * 2
    assert table["model"].unique().tolist() == [name for name, _, _ in MODELS]
    assert table["hit_percent"].between(0, 100).all()
    assert (table["ejected"] + table["remaining"] == len(observed.last) - 4).all()
    longer = table.pivot(index="model", columns="open_ms", values="hit_percent")
    assert (longer[10.0] >= longer[2.0]).all()


def test_a_wider_jet_hits_no_fewer(observed):
    bars = [ValveBar(valve_mm=width) for width in (2.0, None, 20.0)]
    table = hit_shares(observed, PHASE, bars, seed=1)
    assert table["valve_mm"].unique().tolist() == [2.0, 180.0 / 32, 20.0]
    for column in ("hit_percent", "inadvertent_percent"):
        wide = table.pivot(index="model", columns="valve_mm", values=column)
        assert (np.diff(wide.to_numpy(), axis=1) >= 0).all()
        assert wide.loc["IA-Ratio", 20.0] > wide.loc["IA-Ratio", 2.0]


def test_the_same_seed_gives_the_same_shares(observed):
    first, again = (hit_shares(observed, PHASE, BARS, seed=1) for _ in range(2))
    assert first.equals(again)
    assert not first.equals(hit_shares(observed, PHASE, BARS, seed=2))


def test_shares_are_means_over_the_seeds(observed):
    table = mean_hit_shares({"cuboids": observed}, PHASE, BARS, [1, 2])
    single = [hit_shares(observed, PHASE, BARS, seed=seed)["hit_percent"] for seed in (1, 2)]
    assert table["hit_percent"].to_numpy() == pytest.approx(sum(single).to_numpy() / 2)
    assert table["data_set"].unique().tolist() == ["cuboids"]


def test_bars_along_one_quantity_are_else_as_the_given_one(observed):
    bars = [ValveBar(), ValveBar(valves=8), ValveBar(valve_mm=2.0), ValveBar(open_s=0.01)]
    table = hit_shares(observed, PHASE, bars, seed=1)
    parts = {name: along(table, name, ValveBar()) for name in ("valves", "valve_mm", "open_ms")}
    assert parts["valves"]["valves"].unique().tolist() == [32, 8]
    assert parts["valve_mm"]["valve_mm"].unique().tolist() == [180.0 / 32, 2.0]
    assert parts["open_ms"]["open_ms"].unique().tolist() == [5.0, 10.0]
    assert all(len(part) == 2 * len(MODELS) for part in parts.values())
    assert len(along(table, "", ValveBar())) == len(MODELS)


def test_predictions_are_what_the_lateral_deviations_come_from(observed):
    calibration = np.arange(len(observed.last)) < 5
    reference = observed.arrival["y"].to_numpy()[~calibration]
    known = dict(evaluation.lateral_deviations(observed, PHASE, calibration))
    for name, time, y in evaluation.predictions(observed, PHASE, calibration):
        np.testing.assert_array_equal(known[name], y - reference)
        assert np.nanmin(time - observed.last["time_s"].to_numpy()[~calibration]) > 0


def test_too_few_particles_are_told(observed):
    few = observed._replace(last=observed.last[:5], arrival=observed.arrival[:5])
    with pytest.raises(InputError, match="less than one"):
        hit_shares(few, PHASE, BARS, seed=0)
    with pytest.raises(InputError, match="blown"):
        hit_shares(observed, PHASE, BARS, seed=0, blown=2.0)
