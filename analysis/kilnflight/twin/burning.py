"""Heating, ignition and burning of particles in flight.

Sheets have one temperature, chips and granules a profile. Volatiles leave as fast as heat
arrives; the char that is left fades. Ignition needs three things at once: a surface above
its ignition temperature, hot gas around it, and a slip that does not blow the flame off.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kilnflight.twin import forces
from kilnflight.twin.gas import Gas
from kilnflight.twin.state import BURNING, CHAR, UNLIT, State

Array = npt.NDArray[np.float64]

CAUSES = ("", "surface temperature", "hot gas", "slip")


def heat_and_burn(state: State, gas: Gas, gas_k: Array, slip_m_s: Array, step_s: float) -> None:
    """Advance temperatures and masses by one step, in place."""
    coefficient = forces.heat_transfer(slip_m_s, state.diameter_m, gas_k)
    wall = gas.wall_temperature_k
    flux = forces.heat_flux(state.surface_k, gas_k, wall, coefficient, state.kind.emissivity)
    unlit = state.burning == UNLIT
    nodes, surface = _warmer(state, flux, step_s)
    state.nodes_k = np.where(unlit[:, None], nodes, state.nodes_k)
    state.surface_k = np.where(unlit, surface, state.surface_k)
    power = np.maximum(flux, 0.0) * state.surface_m2
    lost = np.where(state.burning == BURNING, power / state.kind.devolatilisation_j_kg, 0.0)
    state.volatiles_kg = np.maximum(state.volatiles_kg - lost * step_s, 0.0)
    fading = np.where(state.burning == CHAR, np.exp(-step_s / state.kind.char_time_s), 1.0)
    state.char_kg = state.char_kg * fading
    state.burning[(state.burning == BURNING) & (state.volatiles_kg <= 0.0)] = CHAR


def _warmer(state: State, flux: Array, step_s: float) -> tuple[Array, Array]:
    """Return the temperatures (active, nodes) and that of the surface one step later.

    The surface lies half a shell outside the last node; the flux brings the difference.
    """
    kind = state.kind
    if kind.sheet:
        capacity = forces.apparent_heat_capacity(
            state.nodes_k[:, 0], kind.heat_capacity_j_kg_k, kind.moisture
        )
        gain = step_s * flux * state.surface_m2 / (state.dry_kg * capacity)
        return state.nodes_k + gain[:, None], state.nodes_k[:, 0] + gain
    # the volume behind the heated surface, so that mass and heat agree for any shape
    volume = state.surface_m2 * state.half_m / (kind.body + 1)
    solid = state.dry_kg / volume
    properties = (kind.conductivity_w_m_k, kind.heat_capacity_j_kg_k, solid, kind.moisture)
    nodes = forces.conduct(state.nodes_k, flux, state.half_m, properties, kind.body, step_s)
    half_shell = state.half_m / nodes.shape[1] / 2
    return nodes, nodes[:, -1] + flux * half_shell / kind.conductivity_w_m_k


def ignite(
    state: State, gas_k: Array, slip_m_s: Array, gas_limit_k: float, extinction_1_s: float
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int8]]:
    """Set fire to what fulfils all criteria, in place.

    Returns
    -------
    lit : (active,) bool
        What caught fire in this step.
    cause : (active,) int8
        Index into `CAUSES`: the criterion that had not been fulfilled one step before
        (of several, the first in that order).
    """
    met = np.stack(
        [
            state.surface_k >= state.ignition_k,
            gas_k >= gas_limit_k,
            slip_m_s / state.diameter_m < extinction_1_s,
        ],
        axis=1,
    )
    lit = met.all(axis=1) & (state.burning == UNLIT)
    cause = np.where(lit, 1 + np.argmin(state.met, axis=1), 0).astype(np.int8)
    state.burning[lit] = BURNING
    state.met = met
    return lit, cause


__all__ = ["CAUSES", "heat_and_burn", "ignite"]
