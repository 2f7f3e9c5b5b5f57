"""Frames of the twin: any order, any process, labels and depth of the truth."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kilnflight.camera import calibrate_points
from kilnflight.recording.frames import check_frame
from kilnflight.simulated.kiln import scenes, truth
from kilnflight.simulated.kiln.background import Background, Interior
from kilnflight.simulated.kiln.feeding import LABELLED
from kilnflight.simulated.kiln.geometry import Geometry
from kilnflight.simulated.kiln.laws import LAWS
from kilnflight.simulated.kiln.lenses import LensCamera, LensWall
from kilnflight.simulated.kiln.light import Optics

PLACE = Geometry()


def digest(frame):
    parts = (frame.gray, frame.xyz, frame.labels)
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


def test_another_process_with_another_hash_seed_renders_the_same_bytes(twin):
    twin.frame(40)  # here another frame comes first
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]);"
        "from conftest import make_twin; from test_scene import digest;"
        "print(digest(make_twin().frame(7)))"
    )
    there = subprocess.run(
        [sys.executable, "-c", code, str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONHASHSEED": "2"},
    ).stdout
    assert there.strip() == digest(twin.frame(7))


def test_positions_are_one_a_pixel_and_lie_on_its_ray(twin):
    frame = check_frame(twin.frame(20), twin.attributes)
    row, column = twin.scene.geometry.project(frame.xyz.astype(float))
    np.testing.assert_allclose(row, frame.pixels[:, 0], atol=1e-2)
    np.testing.assert_allclose(column, frame.pixels[:, 1], atol=1e-2)
    assert 0.6 < len(frame.pixels) / twin.scene.depth.wall_points < 1.3


def test_labels_and_instances_are_those_of_the_truth(twin):
    for t in (60, 80):
        frame, sightings = twin.frame(t), truth.sightings(twin, t)
        assert (set(sightings["frame"]), sightings["particle"].is_unique) == ({t}, True)
        assert set(sightings["label"]) <= {2, 3, 4}
        marked = sightings[sightings["visible"] & (sightings["pixels"] > 0)]
        row = marked["row"].round().astype(int).clip(0, 383)
        column = marked["col"].round().astype(int).clip(0, 511)
        labelled = frame.labels[row, column]
        assert (
            labelled == marked["label"]
        ).mean() > 0.8  # the rest lies behind another
        image = truth.instances(twin, t)
        assert ((image >= 0) == (frame.labels >= 2)).all()
        shown = sightings.set_index("particle").loc[np.unique(image[image >= 0])]
        hidden = shown[
            ~shown["visible"]
        ]  # the middle of such a one is out of the picture
        inside = hidden["row"].between(-0.5, 383.5) & hidden["col"].between(-0.5, 511.5)
        assert not inside.any()


@pytest.mark.parametrize("name", ["V3", "V5"])
def test_a_subset_holds_the_printed_labels_in_ten_frames(name):
    twin = scenes.open_scene(name)
    seen = truth.sightings(twin, LABELLED[0]).iloc[:0]
    for t in LABELLED[1::3]:
        sighted = truth.sightings(twin, t)
        seen = pd.concat([seen, sighted[sighted["visible"]]])
    for row in scenes.COUNTS.loc[name].itertuples():
        count = 10 / 3 * (seen["label"] == row.label).sum()  # three of ten frames
        assert count == pytest.approx(row.everywhere, rel=0.25, abs=20)


def test_scenes_have_the_published_lengths_and_rates():
    run = scenes.campaign("PE granule", 5.0)
    assert (run.frames, run.frame_rate_hz, run.pressure_bar) == (3113, 153.85, 5.0)
    assert scenes.campaign("wood chip", 4.5).frames == 3102
    campaigns = [scenes.campaign(*key) for key in LAWS]
    assert sum(campaign.frames for campaign in campaigns) == 24_892


def test_the_wall_has_as_many_points_as_asked_for_where_pixels_have_equal_contrast():
    # with this seed two pixels at the limit are equal
    camera, interior = LensCamera(), Interior()
    background = Background(Geometry(), Optics(), interior, 23)
    bias = camera.calibration(1536, 2048, 0)
    wall = LensWall(camera, background, bias)
    assert len(wall.index) == int(camera.wall_points / camera.kept_per_frame)
    assert (np.diff(wall.index) > 0).all()


def test_the_lance_is_seen_at_its_published_pixel_and_every_ray_meets_wall_or_plate():
    assert PLACE.project(PLACE.lance_mm) == pytest.approx(PLACE.lance_pixel)
    row, column = np.meshgrid(np.arange(0, 1536, 97.0), np.arange(0, 2048, 113.0))
    local = PLACE.to_kiln(PLACE.unproject(row, column, PLACE.wall_depth(row, column)))
    radius = np.hypot(local[..., 1], local[..., 2])
    plate = np.isclose(local[..., 0], PLACE.inlet_m)
    np.testing.assert_allclose(radius[~plate], 0.7, atol=1e-6)
    assert (radius[plate] <= 0.7 + 1e-9).all()
    assert 0 < plate.sum() < plate.size


def test_the_lance_stands_where_its_points_are(twin):
    place, lance = twin.scene.geometry, np.array(twin.attributes.exit_point_mm)
    assert place.project(lance) == pytest.approx(place.lance_pixel)
    assert lance[2] == pytest.approx(twin.lance_seen_mm)
    near, error = [], twin.scene.depth.wall_scale(place.lance_depth_mm)
    for t in range(0, 160, 4):
        frame = twin.frame(t)
        cloud = calibrate_points(frame.xyz, twin.attributes.depth_calibration)
        beside = np.hypot(*(frame.pixels - place.lance_pixel).T) < 12
        depth = cloud[beside, 2]
        near.append(depth[np.abs(depth - place.lance_depth_mm) < 4 * error].mean())
    assert np.mean(near) == pytest.approx(lance[2], abs=3 * error / np.sqrt(len(near)))


def test_the_plate_scatters_most_near_3_m():
    camera = LensCamera()
    relative = camera.wall_scale([1000.0, 2299.0, 3701.0, 9000.0])
    share = relative[0] / 1000.0
    np.testing.assert_allclose(relative, share * np.array([1000.0, 2299, 3701, 9000]))
    most = camera.wall_scale([2700.0, 3000.0, 3300.0])
    np.testing.assert_allclose(most, most[0])
    assert most[0] > 2 * share * 3000.0
    between = camera.wall_scale([2500.0, 3500.0])
    halfway = (most[0] + share * np.array([2300.0, 3700.0])) / 2
    np.testing.assert_allclose(between, halfway)


def test_one_calibration_serves_all_recordings_of_a_seed():
    first, other = scenes.open_scene("V1"), scenes.open_scene("pe-granule-5.0-bar")
    assert first.lance_seen_mm == other.lance_seen_mm != PLACE.lance_depth_mm
    assert scenes.open_scene("V1", 1).lance_seen_mm != first.lance_seen_mm
    assert scenes.open_scene("V2@own-calibration").lance_seen_mm != first.lance_seen_mm
