"""The table of flights: their start, end and dwell time (section 5.3.1)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError, check_finite, check_number
from kilnflight.detection.wall import Cylinder, InAir
from kilnflight.flight.criteria import BEYOND_S, Plausible, end_of, starts_at_lance
from kilnflight.ignition import NONE, SEEN, Ignition, IgnitionResult
from kilnflight.regression import Fit
from kilnflight.tables import AXES, FLIGHTS, GAPS, Table, order_tracks

# frame, row, col, gray, x, y, z
FLOWN = Table(
    "tracks of flights",
    frame=int,
    row=float,
    col=float,
    gray=float,
    x=GAPS,
    y=GAPS,
    z=GAPS,
)
LANDED = "landed"
BURNT_OUT = "burnt out"
LEFT = "left the view"
LOST = "lost"
UNTESTED = IgnitionResult(NONE)
# from the border of the view, and to a track that goes on: the gate of sec. 3.3
EDGE_PX = 45.0


@dataclass(frozen=True)
class Rules:
    """Criteria of flights that differ between recordings.

    ``ignition`` depends on the camera's grey values, ``plausible`` on the air's
    velocity. The thesis rejects no flight (`kilnflight.flight.Plausible`).

    The test of grey values is made for papers only (section 5.3.2). Without it a flight
    has no ignition and does not burn out.
    """

    ignition: Ignition | None = field(default_factory=Ignition)  # None: not tested
    plausible: Plausible | None = field(
        default_factory=Plausible
    )  # None: none is rejected


class FieldOfView(NamedTuple):
    """The camera's view of a recording; None: ends at that border are not sought.

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

    The table is `kilnflight.tables.FLIGHTS`. The dwell time runs from t0 to landing,
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
    """
    rules = rules or Rules()
    view = view or FieldOfView()
    check_number(frame_rate_hz, "flights: frame_rate_hz", above=0)
    order, particle, _ = order_tracks(tracks, where := "flights: tracks")
    table = FLOWN.check(tracks, where)
    if "background" in tracks:
        table["background"] = check_finite(
            tracks["background"], f"{where}: column background"
        )
    table = table.iloc[order].assign(particle=particle)
    by_particle = dict(iter(table.groupby("particle")))
    starts = table.groupby("particle").head(1)
    rows = []
    for name, fit in fits.items():
        if name not in by_particle:
            raise InputError(f"flights: tracks: no particle {name}, which has a fit.")
        track = by_particle[name]
        try:
            row = _flight(track, fit, wall, in_air, frame_rate_hz, rules)
        except InputError as error:
            raise InputError(f"flights: particle {name}: {error}") from error
        if row["ending"] != LANDED:
            if _cut_off(track, frame_rate_hz, view) or _goes_on(
                track, starts, frame_rate_hz
            ):
                row["ending"] = LOST
            elif _at_border(track, view):
                row["ending"] = LOST if row["ending"] == BURNT_OUT else LEFT
        rows.append({"particle": name} | row)
    return pd.DataFrame(rows)[FLIGHTS.names] if rows else FLIGHTS.empty()


def _flight(
    track: pd.DataFrame,
    fit: Fit,
    wall: Cylinder,
    in_air: InAir,
    rate_hz: float,
    rules: Rules,
) -> dict[str, float | str | bool]:
    """Return one flight's row of `kilnflight.tables.FLIGHTS`, without ``particle``.

    ``track`` holds the flight's detections by ascending frame, ``rate_hz`` is the frame
    rate. The ending is decided from this track alone; `flights` corrects it.
    """
    from_lance, start_mm = starts_at_lance(track[list(AXES)].to_numpy(), fit)
    landed, end_s, wall_mm = end_of(fit, wall, in_air)
    time = track["frame"].to_numpy(np.float64) / rate_hz
    if not landed:  # the last detections may have no depth and so be unknown to the fit
        end_s = max(end_s, float(time[-1]))
    flying = time <= end_s
    behind = track["background"].to_numpy()[flying] if "background" in track else None
    gray = track["gray"].to_numpy()[flying]
    lit = UNTESTED
    if rules.ignition is not None:
        lit = rules.ignition(time[flying], gray, behind)
    burning = lit.outcome == SEEN
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
        "refused": rules.plausible(fit, end_s, wall, in_air) if rules.plausible else "",
    }


def _cut_off(track: pd.DataFrame, rate_hz: float, view: FieldOfView) -> bool:
    """Return whether the last detection is within `BEYOND_S` of the recording's end."""
    if view.frames is None:
        return False
    end = (view.frames.stop - 1) / rate_hz
    return bool(track["frame"].iloc[-1] / rate_hz + BEYOND_S > end)


def _at_border(track: pd.DataFrame, view: FieldOfView) -> bool:
    """Return whether the last detection is outside the region or within `EDGE_PX` of
    its border.
    """
    if view.roi is None:
        return False
    last = track.iloc[-1]
    corners = check_finite(view.roi, "flights: view.roi", (None, 2))
    place = (float(last["row"]), float(last["col"]))
    return (
        cv2.pointPolygonTest(corners.astype(np.float32), place, measureDist=True)
        < EDGE_PX
    )


def _goes_on(track: pd.DataFrame, starts: pd.DataFrame, rate_hz: float) -> bool:
    """Return whether another track continues this one.

    It begins within `BEYOND_S` and `EDGE_PX` of this one's last detection. ``starts``
    holds the first detection of every track.
    """
    last = track.iloc[-1]
    places = ["row", "col"]
    after = (starts["frame"] - last["frame"]).to_numpy() / rate_hz
    apart = np.hypot(*(starts[places] - last[places]).to_numpy(np.float64).T)
    return bool(((after > 0) & (after <= BEYOND_S) & (apart <= EDGE_PX)).any())


def kept(flights: pd.DataFrame) -> pd.DataFrame:
    """Return the flights that are not rejected (`Plausible`), from the lance or not."""
    return flights[flights["refused"] == ""]
