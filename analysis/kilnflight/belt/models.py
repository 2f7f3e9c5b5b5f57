"""When and where a particle leaves the belt (2020 paper, sections 4.1 and 4.2).

An arrival model is called with the last observations (`kilnflight.tables.BELT_LAST`) and the target
in mm. It returns times in s on the clock of the observations. A lateral model is called with the
same and the time that each particle has left, in s; it returns ``y`` in mm.

Time and place are NaN where a model predicts no arrival. That is a particle whose acceleration
stops it before the target: Eq. 6 has no positive root.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError, check_finite, check_positive, check_shape
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST, Table

Array = npt.NDArray[np.float64]

BELT_VELOCITY_MM_S = 1500.0  # 2020 paper, section 4, "Scenarios"
BELT_START_MM = 388.0  # along the belt, in the coordinates of the authors' files of 2020
BELT_EDGE_MM = 788.0  # "a total length of 40 cm", 2016, section IV
BELT_WIDTH_MM = 180.0  # 2020, section 3


Columns = dict[str, Array]  # of a table, (n,) each, checked
TableOrColumns = pd.DataFrame | Columns


def checked(table: TableOrColumns, kind: Table) -> Columns:
    """Return the columns of a table, checked; columns are returned as they are.

    A check costs more than a model, so an evaluation of many models does it once.
    """
    if not isinstance(table, pd.DataFrame):
        return table
    table = kind.check(table)
    return {name: table[name].to_numpy() for name in kind.names}


def select(columns: Columns, which: npt.NDArray[Any]) -> Columns:
    """Return the particles that ``which`` (n,) marks."""
    return {name: values[which] for name, values in columns.items()}


def time_to_cover(distance: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the smallest positive time at which Eq. 5 has covered the distance.

    Solves ``distance = velocity t + acceleration t^2 / 2`` (Eq. 6) by
    ``t = 2 distance / (velocity + sqrt(velocity^2 + 2 acceleration distance))``. This holds for
    zero acceleration, too, and does not cancel. NaN where there is no root.

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


@dataclass(frozen=True)
class _Model:
    """Name and calibration of a model; its parameter is NaN until it is calibrated."""

    @property
    def name(self) -> str:
        """Its name in the paper."""
        return type(self).__name__.removeprefix("Lateral")

    def _check_calibrated(self) -> None:
        if any(np.isnan(value) for value in vars(self).values()):
            raise InputError(
                f"{self.name} is not calibrated; call {self.name}().calibrated(...) first."
            )

    def _checked_pair(
        self, last: TableOrColumns, arrival: TableOrColumns
    ) -> tuple[Columns, Columns]:
        """Return both tables of the calibration particles, checked to belong together."""
        before, after = checked(last, BELT_LAST), checked(arrival, BELT_ARRIVAL)
        names, others = before["particle"], after["particle"]
        if not len(others) or not np.array_equal(names, others):
            raise InputError(
                f"{self.name}: calibration needs at least one particle, and the same particles in "
                f"the same order in both tables; got {len(names)} and {len(others)}."
            )
        return before, after


class ArrivalModel(_Model, ABC):
    """A model of when a particle reaches a place."""

    def __call__(self, last: TableOrColumns, target_mm: float) -> Array:
        """Return the predicted time of arrival at ``x = target_mm`` in s, (n,).

        Raises
        ------
        InputError
            If the model is not calibrated, or a particle is at or beyond the target.
        """
        self._check_calibrated()
        table = checked(last, BELT_LAST)
        velocity, acceleration = table["velocity_x_mm_s"], table["acceleration_x_mm_s2"]
        distance = _distance(table, target_mm)
        return table["time_s"] + self._duration(distance, velocity, acceleration)

    def calibrated(self, last: TableOrColumns, arrival: TableOrColumns, target_mm: float) -> Self:
        """Return the model with its parameter from particles with observed arrival."""
        before, after = self._checked_pair(last, arrival)
        duration = after["time_s"] - before["time_s"]
        if (duration <= 0).any():
            particle = after["particle"][int(np.argmax(duration <= 0))]
            raise InputError(
                f"{self.name}: particle {particle} arrives before it was last observed; check both "
                "tables."
            )
        distance = _distance(before, target_mm)
        return self._fitted(distance, before["velocity_x_mm_s"], duration)

    @abstractmethod
    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the time that the remaining distance (mm) takes, in s."""

    def _fitted(self, distance: Array, velocity: Array, duration: Array) -> Self:
        """Return the model fitted to particles of known duration (s)."""
        return self


