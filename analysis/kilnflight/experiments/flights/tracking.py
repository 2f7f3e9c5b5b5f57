"""Tracking experiment: trackers on campaign windows, scored as in section 5.2.2.

    window -> detections in the air -> tracker -> post-processing -> alpha, beta, JSC,
    JSC_theta

The trackers run on the windows of Table 5.15.
"""

from collections.abc import Callable, Iterable, Mapping
from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd
from pandas import DataFrame

from kilnflight import tracklets
from kilnflight.arrays import Tables, Whole
from kilnflight.detection.combination import Combination
from kilnflight.experiments.detection.labelled import BACKGROUNDS, sift
from kilnflight.experiments.flights.campaigns import LearnedSettings
from kilnflight.experiments.flights.differences import StoredDifferences
from kilnflight.experiments.flights.track_scores import (
    GATE_PX,
    STAGES,
    Key,
    Lance,
    Scored,
    from_lance,
    lasting,
    score_cell,
)
from kilnflight.scores.detections import pair
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.scene import Twin
from kilnflight.simulated.kiln.scenes import (
    TwinSource,
    campaign_name,
    flight_frames,
    scene_name,
    tracking_window,
)
from kilnflight.simulated.kiln.truth import at_notes, followed, kept_marks, noted
from kilnflight.store.parallel import Workers
from kilnflight.tracklets.paths import PathStep

# Frames of each scale; 0: as many as in Table 5.15
LENGTHS = {"quick": 12, "standard": 32, "full": 0}
SMOKE_FRACTIONS = ("wood chip", "paper shred")  # a smoke run has these alone
Stages = Tables  # "without" or "with" post-processing -> tracks
Tracked = Mapping[tuple[str, str], Stages]  # fraction and tracker -> their tracks
# Function of detections that returns them with ``particle``, -1: none
Tracker = Callable[[DataFrame], DataFrame]


class Window(NamedTuple):
    """Consecutive frames of a campaign on which tracking is scored (Table 5.15).

    Attributes
    ----------
    fraction
        Its name, such as "wood chip".
    frames
        Numbers of the frames.
    detections
        `kilnflight.tables.DETECTIONS` that are in the air or have no depth.
    truth
        True positions in the air that a person notes, see
        `kilnflight.simulated.kiln.truth.noted`.
    visible
        All visible true positions in the air, noted or not.
    differences
        Foregrounds for the texture of tracklets (Eq. 4.24).
    lance
        Its outlet.
    """

    fraction: str
    frames: range
    detections: DataFrame
    truth: DataFrame
    visible: DataFrame
    differences: StoredDifferences
    lance: Lance


def windows(
    scale: str,
    settings: LearnedSettings,
    seed: int = 0,
    *,
    jobs: int = 1,
    by_starts: bool = False,
    scenario: str = "base",
) -> list[Window]:
    """Return the windows of all fractions at 4.5 bar with their detections, cached.

    Parameters
    ----------
    scale
        "quick" (two fractions, few frames), "standard" or "full".
    settings
        Threshold, wall and limit of the air, from the labelled frames.
    seed
        Seed of the scenes.
    jobs
        Number of processes for the detection.
    by_starts
        Whether windows are chosen by the flights that start in them, see
        `tracking_window`.
    scenario
        One of `kilnflight.simulated.kiln.scenes.SCENARIOS`.
    """
    stored = []
    for fraction in SMOKE_FRACTIONS if scale == "quick" else FRACTIONS:
        name = scene_name(campaign_name(fraction, 4.5), scenario)
        source = TwinSource(name, seed)
        twin = source.recording()
        within = tracking_window(twin, by_starts)
        # A reduced scale has the part in which most particles fly.
        length = LENGTHS[scale] or len(within)
        starts = np.arange(within.start, within.stop - length + 1)
        begin, end = flight_frames(twin)
        flying = (begin < starts[:, None] + length) & (end > starts[:, None])
        start = int(starts[flying.sum(axis=1).argmax()])
        stored.append(
            StoredDifferences(
                source=source,
                frames=range(start, start + length),
                detector=Combination(sift(settings.threshold)),
                background=BACKGROUNDS[scale],
            )
        )
    lengths = [len(part.frames) for part in stored]
    Workers(jobs)(StoredDifferences.make, stored, lengths, "detection in windows")
    return [_window(part, settings) for part in stored]


def _window(stored: StoredDifferences, settings: LearnedSettings) -> Window:
    """Return the window whose detections and foregrounds are stored."""
    twin = stored.source.recording()
    marks = kept_marks(twin, stored.frames, noted)()
    row, col = twin.scene.geometry.lance_pixel
    outlet = twin.attributes.exit_point_mm
    assert outlet is not None  # every campaign of the twin has a lance
    return Window(
        fraction=twin.scene.fraction,
        frames=stored.frames,
        detections=settings.in_air(stored.table()),
        truth=followed(at_notes(marks)),
        visible=followed(marks),
        differences=stored,
        lance=Lance(row, col, outlet[2]),
    )


