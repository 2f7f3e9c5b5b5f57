import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from tests.definitions import otsu

from kilnflight.checks import InputError
from kilnflight.detection import Otsu
from kilnflight.detection.otsu import flame_mask, otsu_threshold

GRAYS = hnp.arrays(np.uint16, hnp.array_shapes(max_dims=2, max_side=12))


@given(GRAYS, st.integers(-70_000, 70_000))
def test_threshold_is_the_definition_and_moves_with_an_offset(values, offset):
    found, best = otsu_threshold(values), otsu.thresholds(values)
    assert found in best  # maxima that are equal but for rounding
    assert otsu_threshold(values.astype(np.int64) + offset) == found + offset


def test_threshold_of_8_bits_is_opencvs():
    generator = np.random.default_rng(3)
    for _ in range(10):
        image = generator.normal(generator.choice([60, 180], (40, 50)), 20)
        image = image.clip(0, 255).astype(np.uint8)
        assert otsu_threshold(image) == cv2.threshold(image, 0, 255, cv2.THRESH_OTSU)[0]


def test_ties_go_to_the_lowest_level_and_floats_are_rounded():
    assert otsu_threshold(np.array([0, 0, 10, 10])) == 0
    assert otsu_threshold(np.array([-128, 127], np.int8)) == -128
    assert otsu_threshold(np.array([[0.4, 1.4, 1.5, 2.5], [9.6, 10.2, 11.0, 9.9]])) == 2


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_particles_have_the_centre_and_the_area_of_their_region(kind):
    image, (rows, cols) = np.full((60, 80), 7, dtype=kind), np.ogrid[:60, :80]
    regions = [(rows - 20) ** 2 + (cols - 30.5) ** 2 <= 36, (rows - 45) ** 2 + (cols - 60) ** 2 < 9]
    image[regions[0] | regions[1]] = 40_000
    found = Otsu()(image)
    np.testing.assert_allclose(found[:, :2], [[20, 30.5], [45, 60]], atol=1e-9)
    np.testing.assert_allclose(found[:, 2], [np.sqrt(r.sum() / np.pi) for r in regions])


def test_regions_that_touch_at_a_corner_are_one_and_specks_are_none():
    image = np.zeros((30, 30), dtype=np.uint16)
    image[5:8, 5:8] = image[8:11, 8:11] = 900
    image[20, 20:24] = 900
    np.testing.assert_allclose(Otsu()(image)[:, :2], [[7.5, 7.5]])


def test_values_without_a_threshold_are_refused():
    for values in (np.zeros((0, 4)), np.array([0.0, 70_000.0]), np.array([0.0, np.nan])):
        with pytest.raises(InputError, match="values"):
            otsu_threshold(values)


def test_the_flame_is_what_is_bright_in_its_rectangle():
    gray = np.full((40, 60), 5000, np.uint16)
    gray[12:20, 22:30] = gray[2:4, 2:4] = 60_000  # the flame, and something elsewhere
    flame = flame_mask(gray, (10, 25, 20, 40))
    assert flame.shape == gray.shape
    assert flame.sum() == flame[12:20, 22:30].sum() == 64
    assert not flame_mask(np.full((9, 9), 65535, np.uint16), (0, 9, 0, 9)).any()
    for wrong in ((0, 41, 0, 10), (5, 5, 0, 10), (-1, 5, 0, 10), (0, 5, 9, 3)):
        with pytest.raises(InputError, match="rectangle"):
            flame_mask(gray, wrong)
