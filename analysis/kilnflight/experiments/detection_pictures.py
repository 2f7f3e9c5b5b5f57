"""Pictures of the detection experiment.

After Figs 2.19, 3.10, 3.11 and 5.5 to 5.10 of the thesis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from kilnflight.detection import k_distances
from kilnflight.detection import wall as cylinder
from kilnflight.detection.combination import Clusters
from kilnflight.experiments.detection import TABLES
from kilnflight.experiments.detection_tables import PARAMETERS, published_radius_mm
from kilnflight.experiments.plots import draw_bars
from kilnflight.experiments.space import upright
from kilnflight.project import claims
from kilnflight.project.style import (
    COLOURS,
    LINES,
    PAGE_MM,
    PUBLISHED,
    canvas,
    draw_circles,
    draw_frame,
)
from kilnflight.twin.camera import Geometry

Array = npt.NDArray[np.float64]
FEWEST = 10  # particles of a class, else one of them is a large part of its recall
NAMES = {"dbscan": "DBSCAN", "mo": "MO", "qcc": "QCC"}
HERE: dict[str, Any] = {
    "marker": "o",
    "color": "black",
    "mfc": "none",
    "ls": "",
    "label": "simulated",
}
NUMBERED = {"dbscan": ("epsilon_mm", "eps (mm)"), "mo": ("R", "R"), "qcc": ("K", "K")}
NUMBER_SIZE = (0.07, 0.04)  # of a number in the picture, in recall and precision


def draw_k_distances(cloud: Array) -> tuple[Figure, pd.DataFrame]:
    """Draw the sorted k-distance graph of a cloud (n, 3) in mm, and return its curves.

    These are ``point``, and ``distance_<k>_mm`` for each minPts of Table 5.8.
    """
    printed = claims.published(TABLES["dbscan"])
    shown = np.unique(np.geomspace(1, len(cloud), 300).astype(int)) - 1
    counts = np.unique(printed["minPts"])
    distances = {f"distance_{k}_mm": k_distances(cloud, k)[shown] for k in counts}
    curves = pd.DataFrame({"point": shown + 1, **distances})
    picture, ((axes,),) = canvas()
    for name, line in zip(curves.columns[1:], LINES, strict=False):
        axes.plot(curves["point"], curves[name], ls=line, label=f"k = {name.split('_')[1]}")
    for value in np.unique(printed["epsilon_mm"]):
        axes.axhline(value, color="0.7", lw=0.5, ls="-")
        axes.annotate(f"{value}", (1, value), fontsize=6, va="bottom")
    axes.set(xscale="log", yscale="log", xlabel="points, sorted")
    axes.set_ylabel("distance to neighbour k (mm)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")  # the default takes mathematical notation
    axes.legend()
    return picture, curves


def draw_precision_recall(totals: Mapping[str, pd.DataFrame]) -> tuple[Figure, pd.DataFrame]:
    """Draw precision over recall of clusterers, ours and published, and return ours.

    ``totals`` is of `cluster_totals`. Numbers are values of one parameter (eps, R, K), left of the
    settings that have it; those that would lie on one another are left out.
    """
    beside: dict[str, Any] = {"textcoords": "offset points", "fontsize": 5.5, "ha": "right"}
    picture, (panels,) = canvas(1, len(totals), width_mm=PAGE_MM, height_mm=62, sharey=True)
    for axes, (name, ours) in zip(panels, totals.items(), strict=True):
        printed = claims.published(TABLES[name])
        for table, look in ((ours, HERE), (printed, {**PUBLISHED, "zorder": 1})):
            axes.plot(table["recall"], table["precision"], clip_on=False, **look)
        parameter, words = NUMBERED[name]
        ends = ours.groupby(parameter).agg({"recall": "min", "precision": "max"})
        last = np.full(2, np.inf)
        for value, end in ends.sort_values("recall", ascending=False).iterrows():
            if (np.abs(end - last) >= NUMBER_SIZE).any():
                last = end.to_numpy()
                axes.annotate(f"{value:g}", (last[0], last[1]), (-4, -1), va="top", **beside)
        axes.set(title=f"{NAMES[name]}, number: {words}", xlabel="recall", xlim=(0, 1))
    panels[0].set(ylabel="precision", ylim=(0, 1))
    panels[0].legend(loc="upper left")
    points = pd.concat(totals, names=["family"]).reset_index("family")
    names = [*chain(*PARAMETERS.values()), "precision", "recall", "f1", "f1_published"]
    return picture, points[["family", *names]]


def draw_class_recall(recall: pd.DataFrame, by: str, published: Sequence[float] = ()) -> Figure:
    """Draw the recall of each class by subset, a panel for each value of a column.

    Of fewer than `FEWEST` particles no bar is drawn.

    Parameters
    ----------
    recall
        ``subset``, ``kind``, ``tp``, ``fn``, ``recall`` and the column.
    by
        The column.
    published
        Recall of non-burning particles by subset, drawn in the first panel.
    """
    few = recall["tp"] + recall["fn"] < FEWEST
    groups = recall.assign(recall=recall["recall"].mask(few)).groupby(by, sort=False)
    picture, (panels,) = canvas(1, len(groups), width_mm=PAGE_MM, height_mm=62, sharey=True)
    for axes, (name, table) in zip(panels, groups, strict=True):
        draw_bars(axes, table, "subset", "kind", "recall")
        axes.set_title(NAMES.get(str(name), str(name)))
    if len(published):
        panels[0].plot(published, clip_on=False, **{**PUBLISHED, "label": "published, non-burning"})
    panels[0].set_ylabel("recall")
    picture.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return picture


def draw_fitted_wall(points: Array, fit: cylinder.Cylinder) -> Figure:
    """Draw the wall's points (n, 3) in mm along the fitted axis, and their distance.

    The distance is that to the axis.
    """
    picture, (panels,) = canvas(1, 2, width_mm=PAGE_MM, height_mm=75)
    distance = cylinder.distance_to_axis(points, fit)
    depth, across, up = upright(points)
    panels[0].plot(across, up, ",", color="black")
    panels[1].plot(depth, distance, ",", color="black")
    around = np.linspace(0, 2 * np.pi, 200)
    reach = (points[:, 2].mean() - fit.centre_mm[2]) / fit.direction[2]
    middle = np.array(fit.centre_mm) + reach * np.array(fit.direction)
    ring = np.array([np.cos(around), np.sin(around), np.zeros(len(around))]).T
    _, across, up = upright(middle + fit.radius_mm * ring)
    panels[0].plot(across, up, "-", color=COLOURS[2], label=f"fit, {fit.radius_mm:.0f} mm")
    panels[0].set(xlabel="x (m)", ylabel="up, y (m)", aspect="equal")
    panels[0].legend(loc="center")  # within the circle
    levels = {
        "fit": (fit.radius_mm, "-", COLOURS[2]),
        "true": (Geometry().kiln_radius_mm, ":", "black"),
    }
    levels["published"] = (published_radius_mm(), "--", PUBLISHED["color"])
    for text, (level, line, colour) in levels.items():
        panels[1].axhline(level, color=colour, ls=line, label=f"{text}, {level:.0f} mm")
    panels[1].set(xlabel="depth z (m)", ylabel="distance from the axis (mm)", ylim=(300, 1100))
    panels[1].legend(loc="lower left")
    return picture


def draw_axis_distances(placed: pd.DataFrame, thresholds: Mapping[str, float]) -> Figure:
    """Draw histograms of distances from the axis, their Gaussians, and thresholds.

    ``placed`` holds ``label`` and ``distance_mm`` of particles.
    """
    picture, ((axes,),) = canvas(width_mm=120, height_mm=65)
    bins, shown = np.arange(0, 1201, 25), np.linspace(0, 1200, 400)
    kinds = {False: ("in the air", COLOURS[2], "-"), True: ("on the wall", COLOURS[1], "--")}
    for on_wall, values in placed.groupby(placed["label"] == 4)["distance_mm"]:
        name, colour, line = kinds[on_wall]
        axes.hist(values, bins, color=colour, alpha=0.35, density=True, label=name)
        axes.plot(shown, norm.pdf(shown, values.mean(), values.std()), ls=line, color=colour)
    beside: dict[str, Any] = {"textcoords": "offset points", "xytext": (-1, 0), "ha": "right"}
    beside |= {"xycoords": axes.get_xaxis_transform(), "rotation": 90, "va": "top"}
    for level in thresholds.values():
        axes.axvline(level, color="black", lw=0.8, ls=":")
        axes.annotate(f"{level:.0f}", (level, 0.99), fontsize=6, **beside)
    axes.set(xlabel="distance from the fitted axis (mm)", ylabel="density (1/mm)")
    axes.legend(loc="upper left")
    return picture


def _parts(
    images: Mapping[str, tuple[npt.NDArray[Any], Sequence[int]]],
    columns: int,
    look: Mapping[str, Any] | None = None,
    **size: Any,
) -> tuple[Figure, list[Axes]]:
    """Draw rectangles (top, bottom, left, right) of images by title, in pixels of the frame."""
    picture, grid = canvas(-(-len(images) // columns), columns, **size)
    for axes, (title, (image, box)) in zip(grid.flat, images.items(), strict=False):
        top, bottom, left, right = box
        extent = (left, right, bottom, top)
        axes.imshow(image[top:bottom, left:right], cmap="gray", extent=extent, **(look or {}))
        axes.set(title=title, xlabel="column (px)", ylabel="row (px)")
    for axes in grid.flat[len(images) :]:
        axes.axis("off")
    return picture, list(grid.flat)


def draw_flame(
    gray: npt.NDArray[np.uint16], mask: npt.NDArray[np.bool_], roi: Sequence[int]
) -> Figure:
    """Draw the burner's rectangle (top, bottom, left, right) and the flame in it."""
    titles, (top, bottom, left, right) = ("rectangle around the burner", "segmented flame"), roi
    size: dict[str, Any] = {"width_mm": 120, "height_mm": 70, "sharey": True}
    picture, panels = _parts(dict.fromkeys(titles, (gray, roi)), 2, **size)
    panels[1].contour(mask, levels=[0.5], colors=COLOURS[1], extent=(left, right, top, bottom))
    panels[1].set_ylabel("")
    return picture


