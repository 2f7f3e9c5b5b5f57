import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from tests.definitions import otsu

from kilnflight.detection import DoG, Otsu
from kilnflight.detection.otsu import flame_mask, otsu_threshold

GRAYS = hnp.arrays(np.uint16, hnp.array_shapes(max_dims=2, max_side=12))


@given(GRAYS, st.integers(-70_000, 70_000))
def test_threshold_is_the_definition_and_moves_with_an_offset(values, offset):
    found, best = otsu_threshold(values), otsu.thresholds(values)
    assert found in best  # maxima that are equal but for rounding
    assert otsu_threshold(values.astype(np.int64) + offset) == found + offset


def test_ties_go_to_the_lowest_level_and_floats_are_rounded():
    assert otsu_threshold(np.array([0, 0, 10, 10])) == 0
    assert otsu_threshold(np.array([-128, 127], np.int8)) == -128
    assert otsu_threshold(np.array([[0.4, 1.4, 1.5, 2.5], [9.6, 10.2, 11.0, 9.9]])) == 2


@pytest.mark.parametrize("detect", [Otsu(), DoG()])
@pytest.mark.parametrize(
    "shape", [(0, 0), (0, 9), (1, 1), (1, 50), (2, 2), (5, 3), (64, 64)]
)
def test_without_contrast_there_is_nothing(detect, shape):
    for kind in (np.uint8, np.int32, np.float64):
        assert detect(np.full(shape, 200, dtype=kind)).shape == (0, 3)


def test_particles_have_the_centre_and_the_area_of_their_region():
    image, (rows, cols) = np.full((60, 80), 7, dtype=np.uint16), np.ogrid[:60, :80]
    image[(rows - 20) ** 2 + (cols - 30) ** 2 <= 36] = 40_000
    image[45:48, 60:63] = image[48:51, 63:66] = 40_000  # touch at a corner
    image[55, 20:24] = 40_000  # a speck
    expected = [[20, 30, np.sqrt(113 / np.pi)], [47.5, 62.5, np.sqrt(18 / np.pi)]]
    np.testing.assert_allclose(Otsu()(image), expected, atol=1e-9)


def test_what_is_below_the_least_value_is_noise():
    image = np.abs(np.random.default_rng(0).normal(0, 2, (60, 80)))
    assert len(Otsu()(image)) > 0
    assert len(Otsu(9.0)(image)) == 0
    image[10:16, 20:25] += 12
    np.testing.assert_allclose(
        Otsu(9.0)(image), [[12.5, 22, np.sqrt(30 / np.pi)]], atol=0.3
    )


def test_the_flame_is_what_is_bright_in_its_rectangle():
    gray = np.full((40, 60), 5000, np.uint16)
    gray[12:20, 22:30] = gray[2:4, 2:4] = 60_000  # the flame, and something elsewhere
    flame = flame_mask(gray, (10, 25, 20, 40))
    assert flame.shape == gray.shape
    assert flame.sum() == flame[12:20, 22:30].sum() == 64
    assert not flame_mask(np.full((9, 9), 65535, np.uint16), (0, 9, 0, 9)).any()
