"""A stretch of the belt: the whole of it, or the part that is observed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_finite, check_positive

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Area:
    """A rectangle of the belt in the coordinates of the tracks; y runs from 0."""

    start_mm: float = 388.0  # the authors' files of 2020
    end_mm: float = 788.0  # "a total length of 40 cm", 2016, section IV
    width_mm: float = 180.0  # 2020, section 3

    def __post_init__(self) -> None:
        """Refuse what has no area."""
        check_finite([self.start_mm, self.end_mm], "Area: start_mm and end_mm")
        if not self.start_mm < self.end_mm:
            raise InputError(f"Area: end_mm {self.end_mm} is not beyond start_mm {self.start_mm}.")
        check_positive(self.width_mm, "Area: width_mm")

    @property
    def corners(self) -> Array:
        """Its corners (4, 2), x and y in mm: start, end, end, start; y = 0 first."""
        start, end, width = self.start_mm, self.end_mm, self.width_mm
        return np.array([[start, 0.0], [end, 0.0], [end, width], [start, width]])

    @property
    def square_mm(self) -> float:
        """Its size in mm^2."""
        return (self.end_mm - self.start_mm) * self.width_mm

    def holds(self, places: Array) -> npt.NDArray[np.bool_]:
        """Return which places (n, 2), x and y, lie in it."""
        x, y = places.T
        along = (x >= self.start_mm) & (x <= self.end_mm)
        return along & (y >= 0) & (y <= self.width_mm)


BELT = Area()
TRACKED = Area(end_mm=688.0)  # the last 10 cm are the prediction phase, 2016, section IV
