"""Light: Planck in the camera's band, and flames that flicker.

Soot and char shine after Planck, a flame is as opaque as its soot makes it, and its luminosity and
area are first-order processes. They are sums of waves, so that any moment can be computed alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kilnflight.checks import check_number
from kilnflight.twin.gas import Gas, excess_velocity, stream

Array = npt.NDArray[np.float64]
Range = tuple[float, float]

SECOND_RADIATION_UM_K = 14_388.0  # hc/k
# Electrons per unit of radiant energy of a front-lit silicon sensor behind glass, over its peak;
# assumption after data sheets of such sensors.
BAND_UM = np.linspace(0.4, 1.0, 13)
RESPONSE = np.array([0.5, 0.8, 0.95, 1.0, 0.98, 0.92, 0.82, 0.7, 0.55, 0.4, 0.26, 0.14, 0.05])
WAVES = 12  # of a process; more change nothing that can be seen
PIXELS = 4096  # whose light is summed at once


def band_radiance(temperature_k: npt.ArrayLike) -> Array:
    """Return what the sensor sees of a black body by Planck's law, in arbitrary units."""
    kelvin = np.maximum(np.asarray(temperature_k, dtype=np.float64), 250.0)
    flat, seen = kelvin.reshape(-1, 1), np.empty(kelvin.size)
    for first in range(0, len(flat), PIXELS):  # a picture's bands together do not fit the cache
        part = slice(first, first + PIXELS)
        planck = BAND_UM**-5 / np.expm1(SECOND_RADIATION_UM_K / (BAND_UM * flat[part]))
        seen[part] = np.trapezoid(RESPONSE * planck, BAND_UM)
    return seen.reshape(kelvin.shape)


@dataclass(frozen=True)
class Light:
    """How particles shine and are lit.

    ``soot_1_m`` and ``irradiance_spread`` come from `kilnflight.twin.fitted`, all else from
    the literature or by assumption.
    """

    shutter_s: float = 2.5e-3  # at which the wall has its level; a longer one brightens all
    soot_k: Range = (1800.0, 2000.0)  # luminous diffusion flames of hydrocarbons and cellulose
    # Absorption of soot in the band, 5 f/wavelength: 6 to 60 1/m for 1 to 10 ppm (Modest 2013)
    soot_1_m: float = 30.0
    # Char that oxidises is hotter than gas and wall around it, 1423 K, and dimmer than a flame
    # (design: twin2.md): below the 3 walls of the mean flame at the least soot. Assumption within.
    char_k: Range = (1430.0, 1540.0)
    # Relative standard deviation of luminosity and area, and corner frequency (design:
    # twin2.md); both differ from flame to flame
    flutter: Range = (0.1, 0.3)
    flutter_hz: Range = (10.0, 60.0)
    tail_s: float = 2.5e-3  # how long soot glows behind its particle; assumption
    longest_tail_mm: float = 14.0  # then it is burnt; assumption
    rise_m_s: float = 0.6  # of a flame's gas by buoyancy: sqrt(2 g 2 cm); assumption
    irradiance_spread: float = 0.2  # of the light on single particles, of its logarithm
    # Shares of light that pass: seen through a granule, and scattered through paper (opacity of
    # office paper 80 to 90 %)
    seen_through: tuple[tuple[str, float], ...] = (("PE granule", 0.4),)
    scattered_through: tuple[tuple[str, float], ...] = (("confetti", 0.15), ("paper shred", 0.15))

    def __post_init__(self) -> None:
        """Refuse light that is not positive."""
        for field in fields(self)[:10]:
            for value in np.atleast_1d(getattr(self, field.name)):
                check_number(float(value), f"Light: {field.name}", above=0)

    def fires(self, names: Sequence[str], seed: int) -> Fires:
        """Draw what differs between the particles of a scene, of these fractions."""
        n, generator = len(names), np.random.default_rng([seed, 202])
        strata = (np.arange(WAVES) + generator.uniform(0, 1, (n, 2, WAVES))) / WAVES
        low, high = map(float, np.log(self.flutter_hz))
        corner = np.exp(generator.uniform(low, high, (n, 2, 1)))
        seen, scattered = dict(self.seen_through), dict(self.scattered_through)
        return Fires(
            soot_k=generator.uniform(*self.soot_k, n),
            char_k=generator.uniform(*self.char_k, n),
            shade=_about_one(self.irradiance_spread, generator.normal(size=n)),
            strength=generator.uniform(*self.flutter, (n, 2)),
            hertz=corner * np.tan(np.pi / 2 * strata),
            phase=generator.uniform(0, 2 * np.pi, (n, 2, WAVES)),
            seen_through=np.array([seen.get(name, 0.0) for name in names]),
            scattered_through=np.array([scattered.get(name, 0.0) for name in names]),
        )

    def tails(self, velocity_m_s: Array, from_lance_m: Array, gas: Gas) -> Array:
        """Return the tails (m, 3) in mm of flames: along the wind on them, and up."""
        wind = -velocity_m_s
        wind[:, 0] += stream(gas, from_lance_m.T) + excess_velocity(gas, from_lance_m.T)
        wind[:, 2] += self.rise_m_s
        tail = 1000.0 * self.tail_s * wind
        length = np.linalg.norm(tail, axis=1, keepdims=True)
        return tail * np.minimum(1.0, self.longest_tail_mm / np.maximum(length, 1e-9))


class Fires(NamedTuple):
    """What differs between the particles of a scene; arrays (n, ...)."""

    soot_k: Array
    char_k: Array
    shade: Array  # light on it over the mean
    strength: Array  # (n, 2) of the changes of luminosity and area
    hertz: Array  # (n, 2, waves)
    phase: Array  # (n, 2, waves)
    seen_through: Array
    scattered_through: Array

    def flutter(self, rows: npt.NDArray[np.intp], time_s: float, shutter_s: float) -> Array:
        """Return luminosity and area (2, m) of flames over their means at a time.

        Each is the exponential of a first-order process: its frequencies are spread as a
        relaxation's, so it forgets exponentially. The shutter averages what is faster.
        """
        hertz = self.hertz[rows]
        waves = np.cos(2 * np.pi * hertz * time_s + self.phase[rows]) * np.sinc(hertz * shutter_s)
        return _about_one(self.strength[rows], waves.sum(axis=-1) * np.sqrt(2 / WAVES)).T


class Look(NamedTuple):
    """How the particles of a moment shine; arrays (m, ...)."""

    fires: Fires  # of these particles
    char: npt.NDArray[np.bool_]  # glows without a flame
    luminosity: Array  # of flames, over the mean
    swelling: Array  # area of flames over the mean
    tail_mm: Array  # (m, 3) in kiln coordinates


def _about_one(spread: npt.ArrayLike, normal: Array) -> Array:
    """Return positive factors of mean 1 of standard normal values."""
    return np.exp(np.asarray(spread) * normal - np.square(spread) / 2)
