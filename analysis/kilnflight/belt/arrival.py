"""Models of when a particle reaches a place on the belt (2020 paper, section 4.1).

A model is called with the last observations (`kilnflight.tables.BELT_LAST`) and the
place to predict to, in mm; it returns the predicted times in s, on the clock of the
observations. Where a model predicts no arrival at all (a particle that its own
acceleration stops before the target, Eq. 6 without a positive root) the time is NaN;
`kilnflight.belt.deviation` counts those.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Protocol, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt.columns import Arrival, Last, checked_arrival, checked_last
from kilnflight.checks import InputError, check_finite, check_positive

Array = npt.NDArray[np.float64]
Observation = pd.DataFrame | Last  # a table, or its columns as checked before
Reference = pd.DataFrame | Arrival

BELT_VELOCITY_MM_S = 1500.0  # 2020 paper, section 4, "Scenarios"


class ArrivalModel(Protocol):
    """What every arrival model offers."""

    name: ClassVar[str]

    def __call__(self, last: Observation, target_mm: float) -> Array:
        """Return the predicted time of arrival at ``x = target_mm`` in s."""
        ...

    def calibrated(self, last: Observation, arrival: Reference, target_mm: float) -> Self:
        """Return the model with its parameter taken from particles seen to arrive."""
        ...


def time_to_cover(distance: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the smallest positive time at which Eq. 5 has covered the distance.

    Solves ``distance = velocity t + acceleration t^2 / 2`` (Eq. 6) by
    ``t = 2 distance / (velocity + sqrt(velocity^2 + 2 acceleration distance))``, which
    holds for zero acceleration too and does not cancel. NaN where there is no root.

    Parameters
    ----------
    distance, velocity, acceleration
        (n,) in mm, mm/s, mm/s^2; the distance is positive.
    """
    inside = velocity**2 + 2 * acceleration * distance
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(inside)
        time = 2 * distance / (velocity + root)
    return np.where((inside >= 0) & (velocity + root > 0), time, np.nan)


def _remaining(last: Observation, target_mm: float) -> tuple[Array, Array, Array, Array]:
    """Return time, remaining distance, velocity and acceleration of the last observation."""
    table = checked_last(last)
    check_finite(target_mm, "target_mm")
    distance = target_mm - table.x
    if (distance <= 0).any():
        who = table.particle[int(np.argmax(distance <= 0))]
        raise InputError(
            f"particle {who} was last observed at or beyond the target x = {target_mm} mm; "
            "predict to a place downstream of the last observation."
        )
    return table.time_s, distance, table.velocity_x_mm_s, table.acceleration_x_mm_s2


def _calibration_time(last: Observation, arrival: Reference, model: str) -> Array:
    """Return the true arrival times of the calibration particles, checked to belong to them."""
    seen, table = checked_last(last), checked_arrival(arrival)
    if len(table.particle) == 0 or not np.array_equal(table.particle, seen.particle):
        raise InputError(
            f"{model}: calibration needs at least one particle, and the same particles in the "
            f"same order in both tables; got {len(seen.particle)} and {len(table.particle)}."
        )
    time = table.time_s
    if (time <= seen.time_s).any():
        who = table.particle[int(np.argmax(time <= seen.time_s))]
        raise InputError(
            f"{model}: particle {who} arrives before it was last observed; check both tables."
        )
    return time


def _needs_calibration(value: float | None, model: str) -> float:
    if value is None:
        raise InputError(f"{model} is not calibrated; call {model}().calibrated(...) first.")
    return value


@dataclass(frozen=True)
class IV:
    """Identical velocity: every particle covers the rest with one velocity (Eq. 1)."""

    velocity_mm_s: float | None = None  # median over the prediction phase (sec. 5)
    name: ClassVar[str] = "IV"

    def __post_init__(self) -> None:
        """Refuse a velocity that never arrives."""
        if self.velocity_mm_s is not None:
            check_positive(self.velocity_mm_s, "IV: velocity_mm_s")

    def __call__(self, last: Observation, target_mm: float) -> Array:
        """Return the predicted time of arrival in s."""
        time, distance, _, _ = _remaining(last, target_mm)
        return time + distance / _needs_calibration(self.velocity_mm_s, self.name)

    def calibrated(self, last: Observation, arrival: Reference, target_mm: float) -> Self:
        """Take the median of the particles' mean velocities in the prediction phase."""
        reference = _calibration_time(last, arrival, self.name)
        time, distance, _, _ = _remaining(last, target_mm)
        return replace(self, velocity_mm_s=float(np.median(distance / (reference - time))))


