"""The look of particles: tumbling ellipsoids, unlit or with a flame.

All particles of a frame are drawn together. The pixels of every particle's box stand in
one long array, so that nothing loops over particles.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pandas import DataFrame

from kilnflight.arrays import Array, Flags, Index, Picture, Single
from kilnflight.compiled import compiled
from kilnflight.simulated.kiln.fuel import are_sheets
from kilnflight.simulated.kiln.geometry import FULL_SCALE, Geometry
from kilnflight.simulated.kiln.life import Moment
from kilnflight.simulated.kiln.light import Looks, Optics

VISIBLE_CONTRAST = 3.0  # a person marks from this contrast over noise; assumption
VISIBLE_PX = 5  # least number of pixels with that contrast; assumption
LARGEST_RADIUS = 1.6  # an ellipse is drawn so far, in radii
MARKED_RADIUS = 1.15  # a person marks an ellipse so far
BODY_SOFTNESS = 0.15  # edge of an unlit particle over its radius; assumption
# Turns of sheets and of other particles in a second; assumptions
SHEET_HZ = 12.0
BODY_HZ = 20.0


class Bodies(NamedTuple):
    """The constant properties of the particles of a scene; arrays (n, ...)."""

    half_mm: Array  # (n, 3) half axes
    axis: Array  # (n, 3) unit vector that the particle turns about (its first axis)
    across: Array  # (n, 3) unit vector across it
    turns_hz: Array
    phase: Array


def _unit(vectors: Array) -> Array:
    """Return vectors (n, 3) scaled to length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def draw_bodies(table: DataFrame, seed: int) -> Bodies:
    """Draw the bodies of the particles of a scene (columns as in `Life`)."""
    n = len(table)
    generator = np.random.default_rng([seed, 201])
    axis = _unit(generator.normal(size=(n, 3)))
    turns_hz = np.where(are_sheets(table["fraction"]), SHEET_HZ, BODY_HZ)
    return Bodies(
        half_mm=table[["length_mm", "width_mm", "thickness_mm"]].to_numpy() / 2,
        axis=axis,
        across=_unit(np.cross(axis, generator.normal(size=(n, 3)))),
        turns_hz=turns_hz * generator.lognormal(0.0, 0.4, n),
        phase=generator.uniform(0.0, 2 * np.pi, n),
    )


class Blobs(NamedTuple):
    """Particles as they lie in the picture; arrays (m, ...)."""

    row: Array
    column: Array
    ellipse_px2: Array  # (m, 2, 2) of row and column: x' S^-1 x = 1
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
    """Project the particles of a moment into the picture, as `Blobs`.

    Parameters
    ----------
    moment
        The particles that are seen, far ones first.
    bodies, looks
        Shape and light of all particles of the scene.
    geometry, optics
        The camera's.
    time_s
        Time of the frame, which decides how particles flicker and tumble.
    """
    who = moment.particle
    flame = moment.burning
    place_mm = geometry.to_camera(moment.position_m)
    row, column = geometry.project(place_mm)
    px_per_mm = geometry.focal_length_px / place_mm[:, 2]
    flicker, area = looks.flutter(who, time_s, optics.exposure_s)
    fuel_mm2 = _ellipses(moment, bodies, geometry)
    # A flame is the curled fuel, and burning gas around it; its area changes.
    gas_mm2 = np.square(looks.gas_mm[who])[:, None, None] * np.eye(2)
    flame_mm2 = (fuel_mm2 * optics.curl**2 + gas_mm2) * area[:, None, None]
    ellipse_mm2 = np.where(flame[:, None, None], flame_mm2, fuel_mm2)
    # The thicker a flame, the less light passes (Beer and Lambert).
    diameter_mm = 2 * np.linalg.det(ellipse_mm2) ** 0.25
    passes = np.exp(-diameter_mm / optics.thick_mm)
    lit_gray = optics.at_flame * looks.brightness[who] * flicker * (1 - passes)
    unlit_gray = optics.at_wall * looks.unlit(who, time_s, optics.tumble)
    tail_mm = _tails(moment, geometry, optics)
    sharp = _smear(ellipse_mm2, tail_mm) * (px_per_mm**2)[:, None, None]
    # Blurred by the lens, then by the way during the exposure.
    px_s_per_mm = px_per_mm * optics.exposure_s
    way_px = _travels(moment, place_mm, geometry) * px_s_per_mm[:, None]
    blurred = _smear(sharp + np.eye(2) * optics.edge_softness_px**2, way_px)
    # A tail lies on one side, so half of it moves the centre.
    return Blobs(
        row=row + tail_mm[:, 0] * px_per_mm / 2,
        column=column + tail_mm[:, 1] * px_per_mm / 2,
        ellipse_px2=blurred,
        brightness=np.where(flame, lit_gray, unlit_gray),
        passes=np.where(flame, passes, 0.0),
        softness=np.where(flame, optics.flame_softness, BODY_SOFTNESS),
        dilution=np.minimum(_half_axes(sharp) / _half_axes(blurred), 1.0),
        depth_mm=place_mm[:, 2],
    )


