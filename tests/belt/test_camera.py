"""Corners found in pictures of a belt whose corners are known, and what follows from them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.belt.camera import (
    BELT,
    DRIFT_PX,
    TRACKED,
    Corners,
    FindCorners,
    calibrate_camera,
    corner_shifts,
    load_calibration,
    save_calibration,
)
from kilnflight.checks import InputError
from kilnflight.sorter.bulk import BULKS
from kilnflight.sorter.rendering import CameraView, Pictures
from kilnflight.tables import BELT_TRACKS


def empty_belt(view, seed=0):
    far = BELT_TRACKS.empty()
    far.loc[0] = [0, 0, 0.0, -1e4, 0.0]
    far = far.astype({"frame": int, "particle": int})
    return Pictures(far, BULKS["spheres"], seed, view)[0]


def true_corners(view):
    return view.pixels(np.column_stack([BELT.corners, np.zeros(4)]))


VIEW = CameraView()
PICTURE = empty_belt(VIEW)


@settings(max_examples=8, deadline=None)
@given(st.floats(-2, 2), st.floats(-2, 2))
def test_corners_are_found_to_a_tenth_of_a_pixel(turn, tilt):
    view = CameraView(turned_deg=turn, tilted_deg=tilt)
    corners = FindCorners()(empty_belt(view))
    np.testing.assert_allclose(corners.places, true_corners(view), atol=0.15)
    assert not corners.hidden.any()


def test_the_error_reported_is_that_of_noise():
    places = np.array([FindCorners()(empty_belt(VIEW, seed)).places for seed in range(8)])
    reported = FindCorners()(PICTURE).spread_px
    scatter = np.sqrt((places.std(axis=0, ddof=1) ** 2).sum(axis=1))
    assert (scatter < 3 * reported).all()
    assert (scatter > reported / 5).all()


def test_the_mapping_takes_pixels_to_the_belt_and_back():
    calibration = calibrate_camera(FindCorners()(PICTURE))
    inside = np.random.default_rng(0).uniform([388, 0], [788, 180], (50, 2))
    pixels = VIEW.pixels(np.column_stack([inside, np.zeros(50)]))
    np.testing.assert_allclose(calibration.millimetres(pixels), inside, atol=0.06)
    np.testing.assert_allclose(calibration.pixels(calibration.millimetres(pixels)), pixels)
    assert calibration.mm_per_px == pytest.approx(0.44, rel=1e-3)
    assert 0 < calibration.error_mm < 0.05
    assert calibration.hidden == 0


def test_a_particle_above_the_belt_is_off_as_the_note_says():
    calibration = calibrate_camera(FindCorners()(PICTURE))
    pixels = VIEW.pixels(np.array([[688.0, 90.0, 2.5]]))
    assert calibration.millimetres(pixels)[0, 0] == pytest.approx(
        688.0 + 100 * 2.5 / 1000, abs=0.05
    )


def test_a_window_shows_the_area_and_stays_in_the_picture():
    calibration = calibrate_camera(FindCorners()(PICTURE))
    rows, cols = calibration.window(TRACKED, 5.0, PICTURE.shape)
    pixels = true_corners(VIEW)
    assert rows.start == pytest.approx(pixels[:, 0].min() - 5, abs=2)
    assert cols.stop - cols.start == pytest.approx(300 / 0.44 + 10, abs=8)
    rows, cols = calibration.window(TRACKED, 1e4, PICTURE.shape)
    assert (rows, cols) == (slice(0, 708), slice(0, 1064))


@pytest.mark.parametrize("corner", range(4))
def test_a_hidden_corner_is_where_its_edges_meet(corner):
    covered, (row, col) = PICTURE.copy(), true_corners(VIEW)[corner].astype(int)
    cv2.circle(covered, (int(col), int(row)), 70, 130, -1)
    corners = FindCorners()(covered)
    assert corners.hidden.tolist() == [k == corner for k in range(4)]
    np.testing.assert_allclose(corners.places, true_corners(VIEW), atol=0.3)
    assert calibrate_camera(corners).hidden == 1


def test_a_hidden_edge_is_told_by_name():
    covered = PICTURE.copy()
    covered[520:, 200:900] = 130
    with pytest.raises(InputError, match=r"far side.* is seen over .*at least 50%"):
        FindCorners()(covered)


@pytest.mark.parametrize("gray", [0, 200])
def test_no_belt_is_told(gray):
    with pytest.raises(InputError, match="no belt"):
        FindCorners()(np.full((100, 120), gray, dtype=np.uint8))


def test_a_belt_that_leaves_the_picture_is_told():
    with pytest.raises(InputError, match="reaches its border"):
        FindCorners()(PICTURE[:, :900])


def test_what_is_no_picture_and_no_quadrangle_is_told():
    with pytest.raises(InputError, match="uint8"):
        FindCorners()(PICTURE.astype(float))
    line = Corners(np.array([[0, 0], [1, 1], [2, 2], [0, 9]]) * 10.0, np.ones(4), np.zeros(4, bool))
    with pytest.raises(InputError, match="on one line"):
        calibrate_camera(line)
    with pytest.raises(InputError, match="profiles"):
        FindCorners(profiles=3)


def test_a_corner_out_of_view_is_refused_and_named_by_its_border():
    corner = true_corners(VIEW)[1].astype(int)  # at the belt's end, y = 0
    cut = PICTURE[corner[0] + 15 :, : corner[1] - 15]
    with pytest.raises(InputError, match="reaches its border"):
        FindCorners()(np.ascontiguousarray(cut))


def test_a_calibration_is_read_as_it_was_saved(tmp_path):
    calibration = calibrate_camera(FindCorners()(PICTURE))
    save_calibration(calibration, tmp_path / "camera.json")
    again = load_calibration(str(tmp_path / "camera.json"))
    np.testing.assert_array_equal(again.matrix, calibration.matrix)
    assert again[1:] == calibration[1:]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.4", "0.5", "is damaged"),
        ('"version": 1', '"version": 2', "of version 2, not 1"),
        ("sha256", "hash", "no calibration"),
        ("{", "[", "no calibration"),
        ("\n}", "", "no calibration"),
    ],
)
def test_a_damaged_calibration_is_refused(tmp_path, old, new, message):
    path = tmp_path / "camera.json"
    save_calibration(calibrate_camera(FindCorners()(PICTURE)), path)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=rf"camera\.json: .*{message}"):
        load_calibration(path)
    with pytest.raises(InputError, match="no calibration"):
        load_calibration(tmp_path / "none.json")
    path.write_text("3")
    with pytest.raises(InputError, match="no calibration"):
        load_calibration(path)


def test_a_camera_that_was_moved_is_noticed():
    calibration = calibrate_camera(FindCorners()(PICTURE))
    later = corner_shifts(calibration, FindCorners()(empty_belt(VIEW, seed=5)))
    assert (later < DRIFT_PX / 5).all()
    moved = np.roll(PICTURE, 2, axis=1)  # by 2 px along the belt
    np.testing.assert_allclose(corner_shifts(calibration, FindCorners()(moved)), 2.0, atol=0.05)
    turned = empty_belt(replace(VIEW, turned_deg=VIEW.turned_deg + 0.5))
    assert corner_shifts(calibration, FindCorners()(turned)).max() > DRIFT_PX


def test_a_belt_that_runs_downwards_is_refused():
    turned = np.ascontiguousarray(np.rot90(PICTURE))
    with pytest.raises(InputError, match=r"mm per px.*Turn the picture"):
        calibrate_camera(FindCorners()(turned))


@pytest.mark.parametrize("wrong", [None, [[1, 2]], "belt.png", np.empty((0, 0), np.uint8)])
def test_what_is_no_picture_has_no_corners(wrong):
    with pytest.raises(InputError, match=r"FindCorners: .*uint8"):
        FindCorners()(wrong)
