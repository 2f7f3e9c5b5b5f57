"""Summary of many flights in the quantities of section 5.3.

The input is arrays with one entry per particle, true or measured. Distances are in
depth from the lance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy  # stats on first use: they take a quarter of a second

from kilnflight.arrays import Array, Flags, Index

METRES = (1, 2, 3, 4, 5)  # marks from the lance (sec. 5.3.1)
LAST_SHARE = 0.03  # of the particles must pass a metre that is to count as the last one


class FlightValues(NamedTuple):
    """Values of k complete flights, n counted particles and m lost flights.

    NaN stands for what did not happen. A dwell time ends "by landing or complete
    burning out" (section 5.3.1 of the thesis). Flights that are "not fully tracked"
    "cannot be analyzed" (A.1), so lost flights have none: they are censored at the time
    they were seen.
    """

    dwell_s: Array  # (k,): of complete flights
    velocity_m_s: Array  # (n, 5): mean within each metre (Eq. 5.8); NaN: not reached
    ignition_s: Array  # (n,): time from the lance; NaN: not ignited
    reached_m: Array  # (n,): depth travelled from the lance at the end of the flight
    censored_s: Array = np.empty(
        0
    )  # (m,): time from the lance until lost flights were last seen
    lost: Flags = np.zeros(0, np.bool_)  # (n,): which flights these are; empty: none


def remaining(flight_values: FlightValues) -> tuple[Array, Index]:
    """Return the share of particles that pass 1 ... 5 m in per cent, and their number.

    Figs 5.21 to 5.24 print these shares. A flight ends where its dwell time does. A
    lost one is censored at its last detection (Kaplan and Meier 1958).

    Returns
    -------
    share : array (5,)
        Per cent, by metre of `METRES`; NaN without particles, and beyond the farthest
        flight if that one was lost: nobody knows how many of its kind go on.
    counted : array (5,)
        Particles that were not lost before that metre.
    """
    passed = np.where(np.isnan(flight_values.velocity_m_s), 0.0, METRES).max(
        axis=1, initial=0.0
    )
    far = np.fmax(passed, flight_values.reached_m)
    lost = (
        flight_values.lost if len(flight_values.lost) else np.zeros(len(far), np.bool_)
    )
    marks = np.array(METRES) - 1e-9  # reaching a mark counts as passing it
    counted = np.array([(~lost | (far >= mark)).sum() for mark in marks])
    if not len(far):
        return np.full(len(marks), np.nan), counted
    curve = scipy.stats.ecdf(
        scipy.stats.CensoredData(uncensored=far[~lost], right=far[lost])
    ).sf
    share = 100.0 * np.asarray(curve.evaluate(marks))
    share[(marks > far.max()) & (share > 0.0)] = np.nan
    return share, counted


def quartiles(values: Array) -> Array:
    """Return the quartiles (3, ...) of the finite values (n, ...) by column.

    NaN without values.
    """
    return (
        pd.DataFrame(values)
        .quantile([0.25, 0.5, 0.75])
        .to_numpy()
        .reshape(3, *values.shape[1:])
    )


def outcomes(flight_values: FlightValues) -> pd.Series:
    """Return every quantity of section 5.3 by its name and unit, NaN without a value.

    Velocities are medians; "last" is the farthest metre that at least `LAST_SHARE` of
    the particles pass. Dwell times are those of complete flights. "ignited" counts all
    particles, "% of ignited" those that ignited. "penetration" is the median depth at
    the end, "spread" the interquartile range, "landed 1 m" is 100 % minus "remaining 1
    m". The names are keys of the published numbers (``flight.csv``), and
    `kilnflight.experiments.flights.comparison.interval_of` reads them.
    """
    times = pd.Series(flight_values.dwell_s)
    ignition_s = pd.Series(flight_values.ignition_s)
    share = remaining(flight_values)[0]
    lit = ignition_s.dropna()
    low, velocity, high = quartiles(flight_values.velocity_m_s)
    q25, median, q75 = quartiles(flight_values.dwell_s)
    metres = [f"{metre - 1}-{metre} m (m/s)" for metre in METRES]
    last = np.flatnonzero(share >= 100.0 * LAST_SHARE)[-1:]
    values = {f"velocity {metre}": v for metre, v in zip(metres, velocity, strict=True)}
    values |= {"velocity last (m/s)": velocity[last[0]] if len(last) else np.nan}
    values |= {f"remaining {m} m (%)": s for m, s in zip(METRES, share, strict=True)}
    values |= {
        "landed 1 m (%)": 100.0 - share[0],
        "dwell q25 (s)": q25,
        "dwell median (s)": median,
        "dwell q75 (s)": q75,
        "dwell longest (s)": times.max(),
        "dwell 0.3-0.4 s (%)": 100.0 * times.between(0.3, 0.4).mean(),
        "dwell > 0.4 s (%)": 100.0 * (times >= 0.4).mean(),
        "dwell > 1 s (%)": 100.0 * (times > 1.0).mean(),
        "penetration (m)": pd.Series(flight_values.reached_m).median(),
        "ignited (%)": 100.0 * ignition_s.notna().mean(),
        "ignited < 0.1 s (%)": 100.0 * (ignition_s <= 0.1).mean(),
        "ignited < 0.1 s (% of ignited)": 100.0 * lit.between(0.0, 0.1, "right").mean(),
        "ignited < 0.2 s (% of ignited)": 100.0 * lit.between(0.0, 0.2, "right").mean(),
        "ignited < 0.4 s (% of ignited)": 100.0 * lit.between(0.0, 0.4, "right").mean(),
        "ignited 0.2-0.3 s (% of ignited)": 100.0
        * lit.between(0.2, 0.3, "right").mean(),
        "ignition median (s)": lit.median(),
        "dwell spread (s)": q75 - q25,
    }
    values |= {
        f"spread {metre}": v for metre, v in zip(metres, high - low, strict=True)
    }
    return pd.Series(values, dtype=np.float64)


def ignition_histogram(
    ignition_s: Array, width_s: float = 0.1, bins: int = 8
) -> pd.DataFrame:
    """Return the share of particles that ignite in each bin of time (Figs 5.25, 5.26).

    A time on the edge of two bins belongs to the earlier. The last bin holds all later
    ignitions. The first one holds those before the fitted time at the lance, too: a fit
    does not know the first detections if they have no depth.

    Parameters
    ----------
    ignition_s
        (n,) time from the lance in s; NaN: not ignited.
    width_s, bins
        Width of a bin in s (0.1, section 5.3.2) and number of bins.

    Returns
    -------
    DataFrame
        ``from_s``: start of the bin; ``percent`` of all n particles.
    """
    times = ignition_s[np.isfinite(ignition_s)]
    place = np.clip((times - 1e-9) / width_s, 0, bins - 1).astype(np.intp)
    counts = np.bincount(place, minlength=bins)
    percent = 100.0 * counts / max(len(ignition_s), 1)
    return pd.DataFrame({"from_s": width_s * np.arange(bins), "percent": percent})