def _half_axes(ellipses: Array) -> Array:
    """Return the product of the half axes of ellipses (m, 2, 2)."""
    return np.sqrt(np.maximum(np.linalg.det(ellipses), 1e-12))


def _smear(ellipses: Array, vectors: Array) -> Array:
    """Return ellipses (m, 2, 2) drawn out along vectors (m, 2)."""
    return ellipses + vectors[:, :, None] * vectors[:, None, :] / 4


def _down_and_over(vectors: Array, geometry: Geometry) -> Array:
    """Return how far kiln vectors (..., 3) go down and to the right, (..., 2)."""
    return (vectors @ geometry.axes)[..., [1, 0]] * np.array([-1.0, 1.0])


def _tails(moment: Moment, geometry: Geometry, optics: Optics) -> Array:
    """Return the tails of flames in mm down and to the right, (m, 2)."""
    wind = -1000.0 * optics.tail_s * moment.velocity_m_s
    length = np.linalg.norm(wind, axis=1, keepdims=True)
    wind *= np.minimum(1.0, optics.longest_tail_mm / np.maximum(length, 1e-9))
    return _down_and_over(wind, geometry) * moment.burning[:, None]


def _travels(moment: Moment, place: Array, geometry: Geometry) -> Array:
    """Return the velocities in mm/s down and to the right at the particles' depth.

    ``place`` (m, 3) is in camera coordinates.
    """
    x, y, z = 1000.0 * (moment.velocity_m_s @ geometry.axes).T
    down = -(y - z * place[:, 1] / place[:, 2])
    return np.stack([down, x - z * place[:, 0] / place[:, 2]], axis=1)


def _ellipses(moment: Moment, bodies: Bodies, geometry: Geometry) -> Array:
    """Return the projected ellipses in mm^2, (m, 2, 2), of row and column."""
    rows = moment.particle
    angle = 2 * np.pi * bodies.turns_hz[rows] * moment.age_s + bodies.phase[rows]
    angle = np.where(moment.landed, 0.0, angle)[:, None]
    axis = bodies.axis[rows]
    across = bodies.across[rows]
    turned = np.cos(angle) * across + np.sin(angle) * np.cross(axis, across)
    directions = np.stack([axis, turned, np.cross(axis, turned)], axis=1)
    flat = _down_and_over(directions, geometry) * bodies.half_mm[rows, :, None]
    return np.asarray(np.einsum("mki,mkj->mij", flat, flat))


class Pixels(NamedTuple):
    """The pixels of all boxes; arrays (k,)."""

    blob: Index  # row in `Blobs`
    place: Index  # row * columns + column
    radius: Single  # 1 on the ellipse

    def take(self, chosen: Flags) -> Pixels:
        """Return some of the pixels, by a mask."""
        return Pixels._make(part[chosen] for part in self)


