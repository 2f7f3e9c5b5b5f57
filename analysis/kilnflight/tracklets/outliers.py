"""Detections that make a tracklet turn and jump go (thesis, section 4.2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numba import njit

from kilnflight.checks import check_limit
from kilnflight.tracklets.kinematics import turn, velocity
from kilnflight.tracklets.laws import Differences
from kilnflight.tracklets.paths import LOST, read_paths, write_paths


@dataclass(frozen=True)
class OutlierRemoval:
    """Take a detection out whose velocity differs in angle and in magnitude (Eq. 4.18).

    Each scan judges the first point, then the second backwards (Eq. 4.20), then the others
    forwards (Eq. 4.18). The first outlier found is removed and the scan begins anew, until
    none is found. Called with a track table, it returns the table with particle -1 for
    the outliers.

    Notes
    -----
    Readings. (1) The first velocity is compared with the mean of the three that follow it,
    as the text has it; the caption of Fig. 4.7 speaks of the last point, which the forward
    scan judges anyway. (2) A point is judged only where its equation has what it needs:
    the first from 5 points, the second from 4, the others from 3. (3) A velocity of zero
    has no direction and makes no angle. (4) An outlier at the second point bends the first
    velocity more than the second one, so the order of the text (first point first) also
    removes the good first point of a tracklet of 5 or more. Source: Eqs 4.17 to 4.20, thesis.
    """

    angle_deg: float = 30.0  # degrees, theta_eps, Table 5.16
    change: float = 18.0  # px/frame, Delta V_eps, Table 5.16

    def __post_init__(self) -> None:
        """Refuse limits that are below 0 or no numbers."""
        check_limit(self.angle_deg, "OutlierRemoval: angle_deg")
        check_limit(self.change, "OutlierRemoval: change")

    def __call__(
        self, tracks: pd.DataFrame, differences: Differences | None = None
    ) -> pd.DataFrame:
        """Return the table without outliers in its tracklets; ``differences`` is not used.

        Raises
        ------
        InputError
            If the table is none of tracks (`kilnflight.tracklets.paths.read_paths`).
        """
        paths = read_paths(tracks, "OutlierRemoval: tracks")
        kept = np.ones(len(paths.rows), dtype=np.bool_)
        limits = float(self.angle_deg), float(self.change)
        _scan_all(paths.frame, paths.place, paths.starts, limits, kept)
        return write_paths(tracks, paths, np.where(kept, paths.names(), LOST))


@njit(cache=True)
def _scan_all(frame: Any, place: Any, starts: Any, limits: Any, kept: Any) -> None:
    """Mark in ``kept`` what is no outlier of its tracklet."""
    for i in range(len(starts) - 1):
        left = np.arange(starts[i], starts[i + 1])
        while True:
            found = _first_outlier(frame[left], place[left], limits)
            if found < 0:
                break
            kept[left[found]] = False
            left = np.concatenate((left[:found], left[found + 1 :]))


@njit(cache=True)
def _first_outlier(frame: Any, place: Any, limits: Any) -> int:
    """Return the first outlier of one path in the order of the text, or -1."""
    count = len(frame)
    if count >= 5:
        down, right = 0.0, 0.0
        for i in range(1, 4):
            step = velocity(frame, place, i, i + 1)
            down, right = down + step[0] / 3, right + step[1] / 3
        if _is_outlier(velocity(frame, place, 0, 1), (down, right), limits):
            return 0
    if count >= 4 and _turns(frame, place, 2, limits):  # Eq. 4.20
        return 1
    for i in range(2, count):
        if _turns(frame, place, i - 1, limits):  # Eq. 4.18
            return i
    return -1


@njit(cache=True)
def _turns(frame: Any, place: Any, i: int, limits: Any) -> bool:
    """Tell whether the velocities before and after a point differ too much."""
    before, after = velocity(frame, place, i - 1, i), velocity(frame, place, i, i + 1)
    return _is_outlier(before, after, limits)


@njit(cache=True)
def _is_outlier(before: Any, after: Any, limits: Any) -> bool:
    """Tell whether two velocities differ in angle and in magnitude (Eq. 4.18, thesis)."""
    angle, change = turn(before, after)
    return angle > limits[0] and change > limits[1]
