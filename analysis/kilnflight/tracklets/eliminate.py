"""Tracklets that are too short, too slow or too irregular go (thesis, section 4.2.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numba import njit

from kilnflight.checks import check_between, check_limit
from kilnflight.tracklets.kinematics import mean_speed, regularity
from kilnflight.tracklets.laws import Differences
from kilnflight.tracklets.paths import LOST, read_paths, write_paths


@dataclass(frozen=True)
class Elimination:
    """Keep a tracklet whose duration, mean speed and regularity exceed limits (Eq. 4.15).

    Called with a track table, it returns the table with particle -1 for the rows of false
    tracklets.

    Notes
    -----
    Readings. (1) The duration is the number of assigned positions: Eq. 4.16 divides the
    sum of the velocities, one fewer than the positions, by the duration less one. (2) The
    thesis does not say how two coordinates become one coefficient. Here row(t) and col(t)
    each have their polynomial and the coefficient is pooled over both centred
    coordinates, so that each weighs by its variance and one that does not move weighs
    nothing. Three positions always give 1. Source: Eqs 4.15 to 4.17, thesis.
    """

    duration: float = 2.0  # assigned frames, D_eps, Table 5.16
    speed: float = 1.0  # px/frame, V_eps, Table 5.16
    regularity: float = 0.9  # R_eps, Table 5.16

    def __post_init__(self) -> None:
        """Refuse limits that nothing can be held against."""
        check_limit(self.duration, "Elimination: duration")
        check_limit(self.speed, "Elimination: speed")
        check_between(self.regularity, -1, 1, "Elimination: regularity")

    def __call__(
        self, tracks: pd.DataFrame, differences: Differences | None = None
    ) -> pd.DataFrame:
        """Return the table without false tracklets; ``differences`` is not used.

        Raises
        ------
        InputError
            If the table is none of tracks (`kilnflight.tracklets.paths.read_paths`).
        """
        paths = read_paths(tracks, "Elimination: tracks")
        measured = _measure(paths.frame, paths.place, paths.starts)
        kept = (measured > np.array([self.duration, self.speed, self.regularity])).all(axis=1)
        names = paths.names()
        return write_paths(tracks, paths, np.where(kept[names], names, LOST))


@njit(cache=True)
def _measure(frame: Any, place: Any, starts: Any) -> Any:
    """Return duration, mean speed and regularity (m, 3) of every tracklet."""
    measured = np.empty((len(starts) - 1, 3))
    for i in range(len(measured)):
        time, where = frame[starts[i] : starts[i + 1]], place[starts[i] : starts[i + 1]]
        measured[i, 0] = len(time)
        measured[i, 1] = mean_speed(time, where)
        measured[i, 2] = regularity(time, where)
    return measured
