"""Space-sliced velocities (Eq. 5.8), and the share of particles in each slice."""

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
from pandas import DataFrame
from scipy.optimize import brentq

from kilnflight.arrays import Array
from kilnflight.checks import InputError, check_number
from kilnflight.regression import Fit
from kilnflight.tables import SLICES

MOST = 10_000  # slices of one flight


def space_sliced_velocity(
    fit: Fit, slice_m: float = 1.0, until_s: float = math.inf
) -> DataFrame:
    """Return slices of a flight and the mean velocity in depth over each (Eq. 5.8).

    ``V_n = slice / (t_n - t_(n-1))``: t_n is when the fitted trajectory first is n
    slices from the lance towards the camera, t_0 when it leaves the lance.

    Parameters
    ----------
    fit
        A fitted trajectory.
    slice_m
        Length of a slice: 1 m, section 5.3.1.
    until_s
        End of the flight in s of the recording, if before the last detection.

    Returns
    -------
    DataFrame
        One row for every slice between lance and camera, and for each slice behind the
        lance that was reached, by ascending ``slice_m``, the far end of the slice;
        ``start_s``, ``end_s``: t_(n-1), t_n in s of the recording; ``velocity_m_s``,
        NaN where ``reached`` is False; ``observed``: reached after the first detection.

    Raises
    ------
    InputError
        If ``slice_m`` is not above 0 or gives more than `MOST` slices, or the flight
        ends before t_0.

    Notes
    -----
    Readings. (1) Only the span from t_0 to the last detection counts: polynomials are
    no observation afterwards. (2) "First": later returns change nothing, so V_n is
    positive for every slice in front of the lance. The thesis shows negative
    velocities, "reverse motions towards the lance": small ones "probably" of a vortex,
    "relatively large" ones perhaps of camera and tracking (section 5.3.1). It does not
    say how Eq. 5.8 gives them. Here they belong to slices -1, -2, ... behind the lance,
    V_n = -slice / (t_n - t_(n+1)). Plausible flights have no slice behind the
    lance (`kilnflight.flight.Plausible`). (3) The motion between t_0 and the first
    detection counts, as in the thesis; ``observed`` marks it. (4) The distance is the
    difference of depths, not the path.

    Examples
    --------
    >>> fit = Fit((0.0, 0.0, 3000.0), 0.1, 0, (0.0, 0.1), (1, 1, 1),
    ...           ((0.0,), (0.0,), (-8000.0,)), 0.2, 0.4, 60)
    >>> space_sliced_velocity(fit)[["slice_m", "velocity_m_s", "observed"]].round(3)
       slice_m  velocity_m_s  observed
    0      1.0           8.0      True
    1      2.0           8.0      True
    2      3.0           NaN     False
    """
    check_number(slice_m, "space_sliced_velocity: slice_m", least=1e-6)
    last_age = min(until_s, fit.last_s) - fit.t0
    if not last_age > 0:
        raise InputError(
            f"space_sliced_velocity: until_s or fit ends {last_age} s after t0, not "
            "above 0."
        )
    # 8000 mm are 8 slices also where the quotient is rounded to 7.999...
    count = int(max(fit.exit_point_mm[2], 0.0) / (1000.0 * slice_m) * (1 + 1e-12))
    if count > MOST:
        raise InputError(
            f"space_sliced_velocity: slice_m {slice_m} gives {count} slices."
        )
    front = _reached(fit, last_age, 1000.0 * slice_m)[:count]
    behind = _reached(fit, last_age, -1000.0 * slice_m)
    parts = [
        _sliced(fit, behind, -slice_m, len(behind))[::-1],
        _sliced(fit, front, slice_m, count),
    ]
    return pd.concat(parts, ignore_index=True)


def _sliced(fit: Fit, ages: list[float], length_m: float, count: int) -> DataFrame:
    """Return ``count`` slices, of which the first are reached at ``ages`` in s."""
    number = np.arange(1, count + 1)
    times = np.full(count + 1, np.nan)
    times[: len(ages) + 1] = [0.0, *ages]
    begin = fit.t0 + times[:-1]
    end = fit.t0 + times[1:]
    return DataFrame(
        {
            "slice_m": number * length_m,
            "start_s": begin,
            "end_s": end,
            "velocity_m_s": length_m / np.diff(times),
            "reached": number <= len(ages),
            "observed": end >= fit.first_s,
        }
    )


def slices(
    fits: Mapping[int, Fit], ends_s: Mapping[int, float] | None = None
) -> DataFrame:
    """Return the velocities over slices of 1 m of many flights, in m/s.

    The table is `kilnflight.tables.SLICES`, without slices that were not reached.

    Parameters
    ----------
    fits
        By particle.
    ends_s
        By particle: the end of its flight in s, where it is known; else the last
        detection.
    """
    ends_s = ends_s or {}
    parts = []
    for particle, fit in fits.items():
        table = space_sliced_velocity(fit, until_s=ends_s.get(particle, math.inf))
        parts.append(table[table["reached"]].assign(particle=particle))
    return SLICES.join(parts)[SLICES.names]


def reaching(sliced: DataFrame, counted: int) -> DataFrame:
    """Return number, share and median velocity of the particles in each slice.

    These are the box plots' medians and percentages of Figs 5.21 to 5.24.

    Parameters
    ----------
    sliced
        Of `slices`.
    counted
        Number of particles, including those that reach no slice.

    Returns
    -------
    DataFrame
        One row per slice: ``slice_m``, ``number`` of particles, ``share`` of
        ``counted`` (0 to 1) and ``median_m_s``.
    """
    table = sliced.groupby("slice_m", as_index=False).agg(
        number=("particle", "nunique"), median_m_s=("velocity_m_s", "median")
    )
    table.insert(2, "share", table["number"] / max(counted, 1))
    return table


def _reached(fit: Fit, end: float, step: float) -> list[float]:
    """Return the ages in s at which the depth travelled first is 1, 2, ... steps.

    ``step`` is in mm, below 0 for slices behind the lance; ``end`` is the age at the
    end of the flight. Ages count from t0.
    """
    factors = -np.array(fit.coefficients[2], float)

    def far(at: Array | float) -> Array:
        """Return the depth travelled, in steps, at ages in s; below 0: behind."""
        return np.polyval(np.append(factors[::-1], 0.0), at) / step

    # Between these ages the distance is monotone. The real part of a complex root does
    # no harm, and a double root that rounding makes complex is kept.
    slope = factors * np.arange(1, len(factors) + 1) * end ** np.arange(len(factors))
    slope[np.abs(slope) <= 1e-14 * np.abs(slope).max(initial=0.0)] = 0.0
    age = np.append([0.0, end], end * np.roots(slope[::-1]).real)
    age = np.unique(age[(age >= 0.0) & (age <= end)])
    furthest = np.maximum.accumulate(far(age))
    reached = []
    for level in range(1, min(int(furthest[-1]), MOST) + 1):
        # The first age is 0, at the lance, so the index is at least 1.
        k = np.searchsorted(furthest, level)
        rise = (age[k - 1], age[k])
        reached.append(brentq(lambda t, level=level: far(t) - level, *rise, xtol=1e-12))
    return reached