@dataclass(frozen=True)
class CV:
    """Constant velocity: the particle keeps its last velocity (Eq. 3)."""

    name: ClassVar[str] = "CV"

    def __call__(self, last: Observation, target_mm: float) -> Array:
        """Return the predicted time of arrival in s."""
        time, distance, velocity, _ = _remaining(last, target_mm)
        return time + time_to_cover(distance, velocity, np.zeros_like(velocity))

    def calibrated(self, last: Observation, arrival: Reference, target_mm: float) -> Self:
        """Return itself; the model has no parameter."""
        return self


@dataclass(frozen=True)
class CVBC:
    """Constant velocity, its bias corrected by the median error of calibration particles."""

    bias_s: float | None = None  # t_BC: median of true minus CV time
    name: ClassVar[str] = "CVBC"

    def __call__(self, last: Observation, target_mm: float) -> Array:
        """Return the predicted time of arrival in s."""
        return CV()(last, target_mm) + _needs_calibration(self.bias_s, self.name)

    def calibrated(self, last: Observation, arrival: Reference, target_mm: float) -> Self:
        """Take the median of true minus predicted time; particles CV never brings are left out."""
        error = _calibration_time(last, arrival, self.name) - CV()(last, target_mm)
        return replace(self, bias_s=_median(error, self.name))


@dataclass(frozen=True)
class CA:
    """Constant acceleration: the particle keeps its last acceleration (Eqs 5 and 6)."""

    name: ClassVar[str] = "CA"

    def __call__(self, last: Observation, target_mm: float) -> Array:
        """Return the predicted time of arrival in s; NaN where Eq. 6 has no positive root."""
        time, distance, velocity, acceleration = _remaining(last, target_mm)
        return time + time_to_cover(distance, velocity, acceleration)

    def calibrated(self, last: Observation, arrival: Reference, target_mm: float) -> Self:
        """Return itself; the model has no parameter."""
        return self


@dataclass(frozen=True)
class CALV:
    """Constant acceleration up to a limit of the velocity, constant velocity from there.

    The paper's printed condition for "the limit is not reached before the target" has a
    sign reversed (figures/errata.csv); here the limit counts as reached when the distance
    covered until then is below the remaining distance. A particle that is already faster
    than the limit keeps its CA prediction if it slows down, and its velocity if it does
    not: the limit is meant for acceleration beyond the belt's velocity (footnote 3).
    """

    limit_mm_s: float = BELT_VELOCITY_MM_S  # the belt's velocity
    name: ClassVar[str] = "CALV"

    def __post_init__(self) -> None:
        """Refuse a limit that is not a velocity."""
        check_positive(self.limit_mm_s, "CALV: limit_mm_s")

    def __call__(self, last: Observation, target_mm: float) -> Array:
        """Return the predicted time of arrival in s; NaN where Eq. 6 has no positive root."""
        time, distance, velocity, acceleration = _remaining(last, target_mm)
        limit = np.maximum(self.limit_mm_s, velocity)
        gains = acceleration > 0
        # An acceleration next to nothing takes for ever: infinite, and so never limited.
        with np.errstate(over="ignore", invalid="ignore"):
            until = np.divide(limit - velocity, acceleration, out=np.zeros_like(time), where=gains)
            covered = until * (limit + velocity) / 2
            limited = until + (distance - covered) / limit
        free = time_to_cover(distance, velocity, acceleration)
        return time + np.where(gains & (covered < distance), limited, free)

    def calibrated(self, last: Observation, arrival: Reference, target_mm: float) -> Self:
        """Return itself; the limit is known, not learnt."""
        return self


@dataclass(frozen=True)
class IA:
    """Identical acceleration: own velocity, one acceleration for all particles."""

    acceleration_mm_s2: float | None = None  # median of the optimal ones
    name: ClassVar[str] = "IA"

    def __call__(self, last: Observation, target_mm: float) -> Array:
        """Return the predicted time of arrival in s; NaN where Eq. 6 has no positive root."""
        time, distance, velocity, _ = _remaining(last, target_mm)
        shared = np.full_like(velocity, _needs_calibration(self.acceleration_mm_s2, self.name))
        return time + time_to_cover(distance, velocity, shared)

    def calibrated(self, last: Observation, arrival: Reference, target_mm: float) -> Self:
        """Take the median of the accelerations that would have predicted exactly."""
        reference = _calibration_time(last, arrival, self.name)
        time, distance, velocity, _ = _remaining(last, target_mm)
        duration = reference - time
        optimal = 2 * (distance - velocity * duration) / duration**2
        return replace(self, acceleration_mm_s2=float(np.median(optimal)))


def _median(values: Array, model: str) -> float:
    known = values[np.isfinite(values)]
    if not len(known):
        raise InputError(f"{model}: no calibration particle can be used; take others or more.")
    return float(np.median(known))
