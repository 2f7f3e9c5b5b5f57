"""Pictures of tracks in windows, after Figs 4.13 to 4.21 and 5.12 to 5.15."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.figure import Figure

from kilnflight.experiments.tracking import Window
from kilnflight.project.style import PAGE_MM, canvas, frame, tracks
from kilnflight.tracklets import tracked

Tables = Mapping[str, Mapping[str, pd.DataFrame]]  # fraction -> name -> tracks


def trajectories(windows: Sequence[Window], tables: Tables) -> Figure:
    """Return tracks on the sum of frame differences: windows (columns) by name (rows)."""
    rows = len(next(iter(tables.values())))
    picture, grid = canvas(rows, len(windows), width_mm=130, height_mm=40 * rows)
    for window, column in zip(windows, grid.T, strict=True):
        height, width = window.differences.shape
        first, last = window.frames.start, window.frames.stop - 1
        light = window.differences(first, last, 0, 0, height, width)
        for axes, (name, table) in zip(column, tables[window.fraction].items(), strict=True):
            frame(axes, light, 8)
            tracks(axes, tracked(table))
            axes.set(title=f"{window.fraction}: {name}", ylabel="row (px)", xlabel="")
        column[-1].set_xlabel("column (px)")
    return picture


def steps(windows: Sequence[Window], tables: Tables) -> Figure:
    """Return tracks after each step of the post-processing, and the true ones below."""
    rows = 1 + len(next(iter(tables.values())))
    picture, grid = canvas(rows, len(windows), width_mm=PAGE_MM, height_mm=250)
    for window, column in zip(windows, grid.T, strict=True):
        shown = {**tables[window.fraction], "truth": window.truth}
        low, high = (window.truth[["row", "col"]].agg(edge) for edge in ("min", "max"))
        for axes, (name, table) in zip(column, shown.items(), strict=True):
            tracks(axes, tracked(table))
            axes.set(title=f"{window.fraction}: {name}", ylabel="row (px)")
            axes.set(xlim=(low["col"] - 80, high["col"] + 80))
            axes.set(ylim=(high["row"] + 80, low["row"] - 80))
        column[-1].set_xlabel("column (px)")
    return picture


def textures(images: Sequence[npt.NDArray[np.float64]]) -> Figure:
    """Return windows of summed differences side by side, lettered, equally bright."""
    picture, (panels,) = canvas(1, len(images), width_mm=PAGE_MM, height_mm=62)
    lightest = np.sqrt(np.max(images[:-1]))
    for axes, image, name in zip(panels, images, "abcdefgh", strict=False):
        axes.imshow(np.sqrt(image), cmap="gray", vmin=0, vmax=lightest)
        axes.set(title=f"({name})", xlabel="column (px)")
    panels[0].set_ylabel("row (px)")
    return picture


def joined(tables: Tables, column: str) -> pd.DataFrame:
    """Return all tracks in one table, with ``fraction`` and the name in a column."""
    parts = [
        table.assign(fraction=fraction, **{column: name})
        for fraction, group in tables.items()
        for name, table in group.items()
    ]
    table = tracked(pd.concat(parts, ignore_index=True))
    return table[["fraction", column, "particle", "frame", "row", "col"]]
