"""Space-sliced velocity in the depth direction (thesis, section 5.3.1, Eq. 5.8, Fig. 5.20)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import brentq

from kilnflight.checks import InputError, check_count, check_finite, check_positive
from kilnflight.tables import SLICES

Array = npt.NDArray[np.float64]

MOST = 10_000  # slices of one flight
EPSILON = 1e-14  # share of the largest term below which another one moves nothing


class Flown(Protocol):
    """A fitted trajectory, as `kilnflight.regression` makes it."""

    @property
    def exit_point_mm(self) -> npt.ArrayLike:
        """The lance's exit: x, y, z in mm."""
        ...

    @property
    def t0_s(self) -> float:
        """When it passes the exit point."""
        ...

    @property
    def t0_at_bound(self) -> int:
        """0 if t0 is inside the range of its search."""
        ...

    @property
    def first_s(self) -> float:
        """First detection."""
        ...

    @property
    def last_s(self) -> float:
        """Last detection."""
        ...

    @property
    def coefficients(self) -> Sequence[npt.ArrayLike]:
        """Per axis: of (t - t0)^1, ^2, ... in mm, s."""
        ...

    def __call__(self, t: npt.ArrayLike, /) -> Array:
        """Return the place (n, 3) in mm at times (n,) in s."""
        ...

    def velocity(self, t: npt.ArrayLike, /) -> Array:
        """Return the velocity (n, 3) in mm/s."""
        ...


def space_sliced_velocity(
    fit: Flown, slice_m: float = 1.0, until_s: float = math.inf
) -> pd.DataFrame:
    """Return the mean velocity in depth over each metre from the lance (Eq. 5.8).

    ``V_n = slice / (t_n - t_(n-1))``: t_n is when the fitted trajectory first is n slices
    from the lance towards the camera, t_0 when it leaves the lance.

    Parameters
    ----------
    fit
        A fitted trajectory.
    slice_m
        Length of a slice: 1 m, section 5.3.1.
    until_s
        End of the flight, if it comes before the last detection.

    Returns
    -------
    DataFrame
        ``slice_m``: far end of the slice; ``start_s``, ``end_s``: t_(n-1), t_n;
        ``velocity_m_s``; ``reached``; ``observed``: reached between the first and the last
        detection, and not, as the polynomials have it, before the first. One row for every slice
        between lance and camera, and one for each slice behind the lance that was reached; where
        ``reached`` is False the velocity is NaN, and the row must not be counted.

    Notes
    -----
    Readings. (1) Only the span from t_0 to the last detection counts; where a polynomial
    goes afterwards is no observation, so a slice reached only there is not reached.
    (2) "First": later returns change nothing, so V_n is positive for every slice in front of
    the lance. The thesis shows negative velocities, "reverse motions towards the lance", and
    says no more; here they are those of slices -1, -2, ... behind the lance, V_n =
    -slice / (t_n - t_(n+1)), of trajectories that go backwards from the exit point.
    (3) What the polynomials pass between t_0 and the first detection counts, as published;
    a flight first seen beyond a slice has in it the velocity that its polynomials need to get
    there from the lance, which ``observed`` tells.
    (4) The distance is the difference of depths, not the path.
    """
    forth, back, count = _both_ways(fit, slice_m, until_s)
    behind = pd.DataFrame(_rows(fit, back, -slice_m, len(back))).iloc[::-1]
    front = pd.DataFrame(_rows(fit, forth, slice_m, count))
    return pd.concat([behind, front], ignore_index=True)


def slices(
    fits: Mapping[int, Flown], ends_s: Mapping[int, float] | None = None, slice_m: float = 1.0
) -> pd.DataFrame:
    """Return the space-sliced velocities of many flights (`kilnflight.tables.SLICES`).

    Parameters
    ----------
    fits
        By particle: those that are to count.
    ends_s
        By particle: the end of its flight, where it is known.
    slice_m
        Length of a slice.

    Returns
    -------
    DataFrame
        Only slices that were reached.
    """
    parts: list[dict[str, npt.NDArray[np.generic]]] = []
    for particle, fit in fits.items():
        end = math.inf if ends_s is None else ends_s.get(particle, math.inf)
        forth, back, _ = _both_ways(fit, slice_m, end)
        for length, times in ((-slice_m, back), (slice_m, forth)):
            one = _rows(fit, times, length, len(times))
            parts.append(one | {"particle": np.full(len(times), particle)})
    if not parts:
        return SLICES.empty()
    joined = {name: np.concatenate([one[name] for one in parts]) for name in SLICES.names}
    return SLICES.check(pd.DataFrame(joined))


