"""Models of where across the belt a particle arrives (2020 paper, section 4.2).

A model is called with the last observations (`kilnflight.tables.BELT_LAST`) and the
time each particle has left, in s, from an arrival model; it returns ``y`` in mm. Where
there is no time (NaN, no arrival predicted) there is no place either.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Protocol, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt.columns import Arrival, Last, checked_arrival, checked_last
from kilnflight.checks import InputError, check_shape

Array = npt.NDArray[np.float64]
Observation = pd.DataFrame | Last  # a table, or its columns as checked before
Reference = pd.DataFrame | Arrival


class LateralModel(Protocol):
    """What every lateral model offers."""

    name: ClassVar[str]

    def __call__(self, last: Observation, remaining_s: Array) -> Array:
        """Return the predicted lateral position in mm, ``remaining_s`` after the last one."""
        ...

    def calibrated(self, last: Observation, arrival: Reference) -> Self:
        """Return the model with its parameter taken from particles seen to arrive."""
        ...


def _state(last: Observation, remaining_s: Array) -> tuple[Array, Array, Array]:
    table = checked_last(last)
    if not isinstance(remaining_s, np.ndarray) or (remaining_s < 0).any():
        raise InputError("remaining_s: pass an array of times in s, none of them below 0.")
    check_shape(remaining_s, (len(table.y),), "remaining_s (one per particle)")
    return table.y, table.velocity_y_mm_s, table.acceleration_y_mm_s2


@dataclass(frozen=True)
class Straight:
    """No lateral movement; what a line-scan sorter assumes."""

    name: ClassVar[str] = "Straight"

    def __call__(self, last: Observation, remaining_s: Array) -> Array:
        """Return the last lateral position in mm."""
        position, _, _ = _state(last, remaining_s)
        return position

    def calibrated(self, last: Observation, arrival: Reference) -> Self:
        """Return itself; the model has no parameter."""
        return self


@dataclass(frozen=True)
class CV:
    """Constant lateral velocity."""

    name: ClassVar[str] = "CV"

    def __call__(self, last: Observation, remaining_s: Array) -> Array:
        """Return the predicted lateral position in mm."""
        position, velocity, _ = _state(last, remaining_s)
        return position + remaining_s * velocity

    def calibrated(self, last: Observation, arrival: Reference) -> Self:
        """Return itself; the model has no parameter."""
        return self


@dataclass(frozen=True)
class CA:
    """Constant lateral acceleration (Eq. 7)."""

    name: ClassVar[str] = "CA"

    def __call__(self, last: Observation, remaining_s: Array) -> Array:
        """Return the predicted lateral position in mm."""
        position, velocity, acceleration = _state(last, remaining_s)
        return position + remaining_s * velocity + remaining_s**2 * acceleration / 2

    def calibrated(self, last: Observation, arrival: Reference) -> Self:
        """Return itself; the model has no parameter."""
        return self


@dataclass(frozen=True)
class CADSC:
    """Constant acceleration, sign changes disallowed: a particle that has stopped stays."""

    name: ClassVar[str] = "CADSC"

    def __call__(self, last: Observation, remaining_s: Array) -> Array:
        """Return the predicted lateral position in mm."""
        position, velocity, acceleration = _state(last, remaining_s)
        brakes = velocity * acceleration < 0
        never = np.full_like(velocity, np.inf)
        with np.errstate(over="ignore"):  # a deceleration next to nothing never stops
            stops = np.divide(-velocity, acceleration, out=never, where=brakes)
        time = np.minimum(remaining_s, stops)
        return position + time * velocity + time**2 * acceleration / 2

    def calibrated(self, last: Observation, arrival: Reference) -> Self:
        """Return itself; the model has no parameter."""
        return self


@dataclass(frozen=True)
class Ratio:
    """One share of the lateral velocity stays, lost at a constant rate on the way."""

    share: float | None = None  # r: median of arrival velocity over last velocity
    name: ClassVar[str] = "Ratio"

    def __call__(self, last: Observation, remaining_s: Array) -> Array:
        """Return the predicted lateral position in mm."""
        position, velocity, _ = _state(last, remaining_s)
        if self.share is None:
            raise InputError("Ratio is not calibrated; call Ratio().calibrated(...) first.")
        # The acceleration is -(1 - r) velocity / time; half of it times time squared:
        return position + remaining_s * velocity * (1 + self.share) / 2

    def calibrated(self, last: Observation, arrival: Reference) -> Self:
        """Take the median quotient of the velocities; a last velocity of 0 is left out."""
        before, after = checked_last(last), checked_arrival(arrival)
        if not np.array_equal(before.particle, after.particle):
            raise InputError("Ratio: both tables must hold the same particles in the same order.")
        velocity = before.velocity_y_mm_s
        moves = velocity != 0
        if not moves.any():
            raise InputError("Ratio: no calibration particle moves across the belt; take others.")
        quotients = after.velocity_y_mm_s[moves] / velocity[moves]
        return replace(self, share=float(np.median(quotients)))
