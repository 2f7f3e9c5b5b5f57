"""How fast particles move along the belt (2020 paper, Figs 7 and 8)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.tables import BELT_TRACKS

Array = npt.NDArray[np.float64]


def step_velocities(tracks: pd.DataFrame) -> pd.DataFrame:
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
    columns = {
        "particle": table["particle"],
        "x": table["x"] - step["x"] / 2,
        "velocity_x_mm_s": step["x"] / step["time_s"],
        "velocity_y_mm_s": step["y"] / step["time_s"],
    }
    consecutive = (step["particle"] == 0) & (step["frame"] == 1)
    return pd.DataFrame(columns)[consecutive].reset_index(drop=True)


def motion_profile(steps: pd.DataFrame, x_mm: Array) -> pd.DataFrame:
    """Return how fast particles move at places along the belt.

    Figs 7 and 8 of the 2020 paper.

    Each particle's velocity is interpolated linearly along x (section 4.1); a particle
    counts only where it was seen.

    Parameters
    ----------
    steps
        From `step_velocities`.
    x_mm
        Places, (n,), ascending.

    Returns
    -------
    DataFrame
        Columns ``x_mm``, ``mean_m_s``, ``std_m_s``, ``particles``, ``lateral_m_s`` (median of the
        absolute velocity across the belt) and ``lateral_std_m_s``. A few collisions dominate both
        standard deviations. Hence ``median_m_s``, ``iqr_m_s`` and ``width_m_s`` (from 5 to 95 %)
        along the belt, and ``lateral_iqr_m_s`` and ``lateral_width_m_s`` across it. NaN where no
        particle was seen.
    """
    along = velocities_at(steps, "velocity_x_mm_s", x_mm) / 1000.0
    across = velocities_at(steps, "velocity_y_mm_s", x_mm) / 1000.0
    return pd.DataFrame(
        {
            "x_mm": x_mm,
            "mean_m_s": along.mean(),
            "std_m_s": along.std(),
            "particles": along.count(),
            "lateral_m_s": across.abs().median(),
            "lateral_std_m_s": across.std(),
            "median_m_s": along.median(),
            "iqr_m_s": along.quantile(0.75) - along.quantile(0.25),
            "width_m_s": along.quantile(0.95) - along.quantile(0.05),
            "lateral_iqr_m_s": across.quantile(0.75) - across.quantile(0.25),
            "lateral_width_m_s": across.quantile(0.95) - across.quantile(0.05),
        }
    )


def velocities_at(steps: pd.DataFrame, column: str, x_mm: Array) -> pd.DataFrame:
    """Return a column of `step_velocities` at places along the belt, one row per particle.

    It is NaN where the particle was not seen.
    """
    rows = [
        np.interp(x_mm, track["x"], track[column], left=np.nan, right=np.nan)
        for _, track in steps.groupby("particle", sort=False)
    ]
    return pd.DataFrame(rows, columns=range(len(x_mm)), dtype=np.float64)
