"""Settings of trackers: on which frames, by what and how they are chosen.

    campaign -> a stretch that is not reported -> tracker -> post-processing -> beta from the lance

The thesis prints the thresholds of the post-processing (Table 5.16) but neither gate nor noise nor
CIC_eps of its trackers. They are chosen by what is reported: the mean beta (Eq. 5.5) over the
fractions, after post-processing, of the tracks from the lance (section 5.2.2, Fig. 4.21). The
stretches share no frame with those reported. At full scale their detections are those of the
campaigns, of which no differences are stored. So the texture term of Eq. 4.24 is left out there.

Every parameter has a grid of values, in steps of about the same ratio. A small part of the grid is
tried in full; then the neighbours of the best setting whose neighbours are not all tried yet, until
every tracker has had the same number of trials. The table says whether the best setting is at an
end of the grid, where a wider grid may hold a better one, and how many of its neighbours were not
tried.

"The 2D Mahalanobis distance gating of JPDA is selected to be smaller than GNN" (section 5.2.3). So
JPDA has the gates below GNN's chosen one; the widest of them is the text's end of the grid, not
ours. JPDA in its best setting with any gate stands beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight import kiln
from kilnflight.association import GNN, JPDA, Associator
from kilnflight.checks import InputError
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.experiments import other_trackers as peers
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
from kilnflight.project.cache import CachedTable
from kilnflight.project.parallel import Workers
from kilnflight.tracking.gate import Gate
from kilnflight.tracking.motion import ConstantVelocity
from kilnflight.tracking.tracker import Management, track
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import WINDOWS, campaign_name, tracking_window
from kilnflight.twin.truth import true_trajectories

# The values, the same for all trackers. The ends, but for 0, are too small or too large for use.
GATES = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)  # standard deviations
NOISES = (0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # px/frame^1.5
DISTANCES_PX = (2.5, 3.5, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0)
MISSED_FRAMES = (0, 1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 90)  # in a row
FILTERED = {"gate": GATES, "noise": NOISES, "missed_frames": MISSED_FRAMES}
# Eight settings for each tracker; of those with a filter the same ones.
ANY_GATE = "JPDA (any gate)"
FILTERED_START = {"gate": (2.0, 4.0), "noise": (0.5, 2.0), "missed_frames": (3, 8)}
# Ends that no grid can go beyond: no fewer frames than none; trackpy predicts or does not.
NATURAL = {"missed_frames": (0.0,), "predicted": (0.0, 1.0)}

Setting = tuple[float, ...]
Worth = Callable[[Tracker], Mapping[str, object]]  # beta, NaN if refused, and what else to keep


@dataclass(frozen=True)
class Grid:
    """A tracker, and the values of its parameters that may be tried.

    Raises
    ------
    InputError
        If the values of a parameter do not ascend, or do not include those of the start.
    """

    build: Callable[..., Tracker]  # of one value per parameter, in this order
    parameters: Mapping[str, Setting]  # parameter -> its values, ascending
    start: Mapping[str, Setting]  # parameter -> values that are tried in every combination
    natural: Mapping[str, Setting] = field(default_factory=lambda: NATURAL)  # ends that are none

    def __post_init__(self) -> None:
        """Refuse a grid without neighbours."""
        for name, values in self.parameters.items():
            first = self.start.get(name, ())
            if sorted(set(values)) != list(values) or not first or not set(first) <= set(values):
                raise InputError(
                    f"Grid: {name} has the values {values} and the start {first}. Give the "
                    "values in ascending order and take the start from them."
                )

    def neighbors(self, setting: Setting) -> list[Setting]:
        """Return the settings one step up or down in one parameter."""
        settings = []
        for k, values in enumerate(self.parameters.values()):
            place = values.index(setting[k])
            for value in (*values[max(place - 1, 0) : place], *values[place + 1 : place + 2]):
                settings.append((*setting[:k], value, *setting[k + 1 :]))
        return settings

    def at_end(self, setting: Setting) -> str:
        """Return the parameters that are at an end of their values, "" for none.

        Natural ends are none.
        """
        names = [
            name
            for (name, values), value in zip(self.parameters.items(), setting, strict=True)
            if value in (values[0], values[-1]) and value not in self.natural.get(name, ())
        ]
        return ", ".join(names)

    def below(self, gate: float) -> Grid:
        """Return the grid with the gates below a gate, tried from the two widest on (5.2.3)."""
        gates = tuple(value for value in self.parameters["gate"] if value < gate)
        if not gates:
            raise InputError(f"Grid: no gate is below {gate:g}; GATES needs smaller ones.")
        return replace(
            self,
            parameters={**self.parameters, "gate": gates},
            start={**self.start, "gate": gates[-2:]},
            natural={**self.natural, "gate": gates[-1:]},
        )

    def text(self, setting: Setting) -> str:
        """Return the setting in words."""
        pairs = zip(self.parameters, setting, strict=True)
        return ", ".join(f"{name} {value:g}" for name, value in pairs)


def kilnflight_grids() -> dict[str, Grid]:
    """Return the grids of GNN and JPDA; `_tried` narrows that of JPDA."""

    def build(associator: Associator, gate: float, noise: float, missed_frames: float) -> Tracker:
        return partial(
            track,
            associator=associator,
            motion=ConstantVelocity(acceleration_noise=noise),
            gate=Gate(gate),
            management=Management(invisible=int(missed_frames)),
        )

    associators: dict[str, Associator] = {"GNN": GNN(), "JPDA": JPDA(), ANY_GATE: JPDA()}
    return {
        name: Grid(partial(build, associator), FILTERED, FILTERED_START)
        for name, associator in associators.items()
    }


def peer_grids() -> dict[str, Grid]:
    """Return the grids of trackpy, laptrack and Stone Soup, installed together."""
    return {
        "trackpy": Grid(
            lambda step, missed, predicted: peers.Trackpy(step, int(missed), bool(predicted)),
            {"step": DISTANCES_PX, "missed_frames": MISSED_FRAMES, "predicted": (0, 1)},
            {"step": (15.0, 30.0), "missed_frames": (3, 8), "predicted": (0, 1)},
        ),
        "laptrack": Grid(
            lambda step, gap, missed_frames: peers.LapTrack(step, gap, int(missed_frames)),
            {"step": DISTANCES_PX, "gap": DISTANCES_PX, "missed_frames": MISSED_FRAMES},
            {"step": (15.0, 30.0), "gap": (15.0, 30.0), "missed_frames": (3, 8)},
        ),
        "GNN, Stone Soup": Grid(
            lambda gate, noise, missed_frames: peers.StoneSoupGNN(gate, noise, int(missed_frames)),
            FILTERED,
            FILTERED_START,
        ),
        "JPDA, Stone Soup": Grid(
            lambda gate, noise, missed_frames: peers.StoneSoupJPDA(gate, noise, int(missed_frames)),
            FILTERED,
            FILTERED_START,
        ),
    }


def all_grids() -> dict[str, Grid]:
    """Return the grids of our GNN and JPDA, and of the peers that are installed."""
    grids = {f"{name}, ours": grid for name, grid in kilnflight_grids().items()}
    package = dict.fromkeys(("GNN, Stone Soup", "JPDA, Stone Soup"), "stonesoup")
    installed = peers.available()
    theirs = peer_grids().items()
    return grids | {name: grid for name, grid in theirs if package.get(name, name) in installed}


def search(name: str, grid: Grid, worth: Worth, trials: int) -> pd.DataFrame:
    """Return what a tracker's settings are worth; the one of largest beta is chosen.

    Parameters
    ----------
    name
        Of the tracker.
    grid
        Its settings.
    worth
        What a tracker in some setting is worth; what refuses has a NaN for ``beta``.
    trials
        How many settings are tried; fewer only if the grid has no more.

    Returns
    -------
    DataFrame
        ``tracker``, ``setting`` in words, a column per parameter, what ``worth`` returns,
        ``chosen``, and of the chosen one ``at_end`` (its parameters at an end of their values, ""
        if it is interior) and ``untried`` (its neighbours that were not tried; 0 for all others).

    Raises
    ------
    InputError
        If every setting is refused.

    Notes
    -----
    Of settings of equal worth the first is chosen. While all are refused, the neighbours of the
    smallest one come next.
    """
    rows: dict[Setting, dict[str, object]] = {}
    ahead = list(product(*(grid.start[parameter] for parameter in grid.parameters)))
    with tqdm(desc=name, unit="setting", disable=None) as bar:
        while ahead:
            for setting in ahead[: trials - len(rows)]:
                parameters = dict(zip(grid.parameters, setting, strict=True))
                row = {"tracker": name, "setting": grid.text(setting), **parameters}
                rows[setting] = row | dict(worth(grid.build(*setting)))
                bar.update()
            table = pd.DataFrame(rows.values())
            settings, worst = list(rows), -table["beta"].to_numpy()
            if np.isnan(worst).all():  # a narrow gate or few missed frames are refused last
                ranks = np.array(sorted(range(len(settings)), key=settings.__getitem__))
            else:
                ranks = np.argsort(worst, kind="stable")  # NaN last
            ranked = [settings[k] for k in ranks]
            around = ([n for n in grid.neighbors(best) if n not in rows] for best in ranked)
            ahead = next(filter(None, around), []) if len(rows) < trials else []
    if table["beta"].isna().all():
        raise InputError(f"search: {name} refuses every setting: {table['note'].iloc[0]}")
    chosen = np.arange(len(table)) == ranks[0]
    untried = sum(neighbor not in rows for neighbor in grid.neighbors(ranked[0]))
    return table.assign(
        chosen=chosen,
        at_end=np.where(chosen, grid.at_end(ranked[0]), ""),
        untried=np.where(chosen, untried, 0),
    )


def first_frames(window: Window, frames: int) -> Window:
    """Return a window's first frames, for trackers that are too slow for all of it."""
    part = window.frames[:frames]
    detections, truth = (
        table[table["frame"].isin(part)].reset_index(drop=True)
        for table in (window.detections, window.truth)
    )
    return window._replace(frames=part, detections=detections, truth=truth)


