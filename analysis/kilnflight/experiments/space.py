"""Pictures in space: whatever is drawn in three dimensions, and which way is up there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.project.style import COLOURS
from kilnflight.regression import Fit
from kilnflight.twin.flight import Flights

Array = npt.NDArray[np.float64]
SAMPLES = 60  # of a fitted curve
BRIGHTEST = 30_000.0  # grey value that is drawn brightest, nearly half of 16 bits; assumption


def upright(places_mm: npt.ArrayLike) -> Array:
    """Return depth, across and up in m, (3, n), of camera coordinates (n, 3) in mm.

    Every picture in space is drawn in these: y of the camera points up, as rows count down.
    """
    x, y, z = np.asarray(places_mm, dtype=np.float64).reshape(-1, 3).T / 1000.0
    return np.stack([z, x, y])


def draw_curves(
    axes: Any, fits: Sequence[Fit], tracks: Sequence[pd.DataFrame], gray: bool = False
) -> None:
    """Draw fitted trajectories in space, thick; detections thin or by grey value.

    Parameters
    ----------
    axes
        With three dimensions; depth runs along its x, metres.
    fits, tracks
        Of the same particles; tracks with ``frame``, ``x``, ``y``, ``z``, ``gray``.
    gray
        Whether to draw the detections as points as bright as they were.
    """
    for k, (fit, track) in enumerate(zip(fits, tracks, strict=True)):
        colour = COLOURS[1 + k % (len(COLOURS) - 1)]
        way = upright(fit(np.linspace(fit.t0, fit.last_s, SAMPLES)))
        axes.plot(*way, color=colour, lw=1.4, ls="-")
        detections = track.dropna(subset="z").sort_values("frame")
        place = upright(detections[["x", "y", "z"]])
        if gray:
            look = {
                "c": detections["gray"],
                "cmap": "inferno",
                "vmin": 0,
                "vmax": BRIGHTEST,
                "s": 2,
            }
            axes.scatter(*place, **look)
        else:
            axes.plot(*place, color=colour, lw=0.35, ls="-")
    if fits:
        lance = upright(fits[0].exit_point_mm)
        axes.scatter(*lance, marker="x", color="red", s=25, depthshade=False)
    label_camera_space(axes)
    axes.set_box_aspect((1.9, 1, 1), zoom=1.25)  # the way is longest in depth


def label_camera_space(axes: Any) -> None:
    """Label axes of `upright` places; call once, as it turns their second axis."""
    axes.invert_yaxis()  # or right and left were changed
    _label_space(axes, ("depth z (m)", "x (m)", "up, y (m)"), (-2, -4, -1), -2)


def _label_space(axes: Any, labels: Sequence[str], pads: Sequence[int], ticks: int) -> None:
    for axis, label, pad in zip("xyz", labels, pads, strict=True):
        axes.set(**{f"{axis}label": label})
        getattr(axes, f"{axis}axis").labelpad = pad
    axes.tick_params(pad=ticks)
    axes.locator_params(nbins=4)


def draw_flown_paths(axes: Any, flights: Flights, most: int) -> None:
    """Draw simulated flights in space, a dot for every metre in depth (Fig. A.5)."""
    for k in range(min(most, len(flights.end))):
        path = flights.position_m[k]
        path = path[np.isfinite(path).all(axis=1)].astype(np.float64)
        axes.plot(*path.T, color=COLOURS[1 + k % 6], lw=0.6, ls="-")
        marks = np.flatnonzero(np.diff(np.floor(path[:, 0])) > 0)
        axes.scatter(*path[marks].T, s=3, color="black", depthshade=False)
    _label_space(axes, ("from the lance (m)", "across (m)", "up (m)"), (0, -4, -4), -1)
    axes.set_box_aspect((2.2, 1.0, 1.0), zoom=1.1)
