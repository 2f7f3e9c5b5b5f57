"""What the labelled frames can resolve: counts of frames drawn anew.

table of `detection.run` -> draws of frames within each subset -> F1, recall, intervals, ranks
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError
from kilnflight.experiments.detection import COUNTS, sum_counts
from kilnflight.scores import rates
from kilnflight.scores.intervals import Bootstrap, percentiles

DRAWS = Bootstrap().draws


def resampled(
    table: pd.DataFrame, columns: Sequence[str], seed: int, draws: int = DRAWS
) -> pd.DataFrame:
    """Return sums over draws of frames with replacement, within each subset.

    Parameters
    ----------
    table
        Of `detection.run`; every method on the same frames.
    columns
        Counts of the table.
    seed
        Of the draws; all methods see the same draws, so that differences are paired.
    draws
        How many.

    Returns
    -------
    DataFrame
        A row per draw; columns by subset, count and method.
    """
    generator, sums = np.random.default_rng(seed), {}
    for subset, rows in table.groupby("subset", sort=False):
        wide = rows.pivot(index="frame", columns="method", values=list(columns))
        if wide.isna().to_numpy().any():
            raise InputError("resampled: a method lacks a frame; give all methods all frames.")
        picked = generator.integers(len(wide), size=(draws, len(wide)))
        summed = wide.to_numpy()[picked].sum(axis=1)
        sums[subset] = pd.DataFrame(summed, columns=wide.columns)
    return pd.concat(sums, axis=1)


def resampled_rates(table: pd.DataFrame, seed: int, draws: int = DRAWS) -> dict[str, pd.DataFrame]:
    """Return precision, recall and F1 of each method over draws, by name of the rate.

    Each is (draws, methods); arguments as of `resampled`.
    """
    sums = resampled(table, COUNTS, seed, draws)
    pooled = sums.T.groupby(level=[1, 2], sort=False).sum().T
    counts = [pooled.loc[:, count] for count in COUNTS]
    flat = rates(*(part.to_numpy().ravel() for part in counts))
    shape, methods = counts[0].shape, counts[0].columns
    return {
        name: pd.DataFrame(flat[name].to_numpy().reshape(shape), columns=methods)
        for name in ("precision", "recall", "f1")
    }


def f1_with_intervals(table: pd.DataFrame, published: pd.Series, seed: int) -> pd.DataFrame:
    """Return each method's F1 with its 95 % interval over draws of frames.

    Parameters
    ----------
    table
        Of `detection.run`; every method on the same frames.
    published
        F1 by method; those that are missing are NaN.
    seed
        Of the draws of frames, see `resampled`.

    Returns
    -------
    DataFrame
        By ``method``: ``f1``, ``f1_low``, ``f1_high``, ``f1_in_pixels``, ``f1_published``.
    """
    total = sum_counts(table, ["method"]).set_index("method")
    draws = resampled_rates(table, seed)["f1"]
    low, high = draws[total.index].quantile([0.025, 0.975]).to_numpy()
    f1 = total[["f1"]].assign(f1_low=low, f1_high=high, f1_in_pixels=total["f1_in_pixels"])
    return f1.assign(f1_published=published)


def subset_f1(table: pd.DataFrame, method: str, seed: int) -> pd.DataFrame:
    """Return a method's F1 of each subset over draws, (draws, subsets)."""
    tp, fp, fn = _by_subset(table, method, COUNTS, seed)
    return 2 * tp / (2 * tp + fp + fn).clip(lower=1)


def subset_recall(table: pd.DataFrame, method: str, label: int, seed: int) -> pd.DataFrame:
    """Return a method's recall of a class in each subset over draws, (draws, subsets)."""
    tp, fn = _by_subset(table, method, [f"tp_{label}", f"fn_{label}"], seed)
    return tp / (tp + fn).clip(lower=1)


def _by_subset(
    table: pd.DataFrame, method: str, columns: Sequence[str], seed: int
) -> list[pd.DataFrame]:
    sums, subsets = resampled(table, columns, seed), table["subset"].unique()
    return [
        pd.DataFrame({subset: sums[(subset, column, method)] for subset in subsets})
        for column in columns
    ]


def interval(values: npt.ArrayLike) -> str:
    """Return the 95 % interval of draws in words.

    Examples
    --------
    >>> interval([0.1] * 9)
    '95 % [+0.100, +0.100]'
    """
    low, high = percentiles(values)
    return f"95 % [{low:+.3f}, {high:+.3f}]"


def share(holds: npt.ArrayLike) -> str:
    """Return in how many draws a condition holds, in words.

    Examples
    --------
    >>> share([True, True, False, True])
    'in 75% of the draws of frames'
    """
    return f"in {np.mean(np.asarray(holds, dtype=bool)):.0%} of the draws of frames"
