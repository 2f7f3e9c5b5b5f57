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
from typing import Any

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable

from kilnflight.checks import check_number
from kilnflight.twin.burning import area_share, mass_kg
from kilnflight.twin.compiled import cross, dot, either, plus, put, scaled, unit, vector
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

    def __post_init__(self) -> None:
        """Refuse coefficients that are not positive."""
        for name in ("edge_drag", "lift_coefficient", "moment_coefficient", "critical_froude"):
            check_number(float(getattr(self, name)), f"Plates: {name}", above=0)

    @property
    def mean_drag(self) -> float:
        """Return the drag over that broadside, mean over all orientations: in the lance."""
        return self.edge_drag + (1 - self.edge_drag) / 3


@register_jitable
def tip_speed_ratio(aspect: Any) -> Any:
    """Return the edge's over the wind's speed in autorotation.

    Iversen 1979, for plates far denser than the gas; ``aspect`` is the square of the side along
    the axis over the area.
    """
    slender = aspect / (2 + np.sqrt(4 + aspect**2)) * (2 - (aspect / (aspect + 0.595)) ** 0.76)
    return slender ** (2 / 3)


def projected_axes(normal: Array, half: Array, view: Array, along: Array) -> Array:
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
        Unit vectors of the long side (m, 3).

    Returns
    -------
    ndarray
        Matrix S of the ellipse x' S^-1 x = 1 in the picture's directions, in the unit of ``half``
        squared: its eigenvalues are the squares of the half axes.
    """
    sides = np.stack([along, np.cross(normal, along), normal], axis=1) * half[:, :, None]
    flat = sides @ view.T
    return np.asarray(np.swapaxes(flat, 1, 2) @ flat)


def release(state: Any, wind: Array, gas_k: float, generator: np.random.Generator) -> None:
    """Draw the orientation and spin of plates that leave the lance, in place.

    Any orientation, and any spin up to that of autorotation; assumption.
    """
    n = len(state)
    along = unit(generator.normal(size=(n, 3)).T)
    normal = _upright(generator.normal(size=(n, 3)).T, along)
    state.along, state.normal = np.stack(along, axis=1), np.stack(normal, axis=1)
    shape = np.where(state.disc, np.pi / 4, 1.0)
    state.tip_speed_ratio = tip_speed_ratio(state.broadside_m2 / (shape * state.short_m) ** 2)
    free, _, _ = _autorotation(state, (wind - state.velocity).T, along, gas_k, Plates())
    state.spin_1_s = generator.uniform(-1.0, 1.0, n) * free


@register_jitable
def _upright(a: Any, along: Any) -> Any:
    """Return the unit vector at right angles to another, next to the given one."""
    return unit(plus(a, -dot(a, along), along))


@register_jitable
def _sheet(state: Any) -> Any:
    """Return mass over area in kg/m2, and the side across the axis of spin in m."""
    left = area_share(state)
    return mass_kg(state) / (state.broadside_m2 * left), state.short_m * np.sqrt(left)


@register_jitable
@register_jitable
def _autorotation(state: Any, relative: Any, along: Any, gas_k: Any, plates: Any) -> Any:
    """Return the spin of autorotation, the rate in 1/s at which it is reached, and if it is."""
    wind = np.sqrt(dot(relative, relative) - dot(relative, along) ** 2 + 1e-12)
    inverse_inertia = either(state.disc, 16.0, 12.0)
    (areal, chord), gas, ratio = _sheet(state), density(gas_k), state.tip_speed_ratio
    rate = inverse_inertia * plates.moment_coefficient * gas * wind / (4 * areal * ratio)
    tumbles = areal > plates.critical_froude**2 * gas * chord
    return 2 * ratio * wind / chord, rate, tumbles


@register_jitable
def turn(plate: Any, relative: Any, gas_k: float, plates: Any, aside: Any, step_s: float) -> Any:
    """Turn a plate by one step, in place; return the spin of autorotation in rad/s.

    A moment swings it about broadside. The mean moment of a turn drives what spins towards
    autorotation, or brakes it below the critical Froude number.

    Parameters
    ----------
    plate
        A record of the state.
    relative
        Velocity of the gas relative to the plate.
    aside
        Angles in rad by which the long side turns aside in the step.
    """
    along = unit(plus(aside, 1.0, plate.along))
    normal = _upright(vector(plate.normal), along)
    free, rate, tumbles = _autorotation(plate, relative, along, gas_k, plates)
    wind, side = _upright(relative, along), cross(along, normal)
    twice = -2 * (dot(wind, normal) * dot(wind, side))  # sine of twice the angle
    swung = plate.spin_1_s - step_s * rate * free * twice
    aim = np.sign(swung) * free if tumbles else 0.0
    plate.spin_1_s = aim + (swung - aim) * np.exp(-rate * step_s)
    angle = plate.spin_1_s * step_s
    normal = plus(scaled(np.cos(angle), normal), np.sin(angle), side)
    put(plate.along, along)
    put(plate.normal, normal)
    plate.length_m = plate.diameter_m / _perimeter(relative, normal)
    return free


@register_jitable
def _perimeter(relative: Any, normal: Any) -> Any:
    """Return the diameter over the length that heat transfer goes by.

    That length is surface over perimeter in the wind (Pasternak and Gauvin 1960); the perimeter of
    an ellipse after Ramanujan.
    """
    facing = np.abs(dot(unit(relative), normal))
    return 3 * (1 + facing) - np.sqrt((3 + facing) * (1 + 3 * facing))


@register_jitable
def velocity_after(
    plate: Any, wind: Any, gas_k: float, free: float, plates: Any, step_s: float
) -> Any:
    """Return the velocity of a plate one step later.

    The drag is taken implicitly, as in `kilnflight.twin.flight`; ``free`` is of `turn`.
    """
    normal, velocity = vector(plate.normal), vector(plate.velocity)
    relative = plus(wind, -1.0, velocity)
    slip = np.sqrt(dot(relative, relative))
    pressure = density(gas_k) * slip / (2 * _sheet(plate)[0])
    broad = pressure * disc_drag(reynolds(slip, plate.diameter_m, gas_k))
    edge = plates.edge_drag * broad
    spin = np.minimum(np.maximum(plate.spin_1_s / np.maximum(free, 1e-9), -1.0), 1.0)
    lift = pressure * plates.lift_coefficient * spin
    push = plus((0.0, 0.0, -GRAVITY_M_S2), lift, cross(relative, vector(plate.along)))
    push = plus(plus(push, edge, wind), (broad - edge) * dot(wind, normal), normal)
    pushed = plus(velocity, step_s, push)
    against = scaled(dot(pushed, normal), normal)
    in_plane = scaled(1 / (1 + step_s * edge), plus(pushed, -1.0, against))
    return plus(in_plane, 1 / (1 + step_s * broad), against)
