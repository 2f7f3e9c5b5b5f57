"""All trackers on the same detections, in both readings, and who is ahead (notebook 33).

The thesis compares GNN and JPDA only; these are ranks of ours, by beta, with an interval of the
difference to the best of ours.
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


def ahead_of_ours(scores: pd.DataFrame, found: Iterable[Scored]) -> pd.DataFrame:
    """Return by how much each peer's mean beta is above that of our best tracker.

    Returns
    -------
    DataFrame
        ``reading``, ``postprocessing``, ``tracker``, ``beta`` (mean over the fractions), ``ours``
        (our best by that mean), ``beta_minus_ours`` and its 95 % interval's ends (-1 and 1 where a
        window has too few true trajectories to say). Only trackers that ran on every window with a
        true trajectory in the reading.
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
            rows.append(row | {"difference_low": float(low), "difference_high": float(high)})
    names = ["reading", "postprocessing", "tracker", "beta", "ours", "beta_minus_ours"]
    return pd.DataFrame(rows, columns=[*names, "difference_low", "difference_high"])


def describe(ranks: pd.DataFrame, scores: pd.DataFrame) -> str:
    """Describe the ranks of `ahead_of_ours`, best first, and which trackers did not run."""
    sentences = []
    for (reading, stage), part in ranks.groupby(["reading", "postprocessing"], sort=False):
        order = []
        for row in part.to_dict("records"):
            words = f"{row['tracker']} {row['beta']:.3f}"
            if row["tracker"] != row["ours"]:
                ends = f"{row['difference_low']:+.3f} to {row['difference_high']:+.3f}"
                words += f" ({row['beta_minus_ours']:+.3f}, {ends})"
            order.append(words)
        sentences.append(f"{reading}, {stage} post-processing: {', '.join(order)}.")
    left = scores.loc[scores["note"] != "", "tracker"].unique()
    sentences += [f"Not run on every window: {', '.join(left)}."] if len(left) else []
    return f"Mean beta (difference to our best, 95 %). {' '.join(sentences)}"


def draw(scores: pd.DataFrame) -> Figure:
    """Draw beta by tracker: readings (rows) by fraction (columns)."""
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
