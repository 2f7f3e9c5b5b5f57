import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.simulated.kiln import picture as drawing
from kilnflight.simulated.kiln.light import Optics
from kilnflight.simulated.kiln.picture import Blobs


def blobs(row, column, half, brightness=20_000.0, adds=True, softness=0.05):
    shape = np.diag([float(half[0]) ** 2, float(half[1]) ** 2])[None]
    single = np.array([float(row)])
    return Blobs(
        row=single,
        column=np.array([float(column)]),
        ellipse_px2=shape,
        brightness=np.array([brightness]),
        passes=np.array([adds]),
        softness=np.array([softness]),
        dilution=np.ones(1),
        depth_mm=np.array([5000.0]),
    )


@given(
    st.floats(20, 170), st.floats(20, 230), st.floats(2.0, 12.0), st.floats(2.0, 12.0)
)
def test_a_drawn_ellipse_has_its_area_and_centre(row, column, a, b):
    pixels = drawing.cover(blobs(row, column, (a, b)), 192, 256)
    inside = pixels.place[pixels.radius <= 1]
    assert len(inside) == pytest.approx(np.pi * a * b, rel=0.2, abs=8)
    assert np.mean(inside // 256) == pytest.approx(row, abs=0.6)
    assert np.mean(inside % 256) == pytest.approx(column, abs=0.6)
    assert len(np.unique(pixels.place)) == len(pixels.place)


def test_a_flame_adds_and_a_body_covers():
    for adds, level in ((True, 5000.0 + 3000.0), (False, 3000.0)):
        picture = np.full((192, 256), 5000.0, dtype=np.float32)
        single = blobs(90, 120, (8, 8), brightness=3000.0, adds=adds)
        drawing.paint(picture, single, drawing.cover(single, 192, 256), Optics())
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
    single = blobs(90, 120, half, brightness=contrast)
    _, visible_particles = drawing.paint(
        picture, single, drawing.cover(single, 192, 256), Optics()
    )
    assert visible_particles[0] == visible
