"""Simulate friction on the belt, in place of the authors' DEM tracks.

Particles leave a slide slower than the belt and are dragged along by Coulomb friction
at their point of contact; collisions are random kicks. The materials differ in how a
particle can roll: a sphere in any direction, a cylinder only across its axis, a cuboid
not at all. It is no discrete-element simulation: particles do not meet.

For a unit mass the friction is ``-mu g s/|s|`` with the slip ``s = v + w - v_belt``.
The velocity ``w`` is that of the contact point due to rolling. The same force changes
``w`` by ``1/kappa`` times as much as ``v``; kappa is the moment of inertia over m r^2.
So slip ends when the particle rolls or stands on the belt.
"""

from dataclasses import dataclass

import numpy as np
from pandas import DataFrame

from kilnflight.arrays import Array, Generator
from kilnflight.belt.models import (
    BELT_EDGE_MM,
    BELT_START_MM,
    BELT_VELOCITY_MM_S,
    BELT_WIDTH_MM,
)
from kilnflight.tables import read_beside

GRAVITY_MM_S2 = 9810.0
FEED_MM = BELT_START_MM + 2.0  # where the tracks in these files begin
KICK_MM_S = 30.0  # standard deviation per axis of a collision; assumption
_LEAST_SPEED = 1e-300  # mm/s, divides the zero velocity


@dataclass
class _State:
    """Positions and velocities during a simulation, (n, 2) each, changed in place."""

    position: Array  # mm
    velocity: Array  # mm/s
    rolling: Array  # velocity of the contact point relative to the centre, mm/s
    across_axis: Array  # unit vectors: the direction in which a cylinder rolls


