"""How the values of the sorter are found."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.phase import PredictionPhase
from kilnflight.checks import InputError
from kilnflight.experiments import belt_calibration
from kilnflight.experiments.belt_calibration import INPUTS_ONLY, LIMITS
from kilnflight.sorter.machine import Contacts
from kilnflight.sorter.simulation import FIT_PLACES_MM, FittedValues, fitted_record, fitted_values

PHASE = PredictionPhase()


def test_the_frozen_values_lie_within_the_limits_and_cost_least():
    record = fitted_record()
    for name, (low, high) in LIMITS.items():
        assert low <= getattr(fitted_values(), name) <= high
    assert record["cost_calibrated"] == min(end["cost"] for end in record["searches"].values())
    assert record["cost_calibrated"] < record["cost_first_fit"] < record["cost_inputs_only"]


def test_the_frozen_ranges_hold_the_values_and_each_search_says_how_it_ended():
    record = fitted_record()
    for name, (low, high) in record["ranges"].items():
        assert LIMITS[name][0] <= low <= record["inputs"][name] <= high <= LIMITS[name][1]
    assert list(record["searches"]) == list(belt_calibration.STARTS)
    assert all(end["ended"] and end["evaluations"] > 6 for end in record["searches"].values())


def test_the_table_of_fitted_values_has_the_limits_of_the_search():
    table = belt_calibration.fitted_table()
    assert table.index.tolist() == list(LIMITS)
    assert (table["fitted_to_spheres"] >= table["limit_low"]).all()
    assert (table["fitted_to_spheres"] <= table["limit_high"]).all()
    assert table.loc["belt_friction", "inputs_only"] == Contacts.belt_friction
    assert [f"from {name}" in table.columns for name in belt_calibration.STARTS] == [True, True]


def test_the_fit_sees_nothing_of_the_prediction_phase():
    assert FIT_PLACES_MM.max() + 15.0 < PHASE.start_mm  # 15 mm: a step at 100 Hz


def linear_profile(values):
    """A world in which a profile is linear in the values."""
    share = belt_calibration._point(values) - 1.0
    rows = np.random.default_rng(0).normal(size=(15, len(LIMITS))) @ share
    return pd.DataFrame(rows.reshape(3, 5), columns=list(belt_calibration.SCALES)) / 10.0


@pytest.mark.parametrize("start", belt_calibration.STARTS)
def test_the_search_finds_values_that_made_the_targets(monkeypatch, start):
    known = FittedValues(0.2, 0.03, 90.0, 1.0, 10.0, 0.04, 12.0)
    monkeypatch.setattr(belt_calibration, "profile", linear_profile)
    search = belt_calibration.fit(linear_profile(known), belt_calibration.STARTS[start], rounds=20)
    for name in LIMITS:
        assert getattr(search.fitted, name) == pytest.approx(getattr(known, name), rel=0.02)
    assert search.cost < 1e-3
    assert search.evaluations > 7


def test_at_the_ends_of_a_range_the_cost_has_risen_as_stated_and_is_least(monkeypatch):
    """In a linear world the quadratic cost is exact; no other end of that value costs less."""
    known = FittedValues(0.4, 0.05, 160.0, 1.0, 15.0, 0.1, 50.0)
    monkeypatch.setattr(belt_calibration, "profile", lambda values, _=0: linear_profile(values))
    published = linear_profile(known)
    search = belt_calibration.fit(published, known, rounds=5)
    ends = belt_calibration.range_ends(search)
    for name, pair in ends.items():
        assert getattr(pair[0], name) < getattr(known, name) < getattr(pair[1], name)
        for values in pair:
            assert belt_calibration.cost(values, published) == pytest.approx(0.1, rel=0.05)
            alone = replace(search.fitted, **{name: getattr(values, name)})
            assert belt_calibration.cost(alone, published) > 0.095


def test_misfits_count_in_their_scales_and_gaps_are_refused():
    published = pd.DataFrame({name: [1.0] for name in belt_calibration.SCALES})
    simulated = published + pd.Series(belt_calibration.SCALES)
    np.testing.assert_allclose(belt_calibration.profile_misfits(simulated, published), 1.0)
    with pytest.raises(InputError, match="too few particles"):
        belt_calibration.profile_misfits(simulated * np.nan, published)


def test_the_spheres_are_met_better_than_by_handbooks(authors_data, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.setattr(belt_calibration, "PARTICLES", 60)
    published = belt_calibration.published_spheres()
    costs = [belt_calibration.cost(values, published) for values in (fitted_values(), INPUTS_ONLY)]
    assert costs[0] < costs[1] / 5


def test_the_spin_decides_in_the_phase_what_the_fit_does_not_see(authors_data, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.setattr(belt_calibration, "PARTICLES", 30)
    table = belt_calibration.vary_spin((0.7, 1.0))
    assert table["phase_mm_s"].diff().iloc[1] > 30.0
    assert (table["cost"] > 0.0).all()


def test_without_the_authors_tracks_nothing_is_fitted(monkeypatch):
    monkeypatch.setattr(belt_calibration, "find_dem", dict)
    with pytest.raises(InputError, match="make data"):
        belt_calibration.published_spheres()
