"""Settings of trackers: on which frames, by what and how they are chosen.

    campaign -> a stretch that is not reported -> tracker -> post-processing -> beta from the lance

The thesis prints the thresholds of the post-processing (Table 5.16) but neither gate nor noise nor
CIC_eps of its trackers. They are chosen by what is reported: the mean beta (Eq. 5.5) over the
fractions, after post-processing, of the tracks from the lance (section 5.2.2, Fig. 4.21). The
stretches share no frame with those reported.

One thing is not as reported: the texture term of Eq. 4.24 is left out of the choice. It needs the
frame differences. Those of the stretches are not stored, as they cost a detection of as many frames
again as are reported. It is left out for every tracker alike. What the term does to the measures is
asked in notebook 31 ("no texture").

Every parameter has a grid of values, in steps of about the same ratio. A small part of the grid is
tried in full; then the neighbours of the best setting whose neighbours are not all tried yet, until
every tracker has had the same number of trials. The table says whether the best setting is at an
end of the grid, and how many of its neighbours were not tried.

"The 2D Mahalanobis distance gating of JPDA is selected to be smaller than GNN" (section 5.2.3). So
JPDA has the gates below GNN's chosen one; the widest of them is the text's end of the grid, not
ours. JPDA in its best setting with any gate stands beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from kilnflight.association import GNN, JPDA, Associator
from kilnflight.checks import InputError
from kilnflight.experiments import other_trackers as peers
from kilnflight.experiments.campaigns import Settings, settings_from_labels
from kilnflight.experiments.tracking import (
    MARGIN,
    Tracker,
    Window,
    flying_particles,
    follow,
    scored_frames,
    windows,
)
from kilnflight.experiments.tracking_scores import (
    ALL,
    FROM_LANCE,
    MEASURES,
    measures_of,
    score_reading,
)
from kilnflight.kiln import LONG_CHUNK
from kilnflight.project.cache import CachedTable
from kilnflight.project.parallel import Workers
from kilnflight.tracking.gate import Gate
from kilnflight.tracking.motion import ConstantVelocity
from kilnflight.tracking.tracker import Management, track
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import tracking_window

# The values, the same for all trackers. The ends, but for 0, are too small or too large for use.
GATES = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)  # standard deviations
NOISES = (0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # px/frame^1.5
DISTANCES_PX = (2.5, 3.5, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0)
MISSED_FRAMES = (0, 1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 90)  # in a row
FILTERED = {"gate": GATES, "noise": NOISES, "missed_frames": MISSED_FRAMES}
# Eight settings for each tracker; of those with a filter the same ones.
FILTERED_START = {"gate": (2.0, 4.0), "noise": (0.5, 2.0), "missed_frames": (3, 8)}
# Ends that no grid can go beyond: no fewer frames than none; trackpy predicts or does not.
NATURAL = {"missed_frames": (0.0,), "predicted": (0.0, 1.0)}

ANY_GATE = "JPDA (any gate)"
OURS = ("GNN, ours", "JPDA, ours", f"{ANY_GATE}, ours")
Setting = tuple[float, ...]
Worth = Callable[[Tracker], Mapping[str, object]]  # beta, NaN if refused, and what else to keep


@dataclass(frozen=True)
class Grid:
    """A tracker, and the values of its parameters that may be tried."""

    build: Callable[..., Tracker]  # of one value per parameter, in this order
    parameters: Mapping[str, Setting]  # parameter -> its values, ascending
    start: Mapping[str, Setting]  # parameter -> values that are tried in every combination
    natural: Mapping[str, Setting] = field(default_factory=lambda: NATURAL)  # ends that are none

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


def all_grids() -> dict[str, Grid]:
    """Return the grids of `OURS`, JPDA's with any gate, and of the peers that are installed."""

    def ours(associator: Associator, gate: float, noise: float, missed_frames: float) -> Tracker:
        return partial(
            track,
            associator=associator,
            motion=ConstantVelocity(acceleration_noise=noise),
            gate=Gate(gate),
            management=Management(invisible=int(missed_frames)),
        )

    builders: dict[str, Callable[..., Tracker]] = {
        **{name: partial(ours, GNN() if name == OURS[0] else JPDA()) for name in OURS},
        "GNN, Stone Soup": lambda gate, noise, k: peers.StoneSoupGNN(gate, noise, int(k)),
        "JPDA, Stone Soup": lambda gate, noise, k: peers.StoneSoupJPDA(gate, noise, int(k)),
    }
    grids = {name: Grid(build, FILTERED, FILTERED_START) for name, build in builders.items()}
    grids["trackpy"] = Grid(
        lambda step, missed, predicted: peers.Trackpy(step, int(missed), bool(predicted)),
        {"step": DISTANCES_PX, "missed_frames": MISSED_FRAMES, "predicted": (0, 1)},
        {"step": (15.0, 30.0), "missed_frames": (3, 8), "predicted": (0, 1)},
    )
    grids["laptrack"] = Grid(
        lambda step, gap, missed: peers.LapTrack(step, gap, int(missed)),
        {"step": DISTANCES_PX, "gap": DISTANCES_PX, "missed_frames": MISSED_FRAMES},
        {"step": (15.0, 30.0), "gap": (15.0, 30.0), "missed_frames": (3, 8)},
    )
    packages = {"GNN, Stone Soup": "stonesoup", "JPDA, Stone Soup": "stonesoup"}
    installed = {*OURS, *peers.available()}
    return {name: grid for name, grid in grids.items() if packages.get(name, name) in installed}


