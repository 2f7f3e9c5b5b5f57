"""Velocities over the course of the belt (2020 paper, Figs 7 and 8)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.tables import BELT_TRACKS


def velocities(tracks: pd.DataFrame) -> pd.DataFrame:
    """Return the velocity between consecutive observations, at their midpoint.

    Parameters
    ----------
    tracks
        `kilnflight.tables.BELT_TRACKS`.

    Returns
    -------
    DataFrame
        Columns ``particle``, ``x`` (mm), ``velocity_x_mm_s``, ``velocity_y_mm_s``; steps
        across a gap are left out.
    """
    table = BELT_TRACKS.check(tracks).sort_values(["particle", "frame"], kind="stable")
    step = table.diff()
    joined = ((step["particle"] == 0) & (step["frame"] == 1)).to_numpy()
    return pd.DataFrame(
        {
            "particle": table["particle"].to_numpy(),
            "x": (table["x"] - step["x"] / 2).to_numpy(),
            "velocity_x_mm_s": (step["x"] / step["time_s"]).to_numpy(),
            "velocity_y_mm_s": (step["y"] / step["time_s"]).to_numpy(),
        }
    )[joined].reset_index(drop=True)


def velocity_profile(steps: pd.DataFrame, x_mm: npt.NDArray[np.float64]) -> pd.DataFrame:
    """Return mean and standard deviation of the velocity along the belt at given places.

    Each particle's velocity is interpolated linearly along x (section 4.1); a particle
    counts only where it was seen.

    Parameters
    ----------
    steps
        From `velocities`.
    x_mm
        Places, (n,), ascending.

    Returns
    -------
    DataFrame
        Columns ``x_mm``, ``mean_m_s``, ``std_m_s``, ``particles``.
    """
    stack = _at_places(steps, x_mm, "velocity_x_mm_s") / 1000.0
    seen = np.isfinite(stack)
    count = seen.sum(axis=0)
    total = np.where(seen, stack, 0.0).sum(axis=0)
    mean = np.divide(total, count, out=np.full(len(x_mm), np.nan), where=count > 0)
    square = np.where(seen, (stack - mean) ** 2, 0.0).sum(axis=0)
    variance = np.divide(square, count - 1, out=np.full(len(x_mm), np.nan), where=count > 1)
    return pd.DataFrame(
        {"x_mm": x_mm, "mean_m_s": mean, "std_m_s": np.sqrt(variance), "particles": count}
    )


def motion_profile(steps: pd.DataFrame, x_mm: npt.NDArray[np.float64]) -> pd.DataFrame:
    """Return `velocity_profile`, and how fast particles move across the belt.

    Returns
    -------
    DataFrame
        Its columns, and ``lateral_m_s``: the median over particles of the absolute velocity
        across the belt. A median, as a few collisions would rule a standard deviation;
        that is beside it as ``lateral_std_m_s``. NaN where no particle was seen.
    """
    profile = velocity_profile(steps, x_mm)
    across = _at_places(steps, x_mm, "velocity_y_mm_s") / 1000.0
    seen = [column[np.isfinite(column)] for column in across.T]
    profile["lateral_m_s"] = [np.median(np.abs(v)) if len(v) else np.nan for v in seen]
    profile["lateral_std_m_s"] = [np.std(v, ddof=1) if len(v) > 1 else np.nan for v in seen]
    return profile


def _at_places(
    steps: pd.DataFrame, x_mm: npt.NDArray[np.float64], column: str
) -> npt.NDArray[np.float64]:
    """Return a column of each particle, (particles, places); NaN where it was not seen."""
    curves = [
        np.interp(x_mm, one["x"], one[column], left=np.nan, right=np.nan)
        for _, one in steps.groupby("particle", sort=False)
    ]
    return np.array(curves, dtype=np.float64).reshape(-1, len(x_mm))
