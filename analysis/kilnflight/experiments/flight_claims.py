"""Verdicts on sections 5.2.4 and 5.3.1: fits, dwell times and velocities.

Each is of the same measure on the measurement and on the twin's own truth. A claim that fails on
the truth is a verdict on the twin, one that fails as measured only on the chain.

Print: orders, majorities, bounds and single numbers of the text; the last agree if our 95 %
interval holds them (`kilnflight.experiments.statements.conditions`). Ours: "much" is more than a
tenth. It decides only where half and twice as much agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from kilnflight.experiments.campaigns import (
    CampaignKey,
    Measurement,
    Results,
    counted_flights,
    from_lance,
    outcome_table,
)
from kilnflight.experiments.confidence import Array, Values, group_differences, in_words
from kilnflight.experiments.statements import (
    HEAVY,
    KEYS,
    Evidence,
    by_pressure,
    conditions,
    fractions_and_pressures,
    judge_all,
)
from kilnflight.flight import LOST
from kilnflight.project import claims

SENTENCES = {"vel-2": "wood chip", "vel-3": "confetti"}  # each about a fraction at 4.5 bar
SENTENCES |= {"vel-4": "paper shred", "vel-5": "PE granule"}
MUCH = 0.1  # shorter by more than this share is "much shorter"; ours

CampaignPairs = Sequence[tuple[CampaignKey, CampaignKey]]


def dwell_verdicts(results: Results, generator: np.random.Generator) -> list[claims.Verdict]:
    """Return the verdicts on dwell times (section 5.3.1) of complete flights."""
    names, bars = fractions_and_pressures(results.measured)
    others, last = [name for name in names if name != "wood chip"], ("PE granule", 4.5)
    first = [(("wood chip", bar), (name, bar)) for bar in bars for name in others]
    longer = [(last, (name, 4.5)) for name in names if name != "PE granule"]
    pairs = {"dwell-2": first, "dwell-3": [*longer, (last, ("PE granule", 5.0))]}
    times = {key: each.dwell_s for key, each in results.measured.items()}
    flights = counted_flights(results.tables.flights)
    return judge_all(
        flights[flights["ending"] != LOST],
        _dwell_evidence(results.measured),
        "complete flights; print: bounds, orders, majorities; ours: much is over a tenth",
        _resolved(times, pairs, generator),
        _dwell_evidence(results.true),
    )


def _dwell_evidence(values: Values) -> Evidence:
    """Return what claims on dwell times ask for."""
    names, bars = fractions_and_pressures(values)
    median = by_pressure(values, "dwell median (s)")
    order = {bar: median[bar].dropna().sort_values().index.tolist() for bar in bars}
    ranks = {f"{bar} bar: {order[bar][:1]}": order[bar][:1] == ["wood chip"] for bar in bars}
    longest = order[bars[0]][-1:]
    ratio = (median[bars[-1]] / median[bars[0]]).get("PE granule", np.nan)
    granules: dict[str, bool | None] = {
        f"longest at 4.5 bar: {longest}": longest == ["PE granule"],
        f"PE granule at 5 bar {ratio:.2f} of that": much_less(ratio),
    }
    numbers, most = outcome_table(values).set_index(KEYS), {}
    for name, limits in zip(names, ["0.3-0.4", "> 0.4", "> 0.4", "0.3-0.4"], strict=False):
        share = numbers[f"dwell {limits} s (%)"].get((name, 5.0), np.nan)
        most[f"{name} {limits} s {share:.0f} %"] = bool(share > 50)
    return {"dwell-1": median[bars[0]], "dwell-2": ranks, "dwell-3": granules, "dwell-4": most}


def much_less(ratio: float) -> bool | None:
    """Return whether a ratio is "much" below 1; None: half and twice `MUCH` do not agree.

    Examples
    --------
    >>> [much_less(ratio) for ratio in (0.75, 0.85, 0.93, 0.97, 1.1, float("nan"))]
    [True, None, None, False, False, False]
    """
    answers = {ratio < 1 - scale * MUCH for scale in claims.OTHER_BOUNDS}
    return answers.pop() if len(answers) == 1 else None


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
    names, bars = fractions_and_pressures(results.measured)
    papers = [name for name in names if name not in HEAVY]
    pairs = {
        "vel-1": [((a, bar), (b, bar)) for bar in bars for a in HEAVY for b in papers],
        "vel-6": [((name, 5.0), (name, 4.5)) for name in names],
    }
    speeds = {key: each.velocity_m_s[:, 0] for key, each in results.measured.items()}
    evidence, truth = (
        _velocity_evidence(values)
        | {
            claim: conditions(published, (name, 4.5), values, generator)
            for claim, name in SENTENCES.items()
        }
        for values in (results.measured, results.true)
    )
    note = (
        "flights that are not refused, lost ones as far as they were seen; a single printed number "
        "agrees if our 95 % interval holds it"
    )
    flights = counted_flights(results.tables.flights)
    verdicts = judge_all(flights, evidence, note, _resolved(speeds, pairs, generator), truth)
    fit = "the twin's flights were fitted to this campaign"
    return [claims.fitted(v, fit) if v.id in ("vel-2", "vel-3") else v for v in verdicts]


def _velocity_evidence(values: Values) -> Evidence:
    """Return what claims on the first metre of all fractions ask for."""
    names, bars = fractions_and_pressures(values)
    median, order = by_pressure(values, "velocity 0-1 m (m/s)"), {}
    for bar in bars:
        speed = median[bar].reindex([*HEAVY, *names])
        heavy, light = speed.iloc[:2].min(), speed.drop(list(HEAVY)).max()
        order[f"{bar} bar: heavy {heavy:.1f}, papers {light:.1f} m/s"] = bool(heavy > light)
    return {"vel-1": order, "vel-6": (median[bars[-1]] / median[bars[0]]).rename("ratio")}


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
    return judge_all(counted_flights(tables.flights), evidence, note, resolved, because="twin")


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
