"""Medians and shares of campaigns with 95 % intervals, beside the truth and what is
printed.

Medians by bootstrap over particles, shares by Wilson (`kilnflight.scores.intervals`). A
velocity is that of the particles that passed the metre; "velocity last" is that of the
last metre passed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from functools import cache

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.arrays import Array
from kilnflight.experiments.flights.campaigns import KEYS, CampaignKey
from kilnflight.publication import claims
from kilnflight.scores import intervals
from kilnflight.scores.flights import (
    LAST_SHARE,
    METRES,
    FlightValues,
    outcomes,
    remaining,
)
from kilnflight.scores.intervals import Interval
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.geometry import Geometry
from kilnflight.simulated.kiln.laws import released
from kilnflight.simulated.kiln.scenes import PRESSURES_BAR
from kilnflight.simulated.kiln.truth import true_flight_values

Values = Mapping[CampaignKey, FlightValues]
HEAVY = ("wood chip", "PE granule")
PAPERS = ("confetti", "paper shred")
LEAST_FLIGHTS = 6  # in each campaign; claims are open with fewer
TOLERANCE = (
    0.1  # of a median of times or velocities; set before any flight was measured
)
SHARE_POINTS = 5.0  # percentage points of a share; likewise
PUT_IN = 4000  # particles of a run whose flights show what was put in
VERDICTS: dict[bool | None, str] = {True: "recovered", False: "biased", None: "open"}
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


def samples(flight_values: FlightValues) -> dict[str, Array]:
    """Return the finite values (k,) behind each outcome that is a median, by name.

    The names are those of `kilnflight.scores.flights.outcomes`. "velocity last" is
    empty if no metre is passed by a share `LAST_SHARE` of the particles.
    """
    velocity = flight_values.velocity_m_s
    metres = zip(METRES, velocity.T, strict=True)
    last = np.flatnonzero(remaining(flight_values)[0] >= 100.0 * LAST_SHARE)[-1:]
    return {f"velocity {k - 1}-{k} m (m/s)": finite(each) for k, each in metres} | {
        "velocity last (m/s)": finite(velocity[:, last]),
        "dwell median (s)": finite(flight_values.dwell_s),
        "ignition median (s)": finite(flight_values.ignition_s),
    }


def interval_of(
    values: FlightValues, outcome: str, generator: np.random.Generator
) -> Interval:
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
        Of medians by bootstrap, of shares in per cent by Wilson. It is infinite for all
        other outcomes, such as quartiles.
    """
    if outcome in samples(values):
        return median_of(samples(values)[outcome], generator)
    percent = float(outcomes(values)[outcome])
    counted = len(values.dwell_s if outcome.startswith("dwell") else values.ignition_s)
    if outcome.endswith("(% of ignited)"):
        counted = len(finite(values.ignition_s))
    if outcome.startswith("remaining"):  # flights lost before the metre do not count
        counted = int(remaining(values)[1][METRES.index(int(outcome.split()[1]))])
    if "%" not in outcome or not counted or np.isnan(percent):
        return Interval(percent, -np.inf, np.inf, (counted,))
    share = intervals.share(round(percent / 100 * counted), counted)
    low = min(100 * share.low, percent)
    high = max(100 * share.high, percent)
    return Interval(percent, low, high, share.numbers)


def printed_numbers() -> pd.DataFrame:
    """Return the numbers that the thesis prints on flight and ignition (section 5.3).

    Returns
    -------
    DataFrame
        One row per fraction, pressure and number: ``fraction``, ``pressure_bar``,
        ``outcome`` (name with unit), ``printed`` (text); ``low`` and ``high``, equal
        for a single number, NaN where a bound is open. "Most within 0.3 to 0.4 s" is a
        share of 50 to 100 %.
    """
    table = claims.published("flight").rename(columns={"value_as_printed": "printed"})
    table = table.dropna(subset="outcome").dropna(
        subset=["value_low", "value_high"], how="all"
    )
    most = table["statistic"] == "majority range"
    for side, share in (("low", 50.0), ("high", 100.0)):
        table[side] = table[f"value_{side}"].mask(most, share)
    table["fraction"] = (
        table["fraction"].replace("all", "+".join(FRACTIONS)).str.split("+")
    )
    table = table.explode("fraction", ignore_index=True)
    return table[[*KEYS, "outcome", "printed", "low", "high"]]


