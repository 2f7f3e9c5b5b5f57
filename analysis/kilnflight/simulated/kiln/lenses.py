"""Depth, made from the picture on the grid of micro-lenses.

A lens compares what its neighbours see, so that it finds a depth only where its patch
of the picture has contrast over noise. The depth is that of whatever has the contrast:
an edge carries its depth half a lens beyond itself (fattening), and between two lenses
depths are mixed. The error is smooth over the picture. Most of it is drawn anew in each
frame; that of the calibration stays. A particle's own error is the larger, the lower
its contrast.

Published: 176 x 152 lenses (R12 data sheet), about 200,000 points a frame (sec. 5.1.3),
the distances of neighbours (Fig. 5.7), the shares with depth (Table 5.2), the scatter
of the plate (sec. 2.1.5) and of fitted trajectories (Table 5.18, RMSE in z).
`LensCamera` is set by these alone, and fitted to no score of detection.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np

from kilnflight.arrays import (
    Array,
    ArrayLike,
    Flags,
    Generator,
    Index,
    Pair,
    Shape,
    Single,
    TwoInts,
)
from kilnflight.camera import EQUATION_2_4, invert_depth
from kilnflight.compiled import compiled
from kilnflight.simulated.kiln.background import FULL_COLUMNS, Background
from kilnflight.simulated.kiln.geometry import FULL_SCALE
from kilnflight.simulated.kiln.picture import MARKED_RADIUS, SceneView

BLOCKS = 3  # per lens and direction, in which contrast is summed
FLOOR = 0.1  # contrast over noise of a uniform body against the wall; assumption
# The plate scatters most between these depths, near 3 m (sec. 2.1.5).
NEAR_MM = (2300.0, 2700.0, 3300.0, 3700.0)


@dataclass(frozen=True)
class LensCamera:
    """Where lenses find a depth, and how wrong it is.

    Errors are true millimetres, as the thesis sees them after calibration; they are
    inputs. That a measurement finds them again validates nothing.

    Parameters
    ----------
    lenses
        Rows and columns of lenses, 11.6 px apart (R12 data sheet).
    wall_points
        Candidates on the wall; with those of particles about 200,000 points a frame.
    kept_per_frame
        Share of the wall's candidates in a frame; assumption.
    contrast
        Contrast over noise, both standard deviations of a pixel, from which a lens
        finds a depth; fitted to Table 5.2, with 3D.
    dominance
        Power of the contrast by which depths are weighed where a lens sees two: 2 where
        squared differences are matched, more where the stronger edge wins.
    clear
        A particle's contrast over the wall's, below which two depths are refused.
    wall_contrast
        The wall's contrast over noise from which it has a depth, lower as many lenses
        see it; assumption.
    patch
        Share of a lens over which the wall's contrast counts; by Fig. 5.7.
    wall_error
        Relative error of the wall's depth: about 1 m range at 8 m (section 2.1.5).
    wall_error_near_mm
        The same in mm from 2.7 to 3.3 m: a range of "more than 1 m" (section 2.1.5),
        taken as six of these.
    fixed
        The calibration's share of the error's variance: 41 mm at the lance. After Eq.
        2.4 depths have "high agreement" (section 2.1.5), and they fluctuate
        "irregularly" (section 4.1.3); assumption.
    changing
        Share of the error's variance of each lens alone, from frame to frame. This and
        the next three were set by hand with Fig. 5.7 in view.
    smooth_px
        Pixels over which the rest of the error changes.
    white_mm
        Error of each point in mm.
    points_per_pixel
        Points for each pixel of a particle that lenses see.
    half_contrast
        Contrast over noise at which a particle's error is 1.4 times as large;
        assumption.
    scale
        Factor of the errors common to a patch or particle, for the sensitivity.
    particle_error_mm
        Error of a particle in flight in mm; identified by RMSE in z of Table 5.18.
    wall_particle_mm
        Error of a particle on the wall in mm; identified by the 31 % of such particles
        within 800 mm of the axis (Table 5.13).
    """

    lenses: TwoInts = (152, 176)
    wall_points: int = 165_000
    kept_per_frame: float = 0.9
    contrast: float = 12.0
    dominance: float = 4.0
    clear: float = 2.0
    wall_contrast: float = 0.5
    patch: float = 0.5
    wall_error: float = 0.022
    wall_error_near_mm: float = 170.0
    fixed: float = 0.1
    changing: float = 0.03
    smooth_px: float = 200.0
    white_mm: float = 0.9
    points_per_pixel: float = 0.5
    half_contrast: float = 3.0
    scale: float = 1.0
    particle_error_mm: tuple[tuple[str, float], ...] = (
        ("wood chip", 87.0),
        ("confetti", 91.0),
        ("paper shred", 185.0),
        ("PE granule", 132.0),
    )
    wall_particle_mm: float = 445.0

    def captured(self, true_mm: ArrayLike) -> Array:
        """Return the captured depth that Eq. 2.4 turns into each true depth.

        Eq. 2.4 is not monotone below 3 m; the captured depth jumps where the equation
        does.
        """
        return np.interp(np.asarray(true_mm), *_tabulate_captured())

    def wall_scale(self, depth_mm: ArrayLike) -> Array:
        """Return the standard deviation of the wall's error in mm at true depths."""
        depth = np.asarray(depth_mm, float)
        relative = self.wall_error
        first, _, _, last = NEAR_MM
        most = self.wall_error_near_mm
        near = np.interp(
            depth, NEAR_MM, (relative * first, most, most, relative * last)
        )
        inside = (depth > first) & (depth < last)
        return self.scale * np.where(inside, near, relative * depth)

    def calibration(self, rows: int, columns: int, seed: int) -> Single:
        """Return the error of the calibration (rows, columns) over the `wall_scale`."""
        generator = np.random.default_rng([seed, 304])
        size = (rows, columns)
        field = _draw_smooth(generator, size, self.smooth_px, size)
        return field * np.float32(np.sqrt(self.fixed))


