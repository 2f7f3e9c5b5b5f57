"""How the values of the sorter are found."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.machine import Contacts
from kilnflight.belt.sorter import FittedValues, fitted_record, fitted_values
from kilnflight.checks import InputError
from kilnflight.experiments import belt_calibration
from kilnflight.experiments.belt_calibration import INPUTS_ONLY, LIMITS


def test_the_frozen_values_lie_within_the_limits_and_cost_less():
    for name, (low, high) in LIMITS.items():
        assert low <= getattr(fitted_values(), name) <= high
    assert fitted_record()["cost_calibrated"] < fitted_record()["cost_inputs_only"] / 2


def test_the_table_of_fitted_values_has_the_limits_of_the_search():
    table = belt_calibration.fitted_table()
    assert table.index.tolist() == list(LIMITS)
    assert (table["fitted_to_spheres"] > table["low"]).all()
    assert (table["fitted_to_spheres"] < table["high"]).all()
    assert table.loc["belt_friction", "inputs_only"] == Contacts.belt_friction


def test_the_search_finds_values_that_made_the_targets(monkeypatch):
    """A world in which a profile is linear in the values: least squares must find them."""
    known = FittedValues(0.2, 0.03, 90.0, 0.8, 10.0, 0.04, 12.0)

    def profile(values):
        low, high = (np.array(corner) for corner in zip(*LIMITS.values(), strict=True))
        share = (np.array([getattr(values, name) for name in LIMITS]) - low) / (high - low)
        rows = np.random.default_rng(0).normal(size=(9, 7)) @ share
        table = pd.DataFrame(rows.reshape(3, 3), columns=list(belt_calibration.SCALES))
        return table / 10.0

    monkeypatch.setattr(belt_calibration, "profile", profile)
    found, evaluations = belt_calibration.fit(profile(known), rounds=20)
    for name in LIMITS:
        assert getattr(found, name) == pytest.approx(getattr(known, name), rel=0.02, abs=1e-3)
    assert evaluations > 7


def test_misfits_count_in_their_scales_and_gaps_are_refused():
    published = pd.DataFrame({name: [1.0] for name in belt_calibration.SCALES})
    simulated = published + pd.Series(belt_calibration.SCALES)
    np.testing.assert_allclose(belt_calibration.profile_misfits(simulated, published), 1.0)
    with pytest.raises(InputError, match="too few particles"):
        belt_calibration.profile_misfits(simulated * np.nan, published)


def test_the_spheres_are_met_better_than_by_handbooks(authors_data, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.setattr(belt_calibration, "PARTICLES", 40)
    published = belt_calibration.published_spheres()
    costs = [belt_calibration.cost(values, published) for values in (fitted_values(), INPUTS_ONLY)]
    assert costs[0] < costs[1] / 20


def test_without_the_authors_tracks_nothing_is_fitted(monkeypatch):
    monkeypatch.setattr(belt_calibration, "find_dem", dict)
    with pytest.raises(InputError, match="make data"):
        belt_calibration.published_spheres()
