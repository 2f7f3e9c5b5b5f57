"""Real tracklets of a window that the post-processing drops or joins.

Figs 4.4 and 4.12 of the thesis. Which ones are drawn follows a rule, stated at each function.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kilnflight import tracklets
from kilnflight.experiments.tracking import Window
from kilnflight.project.style import COLOURS, PAGE_MM, canvas
from kilnflight.tracklets.eliminate import mean_speed, regularity
from kilnflight.tracklets.paths import read_paths

Array = npt.NDArray[np.float64]
GREEN, RED, YELLOW = COLOURS[4], COLOURS[1], COLOURS[3]
CONDITIONS = {"duration": "frames", "speed": "px/frame", "regularity": ""}
JOINT = ["earlier", "later", "kind", "start_row", "start_col", "end_row", "end_col"]
JOINT += ["first_frame", "last_frame"]
AROUND = 60  # px drawn around a window of the texture


def pooled(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return the tracks of all fractions in one table, particles numbered through."""
    parts, number = [], 0
    for fraction, table in tables.items():
        kept = tracklets.tracked(table)
        parts.append(kept.assign(particle=kept["particle"] + number, fraction=fraction))
        number += int(kept["particle"].max()) + 1 if len(kept) else 0
    return pd.concat(parts, ignore_index=True)


def judge_tracklets(tracks: pd.DataFrame, rule: tracklets.Elimination) -> pd.DataFrame:
    """Return the three measures of Eq. 4.15 of each tracklet.

    Returns
    -------
    DataFrame
        Index ``particle``; ``duration`` in assigned frames, ``speed`` in px/frame and
        ``regularity``; ``fails``, the conditions that it does not meet, joined by a plus.
    """
    paths = read_paths(tracks, "judge_tracklets: tracks")
    names = paths.names()
    table = pd.DataFrame({"duration": np.diff(paths.starts).astype(np.float64)})
    table["speed"] = mean_speed(names, paths.frame, paths.place)
    table["regularity"] = regularity(names, paths.frame, paths.place)
    failed = pd.DataFrame({name: ~(table[name] > getattr(rule, name)) for name in CONDITIONS})
    table["fails"] = [" + ".join(failed.columns[row]) for row in failed.to_numpy()]
    particle = tracks["particle"].to_numpy()[paths.rows[paths.starts[:-1]]]
    return table.set_index(pd.Index(particle, name="particle"))


