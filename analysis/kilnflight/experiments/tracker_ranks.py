"""All trackers on the same detections, in both readings, and who is ahead (notebook 33).

Beside it what was tried for their settings (`kilnflight.experiments.tuning`). The thesis compares
GNN and JPDA only; these are ranks of ours, by beta, with an interval of the difference to the best
of ours.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from kilnflight.checks import InputError
from kilnflight.experiments import plots
from kilnflight.experiments.tracking import Stages, Tracker, Window, cells, follow
from kilnflight.experiments.tracking_scores import (
    ALL,
    KEYS,
    MEAN,
    READINGS,
    STAGES,
    Scored,
    gains,
    tabulate,
)
from kilnflight.project import style

OURS = "ours"  # names of our trackers end so
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
    windows: Sequence[Window], trackers: Mapping[str, Tracker]
) -> tuple[pd.DataFrame, list[Scored]]:
    """Return the measures of all trackers in both readings, and the cells they come from.

    Returns
    -------
    table : DataFrame
        `tracking_scores.tabulate` with ``note``. A tracker that refuses a window (an `InputError`)
        has rows without measures, whose note says why.
    cells : list of Scored
        Of those that ran.
    """
    tracked: dict[tuple[str, str], Stages] = {}
    notes = {}
    for window, (name, tracker) in product(windows, trackers.items()):
        try:
            tracked[window.fraction, name] = follow(window, tracker)
        except InputError as error:
            notes[window.fraction, name] = f"not run: {error}"
    found = cells(windows, tracked)
    fractions = [window.fraction for window in windows]
    keys = pd.MultiIndex.from_product([fractions, trackers, STAGES, READINGS], names=KEYS)
    table = tabulate(found).set_index(KEYS).reindex(keys).reset_index()
    pairs = zip(table["fraction"], table["tracker"], strict=True)
    return table.assign(note=[notes.get(pair, "") for pair in pairs]), found


def filled(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table without the columns of text that nothing fills."""
    return table.loc[:, (table != "").any()]


def held_back(tried: pd.DataFrame) -> dict[str, str]:
    """Return the trackers that refused settings in their search, and how many of how many.

    One that is refused, by our limit of joint tracks or trackpy's own, may be the best.
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
        (our best by that mean), ``beta_minus_ours`` and its 95 % interval's ends (NaN where a
        window has too few true trajectories to say), ``held_back`` (why, or ""). Only trackers
        that ran on every window with a true trajectory in the reading.
    """
    parts = []
    for reading, stage in product(READINGS, STAGES):
        here = [cell for cell in found if cell.key[2:] == (stage, reading) and cell.score]
        if here:
            beta = tabulate(here).pivot(index="fraction", columns="tracker", values="beta")
            means = beta.dropna(axis=1).mean()  # of those that ran on every window
            ours = means[means.index.str.endswith(OURS)]
            if len(ours):
                first = str(ours.idxmax())
                ran = [cell for cell in here if cell.key[1] in means.index]
                part = gains(ran, first).assign(postprocessing=stage, ours=first)
                parts.append(part[part["fraction"] == MEAN].sort_values("beta", ascending=False))
    names = {"beta_gain": "beta_minus_ours"}
    names |= {f"beta_gain_{end}": f"difference_{end}" for end in ("low", "high")}
    columns = ["reading", "postprocessing", "tracker", "beta", "ours", *names.values()]
    if not parts:
        return pd.DataFrame(columns=[*columns, "held_back"])
    table = pd.concat(parts, ignore_index=True).rename(columns=names)[columns]
    return table.assign(held_back=[limits.get(name, "") for name in table["tracker"]])


def describe(ranks: pd.DataFrame, scores: pd.DataFrame) -> str:
    """Describe the ranks of `ahead_of_ours` after post-processing, best first.

    It says which trackers did not run, too.
    """
    words = []
    for reading, part in ranks[ranks["postprocessing"] == "with"].groupby("reading", sort=False):
        order = [
            f"{row['tracker']} {'at least ' if row['held_back'] else ''}{row['beta']:.2f}"
            for row in part.to_dict("records")
        ]
        title = "All tracks" if reading == ALL else str(reading).capitalize()
        words.append(f" {title}: {'; '.join(order)}.")
    left = scores.loc[scores["note"] != "", "tracker"].unique()
    missing = f" Not run on every window: {', '.join(left)}." if len(left) else ""
    return f"Mean beta after post-processing, best first.{''.join(words)}{missing}"


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


def draw_curves(tried: pd.DataFrame) -> Figure:
    """Draw beta against each parameter: all settings, the largest, the chosen one."""
    names = list(tried["tracker"].unique())
    size = {"width_mm": style.PAGE_MM, "height_mm": 12 + 34 * len(names)}
    picture, grid = style.canvas(len(names), 3, **size, sharey="row")
    hollow = {"color": "black", "mfc": "white", "label": "chosen"}
    for row, name in zip(grid, names, strict=True):
        table = tried[tried["tracker"] == name]
        parameters = [column for column in UNITS if column in table.dropna(axis=1, how="all")]
        for axes, parameter in zip(row, parameters, strict=True):
            largest, best = table.groupby(parameter)["beta"].max(), table[table["chosen"]]
            axes.plot(table[parameter], table["beta"], ".", color="0.7", label="tried")
            axes.plot(largest, "-", color="black", lw=0.8, label="largest")
            axes.plot(best[parameter], best["beta"], "o", **hollow)
            if parameter != "predicted":  # steps of about the same ratio, from 0 on
                axes.set_xscale("symlog", linthresh=0.05)
            axes.set_xticks(largest.index, [f"{value:g}" for value in largest.index])
            axes.minorticks_off()
            axes.set(xlabel=UNITS[parameter], title=name)
        row[0].set_ylabel("beta")
    handles = grid[0, 0].get_legend_handles_labels()
    picture.legend(*handles, loc="outside upper center", ncols=3)
    return picture
