"""Data association on small cases: joint events and the gate in flight.

Figs 2.20 to 4.2 of the thesis.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import comb, perm
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kilnflight.association import ASSOCIATORS, Pairs, joint_probabilities
from kilnflight.project.style import COLOURS, canvas
from kilnflight.tracking import tracker
from kilnflight.tracking.gate import Gate

Array = npt.NDArray[np.float64]
Matrices = npt.NDArray[np.uint8]
Places = tuple[Array, Array]  # predictions (n, 2) and detections (m, 2), row and col in px
NAMES = ("NN", "GNN", "PDA", "JPDA")  # of the ASSOCIATORS
BLACK, ORANGE, BLUE, YELLOW = COLOURS[:4]
MARKS: dict[str, Any] = {"mec": BLACK, "mew": 0.6, "ls": ""}


def feasible_events(validation: npt.ArrayLike) -> Matrices:
    """Return every feasibility matrix of a validation matrix.

    Eqs 2.58 to 2.61 of the thesis.

    Parameters
    ----------
    validation
        (m, 1 + n) of 0 and 1: which detection lies in the gate of which track. Column 0
        is "no track" and holds ones (Eq. 2.57).

    Returns
    -------
    ndarray
        (events, m, 1 + n) uint8: one 1 per row, at most one per column but column 0. The
        first is the event without any pair; the order is that of the detections' tracks.

    Examples
    --------
    >>> len(feasible_events([[1, 1, 0], [1, 1, 1], [1, 0, 1], [1, 0, 1]]))  # Fig. 2.23
    11
    """
    omega = np.asarray(validation)
    tracks = np.zeros((1, 0), dtype=np.intp)  # (events so far, detections so far)
    for row in omega:
        choices = np.flatnonzero(row)
        before = np.repeat(tracks, len(choices), axis=0)
        choice = np.tile(choices, len(tracks))
        taken = (before == choice[:, None]).any(axis=1) & (choice > 0)
        tracks = np.column_stack([before, choice])[~taken]
    return (tracks[:, :, None] == np.arange(omega.shape[1])).astype(np.uint8)


def most_events(tracks: int, detections: int) -> int:
    """Return the number of feasible events if all detections are in all gates.

    Eq. 2.62 of the thesis.
    With fewer detections than tracks, the factorials of negative numbers that Eq. 2.62 then
    contains stand for no event.

    >>> most_events(2, 4)
    21
    """
    return 1 + sum(comb(tracks, i) * perm(detections, tracks - i) for i in range(tracks))


def event_table(validation: Matrices) -> pd.DataFrame:
    """Return the probabilities of all pairs over joint events of equal likelihood.

    Fig. 2.23 of the thesis.

    Returns
    -------
    DataFrame
        ``track``, ``detection`` ("none", "D1", ...), ``joint`` by `joint_probabilities`,
        ``sum_over_events`` by Eq. 2.64 as it stands, ``independent``, and for each event
        whether it holds the pair.
    """
    pairs = feasible_events(validation)[:, :, 1:]
    events = np.concatenate([1 - pairs.sum(axis=1, keepdims=True), pairs], axis=1)
    inside, (_, rows, tracks) = validation[:, 1:].T, events.shape
    alone = [joint_probabilities(inside[[k]], [1.0])[0] for k in range(tracks)]
    shares = {
        "joint": joint_probabilities(inside, np.ones(tracks)).T,
        "sum_over_events": events.mean(axis=0),
        "independent": np.transpose(alone),
    }
    shares |= {f"event_{k}": event for k, event in enumerate(events, 1)}
    names = ["none", *(f"D{k}" for k in range(1, rows))]
    table = pd.DataFrame({"track": np.tile([f"T{k + 1}" for k in range(tracks)], rows)})
    table["detection"] = np.repeat(names, tracks)
    return table.assign(**{name: np.ravel(values) for name, values in shares.items()})


def weigh(cases: Mapping[str, Pairs]) -> tuple[dict[tuple[str, str], Array], pd.DataFrame]:
    """Return the weights of all associators in some cases, also as a long table.

    Returns
    -------
    weights : dict
        (n, 1 + m) by situation and associator; column 0: none.
    table : DataFrame
        ``situation``, ``associator``, ``track``, ``detection`` and ``weight``.
    """
    weights = {
        (case, name): associator(pairs)
        for case, pairs in cases.items()
        for name, associator in zip(NAMES, ASSOCIATORS, strict=True)
    }
    rows = [
        (*case, f"T{i + 1}", ["none", "D1", "D2", "N1"][j], weight)
        for case, beta in weights.items()
        for (i, j), weight in np.ndenumerate(beta)
    ]
    columns = ["situation", "associator", "track", "detection", "weight"]
    return weights, pd.DataFrame(rows, columns=columns)


def sketched_outcomes(weights: Mapping[tuple[str, str], Array]) -> pd.Series:
    """Return which outcomes of the thesis's sketches weights show (Figs 2.20 to 2.22).

    ``weights`` is of `weigh`, for the situations "apart", "crowded" and "clutter".
    """
    apart, crowd, clutter = (  # (associator, track, none and detections)
        np.stack([weights[situation, name] for name in NAMES])
        for situation in ("apart", "crowded", "clutter")
    )
    outcomes = {
        "apart: all mostly take their own": (apart[:, [0, 1], [1, 2]] > 0.5).all(),
        "crowded: NN takes D2 for T1, none for T2": crowd[0, [0, 1], [2, 0]].all(),
        "crowded: GNN gives each its own": crowd[1, [0, 1], [1, 2]].all(),
        "crowded: PDA shares T1 out, most to D2": 0.1 < crowd[2, 0, 1] < crowd[2, 0, 2],
        "clutter: NN and GNN take N1": (clutter[:2, 0, 3] == 1).all(),
        "clutter: PDA and JPDA between D1 and N1": (clutter[2:, 0, [1, 3]] > 0.1).all(),
    }
    return pd.Series(outcomes, name="comes out", dtype=bool)


def interrupted_flight(seed: int) -> pd.DataFrame:
    """Return detections of a flight of twelve frames, missed in frames 5 to 7.

    ``origin``: "particle", without depth in frame 10; "other particle", far away in all frames;
    "clutter", nearer than the particle in frame 3.
    """
    frames, random = np.arange(12), np.random.default_rng(seed)
    flight = pd.DataFrame({"frame": frames, "row": 40.0 + 3 * frames, "col": 20.0 + 26 * frames})
    flight[["row", "col"]] += random.normal(0, 1.0, (12, 2))
    flight["z"] = 5000.0 + 60 * frames + random.normal(0, 200, 12)
    flight.loc[10, "z"] = np.nan
    other = flight.assign(row=flight["row"] + 500, z=5000.0, origin="other particle")
    clutter = (flight[frames == 3] + [0, 6, -7, -2600]).assign(origin="clutter")
    flight = flight.drop(index=[5, 6, 7]).assign(origin="particle")
    return pd.concat([flight, other, clutter], ignore_index=True)


def gate_table(detections: pd.DataFrame) -> pd.DataFrame:
    """Return the detections beside the first track's gate, from its second frame on.

    ``expected_row``, ``expected_col``, ``expected_z``: the prediction; ``in_ellipse``: in the
    gate but for the depth; ``reach_row_px``, ``reach_col_px`` of the ellipse; ``in_gate``.
    """
    parts, ellipse = [], Gate(depth_mm=np.inf)
    for step in list(tracker.steps(detections))[1:]:
        row, col = step.predicted.positions[0]
        depth = step.predicted.depth_mm
        part = detections.iloc[step.rows].assign(
            expected_row=row,
            expected_col=col,
            expected_z=np.nan if depth is None else depth[0],
            in_ellipse=np.isfinite(ellipse(step.predicted, step.detected).distance_squared[0]),
        )
        spread = np.sqrt(step.predicted.residual_covariance[0].diagonal())
        part[["reach_row_px", "reach_col_px"]] = Gate().distance * spread
        parts.append(part.assign(in_gate=np.isfinite(step.pairs.distance_squared[0])))
    return pd.concat(parts, ignore_index=True)


def draw_associations(
    situations: Mapping[str, Places],
    weights: Mapping[tuple[str, str], Array],
    covariance: Array,
    distance: float,
) -> Figure:
    """Draw what associators (rows) make of situations (columns).

    Parameters
    ----------
    situations
        Predictions and detections by situation.
    weights
        Of `weigh`.
    covariance, distance
        Of the residuals (2, 2), and the gate in standard deviations.
    """
    size: dict[str, Any] = {"width_mm": 132, "height_mm": 172}
    picture, grid = canvas(len(NAMES), len(situations), **size, sharex=True, sharey=True)
    for (situation, name), beta in weights.items():
        tracks, detections = situations[situation]
        axes = grid[NAMES.index(name), list(situations).index(situation)]
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
        axes.set_title(situation if axes in grid[0] else "")
        axes.set_ylabel(f"{name}\nrow (px)" if axes in grid[:, 0] else "")
    for axes in grid[-1]:
        axes.set_xlabel("column (px)")
    picture.legend(*grid[0, 2].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return picture


def draw_events(
    places: Places, covariance: Array, distance: float, validation: Matrices, table: pd.DataFrame
) -> Figure:
    """Draw gates, validation and feasibility matrices, and probabilities (Fig. 2.23).

    Parameters
    ----------
    places
        Predictions of two tracks, and four detections.
    covariance, distance
        Of the residuals (2, 2), and the gate in standard deviations.
    validation
        (4, 3), see `feasible_events`.
    table
        Of `event_table`.
    """
    events = feasible_events(validation)
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
    rows, names = ["D1", "D2", "D3", "D4"], ["Ω", *(f"Ω{k}" for k in range(1, 1 + len(events)))]
    for axes, name, matrix in zip(rest, names, [validation, *events], strict=False):
        _matrix(axes, matrix, name, ["–", "T1", "T2"], rows)
    betas = {"joint": "β, joint", "independent": "β, each alone"}
    for axes, (column, name) in zip(rest[len(names) :], betas.items(), strict=True):
        matrix = table[column].to_numpy().reshape(5, 2)
        _matrix(axes, matrix, name, ["T1", "T2"], ["–", *rows])
        axes.set_aspect("auto")
        for (i, j), value in np.ndenumerate(matrix):
            axes.text(j + 0.5, i + 0.55, f"{value:.2f}", fontsize=6, ha="center", va="center")
    bound = most_events(2, 4)
    picture.suptitle(f"{len(events)} joint events of at most {bound} (Eq. 2.62)", fontsize=8)
    return picture


def draw_gate(table: pd.DataFrame, missed: tuple[int, ...], depth_mm: float) -> Figure:
    """Draw the gate of a track by frame in the image and in depth (Fig. 4.2).

    Parameters
    ----------
    table
        Of `gate_table`, with the ``origin`` of each detection.
    missed
        Frames without a detection.
    depth_mm
        Limit of depth about the last known one.
    """
    gates = table.drop_duplicates("frame").set_index("frame").loc[2:]
    picture, ((flat,), (deep,)) = canvas(2, height_mm=84, height_ratios=[0.8, 1.2])
    for frame, gate in gates.iterrows():
        place = gate[["expected_row", "expected_col"]].to_numpy(float)
        reach = np.diag(gate[["reach_row_px", "reach_col_px"]].to_numpy(float) ** 2)
        line = {"color": ORANGE, "ls": "--"} if frame in missed else {"color": "0.5"}
        _gate(flat, place, reach, 1.0, **line)
        _text(flat, str(frame), np.array([24, place[1]]))
    flat.plot(gates["expected_col"], gates["expected_row"], "+", color=BLACK, ms=4)
    flat.set(aspect="equal", ylabel="row (px)", xlabel="column (px)")
    flat.set_ylim(98, 10)
    centre, limit = gates["expected_z"] / 1000, depth_mm / 1000
    area = {"step": "mid", "color": "0.88", "label": "gate"}
    deep.fill_between(gates.index, centre - limit, centre + limit, **area)
    near = table.query("frame > 1 and origin != 'other particle'")
    known, passed = near["z"].notna(), near["in_gate"]
    kinds = {"taken": known & passed, "refused by depth": ~passed, "no depth: taken": ~known}
    for (label, mask), mark, fill in zip(kinds.items(), "sXv", (BLUE, "0.7", ORANGE), strict=True):
        look = {**MARKS, "marker": mark, "mfc": fill, "label": label, "ms": 4}
        flat.plot(near["col"][mask], near["row"][mask], **look)
        deep.plot(near["frame"][mask], near["z"].fillna(near["expected_z"])[mask] / 1000, **look)
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
