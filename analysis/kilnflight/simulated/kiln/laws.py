"""Flights as the thesis prints them: paths, landing and ignition as formulas of time.

Nothing is integrated, so that any moment can be computed alone. Coordinates are those
of the kiln in metres: s along the axis to the camera, from the lance; y aside and z up,
from the axis. Time t counts from the release.

    s(t) = v0 (exp(k t) - 1) / k                        so the speed is v0 + k s
    y(t) = w T(t) + f r(t) sin(2 pi h t + phi)          T(t) = tau (1 - exp(-t / tau))
    z(t) = u T(t) - g tau (t - T(t)) + f / 2 r(t) sin(2.6 pi h t + psi)

The fall has a linear drag of time constant tau; f and h are the flutter of sheets,
which begins with r(t) = 1 - exp(-t / 0.05 s). The laws reproduce the numbers of section
5.3 that do not contradict each other (notebook 10). They were fitted run by run,
without any picture, and rounded by hand.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kilnflight.arrays import Array, Flags, Generator, Index, Integers
from kilnflight.scores.flights import MARKS_M
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.geometry import Geometry
from kilnflight.tables import read_beside

GRAVITY_M_S2 = 9.81
ENDS = ("landed", "burnt out", "left the kiln", "still flying")
LANDED, BURNT_OUT, LEFT, FLYING = range(4)
LONGEST_S = 1.6  # no flight is longer
GRID_S = 0.004  # a landing is looked for in such steps
START_S = 0.05  # time in which the flutter begins; assumption
# Edges of the histograms of ignition (sec. 5.3.2)
BIN_S = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.6])
LEAST_FLAME_S = 0.02


@dataclass(frozen=True)
class Law:
    """Distribution of the flights of a fraction at one pressure.

    ``v0 = first exp(spread n)``, ``k = slope + 0.2 |slope| n`` and so on, with normal
    numbers n cut at 2, those of ``u`` and ``w`` at 2.5.

    Parameters
    ----------
    first
        Median of v0, the speed at the lance, in m/s.
    spread
        Standard deviation of its logarithm.
    slope
        Mean of k in 1/s, not 0.
    rise, rise_sd
        Mean and standard deviation of u in m/s.
    aside_sd
        Standard deviation of w in m/s.
    drag_s
        Median of tau in s: terminal speed in hot gas over gravity.
    drag_spread
        Standard deviation of its logarithm.
    flutter_m
        f in m, times 0.5 to 1.5.
    flutter_hz
        h in Hz, times 0.7 to 1.3.
    ignite
        Share of all particles that ignites in the air.
    when
        Per cent of those that ignite in each bin of `BIN_S`.
    flame_s
        Mean time of a flame in s, beyond `LEAST_FLAME_S`.
    """

    first: float
    spread: float
    slope: float
    rise: float
    rise_sd: float
    aside_sd: float
    drag_s: float
    drag_spread: float
    flutter_m: float
    flutter_hz: float
    ignite: float
    when: tuple[float, ...]
    flame_s: float


# laws.csv has a law a row; data/reference/twin_inputs.csv has the source of each value.
# ``first`` to ``rise_sd`` were fitted run by run. ``aside_sd`` is 2.5 times the value
# that gives R2 in x of Table 5.18: "lots of paper shreds touch the side walls" and
# confetti is "significantly dispersed" (secs 5.2.4 and 5.3.1). ``flutter_m`` of shreds
# is the largest with which one true path of 32 is irregular
# (`kilnflight.experiments.flights.identified`); that of confetti gives RMSE in x and y
# of Table 5.18. ``ignite`` and ``when`` are printed (sec. 5.3.2); wood and PE never
# ignite in the air. The rest are assumptions.
_TABLE = read_beside(__file__, "laws.csv", keep_default_na=False)
_TABLE["when"] = [tuple(map(float, text.split())) for text in _TABLE["when"]]
LAWS = {
    (row.pop("fraction"), row.pop("pressure_bar")): Law(**row)
    for row in _TABLE.to_dict("records")
}


class Flights(NamedTuple):
    """Flights of n particles; arrays (n,)."""

    v0: Array  # m/s
    k: Array  # 1/s, not 0
    u: Array  # m/s
    w: Array  # m/s
    tau: Array  # s
    f: Array  # m
    h: Array  # Hz
    phi: Array
    psi: Array
    y0: Array  # m, of the lance
    z0: Array
    ignition_s: Array  # NaN: never in the air
    end_s: Array
    end: Integers  # position in `ENDS`

    def take(self, rows: Index | Flags) -> Flights:
        """Return the flights of some particles, by a mask or their rows."""
        return Flights._make(part[rows] for part in self)

    def along(self, t: Array) -> Array:
        """Return s in m at times t (..., n)."""
        return self.v0 * np.expm1(self.k * t) / self.k

    def position(self, t: Array) -> Array:
        """Return s, y, z (..., n, 3) in m at times t (..., n)."""
        eased = -self.tau * np.expm1(-t / self.tau)
        begun = -self.f * np.expm1(-t / START_S)
        sway = begun * np.sin(2 * np.pi * self.h * t + self.phi)
        bob = 0.5 * begun * np.sin(2.6 * np.pi * self.h * t + self.psi)
        aside = self.y0 + self.w * eased + sway
        up = self.z0 + self.u * eased - GRAVITY_M_S2 * self.tau * (t - eased) + bob
        return np.stack([self.along(t), aside, up], axis=-1)

    def velocity(self, t: Array) -> Array:
        """Return the velocity (..., n, 3) in m/s at times t (..., n).

        The flutter is left out.
        """
        left = np.exp(-t / self.tau)
        fall = GRAVITY_M_S2 * self.tau * (1 - left)
        along = self.v0 * np.exp(self.k * t)
        return np.stack([along, self.w * left, self.u * left - fall], -1)

    def crossings(self) -> Array:
        """Return when each particle passes 1 to 5 m from the lance, in s (n, 5).

        NaN means never.
        """
        k = self.k[:, None]
        with np.errstate(invalid="ignore", divide="ignore"):  # some come to rest before
            times = np.log1p(k * np.array(MARKS_M) / self.v0[:, None]) / k
        return np.where(times <= self.end_s[:, None], times, np.nan)


def _draw_normal(generator: Generator, count: int, most: float) -> Array:
    """Return standard normal numbers (count,), drawn again beyond ``most``."""
    numbers = generator.standard_normal(count)
    while True:
        beyond = np.abs(numbers) > most
        if not beyond.any():
            return numbers
        numbers[beyond] = generator.standard_normal(np.count_nonzero(beyond))


def fly(law: Law, count: int, geometry: Geometry, generator: Generator) -> Flights:
    """Draw the flights of ``count`` particles, each to its end."""
    flights = _draw_paths(law, count, geometry, generator)
    chance, weights = _weigh_ignition(law, geometry)
    lit = generator.random(count) < chance
    drawn = generator.random(count)
    bins = np.searchsorted(np.cumsum(weights)[:-1], drawn, side="right")
    when = BIN_S[bins] + np.diff(BIN_S)[bins] * generator.random(count)
    flame_s = LEAST_FLAME_S + law.flame_s * generator.exponential(size=count)
    lit &= when < flights.end_s
    return burning(flights, np.where(lit, when, np.nan), flame_s)


def burning(flights: Flights, ignition_s: Array, flame_s: Array) -> Flights:
    """Return flights that ignite at times (n,), NaN: never, and burn ``flame_s``."""
    out = ignition_s + flame_s
    gone = out < flights.end_s  # False where NaN
    return flights._replace(
        ignition_s=ignition_s,
        end_s=np.where(gone, out, flights.end_s),
        end=np.where(gone, BURNT_OUT, flights.end),
    )


def _draw_paths(
    law: Law, count: int, geometry: Geometry, generator: Generator
) -> Flights:
    """Draw paths, each to the wall or out of the kiln, without a flame."""
    n1, n2, n5 = (_draw_normal(generator, count, 2.0) for _ in range(3))
    n3, n4 = (_draw_normal(generator, count, 2.5) for _ in range(2))
    size = generator.uniform(0.5, 1.5, count)
    rate = generator.uniform(0.7, 1.3, count)
    phi, psi = generator.uniform(0.0, 2 * np.pi, (2, count))
    _, y0, z0 = geometry.lance_m
    flights = Flights(
        v0=law.first * np.exp(law.spread * n1),
        k=law.slope + 0.2 * abs(law.slope) * n2,
        u=law.rise + law.rise_sd * n3,
        w=law.aside_sd * n4,
        tau=law.drag_s * np.exp(law.drag_spread * n5),
        f=law.flutter_m * size,
        h=law.flutter_hz * rate,
        phi=phi,
        psi=psi,
        y0=np.full(count, y0),
        z0=np.full(count, z0),
        ignition_s=np.full(count, np.nan),
        end_s=np.full(count, LONGEST_S),
        end=np.full(count, FLYING),
    )
    times = GRID_S * np.arange(round(LONGEST_S / GRID_S) + 1.0)
    s, y, z = np.moveaxis(flights.position(times[:, None]), -1, 0)
    landed_s = _first_time(np.hypot(y, z) - geometry.kiln_radius_mm / 1000.0)
    left_s = _first_time(s - geometry.outlet_m)
    end_s = np.minimum(np.minimum(landed_s, left_s), LONGEST_S)
    end = np.where(landed_s <= left_s, LANDED, LEFT)
    return flights._replace(end_s=end_s, end=np.where(end_s < LONGEST_S, end, FLYING))


def _first_time(beyond: Array) -> Array:
    """Return when distances (steps, n) first reach 0, in s (n,).

    Times are interpolated between the steps of `GRID_S`; infinite means never.
    """
    after = np.argmax(beyond >= 0, axis=0)
    rows = np.arange(len(after))
    high = beyond[after, rows]
    low = beyond[np.maximum(after - 1, 0), rows]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(after > 0, low / (low - high), 0.0)
    reached = (beyond >= 0).any(axis=0)
    return np.where(reached, (after - 1 + share) * GRID_S, np.inf)


@lru_cache(maxsize=32)
def _weigh_ignition(law: Law, geometry: Geometry) -> tuple[float, Array]:
    """Return the share of candidates for ignition, and the weights of the bins (5,).

    A time after the landing does not count. So bins are drawn with the printed shares
    over the share that still flies in their middle.
    """
    if not law.ignite:
        return 0.0, np.full(5, 0.2)
    paths = _draw_paths(law, 4000, geometry, np.random.default_rng(0))
    middle = (BIN_S[:-1] + BIN_S[1:]) / 2
    flying = (paths.end_s[:, None] > middle).mean(axis=0)
    shares = np.array(law.when) / sum(law.when) / np.maximum(flying, 1e-3)
    return min(law.ignite * float(shares.sum()), 1.0), shares / shares.sum()


def released(
    fraction: str, bar: float, geometry: Geometry, count: int, seed: int
) -> Flights:
    """Return the flights of particles of a fraction, released at once.

    Parameters
    ----------
    fraction, bar
        Fraction, and pressure in bar: a key of `LAWS`.
    geometry
        Of the kiln.
    count
        Number of particles.
    seed
        Other seeds give other flights.
    """
    key = [seed, list(FRACTIONS).index(fraction), int(10 * bar)]
    return fly(LAWS[fraction, bar], count, geometry, np.random.default_rng(key))
