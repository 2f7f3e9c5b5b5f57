"""Predict when and where a particle leaves the belt (2020 paper, sections 4.1, 4.2).

An arrival model returns times in s on the clock of the observations. A lateral model
takes the time between last observation and arrival and returns ``y`` in mm.
Observations are columns of `kilnflight.tables.BELT_LAST`: a table, or arrays (n,) by
name.

The time is NaN where a model predicts no arrival: the acceleration stops the particle
before the target, so Eq. 6 has no positive root. So is the place, except that of
`Straight`.

A `Predictor` is one of each, with standard deviations. The filter's variance of a state
is carried on to the valves at constant velocity. Its noise is that of particles that
land, so it is too large for those that slide: the calibration gives the factor.

Examples
--------
>>> last = {"time_s": [0.5], "x": [638.0], "velocity_x_mm_s": [1200.0]}
>>> last |= {"acceleration_x_mm_s2": [800.0]}
>>> [(model.name, model(last, 788.0).round(4)) for model in (CV(), CA(), CALV())]
[('CV', array([0.625])), ('CA', array([0.6202])), ('CALV', array([0.6202]))]
>>> [model.name for model in ARRIVAL_MODELS]
['IV', 'CV', 'CVBC', 'CA', 'CALV', 'IA']
>>> [model.name for model in LATERAL_MODELS]
['Straight', 'CV', 'CA', 'CADSC', 'Ratio']
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self

import numpy as np
from pandas import DataFrame

from kilnflight.arrays import Anything, Array, Named
from kilnflight.checks import (
    InputError,
    NotNegative,
    Number,
    Positive,
    Settings,
    check_finite,
    check_number,
)

BELT_VELOCITY_MM_S = 1500.0  # 2020 paper, section 4, "Scenarios"
BELT_START_MM = 388.0  # along the belt, in the authors' files of 2020
BELT_EDGE_MM = 788.0  # "a total length of 40 cm", 2016, section IV
BELT_WIDTH_MM = 180.0  # 2020, section 3
# Variance of a coordinate, covariance with its velocity, variance of the velocity.
SPREADS = ("variance_mm2", "covariance_mm2_s", "variance_mm2_s2")
MOST_S = 1.0  # longest prediction: 10 cm at 100 mm/s; choice
OF_95_PERCENT = 1.96  # standard deviations to each side, if they are normal

Columns = DataFrame | Mapping[str, Any]  # arrays (n,) by name


def time_to_cover(
    distance: Array, velocity: Array, acceleration: Array | float
) -> Array:
    """Return the time in s, (n,), to cover a distance at constant acceleration.

    It is the smallest positive one. Solves ``distance = velocity t + acceleration t^2 /
    2`` (Eq. 6) by ``t = 2 distance / (velocity + sqrt(velocity^2 + 2 acceleration
    distance))``. This form also holds for zero acceleration, and does not cancel. NaN
    where there is no root.

    Parameters
    ----------
    distance, velocity, acceleration
        (n,) in mm, mm/s, mm/s^2; the distance is positive. One acceleration may be
        that of all.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        total = velocity + np.sqrt(velocity**2 + 2 * acceleration * distance)
        return np.where(total > 0, 2 * distance / total, np.nan)


class _Model(Settings):
    """A model whose parameter, if it has one to calibrate, is NaN until then."""

    @property
    def name(self) -> str:
        """Its name in the paper."""
        return type(self).__name__.removeprefix("Lateral")

    def check_calibrated(self) -> None:
        """Raise an `InputError` if a parameter is to be calibrated first."""
        if any(np.isnan(value) for value in vars(self).values()):
            raise InputError(
                f"{self.name} is not calibrated; call its calibrated(...) first."
            )

    def _check_pairs(self, last: Columns, arrival: Columns) -> None:
        """Raise an `InputError` unless both have the same particles, in one order."""
        (particle,) = _take(last, "last", "particle")
        (arrived,) = _take(arrival, "arrival", "particle")
        if not len(particle) or not np.array_equal(particle, arrived):
            raise InputError(
                f"{self.name}: arrival must have the particles of last, at least one."
            )


def _take(columns: Columns, where: str, *names: str) -> list[Array]:
    """Return the named columns (n,), checked to be finite numbers."""
    for name in names:
        if not hasattr(columns, "keys") or name not in columns:
            raise InputError(f"{where}: it has no column {name}. Add it.")
    return [check_finite(columns[name], f"{where}: {name}", (None,)) for name in names]


