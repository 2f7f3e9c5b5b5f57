"""Tables of the detection experiment (thesis, sections 5.1.2 to 5.1.4).

They sum the counts of `kilnflight.experiments.detection.labelled` by subset and class,
beside the publication, and draw frames anew for intervals.
"""

import numpy as np
import pandas as pd
from pandas import DataFrame, Series

from kilnflight.experiments.detection.labelled import COUNTS, sum_counts
from kilnflight.publication import claims
from kilnflight.scores.intervals import DRAWS
from kilnflight.simulated.kiln import truth

RATES = ["precision", "recall", "f1"]


def with_total(table: DataFrame, by: list[str]) -> DataFrame:
    """Sum counts of each subset, and below them of all subsets ("Total").

    ``by`` contains ``subset``. The total does not keep ``threshold`` apart, since each
    subset has its own.
    """
    every = table.assign(subset="Total")
    total = sum_counts(every, [name for name in by if name != "threshold"])
    return pd.concat([sum_counts(table, by), total], ignore_index=True)


def beside_published(table: DataFrame, name: str) -> DataFrame:
    """Add the published rates to a table as columns ``..._published``.

    ``name`` is a published table such as "table_5.11"; rows match by ``subset`` or
    ``method``.
    """
    printed = claims.published(name).rename(columns={"test_set": "subset"})
    keys = [key for key in ("subset", "method") if key in printed]
    printed = printed.set_index(keys)[RATES].add_suffix("_published")
    return table.merge(printed, how="left", on=keys)


def class_recall(table: DataFrame, by: list[str]) -> DataFrame:
    """Sum the recall of each class of particles (as in Figs 5.5 and 5.6).

    Counts of ``table`` (from `kilnflight.experiments.detection.labelled.score_methods`)
    are summed over frames; columns ``by`` stay apart.

    Returns
    -------
    DataFrame
        ``by``, ``label`` (2, 3, 4 of Table 5.1), ``tp``, ``fn``, ``recall`` (NaN
        without particles) and ``kind``, the class in words.
    """
    sums = table.groupby(by, sort=False).sum(numeric_only=True)
    parts = []
    for label, kind in truth.CLASSES.items():
        tp = sums[f"tp_{label}"]
        fn = sums[f"fn_{label}"]
        recall = tp / (tp + fn)  # NaN where none is marked
        columns = {"label": label, "tp": tp, "fn": fn, "recall": recall, "kind": kind}
        parts.append(DataFrame(columns).reset_index())
    return pd.concat(parts, ignore_index=True)


def f1_by_method(table: DataFrame) -> Series:
    """Sum the counts of `labelled.score_methods`; return F1 by method."""
    return sum_counts(table, ["method"]).set_index("method")["f1"]


def resampled_rates(table: DataFrame, seed: int) -> dict[str, DataFrame]:
    """Draw frames anew; return precision, recall and F1, (draws, methods) each.

    ``table`` is from `labelled.score_methods`. Frames are drawn with replacement within
    each subset, the same for all methods, so differences between methods are paired. If
    a subset has one frame, there are no draws: each would be the same, and the interval
    would have no width.
    """
    generator = np.random.default_rng(seed)
    draws = DRAWS
    if table.groupby("subset")["frame"].nunique().min() < 2:
        draws = 0
    sums = []
    for _, rows in table.groupby("subset", sort=False):
        wide = rows.pivot(index="frame", columns="method", values=COUNTS)
        picked = generator.integers(len(wide), size=(draws, len(wide)))
        sums.append(wide.to_numpy()[picked].sum(axis=1))
    total = DataFrame(np.sum(sums, axis=0), columns=wide.columns)
    tp, fp, fn = (DataFrame(total[count]) for count in COUNTS)
    return {
        "precision": tp / (tp + fp).clip(lower=1),
        "recall": tp / (tp + fn).clip(lower=1),
        "f1": 2 * tp / (2 * tp + fp + fn).clip(lower=1),
    }


def f1_with_intervals(table: DataFrame, published: Series, seed: int) -> DataFrame:
    """Add a 95 % interval over draws of frames to the F1 of each method.

    Parameters
    ----------
    table
        From `labelled.score_methods`.
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
    return total[["f1"]].assign(
        f1_low=low,
        f1_high=high,
        f1_in_pixels=total["f1_in_pixels"],
        f1_published=published,
    )
