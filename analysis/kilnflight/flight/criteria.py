"""Criteria of one flight: from the lance, its end, and whether it can be (sec. 5.3.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from kilnflight.checks import (
    InputError,
    check_at_least,
    check_count,
    check_finite,
    check_limit,
    check_positive,
)
from kilnflight.detection.wall import Cylinder, InAir, distance_to_axis
from kilnflight.regression import Fit

Array = npt.NDArray[np.float64]

STEP_S = 0.001  # between the times at which a trajectory is looked at
TOUCH_MM = 1e-6  # short of the limit is at it: times of hours round a place by less
LEAVES, BEHIND, TOO_FAST = "leaves the kiln", "turns back behind the lance", "faster than the air"


@dataclass(frozen=True)
class StartsAtLance:
    """Decide whether a trajectory starts at the lance (Fig. 4.21).

    Notes
    -----
    The rule of flights, in space: it needs the fitted polynomials. Tracks are scored before any fit
    (Table 5.17), beside marked ones of which some have no depth: their rule is one of the picture,
    `kilnflight.experiments.tracking_scores.from_lance`.

    The thesis prints no criterion (secs 4.2.5 and 5.3.1); particles are "probably not captured"
    until several frames after the lance (sec. 4.3). Here the medians of the first positions with
    depth decide, which bear one wrong depth. In depth they lie within one slice of Eq. 5.8, so that
    the first slice was observed, and not farther behind the lance than depths scatter. Across they
    lie within a cone. Paper shreds "touch the side walls before moving far" (sec. 5.3.1), so the
    cone goes from the exit to the wall, 700 mm away, in the first metre. It is wider by what the
    depth and the pixels scatter. A pixel's error in mm grows with the depth, and Table 5.18 has
    both for the depths of a kiln: 219 mm along the line of sight, 18.77 mm across.

    The regression's t0 is not the earliest of its range, where the polynomials found no way back
    to the lance. The latest of the range, at the first detection, is where it lies if a particle
    was detected from the exit on. And it leaves the exit towards the camera. Polynomials that
    start backwards and swing round behind the lance have found an exit that the particle did not
    take.
    """

    within_mm: float = 1000.0  # mm, in depth: one slice; not printed
    slope: float = 0.7  # across by depth: the wall's 700 mm in a metre, secs 2.1.1 and 5.3.1; ours
    depth_scatter_mm: float = 438.0  # mm, two RMSE in depth (Table 5.18)
    across_scatter_mm: float = 38.0  # mm, two RMSE across (Table 5.18)
    points: int = 3  # first positions with depth; not printed
    at_bound: bool = False  # whether a t0 at the early end of its range counts

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        for name in ("within_mm", "slope", "depth_scatter_mm", "across_scatter_mm"):
            check_limit(getattr(self, name), f"StartsAtLance: {name}")
        check_count(self.points, "StartsAtLance: points")

    def __call__(self, places_mm: Array, fit: Fit) -> tuple[bool, float]:
        """Return the decision, and the distance from the lance in mm."""
        known = places_mm[~np.isnan(places_mm).any(axis=1)][: self.points]
        if not len(known):
            raise InputError("StartsAtLance: a fitted track has no position with depth.")
        apart = known - fit.exit_point_mm
        distance = float(np.median(np.linalg.norm(apart, axis=1)))
        gone = -float(np.median(apart[:, 2]))
        across = float(np.median(np.hypot(apart[:, 0], apart[:, 1])))
        cone = self.slope * (gone + self.depth_scatter_mm) + self.across_scatter_mm
        near = -self.depth_scatter_mm <= gone <= self.within_mm and across <= cone
        forwards = float(fit.velocity(np.array([fit.t0]))[0, 2]) < 0
        inside = self.at_bound or fit.t0_at_bound >= 0
        return near and inside and forwards, distance


def straight_on(fit: Fit, time_s: npt.ArrayLike) -> Array:
    """Return places (n, 3) in mm, straight on after the last detection.

    Polynomials leave their data fast.
    """
    time = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
    observed = np.minimum(time, fit.last_s)
    places = check_finite(fit(observed), "straight_on: the fitted trajectory")
    return places + (time - observed)[:, None] * fit.velocity(observed)


class FlightEnd(NamedTuple):
    """End of a flight, on the wall or not, and its last distance."""

    landed: bool
    end_s: float
    wall_mm: float


@dataclass(frozen=True)
class Landing:
    """Find when a fitted trajectory meets the wall (section 3.2).

    A flight lands in one of three cases, in this order. (1) It reaches the limit between first and
    last detection. (2) It reaches it when it flies straight on for at most ``beyond_s``. (3) It is
    last detected within ``near_mm`` of the limit, and ends there. Else it ends in the air, with
    the last detection.

    Notes
    -----
    The thesis ends a flight "by means of the 3D particle classification" and says no more.
    As wall detections are left out before tracking, a track ends short of the limit, and the
    fit goes on straight, as polynomials leave their data fast. On the wall particles are
    found from 700 mm on, where the limit is 800 mm (Fig. 3.11), hence (3).
    """

    beyond_s: float = 0.05  # of flight after the last detection; not printed
    near_mm: float = 100.0  # from the limit, sec. 5.1.4: wall particles at 700 and more of 800

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        check_limit(self.near_mm, "Landing: near_mm")
        check_at_least(self.beyond_s, 0.0, "Landing: beyond_s")

    def __call__(self, fit: Fit, wall: Cylinder, in_air: InAir) -> FlightEnd:
        """Return whether, when and where the trajectory ends on the wall."""

        def outside(t: npt.ArrayLike) -> Array:
            """Return by how many mm the extended fit is beyond the limit."""
            return distance_to_axis(straight_on(fit, t), wall) - in_air.threshold_mm

        count = max(2, math.ceil((fit.last_s - fit.first_s) / STEP_S) + 1)
        observed = np.linspace(fit.first_s, fit.last_s, count)
        later = fit.last_s + np.append(np.arange(0.0, self.beyond_s, STEP_S)[1:], self.beyond_s)
        time = np.concatenate([observed, later])
        off = outside(time)
        last = float(off[count - 1])
        wall_mm = last + in_air.threshold_mm
        beyond = off >= -TOUCH_MM
        if not beyond.any():
            return FlightEnd(last >= -self.near_mm - TOUCH_MM, float(fit.last_s), wall_mm)
        k = int(np.argmax(beyond))
        end = float(time[k])
        if k > 0 and off[k - 1] < 0 < off[k]:
            end = brentq(lambda t: float(outside(t)[0]), time[k - 1], time[k], xtol=1e-9)
        return FlightEnd(True, end, wall_mm)


@dataclass(frozen=True)
class Plausible:
    """Refuse a flight whose fitted polynomials do what no particle does.

    Judged every millisecond from t0 to the end of the flight, straight on after the last
    detection, in this order. It leaves the kiln: it is more than ``beyond_mm`` outside the limit of
    what is in the air, or behind the camera. It turns back behind the lance, by more than
    ``behind_mm``. It is faster than the air that blows it by more than ``factor``.

    Notes
    -----
    The thesis refuses connections that jump too far (sec. 4.2.3), but no flight: of negative
    velocities it says that relatively large ones "might be due to camera inaccuracy and faulty
    tracking results", and Fig. 5.23 keeps them (sec. 5.3.1). To refuse is ours, and so are the
    limits, from what is printed. The air leaves the lance with about 16 m/s at 5 bar (sec. 2.1.1),
    and nothing else drives a particle. The factor allows for the depth's scatter. A metre both of
    whose ends are off by 219 mm, the largest RMSE of Table 5.18, looks 1 / (1 - 0.438) = 1.8 times
    as fast as it is. A fit is known better than one point, so it goes no farther back than this
    RMSE either.
    """

    air_m_s: float = 16.0  # m/s, at the lance's outlet, 5 bar, sec. 2.1.1
    factor: float = 2.0  # on the air's velocity; ours, from Table 5.18
    behind_mm: float = 219.0  # mm, farther from the camera than the exit; RMSE of Table 5.18
    beyond_mm: float = 100.0  # mm, outside the limit of what is in the air; ours, as near_mm

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        check_positive(self.air_m_s, "Plausible: air_m_s")
        for name in ("factor", "behind_mm", "beyond_mm"):
            check_limit(getattr(self, name), f"Plausible: {name}")

    @property
    def fastest_m_s(self) -> float:
        """Return the largest velocity that a flight may have."""
        return self.factor * self.air_m_s

    def __call__(self, fit: Fit, end_s: float, wall: Cylinder, in_air: InAir) -> str:
        """Return why the flight is refused, or an empty text."""
        count = max(2, math.ceil((end_s - fit.t0) / STEP_S) + 1)
        time = np.linspace(fit.t0, end_s, count)
        places = straight_on(fit, time)
        speed = np.linalg.norm(fit.velocity(np.minimum(time, fit.last_s)), axis=1) / 1000
        outside = distance_to_axis(places, wall) - in_air.threshold_mm
        reasons = {
            LEAVES: (outside > self.beyond_mm) | (places[:, 2] < 0),
            BEHIND: places[:, 2] - fit.exit_point_mm[2] > self.behind_mm,
            TOO_FAST: speed > self.fastest_m_s,
        }
        return next((reason for reason, where in reasons.items() if where.any()), "")
