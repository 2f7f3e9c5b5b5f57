"""Medians and shares of campaigns with 95 % intervals, beside the truth and what is printed.

Medians by bootstrap over particles, shares by Wilson (`kilnflight.scores.intervals`). A velocity is
that of the particles that passed the metre; "velocity last" is that of the last metre passed.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.arrays import Array
from kilnflight.experiments.campaigns import (
    KEYS,
    CampaignKey,
    Measurement,
    counted_flights,
    from_lance,
    stack,
)
from kilnflight.project import claims
from kilnflight.scores import intervals
from kilnflight.scores.flights import (
    LAST_SHARE,
    METRES,
    FlightValues,
    outcomes,
    quartiles,
    remaining,
)
from kilnflight.scores.intervals import Interval
from kilnflight.twin.fuel import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR

Values = Mapping[CampaignKey, FlightValues]
HEAVY, PAPERS = ("wood chip", "PE granule"), ("confetti", "paper shred")
LEAST_FLIGHTS = 6  # in each campaign; claims are open with fewer
VAGUE = ("the vast majority", "only very few", "almost all")  # no number is printed
OPEN_ABOVE = ("more than", "over")  # the upper bound in flight.csv is a reading
# Measures of a fit by axis, and their columns in Table 5.18.
FIT_MEASURES = {"rmse_{}_mm": "rmse_mm", "mape_{}_percent": "mape_percent"}
FIT_MEASURES |= {"r2_{}": "r2", "r2_adjusted_{}": "r2_adjusted"}


def interval_columns(interval: Interval) -> dict[str, float]:
    """Return number, estimate, low, high as table cells; NaN for infinite ends."""
    number = sum(interval.numbers)
    known = number > 0 and np.isfinite([interval.low, interval.high])
    low, high = np.where(known, [interval.low, interval.high], np.nan).tolist()
    return {"number": number, "estimate": interval.estimate, "low": low, "high": high}


def finite(values: npt.ArrayLike) -> Array:
    """Return the finite values of an array as a flat one, (k,)."""
    array = np.asarray(values, dtype=np.float64)
    return array[np.isfinite(array)]


def median_of(values: npt.ArrayLike, generator: np.random.Generator) -> Interval:
    """Return the median of the finite values with its 95 % bootstrap interval."""
    return intervals.median_interval(finite(values), generator)


def box(times: Array) -> dict[str, float]:
    """Return a box plot of times (n,) in s, without NaN: quartiles and whiskers.

    Whiskers reach to the last value within 1.5 interquartile ranges of the box, ``outliers`` counts
    the values beyond. All are NaN without values, and ``outliers`` is 0.
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


def samples(flight_values: FlightValues) -> dict[str, Array]:
    """Return the finite values (k,) behind each outcome that is a median, by name.

    The names are those of `kilnflight.scores.flights.outcomes`. "velocity last" is empty if no
    metre is passed by a share `LAST_SHARE` of the particles.
    """
    velocity = flight_values.velocity_m_s
    metres = zip(METRES, velocity.T, strict=True)
    last = np.flatnonzero(remaining(flight_values)[0] >= 100.0 * LAST_SHARE)[-1:]
    return {f"velocity {k - 1}-{k} m (m/s)": finite(each) for k, each in metres} | {
        "velocity last (m/s)": finite(velocity[:, last]),
        "dwell median (s)": finite(flight_values.dwell_s),
        "ignition median (s)": finite(flight_values.ignition_s),
    }


