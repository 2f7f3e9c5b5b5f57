"""Sum up many flights in the numbers that section 5.3 of the thesis states.

From arrays with one entry per particle, whether these are true or measured. Distances are
in depth from the lance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError, check_positive

Array = npt.NDArray[np.float64]

METRES = (1, 2, 3, 4, 5)  # marks from the lance (sec. 5.3.1)
LAST_SHARE = 0.03  # of the particles must pass a metre that is to count as the last one


class FlightValues(NamedTuple):
    """Values of each particle that counts; NaN where something did not happen."""

    dwell_s: Array  # (k,): of those that have a dwell time
    velocity_m_s: Array  # (n, 5): mean within each metre (Eq. 5.8)
    ignition_s: Array  # (n,): from the lance
    reached_m: Array  # (n,): how far from the lance the flight ends


def median_velocities(velocity_m_s: Array) -> Array:
    """Return the median velocity within each metre in m/s, (5,); NaN where none passed."""
    passed = np.isfinite(velocity_m_s).any(axis=0)
    found = np.full(len(METRES), np.nan)
    found[passed] = np.nanmedian(velocity_m_s[:, passed], axis=0)
    return found


def spreads(velocity_m_s: Array) -> Array:
    """Return the range between the quartiles of the velocity in each metre in m/s, (5,)."""
    known = [values[np.isfinite(values)] for values in velocity_m_s.T]
    return np.array([float(np.ptp(quartiles(values)[[0, 2]])) for values in known])


def remaining(velocity_m_s: Array) -> Array:
    """Return the share of particles that pass 1 ... 5 m in per cent, (5,); NaN of none."""
    if not len(velocity_m_s):
        return np.full(len(METRES), np.nan)
    return np.asarray(100.0 * np.isfinite(velocity_m_s).mean(axis=0))


def last_velocity(velocity_m_s: Array) -> float:
    """Return the median velocity in m/s in the last metre that `LAST_SHARE` of them pass."""
    passed = np.flatnonzero(remaining(velocity_m_s) >= 100.0 * LAST_SHARE)
    return float(median_velocities(velocity_m_s)[passed[-1]]) if len(passed) else float("nan")


def quartiles(times: Array) -> Array:
    """Return lower quartile, median and upper quartile, (3,); NaN of none."""
    return np.quantile(times, [0.25, 0.5, 0.75]) if len(times) else np.full(3, np.nan)


def share_within(times: Array, low_s: float, high_s: float = np.inf) -> float:
    """Return the share of times within limits in per cent; NaN of none."""
    within = (times >= low_s) & (times <= high_s)
    return float(100.0 * within.mean()) if len(times) else float("nan")


def ignited(ignition_s: Array, within_s: float = np.inf) -> float:
    """Return the share of all particles that ignite in flight within a time, in per cent."""
    return float(100.0 * (ignition_s <= within_s).mean()) if len(ignition_s) else float("nan")


def share_of_ignited(ignition_s: Array, low_s: float, high_s: float) -> float:
    """Return the share of the ignited ones that ignite after one time and up to another, in %."""
    times = ignition_s[np.isfinite(ignition_s)]
    within = (times > low_s) & (times <= high_s)
    return float(100.0 * within.mean()) if len(times) else float("nan")


def median_ignition(ignition_s: Array) -> float:
    """Return the median ignition time in s of what ignites in flight; NaN if nothing does."""
    times = ignition_s[np.isfinite(ignition_s)]
    return float(np.median(times)) if len(times) else float("nan")


def outcomes(flight_values: FlightValues) -> pd.Series:
    """Return every quantity by name; the unit stands in the name, NaN where it has no value."""
    times, each, ignition_s, reached = flight_values
    velocity, share = median_velocities(each), remaining(each)
    q25, median, q75 = quartiles(times)
    found = {f"velocity {m - 1}-{m} m (m/s)": v for m, v in zip(METRES, velocity, strict=True)}
    found |= {"velocity last (m/s)": last_velocity(each)}
    found |= {f"remaining {m} m (%)": s for m, s in zip(METRES, share, strict=True)}
    found |= {
        "landed 1 m (%)": 100.0 - share[0],
        "dwell q25 (s)": q25,
        "dwell median (s)": median,
        "dwell q75 (s)": q75,
        "dwell longest (s)": times.max() if len(times) else np.nan,
        "dwell 0.3-0.4 s (%)": share_within(times, 0.3, 0.4),
        "dwell > 0.4 s (%)": share_within(times, 0.4),
        "penetration (m)": np.median(reached) if len(reached) else np.nan,
        "ignited (%)": ignited(ignition_s),
        "ignited < 0.1 s (%)": ignited(ignition_s, 0.1),
        "ignited < 0.2 s (% of ignited)": share_of_ignited(ignition_s, 0.0, 0.2),
        "ignited < 0.4 s (% of ignited)": share_of_ignited(ignition_s, 0.0, 0.4),
        "ignited 0.2-0.3 s (% of ignited)": share_of_ignited(ignition_s, 0.2, 0.3),
        "ignition median (s)": median_ignition(ignition_s),
        "dwell spread (s)": q75 - q25,
    }
    spread = spreads(each)
    found |= {f"spread {m - 1}-{m} m (m/s)": v for m, v in zip(METRES, spread, strict=True)}
    return pd.Series(found, dtype=np.float64)


def place_of(name: str) -> tuple[str, float]:
    """Return quantity and distance from the lance in m of an outcome along the way.

    A velocity stands in the middle of its metre; NaN if the outcome has no place.

    Examples
    --------
    >>> place_of("velocity 1-2 m (m/s)"), place_of("remaining 3 m (%)")
    (('velocity', 1.5), ('remaining', 3.0))
    """
    quantity, segment, unit = (*name.split(" "), "", "")[:3]
    if unit != "m" or quantity not in ("velocity", "remaining"):
        return quantity, float("nan")
    return quantity, float(np.mean([float(mark) for mark in segment.split("-")]))


def along(rows: pd.DataFrame) -> pd.DataFrame:
    """Return a table of outcomes as one row per quantity and distance.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``quantity`` ("velocity" in m/s, "remaining" in %),
        ``distance_m``, ``value``.
    """
    names = [name for name in rows.columns if np.isfinite(place_of(name)[1])]
    tall = rows.melt(["fraction", "pressure_bar"], names, "outcome")
    tall["quantity"] = [place_of(name)[0] for name in tall["outcome"]]
    tall["distance_m"] = [place_of(name)[1] for name in tall["outcome"]]
    columns = ["fraction", "pressure_bar", "quantity", "distance_m", "value"]
    return tall[columns].sort_values(columns[:-1], ignore_index=True)


def box(times: Array) -> dict[str, float]:
    """Return quartiles, whiskers (within 1.5 boxes) and the number of outliers beyond."""
    q25, median, q75 = quartiles(times)
    reach = 1.5 * (q75 - q25)
    inside = times[(times >= q25 - reach) & (times <= q75 + reach)]
    return {
        "whisker_low": float(inside.min()) if len(inside) else np.nan,
        "q25": float(q25),
        "median": float(median),
        "q75": float(q75),
        "whisker_high": float(inside.max()) if len(inside) else np.nan,
        "outliers": float(len(times) - len(inside)),
    }


def ignition_histogram(ignition_s: Array, width_s: float = 0.1, bins: int = 8) -> pd.DataFrame:
    """Return which share of all particles ignites when; the last bin holds all that is later.

    Returns
    -------
    DataFrame
        ``from_s`` of each bin and ``percent`` of all particles.

    Raises
    ------
    InputError
        If a particle ignites before it leaves the lance.
    """
    check_positive(width_s, "ignition_histogram: width_s")
    times = ignition_s[np.isfinite(ignition_s)]
    if (times < 0).any():
        raise InputError(
            f"ignition_histogram: an ignition at {times.min():.3f} s; count from leaving the lance."
        )
    place = np.minimum(((times - 1e-9) / width_s).astype(np.intp), bins - 1)
    counts = np.bincount(place, minlength=bins)
    percent = 100.0 * counts / max(len(ignition_s), 1)
    return pd.DataFrame({"from_s": width_s * np.arange(bins), "percent": percent})
