"""The published sentences about flight and ignition (flight.csv) that a number can answer.

Each is tied to one of the `kilnflight.scores.flights.outcomes`. Which of them the calibration may
see is decided here, by cell and quantity alone (design rule: wood chips and confetti at
4.5 bar; velocity, remaining share, dwell time, ignited share).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from kilnflight.project import claims
from kilnflight.scores.flights import FlightValues, outcomes, place_of
from kilnflight.twin import truth
from kilnflight.twin.flight import Flights
from kilnflight.twin.particles import FRACTIONS

CALIBRATED, HELD_OUT, NOT_USED = "calibrated on", "held out", "same cell, not used"
CELLS = (("wood chip", 4.5), ("confetti", 4.5))
# What one unit of misfit is at least, where a number is printed without bounds: assumptions,
# about the spread between runs that differ only by 0.5 bar.
LEAST_UNIT = {
    "velocity": 0.5,
    "remaining": 5.0,
    "landed": 5.0,
    "dwell": 0.05,
    "ignited": 5.0,
    "penetration": 0.5,
}
# By quantity, segment and, where that is not enough, the first word of the statistic.
OUTCOMES = {
    ("dwell_time", "", "median"): "dwell median (s)",
    ("dwell_time", "", "outliers"): "dwell longest (s)",
    ("landed", "1", "percent"): "landed 1 m (%)",
    ("remaining", "end", "percent"): "remaining 3 m (%)",
    ("velocity_z", "last", "median"): "velocity last (m/s)",
    ("ignited", "", "percent"): "ignited (%)",
    ("ignited", "<0.1 s", "percent"): "ignited < 0.1 s (%)",
    ("ignited", "<0.2 s", "share"): "ignited < 0.2 s (% of ignited)",
    ("ignited", "<0.4 s", "share"): "ignited < 0.4 s (% of ignited)",
    ("ignited", "0.2-0.3 s", "share"): "ignited 0.2-0.3 s (% of ignited)",
    ("CFD penetration", "", "majority"): "penetration (m)",
    ("CFD penetration", "", "most"): "penetration (m)",
}


def outcome_of(row: pd.Series) -> str:
    """Return the name of the outcome that answers a row of flight.csv; empty if none does."""
    quantity, segment = row["quantity"], row["segment_m"]
    if quantity == "dwell_time" and row["statistic"] == "majority range":
        return "dwell > 0.4 s (%)" if row["value_high"] == "" else "dwell 0.3-0.4 s (%)"
    if quantity == "remaining" and segment.isdigit():
        return f"remaining {segment} m (%)"
    if quantity == "velocity_z" and segment[:1].isdigit():
        return f"velocity {segment} m (m/s)"
    word = row["statistic"].split(" ")[0].strip(";,")
    return OUTCOMES.get((quantity, segment, word), "")


def use_of(fraction: str, pressure_bar: float, outcome: str) -> str:
    """Return how the calibration may use a statement."""
    if (fraction, pressure_bar) not in CELLS:
        return HELD_OUT
    used = outcome.startswith(("velocity", "remaining", "dwell")) or outcome == "ignited (%)"
    return CALIBRATED if used else NOT_USED


def statements() -> pd.DataFrame:
    """Return the numbers of flight.csv that have an outcome, one row per fraction and pressure.

    A sentence about several fractions becomes one row for each. "Most within 0.3 to 0.4 s"
    is read as a share of at least 50 %.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome``, ``printed``, ``low``, ``high`` (NaN: open),
        ``source``, ``use`` (`CALIBRATED`, `HELD_OUT` or `NOT_USED`).
    """
    rows = []
    for _, row in claims.published("flight", as_printed=True).iterrows():
        outcome = outcome_of(row)
        if not outcome or not (row["value_low"] or row["value_high"]):
            continue
        low, high = (float(row[name] or "nan") for name in ("value_low", "value_high"))
        if row["statistic"] == "majority range":
            low, high = 50.0, 100.0
        names = FRACTIONS if row["fraction"] == "all" else row["fraction"].split("+")
        for name in names:
            bar = float(row["pressure_bar"])
            rows.append(
                {
                    "fraction": name,
                    "pressure_bar": bar,
                    "outcome": outcome,
                    "printed": row["value_as_printed"],
                    "low": low,
                    "high": high,
                    "source": row["source"],
                    "use": use_of(name, bar, outcome),
                }
            )
    return pd.DataFrame(rows)


def along(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the statements that have a place on the way, as `kilnflight.scores.flights.along`.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``quantity``, ``distance_m``, ``low``, ``high``.
    """
    columns = ["fraction", "pressure_bar", "quantity", "distance_m", "low", "high"]
    places = [place_of(name) for name in rows["outcome"]]
    table = rows.assign(quantity=[q for q, _ in places], distance_m=[d for _, d in places])
    return table.loc[table["distance_m"].notna(), columns].reset_index(drop=True)


