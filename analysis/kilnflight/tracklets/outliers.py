"""Removal of detections that make a tracklet turn and jump.

Section 4.2.2 of the thesis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import check_limit
from kilnflight.tracklets.paths import (
    LOST,
    Floats,
    Integers,
    read_paths,
    turns,
    velocities,
    write_paths,
)
from kilnflight.tracklets.texture import Differences


@dataclass(frozen=True)
class OutlierRemoval:
    """Remove detections that change angle and speed too much (Eq. 4.18).

    Each scan judges the first point, then the second backwards (Eq. 4.20), then the others
    forwards (Eq. 4.18). The first outlier found is removed and the scan begins anew, until
    none is found. Called with a track table, it returns the table with particle -1 for
    the outliers.

    Notes
    -----
    Readings. (1) The first velocity is compared with the mean of the three that follow it, as the
    text has it. The caption of Fig. 4.7 speaks of the last point, which the forward scan judges
    anyway. (2) A point is judged only where its equation has what it needs: the first from 5
    points, the second from 4, the others from 3. (3) A velocity of zero has no direction and makes
    no angle. (4) An outlier at the second point bends the first velocity more than the second one.
    So the order of the text, first point first, also removes the good first point of 5 or more.
    Source: Eqs 4.17 to 4.20, thesis.
    """

    angle_deg: float = 30.0  # degrees, theta_eps, Table 5.16
    change: float = 18.0  # px/frame, Delta V_eps, Table 5.16

    def __post_init__(self) -> None:
        """Refuse limits out of range."""
        check_limit(self.angle_deg, "OutlierRemoval: angle_deg")
        check_limit(self.change, "OutlierRemoval: change")

    def __call__(
        self, tracks: pd.DataFrame, differences: Differences | None = None
    ) -> pd.DataFrame:
        """Return the table without outliers in its tracklets.

        ``differences`` is not used.

        Raises
        ------
        InputError
            If the table is not a track table (`kilnflight.tracklets.paths.read_paths`).
        """
        paths = read_paths(tracks, "OutlierRemoval: tracks")
        kept = np.zeros(len(paths.rows), dtype=np.bool_)
        for left in np.split(np.arange(len(kept)), paths.starts[1:-1]):
            while (outlier := self._first(paths.frame[left], paths.place[left])) is not None:
                left = np.delete(left, outlier)
            kept[left] = True
        return write_paths(tracks, paths, np.where(kept, paths.names(), LOST))

    def _first(self, frame: Integers, place: Floats) -> int | None:
        """Return the index of the first outlier of one path, or None.

        The order is that of the text of section 4.2.2.
        """
        if len(frame) < 3:
            return None
        steps = velocities(frame, place)
        turned = self._turned(steps[:-1], steps[1:])
        if len(frame) >= 5 and self._turned(steps[:1], steps[1:4].mean(axis=0, keepdims=True))[0]:
            return 0
        if len(frame) >= 4 and turned[1]:  # Eq. 4.20
            return 1
        return int(np.argmax(turned)) + 2 if turned.any() else None  # Eq. 4.18

    def _turned(self, before: Floats, after: Floats) -> npt.NDArray[np.bool_]:
        """Return whether velocities (n, 2) change as in Eq. 4.18."""
        angle, change = turns(before, after)
        return np.asarray((angle > self.angle_deg) & (change > self.change))
