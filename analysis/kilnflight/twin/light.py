"""Light: grey values of wall, particles and flames, and the noise of the camera.

Levels are relative to the wall's and to full scale. An unlit particle has one level for all its
flight. A flame adds its own light and lets a share of that behind it pass, the less the thicker it
is. Its brightness and area flutter: sums of sines, so that any moment can be computed alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kilnflight.arrays import Array, Index

SHUTTER_S = 2.5e-3  # at which the wall has its level; just below the frame period of 330/s
SINES = 3  # of a flutter


@dataclass(frozen=True)
class Optics:
    """The way from light to grey values.

    ``unlit`` to ``gas_mm`` are fitted to Otsu's row and class recalls of Table 5.5 (notebook 10),
    ``share_on`` in an earlier fit to the same; all else are assumptions. No threshold of the thesis
    may be copied from there.
    """

    wall: float = 20_000.0  # grey value of the wall at `SHUTTER_S`
    exposure_s: float = SHUTTER_S  # 6 ms for PE granules (sec. 5.2.3)
    read_noise: float = 40.0  # grey values, standard deviation, four raw pixels averaged
    shot_gain: float = 0.6  # grey values^2 of variance per grey value, likewise
    unlit: float = 0.86  # median level of unlit particles over the wall's
    unlit_spread: float = 1.43  # of its logarithm
    flame: float = 1.04  # of a thick flame over full scale
    thick_mm: float = 1.25  # diameter of a flame by which light falls to 1/e
    gas_mm: float = 1.6  # radius of the burning gas around a particle
    share_on: float = 0.18  # of the time in which a flame on the wall is there
    flutter: tuple[float, float] = (0.1, 0.3)  # relative, of brightness and area
    flutter_hz: tuple[float, float] = (10.0, 60.0)
    tail_s: float = 2.5e-3  # how long soot glows behind its particle
    longest_tail_mm: float = 10.0
    curl: float = 0.4  # half axes of a burning sheet over those before
    flame_softness: float = 0.35  # width of its edge over its radius
    edge_softness_px: float = 0.8  # blur of the processed image

    @property
    def exposure(self) -> float:
        """Light over that of a shutter of `SHUTTER_S`."""
        return self.exposure_s / SHUTTER_S

    @property
    def at_wall(self) -> float:
        """Grey value of the wall at this exposure."""
        return self.wall * self.exposure

    def spread(self, factor: float) -> Optics:
        """Return the optics with another spread of unlit levels."""
        return replace(self, unlit_spread=factor * self.unlit_spread)

    def noise(self, level: npt.ArrayLike) -> Array:
        """Return the standard deviation of the noise at a grey value."""
        return np.sqrt(self.read_noise**2 + self.shot_gain * np.asarray(level, dtype=np.float64))


class Looks(NamedTuple):
    """What differs between the particles of a scene; arrays (n, ...)."""

    level: Array  # unlit, over the wall's
    brightness: Array  # of the flame, about 1
    gas_mm: Array  # radius of the burning gas
    strength: Array  # (n, 2) of the flutter of brightness and area
    hertz: Array  # (n, 2, sines)
    phase: Array  # (n, 2, sines)

    def flutter(self, rows: Index, time_s: float, shutter_s: float) -> Array:
        """Return brightness and area (2, m) of flames over their means at a time.

        The shutter averages what is faster.
        """
        hertz = self.hertz[rows]
        waves = np.cos(2 * np.pi * hertz * time_s + self.phase[rows]) * np.sinc(hertz * shutter_s)
        strength = self.strength[rows]
        return np.exp(strength * waves.sum(-1) * np.sqrt(2 / SINES) - np.square(strength) / 2).T


def draw_looks(fractions: npt.NDArray[np.object_], optics: Optics, seed: int) -> Looks:
    """Draw how the particles of a scene look."""
    n, generator = len(fractions), np.random.default_rng([seed, 202])
    level = optics.unlit * np.exp(optics.unlit_spread * generator.standard_normal(n))
    gas = optics.gas_mm * np.exp(0.25 * generator.standard_normal(n))
    low, high = np.log(optics.flutter_hz)
    corner = np.exp(generator.uniform(low, high, (n, 2, 1)))
    strata = (np.arange(SINES) + generator.random((n, 2, SINES))) / SINES
    return Looks(
        # from soot to paper, of which 0.85 of twice the wall's light comes back
        level=np.clip(level, 0.12, 1.7),
        brightness=np.exp(0.15 * generator.standard_normal(n)),
        gas_mm=np.where(fractions == "confetti", 0.75, 1.0) * gas,
        strength=generator.uniform(*optics.flutter, (n, 2)),
        hertz=corner * np.tan(np.pi / 2 * strata),
        phase=generator.uniform(0, 2 * np.pi, (n, 2, SINES)),
    )