def search(
    name: str, grid: Grid, worth: Worth, trials: int, run: Trials | None = None
) -> pd.DataFrame:
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
    run
        What runs the trials of ``worth``; one after the other, and none is kept, if None.

    Returns
    -------
    DataFrame
        ``tracker``, ``setting`` in words, a column per parameter, what ``worth`` returns,
        ``chosen``, and of the chosen one ``at_end`` (its parameters at an end of their values, ""
        if it is interior) and ``untried`` (its neighbours that were not tried; 0 for all others).

    Notes
    -----
    Of settings of equal worth the first is chosen. While all are refused, the neighbours of the
    smallest one come next. If all stay refused, none is chosen.
    """
    rows: dict[Setting, dict[str, object]] = {}
    ahead = list(product(*(grid.start[parameter] for parameter in grid.parameters)))
    while ahead:
        now = ahead[: trials - len(rows)]
        trackers = [grid.build(*setting) for setting in now]
        found = run(worth, trackers, now, name) if run else map(worth, trackers)
        for setting, measures in zip(now, found, strict=True):
            parameters = dict(zip(grid.parameters, setting, strict=True))
            row = {"tracker": name, "setting": grid.text(setting), **parameters}
            rows[setting] = row | dict(measures)
        table = pd.DataFrame(rows.values())
        settings, worst = list(rows), -table["beta"].to_numpy()
        if np.isnan(worst).all():  # a narrow gate or few missed frames are refused last
            ranks = np.array(sorted(range(len(settings)), key=settings.__getitem__))
        else:
            ranks = np.argsort(worst, kind="stable")  # NaN last
        ranked = [settings[k] for k in ranks]
        around = ([n for n in grid.neighbors(best) if n not in rows] for best in ranked)
        ahead = next(filter(None, around), []) if len(rows) < trials else []
    chosen = (np.arange(len(table)) == ranks[0]) & table["beta"].notna().to_numpy()
    untried = sum(neighbor not in rows for neighbor in grid.neighbors(ranked[0]))
    return table.assign(
        chosen=chosen,
        at_end=np.where(chosen, grid.at_end(ranked[0]), ""),
        untried=np.where(chosen, untried, 0),
    )


@dataclass(frozen=True)
class Trials:
    """Runs trials side by side and keeps each, so that a killed search goes on from there.

    Parameters
    ----------
    of
        Name of the file of the search's table: it holds the hash of all that a trial depends on.
    frames
        Of a trial, for the bar.
    workers
        Who runs them.
    """

    of: str
    frames: int
    workers: Workers

    def __call__(
        self, worth: Worth, trackers: Iterable[Tracker], settings: Sequence[Setting], label: str
    ) -> list[Mapping[str, object]]:
        """Return what trackers in these settings are worth, in their order."""
        tables = [
            CachedTable("trial", partial(_trial, worth, tracker), {"of": self.of, "setting": each})
            for tracker, each in zip(trackers, settings, strict=True)
        ]
        # wide gates and long gaps take longest: begun last, they would be waited for
        longest = sorted(range(len(tables)), key=settings.__getitem__, reverse=True)
        frames = [self.frames] * len(tables)
        self.workers(CachedTable.__call__, [tables[k] for k in longest], frames, label)
        rows: list[Any] = [table().to_dict("records")[0] for table in tables]
        return rows


def _trial(worth: Worth, tracker: Tracker) -> pd.DataFrame:
    """Return what a tracker is worth as a table of one row."""
    return pd.DataFrame([worth(tracker)])


def first_frames(window: Window, frames: int) -> Window:
    """Return a window's first frames, for trackers that are too slow for all of it."""
    part = window.frames[:frames]
    detections, truth = (
        table[table["frame"].isin(part)].reset_index(drop=True)
        for table in (window.detections, window.truth)
    )
    return window._replace(frames=part, detections=detections, truth=truth)


# Frames of each stretch, and trials of each tracker, by scale.
LENGTHS = {"quick": 12, "standard": 24, "full": 200}
TRIALS = {"quick": 4, "standard": 8, "full": 28}
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


