"""Depth, made from the picture on the grid of micro-lenses.

A lens compares what its neighbours see, so that it finds a depth only where its patch
of the picture has contrast over noise. The depth is that of whatever has the contrast:
an edge carries its depth half a lens beyond itself (fattening), and between two lenses
depths are mixed. The error is smooth over the picture. Most of it comes anew in each
frame; that of the calibration stays. A particle's own error is the larger, the lower
its contrast.

Published: 176 x 152 lenses (R12 data sheet), about 200,000 points a frame (sec. 5.1.3),
the distances of neighbours (Fig. 5.7), the shares with depth (Table 5.2), the scatter
of the plate (sec. 2.1.5) and of fitted trajectories (Table 5.18, RMSE in z).
`LensCamera` is set by these alone. No detection has a part in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.arrays import Array, Flags, Index, Single
from kilnflight.camera import EQUATION_2_4, invert_depth
from kilnflight.simulated.kiln.background import Background
from kilnflight.simulated.kiln.geometry import FULL_SCALE
from kilnflight.simulated.kiln.light import Optics
from kilnflight.simulated.kiln.picture import Blobs, Pixels

FULL_COLUMNS = 2048
BLOCKS = 3  # per lens and direction, in which contrast is summed
# Depths between which the plate scatters most (sec. 2.1.5: 3 m), and where it no longer
# does
_NEAR_MM = (2300.0, 2700.0, 3300.0, 3700.0)


@dataclass(frozen=True)
class LensCamera:
    """Say where lenses find a depth, and how wrong it is.

    Errors are true millimetres, as the thesis sees them after calibration; they are
    inputs. That a measurement finds them again validates nothing.
    """

    lenses: tuple[int, int] = (
        152,
        176,
    )  # rows, columns (R12 data sheet): 11.6 px apart
    wall_points: int = (
        165_000  # candidates; about 200,000 points a frame with those of particles
    )
    kept_per_frame: float = 0.9  # of the wall's candidates; assumption
    # Contrast over noise, both standard deviations of a pixel, from which a lens finds
    # a depth; fitted to Table 5.2, with 3D
    contrast: float = 12.0
    # Power of the contrast by which depths are weighed where a lens sees two: 2 where
    # squared differences are matched, more where the stronger edge wins
    dominance: float = 4.0
    clear: float = (
        2.0  # a particle's contrast over the wall's, below which two depths are refused
    )
    wall_contrast: float = (
        0.5  # likewise, of the wall, which many lenses see; assumption
    )
    patch: float = 0.5  # of a lens, over which the wall's contrast counts; by Fig. 5.7
    wall_error: float = 0.022  # relative (sec. 2.1.5: about 1 m range at 8 m)
    # Between 2.7 and 3.3 m, for a range of "more than 1 m" (sec. 2.1.5) taken as six of
    # these
    wall_error_near_mm: float = 170.0
    # Of the error's variance, the calibration's share: 41 mm at the lance. After Eq.
    # 2.4 depths have "high agreement" (sec. 2.1.5), and they fluctuate "irregularly"
    # (sec. 4.1.3); assumption
    fixed: float = 0.1
    # Set by hand with the distances of neighbours (Fig. 5.7) in view, and nothing else
    changing: float = (
        0.03  # of the error's variance, of each lens alone, from frame to frame
    )
    smooth_px: float = 200.0  # over which the rest of the error changes
    white_mm: float = 0.9  # per point
    points_per_pixel: float = 0.5  # of what lenses see of particles
    # Contrast over noise at which noise makes the error of a particle 1.4 times as
    # large
    half_contrast: float = 3.0
    scale: float = (
        1.0  # of the errors common to a patch or particle, for the sensitivity
    )
    # In flight, mm; identified by RMSE in z of Table 5.18
    particle_error_mm: tuple[tuple[str, float], ...] = (
        ("wood chip", 87.0),
        ("confetti", 91.0),
        ("paper shred", 185.0),
        ("PE granule", 132.0),
    )
    # On the wall; identified by the 31 % of such particles within 800 mm of the axis
    # (Table 5.13)
    wall_particle_mm: float = 445.0

    def captured(self, true_mm: npt.ArrayLike) -> Array:
        """Return the captured depth that Eq. 2.4 turns into each true depth.

        Eq. 2.4 is not monotone below 3 m; the captured depth jumps where the equation
        does.
        """
        return np.asarray(
            np.interp(np.asarray(true_mm, np.float64), *_inverse_of_equation_2_4())
        )

    def wall_scale(self, depth_mm: npt.ArrayLike) -> Array:
        """Return the standard deviation of the wall's error in mm at true depths.

        As the plate's, but without steps.
        """
        depth = np.asarray(depth_mm, dtype=np.float64)
        relative = self.wall_error
        begin = relative * _NEAR_MM[0]
        end = relative * _NEAR_MM[3]
        near = np.interp(depth, _NEAR_MM, (begin, *[self.wall_error_near_mm] * 2, end))
        inside = (depth > _NEAR_MM[0]) & (depth < _NEAR_MM[3])
        return self.scale * np.where(inside, near, relative * depth)

    def calibration(self, rows: int, columns: int, seed: int) -> Single:
        """Return the error of the calibration (rows, columns) over the `wall_scale`."""
        field = _smooth(
            np.random.default_rng([seed, 304]), (rows, columns), self.smooth_px
        )
        return field * np.float32(np.sqrt(self.fixed))

    def particle_scale(self, contrast: Array) -> Array:
        """Return by how much low contrast raises a particle's error."""
        return np.sqrt(1.0 + (self.half_contrast / np.maximum(contrast, 0.1)) ** 2)


