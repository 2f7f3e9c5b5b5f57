"""Heating, ignition and burning of particles in flight.

Sheets have one temperature, chips and granules a profile. Volatiles leave as fast as heat
arrives; the char that is left fades. Ignition needs three things at once: enough fuel, hot gas
around it, and a slip that does not blow the flame off. The flux of volatiles has to be above a
critical one, and the flame's Damkoehler number above 1 (`VolatileIgnition`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numba.extending import register_jitable

from kilnflight.checks import check_number
from kilnflight.twin.compiled import either, numbers
from kilnflight.twin.gas import (
    AIR_OXYGEN,
    DRYING_K,
    HEAT_CAPACITY_J_KG_K,
    conduct,
    heat_flux,
    heat_transfer,
    shells,
)
from kilnflight.twin.particles import Particles

UNLIT, BURNING, CHAR = 0, 1, 2
CAUSES = ("", "volatiles", "hot gas", "flame time", "glowing char")
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
            check_number(
                float(getattr(self, field.name)), f"VolatileIgnition: {field.name}", above=0
            )


@register_jitable
def damkoehler(rule: Any, short_m: Any, slip_m_s: Any, gas_k: Any, oxygen: Any) -> Any:
    """Return the time of the flow along the short side over that of the flame.

    The flame is as hot as the gas around and its ``oxygen`` (mass share) make it; ``rule`` is a
    `VolatileIgnition`.
    """
    heated = gas_k + HEAT_OF_OXYGEN_J_KG * oxygen / HEAT_CAPACITY_J_KG_K
    flame_k = np.minimum(heated, HOTTEST_FLAME_K)
    slower = np.exp(rule.activation_k * (1 / flame_k - 1 / rule.reference_k))
    chemical_s = rule.chemical_time_s * slower * AIR_OXYGEN / np.maximum(oxygen, 1e-6)
    return short_m / np.maximum(slip_m_s, rule.least_slip_m_s) / chemical_s


def at_rest(particles: Particles, nodes: int, temperature_k: float) -> Any:
    """Return the state of all particles, cold and without motion: a record array (n,).

    The laws below take it, or one of its records.
    """
    n, kind, dry = len(particles), particles.fraction, particles.dry_mass_kg
    count, areas, volumes = 1 if kind.sheet else nodes, np.zeros((n, nodes)), np.zeros((n, nodes))
    areas[:, :count], volumes[:, :count] = shells(count, kind.body)
    start: dict[str, Any] = {
        "kind": np.tile(numbers(kind), n),  # the numbers of the `Fraction`
        "disc": np.full(n, kind.round),
        "diameter_m": particles.diameter_m,
        "short_m": np.minimum(particles.length_m, particles.width_m),  # of the broadside
        "broadside_m2": particles.broadside_m2,
        "surface_m2": particles.surface_m2,
        "half_m": particles.thickness_m / 2,  # or radius
        "dry_kg": dry,
        "orientation": particles.orientation,
        "position": np.zeros((n, 3)),
        "velocity": np.zeros((n, 3)),
        "turbulence": np.zeros((n, 3)),
        "lift": np.tile([0.0, 0.0, 1.0], (n, 1)),  # unit vectors
        "shells": np.full(n, count),  # of equal thickness; what is beyond has no meaning
        "areas": areas,
        "volumes": volumes,
        "nodes_k": np.full((n, nodes), temperature_k),  # middles of the shells, from inside out
        "mean_k": np.full(n, temperature_k),  # over the thickness
        "surface_k": np.full(n, temperature_k),
        "volatiles_kg": dry * kind.volatile_share,
        "char_kg": dry * (1 - kind.volatile_share),
        "burning": np.full(n, UNLIT, dtype=np.int8),
        "gust": np.zeros((n, 3)),  # standard normal draws of the step
        "turning": np.zeros((n, 3)),
        "missing": np.zeros(n, dtype=np.int8),  # first ignition criterion not fulfilled before
        "length_m": particles.diameter_m,  # that convection goes by
        # Of plates (`kilnflight.twin.plates`), NaN and 0 of others
        "normal": np.full((n, 3), np.nan),  # unit vectors
        "along": np.full((n, 3), np.nan),  # unit vectors in the plane, along the axis of spin
        "spin_1_s": np.zeros(n),  # rad/s
        "tip_speed_ratio": np.zeros(n),  # in autorotation
    }
    layout = [(name, column.dtype, column.shape[1:]) for name, column in start.items()]
    state = np.recarray(n, np.dtype(layout, align=True))
    for name, column in start.items():
        state[name] = column
    return state


@register_jitable
def char_share(state: Any) -> Any:
    """Return remaining over initial char; 1 for a particle without char."""
    whole = state.dry_kg * (1 - state.kind.volatile_share)
    return either(whole > 0, state.char_kg / np.maximum(whole, 1e-30), 1.0)


@register_jitable
def area_share(state: Any) -> Any:
    """Return the share of the broadside area that is left: charred sheets crumble."""
    crumbles = (state.burning == CHAR) & state.kind.sheet
    return either(crumbles, char_share(state), 1.0)


@register_jitable
def mass_kg(state: Any) -> Any:
    """Return the present mass; ash keeps it above 2 % of the mass at release, water included."""
    low, high = DRYING_K
    dry = np.minimum(np.maximum((state.mean_k - low) / (high - low), 0.0), 1.0)
    water = state.kind.moisture * state.dry_kg
    now = state.volatiles_kg + state.char_kg + water * (1 - dry)
    return np.maximum(now, 0.02 * (state.dry_kg + water))


# What follows changes one particle: a record of the state.


@register_jitable
def heat_and_burn(
    particle: Any, wall_k: float, gas_k: float, slip_m_s: float, step_s: float
) -> None:
    """Advance temperatures and masses of a particle by one step."""
    kind = particle.kind
    if particle.burning == CHAR:
        particle.char_kg *= np.exp(-step_s / kind.char_time_s)
        return
    coefficient = heat_transfer(slip_m_s, particle.length_m, gas_k)
    flux = heat_flux(particle.surface_k, gas_k, wall_k, coefficient, kind.emissivity)
    if particle.burning == UNLIT:
        _heat(particle, flux, step_s)
        return
    lost = np.maximum(flux, 0.0) * particle.surface_m2 / kind.devolatilisation_j_kg
    particle.volatiles_kg = np.maximum(particle.volatiles_kg - lost * step_s, 0.0)
    if particle.volatiles_kg <= 0.0:
        particle.burning = CHAR


@register_jitable
def _heat(particle: Any, flux: float, step_s: float) -> None:
    """Heat an unlit particle by one step.

    The surface lies half a shell outside the last node; the flux brings the difference. A sheet
    has one temperature.
    """
    kind, nodes = particle.kind, particle.nodes_k[: particle.shells]
    # mass over the heated surface, so that mass and heat agree for any shape
    areal = particle.dry_kg / particle.surface_m2
    properties = (kind.conductivity_w_m_k, kind.heat_capacity_j_kg_k, areal, kind.moisture)
    conduct(nodes, flux, particle.half_m, properties, (particle.areas, particle.volumes), step_s)
    particle.mean_k = nodes.mean()
    half_shell = particle.half_m / len(nodes) / 2
    outside = 0.0 if kind.sheet else flux * half_shell / kind.conductivity_w_m_k
    particle.surface_k = nodes[-1] + outside


@register_jitable
def lose_volatiles(particle: Any, step_s: float) -> Any:
    """Let an unlit particle lose volatiles for one step: they are no fuel later.

    Returns their flux afterwards in kg/m2/s. One reaction of first order
    (`Fraction.pyrolysis_1_s`), mean over the volume.
    """
    kind, rate_1_s = particle.kind, 0.0
    for k in range(particle.shells):
        hindrance = kind.pyrolysis_j_mol / GAS_CONSTANT_J_MOL_K / particle.nodes_k[k]
        rate_1_s += particle.volumes[k] * kind.pyrolysis_1_s * np.exp(-hindrance)
    particle.volatiles_kg *= np.exp(-rate_1_s * step_s)
    return rate_1_s * particle.volatiles_kg / particle.surface_m2


@register_jitable
def glow(particle: Any, oxygen: float) -> bool:
    """Turn an unlit particle without volatiles into glowing char; return whether it does."""
    fuel = particle.dry_kg * particle.kind.volatile_share
    spent = particle.burning == UNLIT and particle.volatiles_kg < SPENT * fuel
    glows = spent and particle.surface_k >= GLOWING_K and oxygen >= GLOWING_OXYGEN
    if glows:
        particle.burning = CHAR
    return glows


@register_jitable
def ignite(particle: Any, enough_fuel: bool, hot_gas: bool, flame_holds: bool) -> int:
    """Ignite an unlit particle that fulfils all criteria.

    Returns the place in `CAUSES` of the criterion that had not been fulfilled one step before (of
    several, the first); 0 if it does not ignite.
    """
    if particle.burning != UNLIT:
        return 0
    if enough_fuel and hot_gas and flame_holds:
        particle.burning = BURNING
        return 1 + particle.missing
    particle.missing = 0 if not enough_fuel else 1 if not hot_gas else 2
    return 0
