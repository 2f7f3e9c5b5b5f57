"""Flights of the twin in numpy, step by step; laws of gas and chemistry are the package's."""

import numpy as np

from kilnflight.twin import gas as forces
from kilnflight.twin.burning import (
    BURNING,
    CAUSES,
    CHAR,
    GAS_CONSTANT_J_MOL_K,
    GLOWING_K,
    GLOWING_OXYGEN,
    SPENT,
    UNLIT,
    damkoehler,
)
from kilnflight.twin.camera import unit_vectors
from kilnflight.twin.flight import (
    ENDS,
    Flights,
    launch,
    sample_steps,
)
from kilnflight.twin.gas import DRYING_K, GRAVITY_M_S2
from kilnflight.twin.particles import SPHERE
from kilnflight.twin.plates import tip_speed_ratio


class Plain:
    """The particles still in flight, arrays (active, ...)."""

    def __init__(self, state, particles, settings):
        self.kind = particles.fraction
        self.names = [name for name in state.dtype.names if name != "kind"]
        for name in self.names:
            setattr(self, name, state[name].copy())
        self.nodes_k = self.nodes_k[:, : 1 if self.kind.sheet else settings.nodes]
        self.index, self.fulfilled = np.arange(len(state)), np.zeros((len(state), 3), dtype=bool)
        self.names += ["index", "fulfilled"]

    def keep(self, rows):
        for name in self.names:
            setattr(self, name, getattr(self, name)[rows])

    @property
    def volatiles_1_s(self):
        kind = self.kind
        faces = np.linspace(0.0, 1.0, self.nodes_k.shape[1] + 1) ** (kind.body + 1)
        activation = kind.pyrolysis_j_mol / GAS_CONSTANT_J_MOL_K
        rate = kind.pyrolysis_1_s * np.exp(-activation / self.nodes_k)
        return rate @ np.diff(faces)

    @property
    def char_share(self):
        whole = self.dry_kg * (1 - self.kind.volatile_share)
        return np.divide(self.char_kg, whole, out=np.ones_like(whole), where=whole > 0)

    @property
    def area_share(self):
        charred = self.burning == CHAR
        return np.where(charred & self.kind.sheet, self.char_share, 1.0)

    @property
    def mass_kg(self):
        low, high = DRYING_K
        wet = 1 - np.clip((self.nodes_k.mean(axis=1) - low) / (high - low), 0.0, 1.0)
        now = self.volatiles_kg + self.char_kg + self.kind.moisture * self.dry_kg * wet
        return np.maximum(now, 0.02 * self.dry_kg * (1 + self.kind.moisture))


def conduct(nodes_k, flux_w_m2, half_m, properties, geometry, step_s):
    conductivity, capacity, mass_density, moisture = properties
    count = nodes_k.shape[1]
    faces = np.linspace(0.0, 1.0, count + 1)
    area = faces**geometry
    volume = np.diff(faces ** (geometry + 1)) / (geometry + 1)
    shell = half_m[:, None] / count
    through = np.zeros((len(nodes_k), count + 1))
    through[:, 1:-1] = conductivity * np.diff(nodes_k, axis=1) / shell * area[1:-1]
    through[:, -1] = flux_w_m2
    apparent = forces.apparent_heat_capacity(nodes_k, capacity, moisture)
    stored = mass_density[:, None] * apparent * half_m[:, None] * volume
    return nodes_k + step_s * np.diff(through, axis=1) / stored


def heat_and_burn(state, wall_k, gas_k, slip_m_s, step_s):
    coefficient = forces.heat_transfer(slip_m_s, state.length_m, gas_k)
    flux = forces.heat_flux(state.surface_k, gas_k, wall_k, coefficient, state.kind.emissivity)
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


def _heated(state, flux, step_s):
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
    nodes = conduct(state.nodes_k, flux, state.half_m, properties, kind.body, step_s)
    half_shell = state.half_m / nodes.shape[1] / 2
    return nodes, nodes[:, -1] + flux * half_shell / kind.conductivity_w_m_k


