"""The life of every particle of a scene, and its state at a given moment.

Flights are computed once per scene (a few milliseconds per particle) and looked up by
time; the state between two samples is interpolated. On the wall (about 1200 degC) every
particle ignites (section 5.1.1), burns with a flame that flickers, and fades.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.twin.burning import BURNING, CAUSES, CHAR
from kilnflight.twin.camera import Geometry, unit_vectors
from kilnflight.twin.flight import ENDS, Flight, Flights, fly
from kilnflight.twin.gas import Gas
from kilnflight.twin.particles import FRACTIONS, Burst

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class OnTheWall:
    """Flames of particles that have landed; all assumptions.

    Flames on the wall must be shorter than about 0.2 s or flicker strongly: a background
    over 150 frames would absorb them otherwise, yet they are found (Table 5.5). Scenes take
    ``share_on`` and ``body_s`` from `kilnflight.twin.fitted`. While a flame is on it does
    not change from frame to frame; a real one would.
    """

    delay_s: float = 0.03  # until the flame is there
    sheet_s: float = 0.15  # mean burning time of sheets (exponential)
    body_s: float = 0.6  # mean burning time of chips and granules (exponential)
    flicker_hz: float = 8.0  # of the flame, on and off
    share_on: float = 0.5  # of the time


class Moment(NamedTuple):
    """The particles that can be seen at one moment; arrays (m, ...)."""

    particle: npt.NDArray[np.intp]
    position_m: Array  # (m, 3)
    velocity_m_s: Array  # (m, 3)
    surface_k: Array  # temperature of the surface, K
    area: Array  # share of the broadside area that is left
    burning: npt.NDArray[np.bool_]  # flame or glowing char
    landed: npt.NDArray[np.bool_]
    age_s: Array
    normal: Array  # (m, 3) of sheets, NaN of others
    along: Array  # (m, 3) their long side

    def take(self, rows: npt.NDArray[np.generic]) -> Moment:
        """Return the moment of some particles, by a mask or their rows."""
        return Moment._make(part[rows] for part in self)


@dataclass(frozen=True)
class Life:
    """All particles of a scene."""

    table: pd.DataFrame  # one row per particle, see `live`
    flights: Flights

    @cached_property
    def release_s(self) -> Array:
        """When each particle leaves the lance, (n,), in s from the first frame."""
        return self.table["release_s"].to_numpy()

    @cached_property
    def over_s(self) -> Array:
        """Time from which a particle is invisible, (n,), in s from the first frame."""
        landed = self.flights.end == ENDS.index("landed")
        afterwards = (self.table["flame_delay_s"] + self.table["flame_s"]).to_numpy() * landed
        return self.release_s + self.flights.end_s + afterwards

    @cached_property
    def _last_sample(self) -> npt.NDArray[np.intp]:
        return np.maximum((self.flights.state >= 0).sum(axis=1) - 1, 0)

    @cached_property
    def _flicker(self) -> Array:
        """Return delay, rate, phase and share of time of the flames on the wall, (4, n).

        The delay is in s, the rate in Hz.
        """
        names = ["flame_delay_s", "flicker_hz", "flicker_phase", "flicker_share"]
        return np.ascontiguousarray(self.table[names].to_numpy().T)

    def at(self, time_s: float) -> Moment:
        """Return the particles at a time, in s from the first frame."""
        rows = np.flatnonzero((self.release_s <= time_s) & (self.over_s > time_s))
        age = time_s - self.release_s[rows]
        end = self.flights.end_s[rows]
        landed = age >= end
        age_flying = np.minimum(age, end)
        # the sample before each age, and how far the age is beyond it
        step = self.flights.age_s[1] if len(self.flights.age_s) > 1 else 1.0
        last = self._last_sample[rows]
        low = np.minimum((age_flying / step).astype(np.intp), last)
        share = np.where(low < last, age_flying / step - low, 0.0)
        position = _interpolated(self.flights.position_m, rows, low, share)
        position[landed] = self.flights.end_position_m[rows[landed]]
        velocity = _interpolated(self.flights.velocity_m_s, rows, low, share)
        state = self.flights.state[rows, low]
        delay, rate, phase, flame_share = self._flicker[:, rows]
        since = age - end - delay
        flame_on = landed & (age - end >= delay) & ((since * rate + phase) % 1.0 < flame_share)
        return Moment(
            particle=rows,
            position_m=position,
            velocity_m_s=velocity * ~landed[:, None],
            surface_k=_interpolated(self.flights.surface_k, rows, low, share),
            area=_interpolated(self.flights.area, rows, low, share),
            burning=np.where(landed, flame_on, state >= BURNING),
            landed=landed,
            age_s=age,
            normal=_turned(self.flights.normal, rows, low, share),
            along=_turned(self.flights.along, rows, low, share),
        )

    def glowing(self, moment: Moment) -> npt.NDArray[np.bool_]:
        """Return which particles of a moment fly as glowing char, without a flame."""
        rows = moment.particle
        step = self.flights.age_s[1] if len(self.flights.age_s) > 1 else 1.0
        low = np.minimum((moment.age_s / step).astype(np.intp), self._last_sample[rows])
        return ~moment.landed & (self.flights.state[rows, low] == CHAR)


def _turned(
    samples: npt.NDArray[np.float32],
    rows: npt.NDArray[np.intp],
    low: npt.NDArray[np.intp],
    share: Array,
) -> Array:
    """Return directions (m, 3) between two samples, the shorter way: both faces look alike."""
    before = samples[rows, low].astype(np.float64)
    after = samples[rows, np.minimum(low + 1, samples.shape[1] - 1)].astype(np.float64)
    after = np.where((before * after).sum(axis=1, keepdims=True) < 0, -after, after)
    weight = share[:, None]
    return np.where(weight > 0, unit_vectors(before + weight * (after - before)), before)


def _interpolated(
    samples: npt.NDArray[np.float32],
    rows: npt.NDArray[np.intp],
    low: npt.NDArray[np.intp],
    share: Array,
) -> Array:
    """Return samples (n, samples, ...) of some rows, interpolated.

    They are a share of the way beyond the lower one.
    """
    before = samples[rows, low].astype(np.float64)
    after = samples[rows, np.minimum(low + 1, samples.shape[1] - 1)].astype(np.float64)
    weight = share.reshape((-1,) + (1,) * (before.ndim - 1))
    return np.where(weight > 0, before + weight * (after - before), before)


def live(
    feed: Sequence[Burst],
    gas: Gas,
    geometry: Geometry,
    flight: Flight,
    on_the_wall: OnTheWall,
    seed: int,
) -> Life:
    """Compute the life of all particles that are fed.

    Particles of one fraction fly together; each fraction has random numbers of its own, so
    that feeding more of one does not change another.

    Returns
    -------
    Life
        Its table has the columns ``particle``, ``fraction``, ``length_mm``, ``width_mm``,
        ``thickness_mm``, ``release_s``, ``ignition_s`` (from the release; NaN if never),
        ``ignition_cause``, ``end_s`` (from the release), ``end``, ``end_x_mm``,
        ``end_y_mm``, ``end_z_mm`` (camera coordinates).
    """
    if not feed:  # a burst of no particles, so that the table has its columns
        feed = [Burst(next(iter(FRACTIONS)), 0, 0.0)]
    tables, parts = [], []
    for number, name in enumerate(FRACTIONS):
        bursts = [burst for burst in feed if burst.fraction == name]
        if not bursts:
            continue
        generator = np.random.default_rng([seed, number])
        drawn = [burst.release(generator) for burst in bursts]
        particles = drawn[0][0].joined([more for more, _ in drawn[1:]])
        parts.append(fly(particles, gas, geometry, generator, flight))
        table = particles.table().assign(release_s=np.concatenate([time for _, time in drawn]))
        tables.append(_wall_fire(table, particles.fraction.sheet, on_the_wall, generator))
    flights = Flights.joined(parts).cut()
    end = geometry.to_camera(flights.end_position_m)
    table = pd.concat(tables, ignore_index=True)
    table = table.assign(
        particle=np.arange(len(table)),
        ignition_s=flights.ignition_s,
        ignition_cause=[CAUSES[k] for k in flights.cause],
        end_s=flights.end_s,
        end=[ENDS[k] for k in flights.end],
        end_x_mm=end[:, 0],
        end_y_mm=end[:, 1],
        end_z_mm=end[:, 2],
    )
    return Life(table, flights)


def _wall_fire(
    table: pd.DataFrame, sheet: bool, wall: OnTheWall, generator: np.random.Generator
) -> pd.DataFrame:
    n = len(table)  # the spreads of delay and flicker below are assumed
    mean = wall.sheet_s if sheet else wall.body_s
    return table.assign(
        flame_delay_s=wall.delay_s * generator.uniform(0.3, 1.7, n),
        flame_s=generator.exponential(mean, n),
        flicker_hz=wall.flicker_hz * generator.uniform(0.7, 1.3, n),
        flicker_phase=generator.uniform(0.0, 1.0, n),
        flicker_share=wall.share_on,
    )
