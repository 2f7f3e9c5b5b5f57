"""Grid search for settings of trackers: same objective, same rule, same effort for all.

Every parameter has a grid of values, in steps of about the same ratio. A small part of the grid is
tried in full; then the neighbours of the best setting whose neighbours are not all tried yet, until
every tracker has had the same number of trials. The table says whether the best setting is at an
end of the grid, where a wider grid may hold a better one, and how many of its neighbours were not
tried. What is compared is `kilnflight.experiments.tuning`'s affair.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.association import GNN, JPDA, Associator
from kilnflight.checks import InputError
from kilnflight.experiments import other_trackers as peers
from kilnflight.experiments.tracking import Tracker, Window
from kilnflight.tracking.gate import Gate
from kilnflight.tracking.motion import ConstantVelocity
from kilnflight.tracking.tracker import Management, track

# The values, the same for all trackers. The ends, but for 0, are too small or too large for use.
GATES = (0.7, 1.0, 1.4, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)  # standard deviations
NOISES = (0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # px/frame^1.5
DISTANCES_PX = (2.5, 3.5, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0)
MISSED_FRAMES = (0, 1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 90)  # in a row
FILTERED = {"gate": GATES, "noise": NOISES, "missed_frames": MISSED_FRAMES}
# Eight settings for each tracker; of those with a filter the same ones.
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

        The ends of `NATURAL` are none.
        """
        names = [
            name
            for (name, values), value in zip(self.parameters.items(), setting, strict=True)
            if value in (values[0], values[-1]) and value not in NATURAL.get(name, ())
        ]
        return ", ".join(names)

    def text(self, setting: Setting) -> str:
        """Return the setting in words."""
        pairs = zip(self.parameters, setting, strict=True)
        return ", ".join(f"{name} {value:g}" for name, value in pairs)


def kilnflight_grids() -> dict[str, Grid]:
    """Return the grids of GNN and JPDA."""

    def build(associator: Associator, gate: float, noise: float, missed_frames: float) -> Tracker:
        return partial(
            track,
            associator=associator,
            motion=ConstantVelocity(acceleration_noise=noise),
            gate=Gate(gate),
            management=Management(invisible=int(missed_frames)),
        )

    associators: dict[str, Associator] = {"GNN": GNN(), "JPDA": JPDA()}
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
    """Return the grids of GNN and JPDA, ours, and of the peers that are installed."""
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
    Of settings of equal worth the first is chosen.
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
            if table["beta"].isna().all():
                raise InputError(f"search: {name} refuses every setting: {table['note'].iloc[0]}")
            ranks = np.argsort(-table["beta"].to_numpy(), kind="stable")  # NaN last
            ranked = [list(rows)[k] for k in ranks]
            around = ([n for n in grid.neighbors(best) if n not in rows] for best in ranked)
            ahead = next(filter(None, around), []) if len(rows) < trials else []
    chosen = np.arange(len(table)) == ranks[0]
    untried = sum(neighbor not in rows for neighbor in grid.neighbors(ranked[0]))
    return table.assign(
        chosen=chosen,
        at_end=np.where(chosen, grid.at_end(ranked[0]), ""),
        untried=np.where(chosen, untried, 0),
    )


def chosen_trackers(table: pd.DataFrame, grids: Mapping[str, Grid]) -> dict[str, Tracker]:
    """Return each tracker in the setting that `grid_search` chose."""
    trackers = {}
    for row in table[table["chosen"]].itertuples():
        grid = grids[str(row.tracker)]
        settings = product(*grid.parameters.values())
        chosen = next(setting for setting in settings if grid.text(setting) == row.setting)
        trackers[str(row.tracker)] = grid.build(*chosen)
    return trackers


def first_frames(window: Window, frames: int) -> Window:
    """Return a window's first frames, for trackers that are too slow for all of it."""
    part = window.frames[:frames]
    detections, truth = (
        table[table["frame"].isin(part)].reset_index(drop=True)
        for table in (window.detections, window.truth)
    )
    return window._replace(frames=part, detections=detections, truth=truth)