class Lattice(NamedTuple):
    """The hexagonal grid of lenses over a picture."""

    rows: int  # of the picture
    columns: int
    lenses: tuple[int, int]

    @property
    def pitch_px(self) -> float:
        """Distance of the lenses of a row."""
        return self.columns / self.lenses[1]

    @property
    def block_px(self) -> int:
        """Side of the blocks in which contrast is summed."""
        return max(1, round(self.pitch_px / BLOCKS))

    @property
    def blocks(self) -> tuple[int, int]:
        """Rows and columns of blocks."""
        return -(-self.rows // self.block_px), -(-self.columns // self.block_px)

    def centres(self) -> tuple[Index, Index]:
        """Return the pixels (rows and columns) in the middle of all lenses."""
        row, column = np.divmod(np.arange(np.prod(self.lenses)), self.lenses[1])
        down = (row + 0.5) * self.rows / self.lenses[0]
        right = (column + 0.25 + 0.5 * (row % 2)) * self.pitch_px
        return (
            np.minimum(down.astype(np.intp), self.rows - 1),
            np.minimum(right.astype(np.intp), self.columns - 1),
        )

    def block_of(self, row: Index, column: Index) -> Index:
        """Return the block of each pixel."""
        return row // self.block_px * self.blocks[1] + column // self.block_px

    def between(
        self, row: Index, column: Index
    ) -> tuple[npt.NDArray[np.int32], Single]:
        """Return the four lenses around pixels (4, n) and their weights (4, n)."""
        down = np.clip(
            row * (self.lenses[0] / self.rows) - 0.5, 0.0, self.lenses[0] - 1.001
        )
        upper = down.astype(np.intp)
        share = down - upper
        lens = []
        weight = []
        for line, of_line in ((upper, 1 - share), (upper + 1, share)):
            right = column / self.pitch_px - 0.25 - 0.5 * (line % 2)
            right = np.clip(right, 0.0, self.lenses[1] - 1.001)
            left = right.astype(np.intp)
            lens += [line * self.lenses[1] + left, line * self.lenses[1] + left + 1]
            weight += [of_line * (1 - (right - left)), of_line * (right - left)]
        return np.stack(lens).astype(np.int32), np.stack(weight).astype(np.float32)


@lru_cache(maxsize=1)
def _inverse_of_equation_2_4() -> tuple[Array, Array]:
    """Return true depths, ascending, and the captured ones; lines between them."""
    step = 10.0
    true = np.arange(step, 15_000.0, step)
    captured = invert_depth(true)
    at = float(
        EQUATION_2_4(EQUATION_2_4.breakpoints_mm[0])
    )  # from here on the second segment
    sides = np.array([at - 1e-6, at])
    place = [int(np.searchsorted(true, at))] * 2
    captured = np.insert(captured, place, invert_depth(sides))
    true = np.insert(true, place, sides)
    beyond = float(captured[-1] - captured[-2]) / step * 1e5
    return np.append(true, true[-1] + 1e5), np.append(captured, captured[-1] + beyond)


def measure_contrast(
    picture: Single,
    lattice: Lattice,
    full_scale: float = np.inf,
    asked: Flags | None = None,
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
        Which blocks are needed, (rows, columns); all if None. Values of others mean
        nothing.
    """
    wanted = np.ones(lattice.blocks, np.uint8)
    if asked is not None:
        wanted = np.asarray(
            cv2.dilate(asked.astype(np.uint8), np.ones((BLOCKS, BLOCKS), np.uint8))
        )
    of_blocks = _block_means(picture, wanted, lattice.block_px, np.float32(full_scale))
    mean, square = (cv2.blur(each, (BLOCKS, BLOCKS)) for each in of_blocks)
    variance = np.maximum(square - mean * mean, 0.0)
    return np.asarray(variance, np.float32), np.asarray(mean, np.float32)


@njit(cache=True)
def _block_means(picture: Any, wanted: Any, side: int, full_scale: Any) -> Any:
    """Return the means of grey values, and of their squares, in the wanted blocks;
    elsewhere 0.

    Compiled: particles cover few blocks, and passes over a whole picture take several
    ms.
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


@dataclass(frozen=True)
class LensWall:
    """What the lenses see of the kiln without particles: constant in a scene."""

    camera: LensCamera
    lattice: Lattice
    depth_mm: Single  # (rows, columns), true
    bias: Single  # (rows, columns) of the calibration, over the `LensCamera.wall_scale`
    variance: Single  # of blocks
    changing: Single  # of lenses: standard deviation of their own error, likewise
    index: Index  # pixels of the wall that can have depth
    block: npt.NDArray[np.int32]  # of each of them
    lens: npt.NDArray[np.int32]  # (4, pixels) around each of them
    weight: Single  # (4, pixels)
    level_mm: Single  # (pixels,) depth with the bias of the calibration
    scale_mm: Single  # (pixels,) standard deviation of the error

    @classmethod
    def of(
        cls,
        camera: LensCamera,
        background: Background,
        optics: Optics,
        edge_px: int,
        bias: Single,
    ) -> LensWall:
        """Return the wall of a scene; ``bias`` is that of `LensCamera.calibration`."""
        level = background.level
        rows, columns = level.shape
        lattice = Lattice(rows, columns, camera.lenses)
        generator = np.random.default_rng([background.seed, 305])
        variance, mean = measure_contrast(level, lattice)
        over_noise = np.asarray(np.sqrt(variance) / optics.noise(mean), np.float32)
        index = _textured(over_noise, lattice, camera, edge_px, generator)
        row, column = np.divmod(index, columns)
        centre = lattice.centres()
        at_lens = over_noise.reshape(-1)[lattice.block_of(*centre)]
        changing = np.clip(np.median(at_lens) / np.maximum(at_lens, 1e-6), 0.5, 2.0)
        changing *= np.sqrt(camera.changing)
        true = background.depth_mm.astype(np.float32)
        at = true.reshape(-1)[index]
        scale = camera.wall_scale(at).astype(np.float32)
        return cls(
            camera,
            lattice,
            true,
            bias,
            variance,
            changing.astype(np.float32),
            index,
            lattice.block_of(row, column).astype(np.int32),
            *lattice.between(row, column),
            at + bias.reshape(-1)[index] * scale,
            scale,
        )

    def points(self, sight: Sight, random: np.random.Generator) -> tuple[Index, Single]:
        """Return pixels (n,) and depths in mm (n,) of the points of a frame, error
        included.
        """
        camera = self.camera
        lattice = self.lattice
        block = lattice.block_of(*lattice.centres())
        own, wall = (
            of.take(block) ** camera.dominance for of in (sight.contrast, sight.wall)
        )
        changing = self.changing * random.standard_normal(len(block), dtype=np.float32)
        changing += self._drift(random)
        draws = random.random(len(self.index), np.float32)
        share = np.float32(camera.kept_per_frame)
        hidden = sight.valid.reshape(-1), sight.hidden
        lenses = self.lens, self.weight, changing, own
        points = (self.index, self.block, self.level_mm, self.scale_mm)
        apart, depth, mixed = _kept_points(draws, share, points, hidden, lenses)
        index = np.concatenate([apart, mixed, sight.pixels])
        pixel = np.divmod(index[len(apart) :], lattice.columns)
        of_lenses = own, own * sight.depth_mm.take(block), wall, changing
        depth = np.concatenate([depth, self._mixed(pixel, of_lenses)])
        return index, depth + camera.white_mm * random.standard_normal(
            len(index), np.float32
        )

    def _drift(self, random: np.random.Generator) -> Single:
        """Return the smooth error of the lenses of a frame, over the
        `LensCamera.wall_scale`.
        """
        camera = self.camera
        lattice = self.lattice
        down, right = lattice.lenses
        size = (lattice.rows, lattice.columns)
        field = _smooth(random, size, camera.smooth_px, (down, 2 * right))
        field *= np.float32(np.sqrt(1 - camera.fixed - camera.changing))
        odd = np.arange(down)[:, None] % 2  # these rows are half a lens to the right
        return np.where(odd, field[:, 1::2], field[:, ::2]).reshape(-1)

    def _mixed(
        self, pixel: tuple[Index, Index], of_lenses: tuple[Single, ...]
    ) -> Single:
        """Return the depths at pixels near particles: of the wall, of particles, and
        between.

        By lens: the weight of particles, that times their depth, the wall's weight and
        the error.
        """
        lens, weight = self.lattice.between(*pixel)
        mine, depth, other, error = (
            _interpolated(of, lens, weight) for of in of_lenses
        )
        share = mine / np.maximum(mine + other, 1e-6)
        behind = (1 - share) * self.depth_mm[pixel]
        depth = behind + share * depth / np.maximum(mine, 1e-6)
        scale = self.camera.wall_scale(depth).astype(np.float32)
        return np.asarray(depth + (self.bias[pixel] + error) * scale, dtype=np.float32)

    def look(
        self,
        picture: Single,
        scene: tuple[Blobs, Pixels],
        error: Array,
        labels: npt.NDArray[np.uint8],
        optics: Optics,
        random: np.random.Generator,
    ) -> Sight:
        """Return what the lenses see of the particles of a frame.

        Parameters
        ----------
        picture
            (rows, columns), without noise; what exceeds full scale is cut off.
        scene
            The particles, and the pixels that they cover.
        error
            Of each particle's depth (particles,), at high contrast.
        labels
            Of pixels (rows, columns): wall 0, flame of the burner 1, particles.
        optics, random
            The noise of the picture; chooses among the pixels.
        """
        (blobs, pixels), lattice = scene, self.lattice
        inside = pixels.radius <= 1.15
        place = pixels.place[inside]
        blob = pixels.blob[inside]
        block = lattice.block_of(*np.divmod(place, lattice.columns))
        size = lattice.blocks[0] * lattice.blocks[1]

        def within(weights: Array) -> Single:
            total = np.bincount(block, weights, size).reshape(lattice.blocks)
            summed = cv2.blur(total.astype(np.float32), (BLOCKS, BLOCKS))
            return np.asarray(summed, np.float32)

        count = within(np.ones(len(block)))
        variance, mean = measure_contrast(picture, lattice, FULL_SCALE, count > 0)
        there = count > 0.5 / BLOCKS**2
        total = np.maximum(count, 1e-6)
        covered_share = np.minimum(count / lattice.block_px**2, 1.0)
        wall = self.variance * (
            1 - covered_share
        )  # what a particle hides has no contrast
        own = np.where(there, np.maximum(variance - wall, 0.0), 0.0)
        noise = optics.noise(mean)
        contrast = np.sqrt(own) / noise
        strongest = np.zeros(len(blobs.row))
        np.maximum.at(strongest, blob, contrast.reshape(-1)[block])
        found = blobs.depth_mm + error[blobs.particle] * self.camera.particle_scale(
            strongest
        )
        depth = np.asarray(within(found[blob]) / total, np.float32)
        valid = (
            there
            & (contrast >= self.camera.contrast)
            & (own >= self.camera.clear**2 * wall)
        )
        candidates = _pixels_of(valid, lattice)
        kept = (
            random.random(len(candidates), dtype=np.float32)
            < self.camera.points_per_pixel
        )
        kept &= labels.take(candidates) != 1
        hidden = labels.reshape(-1) != 0
        weights = (
            np.sqrt(own) + 0.1 * noise * covered_share
        )  # within a body there is only itself
        within_body = weights.astype(np.float32)
        behind = np.sqrt(wall).astype(np.float32)
        return Sight(within_body, behind, depth, valid, hidden, candidates[kept])


def _interpolated(
    values: Single, lens: npt.NDArray[np.int32], weight: Single
) -> Single:
    """Return values of lenses between four of them each."""
    total = weight[0] * values.take(lens[0])
    for of_lens, of_weight in zip(lens[1:], weight[1:], strict=True):
        total += of_weight * values.take(of_lens)
    return np.asarray(total, dtype=np.float32)


@njit(cache=True)
def _kept_points(draws: Any, share: Any, points: Any, hidden: Any, lenses: Any) -> Any:
    """Return wall points with their depths, and pixels near particles, of those that
    are kept.

    Compiled: numpy gathers ten times, which takes three times as long.

    Parameters
    ----------
    draws, share
        A point whose draw is below the share is kept, unless it is hidden.
    points
        Pixel, block, depth and standard deviation of its error of each.
    hidden
        Which blocks and which pixels are.
    lenses
        The four lenses around each point and their weights (`Lattice.between`); of
        lenses the error that changes, and what they see of particles.
    """
    (index, block, level, scale), (blocks, pixels) = points, hidden
    lens, weight, error, own = lenses
    apart = np.empty(len(index), np.intp)
    near = np.empty(len(index), np.intp)
    depth = np.empty(len(index), np.float32)
    count = 0
    others = 0
    for i in range(len(index)):
        if draws[i] >= share or blocks[block[i]] or pixels[index[i]]:
            continue
        a = lens[0, i]
        b = lens[1, i]
        c = lens[2, i]
        d = lens[3, i]
        if own[a] > 0 or own[b] > 0 or own[c] > 0 or own[d] > 0:
            near[others] = index[i]
            others += 1
            continue
        total = (
            weight[0, i] * error[a] + weight[1, i] * error[b]
        )  # as in `_interpolated`
        total = total + weight[2, i] * error[c] + weight[3, i] * error[d]
        apart[count] = index[i]
        depth[count] = level[i] + scale[i] * total
        count += 1
    return apart[:count].copy(), depth[:count].copy(), near[:others].copy()


class Sight(NamedTuple):
    """What the lenses see of the particles of a frame."""

    contrast: Single  # of blocks: standard deviation of grey values, of particles alone
    wall: Single  # likewise: of the wall that they leave to be seen
    depth_mm: Single  # of blocks: the particle's, with its error
    valid: Flags  # of blocks: a particle gives a depth
    hidden: Flags  # of pixels (rows * columns,): the wall is not seen there
    pixels: Index  # that have a particle's depth


def _textured(
    over_noise: Single,
    lattice: Lattice,
    camera: LensCamera,
    edge_px: int,
    generator: np.random.Generator,
) -> Index:
    """Return the pixels of the wall with most contrast for their surroundings, sorted.

    They lie in patches, over each of which a lens sees the contrast. Contrast is
    relative to that of a tenth of the picture around, so that points lie everywhere
    where there is any.
    """
    rows = lattice.rows
    columns = lattice.columns
    around = cv2.GaussianBlur(over_noise, (0, 0), lattice.blocks[1] / 20)
    score = np.asarray(
        cv2.resize(over_noise / (around + 0.05), (columns, rows)), np.float32
    )
    score *= 0.9 + 0.1 * generator.random(score.shape, dtype=np.float32)
    score *= cv2.resize(over_noise, (columns, rows)) >= camera.wall_contrast
    score = np.asarray(
        cv2.GaussianBlur(score, (0, 0), lattice.pitch_px * camera.patch), np.float32
    )
    score[:edge_px] = 0
    score[-edge_px:] = 0
    score[:, :edge_px] = 0
    score[:, -edge_px:] = 0
    count = min(int(camera.wall_points / camera.kept_per_frame), score.size // 2)
    score = score.reshape(-1)
    best = np.flatnonzero(score >= np.partition(score, -count)[-count])
    # of equal ones the first
    best = np.sort(best[np.argsort(-score[best], kind="stable")[:count]])
    return best[score[best] > 0]


def _smooth(
    generator: np.random.Generator,
    picture: tuple[int, int],
    cell_px: float,
    size: tuple[int, int] | None = None,
) -> Single:
    """Return a smooth field of unit variance.

    Parameters
    ----------
    generator
        Draws the field.
    picture
        Rows and columns of the picture that the field covers.
    cell_px
        Pixels of a full picture over which the field changes.
    size
        Rows and columns of the field; None: those of the picture.
    """
    rows, columns = picture
    cell = cell_px * columns / FULL_COLUMNS
    coarse = generator.standard_normal((int(rows / cell) + 2, int(columns / cell) + 2))
    down, right = size or picture
    field = cv2.resize(
        coarse.astype(np.float32), (right, down), interpolation=cv2.INTER_CUBIC
    )
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)


def _pixels_of(valid: Flags, lattice: Lattice) -> Index:
    """Return the pixels of blocks."""
    row, column = np.nonzero(valid)
    inner = np.arange(lattice.block_px)
    down = (row[:, None] * lattice.block_px + inner)[:, :, None]
    right = (column[:, None] * lattice.block_px + inner)[:, None, :]
    inside = (down < lattice.rows) & (right < lattice.columns)
    return np.asarray((down * lattice.columns + right)[inside], dtype=np.intp)
