"""What the twin can and cannot do, by facts: eight campaigns, five facts each.

The facts are sentences of the thesis (facts.csv and rankings.csv in data/reference). Which of them
count, their bounds and the rule of their tolerance were fixed from the text before an outcome was
computed; data/reference/README.md states the rule. Two null models stand beside: all fractions
alike, and inputs drawn from the limits of a calibration. The twin has skill only where it beats
both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.stats import norm

from kilnflight.experiments import statements
from kilnflight.experiments.campaigns import KEYS, CampaignKey, outcome_table
from kilnflight.experiments.confidence import trajectory_counts
from kilnflight.experiments.twin_calibration import Inputs, Search
from kilnflight.project import paths
from kilnflight.project.parallel import run_all
from kilnflight.scores.flights import FlightValues
from kilnflight.twin import truth
from kilnflight.twin.fitted import Kiln

PARTICLES = 4000  # per campaign, of a twin; of 300 the counts differ by one to three by chance
DRAWN = 300  # of each draw of the inputs
SPREAD = 0.3  # relative, of speed, reach and dwell time within a fraction; none is printed
OF_MEDIAN = np.sqrt(np.pi / 2)  # error of a median over that of a mean (normal distribution)
LENGTH = 0.1  # error of printed lengths: 772 mm were fitted to a kiln of 700 mm (Table 5.12)
FURTHEST = 2.0  # standard deviations
SHARE = "share that ignites"
# That are counted: first twin and second look, and the second's null models.
VERSIONS = (
    "first twin, true",
    "second look, true",
    "second look, measured",
    "second look, all alike",
    "second look, draws of the inputs",
)
COLUMNS = [*KEYS, "fact", "published", "low", "high", "tolerance", "measured", "true", "z"]
COLUMNS += ["holds", "null_same", "null_prior"]

Array = npt.NDArray[np.float64]
Values = Mapping[CampaignKey, FlightValues]


def sentences() -> pd.DataFrame:
    """Return facts.csv: the facts, and the sentences that are left out, with the reason."""
    return pd.read_csv(paths.reference() / "facts.csv")


def left_out() -> pd.DataFrame:
    """Return why sentences are no facts, and how many: ``reason``, ``sentences``, ``example``."""
    table = sentences().dropna(subset="left_out")
    reason = table["left_out"].str.split("[:;,(]").str[0].str.strip().rename("reason")
    groups = table["quote"].groupby(reason, sort=False).agg(["size", "first"]).reset_index()
    return groups.rename(columns={"size": "sentences", "first": "example"})


def facts() -> pd.DataFrame:
    """Return the facts with their tolerance, a row each.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``, ``fact``, ``outcome`` (of
        `kilnflight.scores.flights.outcomes`), ``printed``, ``low``, ``high``, ``where``, ``quote``,
        ``tolerance`` (a standard deviation in the unit of the outcome).
    """
    table = sentences()
    table = table[table["left_out"].isna()].drop(columns="left_out").reset_index(drop=True)
    counts = trajectory_counts([(name, 0.0) for name in table["fraction"].unique()])
    number = np.array([float(counts[name, 0.0]) for name in table["fraction"]])
    lit = table[table["fact"] == SHARE].set_index(KEYS)["high"] / 100.0
    share = np.array([lit[key] for key in table[KEYS].itertuples(index=False, name=None)])
    of_lit = table["outcome"].str.contains("of ignited").to_numpy()
    number = np.where(of_lit, number * share, number)
    ends = [end_tolerance(table, table[side].to_numpy(float), number) for side in ("low", "high")]
    error = np.hypot(np.fmax(*ends), table["wording"].to_numpy(float))
    return table.drop(columns="wording").assign(tolerance=error)


def end_tolerance(table: pd.DataFrame, end: Array, number: Array) -> Array:
    """Return what sampling and length leave open at an end of the bounds, a standard deviation.

    Parameters
    ----------
    table
        Rows with ``outcome``.
    end
        Lower or upper bounds (n,), NaN if open.
    number
        Trajectories behind each (n,).
    """
    outcome = table["outcome"].str
    share = (end / 100.0 * number + 1.0) / (number + 2.0)
    of_share = np.sqrt(share * (1.0 - share) / number)
    moved = LENGTH / SPREAD * norm.pdf(norm.ppf(share)) * outcome.startswith("remaining")
    of_median = OF_MEDIAN * SPREAD * end / np.sqrt(number)
    longer = LENGTH * end * outcome.startswith("velocity")
    percent = outcome.contains("%").to_numpy()
    both = np.where(percent, 100.0 * np.hypot(of_share, moved), np.hypot(of_median, longer))
    return np.asarray(both, np.float64)


def answers(rows: pd.DataFrame, values: Values) -> pd.Series:
    """Return the value of each row's outcome; NaN where its campaign is not among them."""
    there = among(rows, values)
    known = statements.answer(rows[there], outcome_table(values)) if any(there) else pd.Series()
    return known.reindex(rows.index).astype(float)


