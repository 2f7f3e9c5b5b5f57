"""The detection experiment beside sections 5.1.2 to 5.1.4, and the verdicts on its claims."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

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


class Family(NamedTuple):
    """A clusterer and the table of the thesis that lists its settings."""

    table: str
    parameters: list[str]  # its columns
    clusterer: Callable[[Any], Clusterer]  # of a row of it
    analysed: int  # row whose recall by class section 5.1.3 discusses


FAMILIES = {
    "dbscan": Family(
        "table_5.8", ["minPts", "epsilon_mm"], lambda row: DBSCAN(row.epsilon_mm, row.minPts), 5
    ),
    "mo": Family("table_5.9", ["R"], lambda row: MorphologicalClustering(row.R), 1),
    "qcc": Family(
        "table_5.10", ["K", "alpha"], lambda row: QuasiClusterCenters(row.K, row.alpha), 2
    ),
}


def compare_backgrounds(
    subsets: list[Subset], models: Mapping[str, BackgroundModel], scale: str
) -> pd.DataFrame:
    """Return the chosen rows of `compare_thresholds` for each background, with ``model``."""
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
    methods: dict[tuple[str, float], Method] = {("Otsu", 0): from_foreground(Otsu())}
    for name, graded in {
        "SIFT": from_thresholds(thresholds),
        "8 bits": from_thresholds(thresholds, eight_bits),
    }.items():
        methods |= {(name, threshold): method for threshold, method in graded.items()}
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
    """Return how far backgrounds of frame t are from the scene without any particle, ``clean``.

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
        How many frames, and which gate.
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
        How many frames, and which gate.
    """
    of_otsu, of_sift = (table.set_index("subset") for table in (otsu, sift))
    subsets = of_otsu.index.drop("Total")
    by_class = {
        name: rows.pivot(index="subset", columns="label", values="recall")
        for name, rows in recall.groupby("method")
    }
    burning, unlit, more = by_class["Otsu"][2], by_class["Otsu"][3], by_class["SIFT"][3]
    last, last_of_sift = (table.loc[subsets, "f1"].idxmin() for table in (of_otsu, of_sift))
    lowest = {"V4 lowest": unlit.idxmin() == "V4" or bool(unlit["V4"] == unlit.min())}
    half = {f"{name} {value:.2f} <= 0.5": bool(value <= 0.5) for name, value in unlit.items()}
    about = {
        f"{name} {more[name]:.2f} in 0.35..0.75": 0.35 <= more[name] <= 0.75 for name in subsets
    }
    above = {f"{name} above Otsu {unlit[name]:.2f}": more[name] > unlit[name] for name in subsets}
    both = of_sift["f1"]["Total"], of_otsu["f1"]["Total"]
    gap = of_sift["f1"]["V5"] - of_otsu["f1"]["V5"]
    v5 = {f"last is {last_of_sift}": last_of_sift == "V5", f"V5 {gap:+.3f} >= 0.05": gap >= 0.05}
    precision = claims.judge("otsu-1", of_otsu.loc[subsets, "precision"], note=note)
    rank = claims.judge("otsu-4", {f"last is {last}": last == "V5"}, note=note)
    return [
        claims.fitted(precision, FITTED),
        claims.judge("otsu-2", burning, note=note),
        claims.judge("otsu-3", half | lowest, note=f"{note}; although {FITTED}"),
        claims.fitted(rank, FITTED),
        claims.judge("sift-1", {f"{both[0]:.4f} > {both[1]:.4f}": both[0] > both[1]}, note=note),
        claims.judge("sift-2", about | above, note=note),
        claims.judge("sift-3", v5, note=note),
        claims.judge("sift-4", seconds[400] / seconds[1000], note="median time of a frame"),
    ]


def compare_clusterers(subsets: list[Subset]) -> pd.DataFrame:
    """Return `run` of all settings of Tables 5.8 to 5.10, with ``family`` and ``row``."""
    methods = {
        (name, row.Index): from_cloud(family.clusterer(row))
        for name, family in FAMILIES.items()
        for row in claims.published(family.table).itertuples()
    }
    table = run(subsets, methods)
    table[["family", "row"]] = table["method"].to_list()
    return table


def cluster_table(attempts: pd.DataFrame, family: str) -> pd.DataFrame:
    """Return the counts of a family's settings by subset and in total, beside the publication.

    Parameters
    ----------
    attempts
        Of `compare_clusterers`.
    family
        One of `FAMILIES`.

    Returns
    -------
    DataFrame
        The parameters, the columns of `with_total`, and ``f1_published`` in the total.
    """
    printed = claims.published(FAMILIES[family].table)
    table = with_total(attempts[attempts["family"] == family], ["row", "subset"])
    settings = printed.loc[table.pop("row")].reset_index(drop=True)
    f1 = settings["f1"].where(table["subset"] == "Total")
    return pd.concat([settings[FAMILIES[family].parameters], table.assign(f1_published=f1)], axis=1)


def cluster_totals(tables: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return the rows of `cluster_table` that sum over all subsets, by family."""
    return {name: table[table["subset"] == "Total"] for name, table in tables.items()}


