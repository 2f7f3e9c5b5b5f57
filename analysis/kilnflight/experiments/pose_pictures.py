"""Pictures of the pose: its posterior, and what the camera sees in some draws."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kilnflight.experiments.twin_pose import (
    FIRST_BOTTOM,
    FREE,
    PRIOR,
    Flown,
    first_pose,
    in_kiln,
    off_middle,
)
from kilnflight.project.style import COLOURS, PAGE_MM, canvas
from kilnflight.twin.background import Surroundings
from kilnflight.twin.camera import Geometry
from kilnflight.twin.poses import Pose
from kilnflight.twin.scenes import ROI_BOTTOM

Array = npt.NDArray[np.float64]
LABELS = {
    "axis_height_mm": "axis over the camera (mm)",
    "lance_depth_mm": "depth of the lance exit (mm)",
    "elevation_deg": "lance over the axis (degrees)",
    "scale": "published over true lengths",
}
CORNERS = 180  # of a circle that is drawn
DRAWN = 25  # flights in a picture
SHOWN = (-150.0, 150.0)  # px drawn beyond the picture
BEYOND = 1.5  # lines end there: 1 is the border of the picture, its middle 0


def posterior_table(content: Mapping[str, Any]) -> pd.DataFrame:
    """Return the four numbers: bins with prior and posterior share, and the draws.

    Returns
    -------
    DataFrame
        ``number``, ``kind`` ("bin", "draw", "mode", "first"), ``value`` (of a bin its middle),
        ``posterior`` and ``prior`` share of a bin.
    """
    rows = []
    for name in FREE:
        found = content["numbers"][name]
        low, high = found["ends"]
        edges = np.linspace(low, high, len(found["share"]) + 1)
        prior = np.diff(PRIOR[name].cdf(edges))
        bins = zip((edges[:-1] + edges[1:]) / 2, found["share"], prior, strict=True)
        rows += [(name, "bin", *each) for each in bins]
        rows += [(name, "draw", draw[name], np.nan, np.nan) for draw in content["draws"]]
        rows.append((name, "mode", content["inputs"][name], np.nan, np.nan))
        rows.append((name, "first", content["first"][name], np.nan, np.nan))
    return pd.DataFrame(rows, columns=["number", "kind", "value", "posterior", "prior"])


def draw_posterior(table: pd.DataFrame) -> Figure:
    """Draw prior and posterior of the four numbers, the draws, the mode and the first twin."""
    picture, grid = canvas(2, 2, width_mm=PAGE_MM, height_mm=100)
    for axes, name in zip(grid.flat, FREE, strict=True):
        of = dict(iter(table[table["number"] == name].groupby("kind")))
        bins = of["bin"]
        width = float(bins["value"].diff().median())
        axes.bar(bins["value"], bins["posterior"], width, color="0.75", label="posterior")
        axes.step(bins["value"], bins["prior"], where="mid", color=COLOURS[2], label="prior")
        axes.plot(
            of["draw"]["value"], np.full(len(of["draw"]), -0.015), "|", color="black", ms=5,
            label="16 draws",
        )  # fmt: skip
        for kind, style, colour in (("mode", "-", COLOURS[1]), ("first", "--", COLOURS[4])):
            label = {"mode": "mode", "first": "first twin"}[kind]
            axes.axvline(of[kind]["value"].iloc[0], ls=style, color=colour, label=label)
        axes.set(xlabel=LABELS[name], ylabel="share of a bin")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    picture.legend(handles, labels, loc="outside upper center", ncols=5)
    return picture


def draw_views(
    flights: Mapping[tuple[int, int], Flown], poses: Mapping[str, Pose]
) -> tuple[Figure, pd.DataFrame]:
    """Draw what the camera sees in some poses: tube, lance, true flights of chips.

    The region of interest is that of the second look, in the first pose that of the first twin.
    The outlines come with the picture.
    """
    picture, grid = canvas(2, -(-len(poses) // 2), width_mm=PAGE_MM, height_mm=150)
    parts = []
    for axes, (name, pose) in zip(grid.flat, poses.items(), strict=False):
        geometry = pose.placed(Geometry())
        flown = in_kiln(flights, pose, geometry)["wood chip"].position_m[:DRAWN]
        lines = outlines(geometry, pose)
        lines |= {f"chip {k}": geometry.to_camera(path) for k, path in enumerate(flown)}
        for line, place in lines.items():
            parts.append(_drawn(axes, line, place, geometry).assign(pose=name))
        _frame(axes, geometry, FIRST_BOTTOM if pose == first_pose() else ROI_BOTTOM)
        axes.set_title(
            f"{name}: axis {pose.axis_height_mm:.0f} mm, lance {pose.lance_depth_mm / 1000:.2f} m, "
            f"{pose.elevation_deg:+.1f} degrees"
        )
    for axes in list(grid.flat)[len(poses) :]:
        axes.axis("off")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    picture.legend(handles, labels, loc="outside lower center", ncols=5)
    return picture, pd.concat(parts, ignore_index=True)


def outlines(geometry: Geometry, pose: Pose) -> dict[str, Array]:
    """Return lines (n, 3) in camera coordinates, mm: circles of the wall, and the lance."""
    angle = np.linspace(0.0, 2 * np.pi, CORNERS)
    radius = geometry.kiln_radius_mm / 1000.0
    circle = radius * np.stack([np.zeros(CORNERS), np.cos(angle), np.sin(angle)], axis=1)
    ends = {"inlet plate": geometry.inlet_m, "wall at the lance": 0.0}
    lines = {name: geometry.to_camera(circle + np.array([s, 0, 0])) for name, s in ends.items()}
    along = np.array([1.0, 0.0, np.tan(np.deg2rad(pose.elevation_deg))])
    back = np.linspace(geometry.inlet_m, 0.0, 20)[:, None]
    lines["lance"] = geometry.to_camera(geometry.lance_m + back * along)
    return lines


def _drawn(axes: Axes, name: str, place_mm: Array, geometry: Geometry) -> pd.DataFrame:
    """Draw a line of the kiln where the camera sees it; return its pixels."""
    outside = ~(off_middle(place_mm, geometry) <= BEYOND)
    row, column = geometry.project(np.where(outside[:, None], np.nan, place_mm))
    if name.startswith("chip"):
        look: dict[str, Any] = {"color": "0.6", "lw": 0.6, "ls": "-"}
        look["label"] = "true flights of chips" if name == "chip 0" else None
    else:
        colour = {"inlet plate": COLOURS[2], "wall at the lance": COLOURS[4]}.get(name, COLOURS[1])
        look = {"color": colour, "lw": 2.0 if name == "lance" else 1.2, "ls": "-", "label": name}
    axes.plot(column, row, **look)
    return pd.DataFrame({"line": name, "row": row, "col": column}).dropna()


def _frame(axes: Axes, geometry: Geometry, bottom: float) -> None:
    """Set the limits to a little more than the picture, and draw its border and the ROI."""
    rows, columns = geometry.rows, geometry.columns
    corners = np.array(Surroundings().roi)
    corners[:, 0] = np.minimum(corners[:, 0], bottom)
    corners *= (rows, columns)
    closed = np.vstack([corners, corners[:1]])
    axes.plot(closed[:, 1], closed[:, 0], ":", color="black", lw=0.8, label="region of interest")
    axes.plot([0, columns, columns, 0, 0], [0, 0, rows, rows, 0], "-", color="black", lw=0.8)
    axes.set(xlim=(SHOWN[0], columns + SHOWN[1]), ylim=(rows + SHOWN[1], SHOWN[0]))
    axes.set(xlabel="column (px)", ylabel="row (px)", aspect="equal")