def among(rows: pd.DataFrame, values: Values) -> npt.NDArray[np.bool_]:
    """Return which rows are of a campaign that has values."""
    return np.array([key in values for key in rows[KEYS].itertuples(index=False, name=None)], bool)


def z_scores(rows: pd.DataFrame, value: pd.Series) -> pd.Series:
    """Return how many standard deviations values lie outside their bounds, 0 within.

    Negative below; NaN where there is no value.
    """
    outside = (value - rows["high"]).clip(lower=0.0) - (rows["low"] - value).clip(lower=0.0)
    return outside / rows["tolerance"]


def holding(rows: pd.DataFrame, values: Values) -> pd.Series:
    """Return which facts hold: within two standard deviations of the bounds.

    What has no value fails.
    """
    return z_scores(rows, answers(rows, values)).abs() <= FURTHEST


def true_values(
    kiln: Kiln, count: int = PARTICLES, seed: int = 0
) -> dict[CampaignKey, FlightValues]:
    """Return the true values of flights of all campaigns, launched at once."""
    flown = truth.released_all(kiln, count, seed)
    return {key: truth.true_flight_values(each) for key, each in flown.items()}


def all_alike(values: Values) -> dict[CampaignKey, FlightValues]:
    """Return values in which each fraction flies as all of them together do at its pressure."""
    alike = {}
    for key in values:
        parts = [each for other, each in values.items() if other[1] == key[1]]
        alike[key] = FlightValues(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    return alike


def prior(search: Search[Inputs], count: int, seed: int) -> list[Inputs]:
    """Return inputs drawn from the limits of a calibration, as its search measures them."""
    generator = np.random.default_rng([seed, 14])

    def draw(name: str, low: float, high: float) -> float:
        if name in search.logarithmic:
            return float(np.exp(generator.uniform(np.log(low), np.log(high))))
        return float(generator.uniform(low, high))

    return [
        search.kind(**{name: draw(name, *ends) for name, ends in search.limits.items()})
        for _ in range(count)
    ]


def prior_values(
    search: Search[Inputs],
    kiln_of: Callable[[Inputs], Kiln],
    draws: int,
    count: int,
    seed: int,
    jobs: int = 1,
) -> list[dict[CampaignKey, FlightValues]]:
    """Return the `true_values` of `prior` inputs; ``kiln_of`` puts them into a kiln."""
    kilns = [kiln_of(each) for each in prior(search, draws, seed)]
    return run_all(true_values, [(each, count, seed) for each in kilns], jobs)


def statement_table(measured: Values, true: Values, draws: Iterable[Values]) -> pd.DataFrame:
    """Return every fact with what is published, measured and true, and both null models.

    Returns
    -------
    DataFrame
        `COLUMNS`. ``low`` and ``high`` are the bounds as printed, ``tolerance`` a standard
        deviation. ``z`` is the distance from the bounds in those (`z_scores` without its sign).
        ``z`` and ``holds`` are of what is measured: empty where nothing is.
        ``null_same``: whether it holds with all fractions alike (true values). ``null_prior``: in
        which share of the draws.
    """
    rows = facts()
    table = rows.rename(columns={"printed": "published"})
    table = table.assign(
        fact=rows["fact"] + ": " + rows["outcome"],
        measured=answers(rows, measured),
        true=answers(rows, true),
        z=z_scores(rows, answers(rows, measured)).abs(),
        holds=holding(rows, measured).astype("boolean").where(among(rows, measured)),
        null_same=holding(rows, all_alike(true)),
        null_prior=np.mean([holding(rows, each) for each in draws], axis=0),
    )
    return table[COLUMNS]


def side_by_side(versions: Mapping[str, Values]) -> pd.DataFrame:
    """Return every fact with its bounds, and by version its value and whether it holds.

    Empty for campaigns that a version has not.
    """
    rows = facts()
    table = rows[[*KEYS, "fact", "outcome", "printed", "low", "high", "tolerance"]]
    for name, values in versions.items():
        value = answers(rows, values)
        held = holding(rows, values).astype("boolean").where(among(rows, values))
        columns = {name: value, f"{name}_z": z_scores(rows, value), f"{name}_holds": held}
        table = table.assign(**columns)
    return table


def count_holding(versions: Mapping[str, Iterable[Values]]) -> pd.DataFrame:
    """Return how many facts, cells and orders hold, by version.

    Parameters
    ----------
    versions
        By name: the values of one run, or of many draws.

    Returns
    -------
    DataFrame
        ``version``, ``draws``, ``facts_hold`` of ``facts`` (of draws the mean, ``facts_low`` and
        ``facts_high`` the range that holds 90 %), ``held_out_hold`` of ``held_out``: what no
        calibration read; ``cells_hold`` of ``cells``: campaign and fact, of which every sentence
        holds; ``orders_hold`` of ``orders``; and the `old_count`.
    """
    rows, orders, counts = facts(), rankings(), []
    places = rows[[*KEYS, "outcome"]].itertuples(index=False, name=None)
    unseen = np.array([statements.use_of(*each) != statements.CALIBRATED for each in places])
    for name, runs in versions.items():
        held = pd.DataFrame([holding(rows, each) for each in runs]).T.set_index(rows.index)
        total, cells = held.sum(), held.groupby([rows[key] for key in (*KEYS, "fact")]).all()
        row = {"version": name, "draws": held.shape[1], "facts_hold": total.mean()}
        row |= {"facts_low": total.quantile(0.05), "facts_high": total.quantile(0.95)}
        row |= {"facts": len(rows), "held_out_hold": held[unseen].sum().mean()}
        row |= {"held_out": int(unseen.sum())}
        row |= {"cells_hold": cells.sum().mean(), "cells": len(cells)}
        kept = [in_order(orders, each).sum() for each in runs]
        row |= {"orders_hold": np.mean(kept), "orders": len(orders)}
        counts.append(row | pd.DataFrame([old_count(each) for each in runs]).mean().to_dict())
    return pd.DataFrame(counts)


def old_count(values: Values) -> dict[str, float]:
    """Return how the first twin was counted, by `statements` that no calibration read.

    ``statements_hold`` of the ``statements`` about these campaigns, and the ``median_misfit`` in
    units of the bounds.
    """
    every = statements.statements()
    every = every[every["use"] == statements.HELD_OUT]
    rows = every[among(every, values)]
    off = statements.misfits(rows, answers(rows, values))
    return {
        "statements_hold": float((off == 0).sum()),
        "statements": float(len(off)),
        "median_misfit": float(off.median()),
    }


def facts_that_can_fail(table: pd.DataFrame) -> pd.DataFrame:
    """Count the facts that do not hold in every draw of the inputs, and which of them hold.

    Parameters
    ----------
    table
        `statement_table`.

    Returns
    -------
    DataFrame
        One row: ``facts``, ``hold_in_every_draw``, ``can_fail``, and of these how many hold as
        ``measured`` and in a draw (the mean, ``draws_mean``).
    """
    free = table[table["null_prior"] < 1.0]
    row = {"facts": len(table), "hold_in_every_draw": len(table) - len(free)}
    row |= {"can_fail": len(free), "measured": int(free["holds"].fillna(False).sum())}
    return pd.DataFrame([row | {"draws_mean": free["null_prior"].sum()}])


def describe_counts(counts: pd.DataFrame, can_fail: pd.DataFrame) -> str:
    """Return `count_holding` of `VERSIONS` and `facts_that_can_fail` in sentences."""
    rows, free = counts.set_index("version").round(2), can_fail.iloc[0]
    first, second, measured, alike, drawn = (rows.loc[name] for name in VERSIONS)
    best = max(alike["facts_hold"], drawn["facts_high"])
    shown = pd.Series(["as measured", "on the truth"])
    skilled = pd.Series([row["facts_hold"] > best for row in (measured, second)])
    skill = [
        f"{' and '.join(names)} the second look has {'some' if some else 'no'} skill"
        for some, names in shown.groupby(skilled)
    ]
    return (
        f"Of {second['facts']:.0f} facts {measured['facts_hold']:.0f} hold as measured and "
        f"{second['facts_hold']:.0f} of true flights, of the first twin's "
        f"{first['facts_hold']:.0f}. In draws of the inputs {drawn['facts_low']:.0f} to "
        f"{drawn['facts_high']:.0f} hold, with all fractions alike {alike['facts_hold']:.0f}: "
        f"{' and '.join(skill)}. {free['hold_in_every_draw']:.0f} hold in every draw; of the "
        f"{free['can_fail']:.0f} that can fail {free['measured']:.0f} hold as measured, in a draw "
        f"{free['draws_mean']:.1f} on average. Of {second['held_out']:.0f} that no fit read "
        f"{second['held_out_hold']:.0f} hold of true flights; of {second['orders']:.0f} orders "
        f"{second['orders_hold']:.0f}, of the first twin's {first['orders_hold']:.0f}. Old count: "
        f"of {second['statements']:.0f} statements {first['statements_hold']:.0f} and now "
        f"{second['statements_hold']:.0f}, median misfit {first['median_misfit']:.2f} and now "
        f"{second['median_misfit']:.2f}."
    )


def rankings() -> pd.DataFrame:
    """Return the printed orders of fractions, a row for each pair."""
    table = pd.read_csv(paths.reference() / "rankings.csv")
    for side in ("lower", "higher"):
        table = table.assign(**{side: table[side].str.split("+")}).explode(side, ignore_index=True)
    return table


def in_order(orders: pd.DataFrame, values: Values) -> pd.Series:
    """Return whether the one lies below the other; false where they are equal or unknown."""
    sides = []
    for side in ("lower", "higher"):
        rows = orders[["pressure_bar", "outcome"]].assign(fraction=orders[side])
        sides.append(answers(rows, values))
    return sides[0] < sides[1]
