"""Medians and shares of campaigns with 95 % intervals, beside the truth and the print.

Medians by bootstrap over particles, shares by Wilson (`kilnflight.scores.intervals`). A
velocity is that of the particles that passed the metre; "velocity last" is that of the
last metre passed.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache
from itertools import product

import numpy as np
import pandas as pd
from pandas import DataFrame, Series

from kilnflight.arrays import ArrayLike, Generator, Numbers
from kilnflight.experiments.flights.campaigns import CAMPAIGNS, KEYS, CampaignKey
from kilnflight.publication import claims
from kilnflight.scores import intervals
from kilnflight.scores.flights import (
    MEDIAN,
    NUMBER,
    FlightValues,
    Outcome,
    outcomes,
)
from kilnflight.scores.intervals import Interval
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.geometry import Geometry
from kilnflight.simulated.kiln.laws import released
from kilnflight.simulated.kiln.truth import true_flight_values

Values = Mapping[CampaignKey, FlightValues]
HEAVY = ("wood chip", "PE granule")
PAPERS = ("confetti", "paper shred")
LEAST_FLIGHTS = 6  # flights of each campaign; claims are open with fewer
# Both limits of an error were set before any flight was measured.
TOLERANCE = 0.1  # share of a median of times or velocities
SHARE_POINTS = 5.0  # percentage points of a share
PUT_IN = 4000  # particles of a run whose flights show what was put in
VERDICTS = {True: "recovered", False: "biased", None: "open"}


def interval_columns(interval: Interval) -> Numbers:
    """Return number, estimate, low, high as table cells; NaN for infinite ends."""
    row = {"number": interval.number, **interval._asdict()}
    if not np.isfinite(interval.estimate + interval.high):
        row |= {"low": np.nan, "high": np.nan}
    return row


def median_of(values: ArrayLike, generator: Generator) -> Interval:
    """Return the median of the known (finite) values, with its interval."""
    sample = np.asarray(values, float)
    return intervals.median_interval(sample[np.isfinite(sample)], generator)


def median_columns(values: ArrayLike, generator: Generator) -> Numbers:
    """Return the `interval_columns` of `median_of`."""
    return interval_columns(median_of(values, generator))


def interval_of(
    values: FlightValues, outcome: Outcome, generator: Generator
) -> Interval:
    """Return one outcome of a campaign, a median or a share, with its 95 % interval.

    The interval of an unknown share is infinite.

    Parameters
    ----------
    values
        Measured values of the campaign.
    outcome
        One of those whose ``kind`` is `MEDIAN` or `kilnflight.scores.flights.SHARE`.
    generator
        Of the bootstrap; its state stays as it was.
    """
    taken = outcome.take(values)
    if outcome.kind == MEDIAN:
        return median_of(taken, generator)
    percent, counted = taken
    if np.isnan(percent):
        return Interval(percent, low=-np.inf, high=np.inf, number=counted)
    found = intervals.share(round(percent / 100 * counted), counted)
    low = min(100 * found.low, percent)
    high = max(100 * found.high, percent)
    return Interval(percent, low, high, counted)


def printed_numbers() -> DataFrame:
    """Return the numbers that the thesis prints on flight and ignition (section 5.3).

    Returns
    -------
    DataFrame
        One row per fraction, pressure and number: ``fraction``, ``pressure_bar``,
        ``outcome`` (`Outcome.label`), ``printed`` (text); ``low`` and ``high``, equal
        for a single number, NaN where a bound is open. "Most within 0.3 to 0.4 s" is a
        share of 50 to 100 %.
    """
    names = {"value_as_printed": "printed", "value_low": "low", "value_high": "high"}
    table = claims.published("flight").rename(columns=names)
    table = table.dropna(subset="outcome").dropna(subset=["low", "high"], how="all")
    most = table["statistic"] == "majority range"
    table.loc[most, ["low", "high"]] = [50.0, 100.0]
    every = "+".join(FRACTIONS)
    table["fraction"] = table["fraction"].replace("all", every).str.split("+")
    table = table.explode("fraction", ignore_index=True)
    return table[[*KEYS, "outcome", "printed", "low", "high"]]


@cache  # the judgement of each choice needs it
def put_in(runs: tuple[CampaignKey, ...], count: int, seed: int) -> DataFrame:
    """Return every outcome of flights by the laws that were put in, beside the print.

    ``count`` particles of each run are released. The columns are those of
    `printed_numbers`, NaN where nothing is printed, and ``put_in``.
    """
    values = {
        key: outcomes(true_flight_values(released(*key, Geometry(), count, seed)))
        for key in runs
    }
    known = pd.concat(values, names=[*KEYS, "outcome"]).rename("put_in").reset_index()
    return known.merge(printed_numbers(), "left")


def recovery(
    measured: Values,
    true: Values,
    wanted: Sequence[Outcome],
    generator: Generator,
) -> DataFrame:
    """Compare measured medians and shares with what was put in and with the truth.

    Parameters
    ----------
    measured, true
        Values by campaign; ``true`` has at least the campaigns of ``measured``.
    wanted
        Outcomes; those of kind `kilnflight.scores.flights.NUMBER` are left out.
    generator
        Of the bootstrap; its state stays as it was.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome`` (its label); ``put_in`` and
        ``printed`` (text); ``true``: of the particles of this campaign; ``number`` of
        measured ones, ``measured``; ``error``: measured minus true, with its 95 %
        interval ``low`` and ``high``; ``verdict``: "recovered" if the interval lies
        within `TOLERANCE`, "biased" if it lies outside, else "open".
    """
    rows = []
    for (key, values), outcome in product(measured.items(), wanted):
        if outcome.kind == NUMBER:
            continue
        ours = interval_columns(interval_of(values, outcome, generator))
        real = outcome.estimate(true[key])
        most = SHARE_POINTS
        if outcome.kind == MEDIAN:
            most = TOLERANCE * abs(real)
        low = ours["low"] - real
        high = ours["high"] - real
        row = {
            "fraction": key[0],
            "pressure_bar": key[1],
            "outcome": outcome.label,
            "true": real,
            "number": ours["number"],
            "measured": ours["estimate"],
            "error": ours["estimate"] - real,
            "low": low,
            "high": high,
            "verdict": VERDICTS[claims.within(low, high, -most, most)],
        }
        rows.append(row)
    known = put_in(tuple(measured), PUT_IN, 0).drop_duplicates([*KEYS, "outcome"])
    known = known.drop(columns=["low", "high"]).fillna({"printed": ""})
    return known.merge(DataFrame(rows), "right")


def differences(
    measured: Values,
    true: Values,
    outcome: Outcome,
    pairs: Iterable[tuple[CampaignKey, CampaignKey]],
    generator: Generator,
) -> DataFrame:
    """Return how one outcome differs between pairs of campaigns, first minus second.

    ``measured``, ``true`` and ``generator`` are those of `recovery`. Pairs that were
    not both measured are left out.

    Returns
    -------
    DataFrame
        ``fraction`` and ``pressure_bar`` of the first, ``other`` and ``other_bar``;
        ``outcome``; the difference ``measured`` with its 95 % interval ``low`` and
        ``high`` (Newcombe), and ``true``.
    """
    rows = []
    for first, second in pairs:
        if first not in measured or second not in measured:
            continue
        one = interval_of(measured[first], outcome, generator)
        other = interval_of(measured[second], outcome, generator)
        ours = interval_columns(intervals.difference_interval(one, other))
        ends = (ours["estimate"], ours["low"], ours["high"])
        real = outcome.estimate(true[first]) - outcome.estimate(true[second])
        rows.append((*first, *second, outcome.label, *ends, real))
    names = [*KEYS, "other", "other_bar", "outcome", "measured", "low", "high", "true"]
    return DataFrame(rows, columns=names)


def ends(values: Series, form: str) -> str:
    """Return the least and the greatest value as text, "-" without values."""
    known = values.dropna()
    if known.empty:
        return "-"
    return f"{form} to {form}".format(known.min(), known.max())


def all_above(table: DataFrame) -> bool | None:
    """Return whether all `differences` are above 0; None if an interval holds 0."""
    if table.empty:
        return None
    return claims.all_of(*map(claims.beyond, table["low"], table["high"]))


def recovered(table: DataFrame) -> bool | None:
    """Return whether all rows of `recovery` are recovered; None if open or no row."""
    verdicts = set(table["verdict"])
    if "biased" in verdicts:
        return False
    return True if verdicts == {"recovered"} else None


def if_complete(
    numbers: Collection[int], answers: Mapping[str, bool | None]
) -> dict[str, bool | None]:
    """Return the answers by claim, or None for all if there are too few flights.

    ``numbers`` are the flights of each campaign. All eight campaigns need
    `LEAST_FLIGHTS`.
    """
    if len(numbers) == len(CAMPAIGNS["full"]) and min(numbers) >= LEAST_FLIGHTS:
        return dict(answers)
    return dict.fromkeys(answers)
