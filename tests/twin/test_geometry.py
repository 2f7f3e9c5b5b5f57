import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.project import claims
from kilnflight.twin.geometry import Geometry

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


def test_kiln_axes_are_right_angles_and_point_where_they_say():
    np.testing.assert_allclose(PLACE.axes @ PLACE.axes.T, np.eye(3), atol=1e-12)
    assert PLACE.axes[0, 2] < -0.99  # towards the camera: depth falls
    assert PLACE.axes[1, 0] > 0.99
    assert PLACE.axes[2, 1] > 0.99


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


def test_what_no_camera_could_see_is_refused():
    with pytest.raises(InputError, match="lance_depth_mm"):
        Geometry(lance_depth_mm=0.0)
