"""Elimination of tracklets that are too short, too slow or irregular.

Section 4.2.1 of the thesis.
"""

import numpy as np

from kilnflight.arrays import Array, Index, Whole
from kilnflight.checks import NotNegative, Share
from kilnflight.tracklets.paths import Paths, PathStep, means, step_speeds


class Elimination(PathStep):
    """Keep tracklets that are long, fast and regular enough (Eq. 4.15).

    A tracklet is kept only if all three measures are above their limits.

    Notes
    -----
    The duration is the number of assigned positions. Eq. 4.16 divides the sum of the
    velocities, one fewer than the positions, by the duration less one. The thesis does
    not say how two coordinates become one coefficient. Here row(t) and col(t) each have
    their polynomial, and the coefficient is pooled over both centred coordinates. So
    each weighs by its variance, and one that is constant has weight 0. Three positions
    always give 1. Source: Eqs 4.15 to 4.17, thesis.

    Parameters
    ----------
    duration
        D_eps, assigned frames, Table 5.16.
    speed
        V_eps, px/frame, Table 5.16.
    regularity
        R_eps, correlation with quadratic polynomials, Table 5.16.

    Examples
    --------
    The first tracklet moves by 5 px/frame, the second by 0.5.

    >>> import pandas as pd
    >>> tracks = pd.DataFrame({"frame": [0, 1, 2, 3] * 2, "col": 0.0})
    >>> tracks["particle"] = [0] * 4 + [1] * 4
    >>> tracks["row"] = 5.0 * tracks["frame"]
    >>> tracks.loc[4:, "row"] /= 10
    >>> Elimination()(tracks)["particle"].tolist()
    [0, 0, 0, 0, -1, -1, -1, -1]
    """

    duration: NotNegative = 2.0
    speed: NotNegative = 1.0
    regularity: Share = 0.9

    def apply(self, paths: Paths, differences: object = None) -> Paths:
        """Return the tracklets that meet Eq. 4.15; ``differences`` are not used."""
        names = paths.names()
        points = (names, paths.frame, paths.place)
        kept = np.diff(paths.starts) > self.duration
        kept &= mean_speed(*points) > self.speed
        kept &= regularity(*points) > self.regularity
        return paths.grouped(np.where(kept[names], names, -1))


def mean_speed(names: Index, frame: Whole, place: Array) -> Array:
    """Return the mean speed (m,) of each path in px/frame; 0 for one point (Eq. 4.16).

    ``names`` (n,) is the path of each point, from 0, ``frame`` (n,) its frame and
    ``place`` (n, 2 or more) its row and col in px. Points must be sorted by path and
    frame.
    """
    path, speed = step_speeds(names, frame, place)
    return means(path, speed, names.max(initial=-1) + 1)


@np.errstate(divide="ignore", invalid="ignore")  # short paths give 0 / 0
def regularity(names: Index, frame: Whole, place: Array) -> Array:
    """Return the correlation (m,) of each path with quadratic polynomials (Eq. 4.15).

    ``names`` (n,) is the path of each point, from 0 without gaps; ``frame`` (n,) its
    frame and ``place`` (n, 2 or more) its row and col in px. Points must be sorted by
    path and frame. The polynomials are row(t) and col(t). For least squares with a
    constant term, the correlation is the root of explained over total sum of squares,
    here of both centred coordinates together. It is 1 up to three points and for a path
    without motion.
    """
    count = np.bincount(names)
    first = np.cumsum(count) - count

    def sums(values: Array) -> Array:
        return np.bincount(names, values).astype(float)[names]

    def centred(values: Array) -> Array:
        return values - sums(values) / count[names]

    time = frame - frame[first][names]
    straight = centred(time / time[first + count - 1][names])
    square = straight * straight
    bent = centred(square) - straight * (sums(square * straight) / sums(square))
    total = np.zeros(len(names))
    left = np.zeros(len(names))
    for axis in place[:, :2].T:
        rest = centred(axis - axis[first][names])  # exactly 0 without motion
        total += rest**2
        for base in (straight, bent):
            rest = rest - base * (sums(rest * base) / sums(base * base))
        left += rest**2
    whole = np.bincount(names, total)
    unexplained = np.bincount(names, left) / whole
    known = (count > 3) & (whole > 0)
    return np.where(known, np.sqrt(np.maximum(1.0 - unexplained, 0.0)), 1.0)
