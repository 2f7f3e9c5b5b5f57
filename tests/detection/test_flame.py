import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.detection.flame import segment_flame


def picture():
    gray = np.full((40, 60), 5000, np.uint16)
    gray[12:20, 22:30] = 60_000  # the flame
    gray[2:4, 2:4] = 60_000  # something bright elsewhere
    return gray


def test_the_flame_is_what_is_bright_in_its_rectangle():
    flame = segment_flame(picture(), (10, 25, 20, 40))
    assert flame.mask.shape == (15, 20)
    assert flame.mask.sum() == 64
    foreground = picture().astype(np.float32)
    cleared = flame.cover(foreground)
    assert cleared[12:20, 22:30].max() == 0
    assert cleared[2, 2] == 60_000
    assert foreground[15, 25] == 60_000  # not changed in place


def test_its_points_are_known_by_their_pixels():
    flame = segment_flame(picture(), (10, 25, 20, 40))
    pixels = np.array([[15, 25], [11, 21], [3, 3], [39, 59]])
    assert flame.holds(pixels).tolist() == [True, False, False, False]
    assert flame.holds(np.empty((0, 2), int)).shape == (0,)


def test_a_rectangle_of_one_grey_value_has_no_flame():
    assert not segment_flame(np.full((9, 9), 65535, np.uint16), (0, 9, 0, 9)).mask.any()


@pytest.mark.parametrize("rectangle", [(0, 41, 0, 10), (5, 5, 0, 10), (-1, 5, 0, 10), (0, 5, 9, 3)])
def test_a_rectangle_outside_the_image_is_refused(rectangle):
    with pytest.raises(InputError, match="not inside the image"):
        segment_flame(picture(), rectangle)
