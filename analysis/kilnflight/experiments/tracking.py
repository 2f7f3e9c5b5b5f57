"""Tracking experiment: trackers on campaign windows, scored as in section 5.2.2.

    window -> detections in the air -> tracker -> post-processing -> alpha, beta, JSC, JSC_theta

The trackers run on the windows of Table 5.15. Settings that the thesis does not print are found
on other frames of the same campaigns (`kilnflight.experiments.tuning`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
import zarr
from matplotlib.figure import Figure

from kilnflight import kiln, tracklets
from kilnflight.checks import InputError
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.experiments.campaigns import Settings
from kilnflight.experiments.detection import BACKGROUNDS
from kilnflight.experiments.tracking_scores import (
    FROM_LANCE,
    GATE_PX,
    MEASURES,
    READINGS,
    Lance,
    Scored,
    mean_difference,
    measures_of,
    row_of,
    score_reading,
    scored,
)
from kilnflight.kiln import TILE, DetectionRun
from kilnflight.project import style
from kilnflight.project.parallel import Workers
from kilnflight.scores.detections import pair
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import WINDOWS, campaign_name, tracking_window
from kilnflight.twin.truth import true_trajectories

MARGIN = 150  # frames between a window and those for settings: no shared background
LENGTHS = {"quick": 12, "standard": 48, "full": 0}  # frames; 0: as long as Table 5.15's
FRACTION_NUMBERS = {name: k for k, name in enumerate(WINDOWS, 1)}  # seeds of intervals
SMOKE_FRACTIONS = ("wood chip", "paper shred")  # of a smoke run
STAGES = ("without", "with")  # post-processing
Tables = Mapping[str, Mapping[str, pd.DataFrame]]  # fraction -> name -> tracks
Tracker = Callable[[pd.DataFrame], pd.DataFrame]  # detections -> the same with particle
GAINS = ("alpha", "beta")  # measures whose gains have intervals
MEAN = "mean of fractions"


class Window(NamedTuple):
    """Consecutive frames of a campaign: the detections in them, and the truth."""

    fraction: str
    scene: str
    frames: range
    detections: pd.DataFrame  # in the air, or without depth
    truth: pd.DataFrame  # `kilnflight.twin.truth.true_trajectories`
    differences: StoredDifferences
    lance: Lance | None = None  # needed for the reading `FROM_LANCE`


def flying_particles(twin: Twin, starts: Iterable[int], length: int) -> npt.NDArray[np.intp]:
    """Return how many particles fly in so many frames from each first frame."""
    first = np.asarray(list(starts), dtype=np.intp)[:, None]
    table, rate = twin.life.table, twin.scene.frame_rate_hz
    released = table["release_s"].to_numpy() * rate
    ended = released + table["end_s"].to_numpy() * rate
    return np.asarray(((released < first + length) & (ended > first)).sum(axis=1), dtype=np.intp)


def busiest_frames(twin: Twin, within: range, length: int) -> range:
    """Return the part of a range of frames in which most particles fly."""
    starts = range(within.start, within.stop - length + 1)
    start = starts[int(flying_particles(twin, starts, length).argmax())]
    return range(start, start + length)


def scored_frames(twin: Twin, scale: str) -> range:
    """Return the window of Table 5.15, or the busiest part of it."""
    window = tracking_window(twin)
    return busiest_frames(twin, window, LENGTHS[scale] or len(window))


def windows(scale: str, settings: Settings, seed: int = 0, *, jobs: int = 1) -> list[Window]:
    """Return the windows of all fractions at 4.5 bar with their detections, cached.

    Parameters
    ----------
    scale
        "quick" (two fractions, few frames), "standard" or "full".
    settings
        Threshold and wall, from the labelled frames.
    seed
        Of the scenes.
    jobs
        Processes.
    """
    parts = []
    for fraction in SMOKE_FRACTIONS if scale == "quick" else WINDOWS:
        name = campaign_name(fraction, 4.5)
        source = kiln.TwinSource(name, seed)
        twin = source.recording()
        frames = scored_frames(twin, scale)
        detector, background = Combination(DoG(settings.threshold)), BACKGROUNDS[scale]
        run = kiln.DetectionRun(source, frames.start, frames.stop, detector, background)
        in_air = settings.in_air(kiln.detections(run, Workers(jobs)))
        truth = true_trajectories(twin, frames)
        differences, lance = StoredDifferences(run), lance_of(twin)
        parts.append(Window(fraction, name, frames, in_air, truth, differences, lance))
    return parts


def lance_of(twin: Twin) -> Lance:
    """Return where the lance of a recording is, as a person would mark it once."""
    attributes = twin.attributes
    if attributes.exit_point_mm is None:
        raise InputError(f"{attributes.name}: the lance's outlet is not known.")
    row, col = twin.scene.geometry.lance_pixel
    return Lance(float(row), float(col), float(attributes.exit_point_mm[2]))


def cells(
    windows: Iterable[Window],
    trackers: Mapping[str, Tracker],
    readings: Sequence[str] = READINGS,
    first: int = 1,
) -> Iterator[tuple[Scored, float]]:
    """Yield every cell of Table 5.17 in some readings, and the seconds of its stage.

    The first tracker has the number ``first`` among the seeds of intervals.
    """
    for window, (number, (name, tracker)) in product(windows, enumerate(trackers.items(), first)):
        place = FRACTION_NUMBERS[window.fraction]
        for stage, tracks, seconds in track_and_postprocess(window, tracker):
            for reading in readings:
                score = score_reading(reading, window.truth, tracks, window.lance, stage)
                seed = (place, number, 1 + STAGES.index(stage))
                yield scored((window.fraction, name, stage, reading), score, seed), seconds


def run(
    windows: Iterable[Window], trackers: Mapping[str, Tracker], readings: Sequence[str] = READINGS
) -> pd.DataFrame:
    """Return measures by tracker and window, without and with post-processing.

    Returns
    -------
    DataFrame
        ``fraction``, ``tracker``, ``postprocessing``, ``reading``, the columns of
        `tracking_scores.row_of`, and ``seconds``: of the tracking, or of the post-processing
        after it.
    """
    rows = [
        row_of(cell) | {"seconds": seconds} for cell, seconds in cells(windows, trackers, readings)
    ]
    return pd.DataFrame(rows)


def mean_measures(
    windows: Iterable[Window],
    tracker: Tracker,
    reading: str = FROM_LANCE,
    stage: str = "with",
) -> dict[str, float]:
    """Return a tracker's four measures as means over windows: what settings are chosen by.

    Parameters
    ----------
    windows
        Of which those without a true trajectory in the reading are left out.
    tracker
        A candidate: a tracker in some setting. What it refuses (`InputError`) is passed on.
    reading
        One of `tracking_scores.READINGS`.
    stage
        "with" or "without" post-processing, which is not run for the latter.
    """
    rows = []
    for window in windows:
        stages = track_and_postprocess(window, tracker)
        tracks = next(table for name, table, _ in stages if name == stage)
        rows.append(measures_of(score_reading(reading, window.truth, tracks, window.lance, stage)))
    mean = pd.DataFrame(rows)[list(MEASURES)].mean()
    return {name: float(mean[name]) for name in MEASURES}


def track_and_postprocess(
    window: Window, tracker: Tracker
) -> Iterator[tuple[str, pd.DataFrame, float]]:
    """Yield a window's tracks "without", "with" post-processing, and the seconds."""
    begin = time.perf_counter()
    tracks = tracker(window.detections)
    yield "without", tracks, time.perf_counter() - begin
    begin = time.perf_counter()
    processed = tracklets.postprocess(tracks, window.differences)
    yield "with", processed, time.perf_counter() - begin