def cover(blobs: Blobs, rows: int, columns: int) -> Pixels:
    """Return the pixels of a picture within `LARGEST_RADIUS` of every ellipse."""
    middle = np.stack([blobs.row, blobs.column], axis=1)
    spread = np.diagonal(blobs.ellipse_px2, axis1=1, axis2=2)
    # 0.01 px more, so that rounding loses none
    reach = LARGEST_RADIUS * np.sqrt(spread) + 0.01
    shape = (rows, columns)
    first = np.ceil(middle - reach).clip(0, shape).astype(np.intp)
    end = (np.floor(middle + reach) + 1).clip(0, shape).astype(np.intp)
    form = np.linalg.inv(blobs.ellipse_px2).reshape(-1, 4)
    return Pixels(*_search(middle, form, first, end, columns))


@compiled
def _search(middle: Any, form: Any, first: Any, end: Any, columns: int) -> Any:
    """Return blob, place and radius of the pixels of ellipses, as `Pixels`.

    The rows of ``form`` are inverse ellipses. The search of a box begins at ``first``
    and stops before ``end``, row and column.
    """
    sides = np.maximum(end - first, 0)
    size = (sides[:, 0] * sides[:, 1]).sum()
    blob = np.empty(size, np.intp)
    place = np.empty(size, np.intp)
    radius = np.empty(size, np.float32)
    count = 0
    for k in range(len(middle)):
        tall, slant, _, wide = form[k]
        for row in range(first[k, 0], end[k, 0]):
            y = row - middle[k, 0]
            for column in range(first[k, 1], end[k, 1]):
                x = column - middle[k, 1]
                square = 2 * slant * x * y + tall * y * y + wide * x * x
                if square < LARGEST_RADIUS**2:
                    blob[count] = k
                    place[count] = row * columns + column
                    radius[count] = np.sqrt(square)
                    count += 1
    return blob[:count], place[:count], radius[:count]


def paint(
    picture: Single, blobs: Blobs, pixels: Pixels, optics: Optics
) -> tuple[Flags, Flags]:
    """Draw particles into a picture (rows, columns), in place.

    Returns
    -------
    marked : (k,) bool
        Which pixels of ``pixels`` a person would mark.
    visible : (m,) bool
        Which particles a person would mark: at least `VISIBLE_PX` pixels whose contrast
        exceeds `VISIBLE_CONTRAST` times the noise.
    """

    def at_pixels(values: Array) -> Single:
        return values.astype(np.float32).take(pixels.blob)

    # The profile is shifted so that it ends where it is drawn.
    last = 1 / (1 + np.exp((LARGEST_RADIUS - 1) / blobs.softness))
    edge = (pixels.radius - 1) * at_pixels(1 / blobs.softness)
    share = np.maximum(1 / (1 + np.exp(edge)) - at_pixels(last), 0)
    share *= at_pixels(blobs.dilution / (1 - last))
    covered = share * at_pixels(1 - blobs.passes)
    added = share * at_pixels(blobs.brightness)
    behind = _lay_over(picture.reshape(-1), pixels.place, added, covered)
    marked = pixels.radius <= MARKED_RADIUS
    inner = np.flatnonzero(marked)
    before = behind.take(inner)
    after = before + (added.take(inner) - covered.take(inner) * before)
    recorded = np.minimum(after, FULL_SCALE) - np.minimum(before, FULL_SCALE)
    marked[inner] = np.abs(recorded) > VISIBLE_CONTRAST * optics.noise(before)
    count = np.bincount(pixels.blob[marked], minlength=len(blobs.row))
    return marked, count >= VISIBLE_PX


@compiled
def _lay_over(picture: Any, place: Any, added: Any, covered: Any) -> Any:
    """Draw pixels at places (k,) into a picture, in place, one after the other.

    All are float32. Each hides a share of what is there, which is returned (k,), and
    adds its own. It is compiled as a place may come several times.
    """
    behind = np.empty_like(added)
    for k in range(len(place)):
        there = picture[place[k]]
        behind[k] = there
        picture[place[k]] = there + (added[k] - covered[k] * there)
    return behind


class SceneView(NamedTuple):
    """One frame before noise."""

    picture: Single
    moment: Moment  # particles in the order of the blobs
    blobs: Blobs
    pixels: Pixels
    shown: Flags  # pixels that are labelled as a particle
    visible: Flags  # blobs that a person would mark
    kinds: Picture  # label of each blob: 2, 3 or 4
    labels: Picture
