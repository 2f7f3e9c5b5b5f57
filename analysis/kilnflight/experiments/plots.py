"""Plots shared by notebooks."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pandas import DataFrame

from kilnflight.arrays import Array, ArrayLike, Texts, Two
from kilnflight.experiments.flights.campaigns import CampaignKey
from kilnflight.experiments.flights.comparison import Values
from kilnflight.publication.style import (
    BOXES,
    COLOURS,
    HATCHES,
    LINES,
    LOOKS,
    PAGE_MM,
    PUBLISHED,
    PUBLISHED_BAR,
    canvas,
    draw_circles,
)
from kilnflight.scores.flights import MARKS_M

FACES = ("white", "0.85", COLOURS[6], COLOURS[3])
# Scores as they are written.
SYMBOLS = {"alpha": "alpha", "beta": "beta", "jsc": "JSC", "jsc_theta": "JSCθ"}


def draw_grouped_boxes(
    axes: Axes, groups: Mapping[str, Sequence[Array]], labels: Texts
) -> None:
    """Draw box plots in groups: for each label, one box per source of values.

    Outliers are crosses. The number of finite values stands below each box.

    Parameters
    ----------
    axes
        Axes to draw on; the boxes of label i lie around x = i.
    groups
        For each source (at most four), one array of values per label; NaN are left out.
    labels
        Labels of the horizontal axis.
    """
    for k, (name, series) in enumerate(groups.items()):
        place = _beside(k, len(groups), len(series))
        finite = [values[np.isfinite(values)] for values in series]
        box = LOOKS["grouped_box"] | {"facecolor": FACES[k], "hatch": HATCHES[k]}
        axes.boxplot(
            finite,
            positions=place,
            widths=0.68 / len(groups),
            label=name,
            flierprops=LOOKS["crosses"],
            boxprops=box,
            **BOXES,
        )
        for x, values in zip(place, finite, strict=True):
            axes.annotate(
                str(len(values)),
                (x, 0.01),
                xycoords=axes.get_xaxis_transform(),
                **LOOKS["count"],
            )
    end = len(labels) - 0.45
    axes.set(xticks=range(len(labels)), xticklabels=labels, xlim=(-0.55, end))


def _beside(k: int, kinds: int, groups: int) -> Any:
    """Return the places (groups,) of kind ``k`` in groups 1 apart and 0.8 wide."""
    return np.arange(groups) + 0.8 / kinds * (k - (kinds - 1) / 2)


def draw_velocity_boxes(
    sources: Mapping[str, Values], keys: Sequence[CampaignKey]
) -> Figure:
    """Draw box plots of the velocity within each metre, after Figs 5.21 to 5.24.

    Parameters
    ----------
    sources
        Values of the campaigns by their source, such as "true" and "measured".
    keys
        Campaigns, a panel each, two in a row; 0-1 m is at 0 on the horizontal axis.
    """
    rows = -(-len(keys) // 2)
    picture, grid = canvas(
        rows, 2, width_mm=PAGE_MM, height_mm=55 * rows, sharex=True, sharey=True
    )
    metres = [f"{metre - 1}-{metre} m" for metre in MARKS_M]
    for axes, key in zip(grid.flat, keys, strict=False):
        velocities = {
            name: list(values[key].velocity_m_s.T) for name, values in sources.items()
        }
        draw_grouped_boxes(axes, velocities, metres)
        axes.set(title=f"{key[0]}, {key[1]} bar", ylim=(-2, 25))  # numbers below 0
    for axes in grid[:, 0]:
        axes.set_ylabel("velocity in depth (m/s)")
    grid[0, 0].legend()
    return picture


def draw_dwell_boxes(
    sources: Mapping[str, Values], keys: Sequence[CampaignKey]
) -> Figure:
    """Draw box plots of dwell times by fraction, a panel per pressure (Fig. 5.19).

    The band at 4.5 bar is the published range of the medians.

    Parameters
    ----------
    sources
        Values of the campaigns by their source; dwell times of complete flights in s.
    keys
        Campaigns; every fraction needs every pressure.
    """
    names = list(dict.fromkeys(name for name, _ in keys))
    bars = sorted({bar for _, bar in keys})
    picture, grid = canvas(1, len(bars), width_mm=PAGE_MM, height_mm=80, sharey=True)
    for axes, bar in zip(grid[0], bars, strict=True):
        times = {
            source: [values[name, bar].dwell_s for name in names]
            for source, values in sources.items()
        }
        draw_grouped_boxes(axes, times, names)
        axes.set(title=f"{bar} bar", ylim=(-0.1, 1.5))
        if bar == 4.5:
            color = PUBLISHED["color"]
            axes.axhspan(0.3, 0.5, alpha=0.15, color=color, label="published medians")
        if not any(len(each) for series in times.values() for each in series):
            axes.text(0.5, 0.85, "no flight", transform=axes.transAxes, ha="center")
    grid[0, 0].set_ylabel("dwell time (s)")
    entries = grid[0, 0].get_legend_handles_labels()
    picture.legend(*entries, loc="outside upper center", ncols=4)
    return picture


def draw_published(axes: Axes, bounds: DataFrame) -> None:
    """Draw published numbers and bounds beside what is drawn.

    All have the look of `PUBLISHED`. A number (``low`` equals ``high``) is a diamond,
    two bounds are a bar, an open bound (NaN) is an arrow. The vertical axis grows to
    hold them.

    Parameters
    ----------
    axes
        Axes to draw on.
    bounds
        ``at`` (place on the horizontal axis), ``low`` and ``high`` (in units of the
        vertical one).
    """
    bottom, top = axes.get_ylim()
    reach = 0.09 * (top - bottom)
    low = bounds["low"]
    high = bounds["high"]
    start = low.fillna(high - reach)
    end = high.fillna(low + reach)
    axes.vlines(bounds["at"], start, end, **{**PUBLISHED_BAR, "label": None})
    marks = (("D", low == high, low), ("^", high.isna(), end), ("v", low.isna(), start))
    for marker, which, values in marks:
        look = {**PUBLISHED, "marker": marker, "label": None}
        axes.plot(bounds["at"][which], values[which], **look)
    axes.plot([], [], **PUBLISHED)
    highest = max(start.max(), end.max())
    if highest > top:
        top = highest + reach / 2
    axes.set_ylim(bottom, top)


def draw_intervals(axes: Axes, table: DataFrame) -> None:
    """Draw F1 by method with intervals, F1 in pixels above and published F1 below.

    Parameters
    ----------
    axes
        Axes to draw on; the first row of the table is on top.
    table
        Index: names of the methods. ``f1``, ``f1_low``, ``f1_high`` with a scoring
        distance of 45 px, ``f1_in_pixels`` within a particle's pixels (section 5.1.1),
        and ``f1_published`` (NaN if none).
    """
    place = np.arange(len(table))
    f1 = table["f1"]
    reach = table[["f1_low", "f1_high"]].sub(f1, axis=0).abs().to_numpy().T
    distance = "scoring distance 45 px"
    axes.errorbar(f1, place, xerr=reach, fmt="ok", capsize=2, label=distance)
    axes.plot(
        table["f1_in_pixels"],
        place - 0.25,
        "s",
        mfc="none",
        color=COLOURS[2],
        label="in pixels",
    )
    axes.plot(table["f1_published"], place + 0.25, **PUBLISHED)
    axes.set(yticks=place, yticklabels=table.index, xlabel="F1")
    axes.invert_yaxis()
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)


def draw_class_recall(
    recall: DataFrame, by: str, published: Mapping[str, Sequence[Sequence[float]]]
) -> Figure:
    """Draw the recall of each class by subset, after Figs 5.5, 5.6, 5.8 and 5.10.

    A bar needs ten particles: with fewer, a single one would change the recall much.

    Parameters
    ----------
    recall
        ``subset``, ``kind`` (class in words), ``tp``, ``fn``, ``recall`` and the column
        ``by``.
    by
        Column whose values are the panels, such as "method".
    published
        Published recall (classes, subsets) by panel, in the order of its bars.
    """
    few = recall["tp"] + recall["fn"] < 10
    groups = recall.assign(recall=recall["recall"].mask(few)).groupby(by, sort=False)
    picture, (panels,) = canvas(
        1, len(groups), width_mm=PAGE_MM, height_mm=62, sharey=True
    )
    for axes, (name, table) in zip(panels, groups, strict=True):
        kinds = table["kind"].unique()
        bars = table.pivot(index="subset", columns="kind", values="recall")
        printed = published.get(str(name))
        for k, kind in enumerate(kinds):
            place = _beside(k, len(kinds), len(bars))
            axes.bar(
                place,
                bars[kind],
                0.736 / len(kinds),
                label=kind,
                color=COLOURS[k + 2],
                hatch=HATCHES[k],
            )
            if printed:
                axes.plot(place, printed[k], clip_on=False, **PUBLISHED)
        axes.set(title=name, xlabel="subset")
        axes.set_xticks(range(len(bars)), bars.index)
    panels[0].set_ylabel("recall")
    handles, labels = panels[0].get_legend_handles_labels()
    known = dict(zip(labels, handles, strict=True))  # published is in each class
    picture.legend(known.values(), known, loc="outside upper center", ncols=4)
    return picture


def draw_keypoints(axes: Axes, keypoints: Array, roi: Sequence[Two]) -> None:
    """Draw keypoints as circles, and the outline of the region of interest (Fig. 5.3).

    ``keypoints`` (k, 3) are row, col and radius in px, ``roi`` the corners (row, col).
    """
    draw_circles(axes, keypoints, COLOURS[5])
    corners = np.array([*roi, roi[0]])
    axes.plot(corners[:, 1], corners[:, 0], "-", color=COLOURS[6])


def draw_cloud(wall: DataFrame, particles: DataFrame, marked: DataFrame) -> Figure:
    """Draw a point cloud in space, and one particle of it enlarged (Fig. 2.12).

    Parameters
    ----------
    wall
        ``x``, ``y``, ``z`` in mm and ``gray`` of the points that show no particle.
    particles
        Points of the particles, likewise.
    marked
        Points of the particle that is circled and enlarged, likewise.
    """
    axis = ["x", "y", "z"]
    picture = plt.figure(figsize=(PAGE_MM / 25.4, 85 / 25.4), layout="none")
    plt.close(picture)
    room: Any = picture.add_axes((-0.05, 0.03, 0.6, 0.97), projection="3d")
    scatter = partial(room.scatter, depthshade=False)
    gray = np.sqrt(wall["gray"])
    bright = 1.25 * gray.quantile(0.99)  # white points would vanish on paper
    scatter(*upright(wall[axis]), s=0.8, lw=0, c=gray, cmap="gray", vmin=0, vmax=bright)
    scatter(*upright(particles[axis]), s=1.2, lw=0, color=COLOURS[2])
    scatter(*upright(marked[axis].mean()), s=160, lw=1.4, ec=COLOURS[1], fc="none")
    label_camera_space(room)
    room.set_box_aspect((1.9, 1, 1), zoom=1.15)
    room.view_init(elev=18, azim=-60)
    axes = picture.add_axes((0.73, 0.2, 0.24, 0.64))
    beside = marked[["x", "y"]] - marked[["x", "y"]].mean()  # short labels
    depth = marked["z"] / 1000
    dots = axes.scatter(beside["x"], beside["y"], c=depth, s=9, cmap="viridis")
    axes.set(xlabel="x from its middle (mm)", ylabel="up, y from its middle (mm)")
    axes.set(aspect="equal", title="the marked particle")
    axes.locator_params(nbins=4)
    picture.colorbar(dots, label="depth z (m)", location="bottom", pad=0.25)
    return picture


def draw_k_distances(curves: DataFrame, eps_mm: Sequence[float]) -> Figure:
    """Draw sorted k-distances of a cloud, with values of eps in mm (Fig. 2.19).

    ``curves`` has ``point``, a rank, and a column ``distance_k_mm`` for each k.
    """
    picture, ((axes,),) = canvas(height_mm=75)
    for name, line in zip(curves.columns[1:], LINES, strict=False):
        k = name.split("_")[1]
        axes.loglog(curves["point"], curves[name], ls=line, label=f"k = {k}")
    for value in eps_mm:
        axes.axhline(value, color="0.7", lw=0.5, ls="-")
        axes.annotate(f"eps {value} mm", (1, value), fontsize=6, va="bottom")
    axes.set(xlabel="points, sorted", ylabel="distance to neighbour k (mm)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")  # the default takes mathematical notation
    axes.legend()
    return picture


def broken_at_gaps(tracks: DataFrame) -> DataFrame:
    """Add an empty row to tracks in every gap, so that lines break there.

    Input and result have ``particle``, ``frame``, ``row`` and ``col`` (px); row and col
    of the extra rows are NaN.
    """
    order = ["particle", "frame"]
    places = tracks[[*order, "row", "col"]].sort_values(order)
    behind = places[places.groupby("particle")["frame"].diff() > 1]
    empty = behind.assign(frame=behind["frame"] - 1, row=np.nan, col=np.nan)
    return pd.concat([places, empty]).sort_values(order, ignore_index=True)


def upright(places_mm: ArrayLike) -> Array:
    """Return depth z, across x and up y in m, (3, n), of camera places (n, 3) in mm.

    Pictures in space draw depth along their first axis. The y of the camera points up,
    although rows count down.
    """
    x, y, z = np.asarray(places_mm, float).reshape(-1, 3).T / 1000.0
    return np.stack([z, x, y])


def label_camera_space(axes: Any) -> None:
    """Label 3D axes with `upright` places, and invert the second: call it once."""
    axes.invert_yaxis()  # otherwise left and right are swapped
    label_3d(axes, "depth z (m)", "x (m)", "up, y (m)")


def label_3d(axes: Any, x: str, y: str, z: str) -> None:
    """Label x, y, z of a 3D plot, near their axes, with about 4 ticks each."""
    axes.set(xlabel=x, ylabel=y, zlabel=z)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.labelpad = -3
    axes.tick_params(pad=-2)
    axes.locator_params(nbins=4)


def label_pixels(axes: Axes) -> None:
    """Label axes in px of the camera, and let rows count downwards: call it once."""
    axes.set(xlabel="column (px)", ylabel="row (px)")
    axes.invert_yaxis()


def draw_places(axes: Axes, places: ArrayLike, look: str, **line: Any) -> None:
    """Draw places (n, 2), row and col in px, with a format such as "ow" or "k-"."""
    row, col = np.asarray(places).T
    axes.plot(col, row, look, mec="black", mew=0.6, **line)