def tracks_by_stage(windows: Sequence[Window], trackers: Mapping[str, Tracker]) -> Tables:
    """Return the true tracks of windows, and those of trackers by stage, by fraction."""
    tables = {window.fraction: {"truth": window.truth} for window in windows}
    for window, (name, tracker) in product(windows, trackers.items()):
        for stage, tracks, _ in track_and_postprocess(window, tracker):
            tables[window.fraction][f"{name} {stage} steps"] = tracks
    return tables


def true_particles(detections: pd.DataFrame, true: pd.DataFrame) -> npt.NDArray[np.int64]:
    """Return the true particle that each detection belongs to, (n,); -1: none.

    In each frame detections and true positions are paired within `GATE_PX`.
    """
    owner = np.full(len(detections), -1, dtype=np.int64)
    rows, known = (table.groupby("frame").indices for table in (detections, true))
    spots, places = (table[["row", "col"]].to_numpy(np.float64) for table in (detections, true))
    particle = true["particle"].to_numpy()
    for frame, there in known.items():
        here = rows.get(frame, np.empty(0, np.intp))
        pairs = pair(places[there], spots[here], GATE_PX)
        owner[here[pairs[:, 1]]] = particle[there[pairs[:, 0]]]
    return owner


def ablate(
    windows: Sequence[Window], trackers: Mapping[str, Tracker], reading: str = FROM_LANCE
) -> pd.DataFrame:
    """Return the measures with one part after the other replaced by the truth.

    Returns
    -------
    DataFrame
        `run` with ``input``: "true positions", "right detections only" (those that belong to a
        true trajectory) and "detections"; and rows for the tracker "links by the truth".
    """
    linked = [
        window.detections.assign(particle=true_particles(window.detections, window.truth))
        for window in windows
    ]
    columns = ["frame", "row", "col", "x", "y", "z"]
    inputs = {
        "true positions": [window.truth[columns] for window in windows],
        "right detections only": [
            table[table["particle"] >= 0].drop(columns="particle").reset_index(drop=True)
            for table in linked
        ],
        "detections": [window.detections for window in windows],
    }
    parts = []
    for name, tables in inputs.items():
        pairs = zip(windows, tables, strict=True)
        replaced = [window._replace(detections=table) for window, table in pairs]
        parts.append(run(replaced, trackers, [reading]).assign(input=name))
    rows = [
        {"fraction": window.fraction, "input": "detections", "tracker": "links by the truth"}
        | {"postprocessing": "without", "reading": reading}
        | measures_of(score_reading(reading, window.truth, table, window.lance))
        for window, table in zip(windows, linked, strict=True)
    ]
    return pd.concat([*parts, pd.DataFrame(rows)], ignore_index=True)


