"""Lance and burner as bodies in the kiln, and the burner's flame.

The thesis shows both (Figs 2.2 and 3.4) and prints a diameter of 40 mm for a lance, and that the
burner is partly inside the kiln with a flame that is exceptionally bright (section 3.1). All
else is assumed. The flame is made of puffs of soot that leave the nozzle, grow, drift with the
gas and burn out; what is seen is the sum of their optical depths along the line of sight.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import numpy.typing as npt
from threadpoolctl import ThreadpoolController

from kilnflight.checks import check_number
from kilnflight.twin.camera import Geometry, Optics
from kilnflight.twin.picture import Veil

Array = npt.NDArray[np.float64]
Rectangle = tuple[int, int, int, int]

LIBRARIES = ThreadpoolController()
PUFFS = 320  # in the flame at once
STORED = 8192  # different puffs; then they come again


@dataclass(frozen=True)
class Burner:
    """Tubes of lance and burner, and the soot of the burner's flame; assumptions."""

    lance_bore_mm: float = 20.0  # radius: 40 mm of the lance (sec. 2.1.1)
    lance_mm: float = 34.0  # radius outside, with cooling
    tube_mm: float = 70.0  # radius of the burner's tube
    nozzle_mm: float = 42.0  # radius
    tip_depth_mm: float = 7300.0  # "partly inside the rotary kiln": 1.8 m
    # The nozzle in the rectangle of the flame, as share of its rows and columns
    tip: tuple[float, float] = (0.40, 0.88)
    lance_shade: float = 0.30  # of cooled steel in the wall's light, over the wall
    bore_shade: float = 0.12  # of its cold inside
    length_mm: float = 2200.0  # of the flame
    speed_m_s: float = 12.0  # of its puffs at the nozzle
    spreading: float = 0.031  # growth of the flame's radius per length
    wander: float = 0.5  # radii of the flame by which puffs leave its centre line
    puff: float = 0.42  # radius of a puff over the flame's
    rise_mm: float = 10.0  # by buoyancy at the end of the flame
    opacity: float = 0.45  # optical depth of the middle of the flame
    soot_k: float = 1900.0
    reach_mm: float = 420.0  # within which its light brightens the wall
    reflected: float = 0.35  # greatest share of the wall's own light that this adds

    def __post_init__(self) -> None:
        """Refuse what is not positive."""
        for field in fields(self):
            for value in np.atleast_1d(getattr(self, field.name)):
                check_number(float(value), f"Burner: {field.name}", above=0)


