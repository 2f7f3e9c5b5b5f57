"""Tracking experiment: trackers on windows of the campaigns, scored as in section 5.2.2.

window -> detections in the air -> tracker -> post-processing -> alpha, beta, JSC, JSC_theta

The trackers run on the windows of Table 5.15. Settings that the thesis does not print are found
on other frames of the same campaigns (`settings_frames`), which share no frame with those.
"""

from __future__ import annotations

import time
import tracemalloc
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

from kilnflight import kiln, tracklets
from kilnflight.checks import InputError
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.experiments.campaigns import Settings
from kilnflight.experiments.detection import BACKGROUNDS
from kilnflight.kiln import TILE, DetectionRun
from kilnflight.project.parallel import Workers
from kilnflight.scores import score_tracks
from kilnflight.scores.detections import pair
from kilnflight.tracking.tracker import track
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import WINDOWS, campaign_name, tracking_window
from kilnflight.twin.truth import true_trajectories

# The bare epsilon of Table 5.16, 10 px; Eq. 5.1 is the only place with a bare epsilon.
GATE_PX = 10.0
MARGIN = 150  # frames between a window and those for settings: no shared background
# Frames of a window and of those for settings, by scale; 0: as long as Table 5.15's.
LENGTHS = {"quick": (12, 12), "standard": (48, 24), "full": (0, 100)}
SMOKE_FRACTIONS = ("wood chip", "paper shred")  # of a smoke run
MEASURES = ("alpha", "beta", "jsc", "jsc_theta")
BOX = (60, 30)  # px, rows and columns of a window for the textures; w = 15 px in Table 5.16
SPAN = 11  # frames that such a window sums
Array = npt.NDArray[np.float64]
Tracker = Callable[[pd.DataFrame], pd.DataFrame]  # detections -> the same with particle


class Window(NamedTuple):
    """Consecutive frames of a campaign: the detections in them, and the truth."""

    fraction: str
    scene: str
    frames: range
    detections: pd.DataFrame  # in the air, or without depth
    truth: pd.DataFrame  # `kilnflight.twin.truth.true_trajectories`
    differences: Differences


def flying_particles(twin: Twin, starts: Iterable[int], length: int) -> npt.NDArray[np.intp]:
    """Return how many particles fly in so many frames from each of these first frames."""
    first = np.asarray(list(starts), dtype=np.intp)[:, None]
    table, rate = twin.life.table, twin.scene.frame_rate_hz
    released = table["release_s"].to_numpy() * rate
    ended = released + table["end_s"].to_numpy() * rate
    return np.asarray(((released < first + length) & (ended > first)).sum(axis=1), dtype=np.intp)


def busiest_frames(twin: Twin, within: range, length: int) -> range:
    """Return the part of some frames, of some length, in which most particles fly."""
    starts = range(within.start, within.stop - length + 1)
    start = starts[int(flying_particles(twin, starts, length).argmax())]
    return range(start, start + length)


def scored_frames(twin: Twin, scale: str) -> range:
    """Return the window of Table 5.15, or the busiest part of it."""
    window = tracking_window(twin)
    return busiest_frames(twin, window, LENGTHS[scale][0] or len(window))


def settings_frames(twin: Twin, scale: str) -> range:
    """Return the busiest part of another window like that of Table 5.15, to find settings in.

    Like: as long, with as near to as many particles as Table 5.15 counts, and far away.
    """
    window = tracking_window(twin)
    before = range(0, window.start - MARGIN - len(window) + 1, 10)
    after = range(window.stop + MARGIN, len(twin) - len(window) + 1, 10)
    starts, count = [*before, *after], WINDOWS[str(twin.scene.fraction)][0]
    start = starts[int(np.abs(flying_particles(twin, starts, len(window)) - count).argmin())]
    return busiest_frames(twin, range(start, start + len(window)), LENGTHS[scale][1])


def windows(
    scale: str, settings: Settings, seed: int = 0, *, for_settings: bool = False, jobs: int = 1
) -> list[Window]:
    """Return the windows of all fractions at 4.5 bar with their detections, cached.

    Parameters
    ----------
    scale
        "quick" (two fractions, few frames), "standard" or "full".
    settings
        Threshold and wall, from the labelled frames.
    seed
        Of the scenes.
    for_settings
        Return the frames in which settings are found in place of those that are scored.
    jobs
        Processes.
    """
    found = []
    for fraction in SMOKE_FRACTIONS if scale == "quick" else WINDOWS:
        name = campaign_name(fraction, 4.5)
        source = kiln.TwinSource(name, seed)
        twin = source.recording()
        frames = (settings_frames if for_settings else scored_frames)(twin, scale)
        detector, background = Combination(DoG(settings.threshold)), BACKGROUNDS[scale]
        run = kiln.DetectionRun(source, frames.start, frames.stop, detector, background)
        in_air = settings.in_air(kiln.detections(run, Workers(jobs)))
        truth = true_trajectories(twin, frames)
        found.append(Window(fraction, name, frames, in_air, truth, Differences(run)))
    return found


