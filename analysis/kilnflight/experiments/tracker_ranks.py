"""All trackers on the same detections, in both readings, and who is ahead (notebook 33).

Beside it what was tried for their settings (`kilnflight.experiments.tuning`). The thesis compares
GNN and JPDA only; these are ranks of ours, by beta, with an interval of the difference to the best
of ours.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import product

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from kilnflight.checks import InputError
from kilnflight.experiments import plots
from kilnflight.experiments.tracking import STAGES, Tracker, Window, cells
from kilnflight.experiments.tracking_scores import (
    MEASURES,
    READINGS,
    Scored,
    mean_difference,
    row_of,
)
from kilnflight.project import style

OURS = "ours"  # names of our trackers end so
COLUMNS = ["fraction", "tracker", "postprocessing", "reading", *MEASURES]
COLUMNS += [f"{name}_{end}" for name in MEASURES for end in ("low", "high")]
COLUMNS += ["seconds", "note"]
# Parameters of trackers, as axes name them.
UNITS = {
    "gate": "gate (standard deviations)",
    "noise": "noise (px/frame^1.5)",
    "missed_frames": "missed frames in a row",
    "step": "largest step (px)",
    "gap": "largest step over a gap (px)",
    "predicted": "predicted (0: no, 1: yes)",
}


def score(
    windows: Iterable[Window], trackers: Mapping[str, Tracker]
) -> tuple[pd.DataFrame, list[Scored]]:
    """Return the measures of all trackers in both readings, and the cells they come from.

    Returns
    -------
    table : DataFrame
        That of `tracking.run`, with ``note``. A tracker that refuses a window (an `InputError`)
        has rows without measures, whose note says why.
    cells : list of Scored
        Of those that ran.
    """
    rows: list[dict[str, object]] = []
    found: list[Scored] = []
    for window, (number, (name, tracker)) in product(windows, enumerate(trackers.items(), 1)):
        try:
            part = list(cells([window], {name: tracker}, first=number))
        except InputError as error:
            for stage, reading in product(STAGES, READINGS):
                row = {"fraction": window.fraction, "tracker": name, "postprocessing": stage}
                rows.append({**row, "reading": reading, "note": f"not run: {error}"})
            continue
        found += [cell for cell, _ in part]
        rows += [{**row_of(cell), "seconds": seconds, "note": ""} for cell, seconds in part]
    return pd.DataFrame(rows).reindex(columns=COLUMNS), found


def held_back(tried: pd.DataFrame) -> dict[str, str]:
    """Return the trackers that refused settings in their search, and how many of how many.

    A setting that is refused for our limit of joint tracks may be the best one.
    """
    words = {}
    for name, table in tried.groupby("tracker"):
        refused, frames = int(table["beta"].isna().sum()), table["frames"].iloc[0]
        if refused:
            words[str(name)] = f"{refused} of {len(table)} settings refused, on {frames} frames"
    return words


def ahead_of_ours(
    scores: pd.DataFrame, found: Iterable[Scored], limits: Mapping[str, str]
) -> pd.DataFrame:
    """Return by how much each peer's mean beta is above that of our best tracker.

    Parameters
    ----------
    scores, found
        Of `score`.
    limits
        Of `held_back`: the beta of these is no less than what is found here.

    Returns
    -------
    DataFrame
        ``reading``, ``postprocessing``, ``tracker``, ``beta`` (mean over the fractions), ``ours``
        (our best by that mean), ``beta_minus_ours`` and its 95 % interval's ends (-1 and 1 where a
        window has too few true trajectories to say), ``held_back`` (why, or ""). Only trackers
        that ran on every window with a true trajectory in the reading.
    """
    by_key = {cell.key: cell for cell in found if cell.score is not None}
    rows: list[dict[str, object]] = []
    for reading, stage in product(READINGS, STAGES):
        here = scores[(scores["reading"] == reading) & (scores["postprocessing"] == stage)]
        known = dict.fromkeys(key[0] for key in by_key if key[3] == reading)
        groups = here[here["fraction"].isin(known)].groupby("tracker", sort=False)["beta"]
        means = groups.mean()[groups.count() == len(known)].sort_values(ascending=False)
        ours = [name for name in means.index if str(name).endswith(OURS)]
        for name, mean in means.items() if ours and known else ():
            pairs = [
                tuple(by_key[fraction, who, stage, reading] for who in (str(name), ours[0]))
                for fraction in known
            ]
            apart = mean_difference([(one, other) for one, other in pairs], ["beta"])
            row = {"reading": reading, "postprocessing": stage, "tracker": name, "beta": mean}
            row |= {"ours": ours[0], "beta_minus_ours": apart.estimate}
            low, high = np.clip([apart.low, apart.high], -1.0, 1.0)
            row |= {"difference_low": float(low), "difference_high": float(high)}
            rows.append(row | {"held_back": limits.get(str(name), "")})
    names = ["reading", "postprocessing", "tracker", "beta", "ours", "beta_minus_ours"]
    return pd.DataFrame(rows, columns=[*names, "difference_low", "difference_high", "held_back"])


def describe(ranks: pd.DataFrame, scores: pd.DataFrame) -> str:
    """Describe the ranks of `ahead_of_ours`, best first, and which trackers did not run."""
    sentences = []
    for (reading, stage), part in ranks.groupby(["reading", "postprocessing"], sort=False):
        order = []
        for row in part.to_dict("records"):
            least = "at least " if row["held_back"] else ""
            words = f"{row['tracker']} {least}{row['beta']:.3f}"
            if row["tracker"] != row["ours"]:
                ends = f"{row['difference_low']:+.3f} to {row['difference_high']:+.3f}"
                words += f" ({row['beta_minus_ours']:+.3f}, {ends})"
            order.append(words)
        sentences.append(f"{reading}, {stage} post-processing: {', '.join(order)}.")
    left = scores.loc[scores["note"] != "", "tracker"].unique()
    sentences += [f"Not run on every window: {', '.join(left)}."] if len(left) else []
    return f"Mean beta (difference to our best, 95 %). {' '.join(sentences)}"


def draw(scores: pd.DataFrame, limits: Mapping[str, str]) -> Figure:
    """Draw beta by tracker: readings (rows) by fraction (columns); what is held back has a star."""
    starred = {name: f"{name} *" for name in limits}
    scores = scores.assign(tracker=scores["tracker"].replace(starred))
    fractions = list(scores["fraction"].unique())
    picture, grid = style.canvas(
        2, len(fractions), width_mm=style.PAGE_MM, height_mm=110, sharex=True, sharey=True
    )
    for axes_row, reading in zip(grid, READINGS[::-1], strict=True):
        for axes, fraction in zip(axes_row, fractions, strict=True):
            here = (scores["fraction"] == fraction) & (scores["reading"] == reading)
            part = scores[here]
            plots.draw_before_after(axes, part, "tracker", "postprocessing", "beta")
            for stage, group in part.groupby("postprocessing"):
                shift = 0.25 if stage == "with" else -0.25
                place = np.arange(len(group)) + shift
                known = group["beta"].notna()
                ends = (group.loc[known, f"beta_{end}"] for end in ("low", "high"))
                axes.hlines(place[known], *ends, color="black", lw=0.5)
            axes.set(xlabel="beta", xlim=(-0.02, 1.02))
            axes.set_title(f"{fraction},\n{reading}")
    grid[0, 0].invert_yaxis()
    handles = grid[0, 0].get_legend_handles_labels()
    picture.legend(*handles, loc="outside lower center", ncols=2, title="post-processing")
    return picture


def curves(tried: pd.DataFrame) -> pd.DataFrame:
    """Return the largest beta at each value of each parameter of each tracker.

    Returns
    -------
    DataFrame
        ``tracker``, ``parameter``, ``value``, ``beta`` (the largest of the settings with this
        value), ``settings`` (their number), ``chosen`` (whether it is the chosen one's value).
    """
    rows: list[Mapping[str, object]] = []
    empty = pd.Series(dtype=np.float64)
    for name, table in tried.groupby("tracker", sort=False):
        best = table[table["chosen"]].iloc[0]
        for parameter in (column for column in UNITS if table.get(column, empty).notna().any()):
            for value, part in table.groupby(parameter):
                row = {"tracker": name, "parameter": parameter, "value": value}
                row |= {"beta": part["beta"].max(), "settings": len(part)}
                rows.append(row | {"chosen": value == best[parameter]})
    return pd.DataFrame(rows)


def draw_curves(tried: pd.DataFrame) -> Figure:
    """Draw beta against each parameter: all settings, the largest, the chosen one."""
    largest = curves(tried)
    names = list(tried["tracker"].unique())
    picture, grid = style.canvas(
        len(names), 3, width_mm=style.PAGE_MM, height_mm=12 + 34 * len(names), sharey="row"
    )
    for axes_row, name in zip(grid, names, strict=True):
        table, line = (part[part["tracker"] == name] for part in (tried, largest))
        for axes, (parameter, part) in zip(
            axes_row, line.groupby("parameter", sort=False), strict=True
        ):
            axes.plot(table[parameter], table["beta"], ".", color="0.7", label="tried")
            axes.plot(part["value"], part["beta"], "-", color="black", lw=0.8, label="largest")
            best = table[table["chosen"]]
            hollow = {"color": "black", "mfc": "white", "label": "chosen"}
            axes.plot(best[parameter], best["beta"], "o", **hollow)
            if parameter != "predicted":  # steps of about the same ratio, from 0 on
                axes.set_xscale("symlog", linthresh=0.05)
            axes.set_xticks(part["value"], [f"{value:g}" for value in part["value"]], minor=False)
            axes.minorticks_off()
            axes.set(xlabel=UNITS[parameter], title=name)
        axes_row[0].set_ylabel("beta")
    handles = grid[0, 0].get_legend_handles_labels()
    picture.legend(*handles, loc="outside upper center", ncols=3)
    return picture
