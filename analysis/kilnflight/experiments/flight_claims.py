"""Verdicts on sections 5.2.4 and 5.3.1: fits, dwell times and velocities.

Each is of the same measure on the measurement and on the twin's own truth. A claim that fails on
the truth is a verdict on the twin, one that fails as measured only on the chain.

Print: orders, majorities, bounds and single numbers of the text; the last agree if our 95 %
interval holds them (`kilnflight.experiments.statements.conditions`). Ours: "much" is more than a
tenth. It decides only where half and twice as much agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from kilnflight.experiments.campaigns import (
    CampaignKey,
    Measurement,
    Results,
    counted_flights,
    from_lance,
)
from kilnflight.experiments.confidence import (
    Array,
    Values,
    finite,
    group_differences,
    in_words,
    median_of,
)
from kilnflight.experiments.statements import (
    HEAVY,
    Evidence,
    Measured,
    by_pressure,
    conditions,
    fractions_and_pressures,
    judge_all,
    within,
)
from kilnflight.flight import LOST
from kilnflight.project import claims
from kilnflight.scores.flights import NONE_LOST, censored_median
from kilnflight.scores.intervals import Bootstrap, Interval, difference, share
from kilnflight.twin.particles import FRACTIONS

SENTENCES = {"vel-2": "wood chip", "vel-3": "confetti"}  # each about a fraction at 4.5 bar
SENTENCES |= {"vel-4": "paper shred", "vel-5": "PE granule"}
PRINTED_S = (0.3, 0.5)  # where the text has the medians at 4.5 bar
UNKNOWN = Interval(np.nan, -np.inf, np.inf, (0,))
MUCH = 0.1  # shorter by more than this share is "much shorter"; ours

CampaignPairs = Sequence[tuple[CampaignKey, CampaignKey]]


def dwell_verdicts(results: Results, generator: np.random.Generator) -> list[claims.Verdict]:
    """Return the verdicts on dwell times (section 5.3.1).

    Medians are of complete flights; beside them, as the other reading, with lost flights censored
    (`censored_median`). What the intervals of both leave open is open.
    """
    names, bars = fractions_and_pressures(results.measured)
    others, last = [name for name in names if name != "wood chip"], ("PE granule", 4.5)
    first = [(("wood chip", bar), (name, bar)) for bar in bars for name in others]
    longer = [(last, (name, 4.5)) for name in names if name != "PE granule"]
    pairs = {"dwell-2": first, "dwell-3": [*longer, (last, ("PE granule", 5.0))]}
    times = {key: each.dwell_s for key, each in results.measured.items()}
    flights = counted_flights(results.tables.flights)
    complete, true = (
        _dwell_evidence({key: median_of(each.dwell_s, generator) for key, each in values.items()})
        for values in (results.measured, results.true)
    )
    censored = _dwell_evidence({k: censored_median(v) for k, v in results.measured.items()})
    most = {"dwell-4": _most(results.measured)}, {"dwell-4": _most(results.true)}
    judged = judge_all(
        flights[flights["ending"] != LOST],
        complete | most[0],
        "complete flights; what chance decides is open; ours: much is over a tenth",
        _resolved(times, pairs, generator),
        true | most[1],
    )
    other = {
        name: claims.judge(name, answer, truth=true[name]) for name, answer in censored.items()
    }
    return [
        claims.in_both_readings(verdict, other[verdict.id], "with lost flights censored")
        if verdict.id in other and verdict.measured
        else verdict
        for verdict in judged
    ]


def _dwell_evidence(medians: Mapping[CampaignKey, Interval]) -> dict[str, dict[str, bool | None]]:
    """Return what claims on median dwell times ask for."""
    names, bars = fractions_and_pressures(medians)
    between: dict[str, bool | None] = {}
    for name in names:
        each = medians[name, bars[0]]
        text = f"{name} {each.estimate:.2f} ({each.low:.2f} to {each.high:.2f}) s"
        between[text] = within(each, *PRINTED_S)
    first = {
        f"wood chip - {name} at {bar} bar {text}": holds
        for bar in bars
        for name in names
        if name != "wood chip"
        for text, holds in [_shorter(medians["wood chip", bar], medians[name, bar])]
    }
    granule, later = (medians.get(("PE granule", bar), UNKNOWN) for bar in (bars[0], bars[-1]))
    longest = {
        f"{name} - PE granule at {bars[0]} bar {text}": holds
        for name in names
        if name != "PE granule"
        for text, holds in [_shorter(medians[name, bars[0]], granule)]
    }
    longest[f"PE granule at 5 bar {later.estimate / granule.estimate:.2f} of that"] = much_less(
        later, granule
    )
    return {"dwell-1": between, "dwell-2": first, "dwell-3": longest}


def _most(values: Values) -> dict[str, bool | None]:
    """Return whether most dwell times at 5 bar are in the range that A.2 prints (dwell-4)."""
    conditions: dict[str, bool | None] = {}
    for name, limits in zip(FRACTIONS, ["0.3-0.4", "> 0.4", "> 0.4", "0.3-0.4"], strict=True):
        if (name, 5.0) in values:
            times = pd.Series(values[name, 5.0].dwell_s)
            inside = times.between(0.3, 0.4) if limits == "0.3-0.4" else times >= 0.4
            each = share(int(inside.sum()), len(times))
            ends = f"{100 * each.estimate:.0f} % ({100 * each.low:.0f} to {100 * each.high:.0f})"
            conditions[f"{name} {limits} s {ends}"] = within(each, 0.5, np.inf)
    return conditions


def _shorter(first: Interval, second: Interval) -> tuple[str, bool | None]:
    """Return first minus second in words, and whether it is below 0; None: chance decides."""
    apart = difference(first, second)
    text = f"{apart.estimate:+.2f} [{apart.low:+.2f}, {apart.high:+.2f}] s < 0"
    return text, within(apart, -np.inf, -np.finfo(float).tiny)


def much_less(first: Interval, second: Interval) -> bool | None:
    """Return whether a median is "much" below another.

    None: half and twice `MUCH` do not agree, or chance decides.

    Examples
    --------
    >>> one = Interval(1.0, 1.0, 1.0, (9,))
    >>> [much_less(Interval(x, x, x, (9,)), one) for x in (0.75, 0.85, 0.93, 0.97, 1.1)]
    [True, None, None, False, False]
    """
    answers = set()
    for scale in claims.OTHER_BOUNDS:
        less = 1 - scale * MUCH
        part = Interval(less * second.estimate, less * second.low, less * second.high, (1,))
        answers.add(_shorter(first, part)[1])
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
    for k, verdict in enumerate(verdicts):
        if verdict.id == "vel-6" and verdict.measured:
            verdicts[k] = _beyond_chance(verdict, _speed_ratios(speeds, bars, generator))
        if verdict.because == "twin" and verdict.id in SENTENCES:
            added = _of_chain(evidence[verdict.id], truth[verdict.id])
            verdicts[k] = replace(verdict, reason=f"{verdict.reason}; the chain adds: {added}")
        if verdict.measured and verdict.id in SENTENCES:
            other = _lost_as_ended(verdict.id, published, results, generator)
            name = "remaining particles with lost flights as ended"
            verdicts[k] = claims.in_both_readings(verdicts[k], other, name)
    fit = "the twin's flights were fitted to this campaign"
    return [claims.fitted(v, fit) if v.id in ("vel-2", "vel-3") else v for v in verdicts]


def _speed_ratios(
    speeds: Mapping[CampaignKey, Array], bars: Sequence[float], generator: np.random.Generator
) -> dict[str, Interval]:
    """Return by fraction the ratio of median velocities at the last and the first pressure."""

    def ratio(later: Array, earlier: Array, axis: int = -1) -> Array:
        return np.asarray(np.median(later, axis=axis) / np.median(earlier, axis=axis))

    known = {key: finite(values) for key, values in speeds.items()}
    names = dict.fromkeys(name for name, _ in known)
    return {
        name: Bootstrap()(ratio, [known[name, bars[-1]], known[name, bars[0]]], generator)
        for name in names
    }


def _beyond_chance(verdict: claims.Verdict, ratios: Mapping[str, Interval]) -> claims.Verdict:
    """Return a verdict on ratios, open if those nearest to 1 in their intervals answer otherwise.

    Likewise those farthest from it.
    """
    told = ", ".join(f"{name} {one.low:.2f} to {one.high:.2f}" for name, one in ratios.items())
    reason = f"{verdict.reason}; 95 % intervals of the ratios: {told}"
    ends = (
        [min(max(1.0, one.low), one.high) for one in ratios.values()],
        [max(one.low, one.high, key=lambda end: abs(end - 1.0)) for one in ratios.values()],
    )
    if not np.isfinite(ends).all():
        return replace(verdict, verdict=claims.NOT_DECIDABLE, reason=reason, because="criterion")
    answers = {claims.judge(verdict.id, each, because="chain").verdict for each in ends} | {
        verdict.verdict
    }
    if len(answers) == 1:
        return replace(verdict, reason=reason)
    reason = f"{reason}; chance decides"
    return replace(verdict, verdict=claims.NOT_DECIDABLE, reason=reason, because="criterion")


def _lost_as_ended(
    claim: str, published: pd.DataFrame, results: Results, generator: np.random.Generator
) -> claims.Verdict:
    """Return the verdict if a lost flight ends where it was lost, as a plain count has it.

    Section 5.3.1 does not say how its "percentage of remaining particles" counts lost ones.
    """
    key = (SENTENCES[claim], 4.5)
    plain = {key: results.measured[key]._replace(lost=NONE_LOST)}
    answers = conditions(published, key, plain, generator)
    told = "; ".join(name for name in answers if name.startswith("remaining"))
    return replace(claims.judge(claim, answers, because="twin"), measured=told)


def _of_chain(measured: Measured, true: Measured) -> str:
    """Return the conditions that hold on the twin's own truth, but fail as measured."""
    if not isinstance(measured, Mapping) or not isinstance(true, Mapping):
        return "nothing"
    pairs = zip(measured.items(), true.values(), strict=True)
    names = [name for (name, holds), truly in pairs if holds is False and truly is not False]
    return ", ".join(names) or "nothing"


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
    note = "trajectories from the lance; the scatter of the depth was fitted to Table 5.18"
    judged = judge_all(counted_flights(tables.flights), evidence, note, resolved, because="twin")
    terms = {"fit-1": "RMSE of y over that of z", "fit-2": "MAPE of z"}
    fit = "the pose was fitted to the printed {} (notebook 15)"
    return [claims.fitted(v, fit.format(terms[v.id])) if v.id in terms else v for v in judged]


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
