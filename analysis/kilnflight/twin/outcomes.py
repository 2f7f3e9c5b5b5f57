"""What the twin's flights truly come to, for `kilnflight.scores.flights`.

Nothing is rendered and nothing is measured here: a particle counts whether a camera could
have seen it or not. Distances are along the kiln from the lance.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.scores.flights import METRES, Findings, outcomes
from kilnflight.twin.flight import ENDS, Flight, Flights, fly
from kilnflight.twin.fractions import FRACTIONS, fraction
from kilnflight.twin.gas import Gas
from kilnflight.twin.geometry import Geometry

Array = npt.NDArray[np.float64]

PRESSURES_BAR = (4.5, 5.0)  # sec. 5.2.1
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


def dwell_times(flights: Flights) -> Array:
    """Return dwell times in s: from the lance to landing or burning out (sec. 5.3.1).

    Particles that leave the kiln or still fly have none and are left out.
    """
    return flights.end_s[~np.isin(flights.end, NO_DWELL)]


def findings(flights: Flights) -> Findings:
    """Return what the flights come to, particle by particle, as it truly is."""
    reached = flights.end_position_m[:, 0]
    return Findings(dwell_times(flights), velocities(flights), flights.ignition_s, reached)


def table(cells: dict[tuple[str, float], Flights]) -> pd.DataFrame:
    """Return the outcomes of several cells, one row per fraction and pressure.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``particles``, and the names of
        `kilnflight.scores.flights.outcomes`.
    """
    rows = [
        {
            "fraction": name,
            "pressure_bar": bar,
            "particles": len(one.end),
            **outcomes(findings(one)),
        }
        for (name, bar), one in cells.items()
    ]
    return pd.DataFrame(rows)
