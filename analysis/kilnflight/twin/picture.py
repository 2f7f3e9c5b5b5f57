"""The look of particles: tumbling ellipsoids, unlit or with a flame.

Unlit ones are seen in the wall's light.

All particles of a frame are drawn together. The pixels of every particle's box stand in one
long array, so that nothing loops over particles or pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.twin.camera import FULL_SCALE, Geometry, Optics, unit_vectors
from kilnflight.twin.life import Moment
from kilnflight.twin.light import Look
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.plates import projected_axes

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Single = npt.NDArray[np.float32]

VISIBLE_CONTRAST = 3.0  # times the noise: what a person would mark (twin.md, rule 5)
VISIBLE_PX = 5  # pixels of that contrast
LARGEST_RADIUS = 1.6  # of an ellipse that is drawn, in radii
FAR_PX = 1e6  # beyond every picture: a particle at the camera is endlessly large


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
    passes: Array  # share of the light from behind that passes
    softness: Array  # width of the edge in units of the radius
    dilution: Array  # share of the light in the sharp ellipse after motion blur
    depth_mm: Array
    # (m, 2) of row and column: direction in which a flame narrows, times how much (0 to 1)
    tail: Array = np.zeros((1, 2))


def project(moment: Moment, body: Bodies, geometry: Geometry, optics: Optics, look: Look) -> Blobs:
    """Return how every particle of a moment looks, far ones first."""
    rows = moment.particle
    place = geometry.to_camera(moment.position_m)
    scale = geometry.focal_length_px / place[:, 2]
    flame = moment.burning & ~look.char
    curled = np.where(moment.burning & body.sheet[rows], optics.curl**2, 1.0)[:, None, None]
    halo = np.where(flame, optics.flame_mm**2, 0.0)[:, None, None] * np.eye(2)
    shape = curled * _ellipses(moment, body, geometry) + halo
    row, column = geometry.project(place)
    shape *= np.where(flame, look.swelling, 1.0)[:, None, None]
    level, passes = _radiance(moment, body, optics, look, flame, shape)
    tail = (look.tail_mm @ geometry.axes)[:, [1, 0]] * np.array([-1.0, 1.0]) * flame[:, None]
    shape = shape + tail[:, :, None] * tail[:, None, :] / 4
    row, column = row + tail[:, 0] * scale / 2, column + tail[:, 1] * scale / 2
    shape = shape * (scale**2)[:, None, None]
    sharp = np.sqrt(np.maximum(np.linalg.det(shape), 1e-12))
    shape = shape + np.eye(2) * optics.edge_softness_px**2
    speed = geometry.axes.T @ moment.velocity_m_s[..., None] * 1000.0
    x, y, z = (speed[:, k, 0] for k in range(3))
    travel = np.stack([-(y - z * place[:, 1] / place[:, 2]), x - z * place[:, 0] / place[:, 2]], 1)
    travel = travel * (scale * optics.exposure_s)[:, None]
    shape = shape + travel[:, :, None] * travel[:, None, :] / 4.0
    blobs = Blobs(
        particle=rows,
        row=row,
        column=column,
        spread_px2=shape,
        brightness=level,
        passes=passes,
        softness=np.where(flame, optics.flame_softness, 0.15),
        dilution=np.minimum(sharp / np.sqrt(np.linalg.det(shape)), 1.0),
        depth_mm=place[:, 2],
        tail=tail * (scale / np.sqrt(np.trace(shape, axis1=1, axis2=2)))[:, None],
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
    # sheets that turn as they fly
    sheet = np.flatnonzero(np.isfinite(moment.normal).all(axis=1) & ~moment.landed)
    view = np.stack([-geometry.axes[:, 1], geometry.axes[:, 0]])
    total[sheet] = projected_axes(moment.normal[sheet], half[sheet], view, moment.along[sheet])
    return total


def _radiance(
    moment: Moment,
    body: Bodies,
    optics: Optics,
    look: Look,
    flame: npt.NDArray[np.bool_],
    shape_mm2: Array,
) -> tuple[Array, Array]:
    """Return the grey value that each particle sends out, and the share that it lets pass.

    A flame is soot as deep as it is wide, char a hot body, all else a cold one in the wall's light.
    """
    rows, light, fires = moment.particle, optics.light, look.fires
    depth_m = 2e-3 * np.linalg.det(shape_mm2) ** 0.25
    opaque = 1 - np.exp(-light.soot_1_m * look.luminosity * depth_m)
    reflected = (body.reflectivity[rows] + fires.scattered_through) * optics.irradiance
    seen = fires.seen_through
    kelvin = np.where(look.char, fires.char_k, np.where(flame, fires.soot_k, moment.surface_k))
    own = np.where(flame, opaque, body.emissivity[rows] * (1 - seen)) * optics.glow(kelvin)
    lit = np.where(flame, 0.0, reflected * fires.shade * optics.at_wall)
    return own + lit, np.where(flame, 1 - opaque, np.where(look.char, 0.0, seen))


class Pixels(NamedTuple):
    """The pixels of all boxes; arrays (k,)."""

    blob: Index  # row in `Blobs`
    place: Index  # row * columns + column
    radius: npt.NDArray[np.float32]  # 1 on the ellipse


def cover(blobs: Blobs, rows: int, columns: int) -> Pixels:
    """Return the pixels within `LARGEST_RADIUS` of every ellipse, clipped to the picture.

    Each row of an ellipse is a run of pixels: what is the same in a run is computed once.
    """
    matrix = np.zeros((0, 2, 2))
    if len(blobs.row):
        matrix = np.asarray(np.linalg.inv(blobs.spread_px2), dtype=np.float64)
    blob, row, left, count = _runs(blobs, matrix, rows, columns)
    first = np.cumsum(count) - count
    place = np.repeat(row * columns + left - first, count)
    place += np.arange(len(place))
    x = place - np.repeat(row * columns, count) - np.repeat(blobs.column[blob], count)
    y, matrix = row - blobs.row[blob], matrix[blob]
    square = 2 * np.repeat(matrix[:, 0, 1], count) * x * np.repeat(y, count)
    square += np.repeat(matrix[:, 0, 0] * y * y, count)
    square += np.repeat(matrix[:, 1, 1], count) * x * x
    if blobs.tail.any():
        # a flame narrows towards its tail: squared radii grow with the way along it
        tail = blobs.tail[blob]
        turned = np.einsum("kij,kj->ki", matrix, tail)
        turned /= np.sqrt(np.maximum((turned * tail).sum(axis=1, keepdims=True), 1e-12))
        along = np.repeat(turned[:, 1], count) * x + np.repeat(turned[:, 0] * y, count)
        along = np.maximum(along, 0.0, out=along)
        narrower = along * np.repeat(np.linalg.norm(tail, axis=1), count)
        across = np.maximum(square - along * along, 0.0)
        square += across * narrower * (2 + narrower)
    near = np.flatnonzero(square < LARGEST_RADIUS**2)
    radius = np.sqrt(square.take(near)).astype(np.float32)
    return Pixels(np.repeat(blob, count).take(near), place.take(near), radius)


def _runs(
    blobs: Blobs, matrix: Array, rows: int, columns: int
) -> tuple[Index, Index, Index, Index]:
    """Return blob, row, first column and length of the runs of pixels that may be covered."""
    half = np.sqrt(np.stack([blobs.spread_px2[:, 0, 0], blobs.spread_px2[:, 1, 1]]))
    half = np.minimum(np.ceil(LARGEST_RADIUS * half), FAR_PX).astype(np.intp)
    middle = np.round(np.stack([blobs.row, blobs.column])).astype(np.intp)
    top = np.maximum(middle[0] - half[0], 0)
    height = np.maximum(np.minimum(middle[0] + half[0], rows - 1) - top + 1, 0)
    blob = np.repeat(np.arange(len(height)), height)
    row = np.arange(len(blob)) + np.repeat(top - np.cumsum(height) + height, height)
    y, slant, wide = row - blobs.row[blob], matrix[blob, 0, 1], matrix[blob, 1, 1]
    room = (slant * y) ** 2 - wide * (matrix[blob, 0, 0] * y * y - LARGEST_RADIUS**2)
    reach = np.sqrt(np.maximum(room, 0.0)) / wide + 0.01  # px, so that rounding loses none
    centre, box = blobs.column[blob] - slant * y / wide, half[1][blob]
    left = np.ceil(np.clip(centre - reach, 0, columns)).astype(np.intp)
    right = np.floor(np.clip(centre + reach, -1, columns - 1)).astype(np.intp)
    left = np.maximum(left, middle[1][blob] - box)
    count = np.maximum(np.minimum(right, middle[1][blob] + box) - left + 1, 0)
    return blob, row, left, count


class Veil(NamedTuple):
    """Something bright and translucent in front of a rectangle: the burner's flame."""

    depth_mm: float
    rectangle: tuple[int, int, int, int]  # first row, row after the last, first column, ...
    passing: npt.NDArray[np.float32]  # (rows, columns) of the rectangle: share from behind
    own: npt.NDArray[np.float32]  # likewise: grey values that it adds

    def before(self, depth_mm: Array, place: Index, columns: int) -> tuple[Single, Single]:
        """Return both at pixels (k,) of things at these depths; nothing is before nearer ones."""
        top, bottom, left, right = self.rectangle
        passing, own = np.ones(len(place), np.float32), np.zeros(len(place), np.float32)
        veiled = np.flatnonzero(
            (depth_mm > self.depth_mm) & (place >= top * columns) & (place < bottom * columns)
        )
        row, column = np.divmod(place.take(veiled), columns)
        beside = (column >= left) & (column < right)
        veiled, inside = veiled[beside], (row[beside] - top, column[beside] - left)
        passing[veiled], own[veiled] = self.passing[inside], self.own[inside]
        return passing, own


