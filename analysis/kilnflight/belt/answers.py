"""What deviations say about the claims of both papers: conditions for `claims.judge`.

The same questions to every source of tracks. Spread is the interquartile range.
"""

from __future__ import annotations

import pandas as pd

from kilnflight.belt import friction
from kilnflight.belt.predictive import SIM, STRAIGHT, TRACKING, summaries

Answer = dict[str, bool] | pd.Series

PLOTTED = ["IV", "CVBC", "CA", "CALV", "IA"]  # Fig. 9 leaves CV out for its bias


def arrival_answers(table: pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt20-1 to belt20-5.

    Parameters
    ----------
    table
        Of one source: ``data_set``, ``model``, ``iqr`` and ``mae`` of the arrival in ms.
    """
    mae, iqr = _wide(table, "mae"), _wide(table, "iqr")
    highest, worst, best, order = {}, {}, {}, {}
    for name in mae.index:
        plotted = iqr.loc[name, PLOTTED]
        highest[f"{name}: IV {iqr['IV'][name]:.2f} ms"] = bool(plotted.idxmax() == "IV")
        worst[f"{name}: CV {mae['CV'][name]:.2f} ms"] = bool(mae.loc[name].idxmax() == "CV")
        best[f"{name}: IA {mae['IA'][name]:.2f} ms"] = bool(mae.loc[name].idxmin() == "IA")
        ca, cvbc = mae.loc[name, ["CA", "CVBC"]]
        said = f"{name}: CA {ca:.2f}, CVBC {cvbc:.2f} ms"
        order[said] = bool((ca > cvbc) == (name != "cuboids"))
    limited = 1 - mae["CALV"] / mae["CA"]
    return {
        "belt20-1": highest,
        "belt20-2": worst,
        "belt20-3": order,
        "belt20-4": limited,
        "belt20-5": best,
    }


def by_data_set(answer: Answer) -> dict[str, Answer]:
    """Return an answer data set by data set; one that counts data sets stays whole, as "all"."""
    if isinstance(answer, pd.Series):
        return {str(name): answer.loc[[name]] for name in answer.index}
    parts: dict[str, Answer] = {}
    for text, holds in answer.items():
        name, colon, _ = text.partition(":")
        parts[name if colon else "all"] = {text: holds}
    return parts


def speed_answers(profiles: pd.DataFrame) -> dict[str, Answer]:
    """Return the answer to belt20-6.

    Parameters
    ----------
    profiles
        Of one source: ``data_set``, ``x_mm`` and ``mean_m_s``.
    """
    rising = {}
    for name, one in profiles.groupby("data_set", sort=False):
        mean = one.sort_values("x_mm")["mean_m_s"]
        said = f"{name}: up to {mean.max():.2f} m/s"
        rising[said] = bool(mean.is_monotonic_increasing and mean.max() < 1.5)
    return {"belt20-6": rising}


def lateral_answers(table: pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt20-7 to belt20-10.

    Parameters
    ----------
    table
        Of one source: ``data_set``, ``model`` and ``iqr`` of the lateral position in mm.
    """
    iqr = _wide(table, "iqr")
    rank = iqr.rank(axis=1)["IA-Ratio"].astype(int)
    straight, better, best = {}, {}, {}
    for name in iqr.index:
        row, position = iqr.loc[name], int(rank.loc[name])
        said = f"{name}: Straight {row['Straight']:.2f}, CV {row['CV-CV']:.2f} mm"
        worst = row.idxmax() == "Straight"
        straight[said] = bool(worst and row["CV-CV"] < 0.8 * row["Straight"])
        better[name] = bool(row["CA-CA"] < row["CV-CV"])
        first = position == 1
        best[f"{name}: IA-Ratio has rank {position}"] = bool(first == (name != "cylinders"))
    those = ", ".join(str(name) for name in better if better[name]) or "none"
    return {
        "belt20-7": straight,
        "belt20-8": {f"CA-CA below CV-CV for {those}": sum(better.values()) >= 2},
        "belt20-9": iqr["LV-DSC"] / iqr["CA-CA"] - 1,
        "belt20-10": best,
    }


def tracking_answers(table: pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt16-1 to belt16-5 that a table has data for.

    "Very similar" is read as not half as much again, "far worse" as more than twice as much.

    Parameters
    ----------
    table
        Of one material: ``data`` ("noise-free" or "images"), ``approach``, ``lateral_mm``,
        ``temporal_ms``, as `kilnflight.belt.predictive` gives them.
    """
    off = table.set_index(["data", "approach"])["lateral_mm"].abs().sort_index()
    box = summaries(table[["data", "approach", "lateral_mm", "temporal_ms"]])
    box = box.set_index(["quantity", "data", "approach"]).sort_index()
    there = set(off.index)
    answers: dict[str, Answer] = {}
    if ("noise-free", SIM) in there:
        answers["belt16-1"] = pd.Series({"": (off["noise-free", SIM] < 0.2).mean()})
    if {("noise-free", one) for one in (SIM, TRACKING, STRAIGHT)} <= there:
        answers["belt16-2"] = _narrower(box["iqr"]["lateral_mm", "noise-free"])
    if ("images", TRACKING) in there:
        answers["belt16-3"] = pd.Series({"": (off["images", TRACKING] < 1.5).mean()})
    if ("noise-free", SIM) in there:
        answers["belt16-4"] = box["median"]["temporal_ms", "noise-free"]
    if {("images", TRACKING), ("noise-free", TRACKING)} <= there:
        answers["belt16-5"] = _larger(box["iqr"]["temporal_ms"], box["median"]["temporal_ms"])
    return answers


def _narrower(iqr: pd.Series) -> dict[str, bool]:
    """Return the conditions of belt16-2 from the lateral spread by approach."""
    sim, free, straight = (float(iqr[one]) for one in (SIM, TRACKING, STRAIGHT))
    return {
        f"Tracking {free:.3f} mm, Sim {sim:.3f} mm": free < 1.5 * sim,
        f"Straight {straight:.3f} mm": straight > 2 * max(sim, free),
    }


def _larger(iqr: pd.Series, median: pd.Series) -> dict[str, bool]:
    """Return the conditions of belt16-5 from spread and median by data and approach."""
    larger = {}
    for name, value in (("spread", iqr), ("bias", median.abs())):
        one, other = value["images", TRACKING], value["noise-free", TRACKING]
        larger[f"{name} from images {one:.2f}, noise-free {other:.2f} ms"] = bool(one > other)
    return larger


def _wide(table: pd.DataFrame, quantity: str) -> pd.DataFrame:
    wide = table.pivot(index="data_set", columns="model", values=quantity)
    return wide.loc[[name for name in friction.MATERIALS if name in wide.index]]
