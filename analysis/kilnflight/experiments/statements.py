"""The published sentences on flight and ignition, as numbers and as claims.

Numbers: flight.csv.
Each number is tied to one of the `kilnflight.scores.flights.outcomes`. Which of them the
calibration may see is decided here, by campaign and quantity alone (design rule: wood chips and
confetti at 4.5 bar; velocity, remaining share, dwell time, ignited share).

A verdict is that of the criterion of the claim; which differences are beyond chance stands in
the reason. Without all campaigns nothing is decided.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from kilnflight.experiments.campaigns import (
    KEYS,
    CampaignKey,
    Measurement,
    Results,
    from_lance,
    of_campaign,
    outcome_table,
)
from kilnflight.experiments.confidence import Array, Values, group_differences, in_words
from kilnflight.project import claims
from kilnflight.scores.flights import along, place_of
from kilnflight.twin import truth
from kilnflight.twin.flight import Flights
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR

CALIBRATED, HELD_OUT, NOT_USED = "calibrated on", "held out", "same cell, not used"
FIT_CAMPAIGNS = (("wood chip", 4.5), ("confetti", 4.5))
# What one unit of misfit is at least, where a number is printed without bounds: assumptions,
# about the spread between runs that differ only by 0.5 bar.
LEAST_UNIT = {"velocity": 0.5, "remaining": 5.0, "landed": 5.0, "dwell": 0.05}
LEAST_UNIT |= {"ignited": 5.0, "penetration": 0.5}
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
LEAST_FLIGHTS = 6  # in a campaign; nothing is decided about fewer
HEAVY, PAPERS = ("wood chip", "PE granule"), ("confetti", "paper shred")
SENTENCES = {"vel-2": "wood chip", "vel-3": "confetti"}  # each about a fraction at 4.5 bar
SENTENCES |= {"vel-4": "paper shred", "vel-5": "PE granule"}

CampaignPairs = Sequence[tuple[CampaignKey, CampaignKey]]
Evidence = dict[str, float | pd.Series | Mapping[str, bool]]


def outcome_of(row: pd.Series) -> str:
    """Return the name of the outcome answering a row of flight.csv; empty if none."""
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
    if (fraction, pressure_bar) not in FIT_CAMPAIGNS:
        return HELD_OUT
    used = outcome.startswith(("velocity", "remaining", "dwell")) or outcome == "ignited (%)"
    return CALIBRATED if used else NOT_USED


def statements() -> pd.DataFrame:
    """Return numbers of flight.csv with an outcome, a row per fraction and pressure.

    A sentence about several fractions becomes one row for each. "Most within 0.3 to 0.4 s"
    is read as a share of at least 50 %.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome``, ``printed``, ``low``, ``high`` (NaN: open),
        ``use`` (`CALIBRATED`, `HELD_OUT` or `NOT_USED`).
    """
    table = claims.published("flight", as_printed=True)
    table["outcome"] = [outcome_of(row) for _, row in table.iterrows()]
    number = (table["value_low"] != "") | (table["value_high"] != "")
    table = table[(table["outcome"] != "") & number].copy()
    most = table["statistic"] == "majority range"
    for side, share in (("low", 50.0), ("high", 100.0)):
        table[side] = pd.to_numeric(table[f"value_{side}"]).mask(most, share)
    table["fraction"] = table["fraction"].replace("all", "+".join(FRACTIONS)).str.split("+")
    table = table.explode("fraction", ignore_index=True).astype({"pressure_bar": float})
    columns = [*KEYS, "outcome"]
    table["use"] = [use_of(*row) for row in table[columns].itertuples(index=False)]
    table = table.rename(columns={"value_as_printed": "printed"})
    return table[[*columns, "printed", "low", "high", "use"]]


def calibration_targets() -> pd.DataFrame:
    """Return the statements that the calibration may see; it reads no others."""
    every = statements()
    return every[every["use"] == CALIBRATED].reset_index(drop=True)


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


def true_outcomes(flights: Mapping[CampaignKey, Flights]) -> pd.DataFrame:
    """Return the `outcome_table` of flights of the twin, as they truly are."""
    return outcome_table({key: truth.true_flight_values(each) for key, each in flights.items()})


def answer(rows: pd.DataFrame, outcomes: pd.DataFrame) -> pd.Series:
    """Return the value of each statement's outcome from an `outcome_table`."""
    table = outcomes.set_index(KEYS)
    places = rows[[*KEYS, "outcome"]].itertuples(index=False, name=None)
    values = [table.loc[(fraction, bar), name] for fraction, bar, name in places]
    return pd.Series(values, index=rows.index, dtype=np.float64)


