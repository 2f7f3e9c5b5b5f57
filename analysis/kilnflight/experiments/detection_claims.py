"""The detection experiment beside the thesis, and the verdicts on its claims.

Sections 5.1.2 and 5.1.3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.background import BackgroundModel
from kilnflight.detection import (
    DBSCAN,
    Clusterer,
    DoG,
    MorphologicalClustering,
    Otsu,
    QuasiClusterCenters,
)
from kilnflight.experiments.detection import (
    Subset,
    class_recall,
    compare_thresholds,
    f1_with_intervals,
    leave_one_out,
    run,
    sum_counts,
    tried_thresholds,
    with_total,
)
from kilnflight.experiments.detection_methods import (
    Method,
    eight_bits,
    from_cloud,
    from_foreground,
    from_thresholds,
    table_5_11_methods,
)
from kilnflight.project import claims
from kilnflight.twin import truth

# Otsu's row is no prediction: the light of the twin was fitted to it.
FITTED = "the picture was fitted to Otsu's row (notebook 13)"


# Clusterers: the tables that list their settings, their parameters in them, and the row whose
# recall by class section 5.1.3 discusses.
TABLES = {"dbscan": "table_5.8", "mo": "table_5.9", "qcc": "table_5.10"}
PARAMETERS = {"dbscan": ["minPts", "epsilon_mm"], "mo": ["R"], "qcc": ["K", "alpha"]}
ANALYSED = {"dbscan": 5, "mo": 1, "qcc": 2}


def compare_backgrounds(
    subsets: list[Subset], models: Mapping[str, BackgroundModel], scale: str
) -> pd.DataFrame:
    """Return chosen rows of `compare_thresholds` by background, with ``model``."""
    parts = []
    for name, model in models.items():
        table = compare_thresholds(subsets, scale, model)
        parts.append(table[table["chosen"]].assign(model=name))
    return pd.concat(parts, ignore_index=True)


def compare_pictures(subsets: list[Subset], scale: str) -> pd.DataFrame:
    """Return Otsu and DoG on the same frames, DoG also on foregrounds of eight bits.

    Returns
    -------
    DataFrame
        Of `run`; ``method`` is Otsu, SIFT or 8 bits. ``threshold`` is that of DoG in grey
        values, ``chosen`` as in `compare_thresholds`, by what SIFT is best with on 16 bits.
    """
    thresholds = tried_thresholds(scale)
    fine, coarse = from_thresholds(thresholds), from_thresholds(thresholds, eight_bits)
    methods: dict[tuple[str, float], Method] = {("Otsu", 0): from_foreground(Otsu())}
    methods |= {("SIFT", threshold): fine[threshold] for threshold in thresholds}
    methods |= {("8 bits", threshold): coarse[threshold] for threshold in thresholds}
    table = run(subsets, methods)
    table[["method", "threshold"]] = table["method"].to_list()
    best = leave_one_out(table[table["method"] == "SIFT"])
    return table.assign(chosen=table["threshold"] == table["subset"].map(best))


def time_thresholds(subsets: list[Subset], scale: str) -> pd.DataFrame:
    """Return `run` of DoG with one threshold at a time, on every fifth frame.

    ``threshold`` stands in place of the method: those of `tried_thresholds` and of Table 5.7.
    """
    thresholds = {*tried_thresholds(scale), *claims.published("table_5.7")["dog_local_max"]}
    methods = {threshold: from_foreground(DoG(float(threshold))) for threshold in thresholds}
    few = [subset._replace(frames=subset.frames[::5]) for subset in subsets]
    return run(few, methods).rename(columns={"method": "threshold"})


def chosen_sift(attempts: pd.DataFrame, times: pd.DataFrame) -> pd.DataFrame:
    """Return SIFT with each subset's chosen threshold and the time that it takes.

    ``attempts`` is of `compare_pictures`, ``times`` of `time_thresholds`.
    """
    sift = attempts[attempts["chosen"] & (attempts["method"] == "SIFT")]
    seconds = times.groupby(["subset", "threshold"])["seconds"].median()
    return sift.drop(columns="seconds").join(seconds, on=["subset", "threshold"])


def time_table(times: pd.DataFrame) -> pd.DataFrame:
    """Return Table 5.7 with ``measured_s``, the medians of `time_thresholds`."""
    printed = claims.published("table_5.7").rename(columns={"dog_local_max": "threshold"})
    seconds = times.groupby("threshold")["seconds"].median()
    return printed.assign(measured_s=printed["threshold"].map(seconds))


def background_traces(
    subset: Subset,
    t: int,
    backgrounds: Mapping[str, npt.NDArray[np.floating]],
    clean: npt.NDArray[np.floating],
) -> dict[str, float]:
    """Return how far backgrounds of frame t are from the particle-free ``clean``.

    ``clean`` is the scene without any particle.
    Root mean square in grey values over pixels that hold a particle in one of the frames
    around, but not now.
    """
    around = range(t - 25, t + 26, 5)
    marked = np.any([subset.instances(k) >= 0 for k in around], axis=0)
    trace = marked & ~(subset.instances(t) >= 0)
    return {
        name: float(np.sqrt(np.mean((image - clean)[trace] ** 2)))
        for name, image in backgrounds.items()
    }


def background_verdicts(
    f1: pd.Series, first: pd.Series, traces: Mapping[str, float], note: str
) -> list[claims.Verdict]:
    """Return the verdicts on the claims of section 5.1.2.

    Parameters
    ----------
    f1
        By background, the largest first.
    first
        Share of the draws in which a background is first (`f1_with_intervals`).
    traces
        Of `background_traces`.
    note
        How many frames, and which scoring distance.
    """
    best, last = f1.index[0], f1.index[-1]
    static, moving = f1[["Mean", "Median"]].min(), f1[["TwoFrame", "ThreeFrame"]].max()
    kept = {f"{traces['Mean']:.0f} > {traces['Median']:.0f}": traces["Mean"] > traces["Median"]}
    sure = f"{note}; first in {first[best]:.0%} of the draws"
    measure = "root mean square from the scene without particles, in grey values"
    return [
        claims.judge("bg-1", {f"first is {best}": best == "Median"}, note=sure),
        claims.judge("bg-2", {f"last is {last}": last == "TwoFrame"}, note=note),
        claims.judge("bg-3", abs(f1["Median"] - f1["Mean"]), note=note),
        claims.judge("bg-4", f1.max() - f1["Adaptive"], note=note),
        claims.judge("bg-5", {f"{static:.4f} > {moving:.4f}": bool(static > moving)}, note=note),
        claims.judge("bg-6", kept, note=measure),
    ]


def picture_verdicts(
    otsu: pd.DataFrame, sift: pd.DataFrame, recall: pd.DataFrame, times: pd.DataFrame, note: str
) -> list[claims.Verdict]:
    """Return the verdicts on Otsu and SIFT (section 5.1.3).

    Parameters
    ----------
    otsu, sift
        Tables 5.5 and 5.6, of `with_total`.
    recall
        Of `class_recall` by method and subset.
    times
        Of `time_table`.
    note
        How many frames, and which scoring distance.
    """
    of_otsu, of_sift = (table.set_index("subset") for table in (otsu, sift))
    seconds = times.set_index("threshold")["measured_s"]
    subsets = of_otsu.index.drop("Total")
    by_class = recall.pivot(index="subset", columns=["method", "label"], values="recall")
    burning, unlit, more = (by_class[key] for key in (("Otsu", 2), ("Otsu", 3), ("SIFT", 3)))
    last, last_of_sift = (table.loc[subsets, "f1"].idxmin() for table in (of_otsu, of_sift))
    half = {f"{name} {value:.2f} <= 0.5": bool(value <= 0.5) for name, value in unlit.items()}
    half["V4 lowest"] = unlit.idxmin() == "V4" or bool(unlit["V4"] == unlit.min())
    about = {f"{name} {r:.2f} in 0.35..0.75": bool(0.35 <= r <= 0.75) for name, r in more.items()}
    names = [f"{name} above Otsu {r:.2f}" for name, r in unlit.items()]
    above = dict(zip(names, more > unlit, strict=True))
    otsu_f1, sift_f1 = of_otsu["f1"], of_sift["f1"]
    ahead = f"{sift_f1['Total']:.4f} > {otsu_f1['Total']:.4f}"
    gap = sift_f1["V5"] - otsu_f1["V5"]
    v5 = {f"last is {last_of_sift}": last_of_sift == "V5", f"V5 {gap:+.3f} >= 0.05": gap >= 0.05}
    precision = claims.judge("otsu-1", of_otsu.loc[subsets, "precision"], note=note)
    rank = claims.judge("otsu-4", {f"last is {last}": last == "V5"}, note=note)
    return [
        claims.fitted(precision, FITTED),
        claims.judge("otsu-2", burning, note=note),
        claims.judge("otsu-3", half, note=f"{note}; although {FITTED}"),
        claims.fitted(rank, FITTED),
        claims.judge("sift-1", {ahead: sift_f1["Total"] > otsu_f1["Total"]}, note=note),
        claims.judge("sift-2", about | above, note=note),
        claims.judge("sift-3", v5, note=note),
        claims.judge("sift-4", seconds[400] / seconds[1000], note="median time of a frame"),
    ]


def compare_clusterers(subsets: list[Subset]) -> pd.DataFrame:
    """Return `run` of all settings, with ``family`` and ``row``.

    Tables 5.8 to 5.10 of the thesis.
    """
    makers: dict[str, Callable[[Any], Clusterer]] = {
        "dbscan": lambda row: DBSCAN(row.epsilon_mm, row.minPts),
        "mo": lambda row: MorphologicalClustering(row.R),
        "qcc": lambda row: QuasiClusterCenters(row.K, row.alpha),
    }
    methods = {
        (family, row.Index): from_cloud(make(row))
        for family, make in makers.items()
        for row in claims.published(TABLES[family]).itertuples()
    }
    table = run(subsets, methods)
    table[["family", "row"]] = table["method"].to_list()
    return table


def cluster_table(attempts: pd.DataFrame, family: str) -> pd.DataFrame:
    """Return counts of a family's settings by subset and in total, beside published.

    Parameters
    ----------
    attempts
        Of `compare_clusterers`.
    family
        One of `TABLES`.

    Returns
    -------
    DataFrame
        The parameters, the columns of `with_total`, and ``f1_published`` in the total.
    """
    table = with_total(attempts[attempts["family"] == family], ["row", "subset"])
    settings = claims.published(TABLES[family]).loc[table.pop("row")].reset_index(drop=True)
    f1 = settings["f1"].where(table["subset"] == "Total")
    return pd.concat([settings[PARAMETERS[family]], table.assign(f1_published=f1)], axis=1)


def morphology_readings(subsets: list[Subset], grid: int = 150) -> pd.DataFrame:
    """Return counts of morphological clustering by number of dilations and size rule.

    ``grid`` is R, by default of the best row of Table 5.9, thesis.
    """
    ends = {"none": 0, "once (this work)": 1, "twice": 2, "until unchanged": None}
    methods = {
        (name, size_rule): from_cloud(MorphologicalClustering(grid, end, size_rule))
        for size_rule in (False, True)
        for name, end in ends.items()
    }
    table = sum_counts(run(subsets, methods), ["method"])
    names = pd.DataFrame(table.pop("method").tolist(), columns=["dilations", "size_rule"])
    published = claims.published(TABLES["mo"]).set_index("R")["f1"][grid]
    return pd.concat([names, table.assign(f1_published=published)], axis=1)


def cluster_totals(tables: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return the rows of `cluster_table` that sum over all subsets, by family."""
    return {name: table[table["subset"] == "Total"] for name, table in tables.items()}


