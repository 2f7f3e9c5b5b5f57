"""Panels of the figures of notebooks 50, 52 and 54."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from pandas import DataFrame, Series

from kilnflight.arrays import Array, Two
from kilnflight.experiments import plots
from kilnflight.flight import BURNT_OUT, LANDED, straight_on
from kilnflight.publication import style
from kilnflight.regression import Fit, Three


def draw_stretched(axes: Axes, image: Array, tails: Two, step: int) -> None:
    """Draw an image (rows, cols) from black to white between two of its quantiles.

    Blocks of ``step`` x ``step`` px are averaged.
    """
    low, high = np.quantile(image, tails)
    light = (image - low) / max(high - low, 1.0)
    style.draw_frame(axes, np.clip(light, 0.0, 1.0), step)


def draw_fits(
    axes: Any,
    tracks: DataFrame,
    fits: Mapping[Any, Fit],
    lance_mm: Three,
    gray: bool,
) -> None:
    """Draw fitted trajectories with their detections and the lance in space.

    Parameters
    ----------
    axes
        3D axes.
    tracks
        Detections, ``particle`` and grey values.
    fits
        Trajectory by particle.
    lance_mm
        Outlet of the lance.
    gray
        Whether detections are points coloured by grey value; else they are thin lines.
    """
    for k, (particle, track) in enumerate(tracks.groupby("particle")):
        fit = fits[particle]
        colour = style.COLOURS[1 + k % 6]
        way = plots.upright(fit(np.linspace(fit.t0, fit.last_s, 60)))
        axes.plot(*way, color=colour, lw=1.4, ls="-")
        seen = track.dropna(subset="z").sort_values("frame")
        place = plots.upright(seen[["x", "y", "z"]])
        if gray:
            look = {"cmap": "inferno", "vmin": 0, "vmax": 30_000}
            axes.scatter(*place, s=2, c=seen["gray"], **look)
        else:
            axes.plot(*place, color=colour, lw=0.35, ls="-")
    lance = plots.upright(lance_mm)
    axes.scatter(*lance, marker="x", color="red", s=25, depthshade=False)
    plots.label_camera_space(axes)
    axes.set_box_aspect((1.9, 1, 1), zoom=1.25)  # the path is longest in depth
    axes.view_init(elev=15, azim=-65)


def draw_flight(axes: Axes, flight: Series, track: DataFrame, fit: Fit) -> None:
    """Draw a flight from the side: detections, trajectory unlit and burning, its end.

    ``flight`` is a row of `kilnflight.tables.FLIGHTS`, ``track`` has its detections.
    """
    end_s = flight["end_s"]
    lit_s = np.fmin(flight["t0_s"] + flight["ignition_s"], end_s)
    unlit = straight_on(fit, np.linspace(flight["t0_s"], lit_s, 60))
    burning = straight_on(fit, np.linspace(lit_s, end_s, 60))
    lance = np.array(fit.exit_point_mm)

    def draw(places_mm: Any, form: str, label: str, **look: Any) -> None:
        depth, _, up = plots.upright(places_mm - lance)
        axes.plot(-depth, up, form, label=label, **look)

    draw(track[["x", "y", "z"]], ".", "detections", color="0.65", ms=2)
    draw(unlit, "-k", "unlit", lw=1.0)
    draw(burning, "-", "burning", lw=2.6, color=style.COLOURS[3])
    draw(lance, "x", "lance", ms=6, mew=1.6, color="red")
    ending = flight["ending"]
    mark = {LANDED: "sk", BURNT_OUT: "ok"}[ending]
    draw(straight_on(fit, end_s), mark, f"end: {ending}", mfc="white")
    label = f"dwell time {flight['dwell_s']:.2f} s"
    axes.text(0.03, 0.05, label, transform=axes.transAxes)
