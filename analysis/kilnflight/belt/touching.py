"""Which true particles were seen in one spot with another (2016 paper, section II.B).

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