def paint(
    picture: npt.NDArray[np.float32],
    blobs: Blobs,
    pixels: Pixels,
    optics: Optics,
    veil: Veil | None = None,
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Draw particles into a picture (rows, columns), in place.

    Each is drawn over those behind it, so that transmittances multiply.

    Returns
    -------
    marked : (k,) bool
        Which pixels of ``pixels`` a person would mark.
    visible : (m,) bool
        Which particles a person would mark: at least `VISIBLE_PX` pixels whose contrast
        exceeds `VISIBLE_CONTRAST` times the noise.
    """
    behind, change = _drawn_over(picture, blobs, pixels, veil)
    marked = pixels.radius <= 1.15
    inner = np.flatnonzero(marked)
    before, after = behind.take(inner), behind.take(inner) + change.take(inner)
    recorded = np.minimum(after, FULL_SCALE) - np.minimum(before, FULL_SCALE)
    marked[inner] = np.abs(recorded) > VISIBLE_CONTRAST * optics.noise(before)
    count = np.bincount(pixels.blob[marked], minlength=len(blobs.row))
    return marked, count >= VISIBLE_PX


def _drawn_over(
    picture: Single, blobs: Blobs, pixels: Pixels, veil: Veil | None
) -> tuple[Single, Single]:
    """Draw each particle over those behind it; return what was there, and the change (k,)."""
    flat, of_blob = picture.reshape(-1), pixels.blob
    last = 1 / (1 + np.exp((LARGEST_RADIUS - 1) / blobs.softness))  # it ends where it is drawn
    per_blob = (1 / blobs.softness, last, blobs.dilution / (1 - last))
    steepness, least, dilution = (part.astype(np.float32).take(of_blob) for part in per_blob)
    share = np.maximum(1 / (1 + np.exp((pixels.radius - 1) * steepness)) - least, 0) * dilution
    covered = share * (1 - blobs.passes).astype(np.float32).take(of_blob)
    added = share * blobs.brightness.astype(np.float32).take(of_blob)
    if veil:
        depth_mm = blobs.depth_mm.take(of_blob)
        passing, own = veil.before(depth_mm, pixels.place, picture.shape[1])
        added = passing * added + covered * own
    behind, change = np.empty_like(share), np.empty_like(share)
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
    rest, first = np.arange(len(place), dtype=np.int32), np.empty(size, dtype=np.int32)
    while len(rest):
        there = place.take(rest)
        first[there[::-1]] = rest[::-1]  # of equal places the last one assigned stays
        farthest = first.take(there) == rest
        yield rest[farthest]
        rest = rest[~farthest]
