"""When and where a fitted trajectory meets the kiln's wall (thesis, sections 3.2 and 5.3.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from kilnflight.checks import check_at_least, check_limit
from kilnflight.detection.wall import Cylinder, InAir, distance_to_axis
from kilnflight.slicing import Flown, straight_on

Array = npt.NDArray[np.float64]

STEP_S = 0.001  # between the times at which the distance from the axis is looked at
TOUCH_MM = 1e-6  # short of the limit is at it: times of hours round a place by less


class Landed(NamedTuple):
    """Whether and when a flight ends on the wall, and how far from the axis it was last."""

    landed: bool
    end_s: float
    wall_mm: float


@dataclass(frozen=True)
class Landing:
    """When a fitted trajectory meets the wall: leaves what counts as in the air (section 3.2).

    Landed is, in this order, what (1) reaches the limit between first and last detection, at
    that time; (2) reaches it when it flies straight on from the last detection for at most
    ``beyond_s``, at that time; (3) is last seen within ``near_mm`` of the limit, at its last
    detection. Else the flight ends in the air, with the last detection.

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

    def __call__(self, fit: Flown, wall: Cylinder, in_air: InAir) -> Landed:
        """Return whether, when and where the trajectory ends on the wall."""

        def outside(t: npt.ArrayLike) -> Array:
            """Return by how many mm the fit, continued straight, is beyond the limit."""
            return distance_to_axis(straight_on(fit, t), wall) - in_air.threshold_mm

        count = max(2, math.ceil((fit.last_s - fit.first_s) / STEP_S) + 1)
        time = np.linspace(fit.first_s, fit.last_s, count)
        time = np.append(time, fit.last_s + np.arange(0.0, self.beyond_s, STEP_S)[1:])
        time = np.append(time, fit.last_s + self.beyond_s)
        off = outside(time)
        last = float(off[count - 1])
        beyond = np.flatnonzero(off >= -TOUCH_MM)
        end = float(fit.last_s)
        if len(beyond):
            k = int(beyond[0])
            end = float(time[k])
            if k > 0 and off[k - 1] < 0 < off[k]:
                end = brentq(lambda t: float(outside(t)[0]), time[k - 1], time[k], xtol=1e-9)
        landed = bool(len(beyond)) or last >= -self.near_mm - TOUCH_MM
        return Landed(landed, end, last + in_air.threshold_mm)
