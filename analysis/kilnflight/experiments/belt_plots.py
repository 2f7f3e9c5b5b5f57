"""Pictures of deviations on the belt that several notebooks draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from kilnflight.project.style import MARKERS, PAGE_MM, canvas, draw_boxes


def boxes(
    summaries: pd.DataFrame,
    names: tuple[str, str, str],
    labels: Mapping[str, str],
    height_mm: float,
    rotation: float = 0.0,
    **panel: Any,
) -> Figure:
    """Draw box plots of deviations, a panel for each row and column.

    Parameters
    ----------
    summaries
        A row for each box, with the columns that `style.draw_boxes` takes.
    names
        Columns of the table that tell the rows of panels, their columns, and the boxes.
    labels
        Of the vertical axes by row of panels.
    height_mm
        Of the picture.
    rotation
        Of the boxes' names.
    panel
        Further properties of all axes.
    """
    rows, columns, models = (summaries[name] for name in names)
    picture, grid = canvas(len(labels), columns.nunique(), width_mm=PAGE_MM, height_mm=height_mm)
    for panels, (row, label) in zip(grid, labels.items(), strict=True):
        for axes, column in zip(panels, columns.unique(), strict=True):
            chosen = (rows == row) & (columns == column)
            axes.axhline(0, color="0.6", lw=0.6, ls="-")
            draw_boxes(axes, summaries[chosen])
            axes.set_xticks(range(chosen.sum()), models[chosen], rotation=rotation)
            axes.set(title=column, ylabel=label, **panel)
    return picture


def boxes_by_source(summaries: pd.DataFrame, label: str, height_mm: float) -> Figure:
    """Draw `boxes` of deviations on the belt: rows are sources, columns data sets.

    Parameters
    ----------
    summaries
        ``source``, ``data_set``, ``model`` and the columns that `style.draw_boxes` takes.
    label
        Of the vertical axes, below the source.
    height_mm
        Of a row.
    """
    labels = {source: f"{source}\n{label}" for source in summaries["source"].unique()}
    rotation = 60 if summaries["model"].nunique() > 5 else 0
    names = ("source", "data_set", "model")
    picture = boxes(summaries, names, labels, height_mm * len(labels), rotation)
    for k, axes in enumerate(picture.axes):
        axes.set_ylabel("" if k % summaries["data_set"].nunique() else axes.get_ylabel())
    return picture


def lines_by_rate(by_rate: pd.DataFrame, models: Sequence[str], measure: str, label: str) -> Figure:
    """Draw deviations over the sampling rate: a panel per data set, a line per model.

    Parameters
    ----------
    by_rate
        From `vary_rate`.
    models
        Which are drawn.
    measure, label
        Column of the vertical axes, and their label.
    """
    sets = by_rate["data_set"].unique()
    picture, (panels,) = canvas(1, len(sets), width_mm=PAGE_MM, height_mm=55)
    for axes, data_set in zip(panels, sets, strict=True):
        table = by_rate[by_rate["data_set"] == data_set]
        wide = table.pivot(index="sampling_hz", columns="model", values=measure)
        for name, mark in zip(models, MARKERS, strict=False):
            axes.plot(wide[name], marker=mark, label=name)
        axes.set(title=data_set, xlabel="sampling rate (Hz)", xscale="log", yscale="log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.yaxis.set(major_locator=LogLocator(subs=(1, 2, 5)), major_formatter="{x:g}")
        axes.minorticks_off()
    panels[0].set_ylabel(label)
    picture.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=7)
    return picture