def comparison(rows: pd.DataFrame, answers: Mapping[str, pd.Series]) -> pd.DataFrame:
    """Return every statement with several versions' answers, and if they are within."""
    table = rows[[*KEYS, "outcome", "printed", "low", "high"]]
    names = {version: version.replace(" ", "_") for version in answers}
    table = table.assign(**{names[key]: values.round(3) for key, values in answers.items()})
    for version, values in answers.items():
        off = misfits(rows, values)
        table[f"{names[version]}_within"] = [f"off by {x:.1f}" if x else "yes" for x in off]
    return table.assign(use=rows["use"])


def along_the_way(outcomes: Mapping[str, pd.DataFrame], rows: pd.DataFrame) -> pd.DataFrame:
    """Return velocity and remaining share on the way, by version and as published.

    Parameters
    ----------
    outcomes
        By version: an `outcome_table`.
    rows
        The statements.

    Returns
    -------
    DataFrame
        ``version``, ``pressure_bar``, ``quantity`` ("velocity" in m/s, "remaining" in %),
        ``fraction``, ``distance_m``; ``value``; ``low``, ``high`` of version "published".
    """
    ours = {version: along(table) for version, table in outcomes.items()}
    way = pd.concat(ours, names=["version"]).reset_index("version")
    places = [place_of(name) for name in rows["outcome"]]
    printed = rows.assign(quantity=[q for q, _ in places], distance_m=[d for _, d in places])
    printed = printed.dropna(subset="distance_m").assign(version="published", value=np.nan)
    columns = ["version", "pressure_bar", "quantity", "fraction"]
    table = pd.concat([way, printed]).sort_values(columns, kind="stable", ignore_index=True)
    return table[[*columns, "distance_m", "value", "low", "high"]]


def beside_published(measured: Values, true: Values, quantities: Sequence[str]) -> pd.DataFrame:
    """Return printed numbers of some quantities beside truth and measurement.

    Parameters
    ----------
    measured, true
        By campaign.
    quantities
        First words of the outcomes, such as "dwell".

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome``, ``printed``, ``low``, ``high``, ``true``,
        ``measured``, and what the calibration used (``use``).
    """
    rows = statements().drop_duplicates([*KEYS, "outcome", "printed"])
    keys = rows[KEYS].itertuples(index=False, name=None)
    rows = rows[[key in measured for key in keys]]
    rows = rows[rows["outcome"].str.split(" ").str[0].isin(quantities)]
    values = {"true": true, "measured": measured}
    answers = {name: answer(rows, outcome_table(each)) for name, each in values.items()}
    return rows.drop(columns="use").assign(**answers, use=rows["use"])


def conditions(published: pd.DataFrame, key: CampaignKey) -> dict[str, bool]:
    """Return whether the measurement agrees with each printed number of a campaign.

    Within the printed bounds; where one number is printed, within the unit of `LEAST_UNIT`.
    """
    rows = of_campaign(published, key)
    units = misfits(rows, rows["measured"])
    agreement: dict[str, bool] = {}
    for row, off in zip(rows.to_dict("records"), units, strict=True):
        allowed = 1.0 if row["low"] == row["high"] else 0.0
        value = f"{row['measured']:.3g} [{row['low']:g}, {row['high']:g}]"
        agreement[f"{row['outcome']} at {key[1]} bar {value}"] = bool(off <= allowed)
    return agreement or {"nothing measured": False}


