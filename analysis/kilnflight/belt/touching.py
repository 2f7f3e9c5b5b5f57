"""Spots held against the truth: who shared one, and how far off the others are (2016, II.B).

Two particles that touch are one spot at their common centroid, and nothing tells the tracker so:
each measurement goes to one track. What that costs is counted with the truth.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.spatial import KDTree

from kilnflight.belt.area import TRACKED, Area
from kilnflight.checks import check_columns

APART = 1e6  # mm: what one frame is worth, more than any belt is long


def seen_together(
    spots: pd.DataFrame, truth: pd.DataFrame, area: Area = TRACKED
) -> npt.NDArray[np.int64]:
    """Return the particles whose nearest spot was marked as several, in any frame.

    Parameters
    ----------
    spots
        ``frame``, ``x``, ``y``, ``touching``, as `kilnflight.tables.BELT_SPOTS`.
    truth
        ``frame``, ``particle``, ``x``, ``y`` of the particles in the same frames.
    area
        Only places in it count.

    Returns
    -------
    ndarray
        Their names, each once, ascending; none where there is no spot.
    """
    check_columns(spots, ["frame", "x", "y", "touching"], "spots")
    check_columns(truth, ["frame", "particle", "x", "y"], "truth")
    there = truth[area.holds(truth[["x", "y"]].to_numpy(np.float64))]
    there = there[there["frame"].isin(spots["frame"])]
    if not len(there):
        return np.empty(0, dtype=np.int64)
    scale = np.array([APART, 1.0, 1.0])
    names = ["frame", "x", "y"]
    tree = KDTree(scale * spots[names].to_numpy(np.float64))
    _, nearest = tree.query(scale * there[names].to_numpy(np.float64))
    several = spots["touching"].to_numpy()[nearest] == 1
    return np.unique(there["particle"].to_numpy(np.int64)[several])


def place_errors(spots: pd.DataFrame, truth: pd.DataFrame) -> dict[str, float]:
    """Return how far the places of single particles are off, spot minus nearest true centre.

    Parameters
    ----------
    spots
        ``frame``, ``x``, ``y``, ``touching``; those that are marked as several do not count.
    truth
        ``frame``, ``x``, ``y`` of the particles; a frame without any does not count.

    Returns
    -------
    dict
        ``bias_along_mm``, ``rms_along_mm``, ``bias_across_mm``, ``rms_across_mm`` (of the error
        itself, so that the bias is part of it); NaN where no spot counts.
    """
    check_columns(spots, ["frame", "x", "y", "touching"], "spots")
    check_columns(truth, ["frame", "x", "y"], "truth")
    names = ["frame", "x", "y"]
    single = spots.loc[(spots["touching"] == 0) & spots["frame"].isin(truth["frame"]), names]
    found: dict[str, float] = {}
    known = truth[names].to_numpy(np.float64)
    seen, scale = single.to_numpy(np.float64), np.array([APART, 1.0, 1.0])
    nearest = np.empty(0, dtype=np.intp)
    if len(seen):
        nearest = np.asarray(KDTree(scale * known).query(scale * seen)[1])
    for column, name in ((1, "along"), (2, "across")):
        off = seen[:, column] - known[nearest, column] if len(seen) else np.array([np.nan])
        found[f"bias_{name}_mm"] = float(off.mean())
        found[f"rms_{name}_mm"] = float(np.sqrt((off**2).mean()))
    return found
