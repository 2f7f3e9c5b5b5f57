"""Heating, ignition and burning of particles in flight.

Sheets have one temperature, chips and granules a profile. Volatiles leave as fast as heat
arrives; the char that is left fades. Ignition needs three things at once: enough fuel, hot gas
around it, and a slip that does not blow the flame off. In the first look the surface has to be
above an ignition temperature and the slip below a rate. With `VolatileIgnition` the flux of
volatiles has to be above a critical one, and the flame's Damkoehler number above 1.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from kilnflight.checks import check_positive
from kilnflight.twin.gas import (
    AIR_OXYGEN,
    DRYING_K,
    HEAT_CAPACITY_J_KG_K,
    apparent_heat_capacity,
    conduct,
    heat_flux,
    heat_transfer,
)
from kilnflight.twin.particles import Fraction, Particles

Array = npt.NDArray[np.float64]

UNLIT, BURNING, CHAR = 0, 1, 2
CAUSES = ("", "surface temperature", "hot gas", "slip", "volatiles", "flame time", "glowing char")
GAS_CONSTANT_J_MOL_K = 8.314
HEAT_OF_OXYGEN_J_KG = 13.1e6  # that a flame sets free with a kg of oxygen (Huggett 1980)
SPENT = 0.02  # share of the volatiles below which char burns; assumption
# Char outshines a wall of 1400 K only where it oxidises fast: hot, and in oxygen; assumptions
GLOWING_K = 1000.0
GLOWING_OXYGEN = 0.10  # mass share; glowing cellulose goes out below 0.1 to 0.16
HOTTEST_FLAME_K = 2300.0  # dissociation keeps flames of hydrocarbons in air below


@dataclass(frozen=True)
class VolatileIgnition:
    """Ignition by the flux of volatiles, and a flame that outlasts the slip."""

    # Critical flux of volatiles at ignition, 2 to 4 g/m2 s (Drysdale 2011)
    critical_flux_kg_m2_s: float = 3.0e-3
    # Chemical time of a flame at ``reference_k`` in air, 0.1 to 10 ms: the one free number
    chemical_time_s: float = 1.5e-3
    reference_k: float = 2000.0
    activation_k: float = 15_000.0  # 125 kJ/mol (Westbrook and Dryer 1981, global steps)
    least_slip_m_s: float = 0.3  # the flow that a flame of some mm makes itself; assumption

    def __post_init__(self) -> None:
        """Refuse fluxes and times that are not positive."""
        for field in fields(self):
            check_positive(float(getattr(self, field.name)), f"VolatileIgnition: {field.name}")

    def damkoehler(self, short_m: Array, slip_m_s: Array, gas_k: Array, oxygen: Array) -> Array:
        """Return the time of the flow along the short side over that of the flame, (active,).

        The flame is as hot as the gas around and its ``oxygen`` (mass share) make it.
        """
        heated = gas_k + HEAT_OF_OXYGEN_J_KG * oxygen / HEAT_CAPACITY_J_KG_K
        flame_k = np.minimum(heated, HOTTEST_FLAME_K)
        slower = np.exp(self.activation_k * (1 / flame_k - 1 / self.reference_k))
        chemical_s = self.chemical_time_s * slower * AIR_OXYGEN / np.maximum(oxygen, 1e-6)
        return short_m / np.maximum(slip_m_s, self.least_slip_m_s) / chemical_s


@dataclass
class State:
    """The particles still in flight, with fixed and changing values.

    Arrays are (active, ...).
    """

    kind: Fraction
    char_thins: bool  # charred sheets keep their area
    index: npt.NDArray[np.intp]  # row of the particle among all
    diameter_m: Array
    short_m: Array  # shorter side of the broadside
    broadside_m2: Array
    surface_m2: Array
    half_m: Array  # half thickness or radius
    dry_kg: Array
    ignition_k: Array
    orientation: Array
    position: Array  # (active, 3)
    velocity: Array  # (active, 3)
    turbulence: Array  # (active, 3)
    lift: Array  # (active, 3) unit vectors
    nodes_k: Array  # (active, nodes): middles of the shells, from inside out
    surface_k: Array
    volatiles_kg: Array
    char_kg: Array
    burning: npt.NDArray[np.int8]
    fulfilled: npt.NDArray[np.bool_]  # (active, 3): ignition criteria of the step before
    length_m: Array  # that convection goes by
    # Of plates (`kilnflight.twin.plates`), NaN and 0 of others
    normal: Array  # (active, 3) unit vectors
    along: Array  # (active, 3) unit vectors in the plane, along the axis of spin
    spin_1_s: Array  # rad/s

    @classmethod
    def at_rest(cls, particles: Particles, nodes: int, temperature_k: float) -> State:
        """Return all particles, cold and without motion."""
        n, kind, dry = len(particles), particles.fraction, particles.dry_mass_kg
        return cls(
            kind=kind,
            char_thins=False,
            index=np.arange(n),
            diameter_m=particles.diameter_m,
            short_m=np.minimum(particles.length_m, particles.width_m),
            broadside_m2=particles.broadside_m2,
            surface_m2=particles.surface_m2,
            half_m=particles.thickness_m / 2,
            dry_kg=dry,
            ignition_k=particles.ignition_k,
            orientation=particles.orientation,
            position=np.zeros((n, 3)),
            velocity=np.zeros((n, 3)),
            turbulence=np.zeros((n, 3)),
            lift=np.tile([0.0, 0.0, 1.0], (n, 1)),
            nodes_k=np.full((n, 1 if kind.sheet else nodes), temperature_k),
            surface_k=np.full(n, temperature_k),
            volatiles_kg=dry * kind.volatile_share,
            char_kg=dry * (1 - kind.volatile_share),
            burning=np.full(n, UNLIT, dtype=np.int8),
            fulfilled=np.zeros((n, 3), dtype=bool),
            length_m=particles.diameter_m,
            normal=np.full((n, 3), np.nan),
            along=np.full((n, 3), np.nan),
            spin_1_s=np.zeros(n),
        )

    def keep(self, rows: npt.NDArray[np.bool_]) -> None:
        """Drop the particles whose flight has ended."""
        for field in fields(self)[2:]:
            setattr(self, field.name, getattr(self, field.name)[rows])

    @property
    def volatiles_1_s(self) -> Array:
        """Share of the volatiles that leaves an unlit particle in a second, (active,).

        One reaction of first order (`Fraction.pyrolysis_1_s`), mean over the volume.
        """
        kind = self.kind
        faces = np.linspace(0.0, 1.0, self.nodes_k.shape[1] + 1) ** (kind.body + 1)
        activation = kind.pyrolysis_j_mol / GAS_CONSTANT_J_MOL_K
        rate = kind.pyrolysis_1_s * np.exp(-activation / self.nodes_k)
        return rate @ np.diff(faces)

    @property
    def volatile_flux(self) -> Array:
        """Volatiles that leave an unlit surface in kg/m2/s, (active,)."""
        return self.volatiles_1_s * self.volatiles_kg / self.surface_m2

    @property
    def char_share(self) -> Array:
        """Remaining over initial char, (active,); 1 for a particle without char."""
        whole = self.dry_kg * (1 - self.kind.volatile_share)
        return np.divide(self.char_kg, whole, out=np.ones_like(whole), where=whole > 0)

    @property
    def area_share(self) -> Array:
        """Share of the broadside area that is left, (active,): charred sheets crumble, or thin."""
        charred = self.burning == CHAR
        if not charred.any() or not self.kind.sheet or self.char_thins:
            return np.ones(len(charred))
        return np.where(charred, self.char_share, 1.0)

    @property
    def release_mass_kg(self) -> Array:
        """Mass at release, water included, (active,)."""
        return self.dry_kg * (1 + self.kind.moisture)

    @property
    def mass_kg(self) -> Array:
        """Present mass, (active,); ash keeps it above 2 % of the mass at release."""
        low, high = DRYING_K
        wet = 1 - np.clip((self.nodes_k.mean(axis=1) - low) / (high - low), 0.0, 1.0)
        now = self.volatiles_kg + self.char_kg + self.kind.moisture * self.dry_kg * wet
        return np.maximum(now, 0.02 * self.release_mass_kg)


def heat_and_burn(
    state: State, wall_k: Array | float, gas_k: Array, slip_m_s: Array, step_s: float
) -> None:
    """Advance temperatures and masses by one step, in place."""
    coefficient = heat_transfer(slip_m_s, state.length_m, gas_k)
    flux = heat_flux(state.surface_k, gas_k, wall_k, coefficient, state.kind.emissivity)
    unlit = state.burning == UNLIT
    nodes, surface = _heated(state, flux, step_s)
    state.nodes_k = np.where(unlit[:, None], nodes, state.nodes_k)
    state.surface_k = np.where(unlit, surface, state.surface_k)
    power = np.maximum(flux, 0.0) * state.surface_m2
    lost = np.where(state.burning == BURNING, power / state.kind.devolatilisation_j_kg, 0.0)
    state.volatiles_kg = np.maximum(state.volatiles_kg - lost * step_s, 0.0)
    fading = np.where(state.burning == CHAR, np.exp(-step_s / state.kind.char_time_s), 1.0)
    state.char_kg = state.char_kg * fading
    state.burning[(state.burning == BURNING) & (state.volatiles_kg <= 0.0)] = CHAR


def _heated(state: State, flux: Array, step_s: float) -> tuple[Array, Array]:
    """Return the temperatures (active, nodes) and that of the surface one step later.

    The surface lies half a shell outside the last node; the flux brings the difference.
    """
    kind = state.kind
    if kind.sheet:
        capacity = apparent_heat_capacity(
            state.nodes_k[:, 0], kind.heat_capacity_j_kg_k, kind.moisture
        )
        gain = step_s * flux * state.surface_m2 / (state.dry_kg * capacity)
        return state.nodes_k + gain[:, None], state.nodes_k[:, 0] + gain
    # the volume behind the heated surface, so that mass and heat agree for any shape
    volume = state.surface_m2 * state.half_m / (kind.body + 1)
    solid = state.dry_kg / volume
    properties = (kind.conductivity_w_m_k, kind.heat_capacity_j_kg_k, solid, kind.moisture)
    nodes = conduct(state.nodes_k, flux, state.half_m, properties, kind.body, step_s)
    half_shell = state.half_m / nodes.shape[1] / 2
    return nodes, nodes[:, -1] + flux * half_shell / kind.conductivity_w_m_k


def lose_volatiles(state: State, step_s: float) -> None:
    """Let unlit particles lose volatiles for one step, in place: they are no fuel later."""
    kept = np.where(state.burning == UNLIT, np.exp(-state.volatiles_1_s * step_s), 1.0)
    state.volatiles_kg = state.volatiles_kg * kept


def glow(state: State, oxygen: Array) -> npt.NDArray[np.bool_]:
    """Turn unlit particles without volatiles into glowing char, in place; return which."""
    fuel = state.dry_kg * state.kind.volatile_share
    spent = (state.burning == UNLIT) & (state.volatiles_kg < SPENT * fuel)
    glows = spent & (state.surface_k >= GLOWING_K) & (oxygen >= GLOWING_OXYGEN)
    state.burning[glows] = CHAR
    return glows


def ignite(
    state: State,
    gas_k: Array,
    enough_fuel: npt.NDArray[np.bool_],
    flame_holds: npt.NDArray[np.bool_],
    gas_limit_k: float,
    causes: tuple[int, int, int] = (1, 2, 3),
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int8]]:
    """Ignite the particles that fulfil all criteria, in place.

    The criteria are enough fuel, gas above a limit, and a flame that holds; ``causes`` are
    their places in `CAUSES`.

    Returns
    -------
    lit : (active,) bool
        Particles that ignite in this step.
    cause : (active,) int8
        Index into `CAUSES`: the criterion that had not been fulfilled one step before
        (of several, the first in that order).
    """
    fulfilled = np.stack([enough_fuel, gas_k >= gas_limit_k, flame_holds], axis=1)
    lit = fulfilled.all(axis=1) & (state.burning == UNLIT)
    missing = np.array(causes, dtype=np.int8)[np.argmin(state.fulfilled, axis=1)]
    cause = np.where(lit, missing, 0).astype(np.int8)
    state.burning[lit] = BURNING
    state.fulfilled = fulfilled
    return lit, cause
