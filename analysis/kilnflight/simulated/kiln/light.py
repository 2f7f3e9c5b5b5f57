"""Light: grey values of wall, particles and flames, and the noise of the camera.

Levels are relative to the wall's and to full scale. The level of an unlit particle
varies about its mean as the particle tumbles. A flame adds its own light and lets a
share of that behind it pass, the less the thicker it is. Its brightness and area
flutter: sums of sines, so that any moment can be computed alone.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kilnflight.arrays import Array, ArrayLike, Index, Two
from kilnflight.simulated.kiln.geometry import FULL_SCALE

# The wall has its level at this shutter, just below the frame period at 330 Hz.
SHUTTER_S = 2.5e-3
SINES = 3  # sines that make a flutter


@dataclass(frozen=True)
class Optics:
    """The way from light to grey values.

    ``paper`` to ``flame_softness`` are fitted by identify/light.py to Otsu's row and
    recalls (Table 5.5, Fig. 5.5), to Fig. 3.12 and to overexposed flames, ``share_on``
    in an earlier fit; all else are assumptions.

    Parameters
    ----------
    wall
        Grey value of the wall at `SHUTTER_S`.
    exposure_s
        Time of the shutter in s; 6 ms for PE granules (section 5.2.3).
    read_noise
        Standard deviation in grey values, four raw pixels averaged.
    shot_gain
        Variance in grey values^2 per grey value, likewise.
    paper, paper_spread
        Median level of unlit paper over the wall's, and spread of its logarithm.
    flame
        Level of a thick flame over full scale.
    thick_mm
        Diameter of a flame by which light falls to 1/e.
    gas_mm
        Radius of the burning gas around a particle.
    flame_softness
        Width of a flame's edge over its radius.
    bodies, body_spread
        Median levels over the wall's, and spread of their logarithm. Bodies are darker
        than the wall, "relatively dark" (section 5.2.4), and lighter than the inlet
        plate before which they were marked by hand (Table 5.15).
    tumble, tumble_hz
        Amplitude of an unlit level over its mean, and its rates.
    share_on
        Share of the time in which a flame on the wall is there.
    flutter, flutter_hz
        Relative flutter of brightness and area of flames, and its corner frequencies.
    tail_s, longest_tail_mm
        How long soot glows behind its particle, and how far at most.
    curl
        Half axes of what burns over those of the particle.
    edge_softness_px
        Blur of the processed image.
    """

    wall: float = 20_000.0
    exposure_s: float = SHUTTER_S
    read_noise: float = 40.0
    shot_gain: float = 0.6
    paper: float = 1.33
    paper_spread: float = 0.58
    flame: float = 2.3
    thick_mm: float = 3.5
    gas_mm: float = 3.4
    flame_softness: float = 0.56
    bodies: tuple[tuple[str, float], ...] = (("wood chip", 0.6), ("PE granule", 0.7))
    body_spread: float = 0.25
    tumble: float = 0.4
    tumble_hz: Two = (2.0, 6.0)
    share_on: float = 0.18
    flutter: Two = (0.1, 0.3)
    flutter_hz: Two = (10.0, 60.0)
    tail_s: float = 1.0e-3
    longest_tail_mm: float = 4.0
    curl: float = 0.25
    edge_softness_px: float = 0.8

    @property
    def exposure(self) -> float:
        """Light over that of a shutter of `SHUTTER_S`."""
        return self.exposure_s / SHUTTER_S

    @property
    def at_wall(self) -> float:
        """Grey value of the wall at this exposure."""
        return self.wall * self.exposure

    @property
    def at_flame(self) -> float:
        """Grey value of a thick flame at this exposure."""
        return self.flame * FULL_SCALE * self.exposure

    def noise(self, level: ArrayLike) -> Array:
        """Return the standard deviation of the noise at a grey value."""
        shot = self.shot_gain * np.asarray(level, float)
        return np.sqrt(self.read_noise**2 + shot)


class Looks(NamedTuple):
    """What differs between the particles of a scene; arrays (n, ...)."""

    level: Array  # unlit, over the wall's; mean over time
    tumble_hz: Array  # rate at which it varies
    tumble_phase: Array
    brightness: Array  # factor of the flame's light, about 1
    gas_mm: Array  # radius of the burning gas
    strength: Array  # (n, 2) of the flutter of brightness and area
    hertz: Array  # (n, 2, sines)
    phase: Array  # (n, 2, sines)

    def unlit(self, rows: Index, time_s: float, amplitude: float) -> Array:
        """Return the levels (m,) of unlit particles over the wall's at a time."""
        angle = 2 * np.pi * self.tumble_hz[rows] * time_s + self.tumble_phase[rows]
        return self.level[rows] * (1 + amplitude * np.cos(angle))

    def flutter(self, rows: Index, time_s: float, shutter_s: float) -> Array:
        """Return brightness and area (2, m) of flames over their means at a time.

        The shutter averages what is faster.
        """
        hertz = self.hertz[rows]
        waves = np.cos(2 * np.pi * hertz * time_s + self.phase[rows])
        waves *= np.sinc(hertz * shutter_s)
        strength = self.strength[rows]
        swing = strength * waves.sum(-1) * np.sqrt(2 / SINES)
        return np.exp(swing - np.square(strength) / 2).T


def draw_looks(fractions: npt.NDArray[np.object_], optics: Optics, seed: int) -> Looks:
    """Draw how the particles of a scene look."""
    n = len(fractions)
    generator = np.random.default_rng([seed, 202])
    standard = generator.standard_normal(n)
    level = optics.paper * np.exp(optics.paper_spread * standard)
    for name, median in optics.bodies:
        own = median * np.exp(optics.body_spread * standard)
        level = np.where(fractions == name, own, level)
    gas = optics.gas_mm * np.exp(0.25 * generator.standard_normal(n))
    low, high = np.log(optics.flutter_hz)
    corner = np.exp(generator.uniform(low, high, (n, 2, 1)))
    strata = (np.arange(SINES) + generator.random((n, 2, SINES))) / SINES
    return Looks(
        # The range is from soot to a level that just reaches full scale.
        level=np.clip(level, 0.12, FULL_SCALE / optics.at_wall / (1 + optics.tumble)),
        tumble_hz=generator.uniform(*optics.tumble_hz, n),
        tumble_phase=generator.uniform(0, 2 * np.pi, n),
        brightness=np.exp(0.15 * generator.standard_normal(n)),
        gas_mm=np.where(fractions == "confetti", 0.75, 1.0) * gas,
        strength=generator.uniform(*optics.flutter, (n, 2)),
        hertz=corner * np.tan(np.pi / 2 * strata),
        phase=generator.uniform(0, 2 * np.pi, (n, 2, SINES)),
    )