def median_table(measured: Values, true: Values, generator: np.random.Generator) -> pd.DataFrame:
    """Return each campaign's measured medians beside the true ones.

    Parameters
    ----------
    measured, true
        Values by campaign; ``true`` has at least the campaigns of ``measured``.
    generator
        Of the bootstrap; its state stays as it was.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome`` as in `kilnflight.scores.flights.outcomes`,
        ``number`` of particles, ``estimate``, ``low``, ``high`` (NaN of fewer than six), ``true``
        (median of all flights in the same frames), ``true_number``, and ``covers``: whether the
        interval holds ``true`` (NA where either is unknown).
    """
    parts = {}
    for key, values in measured.items():
        ours, real = samples(values), samples(true[key])
        rows = [
            {"outcome": name, **interval_columns(median_of(ours[name], generator))}
            | {"true": quartiles(real[name])[1], "true_number": len(real[name])}
            for name in ours
        ]
        parts[key] = pd.DataFrame(rows)
    table = stack(parts)
    known = table[["low", "high", "true"]].notna().all(axis=1)
    held = table["true"].between(table["low"], table["high"]).astype("boolean")
    return table.assign(covers=held.where(known))


def interval_of(values: FlightValues, outcome: str, generator: np.random.Generator) -> Interval:
    """Return one outcome of a campaign with its 95 % interval.

    Parameters
    ----------
    values
        Measured values of the campaign.
    outcome
        One of `kilnflight.scores.flights.outcomes`, whose name ends with its unit.
    generator
        Of the bootstrap; its state stays as it was.

    Returns
    -------
    Interval
        Of medians by bootstrap, of shares in per cent by Wilson. It is infinite for all other
        outcomes, such as quartiles.
    """
    if outcome in samples(values):
        return median_of(samples(values)[outcome], generator)
    percent = float(outcomes(values)[outcome])
    counted = len(values.dwell_s if outcome.startswith("dwell") else values.ignition_s)
    if outcome.endswith("(% of ignited)"):
        counted = len(finite(values.ignition_s))
    if outcome.startswith("remaining"):  # flights lost before the metre do not count
        counted = int(remaining(values)[1][METRES.index(int(outcome.split()[1]))])
    if "%" not in outcome or not counted:
        return Interval(percent, -np.inf, np.inf, (counted,))
    share = intervals.share(round(percent / 100 * counted), counted)
    low, high = min(100 * share.low, percent), max(100 * share.high, percent)
    return Interval(percent, low, high, share.numbers)


def printed_numbers() -> pd.DataFrame:
    """Return the numbers that the thesis prints on flight and ignition (section 5.3).

    Returns
    -------
    DataFrame
        One row per fraction, pressure and number: ``fraction``, ``pressure_bar``, ``outcome`` (name
        with unit), ``printed`` (text); ``low`` and ``high``, equal for a single number, NaN where a
        bound is open. "Most within 0.3 to 0.4 s" is a share of 50 to 100 %.
    """
    table = claims.published("flight").rename(columns={"value_as_printed": "printed"})
    table = table.dropna(subset="outcome").dropna(subset=["value_low", "value_high"], how="all")
    most = table["statistic"] == "majority range"
    for side, share in (("low", 50.0), ("high", 100.0)):
        table[side] = table[f"value_{side}"].mask(most, share)
    table["fraction"] = table["fraction"].replace("all", "+".join(FRACTIONS)).str.split("+")
    table = table.explode("fraction", ignore_index=True)
    return table[[*KEYS, "outcome", "printed", "low", "high"]]


def beside_printed(values: Values, generator: np.random.Generator) -> pd.DataFrame:
    """Return `printed_numbers` beside measured ones, with 95 % intervals.

    Parameters
    ----------
    values
        Measured values by campaign; printed numbers of other campaigns are left out.
    generator
        Of the bootstrap; its state stays as it was.

    Returns
    -------
    DataFrame
        Columns of `printed_numbers`; ``measured``, ``measured_low``, ``measured_high`` in the same
        unit; ``agrees`` (True, False or None, see `agrees`).
    """
    table = printed_numbers()
    table = table[[key in values for key in table[KEYS].itertuples(index=False, name=None)]]
    keys = table[[*KEYS, "outcome"]].itertuples(index=False, name=None)
    ours = [interval_of(values[name, bar], outcome, generator) for name, bar, outcome in keys]
    ends = pd.DataFrame([interval_columns(one) for one in ours], table.index)
    table["measured"] = [one.estimate for one in ours]
    table[["measured_low", "measured_high"]] = ends.reindex(columns=["low", "high"])
    answers = map(agrees, table["low"], table["high"], table["printed"], ours)
    return table.assign(agrees=pd.Series(list(answers), table.index, object))


