"""Worked examples on small hand-made cases: assignment, outliers, joined tracklets.

Figs 3.13, 4.5 to 4.7, 4.9 and 4.10 of the thesis. Its sketches have no scales; these cases have
the same make, and the functions that measure the recordings decide them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from scipy.spatial.distance import cdist

from kilnflight import tracklets
from kilnflight.project.style import COLOURS, PAGE_MM, canvas
from kilnflight.scores.detections import FrameScore, score_detections
from kilnflight.tracklets.joining import connected_parts, overlap_in_time
from kilnflight.tracklets.paths import read_paths, turns, velocities

Array = npt.NDArray[np.float64]
GREEN, RED, BLUE = COLOURS[4], COLOURS[1], COLOURS[2]

# Detections d1 to d5 and particles p1 to p5, row and col in px: d4 is alone, and so is p3. The
# nearest detection of p2 is d1, which p1 needs.
DETECTED = np.array([[40.0, 60], [90, 70], [45, 210], [150, 150], [140, 250]])
PARTICLES = np.array([[20.0, 50], [62, 62], [100, 150], [50, 222], [150, 262]])

# Velocities (row, col) in px/frame from each position to the next, and frames, of tracklets
AHEAD = (2.0, 12.0)
SITUATIONS: Mapping[str, tuple[tuple[tuple[float, float], ...], tuple[int, ...]]] = {
    "situation 1: it turns": (((-6, 8), (-5, 8), (4, 8), (6, 8)), (1, 2, 3, 4, 5)),
    "situation 2: it speeds up": ((AHEAD, AHEAD, (4, 34), (3, 14)), (1, 2, 3, 5, 6)),
    "situation 3: both": ((AHEAD, AHEAD, (-30, 14), (34, 10), AHEAD), (1, 2, 3, 4, 5, 6)),
}
SECOND = {
    "four positions": (((-30, 12), (34, 12), AHEAD), (1, 2, 3, 4)),
    "six positions": (((-30, 12), (34, 12), AHEAD, AHEAD, AHEAD), (1, 2, 3, 4, 5, 6)),
}
ENDS = {
    "the first position": (((42, 7), AHEAD, AHEAD, AHEAD, AHEAD), (1, 2, 3, 4, 5, 6)),
    "the last position": ((AHEAD, AHEAD, AHEAD, AHEAD, (-36, 10)), (1, 2, 3, 4, 5, 6)),
}
# Frames of the earlier and later tracklet in Fig. 4.10
CONNECTED = (1, 3, 4, 5, 7, 8), (11, 13, 14, 15, 16)
MERGED = (1, 3, 4, 5, 7, 9, 10, 11), (8, 9, 11, 13, 14, 15, 16)


def score_instance(gate: float) -> tuple[FrameScore, pd.DataFrame]:
    """Return the assignment of Fig. 3.13's kind and its cost matrix (Eq. 3.4).

    Parameters
    ----------
    gate
        Largest distance of a pair, px.

    Returns
    -------
    score : FrameScore
        Of `PARTICLES` and `DETECTED`.
    costs : DataFrame
        Distances in px, a row per detection, a column per particle; NaN beyond the gate.
    """
    score = score_detections(PARTICLES, DETECTED, gate)
    distance = cdist(DETECTED, PARTICLES)
    names = [f"p{k + 1}" for k in range(len(PARTICLES))]
    costs = pd.DataFrame(np.where(distance <= gate, distance, np.nan), columns=names)
    return score, costs.set_axis([f"d{k + 1}" for k in range(len(DETECTED))])


def draw_assignment(score: FrameScore, costs: pd.DataFrame, gate: float) -> Figure:
    """Draw the cost matrix with the pairs chosen, and where particles and detections lie."""
    picture, ((left, right),) = canvas(1, 2, width_mm=PAGE_MM, height_mm=75)
    _draw_costs(left, score, costs)
    pairs = PARTICLES[score.pairs[:, 0]], DETECTED[score.pairs[:, 1]]
    right.plot(*np.stack(pairs).T[::-1].swapaxes(1, 2), "-", color=GREEN, lw=1.5)
    kinds = {"particle": (PARTICLES, "*", BLUE, 6, 9), "detection": (DETECTED, "x", RED, -6, 6)}
    beside: dict[str, Any] = {"textcoords": "offset points", "fontsize": 7, "va": "center"}
    for name, (places, mark, colour, side, size) in kinds.items():
        right.plot(places[:, 1], places[:, 0], mark, color=colour, ms=size, label=name)
        for k, (row, col) in enumerate(places, start=1):
            text, ha = f"{name[0]}{k}", "left" if side > 0 else "right"
            right.annotate(text, (col, row), xytext=(side, 0), ha=ha, **beside)
    for row, col in DETECTED:
        right.add_patch(Circle((col, row), gate, fill=False, color="0.5", lw=0.7, ls=":"))
    right.set(xlabel="column (px)", ylabel="row (px)", aspect="equal")
    right.set(xlim=(0, 320), ylim=(215, -40))
    picture.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return picture


def _draw_costs(axes: Axes, score: FrameScore, costs: pd.DataFrame) -> None:
    """Draw a cost matrix: pairs framed, what is left over hatched."""
    for (row, col), value in np.ndenumerate(costs):
        text = "C max" if np.isnan(value) else f"{value:.1f}"
        axes.text(col, row, text, ha="center", va="center")
    hatched: dict[str, Any] = {"fill": False, "lw": 0, "hatch": "////", "alpha": 0.5}
    for row in score.spurious:
        axes.add_patch(Rectangle((-0.5, row - 0.5), costs.shape[1], 1, ec=RED, **hatched))
        axes.text(costs.shape[1] - 0.4, row, "FP", color=RED, va="center")
    for col in score.missed:
        axes.add_patch(Rectangle((col - 0.5, -0.5), 1, len(costs), ec=BLUE, **hatched))
        axes.text(col, len(costs) - 0.4, "FN", color=BLUE, ha="center", va="top")
    for particle, detection in score.pairs:
        corner = particle - 0.46, detection - 0.46
        axes.add_patch(Rectangle(corner, 0.92, 0.92, fill=False, ec=GREEN, lw=2))
    axes.set(xticks=range(costs.shape[1]), xticklabels=costs.columns, xlim=(-0.6, 5.1))
    axes.set(yticks=range(len(costs)), yticklabels=costs.index, ylim=(5.0, -0.6))
    axes.set(title="cost (px)")
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def judge_outliers(
    cases: Mapping[str, tuple[tuple[tuple[float, float], ...], tuple[int, ...]]],
    rule: tracklets.OutlierRemoval,
) -> pd.DataFrame:
    """Return what the rule makes of hand-made tracklets.

    Parameters
    ----------
    cases
        Velocities (row, col) in px/frame and frames of each tracklet.
    rule
        Removes outliers (Eqs 4.18 to 4.20); also tried with its second reading of Eq. 4.20.

    Returns
    -------
    DataFrame
        ``case``, ``frame``, ``row``, ``col``; turn and change of velocity at this position;
        whether Eq. 4.18, scanned ``forwards`` alone, marks it first; whether it is ``removed`` by
        the rule, or with the second position examined ``alone`` (Eq. 4.20).
    """
    parts = []
    for name, (steps, frames) in cases.items():
        time = np.diff(frames)[:, None]
        place = np.concatenate([np.zeros((1, 2)), np.cumsum(np.array(steps) * time, axis=0)])
        table = pd.DataFrame({"case": name, "frame": frames, "row": place[:, 0]})
        table = table.assign(col=place[:, 1], particle=0)
        speed = velocities(np.array(frames), place)
        angle, change = turns(speed[:-1], speed[1:])
        sharp = np.flatnonzero((angle > rule.angle_deg) & (change > rule.change))
        table["turn_deg"] = np.array([np.nan, *angle, np.nan])
        table["change_px_frame"] = np.array([np.nan, *change, np.nan])
        table["forwards"] = np.isin(np.arange(len(table)), sharp[:1] + 2)
        readings = {"removed": rule, "alone": replace(rule, from_last=False)}
        lost = {name: each(table)["particle"] < 0 for name, each in readings.items()}
        parts.append(table.assign(**lost))
    return pd.concat(parts, ignore_index=True).drop(columns="particle")


def draw_outliers(table: pd.DataFrame, by: Mapping[str, tuple[str, str]]) -> Figure:
    """Draw tracklets with turns and changes of velocity, a panel for each.

    Parameters
    ----------
    table
        From `judge_outliers`.
    by
        Title of each panel: the case it draws, and the column that tells its outliers.
    """
    rows = 1 if len(by) < 4 else 2
    picture, grid = canvas(rows, len(by) // rows, width_mm=PAGE_MM, height_mm=16 + 50 * rows)
    for axes, (title, (case, column)) in zip(grid.flat, by.items(), strict=True):
        _draw_judged(axes, table[table["case"] == case], column)
        axes.set(title=title, xlabel="column (px)", ylabel="row (px)")
    picture.legend(*_legend(grid.flat), loc="outside lower center", ncols=3)
    return picture


def _legend(panels: Any) -> tuple[list[Any], list[str]]:
    """Return what is named in any of the panels, each name once."""
    drawn = [
        pair for axes in panels for pair in zip(*axes.get_legend_handles_labels(), strict=True)
    ]
    named = {name: handle for handle, name in drawn}
    return list(named.values()), list(named)


def _draw_judged(axes: Axes, part: pd.DataFrame, column: str) -> None:
    """Draw a tracklet; what the column marks is an outlier."""
    place, out = part[["col", "row"]].to_numpy(), part[column].to_numpy()
    arrow: dict[str, Any] = {"arrowstyle": "->", "lw": 0.8, "color": "0.35", "shrinkB": 4}
    for before, after in pairwise(place):
        axes.annotate("", tuple(after), tuple(before), arrowprops=arrow)
    axes.plot(*place[~out].T, "o", color=GREEN, ms=6, label="inlier")
    axes.plot(*place[out].T, "X", color=RED, ms=8, label="outlier")
    row = part["row"].to_numpy()
    near = np.minimum(np.append(np.inf, row[:-1]), np.append(row[1:], np.inf))
    for k, point in enumerate(part.to_dict("records")):
        above = row[k] < near[k] or (k % 2 == 1 and row[k] - near[k] < 15)  # free of arrows
        text = f"T{k + 1}" + (f", frame {point['frame']}" if point["frame"] != k + 1 else "")
        if point["change_px_frame"] > 0:
            text += f"\n{point['turn_deg']:.0f}°, {point['change_px_frame']:.0f} px/frame"
        where: dict[str, Any] = {"textcoords": "offset points", "xytext": (0, 7 if above else -7)}
        where |= {"va": "bottom" if above else "top", "ha": "center", "fontsize": 5.5}
        axes.annotate(text, (point["col"], point["row"]), **where)
    low, high = part["row"].min(), part["row"].max()
    axes.set(ylim=(high + 6 + 0.25 * (high - low), low - 6 - 0.25 * (high - low)))
    axes.margins(x=0.2)


def joined_example(
    frames: tuple[tuple[int, ...], tuple[int, ...]], connection: tracklets.Connection
) -> pd.DataFrame:
    """Return two hand-made tracklets, and what the step makes of them.

    Parameters
    ----------
    frames
        Of the earlier and of the later one.
    connection
        Joins them, if it does.

    Returns
    -------
    DataFrame
        ``tracklet`` ("Ti", "Tk" or "Tj", joined), ``frame``, ``cardinality``, ``row``, ``col``,
        and whether a position is in the ``connected`` part (Fig. 4.10; of Ti and Tk only).
    """
    particle, time = np.repeat([0, 1], list(map(len, frames))), np.concatenate(frames)
    both = pd.DataFrame({"tracklet": np.where(particle, "Tk", "Ti"), "frame": time})
    both["row"] = 40.0 + 0.35 * (time - 8.0) ** 2 + 9.0 * particle
    both = both.assign(col=10.0 * time, particle=particle, z=np.nan)
    paths = read_paths(both, "example")
    pair = np.array([0]), np.array([1])
    _, part, place = connected_parts(paths, *pair, overlap_in_time(paths, *pair))
    inside = pd.MultiIndex.from_arrays([part, *place[:, :2].T])
    both["connected"] = pd.MultiIndex.from_frame(both[["frame", "row", "col"]]).isin(inside)
    joined = tracklets.tracked(connection(both))
    joined = joined.assign(tracklet="Tj", connected=False).sort_values("frame")
    if joined["particle"].max() > 0:  # not joined
        joined = joined.head(0)
    table = pd.concat([both, joined], ignore_index=True)
    table["cardinality"] = table.groupby("tracklet").cumcount() + 1
    return table[["tracklet", "frame", "cardinality", "row", "col", "connected"]]


def draw_joined(examples: Mapping[str, pd.DataFrame], parts: bool) -> Figure:
    """Draw examples of `joined_example` side by side.

    Parameters
    ----------
    examples
        By title.
    parts
        Whether to draw the connected part and the frames (Fig. 4.10), or what they are joined
        to (Fig. 4.9).
    """
    picture, (panels,) = canvas(1, len(examples), sharey=True, width_mm=PAGE_MM, height_mm=72)
    for axes, (title, table) in zip(panels, examples.items(), strict=True):
        for name, which, mark, colour, side in (
            ("Ti", "earlier", "o", BLUE, -1),
            ("Tk", "later", "s", RED, 1),
        ):
            part, label = table[table["tracklet"] == name], f"{name}, {which} tracklet"
            axes.plot(part["col"], part["row"], mark, color=colour, ms=5, label=label)
            if parts:
                _name_frames(axes, part, side)
        if not parts:
            joined = table[table["tracklet"] == "Tj"]
            look: dict[str, Any] = {"color": "black", "lw": 1, "ls": "-", "ms": 3, "mfc": "white"}
            axes.plot(joined["col"], joined["row"], marker="D", label="Tj, joined", **look)
        axes.set(title=title, xlabel="column (px)", ylim=(94, 18))
    panels[0].set_ylabel("row (px)")
    picture.legend(*_legend(panels), loc="outside lower center", ncols=3)
    return picture


def _name_frames(axes: Axes, part: pd.DataFrame, side: int) -> None:
    """Write frame and cardinality beside positions; frame the connected part."""
    where: dict[str, Any] = {"textcoords": "offset points", "xytext": (0, -5 * side)}
    where |= {"ha": "center", "va": "bottom" if side < 0 else "top", "fontsize": 6}
    for row in part.to_dict("records"):
        text = f"{row['frame']}\n({row['cardinality']})"
        axes.annotate(text, (row["col"], row["row"]), **where)
    inside = part[part["connected"]]
    (left, top), (right, bottom) = (inside[["col", "row"]].agg(edge) for edge in ("min", "max"))
    box: dict[str, Any] = {"fill": False, "ls": "--", "lw": 0.8, "ec": "black"}
    axes.add_patch(Rectangle((left - 5, top - 3), right - left + 10, bottom - top + 6, **box))