def measures(truth: pd.DataFrame, tracks: pd.DataFrame) -> dict[str, float]:
    """Return the four measures, JSC in the thesis's narrower wording, and counts of tracks."""
    score = score_tracks(truth, tracks, GATE_PX)
    row = {name: float(getattr(score, name)) for name in MEASURES}
    names = ("jsc_spurious_only", "tp_tracks", "fn_tracks", "fp_tracks")
    return row | {name: float(getattr(score, name)) for name in names}


def run(windows: Iterable[Window], trackers: Mapping[str, Tracker]) -> pd.DataFrame:
    """Return the measures of every tracker on every window, without and with post-processing.

    Returns
    -------
    DataFrame
        ``fraction``, ``tracker``, ``postprocessing``, the columns of `measures`, and
        ``seconds``: of the tracking, or of the post-processing after it.
    """
    rows = []
    for window in windows:
        for name, tracker in trackers.items():
            for stage, table, seconds in track_and_postprocess(window, tracker):
                row = {"fraction": window.fraction, "tracker": name, "postprocessing": stage}
                rows.append(row | measures(window.truth, table) | {"seconds": seconds})
    return pd.DataFrame(rows)


def compare_plans(
    windows: Iterable[Window], plans: Mapping[str, Sequence[tracklets.Step] | None]
) -> pd.DataFrame:
    """Return the measures of GNN's tracks after each plan of post-processing.

    Parameters
    ----------
    windows
        To track in.
    plans
        Steps by name; None: those of `kilnflight.tracklets.STEPS` without frame differences.

    Returns
    -------
    DataFrame
        ``fraction``, ``plan`` and `MEASURES`, one row per window and plan.
    """
    rows = []
    for window in windows:
        tracks = track(window.detections)
        for name, plan in plans.items():
            texture = () if plan is None else (window.differences, plan)
            table = tracklets.postprocess(tracks, *texture)
            row = {"fraction": window.fraction, "plan": name}
            rows.append(row | measures(window.truth, table))
    return pd.DataFrame(rows)[["fraction", "plan", *MEASURES]]


def compare_steps(
    windows: Iterable[Window],
) -> tuple[pd.DataFrame, dict[str, dict[str, pd.DataFrame]]]:
    """Return the measures after GNN and each step of the post-processing, and the tracks.

    Returns
    -------
    table : DataFrame
        ``fraction``, ``after``, number of ``tracks`` and ``positions``, and `measures`.
    after : dict
        Tracks by fraction and step, "tracker" first.
    """
    rows, after = [], {}
    for window in windows:
        tracks = track(window.detections)
        stages = {"tracker": tracks, **dict(tracklets.stages(tracks, window.differences))}
        after[window.fraction] = stages
        for step, table in stages.items():
            kept = tracklets.tracked(table)
            row = {"fraction": window.fraction, "after": step, "positions": len(kept)}
            row |= {"tracks": kept["particle"].nunique()}
            rows.append(row | measures(window.truth, table))
    columns = ["fraction", "after", "tracks", "positions", *MEASURES, "jsc_spurious_only"]
    return pd.DataFrame(rows)[columns], after


def texture_table(with_track: pd.DataFrame, without: pd.DataFrame) -> pd.DataFrame:
    """Return medians of texture energies with and without a track, and their ratio (Fig. 4.13).

    ``ratio_10`` and ``ratio_90``: its 10 and 90 % points over windows; largest ratio first.
    """
    table = pd.DataFrame({"with_track": with_track.median(), "without": without.median()})
    table["ratio"] = table["with_track"] / table["without"]
    each = with_track / without.median()
    table = table.assign(ratio_10=each.quantile(0.1), ratio_90=each.quantile(0.9))
    return table.sort_values("ratio", ascending=False).reset_index(names="masks")


def cost(windows: Iterable[Window], tracker: Tracker, repeats: int = 3) -> tuple[float, float]:
    """Return seconds (best of some runs) and the peak of memory in MiB of tracking, in all."""
    seconds, peak = 0.0, 0.0
    for window in windows:
        tracker(window.detections)  # compiled
        times = []
        for _ in range(repeats):
            begin = time.perf_counter()
            tracker(window.detections)
            times.append(time.perf_counter() - begin)
        tracemalloc.start()
        tracker(window.detections)
        peak = max(peak, tracemalloc.get_traced_memory()[1] / 2**20)
        tracemalloc.stop()
        seconds += min(times)
    return seconds, peak


