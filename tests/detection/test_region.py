"""The region of interest against matplotlib."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.path import Path

from kilnflight.detection.region import inside

HOOK = [(0, 0), (0, 10), (10, 10), (10, 6), (4, 6), (4, 0)]  # not convex


def test_a_corner_is_cut_out_and_the_border_is_inside():
    row, col = [2, 7, 7, 4, 10, 0, 11], [3, 8, 3, 3, 8, 0, 8]
    assert inside(HOOK, row, col).tolist() == [
        True,
        True,
        False,
        True,
        True,
        True,
        False,
    ]
    for row, col, shape in ((3, np.arange(5), (5,)), ([], [], (0,)), (1, 1, ())):
        assert inside(HOOK, row, col).shape == shape


@given(st.integers(0, 2**32 - 1))
def test_inside_is_the_polygon_of_matplotlib(seed):
    rng = np.random.default_rng(seed)
    angles = np.sort(
        rng.uniform(0, 2 * np.pi, 7)
    )  # a star, not convex, without crossings
    corners = np.stack([np.sin(angles), np.cos(angles)], 1) * rng.uniform(3, 20, (7, 1))
    points = rng.uniform(-20, 20, (200, 2))
    within = inside(corners, *points.T)
    np.testing.assert_array_equal(within, Path(corners).contains_points(points))
    np.testing.assert_array_equal(inside(corners[::-1], *points.T), within)
