"""Summary of many flights in the quantities of section 5.3.

The input is arrays with one entry per particle, whether these are true or measured. Distances are
in depth from the lance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy import stats

from kilnflight.checks import InputError, check_positive

Array = npt.NDArray[np.float64]

METRES = (1, 2, 3, 4, 5)  # marks from the lance (sec. 5.3.1)
LAST_SHARE = 0.03  # of the particles must pass a metre that is to count as the last one
NO_TIMES: Array = np.empty(0)
NONE_LOST = np.zeros(0, np.bool_)
LEAST = 6  # flights with an interval, as in `kilnflight.scores.intervals.Bootstrap`


class FlightValues(NamedTuple):
    """Values of the counted particles; NaN for what did not happen.

    A dwell time ends "by landing or complete burning out" (section 5.3.1 of the thesis), and of
    what is "not fully tracked" the flight "cannot be analyzed" (A.1). So lost flights have none:
    they are censored, known to last at least as long as they were seen.
    """

    dwell_s: Array  # (k,): of complete flights
    velocity_m_s: Array  # (n, 5): mean within each metre (Eq. 5.8)
    ignition_s: Array  # (n,): from the lance
    reached_m: Array  # (n,): how far from the lance the flight ends
    censored_s: Array = NO_TIMES  # (m,): how long lost flights were seen
    lost: npt.NDArray[np.bool_] = NONE_LOST  # (n,): which flights these are; empty: none


def remaining(flight_values: FlightValues) -> tuple[Array, npt.NDArray[np.intp]]:
    """Return the share of particles that pass 1 ... 5 m, in per cent.

    A flight ends where its dwell time does. A lost one is known to come as far as it was seen: it
    is censored there (Kaplan and Meier 1958).

    Returns
    -------
    share : array (5,)
        NaN without particles.
    counted : array (5,)
        The particles that were not lost before.
    """
    passed = np.where(np.isnan(flight_values.velocity_m_s), 0.0, METRES).max(axis=1, initial=0.0)
    far = np.fmax(passed, flight_values.reached_m)
    lost = flight_values.lost if len(flight_values.lost) else np.zeros(len(far), np.bool_)
    marks = np.array(METRES) - 1e-9  # who comes to a mark passes it
    counted = np.array([(~lost | (far >= mark)).sum() for mark in marks])
    if not len(far):
        return np.full(len(marks), np.nan), counted
    curve = stats.ecdf(stats.CensoredData(uncensored=far[~lost], right=far[lost])).sf
    return 100.0 * np.asarray(curve.evaluate(marks)), counted


def quartiles(values: Array) -> Array:
    """Return lower quartile, median and upper quartile of known values.

    An array (3, ...), NaN without values.
    """
    return pd.DataFrame(values).quantile([0.25, 0.5, 0.75]).to_numpy().reshape(3, *values.shape[1:])


def outcomes(flight_values: FlightValues) -> pd.Series:
    """Return every quantity by its name and unit, NaN without a value."""
    times, ignition_s = pd.Series(flight_values.dwell_s), pd.Series(flight_values.ignition_s)
    share, lit = remaining(flight_values)[0], ignition_s.dropna()
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
        "penetration (m)": pd.Series(flight_values.reached_m).median(),
        "ignited (%)": 100.0 * ignition_s.notna().mean(),
        "ignited < 0.1 s (%)": 100.0 * (ignition_s <= 0.1).mean(),
        "ignited < 0.1 s (% of ignited)": 100.0 * lit.between(0.0, 0.1, "right").mean(),
        "ignited < 0.2 s (% of ignited)": 100.0 * lit.between(0.0, 0.2, "right").mean(),
        "ignited < 0.4 s (% of ignited)": 100.0 * lit.between(0.0, 0.4, "right").mean(),
        "ignited 0.2-0.3 s (% of ignited)": 100.0 * lit.between(0.2, 0.3, "right").mean(),
        "ignition median (s)": lit.median(),
        "dwell spread (s)": q75 - q25,
    }
    values |= {f"spread {metre}": v for metre, v in zip(metres, high - low, strict=True)}
    return pd.Series(values, dtype=np.float64)


def place_of(name: str) -> tuple[str, float]:
    """Return the quantity of an outcome and its distance in m.

    The distance is from the lance, a velocity's to the middle of its metre. It is NaN if the
    outcome has no place.

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
    """Return quartiles, whiskers and the number of outliers.

    Whiskers end within 1.5 boxes.
    """
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
    """Return the share of particles that ignite in each bin of time.

    The last bin holds all later ignitions.

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
