"""From light to grey values: thermal radiation, exposure, noise (thesis 2.1.4; R12 camera)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kilnflight.checks import check_positive

Array = npt.NDArray[np.float64]

SECOND_RADIATION_M_K = 0.014388  # hc/k
WAVELENGTH_M = 0.65e-6  # effective, of a silicon sensor looking at a red-hot wall
FULL_SCALE = 65535.0  # uint16 (sec. 5.1.3)


@dataclass(frozen=True)
class Optics:
    """Exposure and noise; nobody published them. Scenes have the levels of `exposure` instead.

    The thesis's DoG threshold of 450 to 550 grey values bounds the scale only loosely, so
    a threshold is never to be copied from there.
    """

    wall_level: float = 5200.0  # grey value of a surface at the wall's temperature; assumption
    wall_k: float = 1423.0  # temperature of that surface
    read_noise: float = 40.0  # grey values, standard deviation, four raw pixels averaged
    shot_gain: float = 0.6  # grey values^2 of variance per grey value, likewise
    exposure_s: float = 2.5e-3  # just below the frame period of 330/s; 6 ms at 153.85/s
    flame_level: float = 40_000.0  # of a flame's core; saturates with the wall behind it
    # The next two were set once by Fig. 3.12, a published input (mean radius 7.7 px, nearly all
    # below 15 px): 5 mm and 0.5 were tried first and gave burning particles of 12 px.
    flame_mm: float = 2.5  # by which a flame stands off its particle
    curl: float = 0.4  # half axes of a burning sheet over those before
    # Light on a particle over the wall's own; below 1 the open outlet and the cool inlet plate
    # show. Assumption.
    irradiance: float = 1.0
    flame_softness: float = 0.35  # width of its edge over its radius; assumption
    edge_softness_px: float = 0.8  # blur of the processed image; assumption

    def __post_init__(self) -> None:
        """Refuse levels that are not positive."""
        for name in ("wall_level", "wall_k", "read_noise", "shot_gain", "exposure_s"):
            check_positive(float(getattr(self, name)), f"Optics: {name}")

    def glow(self, temperature_k: npt.ArrayLike) -> Array:
        """Return the grey value of a black surface by Planck's law at one wavelength."""
        temperature = np.maximum(np.asarray(temperature_k, dtype=np.float64), 250.0)
        exponent = SECOND_RADIATION_M_K / WAVELENGTH_M
        change = np.exp(exponent / self.wall_k - exponent / temperature)
        return self.wall_level * np.minimum(change, FULL_SCALE / self.wall_level)

    def noise(self, level: npt.ArrayLike) -> Array:
        """Return the standard deviation of the noise at a grey value."""
        variance = self.read_noise**2 + self.shot_gain * np.asarray(level, dtype=np.float64)
        return np.sqrt(variance)
