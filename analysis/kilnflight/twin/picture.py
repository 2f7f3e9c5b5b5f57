"""The look of particles: tumbling ellipsoids, unlit or with a flame.

Unlit ones are seen in the wall's light.

All particles of a frame are drawn together. The pixels of every particle's box stand in one
long array, so that nothing loops over particles or pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.twin.camera import FULL_SCALE, Geometry, Optics, unit_vectors
from kilnflight.twin.life import Moment
from kilnflight.twin.particles import FRACTIONS

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

VISIBLE_CONTRAST = 3.0  # times the noise: what a person would mark (twin.md, rule 5)
VISIBLE_PX = 5  # pixels of that contrast
LARGEST_PX = 120  # half a box at most; nothing that flies is larger at these depths


@dataclass(frozen=True)
class Tumbling:
    """Rates at which particles turn; axis and rate of each are constant."""

    sheet_hz: float = 12.0  # terminal velocity over a few widths; assumption
    body_hz: float = 20.0  # of chips and granules in the jet; assumption


class Bodies(NamedTuple):
    """The constant properties of the particles of a scene; arrays (n, ...)."""

    half_mm: Array  # (n, 3) half axes
    axis: Array  # (n, 3) unit vector that the particle turns about (its first axis)
    across: Array  # (n, 3) unit vector across it
    turns_hz: Array
    phase: Array
    reflectivity: Array
    emissivity: Array
    sheet: npt.NDArray[np.bool_]


def draw_bodies(table: pd.DataFrame, tumbling: Tumbling, seed: int) -> Bodies:
    """Draw the bodies of the particles of a scene (columns as in `life.live`)."""
    n = len(table)
    generator = np.random.default_rng([seed, 201])
    axis = unit_vectors(generator.normal(size=(n, 3)))
    across = unit_vectors(np.cross(axis, generator.normal(size=(n, 3))))
    kinds = [FRACTIONS[name] for name in table["fraction"]]
    sheet = np.array([kind.sheet for kind in kinds], dtype=bool)
    sizes = table[["length_mm", "width_mm", "thickness_mm"]].to_numpy()
    hertz = np.where(sheet, tumbling.sheet_hz, tumbling.body_hz)
    return Bodies(
        half_mm=sizes / 2,
        axis=axis,
        across=across,
        turns_hz=hertz * generator.lognormal(0.0, 0.4, n),
        phase=generator.uniform(0.0, 2 * np.pi, n),
        reflectivity=np.array([kind.reflectivity for kind in kinds]),
        emissivity=np.array([kind.emissivity for kind in kinds]),
        sheet=sheet,
    )


class Blobs(NamedTuple):
    """Particles as they lie in the picture; arrays (m, ...)."""

    particle: npt.NDArray[np.intp]
    row: Array
    column: Array
    spread_px2: Array  # (m, 2, 2) of row and column: the ellipse x' S^-1 x = 1
    brightness: Array  # grey value of the covered pixels before motion blur
    adds: npt.NDArray[np.bool_]  # a flame adds light, a body covers what is behind
    softness: Array  # width of the edge in units of the radius
    dilution: Array  # share of the light in the sharp ellipse after motion blur
    depth_mm: Array


def project(moment: Moment, body: Bodies, geometry: Geometry, optics: Optics) -> Blobs:
    """Return how every particle of a moment looks, far ones first."""
    rows = moment.particle
    place = geometry.to_camera(moment.position_m)
    scale = geometry.focal_length_px / place[:, 2]
    flame = moment.burning
    curled = np.where(flame & body.sheet[rows], optics.curl**2, 1.0)[:, None, None]
    halo = np.where(flame, optics.flame_mm**2, 0.0)[:, None, None] * np.eye(2)
    shape = (curled * _ellipses(moment, body, geometry) + halo) * (scale**2)[:, None, None]
    sharp = np.sqrt(np.maximum(np.linalg.det(shape), 1e-12))
    shape = shape + np.eye(2) * optics.edge_softness_px**2
    speed = geometry.axes.T @ moment.velocity_m_s[..., None] * 1000.0
    x, y, z = (speed[:, k, 0] for k in range(3))
    travel = np.stack([-(y - z * place[:, 1] / place[:, 2]), x - z * place[:, 0] / place[:, 2]], 1)
    travel = travel * (scale * optics.exposure_s)[:, None]
    shape = shape + travel[:, :, None] * travel[:, None, :] / 4.0
    row, column = geometry.project(place)
    blobs = Blobs(
        particle=rows,
        row=row,
        column=column,
        spread_px2=shape,
        brightness=_brightness(moment, body, optics),
        adds=flame,
        softness=np.where(flame, optics.flame_softness, 0.15),
        dilution=np.minimum(sharp / np.sqrt(np.linalg.det(shape)), 1.0),
        depth_mm=place[:, 2],
    )
    order = np.argsort(-blobs.depth_mm, kind="stable")
    return Blobs._make(part[order] for part in blobs)


def _ellipses(moment: Moment, body: Bodies, geometry: Geometry) -> Array:
    """Return the projected ellipses in mm^2, (m, 2, 2), of row and column."""
    rows = moment.particle
    angle = 2 * np.pi * body.turns_hz[rows] * moment.age_s + body.phase[rows]
    angle = np.where(moment.landed, 0.0, angle)
    axis, across = body.axis[rows], body.across[rows]
    third = np.cross(axis, across)
    turned = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * third
    normal = np.cross(axis, turned)
    half = body.half_mm[rows] * np.sqrt(moment.area)[:, None]
    total = np.zeros((len(rows), 2, 2))
    for k, direction in enumerate((axis, turned, normal)):
        camera = direction @ geometry.axes
        flat = np.stack([-camera[:, 1], camera[:, 0]], axis=1) * half[:, k : k + 1]
        total += flat[:, :, None] * flat[:, None, :]
    return total


def _brightness(moment: Moment, body: Bodies, optics: Optics) -> Array:
    """Return grey values: a flame, or reflected wall light and the body's own glow.

    Glowing char counts as a flame: in the light of `Optics` it would be 44,000 at 1650 K by
    Planck, a flame is 40,000.
    """
    rows = moment.particle
    reflected = body.reflectivity[rows] * optics.irradiance * optics.wall_level
    unlit = reflected + body.emissivity[rows] * optics.glow(moment.surface_k)
    return np.where(moment.burning, optics.flame_level, unlit)


class Pixels(NamedTuple):
    """The pixels of all boxes; arrays (k,)."""

    blob: Index  # row in `Blobs`
    place: Index  # row * columns + column
    radius: npt.NDArray[np.float32]  # 1 on the ellipse


def cover(blobs: Blobs, rows: int, columns: int) -> Pixels:
    """Return the pixels within 1.6 radii of every ellipse, clipped to the picture."""
    half = np.sqrt(np.stack([blobs.spread_px2[:, 0, 0], blobs.spread_px2[:, 1, 1]]))
    half = np.minimum(np.ceil(1.6 * half), LARGEST_PX).astype(np.intp)
    size = 2 * half + 1
    count = size[0] * size[1]
    blob = np.repeat(np.arange(len(count)), count)
    inner = np.arange(len(blob)) - np.repeat(np.cumsum(count) - count, count)
    down, right = np.divmod(inner, size[1][blob])
    row = np.round(blobs.row).astype(np.intp)[blob] + down - half[0][blob]
    column = np.round(blobs.column).astype(np.intp)[blob] + right - half[1][blob]
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    blob, row, column = blob[inside], row[inside], column[inside]
    inverse = np.linalg.inv(blobs.spread_px2) if len(count) else np.empty((0, 2, 2))
    y, x = row - blobs.row[blob], column - blobs.column[blob]
    matrix = inverse[blob]
    square = matrix[:, 0, 0] * y * y + 2 * matrix[:, 0, 1] * x * y + matrix[:, 1, 1] * x * x
    near = square < 2.56
    radius = np.sqrt(square[near]).astype(np.float32)
    return Pixels(blob[near], (row * columns + column)[near], radius)


def paint(
    picture: npt.NDArray[np.float32], blobs: Blobs, pixels: Pixels, optics: Optics
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Draw particles into a picture (rows, columns), in place.

    Returns
    -------
    marked : (k,) bool
        Which pixels of ``pixels`` a person would mark.
    visible : (m,) bool
        Which particles a person would mark: at least `VISIBLE_PX` pixels whose contrast
        exceeds `VISIBLE_CONTRAST` times the noise.
    """
    flat = picture.reshape(-1)
    behind = flat[pixels.place]
    softness = blobs.softness[pixels.blob]
    profile = blobs.dilution[pixels.blob] / (1 + np.exp((pixels.radius - 1) / softness))
    level = blobs.brightness[pixels.blob]
    change = np.where(blobs.adds[pixels.blob], level * profile, (level - behind) * profile)
    np.add.at(flat, pixels.place, change.astype(np.float32))
    recorded = np.minimum(behind + change, FULL_SCALE) - np.minimum(behind, FULL_SCALE)
    contrast = np.abs(recorded) > VISIBLE_CONTRAST * optics.noise(behind)
    marked = contrast & (pixels.radius <= 1.15)
    count = np.bincount(pixels.blob[marked], minlength=len(blobs.row))
    return marked, count >= VISIBLE_PX
