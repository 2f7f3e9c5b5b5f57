"""The picture without particles: wall, inlet plate, lance, burner, flicker, edges.

The static part is made once per scene. The changing part is a function of time alone
(sums of sines with seeded phases), so that any frame can be rendered by itself. The
thesis shows lance and burner (Figs 2.2 and 3.4) and prints that the burner is partly
inside the kiln, with a flame that is exceptionally bright (section 3.1). All else is
assumed.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from kilnflight.arrays import Array, Index, Pair, Single, Two
from kilnflight.simulated.kiln.geometry import FULL_SCALE, Geometry, meet_tube
from kilnflight.simulated.kiln.light import Optics

FULL_COLUMNS = 2048  # columns of the full camera, for which sizes in px are
# Cells around and along the wall of each scale of its texture, and its weight
TEXTURE = ((8, 1.0), (24, 0.7), (72, 0.5), (216, 0.35))
TEXTURE_SD = 0.085  # relative; 10 K of a wall of 1423 K in the band of the sensor
PLATE = 0.47  # level of the inlet plate over the wall's
WAVES = 12  # frequencies of the flicker
FLICKER = 0.012  # relative strength of the flicker of hot gas
FLICKER_S = 0.15  # its time
FLICKER_BLOCK = 16  # px that share a value of the flicker; it is smooth over many
FLICKER_PX = 60.0  # px over which hot gas bends light alike
COMMON = 0.015  # relative flicker of the whole picture, by the burner
COMMON_HZ = (1.0, 30.0)  # its rates
EDGE_STRENGTH = 0.10  # relative, of micro-lens artefacts
LANCE_MM = 34.0  # outer radius of the lance
BORE_MM = 20.0  # radius of its bore; 40 mm across are printed (sec. 2.1.1)
TUBE_MM = 70.0  # outer radius of the burner
NOZZLE_MM = 42.0  # radius of its nozzle
STEEL = 0.30  # level of cooled steel over the wall's
COLD = 0.12  # level of a cold bore over the wall's
NOZZLE = (0.40, 0.88)  # place of the burner in rows and columns of its rectangle
NOZZLE_DEPTH_MM = 7300.0  # "partly inside the rotary kiln": 1.7 m (sec. 3.1)
FLAME_PX = (280.0, 100.0)  # length and width of the burner's flame
FLAME_LEVEL = 1.3  # grey value over full scale
FLAME_EDGE = 0.05  # width of its edge over its radius
CLUTTER_PX = (2.0, 6.0)  # Gaussian radius of a spot of clutter
CLUTTER_S = (0.6, 1.6)  # cycle in which it comes and goes
CLUTTER_SHARE = 0.25  # share of the cycle in which it shines


@dataclass(frozen=True)
class Interior:
    """Regions of the picture, as a recording states them.

    Parameters
    ----------
    flame_roi
        Rectangle of the burner's flame in px: first row, last row, first column, last
        column.
    edge_px
        Width of the border with micro-lens artefacts (section 5.1.2).
    clutter
        Mean number of spots in a frame that come and go: "light reflection" and
        residues of the background (section 3.1); assumption.
    clutter_gray
        Mean of their largest grey values, exponential; identified.
    roi
        Polygon of the region of interest, as share of rows and columns. It is not
        published and set by Table 5.3 (an input), which keeps nine tenths in air and
        half of those on the wall.
    """

    flame_roi: tuple[int, int, int, int] = (560, 980, 180, 620)
    edge_px: int = 90
    clutter: float = 80.0
    clutter_gray: float = 2500.0
    roi: tuple[Two, ...] = (
        (0.07, 0.10),
        (0.07, 0.90),
        (0.50, 0.95),
        (0.70, 0.80),
        (0.70, 0.20),
        (0.50, 0.05),
    )


def _see_tube(
    geometry: Geometry,
    mouth_m: Array,
    radius_mm: float,
    bore_mm: float,
    pixels: tuple[Index, ...],
) -> Pair:
    """Return depth in mm and level over the wall's of a tube at pixels (row, column).

    The tube lies along the kiln's axis from the inlet to its mouth (3,), with an outer
    radius and that of its bore in mm. The camera sees the mouth, and the side that is
    turned to it. Depth is infinite beside it.
    """
    camera_mm, ray = geometry.rays(*pixels)
    start = camera_mm - 1000.0 * mouth_m
    with np.errstate(divide="ignore", invalid="ignore"):
        mouth = -start[0] / ray[..., 0]
        a, b, root = meet_tube(start, ray, radius_mm)
        side = (-b - root) / a
    from_centre = np.hypot(
        start[1] + mouth * ray[..., 1], start[2] + mouth * ray[..., 2]
    )
    along = start[0] + side * ray[..., 0]
    inlet = 1000.0 * (geometry.inlet_m - mouth_m[0])
    on_mouth = from_centre <= radius_mm
    on_side = ~on_mouth & (side > 0) & (along <= 0) & (along >= inlet)
    depth = np.where(on_mouth, mouth, np.where(on_side, side, np.inf))
    # The side is the darker, the less it faces the camera.
    facing = np.nan_to_num(root / np.sqrt(a) / radius_mm)
    rim = np.where(from_centre <= bore_mm, COLD, STEEL)
    return depth, np.where(on_mouth, rim, STEEL * (0.45 + 0.4 * facing))


class Still(NamedTuple):
    """What the camera sees of the kiln; arrays (rows, columns)."""

    wall_mm: Array  # depth of wall or inlet plate
    tube_mm: Array  # depth of lance and burner; infinite where neither is
    shade: Array  # level of lance and burner over the wall's, where one is


@lru_cache(maxsize=1)  # most scenes of a process share the kiln and the burner
def _see_kiln(geometry: Geometry, nozzle_m: tuple[float, ...]) -> Still:
    """Return depths and shade of wall, lance and burner.

    They are kept for the next scene, so a caller must not change them. ``nozzle_m`` is
    the burner's mouth in kiln coordinates.
    """
    pixels = np.ogrid[: geometry.rows, : geometry.columns]
    lance_mm, lance = _see_tube(geometry, geometry.lance_m, LANCE_MM, BORE_MM, pixels)
    mouth_m = np.array(nozzle_m)
    burner_mm, burner = _see_tube(geometry, mouth_m, TUBE_MM, NOZZLE_MM, pixels)
    return Still(
        wall_mm=geometry.wall_depth(*pixels),
        tube_mm=np.minimum(lance_mm, burner_mm),
        shade=np.where(burner_mm < lance_mm, burner, lance),
    )


@lru_cache(maxsize=1)
def _edges(rows: int, columns: int, edge_px: int) -> Single:
    """Return the relative strength of the micro-lens artefacts, (rows, columns).

    They are a hexagonal pattern at the border.
    """
    row, column = np.ogrid[:rows, :columns]
    near = np.minimum(row, rows - 1 - row)
    inside = np.minimum(near, np.minimum(column, columns - 1 - column))
    k = 2 * np.pi / 23.0  # px between micro-lens images
    directions = ((1, 0), (0.5, 0.866), (0.5, -0.866))
    pattern = sum(np.cos(k * (c * column + s * row)) for c, s in directions)
    return np.asarray(np.clip(1 - inside / edge_px, 0, 1) * pattern / 3, np.float32)


def _sines(seed: int, stream: int, limits_hz: Two, time_s: float) -> Array:
    """Return three sums of six sines each, of unit spread, at a time."""
    generator = np.random.default_rng([seed, stream])
    low, high = np.log(limits_hz)
    hertz = np.exp(generator.uniform(low, high, (3, 6)))
    phase = generator.uniform(0, 2 * np.pi, (3, 6))
    waves = np.cos(2 * np.pi * hertz * time_s + phase)
    return waves.sum(axis=1) / np.sqrt(3)


class Clutter(NamedTuple):
    """Spots of light on the wall of a scene; arrays (n, ...)."""

    corner: Index  # (n, 2) row and column of the first pixel
    spot: Single  # (n, side, side) grey values when it is brightest
    hertz: Array  # rate at which each comes and goes
    phase: Array  # share of a cycle


@dataclass(frozen=True)
class Background:
    """The picture without particles at any time; all is positive."""

    geometry: Geometry
    optics: Optics
    interior: Interior
    seed: int

    def _texture(self, around: Array, along: Array) -> Array:
        """Return smooth noise of unit variance over angle and length at four scales."""
        generator = np.random.default_rng([self.seed, 101])
        total = np.zeros(around.shape)
        power = 0.0
        for cells, weight in TEXTURE:
            field = generator.normal(size=(cells, cells)).astype(np.float32)
            noise = np.pad(field, 2, mode="wrap")  # its ends meet
            x = ((around % 1.0) * cells + 1.5).astype(np.float32)
            y = ((along % 1.0) * cells + 1.5).astype(np.float32)
            total += weight * cv2.remap(noise, x, y, cv2.INTER_CUBIC)
            power += weight**2
        return total / np.sqrt(power)

    def common(self, time_s: float) -> float:
        """Return the relative brightness of the whole picture, about 1."""
        return 1 + COMMON * float(_sines(self.seed, 103, COMMON_HZ, time_s)[0])

    @cached_property
    def nozzle_m(self) -> Array:
        """Mouth of the burner in kiln coordinates, (3,)."""
        top, bottom, left, right = self.interior.flame_roi
        row = top + NOZZLE[0] * (bottom - top)
        column = left + NOZZLE[1] * (right - left)
        place_mm = self.geometry.unproject(row, column, NOZZLE_DEPTH_MM)
        return self.geometry.to_kiln(place_mm)

    @property
    def _still(self) -> Still:
        return _see_kiln(self.geometry, tuple(self.nozzle_m))

    @cached_property
    def solid_mm(self) -> Single:
        """Depth (rows, columns) of lance and burner; infinite where neither is."""
        return self._still.tube_mm.astype(np.float32)

    @cached_property
    def depth_mm(self) -> Single:
        """True depth of wall, plate, lance and burner, (rows, columns)."""
        depth = np.minimum(self._still.wall_mm, self.solid_mm)
        return depth.astype(np.float32)

    @cached_property
    def level(self) -> Single:
        """Grey values (rows, columns) of wall, plate and tubes, without flicker."""
        geometry = self.geometry
        wall_mm, tube_mm, shade = self._still
        row, column = np.ogrid[: geometry.rows, : geometry.columns]
        point = geometry.to_kiln(geometry.unproject(row, column, wall_mm))
        s, y, z = np.moveaxis(point, -1, 0)
        around = np.arctan2(z, y) / (2 * np.pi) + 0.5
        wall = np.exp(TEXTURE_SD * self._texture(around, s / 8.4 + 0.4))
        level = np.where(s <= geometry.inlet_m + 0.01, PLATE, wall)
        level = np.where(tube_mm < wall_mm, shade, level) * self.optics.at_wall
        down = np.linspace(-1, 1, geometry.rows)[:, None]
        over = 4 / 3 * np.linspace(-1, 1, geometry.columns)
        level *= 1.0 - 0.12 * (down**2 + over**2) / 2.78  # vignetting
        blur = self.optics.edge_softness_px
        return cv2.GaussianBlur(level, (0, 0), blur).astype(np.float32)

    def _burn(self, picture: Single, time_s: float) -> None:
        """Draw the burner's flame: an ellipse from the nozzle away from the lance."""
        top, bottom, left, right = self.interior.flame_roi
        ends_m = self.nozzle_m + np.outer([0.0, 0.5], [1, 0, 0])
        ends = self.geometry.project(self.geometry.to_camera(ends_m))
        nozzle, end = np.transpose(ends)  # rows and columns
        direction = (end - nozzle) / np.hypot(*(end - nozzle))
        sines = _sines(self.seed, 106, (3.0, 17.0), time_s)
        moves = 1 + np.array([0.035, 0.035, 0.08]) * sines
        length, width = np.array(FLAME_PX) * moves[:2] * self._scale
        ahead = direction * length / 2
        # In rows beyond 1.5 radii its share, below 1e-17, changes no grey value.
        down, over = direction
        reach = 0.75 * np.hypot(down * length, over * width)
        rows = nozzle[0] + ahead[0] + [-reach, reach + 1]
        top, bottom = np.clip(rows, top, bottom).astype(int)
        box = np.s_[top:bottom, left:right]
        row, column = np.ogrid[box]
        row = row - nozzle[0] - ahead[0]
        column = column - nozzle[1] - ahead[1]
        along = (row * down + column * over) / (length / 2)
        across = (column * down - row * over) / (width / 2)
        edge = 4 * (np.hypot(along, across) - 1) / FLAME_EDGE
        share = (1 / (1 + np.exp(edge))).astype(np.float32)
        level = np.float32(FLAME_LEVEL * FULL_SCALE * moves[2])
        picture[box] += share * (level - picture[box])

    @property
    def _scale(self) -> float:
        """Share of the full camera's resolution."""
        return self.geometry.columns / FULL_COLUMNS

    @cached_property
    def _clutter(self) -> Clutter:
        count = round(self.interior.clutter / CLUTTER_SHARE)
        generator = np.random.default_rng([self.seed, 107])
        radius = generator.uniform(*CLUTTER_PX, (count, 1, 1)) * self._scale
        reach = int(3 * CLUTTER_PX[1] * self._scale)
        size = np.array([self.geometry.rows, self.geometry.columns])
        centre = reach + generator.random((count, 2)) * (size - 2 * reach - 1)
        corner = np.round(centre).astype(np.intp) - reach
        offset = np.arange(2 * reach + 1) - (centre - corner)[:, :, None]
        profile = np.exp(-((offset / radius) ** 2) / 2)
        down = profile[:, 0, :, None]
        over = profile[:, 1, None, :]
        mean = self.interior.clutter_gray * self.optics.exposure
        gray = generator.exponential(mean, (count, 1, 1))
        low, high = np.log(CLUTTER_S)
        return Clutter(
            corner=corner,
            spot=(gray * down * over).astype(np.float32),
            hertz=np.exp(-generator.uniform(low, high, count)),
            phase=generator.random(count),
        )

    @cached_property
    def _patterns(self) -> tuple[Array, Single]:
        """Frequencies (waves,) in Hz, and patterns (2 waves, down, over) of flicker."""
        generator = np.random.default_rng([self.seed, 105])
        corner = 1 / (2 * np.pi * FLICKER_S)
        strata = (np.arange(WAVES) + generator.uniform(0, 1, WAVES)) / WAVES
        block = int(FLICKER_BLOCK * self._scale)
        down = -(-self.geometry.rows // block)
        over = -(-self.geometry.columns // block)
        spread = FLICKER_PX * self._scale / block
        noise = generator.normal(size=(2 * WAVES, down, over)).astype(np.float32)
        smooth = np.stack([cv2.GaussianBlur(one, (0, 0), spread) for one in noise])
        smooth *= FLICKER / (smooth.std() * np.sqrt(WAVES))
        return corner * np.tan(np.pi / 2 * strata), smooth

    def at(self, time_s: float) -> Single:
        """Return the picture (rows, columns) at a time, without particles and noise."""
        # The flicker of hot gas: positive factors about 1.
        hertz, patterns = self._patterns
        angle = 2 * np.pi * hertz * time_s
        weights = np.concatenate([np.cos(angle), np.sin(angle)]).astype(np.float32)
        # BLAS is avoided: its sums depend on the number of its threads.
        field = np.exp(np.einsum("i,ijk->jk", weights, patterns))
        field *= np.float32(np.exp(self.common(time_s) - 1))
        picture = cv2.resize(field, (self.geometry.columns, self.geometry.rows))
        artefacts = np.float32(EDGE_STRENGTH * self.common(2 * time_s))
        edge = self.interior.edge_px
        edges = _edges(*picture.shape, edge)
        sides = np.s_[edge:-edge, :edge], np.s_[edge:-edge, -edge:]
        for strip in (np.s_[:edge], np.s_[-edge:], *sides):
            picture[strip] *= 1 + edges[strip] * artefacts
        picture *= self.level
        # The clutter: slow faint spots that belong to no particle.
        corner, spot, rate, phase = self._clutter
        cycle = (rate * time_s + phase) % 1.0
        share = np.sin(np.pi * cycle / CLUTTER_SHARE).astype(np.float32) ** 2
        side = spot.shape[1]
        for k in np.flatnonzero(cycle < CLUTTER_SHARE):
            row, column = corner[k]
            picture[row : row + side, column : column + side] += share[k] * spot[k]
        self._burn(picture, time_s)
        return picture