@lru_cache(maxsize=1)
def _tabulate_captured() -> Pair:
    """Return true depths, ascending up to 15 m, and the captured ones."""
    # The second segment of the equation begins here.
    jump = float(EQUATION_2_4(EQUATION_2_4.breakpoints_mm[0]))
    true = np.append(np.arange(10.0, 15_000.0, 10.0), [jump - 1e-6, jump])
    true.sort()
    return true, invert_depth(true)


class Lattice(NamedTuple):
    """The hexagonal grid of lenses over a picture."""

    rows: int  # size of the picture
    columns: int
    lenses: TwoInts

    @property
    def pitch_px(self) -> float:
        """Distance of the lenses of a row."""
        return self.columns / self.lenses[1]

    @property
    def block_px(self) -> int:
        """Side of the blocks in which contrast is summed."""
        return round(self.pitch_px / BLOCKS)

    @property
    def blocks(self) -> TwoInts:
        """Rows and columns of blocks."""
        return -(-self.rows // self.block_px), -(-self.columns // self.block_px)

    def block_of(self, pixel: Index) -> Index:
        """Return the block of each pixel."""
        row, column = np.divmod(pixel, self.columns)
        return row // self.block_px * self.blocks[1] + column // self.block_px

    def centres(self) -> Index:
        """Return the blocks in the middle of all lenses."""
        row, column = np.divmod(np.arange(np.prod(self.lenses)), self.lenses[1])
        down = (row + 0.5) * self.rows / self.lenses[0]
        right = (column + 0.25 + 0.5 * (row % 2)) * self.pitch_px
        return self.block_of(
            down.astype(np.intp) * self.columns + right.astype(np.intp)
        )

    def between(self, pixel: Index) -> tuple[Index, Single]:
        """Return the four lenses around pixels (4, n) and their weights (4, n)."""
        row, column = np.divmod(pixel, self.columns)
        lines, per_line = self.lenses
        down = np.clip(row * (lines / self.rows) - 0.5, 0.0, lines - 1.001)
        upper = down.astype(np.intp)
        share = down - upper
        lens = []
        weight = []
        for line, of_line in ((upper, 1 - share), (upper + 1, share)):
            right = column / self.pitch_px - 0.25 - 0.5 * (line % 2)
            right = np.clip(right, 0.0, per_line - 1.001)
            left = right.astype(np.intp)
            lens += [line * per_line + left, line * per_line + left + 1]
            weight += [of_line * (1 - (right - left)), of_line * (right - left)]
        return np.stack(lens), np.stack(weight).astype(np.float32)

    def average_sums(self, block: Index, values: Array) -> Single:
        """Return sums of values by block, averaged over a lens around each block."""
        rows, columns = self.blocks
        total = np.bincount(block, values, rows * columns).reshape(rows, columns)
        return _blur(total.astype(np.float32))

    def pixels_of(self, blocks: Index) -> Index:
        """Return the pixels of some blocks."""
        row, column = np.divmod(blocks, self.blocks[1])
        inner = np.arange(self.block_px)
        down = (row[:, None] * self.block_px + inner)[:, :, None]
        right = (column[:, None] * self.block_px + inner)[:, None, :]
        inside = (down < self.rows) & (right < self.columns)
        return (down * self.columns + right)[inside]


def _blur(values: Single) -> Single:
    """Return the mean of values (rows, columns) of blocks over a lens around each."""
    return np.asarray(cv2.blur(values, (BLOCKS, BLOCKS)), np.float32)


def measure_contrast(
    picture: Single, lattice: Lattice, full_scale: float, asked: Flags
) -> tuple[Single, Single]:
    """Return variance and mean of grey values within a lens around each block.

    Parameters
    ----------
    picture
        (rows, columns); what exceeds ``full_scale`` is cut off.
    lattice
        Of the lenses.
    full_scale
        The highest grey value.
    asked
        Which blocks are needed, (rows, columns). Values of others mean nothing.
    """
    kernel = np.ones((BLOCKS, BLOCKS), np.uint8)
    wanted = cv2.dilate(asked.astype(np.uint8), kernel)
    means = _block_means(picture, wanted, lattice.block_px, np.float32(full_scale))
    mean = _blur(means[0])
    return np.maximum(_blur(means[1]) - mean * mean, 0.0), mean


@compiled
def _block_means(picture: Any, wanted: Any, side: int, full_scale: Any) -> Any:
    """Return the means of grey values, and of their squares, in the wanted blocks.

    It is compiled as particles cover few blocks, and passes over a whole picture take
    several ms.
    """
    means = np.zeros((2, *wanted.shape), np.float32)
    rows, columns = picture.shape
    for i in range(wanted.shape[0]):
        for j in range(wanted.shape[1]):
            if not wanted[i, j]:
                continue
            bottom = min((i + 1) * side, rows)
            right = min((j + 1) * side, columns)
            total = np.float32(0)
            squares = np.float32(0)
            for row in range(i * side, bottom):
                line = np.float32(0)
                of_line = np.float32(0)
                for column in range(j * side, right):
                    gray = min(picture[row, column], full_scale)
                    line += gray
                    of_line += gray * gray
                total += line
                squares += of_line
            share = np.float32(1) / np.float32((bottom - i * side) * (right - j * side))
            means[0, i, j] = total * share
            means[1, i, j] = squares * share
    return means


class Sight(NamedTuple):
    """Particles of a frame as the lenses see them."""

    own: Single  # (lenses,) weight of the particles' depth
    wall: Single  # (lenses,) weight of the depth of the wall behind them
    depth_mm: Single  # (lenses,) of the particles, with their error
    hidden: Flags  # (rows * columns,) pixels that cannot have the wall's depth
    pixels: Index  # pixels that have a particle's depth


class LensWall:
    """The kiln without particles as the lenses see it: constant in a scene.

    Parameters
    ----------
    camera, background
        Of the scene.
    bias
        Error of the calibration (`LensCamera.calibration`), (rows, columns), over the
        `LensCamera.wall_scale`.
    """

    def __init__(
        self, camera: LensCamera, background: Background, bias: Single
    ) -> None:
        self.camera = camera
        self.background = background
        self.bias = bias
        level = background.level
        rows, columns = level.shape
        self.lattice = Lattice(rows=rows, columns=columns, lenses=camera.lenses)
        everywhere = np.ones(self.lattice.blocks, bool)
        # Variance of grey values by block.
        self.variance, mean = measure_contrast(level, self.lattice, np.inf, everywhere)
        over_noise = np.sqrt(self.variance) / background.optics.noise(mean)
        contrast = over_noise.astype(np.float32)
        # (lenses,) The block in the middle of each.
        self.centre = self.lattice.centres()
        at_lens = contrast.take(self.centre)
        changing = np.clip(np.median(at_lens) / np.maximum(at_lens, 1e-6), 0.5, 2.0)
        changing *= np.sqrt(camera.changing)
        # (lenses,) Standard deviation of their own error, over the wall's scale.
        self.changing: Single = changing.astype(np.float32)
        # (n,) Pixels of the wall that can have depth; (4, n) the lenses around each.
        self.index = _choose_textured(contrast, self.lattice, camera, background)
        self.lens, self.weight = self.lattice.between(self.index)
        depth = background.depth_mm.take(self.index)
        # (n,) Standard deviation of their error, and depth with the calibration's.
        self.scale_mm = camera.wall_scale(depth).astype(np.float32)
        self.level_mm = depth + bias.take(self.index) * self.scale_mm

    def points(self, sight: Sight, random: Generator) -> tuple[Index, Single]:
        """Return pixels (n,) and depths in mm (n,) of the points of a frame.

        The depths have their error.
        """
        camera = self.camera
        size = len(self.changing)
        changing = self.changing * random.standard_normal(size, dtype=np.float32)
        # The rest of the error is smooth over the picture.
        down, right = self.lattice.lenses
        smooth = _draw_smooth(
            random, self.bias.shape, camera.smooth_px, (down, 2 * right)
        )
        smooth *= np.float32(np.sqrt(1 - camera.fixed - camera.changing))
        odd = np.arange(down)[:, None] % 2  # these rows are half a lens to the right
        changing += np.where(odd, smooth[:, 1::2], smooth[:, ::2]).reshape(-1)
        draws = random.random(len(self.index), np.float32)
        kept = draws < np.float32(camera.kept_per_frame)
        kept &= ~sight.hidden.take(self.index)
        mixed = (sight.own > 0).take(self.lens).any(axis=0)
        alone = kept & ~mixed
        near = np.concatenate([self.index[kept & mixed], sight.pixels])
        index = np.concatenate([self.index[alone], near])
        error = _interpolate(changing, self.lens, self.weight)
        depth = self.level_mm + self.scale_mm * error
        depth = np.concatenate([depth[alone], self._mix(near, sight, changing)])
        white = random.standard_normal(len(index), np.float32)
        return index, depth + camera.white_mm * white

    def _mix(self, index: Index, sight: Sight, changing: Single) -> Single:
        """Return the depths (n,) in mm at pixels near particles.

        They are those of the wall, of particles, and between. ``changing`` is the error
        of the lenses.
        """
        lens, weight = self.lattice.between(index)
        own = _interpolate(sight.own, lens, weight)
        own_depth = _interpolate(sight.own * sight.depth_mm, lens, weight)
        wall = _interpolate(sight.wall, lens, weight)
        error = _interpolate(changing, lens, weight)
        share = own / np.maximum(own + wall, 1e-6)
        behind = (1 - share) * self.background.depth_mm.take(index)
        depth = behind + share * own_depth / np.maximum(own, 1e-6)
        scale = self.camera.wall_scale(depth).astype(np.float32)
        return depth + (self.bias.take(index) + error) * scale

    def see_particles(self, view: SceneView, error: Array, random: Generator) -> Sight:
        """Return the particles of a frame as the lenses see them.

        Contrast is measured in blocks, 3 x 3 for each lens. A block whose contrast
        stands out from noise and wall has depth. Then each lens weighs the depth of its
        particles against that of the wall.

        Parameters
        ----------
        view
            The frame without noise; what exceeds full scale is cut off.
        error
            Error of each particle's depth at high contrast in mm, (particles,).
        random
            Draws which pixels get a point.

        Returns
        -------
        Sight
            Weights and depths by lens, and the pixels that get a particle's depth.
        """
        camera = self.camera
        lattice = self.lattice
        # Which blocks particles cover, and by how much.
        pixels = view.pixels.take(view.pixels.radius <= MARKED_RADIUS)
        blob = pixels.blob
        block = lattice.block_of(pixels.place)
        count = lattice.average_sums(block, np.ones(len(block)))
        near = np.flatnonzero(count)  # elsewhere there is only the wall
        variance, mean = measure_contrast(view.picture, lattice, FULL_SCALE, count > 0)
        covered = np.minimum(count / lattice.block_px**2, 1.0)
        # What of the contrast is the particles' own.
        wall_variance = self.variance * (1 - covered)  # what is hidden has no contrast
        variance_behind = wall_variance.take(near)
        own_variance = np.maximum(variance.take(near) - variance_behind, 0.0)
        noise = self.background.optics.noise(mean.take(near))
        over_noise = np.sqrt(own_variance) / noise
        # Where that is enough for a depth; ``clear`` compares standard deviations.
        resolved = over_noise >= camera.contrast
        resolved &= own_variance >= camera.clear**2 * variance_behind
        contrast = np.zeros(count.size)
        contrast[near] = over_noise
        with_depth = lattice.pixels_of(near[resolved])
        # Neither a particle nor a pixel with a particle's depth can have the wall's.
        hidden = view.labels.reshape(-1) != 0
        hidden[with_depth] = True
        kept = random.random(len(with_depth), np.float32) < camera.points_per_pixel
        kept &= view.labels.take(with_depth) != 1  # none in the flame
        by_blob = self._depths(view, error, blob, contrast[block])
        depth = lattice.average_sums(block, by_blob[blob])
        depth /= np.maximum(count, 1e-6)  # 0 / 0 where there is no particle
        # A uniform body has no contrast, yet it hides the wall: it gets a small weight.
        body = np.zeros(count.size, np.float32)
        body[near] = np.sqrt(own_variance) + FLOOR * noise * covered.take(near)
        return Sight(
            own=body.take(self.centre) ** camera.dominance,
            wall=np.sqrt(wall_variance.take(self.centre)) ** camera.dominance,
            depth_mm=depth.take(self.centre),
            hidden=hidden,
            pixels=with_depth[kept],
        )

    def _depths(
        self, view: SceneView, error: Array, blob: Index, contrast: Array
    ) -> Array:
        """Return the depth (m,) in mm that lenses find for each particle of a view.

        ``error`` is that of all particles at high contrast; a low one raises it. The
        contrast (k,) is that of pixels of some blobs (k,).
        """
        strongest = np.zeros(len(view.visible))
        np.maximum.at(strongest, blob, contrast)
        over = self.camera.half_contrast / np.maximum(strongest, 0.1)
        scale = np.sqrt(1.0 + over**2)
        return view.blobs.depth_mm + error[view.moment.particle] * scale


def _interpolate(values: Single, lens: Index, weight: Single) -> Single:
    """Return values of lenses between four of them each."""
    return (weight * values.take(lens)).sum(axis=0)


def _choose_textured(
    contrast: Single, lattice: Lattice, camera: LensCamera, background: Background
) -> Index:
    """Return the pixels of the wall with most contrast for their surroundings, sorted.

    They lie in patches, over each of which a lens sees the contrast. Contrast is
    relative to that of a tenth of the picture around, so that points lie everywhere
    where there is any.
    """
    size = (lattice.columns, lattice.rows)
    around = cv2.GaussianBlur(contrast, (0, 0), lattice.blocks[1] / 20)
    score = np.asarray(cv2.resize(contrast / (around + 0.05), size), np.float32)
    generator = np.random.default_rng([background.seed, 305])
    score *= 0.9 + 0.1 * generator.random(score.shape, dtype=np.float32)
    score *= cv2.resize(contrast, size) >= camera.wall_contrast
    cv2.GaussianBlur(score, (0, 0), lattice.pitch_px * camera.patch, dst=score)
    edge = background.interior.edge_px  # no pixel there has depth
    score = np.pad(score[edge:-edge, edge:-edge], edge).reshape(-1)
    count = int(camera.wall_points / camera.kept_per_frame)
    # Ties go to the first pixel.
    best = np.sort(np.argsort(-score, kind="stable")[:count])
    return best[score[best] > 0]


def _draw_smooth(
    generator: Generator,
    picture: Shape,
    cell_px: float,
    size: TwoInts,
) -> Single:
    """Draw a smooth field of unit variance.

    Parameters
    ----------
    generator
        Draws the field.
    picture
        Rows and columns of the picture that the field covers.
    cell_px
        Pixels of a full picture over which the field changes.
    size
        Rows and columns of the field.
    """
    rows, columns = picture
    cell = cell_px * columns / FULL_COLUMNS
    coarse = generator.standard_normal((int(rows / cell) + 2, int(columns / cell) + 2))
    down, right = size
    field = cv2.resize(
        coarse.astype(np.float32), (right, down), interpolation=cv2.INTER_CUBIC
    )
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)