def lose_volatiles(state, step_s):
    kept = np.where(state.burning == UNLIT, np.exp(-state.volatiles_1_s * step_s), 1.0)
    state.volatiles_kg = state.volatiles_kg * kept


def glow(state, oxygen):
    fuel = state.dry_kg * state.kind.volatile_share
    spent = (state.burning == UNLIT) & (state.volatiles_kg < SPENT * fuel)
    glows = spent & (state.surface_k >= GLOWING_K) & (oxygen >= GLOWING_OXYGEN)
    state.burning[glows] = CHAR
    return glows


def ignite(state, gas_k, enough_fuel, flame_holds, gas_limit_k):
    fulfilled = np.stack([enough_fuel, gas_k >= gas_limit_k, flame_holds], axis=1)
    lit = fulfilled.all(axis=1) & (state.burning == UNLIT)
    cause = np.where(lit, 1 + np.argmin(state.fulfilled, axis=1), 0).astype(np.int8)
    state.burning[lit] = BURNING
    state.fulfilled = fulfilled
    return lit, cause


def _dot(first, second):
    return np.asarray(np.einsum("ij,ij->i", first, second))[:, None]


def _cross(first, second):
    (a, b, c), (x, y, z) = first.T, second.T
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)


def _upright(vectors, along):
    return unit_vectors(vectors - _dot(vectors, along) * along)


def _sheet(state):
    left = state.area_share
    return state.mass_kg / (state.broadside_m2 * left), state.short_m * np.sqrt(left)


def _autorotation(state, relative, gas_k, plates):
    wind = np.sqrt(_dot(relative, relative) - _dot(relative, state.along) ** 2 + 1e-12)[:, 0]
    shape, inverse_inertia = (np.pi / 4, 16.0) if state.kind.round else (1.0, 12.0)
    ratio = tip_speed_ratio(state.broadside_m2 / (shape * state.short_m) ** 2)
    (areal, chord), gas = _sheet(state), forces.density(gas_k)
    rate = inverse_inertia * plates.moment_coefficient * gas * wind / (4 * areal * ratio)
    tumbles = areal > plates.critical_froude**2 * gas * chord
    return 2 * ratio * wind / chord, rate, tumbles


def turn(state, relative, gas_k, plates, wander, step_s, generator):
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


def _set_length(state, relative):
    facing = np.abs(_dot(unit_vectors(relative), state.normal))[:, 0]
    perimeter = 3 * (1 + facing) - np.sqrt((3 + facing) * (1 + 3 * facing))
    state.length_m = state.diameter_m / perimeter


def velocity_after(state, wind, gas_k, free, plates, step_s):
    relative, normal = wind - state.velocity, state.normal
    slip = np.sqrt(_dot(relative, relative))
    pressure = forces.density(gas_k)[:, None] * slip / (2 * _sheet(state)[0][:, None])
    broad = (
        pressure * forces.disc_drag(forces.reynolds(slip[:, 0], state.diameter_m, gas_k))[:, None]
    )
    edge = plates.edge_drag * broad
    spin = np.clip(state.spin_1_s / np.maximum(free, 1e-9), -1.0, 1.0)[:, None]
    push = pressure * plates.lift_coefficient * spin * _cross(relative, state.along)
    push[:, 2] -= GRAVITY_M_S2
    push += edge * wind + (broad - edge) * _dot(wind, normal) * normal
    pushed = state.velocity + step_s * push
    against = _dot(pushed, normal) * normal
    return np.asarray(against / (1 + step_s * broad) + (pushed - against) / (1 + step_s * edge))


