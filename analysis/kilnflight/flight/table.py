"""The table of flights: their start, end and dwell time (section 5.3.1)."""

from collections.abc import Mapping
from typing import NamedTuple

import cv2
import numpy as np
from pandas import DataFrame, Series

from kilnflight.arrays import ArrayLike, Facts
from kilnflight.checks import (
    LARGEST_WHOLE,
    InputError,
    Settings,
    check_finite,
    check_number,
)
from kilnflight.detection.wall import Cylinder, InAir
from kilnflight.flight.criteria import BEYOND_S, Plausible, landing_s, starts_at_lance
from kilnflight.ignition import NONE, SEEN, Ignition, IgnitionResult
from kilnflight.regression import Fit
from kilnflight.tables import AXES, FLIGHTS, FLOWN, order_tracks

LANDED = "landed"
BURNT_OUT = "burnt out"
LEFT = "left the view"
LOST = "lost"
# Distance from the border of the view, or to a track that goes on: gate of sec. 3.3.
EDGE_PX = 45.0


class Rules(Settings):
    """Criteria of flights that differ between recordings.

    ``ignition`` depends on the camera's grey values, ``plausible`` on the air's
    velocity. The thesis rejects no flight (`kilnflight.flight.Plausible`).

    The test of grey values is made for papers only (section 5.3.2). Without it a flight
    has no ignition and does not burn out.

    Parameters
    ----------
    ignition
        Test of the grey values. None: not tested.
    plausible
        Test of the trajectory. None: no flight is rejected.
    """

    ignition: Ignition | None = Ignition()
    plausible: Plausible | None = Plausible()


class FieldOfView(NamedTuple):
    """The camera's view of a recording; by default without a border or an end.

    Attributes
    ----------
    roi
        (m, 2) corners of the region of interest: row, col in px.
    frames
        Frames that were searched for particles.
    """

    roi: ArrayLike | None = None
    frames: range = range(int(LARGEST_WHOLE))


def flights(
    tracks: DataFrame,
    fits: Mapping[int, Fit],
    wall: Cylinder,
    in_air: InAir,
    frame_rate_hz: float,
    rules: Rules | None = None,
    view: FieldOfView | None = None,
) -> DataFrame:
    """Return the flights of fitted tracks, one row each.

    The dwell time runs from t0 to landing,
    unlit (Fig. 5.18 a) or burning (b), or to burning out in the air (c).

    Parameters
    ----------
    tracks
        Columns frame, particle, row, col (px), gray, x, y, z (mm). Particle -1 and
        tracks without a fit are left out. A column ``background``, if there is one,
        holds the grey value behind each detection
        (`kilnflight.flight.empty.background_gray`).
    fits
        By particle; of `kilnflight.regression.fits`.
    wall, in_air
        The kiln and the limit (Table 5.12, section 5.1.4).
    frame_rate_hz
        Of the recording.
    rules
        None: `Rules` with their defaults.
    view
        Region and frames: what ends at their border did not burn out.

    Returns
    -------
    DataFrame
        `kilnflight.tables.FLIGHTS`.

    Raises
    ------
    InputError
        If a column is missing or holds other values, or a fitted particle has no track
        or no position with depth.

    Notes
    -----
    A track that ends in the air burnt out if it burnt. An unlit one that ends within
    `EDGE_PX` of the region's border has left the view: "their actual flight time is
    longer than computed" (appendix A.1). A burning one there is lost: of those that
    rise into the edge, "flight and burning behavior cannot be analyzed" (A.1). So is
    any other unlit one, what the recording cuts, and what goes on as another track, as
    where a track is cut (`kilnflight.tracklets.Cutting`). The dwell time of what left
    or was lost is a lower bound. Ignition is searched up to the landing, since the wall
    ignites all that land (section 5.1.1).

    Examples
    --------
    A particle falls to the wall, which is 0.8 m from the axis, in 0.4 s.

    >>> fit = Fit((0.0, 0.0, 6500.0), 0.0, 0, (-0.1, 0.0), (2, 2, 2),
    ...           ((0.0, 0.0), (0.0, 5000.0), (-8000.0, 0.0)), 0.05, 0.45, 41)
    >>> track = DataFrame({"frame": range(5, 46), "particle": 0, "gray": 3000.0})
    >>> track[["x", "y", "z"]] = fit(track["frame"] / 100)
    >>> track[["row", "col"]] = track[["y", "x"]] / 3 + 500
    >>> kiln = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 772.0)
    >>> found = flights(track, {0: fit}, kiln, InAir(800.0), frame_rate_hz=100.0)
    >>> found[["dwell_s", "ending", "ignition"]].round(3).to_dict("records")
    [{'dwell_s': 0.4, 'ending': 'landed', 'ignition': 'none'}]
    """
    rules = rules or Rules()
    view = view or FieldOfView()
    check_number(frame_rate_hz, "flights: frame_rate_hz", above=0)
    where = "flights: tracks"
    order, particle, _ = order_tracks(tracks, where)
    table = FLOWN.check(tracks, where)
    if "background" in tracks:
        background = tracks["background"]
        table["background"] = check_finite(background, f"{where}: column background")
    table = table.iloc[order].assign(particle=particle)
    grouped = table.groupby("particle")
    by_particle = dict(iter(grouped))
    starts = grouped.head(1)
    rows = []
    for name, fit in fits.items():
        if name not in by_particle:
            raise InputError(f"flights: tracks: no particle {name}, which has a fit.")
        track = by_particle[name]
        try:
            row = _flight(track, fit, wall, in_air, frame_rate_hz, rules)
        except InputError as error:
            raise InputError(f"flights: particle {name}: {error}") from error
        if not row["ending"]:
            burning = row["ignition"] == SEEN
            last = track.iloc[-1]
            row["ending"] = _ending_in_air(last, burning, starts, frame_rate_hz, view)
        rows.append({"particle": name} | row)
    if not rows:
        return FLIGHTS.empty()
    return DataFrame(rows)[FLIGHTS.names]


