r"""Flights: their start, end, dwell time and velocity (section 5.3.1).

::

    track + fitted trajectory -> from the lance? -> landing -> ignition -> ending, dwell time
                              \-> space-sliced velocity
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
from scipy.optimize import brentq

from kilnflight.checks import (
    InputError,
    check_at_least,
    check_columns,
    check_count,
    check_finite,
    check_limit,
    check_positive,
    check_shape,
    check_whole,
    known_numbers,
)
from kilnflight.detection.wall import Cylinder, InAir, distance_to_axis
from kilnflight.ignition import BEFORE, SEEN, Ignition
from kilnflight.regression import Fit
from kilnflight.tables import FLIGHTS, SLICES

Array = npt.NDArray[np.float64]

LANDED, BURNT_OUT, LOST = "landed", "burnt out", "lost"
COLUMNS = ("frame", "particle", "row", "col", "gray", "x", "y", "z")
STEP_S = 0.001  # between the times at which the landing looks for the wall
TOUCH_MM = 1e-6  # short of the limit is at it: times of hours round a place by less
MOST = 10_000  # slices of one flight
EPSILON = 1e-14  # share of the largest term below which another one moves nothing


@dataclass(frozen=True)
class StartsAtLance:
    """Decide whether a trajectory starts at the lance (Fig. 4.21).

    Notes
    -----
    The thesis prints no criterion. Here the median distance of the first positions with depth from
    the exit point is within one slice of Eq. 5.8, so that the first slice was observed. The
    regression's t0 is not the earliest of its range, where the polynomials found no way back to
    the lance. The latest of the range, at the first detection, is where it lies if a particle was
    detected from the exit on. The median of three bears one wrong depth. And it leaves the exit
    towards the camera. Polynomials that start backwards and swing round behind the lance have
    found an exit that the particle did not take.
    """

    within_mm: float = 1000.0  # one slice; not printed
    points: int = 3  # first positions with depth; not printed
    at_bound: bool = False  # whether a t0 at the early end of its range counts

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        check_limit(self.within_mm, "StartsAtLance: within_mm")
        check_count(self.points, "StartsAtLance: points")

    def __call__(self, places_mm: Array, fit: Fit) -> tuple[bool, float]:
        """Return the decision, and the distance from the lance in mm."""
        known = places_mm[~np.isnan(places_mm).any(axis=1)][: self.points]
        if not len(known):
            raise InputError("StartsAtLance: a fitted track has no position with depth.")
        distance = float(np.median(np.linalg.norm(known - fit.exit_point_mm, axis=1)))
        forwards = float(fit.velocity(np.array([fit.t0]))[0, 2]) < 0
        inside = self.at_bound or fit.t0_at_bound >= 0
        return distance <= self.within_mm and inside and forwards, distance


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
class Rules:
    """Methods and parameters that make flights of tracks."""

    start: StartsAtLance = field(default_factory=StartsAtLance)
    landing: Landing = field(default_factory=Landing)
    ignition: Ignition = field(default_factory=Ignition)
    edge_px: float = 45.0  # from the border of the view, the gate of sec. 3.3; not printed

    def __post_init__(self) -> None:
        """Refuse an invalid margin."""
        check_limit(self.edge_px, "Rules: edge_px")


class FieldOfView(NamedTuple):
    """The camera's view of a recording; None where it does not matter.

    Attributes
    ----------
    roi
        (m, 2) corners of the region of interest: row, col in px.
    frames
        Frames that were searched for particles.
    """

    roi: npt.ArrayLike | None = None
    frames: range | None = None


def flights(
    tracks: pd.DataFrame,
    fits: Mapping[int, Fit],
    wall: Cylinder,
    in_air: InAir,
    frame_rate_hz: float,
    rules: Rules | None = None,
    view: FieldOfView | None = None,
) -> pd.DataFrame:
    """Return the flights of fitted tracks, one row each.

    The table is `kilnflight.tables.FLIGHTS`. The dwell time runs from t0 to landing, unlit (Fig.
    5.18 a) or burning (b), or to burning out in the air (c).

    Parameters
    ----------
    tracks
        Detections with ``particle``; those of -1 and tracks without a fit are left out. A
        column ``background``, if there is one, holds the grey value behind each
        (`kilnflight.kiln.background_gray`).
    fits
        By particle; of `kilnflight.regression.fits`.
    wall, in_air
        The kiln and the limit (Table 5.12, section 5.1.4).
    frame_rate_hz
        Of the recording.
    rules
        None: `Rules` with their defaults.
    view
        Region and frames: what ends at their border was lost, not burnt out.

    Notes
    -----
    A track that ends in the air ended by burning out only if it burnt. An unlit one left the view
    or was lost by the tracker ("their actual flight time is longer than computed", appendix A.1).
    It stays in the table as "lost", its dwell time a lower bound. Ignition is searched up to the
    landing, since the wall ignites all that land (section 5.1.1).
    """
    rules, view = rules or Rules(), view or FieldOfView()
    columns = (*COLUMNS, "background") if rules.ignition.above_background else COLUMNS
    check_columns(tracks, columns, "flights: tracks")
    check_positive(frame_rate_hz, "flights: frame_rate_hz")
    if not fits:
        return FLIGHTS.empty()
    particle = check_whole(tracks["particle"], "flights: particle")
    positions = pd.Series(np.arange(len(tracks))).groupby(particle).indices
    missing = [name for name in fits if name not in positions]
    if missing:
        raise InputError(f"flights: no track of particle {missing[0]}, which has a fit.")
    rows = []
    for name, fit in fits.items():
        track = tracks.iloc[positions[name]].sort_values("frame", kind="stable")
        try:
            row = _flight(track, fit, wall, in_air, frame_rate_hz, rules)
        except InputError as error:
            raise InputError(f"flights: particle {name}: {error}") from error
        if row["ending"] == BURNT_OUT and _cut_off(track, frame_rate_hz, rules, view):
            row["ending"] = LOST
        rows.append({"particle": name} | row)
    return FLIGHTS.check(pd.DataFrame(rows)[FLIGHTS.names])


def _flight(
    track: pd.DataFrame,
    fit: Fit,
    wall: Cylinder,
    in_air: InAir,
    frame_rate_hz: float,
    rules: Rules,
) -> dict[str, float | str | bool]:
    """Return the row of one flight, but for its particle."""
    places = np.stack([known_numbers(track[axis], f"column {axis}") for axis in "xyz"], axis=1)
    from_lance, start_mm = rules.start(places, fit)
    landed, end_s, wall_mm = rules.landing(fit, wall, in_air)
    time = track["frame"].to_numpy(np.float64) / frame_rate_hz
    if not landed:  # the last detections may have no depth, which the fit does not know of
        end_s = max(end_s, float(time[-1]))
    flying = time <= end_s
    behind = track["background"].to_numpy()[flying] if "background" in track else None
    lit = rules.ignition(time[flying], track["gray"].to_numpy()[flying], behind)
    burning = lit.outcome in (SEEN, BEFORE)
    return {
        "t0_s": float(fit.t0),
        "first_s": min(float(fit.first_s), float(time[0])),
        "last_s": max(float(fit.last_s), float(time[-1])),
        "end_s": end_s,
        "dwell_s": end_s - float(fit.t0),
        "ending": LANDED if landed else BURNT_OUT if burning else LOST,
        "from_lance": from_lance,
        "start_mm": start_mm,
        "ignition": lit.outcome,
        "ignition_s": lit.time_s - float(fit.t0),
        # 0 where nothing can be said
        "rise_gray": 0.0 if math.isnan(lit.before) else lit.after - lit.before,
        "wall_mm": wall_mm,
    }


def _cut_off(track: pd.DataFrame, frame_rate_hz: float, rules: Rules, view: FieldOfView) -> bool:
    """Return whether a flight ends at the border of view or recording."""
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


def space_sliced_velocity(
    fit: Fit, slice_m: float = 1.0, until_s: float = math.inf
) -> pd.DataFrame:
    """Return the mean velocity in depth over each slice (Eq. 5.8).

    ``V_n = slice / (t_n - t_(n-1))``: t_n is when the fitted trajectory first is n slices
    from the lance towards the camera, t_0 when it leaves the lance.

    Parameters
    ----------
    fit
        A fitted trajectory.
    slice_m
        Length of a slice: 1 m, section 5.3.1.
    until_s
        End of the flight, if it comes before the last detection.

    Returns
    -------
    DataFrame
        ``slice_m``: far end of the slice; ``start_s``, ``end_s``: t_(n-1), t_n;
        ``velocity_m_s``; ``reached``; ``observed``: reached between the first and the last
        detection, and not, as the polynomials have it, before the first. One row for every slice
        between lance and camera, and one for each slice behind the lance that was reached. Where
        ``reached`` is False the velocity is NaN, and the row must not be counted.

    Notes
    -----
    Readings. (1) Only the span from t_0 to the last detection counts. Where a polynomial goes
    afterwards is no observation, so a slice reached only there is not reached. (2) "First": later
    returns change nothing, so V_n is positive for every slice in front of the lance. The thesis
    shows negative velocities, "reverse motions towards the lance", and says no more; here they are
    those of slices -1, -2, ... behind the lance, V_n = -slice / (t_n - t_(n+1)), of trajectories
    that go backwards from the exit point. (3) What the polynomials pass between t_0 and the first
    detection counts, as published. A flight first detected beyond a slice has in it the velocity
    that its polynomials need from the lance to there (``observed``). (4) The distance is the
    difference of depths, not the path.
    """
    check_positive(slice_m, "space_sliced_velocity: slice_m")
    if math.isnan(until_s):
        raise InputError("space_sliced_velocity: until_s is NaN; leave it out if not known.")
    distance, age = _distance(fit, min(fit.last_s, until_s))
    count = int(max(fit.exit_point_mm[2], 0.0) / (1000.0 * slice_m) * (1 + 1e-12))
    if count > MOST:
        raise InputError(f"space_sliced_velocity: {count} slices of {slice_m} m; take longer ones.")
    parts = []
    for length in (-slice_m, slice_m):
        reached = _reached(distance, age, 1000.0 * length)
        number = np.arange(1, (len(reached) if length < 0 else count) + 1)
        times = np.full(len(number) + 1, np.nan)
        times[: len(reached) + 1] = [0.0, *reached][: len(times)]
        part = pd.DataFrame({"slice_m": number * length})
        part["start_s"], part["end_s"] = fit.t0 + times[:-1], fit.t0 + times[1:]
        part["velocity_m_s"] = length / np.diff(times)
        part["reached"] = number <= len(reached)
        part["observed"] = fit.t0 + times[1:] >= fit.first_s
        parts.append(part)
    return pd.concat([parts[0][::-1], parts[1]], ignore_index=True)


def slices(
    fits: Mapping[int, Fit], ends_s: Mapping[int, float] | None = None, slice_m: float = 1.0
) -> pd.DataFrame:
    """Return the space-sliced velocities of many flights.

    Parameters
    ----------
    fits
        By particle: those that are to count.
    ends_s
        By particle: the end of its flight, where it is known.
    slice_m
        Length of a slice.

    Returns
    -------
    DataFrame
        Only slices that were reached.
    """
    parts = [SLICES.empty()]
    for particle, fit in fits.items():
        end = math.inf if ends_s is None else ends_s.get(particle, math.inf)
        table = space_sliced_velocity(fit, slice_m, end).assign(particle=particle)
        behind = table["slice_m"] < 0
        table = pd.concat([table[behind][::-1], table[~behind & table["reached"]]])
        parts.append(table[SLICES.names])
    filled = [part for part in parts if len(part)] or parts[:1]
    return SLICES.check(pd.concat(filled, ignore_index=True))


def remaining(sliced: pd.DataFrame, counted: int) -> pd.DataFrame:
    """Return the share of particles that reach each slice's far end.

    Parameters
    ----------
    sliced
        Of `slices`.
    counted
        All particles that count, also those that pass no slice.

    Returns
    -------
    DataFrame
        ``slice_m``, ``number``, ``share`` (0 of 0 is 0), ``median_m_s``. Slices behind the
        lance are rows of their own. What the tracker loses counts as not remaining.
    """
    check_count(counted, "remaining: counted", least=0)
    table = SLICES.check(sliced, "remaining: slices")
    columns = {"number": ("particle", "nunique"), "median_m_s": ("velocity_m_s", "median")}
    slices_reached = table.groupby("slice_m").agg(**columns).reset_index()
    number = slices_reached["number"]
    if number.max() > counted:
        raise InputError(f"remaining: {number.max()} particles in a slice, but {counted} counted.")
    slices_reached.insert(2, "share", number / max(counted, 1))
    return slices_reached


def _distance(fit: Fit, end_s: float) -> tuple[Array, Array]:
    """Return the distance's coefficients and the ages that part it.

    Between two of these ages the distance only rises or only falls. They are both ends of the span
    and the real parts of the roots of the velocity. A point more does no harm, and no double root
    that rounding makes complex is lost.
    """
    powers = -check_finite(fit.coefficients[2], "fit: coefficients of z")
    if not end_s > fit.t0:
        raise InputError(
            f"space_sliced_velocity: the flight ends at {end_s} s, but leaves the lance at "
            f"{fit.t0} s. Check the trajectory."
        )
    end = end_s - fit.t0
    slope = powers * np.arange(1, len(powers) + 1) * end ** np.arange(len(powers))
    slope[np.abs(slope) <= EPSILON * np.abs(slope).max(initial=0.0)] = 0.0
    turns = end * np.roots(slope[::-1]).real
    age = np.concatenate([[0.0, end], turns])
    return powers, np.unique(age[(age >= 0.0) & (age <= end)])


def _reached(powers: Array, age: Array, step: float) -> list[float]:
    """Return the ages at which the distance first is 1, 2, ... steps."""

    def far(at: Array | float) -> Array:
        """Return the distance in steps, below 0 behind the lance."""
        return np.asarray(np.polyval(np.append(powers[::-1], 0.0), at) / step)

    furthest = np.maximum.accumulate(check_finite(far(age), "space_sliced_velocity: fit"))
    reached = []
    for level in range(1, min(int(furthest[-1]), MOST) + 1):
        k = int(np.searchsorted(furthest, level))  # from 1: the first age is 0, at the lance
        reached.append(
            brentq(lambda t, level=level: far(t) - level, age[k - 1], age[k], xtol=1e-12)
        )
    return reached