@dataclass(frozen=True)
class Reported:
    """What a tracker is worth: its mean measures over stretches, as they are reported.

    After post-processing, of the tracks from the lance; of all tracks, where no true track of any
    stretch starts at the lance (a smoke run).
    """

    windows: Sequence[Window]

    def __call__(self, tracker: Tracker) -> dict[str, object]:
        """Return the measures, ``note``, and ``frames`` of each stretch.

        A tracker that refuses a stretch (an `InputError`) has no measures.
        """
        row: dict[str, object] = {**dict.fromkeys(MEASURES, np.nan), "note": ""}
        row["frames"] = len(self.windows[0].frames)
        try:
            tracks = [follow(window, tracker)["with"] for window in self.windows]
        except InputError as error:
            return row | {"note": f"not run: {error}"}
        for reading in (FROM_LANCE, ALL):
            pairs = zip(self.windows, tracks, strict=True)
            found = [score_reading(reading, one.truth, each, one.lance) for one, each in pairs]
            mean = pd.DataFrame(map(measures_of, found))[list(MEASURES)].mean()
            if mean.notna().all():
                break
        return row | {name: float(mean[name]) for name in MEASURES}


def tried_settings(scale: str, names: Iterable[str], seed: int = 0, jobs: int = 1) -> pd.DataFrame:
    """Return what was tried for trackers by name, the same number for each; cached.

    Returns
    -------
    DataFrame
        `search` of each, below each other: every setting with the mean measures
        over the stretches, the chosen one marked. A peer may refuse all; then none is.

    Raises
    ------
    InputError
        If a tracker of ours refuses every setting.
    """
    learned = settings_from_labels(scale, seed)
    tables = []
    for name in names:
        table = _table_of(scale, learned, seed, jobs, name)()
        if name in OURS and not table["chosen"].any():
            raise InputError(f"tried_settings: {_refused_all(name, table)}")
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def _table_of(scale: str, learned: Settings, seed: int, jobs: int, name: str) -> CachedTable:
    """Return the cached table of what was tried for one tracker."""
    known = {"scale": scale, "settings": learned, "seed": seed, "tracker": name}
    return CachedTable("tried", partial(_tried, scale, learned, seed, jobs, name), known)


def _refused_all(name: object, table: pd.DataFrame) -> str:
    """Return in words that a tracker refused all that was tried, and why the first."""
    why = str(table["note"].iloc[0]).removeprefix("not run: ") or "no track to score"
    return f"{name} refuses each of {len(table)} settings; the first: {why}"


def _tried(scale: str, learned: Settings, seed: int, jobs: int, name: str) -> pd.DataFrame:
    """Return what was tried for one tracker; JPDA's gates are below GNN's."""
    grid = all_grids()[name]
    if name == "JPDA, ours":
        gnn = tried_settings(scale, ["GNN, ours"], seed, jobs)
        grid = grid.below(float(gnn.loc[gnn["chosen"], "gate"].iloc[0]))
    piece = LONG_CHUNK if scale == "full" else 1
    stretches = windows(scale, learned, seed, jobs=jobs, frames=tuning_frames, piece=piece)
    if name in SLOW:
        stretches = [first_frames(window, SLOW_FRAMES) for window in stretches]
    of = _table_of(scale, learned, seed, jobs, name).path.name
    run = Trials(of, sum(len(window.frames) for window in stretches), Workers(jobs))
    return search(name, grid, Reported(stretches), TRIALS[scale], run)


def our_trackers(tried: pd.DataFrame) -> dict[str, Tracker]:
    """Return ours in their chosen settings: "GNN", "JPDA" and `ANY_GATE`."""
    chosen = chosen_trackers(tried)
    return {name.removesuffix(", ours"): tracker for name, tracker in chosen.items()}


def chosen_trackers(
    tried: pd.DataFrame, grids: Mapping[str, Grid] | None = None
) -> dict[str, Tracker]:
    """Return each tracker in its chosen setting, of `tried_settings`.

    One that refused all settings refuses whatever it is given, and says so.
    """
    trackers: dict[str, Tracker] = {}
    for name, table in tried.groupby("tracker", sort=False):
        best = table[table["chosen"]]
        if best.empty:
            trackers[str(name)] = partial(_refuse, _refused_all(name, table))
        else:
            grid = (grids or all_grids())[str(name)]
            trackers[str(name)] = grid.build(*(best[each].iloc[0] for each in grid.parameters))
    return trackers


def _refuse(why: str, detections: pd.DataFrame) -> pd.DataFrame:
    """Refuse to track; what has no setting that runs does so."""
    raise InputError(why)


def describe_chosen(tried: pd.DataFrame) -> str:
    """Describe the chosen settings, their beta, and which are at an end of the grid."""
    parts = []
    for row in tried[tried["chosen"]].to_dict("records"):
        end = f", at the end of {row['at_end'].replace('_', ' ')}" if row["at_end"] else ""
        open_ = f", {row['untried']} neighbours not tried" if row["untried"] else ""
        setting = row["setting"].replace("_", " ")
        parts.append(f"{row['tracker']} {setting} (beta {row['beta']:.3f}{end}{open_})")
    return ". ".join(parts)
