"""Pictures of data association on small cases, after Figs 2.20 to 2.23 and 4.2."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kilnflight.project.style import COLOURS, canvas

Array = npt.NDArray[np.float64]
BLACK, ORANGE, BLUE, YELLOW = COLOURS[:4]
MARKS: dict[str, Any] = {"mec": BLACK, "mew": 0.6, "ls": ""}


def associations(
    situations: Mapping[str, tuple[Array, Array]],
    weights: Mapping[tuple[str, str], Array],
    covariance: Array,
    distance: float,
) -> Figure:
    """Return what associators (rows) make of situations (columns).

    Parameters
    ----------
    situations
        Predictions (n, 2) and detections (m, 2) as row, col in px, by situation.
    weights
        (n, 1 + m) by situation and associator; column 0: none.
    covariance, distance
        Of the residuals (2, 2), and the gate in standard deviations.
    """
    names = list(dict.fromkeys(name for _, name in weights))
    size: dict[str, Any] = {"width_mm": 132, "height_mm": 172}
    picture, grid = canvas(len(names), len(situations), **size, sharex=True, sharey=True)
    for (situation, name), beta in weights.items():
        tracks, detections = situations[situation]
        axes = grid[names.index(name), list(situations).index(situation)]
        for i, place in enumerate(tracks):
            _gate(axes, place, covariance, distance, color="0.7")
            axes.plot([-28, place[1]], place[[0, 0]], ":", color="0.4", lw=0.9)
            _text(axes, f"T{i + 1}", np.array([place[0], -25]))
            for j in np.flatnonzero(beta[i, 1:] > 0.01):
                path = np.transpose([place, detections[j]])[::-1]
                axes.plot(*path, "-", color=ORANGE, lw=0.4 + 4 * beta[i, 1 + j])
        mean = beta[:, :1] * tracks + beta[:, 1:] @ detections  # as in Eq. 2.53
        axes.plot(*tracks.T[::-1], "o", mfc="white", ms=5, label="predicted", **MARKS)
        axes.plot(*detections[:2].T[::-1], "s", mfc=BLUE, ms=5, label="detected", **MARKS)
        axes.plot(*detections[2:].T[::-1], "X", mfc="0.7", ms=6.5, label="clutter", **MARKS)
        axes.plot(*mean.T[::-1], "D", mfc=YELLOW, ms=3.6, label="weighted mean", **MARKS)
        for text, place in zip(["D1", "D2", "N1"], detections, strict=False):
            _text(axes, text, place, (0, 7) if text == "D1" else (-9, 0))
        axes.set(aspect="equal", xlim=(-29, 20), ylim=(40, -14))
        axes.set_title(situation if name == names[0] else "")
        axes.set_ylabel(f"{name}\nrow (px)" if axes is grid[names.index(name), 0] else "")
    for axes in grid[-1]:
        axes.set_xlabel("column (px)")
    picture.legend(*grid[0, 2].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return picture


def joint_events(
    places: tuple[Array, Array],
    covariance: Array,
    distance: float,
    matrices: Mapping[str, Array],
    betas: Mapping[str, Array],
    title: str,
) -> Figure:
    """Return gates, validation matrix and feasibility matrices, and probabilities (Fig. 2.23).

    Parameters
    ----------
    places
        Predictions of two tracks and four detections, row and col in px.
    covariance, distance
        Of the residuals (2, 2), and the gate in standard deviations.
    matrices
        (4, 3) by their title: detections by none and the tracks.
    betas
        (5, 2) by their title: none and the detections by the tracks.
    title
        Above all.
    """
    picture, grid = canvas(3, 5, width_mm=132, height_mm=112)
    first, *rest = grid.ravel()
    for place, line in zip(places[0], ("-", "--"), strict=True):
        _gate(first, place, covariance, distance, color=BLACK, ls=line)
    first.plot(*places[0].T[::-1], "o", mfc="white", **MARKS)
    first.plot(*places[1].T[::-1], "s", mfc=BLUE, **MARKS)
    for text, place in zip(["P1", "P2", "D1", "D2", "D3", "D4"], np.vstack(places), strict=True):
        _text(first, text, place, (8, 0))
    first.set(aspect="equal", xlabel="column (px)", ylim=(28, -14))
    first.set_title("row (px)", loc="left", fontsize=7.5)
    rows = ["D1", "D2", "D3", "D4"]
    for axes, (name, matrix) in zip(rest, matrices.items(), strict=False):
        _matrix(axes, matrix, name, ["–", "T1", "T2"], rows)
    for axes, (name, matrix) in zip(rest[len(matrices) :], betas.items(), strict=True):
        _matrix(axes, matrix, name, ["T1", "T2"], ["–", *rows])
        axes.set_aspect("auto")
        for (i, j), value in np.ndenumerate(matrix):
            axes.text(j + 0.5, i + 0.55, f"{value:.2f}", fontsize=6, ha="center", va="center")
    picture.suptitle(title, fontsize=8)
    plt.close(picture)  # shown when it is saved
    return picture


def gate_in_flight(table: pd.DataFrame, unseen: tuple[int, ...], depth_mm: float) -> Figure:
    """Return the gate of a track by frame in the image and in depth (Fig. 4.2).

    Parameters
    ----------
    table
        ``frame``, ``what``, ``row``, ``col``, ``z`` of detections; ``expected_row``,
        ``expected_col``, ``expected_z``, ``reach_row_px``, ``reach_col_px`` of the gate;
        ``in_gate``.
    unseen
        Frames without a detection.
    depth_mm
        Limit of depth about the last known one.
    """
    gates = table.drop_duplicates("frame").set_index("frame").loc[2:]
    picture, ((flat,), (deep,)) = canvas(2, height_mm=84, height_ratios=[0.8, 1.2])
    for frame, gate in gates.iterrows():
        place = gate[["expected_row", "expected_col"]].to_numpy(float)
        reach = np.diag(gate[["reach_row_px", "reach_col_px"]].to_numpy(float) ** 2)
        _gate(
            flat,
            place,
            reach,
            1.0,
            **{"color": ORANGE, "ls": "--"} if frame in unseen else {"color": "0.5"},
        )
        _text(flat, str(frame), np.array([24, place[1]]))
    flat.plot(gates["expected_col"], gates["expected_row"], "+", color=BLACK, ms=4)
    flat.set(aspect="equal", ylabel="row (px)", xlabel="column (px)")
    flat.set_ylim(98, 10)
    centre, limit = gates["expected_z"] / 1000, depth_mm / 1000
    area = {"step": "mid", "color": "0.88", "label": "gate"}
    deep.fill_between(gates.index, centre - limit, centre + limit, **area)
    near = table.query("frame > 1 and what != 'other particle'")
    known, passed = near["z"].notna(), near["in_gate"]
    kinds = {"taken": known & passed, "refused by depth": ~passed, "no depth: taken": ~known}
    for (kind, which), mark, fill in zip(kinds.items(), "sXv", (BLUE, "0.7", ORANGE), strict=True):
        look = {**MARKS, "marker": mark, "mfc": fill, "label": kind, "ms": 4}
        flat.plot(near["col"][which], near["row"][which], **look)
        deep.plot(near["frame"][which], near["z"].fillna(near["expected_z"])[which] / 1000, **look)
    deep.set(xlabel="frame", ylabel="depth z (m)", xticks=gates.index, ylim=(2, 8.6))
    deep.legend(loc="upper left", ncols=2)
    return picture


def _text(axes: Axes, text: str, place: Array, shift: tuple[float, float] = (0, 6)) -> None:
    look: dict[str, Any] = {"textcoords": "offset points", "fontsize": 6.5, "va": "center"}
    axes.annotate(text, (place[1], place[0]), xytext=shift, ha="center", **look)


def _gate(axes: Axes, place: Array, covariance: Array, distance: float, **line: Any) -> None:
    turn = np.linspace(0, 2 * np.pi, 200)
    edge = distance * np.linalg.cholesky(covariance) @ [np.cos(turn), np.sin(turn)]
    axes.plot(*(place[:, None] + edge)[::-1], **{"lw": 0.8, "ls": "-", **line})


def _matrix(axes: Axes, matrix: Array, title: str, columns: list[str], rows: list[str]) -> None:
    axes.pcolormesh(matrix, cmap="gray_r", vmin=0, vmax=1, edgecolors="0.6", lw=0.5)
    axes.set(aspect="equal", title=title, ylim=(len(matrix), 0), anchor="S")
    axes.set_xticks(np.arange(len(columns)) + 0.5, columns)
    axes.set_yticks(np.arange(len(rows)) + 0.5, rows)
