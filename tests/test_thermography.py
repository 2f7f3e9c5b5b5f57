import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.thermography import equalize, wall_profile

RAMP = np.add.outer(np.arange(60.0), np.zeros(80))
WHOLE = ((0, 0), (0, 79), (59, 79), (59, 0))


def test_the_whole_picture_is_itself():
    picture = np.random.default_rng(1).normal(1400, 20, (60, 80))
    np.testing.assert_allclose(equalize(picture, WHOLE, 60, 80), picture, rtol=1e-5)


def floor_seen_in_perspective(length, near=1.0, far=8.0, height=0.7):
    """A floor whose temperature grows linearly from near to far, and the corners of a strip."""
    rows, columns, focal, middle = 400, 400, 300.0, 100.0
    row = np.indices((rows, columns), dtype=float)[0]
    depth = np.where(row > middle, focal * height / np.maximum(row - middle, 1e-6), far)
    picture = 1000.0 + 50.0 * np.clip(depth, near, far)
    corners = []
    for z, side in ((far, -1), (far, 1), (near, 1), (near, -1)):
        corners.append((middle + focal * height / z, 200 + side * focal * length / 2 / z))
    return picture, tuple(corners), far, near


def test_a_strip_in_perspective_gives_an_even_profile():
    """The definition: equal steps along the floor, so a linear temperature stays linear."""
    picture, corners, far, near = floor_seen_in_perspective(0.8)
    profile = wall_profile(picture, corners, rows=141)
    expected = 1000.0 + 50.0 * np.linspace(far, near, 141)
    np.testing.assert_allclose(profile[3:-3], expected[3:-3], atol=3.0)


@given(st.floats(0, 15), st.floats(0, 15), st.floats(25, 45), st.floats(60, 79))
def test_a_constant_picture_has_a_constant_profile(top, left, bottom, right):
    corners = ((top, left + 3), (top, right - 3), (bottom, right), (bottom, left))
    profile = wall_profile(np.full((60, 80), 1423.0), corners, rows=20)
    np.testing.assert_allclose(profile[1:-1], 1423.0, rtol=1e-4)


@pytest.mark.parametrize(
    ("picture", "corners", "message"),
    [
        (RAMP, WHOLE[:3], "four corners"),
        (RAMP[0], WHOLE, "one picture"),
        (RAMP, ((0, 0), (0, 90), (59, 79), (59, 0)), "leave the picture"),
        (RAMP, ((0, 0), (59, 79), (0, 79), (59, 0)), "no convex area"),
        (RAMP * np.nan, WHOLE, "not finite"),
    ],
)
def test_what_is_no_strip_is_told(picture, corners, message):
    with pytest.raises(InputError, match=message):
        wall_profile(picture, corners)
