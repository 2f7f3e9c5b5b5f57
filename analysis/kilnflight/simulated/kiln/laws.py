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
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from kilnflight.arrays import Array, Integers
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.geometry import Geometry

GRAVITY_M_S2 = 9.81
ENDS = ("landed", "burnt out", "left the kiln", "still flying")
LANDED, BURNT_OUT, LEFT, FLYING = range(4)
LONGEST_S = 1.6  # of a flight; none is longer
GRID_S = 0.004  # between the moments at which a landing is looked for
START_S = 0.05  # time in which the flutter begins; assumption
METRES = np.arange(1.0, 6.0)  # marks from the lance (section 5.3.1)
BIN_S = np.array(
    [0.0, 0.1, 0.2, 0.3, 0.4, 0.6]
)  # edges of the histograms of ignition (sec. 5.3.2)
LEAST_FLAME_S = 0.02


@dataclass(frozen=True)
class Law:
    """Distribution of the flights of a fraction at one pressure; all lengths in m,
    times in s.

    ``v0 = first exp(spread n)``, ``k = slope + 0.2 |slope| n`` and so on, with normal
    numbers n cut at 2, those of ``u`` and ``w`` at 2.5.
    """

    first: float  # m/s, median of v0 at the lance
    spread: float  # of its logarithm
    slope: float  # 1/s, k0
    rise: float  # m/s, mean of u
    rise_sd: float  # m/s
    aside_sd: float  # m/s, of w
    drag_s: float  # tau: terminal speed in hot gas over gravity
    drag_spread: float = 0.0  # of its logarithm
    flutter_m: float = 0.0  # f, times 0.5 to 1.5
    flutter_hz: float = 0.0  # h, times 0.7 to 1.3
    ignite: float = 0.0  # share of all that ignites in the air
    when: tuple[float, ...] = (0.0,) * 5  # per cent of those, in the bins of `BIN_S`
    flame_s: float = 0.0  # mean time of a flame, beyond `LEAST_FLAME_S`


_FITTED = ("first", "spread", "slope", "rise", "rise_sd")  # run by run, to flight.csv
_RUNS: dict[tuple[str, float], tuple[float, ...]] = {
    ("wood chip", 4.5): (14.2, 0.04, -1.35, 0.47, 0.27),
    ("wood chip", 5.0): (13.4, 0.08, -0.70, 0.32, 1.0),
    ("confetti", 4.5): (9.4, 0.36, -4.3, 0.40, 1.2),
    ("confetti", 5.0): (9.3, 0.15, -3.8, 0.90, 1.47),
    ("paper shred", 4.5): (6.2, 0.36, -3.6, 0.84, 0.6),
    ("paper shred", 5.0): (6.7, 0.375, -3.8, 1.37, 1.19),
    ("PE granule", 4.5): (8.45, 0.17, -0.45, 0.96, 0.57),
    ("PE granule", 5.0): (7.45, 0.05, 0.76, 0.98, 0.36),
}
# The spread aside is 2.5 times what gives R2 in x of Table 5.18: "lots of paper shreds
# touch the side walls" and confetti is "significantly dispersed" (secs 5.2.4 and
# 5.3.1). The flutter of shreds is the largest with which one true path of 32 is
# irregular (`experiments.identified`). That of confetti is by Table 5.18, RMSE in x and
# y. The rest are assumptions.
_KINDS: dict[str, dict[str, Any]] = {
    "wood chip": {"aside_sd": 1.375, "drag_s": 0.8},
    "PE granule": {"aside_sd": 0.875, "drag_s": 2.0},
    "confetti": {
        **{"aside_sd": 1.5, "drag_s": 0.2, "drag_spread": 0.2},
        **{"flutter_m": 0.010, "flutter_hz": 8.0, "flame_s": 0.15},
    },
    "paper shred": {
        **{"aside_sd": 2.25, "drag_s": 0.2, "drag_spread": 0.2},
        **{"flutter_m": 0.024, "flutter_hz": 7.0, "flame_s": 0.3},
    },
}
# Printed shares and histograms of ignition (sec. 5.3.2); wood and PE never ignite in
# the air
_IGNITION: dict[tuple[str, float], dict[str, Any]] = {
    ("confetti", 4.5): {"ignite": 0.26, "when": (3.0, 47.0, 30.0, 14.0, 6.0)},
    ("confetti", 5.0): {"ignite": 0.17, "when": (0.0, 20.0, 60.0, 15.0, 5.0)},
    ("paper shred", 4.5): {"ignite": 0.71, "when": (29.6, 26.0, 21.0, 15.0, 8.4)},
    ("paper shred", 5.0): {"ignite": 0.40, "when": (15.0, 25.0, 28.0, 22.0, 10.0)},
}
LAWS = {
    run: Law(
        **_KINDS[run[0]] | _IGNITION.get(run, {}) | dict(zip(_FITTED, fit, strict=True))
    )
    for run, fit in _RUNS.items()
}


