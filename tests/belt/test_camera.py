"""Corners found in pictures of a belt whose corners are known, and the mapping from
them.
"""

import cv2
import numpy as np
import pytest

from kilnflight.belt.camera import (
    BELT,
    Area,
    BeltCorners,
    calibrate_camera,
    check_picture,
    find_corners,
)
from kilnflight.checks import InputError
from kilnflight.simulated.belt.rendering import BULKS, CameraView, Pictures
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


@pytest.mark.parametrize(("turn", "tilt"), [(-2.0, 2.0), (1.3, -0.7)])
def test_corners_are_found_to_a_tenth_of_a_pixel(turn, tilt):
    view = CameraView(turned_deg=turn, tilted_deg=tilt)
    found = find_corners(empty_belt(view))
    np.testing.assert_allclose(found.places, true_corners(view), atol=0.15)


def test_the_mapping_takes_pixels_to_the_belt_and_back():
    calibration = calibrate_camera(find_corners(PICTURE))
    inside = np.random.default_rng(0).uniform([388, 0], [788, 180], (50, 2))
    pixels = VIEW.pixels(np.column_stack([inside, np.zeros(50)]))
    np.testing.assert_allclose(calibration.millimetres(pixels), inside, atol=0.06)
    np.testing.assert_allclose(
        calibration.pixels(calibration.millimetres(pixels)), pixels
    )
    assert calibration.mm_per_px == pytest.approx(0.44, rel=1e-3)
    assert 0 < calibration.error_mm < 0.05
    # a particle above the belt is off by the parallax of the note
    high = calibration.millimetres(VIEW.pixels(np.array([[688.0, 90.0, 2.5]])))[0, 0]
    assert high == pytest.approx(688.0 + 100 * 2.5 / 1000, abs=0.05)


def test_a_hidden_corner_is_where_its_edges_meet():
    covered, (row, col) = PICTURE.copy(), true_corners(VIEW)[1].astype(int)
    cv2.circle(covered, (int(col), int(row)), 70, 130, -1)
    np.testing.assert_allclose(
        find_corners(covered).places, true_corners(VIEW), atol=0.3
    )


def covered(rows, cols):
    picture = PICTURE.copy()
    picture[rows, cols] = 130
    return picture


@pytest.mark.parametrize(
    "picture",
    [
        covered(slice(520, None), slice(200, 900)),  # an edge is hidden
        np.full((100, 120), 200, dtype=np.uint8),
        PICTURE[:, :900],  # the belt leaves the picture
        PICTURE.astype(float),
        None,
    ],
)
def test_a_picture_without_a_whole_belt_is_refused(picture):
    with pytest.raises(InputError, match="picture"):
        find_corners(picture)


def test_a_belt_that_runs_downwards_and_no_area_are_refused():
    turned = np.ascontiguousarray(np.rot90(PICTURE))
    with pytest.raises(InputError, match="belt"):
        calibrate_camera(find_corners(turned))
    with pytest.raises(InputError, match="end_mm"):
        Area(start_mm=10.0, end_mm=5.0)
    with pytest.raises(InputError, match="frame 3"):
        check_picture(PICTURE, "frame 3", (2, 2))


UPRIGHT = np.array([[10.0, 10], [10, 810], [370, 810], [370, 10]])


@pytest.mark.parametrize(
    "places",
    [
        UPRIGHT[[0, 2, 1, 3]],
        UPRIGHT[[0, 1, 3, 2]],
        UPRIGHT[::-1],
        [[10, 10], [10, 410], [10, 810], [370, 10]],
        [[10, 10], [10, 810], [190, 410], [370, 10]],
        [[10, 10], [10, 810], [100, 200], [370, 10]],
        np.full((4, 2), 10.0),
    ],
    ids=str,
)
def test_corners_that_are_no_quadrilateral_in_order_are_refused(places):
    calibrate_camera(BeltCorners(UPRIGHT, np.full(4, 0.02)))
    with pytest.raises(InputError, match="corners"):
        calibrate_camera(BeltCorners(np.array(places, float), np.full(4, 0.02)))


def test_the_error_of_a_corner_is_known():
    with pytest.raises(InputError, match="spread"):
        calibrate_camera(BeltCorners(UPRIGHT, np.full(4, np.nan)))
