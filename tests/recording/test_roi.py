import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.path import Path

from kilnflight.camera import inside
from kilnflight.checks import InputError

HOOK = [(0, 0), (0, 10), (10, 10), (10, 6), (4, 6), (4, 0)]  # not convex
coordinates = st.tuples(st.integers(0, 20), st.integers(0, 20))


def test_a_corner_is_cut_out_and_the_border_is_inside():
    row, col = [2, 7, 7, 4, 10, 0, 11], [3, 8, 3, 3, 8, 0, 8]
    assert inside(HOOK, row, col).tolist() == [True, True, False, True, True, True, False]


@given(st.lists(coordinates, min_size=3, max_size=8, unique=True), st.integers(0, 2**32 - 1))
def test_inside_is_what_counting_edges_and_matplotlib_say(corners, seed):
    if np.linalg.matrix_rank(np.subtract(corners, corners[0])) < 2:
        return
    points = np.random.default_rng(seed).uniform(-2, 22, (200, 2))
    expected = np.array([_even_odd(corners, p) for p in points])
    found = inside(corners, *points.T)
    np.testing.assert_array_equal(found, expected)
    if len(corners) == 3:
        np.testing.assert_array_equal(found, Path(corners).contains_points(points))
    turned = inside(np.roll(corners, 1, axis=0)[::-1], *points.T)
    np.testing.assert_array_equal(turned, found)
    assert inside(corners, *np.transpose(corners)).all()


def _even_odd(corners, point):
    """How many edges a walk along the row meets, in plain code."""
    crossings = 0
    for (r0, c0), (r1, c1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (r0 > point[0]) != (r1 > point[0]):
            crossings += c0 + (point[0] - r0) * (c1 - c0) / (r1 - r0) > point[1]
    return crossings % 2 == 1


def test_the_shape_of_the_pixels_comes_back():
    row, col = np.mgrid[:12, :9]
    assert inside(HOOK, row, col).shape == (12, 9)
    assert inside(HOOK, 3, np.arange(5)).shape == (5,)
    assert inside(HOOK, [], []).shape == (0,)
    assert inside(HOOK, 1, 1, shape=(1536, 2048)).shape == ()


@pytest.mark.parametrize(
    ("polygon", "shape", "message"),
    [
        ([], None, "shape"),
        ([(0, 0), (5, 5)], None, r"2 different corner\(s\)"),
        ([(0, 0), (5, 5), (0, 0)], None, r"2 different corner\(s\)"),
        ([(0, 0), (5, 5), (9, 9)], None, "in one line"),
        ([(0, 0), (5, np.nan), (9, 9)], None, "polygon: 1 value"),
        ([(0, 0, 0)] * 4, None, r"shape \(4, 3\)"),
        ([(0, 3000), (9, 3000), (9, 3100)], (1536, 2048), "beside the image of 1536 x 2048"),
        ([(-9, 5), (-5, 9), (-5, 5)], (1536, 2048), "beside the image"),
    ],
)
def test_a_polygon_that_is_none_is_told(polygon, shape, message):
    with pytest.raises(InputError, match=message):
        inside(polygon, 1, 1, shape)


def test_pixels_that_are_none_are_told():
    with pytest.raises(InputError, match="row"):
        inside(HOOK, np.nan, 1)
