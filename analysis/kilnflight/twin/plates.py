"""Sheets as turning plates: one orientation for motion, heat and picture.

A sheet has a unit normal and, in its plane, the long side that it turns about. The pressure on it
is normal to the plate, so drag and lift are one force (Andersen, Pesavento and Wang 2005). It
spins up to the tip speed of autorotation (Iversen 1979) where its Froude number is above that of
tumbling (Belmonte, Eisenberg and Moses 1998); below it swings about broadside and settles. Moments
and the lift of the spin are those of sheets in the wind (Baker 2007). All four are cited from
memory. Chips and granules keep a mean area.

Radiation does not depend on the orientation: both faces see a wall that is as hot all around.
Convection does, by the length of Pasternak and Gauvin (1960, cited from memory).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kilnflight.checks import check_positive
from kilnflight.twin.burning import State
from kilnflight.twin.camera import unit_vectors
from kilnflight.twin.gas import GRAVITY_M_S2, density, disc_drag, reynolds

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Plates:
    """How plates are pushed and turned by the wind."""

    # Drag edge-on over broadside. 1.4 -+ 1.0 of Andersen, Pesavento and Wang is 0.4 of 2.4; their
    # lift of 1.0 sin(2 angle) then is that of a force normal to the plate.
    edge_drag: float = 1 / 6
    lift_coefficient: float = 0.4  # of the spin, at the spin of autorotation (Baker 2007)
    moment_coefficient: float = 0.12  # (Baker 2007)
    critical_froude: float = 0.67  # above it sheets tumble, 0.62 to 0.72 (Belmonte and others)
    char_thins: bool = False  # charred sheets keep their area and get thin, instead of crumbling

    def __post_init__(self) -> None:
        """Refuse coefficients that are not positive."""
        for name in ("edge_drag", "lift_coefficient", "moment_coefficient", "critical_froude"):
            check_positive(float(getattr(self, name)), f"Plates: {name}")

    @property
    def mean_drag(self) -> float:
        """Return the drag over that broadside, mean over all orientations: in the lance."""
        return self.edge_drag + (1 - self.edge_drag) / 3


def tip_speed_ratio(aspect: Array) -> Array:
    """Return the edge's over the wind's speed in autorotation.

    Iversen 1979, for plates far denser than the gas; ``aspect`` is the square of the side along
    the axis over the area.
    """
    slender = aspect / (2 + np.sqrt(4 + aspect**2)) * (2 - (aspect / (aspect + 0.595)) ** 0.76)
    return np.asarray(slender ** (2 / 3))


def projected_axes(normal: Array, half: Array, view: Array, along: Array | None = None) -> Array:
    """Return the ellipses as which plates appear, (m, 2, 2).

    Parameters
    ----------
    normal
        Unit vectors (m, 3).
    half
        Half sizes (m, 3): along the long side, across it, and half the thickness.
    view
        Unit vectors of the picture in the same coordinates, (2, 3): one for each of its directions.
    along
        Unit vectors of the long side (m, 3). None: any in the plane, as fits discs.

    Returns
    -------
    ndarray
        Matrix S of the ellipse x' S^-1 x = 1 in the picture's directions, in the unit of ``half``
        squared: its eigenvalues are the squares of the half axes.
    """
    if along is None:
        least = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
        along = unit_vectors(np.cross(normal, least))
    sides = np.stack([along, np.cross(normal, along), normal], axis=1) * half[:, :, None]
    flat = sides @ view.T
    return np.asarray(np.swapaxes(flat, 1, 2) @ flat)


def release(state: State, wind: Array, gas_k: Array, generator: np.random.Generator) -> None:
    """Draw the orientation and spin of plates that leave the lance, in place.

    Any orientation, and any spin up to that of autorotation; assumption.
    """
    n = len(state.index)
    state.along = unit_vectors(generator.normal(size=(n, 3)))
    state.normal = _upright(generator.normal(size=(n, 3)), state.along)
    free, _, _ = _autorotation(state, wind - state.velocity, gas_k, Plates())
    state.spin_1_s = generator.uniform(-1.0, 1.0, n) * free


def _dot(first: Array, second: Array) -> Array:
    """Return the products of vectors (active, 3), (active, 1)."""
    return np.asarray(np.einsum("ij,ij->i", first, second))[:, None]


def _cross(first: Array, second: Array) -> Array:
    """Return the vector products (active, 3); five times as fast as numpy's for a few hundred."""
    (a, b, c), (x, y, z) = first.T, second.T
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)


def _upright(vectors: Array, along: Array) -> Array:
    """Return unit vectors at right angles to others, next to the given ones."""
    return unit_vectors(vectors - _dot(vectors, along) * along)


