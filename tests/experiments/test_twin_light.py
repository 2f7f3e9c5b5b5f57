import json
from dataclasses import asdict

import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import twin_exposure as exposure
from kilnflight.experiments import twin_light
from kilnflight.twin.camera import FULL_SCALE
from kilnflight.twin.fitted import SECOND_LIGHT_FILE, SecondLightInputs, second_light
from kilnflight.twin.light import Light, band_radiance
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import downscaled, open_scene, subset_scene


def test_the_limits_are_those_of_radiometry():
    """The longer shutter leaves the wall unsaturated; the mean flame of confetti is 3 walls."""
    assert twin_light.LIMITS["wall_level"][1] * 6.0 / 2.5 * 1.25 < FULL_SCALE
    radius_m = 1e-3 * (2.5**2 + 0.7 * (0.4 * 2.75) ** 2) ** 0.5  # halo and curled disc
    opaque = 1 - np.exp(-twin_light.LIMITS["soot_1_m"][0] * 2 * radius_m)
    soot = band_radiance(np.linspace(*Light().soot_k, 21)) / band_radiance(1423.0)
    assert 3.0 < np.mean(opaque * soot + 1 - opaque) < 3.5
    assert set(twin_light.LIMITS) == set(asdict(SecondLightInputs()))


def test_only_frames_of_the_background_and_one_labelled_are_rendered():
    labelled = [t for t in twin_light.RENDERED if t in exposure.LABELLED]
    assert len(labelled) == 1
    assert len(twin_light.RENDERED) == 12


def test_the_frozen_file_is_within_the_limits_and_better_than_its_start():
    record = twin_light.read_fit()
    assert record["cost_calibrated"] <= record["cost_inputs_only"]
    assert SecondLightInputs(**record["inputs"]) == second_light()
    for name, (low, high) in twin_light.LIMITS.items():
        assert low * 0.999 <= getattr(second_light(), name) <= high * 1.001
    assert open_scene("V1@second-light").scene.optics.wall_level == second_light().wall_level


def test_a_file_that_was_edited_is_refused(tmp_path):
    content = json.loads(SECOND_LIGHT_FILE.read_text())
    content["inputs"]["wall_level"] = 20_000.0
    path = tmp_path / "light.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="damaged"):
        second_light(path)


def test_other_light_on_the_same_flights_is_the_scene_computed_afresh():
    start, other = SecondLightInputs(), SecondLightInputs(8000.0, 40.0, 1.5, 0.4, 0.3, 0.3)
    scene = downscaled(subset_scene("V3", twin_light.SIZES["V3"], 3))
    shared = exposure.relit(Twin(start.applied(scene)), other)
    afresh = Twin(other.applied(scene))
    difference = shared.gray(75).astype(int) - afresh.gray(75)
    assert np.abs(difference).max() <= 1  # a rounding of the wall's level
    assert (difference != 0).mean() < 0.02
