"""Criteria of one flight: start at the lance, landing, plausibility (section 5.3.1)."""

import math

import numpy as np
from scipy.optimize import brentq

from kilnflight.arrays import Array, ArrayLike
from kilnflight.checks import InputError, Positive, Settings
from kilnflight.detection.wall import Cylinder, InAir, distance_to_axis
from kilnflight.regression import Fit

STEP_S = 0.001  # a trajectory is sampled in these steps
TOUCH_MM = 1e-6  # tolerance of the limit: times of hours round positions by less
FIRST_POINTS = 3  # positions with depth whose median decides the start; not printed
WITHIN_MM = 1000.0  # depth travelled from the lance: one slice of Eq. 5.8; not printed
CONE = 0.7  # across by depth: the wall's 700 mm in a metre, secs 2.1.1 and 5.3.1; ours
DEPTH_SCATTER_MM = 438.0  # two RMSE in depth (Table 5.18)
ACROSS_SCATTER_MM = 38.0  # two RMSE across (Table 5.18)
BEYOND_S = 0.05  # flight after the last detection; not printed
BEYOND_MM = 300.0  # way after the last detection; not printed
LAST_S = 0.02  # last detections, whose mean velocity leads on; not printed
FACTOR = 2.0  # times the air's velocity; ours, from Table 5.18
BEHIND_MM = 219.0  # farther from the camera than the exit; RMSE of Table 5.18
# A flight may leave what is in the air by so much; ours: particles on the wall are at
# 700 mm and more of 800 (sec. 5.1.4).
OUTSIDE_MM = 100.0
LEAVES = "leaves the kiln"
BEHIND = "turns back behind the lance"
TOO_FAST = "faster than the air"


def starts_at_lance(places_mm: Array, fit: Fit) -> tuple[bool, float]:
    """Return whether a trajectory starts at the lance, and its distance from it in mm.

    Only trajectories from the lance are analysed further (section 4.2.5, Fig. 4.21).
    ``places_mm`` (n, 3) are x, y, z of the track's detections in order of time, NaN
    without depth. Three scalar medians are taken over the first `FIRST_POINTS` of them
    with depth: of the depth travelled from the outlet, of the distance from the lance's
    axis, and of the distance from the outlet. The last is returned for the table and
    not tested. A trajectory starts at the lance if

    1. the depth travelled is at most `WITHIN_MM`, and at least -`DEPTH_SCATTER_MM`;
    2. the distance from the axis is within a cone that widens by `CONE` with the depth;
    3. t0, the fitted time at the outlet, is not the earliest of its range;
    4. the fitted velocity at t0 points to the camera.

    Raises
    ------
    InputError
        If no detection has a depth.

    Notes
    -----
    The thesis prints no criterion (secs 4.2.5 and 5.3.1); these are ours. Particles are
    "probably not captured" until several frames after the lance (sec. 4.3), so first
    positions lie some way from it. One wrong depth changes a median little. (1)
    `WITHIN_MM` is one slice of Eq. 5.8, so that the first slice was observed; depths
    scatter by `DEPTH_SCATTER_MM`. (2) Paper shreds "touch the side walls before moving
    far" (sec. 5.3.1). So the cone widens from the exit to the wall, 700 mm away, in the
    first metre, plus the scatter of Table 5.18. (3) At the earliest t0 the polynomials
    found no way back to the lance. The latest is allowed: the particle was detected
    from the exit on. (4) Polynomials that start backwards have found an exit that the
    particle did not take. Tracks without a fit are judged by their place in the picture
    (`kilnflight.experiments.flights.track_scores.from_lance`).
    """
    known = places_mm[~np.isnan(places_mm).any(axis=1)][:FIRST_POINTS]
    if not len(known):
        raise InputError("a fitted track has no position with depth in x, y, z.")
    apart = known - fit.exit_point_mm
    distance = np.median(np.linalg.norm(apart, axis=1))
    gone = -np.median(apart[:, 2])
    across = np.median(np.hypot(*apart[:, :2].T))
    cone = CONE * (gone + DEPTH_SCATTER_MM) + ACROSS_SCATTER_MM
    near = -DEPTH_SCATTER_MM <= gone <= WITHIN_MM and across <= cone
    forwards = fit.velocity(fit.t0)[0, 2] < 0
    return bool(near and fit.t0_at_bound >= 0 and forwards), distance


def straight_on(fit: Fit, time_s: ArrayLike) -> Array:
    """Return positions (n, 3) in mm, on a straight line after the last detection.

    ``time_s`` (n,) or one number is on the fit's clock. Polynomials diverge quickly
    outside their data, and so do their slopes at its end. So the mean velocity of the
    last `LAST_S` leads on.
    """
    time = np.atleast_1d(time_s)
    observed = np.minimum(time, fit.last_s)
    return fit(observed) + (time - observed)[:, None] * _last_velocity(fit)


