"""On which frames, and by what, settings of trackers are chosen.

    campaign -> a stretch that is not reported -> tracker -> post-processing -> beta from the lance

The thesis prints the thresholds of the post-processing (Table 5.16) but neither gate nor noise nor
CIC_eps of its trackers. They are chosen by what is reported: the mean beta (Eq. 5.5) over the
fractions, after post-processing, of the tracks from the lance (section 5.2.2, Fig. 4.21). The
stretches share no frame with those reported. At full scale their detections are those of the
campaigns, of which no differences are stored. So the texture term of Eq. 4.24 is left out there.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from kilnflight import kiln
from kilnflight.checks import InputError
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.experiments import grid_search
from kilnflight.experiments.campaigns import Settings, settings_from_labels
from kilnflight.experiments.detection import BACKGROUNDS
from kilnflight.experiments.tracking import (
    MARGIN,
    SMOKE_FRACTIONS,
    Tracker,
    Window,
    flying_particles,
    lance_of,
    mean_measures,
    scored_frames,
)
from kilnflight.experiments.tracking_scores import ALL, MEASURES
from kilnflight.kiln import LONG_CHUNK, DetectionRun
from kilnflight.project import style
from kilnflight.project.cache import CachedTable
from kilnflight.project.parallel import Workers
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import WINDOWS, campaign_name, tracking_window
from kilnflight.twin.truth import true_trajectories

# Frames of each stretch, and trials of each tracker, by scale.
LENGTHS = {"quick": 12, "standard": 48, "full": 200}
TRIALS = {"quick": 10, "standard": 20, "full": 32}
# Joint probabilities of Stone Soup take 20 times as long as ours: tried on so many frames.
SLOW, SLOW_FRAMES = ("JPDA, Stone Soup",), 40


def tuning_frames(twin: Twin, scale: str) -> range:
    """Return the stretch of a campaign that settings are chosen on.

    In it fly as nearly as possible as many particles as from the first reported frame on in
    as many frames; it is `MARGIN` frames away from the window of Table 5.15.
    """
    length, scored = LENGTHS[scale], tracking_window(twin)
    before = range(0, scored.start - MARGIN - length + 1, 10)
    after = range(scored.stop + MARGIN, len(twin) - length + 1, 10)
    starts = [*before, *after]
    alike = flying_particles(twin, [scored_frames(twin, scale).start], length)
    start = starts[int(np.abs(flying_particles(twin, starts, length) - alike).argmin())]
    return range(start, start + length)


def tuning_windows(scale: str, settings: Settings, seed: int = 0, jobs: int = 1) -> list[Window]:
    """Return the stretches of all fractions at 4.5 bar, without frame differences.

    Parameters
    ----------
    scale
        "quick" (two fractions, few frames), "standard" or "full" (pieces of the campaigns).
    settings
        Threshold and wall, from the labelled frames.
    seed
        Of the scenes.
    jobs
        Processes of the detection.
    """
    parts = []
    for fraction in SMOKE_FRACTIONS if scale == "quick" else WINDOWS:
        name = campaign_name(fraction, 4.5)
        source = kiln.TwinSource(name, seed)
        twin = source.recording()
        frames, piece = tuning_frames(twin, scale), LONG_CHUNK if scale == "full" else 1
        start = frames.start // piece * piece
        stop = min(-(-frames.stop // piece) * piece, len(twin))
        detector, background = Combination(DoG(settings.threshold)), BACKGROUNDS[scale]
        run = DetectionRun(source, start, stop, detector, background, LONG_CHUNK, False)
        found = settings.in_air(kiln.detections(run, Workers(jobs)))
        inside = found["frame"].between(frames.start, frames.stop - 1)
        detections = found[inside].reset_index(drop=True)
        truth = true_trajectories(twin, frames)
        none: Any = None  # of the differences: what steps do without them is their affair
        parts.append(Window(fraction, name, frames, detections, truth, none, lance_of(twin)))
    return parts


@dataclass(frozen=True)
class Reported:
    """What a tracker is worth: its mean measures over stretches, as they are reported.

    After post-processing, of the tracks from the lance; of all tracks, where no true track of any
    stretch starts at the lance (a smoke run).
    """

    windows: Sequence[Window]

    def __call__(self, tracker: Tracker) -> dict[str, object]:
        """Return the measures, seconds of all, ``note``, and ``frames`` of each stretch.

        A tracker that refuses a stretch (an `InputError`) has no measures.
        """
        begin, note = perf_counter(), ""
        measures = dict.fromkeys(MEASURES, np.nan)
        try:
            measures = mean_measures(self.windows, tracker)
            if np.isnan(measures["beta"]):
                measures = mean_measures(self.windows, tracker, ALL)
        except InputError as error:
            note = f"not run: {error}"
        frames = len(self.windows[0].frames)
        return {**measures, "seconds": perf_counter() - begin, "note": note, "frames": frames}


def tried_settings(scale: str, names: Iterable[str], seed: int = 0, jobs: int = 1) -> pd.DataFrame:
    """Return what was tried for trackers by name, the same number for each; cached.

    Returns
    -------
    DataFrame
        `grid_search.search` of each, below each other: every setting with the mean measures
        over the stretches, the chosen one marked.

    Raises
    ------
    InputError
        If a tracker refuses every setting.
    """
    learned = settings_from_labels(scale, seed)
    tables = []
    for name in names:
        make = partial(_tried, scale, learned, seed, jobs, name)
        known = {"scale": scale, "settings": learned, "seed": seed, "tracker": name}
        tables.append(CachedTable("tried", make, known)())
    return pd.concat(tables, ignore_index=True)


def _tried(scale: str, learned: Settings, seed: int, jobs: int, name: str) -> pd.DataFrame:
    """Return what was tried for one tracker."""
    windows = tuning_windows(scale, learned, seed, jobs)
    if name in SLOW:
        windows = [grid_search.first_frames(window, SLOW_FRAMES) for window in windows]
    grid = grid_search.all_grids()[name]
    return grid_search.search(name, grid, Reported(windows), TRIALS[scale])


def chosen_trackers(tried: pd.DataFrame) -> dict[str, Tracker]:
    """Return each tracker in its chosen setting, of `tried_settings`."""
    return grid_search.chosen_trackers(tried, grid_search.all_grids())


def describe_chosen(tried: pd.DataFrame) -> str:
    """Describe the chosen settings, their beta, and which are at an end of the grid."""
    parts = []
    for row in tried[tried["chosen"]].to_dict("records"):
        end = f", at the end of {row['at_end']}" if row["at_end"] else ""
        open_ = f", {row['untried']} neighbours not tried" if row["untried"] else ""
        parts.append(f"{row['tracker']} {row['setting']} (beta {row['beta']:.3f}{end}{open_})")
    return "; ".join(parts)


def curves(tried: pd.DataFrame) -> pd.DataFrame:
    """Return the largest beta at each value of each parameter of each tracker.

    Returns
    -------
    DataFrame
        ``tracker``, ``parameter``, ``value``, ``beta`` (the largest of the settings with this
        value), ``settings`` (their number), ``chosen`` (whether it is the chosen one's value).
    """
    rows: list[Mapping[str, object]] = []
    for name, table in tried.groupby("tracker", sort=False):
        best = table[table["chosen"]].iloc[0]
        for parameter in grid_search.all_grids()[str(name)].parameters:
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


UNITS = {
    "gate": "gate (standard deviations)",
    "noise": "noise (px/frame^1.5)",
    "missed_frames": "missed frames in a row",
    "step": "largest step (px)",
    "gap": "largest step over a gap (px)",
    "predicted": "predicted (0: no, 1: yes)",
}