def within(rows: pd.DataFrame, values: pd.Series) -> pd.Series:
    """Return "yes" for a value within the published bounds, else its distance in units."""
    return misfits(rows, values).map(lambda units: "yes" if units == 0 else f"off by {units:.1f}")


def targets() -> pd.DataFrame:
    """Return the statements that the calibration may see; it reads no others."""
    everything = statements()
    return everything[everything["use"] == CALIBRATED].reset_index(drop=True)


def misfits(rows: pd.DataFrame, values: pd.Series) -> pd.Series:
    """Return how far each value is outside its bounds in units, 0 inside.

    A unit is half the width of the bounds, or `LEAST_UNIT` where that is more. A value that
    does not exist (nothing passed that metre) counts as far out as a standstill would.
    """
    value = values.to_numpy(dtype=np.float64)
    value = np.where(np.isfinite(value), value, 0.0)
    low, high = rows["low"].to_numpy(), rows["high"].to_numpy()
    least = rows["outcome"].str.split(" ").str[0].map(LEAST_UNIT).to_numpy(dtype=np.float64)
    unit = np.fmax((high - low) / 2, least)
    outside = np.fmax(np.fmax(low - value, value - high), 0.0)
    return pd.Series(outside / unit, index=rows.index)


def outcome_table(cells: Mapping[tuple[str, float], FlightValues]) -> pd.DataFrame:
    """Return the outcomes of campaigns, one row per fraction and pressure.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``particles``, and the names of
        `kilnflight.scores.flights.outcomes`.
    """
    rows = [
        {"fraction": name, "pressure_bar": bar, "particles": len(values.ignition_s)}
        | outcomes(values).to_dict()
        for (name, bar), values in cells.items()
    ]
    return pd.DataFrame(rows)


def true_outcomes(flights: Mapping[tuple[str, float], Flights]) -> pd.DataFrame:
    """Return the `outcome_table` of flights of the twin, as they truly are."""
    return outcome_table({cell: truth.flight_values(all_) for cell, all_ in flights.items()})


def answer(rows: pd.DataFrame, outcomes: pd.DataFrame) -> pd.Series:
    """Return the value of each statement's outcome from an `outcome_table`."""
    by_cell = {(row["fraction"], row["pressure_bar"]): row for _, row in outcomes.iterrows()}
    cells = zip(rows["fraction"], rows["pressure_bar"], strict=True)
    values = [by_cell[cell][name] for cell, name in zip(cells, rows["outcome"], strict=True)]
    return pd.Series(values, index=rows.index, dtype=np.float64)


def comparison(rows: pd.DataFrame, answers: Mapping[str, pd.Series]) -> pd.DataFrame:
    """Return every statement with the answers of several versions, and whether they are within."""
    table = rows[["fraction", "pressure_bar", "outcome", "printed", "low", "high"]]
    names = {version: version.replace(" ", "_") for version in answers}
    table = table.assign(**{names[one]: values.round(3) for one, values in answers.items()})
    bounds = {f"{names[one]}_within": within(rows, values) for one, values in answers.items()}
    return table.assign(**bounds, use=rows["use"])


def agreement(rows: pd.DataFrame, answers: Mapping[str, pd.Series]) -> pd.DataFrame:
    """Return number of ``statements``, median misfit and number within, by use (the index)."""
    units = pd.DataFrame({version: misfits(rows, values) for version, values in answers.items()})
    groups = units.groupby(rows["use"])
    median = groups.agg("median").add_suffix(", median off by")
    table = median.join((units == 0).groupby(rows["use"]).sum().add_suffix(", within"))
    table.insert(0, "statements", rows["use"].value_counts())
    return table


def worst(rows: pd.DataFrame, values: pd.Series) -> pd.DataFrame:
    """Return the statements that do not hold, the farthest off first."""
    units = misfits(rows, values)
    table = rows[["fraction", "pressure_bar", "outcome", "printed"]]
    table = table.assign(inputs_only=values.round(3), off_by=units.round(1))
    return table[units > 0].sort_values("off_by", ascending=False)
