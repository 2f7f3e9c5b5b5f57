import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tests.definitions.peaks import peaks

from kilnflight.detection.peaks import Evidence, find_peaks

WHOLE, AREA = np.array([0, 40, 0, 60]), np.array([40, 61, 60, 81])


def test_hills_are_counted_highest_first_and_areas_clipped():
    row, col = np.indices((40, 60))
    hills = [(10, 12, 100.0), (25, 40, 50.0), (30, 15, 4.0)]
    image = sum(t * np.exp(-((row - r) ** 2 + (col - c) ** 2) / 8) for r, c, t in hills)
    image = image.astype(np.float32)
    assert find_peaks(image, WHOLE, 10.0)[:, 2] == pytest.approx([100.0, 50.0], abs=0.1)
    areas = np.array(
        [WHOLE, [20, 99, 30, 99], [0, 2, 0, 2], [-5, 20, -5, 30], [-9, -3, -9, -3]]
    )
    found = [find_peaks(image, area, 10.0)[:, :2].tolist() for area in areas]
    assert found == [[[10, 12], [25, 40]], [[25, 40]], [], [[10, 12]], []]


@given(arrays(np.float32, (6, 7), elements=st.integers(0, 6)), st.integers(1, 4))
def test_prominence_is_what_flooding_by_levels_gives(image, prominence):
    found = find_peaks(image, np.array([0, 6, 0, 7]), float(prominence))
    assert {(int(r), int(c)): h for r, c, h in found} == peaks(image, prominence)


@pytest.mark.parametrize("seed", range(12))
def test_areas_have_peaks_exactly_where_peaks_are_found(seed):
    generator = np.random.default_rng(seed)
    shape = (60, 80) if seed % 4 else (180, 220)
    image = generator.normal(size=shape).astype(np.float32)
    image = cv2.GaussianBlur(image, (0, 0), shape[0] / 60 * generator.uniform(0.3, 4))
    image = (
        np.round(4 * image / image.std()) if seed % 3 == 0 else image
    )  # many equal pixels
    areas = np.hstack(
        [np.sort(generator.integers(-3, n + 4, (30, 2)), axis=1) for n in shape]
    )
    prominence = image.std() * generator.uniform(0.3, 4)
    before = generator.integers(0, 9, shape).astype(
        np.float32
    )  # whole, so that pixels stay equal
    evidence = Evidence(image + before, before, prominence, prominence)
    seen = np.abs(evidence.gray - before)
    assert evidence.moved(areas).tolist() == [
        len(find_peaks(seen, area, prominence)) > 0 for area in areas
    ]


def test_the_noise_sets_the_threshold_and_is_hardly_ever_real():
    pairs = (
        np.random.default_rng(0).normal(5000, 20, (20, 2, 120, 160)).astype(np.uint16)
    )
    still = [Evidence.of(*pair) for pair in pairs]
    smoothed = 20.0 / (2 * np.sqrt(np.pi))
    assert still[0].threshold == pytest.approx(5 * smoothed, rel=0.05)
    assert still[0].change_threshold == pytest.approx(
        5 * smoothed * np.sqrt(2), rel=0.05
    )
    assert sum(evidence.real(AREA) for evidence in still) <= 1
