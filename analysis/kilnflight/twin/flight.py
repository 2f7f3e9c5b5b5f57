"""Flight of single particles from lance to end, all of a fraction at once.

A particle is a point with a mass, a mean area and a temperature. It leaves the lance with
a slip, is dragged by stream, jet and turbulence, and pushed aside by a lift that wanders
(tumbling). A sheet turns, and is pushed as it faces the wind (`Plates`). Particles heat up, may
ignite, and end on the wall, burnt out or out of the kiln.
Kiln coordinates in metres, SI units; time counts from the particle's release.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit
from numba.extending import register_jitable

from kilnflight.project.cache import code_hash
from kilnflight.twin.burning import (
    CAUSES,
    CHAR,
    UNLIT,
    VolatileIgnition,
    area_share,
    at_rest,
    char_share,
    damkoehler,
    glow,
    heat_and_burn,
    ignite,
    lose_volatiles,
    mass_kg,
)
from kilnflight.twin.camera import Geometry, unit_vectors
from kilnflight.twin.compiled import cross, dot, numbers, plus, put, scaled, unit, vector
from kilnflight.twin.gas import (
    GRAVITY_M_S2,
    Gas,
    density,
    disc_drag,
    excess_velocity,
    oxygen,
    reynolds,
    sphere_drag,
    stream,
    temperature,
    wall_k,
)
from kilnflight.twin.particles import SPHERE, Particles
from kilnflight.twin.plates import Plates, release, turn, velocity_after

Array = npt.NDArray[np.float64]

SAMPLED = ("position_m", "velocity_m_s", "surface_k", "area", "state", "normal", "along")
ENDS = ("landed", "burnt out", "left the kiln", "still flying")
LANDED, BURNT_OUT, LEFT, FLYING = range(len(ENDS))
GLOWING = CAUSES.index("glowing char")
# Numba's cache sees changes of this file only; a type with this name in it tells of the laws' files
LAWS = code_hash(Plates)


@dataclass(frozen=True)
class Flight:
    """Settings of the computation, and the few quantities that are not published."""

    step_s: float = 0.5e-3  # a quarter of it changes medians by less than 3 % (tested)
    sample_s: float = 2e-3  # between stored states; frames are interpolated
    longest_s: float = 2.5  # of a flight; the thesis's outliers exceed 1 s (sec. 5.3.1)
    nodes: int = 12  # of the heat conduction in chips and granules
    lance_length_m: float = 2.5  # over which particles are accelerated; assumption
    # In the lance a particle flies from wall to wall at an angle and loses friction times
    # (1 + restitution) of its transverse velocity at each impact. That is a solids friction of
    # 2 friction (1 + restitution) tan^2(angle).
    wall_friction: float = 0.3  # assumption
    bounce_angle_deg: float = 5.0  # to the wall, 2 to 8 (Sommerfeld 1992 measures 5); assumption
    restitution: float = 0.6  # of wood and plastic on steel, 0.5 to 0.7 (handbooks)
    slip_spread: float = 0.08  # relative, of the exit velocity; assumption
    launch_elevation_deg: float = 0.0  # of the lance over the axis; assumption
    launch_spread_factor: float = 1.0  # on the fractions' own spread
    lift_time_s: float = 0.15  # correlation time of the lift's (axis's) direction; assumption
    plates: Plates = field(default_factory=Plates)  # of sheets
    ignition_gas_k: float = 950.0  # the gas around must be hotter; assumption
    volatiles: VolatileIgnition = field(default_factory=VolatileIgnition)
    char_left: float = 0.15  # share of char at which a sheet counts as burnt out; assumption


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
    # Of sheets, (n, samples, 3): normal and long side, NaN of others.
    normal: npt.NDArray[np.float32]
    along: npt.NDArray[np.float32]

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
            normal=vectors.copy(),
            along=vectors.copy(),
        )

    @classmethod
    def joined(cls, parts: Sequence[Flights]) -> Flights:
        """Return the flights of several fractions one after the other, before `cut`."""
        columns = zip(*(part[1:] for part in parts), strict=True)
        return cls._make([parts[0].age_s, *map(np.concatenate, columns)])

    def cut(self) -> Flights:
        """Return the flights without the samples that no particle has reached."""
        count = int((self.state >= 0).any(axis=0).sum())
        short = {name: getattr(self, name)[:, :count] for name in SAMPLED}
        return self._replace(age_s=self.age_s[:count], **short)

    def only(self, rows: npt.NDArray[np.generic]) -> Flights:
        """Return the flights of some particles, by a mask or their numbers."""
        return Flights._make([self.age_s, *(part[rows] for part in self[1:])])


def sample_steps(settings: Flight) -> int:
    """Return how many steps lie between two samples."""
    return max(1, round(settings.sample_s / settings.step_s))


def fly(
    particles: Particles,
    gas: Gas,
    geometry: Geometry,
    generator: np.random.Generator,
    settings: Flight,
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
        Steps and unpublished quantities.

    Returns
    -------
    Flights
        One row per particle, in their order; none is lost. Samples that no particle has
        reached are there too: `Flights.cut` removes them.
    """
    flights = Flights.blank(len(particles), settings)
    state = launch(particles, gas, geometry, generator, settings)
    samples = tuple(getattr(flights, name) for name in SAMPLED)
    inputs = _inputs(gas, geometry, settings)
    _fly(state, inputs, generator, sample_steps(settings), samples, flights[6:11])
    return flights


