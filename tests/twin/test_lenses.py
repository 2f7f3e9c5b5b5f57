"""Depth on the grid of micro-lenses, on pictures whose depth is known."""

import numpy as np

from kilnflight.twin import scenes
from kilnflight.twin.lenses import (
    LensCamera,
    LensWall,
)
from kilnflight.twin.picture import Blobs, cover

ROWS, COLUMNS = 384, 512
EXACT = LensCamera(
    lenses=(38, 44),  # 11.6 px apart
    wall_points=6000,
    changing=0.0,
    wall_error=1e-9,
    wall_error_near_mm=1e-9,
    white_mm=0.0,
    contrast=5.0,
    half_contrast=1e-3,
    dominance=1.0,
    points_per_pixel=0.9,
)
OPTICS = scenes.ground_truth("V1").optics


class Plate:
    """A textured wall across the line of sight, 6 m away."""

    depth_mm = np.full((ROWS, COLUMNS), 6000.0)

    def __init__(self, texture=200.0):
        row, column = np.indices((ROWS, COLUMNS))
        waves = np.sin(column / 3.0) + np.sin(row / 4.0)
        self.level = (19_000.0 + texture * waves).astype(np.float32)


def disc(radius_px, depth_mm, brightness):
    """One particle in the middle of the picture."""
    one = np.ones(1)
    blobs = Blobs(
        particle=np.zeros(1, dtype=np.intp),
        row=one * 190.3,
        column=one * 250.8,
        spread_px2=radius_px**2 * np.eye(2)[None],
        brightness=one * brightness,
        passes=one * 0,
        softness=one * 0.1,
        dilution=one,
        depth_mm=one * depth_mm,
    )
    return blobs, cover(blobs, ROWS, COLUMNS)


def look(camera, plate, blobs, pixels, error=0.0, seed=1):
    wall = LensWall.of(camera, plate, OPTICS, 20, 3)
    picture = plate.level.copy()
    inside = pixels.radius <= 1
    picture.reshape(-1)[pixels.place[inside]] = blobs.brightness[pixels.blob[inside]]
    labels, random = np.zeros(picture.shape, dtype=np.uint8), np.random.default_rng(seed)
    labels.reshape(-1)[pixels.place[inside]] = 2
    sight = wall.look(picture, (blobs, pixels), np.array([error]), labels, OPTICS, random)
    return wall, sight


def depth_image(wall, sight, seed=2):
    index, depth = wall.points(sight, np.random.default_rng(seed))
    assert len(np.unique(index)) == len(index)
    image = np.full(ROWS * COLUMNS, np.nan)
    image[index] = depth
    return image.reshape(ROWS, COLUMNS)


def test_depths_of_a_particle_reach_beyond_it_and_mix_with_the_wall():
    wall, sight = look(EXACT, Plate(), *disc(12.0, 4000.0, 40_000.0))
    image = depth_image(wall, sight)
    row, column = np.indices(image.shape)
    off = np.hypot(row - 190.3, column - 250.8)
    known = np.isfinite(image)
    assert np.nanmax(np.abs(image[off > 40] - 6000.0)) < 0.1
    rim = known & (off > 7) & (off < 12)
    assert 4000.0 <= np.median(image[rim]) < 4060.0  # the wall's texture draws a little
    beyond = known & (off > 13) & (off < 17)
    assert np.mean(image[beyond] < 5000.0) > 0.7  # fattening
    mixed = known & (image > 4150.0) & (image < 5850.0)
    assert mixed.any()
    assert off[mixed].min() > 12
    assert off[mixed].max() < 30


def test_an_overexposed_middle_has_no_depth():
    wall, sight = look(EXACT, Plate(), *disc(25.0, 4000.0, 65_535.0))
    image = depth_image(wall, sight)
    row, column = np.indices(image.shape)
    off = np.hypot(row - 190.3, column - 250.8)
    known = np.isfinite(image)
    assert known[(off > 19) & (off < 25)].mean() > 0.7
    assert not known[off < 14].any()