def agrees(low: float, high: float, text: str, ours: Interval) -> bool | None:
    """Return whether a measured outcome agrees with the print; None if open.

    It is open if the text has no number (`VAGUE`), the sample is too small for an interval,
    or the measured number is outside the bounds but its interval is not. Without a measured number
    the answer is False.

    Parameters
    ----------
    low, high
        Printed bounds; equal for a single number, NaN where open.
    text
        The printed text. After a word of `OPEN_ABOVE` the upper bound does not count.
    ours
        Measured number with its 95 % interval. The interval must hold a single printed number, as
        rounded in print; the number itself must lie within printed bounds.
    """
    if text.startswith(VAGUE):
        return None
    if not np.isfinite(ours.estimate):
        return False
    if low == high:  # a single number, as exactly as it is printed
        half = 0.5 * 10.0 ** -len(f"{low:g}".partition(".")[2])
        held = ours.low <= low + half and low - half <= ours.high
        return None if held and np.isinf(ours.low) else held
    least = -np.inf if np.isnan(low) else low
    most = np.inf if np.isnan(high) or text.startswith(OPEN_ABOVE) else high
    if least <= ours.estimate <= most:
        return True
    return None if ours.low <= most and least <= ours.high else False


def if_complete(
    flights: pd.DataFrame, answers: Mapping[str, bool | None]
) -> dict[str, bool | None]:
    """Return the answers by claim, or None for all if there are too few flights.

    All eight campaigns need `LEAST_FLIGHTS` accepted flights from the lance, so a reduced run
    decides no claim. ``flights`` are `kilnflight.tables.FLIGHTS` of all campaigns.
    """
    enough = int((counted_flights(flights).groupby(KEYS).size() >= LEAST_FLIGHTS).sum())
    whole = enough == len(FRACTIONS) * len(PRESSURES_BAR)
    return {claim: answer if whole else None for claim, answer in answers.items()}


def regression_table(tables: Measurement, generator: np.random.Generator) -> pd.DataFrame:
    """Return measures of the fits beside Table 5.18, a row per fraction and axis.

    Parameters
    ----------
    tables
        Tables of all campaigns; both pressures count together.
    generator
        Of the bootstrap; its state stays as it was.

    Returns
    -------
    DataFrame
        ``fraction``, ``axis`` (x, y, z); ``rmse_mm``, ``mape_percent``, ``r2``, ``r2_adjusted``:
        medians over the accepted trajectories from the lance; ``tracks``, their number; each
        measure with ``_published``, ``_low`` and ``_high`` (95 % interval).
    """
    fitted = from_lance(tables, "trajectories")
    printed = claims.published("table_5.18").set_index(["fraction", "axis", "measure"])["value"]
    printed = printed.rename(lambda name: name.lower().rstrip("s"), level="fraction")
    printed = printed.rename(str.lower, level="measure")
    rows = []
    for fraction in tables.trajectories["fraction"].unique():
        part = fitted[fitted["fraction"] == fraction]
        for axis in "xyz":
            fits = {name: part[column.format(axis)] for column, name in FIT_MEASURES.items()}
            row = {"fraction": fraction, "axis": axis}
            row |= {name: values.median() for name, values in fits.items()}
            row["tracks"] = len(part)
            row |= {f"{name}_published": printed[fraction.lower(), axis, name] for name in fits}
            for name, values in fits.items():
                ends = interval_columns(median_of(values, generator))
                row |= {f"{name}_{side}": ends[side] for side in ("low", "high")}
            rows.append(row)
    return pd.DataFrame(rows)