def draw_cuts(images: Mapping[str, tuple[Array, Sequence[int]]], peaks: Array) -> Figure:
    """Draw rectangles (top, bottom, left, right) of images; the first with its peaks."""
    picture, panels = _parts(images, len(images), width_mm=PAGE_MM, height_mm=62)
    panels[0].plot(peaks[:, 1] + 0.5, peaks[:, 0] + 0.5, "x", color=COLOURS[1], ms=8)
    for axes in panels:
        axes.locator_params(axis="x", nbins=3, integer=True)
    return picture


def draw_backgrounds(images: Mapping[str, Array], box: Sequence[int]) -> Figure:
    """Draw a rectangle (top, bottom, left, right) of a frame, the first, and of backgrounds."""
    top, bottom, left, right = box
    first = next(iter(images.values()))[top:bottom, left:right]
    look = dict(zip(("vmin", "vmax"), np.quantile(first, [0.01, 0.99]), strict=True))
    parts = {name: (image, box) for name, image in images.items()}
    return _parts(parts, 2, look, width_mm=PAGE_MM, height_mm=135)[0]


def draw_keypoints_and_clusters(
    gray: npt.NDArray[np.uint16],
    keypoints: Array,
    clusters: Clusters | None,
    roi: Sequence[tuple[float, float]],
    **size: Any,
) -> Figure:
    """Draw a frame with keypoints (circles), clusters (dots), region of interest."""
    picture, ((axes,),) = canvas(**size)
    draw_frame(axes, gray, 4 if clusters is not None else 2)
    if clusters is not None:
        spread = np.repeat(np.arange(len(clusters)) % 6 + 1, np.diff(clusters.start))
        axes.scatter(*clusters.pixels.T[::-1], s=0.1, c=[COLOURS[k] for k in spread])
    draw_circles(axes, keypoints, COLOURS[5])
    corners = np.array([*roi, roi[0]])
    axes.plot(corners[:, 1], corners[:, 0], "-", color=COLOURS[6])
    return picture


