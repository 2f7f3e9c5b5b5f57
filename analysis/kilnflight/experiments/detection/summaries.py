"""Tables of the detection experiment (thesis, sections 5.1.2 to 5.1.4).

tables of `detection` -> rates by subset and class beside the publication -> frames
drawn anew
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np
import pandas as pd

from kilnflight.detection import Polygon
from kilnflight.experiments.detection.labelled import COUNTS, sum_counts
from kilnflight.publication import claims
from kilnflight.scores import count_in_air, rates, score_detections
from kilnflight.scores.intervals import DRAWS
from kilnflight.simulated.kiln import truth

RATES = ["precision", "recall", "f1"]


def with_total(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return `sum_counts` of each subset, and below them of all subsets ("Total").

    ``by`` contains ``subset``. The total does not keep ``threshold`` apart, since each
    subset has its own.
    """
    total = sum_counts(
        table.assign(subset="Total"), [name for name in by if name != "threshold"]
    )
    return pd.concat([sum_counts(table, by), total], ignore_index=True)


def beside_published(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return a table of rates with the published ones as columns ``..._published``.

    ``name`` is a published table such as "table_5.11"; rows match by ``subset`` or
    ``method``.
    """
    printed = claims.published(name).rename(columns={"test_set": "subset"})
    keys = [key for key in ("subset", "method") if key in printed]
    printed = printed[[*keys, *RATES]].rename(
        columns={rate: f"{rate}_published" for rate in RATES}
    )
    return table.merge(printed, how="left", on=keys)


def class_recall(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return the recall of each class of particles (as in Figs 5.5 and 5.6).

    Counts of ``table`` (from `kilnflight.experiments.detection.labelled.run`) are
    summed over frames; columns ``by`` stay apart.

    Returns
    -------
    DataFrame
        ``by``, ``label`` (2, 3, 4 of Table 5.1), ``tp``, ``fn``, ``recall`` (NaN
        without particles) and ``kind``, the class in words.
    """
    groups = table.groupby(by, sort=False)
    parts = []
    for label, kind in truth.CLASSES.items():
        counts = (
            groups[[f"tp_{label}", f"fn_{label}"]].sum().set_axis(["tp", "fn"], axis=1)
        )
        counts.insert(0, "label", label)
        recall = counts["tp"] / (
            counts["tp"] + counts["fn"]
        )  # NaN where none is marked
        parts.append(counts.assign(recall=recall, kind=kind).reset_index())
    return pd.concat(parts, ignore_index=True)


def classification_table(
    marked: pd.DataFrame,
    spots: pd.DataFrame,
    thresholds: Mapping[str, float],
    roi: Polygon | None,
) -> pd.DataFrame:
    """Return the rates of telling air from wall (Tables 5.13 and 5.14).

    A spot is in the air if its distance from the wall's axis is at most a threshold.

    Parameters
    ----------
    marked
        Marked particles from `detection.positions`; those without ``distance_mm`` do
        not count.
    spots
        Detections from `detection.positions` (Table 5.14), or the marked particles
        themselves (Table 5.13).
    thresholds
        Largest distance from the axis that counts as in the air, in mm, by name.
    roi
        Region of interest: corners (row, col); points outside do not count.

    Returns
    -------
    DataFrame
        A row per threshold and subset (and "Total"): ``threshold`` (name),
        ``threshold_mm``, ``subset``, ``tp``, ``fp``, ``fn``, ``precision``, ``recall``,
        ``f1``. A true positive is a particle in the air whose spot is classified so.
    """
    frames = []
    rows = []
    for (subset, frame), particles in marked.groupby(["subset", "frame"], sort=False):
        found = spots[(spots["subset"] == subset) & (spots["frame"] == frame)]
        score = score_detections(
            particles[["row", "col"]], found[["row", "col"]], roi=roi
        )
        flying = (particles["label"] != 4) & particles["distance_mm"].notna()
        frames.append((subset, flying, found["distance_mm"], score))
    for (name, level), (subset, flying, distance, score) in product(
        thresholds.items(), frames
    ):
        row = {"threshold": name, "threshold_mm": level, "subset": subset}
        rows.append(row | count_in_air(score, flying, distance <= level))
    table = pd.DataFrame(rows)
    keys = ["threshold", "threshold_mm", "subset"]
    both = pd.concat([table, table.assign(subset="Total")]).groupby(keys, sort=False)
    counts = both[list(COUNTS)].sum().reset_index()
    return pd.concat([counts, rates(*(counts[count] for count in COUNTS))], axis=1)


def resampled_rates(
    table: pd.DataFrame, seed: int, draws: int = DRAWS
) -> dict[str, pd.DataFrame]:
    """Return precision, recall and F1 over draws of frames, (draws, methods) each.

    ``table`` is from `detection.run`. Frames are drawn with replacement within each
    subset, the same for all methods, so differences between methods are paired. If a
    subset has one frame, there are no draws: each would be the same, and the interval
    would have no width.
    """
    generator = np.random.default_rng(seed)
    sums = []
    if table.groupby("subset")["frame"].nunique().min() < 2:
        draws = 0
    for _, rows in table.groupby("subset", sort=False):
        wide = rows.pivot(index="frame", columns="method", values=list(COUNTS))
        picked = generator.integers(len(wide), size=(draws, len(wide)))
        sums.append(
            pd.DataFrame(wide.to_numpy()[picked].sum(axis=1), columns=wide.columns)
        )
    total = sum(sums[1:], start=sums[0])
    tp, fp, fn = (pd.DataFrame(total[count]) for count in COUNTS)
    return {
        "precision": tp / (tp + fp).clip(lower=1),
        "recall": tp / (tp + fn).clip(lower=1),
        "f1": 2 * tp / (2 * tp + fp + fn).clip(lower=1),
    }


def f1_with_intervals(
    table: pd.DataFrame, published: pd.Series, seed: int
) -> pd.DataFrame:
    """Return each method's F1 with its 95 % interval over draws of frames.

    Parameters
    ----------
    table
        From `detection.run`.
    published
        Published F1 by method.
    seed
        Seed of the draws.

    Returns
    -------
    DataFrame
        Index ``method``; ``f1``, ``f1_low``, ``f1_high`` (NaN with one frame per
        subset); ``f1_in_pixels``, scored within a particle's pixels; ``f1_published``
        (NaN if not printed).
    """
    total = sum_counts(table, ["method"]).set_index("method")
    draws = resampled_rates(table, seed)["f1"]
    low, high = draws[total.index].quantile([0.025, 0.975]).to_numpy()
    f1 = total[["f1"]].assign(
        f1_low=low, f1_high=high, f1_in_pixels=total["f1_in_pixels"]
    )
    return f1.assign(f1_published=published)