@cache  # the judgement of each choice needs it
def put_in(runs: tuple[CampaignKey, ...], count: int, seed: int) -> pd.DataFrame:
    """Return every outcome of flights by the laws that were put in, beside
    `printed_numbers`.

    ``count`` particles of each run are released. The columns are those of
    `printed_numbers`, NaN where nothing is printed, and ``put_in``.
    """
    values = {
        key: outcomes(true_flight_values(released(*key, Geometry(), count, seed)))
        for key in runs
    }
    known = pd.concat(values, names=[*KEYS, "outcome"]).rename("put_in").reset_index()
    return known.merge(printed_numbers(), "left", [*KEYS, "outcome"])


def recovery(
    measured: Values, true: Values, start: str, generator: np.random.Generator
) -> pd.DataFrame:
    """Compare measured medians and shares with what was put in and with the truth.

    Parameters
    ----------
    measured, true
        Values by campaign; ``true`` has at least the campaigns of ``measured``.
    start
        First letters of the outcomes (`kilnflight.scores.flights.outcomes`), a regular
        expression.
    generator
        Of the bootstrap; its state stays as it was.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome``; ``put_in`` and ``printed`` (text);
        ``true``: of the particles of this campaign; ``number`` of measured ones,
        ``measured``; ``error``: measured minus true, with its 95 % interval ``low`` and
        ``high``; ``verdict``: "recovered" if the interval lies within `TOLERANCE`,
        "biased" if it lies outside, else "open".
    """
    rows = []
    for key, values in measured.items():
        known = outcomes(true[key]).filter(regex=f"^({start})")
        for name in known.index[
            known.index.str.contains("%") | known.index.isin(samples(values))
        ]:
            ours = interval_of(values, name, generator)
            most = SHARE_POINTS if "%" in name else TOLERANCE * abs(known[name])
            low = ours.low - known[name]
            high = ours.high - known[name]
            answer = (
                claims.within(low, high, -most, most) if ours.numbers != (0,) else None
            )
            numbers = (
                known[name],
                sum(ours.numbers),
                ours.estimate,
                ours.estimate - known[name],
            )
            rows.append((*key, name, *numbers, low, high, VERDICTS[answer]))
    told = put_in(tuple(measured), PUT_IN, 0).drop_duplicates([*KEYS, "outcome"])
    told = told.drop(columns=["low", "high"]).fillna({"printed": ""})
    rest = ["true", "number", "measured", "error", "low", "high", "verdict"]
    table = pd.DataFrame(rows, columns=[*KEYS, "outcome", *rest]).replace(
        [np.inf, -np.inf], np.nan
    )
    return told.merge(table, "right", [*KEYS, "outcome"])


def differences(
    measured: Values,
    true: Values,
    outcome: str,
    pairs: Iterable[tuple[CampaignKey, CampaignKey]],
    generator: np.random.Generator,
) -> pd.DataFrame:
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
    for pair in pairs:
        if set(pair) <= set(measured):
            found = (interval_of(measured[key], outcome, generator) for key in pair)
            ends = list(
                interval_columns(intervals.difference_interval(*found)).values()
            )[1:]
            real = [float(outcomes(true[key])[outcome]) for key in pair]
            rows.append((*pair[0], *pair[1], outcome, *ends, real[0] - real[1]))
    names = [*KEYS, "other", "other_bar", "outcome", "measured", "low", "high", "true"]
    return pd.DataFrame(rows, columns=names)


def ends(values: pd.Series, form: str) -> str:
    """Return the least and the greatest value as text, "-" without values."""
    known = values.dropna()
    return f"{form} to {form}".format(known.min(), known.max()) if len(known) else "-"


def all_above(table: pd.DataFrame) -> bool | None:
    """Return whether all `differences` are above 0; None if an interval holds 0."""
    return (
        claims.all_of(*map(claims.beyond, table["low"], table["high"]))
        if len(table)
        else None
    )


def recovered(table: pd.DataFrame, **where: object) -> bool | None:
    """Return whether all rows of `recovery` with the given cells are recovered; None if
    open.
    """
    table = table[(table[list(where)] == pd.Series(where)).all(axis=1)]
    answers = {verdict: answer for answer, verdict in VERDICTS.items()}
    return (
        None
        if table.empty
        else claims.all_of(*table["verdict"].map(answers).replace({np.nan: None}))
    )


def if_complete(
    numbers: Collection[int], answers: Mapping[str, bool | None]
) -> dict[str, bool | None]:
    """Return the answers by claim, or None for all if there are too few flights.

    ``numbers`` are the flights of each campaign. All eight campaigns need
    `LEAST_FLIGHTS`.
    """
    whole = (
        len(numbers) == len(FRACTIONS) * len(PRESSURES_BAR)
        and min(numbers) >= LEAST_FLIGHTS
    )
    return {claim: answer if whole else None for claim, answer in answers.items()}
