"""The particles of a recording: when each is fed, flies, burns and lands.

On the wall (about 1200 degC) every particle ignites (section 5.1.1). Its flame there
goes on and off, or the background would absorb it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from pandas import DataFrame

from kilnflight.arrays import Array, Flags, Generator, Index
from kilnflight.simulated.kiln.fuel import are_sheets
from kilnflight.simulated.kiln.laws import ENDS, LANDED, Flights

DELAY_S = (0.01, 0.05)  # time from the landing to the flame; assumption
FLICKER_HZ = 8.0  # rate of flames on the wall; assumption
# Mean times of flames on the wall of sheets and other particles; assumptions
SHEET_S = 0.15
BODY_S = 0.6


class Moment(NamedTuple):
    """The particles that can be seen at one moment; arrays (m, ...)."""

    particle: Index
    position_m: Array  # (m, 3)
    velocity_m_s: Array  # (m, 3)
    burning: Flags  # has a flame
    landed: Flags
    age_s: Array  # since the release

    def take(self, rows: Index | Flags) -> Moment:
        """Return the moment of some particles, by a mask or their rows."""
        return Moment._make(part[rows] for part in self)


@dataclass(frozen=True)
class Life:
    """All particles of a recording.

    ``table`` has ``particle``, ``fraction``, ``length_mm``, ``width_mm``,
    ``thickness_mm``, ``release_s`` from the first frame, and from the release
    ``ignition_s`` (NaN: not in the air) and ``end_s``, ``end``, and the flame on the
    wall: ``flame_delay_s``, ``flame_s``, ``flicker_phase``.
    """

    table: DataFrame
    flights: Flights
    share_on: float  # share of a cycle in which a flame on the wall is there

    @classmethod
    def of(
        cls,
        table: DataFrame,
        flights: Flights,
        share_on: float,
        generator: Generator,
    ) -> Self:
        """Return the life of particles.

        Parameters
        ----------
        table
            ``fraction``, sizes and ``release_s``.
        flights
            Of the same particles.
        share_on
            Share of a cycle in which a flame on the wall is there.
        generator
            Draws the flames on the wall.
        """
        n = len(table)
        mean_s = np.where(are_sheets(table["fraction"]), SHEET_S, BODY_S)
        table = table.reset_index(drop=True).assign(
            particle=np.arange(n),
            ignition_s=flights.ignition_s,
            end_s=flights.end_s,
            end=[ENDS[k] for k in flights.end],
            flame_delay_s=generator.uniform(*DELAY_S, n),
            flame_s=mean_s * generator.exponential(size=n),
            flicker_phase=generator.random(n),
        )
        return cls(table, flights, share_on)

    @cached_property
    def release_s(self) -> Array:
        """When each particle leaves the lance, (n,), in s from the first frame."""
        return self.table["release_s"].to_numpy()

    @cached_property
    def _flame(self) -> Array:
        """Delay in s, time in s and phase of the flames on the wall, (3, n)."""
        names = ["flame_delay_s", "flame_s", "flicker_phase"]
        return self.table[names].to_numpy(float).T

    @cached_property
    def over_s(self) -> Array:
        """Time from which a particle is invisible, (n,), in s from the first frame."""
        afterwards = self._flame[:2].sum(axis=0) * (self.flights.end == LANDED)
        return self.release_s + self.flights.end_s + afterwards

    def at(self, time_s: float) -> Moment:
        """Return the particles at a time, in s from the first frame."""
        rows = np.flatnonzero((self.release_s <= time_s) & (self.over_s > time_s))
        flights = self.flights.take(rows)
        age = time_s - self.release_s[rows]
        landed = age >= flights.end_s
        flying_s = np.minimum(age, flights.end_s)
        delay, _, phase = self._flame[:, rows]
        since = age - flights.end_s - delay
        on = (since >= 0) & ((since * FLICKER_HZ + phase) % 1.0 < self.share_on)
        return Moment(
            particle=rows,
            position_m=flights.position(flying_s),
            velocity_m_s=flights.velocity(flying_s) * ~landed[:, None],
            burning=np.where(landed, on, age >= flights.ignition_s),
            landed=landed,
            age_s=age,
        )
