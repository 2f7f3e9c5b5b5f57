"""What pushes and heats a particle: drag, lift, convection, radiation (SI units)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kilnflight.twin.gas import HEAT_CAPACITY_J_KG_K, PRANDTL, density, viscosity

Array = npt.NDArray[np.float64]

STEFAN_BOLTZMANN = 5.670e-8  # W/m2/K4
LATENT_HEAT_J_KG = 2.26e6  # of water at ambient pressure
DRYING_K = (373.0, 383.0)  # the water leaves while the body warms through this range


def sphere_drag(reynolds: Array) -> Array:
    """Return the drag coefficient of a sphere (Schiller and Naumann 1933; 0.44 above 1000)."""
    re = np.maximum(reynolds, 1e-9)
    return np.where(re < 1000.0, 24.0 / re * (1 + 0.15 * re**0.687), 0.44)


def disc_drag(reynolds: Array) -> Array:
    """Return the drag coefficient of a disc broadside on (Clift, Grace and Weber 1978)."""
    re = np.maximum(reynolds, 1e-9)
    return np.where(re < 133.0, 64.0 / (np.pi * re) * (1 + 0.138 * re**0.792), 1.17)


def reynolds(slip_m_s: Array, diameter_m: Array, temperature_k: Array) -> Array:
    """Return the Reynolds number of the slip velocity."""
    return density(temperature_k) * slip_m_s * diameter_m / viscosity(temperature_k)


def heat_transfer(slip_m_s: Array, diameter_m: Array, temperature_k: Array) -> Array:
    """Return the convective heat transfer coefficient in W/m2/K (Ranz and Marshall 1952)."""
    number = reynolds(slip_m_s, diameter_m, temperature_k)
    nusselt = 2 + 0.6 * np.sqrt(number) * PRANDTL ** (1 / 3)
    conductivity = viscosity(temperature_k) * HEAT_CAPACITY_J_KG_K / PRANDTL
    return nusselt * conductivity / diameter_m


def heat_flux(
    surface_k: Array, gas_k: Array, wall_k: float, coefficient: Array, emissivity: float
) -> Array:
    """Return the heat flux into a surface in W/m2: convection and radiation of the wall."""
    radiation = emissivity * STEFAN_BOLTZMANN * (wall_k**4 - surface_k**4)
    return coefficient * (gas_k - surface_k) + radiation


def apparent_heat_capacity(temperature_k: Array, dry_j_kg_k: float, moisture: float) -> Array:
    """Return the heat capacity in J/kg/K of dry mass, the latent heat of its water included.

    The water's latent heat is spread over `DRYING_K`, so that the energy to dry is right
    and the temperature stays near 100 degC while it is being spent.
    """
    low, high = DRYING_K
    drying = (temperature_k >= low) & (temperature_k < high)
    return dry_j_kg_k + np.where(drying, moisture * LATENT_HEAT_J_KG / (high - low), 0.0)


def conduct(
    nodes_k: Array,
    flux_w_m2: Array,
    half_m: Array,
    properties: tuple[float, float, Array, float],
    geometry: int,
    step_s: float,
) -> Array:
    """Return node temperatures one explicit step later.

    Finite volumes across a body: shells of equal thickness from the middle (node 0) to the
    surface (last node), for a slab (geometry 0) or a sphere (geometry 2).

    Parameters
    ----------
    nodes_k
        (n, nodes).
    flux_w_m2
        Into the surface, (n,).
    half_m
        Half thickness or radius, (n,).
    properties
        Conductivity in W/m/K, dry heat capacity in J/kg/K, density in kg/m3 (n,), moisture.
    geometry
        0 or 2.
    step_s
        Time step.
    """
    conductivity, capacity, mass_density, moisture = properties
    count = nodes_k.shape[1]
    faces = np.linspace(0.0, 1.0, count + 1)
    area = faces**geometry
    volume = np.diff(faces ** (geometry + 1)) / (geometry + 1)
    shell = half_m[:, None] / count
    through = np.zeros((len(nodes_k), count + 1))
    through[:, 1:-1] = conductivity * np.diff(nodes_k, axis=1) / shell * area[1:-1]
    through[:, -1] = flux_w_m2
    apparent = apparent_heat_capacity(nodes_k, capacity, moisture)
    stored = mass_density[:, None] * apparent * half_m[:, None] * volume
    return nodes_k + step_s * np.diff(through, axis=1) / stored
