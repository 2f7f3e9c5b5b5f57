import json
from dataclasses import fields

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt import calibration, friction_values
from kilnflight.belt.friction_values import INPUTS_ONLY, LIMITS, FreeValues, calibrated, record
from kilnflight.belt.machine import Sorter
from kilnflight.belt.physics import Contacts
from kilnflight.belt.slide import Slide
from kilnflight.checks import InputError
from kilnflight.project import cache


def test_the_untouched_values_are_the_defaults():
    assert INPUTS_ONLY.applied(Sorter()) == Sorter()
    other = FreeValues(belt_friction=0.2, drop_mm=50.0).applied(Sorter())
    assert (other.contacts.belt_friction, other.slide.drop_mm) == (0.2, 50.0)
    assert other.contacts.wall_friction == Sorter().contacts.wall_friction


def test_the_frozen_values_lie_within_the_limits_and_cost_less():
    for name, (low, high) in LIMITS.items():
        assert low <= getattr(calibrated(), name) <= high
    assert record()["cost_calibrated"] < record()["cost_inputs_only"] / 2


def test_every_value_says_where_it_comes_from():
    table = friction_values.all_values(calibrated()).set_index("value")
    names = {field.name for field in fields(Contacts)}
    slide = {field.name for field in fields(Slide)} - {"yaw_spread_deg"}
    names |= {name if name in LIMITS else f"slide_{name}" for name in slide}
    assert set(table.index) == names
    fitted = table["source"].str.startswith("fitted")
    assert set(table.index[fitted]) == set(LIMITS)
    assert (table["inputs_only"] == table["found_with_spheres"])[~fitted].all()
    assert table.loc["wall_friction", "source"].startswith("assumed")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda one: one["inputs"].update(drop_mm=1.0), "damaged"),
        (lambda one: one.update(targets_sha256="0", sha256=None), "other targets"),
        (lambda one: one["inputs"].update(strange=1.0), "other inputs"),
    ],
)
def test_a_file_that_does_not_fit_is_refused(tmp_path, change, message):
    content = json.loads(friction_values.FILE.read_text())
    known = content.pop("sha256")
    change(content)
    again = "damaged" not in message
    content.pop("sha256", None)
    content["sha256"] = cache.content_hash(content) if again else known
    path = tmp_path / "values.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        calibrated(path)


def test_the_search_finds_values_that_made_the_targets(monkeypatch):
    """A world in which a profile is linear in the values: least squares must find them."""
    known = FreeValues(0.2, 0.03, 90.0, 0.8, 10.0, 0.04, 12.0)

    def profile(values, material="spheres"):
        low, high = (np.array(corner) for corner in zip(*LIMITS.values(), strict=True))
        share = (np.array([getattr(values, name) for name in LIMITS]) - low) / (high - low)
        rows = np.random.default_rng(0).normal(size=(9, 7)) @ share
        table = pd.DataFrame(rows.reshape(3, 3), columns=list(calibration.SCALES))
        return table / 10.0

    monkeypatch.setattr(calibration, "profile", profile)
    found, evaluations = calibration.fit(profile(known), rounds=20)
    for name in LIMITS:
        assert getattr(found, name) == pytest.approx(getattr(known, name), rel=0.02, abs=1e-3)
    assert evaluations > 7


def test_misfits_count_in_their_scales_and_gaps_are_told():
    wanted = pd.DataFrame({name: [1.0] for name in calibration.SCALES})
    found = wanted + pd.Series(calibration.SCALES)
    np.testing.assert_allclose(calibration.misfits(found, wanted), 1.0)
    with pytest.raises(InputError, match="too few particles"):
        calibration.misfits(found * np.nan, wanted)


def test_the_spheres_are_met_better_than_by_handbooks(authors_data, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.setattr(calibration, "PARTICLES", 40)
    wanted = calibration.published("spheres")
    costs = [calibration.cost(one, wanted) for one in (calibrated(), INPUTS_ONLY)]
    assert costs[0] < costs[1] / 20


def test_without_the_authors_tracks_nothing_is_fitted(monkeypatch):
    monkeypatch.setattr(calibration, "find_dem", dict)
    with pytest.raises(InputError, match="make data"):
        calibration.published("spheres")