# Frames of each stretch, and trials of each tracker, by scale.
OURS = ("GNN, ours", "JPDA, ours", f"{ANY_GATE}, ours")
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
        `search` of each, below each other: every setting with the mean measures
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
    """Return what was tried for one tracker; JPDA's gates are below GNN's."""
    grid = all_grids()[name]
    if name == "JPDA, ours":
        gnn = tried_settings(scale, ["GNN, ours"], seed, jobs)
        grid = grid.below(float(gnn.loc[gnn["chosen"], "gate"].iloc[0]))
    windows = tuning_windows(scale, learned, seed, jobs)
    if name in SLOW:
        windows = [first_frames(window, SLOW_FRAMES) for window in windows]
    return search(name, grid, Reported(windows), TRIALS[scale])


def our_trackers(tried: pd.DataFrame) -> dict[str, Tracker]:
    """Return ours in their chosen settings: "GNN", "JPDA" and `ANY_GATE`."""
    chosen = chosen_trackers(tried)
    return {name.removesuffix(", ours"): tracker for name, tracker in chosen.items()}


def chosen_trackers(
    tried: pd.DataFrame, grids: Mapping[str, Grid] | None = None
) -> dict[str, Tracker]:
    """Return each tracker in its chosen setting, of `tried_settings`."""
    return {
        row["tracker"]: grid.build(*(row[name] for name in grid.parameters))
        for row in tried[tried["chosen"]].to_dict("records")
        for grid in [(grids or all_grids())[row["tracker"]]]
    }


def describe_chosen(tried: pd.DataFrame) -> str:
    """Describe the chosen settings, their beta, and which are at an end of the grid."""
    parts = []
    for row in tried[tried["chosen"]].to_dict("records"):
        end = f", at the end of {row['at_end']}" if row["at_end"] else ""
        open_ = f", {row['untried']} neighbours not tried" if row["untried"] else ""
        parts.append(f"{row['tracker']} {row['setting']} (beta {row['beta']:.3f}{end}{open_})")
    return "; ".join(parts)
