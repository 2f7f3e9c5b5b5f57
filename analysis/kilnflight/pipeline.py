"""A whole recording from its detections to its flights, each step a table that is kept.

recording -> detections (`kilnflight.stages`) -> tracks -> trajectories -> flights and slices

Detection is done chunk by chunk, here or on a cluster; what follows takes seconds a recording
and is done here, one recording a process. The tracks are made without the texture term of
Eq. 4.24: its frame differences would take 2.8 MB a frame, 68 GB for eight campaigns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from kilnflight import flight, regression, stages
from kilnflight.association import GNN
from kilnflight.backdrop import behind
from kilnflight.detection.wall import Cylinder, InAir
from kilnflight.project import paths
from kilnflight.project.cache import kept, place
from kilnflight.project.parallel import Workers
from kilnflight.regression import Regression
from kilnflight.stages import Stretch
from kilnflight.tables import FLIGHTS, TRAJECTORIES
from kilnflight.tracking.tracker import track
from kilnflight.tracklets import postprocess, tracked

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Passage:
    """A recording and all that decides what becomes of its particles.

    Parameters
    ----------
    stretch
        Recording, frames, detector, and the folder in which all is kept.
    exit_point_mm
        Outlet of the lance after Eq. 2.4; None: there are no trajectories.
    wall
        The kiln; None: nothing is taken for lying on it, and there are no flights.
    in_air
        Who counts as in the air.
    tracker
        Makes one track of each particle's detections.
    regression
        How three polynomials are fitted to a track.
    rules
        What makes a flight of a track.
    """

    stretch: Stretch
    exit_point_mm: Vector | None = None
    wall: Cylinder | None = None
    in_air: InAir = field(default_factory=InAir)
    tracker: GNN = field(default_factory=GNN)
    regression: Regression = field(default_factory=Regression)
    rules: flight.Rules = field(default_factory=flight.Rules)

    @property
    def frame_rate_hz(self) -> float:
        """Frames per second."""
        return self.stretch.origin.recording().attributes.frame_rate_hz

    def step(self, name: str) -> Path:
        """Return where the table of a step is kept: "tracks", "trajectories" and so on."""
        return place(name, STEPS[name].went_in(self), self.stretch.folder)


def tracks(passage: Passage) -> pd.DataFrame:
    """Return the detections in the air with ``particle`` (-1: in no track), post-processed."""
    return _made("tracks", passage)


def trajectories(passage: Passage) -> pd.DataFrame:
    """Return the regression of every track (`kilnflight.tables.TRAJECTORIES`)."""
    return _made("trajectories", passage)


def flights(passage: Passage) -> pd.DataFrame:
    """Return dwell time and ignition (`kilnflight.tables.FLIGHTS`)."""
    return _made("flights", passage)


def slices(passage: Passage) -> pd.DataFrame:
    """Return the velocity in every metre from the lance of flights that start there.

    Returns
    -------
    DataFrame
        `kilnflight.tables.SLICES`.
    """
    return _made("slices", passage)


def run(passages: Sequence[Passage], workers: Workers | None = None) -> None:
    """Make all tables of all recordings that are not there, with progress.

    Parameters
    ----------
    passages
        Recordings; their tables are then read by `tracks`, `trajectories` and so on.
    workers
        One process if None. Those of a cluster detect; the rest is done by ``workers.jobs``
        processes here.
    """
    workers = workers if workers is not None else Workers()
    stages.detect([one.stretch for one in passages], workers)
    here = replace(workers, scheduler=None)
    for name in STEPS:
        ready = [one for one in passages if one.step(name).is_file()]
        todo = [_at_home(one) for one in passages if one not in ready]
        pieces = [(name, one) for one in todo]
        before = sum(_length(one) for one in ready)
        here(_make, pieces, [_length(one) for one in todo], name, before)


def _length(passage: Passage) -> int:
    return passage.stretch.stop - passage.stretch.start


def _at_home(passage: Passage) -> Passage:
    """Return the passage with its folder spelled out: processes may know it otherwise."""
    folder = (passage.stretch.folder or paths.derived()).absolute()
    return replace(passage, stretch=replace(passage.stretch, folder=folder))


def _make(piece: tuple[str, Passage]) -> None:
    _made(*piece)


class Step(NamedTuple):
    """How the table of a step is made, and from what."""

    make: Callable[[Passage], pd.DataFrame]
    went_in: Callable[[Passage], dict[str, object]]


def _made(name: str, passage: Passage) -> pd.DataFrame:
    step = STEPS[name]

    def make() -> pd.DataFrame:
        return step.make(passage)

    return kept(name, step.went_in(passage), make, passage.stretch.folder)


def _track(passage: Passage) -> pd.DataFrame:
    found = stages.detections(passage.stretch)
    if passage.wall is not None:
        on_wall = passage.in_air.on_wall(found[["x", "y", "z"]], passage.wall)
        found = found[~on_wall].reset_index(drop=True)
    return postprocess(track(found, passage.tracker))


def _regress(passage: Passage) -> pd.DataFrame:
    if passage.exit_point_mm is None:
        return TRAJECTORIES.empty()
    linked, rate = tracked(tracks(passage)), passage.frame_rate_hz
    return regression.regress_all(linked, passage.exit_point_mm, rate, passage.regression)


def _fly(passage: Passage) -> pd.DataFrame:
    return flown(passage, tracks(passage), regression.fits(trajectories(passage)))


def _slice(passage: Passage) -> pd.DataFrame:
    return sliced(flights(passage), regression.fits(trajectories(passage)))


def flown(
    passage: Passage, table: pd.DataFrame, fits: Mapping[int, regression.Fit]
) -> pd.DataFrame:
    """Return the flights of a table with ``particle`` and these fits; none without a wall."""
    if passage.wall is None:
        return FLIGHTS.empty()
    recording = passage.stretch.origin.recording()
    frames, linked = range(passage.stretch.start, passage.stretch.stop), tracked(table)
    if passage.rules.above_background:
        linked = linked.assign(background=behind(linked, recording, frames))
    return flight.flights(
        linked,
        fits,
        passage.wall,
        passage.in_air,
        passage.frame_rate_hz,
        passage.rules,
        flight.View(recording.attributes.roi, frames),
    )


def sliced(flights: pd.DataFrame, fits: Mapping[int, regression.Fit]) -> pd.DataFrame:
    """Return the velocity in every metre from the lance of the flights that start there."""
    counted = flights[flights["from_lance"]]
    ends = dict(zip(counted["particle"].tolist(), counted["end_s"].tolist(), strict=True))
    return flight.slices({particle: fits[particle] for particle in ends}, ends)


def _before(*names: str) -> Callable[[Passage], dict[str, object]]:
    """Return what tells the tables that a step is made from."""
    return lambda passage: {name: passage.step(name).name for name in names}


def _detected(passage: Passage) -> dict[str, object]:
    stretch = passage.stretch
    chunks = [stretch.table(frames).name for frames in stretch.chunks]
    fields = {"wall": passage.wall, "in_air": passage.in_air, "tracker": passage.tracker}
    return {"detections": chunks, **{name: repr(value) for name, value in fields.items()}}


def _fitted(passage: Passage) -> dict[str, object]:
    return _before("tracks", "trajectories")(passage) | {"rules": repr(passage.rules)}


def _tracked(passage: Passage) -> dict[str, object]:
    fields = {"exit_point_mm": passage.exit_point_mm, "regression": passage.regression}
    return _before("tracks")(passage) | {name: repr(value) for name, value in fields.items()}


STEPS: dict[str, Step] = {
    "tracks": Step(_track, _detected),
    "trajectories": Step(_regress, _tracked),
    "flights": Step(_fly, _fitted),
    "slices": Step(_slice, _before("trajectories", "flights")),
}