def compare(
    windows: Sequence[Window], variants: Mapping[str, Variant], seed: int = 0
) -> pd.DataFrame:
    """Return the measures of variants, and what each gains over the first one.

    Parameters
    ----------
    windows
        With truth and lance.
    variants
        By name, the first is what all others are compared with.
    seed
        Of the bootstrap.

    Returns
    -------
    DataFrame
        ``variant``, ``reading``, ``fraction`` (`MEAN`: of all), ``true_tracks``, the four
        measures, and for alpha and beta the gain over the first variant with its 95 % interval
        (``_gain``, ``_gain_low``, ``_gain_high``), bootstrap over true tracks. A fraction
        without a true track in a reading is left out of it.
    """
    cells: dict[tuple[str, str], list[Scored]] = {}
    for place, window in enumerate(windows):
        for number, (name, variant) in enumerate(variants.items()):
            tracks = variant(window)
            for reading in READINGS:
                score = score_reading(reading, window.truth, tracks, window.lance)
                cell = scored((window.fraction, name, "with", reading), score, (place, number))
                if score is not None:
                    cells.setdefault((reading, name), []).append(cell)
    first, rows = next(iter(variants)), []
    for (reading, name), found in cells.items():
        pairs = list(zip(found, cells[reading, first], strict=True))
        for fraction, part in [
            *((cell.key[0], [(cell, base)]) for cell, base in pairs),
            (MEAN, pairs),
        ]:
            rows.append({"variant": name, "reading": reading, "fraction": fraction} | _gains(part))
    return pd.DataFrame(rows)


def _gains(pairs: Sequence[tuple[Scored, Scored]]) -> dict[str, object]:
    """Return the mean measures of the first of each pair, and their gains over the second."""
    means = pd.DataFrame([measures_of(cell.score) for cell, _ in pairs])[list(MEASURES)].mean()
    count = sum(len(cell.score.true_tracks) for cell, _ in pairs if cell.score is not None)
    row: dict[str, object] = {"true_tracks": count}
    row |= {name: means[name] for name in MEASURES}
    for measure in GAINS:
        one = mean_difference(pairs, [measure])
        ends = one.estimate, *np.clip([one.low, one.high], -1.0, 1.0)
        names = (f"{measure}_gain", f"{measure}_gain_low", f"{measure}_gain_high")
        row |= dict(zip(names, ends, strict=True))
    return row