def _distance(last: Columns, target_mm: float) -> Array:
    check_finite(target_mm, "target_mm")
    distance = target_mm - last["x"]
    if (distance <= 0).any():
        particle = last["particle"][int(np.argmax(distance <= 0))]
        raise InputError(
            f"particle {particle} was last observed at or beyond the target x = {target_mm} mm; "
            "predict to a place downstream of the last observation."
        )
    return distance


@dataclass(frozen=True)
class ID(ArrivalModel):
    """Identical delay: ``t_Last + t_Avg`` for every particle (sec. 4.1, no number).

    The old, implicit model. It takes all particles as last observed at one place; then it is `IV`.
    Section 5 leaves it out, so it is none of `kilnflight.belt.ARRIVAL_MODELS`.
    """

    delay_s: float = np.nan  # t_Avg: a median, as the average velocity of IV (sec. 5)

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        return np.full_like(distance, self.delay_s)

    def _fitted(self, distance: Array, velocity: Array, duration: Array) -> Self:
        return replace(self, delay_s=float(np.median(duration)))


@dataclass(frozen=True)
class IV(ArrivalModel):
    """Identical velocity: every particle covers the rest with one velocity (Eq. 1)."""

    velocity_mm_s: float = np.nan  # median over the prediction phase (sec. 5)

    def __post_init__(self) -> None:
        """Refuse a velocity that never arrives."""
        if not (isinstance(self.velocity_mm_s, float) and np.isnan(self.velocity_mm_s)):
            check_positive(self.velocity_mm_s, "IV: velocity_mm_s")

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        return distance / self.velocity_mm_s

    def _fitted(self, distance: Array, velocity: Array, duration: Array) -> Self:
        return replace(self, velocity_mm_s=float(np.median(distance / duration)))


@dataclass(frozen=True)
class CV(ArrivalModel):
    """Constant velocity: the particle keeps its last velocity (Eq. 3)."""

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        return time_to_cover(distance, velocity, np.zeros_like(velocity))


@dataclass(frozen=True)
class CVBC(CV):
    """Constant velocity, bias-corrected by calibration particles' median error."""

    bias_s: float = np.nan  # t_BC: median of true minus CV time

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        return super()._duration(distance, velocity, acceleration) + self.bias_s

    def _fitted(self, distance: Array, velocity: Array, duration: Array) -> Self:
        error = duration - super()._duration(distance, velocity, velocity)
        if np.isnan(error).all():
            raise InputError(f"{self.name}: no calibration particle can be used; take others.")
        return replace(self, bias_s=float(np.nanmedian(error)))  # NaN: no arrival by CV


@dataclass(frozen=True)
class CA(ArrivalModel):
    """Constant acceleration: the particle keeps its last acceleration (Eqs 5 and 6)."""

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        return time_to_cover(distance, velocity, acceleration)


@dataclass(frozen=True)
class CALV(ArrivalModel):
    """Constant acceleration up to a limit of the velocity, then constant velocity.

    The paper's printed condition for "the limit is not reached before the target" has a sign
    reversed (figures/errata.csv). Here the limit counts as reached when the distance covered until
    then is below the remaining distance. A particle above the limit keeps its CA prediction if it
    slows down, else its velocity: the limit is for acceleration beyond the belt's velocity
    (footnote 3).
    """

    limit_mm_s: float = BELT_VELOCITY_MM_S  # the belt's velocity: known, not calibrated

    def __post_init__(self) -> None:
        """Refuse a limit that is not a velocity."""
        check_positive(self.limit_mm_s, "CALV: limit_mm_s")

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        limit = np.maximum(self.limit_mm_s, velocity)
        gains = acceleration > 0
        # An acceleration next to nothing takes for ever: infinite, and so never limited.
        with np.errstate(over="ignore", invalid="ignore"):
            until = np.divide(
                limit - velocity, acceleration, out=np.zeros_like(distance), where=gains
            )
            covered = until * (limit + velocity) / 2
            limited = until + (distance - covered) / limit
        free = time_to_cover(distance, velocity, acceleration)
        return np.where(gains & (covered < distance), limited, free)


