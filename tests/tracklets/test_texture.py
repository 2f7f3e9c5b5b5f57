"""Texture energies of streaks, and their part in the choice of pairs."""

import numpy as np
import pytest
from scipy.ndimage import correlate1d
from tests.definitions.plain_tracklets import make_table

from kilnflight.tracklets import Connection, tracked
from kilnflight.tracklets.texture import (
    LAWS_EDGE,
    LAWS_LEVEL,
    level_edge,
    texture_energy,
)


def streak(angle_deg, size=101):
    """A ridge through the middle, counted from straight down."""
    rows, cols = np.mgrid[:size, :size] - size // 2
    turned = np.deg2rad(angle_deg)
    across = cols * np.cos(turned) - rows * np.sin(turned)
    return 1000.0 * np.exp(-((across / 5.0) ** 2) / 2)


@pytest.mark.parametrize("angle", [0.0, 30.0, 45.0, 90.0, 135.0])
def test_the_energy_is_that_of_scipy_and_shows_a_streak(angle):
    image = streak(angle) + np.random.default_rng(0).random((101, 101))
    masks = [(LAWS_LEVEL, LAWS_EDGE), (LAWS_EDGE, LAWS_LEVEL)]
    both = [correlate1d(correlate1d(image, a, 0, mode="nearest"), b, 1, mode="nearest")
            for a, b in masks]  # fmt: skip
    found = texture_energy(image, LAWS_LEVEL, LAWS_EDGE)
    assert found == pytest.approx(np.abs(both).sum() / 2, rel=1e-9)
    mean = texture_energy(image, LAWS_LEVEL, LAWS_EDGE, average=True)
    assert mean == pytest.approx(found / image.size, rel=1e-9)  # no response is zero
    assert found > 30 * texture_energy(image - streak(angle), LAWS_LEVEL, LAWS_EDGE)
    assert texture_energy(np.full((20, 20), 3.0), LAWS_LEVEL, LAWS_EDGE) == 0.0


@pytest.mark.parametrize(
    ("start", "end", "box", "rows", "cols"),
    [
        ((50, 60), (70, 60), (48, 73, 43, 78), (2, 23), (2, 33)),  # down
        ((50, 60), (50, 80), (33, 68, 58, 83), (2, 33), (2, 23)),  # across
        ((70, 60), (50, 60), (48, 73, 43, 78), (2, 23), (2, 33)),  # up
        (
            (50, 60),
            (50, 60),
            (48, 53, 43, 78),
            (2, 3),
            (2, 33),
        ),  # the same place: one line
        ((3, 4), (9, 4), (1, 12, 0, 22), (2, 9), (0, 20)),  # at the border of the image
    ],
)
def test_the_box_and_the_parallelogram(start, end, box, rows, cols):
    image = np.random.default_rng(0).random((100, 120))
    frames = np.stack([0 * image + 9, image / 2, image / 2])
    window = image[slice(*box[:2]), slice(*box[2:])]
    inside = np.zeros(window.shape, bool)
    inside[slice(*rows), slice(*cols)] = True
    found = level_edge(np.array(start, float), np.array(end, float), (1, 2), frames)
    assert found == pytest.approx(texture_energy(window, LAWS_LEVEL, LAWS_EDGE, inside))
    assert (
        level_edge(np.array([500.0, 20.0]), np.array([520.0, 20.0]), (1, 2), frames)
        == 0.0
    )


def test_the_streak_decides_which_tracklets_are_connected():
    """Two continue the first equally well; the picture shows which one it was."""
    frame, later = np.arange(6), np.arange(12, 18)
    sides = [
        (later, 80.0 + 8 * later, 150.0 + side * 2.0 * (later - 5)) for side in (-1, 1)
    ]
    tracks = make_table((frame, 80.0 + 8 * frame, 150.0), *sides)
    centre = 150 + np.maximum(0.0, 0.25 * (np.arange(300) - 120))
    image = 1e6 * np.exp(-(((np.arange(300) - centre[:, None]) / 4) ** 2))
    for seen, joined in ((image, 2), (image[:, ::-1], 1)):
        frames = np.broadcast_to(seen / 18, (18, 300, 300))
        result = tracked(Connection()(tracks, frames))
        assert set(result.index[result["particle"] == 0] // 6) == {0, joined}
