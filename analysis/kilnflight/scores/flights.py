"""Outcomes of many flights: the medians and shares of section 5.3.

The input is arrays with one entry per particle, true or measured. Distances are in
depth from the lance.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy  # stats on first use: they take a quarter of a second
from pandas import Series

from kilnflight.arrays import Array, Flags, Index

MARKS_M = (1, 2, 3, 4, 5)  # depths from the lance that flights pass (sec. 5.3.1)
LAST_SHARE = 0.03  # least share of the particles that pass the last metre
# Kinds of outcomes. A number has no interval.
MEDIAN = "median"
SHARE = "share"
NUMBER = "number"


class FlightValues(NamedTuple):
    """Values of n flights, k of which are complete.

    NaN stands for what did not happen. A dwell time ends "by landing or complete
    burning out" (section 5.3.1 of the thesis). Flights that are "not fully tracked"
    "cannot be analyzed" (A.1), so lost flights have none.
    """

    dwell_s: Array  # (k,): of complete flights
    velocity_m_s: Array  # (n, 5): mean within each metre (Eq. 5.8); NaN: not reached
    ignition_s: Array  # (n,): time from the lance; NaN: not ignited
    reached_m: Array  # (n,): depth travelled from the lance at the end of the flight
    lost: Flags  # (n,): whether the end was not seen


class Share(NamedTuple):
    """A share of particles, and of how many."""

    percent: float  # NaN: not known
    counted: int


@dataclass(frozen=True)
class Outcome:
    """A quantity of section 5.3, and how it is taken from many flights.

    Parameters
    ----------
    name, unit
        Such as "dwell median" and "s".
    kind
        `MEDIAN`, `SHARE` or `NUMBER`.
    take
        Returns what is behind the outcome: of a median the values (k,) with NaN, of a
        share a `Share`, else the number itself.
    """

    name: str
    unit: str
    kind: str
    take: Callable[[FlightValues], Any]

    @property
    def label(self) -> str:
        """Name and unit, a key of the published numbers (``flight.csv``)."""
        return f"{self.name} ({self.unit})"

    def estimate(self, values: FlightValues) -> float:
        """Return the outcome of flights in its unit, NaN without a value."""
        taken = self.take(values)
        if self.kind == MEDIAN:
            return Series(taken).median()
        if self.kind == SHARE:
            return taken.percent
        return float(taken)


def remaining(values: FlightValues) -> tuple[Array, Index]:
    """Return the share of particles that pass 1 ... 5 m in per cent, and their number.

    Figs 5.21 to 5.24 print these shares. A flight ends where its dwell time does. A
    lost one is censored at its last detection (Kaplan and Meier 1958).

    Returns
    -------
    share : array (5,)
        Per cent, by `MARKS_M`; NaN without particles, and beyond the farthest flight if
        that one was lost: nothing tells how far such flights go.
    counted : array (5,)
        Particles that were not lost before that mark.
    """
    passed = np.where(np.isnan(values.velocity_m_s), 0.0, MARKS_M)
    far = np.fmax(passed.max(axis=1, initial=0.0), values.reached_m)
    marks = np.array(MARKS_M) - 1e-9  # reaching a mark counts as passing it
    counted = (~values.lost[:, None] | (far[:, None] >= marks)).sum(axis=0)
    if not len(far):
        return np.nan * marks, counted
    distances = scipy.stats.CensoredData(
        uncensored=far[~values.lost], right=far[values.lost]
    )
    share = 100.0 * scipy.stats.ecdf(distances).sf.evaluate(marks)
    share[(marks > far.max()) & (share > 0.0)] = np.nan
    return share, counted


def _velocity_within(metre: int) -> Outcome:
    return Outcome(
        f"velocity {metre - 1}-{metre} m",
        "m/s",
        MEDIAN,
        lambda values: values.velocity_m_s[:, metre - 1],
    )


def _last_velocity(values: FlightValues) -> Array:
    """Return velocities in the last metre that `LAST_SHARE` of the particles pass."""
    passed = np.flatnonzero(remaining(values)[0] >= 100.0 * LAST_SHARE)
    return values.velocity_m_s[:, passed[-1:]].ravel()


def _remaining_beyond(metre: int) -> Outcome:
    def take(values: FlightValues) -> Share:
        share, counted = remaining(values)
        return Share(share[metre - 1], counted[metre - 1])

    return Outcome(f"remaining {metre} m", "%", SHARE, take)


def _share_of(flags: Flags) -> Share:
    return Share(100.0 * Series(flags).mean(), len(flags))


def _of_ignited(when: str, low: float, high: float) -> Outcome:
    """Return the share of the ignited that ignite after ``low``, up to ``high`` (s)."""

    def take(values: FlightValues) -> Share:
        times = values.ignition_s[np.isfinite(values.ignition_s)]
        return _share_of((times > low) & (times <= high))

    return Outcome(f"ignited {when} s", "% of ignited", SHARE, take)


VELOCITIES = tuple(map(_velocity_within, MARKS_M))
REMAINING = tuple(map(_remaining_beyond, MARKS_M))
DWELL = Outcome("dwell median", "s", MEDIAN, lambda values: values.dwell_s)
DWELL_SHORT = Outcome(
    "dwell 0.3-0.4 s",
    "%",
    SHARE,
    lambda values: _share_of((values.dwell_s >= 0.3) & (values.dwell_s <= 0.4)),
)
DWELL_LONG = Outcome(
    "dwell > 0.4 s", "%", SHARE, lambda values: _share_of(values.dwell_s >= 0.4)
)
IGNITED = Outcome(
    "ignited", "%", SHARE, lambda values: _share_of(np.isfinite(values.ignition_s))
)
IGNITED_EARLY = Outcome(
    "ignited < 0.1 s", "%", SHARE, lambda values: _share_of(values.ignition_s <= 0.1)
)
IGNITION = Outcome("ignition median", "s", MEDIAN, lambda values: values.ignition_s)
VELOCITY_OUTCOMES = (
    *VELOCITIES,
    Outcome("velocity last", "m/s", MEDIAN, _last_velocity),
    *REMAINING,
    Outcome("landed 1 m", "%", NUMBER, lambda values: 100.0 - remaining(values)[0][0]),
)
DWELL_OUTCOMES = (
    DWELL,
    Outcome("dwell longest", "s", NUMBER, lambda values: Series(values.dwell_s).max()),
    DWELL_SHORT,
    DWELL_LONG,
    Outcome("dwell > 1 s", "%", SHARE, lambda values: _share_of(values.dwell_s > 1.0)),
    Outcome(
        "penetration", "m", NUMBER, lambda values: Series(values.reached_m).median()
    ),
)
IGNITION_OUTCOMES = (
    IGNITED,
    IGNITED_EARLY,
    _of_ignited("< 0.1", 0.0, 0.1),
    _of_ignited("< 0.2", 0.0, 0.2),
    _of_ignited("< 0.4", 0.0, 0.4),
    _of_ignited("0.2-0.3", 0.2, 0.3),
    IGNITION,
)
OUTCOMES = VELOCITY_OUTCOMES + DWELL_OUTCOMES + IGNITION_OUTCOMES


def outcomes(values: FlightValues) -> Series:
    """Return every outcome of flights by `Outcome.label`, NaN without a value.

    Velocities are medians; "last" is the farthest metre that at least `LAST_SHARE` of
    the particles pass. Dwell times are those of complete flights. "ignited" counts all
    particles, "% of ignited" those that ignited. "penetration" is the median depth at
    the end, "landed 1 m" is 100 % minus "remaining 1 m".
    """
    found = {outcome.label: outcome.estimate(values) for outcome in OUTCOMES}
    return Series(found)