def judge_all(
    tables: Measurement,
    values: Mapping[str, float | pd.Series | Mapping[str, bool]],
    note: str = "",
    resolved: Mapping[str, str] | None = None,
) -> list[claims.Verdict]:
    """Return verdicts on claims about all eight campaigns.

    Undecidable if flights are missing.

    Parameters
    ----------
    tables
        The campaigns.
    values
        By claim: what `kilnflight.project.claims.judge` asks for.
    note
        What a reader must know beside the verdicts.
    resolved
        By claim: which differences are beyond chance (`confidence.in_words`). It stands in the
        reason; the verdict is that of the criterion, on the numbers as they are.
    """
    counted = tables.flights[tables.flights["from_lance"]].groupby(KEYS).size()
    missing = len(FRACTIONS) * len(PRESSURES_BAR) - int((counted >= LEAST_FLIGHTS).sum())
    if missing:
        reason = (
            f"fewer than {LEAST_FLIGHTS} flights in {missing} of the eight campaigns at this scale"
        )
        return [claims.undecidable(name, reason) for name in values]
    notes = {name: "; ".join(filter(None, [note, (resolved or {}).get(name)])) for name in values}
    return [claims.judge(name, value, note=notes[name]) for name, value in values.items()]


def by_pressure(values: Values, outcome: str) -> pd.DataFrame:
    """Return an outcome by fraction (rows) and pressure (columns)."""
    return outcome_table(values).set_index(KEYS)[outcome].unstack()


def dwell_verdicts(results: Results, generator: np.random.Generator) -> list[claims.Verdict]:
    """Return the verdicts on dwell times (section 5.3.1)."""
    values, (names, bars) = results.measured, _axes(results.measured)
    median = by_pressure(values, "dwell median (s)")
    order = {bar: median[bar].dropna().sort_values().index.tolist() for bar in bars}
    ranks = {f"{bar} bar: {order[bar][:1]}": order[bar][:1] == ["wood chip"] for bar in bars}
    longest = order[bars[0]][-1:]
    shorter = (median[bars[-1]] / median[bars[0]])[names[-1]]
    granules = {f"longest at 4.5 bar: {longest}": longest == ["PE granule"]}
    granules[f"{names[-1]} at 5 bar {shorter:.2f} of that"] = bool(shorter < 0.9)
    numbers, most = outcome_table(values).set_index(KEYS), {}
    for name, limits in zip(names, ["0.3-0.4", "> 0.4", "> 0.4", "0.3-0.4"], strict=False):
        share = numbers[f"dwell {limits} s (%)"].get((name, 5.0), np.nan)
        most[f"{name} {limits} s {share:.0f} %"] = bool(share > 50)

    others, last = [name for name in names if name != "wood chip"], ("PE granule", 4.5)
    first = [(("wood chip", bar), (name, bar)) for bar in bars for name in others]
    longer = [(last, (name, 4.5)) for name in names if name != "PE granule"]
    pairs = {"dwell-2": first, "dwell-3": [*longer, (last, ("PE granule", 5.0))]}
    times = {key: each.dwell_s for key, each in values.items()}
    evidence: Evidence = {
        "dwell-1": median[bars[0]],
        "dwell-2": ranks,
        "dwell-3": granules,
        "dwell-4": most,
    }
    note = (
        "lost flights count with the time they were seen; much shorter: by over a tenth, a reading"
    )
    return judge_all(results.tables, evidence, note, _resolved(times, pairs, generator))


def _axes(values: Values) -> tuple[list[str], list[float]]:
    """Return the fractions in their order, and the pressures from low to high."""
    return list(dict.fromkeys(name for name, _ in values)), sorted({bar for _, bar in values})


def _resolved(
    values: Mapping[CampaignKey, Array],
    pairs: Mapping[str, CampaignPairs],
    generator: np.random.Generator,
) -> dict[str, str]:
    """Return by claim which differences of medians are beyond chance."""
    return {
        claim: in_words(group_differences(values, each, generator), "medians")
        for claim, each in pairs.items()
    }


