"""Pictures of the belt: deviations, and Figs 4 and 5 of the 2020 paper.

Fig. 4 sketches eight nozzles: the right valve at the right time, a wrong valve, a wrong time. Fig.
5 sketches how the reference is made: a straight line between the last observation before the edge
and the first one after it. Both are drawn here from tracks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator

from kilnflight.belt.evaluation import predictions
from kilnflight.belt.models import BELT_WIDTH_MM
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.checks import InputError
from kilnflight.project.style import COLOURS, MARKERS, PAGE_MM, canvas, draw_boxes

NOZZLES = 8  # Fig. 4
PITCH_MM = BELT_WIDTH_MM / NOZZLES  # the belt's width, section 3
OPEN_MS = 4.0  # a sphere of 5 mm passes in 3.5 ms at 1.4 m/s; our choice
PANELS = {"optimal": "right valve and time", "Straight": "wrong valve", "CV-CV": "wrong time"}


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


def decisions(
    observed: Mapping[str, Observed], phase: PredictionPhase, seed: int
) -> tuple[str, pd.DataFrame]:
    """Return valve decisions for one particle: optimal, by Straight and by CV-CV (Fig. 4).

    The particle is the first whose valve Straight gets wrong and CV-CV right, in the first data
    set that has one. Straight has no time of its own (section 4.2) and is given the true one, as
    in Fig. 4b.

    Returns
    -------
    data_set : str
        Of the particle.
    table : DataFrame
        Index: the keys of `PANELS`. ``nozzle`` from 0, ``y_mm``, and ``opens_ms`` and
        ``closes_ms`` after the particle's true arrival.

    Raises
    ------
    InputError
        If there is no such particle.
    """
    for data_set, particles in observed.items():
        table = _decisions(particles, phase, seed)
        if table is not None:
            return data_set, table
    raise InputError("no particle for which Straight takes a wrong valve; use more particles.")


def _decisions(observed: Observed, phase: PredictionPhase, seed: int) -> pd.DataFrame | None:
    """Return the decisions for the first such particle of a data set; None: there is none."""
    count = len(observed.last)
    drawn = np.random.default_rng(seed).permutation(count)[: max(1, count // 100)]
    calibration = np.isin(np.arange(count), drawn)
    arrival = observed.arrival[~calibration]
    told = {name: (t, y) for name, t, y in predictions(observed, phase, calibration)}
    told["optimal"] = arrival["time_s"].to_numpy(), arrival["y"].to_numpy()
    told["Straight"] = told["optimal"][0], told["Straight"][1]
    nozzle = {name: np.floor(told[name][1] / PITCH_MM) for name in PANELS}
    wrong = (nozzle["Straight"] != nozzle["optimal"]) & (nozzle["CV-CV"] == nozzle["optimal"])
    if not wrong.any():
        return None
    one = int(np.argmax(wrong))
    rows = [(name, nozzle[name][one], *(values[one] for values in told[name])) for name in PANELS]
    table = pd.DataFrame(rows, columns=["decision", "nozzle", "time_s", "y_mm"])
    table = table.set_index("decision").astype({"nozzle": int})
    late = 1000.0 * (table["time_s"] - table["time_s"]["optimal"])
    table = table.assign(opens_ms=late - OPEN_MS / 2, closes_ms=late + OPEN_MS / 2)
    return table.drop(columns="time_s")


def draw_decisions(table: pd.DataFrame) -> Figure:
    """Draw the nozzles over time, the particle, and what each decision opens (Fig. 4)."""
    picture, (panels,) = canvas(1, len(PANELS), width_mm=PAGE_MM, height_mm=60, sharey=True)
    near, last = PITCH_MM * table["nozzle"], float(table["closes_ms"].max()) + 3
    borders, seen = PITCH_MM * np.arange(NOZZLES + 1), float(table["y_mm"]["optimal"])
    for axes, (name, title) in zip(panels, PANELS.items(), strict=True):
        corner = float(table["opens_ms"][name]), float(near[name])
        colour, hatch = (COLOURS[2], "") if name == "optimal" else (COLOURS[1], "///")
        box = Rectangle(corner, OPEN_MS, PITCH_MM, facecolor=colour, hatch=hatch, alpha=0.5)
        axes.add_patch(box)
        axes.hlines(borders, -6, last, "0.7", lw=0.5)
        axes.plot(0.0, seen, "o", color="0.1", ms=5)
        axes.set(title=f"{title} ({name})", xlabel="time after the arrival (ms)")
        axes.set(xlim=(-6, last), ylim=(near.min() - PITCH_MM, near.max() + 2 * PITCH_MM))
    panels[0].set_ylabel("y across the belt (mm)")
    return picture


def crossing(track: pd.DataFrame, target_mm: float) -> pd.DataFrame:
    """Return the observations around the target and the crossing between them (Fig. 5).

    Parameters
    ----------
    track
        Of one particle: ``x``, ``y`` (mm), ``time_s``, ascending in time.

    Returns
    -------
    DataFrame
        Index: ``before``, ``crossing``, ``after``; ``x_mm``, ``y_mm``, ``time_ms``.

    Raises
    ------
    InputError
        If the particle is not seen on both sides of the target.
    """
    after = int((track["x"] < target_mm).sum())
    if not 0 < after < len(track):
        raise InputError(f"the particle is not seen on both sides of {target_mm:g} mm.")
    ends = track[["x", "y", "time_s"]].to_numpy(np.float64)[after - 1 : after + 1]
    share = (target_mm - ends[0, 0]) / (ends[1, 0] - ends[0, 0])
    rows = np.stack([ends[0], ends[0] + share * (ends[1] - ends[0]), ends[1]]) * [1, 1, 1000]
    names = pd.Index(["before", "crossing", "after"], name="point")
    return pd.DataFrame(rows, names, ["x_mm", "y_mm", "time_ms"])


def draw_crossing(points: pd.DataFrame, target_mm: float) -> Figure:
    """Draw both observations, the line between them and the crossing."""
    picture, ((axes,),) = canvas(width_mm=PAGE_MM / 2, height_mm=60)
    axes.axvline(0, color="0.5", lw=1.0, ls="--", label="target")
    along = points["x_mm"] - target_mm
    across = 1000.0 * (points["y_mm"] - points["y_mm"].iloc[0])
    passed = points["time_ms"] - points["time_ms"].iloc[0]
    axes.plot(along, across, "-", color="0.4")
    looks = {"before": ("o", "0.6"), "after": ("o", "0.1"), "crossing": ("x", COLOURS[1])}
    for name, (mark, colour) in looks.items():
        text = f"{name}, {passed[name]:.2f} ms"
        axes.plot(along[name], across[name], mark, color=colour, ms=7, label=text, ls="none")
    axes.set(xlabel="x from the target (mm)", ylabel="y from the first position (µm)")
    axes.legend()
    return picture
