"""Plots that are long or shared by notebooks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from kilnflight.checks import InputError
from kilnflight.detection.combination import Clusters
from kilnflight.experiments.accuracy import CASES
from kilnflight.experiments.campaigns import CampaignKey
from kilnflight.experiments.space import SAMPLES, upright
from kilnflight.experiments.space import label_camera_space as label_camera_space
from kilnflight.flight import BURNT_OUT, LANDED, straight_on
from kilnflight.ignition import NONE, SEEN
from kilnflight.project.style import (
    BOXES,
    COLOURS,
    HATCHES,
    LINES,
    PAGE_MM,
    PUBLISHED,
    PUBLISHED_BAR,
    canvas,
    draw_circles,
    draw_frame,
)
from kilnflight.recording.frames import Recording
from kilnflight.regression import Fit
from kilnflight.twin.flight import Flights

Array = npt.NDArray[np.float64]
FACES = ("white", "0.85", COLOURS[6], COLOURS[3])
SUBSCRIPTS = "₀₁₂₃₄₅₆₇₈₉"
SYMBOLS = {"alpha": "alpha", "beta": "beta", "jsc": "JSC", "jsc_theta": "JSCθ"}  # of scores
LANCE: dict[str, Any] = {"marker": "x", "color": COLOURS[1], "ms": 6, "mew": 1.6, "ls": ""}


def draw_grouped_boxes(
    axes: Axes, groups: Mapping[str, Sequence[Array]], labels: Sequence[str]
) -> None:
    """Draw box plots: a place per label, a box per group, outliers as crosses.

    Below each box stands how many values it has.

    Parameters
    ----------
    axes
        Where to; place i is at i.
    groups
        By name: one array of values per label; NaN are left out.
    labels
        Below the places.
    """
    width = 0.8 / len(groups)
    below: dict[str, Any] = {"xycoords": axes.get_xaxis_transform(), "va": "bottom"}
    below |= {"ha": "center", "fontsize": 5.5, "color": "0.3"}
    for k, (name, series) in enumerate(groups.items()):
        place = np.arange(len(series)) + width * (k - (len(groups) - 1) / 2)
        finite = [values[np.isfinite(values)] for values in series]
        face = {"facecolor": FACES[k], "hatch": HATCHES[k], "edgecolor": "black", "linewidth": 0.6}
        options = {"widths": 0.85 * width, "boxprops": {**face, "linestyle": "-"}, **BOXES}
        crosses = {"marker": "+", "markersize": 3, "markeredgewidth": 0.5}
        drawn = axes.boxplot(finite, positions=place, flierprops=crosses, **options)
        drawn["boxes"][0].set_label(name)
        for x, values in zip(place, finite, strict=True):
            axes.annotate(str(len(values)), (float(x), 0.01), **below)
    axes.set(xticks=range(len(labels)), xticklabels=labels, xlim=(-0.55, len(labels) - 0.45))


def draw_published(axes: Axes, bounds: pd.DataFrame, scale: float = 1.0) -> None:
    """Draw published bounds: ``at`` along the axis, ``low``, ``high`` (NaN: open).

    A number is a diamond, two bounds are a bar; what is open on one side is an arrow. The axis
    grows to hold them.
    """
    bottom, top = axes.get_ylim()
    low, high, at = bounds["low"] * scale, bounds["high"] * scale, bounds["at"]
    reach = 0.09 * (top - bottom)
    ends = low.fillna(high - reach), high.fillna(low + reach)
    axes.vlines(at, *ends, **{**PUBLISHED_BAR, "label": None})
    for mark, places, values in (
        ("D", low == high, low),
        ("^", high.isna(), ends[1]),
        ("v", low.isna(), ends[0]),
    ):
        axes.plot(at[places], values[places], **{**PUBLISHED, "marker": mark, "label": None})
    axes.plot([], [], **PUBLISHED)
    highest = pd.concat(ends).max()
    axes.set_ylim(bottom, top if not highest > top else highest + reach / 2)


def broken_at_gaps(tracks: pd.DataFrame) -> pd.DataFrame:
    """Return tracks with an empty place in every gap of frames, so that no line is drawn there.

    The columns are ``particle``, ``frame``, ``row`` and ``col``.
    """
    places = tracks[["particle", "frame", "row", "col"]].sort_values(["particle", "frame"])
    behind = places[places.groupby("particle")["frame"].diff() > 1]
    empty = behind.assign(frame=behind["frame"] - 1, row=np.nan, col=np.nan)
    return pd.concat([places, empty]).sort_values(["particle", "frame"], ignore_index=True)


def summed_changes(recording: Recording, frames: range) -> Array:
    """Return the sum (rows, cols) of absolute differences of neighbouring frames."""
    total = np.zeros((recording.attributes.rows, recording.attributes.columns))
    for before, now in pairwise(recording.gray(t).astype(np.float32) for t in frames):
        total += np.abs(now - before)
    return total


def draw_sums_and_tracks(
    fraction: str, sums: Mapping[CampaignKey, Array], tracks: Mapping[CampaignKey, pd.DataFrame]
) -> Figure:
    """Draw summed frame differences above the tracks in the same frames, by pressure."""
    keys = [key for key in sums if key[0] == fraction]
    picture, grid = canvas(2, max(len(keys), 2), width_mm=PAGE_MM, height_mm=125)
    for panels, key in zip(grid.T, keys, strict=False):
        total = sums[key]
        low, high = np.quantile(total, [0.05, 0.999])
        shown = np.clip((total - low) / max(float(high - low), 1.0), 0.0, 1.0)
        draw_frame(panels[0], shown, 8)
        for k, (_, track) in enumerate(tracks[key].groupby("particle")):
            look = {"color": COLOURS[k % len(COLOURS)], "ls": LINES[k % 3], "lw": 0.5}
            panels[1].plot(track["col"], track["row"], **look)
        rows, cols = total.shape
        panels[1].set(xlim=(0, cols), ylim=(rows, 0), aspect="equal", xlabel="column (px)")
        panels[0].set_title(f"{fraction}, {key[1]} bar: summed frame differences")
        panels[1].set_title(f"{tracks[key]['particle'].nunique()} trajectories from the lance")
    plt.setp(grid.T[len(keys) :].ravel(), visible=False)
    plt.setp(grid[:, 0], ylabel="row (px)")
    return picture


def case_of(flight: Mapping[Any, Any]) -> str | None:
    """Return which of `CASES` a row of `kilnflight.tables.FLIGHTS` is, or None.

    Landed burning and burnt out are shown where ignition was seen, so that it can be drawn.
    """
    if flight["ending"] == LANDED:
        return {SEEN: CASES[1], NONE: CASES[0]}.get(flight["ignition"])
    return CASES[2] if flight["ending"] == BURNT_OUT and flight["ignition"] == SEEN else None


def examples(flights: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Return of each of `CASES` the flight from the lance with the median dwell time.

    Parameters
    ----------
    flights
        Of all campaigns (`kilnflight.experiments.campaigns.Measurement`).

    Returns
    -------
    dict
        Rows of ``flights`` by case; of an even number the shorter of the two in the middle.
        A case that was not measured is missing.
    """
    cases: dict[str | None, list[Any]] = {case: [] for case in (*CASES, None)}
    from_lance = flights[flights["from_lance"]].sort_values("dwell_s", kind="stable")
    for flight in from_lance.to_dict("records"):
        cases[case_of(flight)].append(flight)
    return {case: cases[case][(len(cases[case]) - 1) // 2] for case in CASES if cases[case]}


def draw_dwell_time(axes: Axes, fit: Fit, flight: Mapping[str, Any], track: pd.DataFrame) -> None:
    """Draw a flight from the side, from the lance to its end, thick where it burns.

    Past its last detection it flies straight on, as `kilnflight.flight.Landing` has it.

    Parameters
    ----------
    axes
        Where to.
    fit
        Its trajectory.
    flight
        Its row of `kilnflight.tables.FLIGHTS`.
    track
        Its detections, for those with depth: ``x``, ``y``, ``z``.
    """
    places = track[["x", "y", "z"]].dropna().to_numpy(np.float64)
    axes.plot(*_from_the_lance(fit, places).T, ".", color="0.65", ms=2, label="detections")
    lit = flight["t0_s"] + flight["ignition_s"]  # NaN: never
    parts = [(flight["t0_s"], np.fmin(lit, flight["end_s"]), "unlit", "black", 1.0)]
    if lit < flight["end_s"]:
        parts.append((lit, flight["end_s"], "burning", COLOURS[3], 2.6))
    for start, end, name, colour, width in parts:
        way = _from_the_lance(fit, straight_on(fit, np.linspace(start, end, SAMPLES)))
        axes.plot(*way.T, color=colour, lw=width, ls="-", label=name)
    axes.plot(0, 0, **LANCE, label="lance")
    mark = "s" if flight["ending"] == LANDED else "o"
    last = _from_the_lance(fit, straight_on(fit, flight["end_s"]))
    axes.plot(*last.T, mark, ms=5, mfc="white", color="black", label=f"end: {flight['ending']}")
    axes.set(xlabel="depth from the lance (m)", ylabel="height over it (m)")
    label = f"dwell time {flight['dwell_s']:.2f} s"
    axes.text(0.97, 0.95, label, transform=axes.transAxes, ha="right", va="top")


def _from_the_lance(fit: Fit, places: Array) -> Array:
    """Return depth and height from the lance (n, 2) in m of camera coordinates in mm."""
    depth, _, up = upright(places - np.array(fit.exit_point_mm))
    return np.column_stack([-depth, up])


def draw_space_slices(axes: Axes, fit: Fit, passed: pd.DataFrame, end_s: float) -> None:
    """Draw when a flight passes each metre, and the velocity between two (Eq. 5.8).

    Parameters
    ----------
    axes
        Where to.
    fit
        Its trajectory.
    passed
        Its rows of `kilnflight.tables.SLICES`.
    end_s
        End of the flight on the recording's clock.

    Raises
    ------
    InputError
        If a slice is missing among those in front of the lance.
    """
    front = passed[passed["slice_m"] > 0].sort_values("slice_m")
    far = np.concatenate([[0.0], front["slice_m"].to_numpy(np.float64)])
    lengths = np.diff(far)
    if not len(lengths) or not np.allclose(lengths, lengths[0]):
        raise InputError("slices: not every slice up to the farthest; pass those of one flight.")
    time = np.concatenate([[0.0], np.cumsum(lengths / front["velocity_m_s"].to_numpy(np.float64))])
    times = np.linspace(fit.t0, end_s, SAMPLES)
    depth = _from_the_lance(fit, straight_on(fit, times))[:, 0]
    axes.plot(times - fit.t0, depth, color="black", lw=1.2, ls="-", label="trajectory")
    axes.plot(0, 0, **LANCE, label="lance", zorder=3)
    axes.plot(time[1:], far[1:], "o", ms=4, mfc="white", color="black", label="a metre is passed")
    _mark_slices(axes, time, far)
    axes.set(xlabel="time from the lance (s)", ylabel="depth from the lance (m)")
    axes.margins(x=0.2)


def _mark_slices(axes: Axes, time: Array, depth: Array) -> None:
    """Draw lines at each slice's end, and its velocity; arrays begin at the lance."""
    box = {"facecolor": "white", "edgecolor": "none", "pad": 1}
    look: dict[str, Any] = {"textcoords": "offset points", "va": "center", "bbox": box}
    axes.vlines(time[1:], 0, depth[1:], color="0.6", lw=0.6, ls=":")
    axes.hlines(depth[1:], 0, time[1:], color="0.6", lw=0.6, ls=":")
    velocity = np.diff(depth) / np.diff(time)
    for n, value in enumerate(velocity.tolist(), start=1):
        text = f"V{SUBSCRIPTS[n]} = {value:.1f} m/s"
        where = float(time[n]), float(depth[n - 1 : n + 1].mean())
        axes.annotate(text, where, xytext=(4, 0), **look)


def draw_from_the_side(
    axes: Axes, flights: Flights, values: Array, limits: npt.ArrayLike, most: int
) -> LineCollection:
    """Draw flights from the side, as dark as a value is low; return what is coloured.

    Parameters
    ----------
    axes
        Where to.
    flights
        Of one fraction.
    values
        (n,) one for each flight, or (n, samples).
    limits
        The two values that are darkest and brightest.
    most
        How many flights are drawn, the first ones.
    """
    paths = flights.position_m[:most, :, [0, 2]].astype(np.float64)
    every = np.broadcast_to(values[:most].reshape(len(paths), -1), paths.shape[:2])
    steps = np.stack([paths[:, :-1], paths[:, 1:]], axis=2)  # (n, samples - 1, 2, 2)
    finite = np.isfinite(steps).all(axis=(2, 3))
    lines = LineCollection(list(steps[finite]), cmap="viridis", linewidths=0.6, linestyles="-")
    lines.set_array(every[:, :-1][finite])
    lines.set_clim(*np.asarray(limits, dtype=np.float64))
    axes.add_collection(lines)
    axes.autoscale_view()
    axes.set(xlabel="from the lance (m)", ylabel="above the kiln's axis (m)")
    return lines


def draw_beside_published(axes: Axes, table: pd.DataFrame) -> None:
    """Draw values without and with a treatment in two readings, and the published ones below.

    Parameters
    ----------
    axes
        To draw on.
    table
        ``fraction``, ``tracker``, ``postprocessing`` ("without", "with"), ``recomputed`` with
        ``low`` and ``high``, ``all_tracks`` and ``published``.
    """
    wide = table.pivot(index=["fraction", "tracker"], columns="postprocessing").iloc[::-1]
    places = {"recomputed": ("black", "o", 0.25), "all_tracks": ("0.55", "s", 0.0)}
    places["published"] = (str(PUBLISHED["color"]), "", -0.25)
    names = {"recomputed": "from the lance", "all_tracks": "all tracks", "published": "published"}
    for source, (color, marker, shift) in places.items():
        look = PUBLISHED if source == "published" else {"marker": marker, "color": color, "ms": 3}
        looks = {
            stage: {**look, "mfc": face, "label": f"{names[source]}, {stage}"}
            for stage, face in (("without", "white"), ("with", color))
        }
        _joined(axes, wide[source], np.arange(len(wide)) + shift, looks, color)
    for stage, shift in (("without", 0.36), ("with", 0.14)):
        place = np.arange(len(wide)) + shift
        known = wide["recomputed"][stage].notna()
        ends = (wide[end][stage][known] for end in ("low", "high"))
        axes.hlines(place[known], *ends, color="black", lw=0.4)
    axes.set_yticks(range(len(wide)), [f"{name}, {tracker}" for name, tracker in wide.index])


def _joined(axes: Axes, wide: Any, place: npt.NDArray[Any], looks: Any, color: str) -> None:
    """Draw the columns "without" and "with", each in its look, joined by a line."""
    axes.hlines(place, wide["without"], wide["with"], color=color, lw=0.7, linestyle="-")
    for stage, look in looks.items():
        axes.plot(wide[stage], place, **{**look, "ls": ""})


def draw_before_after(axes: Axes, table: pd.DataFrame, along: str, stage: str, value: str) -> None:
    """Draw what each entry has "without" and "with" something, joined by a line.

    Parameters
    ----------
    axes
        Where to; the first entry of ``along`` is drawn at 0 of the vertical axis.
    table
        Long; one row per mark, NaN: no mark.
    along, stage, value
        Its columns; ``stage`` is "without" or "with".
    """
    wide = table.pivot(index=along, columns=stage, values=value).loc[table[along].unique()]
    looks = {
        "without": {"marker": "o", "mfc": "white", "color": COLOURS[2], "label": "without"},
        "with": {"marker": "s", "color": COLOURS[1], "label": "with"},
    }
    _joined(axes, wide, np.arange(len(wide)), looks, "0.6")
    axes.set(yticks=range(len(wide)), yticklabels=wide.index)


def draw_bars(axes: Axes, table: pd.DataFrame, along: str, kind: str, value: str) -> None:
    """Draw bars: groups by entry of ``along``, one per ``kind``, in colour and hatch.

    Parameters
    ----------
    axes
        Where to; group i is drawn at i.
    table
        Long; one row per bar.
    along, kind, value
        Its columns.
    """
    groups, kinds = list(table[along].unique()), list(table[kind].unique())
    width = 0.8 / len(kinds)
    wide = table.pivot(index=along, columns=kind, values=value).loc[groups]
    for k, name in enumerate(kinds):
        place = np.arange(len(groups)) + width * (k - (len(kinds) - 1) / 2)
        look: dict[str, Any] = {"label": str(name), "hatch": HATCHES[k % len(HATCHES)]}
        axes.bar(place, wide[name], 0.92 * width, color=COLOURS[(k + 1) % len(COLOURS)], **look)
    axes.set(xticks=range(len(groups)), xticklabels=groups, xlabel=along)


def draw_intervals(axes: Axes, table: pd.DataFrame, published_f1: str, f1_in_pixels: str) -> None:
    """Draw methods' F1 with intervals, beside another criterion and the publication.

    Parameters
    ----------
    axes
        Where to; the first row of the table is on top.
    table
        Index: names; columns ``f1``, ``f1_low``, ``f1_high``, and the next two.
    published_f1, f1_in_pixels
        Columns with the published F1 (NaN where none) and with F1 within a particle's pixels.
    """
    place, label = np.arange(len(table)), "scoring distance 45 px"
    reach = np.abs(table[["f1_low", "f1_high"]].to_numpy().T - table["f1"].to_numpy())
    axes.errorbar(table["f1"], place, xerr=reach, fmt="o", color="black", capsize=2, label=label)
    axes.plot(table[f1_in_pixels], place, "s", mfc="none", color=COLOURS[2], label="in pixels")
    axes.plot(table[published_f1], place, **PUBLISHED)
    axes.set(yticks=place, yticklabels=table.index, xlabel="F1")
    axes.invert_yaxis()
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)


def draw_class_recall(recall: pd.DataFrame, by: str, published: Sequence[float] = ()) -> Figure:
    """Draw the recall of each class by subset, a panel for each value of a column.

    No bar is drawn for fewer than ten particles: one of them would be a large part of its recall.

    Parameters
    ----------
    recall
        ``subset``, ``kind``, ``tp``, ``fn``, ``recall`` and the column.
    by
        The column.
    published
        Recall of non-burning particles by subset, drawn in the first panel.
    """
    few = recall["tp"] + recall["fn"] < 10
    groups = recall.assign(recall=recall["recall"].mask(few)).groupby(by, sort=False)
    picture, (panels,) = canvas(1, len(groups), width_mm=PAGE_MM, height_mm=62, sharey=True)
    for axes, (name, table) in zip(panels, groups, strict=True):
        draw_bars(axes, table, "subset", "kind", "recall")
        axes.set_title(str(name))
    if len(published):
        panels[0].plot(published, clip_on=False, **{**PUBLISHED, "label": "published, non-burning"})
    panels[0].set_ylabel("recall")
    picture.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return picture


def draw_keypoints_and_clusters(
    gray: npt.NDArray[np.uint16],
    keypoints: Array,
    clusters: Clusters | None,
    roi: Sequence[tuple[float, float]],
    **size: Any,
) -> Figure:
    """Draw a frame with keypoints (circles), clusters (dots) and region of interest."""
    picture, ((axes,),) = canvas(**size)
    draw_frame(axes, gray, 4 if clusters is not None else 2)
    if clusters is not None:
        spread = np.repeat(np.arange(len(clusters)) % 6 + 1, np.diff(clusters.start))
        axes.scatter(*clusters.pixels.T[::-1], s=0.1, c=[COLOURS[k] for k in spread])
    draw_circles(axes, keypoints, COLOURS[5])
    corners = np.array([*roi, roi[0]])
    axes.plot(corners[:, 1], corners[:, 0], "-", color=COLOURS[6])
    return picture