def chosen_tracklets(judged: pd.DataFrame) -> pd.DataFrame:
    """Return an eligible and a false tracklet for each condition (Fig. 4.4).

    The rule: of the eligible ones, and of those that fail this condition alone, the one in the
    middle when sorted by the condition's measure, then by particle. A condition that nothing fails
    alone has no false one.

    Parameters
    ----------
    judged
        From `judge_tracklets`.

    Returns
    -------
    DataFrame
        ``condition``, ``verdict`` ("eligible" or "false"), ``particle``, and the measures.
    """
    rows = []
    for condition in CONDITIONS:
        for verdict, fails in (("eligible", ""), ("false", condition)):
            part = judged[judged["fails"] == fails].reset_index()
            part = part.sort_values([condition, "particle"], kind="stable")
            middle = part.iloc[len(part) // 2 : len(part) // 2 + 1]
            rows.append(middle.assign(condition=condition, verdict=verdict))
    table = pd.concat(rows, ignore_index=True)
    return table[["condition", "verdict", "particle", *CONDITIONS]]


def draw_eligible(tracks: pd.DataFrame, chosen: pd.DataFrame) -> Figure:
    """Draw chosen tracklets, eligible ones above, false ones below.

    Parameters
    ----------
    tracks
        Before the elimination.
    chosen
        From `chosen_tracklets`.
    """
    picture, grid = canvas(2, len(CONDITIONS), width_mm=PAGE_MM, height_mm=110)
    rows = chosen.set_index(["verdict", "condition"])
    looks = {"eligible": ("o", GREEN), "false": ("X", RED)}
    for panels, (verdict, (mark, colour)) in zip(grid, looks.items(), strict=True):
        for axes, (condition, unit) in zip(panels, CONDITIONS.items(), strict=True):
            if (verdict, condition) not in rows.index:
                axes.set_title(f"{verdict}: no {condition} alone")
                axes.set_axis_off()
                continue
            axes.set(xlabel="column (px)", ylabel="row (px)")
            row: Any = rows.loc[(verdict, condition)]
            part = tracks[tracks["particle"] == row["particle"]].sort_values("frame")
            _draw_tracklet(axes, part[["frame", "col", "row"]].to_numpy(np.float64), mark, colour)
            axes.set_title(f"{verdict}: {condition} {row[condition]:.3g} {unit}")
    return picture


def _draw_tracklet(axes: Axes, points: Array, mark: str, colour: str) -> None:
    """Draw a tracklet (frame, col, row) and its polynomials (Eq. 4.15), at least 20 px wide."""
    time, place = points[:, 0] - points[:, 0].mean(), points[:, 1:]
    axes.plot(*place.T, mark, color=colour, ms=4, lw=0.7, ls="-")
    if len(points) > 3:
        curve = np.polynomial.Polynomial
        ways = [curve.fit(time, values, 2).linspace(60)[1] for values in place.T]
        axes.plot(*ways, "--", color="black", lw=0.8)
    (x, y), half = (place.min(0) + place.max(0)) / 2, max(10.0, 0.6 * np.ptp(place, axis=0).max())
    axes.set(xlim=(x - half, x + half), ylim=(y + half, y - half), box_aspect=1)


@dataclass
class Remembering:
    """A matching that remembers which pairs it has chosen, iteration by iteration."""

    matching: tracklets.Matching
    chosen: list[tuple[int, int]] = field(default_factory=list)

    def __call__(self, pairs: tracklets.Pairs) -> npt.NDArray[np.int64]:
        """Return what the matching chooses."""
        positions = self.matching(pairs)
        both = pairs.earlier[positions].tolist(), pairs.later[positions].tolist()
        self.chosen += zip(*both, strict=True)
        return positions


def joins(
    before: pd.DataFrame,
    connection: tracklets.Connection,
    differences: tracklets.Differences | None = None,
) -> pd.DataFrame:
    """Return which pairs a step joins, one row for each.

    Parameters
    ----------
    before
        Tracks that the step is given.
    connection, differences
        The step, and what it looks at.

    Returns
    -------
    DataFrame
        ``earlier`` and ``later``, the particles of ``before`` that meet; ``kind``, "connection"
        or "merging"; ``start_row``, ``start_col`` and ``end_row``, ``end_col``, the last position
        of the earlier and the first of the later one; ``first_frame`` and ``last_frame`` of both.
    """
    spy = Remembering(connection.matching)
    replace(connection, matching=spy)(before, differences)
    paths = read_paths(before, "joins: tracks")
    members = np.split(np.arange(len(paths.rows)), paths.starts[1:-1])
    particle = before["particle"].to_numpy()[paths.rows]
    rows = []
    for pair in spy.chosen:
        points = [members[k][np.argsort(paths.frame[members[k]])] for k in pair]
        ends = np.array([points[0][-1], points[1][0]])
        (start, end), frames = paths.place[ends, :2], paths.frame[np.concatenate(points)]
        row = dict(zip(("earlier", "later"), particle[ends].tolist(), strict=True))
        apart = paths.frame[ends[1]] > paths.frame[ends[0]]
        row |= {"kind": "connection" if apart else "merging", "start_row": start[0]}
        row |= {"start_col": start[1], "end_row": end[0], "end_col": end[1]}
        rows.append(row | {"first_frame": int(frames.min()), "last_frame": int(frames.max())})
        members[min(pair)], members[max(pair)] = np.concatenate(points), points[0][:0]
    return pd.DataFrame(rows, columns=JOINT)


def joined_in(
    windows: Sequence[Window],
    tables: Mapping[str, pd.DataFrame],
    connection: tracklets.Connection,
) -> pd.DataFrame:
    """Return the `joins` of all windows, ``fraction`` first."""
    found = {
        window.fraction: joins(tables[window.fraction], connection, window.differences)
        for window in windows
    }
    return pd.concat(found, names=["fraction"]).reset_index("fraction").reset_index(drop=True)


def chosen_joins(table: pd.DataFrame) -> dict[str, dict[Any, Any]]:
    """Return the joints of Fig. 4.12: of each kind that with the longest window.

    Vertical and lateral connection, vertical merging, from `joins`; a kind that does not occur is
    missing. Vertical is a joint at least as long along the rows as along the columns.
    """
    tall = (table["end_row"] - table["start_row"]).abs()
    wide = (table["end_col"] - table["start_col"]).abs()
    kinds = {
        "vertical connection": (table["kind"] == "connection") & (tall >= wide),
        "lateral connection": (table["kind"] == "connection") & (tall < wide),
        "vertical merging": (table["kind"] == "merging") & (tall >= wide),
    }
    length = pd.Series(np.maximum(tall, wide))
    return {
        name: table.loc[[length[mask].idxmax()]].to_dict("records")[0]
        for name, mask in kinds.items()
        if mask.any()
    }


def draw_windows(
    windows: Sequence[Window],
    tables: Mapping[str, pd.DataFrame],
    chosen: Mapping[str, dict[Any, Any]],
    texture: tracklets.LevelEdge,
) -> Figure:
    """Draw joined tracklets and their texture windows on the sum of frame differences.

    Parameters
    ----------
    windows
        With their differences.
    tables
        By fraction: tracks before they were joined.
    chosen
        From `chosen_joins`.
    texture
        Measures in the windows that are drawn.
    """
    picture, (panels,) = canvas(1, 3, width_mm=PAGE_MM, height_mm=82)
    by_fraction = {window.fraction: window for window in windows}
    for axes, (name, joint) in zip(panels, chosen.items(), strict=False):
        first, last = ((joint[f"{end}_row"], joint[f"{end}_col"]) for end in ("start", "end"))
        corners = texture.corners(first, last)
        _draw_sum(axes, by_fraction[joint["fraction"]], joint, corners)
        _draw_pair(axes, tables[joint["fraction"]], joint)
        outline = np.concatenate([corners, corners[:1]])
        axes.plot(outline[:, 1], outline[:, 0], "-", color=YELLOW, lw=1.4, label="window")
        axes.set(title=f"{name},\n{joint['fraction']}", xlabel="column (px)", ylabel="row (px)")
    for axes in panels[len(chosen) :]:
        axes.set_axis_off()
    if chosen:
        handles = panels[0].get_legend_handles_labels()
        picture.legend(*handles, loc="outside lower center", ncols=3)
    return picture


def _draw_sum(axes: Axes, window: Window, joint: Mapping[Any, Any], corners: Array) -> None:
    """Draw the sum of frame differences around the corners (4, 2) of a window."""
    middle, half = corners.mean(axis=0), np.ptp(corners, axis=0).max() / 2 + AROUND
    box = np.array([np.floor(middle - half), np.ceil(middle + half)])
    box = np.clip(box, 0, window.differences.shape).astype(int)
    sums = window.differences(joint["first_frame"], joint["last_frame"], *box.ravel().tolist())
    image = np.sqrt(sums.astype(np.float64))
    (top, left), (bottom, right) = box - 0.5
    brightest = max(float(np.quantile(image, 0.995)), 1.0)
    axes.imshow(image, cmap="gray", extent=(left, right, bottom, top), vmin=0, vmax=brightest)
    axes.set(xlim=(left, right), ylim=(bottom, top), autoscale_on=False)


def _draw_pair(axes: Axes, before: pd.DataFrame, joint: dict[Any, Any]) -> None:
    """Draw the two tracklets of a joint."""
    looks = {"earlier": ("o", COLOURS[6]), "later": ("s", RED)}
    for which, (mark, colour) in looks.items():
        part = before[before["particle"] == joint[which]].sort_values("frame")
        look: dict[str, Any] = {"marker": mark, "ms": 3, "lw": 0.6, "ls": "-", "mfc": "none"}
        axes.plot(part["col"], part["row"], color=colour, label=f"{which} tracklet", **look)
