"""Properties of every 2D detector."""

import numpy as np
import pytest

from kilnflight.detection import DETECTORS_2D

pytestmark = pytest.mark.parametrize("detect", DETECTORS_2D, ids=lambda d: type(d).__name__)


def blob(row=40.0, col=70.0, sigma=4.0, height=20_000.0):
    rows, cols = np.ogrid[:96, :120]
    return height * np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / (2 * sigma**2))


@pytest.mark.parametrize("shape", [(0, 0), (0, 9), (1, 1), (1, 50), (2, 2), (5, 3), (64, 64)])
def test_without_contrast_there_is_nothing(detect, shape):
    for kind in (np.uint8, np.int32, np.float64):
        assert detect(np.full(shape, 200, dtype=kind)).shape == (0, 3)


def test_a_shift_moves_the_particles_and_an_offset_does_nothing(detect):
    here, there = detect(blob()), detect(blob(row=56.0, col=54.0))
    assert here.shape == (1, 3)
    np.testing.assert_allclose(there - here, [[16, -16, 0]], atol=0.02)
    whole = blob().round()
    np.testing.assert_allclose(detect(whole + 30_000), detect(whole), atol=1e-3)
