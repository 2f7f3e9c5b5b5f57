"""Removal of detections that make a tracklet turn and jump, and cuts at impossible steps.

Sections 4.2.2 and 4.2.3 of the thesis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
from numpy.lib.stride_tricks import sliding_window_view

from kilnflight.checks import check_count, check_kind, check_limit, check_positive
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

    Each scan judges the first point, then the second backwards from the last (Eq. 4.20), then
    the others forwards (Eq. 4.18). The first outlier found is removed and the scan begins anew,
    until none is found. Called with a track table, it returns the table with particle -1 for
    the outliers.

    Notes
    -----
    Readings. (1) The first velocity is compared with the mean of the three that follow it, as the
    text has it. The caption of Fig. 4.7 speaks of the last point, which the forward scan judges
    anyway. (2) A point is judged only where its equation has what it needs: the first from 5
    points, the second from 4, the others from 3. (3) A velocity of zero has no direction and makes
    no angle. (4) "The second assigned detection is examined backwards from the last one": going
    back, it must be the first point that meets Eq. 4.20. Then T4 of situation 3 (Fig. 4.5) goes
    alone, as its caption has it. Without ``from_last`` the second is examined alone, and T4 costs
    T2 and T3. To remove on the way back whatever meets Eq. 4.20 is no reading: a wrong last
    point would cost all before it. (5) The order of the text, first point first, also costs the
    good first point of 5 or more where the second is wrong.
    Source: section 4.2.2, Eqs 4.17 to 4.20, thesis.
    """

    angle_deg: float = 30.0  # degrees, theta_eps, Table 5.16
    change: float = 18.0  # px/frame, Delta V_eps, Table 5.16
    from_last: bool = True  # Eq. 4.20 from the last point back (sec. 4.2.2), or the second alone

    def __post_init__(self) -> None:
        """Refuse limits out of range."""
        check_limit(self.angle_deg, "OutlierRemoval: angle_deg")
        check_limit(self.change, "OutlierRemoval: change")
        check_kind(self.from_last, bool, "OutlierRemoval: from_last")

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
        if len(frame) >= 4 and turned[1] and not (self.from_last and turned[2:].any()):
            return 1  # Eq. 4.20
        return int(np.argmax(turned)) + 2 if turned.any() else None  # Eq. 4.18

    def _turned(self, before: Floats, after: Floats) -> npt.NDArray[np.bool_]:
        """Return whether velocities (n, 2) change as in Eq. 4.18."""
        angle, change = turns(before, after)
        return np.asarray((angle > self.angle_deg) & (change > self.change))


@dataclass(frozen=True)
class Cutting:
    """Cut tracks where they make a step that no particle makes.

    Called with a track table and the frame rate, it returns the table with each part as a track
    of its own, and particle -1 for parts of fewer than ``least`` detections.

    Notes
    -----
    The thesis does not connect tracklets "far apart" (sec. 4.2.3); a limit in mm is not printed
    and ours. No particle is faster than `kilnflight.flight.Plausible` lets it be, and places
    scatter by their RMSE (Table 5.18). An error of the depth moves a place along its line of
    sight (sec. 4.1.2), so steps are judged across it and along it. Across: from each detection to
    the next, in directions compared at the nearer of both depths. Along: from each of ``least``
    detections to each of the ``least`` that follow, all the same way. So a wrong depth that comes
    back soon is scatter, and stays; one that lasts is another particle's or the wall's, and the
    parts on both sides are tracks of their own. Detections without depth are not judged, as a
    step in pixels has no length; they stay with those before them.
    """

    fastest_m_s: float = 32.0  # m/s, twice the lance's air (sec. 2.1.1)
    across_mm: float = 56.0  # mm, three RMSE across, 18.77 mm (Table 5.18)
    depth_mm: float = 657.0  # mm, three RMSE in depth, 219 mm (Table 5.18)
    least: int = 3  # detections of a part: more than D_eps of Table 5.16

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        check_limit(self.fastest_m_s, "Cutting: fastest_m_s")
        check_limit(self.across_mm, "Cutting: across_mm")
        check_limit(self.depth_mm, "Cutting: depth_mm")
        check_count(self.least, "Cutting: least")

    def __call__(self, tracks: pd.DataFrame, frame_rate_hz: float) -> pd.DataFrame:
        """Return the table with cut tracks; as it is without places in space.

        Raises
        ------
        InputError
            If the table is not a track table, or the frame rate is not above 0.
        """
        check_positive(frame_rate_hz, "Cutting: frame_rate_hz")
        paths = read_paths(tracks, "Cutting: tracks")
        cuts = np.zeros(len(paths.rows), dtype=np.int64)
        if paths.place.shape[1] == 5:
            for left in np.split(np.arange(len(cuts)), paths.starts[1:-1]):
                known = left[np.isfinite(paths.place[left, 2:]).all(axis=1)]
                if len(known) > 1:
                    time = paths.frame[known] / frame_rate_hz
                    place = paths.place[known][:, [3, 4, 2]]
                    cuts[known[1:]] = self._across(time, place) | self._along(time, place[:, 2])
        if not cuts.any():
            return tracks
        names = paths.names() + np.cumsum(cuts)
        number = np.bincount(names)
        return write_paths(tracks, paths, np.where(number[names] < self.least, LOST, names))

    def _across(self, time: Floats, place: Floats) -> npt.NDArray[np.bool_]:
        """Return which steps (n - 1,) across the line of sight no particle makes."""
        ahead = np.where(place[:, 2] > 0, place[:, 2], np.nan)
        sight = place[:, :2] / ahead[:, None]
        across = np.hypot(*np.diff(sight, axis=0).T) * np.minimum(ahead[1:], ahead[:-1])
        return np.asarray(across > 1000 * self.fastest_m_s * np.diff(time) + self.across_mm)

    def _along(self, time: Floats, depth: Floats) -> npt.NDArray[np.bool_]:
        """Return which steps (n - 1,) along the line of sight no particle makes, and stay."""
        steps, some = np.zeros(len(depth) - 1, dtype=np.bool_), self.least
        if len(depth) >= 2 * some:
            around = sliding_window_view(np.stack([time, depth]), 2 * some, axis=1)
            flown, step = around[:, :, None, some:] - around[:, :, :some, None]
            limit = 1000 * self.fastest_m_s * flown + self.depth_mm
            far = [(way > limit).all(axis=(1, 2)) for way in (step, -step)]
            steps[some - 1 : len(depth) - some] = np.logical_or(*far)
        return steps