def _flight(
    track: DataFrame,
    fit: Fit,
    wall: Cylinder,
    in_air: InAir,
    rate_hz: float,
    rules: Rules,
) -> Facts:
    """Return one flight's row of `kilnflight.tables.FLIGHTS`, without ``particle``.

    ``track`` holds the flight's detections by ascending frame, ``rate_hz`` is the frame
    rate. The ``ending`` is empty if the flight ends in the air.
    """
    from_lance, start_mm = starts_at_lance(track[list(AXES)].to_numpy(), fit)
    time = track["frame"].to_numpy(float) / rate_hz
    ending = LANDED
    end_s = landing_s(fit, wall, in_air)
    if end_s is None:
        # The last detections may have no depth and so be unknown to the fit.
        ending = ""
        end_s = max(fit.last_s, time[-1])
    ignition = IgnitionResult(NONE)
    if rules.ignition is not None:
        flying = track[time <= end_s]
        ignition = rules.ignition(
            time[time <= end_s], flying["gray"], flying.get("background")
        )
    refused = ""
    if rules.plausible is not None:
        refused = rules.plausible(fit, end_s, wall, in_air)
    return {
        "t0_s": fit.t0,
        "first_s": min(fit.first_s, time[0]),
        "last_s": max(fit.last_s, time[-1]),
        "end_s": end_s,
        "dwell_s": end_s - fit.t0,
        "ending": ending,
        "from_lance": from_lance,
        "start_mm": start_mm,
        "ignition": ignition.outcome,
        "ignition_s": ignition.time_s - fit.t0,
        "refused": refused,
    }


def _ending_in_air(
    last: Series,
    burning: bool,
    starts: DataFrame,
    rate_hz: float,
    view: FieldOfView,
) -> str:
    """Return `BURNT_OUT`, `LEFT` or `LOST`; the notes of `flights` have the rule.

    ``last`` is the flight's last detection, ``starts`` the first one of every track.
    """
    cut_off = last["frame"] / rate_hz + BEYOND_S > (view.frames.stop - 1) / rate_hz
    # Another track may begin where and soon after this one ends.
    places = ["row", "col"]
    after = (starts["frame"] - last["frame"]).to_numpy() / rate_hz
    apart = np.hypot(*(starts[places] - last[places]).to_numpy(float).T)
    goes_on = ((after > 0) & (after <= BEYOND_S) & (apart <= EDGE_PX)).any()
    if cut_off or goes_on or burning == _at_border(last, view):
        return LOST
    return BURNT_OUT if burning else LEFT


def _at_border(last: Series, view: FieldOfView) -> bool:
    """Return whether the last detection is at the region's border, or beyond it."""
    if view.roi is None:
        return False
    corners = check_finite(view.roi, "flights: view.roi", (None, 2))
    place = (last["row"], last["col"])
    inwards = cv2.pointPolygonTest(corners.astype(np.float32), place, measureDist=True)
    return inwards < EDGE_PX


def kept(flights: DataFrame) -> DataFrame:
    """Return the flights that are not rejected (`Plausible`), from the lance or not.

    Parameters
    ----------
    flights
        `kilnflight.tables.FLIGHTS`.

    Examples
    --------
    >>> from kilnflight.flight import TOO_FAST
    >>> table = DataFrame({"particle": [0, 1], "refused": ["", TOO_FAST]})
    >>> kept(table)["particle"].tolist()
    [0]
    """
    return flights[flights["refused"] == ""]
