from dataclasses import replace

import numpy as np
import pytest

from kilnflight.belt import PredictionPhase, deviation
from kilnflight.belt.friction import MATERIALS
from kilnflight.belt.separation import ValveBar
from kilnflight.belt.sorting import MODELS, shares
from kilnflight.checks import InputError

PHASE = PredictionPhase()
BARS = [ValveBar(valves=32, open_s=time) for time in (0.002, 0.01)]


@pytest.fixture(scope="module")
def observed():
    few = replace(MATERIALS["cuboids"], particles=400, feed_s=2.0)
    return PHASE.observe(few(np.random.default_rng(0)))


def test_every_model_and_bar_has_a_row(observed):
    table = shares(observed, PHASE, BARS, seed=1)
    assert len(table) == len(MODELS) * 2
    assert table["model"].unique().tolist() == [name for name, _, _ in MODELS]
    assert table["hit_percent"].between(0, 100).all()
    assert (table["wanted"] + table["others"] == len(observed.last) - 4).all()
    longer = table.pivot(index="model", columns="open_ms", values="hit_percent")
    assert (longer[10.0] >= longer[2.0]).all()


def test_a_wider_jet_hits_no_fewer(observed):
    bars = [ValveBar(valve_mm=width) for width in (2.0, None, 20.0)]
    table = shares(observed, PHASE, bars, seed=1)
    assert table["valve_mm"].unique().tolist() == [2.0, 180.0 / 32, 20.0]
    for column in ("hit_percent", "inadvertent_percent"):
        wide = table.pivot(index="model", columns="valve_mm", values=column)
        assert (np.diff(wide.to_numpy(), axis=1) >= 0).all()
        assert wide.loc["IA-Ratio", 20.0] > wide.loc["IA-Ratio", 2.0]


def test_the_same_seed_gives_the_same_shares(observed):
    one, other = (shares(observed, PHASE, BARS, seed=1) for _ in range(2))
    assert one.equals(other)
    assert not one.equals(shares(observed, PHASE, BARS, seed=2))


def test_predictions_are_what_the_lateral_deviations_come_from(observed):
    calibration = np.arange(len(observed.last)) < 5
    reference = observed.arrival["y"].to_numpy()[~calibration]
    known = dict(deviation.lateral_deviations(observed, PHASE, calibration))
    for name, time, y in deviation.predictions(observed, PHASE, calibration):
        np.testing.assert_array_equal(known[name], y - reference)
        assert np.nanmin(time - observed.last["time_s"].to_numpy()[~calibration]) > 0


def test_too_few_particles_are_told(observed):
    few = observed._replace(last=observed.last[:5], arrival=observed.arrival[:5])
    with pytest.raises(InputError, match="less than one"):
        shares(few, PHASE, BARS, seed=0)
    with pytest.raises(InputError, match="wanted"):
        shares(observed, PHASE, BARS, seed=0, wanted=2.0)
