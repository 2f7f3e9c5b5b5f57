"""What every 2D detector keeps to."""

import re

import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.detection import DETECTORS_2D

pytestmark = pytest.mark.parametrize("detect", DETECTORS_2D, ids=lambda d: type(d).__name__)


def blob(shape=(96, 120), row=40.0, col=70.0, sigma=4.0, height=20_000.0):
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    return height * np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / (2 * sigma**2))


def test_a_blob_is_found(detect):
    found = detect(blob())
    assert found.shape == (1, 3)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found[0, :2], [40, 70], atol=0.05)
    assert 3 < found[0, 2] < 7


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int32, np.float32, np.float64])
@pytest.mark.parametrize("shape", [(0, 0), (0, 9), (1, 1), (1, 50), (2, 2), (5, 3), (64, 64)])
@pytest.mark.parametrize("value", [0, 200])
def test_without_contrast_there_is_nothing(detect, kind, shape, value):
    found = detect(np.full(shape, value, dtype=kind))
    assert found.shape == (0, 3)
    assert found.dtype == np.float64


def test_a_foreground_is_not_changed_and_nothing_is_kept(detect):
    foreground = blob()
    before = foreground.copy()
    first = detect(foreground)
    detect(blob(row=20.0))
    np.testing.assert_array_equal(foreground, before)
    np.testing.assert_array_equal(detect(foreground), first)


def test_views_and_column_order_give_the_same(detect):
    wide = np.zeros((192, 240))
    wide[::2, ::2] = blob()
    for same in (wide[::2, ::2], np.asfortranarray(blob())):
        np.testing.assert_array_equal(detect(same), detect(blob()))


@pytest.mark.parametrize("kind", [">u2", ">f4", "<f2"])
def test_any_byte_order_and_half_floats_give_the_same(detect, kind):
    foreground = blob().round().astype(kind)
    same = foreground.astype(np.float32)
    np.testing.assert_array_equal(detect(foreground), detect(same))


def test_a_shift_moves_the_particles(detect):
    here, there = blob(row=40.0), blob(row=40.0 + 16, col=70.0 - 16)
    np.testing.assert_allclose(detect(there) - detect(here), [[16, -16, 0]], atol=0.02)


def test_a_constant_changes_nothing(detect):
    foreground = blob().round()
    np.testing.assert_allclose(detect(foreground + 30_000), detect(foreground), atol=1e-3)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_what_is_not_finite_is_refused(detect, value):
    foreground = blob()
    foreground[7, 9] = value
    with pytest.raises(InputError, match=rf"{re.escape(str(value))} at row 7, col 9"):
        detect(foreground)


def test_what_is_no_foreground_is_refused(detect):
    for wrong in (np.zeros(5), np.zeros((2, 3, 3)), np.float64(3.0)):
        with pytest.raises(InputError, match="shape"):
            detect(wrong)
    for kind in (bool, complex, str):
        with pytest.raises(InputError, match="pass integers or floats"):
            detect(np.zeros((4, 4)).astype(kind))