class ArrivalModel(_Model, ABC):
    """A model of when a particle reaches a place along the belt (2020, sec. 4.1)."""

    def __call__(self, last: Columns, target_mm: float) -> Array:
        """Return the predicted time of arrival at ``x = target_mm`` in s, (n,).

        It is on the clock of the observations, and NaN where no arrival is predicted.

        Parameters
        ----------
        last
            Columns of `kilnflight.tables.BELT_LAST`.
        target_mm
            Downstream of all last observations.

        Raises
        ------
        InputError
            If the model is not calibrated, a number is not finite, or a particle is at
            or beyond the target.
        """
        self.check_calibrated()
        time, *rest = _rest_of_belt(last, target_mm)
        return time + self._duration(*rest)

    def calibrated(self, last: Columns, arrival: Columns, target_mm: float) -> Self:
        """Return the model with its parameter from particles with observed arrival.

        Parameters
        ----------
        last
            Columns of `kilnflight.tables.BELT_LAST`.
        arrival
            Columns of `kilnflight.tables.BELT_ARRIVAL` for the same particles in the
            same order.
        target_mm
            The place x of the arrivals, downstream of all last observations.

        Raises
        ------
        InputError
            If the particles differ, a number is not finite, or an arrival is not after
            the last observation.
        """
        self._check_pairs(last, arrival)
        time, distance, velocity, _ = _rest_of_belt(last, target_mm)
        (arrived,) = _take(arrival, "arrival", "time_s")
        duration = arrived - time
        if (duration <= 0).any():
            row = np.argmax(duration <= 0)
            raise InputError(f"arrival: time_s in row {row} is not after that of last.")
        return self._fitted(distance, velocity, duration)

    @abstractmethod
    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the time (n,) in s for the distance in mm that is left to the target.

        Velocity (mm/s) and acceleration (mm/s^2), (n,) each, are the last ones along
        the belt.
        """

    def _fitted(self, distance: Array, velocity: Array, duration: Array) -> Self:
        """Return the model fitted to n calibration particles, if it has a parameter.

        They have (n,) distances to the target (mm), last velocities (mm/s) and times to
        it (s).
        """
        return self


def _rest_of_belt(last: Columns, target_mm: float) -> list[Array]:
    """Return time, distance to the target, velocity and acceleration, (n,) each.

    Units are s, mm, mm/s and mm/s^2; all are those of the last observation, along the
    belt.
    """
    check_number(target_mm, "target_mm")
    names = ("time_s", "x", "velocity_x_mm_s", "acceleration_x_mm_s2")
    time, x, velocity, acceleration = _take(last, "last", *names)
    distance = target_mm - x
    if (distance <= 0).any():
        row = np.argmax(distance <= 0)
        raise InputError(
            f"target_mm: {target_mm} mm is not beyond x of last in row {row}."
        )
    return [time, distance, velocity, acceleration]


class IV(ArrivalModel):
    """Identical velocity: one for the remaining distance of all particles (Eq. 1).

    Parameters
    ----------
    velocity_mm_s
        Median over the prediction phase (sec. 5), from `calibrated`.
    """

    velocity_mm_s: Positive = np.nan

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        return distance / self.velocity_mm_s

    def _fitted(self, distance: Array, velocity: Array, duration: Array) -> Self:
        return replace(self, velocity_mm_s=float(np.median(distance / duration)))


class CV(ArrivalModel):
    """Constant velocity: the particle keeps its last velocity (Eq. 3)."""

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        return time_to_cover(distance, velocity, acceleration=0.0)


class CVBC(CV):
    """Constant velocity with a correction of its bias (Eq. 3, sec. 4.1).

    Parameters
    ----------
    bias_s
        t_BC, the median of true minus CV time over the particles of `calibrated`.
        Those for which CV predicts no arrival are left out.
    """

    bias_s: Number = np.nan

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        return super()._duration(distance, velocity, acceleration) + self.bias_s

    def _fitted(self, distance: Array, velocity: Array, duration: Array) -> Self:
        error = duration - super()._duration(distance, velocity, velocity)
        if np.isnan(error).all():
            raise InputError(
                "CVBC: no calibration particle in last moves on; take others."
            )
        return replace(self, bias_s=float(np.nanmedian(error)))


class CA(ArrivalModel):
    """Constant acceleration: the particle keeps its last acceleration (Eqs 5 and 6)."""

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        return time_to_cover(distance, velocity, acceleration)


class CALV(ArrivalModel):
    """Constant acceleration up to a limit of the velocity, then constant velocity.

    Parameters
    ----------
    limit_mm_s
        The belt's velocity: known, not calibrated (sec. 4).

    Notes
    -----
    The paper's printed condition for "the limit is not reached before the target" has a
    sign reversed (figures/errata.csv). Here the limit counts as reached if the distance
    covered until then is below the remaining distance. Above the limit a particle keeps
    its CA prediction if it slows down, else its velocity (footnote 3: the limit is for
    acceleration beyond the belt's velocity).
    """

    limit_mm_s: Positive = BELT_VELOCITY_MM_S

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        limit = np.maximum(self.limit_mm_s, velocity)
        gains = acceleration > 0
        # Next to no acceleration takes an infinite time, so it is never limited.
        with np.errstate(all="ignore"):
            until = (limit - velocity) / acceleration
            covered = until * (limit + velocity) / 2
            limited = until + (distance - covered) / limit
        free = time_to_cover(distance, velocity, acceleration)
        return np.where(gains & (covered < distance), limited, free)


class IA(ArrivalModel):
    """Identical acceleration: one for all particles, each with its velocity (Eq. 5).

    Parameters
    ----------
    acceleration_mm_s2
        Median of those that would have predicted the particles of `calibrated` exactly.
    """

    acceleration_mm_s2: Number = np.nan

    def _duration(self, distance: Array, velocity: Array, acceleration: Array) -> Array:
        return time_to_cover(distance, velocity, self.acceleration_mm_s2)

    def _fitted(self, distance: Array, velocity: Array, duration: Array) -> Self:
        optimal = 2 * (distance - velocity * duration) / duration**2
        return replace(self, acceleration_mm_s2=float(np.median(optimal)))


class LateralModel(_Model, ABC):
    """A model of where across the belt a particle arrives (2020, sec. 4.2)."""

    def __call__(self, last: Columns, remaining_s: Array) -> Array:
        """Return the predicted lateral position of arrival in mm, (n,).

        Parameters
        ----------
        last
            Columns of `kilnflight.tables.BELT_LAST`.
        remaining_s
            (n,) predicted times in s from the last observation to the arrival; NaN:
            none predicted.

        Raises
        ------
        InputError
            If the model is not calibrated, a number is not finite, or a time is below 0
            or not one for each particle.
        """
        self.check_calibrated()
        names = ("y", "velocity_y_mm_s", "acceleration_y_mm_s2")
        y, velocity, acceleration = _take(last, "last", *names)
        time = check_finite(remaining_s, "remaining_s", y.shape, gaps=True, most=np.inf)
        check_number(np.fmin.reduce(time, initial=0.0), "remaining_s", least=0)
        return y + self._displacement(time, velocity, acceleration)

    def calibrated(self, last: Columns, arrival: Columns) -> Self:
        """Return the model with its parameter from particles with observed arrival.

        Parameters
        ----------
        last
            Columns of `kilnflight.tables.BELT_LAST`.
        arrival
            Columns of `kilnflight.tables.BELT_ARRIVAL` for the same particles in the
            same order.
        """
        self._check_pairs(last, arrival)
        (before,) = _take(last, "last", "velocity_y_mm_s")
        (after,) = _take(arrival, "arrival", "velocity_y_mm_s")
        return self._fitted(before, after)

    @abstractmethod
    def _displacement(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the displacement across the belt (n,) in mm.

        It takes ``time`` (s); velocity (mm/s) and acceleration (mm/s^2) are the last
        ones across the belt, (n,) each.
        """

    def _fitted(self, before: Array, after: Array) -> Self:
        """Return the model fitted to n calibration particles, if it has a parameter.

        Lateral velocities (n,) in mm/s are those of the last observation and of the
        arrival.
        """
        return self


class Straight(LateralModel):
    """No lateral movement, as a line-scan sorter assumes."""

    def _displacement(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        return np.zeros_like(velocity)


class LateralCV(LateralModel):
    """Constant lateral velocity."""

    def _displacement(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        return time * velocity


class LateralCA(LateralModel):
    """Constant lateral acceleration (Eq. 7)."""

    def _displacement(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        return time * velocity + time**2 * acceleration / 2


class CADSC(LateralCA):
    """Constant acceleration without sign changes (Eq. 7, sec. 4.2).

    The lateral velocity keeps its sign: a particle that has stopped across the belt
    stays.
    """

    def _displacement(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        slows = velocity * acceleration < 0
        with np.errstate(all="ignore"):  # next to no deceleration never stops
            stops = np.where(slows, -velocity / acceleration, np.inf)
        return super()._displacement(np.minimum(time, stops), velocity, acceleration)


class Ratio(LateralModel):
    """One share of the lateral velocity stays; the rest is lost at a constant rate.

    Acceleration of Eq. 7: -(1 - share) times the last velocity, by the time to the
    arrival. So the model needs no acceleration of the particle's own.

    Parameters
    ----------
    share
        r, the median of arrival velocity over last velocity, from `calibrated`.
    """

    share: Number = np.nan

    def _displacement(self, time: Array, velocity: Array, acceleration: Array) -> Array:
        # The acceleration is -(1 - r) velocity / time; half of it times time squared:
        return time * velocity * (1 + self.share) / 2

    def _fitted(self, before: Array, after: Array) -> Self:
        moves = before != 0
        if not moves.any():
            raise InputError(
                "Ratio: no calibration particle in last moves across; take others."
            )
        return replace(self, share=float(np.median(after[moves] / before[moves])))


ARRIVAL_MODELS: tuple[ArrivalModel, ...] = (IV(), CV(), CVBC(), CA(), CALV(), IA())
LATERAL_MODELS: tuple[LateralModel, ...] = (
    Straight(),
    LateralCV(),
    LateralCA(),
    CADSC(),
    Ratio(),
)
# The seven combinations of Fig. 10: name on the axis, arrival model, lateral model.
COMBINATIONS: tuple[tuple[str, ArrivalModel, LateralModel], ...] = (
    ("Straight", CV(), Straight()),
    ("CV-CV", CV(), LateralCV()),
    ("CA-CA", CA(), LateralCA()),
    ("LV-DSC", CALV(), CADSC()),
    ("IA-CV", IA(), LateralCV()),
    ("IA-CA", IA(), LateralCA()),
    ("IA-Ratio", IA(), Ratio()),
)


class Predictor(Settings):
    """Predict arrivals at the valves, from states of tracks.

    Parameters
    ----------
    arrival, lateral
        Models of time and place.
    target_mm
        Place x of the valves.
    time_factor, y_factor
        Standard deviations of time and place by those of the filter, from
        `calibrated`: 1.96 of them hold 95 % of its particles.

    Examples
    --------
    >>> last = {"particle": [7], "time_s": [0.5], "x": [638.0], "y": [90.0]}
    >>> last |= {"velocity_x_mm_s": [1500.0], "velocity_y_mm_s": [0.0]}
    >>> last |= {"acceleration_x_mm_s2": [0.0], "acceleration_y_mm_s2": [0.0]}
    >>> Predictor()(last)["time_s"]
    array([0.6])
    """

    arrival: ArrivalModel = CV()
    lateral: LateralModel = LateralCV()
    target_mm: Number = BELT_EDGE_MM
    time_factor: NotNegative = 1.0
    y_factor: NotNegative = 1.0

    def __call__(self, last: Columns) -> Named:
        """Return when and where particles pass the valves.

        Parameters
        ----------
        last
            Columns of `kilnflight.tables.BELT_LAST`, and `SPREADS` of the filter.
            Without these the variance of each place is 1 mm^2.

        Returns
        -------
        dict
            Columns of `kilnflight.tables.BELT_PREDICTED`, (n,) each, and ``time_sd_s``,
            ``y_sd_mm``. The time is NaN where a model predicts no arrival, one before
            the last observation, or one after `MOST_S`. So is the place, except that
            of `Straight`.
        """
        time = self.arrival(last, self.target_mm)
        seen = np.asarray(last["time_s"])
        time = np.where((time >= seen) & (time - seen <= MOST_S), time, np.nan)
        wait = time - seen
        variance: Anything = np.ones(len(time))
        if SPREADS[0] in last:
            place, both, speed = (np.asarray(last[name]) for name in SPREADS)
            variance = place + 2 * wait * both + wait**2 * speed
        mean = (self.target_mm - np.asarray(last["x"])) / wait  # velocity
        time_sd = self.time_factor * np.sqrt(variance) / mean
        y_variance = self.y_factor**2 * variance
        y_variance += (np.asarray(last["velocity_y_mm_s"]) * time_sd) ** 2
        return {
            "particle": np.asarray(last["particle"]),
            "time_s": time,
            "y": self.lateral(last, wait),
            "time_sd_s": time_sd,
            "y_sd_mm": np.sqrt(y_variance),
        }

    def calibrated(self, last: Columns, arrival: Columns) -> Self:
        """Return the predictor with models and factors of observed particles.

        Parameters
        ----------
        last
            As for a prediction; 40 particles are enough.
        arrival
            Columns of `kilnflight.tables.BELT_ARRIVAL` for the same particles in the
            same order.
        """
        fitted = replace(
            self,
            arrival=self.arrival.calibrated(last, arrival, self.target_mm),
            lateral=self.lateral.calibrated(last, arrival),
            time_factor=1.0,
            y_factor=1.0,
        )
        known = fitted(last)
        factors = []
        for column, deviation in (("time_s", "time_sd_s"), ("y", "y_sd_mm")):
            off = (known[column] - np.asarray(arrival[column])) / known[deviation]
            # Of n + 1 equal parts, so that 95 % of other particles are expected within.
            most = np.nanquantile(np.abs(off), 0.95, method="weibull")
            factors.append(float(most / OF_95_PERCENT))
        return replace(fitted, time_factor=factors[0], y_factor=factors[1])
