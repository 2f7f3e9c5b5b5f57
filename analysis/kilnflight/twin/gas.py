"""The gas in the kiln, and how it pushes and heats a particle (SI units).

A slow hot stream, and the cold jet of the lance that dies in it. The jet is round and
turbulent and has a variable density. The law of constant density holds with the equivalent
diameter ``d sqrt(rho_jet / rho_gas)`` (Thring and Newby 1953). Decay and spreading are after
Pope, Turbulent Flows, 2000. Being heavier than the hot gas, it sinks. Kiln coordinates
in metres, see `kilnflight.twin.camera`.

The outlet of the lance is choked: the air's velocity is proportional to the absolute pressure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable

from kilnflight.checks import InputError, check_number
from kilnflight.twin.compiled import either, numbers

Array = npt.NDArray[np.float64]

GRAVITY_M_S2 = 9.81
GAS_CONSTANT_J_KG_K = 287.0  # of air; flue gas differs by a few per cent
PRESSURE_PA = 101_325.0
PRANDTL = 0.7  # of air and flue gas
HEAT_CAPACITY_J_KG_K = 1150.0  # of air at about 1000 K
STEFAN_BOLTZMANN = 5.670e-8  # W/m2/K4
LATENT_HEAT_J_KG = 2.26e6  # of water at ambient pressure
DRYING_K = (373.0, 383.0)  # the water leaves while the body warms through this range
AIR_OXYGEN = 0.232  # mass share of oxygen in air
AMBIENT_BAR = PRESSURE_PA / 1e5


@register_jitable
def density(temperature_k: Any) -> Any:
    """Return the density of the gas in kg/m3 (ideal gas at ambient pressure)."""
    return PRESSURE_PA / (GAS_CONSTANT_J_KG_K * temperature_k)


@register_jitable
def viscosity(temperature_k: Any) -> Any:
    """Return the dynamic viscosity of air in Pa s (Sutherland's law)."""
    relative = temperature_k / 273.15
    return 1.716e-5 * relative * np.sqrt(relative) * (273.15 + 110.4) / (temperature_k + 110.4)


@dataclass(frozen=True)
class Gas:
    """Stream and jet."""

    pressure_bar: float = 4.5  # of the lance's air; runs at 4.5 and 5 bar (sec. 5.2.1)
    velocity_at_5_bar_m_s: float = 16.0  # at the lance's outlet (sec. 2.1.1)
    # Printed for the lance of the combustion chamber (sec. 2.1.1), assumption for the kiln's. The
    # printed volumes of air, if at the pressure of the feed, give 0.10 m: 0.04 to 0.10
    lance_diameter_m: float = 0.040
    lance_temperature_k: float = 330.0  # assumption: air warmed in the lance
    temperature_k: float = 1373.0  # flue gas, 1000 to 1200 degC (sec. 2.1.1)
    wall_temperature_k: float = 1423.0  # wall about 1200 degC (sec. 5.1.1)
    stream_m_s: float = 1.5  # balance of 1.5 MW oil burner over 1.54 m2 (sec. 2.1.1): 1.5 to 2.5
    turbulence_m_s: float = 0.35  # assumption: about 20 % of stream and entrainment
    turbulence_in_jet: float = 0.20  # u'/U of a round jet, 0.2 to 0.25 (Pope 2000)
    turbulence_time_s: float = 0.1  # assumption: jet width over velocity
    decay: float = 6.3  # U_c / U_0 = 6.3 d_eff / x (Pope 2000)
    spreading: float = 0.107  # 1/e width of the velocity over x (Pope 2000)
    scalar_decay: float = 5.0  # of the cold air's share over d_eff / x (Pope 2000)
    scalar_spreading: float = 0.127  # 1/e width of the cold air's share over x (Pope 2000)
    jet_persistence: float = 1.0  # factor on the jet's excess velocity; 0: no jet
    # Axial velocity of the gas around the jet at the lance, -1.5 to 2.5 m/s: less than
    # ``stream_m_s`` where a confined jet draws gas back.
    lance_stream_m_s: float = 1.5
    # Way over which it becomes ``stream_m_s``: 1.5 diameters of the kiln. Eddies of confined jets
    # end 2 to 4 diameters behind the nozzle (Barchilon and Curtet 1964); assumption.
    recirculation_m: float = 2.1
    flue_oxygen: float = 0.045  # mass share in the flue gas: 20 % excess air of oil; assumption
    load: float = 0.0  # kg of particles in a kg of the lance's air, see `particles.air_load`
    # How much colder the wall is at the outlet than at the lance, in K per m; 0: Fig. 2.4 shows a
    # profile without an axis that can be read. A scenario.
    wall_fall_k_m: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a lance that blocks: below 4 bar the particles stick (sec. 2.1.1)."""
        if not 4.0 <= self.pressure_bar <= 6.0:
            raise InputError(
                f"Gas: pressure_bar {self.pressure_bar}: below 4 bar particles stick in the lance "
                "(sec. 2.1.1), above 6 bar nothing is published; the runs used 4.5 and 5."
            )
        check_number(self.temperature_k, "Gas: temperature_k", above=0)
        check_number(self.recirculation_m, "Gas: recirculation_m", above=0)
        if self.load < 0.0 or not 0.0 <= self.flue_oxygen <= AIR_OXYGEN:
            raise InputError(
                f"Gas: load {self.load} or flue_oxygen {self.flue_oxygen}: expected a load of 0 or "
                f"more and a mass share between 0 and {AIR_OXYGEN}, that of air."
            )

    @property
    def jet_velocity_m_s(self) -> float:
        """Return the velocity of the air at the lance's outlet.

        It is scaled from 5 bar (gauge) by the absolute pressure: the printed 4 m/s at 0.5 bar and
        16 m/s at 5 bar (sec. 2.1.1) stand like 1.51 to 6.01 bar. A load takes its momentum from
        the air.
        """
        ratio = (self.pressure_bar + AMBIENT_BAR) / (5.0 + AMBIENT_BAR)
        return float(self.velocity_at_5_bar_m_s * ratio / (1.0 + self.load))

    @property
    def air_kg_s(self) -> float:
        """Return the mass flow of the lance's air without particles."""
        area = np.pi * self.lance_diameter_m**2 / 4
        free = self.jet_velocity_m_s * (1.0 + self.load)
        return float(density(self.lance_temperature_k) * free * area)

    @property
    def effective_diameter_m(self) -> float:
        """Diameter of the jet of hot gas that carries the same momentum."""
        ratio = density(self.lance_temperature_k) / density(self.temperature_k)
        return float(self.lance_diameter_m * np.sqrt(ratio))

    @property
    def drop_1_m2(self) -> float:
        """How far the jet sinks in m, over the third power of the distance in m.

        While momentum dominates: buoyancy flux B, momentum flux M, entrainment 0.08 (Pope 2000;
        drop = 0.08 sqrt(pi) B s^3 / 3 M^1.5).
        """
        area = np.pi * self.lance_diameter_m**2 / 4
        ratio = density(self.lance_temperature_k) / density(self.temperature_k)
        buoyancy = GRAVITY_M_S2 * (ratio - 1) * self.jet_velocity_m_s * area
        momentum = ratio * self.jet_velocity_m_s**2 * area
        return float(0.08 * np.sqrt(np.pi) * buoyancy / (3 * momentum**1.5))

    @property
    def backflow_m_s(self) -> float:
        """How much slower the gas around the jet is at the lance than far behind it."""
        return self.stream_m_s - self.lance_stream_m_s

    @property
    def numbers(self) -> Any:
        """The fields and what follows from them, as compiled loops read them."""
        names = ("jet_velocity_m_s", "effective_diameter_m", "drop_1_m2", "backflow_m_s")
        return numbers(self, **{name: getattr(self, name) for name in names})


# The laws of the gas take a `Gas`, or its numbers, and a place: (s, y, z) in m from the lance, such
# as the transpose of (n, 3) positions.


@register_jitable
def stream(gas: Any, place: Any) -> Any:
    """Return the axial velocity of the gas around the jet in m/s."""
    rest = np.exp(-np.maximum(place[0], 0.0) / gas.recirculation_m)
    return gas.stream_m_s - gas.backflow_m_s * rest


@register_jitable
def wall_k(gas: Any, place: Any) -> Any:
    """Return the temperature in K of the wall beside a place."""
    return gas.wall_temperature_k - gas.wall_fall_k_m * np.maximum(place[0], 0.0)


@register_jitable
def jet_drop(gas: Any, distance_m: Any) -> Any:
    """Return how far the jet has sunk, in m, at a distance from the lance."""
    return gas.drop_1_m2 * distance_m**3


@register_jitable
def _profile(gas: Any, place: Any, decay: float, spreading: float) -> Any:
    """Return a jet's property over that at its outlet, 0 to 1."""
    distance, aside, up = place
    along = np.maximum(distance, 1e-6)
    square = aside**2 + (up + jet_drop(gas, along)) ** 2
    core = np.minimum(1.0, decay * gas.effective_diameter_m / along)
    width = np.maximum(spreading * along, gas.lance_diameter_m / 2)
    return either(distance > 0, core * np.exp(-square / width**2), 0.0)


@register_jitable
def excess_velocity(gas: Any, place: Any) -> Any:
    """Return the jet's velocity along s over that of the gas around it in m/s."""
    excess = gas.jet_persistence * (gas.jet_velocity_m_s - stream(gas, place))
    return excess * _profile(gas, place, gas.decay, gas.spreading)


@register_jitable
def cold_share(gas: Any, place: Any) -> Any:
    """Return the mass share of the lance's air, 0 to 1."""
    return _profile(gas, place, gas.scalar_decay, gas.scalar_spreading)


@register_jitable
def temperature(gas: Any, place: Any) -> Any:
    """Return the temperature in K of the mixture."""
    cold = cold_share(gas, place)
    return gas.temperature_k + cold * (gas.lance_temperature_k - gas.temperature_k)


@register_jitable
def oxygen(gas: Any, place: Any) -> Any:
    """Return the mass share of oxygen, 0 to `AIR_OXYGEN`."""
    return gas.flue_oxygen + cold_share(gas, place) * (AIR_OXYGEN - gas.flue_oxygen)


@register_jitable
def sphere_drag(reynolds: Any) -> Any:
    """Return the drag coefficient of a sphere.

    Schiller and Naumann 1933; 0.44 above 1000.
    """
    re = np.maximum(reynolds, 1e-9)
    return either(re < 1000.0, 24.0 / re * (1 + 0.15 * re**0.687), 0.44)


@register_jitable
def disc_drag(reynolds: Any) -> Any:
    """Return the drag coefficient of a disc broadside on.

    Clift, Grace and Weber 1978.
    """
    re = np.maximum(reynolds, 1e-9)
    return either(re < 133.0, 64.0 / (np.pi * re) * (1 + 0.138 * re**0.792), 1.17)


@register_jitable
def reynolds(slip_m_s: Any, diameter_m: Any, temperature_k: Any) -> Any:
    """Return the Reynolds number of the slip velocity."""
    return density(temperature_k) * slip_m_s * diameter_m / viscosity(temperature_k)


@register_jitable
def heat_transfer(slip_m_s: Any, diameter_m: Any, temperature_k: Any) -> Any:
    """Return the convective heat transfer coefficient in W/m2/K.

    Ranz and Marshall 1952.
    """
    number = reynolds(slip_m_s, diameter_m, temperature_k)
    nusselt = 2 + 0.6 * np.sqrt(number) * PRANDTL ** (1 / 3)
    conductivity = viscosity(temperature_k) * HEAT_CAPACITY_J_KG_K / PRANDTL
    return nusselt * conductivity / diameter_m


@register_jitable
def heat_flux(surface_k: Any, gas_k: Any, wall_k: Any, coefficient: Any, emissivity: Any) -> Any:
    """Return the heat flux into a surface in W/m2.

    It is convection and radiation of the wall.
    """
    radiation = emissivity * STEFAN_BOLTZMANN * (wall_k**4 - surface_k**4)
    return coefficient * (gas_k - surface_k) + radiation


@register_jitable
def apparent_heat_capacity(temperature_k: Any, dry_j_kg_k: Any, moisture: Any) -> Any:
    """Return the heat capacity in J/kg/K of dry mass.

    The latent heat of its water is included.

    The water's latent heat is spread over `DRYING_K`, so that the energy to dry is right
    and the temperature stays near 100 degC while it is being spent.
    """
    low, high = DRYING_K
    drying = (temperature_k >= low) & (temperature_k < high)
    return dry_j_kg_k + either(drying, moisture * LATENT_HEAT_J_KG / (high - low), 0.0)


def shells(count: int, geometry: int) -> tuple[Array, Array]:
    """Return outer areas and volumes, (count,), of shells of equal thickness.

    From the middle to the surface of a slab (geometry 0) or a sphere (geometry 2), over the area
    of the surface and the whole volume.
    """
    faces = np.linspace(0.0, 1.0, count + 1)
    return faces[1:] ** geometry, np.diff(faces ** (geometry + 1))


@register_jitable
def conduct(
    nodes_k: Any, flux_w_m2: float, half_m: float, properties: Any, shells: Any, step_s: float
) -> None:
    """Heat the nodes of a body by one explicit step, in place.

    Finite volumes: a node in each of its `shells`, from the middle to the surface.

    Parameters
    ----------
    nodes_k
        (nodes,).
    flux_w_m2
        Into the surface.
    half_m
        Half thickness or radius.
    properties
        Conductivity in W/m/K, dry heat capacity in J/kg/K, mass over the area of the surface in
        kg/m2, moisture.
    shells
        Their areas and volumes.
    step_s
        Time step.
    """
    conductivity, capacity, areal_kg_m2, moisture = properties
    areas, volumes = shells
    count, inner = len(nodes_k), 0.0
    through = conductivity / (half_m / count)
    for k in range(count):
        outer = flux_w_m2
        if k + 1 < count:  # of temperatures before the step
            outer = through * (nodes_k[k + 1] - nodes_k[k]) * areas[k]
        stored = areal_kg_m2 * apparent_heat_capacity(nodes_k[k], capacity, moisture) * volumes[k]
        nodes_k[k] += step_s * (outer - inner) / stored
        inner = outer