def velocity_verdicts(
    results: Results, published: pd.DataFrame, generator: np.random.Generator
) -> list[claims.Verdict]:
    """Return the verdicts on velocities; ``published`` from `beside_published`."""
    names, bars = _axes(results.measured)
    median = by_pressure(results.measured, "velocity 0-1 m (m/s)")
    order = {}
    for bar in bars:
        speed = median[bar].reindex([*HEAVY, *names])
        heavy, light = speed.iloc[:2].min(), speed.drop(list(HEAVY)).max()
        order[f"{bar} bar: heavy {heavy:.1f}, papers {light:.1f} m/s"] = bool(heavy > light)
    ratio = (median[bars[-1]] / median[bars[0]]).rename("ratio")
    papers = [name for name in names if name not in HEAVY]
    pairs = {
        "vel-1": [((a, bar), (b, bar)) for bar in bars for a in HEAVY for b in papers],
        "vel-6": [((name, 5.0), (name, 4.5)) for name in names],
    }
    speeds = {key: each.velocity_m_s[:, 0] for key, each in results.measured.items()}
    evidence: Evidence = {"vel-1": order, "vel-6": ratio}
    evidence |= {claim: conditions(published, (name, 4.5)) for claim, name in SENTENCES.items()}
    note = "medians measured on the twin; bounds of the printed sentences"
    verdicts = judge_all(results.tables, evidence, note, _resolved(speeds, pairs, generator))
    fit = "the twin's flights were fitted to this campaign"
    return [claims.fitted(v, fit) if v.id in ("vel-2", "vel-3") else v for v in verdicts]


def regression_verdicts(
    tables: Measurement,
    table: pd.DataFrame,
    by_order: pd.DataFrame,
    generator: np.random.Generator,
) -> list[claims.Verdict]:
    """Return the verdicts on the regression.

    Parameters
    ----------
    tables
        The campaigns.
    table
        `confidence.regression_table`.
    by_order
        Medians of the measures by ``order`` and ``axis``.
    generator
        Of the bootstrap.
    """
    names = list(dict.fromkeys(table["fraction"]))
    wide = table.pivot(index="fraction", columns="axis").reindex(names)
    rmse, mape, r2 = wide["rmse_mm"], wide["mape_percent"], wide["r2"]
    ratio = (rmse["z"] / np.fmax(rmse["x"], rmse["y"])).rename("ratio")
    lowest, least = {}, {}
    for name in names:
        lowest[f"{name} z {mape.z[name]:.3g} %"] = bool(mape.z[name] == mape.loc[name].min())
        least[f"{name} z {r2.z[name]:.2g}"] = bool(r2.z[name] == r2.loc[name].min())
    worst = r2["z"].dropna().sort_values().index[:1].tolist()
    least[f"lowest of all: {worst}"] = worst == ["paper shred"]
    pairs = [((name, "z"), (name, axis)) for name in names for axis in "xy"]
    worse = [(("paper shred", "z"), (name, "z")) for name in names if name != "paper shred"]
    compared = {"fit-2": ("mape_{}_percent", pairs), "fit-3": ("r2_{}", pairs + worse)}
    resolved = {}
    for claim, (column, each) in compared.items():
        groups = _by_axis(tables, column)
        resolved[claim] = in_words(group_differences(groups, each, generator), "medians")
    evidence: Evidence = {"fit-1": ratio, "fit-2": lowest, "fit-3": least}
    evidence["fit-4"] = order_gain(by_order)
    note = "trajectories from the lance; the scatter of the depth is an input"
    return judge_all(tables, evidence, note, resolved)


def _by_axis(tables: Measurement, column: str) -> dict[tuple[str, object], Array]:
    """Return a measure of the trajectories from the lance by fraction and axis."""
    return {
        (str(name), axis): part[column.format(axis)].to_numpy()
        for name, part in from_lance(tables, "trajectories").groupby("fraction")
        for axis in "xyz"
    }


def order_gain(by_order: pd.DataFrame) -> float:
    """Return the rise of mean adjusted R2 from order 6 to order 7; NaN if unknown."""
    mean = by_order.groupby("order")["r2_adjusted"].mean()
    return float(mean.get(7, float("nan")) - mean.get(6, float("nan")))