def track_and_postprocess(
    window: Window, tracker: Tracker
) -> Iterator[tuple[str, pd.DataFrame, float]]:
    """Yield the tracks of a window "without" and "with" post-processing, and the seconds."""
    begin = time.perf_counter()
    tracks = tracker(window.detections)
    yield "without", tracks, time.perf_counter() - begin
    begin = time.perf_counter()
    done = tracklets.postprocess(tracks, window.differences)
    yield "with", done, time.perf_counter() - begin


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


def linked_by_truth(window: Window) -> pd.DataFrame:
    """Return the detections with the true particle they belong to: links without a mistake."""
    owner = true_particles(window.detections, window.truth)
    return window.detections.assign(particle=owner)


def without_false_detections(window: Window) -> Window:
    """Return the window with only the detections that belong to a true trajectory."""
    linked = linked_by_truth(window)
    kept = linked[linked["particle"] >= 0].drop(columns="particle").reset_index(drop=True)
    return window._replace(detections=kept)


def with_true_positions(window: Window) -> Window:
    """Return the window with the true positions, and depths, as its detections."""
    return window._replace(detections=window.truth[["frame", "row", "col", "x", "y", "z"]])


def texture_windows(
    window: Window, count: int, generator: np.random.Generator
) -> tuple[list[Array], list[Array]]:
    """Return sums of frame differences with and without a track in them (Fig. 4.13).

    Parameters
    ----------
    window
        With true trajectories.
    count
        How many of each.
    generator
        Of the places.

    Returns
    -------
    with_track, without : list of ndarray
        `BOX` pixels, over `SPAN` frames: around a true position, and in the same frames where
        no true position is within three boxes.
    """
    streaks, empty = [], []
    for _ in range(count):
        position = window.truth.iloc[int(generator.integers(len(window.truth)))]
        frames = (int(position["frame"]) - SPAN // 2, int(position["frame"]) + SPAN // 2)
        streaks.append(_summed(window, frames, (position["row"], position["col"])))
        empty.append(_summed(window, frames, _empty_place(window, frames, generator)))
    return streaks, empty


def _empty_place(
    window: Window, frames: tuple[int, int], generator: np.random.Generator
) -> tuple[float, float]:
    """Return a place that no true trajectory is near to in these frames."""
    rows, cols = window.differences.shape
    now = window.truth[window.truth["frame"].between(*frames)]
    for _ in range(1000):
        row, col = generator.uniform(BOX, (rows - BOX[0], cols - BOX[1]))
        if np.hypot(now["row"] - row, now["col"] - col).min() > 3 * max(BOX):
            return float(row), float(col)
    raise InputError(f"{window.scene}: no place without a track in frames {frames}.")


def _summed(window: Window, frames: tuple[int, int], place: tuple[float, float]) -> Array:
    """Return the sum of differences in the box around a place, moved into the image."""
    top, left = (
        min(max(round(at) - size // 2, 0), edge - size)
        for at, size, edge in zip(place, BOX, window.differences.shape, strict=True)
    )
    return window.differences(*frames, top, left, top + BOX[0], left + BOX[1])


@dataclass(frozen=True)
class Differences:
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
        height, width = TILE
        tiles = product(
            range(top // height, (bottom - 1) // height + 1),
            range(left // width, (right - 1) // width + 1),
        )
        for (tile_row, tile_col), frames in product(tiles, self.run.chunks):
            span = _overlap(frames, first_frame, last_frame + 1)
            if span:
                rows = _overlap(range(tile_row * height, (tile_row + 1) * height), top, bottom)
                cols = _overlap(range(tile_col * width, (tile_col + 1) * width), left, right)
                tile = _tile(self.run.differences_of(frames), tile_row, tile_col)
                roots = tile[
                    _shifted(span, frames.start),
                    _shifted(rows, tile_row * height),
                    _shifted(cols, tile_col * width),
                ].astype(np.uint16)
                squares = np.sum(roots * roots, axis=0, dtype=np.uint32)
                total[_shifted(rows, top), _shifted(cols, left)] += squares
        return total


def _overlap(part: range, start: int, stop: int) -> range:
    return range(max(part.start, start), min(part.stop, stop))


def _shifted(part: range, origin: int) -> slice:
    return slice(part.start - origin, part.stop - origin)


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
