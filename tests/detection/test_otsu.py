import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from kilnflight.checks import InputError
from kilnflight.detection import Otsu, otsu_threshold

grays = hnp.arrays(np.uint16, hnp.array_shapes(max_dims=2, max_side=12))


def threshold_by_definition(values):
    """Eqs 2.11 to 2.18 with exact whole numbers, one level at a time."""
    line = sorted(int(v) for v in np.ravel(values))
    best, chosen = (-1, 1), line[0]
    for k in sorted(set(line))[:-1]:
        below = [v for v in line if v <= k]
        above = [v for v in line if v > k]
        difference = sum(above) * len(below) - sum(below) * len(above)
        eta = (difference**2, len(below) * len(above))  # eta up to a constant, as a fraction
        if eta[0] * best[1] > best[0] * eta[1]:
            best, chosen = eta, k
    return chosen


def between_class_variance(values, k):
    below, above = (values[side].astype(float) for side in (values <= k, values > k))
    return below.size * above.size * (above.mean() - below.mean()) ** 2


@settings(deadline=None)  # the first call compiles
@given(grays)
def test_threshold_is_the_definition(values):
    found, expected = otsu_threshold(values), threshold_by_definition(values)
    if found != expected:  # maxima that are equal but for rounding
        one, other = (between_class_variance(values, k) for k in (found, expected))
        assert one == pytest.approx(other, rel=1e-12)


def test_threshold_of_8_bits_is_opencvs():
    generator = np.random.default_rng(3)
    for _ in range(20):
        image = generator.normal(generator.choice([60, 180], (40, 50)), 20)
        image = image.clip(0, 255).astype(np.uint8)
        peer, _ = cv2.threshold(image, 0, 255, cv2.THRESH_OTSU)
        assert otsu_threshold(image) == peer


@settings(deadline=None)
@given(grays, st.integers(-70_000, 70_000))
def test_a_constant_added_to_all_moves_the_threshold_by_it(values, constant):
    moved = values.astype(np.int64) + constant
    assert otsu_threshold(moved) == otsu_threshold(values) + constant


def test_of_equal_maxima_the_lowest_is_taken():
    assert otsu_threshold(np.array([0, 0, 10, 10])) == 0
    assert otsu_threshold(np.array([0, 1, 2])) == 0


def test_floats_are_rounded_to_gray_values():
    values = np.array([[0.4, 1.4, 1.5, 2.5], [9.6, 10.2, 11.0, 9.9]])
    assert otsu_threshold(values) == otsu_threshold(np.rint(values).astype(np.uint16)) == 2


def disc(shape, row, col, radius):
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    return (rows - row) ** 2 + (cols - col) ** 2 <= radius**2


@pytest.mark.parametrize("kind", [np.uint16, np.float32, np.float64])
def test_particles_have_the_centre_and_the_area_of_their_region(kind):
    image = np.full((60, 80), 7, dtype=kind)
    regions = [disc(image.shape, 20, 30.5, 6), disc(image.shape, 45, 60, 3)]
    image[regions[0] | regions[1]] = 40_000
    found = Otsu()(image)
    np.testing.assert_allclose(found[:, :2], [[20, 30.5], [45, 60]], atol=1e-9)
    np.testing.assert_allclose(found[:, 2], [np.sqrt(r.sum() / np.pi) for r in regions])


def test_regions_that_touch_at_a_corner_are_one_and_specks_are_none():
    image = np.zeros((30, 30), dtype=np.uint16)
    image[5:8, 5:8] = image[8:11, 8:11] = 900
    image[20, 20:24] = 900
    np.testing.assert_allclose(Otsu()(image)[:, :2], [[7.5, 7.5]])
    assert len(Otsu(smallest_px=4)(image)) == 2


def test_saturated_frames():
    assert Otsu()(np.full((20, 20), 65535, dtype=np.uint16)).shape == (0, 3)
    image = np.zeros((40, 40), dtype=np.uint16)
    image[10:30, 12:32] = 65535
    np.testing.assert_allclose(Otsu()(image), [[19.5, 21.5, 20 / np.sqrt(np.pi)]])


def test_a_rectangle_without_values_is_refused():
    with pytest.raises(InputError, match="no values"):
        otsu_threshold(np.zeros((0, 4)))
    with pytest.raises(InputError, match="span more than 65536"):
        otsu_threshold(np.array([0.0, 70_000.0]))
    with pytest.raises(InputError, match="nan at row 0, col 1"):
        otsu_threshold(np.array([0.0, np.nan]))
    with pytest.raises(InputError, match="smallest_px"):
        Otsu(smallest_px=0)