@dataclass(frozen=True)
class FrictionBelt:
    """One bulk material on the belt.

    The paper publishes neither friction coefficients nor feed velocities. Values marked
    "read off" were taken once from the authors' tracks upstream of the prediction
    phase. They are mean and standard deviation of the first velocity of each particle,
    and the median acceleration of the cuboids. Nothing was adjusted to the deviations
    of the models.

    Parameters
    ----------
    particles
        About 4000 per material (sec. 4, "Scenarios").
    inertia
        Moment of inertia / (m r^2); inf does not roll.
    rolls_across_axis_only
        Whether particles are cylinders that lie on the belt.
    rolling_start
        Whether particles roll down the slide without slip.
    friction
        Coefficient, read off: 1.57 m/s^2 = 0.16 g.
    rolling_friction
        Coefficient of wood on a belt; assumption.
    velocity_mm_s, velocity_spread_mm_s, lateral_spread_mm_s
        Velocity at the start of the belt and its spreads along and across it, read off
        (cuboids).
    kicks_per_s
        Number of collisions; assumption.
    end_mm
        End of the belt as in the authors' files; an observation follows the edge.
    feed_s
        Time in s over which the particles are fed; that of the authors' files.
    sampling_hz
        Rate of the tracks; that of the authors' public files.
    steps_per_sample
        Integration steps, of 0.5 ms; the paper's DEM has 0.1 ms.
    """

    particles: int = 4000
    inertia: float = np.inf
    rolls_across_axis_only: bool = False
    rolling_start: bool = False
    friction: float = 0.16
    rolling_friction: float = 0.005
    velocity_mm_s: float = 923.0
    velocity_spread_mm_s: float = 58.0
    lateral_spread_mm_s: float = 49.0
    kicks_per_s: float = 2.0
    end_mm: float = BELT_EDGE_MM + 32.0
    feed_s: float = 15.0
    sampling_hz: float = 100.0
    steps_per_sample: int = 20

    def __call__(self, generator: Generator) -> DataFrame:
        """Simulate particles that slide or roll along the belt; return BELT_TRACKS.

        A row is a particle and a sample: frame, particle, time in s, x and y in mm, up
        to ``end_mm``. Particles do not touch each other. So all are moved from one
        start, and then shifted to random times of entry within ``feed_s``. The same
        generator state gives the same tracks.
        """
        state = self._feed(generator)
        entry = np.sort(generator.uniform(0.0, self.feed_s, self.particles))
        first = np.ceil(entry * self.sampling_hz).astype(np.int64)
        samples = []
        while state.position[:, 0].min() < self.end_mm:
            samples.append(state.position.copy())
            for _ in range(self.steps_per_sample):
                self._step(state, generator)
        x, y = np.moveaxis(np.stack(samples), -1, 0)
        particle, row = np.nonzero((x < self.end_mm).T)
        frame = first[particle] + row
        return DataFrame(
            {
                "frame": frame,
                "particle": particle,
                "time_s": frame / self.sampling_hz,
                "x": x[row, particle],
                "y": y[row, particle],
            }
        )

    def _feed(self, generator: Generator) -> _State:
        """Return the particles as they reach the belt: places, velocities and rolling.

        They are drawn at random, evenly across the belt and by the spreads of the
        velocity.
        """
        n = self.particles
        # A particle is first seen within the distance of one frame.
        step = self.velocity_mm_s / self.sampling_hz
        x = FEED_MM + generator.uniform(0.0, step, n)
        y = generator.uniform(0.05, 0.95, n) * BELT_WIDTH_MM
        along = generator.normal(self.velocity_mm_s, self.velocity_spread_mm_s, n)
        across = generator.normal(0.0, self.lateral_spread_mm_s, n)
        velocity = np.column_stack([along, across])
        angle = generator.uniform(0.0, np.pi, n)
        across_axis = np.column_stack([np.cos(angle), np.sin(angle)])
        rolling = np.zeros_like(velocity)
        if self.rolling_start:
            rolling = -velocity
        if self.rolls_across_axis_only:
            rolling = _part_along(rolling, across_axis)
        return _State(
            position=np.column_stack([x, y]),
            velocity=velocity,
            rolling=rolling,
            across_axis=across_axis,
        )

    def _step(self, state: _State, generator: Generator) -> None:
        """Advance the particles by one integration step, in place.

        Friction changes velocity and rolling, as the module's docstring says; then
        rolling slows down, and some particles get a random kick.
        """
        step = 1.0 / (self.sampling_hz * self.steps_per_sample)
        slip = state.velocity + state.rolling - np.array([BELT_VELOCITY_MM_S, 0.0])
        speed = np.linalg.norm(slip, axis=1, keepdims=True)
        both = 1.0 + 1.0 / self.inertia  # change of the slip by that of the velocity
        # The force that ends the slip in this step, up to the Coulomb limit. Along a
        # cylinder's axis, where nothing rolls, the slip takes a few steps to end.
        push = np.minimum(self.friction * GRAVITY_MM_S2, speed / (both * step))
        change = -push * step * (slip / speed.clip(_LEAST_SPEED))
        state.velocity += change
        if np.isfinite(self.inertia):
            turn = change / self.inertia
            if self.rolls_across_axis_only:
                turn = _part_along(turn, state.across_axis)
            state.rolling += turn
            # Rolling resistance; friction at the contact then takes the particle along.
            loss = self.rolling_friction * GRAVITY_MM_S2 * step * both
            rolls = np.linalg.norm(state.rolling, axis=1, keepdims=True)
            state.rolling *= (rolls - loss).clip(0.0) / rolls.clip(_LEAST_SPEED)
        kicked = generator.random(self.particles) < self.kicks_per_s * step
        kicks = generator.normal(0.0, KICK_MM_S, (int(kicked.sum()), 2))
        state.velocity[kicked] += kicks
        state.position += state.velocity * step


def _part_along(vectors: Array, axis: Array) -> Array:
    """Return the part of vectors (n, 2) along unit vectors (n, 2)."""
    return axis * (vectors * axis).sum(axis=1, keepdims=True)


# friction.csv has a material a row: its particles in 0.2 kg (section 4), inertia (solid
# sphere 2/5, solid cylinder about its axis 1/2), and velocities, read off.
_TABLE = read_beside(__file__, "friction.csv")
MATERIALS = {
    row.pop("material"): FrictionBelt(**row) for row in _TABLE.to_dict("records")
}
