"""Counts of detections summed over frames: rates, recall by class, best parameter, intervals.

The tables are those of `kilnflight.experiments.trial.attempt`: one row per frame and method.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from kilnflight.checks import InputError
from kilnflight.scores import rates
from kilnflight.twin import truth


def sums(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return counts and rates summed over frames.

    Parameters
    ----------
    table
        Of `attempt`.
    by
        Columns that stay apart.

    Returns
    -------
    DataFrame
        ``by``, ``tp``, ``fp``, ``fn``, ``precision``, ``recall``, ``f1`` by the gate of 45 px
        (section 3.3); the median ``seconds_per_image``, which one frame that a busy machine
        delayed does not move; and ``f1_in_pixels`` by the pixels of a particle (5.1.1).
    """
    groups = table.groupby(by, sort=False)
    counts = groups[["tp", "fp", "fn"]].sum().reset_index()
    inside = groups[["tp_pixels", "fp_pixels", "fn_pixels"]].sum()
    f1 = rates(*(inside[name] for name in inside.columns))["f1"].to_numpy()
    median = groups["seconds"].median().to_numpy()
    more = {"seconds_per_image": median, "f1_in_pixels": f1}
    together = rates(counts["tp"], counts["fp"], counts["fn"]).assign(**more)
    return pd.concat([counts, together], axis=1)


def class_recall(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return the recall of each class: ``by``, ``label``, ``tp``, ``fn``, ``recall``."""
    parts = []
    for label in truth.CLASSES:
        names = {f"found_{label}": "tp", f"marked_{label}": "marked"}
        one = table.groupby(by, sort=False)[list(names)].sum().rename(columns=names).reset_index()
        missed = one["marked"] - one["tp"]
        recall = rates(one["tp"], 0 * missed, missed)["recall"].where(one["marked"] > 0)
        parts.append(
            one.drop(columns="marked").assign(label=label, fn=missed, recall=recall.to_numpy())
        )
    return pd.concat(parts, ignore_index=True)[[*by, "label", "tp", "fn", "recall"]]


def leave_one_out(table: pd.DataFrame, parameter: str) -> pd.DataFrame:
    """Return for each subset the parameter that is best on the others (section 5.1.3).

    Parameters
    ----------
    table
        Of `attempt`, with a column ``parameter`` beside.

    Returns
    -------
    DataFrame
        ``subset`` and ``parameter``; among equals the smallest.
    """
    subsets = list(table["subset"].unique())
    if len(subsets) < 2:
        raise InputError(f"leave_one_out: needs two subsets or more, got {subsets}.")
    chosen = []
    for subset in subsets:
        others = sums(table[table["subset"] != subset], [parameter]).sort_values(parameter)
        best = others[parameter].to_numpy()[int(np.argmax(others["f1"].to_numpy()))]
        chosen.append({"subset": subset, parameter: best})
    return pd.DataFrame(chosen)


def marked_best(tried: pd.DataFrame) -> pd.DataFrame:
    """Return a table of `attempt` by ``threshold`` with ``chosen``; see `thresholds`."""
    best = leave_one_out(tried, "threshold").set_index("subset")["threshold"]
    return tried.assign(chosen=tried["threshold"] == tried["subset"].map(best))


def resampled_f1(
    table: pd.DataFrame, generator: np.random.Generator, draws: int = 2000
) -> pd.DataFrame:
    """Return F1 of every method over draws of frames with replacement, subset by subset.

    Parameters
    ----------
    table
        Of `attempt`; every method on the same frames.
    generator
        Of the draws; all methods see the same draws, so that differences are paired.

    Returns
    -------
    DataFrame
        (draws, methods), a column per method.
    """
    wide = table.pivot(index=["subset", "frame"], columns="method", values=["tp", "fp", "fn"])
    if wide.isna().to_numpy().any():
        raise InputError("resampled_f1: a method lacks a frame; give all methods all frames.")
    position = wide.reset_index().groupby("subset", sort=False).indices
    picked = np.concatenate(
        [generator.choice(rows, (draws, len(rows))) for rows in position.values()], axis=1
    )
    tp, fp, fn = (wide[name].to_numpy()[picked].sum(axis=1) for name in ("tp", "fp", "fn"))
    return pd.DataFrame(2 * tp / np.maximum(2 * tp + fp + fn, 1), columns=wide["tp"].columns)
