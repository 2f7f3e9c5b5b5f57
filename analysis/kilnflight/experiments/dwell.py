"""Dwell times: which flights are complete, their medians, and the share that still flies.

The flight duration ends "by landing or complete burning out" (section 5.3.1 of the thesis). Of
particles that "cannot be fully tracked" flight and burning "cannot be analyzed" (A.1), and of
those that land out of view the "actual flight time is longer than computed". So a dwell time is
that of a complete flight. A lost one is known to last longer than it was seen: it is censored
in the curve of Kaplan and Meier and in no median or box.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from kilnflight import kiln, regression
from kilnflight.experiments.accuracy import CASES, NOT_MEASURED, NOT_WHOLE
from kilnflight.experiments.campaigns import (
    KEYS,
    REASONS,
    CampaignKey,
    Measurement,
    campaign_keys,
    counted_flights,
    of_campaign,
    rows_by_campaign,
    stack,
)
from kilnflight.experiments.confidence import Values, covers, interval_columns, median_of
from kilnflight.flight import LANDED, LOST
from kilnflight.scores.flights import censored_median, quartiles, still_flying
from kilnflight.tables import TRAJECTORIES


def flights_and_particles(tables: Measurement, both: pd.DataFrame) -> pd.DataFrame:
    """Return the counted flights and whole true flights, matches side by side.

    Parameters
    ----------
    tables
        The campaigns.
    both
        `kilnflight.experiments.accuracy.compare_campaigns`.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``track``, ``measured_s`` (dwell time of a complete
        flight), ``seen_s`` (how long a lost one was seen), ``ending``, ``ignition_s``;
        ``particle`` (-1: of no whole flight), ``true_s``, ``true_ending``,
        ``true_ignition_s``; empty where there is none.
    """
    counted = counted_flights(tables.flights)
    lost = counted["ending"] == LOST
    flights = counted.assign(
        track=counted["particle"],
        measured_s=counted["dwell_s"].mask(lost),
        seen_s=(counted["last_s"] - counted["t0_s"]).where(lost),
    )
    ours = [*KEYS, "track", "measured_s", "seen_s", "ending", "ignition_s"]
    real = [*KEYS, "track", "particle", "true_s", "true_ending", "true_ignition_s"]
    true = both.rename(columns={"true_dwell_s": "true_s"})
    data = flights[ours].merge(true[real], how="outer", on=[*KEYS, "track"])
    return data.fillna({"particle": -1}).astype({"particle": int})


def ending_table(data: pd.DataFrame) -> pd.DataFrame:
    """Return how flights from the lance end by how they truly do (Fig. 5.18).

    Parameters
    ----------
    data
        `flights_and_particles`.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``true`` (`NOT_WHOLE` for false flights, further tracks of
        a particle and those that the recording cuts); ``landed unlit``, ``landed burning``,
        ``burnt out`` and ``lost`` as measured, and ``not measured``.
    """
    measured = _cases(data["ending"], data["ignition_s"]).fillna(NOT_MEASURED)
    true = _cases(data["true_ending"], data["true_ignition_s"])
    true = true.where(data["particle"] >= 0, NOT_WHOLE).rename("true")
    table = pd.crosstab([data["fraction"], data["pressure_bar"], true], measured)
    columns = [*CASES, LOST, NOT_MEASURED]
    return table.reindex(columns=columns, fill_value=0).rename_axis(columns=None).reset_index()


def _cases(ending: pd.Series, ignition_s: pd.Series) -> pd.Series:
    """Return `CASES` of endings, by whether a particle burnt; other endings stay."""
    landed = ignition_s.notna().map({False: CASES[0], True: CASES[1]})
    return ending.where(ending != LANDED, landed)


def count_flights(tables: Measurement, values: Values) -> pd.DataFrame:
    """Return how many flights from the lance are complete, lost, or refused and why.

    A row for each campaign of ``values``, also of one without flights.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``from_lance``, `CASES` (the complete ones), ``lost``,
        and ``refused:`` each of `REASONS`. The last columns sum up to ``from_lance``.
    """
    starting, rows = tables.flights[tables.flights["from_lance"]], {}
    for key in values:
        flights = of_campaign(starting, key)
        counted = counted_flights(flights)
        ends = _cases(counted["ending"], counted["ignition_s"])
        row = {"from_lance": len(flights)}
        row |= {name: int((ends == name).sum()) for name in (*CASES, LOST)}
        row |= {f"refused: {why}": int((flights["refused"] == why).sum()) for why in REASONS}
        rows[key] = row
    return rows_by_campaign(rows)


def medians(
    measured: Values, followed: Values, true: Values, generator: np.random.Generator
) -> pd.DataFrame:
    """Return the median dwell times of campaigns, of complete flights and with lost ones.

    Parameters
    ----------
    measured
        By campaign.
    followed
        True flights as far as a person could follow them (`campaigns.followed_values`).
    true
        Of all flights of the twin.
    generator
        Of the bootstrap over flights.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``; ``complete`` and ``lost`` flights; ``measured_s`` with
        ``low`` and ``high``: median of complete ones and 95 % interval; ``with_lost_s`` with its
        bounds: lost ones censored (`censored_median`); the same two of those that could be
        followed, ``followed_s`` and ``followed_with_lost_s``; ``true_s`` of all ``true_number``;
        ``covers``, ``covers_with_lost``: whether the interval of the complete flights, and that
        with lost ones, holds ``true_s``. Empty where nothing is known.
    """
    rows: dict[CampaignKey, dict[str, float]] = {}
    for key, values in measured.items():
        median = interval_columns(median_of(values.dwell_s, generator))
        row: dict[str, float] = {"complete": len(values.dwell_s), "lost": len(values.censored_s)}
        row |= {"measured_s": median["estimate"], "low": median["low"], "high": median["high"]}
        names = {"estimate": "with_lost_s", "low": "with_lost_low", "high": "with_lost_high"}
        with_lost = interval_columns(censored_median(values))
        row |= {name: with_lost[column] for column, name in names.items()}
        row["followed_complete"] = len(followed[key].dwell_s)
        row["followed_lost"] = len(followed[key].censored_s)
        row["followed_s"] = float(quartiles(followed[key].dwell_s)[1])
        row["followed_with_lost_s"] = censored_median(followed[key]).estimate
        row["true_s"] = float(quartiles(true[key].dwell_s)[1])
        row["true_number"] = len(true[key].dwell_s)
        rows[key] = row
    table = rows_by_campaign(rows)
    names = {"with_lost_low": "low", "with_lost_high": "high"}
    censored = table[["true_s", *names]].rename(columns=names)
    return table.assign(covers=covers(table, "true_s"), covers_with_lost=covers(censored, "true_s"))


def curves(sources: Mapping[str, Values]) -> pd.DataFrame:
    """Return `still_flying` of sources and campaigns below each other.

    Returns
    -------
    DataFrame
        ``source``, ``fraction``, ``pressure_bar``, ``time_s``, ``flying``, ``low``, ``high``.
    """
    tables = {
        source: stack({key: still_flying(each) for key, each in values.items()})
        for source, values in sources.items()
    }
    return pd.concat(tables, names=["source"]).reset_index("source").reset_index(drop=True)


def complete_only(tables: Measurement) -> Measurement:
    """Return campaigns without their lost flights.

    The other reading for velocities: A.1 keeps "a few complete trajectories" of the shreds "for
    subsequent analysis of flight behavior". Section 5.3.1 speaks of those that remain in a metre.
    """
    return tables._replace(flights=tables.flights[tables.flights["ending"] != LOST])


def nothing_refused(tables: Measurement) -> Measurement:
    """Return campaigns whose flights all count, also those that no particle flies.

    The thesis refuses none (section 5.3.1, Fig. 5.23).
    """
    flights, parts = tables.flights.assign(refused=""), {}
    for key in campaign_keys(flights):
        fits = regression.fits(of_campaign(tables.trajectories, key)[TRAJECTORIES.names])
        parts[key] = kiln.slices_from(of_campaign(flights, key), fits)
    return tables._replace(flights=flights, slices=stack(parts))


def describe(table: pd.DataFrame) -> str:
    """Describe `count_flights` in a sentence."""
    refused = int(table.filter(like="refused").to_numpy().sum())
    total, lost = int(table["from_lance"].sum()), int(table[LOST].sum())
    complete = int(table[list(CASES)].to_numpy().sum())
    return (
        f"Of {total} flights from the lance {complete} are complete, {lost} lost and {refused} "
        "refused."
    )


def describe_refused(table: pd.DataFrame) -> str:
    """Describe where refusing selects most, from `accuracy.whom_refused`."""
    wide = table.pivot(index="fraction", columns="refused", values="true_dwell_s").dropna()
    if not len(wide):
        return "Whom refusing takes is not known: too few flights."
    apart = np.log((wide[True] / wide[False]).to_numpy(np.float64))
    name = wide.index[int(np.argmax(np.abs(apart)))]
    counted, refused = wide.loc[[name]].to_numpy()[0]
    return (
        f"Refusing shifts {name} flights most: the refused ones truly last {refused:.2f} s, "
        f"the others {counted:.2f} s (medians)."
    )