def _sheet(state: State) -> tuple[Array, Array]:
    """Return mass over area in kg/m2, and the side across the axis of spin in m, (active,)."""
    left = state.area_share
    return state.mass_kg / (state.broadside_m2 * left), state.short_m * np.sqrt(left)


def froude(state: State, gas_k: Array) -> Array:
    """Return the Froude number of falling sheets, (active,).

    The root of their mass over that of the gas in a cube on the short side: of the time in which
    a plate falls by its side over that in which it swings (Belmonte and others 1998).
    """
    areal, chord = _sheet(state)
    return np.asarray(np.sqrt(areal / (density(gas_k) * chord)))


def _autorotation(
    state: State, relative: Array, gas_k: Array, plates: Plates
) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Return the spin of autorotation, the rate in 1/s at which it is reached, and if it is."""
    wind = np.sqrt(_dot(relative, relative) - _dot(relative, state.along) ** 2 + 1e-12)[:, 0]
    shape, inverse_inertia = (np.pi / 4, 16.0) if state.kind.round else (1.0, 12.0)
    ratio = tip_speed_ratio(state.broadside_m2 / (shape * state.short_m) ** 2)
    (areal, chord), gas = _sheet(state), density(gas_k)
    rate = inverse_inertia * plates.moment_coefficient * gas * wind / (4 * areal * ratio)
    tumbles = areal > plates.critical_froude**2 * gas * chord
    return 2 * ratio * wind / chord, rate, tumbles


def turn(
    state: State,
    relative: Array,
    gas_k: Array,
    plates: Plates,
    wander: float,
    step_s: float,
    generator: np.random.Generator,
) -> Array:
    """Turn plates by one step, in place; return the spin of autorotation in rad/s, (active,).

    A moment swings them about broadside. The mean moment of a turn drives what spins towards
    autorotation, or brakes it below the critical Froude number.

    Parameters
    ----------
    relative
        Velocity of the gas relative to each plate, (active, 3).
    wander
        Standard deviation in rad by which the long side turns aside in a step.
    """
    state.along = unit_vectors(state.along + wander * generator.normal(size=relative.shape))
    state.normal = _upright(state.normal, state.along)
    free, rate, tumbles = _autorotation(state, relative, gas_k, plates)
    wind, side = _upright(relative, state.along), _cross(state.along, state.normal)
    twice = -2 * (_dot(wind, state.normal) * _dot(wind, side))[:, 0]  # sine of twice the angle
    swung = state.spin_1_s - step_s * rate * free * twice
    aim = np.where(tumbles, np.sign(swung) * free, 0.0)
    state.spin_1_s = aim + (swung - aim) * np.exp(-rate * step_s)
    angle = (state.spin_1_s * step_s)[:, None]
    state.normal = np.cos(angle) * state.normal + np.sin(angle) * side
    _set_length(state, relative)
    return free


def _set_length(state: State, relative: Array) -> None:
    """Set the length that heat transfer goes by, in place: surface over perimeter in the wind.

    Pasternak and Gauvin 1960; the perimeter of an ellipse after Ramanujan.
    """
    facing = np.abs(_dot(unit_vectors(relative), state.normal))[:, 0]
    perimeter = 3 * (1 + facing) - np.sqrt((3 + facing) * (1 + 3 * facing))
    state.length_m = state.diameter_m / perimeter


def velocity_after(
    state: State, wind: Array, gas_k: Array, free: Array, plates: Plates, step_s: float
) -> Array:
    """Return the velocity of plates one step later, (active, 3).

    The drag is taken implicitly, as in `kilnflight.twin.flight`; ``free`` is of `turn`.
    """
    relative, normal = wind - state.velocity, state.normal
    slip = np.sqrt(_dot(relative, relative))
    pressure = density(gas_k)[:, None] * slip / (2 * _sheet(state)[0][:, None])
    broad = pressure * disc_drag(reynolds(slip[:, 0], state.diameter_m, gas_k))[:, None]
    edge = plates.edge_drag * broad
    spin = np.clip(state.spin_1_s / np.maximum(free, 1e-9), -1.0, 1.0)[:, None]
    push = pressure * plates.lift_coefficient * spin * _cross(relative, state.along)
    push[:, 2] -= GRAVITY_M_S2
    push += edge * wind + (broad - edge) * _dot(wind, normal) * normal
    pushed = state.velocity + step_s * push
    against = _dot(pushed, normal) * normal
    return np.asarray(against / (1 + step_s * broad) + (pushed - against) / (1 + step_s * edge))