def processed(
    window: Window, tracks: DataFrame, steps: Iterable[PathStep] = tracklets.STEPS
) -> Stages:
    """Return a window's tracks "without" and "with" post-processing by ``steps``."""
    done = tracklets.postprocess(tracks, window.differences, steps)
    return {"without": tracks, "with": done}


def follow_all(windows: Iterable[Window], trackers: Mapping[str, Tracker]) -> Tracked:
    """Return the tracks of all windows and trackers, by fraction and tracker."""
    return {
        (window.fraction, name): processed(window, tracker(window.detections))
        for window, (name, tracker) in product(windows, trackers.items())
    }


def cells(windows: Iterable[Window], tracked: Tracked) -> dict[Key, Scored]:
    """Return the cells of Table 5.17 by fraction, tracker and stage.

    ``tracked`` has every tracker in every window. The seed of a cell starts with its
    fraction's number. So all cells of a window draw the same true trajectories, and
    their differences are paired.
    """
    fractions = list(FRACTIONS)
    trackers = list(dict.fromkeys(name for _, name in tracked))
    by_fraction = {window.fraction: window for window in windows}
    found = dict[Key, Scored]()
    for (fraction, name), stages in tracked.items():
        number = (1 + fractions.index(fraction), 1 + trackers.index(name))
        window = by_fraction[fraction]
        for stage, tracks in stages.items():
            seed = (*number, 1 + STAGES.index(stage))
            cell = score_cell(window.truth, tracks, window.lance, seed)
            found[fraction, name, stage] = cell
    return found


def true_particles(detections: DataFrame, true: DataFrame) -> Whole:
    """Return the true particle (n,) of each of n detections; -1: none.

    In each frame detections and true positions are paired within `GATE_PX` at the least
    sum of distances (Eq. 3.4). Both tables have ``frame``, ``row``, ``col``; ``true``
    has ``particle``.
    """
    owner = np.full(len(detections), -1, np.int64)
    spots = detections[["row", "col"]].to_numpy(float)
    places = true[["row", "col"]].to_numpy(float)
    particle = true["particle"].to_numpy()
    visible = true.groupby("frame").indices
    for frame, here in detections.groupby("frame").indices.items():
        if frame in visible:
            there = visible[frame]
            pairs = pair(places[there], spots[here], GATE_PX)
            owner[here[pairs[:, 1]]] = particle[there[pairs[:, 0]]]
    return owner


def count_window(window: Window) -> dict[str, object]:
    """Return the row of Table 5.15 of a window: its frames and what is in them."""
    scored = lasting(from_lance(window.truth, window.lance))
    owner = true_particles(window.detections, window.visible)
    return {
        "fraction": window.fraction,
        "first_frame": window.frames.start,
        "frames": len(window.frames),
        "trajectories": window.truth["particle"].nunique(),
        "trajectories_from_lance": scored["particle"].nunique(),
        "positions_visible": len(window.visible),
        "positions": len(window.truth),
        "detections": len(window.detections),
        "of_no_particle": (owner < 0).sum(),
    }


def without_gaps(truth: DataFrame) -> DataFrame:
    """Return true tracks with a position in every frame between their ends.

    Gaps are straight lines. The columns are ``particle``, ``frame``, ``row``, ``col``
    (px), ``x``, ``y`` and ``z`` (mm).
    """

    def filled(track: DataFrame) -> DataFrame:
        frames = range(track.index[0], track.index[-1] + 1)
        return track.reindex(frames).interpolate()

    places = truth.set_index("frame").groupby("particle")[["row", "col", "x", "y", "z"]]
    return places.apply(filled).rename_axis(["particle", "frame"]).reset_index()


def flying_paths(twin: Twin, frames: Iterable[int]) -> DataFrame:
    """Return where the particles in the air are in some frames, visible or not.

    The columns are ``particle``, ``frame``, ``row`` and ``col`` (px, in the picture).
    """
    place = twin.scene.geometry
    parts = []
    for t in frames:
        moment = twin.life.at(twin.time_s(t))
        row, col = place.project(place.to_camera(moment.position_m))
        inside = (row >= 0) & (row < place.rows) & (col >= 0) & (col < place.columns)
        part = {"particle": moment.particle, "frame": t, "row": row, "col": col}
        parts.append(DataFrame(part)[~moment.landed & inside])
    return pd.concat(parts)


def joined_tables(
    tables: Mapping[tuple[str, str], DataFrame], column: str
) -> DataFrame:
    """Return all tracks in one table, for the data behind a figure.

    ``tables`` has the tracks by fraction and another name, for ``column``. The columns
    are ``fraction``, ``column``, ``particle``, ``frame``, ``row`` and ``col``.
    Detections of no track are left out.
    """
    table = pd.concat(tables, names=["fraction", column]).reset_index([0, 1])
    table = tracklets.tracked(table)
    return table[["fraction", column, "particle", "frame", "row", "col"]]
