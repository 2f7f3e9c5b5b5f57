"""Space-sliced velocities (Eq. 5.8), and who remains in each slice."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import brentq

from kilnflight.checks import InputError, check_count, check_finite, check_positive
from kilnflight.regression import Fit
from kilnflight.tables import SLICES

Array = npt.NDArray[np.float64]

MOST = 10_000  # slices of one flight
EPSILON = 1e-14  # share of the largest term below which another one moves nothing


def space_sliced_velocity(
    fit: Fit, slice_m: float = 1.0, until_s: float = math.inf
) -> pd.DataFrame:
    """Return the mean velocity in depth over each slice (Eq. 5.8).

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
        between lance and camera, and one for each slice behind the lance that was reached. Where
        ``reached`` is False the velocity is NaN, and the row must not be counted.

    Notes
    -----
    Readings. (1) Only the span from t_0 to the last detection counts. Where a polynomial goes
    afterwards is no observation, so a slice reached only there is not reached. (2) "First": later
    returns change nothing, so V_n is positive for every slice in front of the lance. The thesis
    shows negative velocities, "reverse motions towards the lance": small ones "probably" of a
    vortex, "relatively large" ones perhaps of camera and tracking (section 5.3.1). How Eq. 5.8
    gives them it does not say; here they are those of slices -1, -2, ... behind the lance, V_n =
    -slice / (t_n - t_(n+1)), of trajectories that go backwards from the exit point. A flight that
    does so by more than the depth scatters is refused (`kilnflight.flight.Plausible`), so flights
    that count have none. (3) What the polynomials pass between t_0 and the first detection counts,
    as published. A flight first detected beyond a slice has in it the velocity that its polynomials
    need from the lance to there (``observed``). (4) The distance is the difference of depths, not
    the path.
    """
    check_positive(slice_m, "space_sliced_velocity: slice_m")
    if math.isnan(until_s):
        raise InputError("space_sliced_velocity: until_s is NaN; leave it out if not known.")
    distance, age = _distance(fit, min(fit.last_s, until_s))
    count = int(max(fit.exit_point_mm[2], 0.0) / (1000.0 * slice_m) * (1 + 1e-12))
    if count > MOST:
        raise InputError(f"space_sliced_velocity: {count} slices of {slice_m} m; take longer ones.")
    parts = []
    for length in (-slice_m, slice_m):
        reached = _reached(distance, age, 1000.0 * length)
        number = np.arange(1, (len(reached) if length < 0 else count) + 1)
        times = np.full(len(number) + 1, np.nan)
        times[: len(reached) + 1] = [0.0, *reached][: len(times)]
        part = pd.DataFrame({"slice_m": number * length})
        part["start_s"], part["end_s"] = fit.t0 + times[:-1], fit.t0 + times[1:]
        part["velocity_m_s"] = length / np.diff(times)
        part["reached"] = number <= len(reached)
        part["observed"] = fit.t0 + times[1:] >= fit.first_s
        parts.append(part)
    return pd.concat([parts[0][::-1], parts[1]], ignore_index=True)


def slices(
    fits: Mapping[int, Fit], ends_s: Mapping[int, float] | None = None, slice_m: float = 1.0
) -> pd.DataFrame:
    """Return the space-sliced velocities of many flights.

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
    parts = [SLICES.empty()]
    for particle, fit in fits.items():
        end = math.inf if ends_s is None else ends_s.get(particle, math.inf)
        table = space_sliced_velocity(fit, slice_m, end).assign(particle=particle)
        behind = table["slice_m"] < 0
        table = pd.concat([table[behind][::-1], table[~behind & table["reached"]]])
        parts.append(table[SLICES.names])
    filled = [part for part in parts if len(part)] or parts[:1]
    return SLICES.check(pd.concat(filled, ignore_index=True))


def remaining(sliced: pd.DataFrame, counted: int) -> pd.DataFrame:
    """Return the share of particles that reach each slice's far end.

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
    columns = {"number": ("particle", "nunique"), "median_m_s": ("velocity_m_s", "median")}
    slices_reached = table.groupby("slice_m").agg(**columns).reset_index()
    number = slices_reached["number"]
    if number.max() > counted:
        raise InputError(f"remaining: {number.max()} particles in a slice, but {counted} counted.")
    slices_reached.insert(2, "share", number / max(counted, 1))
    return slices_reached


def _distance(fit: Fit, end_s: float) -> tuple[Array, Array]:
    """Return the distance's coefficients and the ages that part it.

    Between two of these ages the distance only rises or only falls. They are both ends of the span
    and the real parts of the roots of the velocity. A point more does no harm, and no double root
    that rounding makes complex is lost.
    """
    powers = -check_finite(fit.coefficients[2], "fit: coefficients of z")
    if not end_s > fit.t0:
        raise InputError(
            f"space_sliced_velocity: the flight ends at {end_s} s, but leaves the lance at "
            f"{fit.t0} s. Check the trajectory."
        )
    end = end_s - fit.t0
    slope = powers * np.arange(1, len(powers) + 1) * end ** np.arange(len(powers))
    slope[np.abs(slope) <= EPSILON * np.abs(slope).max(initial=0.0)] = 0.0
    turns = end * np.roots(slope[::-1]).real
    age = np.concatenate([[0.0, end], turns])
    return powers, np.unique(age[(age >= 0.0) & (age <= end)])


def _reached(powers: Array, age: Array, step: float) -> list[float]:
    """Return the ages at which the distance first is 1, 2, ... steps."""

    def far(at: Array | float) -> Array:
        """Return the distance in steps, below 0 behind the lance."""
        return np.asarray(np.polyval(np.append(powers[::-1], 0.0), at) / step)

    furthest = np.maximum.accumulate(check_finite(far(age), "space_sliced_velocity: fit"))
    reached = []
    for level in range(1, min(int(furthest[-1]), MOST) + 1):
        k = int(np.searchsorted(furthest, level))  # from 1: the first age is 0, at the lance
        reached.append(
            brentq(lambda t, level=level: far(t) - level, age[k - 1], age[k], xtol=1e-12)
        )
    return reached
