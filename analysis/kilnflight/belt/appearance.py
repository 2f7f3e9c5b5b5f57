"""Where particles come into view and where they leave it (2016 paper, II.B and Fig. 2)."""

from __future__ import annotations

from dataclasses import dataclass
from math import erfc, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.belt.camera import TRACKED, Area
from kilnflight.checks import check_between, check_positive, check_shape

Array = npt.NDArray[np.float64]

LEAST = 1e-12  # a probability whose logarithm is taken


@dataclass(frozen=True)
class Appearance:
    """Likelihoods by place on the belt that a track begins or is not observed any more.

    Notes
    -----
    Fig. 2 shows both curves without a scale; their text says that particles appear mostly at
    the beginning of the observed region, and have likely disappeared where their prediction
    lies behind its end. Here both follow from counting: what is new in a frame lies within
    the way that the belt makes in it, and a track whose prediction lies outside by a certain
    probability is missed by that probability. Beyond the sides is outside, too.
    """

    area: Area = TRACKED
    arrivals: float = 1.0  # per frame; the order of 4000 particles in 15 s at 200 frames/s
    entry_mm: float = 7.5  # in which they are first seen: 1500 mm/s for 5 ms
    entry_blur_mm: float = 2.5  # softness of its end: radius of a sphere
    clutter: float = 0.1  # per frame, anywhere: dirt, or particles found again; assumption
    missed: float = 0.1  # share of particles in view without a spot of their own; assumption

    def __post_init__(self) -> None:
        """Refuse what is no number of particles."""
        for name in ("arrivals", "entry_mm", "entry_blur_mm", "clutter"):
            check_positive(getattr(self, name), f"Appearance: {name}")
        check_between(self.missed, LEAST, 1 - LEAST, "Appearance: missed")

    @property
    def clutter_density(self) -> float:
        """Expected number of measurements per frame and mm^2 that are of no new particle."""
        return self.clutter / self.area.square_mm

    def new(self, places: Array) -> Array:
        """Return the expected number of new tracks per mm^2 at places (m, 2) in mm."""
        check_shape(places, (None, 2), "places")
        density = self.arrivals / (self.entry_mm * self.area.width_mm)
        end = self.area.start_mm + self.entry_mm
        return _new(places, end, self.entry_blur_mm, density, self.clutter_density)

    def gone(self, places: Array, residual: Array) -> tuple[Array, Array]:
        """Return the probability that tracks are not observed, and that they are outside.

        Parameters
        ----------
        places
            Predicted, (n, 2) in mm.
        residual
            S (n, 2, 2) in mm^2, the covariance of what would be measured; the ellipse is taken
            along the axes.
        """
        check_shape(places, (None, 2), "places")
        check_shape(residual, (len(places), 2, 2), "residual")
        area = self.area
        sides = area.start_mm, area.end_mm, area.width_mm
        return _gone(places, residual, *sides, self.missed)


@njit(cache=True)
def _below(value: float) -> float:
    """Return the share of a standard normal distribution below ``value``."""
    return 0.5 * erfc(-value / sqrt(2.0))


@njit(cache=True)
def _new(places: Any, end: float, blur: float, density: float, clutter: float) -> Any:
    result = np.empty(len(places))
    for j in range(len(places)):
        result[j] = clutter + density * _below((end - places[j, 0]) / blur)
    return result


@njit(cache=True)
def _gone(places: Any, residual: Any, start: float, end: float, width: float, missed: float) -> Any:
    gone, outside = np.empty(len(places)), np.empty(len(places))
    for i in range(len(places)):
        along, across = sqrt(residual[i, 0, 0]), sqrt(residual[i, 1, 1])
        x, y = places[i]
        inside = _below((end - x) / along) - _below((start - x) / along)
        inside *= _below((width - y) / across) - _below(-y / across)
        outside[i] = 1.0 - inside
        gone[i] = max(LEAST, 1.0 - (1.0 - missed) * inside)
    return gone, outside