def _last_velocity(fit: Fit) -> Array:
    """Return the mean velocity (3,) in mm/s of the last `LAST_S` that were observed."""
    before = max(fit.first_s, fit.last_s - LAST_S)
    places = fit(np.array([before, fit.last_s]))
    return (places[1] - places[0]) / max(fit.last_s - before, 1e-9)


def landing_s(fit: Fit, wall: Cylinder, in_air: InAir) -> float | None:
    """Return when a trajectory ends on the wall (section 3.2); None: in the air.

    The time is in s on the recording's clock. The limit is the distance
    ``in_air.threshold_mm`` from the axis of ``wall``. A flight lands if it reaches the
    limit between first and last detection, or on a straight line within `BEYOND_S` and
    `BEYOND_MM` of the last one.

    Notes
    -----
    The thesis ends a flight "by means of the 3D particle classification" and says no
    more. Detections on the wall are left out before tracking, so a track ends short of
    the limit.
    """

    def outside(t: ArrayLike) -> Array:
        """Return how far (n,) in mm the fit is beyond the limit at t (n,) in s."""
        return distance_to_axis(straight_on(fit, t), wall) - in_air.threshold_mm

    count = max(2, math.ceil((fit.last_s - fit.first_s) / STEP_S) + 1)
    observed = np.linspace(fit.first_s, fit.last_s, count)
    speed = float(np.linalg.norm(_last_velocity(fit)))
    beyond_s = min(BEYOND_S, BEYOND_MM / max(speed, 1.0))
    later = fit.last_s + np.append(np.arange(0.0, beyond_s, STEP_S)[1:], beyond_s)
    time = np.concatenate([observed, later])
    off = outside(time)
    beyond = off >= -TOUCH_MM
    if not beyond.any():
        return None
    k = np.argmax(beyond)
    if k > 0 and off[k - 1] < 0 < off[k]:
        return brentq(lambda t: outside(t)[0], time[k - 1], time[k], xtol=1e-9)
    return time[k]


class Plausible(Settings):
    """Reject flights whose fitted trajectory is impossible.

    Sampled every millisecond from t0 to the end of the flight, a trajectory is
    impossible if it is (1) more than `OUTSIDE_MM` outside the limit of what is in the
    air, or behind the camera; (2) more than `BEHIND_MM` behind the lance; (3) faster
    than `FACTOR` times the air.

    Notes
    -----
    The thesis rejects connections that jump too far (sec. 4.2.3), but no flight: of
    negative velocities it says that relatively large ones "might be due to camera
    inaccuracy and faulty tracking results", and Fig. 5.23 keeps them (sec. 5.3.1).
    Rejection and its limits are ours. The air leaves the lance with about 16 m/s at 5
    bar (sec. 2.1.1), and nothing else drives a particle. The factor allows for the
    scatter of depth. A metre whose ends are both off by 219 mm, the largest RMSE of
    Table 5.18, appears 1 / (1 - 0.438) = 1.8 times as fast.

    Parameters
    ----------
    air_m_s
        Velocity of the air at the lance's outlet in m/s, at 5 bar (sec. 2.1.1).
    """

    air_m_s: Positive = 16.0

    @property
    def fastest_m_s(self) -> float:
        """Return the largest velocity of a flight in m/s."""
        return FACTOR * self.air_m_s

    def __call__(self, fit: Fit, end_s: float, wall: Cylinder, in_air: InAir) -> str:
        """Return the reason for rejection; empty if accepted.

        The reason is `LEAVES`, `BEHIND` or `TOO_FAST`, the first that holds anywhere
        between t0 and ``end_s``, on the fit's clock.
        """
        count = max(2, math.ceil((end_s - fit.t0) / STEP_S) + 1)
        # A stray frame makes a flight of hours.
        time = np.linspace(fit.t0, end_s, min(count, 1_000_000))
        places = straight_on(fit, time)
        velocity = fit.velocity(np.minimum(time, fit.last_s))
        speed = np.linalg.norm(velocity, axis=1) / 1000
        outside = distance_to_axis(places, wall) - in_air.threshold_mm
        reasons = {
            LEAVES: (outside > OUTSIDE_MM) | (places[:, 2] < 0),
            BEHIND: places[:, 2] - fit.exit_point_mm[2] > BEHIND_MM,
            TOO_FAST: speed > self.fastest_m_s,
        }
        return next((reason for reason, where in reasons.items() if where.any()), "")
