import numpy as np
import pytest

from kilnflight.camera import PLATE_DISTANCES_MM, invert_depth
from kilnflight.checks import InputError
from kilnflight.twin.depth import DepthCamera
from kilnflight.twin.geometry import Geometry
from kilnflight.twin.plate import DOT_MM, PITCH_MM, see_all_plates, see_plate

EXACT = DepthCamera(scale=0.0, white_mm=0.0)


@pytest.mark.parametrize("distance", [1000.0, 4000.0, 11_000.0])
def test_without_error_the_dots_stand_where_they_are(distance):
    points = see_plate(distance, 500, np.random.default_rng(1), EXACT)
    true = points * (distance / points[:, 2])[:, None]
    inside = (np.abs(true[:, 0]) < 100) & (np.abs(true[:, 1]) < 80)
    centre = np.round(true[inside, :2] / PITCH_MM) * PITCH_MM
    radius = np.hypot(*(true[inside, :2] - centre).T)
    np.testing.assert_allclose(radius, DOT_MM / 2, atol=1e-6)


def test_medians_are_the_inverse_of_the_equation():
    captured, true = see_all_plates(3000, np.random.default_rng(2))
    expected = invert_depth(PLATE_DISTANCES_MM)
    box = np.subtract(*np.quantile(captured, [0.75, 0.25], axis=1))
    assert (np.abs(np.median(captured, axis=1) - expected) < 0.5 * box).all()
    assert captured.shape == true.shape == (11, 3000)


def test_the_scatter_follows_the_words_of_the_text():
    captured, _ = see_all_plates(5000, np.random.default_rng(3))
    box = np.subtract(*np.quantile(captured, [0.75, 0.25], axis=1))
    whiskers = 4 * box
    assert box.argmax() == 2  # 3 m is the most dispersed
    assert whiskers[2] > 1000.0  # more than 1 m
    assert whiskers[3] < whiskers[2] / 2  # a few tens of centimetres
    assert (np.diff(box[3:]) > -0.25 * box[3:-1]).all()  # grows from 4 m on, but for chance


def test_every_point_is_in_the_picture_and_reproducible():
    one, two = (see_plate(2000.0, 200, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    row, column = Geometry().project(one)
    assert ((row >= -0.51) & (row <= 1535.51)).all()
    assert ((column >= -0.51) & (column <= 2047.51)).all()


def test_no_plate_and_no_points():
    with pytest.raises(InputError, match="distance_mm"):
        see_plate(0.0, 10, np.random.default_rng(1))
    assert see_plate(3000.0, 0, np.random.default_rng(1)).shape == (0, 3)
