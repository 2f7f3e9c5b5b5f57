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
    of_campaign,
    outcome_table,
)
from kilnflight.experiments.confidence import Values, interval_of
from kilnflight.project import claims
from kilnflight.scores.flights import along, place_of
from kilnflight.scores.intervals import Interval
from kilnflight.twin import truth
from kilnflight.twin.flight import Flights
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR

IGNITED, EARLY = "ignited (%)", "ignited < 0.1 s (%)"
EARLY_OF_IGNITED = "ignited < 0.1 s (% of ignited)"
CALIBRATED, HELD_OUT, NOT_USED = "calibrated on", "held out", "same cell, not used"
BY_LEVEL = "by level only"
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
    ("ignited", "", "percent"): IGNITED,
    ("ignited", "<0.1 s", "percent"): EARLY,
    ("ignited", "<0.2 s", "share"): "ignited < 0.2 s (% of ignited)",
    ("ignited", "<0.4 s", "share"): "ignited < 0.4 s (% of ignited)",
    ("ignited", "0.2-0.3 s", "share"): "ignited 0.2-0.3 s (% of ignited)",
    ("CFD penetration", "", "majority"): "penetration (m)",
    ("CFD penetration", "", "most"): "penetration (m)",
}
# Sentences that say more or less than another velocity (m/s), with pressure and metre of that one.
# Their bounds are the printed level of the other.
COMPARED = {
    ("wood chip", 5.0, "velocity 0-1 m (m/s)"): (4.5, "velocity 0-1 m (m/s)"),
    ("confetti", 4.5, "velocity 1-2 m (m/s)"): (4.5, "velocity 0-1 m (m/s)"),
    ("paper shred", 4.5, "velocity 2-3 m (m/s)"): (4.5, "velocity 1-2 m (m/s)"),
    ("paper shred", 5.0, "velocity 1-2 m (m/s)"): (5.0, "velocity 0-1 m (m/s)"),
    ("PE granule", 4.5, "velocity 2-3 m (m/s)"): (4.5, "velocity 1-2 m (m/s)"),
    ("PE granule", 5.0, "velocity 0-1 m (m/s)"): (4.5, "velocity 0-1 m (m/s)"),
}
LEAST_FLIGHTS = 6  # in a campaign; nothing is decided about fewer
VAGUE = ("the vast majority", "only very few", "almost all")  # printed without a number
HEAVY, PAPERS = ("wood chip", "PE granule"), ("confetti", "paper shred")
Measured = float | pd.Series | Mapping[str, bool | None]
Evidence = dict[str, Measured]


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
    is read as a share of at least 50 %. A share "of all (or of ignited)" becomes two rows.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``outcome``, ``printed``, ``low``, ``high`` (NaN: open),
        ``use`` (`CALIBRATED`, `HELD_OUT` or `NOT_USED`).
    """
    table = claims.published("flight", as_printed=True)
    table["outcome"] = [outcome_of(row) for _, row in table.iterrows()]
    either = table[table["statistic"].str.contains("or of ignited")]
    table = pd.concat([table, either.assign(outcome=EARLY_OF_IGNITED)]).sort_index(kind="stable")
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


def against_its_words(rows: pd.DataFrame, outcomes: pd.DataFrame) -> pd.Series:
    """Return which statements compare two velocities (`COMPARED`) that stand the other way round.

    ``outcomes`` is the `outcome_table` of one version.
    """
    table, wrong = outcomes.set_index(KEYS), []
    for fraction, bar, outcome, low in rows[[*KEYS, "outcome", "low"]].itertuples(index=False):
        other = COMPARED.get((fraction, bar, outcome))
        if other is None or np.isnan(table.loc[(fraction, bar), outcome]):
            wrong.append(False)
            continue
        rise = table.loc[(fraction, bar), outcome] - table.loc[(fraction, other[0]), other[1]]
        # "increases" has the other's level as lower bound, "decreases" as upper one
        wrong.append(bool(rise < 0 if low > 0 else rise > 0))
    return pd.Series(wrong, index=rows.index)


def comparison(
    rows: pd.DataFrame, answers: Mapping[str, pd.Series], against: Mapping[str, pd.Series]
) -> pd.DataFrame:
    """Return every statement with several versions' answers, and if they are within.

    ``against`` is `against_its_words` by version; what then is within is so "by level only".
    """
    table = rows[[*KEYS, "outcome", "printed", "low", "high"]]
    names = {version: version.replace(" ", "_") for version in answers}
    table = table.assign(**{names[key]: values.round(3) for key, values in answers.items()})
    for version, values in answers.items():
        off = misfits(rows, values)
        held = np.where(against[version], BY_LEVEL, "yes")
        table[f"{names[version]}_within"] = [
            f"off by {x:.1f}" if x else word for x, word in zip(off, held, strict=True)
        ]
    return table.assign(use=rows["use"])


def held_by_campaign(rows: pd.DataFrame, units: Mapping[str, pd.Series]) -> pd.DataFrame:
    """Return how many statements hold, and the median misfit, by campaign and quantity.

    Parameters
    ----------
    rows
        The statements.
    units
        By version: `misfits`.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``quantity``, ``use``, ``statements`` (how many); for each
        version ``*_hold`` and ``*_misfit``.
    """
    keys = [*KEYS, "quantity", "use"]
    table = rows[[*KEYS, "use"]].assign(
        quantity=rows["outcome"].str.split(" ").str[0], statements=1
    )
    kinds: dict[str, str] = {"statements": "sum"}
    for version, values in units.items():
        name = version.replace(" ", "_")
        table[f"{name}_hold"], table[f"{name}_misfit"] = (values == 0).astype(int), values
        kinds |= {f"{name}_hold": "sum", f"{name}_misfit": "median"}
    return table.groupby(keys, sort=False).agg(kinds).reset_index()


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


def conditions(
    published: pd.DataFrame,
    key: CampaignKey,
    values: Values,
    generator: np.random.Generator,
) -> dict[str, bool | None]:
    """Return whether a campaign agrees with each number printed of it.

    A single printed number agrees if it lies, as exactly as it is printed, within the 95 % interval
    of ours (`confidence.interval_of`); open (None) if there are too few particles for an interval.
    A printed bound must hold of the value; where only the interval reaches it, it is open. The
    bounds of `VAGUE` words are ours: they decide only where half and twice as far agree.

    Parameters
    ----------
    published
        Of `beside_published`.
    key
        Fraction and pressure.
    values
        Measured or true, by campaign.
    generator
        Of the bootstrap.
    """
    agreement: dict[str, bool | None] = {}
    for row in of_campaign(published, key).to_dict("records"):
        interval = interval_of(values[key], row["outcome"], generator)
        low, high, value = row["low"], row["high"], interval.estimate
        name = f"{row['outcome']} at {key[1]} bar {value:.3g}"
        if low == high:
            half = 0.5 * 10.0 ** -len(f"{low:g}".partition(".")[2])
            known = np.isfinite([interval.low, interval.high]).all()
            around = f"{interval.low:.3g} to {interval.high:.3g}" if known else "too few particles"
            name += f" ({around}), printed {low:g}"
            covers = interval.low <= high + half and low - half <= interval.high
            holds = bool(covers and np.isfinite(value))
            agreement[name] = None if holds and np.isinf(interval.low) else holds
            continue
        scales = claims.OTHER_BOUNDS if row["printed"].startswith(VAGUE) else (1.0,)
        if row["printed"].startswith(("more than", "over")):
            high = np.nan
        ends = [(100 - k * (100 - low), high) if high == 100 else (low, k * high) for k in scales]
        answers = {within(interval, np.fmax(a, -np.inf), np.fmin(b, np.inf)) for a, b in ends}
        bounds = [f"{word} {end:g}" for word, end in (("from", low), ("to", high)) if end == end]
        name += f", printed {' '.join(bounds)}"
        has = bool(np.isfinite(value))  # what nothing passed has no velocity
        agreement[name] = (answers.pop() if len(answers) == 1 else None) if has else False
    return agreement or {"nothing measured": False}


def within(interval: Interval, low: float, high: float) -> bool | None:
    """Return whether an estimate lies within bounds; None if only its interval reaches them."""
    if low <= interval.estimate <= high:
        return True
    return None if interval.low <= high and low <= interval.high else False


def judge_all(
    flights: pd.DataFrame,
    values: Mapping[str, Measured],
    note: str = "",
    resolved: Mapping[str, str] | None = None,
    truth: Mapping[str, Measured] | None = None,
    because: str = "chain",
) -> list[claims.Verdict]:
    """Return verdicts on claims about all eight campaigns.

    Undecidable if flights are missing.

    Parameters
    ----------
    flights
        Flights of the campaigns: those that the claims are about.
    values
        By claim: what `kilnflight.project.claims.judge` asks for.
    note
        What a reader must know beside the verdicts.
    resolved
        By claim: which differences are beyond chance (`confidence.in_words`). It stands in the
        reason; the verdict is that of the criterion, on the numbers as they are.
    truth
        By claim: the same of the twin's own truth, which tells the twin's failures from the
        chain's.
    because
        Cause where the truth does not tell it.
    """
    counted = flights.groupby(KEYS).size()
    missing = len(FRACTIONS) * len(PRESSURES_BAR) - int((counted >= LEAST_FLIGHTS).sum())
    if missing:
        reason = (
            f"fewer than {LEAST_FLIGHTS} flights that count in {missing} of the eight campaigns"
        )
        return [claims.undecidable(name, reason, because="chain") for name in values]
    notes = {name: "; ".join(filter(None, [note, (resolved or {}).get(name)])) for name in values}
    known = {name: value for name, value in (truth or {}).items() if _known(value)}
    return [
        claims.judge(name, value, note=notes[name], truth=known.get(name), because=because)
        for name, value in values.items()
    ]


def _known(value: Measured) -> bool:
    """Return whether a value can be judged: named conditions, or finite numbers."""
    return isinstance(value, Mapping) or bool(np.isfinite(np.asarray(value, np.float64)).all())


def by_pressure(values: Values, outcome: str) -> pd.DataFrame:
    """Return an outcome by fraction (rows) and pressure (columns)."""
    return outcome_table(values).set_index(KEYS)[outcome].unstack()


def fractions_and_pressures(values: Mapping[CampaignKey, object]) -> tuple[list[str], list[float]]:
    """Return the fractions in their order, and the pressures from low to high."""
    return list(dict.fromkeys(name for name, _ in values)), sorted({bar for _, bar in values})