def remaining(sliced: pd.DataFrame, counted: int) -> pd.DataFrame:
    """Return the share of particles that reach each slice's far end (Figs 5.21 to 5.24).

    Parameters
    ----------
    sliced
        Of `slices`.
    counted
        All particles that count, also those that pass no slice.

    Returns
    -------
    DataFrame
        ``slice_m``, ``number``, ``share`` (0 of 0 is 0), ``median_m_s``. Slices behind the
        lance are rows of their own. What the tracker loses counts as not remaining.
    """
    check_count(counted, "remaining: counted", least=0)
    table = SLICES.check(sliced, "remaining: slices")
    groups = table.groupby("slice_m")
    number = groups["particle"].nunique()
    if len(number) and number.max() > counted:
        raise InputError(f"remaining: {number.max()} particles in a slice, but {counted} counted.")
    share = number / max(counted, 1)
    named = {"number": number, "share": share, "median_m_s": groups["velocity_m_s"].median()}
    return pd.DataFrame(named).reset_index()


def straight_on(fit: Flown, time_s: npt.ArrayLike) -> Array:
    """Return places (n, 3) in mm; past the last detection the trajectory flies straight on.

    Polynomials leave their data fast.
    """
    time = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
    seen = np.minimum(time, fit.last_s)
    places = check_finite(fit(seen), "straight_on: the fitted trajectory")
    return places + (time - seen)[:, None] * fit.velocity(seen)


def _both_ways(fit: Flown, slice_m: float, until_s: float) -> tuple[list[float], list[float], int]:
    """Return ages at the marks in front and behind, and how many are before the camera."""
    check_positive(slice_m, "space_sliced_velocity: slice_m")
    if math.isnan(until_s):
        raise InputError("space_sliced_velocity: until_s is NaN; leave it out if not known.")
    powers, age = _path(fit, min(fit.last_s, until_s))
    lance = float(np.asarray(fit.exit_point_mm, dtype=np.float64)[2])
    count = int(max(lance, 0.0) / (1000.0 * slice_m) * (1 + 1e-12))
    if count > MOST:
        raise InputError(f"space_sliced_velocity: {count} slices of {slice_m} m; take longer ones.")
    forth, back = (_reached(powers, age, sign * 1000.0 * slice_m) for sign in (1, -1))
    return forth[:count], back, count


def _path(fit: Flown, end_s: float) -> tuple[Array, Array]:
    """Return the coefficients of the distance from the lance, and ages that part it.

    Between two of these ages the distance only rises or only falls. They are both ends of
    the span and the real parts of the roots of the velocity: a point more does no harm, and
    a double root that rounding makes complex is not lost.
    """
    powers = -check_finite(fit.coefficients[2], "fit: coefficients of z")
    if not end_s > fit.t0_s:
        raise InputError(
            f"space_sliced_velocity: the flight ends at {end_s} s, but leaves the lance at "
            f"{fit.t0_s} s. Check the trajectory."
        )
    end = end_s - fit.t0_s
    slope = powers * np.arange(1, len(powers) + 1) * end ** np.arange(len(powers))
    slope[np.abs(slope) <= EPSILON * np.abs(slope).max(initial=0.0)] = 0.0
    turns = end * np.roots(slope[::-1]).real
    age = np.concatenate([[0.0, end], turns])
    return powers, np.unique(age[(age >= 0.0) & (age <= end)])


def _reached(powers: Array, age: Array, step: float) -> list[float]:
    """Return at what ages the distance first is one step, two steps, ...; steps in mm."""

    def far(at: Array | float) -> Array:
        """Return the distance in steps; below 0 on the other side of the lance."""
        return np.asarray(np.polyval(np.append(powers[::-1], 0.0), at) / step)

    furthest = np.maximum.accumulate(check_finite(far(age), "space_sliced_velocity: fit"))
    found = []
    for level in range(1, min(int(furthest[-1]), MOST) + 1):
        k = int(np.searchsorted(furthest, level))  # from 1: the first age is 0, at the lance
        found.append(brentq(lambda t, level=level: far(t) - level, age[k - 1], age[k], xtol=1e-12))
    return found


def _rows(
    fit: Flown, reached: list[float], slice_m: float, count: int
) -> dict[str, npt.NDArray[np.generic]]:
    """Return the columns of the slices in one direction; those not reached hold NaN."""
    times = np.full(count + 1, np.nan)
    times[: len(reached) + 1] = [0.0, *reached]
    number = np.arange(1, count + 1)
    return {
        "slice_m": number * slice_m,
        "start_s": fit.t0_s + times[:-1],
        "end_s": fit.t0_s + times[1:],
        "velocity_m_s": slice_m / np.diff(times),
        "reached": number <= len(reached),
        "observed": fit.t0_s + times[1:] >= fit.first_s,
    }
