"""Plots shared by notebooks: boxes, bars, intervals, printed marks, tracks, pictures in
space.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kilnflight.arrays import Array
from kilnflight.detection.combination import Clusters
from kilnflight.experiments.flights.campaigns import CampaignKey, of_campaign
from kilnflight.experiments.flights.comparison import Values
from kilnflight.publication.style import (
    BOXES,
    COLOURS,
    HATCHES,
    PAGE_MM,
    PUBLISHED,
    PUBLISHED_BAR,
    canvas,
    draw_circles,
    draw_frame,
)
from kilnflight.scores.flights import MARKS_M

FACES = ("white", "0.85", COLOURS[6], COLOURS[3])
SYMBOLS = {
    "alpha": "alpha",
    "beta": "beta",
    "jsc": "JSC",
    "jsc_theta": "JSCθ",
}  # of scores


def draw_grouped_boxes(
    axes: Axes, groups: Mapping[str, Sequence[Array]], labels: Sequence[str]
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
    width = 0.8 / len(groups)
    below: dict[str, Any] = {"xycoords": axes.get_xaxis_transform(), "va": "bottom"}
    below |= {"ha": "center", "fontsize": 5.5, "color": "0.3"}
    for k, (name, series) in enumerate(groups.items()):
        place = np.arange(len(series)) + width * (k - (len(groups) - 1) / 2)
        finite = [values[np.isfinite(values)] for values in series]
        face = {
            "facecolor": FACES[k],
            "hatch": HATCHES[k],
            "edgecolor": "black",
            "linewidth": 0.6,
        }
        options = {
            "widths": 0.85 * width,
            "boxprops": {**face, "linestyle": "-"},
            **BOXES,
        }
        crosses = {"marker": "+", "markersize": 3, "markeredgewidth": 0.5}
        drawn = axes.boxplot(finite, positions=place, flierprops=crosses, **options)
        drawn["boxes"][0].set_label(name)
        for x, values in zip(place, finite, strict=True):
            axes.annotate(str(len(values)), (float(x), 0.01), **below)
    axes.set(
        xticks=range(len(labels)), xticklabels=labels, xlim=(-0.55, len(labels) - 0.45)
    )


def draw_velocity_boxes(
    sources: Mapping[str, Values],
    keys: Sequence[CampaignKey],
    bounds: pd.DataFrame | None = None,
) -> Figure:
    """Draw box plots of the velocity within each metre, after Figs 5.21 to 5.24.

    Parameters
    ----------
    sources
        Values of the campaigns by their source, such as "true" and "measured".
    keys
        Campaigns, a panel each, two in a row.
    bounds
        Published bounds in m/s: ``fraction``, ``pressure_bar``, ``outcome`` ("velocity
        0-1 m (m/s)" ...), ``low``, ``high``; None: not drawn.
    """
    rows = max(-(-len(keys) // 2), 1)
    size: dict[str, Any] = {"width_mm": PAGE_MM, "height_mm": 55 * rows}
    picture, grid = canvas(rows, 2, **size, sharex=True, sharey=True)
    metres = [f"{metre - 1}-{metre} m" for metre in MARKS_M]
    for axes, key in zip(grid.flat, keys, strict=False):
        groups = {
            name: list(values[key].velocity_m_s.T) for name, values in sources.items()
        }
        draw_grouped_boxes(axes, groups, metres)
        axes.set(title=f"{key[0]}, {key[1]} bar", ylim=(-2, 25))  # numbers below 0
        if bounds is not None:
            # the first metre, 0-1 m, is label 0
            at = bounds["outcome"].str.extract(r"velocity (\d)")[0].astype(float)
            draw_published(
                axes, of_campaign(bounds.assign(at=at).dropna(subset="at"), key)
            )
    for axes in grid[:, 0]:
        axes.set_ylabel("velocity in depth (m/s)")
    grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels())
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
        groups = {
            source: [values[name, bar].dwell_s for name in names]
            for source, values in sources.items()
        }
        draw_grouped_boxes(axes, groups, names)
        if bar == 4.5:
            axes.axhspan(
                0.3,
                0.5,
                color=PUBLISHED["color"],
                alpha=0.15,
                label="published medians",
            )
        axes.set(title=f"{bar} bar", ylim=(-0.1, 1.5))
        if not sum(len(each) for group in groups.values() for each in group):
            axes.text(0.5, 0.85, "no flight", transform=axes.transAxes, ha="center")
    grid[0, 0].set_ylabel("dwell time (s)")
    picture.legend(
        *grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4
    )
    return picture


def draw_published(axes: Axes, bounds: pd.DataFrame) -> None:
    """Draw published numbers and bounds beside what is drawn.

    All have the look of `PUBLISHED`. A number (``low`` equals ``high``) is a diamond,
    two bounds are a bar, an open bound (NaN) is an arrow. The vertical axis grows to
    hold them. ``bounds`` has ``at`` (place on the horizontal axis), ``low`` and
    ``high`` (in units of the vertical one).
    """
    bottom, top = axes.get_ylim()
    low = bounds["low"]
    high = bounds["high"]
    at = bounds["at"]
    reach = 0.09 * (top - bottom)
    ends = low.fillna(high - reach), high.fillna(low + reach)
    axes.vlines(at, *ends, **{**PUBLISHED_BAR, "label": None})
    for mark, places, values in (
        ("D", low == high, low),
        ("^", high.isna(), ends[1]),
        ("v", low.isna(), ends[0]),
    ):
        axes.plot(
            at[places], values[places], **{**PUBLISHED, "marker": mark, "label": None}
        )
    axes.plot([], [], **PUBLISHED)
    highest = pd.concat(ends).max()
    axes.set_ylim(bottom, top if not highest > top else highest + reach / 2)


def draw_bars(
    axes: Axes, table: pd.DataFrame, along: str, kind: str, value: str
) -> None:
    """Draw grouped bars; bars of one kind share colour and hatch.

    Parameters
    ----------
    axes
        Axes to draw on; group i is at x = i.
    table
        One row per bar; each pair of group and kind occurs once.
    along, kind, value
        Columns with the group, the kind and the height of a bar.
    """
    groups = list(table[along].unique())
    kinds = list(table[kind].unique())
    width = 0.8 / len(kinds)
    wide = table.pivot(index=along, columns=kind, values=value).loc[groups]
    for k, name in enumerate(kinds):
        place = np.arange(len(groups)) + width * (k - (len(kinds) - 1) / 2)
        look: dict[str, Any] = {"label": str(name), "hatch": HATCHES[k % len(HATCHES)]}
        axes.bar(
            place,
            wide[name],
            0.92 * width,
            color=COLOURS[(k + 1) % len(COLOURS)],
            **look,
        )
    axes.set(xticks=range(len(groups)), xticklabels=groups, xlabel=along)


def draw_intervals(
    axes: Axes, table: pd.DataFrame, published_f1: str, f1_in_pixels: str
) -> None:
    """Draw F1 by method with intervals, beside F1 in pixels and the published F1.

    Parameters
    ----------
    axes
        Axes to draw on; the first row of the table is on top.
    table
        Index: names of the methods; ``f1``, ``f1_low``, ``f1_high`` with a scoring
        distance of 45 px, and the columns named by the next two arguments.
    published_f1, f1_in_pixels
        Names of the columns with the published F1 (NaN if none) and with F1 within a
        particle's pixels (section 5.1.1).
    """
    place = np.arange(len(table))
    label = "scoring distance 45 px"
    reach = np.abs(table[["f1_low", "f1_high"]].to_numpy().T - table["f1"].to_numpy())
    axes.errorbar(
        table["f1"], place, xerr=reach, fmt="o", color="black", capsize=2, label=label
    )
    axes.plot(
        table[f1_in_pixels], place, "s", mfc="none", color=COLOURS[2], label="in pixels"
    )
    axes.plot(table[published_f1], place, **PUBLISHED)
    axes.set(yticks=place, yticklabels=table.index, xlabel="F1")
    axes.invert_yaxis()
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)


def draw_class_recall(
    recall: pd.DataFrame, by: str, published: Mapping[str, Sequence[Sequence[float]]]
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
        draw_bars(axes, table, "subset", "kind", "recall")
        axes.set_title(str(name))
        for bars, values in zip(
            axes.containers, published.get(str(name), ()), strict=False
        ):
            at = [bar.get_x() + bar.get_width() / 2 for bar in bars]
            axes.plot(at, values, clip_on=False, **PUBLISHED)
    panels[0].set_ylabel("recall")
    handles, labels = panels[0].get_legend_handles_labels()
    known = dict(zip(labels, handles, strict=True))
    picture.legend(
        list(known.values()), list(known), loc="outside upper center", ncols=4
    )
    return picture


def draw_keypoints_and_clusters(
    gray: npt.NDArray[np.uint16],
    keypoints: Array,
    clusters: Clusters | None,
    roi: Sequence[tuple[float, float]],
    **size: Any,
) -> Figure:
    """Draw a frame with keypoints as circles and the clusters' pixels as dots.

    Fig. 5.3 shows the keypoints alone, Figs 3.1 and 3.2 both.

    Parameters
    ----------
    gray
        (rows, cols) grey values of the frame. Averages over 2 x 2 px are shown; over 4
        x 4 px behind clusters.
    keypoints
        (k, 3) row, col and radius in px.
    clusters
        Each pixel of a cluster is a dot; six colours in turn tell clusters apart. None:
        not drawn.
    roi
        Corners (row, col) of the region of interest in px, in order around it.
    **size
        ``width_mm`` and ``height_mm`` of the figure, for `canvas`.
    """
    picture, ((axes,),) = canvas(**size)
    draw_frame(axes, gray, 4 if clusters is not None else 2)
    if clusters is not None:
        spread = np.repeat(
            np.arange(len(clusters.start) - 1) % 6 + 1, np.diff(clusters.start)
        )
        axes.scatter(*clusters.pixels.T[::-1], s=0.1, c=[COLOURS[k] for k in spread])
    draw_circles(axes, keypoints, COLOURS[5])
    corners = np.array([*roi, roi[0]])
    axes.plot(corners[:, 1], corners[:, 0], "-", color=COLOURS[6])
    return picture


def broken_at_gaps(tracks: pd.DataFrame) -> pd.DataFrame:
    """Return tracks with an extra row in every gap, so that lines break there.

    Input and result have ``particle``, ``frame``, ``row`` and ``col`` (px); row and col
    of the extra rows are NaN.
    """
    places = tracks[["particle", "frame", "row", "col"]].sort_values(
        ["particle", "frame"]
    )
    behind = places[places.groupby("particle")["frame"].diff() > 1]
    empty = behind.assign(frame=behind["frame"] - 1, row=np.nan, col=np.nan)
    return pd.concat([places, empty]).sort_values(
        ["particle", "frame"], ignore_index=True
    )


def upright(places_mm: npt.ArrayLike) -> Array:
    """Return depth z, across x and up y in m, (3, n), of camera places (n, 3) in mm.

    Pictures in space draw depth along their first axis. The y of the camera points up,
    although rows count down.
    """
    x, y, z = np.asarray(places_mm, dtype=np.float64).reshape(-1, 3).T / 1000.0
    return np.stack([z, x, y])


def label_camera_space(axes: Any) -> None:
    """Label 3D axes with `upright` places, and invert the second: call it once."""
    axes.invert_yaxis()  # otherwise left and right are swapped
    label_space(axes, ("depth z (m)", "x (m)", "up, y (m)"), (-2, -4, -1), -2)


def label_space(
    axes: Any, labels: Sequence[str], pads: Sequence[int], ticks: int
) -> None:
    """Label three axes; ``pads`` and ``ticks`` shift labels and ticks (points)."""
    for axis, label, pad in zip("xyz", labels, pads, strict=True):
        axes.set(**{f"{axis}label": label})
        getattr(axes, f"{axis}axis").labelpad = pad
    axes.tick_params(pad=ticks)
    axes.locator_params(nbins=4)