def joined_tables(tables: Tables, column: str) -> pd.DataFrame:
    """Return all tracks in one table, with ``fraction`` and the name in a column."""
    parts = [
        table.assign(fraction=fraction, **{column: name})
        for fraction, group in tables.items()
        for name, table in group.items()
    ]
    table = tracklets.tracked(pd.concat(parts, ignore_index=True))
    return table[["fraction", column, "particle", "frame", "row", "col"]]


def draw_trajectories(windows: Sequence[Window], tables: Tables) -> Figure:
    """Draw tracks on the sum of frame differences: windows (columns) by name (rows)."""
    rows = len(next(iter(tables.values())))
    picture, grid = style.canvas(rows, len(windows), width_mm=130, height_mm=40 * rows)
    for window, column in zip(windows, grid.T, strict=True):
        height, width = window.differences.shape
        first, last = window.frames.start, window.frames.stop - 1
        light = window.differences(first, last, 0, 0, height, width)
        for axes, (name, table) in zip(column, tables[window.fraction].items(), strict=True):
            style.draw_frame(axes, light, 8)
            style.draw_tracks(axes, tracklets.tracked(table))
            axes.set(title=f"{window.fraction}: {name}", ylabel="row (px)", xlabel="")
        column[-1].set_xlabel("column (px)")
    return picture


Variant = Callable[[Window], pd.DataFrame]  # the tracks of a window


@dataclass(frozen=True)
class StoredDifferences:
    """Sums of the differences to the background that were stored with detections.

    Each is kept as the root of its grey values, rounded: of 10,000 that is off by 100 at
    most, less than the noise there.
    """

    run: DetectionRun

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frames."""
        known = self.run.source.recording().attributes
        return known.rows, known.columns

    def __call__(
        self, first_frame: int, last_frame: int, top: int, left: int, bottom: int, right: int
    ) -> npt.NDArray[np.float64]:
        """Return the sum over the frames first to last, both counted, in a box."""
        total = np.zeros((bottom - top, right - left))
        tiles = product(
            range(top // TILE[0], (bottom - 1) // TILE[0] + 1),
            range(left // TILE[1], (right - 1) // TILE[1] + 1),
        )
        for (row, col), frames in product(tiles, self.run.chunks):
            span, _ = _overlap(frames.start, len(frames), first_frame, last_frame + 1)
            if span.start < span.stop:
                rows, total_rows = _overlap(row * TILE[0], TILE[0], top, bottom)
                cols, total_cols = _overlap(col * TILE[1], TILE[1], left, right)
                tile = _tile(self.run.differences_of(frames), row, col)
                roots = tile[span, rows, cols].astype(np.uint16)
                squares = np.sum(roots * roots, axis=0, dtype=np.uint32)
                total[total_rows, total_cols] += squares
        return total


def _overlap(start: int, size: int, low: int, high: int) -> tuple[slice, slice]:
    """Return where a piece and the range low to high meet, from the start of each."""
    first, stop = max(start, low), min(start + size, high)
    return slice(first - start, stop - start), slice(first - low, stop - low)


@lru_cache(maxsize=32)  # 20 MB each: what pairs in 300 frames look at, again and again
def _tile(folder: Path, row: int, col: int) -> npt.NDArray[np.uint8]:
    """Return the roots (frames, rows, cols) of one tile in all frames of a chunk."""
    try:
        # the files of many frames in one go: asked one by one, they cost twice the time
        with zarr.config.set({"codec_pipeline.batch_size": 32}):
            store = zarr.open_array(folder, mode="r")
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder}: frame differences cannot be read ({error}). Run `kiln.detections` first."
        ) from error
    height, width = TILE
    rows, cols = slice(row * height, (row + 1) * height), slice(col * width, (col + 1) * width)
    return np.asarray(store[:, rows, cols], dtype=np.uint8)