class Flights(NamedTuple):
    """Flights of n particles; arrays (n,)."""

    v0: Array  # m/s
    k: Array  # 1/s
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

    def take(self, rows: npt.NDArray[np.generic]) -> Flights:
        """Return the flights of some particles, by a mask or their rows."""
        return Flights._make(part[rows] for part in self)

    @classmethod
    def joined(cls, parts: list[Flights]) -> Self:
        """Return several flights as one, one after the other."""
        return cls._make(np.concatenate(each) for each in zip(*parts, strict=True))

    def along(self, t: Array) -> Array:
        """Return s in m at times t (..., n)."""
        growth = np.where(self.k == 0, 1.0, self.k)
        return np.where(
            self.k == 0, self.v0 * t, self.v0 * np.expm1(self.k * t) / growth
        )

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
        """Return the velocity (..., n, 3) in m/s at times t (..., n), without the
        flutter.
        """
        left = np.exp(-t / self.tau)
        fall = GRAVITY_M_S2 * self.tau * (1 - left)
        return np.stack(
            [self.v0 * np.exp(self.k * t), self.w * left, self.u * left - fall], -1
        )

    def crossings(self) -> Array:
        """Return when each particle passes 1 to 5 m from the lance, in s (n, 5); NaN:
        never.
        """
        k = np.where(self.k == 0, 1e-9, self.k)[:, None]
        with np.errstate(
            invalid="ignore", divide="ignore"
        ):  # below 0: it comes to rest before
            times = np.log1p(k * METRES / self.v0[:, None]) / k
        return np.where(times <= self.end_s[:, None], times, np.nan)


def _cut(generator: np.random.Generator, count: int, most: float) -> Array:
    """Return standard normal numbers (count,), drawn again beyond ``most``."""
    numbers = generator.standard_normal(count)
    while (beyond := np.abs(numbers) > most).any():
        numbers[beyond] = generator.standard_normal(np.count_nonzero(beyond))
    return numbers


def fly(
    law: Law, count: int, geometry: Geometry, generator: np.random.Generator
) -> Flights:
    """Draw the flights of ``count`` particles, each to its end."""
    flights = _paths(law, count, geometry, generator)
    n = count
    chances, weights = _ignition(law, geometry)
    lit = generator.random(n) < chances
    bins = np.searchsorted(np.cumsum(weights)[:-1], generator.random(n), side="right")
    when = BIN_S[bins] + np.diff(BIN_S)[bins] * generator.random(n)
    flame_s = LEAST_FLAME_S + law.flame_s * generator.exponential(size=n)
    lit &= when < flights.end_s
    return burning(flights, np.where(lit, when, np.nan), flame_s)


def burning(flights: Flights, ignition_s: Array, flame_s: Array) -> Flights:
    """Return flights that ignite at some times (n,), NaN: never, and burn for others
    (n,).
    """
    out = ignition_s + flame_s
    gone = out < flights.end_s  # False where NaN
    return flights._replace(
        ignition_s=ignition_s,
        end_s=np.where(gone, out, flights.end_s),
        end=np.where(gone, BURNT_OUT, flights.end),
    )


