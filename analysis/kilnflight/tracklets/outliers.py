"""Outlier removal, and cuts at impossible steps.

Sections 4.2.2 and 4.2.3 of the thesis.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from pandas import DataFrame

from kilnflight.arrays import Array, Flags, Whole
from kilnflight.checks import NotNegative, Positive, Settings, check_number
from kilnflight.tracklets.paths import (
    Paths,
    PathStep,
    read_paths,
    turns,
    velocities,
    write_paths,
)

# Limits of `Cutting`, ours.
ACROSS_MM = 56.0  # three RMSE across, 18.77 mm (Table 5.18)
DEPTH_MM = 657.0  # three RMSE in depth, 219 mm (Table 5.18)
LEAST_PART = 3  # detections of a part: more than D_eps of Table 5.16


class OutlierRemoval(PathStep):
    """Remove detections that change angle and speed too much (Eq. 4.18).

    Each scan judges the first point, then the second backwards from the last (Eq.
    4.20), then the others forwards (Eq. 4.18). The first outlier found is removed and
    the scan begins anew, until none is found.

    Notes
    -----
    Readings. (1) The first velocity is compared with the mean of the three that follow
    it, as the text has it. The caption of Fig. 4.7 names the last point, which the
    forward scan judges anyway. (2) A point is judged only where its equation has what
    it needs: the first from 5 points, the second from 4, the others from 3. (3) A
    velocity of zero has no direction and makes no angle. (4) "The second assigned
    detection is examined backwards from the last one": going back, it must be the first
    point that meets Eq. 4.20. Then T4 of situation 3 (Fig. 4.5) alone is removed, as
    its caption has it. Removing all points that meet Eq. 4.20 on the way back is
    excluded: a wrong last point would cost all before it. (5) The order of the text,
    first point first, also removes the correct first point of 5 or more where the
    second is wrong. Source: section 4.2.2, Eqs 4.17 to 4.20, thesis.

    Parameters
    ----------
    angle_deg
        theta_eps, change of direction in degrees, Table 5.16.
    change
        Delta V_eps, change of velocity in px/frame, Table 5.16.

    Examples
    --------
    One detection is 60 px off.

    >>> frame = np.arange(7)
    >>> tracks = DataFrame({"frame": frame, "row": 5.0 * frame, "particle": 0})
    >>> tracks["col"] = [0.0, 0.0, 0.0, 60.0, 0.0, 0.0, 0.0]
    >>> OutlierRemoval()(tracks)["particle"].tolist()
    [0, 0, 0, -1, 0, 0, 0]
    """

    angle_deg: NotNegative = 30.0
    change: NotNegative = 18.0

    def apply(self, paths: Paths, differences: object = None) -> Paths:
        """Return the tracklets without outliers; ``differences`` are not used."""
        names = paths.names()
        steps = velocities(paths.frame, paths.place)
        # A change from the mean of three is at most twice the largest from step to
        # step.
        large = turns(steps[:-1], steps[1:])[1] > self.change / 2.1
        for k in np.unique(names[2:][large & (names[2:] == names[:-2])]):
            left = np.arange(*paths.starts[[k, k + 1]])
            while True:
                outlier = self.first_outlier(paths.frame[left], paths.place[left])
                if outlier is None:
                    break
                names[left[outlier]] = -1
                left = np.delete(left, outlier)
        return paths.grouped(names)

    def first_outlier(self, frame: Whole, place: Array) -> int | None:
        """Return the index of the first outlier of one path, or None.

        ``frame`` (n,) must ascend; ``place`` (n, 2 or more) holds row and col in px.
        """
        steps = velocities(frame, place)
        if len(frame) >= 5:
            mean = steps[1:4].mean(axis=0, keepdims=True)
            if self._turned(steps[:1], mean)[0]:
                return 0
        turned = self._turned(steps[:-1], steps[1:])
        if len(frame) >= 4 and turned[1] and not turned[2:].any():
            return 1  # Eq. 4.20
        if turned.any():
            return int(np.argmax(turned)) + 2  # Eq. 4.18
        return None

    def _turned(self, before: Array, after: Array) -> Flags:
        """Return which velocities (n, 2) in px/frame change as in Eq. 4.18, (n,)."""
        angle, change = turns(before, after)
        return (angle > self.angle_deg) & (change > self.change)


class Cutting(Settings):
    """Split tracks at physically impossible steps.

    A step leads from one detection with depth to the next. It is impossible if it is
    longer than ``fastest_m_s`` times its duration plus three RMSE of Table 5.18.

    Notes
    -----
    The thesis does not connect tracklets "far apart" (sec. 4.2.3); a limit in mm is not
    printed and ours. An error of the depth moves a place along its line of sight (sec.
    4.1.2), so steps are judged across it and along it. Across: from each detection to
    the next, in directions compared at the nearer of both depths. Along: from each of
    `LEAST_PART` detections to each of as many that follow, all in one direction. So a
    wrong depth that comes back soon counts as scatter; one that lasts is another
    particle's or the wall's. Detections without depth are not judged; they stay with
    those before them.

    Parameters
    ----------
    fastest_m_s
        Largest velocity of a particle in m/s; twice that of the lance's air (sec.
        2.1.1).

    Examples
    --------
    A track jumps by 1 m to another particle.

    >>> tracks = DataFrame({"frame": range(8), "particle": 0, "row": 0.0})
    >>> tracks["x"] = [0.0] * 4 + [1000.0] * 4
    >>> tracks = tracks.assign(col=0.0, y=0.0, z=5000.0)
    >>> Cutting()(tracks, frame_rate_hz=330.0)["particle"].tolist()
    [0, 0, 0, 0, 1, 1, 1, 1]
    """

    fastest_m_s: Positive = 32.0

    def __call__(self, tracks: DataFrame, frame_rate_hz: float) -> DataFrame:
        """Return the table with a track for each part of a track.

        Parts of fewer than `LEAST_PART` detections get particle -1. A table without
        places in space is returned as it is.

        Parameters
        ----------
        tracks
            Track table, see `kilnflight.tracklets`.
        frame_rate_hz
            Of the recording.

        Raises
        ------
        InputError
            If the table is not a track table, or the frame rate is not above 0.
        """
        check_number(frame_rate_hz, "Cutting: frame_rate_hz", above=0)
        paths = read_paths(tracks, "Cutting: tracks")
        if paths.place.shape[1] < 5:
            return tracks
        cuts = np.zeros(len(paths.rows), np.int64)
        known = ~np.isnan(paths.place[:, 2:].sum(axis=1))
        for path in np.split(np.arange(len(cuts)), paths.starts[1:-1]):
            points = path[known[path]]
            if len(points) > 1:
                time = paths.frame[points] / frame_rate_hz
                depth = paths.place[points, 2]
                # Across the line of sight, from the camera.
                ahead = np.where(depth > 0, depth, np.nan)
                step = np.diff(paths.place[points, 3:] / ahead[:, None], axis=0)
                across = np.hypot(*step.T) * np.minimum(ahead[1:], ahead[:-1])
                far = across > 1000 * self.fastest_m_s * np.diff(time) + ACROSS_MM
                cuts[points[1:]] = far | self._along(time, depth)
        if not cuts.any():
            return tracks
        names = paths.names() + np.cumsum(cuts)
        long = np.bincount(names)[names] >= LEAST_PART
        return write_paths(tracks, paths.grouped(np.where(long, names, -1)))

    def _along(self, time: Array, depth: Array) -> Flags:
        """Return which steps (n - 1,) along the line of sight are impossible and last.

        ``time`` (n,) is in s, ``depth`` (n,) in mm. All steps from the `LEAST_PART`
        detections before to the `LEAST_PART` after must be impossible, in the same
        direction.
        """
        if len(depth) < 2 * LEAST_PART:
            return np.zeros(len(depth) - 1, bool)
        both = np.stack([time, depth])
        around = sliding_window_view(both, 2 * LEAST_PART, axis=1)
        before = around[:, :, :LEAST_PART, None]
        after = around[:, :, None, LEAST_PART:]
        flown, step = after - before
        limit = 1000 * self.fastest_m_s * flown + DEPTH_MM
        away = (step > limit).all(axis=(1, 2))
        back = (-step > limit).all(axis=(1, 2))
        return np.pad(away | back, LEAST_PART - 1)
