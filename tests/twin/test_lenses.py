"""Depth on the grid of micro-lenses, on pictures whose depth is known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from kilnflight.camera import EQUATION_2_4
from kilnflight.twin import scenes
from kilnflight.twin.camera import FULL_SCALE, DepthCamera
from kilnflight.twin.lenses import (
    Lattice,
    LensCamera,
    LensWall,
    _block_means,
    _interpolated,
    _kept_points,
    measure_contrast,
)
from kilnflight.twin.particles import Burst
from kilnflight.twin.picture import Blobs, cover
from kilnflight.twin.scene import Scene, Twin

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


def test_a_linear_function_is_interpolated_exactly():
    lattice = Lattice(ROWS, COLUMNS, (38, 44))
    centre = np.arange(lattice.size)
    row, column = np.divmod(centre, 44)
    down, right = (row + 0.5) * ROWS / 38, (column + 0.25 + 0.5 * (row % 2)) * lattice.pitch_px
    values = (3.0 * down - 2.0 * right).astype(np.float32)
    at = np.array([100, 201, 300]), np.array([60, 255, 400])
    expected = 3.0 * at[0] - 2.0 * at[1]
    assert _interpolated(values, *lattice.between(*at)) == pytest.approx(expected, abs=0.01)
    lens, weight = lattice.between(*np.indices((ROWS, COLUMNS)).reshape(2, -1))
    assert lens.min() >= 0
    assert lens.max() < lattice.size
    assert weight.min() >= 0
    assert weight.sum(axis=0) == pytest.approx(1.0, abs=1e-5)


def test_contrast_is_the_variance_within_a_lens():
    lattice = Lattice(ROWS, COLUMNS, (38, 44))
    picture = np.random.default_rng(0).normal(5.0, 2.0, (ROWS, COLUMNS)).astype(np.float32)
    seen = measure_contrast(picture, lattice)
    block = lattice.block_px
    window = picture[10 * block : 13 * block, 20 * block : 23 * block]
    assert seen.variance[11, 21] == pytest.approx(window.var(), rel=1e-4)
    assert seen.mean[11, 21] == pytest.approx(window.mean(), rel=1e-5)


def test_contrast_near_particles_is_that_of_the_whole_picture():
    rng, lattice = np.random.default_rng(1), Lattice(ROWS, COLUMNS, (38, 44))
    picture = rng.normal(30_000.0, 20_000.0, (ROWS, COLUMNS)).astype(np.float32)
    asked = rng.random(lattice.blocks) < 0.01
    asked[0, 0] = asked[-1, -1] = True
    part = measure_contrast(picture, lattice, FULL_SCALE, asked)
    whole = measure_contrast(np.minimum(picture, np.float32(FULL_SCALE)), lattice)
    for one, other in zip(part, whole, strict=True):
        assert np.array_equal(one[asked], other[asked])
    means = cv2.resize(picture, lattice.blocks[::-1], interpolation=cv2.INTER_AREA)
    of_opencv = cv2.blur(means, (3, 3))
    np.testing.assert_allclose(measure_contrast(picture, lattice).mean, of_opencv, rtol=1e-6)


def test_blocks_that_the_picture_cuts_have_the_mean_of_what_is_there():
    picture = np.arange(9 * 14, dtype=np.float32).reshape(9, 14)
    means, squares = _block_means(picture, np.ones((3, 4), np.uint8), 4, np.float32(np.inf))
    assert means[2, 3] == picture[8:, 12:].mean()
    assert squares[2, 3] == (picture[8:, 12:] ** 2).mean()


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


@pytest.mark.parametrize(("radius_px", "brighter", "found"), [(8.0, 3000, True), (8.0, 250, False)])
def test_little_contrast_gives_no_depth(radius_px, brighter, found):
    _, sight = look(EXACT, Plate(texture=20.0), *disc(radius_px, 4000.0, 19_000.0 + brighter))
    assert bool(sight.valid.any()) == found


def test_small_particles_lose_depth_before_large_ones():
    camera, plate = replace(EXACT, contrast=10.0), Plate(texture=20.0)
    valid = [
        look(camera, plate, *disc(radius, 4000.0, 21_500.0))[1].valid.any() for radius in (1.0, 8.0)
    ]
    assert valid == [False, True]


def test_the_bias_stays_and_the_rest_changes():
    plate = Plate()
    camera = replace(EXACT, wall_error=0.02, wall_error_near_mm=60.0, changing=0.1)
    nothing = disc(5.0, 4000.0, 19_000.0)
    wall, sight = look(camera, plate, *nothing)
    both = [depth_image(wall, sight, seed) for seed in (5, 6)]
    known = np.isfinite(both[0]) & np.isfinite(both[1])
    first, second = (image[known] - 6000.0 for image in both)
    assert np.corrcoef(first, second)[0, 1] > 0.7
    assert (first != second).all()
    steps = np.abs(np.diff(both[0], axis=1))
    assert np.nanmax(steps) < 60.0  # continuous: a lens's error is spread over 11.6 px


def test_a_particle_has_its_own_error_the_larger_the_lower_its_contrast():
    camera = replace(EXACT, half_contrast=20.0)
    added = []
    for brightness in (60_000.0, 22_000.0):
        both = [
            depth_image(*look(camera, Plate(50.0), *disc(9.0, 4000.0, brightness), error=error))
            for error in (0.0, 50.0)
        ]
        added.append(np.nanmedian((both[1] - both[0])[183:198, 243:259]))
    assert 45.0 < added[0] < 55.0 < added[1] < 120.0


def test_a_flame_of_the_burner_hides_the_wall():
    plate = Plate()
    wall, sight = look(EXACT, plate, *disc(5.0, 4000.0, 19_000.0))
    hidden = np.zeros((ROWS, COLUMNS), dtype=bool)
    hidden[100:300, 100:300] = True
    image = depth_image(wall, sight._replace(hidden=hidden.reshape(-1)))
    assert not np.isfinite(image[hidden]).any()
    assert np.isfinite(image[~hidden]).sum() > 3000


def test_a_picture_without_texture_has_no_depth_but_of_the_particle():
    wall, sight = look(EXACT, Plate(texture=0.0), *disc(8.0, 4000.0, 40_000.0))
    near = depth_image(wall, sight)
    assert np.isfinite(near).sum() > 100
    assert np.nanmax(np.abs(near - 4000.0)) < 1.0


def test_the_wall_scatters_as_the_plate_without_steps():
    camera = LensCamera()
    depth = np.arange(1000.0, 9000.0, 1.0)
    scale = camera.wall_scale(depth)
    assert camera.wall_scale(3000.0) == pytest.approx(1000.0 / 6, rel=0.03)  # "exceeds 1 m"
    assert camera.wall_scale(np.array([4000.0, 8000.0])) == pytest.approx([88.0, 176.0])
    assert np.abs(np.diff(scale)).max() < 1.0


def few(seed=4):
    feed = (Burst("wood chip", 20, -0.3, 0.3), Burst("confetti", 20, -0.3, 0.3))
    return Twin(scenes.downscaled(scenes.second(Scene("few", feed, 20, seed))))


def test_frames_of_a_scene_have_points_of_wall_and_particles_in_any_order():
    twin, again = few(), few()
    other, frame = twin.frame(11), twin.frame(10)
    assert np.array_equal(frame.xyz, again.frame(10).xyz)
    assert not np.array_equal(frame.pixels, other.pixels)
    assert np.isfinite(frame.xyz).all()
    assert frame.xyz[:, 2].min() > 0
    places = frame.pixels[:, 0] * 512 + frame.pixels[:, 1]
    assert len(np.unique(places)) == len(places)
    view = twin.view(10)
    known = twin.particles_with_depth(10, view)
    assert 0 < len(known) <= len(view.visible)


def test_the_captured_depth_is_the_inverse_of_the_equation():
    true = np.concatenate([np.arange(1000.0, 4900.0, 37.0), np.arange(4960.0, 12_000.0, 37.0)])
    assert EQUATION_2_4(LensCamera().captured(true)) == pytest.approx(true, abs=0.5)
    first = EQUATION_2_4(DepthCamera().captured(2500.0))
    assert first > 3400.0  # the plate's comes back a metre too far


def test_points_are_kept_near_or_apart_from_particles_as_their_lenses_say():
    generator, points, lenses = np.random.default_rng(5), 3000, 60
    index = np.sort(generator.choice(20_000, points, replace=False))
    block = generator.integers(0, 90, points)
    level = generator.uniform(3000, 9000, points).astype(np.float32)
    draws = generator.random(points, dtype=np.float32)
    lens = generator.integers(0, lenses, (4, points)).astype(np.int32)
    weight = generator.random((4, points), dtype=np.float32)
    error = generator.standard_normal(lenses, dtype=np.float32)
    own = np.where(generator.random(lenses) < 0.07, generator.random(lenses), 0).astype(np.float32)
    hidden = generator.random(90) < 0.1, generator.random(20_000) < 0.1
    share = np.float32(0.7)
    parts = (index, block, level), hidden, (lens, weight, error, own)
    apart, depth, near = _kept_points(draws, share, *parts)
    kept = (draws < share) & ~hidden[0][block] & ~hidden[1][index]
    beside = (own[lens] > 0).any(axis=0)
    np.testing.assert_array_equal(apart, index[kept & ~beside])
    np.testing.assert_array_equal(near, index[kept & beside])
    known = (level + _interpolated(error, lens, weight))[kept & ~beside]
    np.testing.assert_allclose(depth, known, rtol=1e-6)
    assert 0 < len(near) < len(apart)
