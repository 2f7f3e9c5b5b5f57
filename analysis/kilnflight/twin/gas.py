"""The gas in the kiln, and how it pushes and heats a particle (SI units).

A slow hot stream, and the cold jet of the lance that dies in it. The jet is round and
turbulent and has a variable density. The law of constant density holds with the equivalent
diameter ``d sqrt(rho_jet / rho_gas)`` (Thring and Newby 1953). Decay and spreading are after
Pope, Turbulent Flows, 2000. Being heavier than the hot gas, it sinks. Kiln coordinates
in metres, see `kilnflight.twin.camera`.

The defaults are those of the twin's first look. Scenarios of `kilnflight.twin.scenes` choke the
outlet of the lance, draw gas back around the jet, load it, or cool the wall along the axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_positive

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


def density(temperature_k: npt.ArrayLike) -> Array:
    """Return the density of the gas in kg/m3 (ideal gas at ambient pressure)."""
    return PRESSURE_PA / (GAS_CONSTANT_J_KG_K * np.asarray(temperature_k, dtype=np.float64))


def viscosity(temperature_k: npt.ArrayLike) -> Array:
    """Return the dynamic viscosity of air in Pa s (Sutherland's law)."""
    temperature = np.asarray(temperature_k, dtype=np.float64)
    return 1.716e-5 * (temperature / 273.15) ** 1.5 * (273.15 + 110.4) / (temperature + 110.4)


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
    # A choked outlet passes air in proportion to the absolute pressure. The printed 4 m/s at 0.5
    # bar and 16 m/s at 5 bar (sec. 2.1.1) stand like 1.51 to 6.01 bar. False: by the square root.
    choked: bool = False
    # Axial velocity of the gas around the jet at the lance, -1.5 to 2.5 m/s: less than
    # ``stream_m_s`` where a confined jet draws gas back. None: ``stream_m_s`` everywhere.
    lance_stream_m_s: float | None = None
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
        check_positive(self.temperature_k, "Gas: temperature_k")
        check_positive(self.recirculation_m, "Gas: recirculation_m")
        if self.load < 0.0 or not 0.0 <= self.flue_oxygen <= AIR_OXYGEN:
            raise InputError(
                f"Gas: load {self.load} or flue_oxygen {self.flue_oxygen}: expected a load of 0 or "
                f"more and a mass share between 0 and {AIR_OXYGEN}, that of air."
            )

    @property
    def jet_velocity_m_s(self) -> float:
        """Return the velocity of the air at the lance's outlet.

        It is scaled from 5 bar (gauge) by the absolute pressure of a choked outlet, else by the
        square root of the pressure. A load takes its momentum from the air.
        """
        ratio = (self.pressure_bar + AMBIENT_BAR) / (5.0 + AMBIENT_BAR)
        scale = ratio if self.choked else np.sqrt(self.pressure_bar / 5.0)
        return float(self.velocity_at_5_bar_m_s * scale / (1.0 + self.load))

    @property
    def air_kg_s(self) -> float:
        """Return the mass flow of the lance's air without particles."""
        area = np.pi * self.lance_diameter_m**2 / 4
        free = self.jet_velocity_m_s * (1.0 + self.load)
        return float(density(self.lance_temperature_k) * free * area)

    def stream(self, from_lance_m: Array) -> Array | float:
        """Return the axial velocity of the gas around the jet in m/s, at (n, 3) positions."""
        if self.lance_stream_m_s is None:
            return self.stream_m_s
        rest = np.exp(-np.maximum(from_lance_m[:, 0], 0.0) / self.recirculation_m)
        return self.stream_m_s + (self.lance_stream_m_s - self.stream_m_s) * rest

    def wall_k(self, from_lance_m: Array) -> Array | float:
        """Return the temperature in K of the wall beside (n, 3) positions."""
        if not self.wall_fall_k_m:
            return self.wall_temperature_k
        return self.wall_temperature_k - self.wall_fall_k_m * np.maximum(from_lance_m[:, 0], 0.0)

    def oxygen(self, from_lance_m: Array) -> Array:
        """Return the mass share of oxygen, 0 to `AIR_OXYGEN`, at (n, 3) positions."""
        cold = self.cold_share(from_lance_m)
        return self.flue_oxygen + cold * (AIR_OXYGEN - self.flue_oxygen)

    @property
    def effective_diameter_m(self) -> float:
        """Diameter of the jet of hot gas that carries the same momentum."""
        ratio = density(self.lance_temperature_k) / density(self.temperature_k)
        return float(self.lance_diameter_m * np.sqrt(ratio))

    def jet_drop(self, distance_m: Array) -> Array:
        """Return how far the jet has sunk, in m, at distances (n,) from the lance.

        The drop grows with the third power while momentum dominates: buoyancy flux B,
        momentum flux M, entrainment 0.08 (Pope 2000; drop = 0.08 sqrt(pi) B s^3 / 3 M^1.5).
        """
        area = np.pi * self.lance_diameter_m**2 / 4
        ratio = float(density(self.lance_temperature_k) / density(self.temperature_k))
        buoyancy = GRAVITY_M_S2 * (ratio - 1) * self.jet_velocity_m_s * area
        momentum = ratio * self.jet_velocity_m_s**2 * area
        return 0.08 * np.sqrt(np.pi) * buoyancy * distance_m**3 / (3 * momentum**1.5)

    def _profile(self, from_lance_m: Array, decay: float, spreading: float) -> Array:
        """Return a jet's property over that at its outlet, 0 to 1, at (n, 3) positions."""
        distance = from_lance_m[:, 0]
        along = np.maximum(distance, 1e-6)
        height = from_lance_m[:, 2] + self.jet_drop(along)
        square = from_lance_m[:, 1] ** 2 + height**2
        core = np.minimum(1.0, decay * self.effective_diameter_m / along)
        width = np.maximum(spreading * along, self.lance_diameter_m / 2)
        return np.where(distance > 0, core * np.exp(-square / width**2), 0.0)

    def excess_velocity(self, from_lance_m: Array) -> Array:
        """Return the jet's velocity over that of the gas around it in m/s.

        It is along s, at (n, 3) positions.
        """
        excess = self.jet_persistence * (self.jet_velocity_m_s - self.stream(from_lance_m))
        return excess * self._profile(from_lance_m, self.decay, self.spreading)

    def cold_share(self, from_lance_m: Array) -> Array:
        """Return the mass share of the lance's air, 0 to 1, at (n, 3) positions."""
        return self._profile(from_lance_m, self.scalar_decay, self.scalar_spreading)

    def temperature(self, from_lance_m: Array) -> Array:
        """Return the temperature in K of the mixture at (n, 3) positions from the lance."""
        cold = self.cold_share(from_lance_m)
        return self.temperature_k + cold * (self.lance_temperature_k - self.temperature_k)


def sphere_drag(reynolds: Array) -> Array:
    """Return the drag coefficient of a sphere.

    Schiller and Naumann 1933; 0.44 above 1000.
    """
    re = np.maximum(reynolds, 1e-9)
    return np.where(re < 1000.0, 24.0 / re * (1 + 0.15 * re**0.687), 0.44)


def disc_drag(reynolds: Array) -> Array:
    """Return the drag coefficient of a disc broadside on.

    Clift, Grace and Weber 1978.
    """
    re = np.maximum(reynolds, 1e-9)
    return np.where(re < 133.0, 64.0 / (np.pi * re) * (1 + 0.138 * re**0.792), 1.17)


def reynolds(slip_m_s: Array, diameter_m: Array, temperature_k: Array) -> Array:
    """Return the Reynolds number of the slip velocity."""
    return density(temperature_k) * slip_m_s * diameter_m / viscosity(temperature_k)


def heat_transfer(slip_m_s: Array, diameter_m: Array, temperature_k: Array) -> Array:
    """Return the convective heat transfer coefficient in W/m2/K.

    Ranz and Marshall 1952.
    """
    number = reynolds(slip_m_s, diameter_m, temperature_k)
    nusselt = 2 + 0.6 * np.sqrt(number) * PRANDTL ** (1 / 3)
    conductivity = viscosity(temperature_k) * HEAT_CAPACITY_J_KG_K / PRANDTL
    return nusselt * conductivity / diameter_m


def heat_flux(
    surface_k: Array, gas_k: Array, wall_k: Array | float, coefficient: Array, emissivity: float
) -> Array:
    """Return the heat flux into a surface in W/m2.

    It is convection and radiation of the wall.
    """
    radiation = emissivity * STEFAN_BOLTZMANN * (wall_k**4 - surface_k**4)
    return coefficient * (gas_k - surface_k) + radiation


def apparent_heat_capacity(temperature_k: Array, dry_j_kg_k: float, moisture: float) -> Array:
    """Return the heat capacity in J/kg/K of dry mass.

    The latent heat of its water is included.

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
