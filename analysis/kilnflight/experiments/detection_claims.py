"""The detection experiment beside the thesis (sections 5.1.2 and 5.1.3).

The verdicts on its claims are in `detection_verdicts`.
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
    leave_one_out,
    run,
    tried_thresholds,
    with_total,
)
from kilnflight.experiments.detection_intervals import f1_with_intervals
from kilnflight.experiments.detection_methods import (
    Method,
    eight_bits,
    from_cloud,
    from_foreground,
    from_thresholds,
    table_5_11_methods,
)
from kilnflight.project import claims

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


def compare_methods(
    subsets: list[Subset], thresholds: pd.Series, clouds_alone: bool = True
) -> pd.DataFrame:
    """Return `run` of the methods of Table 5.11, with each subset's DoG threshold.

    They are eleven; without those that see no picture (``clouds_alone``) eight.
    """
    parts = []
    for subset in subsets:
        threshold, roi = float(thresholds[subset.name]), subset.recording.attributes.roi
        methods = table_5_11_methods(threshold, roi)
        if not clouds_alone:
            methods = {name: methods[name] for name in methods if not name.startswith("3D")}
        parts.append(run([subset], methods))
    return pd.concat(parts, ignore_index=True)


def f1_beside_published(attempts: pd.DataFrame, seed: int) -> pd.DataFrame:
    """Return `f1_with_intervals` beside Table 5.11, also ``f1_published_recomputed``.

    That is the F1 of the printed counts.
    """
    printed = claims.published("table_5.11").set_index("method")
    f1 = f1_with_intervals(attempts, printed["f1"], seed)
    recomputed = 2 * printed["TP"] / (2 * printed["TP"] + printed["FP"] + printed["FN"])
    return f1.assign(f1_published_recomputed=recomputed)


def recall_by_class(attempts: pd.DataFrame) -> pd.DataFrame:
    """Return the recall of each class in a column, by method in the order of `run`."""
    recall = class_recall(attempts, ["method"])
    by_class = recall.pivot(index="method", columns="label", values="recall")
    by_class.columns = ["burning_in_air", "non_burning_in_air", "burning_on_wall"]
    return by_class.loc[attempts["method"].unique()].reset_index()
