"""The look of particles: tumbling ellipsoids, unlit or with a flame.

All particles of a frame are drawn together. The pixels of every particle's box stand in
one long array, so that nothing loops over particles or pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.arrays import Array, Flags, Index, Single
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.geometry import FULL_SCALE, Geometry, unit_vectors
from kilnflight.simulated.kiln.life import Moment
from kilnflight.simulated.kiln.light import Looks, Optics

VISIBLE_CONTRAST = 3.0  # times the noise: what a person would mark; assumption
VISIBLE_PX = 5  # pixels of that contrast; assumption
LARGEST_RADIUS = 1.6  # of an ellipse that is drawn, in radii
FAR_PX = 1e6  # beyond every picture: a particle at the camera is endlessly large
SHEET_HZ = 12.0
BODY_HZ = 20.0  # at which particles turn; assumption


class Bodies(NamedTuple):
    """The constant properties of the particles of a scene; arrays (n, ...)."""

    half_mm: Array  # (n, 3) half axes
    axis: Array  # (n, 3) unit vector that the particle turns about (its first axis)
    across: Array  # (n, 3) unit vector across it
    turns_hz: Array
    phase: Array


def draw_bodies(table: pd.DataFrame, seed: int) -> Bodies:
    """Draw the bodies of the particles of a scene (columns as in `Life`)."""
    n = len(table)
    generator = np.random.default_rng([seed, 201])
    axis = unit_vectors(generator.normal(size=(n, 3)))
    sheet = np.array(
        [FRACTIONS[name].sheet for name in table["fraction"]], dtype=np.bool_
    )
    return Bodies(
        half_mm=table[["length_mm", "width_mm", "thickness_mm"]].to_numpy() / 2,
        axis=axis,
        across=unit_vectors(np.cross(axis, generator.normal(size=(n, 3)))),
        turns_hz=np.where(sheet, SHEET_HZ, BODY_HZ) * generator.lognormal(0.0, 0.4, n),
        phase=generator.uniform(0.0, 2 * np.pi, n),
    )


class Blobs(NamedTuple):
    """Particles as they lie in the picture; arrays (m, ...)."""

    particle: Index
    row: Array
    column: Array
    spread_px2: Array  # (m, 2, 2) of row and column: the ellipse x' S^-1 x = 1
    brightness: Array  # grey value of the covered pixels before motion blur
    passes: Array  # share of the light from behind that passes
    softness: Array  # width of the edge in units of the radius
    dilution: Array  # share of the light in the sharp ellipse after motion blur
    depth_mm: Array


def project(
    moment: Moment,
    bodies: Bodies,
    looks: Looks,
    geometry: Geometry,
    optics: Optics,
    time_s: float,
) -> Blobs:
    """Return how every particle of a moment looks, far ones first."""
    rows = moment.particle
    flame = moment.burning
    place = geometry.to_camera(moment.position_m)
    scale = geometry.focal_length_px / place[:, 2]
    curled = np.where(flame, optics.curl**2, 1.0)
    bright, swollen = looks.flutter(rows, time_s, optics.exposure_s)
    gas = np.where(flame, looks.gas_mm[rows] ** 2, 0.0)[:, None, None] * np.eye(2)
    shape = curled[:, None, None] * _ellipses(moment, bodies, geometry) + gas
    shape *= np.where(flame, swollen, 1.0)[:, None, None]
    passes = np.exp(
        -2 * np.linalg.det(shape) ** 0.25 / optics.thick_mm
    )  # through its diameter
    own = optics.flame * FULL_SCALE * optics.exposure * looks.brightness[rows] * bright
    unlit = optics.at_wall * looks.unlit(rows, time_s, optics.tumble)
    level = np.where(flame, own * (1 - passes), unlit)
    row, column = geometry.project(place)
    wind = -1000.0 * optics.tail_s * moment.velocity_m_s
    length = np.linalg.norm(wind, axis=1, keepdims=True)
    wind *= np.minimum(1.0, optics.longest_tail_mm / np.maximum(length, 1e-9))
    tail = (wind @ geometry.axes)[:, [1, 0]] * np.array([-1.0, 1.0]) * flame[:, None]
    shape = shape + tail[:, :, None] * tail[:, None, :] / 4
    row = row + tail[:, 0] * scale / 2
    column = column + tail[:, 1] * scale / 2
    shape = shape * (scale**2)[:, None, None]
    sharp = np.sqrt(np.maximum(np.linalg.det(shape), 1e-12))
    shape = shape + np.eye(2) * optics.edge_softness_px**2
    x, y, z = 1000.0 * (moment.velocity_m_s @ geometry.axes).T
    travel = np.stack(
        [-(y - z * place[:, 1] / place[:, 2]), x - z * place[:, 0] / place[:, 2]], 1
    )
    travel *= (scale * optics.exposure_s)[:, None]
    shape = shape + travel[:, :, None] * travel[:, None, :] / 4.0
    blobs = Blobs(
        particle=rows,
        row=row,
        column=column,
        spread_px2=shape,
        brightness=level,
        passes=np.where(flame, passes, 0.0),
        softness=np.where(flame, optics.flame_softness, 0.15),
        dilution=np.minimum(sharp / np.sqrt(np.linalg.det(shape)), 1.0),
        depth_mm=place[:, 2],
    )
    order = np.argsort(-blobs.depth_mm, kind="stable")
    return Blobs._make(part[order] for part in blobs)


def _ellipses(moment: Moment, bodies: Bodies, geometry: Geometry) -> Array:
    """Return the projected ellipses in mm^2, (m, 2, 2), of row and column."""
    rows = moment.particle
    angle = 2 * np.pi * bodies.turns_hz[rows] * moment.age_s + bodies.phase[rows]
    angle = np.where(moment.landed, 0.0, angle)[:, None]
    axis = bodies.axis[rows]
    across = bodies.across[rows]
    turned = np.cos(angle) * across + np.sin(angle) * np.cross(axis, across)
    directions = (
        np.stack([axis, turned, np.cross(axis, turned)], axis=1) @ geometry.axes
    )
    flat = (
        directions[..., [1, 0]] * np.array([-1.0, 1.0]) * bodies.half_mm[rows, :, None]
    )
    return np.asarray(np.einsum("mki,mkj->mij", flat, flat), dtype=np.float64)


class Pixels(NamedTuple):
    """The pixels of all boxes; arrays (k,)."""

    blob: Index  # row in `Blobs`
    place: Index  # row * columns + column
    radius: Single  # 1 on the ellipse


def cover(blobs: Blobs, rows: int, columns: int) -> Pixels:
    """Return the pixels within `LARGEST_RADIUS` of every ellipse, clipped to the
    picture.

    Each row of an ellipse is a run of pixels: what is the same in a run is computed
    once.
    """
    matrix = np.zeros((0, 2, 2))
    if len(blobs.row):
        matrix = np.asarray(np.linalg.inv(blobs.spread_px2), dtype=np.float64)
    blob, row, left, count = _runs(blobs, matrix, rows, columns)
    first = np.cumsum(count) - count
    place = np.repeat(row * columns + left - first, count)
    place += np.arange(len(place))
    x = place - np.repeat(row * columns, count) - np.repeat(blobs.column[blob], count)
    y = row - blobs.row[blob]
    matrix = matrix[blob]
    square = 2 * np.repeat(matrix[:, 0, 1], count) * x * np.repeat(y, count)
    square += np.repeat(matrix[:, 0, 0] * y * y, count)
    square += np.repeat(matrix[:, 1, 1], count) * x * x
    near = np.flatnonzero(square < LARGEST_RADIUS**2)
    radius = np.sqrt(square.take(near)).astype(np.float32)
    return Pixels(np.repeat(blob, count).take(near), place.take(near), radius)


def _runs(
    blobs: Blobs, matrix: Array, rows: int, columns: int
) -> tuple[Index, Index, Index, Index]:
    """Return blob, row, first column and length of the runs of pixels that may be
    covered.
    """
    half = np.sqrt(np.stack([blobs.spread_px2[:, 0, 0], blobs.spread_px2[:, 1, 1]]))
    half = np.minimum(np.ceil(LARGEST_RADIUS * half), FAR_PX).astype(np.intp)
    middle = np.round(np.stack([blobs.row, blobs.column])).astype(np.intp)
    top = np.maximum(middle[0] - half[0], 0)
    height = np.maximum(np.minimum(middle[0] + half[0], rows - 1) - top + 1, 0)
    blob = np.repeat(np.arange(len(height)), height)
    row = np.arange(len(blob)) + np.repeat(top - np.cumsum(height) + height, height)
    y = row - blobs.row[blob]
    slant = matrix[blob, 0, 1]
    wide = matrix[blob, 1, 1]
    room = (slant * y) ** 2 - wide * (matrix[blob, 0, 0] * y * y - LARGEST_RADIUS**2)
    reach = (
        np.sqrt(np.maximum(room, 0.0)) / wide + 0.01
    )  # px, so that rounding loses none
    centre = blobs.column[blob] - slant * y / wide
    box = half[1][blob]
    left = np.ceil(np.clip(centre - reach, 0, columns)).astype(np.intp)
    right = np.floor(np.clip(centre + reach, -1, columns - 1)).astype(np.intp)
    left = np.maximum(left, middle[1][blob] - box)
    count = np.maximum(np.minimum(right, middle[1][blob] + box) - left + 1, 0)
    return blob, row, left, count


def paint(
    picture: Single, blobs: Blobs, pixels: Pixels, optics: Optics
) -> tuple[Flags, Flags]:
    """Draw particles into a picture (rows, columns), in place, each over those behind
    it.

    Returns
    -------
    marked : (k,) bool
        Which pixels of ``pixels`` a person would mark.
    visible : (m,) bool
        Which particles a person would mark: at least `VISIBLE_PX` pixels whose contrast
        exceeds `VISIBLE_CONTRAST` times the noise.
    """
    behind, change = _drawn_over(picture, blobs, pixels)
    marked = pixels.radius <= 1.15
    inner = np.flatnonzero(marked)
    before = behind.take(inner)
    after = behind.take(inner) + change.take(inner)
    recorded = np.minimum(after, FULL_SCALE) - np.minimum(before, FULL_SCALE)
    marked[inner] = np.abs(recorded) > VISIBLE_CONTRAST * optics.noise(before)
    count = np.bincount(pixels.blob[marked], minlength=len(blobs.row))
    return marked, count >= VISIBLE_PX


def _drawn_over(picture: Single, blobs: Blobs, pixels: Pixels) -> tuple[Single, Single]:
    """Draw each particle over those behind it; return what was there, and the change
    (k,).
    """
    flat = picture.reshape(-1)
    of_blob = pixels.blob
    last = 1 / (
        1 + np.exp((LARGEST_RADIUS - 1) / blobs.softness)
    )  # it ends where it is drawn
    per_blob = (1 / blobs.softness, last, blobs.dilution / (1 - last))
    steepness, least, dilution = (
        part.astype(np.float32).take(of_blob) for part in per_blob
    )
    share = (
        np.maximum(1 / (1 + np.exp((pixels.radius - 1) * steepness)) - least, 0)
        * dilution
    )
    covered = share * (1 - blobs.passes).astype(np.float32).take(of_blob)
    added = share * blobs.brightness.astype(np.float32).take(of_blob)
    behind = np.empty_like(share)
    change = np.empty_like(share)
    for layer in _layers(pixels.place, flat.size):
        place = pixels.place.take(layer)
        there = flat.take(place)
        behind[layer], changes = there, added.take(layer) - covered.take(layer) * there
        change[layer] = changes
        flat[place] = there + changes
    return behind, change


def _layers(place: Index, size: int) -> Iterator[npt.NDArray[np.int32]]:
    """Yield the pixels of the farthest blob of each place, then the next, and so on.

    No place is twice in a layer.
    """
    rest = np.arange(len(place), dtype=np.int32)
    first = np.empty(size, dtype=np.int32)
    while len(rest):
        there = place.take(rest)
        first[there[::-1]] = rest[::-1]  # of equal places the last one assigned stays
        farthest = first.take(there) == rest
        yield rest[farthest]
        rest = rest[~farthest]
