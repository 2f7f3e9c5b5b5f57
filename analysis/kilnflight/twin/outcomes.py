"""What flights come to: the quantities that section 5.3 of the thesis states, as they truly are.

Nothing is rendered and nothing is measured here: a particle counts whether a camera could
have seen it or not. Distances are along the kiln from the lance.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.twin.flight import ENDS, Flight, Flights, fly
from kilnflight.twin.fractions import FRACTIONS, fraction
from kilnflight.twin.gas import Gas
from kilnflight.twin.geometry import Geometry

Array = npt.NDArray[np.float64]

METRES = (1, 2, 3, 4, 5)  # marks from the lance (sec. 5.3.1)
PRESSURES_BAR = (4.5, 5.0)  # sec. 5.2.1
LAST_SHARE = 0.03  # of the particles must pass a metre that is to count as the last one
NO_DWELL = [ENDS.index(end) for end in ("left the kiln", "still flying")]


def released(
    name: str, pressure_bar: float, inputs: tuple[Flight, Gas], count: int, seed: int
) -> Flights:
    """Let ``count`` particles of a fraction fly, all launched at once.

    Parameters
    ----------
    name
        Of the fraction.
    pressure_bar
        Of the lance's air.
    inputs
        How flights are computed, and the gas (at any pressure).
    count
        Of particles.
    seed
        The same seed gives the same particles, whatever the inputs.
    """
    flight, gas = inputs
    kind = fraction(name)
    at_pressure = Gas(**{**vars(gas), "pressure_bar": pressure_bar})
    drawn = kind.draw(count, np.random.default_rng([seed, 1]))
    return fly(drawn, at_pressure, Geometry(), np.random.default_rng([seed, 2]), flight)


def released_all(
    inputs: tuple[Flight, Gas], count: int, seed: int
) -> dict[tuple[str, float], Flights]:
    """Return the flights of every fraction at both pressures; see `released`."""
    cells = [(name, bar) for name in FRACTIONS for bar in PRESSURES_BAR]
    return {cell: released(*cell, inputs, count, seed) for cell in cells}


def crossing_times(flights: Flights, distance_m: float, lance_s_m: float = 0.0) -> Array:
    """Return when each particle first was that far from the lance, in s, (n,); NaN if never."""
    way = flights.position_m[:, :, 0] - lance_s_m
    beyond = way >= distance_m
    after = np.argmax(beyond, axis=1) if way.shape[1] else np.zeros(len(way), dtype=np.intp)
    rows = np.flatnonzero(beyond.any(axis=1) & (after > 0))
    high, low = way[rows, after[rows]], way[rows, after[rows] - 1]
    share = (distance_m - low) / (high - low)
    age = flights.age_s
    found = np.full(len(way), np.nan)
    found[rows] = age[after[rows] - 1] + share * (age[after[rows]] - age[after[rows] - 1])
    return found


def velocities(flights: Flights) -> Array:
    """Return each particle's mean velocity within each metre in m/s (Eq. 5.8), (n, 5).

    NaN where a particle did not pass the whole metre.
    """
    crossed = [crossing_times(flights, float(metre)) for metre in METRES]
    times = np.stack([np.zeros(len(flights.end)), *crossed], axis=1)
    return 1.0 / np.diff(times, axis=1)


def median_velocities(flights: Flights) -> Array:
    """Return the median velocity within each metre in m/s, (5,); NaN where none passed."""
    each = velocities(flights)
    passed = np.isfinite(each).any(axis=0)
    found = np.full(len(METRES), np.nan)
    found[passed] = np.nanmedian(each[:, passed], axis=0)
    return found


def remaining(flights: Flights) -> Array:
    """Return the share of particles that pass 1 ... 5 m in per cent, (5,)."""
    return 100.0 * np.isfinite(velocities(flights)).mean(axis=0)


def last_velocity(flights: Flights) -> float:
    """Return the median velocity in m/s in the last metre that `LAST_SHARE` of them pass."""
    passed = np.flatnonzero(remaining(flights) >= 100.0 * LAST_SHARE)
    return float(median_velocities(flights)[passed[-1]]) if len(passed) else float("nan")


def dwell_times(flights: Flights) -> Array:
    """Return dwell times in s: from the lance to landing or burning out (sec. 5.3.1).

    Particles that leave the kiln or still fly have none and are left out.
    """
    return flights.end_s[~np.isin(flights.end, NO_DWELL)]


def dwell_quartiles(flights: Flights) -> Array:
    """Return lower quartile, median and upper quartile of the dwell time in s, (3,)."""
    times = dwell_times(flights)
    return np.quantile(times, [0.25, 0.5, 0.75]) if len(times) else np.full(3, np.nan)


def dwell_share(flights: Flights, low_s: float, high_s: float = np.inf) -> float:
    """Return the share of dwell times within limits in per cent."""
    times = dwell_times(flights)
    within = (times >= low_s) & (times <= high_s)
    return float(100.0 * within.mean()) if len(times) else float("nan")


def ignited(flights: Flights, within_s: float = np.inf) -> float:
    """Return the share of all particles that ignite in flight within a time, in per cent."""
    return float(100.0 * (flights.ignition_s <= within_s).mean())


def share_of_ignited(flights: Flights, low_s: float, high_s: float) -> float:
    """Return the share of the ignited ones that ignite after one time and up to another, in %."""
    times = flights.ignition_s[np.isfinite(flights.ignition_s)]
    within = (times > low_s) & (times <= high_s)
    return float(100.0 * within.mean()) if len(times) else float("nan")


def median_ignition(flights: Flights) -> float:
    """Return the median ignition time in s of what ignites in flight; NaN if nothing does."""
    times = flights.ignition_s[np.isfinite(flights.ignition_s)]
    return float(np.median(times)) if len(times) else float("nan")


def penetration(flights: Flights) -> float:
    """Return the median distance from the lance in m at which flights end."""
    return float(np.median(flights.end_position_m[:, 0]))


def outcomes(flights: Flights) -> pd.Series:
    """Return every quantity by name; the unit stands in the name, NaN where it has no value."""
    velocity, share = median_velocities(flights), remaining(flights)
    q25, median, q75 = dwell_quartiles(flights)
    times = dwell_times(flights)
    found = {f"velocity {m - 1}-{m} m (m/s)": v for m, v in zip(METRES, velocity, strict=True)}
    found |= {"velocity last (m/s)": last_velocity(flights)}
    found |= {f"remaining {m} m (%)": s for m, s in zip(METRES, share, strict=True)}
    found |= {
        "landed 1 m (%)": 100.0 - share[0],
        "dwell q25 (s)": q25,
        "dwell median (s)": median,
        "dwell q75 (s)": q75,
        "dwell longest (s)": times.max() if len(times) else np.nan,
        "dwell 0.3-0.4 s (%)": dwell_share(flights, 0.3, 0.4),
        "dwell > 0.4 s (%)": dwell_share(flights, 0.4),
        "penetration (m)": penetration(flights),
        "ignited (%)": ignited(flights),
        "ignited < 0.1 s (%)": ignited(flights, 0.1),
        "ignited < 0.2 s (% of ignited)": share_of_ignited(flights, 0.0, 0.2),
        "ignited < 0.4 s (% of ignited)": share_of_ignited(flights, 0.0, 0.4),
        "ignited 0.2-0.3 s (% of ignited)": share_of_ignited(flights, 0.2, 0.3),
        "ignition median (s)": median_ignition(flights),
    }
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


def dwell_box(flights: Flights) -> dict[str, float]:
    """Return quartiles, whiskers (within 1.5 boxes) and the number of outliers beyond, in s."""
    times = dwell_times(flights)
    q25, median, q75 = dwell_quartiles(flights)
    reach = 1.5 * (q75 - q25)
    inside = times[(times >= q25 - reach) & (times <= q75 + reach)]
    return {
        "whisker_low": float(inside.min()) if len(inside) else np.nan,
        "q25": float(q25),
        "median": float(median),
        "q75": float(q75),
        "whisker_high": float(inside.max()) if len(inside) else np.nan,
        "outliers": float(len(times) - len(inside)),
        "without_dwell": float(len(flights.end) - len(times)),
    }


def ignition_histogram(flights: Flights, width_s: float = 0.1, bins: int = 8) -> pd.DataFrame:
    """Return which share of all particles ignites when; the last bin holds all that is later.

    Returns
    -------
    DataFrame
        ``from_s`` of each bin and ``percent`` of all particles.
    """
    times = flights.ignition_s[np.isfinite(flights.ignition_s)]
    place = np.minimum(((times - 1e-9) / width_s).astype(np.intp), bins - 1)
    counts = np.bincount(place, minlength=bins)
    percent = 100.0 * counts / max(len(flights.end), 1)
    return pd.DataFrame({"from_s": width_s * np.arange(bins), "percent": percent})


def table(cells: dict[tuple[str, float], Flights]) -> pd.DataFrame:
    """Return the outcomes of several cells, one row per fraction and pressure.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``particles``, and the names of `outcomes`.
    """
    rows = [
        {"fraction": name, "pressure_bar": bar, "particles": len(one.end), **outcomes(one)}
        for (name, bar), one in cells.items()
    ]
    return pd.DataFrame(rows)
