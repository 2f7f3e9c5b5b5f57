"""Background, appearance, drawing, optics and depth, on a small camera."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.camera import PLATE_DISTANCES_MM, calibrate_depth
from kilnflight.checks import InputError
from kilnflight.project import claims
from kilnflight.twin import drawing
from kilnflight.twin.appearance import Blobs
from kilnflight.twin.background import Background, Surroundings
from kilnflight.twin.depth import DepthCamera
from kilnflight.twin.geometry import Geometry
from kilnflight.twin.optics import Optics

SMALL = replace(
    Geometry(), rows=192, columns=256, focal_length_px=85.0 / 0.088, lance_pixel=(60.5, 117.0)
)
AROUND = Surroundings(flame_roi=(70, 122, 22, 78), edge_px=11)
BACK = Background(SMALL, Optics(), AROUND, seed=2)


def blobs(row, column, half, brightness=20_000.0, adds=True, softness=0.05):
    shape = np.diag([float(half[0]) ** 2, float(half[1]) ** 2])[None]
    one = np.array([float(row)])
    return Blobs(
        np.array([0]),
        one,
        np.array([float(column)]),
        shape,
        np.array([brightness]),
        np.array([adds]),
        np.array([softness]),
        np.ones(1),
        np.array([5000.0]),
    )


def test_planck_doubles_where_it_should():
    optics = Optics()
    assert optics.glow(optics.wall_k) == pytest.approx(optics.wall_level)
    ratio = optics.glow(1400.0) / optics.glow(1300.0)
    exact = np.exp(0.014388 / 0.65e-6 * (1 / 1300 - 1 / 1400))
    assert ratio == pytest.approx(exact)
    assert optics.glow(300.0) < 1e-9
    assert optics.glow(1e5) == 65535.0


def test_noise_has_a_floor_and_grows_with_light():
    optics = Optics()
    assert optics.noise(0.0) == optics.read_noise
    assert optics.noise(20_000.0) == pytest.approx(np.sqrt(40.0**2 + 0.6 * 20_000.0))


def test_the_plate_is_darker_than_the_wall():
    point = SMALL.to_kiln(SMALL.unproject(*np.indices((192, 256)), BACK.depth_mm))
    plate = np.isclose(point[..., 0], SMALL.inlet_m)
    assert BACK.level[plate].mean() < 0.7 * BACK.level[~plate].mean()


def test_a_picture_depends_on_time_alone():
    one = BACK.at(0.37)
    BACK.at(5.0)
    np.testing.assert_array_equal(one, BACK.at(0.37))
    np.testing.assert_array_equal(one, Background(SMALL, Optics(), AROUND, seed=2).at(0.37))
    assert not np.array_equal(one, Background(SMALL, Optics(), AROUND, seed=3).at(0.37))


def test_flicker_has_its_strength_and_its_pace():
    times = np.arange(0.0, 12.0, 0.05)
    spot = np.array([BACK.at(t)[150, 200] for t in times]) / BACK.level[150, 200]
    expected = np.hypot(AROUND.flicker, AROUND.common_flicker)
    assert spot.std() == pytest.approx(expected, rel=0.5)
    assert spot.mean() == pytest.approx(1.0, abs=0.01)
    near = [BACK.at(t)[150, 200] / BACK.at(t + 1 / 330)[150, 200] for t in times[:40]]
    assert np.std(near) < 0.4 * expected


def test_the_burner_saturates_inside_its_rectangle_only():
    first, last, left, right = AROUND.flame_roi
    added = BACK.at(1.0) - BACK.level
    outside = added.copy()
    outside[first:last, left:right] = 0
    assert np.abs(outside).max() < 2000
    assert (BACK.at(1.0)[first:last, left:right] > 65535).mean() > 0.01


@given(st.floats(20, 170), st.floats(20, 230), st.floats(2.0, 12.0), st.floats(2.0, 12.0))
def test_a_drawn_ellipse_has_its_area_and_centre(row, column, a, b):
    pixels = drawing.cover(blobs(row, column, (a, b)), 192, 256)
    inside = pixels.place[pixels.radius <= 1]
    assert len(inside) == pytest.approx(np.pi * a * b, rel=0.2, abs=8)
    assert np.mean(inside // 256) == pytest.approx(row, abs=0.6)
    assert np.mean(inside % 256) == pytest.approx(column, abs=0.6)
    assert len(np.unique(pixels.place)) == len(pixels.place)


def test_what_lies_outside_the_picture_is_cut_off():
    for row, column in ((-50.0, 100.0), (0.0, 0.0), (191.0, 255.0), (1e6, 1e6)):
        pixels = drawing.cover(blobs(row, column, (6, 6)), 192, 256)
        assert (pixels.place >= 0).all()
        assert (pixels.place < 192 * 256).all()


def test_a_flame_adds_and_a_body_covers():
    for adds, level in ((True, 5000.0 + 3000.0), (False, 3000.0)):
        picture = np.full((192, 256), 5000.0, dtype=np.float32)
        one = blobs(90, 120, (8, 8), brightness=3000.0, adds=adds)
        drawing.paint(picture, one, drawing.cover(one, 192, 256), Optics())
        assert picture[90, 120] == pytest.approx(level, rel=1e-3)
        assert picture[0, 0] == 5000.0


@pytest.mark.parametrize(
    ("half", "contrast", "visible"),
    [
        ((4, 4), 3000.0, True),
        ((4, 4), 3.5 * 68.0, True),
        ((4, 4), 2.5 * 68.0, False),  # too faint
        ((0.6, 0.6), 3000.0, False),  # too small: fewer than five pixels
    ],
)
def test_visible_is_what_a_person_would_mark(half, contrast, visible):
    """Contrast over three times the noise (68 at 5000) over at least five pixels."""
    picture = np.full((192, 256), 5000.0, dtype=np.float32)
    one = blobs(90, 120, half, brightness=contrast)
    _, seen = drawing.paint(picture, one, drawing.cover(one, 192, 256), Optics())
    assert seen[0] == visible


def test_nothing_is_visible_before_a_saturated_flame():
    picture = np.full((192, 256), 90_000.0, dtype=np.float32)
    one = blobs(90, 120, (5, 5))
    _, seen = drawing.paint(picture, one, drawing.cover(one, 192, 256), Optics())
    assert not seen[0]


def test_captured_depth_is_the_inverse_of_the_equation_at_the_plates():
    plates = np.array(PLATE_DISTANCES_MM)
    captured = DepthCamera().captured(plates)
    np.testing.assert_allclose(calibrate_depth(captured), plates, atol=1e-6)
    printed = claims.published("depth_calibration").set_index("where")["value"]
    assert captured[4] == pytest.approx(float(printed["captured depth for true 5000 mm"]), abs=0.1)


@given(st.floats(500, 12_000), st.floats(500, 12_000))
def test_captured_depth_keeps_the_order(one, two):
    near, far = DepthCamera().captured(np.sort([one, two]))
    assert near <= far


def test_the_wall_scatters_most_at_three_metres():
    camera = DepthCamera()
    scale = camera.wall_scale(np.array([3000.0, 4000.0, 8000.0]))
    assert scale[0] > scale[2] > scale[1]
    double = replace(camera, scale=2.0).wall_scale(np.array([8000.0]))
    np.testing.assert_allclose(double, 2 * scale[2])


def test_optics_without_light_are_refused():
    with pytest.raises(InputError, match="wall_level"):
        Optics(wall_level=0.0)
