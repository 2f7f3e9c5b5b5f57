"""The detection experiment beside the thesis, and the verdicts on its claims.

Sections 5.1.2 to 5.1.4.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.background import BackgroundModel
from kilnflight.detection import (
    DBSCAN,
    Clusterer,
    MorphologicalClustering,
    Otsu,
    QuasiClusterCenters,
)
from kilnflight.detection.wall import Cylinder
from kilnflight.experiments.detection import (
    Subset,
    class_recall,
    compare_thresholds,
    leave_one_out,
    run,
    tried_thresholds,
    with_total,
)
from kilnflight.experiments.detection_methods import (
    Method,
    eight_bits,
    from_cloud,
    from_foreground,
    from_thresholds,
)
from kilnflight.project import claims
from kilnflight.twin import truth
from kilnflight.twin.camera import Geometry

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
    otsu: pd.DataFrame, sift: pd.DataFrame, recall: pd.DataFrame, seconds: pd.Series, note: str
) -> list[claims.Verdict]:
    """Return the verdicts on Otsu and SIFT (section 5.1.3).

    Parameters
    ----------
    otsu, sift
        Tables 5.5 and 5.6, of `with_total`.
    recall
        Of `class_recall` by method and subset.
    seconds
        Of one frame, by threshold.
    note
        How many frames, and which scoring distance.
    """
    of_otsu, of_sift = (table.set_index("subset") for table in (otsu, sift))
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


def published_radius_mm() -> float:
    """Return the radius of the fitted cylinder as printed in Table 5.12."""
    printed = claims.published("table_5.12").set_index("quantity")["value_mm"]
    return float(printed["Radius"])


def cylinder_table(fits: Mapping[str, Cylinder], geometry: Geometry) -> pd.DataFrame:
    """Return the fitted cylinder of each subset beside the true one and Table 5.12."""
    along = [abs(np.dot(fit.direction, geometry.axes[0])) for fit in fits.values()]
    names = ["radius_mm", "inliers", "rms_mm"]
    table = pd.DataFrame([asdict(fit) for fit in fits.values()])[names]
    table.insert(0, "subset", list(fits))
    table.insert(2, "radius_true_mm", geometry.kiln_radius_mm)
    table.insert(3, "radius_published_mm", published_radius_mm())
    table.insert(4, "direction_off_deg", np.degrees(np.arccos(np.minimum(along, 1.0))))
    return table


def wall_verdicts(
    cylinders: pd.DataFrame, crossing_mm: float, marked: pd.DataFrame, detected: pd.DataFrame
) -> list[claims.Verdict]:
    """Return the verdicts on the wall and on what is in the air (section 5.1.4).

    Parameters
    ----------
    cylinders
        Of `cylinder_table`; the first one serves all subsets.
    crossing_mm
        Distance from the axis where the two Gaussians cross.
    marked, detected
        Tables 5.13 and 5.14, of `classification_table`, with the thresholds
        "crossing_plus_40" and "printed_800".
    """
    exact, measured = (
        table[table["subset"] == "Total"].set_index("threshold") for table in (marked, detected)
    )
    radius = cylinders.set_index("subset")["radius_mm"]
    off = radius / cylinders["radius_true_mm"].to_numpy() - 1
    f1, lower = exact["f1"]["crossing_plus_40"], measured["f1"]["crossing_plus_40"]
    conditions = {f"{lower:.4f} < {f1:.4f}": lower < f1, "at least 0.8": lower >= 0.8}
    missed = 1 - exact["recall"]["crossing_plus_40"]
    printed = f"with 800 mm F1 {exact['f1']['printed_800']:.3f}"
    note = f"crossing + 40 mm = {crossing_mm + 40:.0f} mm; {printed}"
    return [
        claims.judge("wall-1", off, note="one frame of each subset, against the true 700 mm"),
        claims.judge("wall-2", crossing_mm - radius.iloc[0], note=f"crossing {crossing_mm:.0f} mm"),
        claims.judge("wall-3", f1, note=note),
        claims.judge("wall-4", conditions, note=note),
        claims.judge("wall-5", missed, note=note),
    ]
