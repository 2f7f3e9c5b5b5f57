"""The picture without particles: wall, inlet plate, burner flame, flicker, edges.

The static part is made once per scene. The changing part is a function of time alone
(sums of sinusoids with seeded phases), so that any frame can be rendered by itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from kilnflight.twin.burner import Burner, Flame, Tube, burner_tube, lance_tube
from kilnflight.twin.camera import Geometry, Optics
from kilnflight.twin.picture import Veil

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.float32]
Index = npt.NDArray[np.intp]

ROWS = 8  # whose rays are followed at once; those of a picture do not fit the cache
# Cells around and along the wall of each scale of its texture, and its weight
TEXTURE = ((8, 1.0), (24, 0.7), (72, 0.5), (216, 0.35))
WAVES = 12  # of the flicker's frequencies
FLICKER_BLOCK = 8  # pixels of a flicker's value, full camera; it is smooth over many of them
FLICKER_PX = 60.0  # over which hot gas bends light alike, full camera; assumption
FULL_COLUMNS = 2048


@dataclass(frozen=True)
class Surroundings:
    """Appearance of the kiln without particles; all assumptions but the temperatures."""

    texture_k: float = 25.0  # standard deviation of the wall's temperature (slag, bricks)
    plate_k: float = 1340.0  # the inlet plate is cooler than the wall
    flicker: float = 0.012  # relative, local, of hot gas
    flicker_time_s: float = 0.15
    common_flicker: float = 0.015  # relative, of the whole picture (burner)
    common_time_s: float = 0.03
    # Rectangle of the burner's flame: first row, last row, first column, last column.
    flame_roi: tuple[int, int, int, int] = (560, 980, 180, 620)
    burner: Burner = field(default_factory=Burner)  # with the lance: cooled tubes
    edge_px: int = 90  # width of the border with micro-lens artefacts (sec. 5.1.2)
    edge_strength: float = 0.10  # relative
    # Polygon of the region of interest, as share of rows and columns: not published, set by
    # Table 5.3 (an input), which keeps nine tenths in air and half of those on the wall. Its
    # lower edge was moved once, from 0.78 to 0.87, after it had kept a seventh on the wall.
    roi: tuple[tuple[float, float], ...] = (
        (0.07, 0.10),
        (0.07, 0.90),
        (0.50, 0.95),
        (0.87, 0.80),
        (0.87, 0.20),
        (0.50, 0.05),
    )


def _blocks(geometry: Geometry) -> Iterator[tuple[slice, Array, Array]]:
    """Yield `ROWS` rows of the picture at a time, with row and column of their pixels."""
    for first in range(0, geometry.rows, ROWS):
        rows = slice(first, min(first + ROWS, geometry.rows))
        row, column = np.indices((rows.stop - first, geometry.columns), dtype=np.float64)
        yield rows, row + first, column


@lru_cache(maxsize=1)
def _depth_mm(geometry: Geometry) -> Array:
    """Return the depth at which each pixel meets wall or plate.

    It is (rows, columns) and read-only.
    """
    depth = np.empty((geometry.rows, geometry.columns))
    for rows, row, column in _blocks(geometry):
        depth[rows] = geometry.wall_depth(row, column)
    depth.flags.writeable = False
    return depth


@dataclass(frozen=True)
class Background:
    """The picture without particles at any time.

    Lance and burner stand in the kiln, the inlet plate is smooth, the burner's flame is soot
    that lets light through, and the flicker of hot gas has no lattice. All is positive.
    """

    geometry: Geometry
    optics: Optics
    surroundings: Surroundings
    seed: int
    lance_elevation_deg: float = 0.0  # over the axis, as particles leave it

    def _texture(self, around: Array, along: Array) -> Array:
        """Return smooth noise of unit variance over angle and length, at four scales."""
        total, power = np.zeros(around.shape), 0.0
        for (cells, weight), noise in zip(TEXTURE, self._fields, strict=True):
            x = ((around % 1.0) * cells + 1.5).astype(np.float32)
            y = ((along % 1.0) * cells + 1.5).astype(np.float32)
            total += weight * cv2.remap(noise, x, y, cv2.INTER_CUBIC)
            power += weight**2
        return total / np.sqrt(power)

    @cached_property
    def _fields(self) -> list[Picture]:
        """White noise of each scale of the texture; its ends meet."""
        generator = np.random.default_rng([self.seed, 101])
        fields = [generator.normal(size=(cells, cells)) for cells, _ in TEXTURE]
        return [np.pad(field.astype(np.float32), 2, mode="wrap") for field in fields]

    def _vignetting(self) -> Array:
        rows, columns = self.geometry.rows, self.geometry.columns
        row = np.linspace(-1, 1, rows)[:, None]
        column = np.linspace(-1, 1, columns)[None, :] * columns / rows
        return 1.0 - 0.12 * (row**2 + column**2) / 2.78

    @cached_property
    def _edges(self) -> Picture:
        """Return the relative strength of the micro-lens artefacts.

        They are a hexagonal pattern at the border.
        """
        rows, columns, width = self.geometry.rows, self.geometry.columns, self.surroundings.edge_px
        row = np.arange(rows, dtype=np.float32)[:, None]
        column = np.arange(columns, dtype=np.float32)[None, :]
        near = np.minimum(row, rows - 1 - row)
        inside = np.minimum(near, np.minimum(column, columns - 1 - column))
        k = 2 * np.pi / 23.0  # px between micro-lens images
        pattern = np.cos(k * column) + np.cos(k * (0.5 * column + 0.866 * row))
        pattern = pattern + np.cos(k * (0.5 * column - 0.866 * row))
        return (np.clip(1 - inside / width, 0, 1) * pattern / 3).astype(np.float32)

    def common(self, time_s: float) -> float:
        """Return the relative brightness of the whole picture, about 1."""
        generator = np.random.default_rng([self.seed, 103])
        corner = 1 / (2 * np.pi * self.surroundings.common_time_s)
        hertz = corner * np.tan(np.pi / 2 * (np.arange(9) + generator.uniform(0, 1, 9)) / 10)
        phase = generator.uniform(0, 2 * np.pi, 9)
        waves = np.cos(2 * np.pi * hertz * time_s + phase).sum() * np.sqrt(2 / 9)
        return float(1 + self.surroundings.common_flicker * waves)

    @cached_property
    def tubes(self) -> list[Tube]:
        """The tubes of lance and burner."""
        burner = self.surroundings.burner
        return [
            lance_tube(burner, self.geometry, self.lance_elevation_deg),
            burner_tube(burner, self.geometry, self.surroundings.flame_roi),
        ]

    @cached_property
    def solid_mm(self) -> Picture:
        """Depth of lance and burner, (rows, columns); infinite where there is neither."""
        depth = _depth_mm(self.geometry)
        nearest = np.full(depth.shape, np.inf)
        for pixels, seen_mm, _ in self._seen_tubes:
            nearest[pixels] = np.minimum(nearest[pixels], seen_mm)
        return np.where(nearest < depth, nearest, np.inf).astype(np.float32)

    @cached_property
    def _seen_tubes(self) -> list[tuple[tuple[Index, Index], Array, Array]]:
        """Row and column of the pixels that see a tube, its depth in mm and its shade there."""
        place = self.geometry
        found = []
        for tube in self.tubes:
            parts = []
            for block, row, column in _blocks(place):
                seen_mm, shade = tube.seen(place, row, column)
                at = np.nonzero(np.isfinite(seen_mm))
                parts.append((at[0] + block.start, at[1], seen_mm[at], shade[at]))
            rows, columns, depth, shades = map(np.concatenate, zip(*parts, strict=True))
            found.append(((rows, columns), depth, shades))
        return found

    @cached_property
    def depth_mm(self) -> Array:
        """True depth of wall, plate, lance and burner, (rows, columns)."""
        return np.minimum(_depth_mm(self.geometry), self.solid_mm)

    @cached_property
    def level(self) -> Picture:
        """Grey values of wall, plate and tubes, (rows, columns), without flicker and noise."""
        optics, depth = self.optics, _depth_mm(self.geometry)
        level = np.empty(depth.shape)
        for rows, row, column in _blocks(self.geometry):
            level[rows] = self._lit(row, column, depth[rows])
        for at, seen_mm, shade in self._seen_tubes:
            level[at] = np.where(seen_mm < depth[at], shade * optics.at_wall, level[at])
        soft = cv2.GaussianBlur(level * self._vignetting(), (0, 0), optics.edge_softness_px)
        return soft.astype(np.float32)

    def _lit(self, row: Array, column: Array, depth_mm: Array) -> Array:
        """Return the grey values of wall and plate at pixels, in the light of the flame, too."""
        place, around = self.geometry, self.surroundings
        camera = place.unproject(row, column, depth_mm)
        point = place.to_kiln(camera)
        plate = point[..., 0] <= place.inlet_m + 0.01
        angle = np.arctan2(point[..., 2], point[..., 1])
        wall = self._texture(angle / (2 * np.pi) + 0.5, point[..., 0] / 8.4 + 0.4)
        kelvin = np.where(plate, around.plate_k, self.optics.wall_k + around.texture_k * wall)
        return self.optics.glow(kelvin) + self.flame.lights(camera, self.optics)

    @cached_property
    def flame(self) -> Flame:
        """The burner's flame."""
        around = self.surroundings
        return Flame(around.burner, self.tubes[1], self.geometry, around.flame_roi, self.seed)

    @cached_property
    def _patterns(self) -> tuple[Array, npt.NDArray[np.float32]]:
        """Frequencies (waves,) in Hz and smooth patterns (2 waves, cells) of the flicker."""
        around, generator = self.surroundings, np.random.default_rng([self.seed, 105])
        corner = 1 / (2 * np.pi * around.flicker_time_s)
        strata = (np.arange(WAVES) + generator.uniform(0, 1, WAVES)) / WAVES
        size = self._cells
        spread = FLICKER_PX * self.geometry.columns / FULL_COLUMNS / self._block
        noise = generator.normal(size=(2 * WAVES, *size)).astype(np.float32)
        smooth = np.stack([cv2.GaussianBlur(one, (0, 0), spread) for one in noise])
        smooth *= around.flicker / (smooth.std() * np.sqrt(WAVES))
        return corner * np.tan(np.pi / 2 * strata), smooth.reshape(2 * WAVES, -1)

    @property
    def _block(self) -> int:
        return max(1, FLICKER_BLOCK * self.geometry.columns // FULL_COLUMNS)

    @property
    def _cells(self) -> tuple[int, int]:
        return -(-self.geometry.rows // self._block), -(-self.geometry.columns // self._block)

    def _local(self, time_s: float) -> Picture:
        """Return the flicker of hot gas (rows, columns): positive factors about 1."""
        hertz, patterns = self._patterns
        angle = 2 * np.pi * hertz * time_s
        weights = np.concatenate([np.cos(angle), np.sin(angle)]).astype(np.float32)
        # not by BLAS, whose sums depend on how many threads it has
        field = np.exp(np.einsum("i,ij->j", weights, patterns))
        field *= np.float32(np.exp(self.common(time_s) - 1))
        size = (self.geometry.columns, self.geometry.rows)
        return cv2.resize(field.reshape(self._cells), size, interpolation=cv2.INTER_LINEAR)

    def at(self, time_s: float) -> Picture:
        """Return the picture (rows, columns) at a time, without particles and noise."""
        return self.veiled(time_s)[0]

    def veiled(self, time_s: float) -> tuple[Picture, Veil]:
        """Return the picture and the burner's flame that is in it."""
        picture = self._local(time_s)
        artefacts = np.float32(self.surroundings.edge_strength * self.common(2 * time_s))
        edge = self.surroundings.edge_px
        middle = slice(edge, -edge)
        for strip in (np.s_[:edge], np.s_[-edge:], np.s_[middle, :edge], np.s_[middle, -edge:]):
            picture[strip] *= 1 + self._edges[strip] * artefacts
        picture *= self.level
        veil = self.flame.at(time_s, self.optics)
        top, bottom, left, right = veil.rectangle
        behind = picture[top:bottom, left:right]
        behind *= veil.passing
        behind += veil.own
        return picture, veil
