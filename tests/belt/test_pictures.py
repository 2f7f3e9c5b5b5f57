from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.belt.area import BELT, Area
from kilnflight.belt.pictures import SHAPES, Pictures, Shape, _exposed, at_rate
from kilnflight.belt.view import View
from kilnflight.checks import InputError
from kilnflight.tables import BELT_TRACKS

LEVEL = View(turned_deg=0.0, tilted_deg=0.0)


def one_track(x=500.0, y=90.0, frames=3, step=5):
    frame = step * np.arange(frames)
    columns = {"frame": frame, "particle": 0, "time_s": frame / 1000.0, "x": x, "y": y}
    return pd.DataFrame(columns)[BELT_TRACKS.names]


def test_a_level_camera_has_the_scale_of_the_paper():
    seen = LEVEL.pixels(np.column_stack([BELT.corners, np.zeros(4)]))
    np.testing.assert_allclose(seen[1] - seen[0], [0.0, 400 / 0.44])
    np.testing.assert_allclose(seen[3] - seen[0], [180 / 0.44, 0.0])
    np.testing.assert_allclose(seen.mean(axis=0), [353.5, 531.5])


def test_the_whole_belt_is_in_view_whatever_the_mounting():
    for turn, tilt in [(0.3, 0.3), (-1.0, 1.0)]:
        view = View(turned_deg=turn, tilted_deg=tilt)
        seen = view.pixels(np.column_stack([BELT.corners, np.zeros(4)]))
        assert ((seen > 10) & (seen < [698, 1054])).all()
        middle = view.pixels(np.array([[588.0, 90.0, 0.0]]))
        np.testing.assert_allclose(middle, [[353.5, 531.5]], atol=1e-9)


@settings(deadline=None)
@given(st.floats(-180, 180), st.floats(-80, 80), st.floats(0.1, 5.0))
def test_what_is_higher_is_seen_farther_from_the_middle(dx, dy, z):
    flat, high = LEVEL.pixels(np.array([[588 + dx, 90 + dy, 0.0], [588 + dx, 90 + dy, z]]))
    middle = np.array([353.5, 531.5])
    np.testing.assert_allclose(high - middle, (flat - middle) * 1000 / (1000 - z), atol=1e-9)


@pytest.mark.parametrize("name", SHAPES)
def test_a_particle_has_its_area_and_its_place(name):
    shape = SHAPES[name]
    tracks = one_track(x=520.3, y=60.7).assign(angle_rad=0.6)
    pictures = Pictures(tracks, shape, 0, LEVEL, belt_gray=0.0, noise_gray=0.0)
    empty = Pictures(one_track(x=10.0), shape, 0, LEVEL, belt_gray=0.0, noise_gray=0.0)
    window = np.s_[240:340, 330:430]
    share = (pictures[0].astype(float) - empty[0])[window] / 200.0
    flat = np.pi * 2.5**2 if name == "spheres" else shape.length_mm * shape.width_mm
    assert share.sum() * 0.44**2 == pytest.approx(flat, rel=0.02)
    rows, cols = np.mgrid[window]
    place = [(share * rows).sum() / share.sum(), (share * cols).sum() / share.sum()]
    expected = LEVEL.pixels(np.array([[520.3, 60.7, shape.height_mm]]))[0]
    np.testing.assert_allclose(place, expected, atol=0.1)


def test_a_cylinder_lies_in_its_direction():
    for angle in (0.0, np.pi / 2):
        tracks = one_track().assign(angle_rad=angle)
        picture = Pictures(tracks, SHAPES["cylinders"], 0, LEVEL, noise_gray=0.0)[0] > 150
        rows, cols = np.nonzero(picture[150:560, 80:980])
        assert (np.ptp(cols) > np.ptp(rows)) == (angle == 0.0)


def test_frames_do_not_depend_on_which_others_are_asked_for():
    pictures = Pictures(one_track(frames=4), SHAPES["spheres"], 3)
    assert len(pictures) == 4
    assert len(Pictures(BELT_TRACKS.empty(), SHAPES["spheres"], 3)) == 0
    backwards = list(pictures.frames([2, 0]))
    np.testing.assert_array_equal(backwards[0], pictures[2])
    np.testing.assert_array_equal(backwards[1], pictures[0])
    assert (pictures[0] != pictures[2]).any()
    other = Pictures(one_track(frames=4), SHAPES["spheres"], 4)
    assert (pictures[0] != other[0]).any()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 20), st.sampled_from([200.0, 100.0, 500.0]))
def test_thinning_keeps_times(first, rate):
    frame = first + np.arange(60)
    table = pd.DataFrame(
        {"frame": frame, "particle": 1, "time_s": frame / 1000, "x": 1.0, "y": 2.0}
    )
    slow = at_rate(table, rate)
    np.testing.assert_allclose(slow["time_s"], slow["frame"] / rate)
    assert (slow["frame"].diff().dropna() == 1).all()


def test_what_cannot_be_drawn_is_told():
    slow = one_track(frames=10, step=10)  # 100 Hz
    with pytest.raises(InputError, match="no rows 200 times a second"):
        at_rate(slow, 200.0)
    with pytest.raises(InputError, match="half a side"):
        Shape(5.0, 3.0, 2.0, 1.0)
    with pytest.raises(InputError, match="mm_per_px"):
        View(mm_per_px=0.0)
    with pytest.raises(InputError, match="not beyond"):
        Area(start_mm=10.0, end_mm=5.0)
    with pytest.raises(InputError, match="soft_px"):
        replace(Pictures(one_track(), SHAPES["spheres"], 0), soft_px=0.0)


def test_gray_values_are_rounded_and_cut_off_at_eight_bits():
    rng = np.random.default_rng(5)
    picture = rng.uniform(-20, 280, (40, 50)).astype(np.float32)
    picture[0, :4] = [0.5, 1.5, 254.5, 255.5]
    noise = rng.standard_normal(picture.shape, dtype=np.float32)
    for spread in (0.0, 3.0, 400.0):
        plain = np.clip(np.rint(picture + spread * noise), 0, 255).astype(np.uint8)
        np.testing.assert_array_equal(_exposed(picture, np.float32(spread), noise), plain)