class _Inputs(NamedTuple):
    """What flights depend on, as compiled loops read it."""

    gas: Any
    flight: Any
    plates: Any
    volatiles: Any
    lance_m: tuple[float, float, float]


def _inputs(gas: Gas, geometry: Geometry, settings: Flight) -> _Inputs:
    x, y, z = map(float, geometry.lance_m)
    flight = numbers(
        settings,
        turbulence_kept=np.exp(-settings.step_s / gas.turbulence_time_s),
        wander=np.sqrt(settings.step_s / settings.lift_time_s),
        radius_m=geometry.kiln_radius_mm / 1000.0,
        outlet_m=geometry.outlet_m,
        **{LAWS: 0.0},
    )
    laws = numbers(settings.plates), numbers(settings.volatiles)
    return _Inputs(gas.numbers, flight, *laws, (x, y, z))


@njit(cache=True, nogil=True, error_model="numpy")
def _fly(state: Any, inputs: _Inputs, generator: Any, every: int, samples: Any, ends: Any) -> None:
    """Fly all particles of a state to their ends; store samples and ends.

    Drawn are in each step the turbulence of all that still fly, then the turning of all.
    """
    ignition_s, cause, end_s, end, end_position = ends
    step_s, steps = inputs.flight.step_s, int(inputs.flight.longest_s / inputs.flight.step_s)
    flying, count = np.arange(len(state)), len(state)
    for step in range(steps + 1):
        left = 0
        for i in flying[:count]:
            end[i] = _end(state[i], inputs.flight)
            if end[i] < 0 and step == steps:
                end[i] = FLYING
            if end[i] < 0:
                flying[left] = i
                left += 1
            else:
                end_s[i] = step * step_s
                end_position[i] = state[i].position
        count = left
        for i in flying[:count]:
            _draw(state[i].gust, generator)
        for i in flying[:count]:
            _draw(state[i].turning, generator)
        for i in flying[:count]:
            if step % every == 0:
                _store(samples, i, step // every, state[i])
            why = _advance(state[i], inputs)
            if why:
                ignition_s[i], cause[i] = step * step_s + step_s, why


@register_jitable
def _draw(row: Any, generator: Any) -> None:
    """Draw three standard normal components."""
    for axis in range(3):
        row[axis] = generator.normal()


@register_jitable
def _store(samples: Any, row: int, column: int, particle: Any) -> None:
    """Store the present state of a particle as a sample."""
    position, velocity, surface_k, area, state, normal, along = samples
    put(position[row, column], particle.position)
    put(velocity[row, column], particle.velocity)
    surface_k[row, column] = particle.surface_k
    area[row, column] = area_share(particle)
    state[row, column] = particle.burning
    put(normal[row, column], particle.normal)
    put(along[row, column], particle.along)


@register_jitable
def _advance(particle: Any, inputs: _Inputs) -> int:
    """Advance a particle by one step; return why it ignites (see `CAUSES`), 0 if it does not."""
    gas, step_s = inputs.gas, inputs.flight.step_s
    place = plus(vector(particle.position), -1.0, inputs.lance_m)
    gas_k = temperature(gas, place)
    slip = _move(particle, place, gas_k, inputs)
    place = plus(vector(particle.position), -1.0, inputs.lance_m)
    heat_and_burn(particle, wall_k(gas, place), gas_k, slip, step_s)
    return _ignite(particle, place, gas_k, slip, inputs) if particle.burning == UNLIT else 0


@register_jitable
def _ignite(particle: Any, place: Any, gas_k: float, slip_m_s: float, inputs: _Inputs) -> int:
    """Ignite an unlit particle by the flux of its volatiles, or let its char glow."""
    settings, rule = inputs.flight, inputs.volatiles
    fuel = lose_volatiles(particle, settings.step_s) >= rule.critical_flux_kg_m2_s
    share = oxygen(inputs.gas, place)
    holds = damkoehler(rule, particle.short_m, slip_m_s, gas_k, share) >= 1.0
    cause = ignite(particle, fuel, gas_k >= settings.ignition_gas_k, holds)
    return GLOWING if glow(particle, share) else cause


def launch(
    particles: Particles,
    gas: Gas,
    geometry: Geometry,
    generator: np.random.Generator,
    settings: Flight,
) -> Any:
    """Return the particles as they leave the lance."""
    n = len(particles)
    state = at_rest(particles, settings.nodes, gas.lance_temperature_k)
    if particles.fraction.sheet:
        state.orientation = settings.plates.mean_drag
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
    if particles.fraction.sheet:
        wind = np.array([gas.jet_velocity_m_s, 0.0, 0.0])
        release(state, wind, gas.lance_temperature_k, generator)
    return state


def exit_velocity(state: Any, gas: Gas, settings: Flight) -> Array:
    """Return the velocity in m/s at the lance's outlet, before its spread, (n,).

    From rest over the length of the lance, against the friction of the impacts.
    """
    slope = np.tan(np.deg2rad(settings.bounce_angle_deg))
    read = numbers(settings, bounce_slope=slope, **{LAWS: 0.0})
    return np.asarray(_exit_velocity(state, gas.numbers, read))


@njit(cache=True, nogil=True, error_model="numpy")
def _exit_velocity(state: Any, gas: Any, settings: Any) -> Any:
    speeds = np.empty(len(state))
    for i in range(len(state)):
        speed, way = 0.1, 0.0
        for _ in range(int(settings.longest_s / settings.step_s)):
            if way >= settings.lance_length_m:
                break
            slip = gas.jet_velocity_m_s - speed
            rate = drag_rate(state[i], np.abs(slip), gas.lance_temperature_k)
            across = speed * settings.bounce_slope
            impacts_1_s = across / gas.lance_diameter_m
            braking = settings.wall_friction * (1 + settings.restitution) * across * impacts_1_s
            gain = settings.step_s * (rate * slip - braking) / (1 + settings.step_s * rate)
            speed = np.maximum(speed + gain, 0.1)
            way += speed * settings.step_s
        speeds[i] = speed
    return speeds


@register_jitable
def drag_rate(state: Any, slip_m_s: Any, gas_k: Any) -> Any:
    """Return drag acceleration over slip velocity in 1/s."""
    number = reynolds(slip_m_s, state.diameter_m, gas_k)
    drag = sphere_drag(number) if state.kind.body == SPHERE else disc_drag(number)
    area = state.orientation * state.broadside_m2 * area_share(state)
    return density(gas_k) * drag * area * slip_m_s / (2 * mass_kg(state))


@register_jitable
def _move(particle: Any, place: Any, gas_k: float, inputs: _Inputs) -> float:
    """Advance velocity and position of a particle by one step; return the slip before it.

    Drag is taken implicitly, so that light sheets stay stable.
    """
    gas, settings, step_s = inputs.gas, inputs.flight, inputs.flight.step_s
    excess = excess_velocity(gas, place)
    turbulence = _gust(particle, excess, inputs)
    wind = plus(turbulence, stream(gas, place) + excess, (1.0, 0.0, 0.0))
    velocity = vector(particle.velocity)
    relative = plus(wind, -1.0, velocity)
    slip = np.sqrt(dot(relative, relative))
    aside = scaled(settings.wander, particle.turning)
    if particle.kind.sheet:
        free = turn(particle, relative, gas_k, inputs.plates, aside, step_s)
        velocity = velocity_after(particle, wind, gas_k, free, inputs.plates, step_s)
    else:
        put(particle.lift, unit(plus(aside, 1.0, particle.lift)))
        rate = drag_rate(particle, slip, gas_k)
        lift = scaled(_lift_rate(particle, slip, gas_k), cross(particle.lift, relative))
        push = plus(plus(lift, GRAVITY_M_S2, (0.0, 0.0, -1.0)), rate, wind)
        velocity = scaled(1 / (1 + step_s * rate), plus(velocity, step_s, push))
    put(particle.velocity, velocity)
    put(particle.position, plus(vector(particle.position), step_s, velocity))
    return slip


@register_jitable
def _gust(particle: Any, excess: float, inputs: _Inputs) -> Any:
    """Advance the turbulence around a particle and return it.

    It is Ornstein-Uhlenbeck, exact in time.
    """
    gas, kept = inputs.gas, inputs.flight.turbulence_kept
    strength = gas.turbulence_m_s + gas.turbulence_in_jet * np.abs(excess)
    old = scaled(kept, vector(particle.turbulence))
    turbulence = plus(old, np.sqrt(1 - kept**2) * strength, particle.gust)
    put(particle.turbulence, turbulence)
    return turbulence


@register_jitable
def _lift_rate(particle: Any, slip_m_s: float, gas_k: float) -> float:
    """Return the lift's acceleration over slip velocity in 1/s; it is across the slip."""
    area = particle.kind.lift_coefficient * particle.broadside_m2 * area_share(particle)
    return density(gas_k) * area * slip_m_s / (2 * mass_kg(particle))


@register_jitable
def _end(particle: Any, settings: Any) -> int:
    """Return the end of a particle as an index into `ENDS`, -1 while it flies."""
    x, y, z = vector(particle.position)
    if np.hypot(y, z) >= settings.radius_m:
        return LANDED
    if x >= settings.outlet_m:
        return LEFT
    without_char = particle.kind.volatile_share == 1.0
    crumbled = particle.kind.sheet and char_share(particle) <= settings.char_left
    return BURNT_OUT if particle.burning == CHAR and (without_char or crumbled) else -1
