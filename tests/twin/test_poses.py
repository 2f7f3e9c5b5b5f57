import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.project import cache
from kilnflight.twin import scenes
from kilnflight.twin.camera import Geometry
from kilnflight.twin.poses import DRAWS, FIRST_SCALE, POSE_FILE, Pose, read_poses


def test_the_untouched_pose_is_the_first_twins():
    place = Pose().placed(Geometry())
    assert place == replace(Geometry(), axis_far_mm=place.axis_far_mm)
    np.testing.assert_allclose(place.axis_far_mm, Geometry.axis_far_mm, rtol=1e-12)


def test_a_larger_scale_brings_the_far_end_nearer_and_shows_the_same_picture():
    far, near = Pose().placed(Geometry()), Pose(scale=1.1 * FIRST_SCALE).placed(Geometry())
    np.testing.assert_allclose(1.1 * np.array(near.axis_far_mm), far.axis_far_mm)
    assert near.inlet_depth_mm == pytest.approx(far.inlet_depth_mm / 1.1)
    first, second = (p.project(np.array(p.axis_far_mm)) for p in (far, near))
    assert first == pytest.approx(second)


@pytest.mark.parametrize("number", range(DRAWS))
def test_every_draw_is_a_kiln_and_a_scene(number):
    pose = read_poses().draws[number]
    scene = scenes.open_scene(f"V1@pose-{number:02d}+small").scene
    place = scene.geometry
    assert place.lance_depth_mm == pose.lance_depth_mm
    assert place.axis_height_mm == pose.axis_height_mm
    assert scene.flight.launch_elevation_deg == pose.elevation_deg
    assert place.inlet_m < 0 < place.outlet_m
    depth = place.wall_depth(np.array([0.0]), np.array([0.0]))
    assert 0 < depth < place.inlet_depth_mm


def test_the_mode_joins_other_scenarios_and_leaves_the_rest():
    base, posed = (scenes.open_scene(n).scene for n in ("V2", "V2@pose"))
    mode = read_poses().mode
    flight = replace(base.flight, launch_elevation_deg=mode.elevation_deg)
    expected = replace(base, name="V2@pose", flight=flight, geometry=mode.placed(Geometry()))
    assert posed == expected
    joined = scenes.open_scene("confetti-4.5-bar@pose-03+choked-lance").scene
    assert joined.gas.choked
    assert joined.geometry.axis_height_mm == read_poses().draws[3].axis_height_mm


def test_a_draw_that_is_not_there_is_told():
    with pytest.raises(InputError, match="no scene"):
        scenes.open_scene(f"V1@pose-{DRAWS}")


@pytest.mark.parametrize("change", ["edited", "other draws", "unknown number"])
def test_an_edited_file_is_refused(tmp_path, change):
    content = json.loads(POSE_FILE.read_text())
    if change == "edited":
        content["draws"][2]["scale"] += 0.01
    else:
        content.pop("sha256")
        if change == "other draws":
            content["draws"].pop()
        else:
            content["draws"][0]["wind"] = 1.0
        content["sha256"] = cache.content_hash(content)
    path = tmp_path / "pose.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"pose\.json"):
        read_poses(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lance_depth_mm": -100.0}, "lance_depth_mm"),  # behind the camera
        ({"lance_depth_mm": 9500.0}, "outside the kiln"),  # behind the inlet
        ({"lance_depth_mm": 500.0}, "outside the kiln"),  # before the outlet
        ({"lance_pixel": (2900.0, 936.3)}, "outside the kiln"),  # below the wall
        ({"kiln_radius_mm": 5000.0}, "wall is out of the picture"),
    ],
)
def test_a_geometry_that_shows_no_kiln_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        replace(Geometry(), **change)
    with pytest.raises(InputError, match=message):
        Geometry(**{**asdict(Geometry()), **change})