def analysed_settings(attempts: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of `compare_clusterers` with the settings that the thesis analyses."""
    analysed = {name: family.analysed for name, family in FAMILIES.items()}
    return attempts[attempts["row"] == attempts["family"].map(analysed)]


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
        How many frames, and which gate.
    """
    totals = cluster_totals(tables)
    dbscan, mo, qcc = (totals[name].set_index(FAMILIES[name].parameters) for name in FAMILIES)
    by_points = {f"minPts {n}": rows for n, rows in dbscan.groupby(level="minPts")}
    falling = {
        f"{n}: FP falls": rows["fp"].is_monotonic_decreasing for n, rows in by_points.items()
    }
    rising = {f"{n}: FN rises": rows["fn"].is_monotonic_increasing for n, rows in by_points.items()}
    of_eps = dbscan["f1"].groupby(level="minPts").agg(np.ptp).mean()
    of_points = dbscan["f1"].groupby(level="epsilon_mm").agg(np.ptp)[[30, 50, 70]].mean()
    seconds = dbscan["seconds_per_image"]
    grows = {name: mo[name].is_monotonic_increasing for name in ("tp", "fp", "seconds_per_image")}
    conditions = {
        f"alpha {alpha}: FP falls with K": rows["fp"].is_monotonic_decreasing
        for alpha, rows in qcc.groupby(level="alpha")
    }
    wide = {name: qcc[name].unstack("alpha") for name in ("recall", "precision")}
    rise = {name: table[0.2] - table[0.1] for name, table in wide.items()}
    for k in (20, 25, 30):
        conditions[f"K {k}: recall up with alpha"] = bool(rise["recall"][k] > 0)
        conditions[f"K {k}: precision down"] = bool(rise["precision"][k] < 0)
    picked = analysed_settings(attempts)
    pooled = class_recall(picked, ["family"]).pivot(
        index="family", columns="label", values="recall"
    )
    walls = class_recall(picked, ["family", "subset"]).query("family == 'dbscan' and label == 4")
    most = {
        f"{truth.CLASSES[k]}: {pooled[k].round(2).to_dict()}": pooled[k].idxmax() == "qcc"
        for k in (3, 4)
    }
    half = walls.set_index("subset")["recall"].filter(["V1", "V4"])
    return [
        claims.judge("cluster-1", falling | rising, note=note),
        claims.judge("cluster-2", of_eps / of_points, note=f"{note}; mean range of F1"),
        claims.judge(
            "cluster-3", seconds[(6, 50)] / seconds[(6, 10)], note="minPts 6, median time"
        ),
        claims.judge("cluster-4", grows, note=note),
        claims.judge("cluster-5", conditions, note=note),
        claims.judge("cluster-7", pooled[2], note=f"{note}; all subsets"),
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
        How many frames, and which gate.
    """
    rates = total[["precision", "recall", "f1"]]
    combined = rates[rates.index.str.startswith("Combi")].rename(lambda name: name.split()[1])
    alone = rates.loc["2D-" + combined.index.str.split("+").str[0]].set_axis(combined.index)
    change = combined - alone
    otsu, sift = (
        change[change.index.str.startswith(name)].rename(lambda pair: pair.split("+")[1])
        for name in ("OTSU", "SIFT")
    )
    rise = {f"{name}: recall {value:+.3f}": value > 0.03 for name, value in otsu["recall"].items()}
    fall = {
        f"{name}: precision {value:+.3f}": -0.05 < value < 0
        for name, value in otsu["precision"].items()
    }
    both = {
        f"{name}: precision {precision:+.3f}, recall {recall:+.3f}": precision > 0 and recall > 0
        for name, precision, recall in zip(
            sift.index, sift["precision"], sift["recall"], strict=True
        )
    }
    f1, best = rates["f1"], str(rates["f1"].idxmax())
    gap = f1[["2D-OTSU", "2D-SIFT"]].min() - f1[f1.index.str.startswith("3D")]
    below = {f"{name} {value:.3f} below": value >= 0.1 for name, value in gap.items()}
    sure = f"{note}; first in {first[best]:.0%} of the draws"
    return [
        claims.judge("cluster-6", below, note=f"{note}; below the lower of Otsu and SIFT"),
        claims.judge("combi-1", change["f1"], note=note),
        claims.judge("combi-2", {f"first is {best}": best == "Combi SIFT+DBSCAN"}, note=sure),
        claims.judge("combi-3", rise | fall, note=note),
        claims.judge("combi-4", both, note=note),
    ]


def cylinder_table(fits: Mapping[str, Cylinder], geometry: Geometry) -> pd.DataFrame:
    """Return the fitted cylinder of each subset beside the true one and Table 5.12."""
    along = [abs(np.dot(fit.direction, geometry.axes[0])) for fit in fits.values()]
    return pd.DataFrame(
        {
            "subset": list(fits),
            "radius_mm": [fit.radius_mm for fit in fits.values()],
            "radius_true_mm": geometry.kiln_radius_mm,
            "radius_published_mm": 772.1827,
            "direction_off_deg": np.degrees(np.arccos(np.minimum(along, 1.0))),
            "inliers": [fit.inliers for fit in fits.values()],
            "rms_mm": [fit.rms_mm for fit in fits.values()],
        }
    )


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
    exact, seen = (
        table[table["subset"] == "Total"].set_index("threshold") for table in (marked, detected)
    )
    radius = cylinders.set_index("subset")["radius_mm"]
    off = radius / cylinders["radius_true_mm"].to_numpy() - 1
    f1, lower = exact["f1"]["crossing_plus_40"], seen["f1"]["crossing_plus_40"]
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
