"""Tracking experiment: trackers on campaign windows, scored as in section 5.2.2.

    window -> detections in the air -> tracker -> post-processing -> alpha, beta, JSC,
    JSC_theta

The trackers run on the windows of Table 5.15.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight import tracklets
from kilnflight.checks import InputError
from kilnflight.detection.combination import Combination
from kilnflight.experiments.detection.labelled import BACKGROUNDS, sift
from kilnflight.experiments.flights.campaigns import LearnedSettings
from kilnflight.experiments.flights.differences import StoredDifferences
from kilnflight.experiments.flights.sources import TwinSource
from kilnflight.experiments.flights.track_scores import (
    GATE_PX,
    STAGES,
    Key,
    Lance,
    Scored,
    score_cell,
)
from kilnflight.scores.detections import pair
from kilnflight.simulated.kiln.scene import Twin
from kilnflight.simulated.kiln.scenes import (
    WINDOWS,
    campaign_name,
    scene_name,
    tracking_window,
)
from kilnflight.simulated.kiln.truth import at_notes, followed, kept_marks, noted
from kilnflight.store.parallel import Workers
from kilnflight.tracklets.paths import PathStep

LENGTHS = {"quick": 12, "standard": 32, "full": 0}  # 0: as long as Table 5.15's
FRACTION_NUMBERS = {name: k for k, name in enumerate(WINDOWS, 1)}  # seeds of intervals
SMOKE_FRACTIONS = ("wood chip", "paper shred")  # of a smoke run
Tables = Mapping[str, Mapping[str, pd.DataFrame]]  # fraction -> name -> tracks
Stages = Mapping[str, pd.DataFrame]  # "without" or "with" post-processing -> tracks
Tracked = Mapping[tuple[str, str], Stages]  # fraction and tracker -> their tracks
Tracker = Callable[
    [pd.DataFrame], pd.DataFrame
]  # detections -> the same with particle, -1: none


class Window(NamedTuple):
    """Consecutive frames of a campaign on which tracking is scored (Table 5.15)."""

    fraction: str
    frames: range
    detections: (
        pd.DataFrame
    )  # `kilnflight.tables.DETECTIONS` in the air, or without depth
    truth: (
        pd.DataFrame
    )  # noted positions in the air (`kilnflight.simulated.kiln.truth.noted`)
    visible: pd.DataFrame  # the same with all visible positions, noted or not
    differences: (
        StoredDifferences  # foregrounds for the texture of tracklets (Eq. 4.24)
    )
    lance: Lance  # its outlet


def flying_particles(
    twin: Twin, starts: Iterable[int], length: int
) -> npt.NDArray[np.intp]:
    """Return how many particles fly in ``length`` frames from each start."""
    first = np.asarray(list(starts), dtype=np.intp)[:, None]
    table = twin.life.table
    rate = twin.scene.frame_rate_hz
    released = table["release_s"].to_numpy() * rate
    ended = released + table["end_s"].to_numpy() * rate
    return np.asarray(
        ((released < first + length) & (ended > first)).sum(axis=1), dtype=np.intp
    )


def scored_frames(twin: Twin, scale: str, by_starts: bool = False) -> range:
    """Return the frames of Table 5.15, or the part with most particles.

    A reduced ``scale`` takes `LENGTHS` frames. ``by_starts``: see `tracking_window`.
    """
    within = tracking_window(twin, by_starts)
    length = LENGTHS[scale] or len(within)
    starts = range(within.start, within.stop - length + 1)
    start = starts[int(flying_particles(twin, starts, length).argmax())]
    return range(start, start + length)


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
    detector = Combination(sift(settings.threshold))
    background = BACKGROUNDS[scale]
    stored = {}
    for fraction in SMOKE_FRACTIONS if scale == "quick" else WINDOWS:
        source = TwinSource(scene_name(campaign_name(fraction, 4.5), scenario), seed)
        frames = scored_frames(source.recording(), scale, by_starts)
        stored[fraction] = StoredDifferences(source, frames, detector, background)
    lengths = [len(each.frames) for each in stored.values()]
    Workers(jobs)(
        StoredDifferences.make, list(stored.values()), lengths, "detection in windows"
    )
    parts = []
    for fraction, each in stored.items():
        twin = each.source.recording()
        frames = each.frames
        marks = kept_marks(twin, frames, noted)()
        parts.append(
            Window(
                fraction,
                frames,
                detections=settings.in_air(each.table()),
                truth=followed(at_notes(marks)),
                visible=followed(marks),
                differences=each,
                lance=lance_of(twin),
            )
        )
    return parts


def lance_of(twin: Twin) -> Lance:
    """Return the lance's outlet: row and col in px, depth in mm."""
    attributes = twin.attributes
    if attributes.exit_point_mm is None:
        raise InputError(f"{attributes.name}: the lance's outlet is not known.")
    row, col = twin.scene.geometry.lance_pixel
    return Lance(float(row), float(col), float(attributes.exit_point_mm[2]))