@dataclass(frozen=True)
class Tube:
    """A tube from the inlet to its mouth, along the kiln's axis or rising from it."""

    mouth_m: tuple[float, float, float]  # kiln coordinates
    radius_mm: float
    bore_mm: float  # radius of its mouth
    shade: float  # grey value over that of the wall
    bore_shade: float
    elevation_deg: float = 0.0  # over the axis

    def _turned(self, vectors: Array) -> Array:
        """Return vectors (..., 3) of the kiln in the tube's own directions: along, aside, up."""
        angle = np.deg2rad(self.elevation_deg)
        x, y, z = np.moveaxis(vectors, -1, 0)
        along, up = np.cos(angle) * x + np.sin(angle) * z, np.cos(angle) * z - np.sin(angle) * x
        return np.stack([along, y, up], axis=-1)

    def seen(self, geometry: Geometry, row: Array, column: Array) -> tuple[Array, Array]:
        """Return depth in mm (infinite beside the tube) and shade at pixels.

        The camera sees its mouth, and the side that is turned to the camera's own axis.
        """
        ray = self._turned(
            geometry.unproject(row, column, np.ones(np.shape(row))) @ geometry.axes.T
        )
        start = self._turned(
            -geometry.origin_mm @ geometry.axes.T - 1000.0 * np.array(self.mouth_m)
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            mouth = -start[0] / ray[..., 0]
            a = (ray[..., 1:] ** 2).sum(axis=-1)
            b = (ray[..., 1:] * start[1:]).sum(axis=-1)
            root = np.sqrt(b**2 - a * ((start[1:] ** 2).sum() - self.radius_mm**2))
            side = (-b - root) / a
        across = start[1:] + mouth[..., None] * ray[..., 1:]
        from_centre = np.hypot(across[..., 0], across[..., 1])
        on_mouth = from_centre <= self.radius_mm
        along = start[0] + side * ray[..., 0]
        inlet = (
            1000.0 * (geometry.inlet_m - self.mouth_m[0]) / np.cos(np.deg2rad(self.elevation_deg))
        )
        on_side = ~on_mouth & (side > 0) & (along <= 0) & (along >= inlet)
        depth = np.where(on_mouth, mouth, np.where(on_side, side, np.inf))
        # the side is the darker, the less it faces the camera
        facing = root / np.sqrt(np.maximum(a, 1e-12)) / self.radius_mm
        side_shade = self.shade * (0.45 + 0.4 * np.nan_to_num(facing))
        rim = np.where(from_centre <= self.bore_mm, self.bore_shade, self.shade)
        return depth, np.where(on_mouth, rim, side_shade)


def lance_tube(burner: Burner, geometry: Geometry, elevation_deg: float = 0.0) -> Tube:
    """Return the lance: its mouth is where particles start, and it points where they go."""
    x, y, z = map(float, geometry.lance_m)
    radii = (burner.lance_mm, burner.lance_bore_mm)
    return Tube((x, y, z), *radii, burner.lance_shade, burner.bore_shade, elevation_deg)


def burner_tube(burner: Burner, geometry: Geometry, rectangle: Rectangle) -> Tube:
    """Return the burner's tube, its mouth in the rectangle of the flame."""
    top, bottom, left, right = rectangle
    row = top + burner.tip[0] * (bottom - top)
    column = left + burner.tip[1] * (right - left)
    mouth = geometry.to_kiln(geometry.unproject(row, column, burner.tip_depth_mm))
    radii = (burner.tube_mm, burner.nozzle_mm)
    return Tube(tuple(map(float, mouth)), *radii, burner.lance_shade, burner.bore_shade)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Flame:
    """The burner's flame at any time; puffs are numbered, so that nothing is remembered."""

    burner: Burner
    tube: Tube
    geometry: Geometry
    rectangle: Rectangle
    seed: int

    @cached_property
    def _puffs(self) -> tuple[Array, Array, Array]:
        """Wander (2, stored), share of the length and strength (stored,) of puffs."""
        generator = np.random.default_rng([self.seed, 106])
        slow = generator.normal(size=(2, STORED // 16))  # eddies larger than a puff
        slow = np.repeat(slow, 16, axis=1)
        kernel = np.hanning(33)[1:-1] / np.hanning(33).sum()
        slow = np.stack([np.convolve(np.tile(row, 3), kernel, "same") for row in slow])
        wander = 0.8 * slow[:, STORED : 2 * STORED] + 0.9 * generator.normal(size=(2, STORED))
        last = generator.uniform(0.5, 1.0, STORED)
        return wander, last, generator.gamma(1.0, 1.0, STORED)

    def at(self, time_s: float, optics: Optics) -> Veil:
        """Return how much of the light behind passes the flame, and its own light."""
        flame, (wander, last, strength) = self.burner, self._puffs
        rate = PUFFS * 1000.0 * flame.speed_m_s / flame.length_mm
        newest = int(np.floor(time_s * rate))
        number = newest - np.arange(PUFFS)
        share = (time_s * rate - number) / PUFFS  # of the flame's length
        number %= STORED
        centre, radius = self._centres(share, wander[:, number])
        # soot forms soon behind the nozzle and is burnt at the puff's own end
        soot = np.clip(share / 0.08, 0, 1) * np.clip((last[number] - share) / 0.25, 0, 1)
        depth = strength[number] * soot
        scale = self.geometry.focal_length_px / centre[:, 2]
        row, column = self.geometry.project(centre)
        top, bottom, left, right = self.rectangle
        spread = radius * scale
        shine = np.flatnonzero(depth)  # others are not yet soot, or burnt
        down = _profiles(top, bottom, row[shine], spread[shine])
        over = _profiles(left, right, column[shine], spread[shine])
        with LIBRARIES.limit(limits=1, user_api="blas"):  # more threads would sum in another order
            total = (down * depth[shine, None].astype(np.float32)).T @ over
        total *= self._border * np.float32(self._opacity)
        passing = np.exp(-total)
        own = np.float32(optics.glow(flame.soot_k)) * (1 - passing)
        return Veil(float(centre[:, 2].mean()), self.rectangle, passing, own)

    def _centres(self, share: Array, wander: Array) -> tuple[Array, Array]:
        """Return the middles (puffs, 3) of puffs in camera mm, and their radii (puffs,)."""
        flame = self.burner
        along = share * flame.length_mm
        radius = flame.nozzle_mm + flame.spreading * along
        off = flame.wander * wander * radius * np.minimum(1.0, 4.0 * share)
        kiln = np.array(self.tube.mouth_m) + 1e-3 * np.stack(
            [along, off[0], off[1] + flame.rise_mm * share**2], axis=1
        )
        return self.geometry.to_camera(kiln), flame.puff * radius

    @cached_property
    def _opacity(self) -> float:
        """Optical depth of a puff of mean strength."""
        return self.burner.opacity * 12.0 / PUFFS

    @cached_property
    def _border(self) -> npt.NDArray[np.float32]:
        """Let the flame end softly before its rectangle does, (rows, columns)."""
        top, bottom, left, right = self.rectangle
        down, over = np.linspace(-1, 1, bottom - top)[:, None], np.linspace(-1, 1, right - left)
        from_middle = (down**4 + over**4) ** 0.25  # round corners
        outside = np.clip((from_middle - 0.6) / 0.4, 0, 1)
        return (0.5 + 0.5 * np.cos(np.pi * outside)).astype(np.float32)

    def lights(self, camera_mm: Array, optics: Optics) -> Array:
        """Return the grey values that its light adds to walls at positions (..., 3)."""
        middle = np.add(self.tube.mouth_m, [self.burner.length_mm / 2500.0, 0.0, 0.0])
        distance = np.linalg.norm(camera_mm - self.geometry.to_camera(middle), axis=-1)
        falls = 1 + (distance / self.burner.reach_mm) ** 2
        return self.burner.reflected * optics.at_wall / falls


def _profiles(first: int, last: int, middle: Array, spread: Array) -> npt.NDArray[np.float32]:
    """Return Gaussian profiles (puffs, pixels) across the pixels from the first to the last."""
    start, step = ((part / spread).astype(np.float32)[:, None] for part in (first - middle, 1.0))
    away = start + step * np.arange(last - first, dtype=np.float32)
    away *= -away
    return np.exp(away, out=away)
