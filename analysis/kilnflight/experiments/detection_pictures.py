"""Pictures of the detection experiment, after Figs 2.19, 3.10, 3.11 and 5.5 to 5.10."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import norm

from kilnflight.detection import wall as cylinder
from kilnflight.experiments.plots import bars
from kilnflight.project.style import COLOURS, LINES, PAGE_MM, canvas

Array = npt.NDArray[np.float64]
HERE, PUBLISHED = ("o", "k"), ("D", COLOURS[1])


def k_distances(curves: pd.DataFrame, eps: Sequence[float]) -> Figure:
    """Return sorted k-distance curves: ``point``, and ``distance_<k>_mm`` for each k."""
    picture, ((axes,),) = canvas()
    for name, line in zip(curves.columns[1:], LINES, strict=False):
        axes.plot(curves["point"], curves[name], ls=line, label=f"k = {name.split('_')[1]}")
    for value in eps:
        axes.axhline(value, color="0.7", lw=0.5, ls="-")
        axes.annotate(f"{value}", (1, value), fontsize=6, va="bottom")
    axes.set(xscale="log", yscale="log", xlabel="points, sorted")
    axes.set_ylabel("distance to neighbour k (mm)")
    axes.legend()
    return picture


def precision_recall(
    tables: Mapping[str, pd.DataFrame],
    published: Mapping[str, pd.DataFrame],
    parameters: Mapping[str, Sequence[str]],
) -> Figure:
    """Return precision over recall of clusterers, ours and published, by family.

    Parameters
    ----------
    tables, published
        ``precision``, ``recall`` and the parameters, one row per setting, by family.
    parameters
        Columns by family; lines join settings with the same value of the last.
    """
    beside: dict[str, Any] = {"textcoords": "offset points", "fontsize": 5, "ha": "right"}
    picture, (panels,) = canvas(1, len(tables), width_mm=PAGE_MM, height_mm=62, sharey=True)
    for axes, (name, ours) in zip(panels, tables.items(), strict=True):
        kinds = {"here": (ours, HERE), "published": (published[name], PUBLISHED)}
        for label, (table, (mark, colour)) in kinds.items():
            look = {"color": colour, "mfc": "none", "label": label}
            axes.plot(table["recall"], table["precision"], mark, **look)
        last = parameters[name][-1]
        for value, one in ours.groupby(last):
            axes.plot(one["recall"], one["precision"], "-", color="0.6", lw=0.6, zorder=1)
            end = (one["recall"].min(), one["precision"].max())
            axes.annotate(f"{value:g}", end, (-4, 0), va="center", **beside)
        axes.set(title=f"{name}, number: {last}", xlabel="recall", xlim=(0, 1))
    panels[0].set(ylabel="precision", ylim=(0, 1))
    panels[0].legend(loc="upper left")
    return picture


def class_recall(recall: pd.DataFrame, by: str, published: Sequence[float] = ()) -> Figure:
    """Return the recall of each class by subset, a panel for each value of a column.

    Parameters
    ----------
    recall
        ``subset``, ``kind``, ``recall`` and the column.
    by
        The column.
    published
        Recall of non-burning particles by subset, drawn in the first panel.
    """
    groups = recall.groupby(by, sort=False)
    picture, (panels,) = canvas(1, len(groups), width_mm=PAGE_MM, height_mm=62, sharey=True)
    for axes, (name, one) in zip(panels, groups, strict=True):
        bars(axes, one, "subset", "kind", "recall")
        axes.set_title(name)
    if len(published):
        look = {"color": "black", "ms": 3, "label": "published, non-burning"}
        panels[0].plot(published, "D", **look)
    panels[0].set_ylabel("recall")
    picture.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return picture


def fitted_wall(points: Array, fit: cylinder.Cylinder) -> Figure:
    """Return the wall's points (n, 3) in mm along the fitted axis, and their distance to it."""
    picture, (panels,) = canvas(1, 2, width_mm=PAGE_MM, height_mm=75)
    panels[0].plot(points[:, 0], points[:, 1], ",", color="black")
    distance = cylinder.distance_to_axis(points, fit)
    panels[1].plot(points[:, 2] / 1000, distance, ",", color="black")
    around = np.linspace(0, 2 * np.pi, 200)
    reach = (points[:, 2].mean() - fit.centre_mm[2]) / fit.direction[2]
    middle = np.array(fit.centre_mm) + reach * np.array(fit.direction)
    ring = middle[:2, None] + fit.radius_mm * np.array([np.cos(around), np.sin(around)])
    panels[0].plot(*ring, "-", color=COLOURS[1], label=f"fit, {fit.radius_mm:.0f} mm")
    panels[0].set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    panels[0].legend(loc="upper right")
    levels = {"fit": (fit.radius_mm, "-"), "true": (700.0, ":"), "published": (772.2, "--")}
    for text, (level, line) in levels.items():
        panels[1].axhline(level, color=COLOURS[1], ls=line, label=f"{text}, {level:.0f} mm")
    panels[1].set(xlabel="z (m)", ylabel="distance from the axis (mm)", ylim=(300, 1100))
    panels[1].legend(loc="lower left")
    return picture


def axis_distances(
    air_mm: pd.Series, wall_mm: pd.Series, thresholds: Mapping[str, float]
) -> Figure:
    """Return histograms of distances from the axis, their Gaussians, and thresholds."""
    picture, ((axes,),) = canvas(width_mm=120, height_mm=65)
    bins, shown = np.arange(0, 1201, 25), np.linspace(0, 1200, 400)
    kinds = {"in the air": (air_mm, COLOURS[2], "-"), "on the wall": (wall_mm, COLOURS[1], "--")}
    for name, (values, colour, line) in kinds.items():
        axes.hist(values, bins, color=colour, alpha=0.35, density=True, label=name)
        axes.plot(shown, norm.pdf(shown, values.mean(), values.std()), ls=line, color=colour)
    for level in thresholds.values():
        axes.axvline(level, color="black", lw=0.8, ls=":")
        top = (level, axes.get_ylim()[1])
        axes.annotate(f"{level:.0f}", top, fontsize=6, rotation=90, va="top")
    axes.set(xlabel="distance from the fitted axis (mm)", ylabel="density (1/mm)")
    axes.legend(loc="upper left")
    return picture