def fly_plainly(particles, gas, geometry, generator, settings):
    flights = Flights.blank(len(particles), settings)
    state = Plain(launch(particles, gas, geometry, generator, settings), particles, settings)
    every, steps = sample_steps(settings), int(settings.longest_s / settings.step_s)
    for step in range(steps + 1):
        time = step * settings.step_s
        over = _ended(state, geometry, settings)
        if step == steps:
            over[over < 0] = ENDS.index("still flying")
        rows = state.index[over >= 0]
        flights.end_s[rows], flights.end[rows] = time, over[over >= 0]
        flights.end_position_m[rows] = state.position[over >= 0]
        state.keep(over < 0)
        if not len(state.index):
            break
        if step % every == 0:
            rows, column = state.index, step // every
            flights.position_m[rows, column] = state.position
            flights.velocity_m_s[rows, column] = state.velocity
            flights.surface_k[rows, column] = state.surface_k
            flights.area[rows, column] = state.area_share
            flights.state[rows, column] = state.burning
            flights.normal[rows, column] = state.normal
            flights.along[rows, column] = state.along
        gas_k, slip = _move(state, gas, geometry, generator, settings)
        wall_k = forces.wall_k(gas, (state.position - geometry.lance_m).T)
        heat_and_burn(state, wall_k, gas_k, slip, settings.step_s)
        lit, cause = _ignite(state, gas, geometry, gas_k, slip, settings)
        flights.ignition_s[state.index[lit]] = time + settings.step_s
        flights.cause[state.index[lit]] = cause[lit]
    return flights


def _ignite(state, gas, geometry, gas_k, slip_m_s, settings):
    rule = settings.volatiles
    lose_volatiles(state, settings.step_s)
    oxygen = forces.oxygen(gas, (state.position - geometry.lance_m).T)
    flux = state.volatiles_1_s * state.volatiles_kg / state.surface_m2
    fuel = flux >= rule.critical_flux_kg_m2_s
    holds = damkoehler(rule, state.short_m, slip_m_s, gas_k, oxygen) >= 1.0
    lit, cause = ignite(state, gas_k, fuel, holds, settings.ignition_gas_k)
    glows = glow(state, oxygen)
    cause[glows] = CAUSES.index("glowing char")
    return lit | glows, cause


def drag_rate(state, slip_m_s, gas_k):
    number = forces.reynolds(slip_m_s, state.diameter_m, gas_k)
    law = forces.sphere_drag if state.kind.body == SPHERE else forces.disc_drag
    area = state.orientation * state.broadside_m2 * state.area_share
    return forces.density(gas_k) * law(number) * area * slip_m_s / (2 * state.mass_kg)


def _move(state, gas, geometry, generator, settings):
    from_lance = (state.position - geometry.lance_m).T
    gas_k, excess = forces.temperature(gas, from_lance), forces.excess_velocity(gas, from_lance)
    _wander(state, excess, gas, generator, settings)
    wind = state.turbulence.copy()
    wind[:, 0] += forces.stream(gas, from_lance) + excess
    relative = wind - state.velocity
    slip = np.linalg.norm(relative, axis=1)
    dt = settings.step_s
    if state.kind.sheet:
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


def _wander(state, excess, gas, generator, settings):
    shape, dt = state.position.shape, settings.step_s
    keep = np.exp(-dt / gas.turbulence_time_s)
    strength = gas.turbulence_m_s + gas.turbulence_in_jet * np.abs(excess)
    noise = generator.normal(size=shape) * strength[:, None]
    state.turbulence = keep * state.turbulence + np.sqrt(1 - keep**2) * noise
    if not state.kind.sheet:
        turn = np.sqrt(dt / settings.lift_time_s)
        state.lift = unit_vectors(state.lift + turn * generator.normal(size=shape))


def _lift(state, relative, slip_m_s, gas_k):
    area = state.kind.lift_coefficient * state.broadside_m2 * state.area_share
    rate = forces.density(gas_k) * area * slip_m_s / (2 * state.mass_kg)
    return rate[:, None] * np.cross(state.lift, relative)


def _ended(state, geometry, settings):
    over = np.full(len(state.index), -1, dtype=np.int8)
    crumbles = state.kind.sheet | (state.kind.volatile_share == 1.0)
    spent = (state.char_share <= settings.char_left) | (state.kind.volatile_share == 1.0)
    over[(state.burning == CHAR) & crumbles & spent] = ENDS.index("burnt out")
    over[state.position[:, 0] >= geometry.outlet_m] = ENDS.index("left the kiln")
    radius = np.hypot(state.position[:, 1], state.position[:, 2])
    over[radius >= geometry.kiln_radius_mm / 1000.0] = ENDS.index("landed")
    return over