@dataclass(frozen=True)
class IA(ArrivalModel):
    """Identical acceleration: own velocity, one acceleration for all particles."""

    acceleration_mm_s2: float = np.nan  # median of the optimal ones

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        shared = np.full_like(velocity, self.acceleration_mm_s2)
        return time_to_cover(distance, velocity, shared)

    def _fitted(self, distance: Array, velocity: Array, duration: Array) -> Self:
        optimal = 2 * (distance - velocity * duration) / duration**2  # would predict exactly
        return replace(self, acceleration_mm_s2=float(np.median(optimal)))


class LateralModel(_Model, ABC):
    """A model of where across the belt a particle arrives."""

    def __call__(self, last: TableOrColumns, remaining_s: Array) -> Array:
        """Return the lateral position in mm, ``remaining_s`` after the last observation.

        ``remaining_s`` is (n,).
        """
        self._check_calibrated()
        table = checked(last, BELT_LAST)
        if not isinstance(remaining_s, np.ndarray) or (remaining_s < 0).any():
            raise InputError("remaining_s: pass an array of times in s, none of them below 0.")
        check_shape(remaining_s, (len(table["y"]),), "remaining_s (one per particle)")
        velocity, acceleration = table["velocity_y_mm_s"], table["acceleration_y_mm_s2"]
        return table["y"] + self._way(remaining_s, velocity, acceleration)

    def calibrated(self, last: TableOrColumns, arrival: TableOrColumns) -> Self:
        """Return the model with its parameter from particles with observed arrival."""
        before, after = self._checked_pair(last, arrival)
        return self._fitted(before["velocity_y_mm_s"], after["velocity_y_mm_s"])

    @abstractmethod
    def _way(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        """Return how far a particle moves across the belt in ``time``, in mm."""

    def _fitted(self, before: Array, after: Array) -> Self:
        """Return the model fitted to lateral velocities before and after the phase."""
        return self


@dataclass(frozen=True)
class Straight(LateralModel):
    """No lateral movement, as a line-scan sorter assumes."""

    def _way(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        return np.zeros_like(velocity)


@dataclass(frozen=True)
class LateralCV(LateralModel):
    """Constant lateral velocity."""

    def _way(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        return time * velocity


@dataclass(frozen=True)
class LateralCA(LateralModel):
    """Constant lateral acceleration (Eq. 7)."""

    def _way(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        return time * velocity + time**2 * acceleration / 2


@dataclass(frozen=True)
class CADSC(LateralCA):
    """Constant acceleration, sign changes disallowed.

    A particle that has stopped stays.
    """

    def _way(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        stops = np.full_like(velocity, np.inf)
        with np.errstate(over="ignore"):  # a deceleration next to nothing never stops
            np.divide(-velocity, acceleration, out=stops, where=velocity * acceleration < 0)
        return super()._way(np.minimum(time, stops), velocity, acceleration)


@dataclass(frozen=True)
class Ratio(LateralModel):
    """One share of the lateral velocity stays, lost at a constant rate on the way."""

    share: float = np.nan  # r: median of arrival velocity over last velocity

    def _way(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        # The acceleration is -(1 - r) velocity / time; half of it times time squared:
        return time * velocity * (1 + self.share) / 2

    def _fitted(self, before: Array, after: Array) -> Self:
        moves = before != 0
        if not moves.any():
            raise InputError("Ratio: no calibration particle moves across the belt; take others.")
        return replace(self, share=float(np.median(after[moves] / before[moves])))
