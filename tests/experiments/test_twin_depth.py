"""The depth camera is set by published inputs, and by nothing else."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import twin_depth
from kilnflight.twin import scenes, truth
from kilnflight.twin.fitted import DEPTH_FILE, second_depth
from kilnflight.twin.particles import Burst
from kilnflight.twin.scene import Scene, Twin


@pytest.fixture(scope="module")
def chips():
    feed = (Burst("wood chip", 25, -0.2, 0.2),)
    scene = scenes.second(Scene("chips", feed, 60, 7, fraction="wood chip"))
    return Twin(scenes.downscaled(scene))


def test_targets_are_as_printed():
    shares, points, errors = twin_depth.targets()
    assert shares["non-burning particle in air"] == "78.79%"
    assert points == {"points": 200_000}
    assert errors["paper shred"] == 218.99


def test_another_camera_sees_the_same_picture(chips):
    other = twin_depth.with_depth(chips, replace(chips.scene.depth, contrast=1e3))
    assert np.array_equal(other.gray(20), chips.gray(20))
    assert len(other.frame(20).pixels) < len(chips.frame(20).pixels)
    assert other.life is chips.life


def test_places_are_medians_of_the_labelled_points(chips):
    table, view, frame = twin_depth.points_on(chips, 20), chips.view(20), chips.frame(20)
    assert set(table["particle"]) <= set(chips.particles_with_depth(20, view))
    particle = int(table["particle"].iloc[0])
    shown = view.shown & (view.blobs.particle[view.pixels.blob] == particle)
    places = frame.pixels[:, 0] * 512 + frame.pixels[:, 1]
    mine = frame.xyz[np.isin(places, view.pixels.place[shown])]
    true = truth.sightings(chips, 20).set_index("particle").loc[particle, "z"]
    assert table["z"].iloc[0] == pytest.approx(true, abs=1500.0)
    assert mine[:, 2].min() - 400 < table["z"].iloc[0] < mine[:, 2].max() + 400


def test_errors_come_out_again(monkeypatch):
    """Where the fit adds a constant variance, the error put in makes up for it."""
    rest = 60.0

    def fitted(camera):
        put_in = dict(camera.particle_error_mm)
        return {name: float(np.hypot(error, rest)) for name, error in put_in.items()}

    monkeypatch.setattr(twin_depth, "fitted_errors", fitted)
    camera, measured = twin_depth.errors_that_return(second_depth())
    assert measured == pytest.approx(twin_depth.printed_errors(), abs=0.1)
    assert dict(camera.particle_error_mm)["confetti"] == pytest.approx(126.65, abs=0.1)


def test_jumps_to_the_depth_of_another_particle_are_left_out():
    z = 5000.0 - 30.0 * np.arange(20)
    z[[7, 15]] = [2500.0, 9000.0]
    table = pd.DataFrame({"frame": range(20), "particle": 1, "z": z})
    table.loc[3, "z"] = np.nan
    kept = twin_depth.without_jumps(table, 400.0)
    assert sorted(set(range(20)) - set(kept["frame"])) == [3, 7, 15]


def test_the_frozen_file_is_what_scenes_use():
    record = twin_depth.read_fit()
    camera = scenes.ground_truth("V1").depth
    assert camera == second_depth()
    assert camera.contrast == record["inputs"]["contrast"]
    assert record["with_depth"]["3"] == pytest.approx(twin_depth.UNLIT, abs=0.05)
    assert np.mean(record["points"]) == pytest.approx(twin_depth.POINTS, rel=0.05)


def test_a_file_that_was_edited_is_refused(tmp_path):
    content = json.loads(DEPTH_FILE.read_text())
    content["inputs"]["contrast"] = 1.0
    path = tmp_path / "depth.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="damaged"):
        second_depth(path)