def _paths(
    law: Law, count: int, geometry: Geometry, generator: np.random.Generator
) -> Flights:
    """Draw paths, each to the wall or out of the kiln, without a flame."""
    n1, n2, n5 = (_cut(generator, count, 2.0) for _ in range(3))
    n3, n4 = (_cut(generator, count, 2.5) for _ in range(2))
    size = generator.uniform(0.5, 1.5, count)
    rate = generator.uniform(0.7, 1.3, count)
    v0 = law.first * np.exp(law.spread * n1)
    k = law.slope + 0.2 * abs(law.slope) * n2
    u = law.rise + law.rise_sd * n3
    w = law.aside_sd * n4
    tau = law.drag_s * np.exp(law.drag_spread * n5)
    phases = generator.uniform(0.0, 2 * np.pi, (2, count))
    f = law.flutter_m * size
    h = law.flutter_hz * rate
    y0, z0, never, zero = np.tile([[*geometry.lance_m[1:], np.nan, 0.0]], (count, 1)).T
    parts = v0, k, u, w, tau, f, h, *phases, y0, z0, never, zero, np.full(count, FLYING)
    flights = Flights._make(parts)
    return _ended(flights, geometry)


def _ended(flights: Flights, geometry: Geometry) -> Flights:
    """Return flights with the time and kind of their end, interpolated on a grid."""
    moments = np.arange(round(LONGEST_S / GRID_S) + 1)[:, None]
    aloft = np.arange(len(flights.v0))
    over = np.full((2, len(moments), len(aloft)), -np.inf)  # of wall and outlet
    for some in np.array_split(moments, 20):  # of the particles that still aloft
        place = flights.take(aloft).position(GRID_S * some + np.zeros(len(aloft)))
        beyond = np.hypot(*place[..., 1:].T).T - geometry.kiln_radius_mm / 1000.0
        over[:, some, aloft] = beyond, place[..., 0] - geometry.outlet_m
        aloft = aloft[(over[:, some[-1], aloft] < 0).all(axis=0)]
    ends = []
    for beyond in over:
        after = np.argmax(beyond >= 0, axis=0)
        rows = np.arange(len(after))
        high = beyond[after, rows]
        low = beyond[np.maximum(after - 1, 0), rows]
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(after > 0, low / (low - high), 0.0)
        ends.append(
            np.where((beyond >= 0).any(axis=0), (after - 1 + share) * GRID_S, np.inf)
        )
    end_s = np.minimum(np.min(ends, axis=0), LONGEST_S)
    kind = np.where(
        end_s < LONGEST_S, np.where(ends[0] <= ends[1], LANDED, LEFT), FLYING
    )
    return flights._replace(end_s=end_s, end=kind)


@lru_cache(maxsize=32)
def _ignition(law: Law, geometry: Geometry) -> tuple[float, Array]:
    """Return the share of candidates for ignition, and the weights of the bins (5,).

    A time after the landing does not count. So bins are drawn with the printed shares
    over the share that still flies in their middle.
    """
    if not law.ignite:
        return 0.0, np.full(5, 0.2)
    paths = _paths(law, 4000, geometry, np.random.default_rng(0))
    middle = (BIN_S[:-1] + BIN_S[1:]) / 2
    flying = (paths.end_s[:, None] > middle).mean(axis=0)
    shares = np.array(law.when) / sum(law.when) / np.maximum(flying, 1e-3)
    return min(law.ignite * float(shares.sum()), 1.0), shares / shares.sum()


def released(
    fraction: str, bar: float, geometry: Geometry, count: int, seed: int
) -> Flights:
    """Return the flights of particles of a fraction, released at once."""
    generator = np.random.default_rng(
        [seed, list(FRACTIONS).index(fraction), int(10 * bar)]
    )
    return fly(LAWS[fraction, bar], count, geometry, generator)
