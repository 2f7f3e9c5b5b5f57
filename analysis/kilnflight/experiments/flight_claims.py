"""Verdicts on the claims about flights: what is compared, and what is beyond chance.

Each function answers the claims of one section from the results of the campaigns, or says that
they cannot be decided where campaigns are missing. The verdict is that of the criterion of the
claim; which differences are beyond chance stands in the reason.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from kilnflight.experiments.campaigns import Measurement
from kilnflight.experiments.confidence import (
    FIT_MEASURES,
    in_words,
    resolved_differences,
    resolved_share_differences,
)
from kilnflight.experiments.results import (
    CampaignKey,
    conditions,
    ignited,
    judge_all,
    outcome_table,
    trajectories_from_lance,
)
from kilnflight.project import claims
from kilnflight.scores.flights import FlightValues

Results = Mapping[CampaignKey, FlightValues]
Given = dict[str, float | pd.Series | Mapping[str, bool]]
HEAVY, PAPERS = ("wood chip", "PE granule"), ("confetti", "paper shred")
SENTENCES = {"vel-2": "wood chip", "vel-3": "confetti"}  # each about a fraction at 4.5 bar
SENTENCES |= {"vel-4": "paper shred", "vel-5": "PE granule"}


def _fractions(found: Results) -> list[str]:
    return list(dict.fromkeys(fraction for fraction, _ in found))


def _pressures(found: Results) -> list[float]:
    return sorted({bar for _, bar in found})


def by_pressure(found: Results, outcome: str) -> pd.DataFrame:
    """Return an outcome by fraction (rows) and pressure (columns)."""
    table = outcome_table(found)
    return table.pivot(index="fraction", columns="pressure_bar", values=outcome)


def dwell_verdicts(
    measured: Measurement, found: Results, generator: np.random.Generator
) -> list[claims.Verdict]:
    """Return the verdicts on dwell times (section 5.3.1)."""
    names, bars = _fractions(found), _pressures(found)
    median = by_pressure(found, "dwell median (s)")
    first, ranks = median[bars[0]], {}
    for bar in bars:
        quickest = median[bar].dropna().sort_values().index[:1].tolist()
        ranks[f"{bar} bar: {quickest}"] = quickest == ["wood chip"]
    longest = first.dropna().sort_values().index[-1:].tolist()
    shorter = (median[bars[-1]] / median[bars[0]])[names[-1]]
    granules = {f"longest at 4.5 bar: {longest}": longest == ["PE granule"]}
    granules[f"{names[-1]} at 5 bar {shorter:.2f} of that"] = bool(shorter < 0.9)
    numbers, most = outcome_table(found).set_index(["fraction", "pressure_bar"]), {}
    for name, limits in zip(names, ["0.3-0.4", "> 0.4", "> 0.4", "0.3-0.4"], strict=False):
        share = numbers[f"dwell {limits} s (%)"].get((name, 5.0), np.nan)
        most[f"{name} {limits} s {share:.0f} %"] = bool(share > 50)

    others, last = [name for name in names if name != "wood chip"], ("PE granule", 4.5)
    pairs = {"dwell-2": [(("wood chip", bar), (name, bar)) for bar in bars for name in others]}
    pairs["dwell-3"] = [(last, (name, 4.5)) for name in names if name != "PE granule"]
    pairs["dwell-3"] += [(last, ("PE granule", 5.0))]
    times = {key: one.dwell_s for key, one in found.items()}
    resolved = {
        claim: in_words(resolved_differences(times, some, generator), "medians")
        for claim, some in pairs.items()
    }
    given: Given = {"dwell-1": first, "dwell-2": ranks, "dwell-3": granules, "dwell-4": most}
    note = (
        "lost flights count with the time they were seen; much shorter: by over a tenth, a reading"
    )
    return judge_all(measured, given, note, resolved)


def velocity_verdicts(
    measured: Measurement,
    found: Results,
    published: pd.DataFrame,
    generator: np.random.Generator,
) -> list[claims.Verdict]:
    """Return the verdicts on velocities; ``published`` from `results.beside_published`."""
    names, bars = _fractions(found), _pressures(found)
    first = by_pressure(found, "velocity 0-1 m (m/s)")
    order = {}
    for bar in bars:
        speed = first[bar].reindex([*HEAVY, *names])
        heavy, light = speed.iloc[:2].min(), speed.drop(list(HEAVY)).max()
        order[f"{bar} bar: heavy {heavy:.1f}, papers {light:.1f} m/s"] = bool(heavy > light)
    ratio = (first[bars[-1]] / first[bars[0]]).rename("ratio")
    light_names = [name for name in names if name not in HEAVY]
    pairs = {
        "vel-1": [((a, bar), (b, bar)) for bar in bars for a in HEAVY for b in light_names],
        "vel-6": [((name, 5.0), (name, 4.5)) for name in names],
    }
    speeds = {key: one.velocity_m_s[:, 0] for key, one in found.items()}
    resolved = {
        claim: in_words(resolved_differences(speeds, some, generator), "medians")
        for claim, some in pairs.items()
    }
    given: Given = {"vel-1": order, "vel-6": ratio}
    given |= {claim: conditions(published, (name, 4.5)) for claim, name in SENTENCES.items()}
    note = "medians measured on the twin; bounds of the printed sentences"
    verdicts = judge_all(measured, given, note, resolved)
    fit = "the twin's flights were fitted to this cell"
    return [claims.fitted(v, fit) if v.id in ("vel-2", "vel-3") else v for v in verdicts]


def ignition_verdicts(
    measured: Measurement,
    readings: Mapping[str, Results],
    published: pd.DataFrame,
    generator: np.random.Generator,
) -> list[claims.Verdict]:
    """Return the verdicts on ignition, on the reading "as published".

    Parameters
    ----------
    measured
        The campaigns.
    readings
        Results by reading: "as published" and "above background", which the note states.
    published
        `results.beside_published` of the first reading.
    generator
        Of the bootstrap.
    """
    found = readings["as published"]
    papers = [name for name in PAPERS if name in _fractions(found)]
    numbers = {
        name: outcome_table(one).set_index(["fraction", "pressure_bar"])
        for name, one in readings.items()
    }
    share, middle = (
        numbers["as published"][name] for name in ("ignited (%)", "ignition median (s)")
    )
    others = share[~share.index.get_level_values(0).isin(papers)] / 100
    never = others.set_axis([f"{name} {bar} bar" for name, bar in found if name not in papers])
    table = published[published["outcome"].isin(["ignited (%)", "ignited < 0.1 s (%)"])]
    given: Given = {"ign-1": never}
    for claim, name in (("ign-2", "confetti"), ("ign-3", "paper shred")):
        given[claim] = conditions(table, (name, 4.5)) | conditions(table, (name, 5.0))
    more = {}
    for bar in _pressures(found):
        one, two = (("confetti", bar), ("paper shred", bar))
        more[f"shreds more often at {bar} bar"] = bool(share.get(two, 0) > share.get(one, 0))
        more[f"shreds earlier at {bar} bar"] = bool(middle.get(two, 9) < middle.get(one, 0))
    for name in papers:
        fewer, later = (one.unstack().loc[name] for one in (share, middle))
        more[f"{name}: fewer at 5 bar"] = bool(fewer.iloc[-1] < fewer.iloc[0])
        more[f"{name}: later at 5 bar"] = bool(later.iloc[-1] > later.iloc[0])
    given["ign-4"] = more

    pairs = [(("paper shred", bar), ("confetti", bar)) for bar in _pressures(found)]
    pairs += [((name, 5.0), (name, 4.5)) for name in papers]
    times = {key: one.ignition_s for key, one in found.items()}
    counts = {key: ignited(one) for key, one in found.items()}
    parts = [
        in_words(resolved_share_differences(counts, pairs), "shares"),
        in_words(resolved_differences(times, pairs, generator), "median times"),
    ]
    better = numbers["above background"]["ignited (%)"]
    other = ", ".join(
        f"{key[0]} {key[1]} bar {value:.0f} %" for key, value in zip(found, better, strict=True)
    )
    note = f"grey values as they are; above the background: {other}"
    verdicts = judge_all(measured, given, note, {"ign-4": "; ".join(parts)})
    fit = "the twin was fitted to the share of confetti at 4.5 bar"
    return [claims.fitted(one, fit) if one.id == "ign-2" else one for one in verdicts]


def regression_verdicts(
    measured: Measurement,
    table: pd.DataFrame,
    by_order: pd.DataFrame,
    generator: np.random.Generator,
) -> list[claims.Verdict]:
    """Return the verdicts on the regression.

    Parameters
    ----------
    measured
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
    flights = trajectories_from_lance(measured)
    pairs = [((name, "z"), (name, axis)) for name in names for axis in "xy"]
    worse = [(("paper shred", "z"), (name, "z")) for name in names if name != "paper shred"]
    columns = {name: column for column, name in FIT_MEASURES.items()}
    resolved = {}
    for claim, of, some in (("fit-2", "mape_percent", pairs), ("fit-3", "r2", pairs + worse)):
        groups = {
            (name, axis): one[columns[of].format(axis)].to_numpy()
            for name, one in flights.groupby("fraction")
            for axis in "xyz"
        }
        resolved[claim] = in_words(resolved_differences(groups, some, generator), "medians")
    given: Given = {"fit-1": ratio, "fit-2": lowest, "fit-3": least, "fit-4": order_gain(by_order)}
    note = "trajectories from the lance; the scatter of the depth is an input"
    return judge_all(measured, given, note, resolved)


def order_gain(by_order: pd.DataFrame) -> float:
    """Return by how much the mean adjusted R2 rises from order 6 to order 7; NaN if unknown."""
    mean = by_order.groupby("order")["r2_adjusted"].mean()
    return float(mean.get(7, float("nan")) - mean.get(6, float("nan")))
