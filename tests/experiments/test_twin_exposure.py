from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import twin_exposure as exposure
from kilnflight.twin.camera import FULL_SCALE
from kilnflight.twin.fitted import LightInputs, light_inputs
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import downscaled, ground_truth, subset_scene


def test_the_targets_are_the_published_row():
    row = exposure.otsu_targets().set_index("subset").loc["V5"]
    assert row.tolist() == [0.9920, 0.4758, 0.35]


def test_no_misfit_costs_nothing_and_units_are_the_spreads():
    published = exposure.otsu_targets()
    assert exposure.cost(published, published) == 0
    off = published.assign(recall=published["recall"] + 0.05)
    assert exposure.cost(off, published) == pytest.approx(5.0)


def test_the_search_is_deterministic_and_keeps_to_the_limits():
    def bowl(inputs):
        return (inputs.wall_level / 9000 - 1) ** 2 + (inputs.share_on - 0.3) ** 2

    search = replace(exposure.SEARCH, seed=1, generations=4)
    first, evaluations = search(bowl)
    assert (first, evaluations) == search(bowl)
    assert all(low <= asdict(first)[n] <= high for n, (low, high) in exposure.LIMITS.items())
    assert set(exposure.LIMITS) == set(asdict(LightInputs()))


def test_the_row_is_what_otsu_detects_and_depends_on_the_light():
    twin = Twin(downscaled(ground_truth("V3", first=True)))
    fitted = light_inputs()
    row = exposure.otsu_row([twin], fitted)
    assert list(row.columns) == list(exposure.otsu_targets().columns)
    assert row[["precision", "recall", "unlit"]].to_numpy().min() >= 0
    assert row[["precision", "recall", "unlit"]].to_numpy().max() <= 1
    pd.testing.assert_frame_equal(row, exposure.otsu_row([twin], fitted))
    other = exposure.otsu_row([twin], replace(fitted, irradiance=1.2, burner_flicker=0.5))
    assert not np.allclose(row.iloc[0, 1:].astype(float), other.iloc[0, 1:].astype(float))


def test_the_frozen_file_fits_the_targets_and_overexposes_flames():
    record = exposure.read_fit()
    assert record["cost_calibrated"] < record["cost_inputs_only"]
    assert LightInputs(**record["inputs"]) == light_inputs()
    assert light_inputs().flame_reach >= 1
    optics = ground_truth("V1", first=True).optics
    assert optics.wall_level + optics.flame_level >= FULL_SCALE * (1 - 1e-9)


@pytest.fixture(scope="module")
def plain_twin():
    return Twin(downscaled(subset_scene("V3", exposure.FED["V3"], 3)))


def test_other_light_on_the_same_flights_is_the_scene_computed_afresh(plain_twin):
    inputs = LightInputs(9000.0, 0.45, 0.6, 0.3, 0.2, 90_000.0, 0.1)
    shared, afresh = exposure.relit(plain_twin, inputs), Twin(inputs.applied(plain_twin.scene))
    for t in (0, 75):
        difference = shared.gray(t).astype(int) - afresh.gray(t)
        assert np.abs(difference).max() <= 1  # a rounding of the wall's level
        assert (difference != 0).mean() < 0.01
        assert (shared.frame(t).labels == afresh.frame(t).labels).mean() > 0.9999


def test_other_light_changes_light_only(plain_twin):
    before, other = (
        plain_twin.scene,
        exposure.relit(plain_twin, LightInputs(9000.0, 0.45, 0.6, 0.3, 0.2)),
    )
    after = other.scene
    assert after != before
    parts = {name: getattr(before, name) for name in ("optics", "surroundings", "on_the_wall")}
    assert replace(after, **parts) == before
    assert after.optics.wall_k == before.optics.wall_k
    assert after.on_the_wall.delay_s == before.on_the_wall.delay_s
    assert other.life.flights is plain_twin.life.flights
    light = ["flame_s", "flicker_share"]
    known, table = plain_twin.life.table, other.life.table
    pd.testing.assert_frame_equal(table.drop(columns=light), known.drop(columns=light))
    assert not table["flame_s"].equals(known["flame_s"])
