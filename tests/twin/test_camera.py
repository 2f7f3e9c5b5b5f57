import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.camera import PLATE_DISTANCES_MM, calibrate_depth
from kilnflight.project import claims
from kilnflight.twin.camera import (
    DOT_MM,
    PITCH_MM,
    DepthCamera,
    Geometry,
    see_plate,
)

EXACT = DepthCamera(scale=0.0, white_mm=0.0)


PLACE = Geometry()


@given(st.floats(0, 1535), st.floats(0, 2047), st.floats(500, 12_000))
def test_a_pixel_at_a_depth_is_seen_there(row, column, depth):
    point = PLACE.unproject(row, column, depth)
    assert PLACE.project(point) == pytest.approx((row, column))
    assert point[2] == depth


@given(st.tuples(*[st.floats(-5, 5)] * 3))
def test_kiln_and_camera_coordinates_are_one_place(position):
    there = PLACE.to_camera(np.array(position))
    np.testing.assert_allclose(PLACE.to_kiln(there), position, atol=1e-9)


def test_the_lance_is_seen_at_its_published_pixel_and_lies_in_the_kiln():
    assert PLACE.project(PLACE.lance_mm) == pytest.approx(PLACE.lance_pixel)
    assert np.hypot(*PLACE.lance_m[1:]) < PLACE.kiln_radius_mm / 1000
    assert PLACE.lance_m[0] == pytest.approx(0.0, abs=1e-9)
    assert PLACE.inlet_m < 0 < PLACE.outlet_m


def test_the_axis_passes_the_published_centre_scaled_to_the_true_radius():
    table = claims.published("table_5.12").set_index("quantity")["value_mm"]
    centre = np.array([float(v) for v in table["Center"].strip("[]").split(",")])
    scaled = centre * PLACE.kiln_radius_mm / float(table["Radius"])
    np.testing.assert_allclose(PLACE.axis_far_mm, scaled, atol=0.1)


def test_every_ray_meets_wall_or_plate():
    row, column = np.meshgrid(np.arange(0, 1536, 97.0), np.arange(0, 2048, 113.0))
    depth = PLACE.wall_depth(row, column)
    local = PLACE.to_kiln(PLACE.unproject(row, column, depth))
    radius = np.hypot(local[..., 1], local[..., 2])
    plate = np.isclose(local[..., 0], PLACE.inlet_m)
    np.testing.assert_allclose(radius[~plate], 0.7, atol=1e-6)
    assert (radius[plate] <= 0.7 + 1e-9).all()
    assert plate.any()
    assert not plate.all()


def test_captured_depth_is_the_inverse_of_the_equation_at_the_plates():
    plates = np.array(PLATE_DISTANCES_MM)
    captured = DepthCamera().captured(plates)
    np.testing.assert_allclose(calibrate_depth(captured), plates, atol=1e-6)
    printed = claims.published("depth_calibration").set_index("where")["value"]
    assert captured[4] == pytest.approx(float(printed["captured depth for true 5000 mm"]), abs=0.1)


@pytest.mark.parametrize("distance", [1000.0, 4000.0, 11_000.0])
def test_without_error_the_dots_stand_where_they_are(distance):
    points = see_plate(distance, 500, np.random.default_rng(1), EXACT)
    true = points * (distance / points[:, 2])[:, None]
    inside = (np.abs(true[:, 0]) < 100) & (np.abs(true[:, 1]) < 80)
    centre = np.round(true[inside, :2] / PITCH_MM) * PITCH_MM
    radius = np.hypot(*(true[inside, :2] - centre).T)
    np.testing.assert_allclose(radius, DOT_MM / 2, atol=1e-6)