def track_window(window: Window, tracker: Tracker) -> Stages:
    """Return a window's tracks "without" and "with" post-processing (`STAGES`)."""
    return processed(window, tracker(window.detections))


def processed(
    window: Window, tracks: pd.DataFrame, steps: Iterable[PathStep] = tracklets.STEPS
) -> Stages:
    """Return raw ``tracks`` of a window "without" and "with" post-processing by
    ``steps``.
    """
    done = tracklets.postprocess(tracks, window.differences, steps)
    return dict(zip(STAGES, (tracks, done), strict=True))


def follow_all(windows: Iterable[Window], trackers: Mapping[str, Tracker]) -> Tracked:
    """Return the tracks of all windows and trackers, by fraction and tracker."""
    each = product(windows, trackers.items())
    return {
        (window.fraction, name): track_window(window, tracker)
        for window, (name, tracker) in each
    }


def cells(windows: Iterable[Window], tracked: Tracked) -> dict[Key, Scored]:
    """Return the cells of Table 5.17 by fraction, tracker and stage.

    The seed of a cell starts with its fraction's number. So all cells of a window draw
    the same true trajectories, and their differences are paired.
    """
    numbers = {
        name: k for k, name in enumerate(dict.fromkeys(name for _, name in tracked), 1)
    }
    found = [
        score_cell(
            (window.fraction, name, stage),
            window.truth,
            tracks,
            window.lance,
            (FRACTION_NUMBERS[window.fraction], number, 1 + STAGES.index(stage)),
        )
        for window, (name, number) in product(windows, numbers.items())
        for stage, tracks in tracked.get((window.fraction, name), {}).items()
    ]
    return {cell.key: cell for cell in found}


def true_particles(
    detections: pd.DataFrame, true: pd.DataFrame
) -> npt.NDArray[np.int64]:
    """Return the true particle (n,) of each of n detections; -1: none.

    In each frame detections and true positions are paired within `GATE_PX` at the least
    sum of distances (Eq. 3.4). Both tables have ``frame``, ``row``, ``col``; ``true``
    has ``particle``.
    """
    owner = np.full(len(detections), -1, dtype=np.int64)
    rows, known = (table.groupby("frame").indices for table in (detections, true))
    spots, places = (
        table[["row", "col"]].to_numpy(np.float64) for table in (detections, true)
    )
    particle = true["particle"].to_numpy()
    for frame, there in known.items():
        here = rows.get(frame, np.empty(0, np.intp))
        pairs = pair(places[there], spots[here], GATE_PX)
        owner[here[pairs[:, 1]]] = particle[there[pairs[:, 0]]]
    return owner


def joined_tables(tables: Tables, column: str) -> pd.DataFrame:
    """Return all tracks in one table, for the data behind a figure.

    The columns are ``fraction``, ``column`` (the name in ``tables``), ``particle``,
    ``frame``, ``row`` and ``col``. Detections of no track are left out.
    """
    parts = [
        table.assign(fraction=fraction, **{column: name})
        for fraction, group in tables.items()
        for name, table in group.items()
    ]
    table = tracklets.tracked(pd.concat(parts, ignore_index=True))
    return table[["fraction", column, "particle", "frame", "row", "col"]]
