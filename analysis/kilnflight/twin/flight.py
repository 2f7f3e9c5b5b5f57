"""Flight of single particles from lance to end, all of a fraction at once.

A particle is a point with a mass, a mean area and a temperature. It leaves the lance with
a slip, is dragged by stream, jet and turbulence, and pushed aside by a lift that wanders
(tumbling). With `Plates` a sheet turns, and is pushed as it faces the wind. Particles heat up, may
ignite, and end on the wall, burnt out or out of the kiln.
Kiln coordinates in metres, SI units; time counts from the particle's release.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_positive
from kilnflight.twin.burning import (
    CAUSES,
    CHAR,
    State,
    VolatileIgnition,
    glow,
    heat_and_burn,
    ignite,
    lose_volatiles,
)
from kilnflight.twin.camera import Geometry, unit_vectors
from kilnflight.twin.gas import GRAVITY_M_S2, Gas, density, disc_drag, reynolds, sphere_drag
from kilnflight.twin.particles import SPHERE, Particles
from kilnflight.twin.plates import Plates, release, turn, velocity_after

Array = npt.NDArray[np.float64]

SAMPLED = ("position_m", "velocity_m_s", "surface_k", "area", "state")
TURNED = ("normal", "along")
ENDS = ("landed", "burnt out", "left the kiln", "still flying")


@dataclass(frozen=True)
class Flight:
    """Settings of the computation, and the few quantities that are not published."""

    step_s: float = 0.5e-3  # a quarter of it changes medians by less than 3 % (tested)
    sample_s: float = 2e-3  # between stored states; frames are interpolated
    longest_s: float = 2.5  # of a flight; the thesis's outliers exceed 1 s (sec. 5.3.1)
    nodes: int = 12  # of the heat conduction in chips and granules
    lance_length_m: float = 2.5  # over which particles are accelerated; assumption
    wall_friction: float = 0.3  # of particles sliding in the lance; assumption
    solids_friction: float = 0.01  # additional loss of pneumatic conveying, 0.003 to 0.01
    # Bouncing through the lance instead of sliding. A particle flies from wall to wall at an angle
    # and loses friction times (1 + restitution) of its transverse velocity at each impact. That is
    # a solids friction of 2 friction (1 + restitution) tan^2(angle), which replaces the two above.
    bouncing: bool = False
    bounce_angle_deg: float = 5.0  # to the wall, 2 to 8 (Sommerfeld 1992 measures 5); assumption
    restitution: float = 0.6  # of wood and plastic on steel, 0.5 to 0.7 (handbooks)
    slip_spread: float = 0.08  # relative, of the exit velocity; assumption
    launch_elevation_deg: float = 0.0  # of the lance over the axis; assumption
    launch_spread_factor: float = 1.0  # on the fractions' own spread
    lift_time_s: float = 0.15  # correlation time of the lift's (axis's) direction; assumption
    plates: Plates | None = None  # of sheets, in place of mean area and wandering lift
    ignition_gas_k: float = 950.0  # the gas around must be hotter; assumption
    extinction_1_s: float = 800.0  # slip over size that blows a flame off; assumption
    volatiles: VolatileIgnition | None = None  # in place of surface temperature and slip over size
    char_left: float = 0.15  # share of char at which a sheet counts as burnt out; assumption

    def __post_init__(self) -> None:
        """Refuse steps and times that are not positive."""
        for name in ("step_s", "sample_s", "longest_s", "nodes", "lance_length_m"):
            check_positive(float(getattr(self, name)), f"Flight: {name}")
        if self.sample_s < self.step_s:
            raise InputError(f"Flight: sample_s {self.sample_s} is below step_s {self.step_s}.")


class Flights(NamedTuple):
    """Sampled flights, one row per particle; NaN (state -1) after the end."""

    age_s: Array  # (samples,)
    position_m: npt.NDArray[np.float32]  # (n, samples, 3)
    velocity_m_s: npt.NDArray[np.float32]  # (n, samples, 3)
    surface_k: npt.NDArray[np.float32]  # (n, samples)
    area: npt.NDArray[np.float32]  # (n, samples): share of the broadside area that is left
    state: npt.NDArray[np.int8]  # (n, samples): UNLIT, BURNING or CHAR
    ignition_s: Array  # (n,), NaN if never
    cause: npt.NDArray[np.int8]  # (n,), index into CAUSES
    end_s: Array  # (n,)
    end: npt.NDArray[np.int8]  # (n,), index into ENDS
    end_position_m: Array  # (n, 3)
    # Of plates, (n, samples, 3): normal and long side, NaN of what is no sheet. None without
    # `Flight.plates`.
    normal: npt.NDArray[np.float32] | None = None
    along: npt.NDArray[np.float32] | None = None

    @classmethod
    def blank(cls, n: int, settings: Flight) -> Flights:
        """Return flights without any sample."""
        every = sample_steps(settings) * settings.step_s
        samples = int(settings.longest_s / every) + 2
        unknown = np.full((n, samples), np.nan, dtype=np.float32)
        vectors = np.full((n, samples, 3), np.nan, dtype=np.float32)
        return cls(
            age_s=every * np.arange(samples, dtype=np.float64),
            position_m=vectors,
            velocity_m_s=vectors.copy(),
            surface_k=unknown,
            area=unknown.copy(),
            state=np.full((n, samples), -1, dtype=np.int8),
            ignition_s=np.full(n, np.nan),
            cause=np.zeros(n, dtype=np.int8),
            end_s=np.full(n, np.nan),
            end=np.full(n, -1, dtype=np.int8),
            end_position_m=np.full((n, 3), np.nan),
            normal=vectors.copy() if settings.plates else None,
            along=vectors.copy() if settings.plates else None,
        )

    @classmethod
    def joined(cls, parts: Sequence[Flights]) -> Flights:
        """Return the flights of several fractions one after the other, before `cut`."""
        columns = zip(*(part[1:] for part in parts), strict=True)
        whole = (None if column[0] is None else np.concatenate(column) for column in columns)
        return cls._make([parts[0].age_s, *whole])

    def store(self, column: int, state: State) -> None:
        """Store the present state as a sample."""
        rows = state.index
        self.position_m[rows, column] = state.position
        self.velocity_m_s[rows, column] = state.velocity
        self.surface_k[rows, column] = state.surface_k
        self.area[rows, column] = state.area_share
        self.state[rows, column] = state.burning
        if self.normal is not None and self.along is not None:
            self.normal[rows, column] = state.normal
            self.along[rows, column] = state.along

    def store_end(self, state: State, over: npt.NDArray[np.int8], time_s: float) -> None:
        """Store time, kind and place of the flights that have ended."""
        rows = state.index[over >= 0]
        self.end_s[rows] = time_s
        self.end[rows] = over[over >= 0]
        self.end_position_m[rows] = state.position[over >= 0]

    def cut(self) -> Flights:
        """Return the flights without the samples that no particle has reached."""
        count = int((self.state >= 0).any(axis=0).sum())
        names = SAMPLED if self.normal is None else SAMPLED + TURNED
        short = {name: getattr(self, name)[:, :count] for name in names}
        return self._replace(age_s=self.age_s[:count], **short)

    def only(self, rows: npt.NDArray[np.generic]) -> Flights:
        """Return the flights of some particles, by a mask or their numbers."""
        chosen = (None if field is None else field[rows] for field in self[1:])
        return Flights._make([self.age_s, *chosen])


def sample_steps(settings: Flight) -> int:
    """Return how many steps lie between two samples."""
    return max(1, round(settings.sample_s / settings.step_s))


def fly(
    particles: Particles,
    gas: Gas,
    geometry: Geometry,
    generator: np.random.Generator,
    settings: Flight | None = None,
) -> Flights:
    """Compute the flights of particles from the lance until each has ended.

    Parameters
    ----------
    particles
        Particles of one fraction.
    gas, geometry
        The kiln.
    generator
        Draws launch, turbulence and tumbling.
    settings
        Default `Flight`.

    Returns
    -------
    Flights
        One row per particle, in their order; none is lost. Samples that no particle has
        reached are there too: `Flights.cut` removes them.
    """
    settings = settings or Flight()
    flights = Flights.blank(len(particles), settings)
    state = launch(particles, gas, geometry, generator, settings)
    every, steps = sample_steps(settings), int(settings.longest_s / settings.step_s)
    for step in range(steps + 1):
        time = step * settings.step_s
        over = _ended(state, geometry, settings)
        if step == steps:
            over[over < 0] = ENDS.index("still flying")
        flights.store_end(state, over, time)
        if (over >= 0).any():
            state.keep(over < 0)
        if not len(state.index):
            break
        if step % every == 0:
            flights.store(step // every, state)
        gas_k, slip = _move(state, gas, geometry, generator, settings)
        wall_k = gas.wall_k(state.position - geometry.lance_m)
        heat_and_burn(state, wall_k, gas_k, slip, settings.step_s)
        lit, cause = _ignite(state, gas, geometry, gas_k, slip, settings)
        flights.ignition_s[state.index[lit]] = time + settings.step_s
        flights.cause[state.index[lit]] = cause[lit]
    return flights


def _ignite(
    state: State, gas: Gas, geometry: Geometry, gas_k: Array, slip_m_s: Array, settings: Flight
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int8]]:
    """Ignite by the criteria of the settings, see `ignite`."""
    rule = settings.volatiles
    if rule is None:
        hot = state.surface_k >= state.ignition_k
        holds = slip_m_s / state.diameter_m < settings.extinction_1_s
        return ignite(state, gas_k, hot, holds, settings.ignition_gas_k)
    lose_volatiles(state, settings.step_s)
    oxygen = gas.oxygen(state.position - geometry.lance_m)
    fuel = state.volatile_flux >= rule.critical_flux_kg_m2_s
    holds = rule.damkoehler(state.short_m, slip_m_s, gas_k, oxygen) >= 1.0
    lit, cause = ignite(state, gas_k, fuel, holds, settings.ignition_gas_k, causes=(4, 2, 5))
    glows = glow(state, oxygen)
    cause[glows] = CAUSES.index("glowing char")
    return lit | glows, cause


def launch(
    particles: Particles,
    gas: Gas,
    geometry: Geometry,
    generator: np.random.Generator,
    settings: Flight,
) -> State:
    """Return the particles as they leave the lance."""
    n = len(particles)
    state = State.at_rest(particles, settings.nodes, gas.lance_temperature_k)
    plates = settings.plates if state.kind.sheet else None
    if plates:
        state.char_thins = plates.char_thins
        state.orientation = np.full(n, plates.mean_drag)
    spread = np.deg2rad(particles.fraction.launch_spread_deg * settings.launch_spread_factor)
    elevation = np.deg2rad(settings.launch_elevation_deg) + generator.normal(0.0, spread, n)
    azimuth = generator.normal(0.0, spread, n)
    ahead, aside = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    direction = np.stack([ahead, aside, np.sin(elevation)], axis=1)
    varied = np.maximum(1 + settings.slip_spread * generator.normal(size=n), 0.1)
    speed = exit_velocity(state, gas, settings) * varied
    bore = generator.uniform(-0.4, 0.4, (n, 2)) * gas.lance_diameter_m
    state.position = geometry.lance_m + np.concatenate([np.zeros((n, 1)), bore], axis=1)
    state.velocity = direction * speed[:, None]
    state.lift = unit_vectors(generator.normal(size=(n, 3)))
    if plates:
        wind = np.array([gas.jet_velocity_m_s, 0.0, 0.0])
        release(state, wind, np.full(n, gas.lance_temperature_k), generator)
    return state


def exit_velocity(state: State, gas: Gas, settings: Flight) -> Array:
    """Return the velocity in m/s at the lance's outlet, before its spread, (n,).

    From rest over the length of the lance, against the friction of what slides or bounces.
    """
    air_k = np.full(len(state.index), gas.lance_temperature_k)
    speed, way = np.full(len(state.index), 0.1), np.zeros(len(state.index))
    for _ in range(int(settings.longest_s / settings.step_s)):
        inside = way < settings.lance_length_m
        if not inside.any():
            break
        slip = gas.jet_velocity_m_s - speed
        rate = drag_rate(state, np.abs(slip), air_k)
        braking = _lance_friction(speed, gas.lance_diameter_m, settings)
        gain = settings.step_s * (rate * slip - braking) / (1 + settings.step_s * rate)
        speed = np.where(inside, np.maximum(speed + gain, 0.1), speed)
        way = way + speed * settings.step_s
    return speed


def _lance_friction(speed_m_s: Array, diameter_m: float, settings: Flight) -> Array:
    """Return the deceleration in m/s2 by the wall of the lance."""
    if settings.bouncing:
        across = speed_m_s * np.tan(np.deg2rad(settings.bounce_angle_deg))
        impacts_1_s = across / diameter_m
        return settings.wall_friction * (1 + settings.restitution) * across * impacts_1_s
    solids = settings.solids_friction * speed_m_s**2 / (2 * diameter_m)
    return settings.wall_friction * GRAVITY_M_S2 + solids


def drag_rate(state: State, slip_m_s: Array, gas_k: Array) -> Array:
    """Return drag acceleration over slip velocity in 1/s, (active,)."""
    number = reynolds(slip_m_s, state.diameter_m, gas_k)
    law = sphere_drag if state.kind.body == SPHERE else disc_drag
    area = state.orientation * state.broadside_m2 * state.area_share
    return density(gas_k) * law(number) * area * slip_m_s / (2 * state.mass_kg)


def _move(
    state: State,
    gas: Gas,
    geometry: Geometry,
    generator: np.random.Generator,
    settings: Flight,
) -> tuple[Array, Array]:
    """Advance positions by one step in place.

    Gas temperature and slip before the step are returned.

    Drag is taken implicitly, so that light sheets stay stable.
    """
    from_lance = state.position - geometry.lance_m
    gas_k, excess = gas.temperature(from_lance), gas.excess_velocity(from_lance)
    _wander(state, excess, gas, generator, settings)
    wind = state.turbulence.copy()
    wind[:, 0] += gas.stream(from_lance) + excess
    relative = wind - state.velocity
    slip = np.linalg.norm(relative, axis=1)
    dt = settings.step_s
    if settings.plates and state.kind.sheet:
        wander = np.sqrt(dt / settings.lift_time_s)
        free = turn(state, relative, gas_k, settings.plates, wander, dt, generator)
        state.velocity = velocity_after(state, wind, gas_k, free, settings.plates, dt)
    else:
        rate = drag_rate(state, slip, gas_k)[:, None]
        push = _lift(state, relative, slip, gas_k)
        push[:, 2] -= GRAVITY_M_S2
        state.velocity = (state.velocity + dt * (push + rate * wind)) / (1 + dt * rate)
    state.position = state.position + dt * state.velocity
    return gas_k, slip


def _wander(
    state: State, excess: Array, gas: Gas, generator: np.random.Generator, settings: Flight
) -> None:
    """Advance turbulence and the lift's direction.

    Turbulence is Ornstein-Uhlenbeck, exact in time.
    """
    shape, dt = state.position.shape, settings.step_s
    keep = np.exp(-dt / gas.turbulence_time_s)
    strength = gas.turbulence_m_s + gas.turbulence_in_jet * np.abs(excess)
    noise = generator.normal(size=shape) * strength[:, None]
    state.turbulence = keep * state.turbulence + np.sqrt(1 - keep**2) * noise
    if not (settings.plates and state.kind.sheet):
        turn = np.sqrt(dt / settings.lift_time_s)
        state.lift = unit_vectors(state.lift + turn * generator.normal(size=shape))


def _lift(state: State, relative: Array, slip_m_s: Array, gas_k: Array) -> Array:
    """Return the lift's acceleration in m/s2, (active, 3).

    It is across the slip and turns with time.
    """
    area = state.kind.lift_coefficient * state.broadside_m2 * state.area_share
    rate = density(gas_k) * area * slip_m_s / (2 * state.mass_kg)
    return rate[:, None] * np.cross(state.lift, relative)


def _ended(state: State, geometry: Geometry, settings: Flight) -> npt.NDArray[np.int8]:
    """Return the end of each active particle as an index into `ENDS`.

    It is -1 while the particle flies.
    """
    over = np.full(len(state.index), -1, dtype=np.int8)
    crumbles = state.kind.sheet | (state.kind.volatile_share == 1.0)
    spent = (state.char_share <= settings.char_left) | (state.kind.volatile_share == 1.0)
    over[(state.burning == CHAR) & crumbles & spent] = ENDS.index("burnt out")
    over[state.position[:, 0] >= geometry.outlet_m] = ENDS.index("left the kiln")
    radius = np.hypot(state.position[:, 1], state.position[:, 2])
    over[radius >= geometry.kiln_radius_mm / 1000.0] = ENDS.index("landed")
    return over
