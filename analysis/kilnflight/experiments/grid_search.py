"""Grid search for the settings of trackers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product
from time import perf_counter

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.association import GNN, JPDA, Associator
from kilnflight.checks import InputError
from kilnflight.experiments import other_trackers as peers
from kilnflight.experiments.tracking import MEASURES, Tracker, Window, measures, run
from kilnflight.tracking.gate import Gate
from kilnflight.tracking.motion import ConstantVelocity
from kilnflight.tracking.tracker import Management, track

# The ladders, for ours and for peers alike. Ends that are not nought are far from any use.
GATES = (0.7, 1.0, 1.4, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)  # standard deviations
NOISES = (0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # px/frame^1.5
STEPS = (2.5, 3.5, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0)  # px
PATIENCE = (0, 1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 90)  # frames; the stretches have 100

Setting = tuple[float, ...]


@dataclass(frozen=True)
class Grid:
    """A tracker, and the values of its parameters that may be tried.

    Raises
    ------
    InputError
        If a ladder is not ascending, or a value of the grid is not on it.
    """

    build: Callable[..., Tracker]  # of one value per parameter, in this order
    rungs: Mapping[str, Setting]  # parameter -> the values of its ladder, ascending
    grid: Mapping[str, Setting]  # parameter -> values that are tried in every combination

    def __post_init__(self) -> None:
        """Refuse ladders that cannot be climbed."""
        for name, ladder in self.rungs.items():
            first = self.grid.get(name, ())
            if sorted(set(ladder)) != list(ladder) or not first or not set(first) <= set(ladder):
                raise InputError(
                    f"Grid: {name} has the ladder {ladder} and the grid {first}. Give the "
                    "ladder in ascending order and take the grid from it."
                )

    def first(self) -> list[Setting]:
        """Return the settings of the grid."""
        return list(product(*(self.grid[name] for name in self.rungs)))

    def neighbors(self, setting: Setting) -> list[Setting]:
        """Return the settings one step up or down on one ladder."""
        found = []
        for k, ladder in enumerate(self.rungs.values()):
            at = ladder.index(setting[k])
            for value in (*ladder[max(at - 1, 0) : at], *ladder[at + 1 : at + 2]):
                found.append((*setting[:k], value, *setting[k + 1 :]))
        return found

    def ends(self, setting: Setting) -> str:
        """Return the parameters that are at an end of their ladders, "" for none.

        A ladder that the grid holds in full, yes or no, say, has nothing beyond its ends.
        """
        pairs = zip(self.rungs.items(), setting, strict=True)
        at_end = [name for (name, some), value in pairs if value in (some[0], some[-1])]
        return ", ".join(one for one in at_end if set(self.grid[one]) != set(self.rungs[one]))

    def text(self, setting: Setting) -> str:
        """Return the setting in words."""
        pairs = zip(self.rungs, setting, strict=True)
        return ", ".join(f"{name} {value:g}" for name, value in pairs)


def kilnflight_grids() -> dict[str, Grid]:
    """Return the ladders of GNN and JPDA."""
    rungs = {"gate": GATES, "noise": NOISES, "lost": PATIENCE}
    grid = {"gate": (2.0, 3.0, 4.0, 6.0), "noise": (0.5, 1.0, 2.0), "lost": (3, 5, 8, 12)}
    return {
        "GNN": Grid(_Ours(GNN()), rungs, grid),
        "JPDA": Grid(_Ours(JPDA()), rungs, grid),
    }


@dataclass(frozen=True)
class _Ours:
    """Our tracker with an associator, of gate, noise and patience."""

    associator: Associator

    def __call__(self, gate: float, noise: float, lost: float) -> Tracker:
        return partial(
            track,
            associator=self.associator,
            motion=ConstantVelocity(acceleration_noise=noise),
            gate=Gate(gate),
            management=Management(invisible=int(lost)),
        )


def peer_grids() -> dict[str, Grid]:
    """Return the ladders of trackpy, laptrack and Stone Soup; all are installed or not."""
    filtered = {"gate": GATES, "noise": NOISES, "unseen": PATIENCE}
    return {
        "trackpy": Grid(
            lambda step, unseen, predicted: peers.Trackpy(step, int(unseen), bool(predicted)),
            {"step": STEPS, "unseen": PATIENCE, "predicted": (0, 1)},
            {"step": (15.0, 20.0), "unseen": (2, 5), "predicted": (0, 1)},
        ),
        "laptrack": Grid(
            lambda step, gap, unseen: peers.LapTrack(step, gap, int(unseen)),
            {"step": STEPS, "gap": STEPS, "unseen": PATIENCE},
            {"step": (20.0, 40.0), "gap": (20.0, 40.0), "unseen": (2, 5)},
        ),
        "GNN, Stone Soup": Grid(
            lambda gate, noise, unseen: peers.StoneSoupGNN(gate, noise, int(unseen)),
            filtered,
            {"gate": (3.0, 4.0), "noise": (1.0,), "unseen": (3, 5)},
        ),
        "JPDA, Stone Soup": Grid(
            lambda gate, noise, unseen: peers.StoneSoupJPDA(gate, noise, int(unseen)),
            filtered,
            {"gate": (2.0, 3.0), "noise": (1.0,), "unseen": (1, 2)},
        ),
    }


def grid_search(windows: Iterable[Window], trackers: Mapping[str, Grid]) -> pd.DataFrame:
    """Return what each setting of each tracker gives; the best of each tracker is chosen.

    Parameters
    ----------
    windows
        Stretches that no result is taken from (`pursuit.windows`, ``others``).
    trackers
        Name of the tracker -> its ladders.

    Returns
    -------
    DataFrame
        ``tracker``, ``setting``, the four measures without post-processing, averaged over the
        windows, ``seconds`` in all, ``chosen``, ``at_end`` (of the chosen: its parameters at an
        end of their ladders, "" if it lies inside) and ``note``. A tracker that refuses a
        window (an `InputError`) has no measures for that setting, and the note says why.

    Raises
    ------
    InputError
        If there is no window, or every setting of a tracker refuses one.

    Notes
    -----
    Of settings of equal worth the first is chosen.
    """
    looked_at = list(windows)
    if not looked_at:
        raise InputError("best_setting: no windows to try settings on.")
    parts = [_climbed(looked_at, name, ladders) for name, ladders in trackers.items()]
    names = ["tracker", "setting", *MEASURES, "seconds", "chosen", "at_end", "note"]
    return pd.concat(parts, ignore_index=True)[names] if parts else pd.DataFrame(columns=names)


def first_frames(window: Window, frames: int) -> Window:
    """Return the first frames of a stretch, for trackers that are too slow for all of it."""
    part = window.frames[:frames]
    seen, true = (
        table[table["frame"].isin(part)].reset_index(drop=True)
        for table in (window.detections, window.truth)
    )
    return window._replace(frames=part, detections=seen, truth=true)


def _climbed(windows: list[Window], name: str, ladders: Grid) -> pd.DataFrame:
    """Try the grid, then the neighbours of the best until none is better."""
    tried: dict[Setting, dict[str, object]] = {}
    ahead = ladders.first()
    with tqdm(desc=name, unit="setting", disable=None) as bar:
        while ahead:
            for setting in ahead:
                row = {"tracker": name, "setting": ladders.text(setting)}
                tried[setting] = row | _tried(windows, ladders.build(*setting))
                bar.update()
            table = pd.DataFrame(tried.values())
            if table["beta"].isna().all():
                raise InputError(
                    f"best_setting: {name} refuses every setting: {table['note'].iloc[0]}"
                )
            best = int(table["beta"].argmax())
            setting = list(tried)[best]
            ahead = [one for one in ladders.neighbors(setting) if one not in tried]
    here = np.arange(len(table)) == best
    return table.assign(chosen=here, at_end=np.where(here, ladders.ends(setting), ""))


def chosen_trackers(tried: pd.DataFrame, trackers: Mapping[str, Grid]) -> dict[str, Tracker]:
    """Return each tracker in the setting that `grid_search` chose."""
    best = tried[tried["chosen"]]
    found = {}
    for name, text in zip(best["tracker"], best["setting"], strict=True):
        ladders = trackers[name]
        named = {ladders.text(one): one for one in product(*ladders.rungs.values())}
        found[name] = ladders.build(*named[text])
    return found


def score(windows: Iterable[Window], trackers: Mapping[str, Tracker]) -> pd.DataFrame:
    """Return `pursuit.run`, with a row without measures where a tracker refuses."""
    parts = []
    for window in windows:
        for name, tracker in trackers.items():
            try:
                parts.append(run([window], {name: tracker}).assign(note=""))
            except InputError as error:
                row = {"fraction": window.fraction, "tracker": name, "note": f"not run: {error}"}
                stages = pd.DataFrame([row, row]).assign(postprocessing=["without", "with"])
                parts.append(stages)
    return pd.concat(parts, ignore_index=True)


def _tried(windows: list[Window], tracker: Tracker) -> dict[str, object]:
    """Return the means over the windows, the seconds of tracking, and why there are none."""
    found, begin = [], perf_counter()
    try:
        tracks = [tracker(window.detections) for window in windows]
    except InputError as error:
        nothing = dict.fromkeys(MEASURES, np.nan)
        return {**nothing, "seconds": perf_counter() - begin, "note": f"not run: {error}"}
    seconds = perf_counter() - begin
    for window, table in zip(windows, tracks, strict=True):
        found.append(measures(window.truth, table))
    means = pd.DataFrame(found)[list(MEASURES)].mean()
    return {**{str(k): float(v) for k, v in means.items()}, "seconds": seconds, "note": ""}
