"""A small friction simulation of the belt, in place of the authors' DEM tracks.

Particles leave a slide slower than the belt and are dragged along by Coulomb friction
at their point of contact; collisions are random kicks. The materials differ in how a
particle can roll: a sphere in any direction, a cylinder only across its axis, a cuboid
not at all. It is no discrete-element simulation: particles do not meet.

For a unit mass the friction is ``-mu g s/|s|`` with the slip ``s = v + w - v_belt``.
The velocity ``w`` is that of the contact point due to rolling. The same force changes
``w`` by ``1/kappa`` times as much as ``v``; kappa is the moment of inertia over m r^2.
So slip ends when the particle rolls or stands on the belt.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from kilnflight.arrays import Array
from kilnflight.belt.models import (
    BELT_EDGE_MM,
    BELT_START_MM,
    BELT_VELOCITY_MM_S,
    BELT_WIDTH_MM,
)
from kilnflight.simulated.belt.bulk import BULKS
from kilnflight.tables import BELT_TRACKS

GRAVITY_MM_S2 = 9810.0


@dataclass(frozen=True)
class FrictionBelt:
    """One bulk material on the belt.

    The paper publishes neither friction coefficients nor feed velocities. Values marked
    "read off" were taken once from the authors' tracks upstream of the prediction
    phase. They are mean and standard deviation of the first velocity of each particle,
    and the median acceleration of the cuboids. Nothing was adjusted to the deviations
    of the models.
    """

    particles: int = 4000  # about 4000 per material (sec. 4, "Scenarios")
    inertia: float = np.inf  # moment of inertia / (m r^2); inf: does not roll
    rolls_across_axis_only: bool = False  # a cylinder lying on the belt
    rolling_start: bool = False  # rolls down the slide without slip
    friction: float = 0.16  # read off: 1.57 m/s^2 = 0.16 g
    rolling_friction: float = 0.005  # assumption: wood on a belt
    velocity_mm_s: float = 923.0  # at the start of the belt, read off (cuboids)
    velocity_spread_mm_s: float = 58.0  # read off (cuboids)
    lateral_spread_mm_s: float = 49.0  # read off (cuboids)
    kicks_per_s: float = 2.0  # collisions; assumption
    kick_mm_s: float = 30.0  # standard deviation per axis; assumption
    belt_mm_s: float = BELT_VELOCITY_MM_S  # sec. 4
    start_mm: float = BELT_START_MM + 2.0  # the authors' files
    end_mm: float = BELT_EDGE_MM + 32.0  # so that an observation follows the edge
    width_mm: float = BELT_WIDTH_MM
    feed_s: float = 15.0  # over which the particles are fed; the authors' files: 15 s
    sampling_hz: float = 100.0  # as the authors' public files
    steps_per_sample: int = 20  # integration step 0.5 ms; the paper's DEM has 0.1 ms

    def __call__(self, generator: np.random.Generator) -> pd.DataFrame:
        """Simulate particles that slide or roll along the belt; return `BELT_TRACKS`.

        A row is a particle and a sample: frame, particle, time in s, x and y in mm, up
        to ``end_mm`` or 20 s. Particles do not touch each other. So all are moved from
        one start, and then shifted to random times of entry within ``feed_s``. The same
        generator state gives the same tracks.
        """
        state = self._feed(generator)
        entry = np.sort(generator.uniform(0.0, self.feed_s, self.particles))
        first = np.ceil(entry * self.sampling_hz).astype(np.int64)
        samples: list[Array] = []
        while (
            state.position[:, 0].min() < self.end_mm
            and len(samples) < 20 * self.sampling_hz
        ):
            samples.append(state.position.copy())
            for _ in range(self.steps_per_sample):
                self._step(state, generator)
        x, y = np.moveaxis(np.stack(samples), -1, 0)
        particle, row = np.nonzero((x < self.end_mm).T)
        frame = first[particle] + row
        columns = (
            frame,
            particle,
            frame / self.sampling_hz,
            x[row, particle],
            y[row, particle],
        )
        return pd.DataFrame(dict(zip(BELT_TRACKS.names, columns, strict=True)))

    def _feed(self, generator: np.random.Generator) -> _State:
        """Return the particles as they reach the belt: places, velocities and rolling.

        They are drawn at random, evenly across the belt and by the spreads of the
        velocity.
        """
        n = self.particles
        first = (
            self.velocity_mm_s / self.sampling_hz
        )  # first seen within one frame's way
        x = self.start_mm + generator.uniform(0.0, first, n)
        y = generator.uniform(0.05, 0.95, n) * self.width_mm
        along = generator.normal(self.velocity_mm_s, self.velocity_spread_mm_s, n)
        velocity = np.column_stack(
            [along, generator.normal(0.0, self.lateral_spread_mm_s, n)]
        )
        angle = generator.uniform(0.0, np.pi, n)
        across_axis = np.column_stack([np.cos(angle), np.sin(angle)])
        rolling = -velocity if self.rolling_start else np.zeros_like(velocity)
        if self.rolls_across_axis_only:
            rolling = across_axis * (rolling * across_axis).sum(axis=1, keepdims=True)
        return _State(np.column_stack([x, y]), velocity, rolling, across_axis)

    def _step(self, state: _State, generator: np.random.Generator) -> None:
        """Advance the particles by one integration step, in place.

        Friction changes velocity and rolling, as the module's docstring says; then
        rolling slows down, and some particles get a random kick.
        """
        step = 1.0 / (self.sampling_hz * self.steps_per_sample)
        slip = state.velocity + state.rolling - np.array([self.belt_mm_s, 0.0])
        speed = np.linalg.norm(slip, axis=1, keepdims=True)
        # The force that ends the slip in this step, up to the Coulomb limit. Along a
        # cylinder's axis, where nothing rolls, the slip takes a few steps to end.
        push = np.minimum(
            self.friction * GRAVITY_MM_S2, speed / ((1.0 + 1.0 / self.inertia) * step)
        )
        direction = np.divide(slip, speed, out=np.zeros_like(slip), where=speed > 0)
        change = -push * step * direction
        state.velocity += change
        if not np.isinf(self.inertia):
            turn = change / self.inertia
            if self.rolls_across_axis_only:
                along = (turn * state.across_axis).sum(axis=1, keepdims=True)
                turn = state.across_axis * along
            state.rolling += turn
            # Rolling resistance; friction at the contact then takes the particle along.
            speed = np.linalg.norm(state.rolling, axis=1, keepdims=True)
            loss = (
                self.rolling_friction
                * GRAVITY_MM_S2
                * step
                * (1.0 + 1.0 / self.inertia)
            )
            remaining_share = np.divide(
                speed - loss, speed, out=np.zeros_like(speed), where=speed > loss
            )
            state.rolling *= remaining_share
        kicked = generator.random(self.particles) < self.kicks_per_s * step
        state.velocity[kicked] += generator.normal(
            0.0, self.kick_mm_s, (int(kicked.sum()), 2)
        )
        state.position += state.velocity * step


@dataclass
class _State:
    """Positions and velocities during a simulation, (n, 2) each, changed in place."""

    position: Array  # mm
    velocity: Array  # mm/s
    rolling: Array  # velocity of the contact point relative to the centre, mm/s
    across_axis: Array  # unit vectors: the direction in which a cylinder rolls


def _material(
    name: str, velocity: float, spread: float, lateral_spread: float, **rolling: Any
) -> FrictionBelt:
    """Return a material's belt; velocities and spreads of the feed are in mm/s."""
    start: dict[str, Any] = {"velocity_mm_s": velocity, "velocity_spread_mm_s": spread}
    start |= {"lateral_spread_mm_s": lateral_spread}
    return FrictionBelt(particles=BULKS[name].count, **start, **rolling)


# Feed velocities (mm/s) and their spread along and across the belt are read off.
# Moments of inertia over m r^2: solid sphere 2/5, solid cylinder about its axis 1/2.
_CYLINDERS: dict[str, Any] = {
    "inertia": 0.5,
    "rolls_across_axis_only": True,
    "rolling_start": True,
}
MATERIALS: dict[str, FrictionBelt] = {
    "spheres": _material(
        "spheres", 1045.0, 39.0, 27.0, inertia=0.4, rolling_start=True
    ),
    "cuboids": _material("cuboids", 923.0, 58.0, 49.0),
    "cylinders": _material("cylinders", 929.0, 42.0, 47.0, **_CYLINDERS),
}