def analysed_recall(attempts: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return `class_recall` with the settings that the thesis analyses."""
    return class_recall(attempts[attempts["row"] == attempts["family"].map(ANALYSED)], by)


def cluster_verdicts(
    tables: Mapping[str, pd.DataFrame], attempts: pd.DataFrame, note: str
) -> list[claims.Verdict]:
    """Return the verdicts on the clusterers (section 5.1.3).

    Parameters
    ----------
    tables
        Of `cluster_table`, by family.
    attempts
        Of `compare_clusterers`.
    note
        How many frames, and which scoring distance.
    """
    totals = cluster_totals(tables)
    dbscan, mo, qcc = (totals[family].set_index(PARAMETERS[family]) for family in TABLES)
    by_points = dbscan.groupby(level="minPts")
    eps = {f"minPts {n}: FP falls": fp.is_monotonic_decreasing for n, fp in by_points["fp"]}
    eps |= {f"minPts {n}: FN rises": fn.is_monotonic_increasing for n, fn in by_points["fn"]}
    of_eps = dbscan["f1"].groupby(level="minPts").agg(np.ptp).mean()
    of_points = dbscan["f1"].groupby(level="epsilon_mm").agg(np.ptp)[[30, 50, 70]].mean()
    seconds = dbscan["seconds_per_image"]
    slower = seconds[(6, 50)] / seconds[(6, 10)]
    grows = {name: mo[name].is_monotonic_increasing for name in ("tp", "fp", "seconds_per_image")}
    by_alpha = qcc["fp"].groupby(level="alpha")
    alphas = {f"alpha {n}: FP falls with K": fp.is_monotonic_decreasing for n, fp in by_alpha}
    recall, precision = (
        qcc[name].unstack("alpha").diff(axis=1)[0.2] for name in ("recall", "precision")
    )
    for k in (20, 25, 30):
        alphas[f"K {k}: recall up with alpha"] = bool(recall[k] > 0)
        alphas[f"K {k}: precision down"] = bool(precision[k] < 0)
    return [
        claims.judge("cluster-1", eps, note=note),
        claims.judge("cluster-2", of_eps / of_points, note=f"{note}; mean range of F1"),
        claims.judge("cluster-3", slower, note="minPts 6, median time"),
        claims.judge("cluster-4", grows, note=note),
        claims.judge("cluster-5", alphas, note=note),
        *_class_verdicts(attempts, note),
    ]


def _class_verdicts(attempts: pd.DataFrame, note: str) -> list[claims.Verdict]:
    """Return the verdicts on which classes the clusterers detect."""
    pooled = analysed_recall(attempts, ["family"])
    by_class = pooled.pivot(index="family", columns="label", values="recall")
    most = {
        f"{truth.CLASSES[k]}: {by_class[k].round(2).to_dict()}": by_class[k].idxmax() == "qcc"
        for k in (3, 4)
    }
    walls = analysed_recall(attempts, ["family", "subset"]).query("label == 4")
    half = walls.query("family == 'dbscan'").set_index("subset")["recall"].filter(["V1", "V4"])
    return [
        claims.judge("cluster-7", by_class[2], note=f"{note}; all subsets"),
        claims.judge("cluster-8", half, note=note),
        claims.judge("cluster-9", most, note=note),
    ]


def compare_methods(subsets: list[Subset], thresholds: pd.Series) -> pd.DataFrame:
    """Return `run` of the eleven methods of Table 5.11, with each subset's DoG threshold."""
    parts = []
    for subset in subsets:
        threshold, roi = float(thresholds[subset.name]), subset.recording.attributes.roi
        parts.append(run([subset], table_5_11_methods(threshold, roi)))
    return pd.concat(parts, ignore_index=True)


def f1_beside_published(attempts: pd.DataFrame, seed: int) -> tuple[pd.DataFrame, pd.Series]:
    """Return `f1_with_intervals` beside Table 5.11, also ``f1_published_recomputed``.

    That is the F1 of the printed counts.
    """
    printed = claims.published("table_5.11").set_index("method")
    f1, first = f1_with_intervals(attempts, printed["f1"], seed)
    recomputed = 2 * printed["TP"] / (2 * printed["TP"] + printed["FP"] + printed["FN"])
    return f1.assign(f1_published_recomputed=recomputed), first


def recall_by_class(attempts: pd.DataFrame) -> pd.DataFrame:
    """Return the recall of each class in a column, by method in the order of `run`."""
    recall = class_recall(attempts, ["method"])
    by_class = recall.pivot(index="method", columns="label", values="recall")
    by_class.columns = ["burning_in_air", "non_burning_in_air", "burning_on_wall"]
    return by_class.loc[attempts["method"].unique()].reset_index()


def combination_verdicts(total: pd.DataFrame, first: pd.Series, note: str) -> list[claims.Verdict]:
    """Return the verdicts on Table 5.11.

    Parameters
    ----------
    total
        Of `sum_counts`, by method.
    first
        Share of the draws in which a method is first (`f1_with_intervals`).
    note
        How many frames, and which scoring distance.
    """
    rates = total[["precision", "recall", "f1"]]
    combined = rates[rates.index.str.startswith("Combi")].rename(lambda name: name.split()[1])
    alone = rates.loc["2D-" + combined.index.str.split("+").str[0]].set_axis(combined.index)
    change = combined - alone
    otsu, sift = (
        change[change.index.str.startswith(name)].rename(lambda pair: pair.split("+")[1])
        for name in ("OTSU", "SIFT")
    )
    slight = {
        f"{name}: recall {value:+.3f}": value > 0.03 for name, value in otsu["recall"].items()
    }
    for name, value in otsu["precision"].items():
        slight[f"{name}: precision {value:+.3f}"] = -0.05 < value < 0
    words = "precision " + sift["precision"].map("{:+.3f}".format)
    words = sift.index + ": " + words + ", recall " + sift["recall"].map("{:+.3f}".format)
    both = dict(zip(words, (sift[["precision", "recall"]] > 0).all(axis=1), strict=True))
    f1, best = rates["f1"], str(rates["f1"].idxmax())
    gap = f1[["2D-OTSU", "2D-SIFT"]].min() - f1[f1.index.str.startswith("3D")]
    below = {f"{name} {value:.3f} below": value >= 0.1 for name, value in gap.items()}
    sure = f"{note}; first in {first[best]:.0%} of the draws"
    return [
        claims.judge("cluster-6", below, note=f"{note}; below the lower of Otsu and SIFT"),
        claims.judge("combi-1", change["f1"], note=note),
        claims.judge("combi-2", {f"first is {best}": best == "Combi SIFT+DBSCAN"}, note=sure),
        claims.judge("combi-3", slight, note=note),
        claims.judge("combi-4", both, note=note),
    ]