def draw_cases(gray: npt.NDArray[np.uint16], examples: Mapping[int, Sequence[Any]]) -> Figure:
    """Draw up to three examples of each case.

    An example is (keypoints, clusters, decided particles).
    """
    middle = np.sqrt(np.median(gray))
    picture, grid = canvas(len(examples), 3, width_mm=110, height_mm=38 * len(examples))
    for (case, rows), panels in zip(examples.items(), grid, strict=True):
        shown = sorted(rows, key=lambda row: -len(row[2]))[:: max(1, len(rows) // 3)][:3]
        for axes in panels:
            axes.axis("off")
        for axes, (spots, groups, particles) in zip(panels, shown, strict=False):
            where = np.concatenate([spots[:, :2], groups.pixels])
            (y, x) = where.mean(axis=0)
            axes.imshow(np.sqrt(gray), cmap="gray", vmin=0.6 * middle, vmax=256)
            axes.scatter(groups.pixels[:, 1], groups.pixels[:, 0], s=0.8, color=COLOURS[6])
            draw_circles(axes, spots, COLOURS[5])
            for particle in particles:
                axes.plot(particle.col, particle.row, "x", color=COLOURS[1], ms=7)
            half = max(25.0, 1.3 * np.abs(where - (y, x)).max())
            axes.set(xlim=(x - half, x + half), ylim=(y + half, y - half))
            number = f"{len(particles)} particle{'s' * (len(particles) != 1)}"
            axes.set_title(f"case {case}: {number}", fontsize=6.5)
    return picture
