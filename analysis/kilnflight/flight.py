r"""What a flight is: where it starts, when it ends and how (thesis, section 5.3.1, Fig. 5.18).

::

    track + fitted trajectory -> from the lance? -> landing -> ignition -> ending, dwell time
                              \-> space-sliced velocity (`kilnflight.slicing`)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import (
    InputError,
    check_columns,
    check_count,
    check_finite,
    check_limit,
    check_positive,
    check_shape,
    check_whole,
    known_numbers,
)
from kilnflight.detection.wall import Cylinder, InAir
from kilnflight.ignition import BEFORE, SEEN, Ignited, Ignition
from kilnflight.landing import Landing
from kilnflight.slicing import Flown, remaining, slices, space_sliced_velocity
from kilnflight.tables import FLIGHTS

Array = npt.NDArray[np.float64]

LANDED, BURNT_OUT, LOST = "landed", "burnt out", "lost"
COLUMNS = ("frame", "particle", "row", "col", "gray", "x", "y", "z")


@dataclass(frozen=True)
class StartsAtLance:
    """Tell whether a trajectory starts at the lance; only such ones count (Fig. 4.21).

    Notes
    -----
    The thesis prints no criterion. Here the median distance of the first positions with
    depth from the exit point is within one slice of Eq. 5.8, so that the first slice was
    observed; and the regression's t0 is not the earliest of its range, which would say that the
    polynomials found no way back to the lance. The latest of the range, at the first detection,
    is where it lies if a particle was seen from the exit on. The median of three bears one
    wrong depth. And it leaves the exit towards the camera: polynomials that start backwards
    and swing round behind the lance have found an exit that the particle did not take.
    """

    within_mm: float = 1000.0  # one slice; not printed
    points: int = 3  # first positions with depth; not printed
    at_bound: bool = False  # whether a t0 at the early end of its range counts

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        check_limit(self.within_mm, "StartsAtLance: within_mm")
        check_count(self.points, "StartsAtLance: points")

    def __call__(self, places_mm: Array, fit: Flown) -> tuple[bool, float]:
        """Return whether it does, and the distance in mm; places (n, 3) by time, with depth."""
        known = places_mm[~np.isnan(places_mm).any(axis=1)][: self.points]
        if not len(known):
            raise InputError("StartsAtLance: a fitted track has no position with depth.")
        exit_point = np.asarray(fit.exit_point_mm, dtype=np.float64)
        distance = float(np.median(np.linalg.norm(known - exit_point, axis=1)))
        forwards = float(fit.velocity(np.array([fit.t0_s]))[0, 2]) < 0
        found = self.at_bound or fit.t0_at_bound >= 0
        return distance <= self.within_mm and found and forwards, distance


@dataclass(frozen=True)
class Rules:
    """What makes a flight of a track: the methods and their parameters."""

    start: StartsAtLance = field(default_factory=StartsAtLance)
    landing: Landing = field(default_factory=Landing)
    ignition: Ignition = field(default_factory=Ignition)
    above_background: bool = False  # ignition by the rise above it, of column ``background``
    edge_px: float = 45.0  # from the border of the view, the gate of sec. 3.3; not printed

    def __post_init__(self) -> None:
        """Refuse a margin that is none."""
        check_limit(self.edge_px, "Rules: edge_px")


class View(NamedTuple):
    """What the camera could see of a recording; None where it does not matter.

    Attributes
    ----------
    roi
        (m, 2) corners of the region of interest: row, col in px.
    frames
        Frames that were looked at.
    """

    roi: npt.ArrayLike | None = None
    frames: range | None = None


def flights(
    tracks: pd.DataFrame,
    fits: Mapping[int, Flown],
    wall: Cylinder,
    in_air: InAir,
    frame_rate_hz: float,
    rules: Rules | None = None,
    view: View | None = None,
) -> pd.DataFrame:
    """Return the flights of fitted tracks (`kilnflight.tables.FLIGHTS`), one row each.

    The dwell time runs from t0 to landing, unlit (Fig. 5.18 a) or burning (b), or to burning
    out in the air (c).

    Parameters
    ----------
    tracks
        Detections with ``particle``; those of -1 and tracks without a fit are left out. A
        column ``background``, if the rules ask for it, holds the grey value behind each
        (`kilnflight.detection.correspondence.mean_gray` of ``Median().backgrounds``).
    fits
        By particle; of `kilnflight.regression.fits`.
    wall, in_air
        The kiln and the limit (Table 5.12, section 5.1.4).
    frame_rate_hz
        Of the recording.
    rules
        `Rules` with their defaults unless told otherwise.
    view
        Region and frames: what ends at their border was lost, not burnt out.

    Notes
    -----
    A track that ends in the air ended by burning out only if it burnt; an unlit one left the
    view or was lost by the tracker ("their actual flight time is longer than computed",
    appendix A.1). It stays in the table as "lost", its dwell time a lower bound. Ignition is
    looked for up to the landing, since the wall ignites all that land (section 5.1.1).
    """
    use, seen = rules or Rules(), view or View()
    more = ("background",) if use.above_background else ()
    check_columns(tracks, (*COLUMNS, *more), "flights: tracks")
    check_positive(frame_rate_hz, "flights: frame_rate_hz")
    if not fits:
        return FLIGHTS.empty()
    particle = check_whole(tracks["particle"], "flights: particle")
    rows = pd.Series(np.arange(len(tracks))).groupby(particle).indices
    missing = [name for name in fits if name not in rows]
    if missing:
        raise InputError(f"flights: no track of particle {missing[0]}, which has a fit.")
    found = []
    for name, fit in fits.items():
        track = tracks.iloc[rows[name]].sort_values("frame", kind="stable")
        try:
            found.append({"particle": name} | _flight(track, fit, wall, in_air, frame_rate_hz, use))
        except InputError as error:
            raise InputError(f"flights: particle {name}: {error}") from error
        if _cut_off(track, found[-1], frame_rate_hz, use, seen):
            found[-1]["ending"] = LOST
    return FLIGHTS.check(pd.DataFrame(found)[FLIGHTS.names])


def _flight(
    track: pd.DataFrame,
    fit: Flown,
    wall: Cylinder,
    in_air: InAir,
    frame_rate_hz: float,
    rules: Rules,
) -> dict[str, float | str | bool]:
    """Return one row of the table but for its particle."""
    places = np.stack([known_numbers(track[axis], f"column {axis}") for axis in "xyz"], axis=1)
    from_lance, start_mm = rules.start(places, fit)
    landed, end_s, wall_mm = rules.landing(fit, wall, in_air)
    time = track["frame"].to_numpy(np.float64) / frame_rate_hz
    if not landed:  # the last detections may have no depth, which the fit does not know of
        end_s = max(end_s, float(time[-1]))
    flying = time <= end_s
    behind = track["background"].to_numpy() if rules.above_background else np.zeros(len(time))
    lit = rules.ignition(time[flying], track["gray"].to_numpy()[flying], behind[flying])
    burning = lit.outcome in (SEEN, BEFORE)
    return {
        "t0_s": float(fit.t0_s),
        "first_s": min(float(fit.first_s), float(time[0])),
        "last_s": max(float(fit.last_s), float(time[-1])),
        "end_s": end_s,
        "dwell_s": end_s - float(fit.t0_s),
        "ending": LANDED if landed else BURNT_OUT if burning else LOST,
        "from_lance": from_lance,
        "start_mm": start_mm,
        "ignition": lit.outcome,
        "ignition_s": lit.time_s - float(fit.t0_s),
        "rise_gray": _rise(lit),
        "wall_mm": wall_mm,
    }


def _rise(lit: Ignited) -> float:
    """Return the grey values between both levels; 0 where nothing can be said."""
    return 0.0 if math.isnan(lit.before) else lit.after - lit.before


def _cut_off(
    track: pd.DataFrame,
    flight: Mapping[str, float | str | bool],
    frame_rate_hz: float,
    rules: Rules,
    view: View,
) -> bool:
    """Tell whether a flight that ends in the air ends where the view or the recording does."""
    if flight["ending"] != BURNT_OUT:
        return False
    if view.frames is not None:
        last = (view.frames.stop - 1) / frame_rate_hz
        if track["frame"].iloc[-1] / frame_rate_hz + rules.landing.beyond_s > last:
            return True
    if view.roi is None:
        return False
    corners = check_finite(view.roi, "flights: roi")
    check_shape(corners, (None, 2), "flights: roi")
    place = track[["row", "col"]].to_numpy(np.float64)[-1].tolist()
    inside = cv2.pointPolygonTest(corners.astype(np.float32), place, measureDist=True)
    return bool(inside < rules.edge_px)


__all__ = [
    "Landing",
    "Rules",
    "StartsAtLance",
    "View",
    "flights",
    "remaining",
    "slices",
    "space_sliced_velocity",
]
