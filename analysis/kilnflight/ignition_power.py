"""How probably an ignition is seen, by simulation."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pandas as pd

from kilnflight.checks import check_between, check_count
from kilnflight.ignition import SEEN, Ignition

LEVEL, SCATTER = 1000.0, 50.0  # grey values before the step


def detection_power(
    rises: Iterable[float],
    points: Iterable[int],
    generator: np.random.Generator,
    method: Ignition | None = None,
    *,
    at: float = 0.5,
    draws: int = 200,
) -> pd.DataFrame:
    """Return how probably a rise is seen, by simulation with Gaussian scatter.

    Parameters
    ----------
    rises
        Heights of the step in standard deviations of the scatter; 0 gives false alarms.
    points
        Lengths of tracks, in detections.
    generator
        Of the scatter.
    method
        `Ignition` with its defaults unless told otherwise.
    at
        Where the step is, as a share of the track.
    draws
        Tracks per row.

    Returns
    -------
    DataFrame
        ``rise``, ``points``, ``at``, ``seen`` (share of tracks), ``off_points`` (median
        distance of the step that was seen from the true one; NaN if none was). The level
        before is 20 standard deviations, so that a ``share`` of 0.1 asks for 2 of them.
    """
    check_between(at, 0.0, 1.0, "detection_power: at")
    check_count(draws, "detection_power: draws")
    test = method if method is not None else Ignition()
    rows = []
    for length in points:
        check_count(length, "detection_power: points")
        split = round(at * length)
        steps = np.arange(length) >= split
        for rise in rises:
            level = LEVEL + SCATTER * rise * steps
            noise = generator.normal(0.0, SCATTER, (draws, length))
            found = [test(np.arange(length), np.maximum(level + one, 0.0)) for one in noise]
            off = [abs(one.time_s + 0.5 - split) for one in found if one.outcome == SEEN]
            middle = float(np.median(off)) if off else math.nan
            row = {"rise": float(rise), "points": int(length), "at": float(at)}
            rows.append(row | {"seen": len(off) / draws, "off_points": middle})
    return pd.DataFrame(rows, columns=["rise", "points", "at", "seen", "off_points"])
