"""Tracking experiment: trackers on windows of the campaigns, scored as in section 5.2.2."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
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
from kilnflight.scores.matching import pair
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import WINDOWS, tracking_window
from kilnflight.twin.truth import true_trajectories

# The bare epsilon of Table 5.16, 10 px; Eq. 5.1 is the only place with a bare epsilon.
GATE_PX = 10.0
MARGIN = 150  # frames between a window and the stretch for settings: no shared background
# Frames of a window and of the stretch for settings, by scale; 0: as long as Table 5.15's.
LENGTHS = {"quick": (12, 12), "standard": (48, 24), "full": (0, 100)}
SMOKE_FRACTIONS = ("wood chip", "paper shred")  # fractions of a smoke run
MEASURES = ("alpha", "beta", "jsc", "jsc_theta")
BOX = (60, 30)  # px, rows and columns of a window for the textures; w = 15 px in Table 5.16
SPAN = 11  # frames that such a window sums
Array = npt.NDArray[np.float64]
Tracker = Callable[[pd.DataFrame], pd.DataFrame]  # detections -> the same with particle


class Window(NamedTuple):
    """A stretch of a campaign: what was found in it, and what is true."""

    fraction: str
    scene: str
    frames: range
    detections: pd.DataFrame  # in the air, or without depth
    truth: pd.DataFrame  # `kilnflight.twin.truth.true_trajectories`
    differences: Differences


def flying_particles(twin: Twin, starts: Iterable[int], length: int) -> npt.NDArray[np.intp]:
    """Return how many particles fly in the stretches of some length at these first frames."""
    first = np.asarray(list(starts), dtype=np.intp)
    table, rate = twin.life.table, twin.scene.frame_rate_hz
    released = table["release_s"].to_numpy() * rate
    ended = released + table["end_s"].to_numpy() * rate
    number = (released < first[:, None] + length) & (ended > first[:, None])
    return np.asarray(number.sum(axis=1), dtype=np.intp)


def busiest_frames(twin: Twin, within: range, length: int) -> range:
    """Return the part of a stretch, of some length, in which most particles fly."""
    starts = range(within.start, within.stop - length + 1)
    start = starts[int(flying_particles(twin, starts, length).argmax())]
    return range(start, start + length)


def scored_frames(twin: Twin, scale: str) -> range:
    """Return the window of Table 5.15, or the busiest part of it."""
    window = tracking_window(twin)
    return busiest_frames(twin, window, LENGTHS[scale][0] or len(window))


def settings_frames(twin: Twin, scale: str) -> range:
    """Return the busiest part of another stretch like the window, for the choice of settings.

    Like: as long, with as near to as many particles as Table 5.15 counts, and far away.
    """
    window = tracking_window(twin)
    before = range(0, window.start - MARGIN - len(window) + 1, 10)
    after = range(window.stop + MARGIN, len(twin) - len(window) + 1, 10)
    starts = [*before, *after]
    off = np.abs(flying_particles(twin, starts, len(window)) - WINDOWS[str(twin.scene.fraction)][0])
    start = starts[int(off.argmin())]
    return busiest_frames(twin, range(start, start + len(window)), LENGTHS[scale][1])


def windows(
    scale: str, learned: Settings, seed: int = 0, *, others: bool = False, jobs: int = 1
) -> list[Window]:
    """Return the windows of all fractions at 4.5 bar, detected (kept on disk).

    Parameters
    ----------
    scale
        "quick" (two fractions, few frames), "standard" or "full".
    learned
        Threshold and wall, from the labelled frames.
    seed
        Of the scenes.
    others
        The stretches for settings in place of the windows.
    jobs
        Processes.
    """
    found = []
    for fraction in SMOKE_FRACTIONS if scale == "quick" else WINDOWS:
        name = f"{fraction.replace(' ', '-').lower()}-4.5-bar"
        source = kiln.TwinSource(name, seed)
        twin = source.recording()
        frames = (settings_frames if others else scored_frames)(twin, scale)
        detector, background = Combination(DoG(learned.threshold)), BACKGROUNDS[scale]
        run = kiln.DetectionRun(source, frames.start, frames.stop, detector, background)
        seen = learned.in_air(kiln.detections(run, Workers(jobs)))
        true = true_trajectories(twin, frames)
        found.append(Window(fraction, name, frames, seen, true, Differences(run)))
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


def linked_by_truth(window: Window) -> pd.DataFrame:
    """Return the detections with the true particle they belong to: links without a mistake.

    In each frame true positions and detections are paired within `GATE_PX` at the least
    distance; what is in no pair is in no track (-1).
    """
    seen = window.detections
    particle = np.full(len(seen), -1, dtype=np.int64)
    rows = seen.groupby("frame").indices
    for frame, true in window.truth.groupby("frame"):
        here = rows.get(frame, np.empty(0, np.intp))
        places = seen[["row", "col"]].to_numpy()[here]
        found = pair(true[["row", "col"]].to_numpy(), places, GATE_PX)
        particle[here[found[:, 1]]] = true["particle"].to_numpy()[found[:, 0]]
    return seen.assign(particle=particle)


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
        Its true trajectories are looked at.
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
    streaks: list[Array] = []
    empty: list[Array] = []
    for _ in range(count):
        one = window.truth.iloc[int(generator.integers(len(window.truth)))]
        frames = (int(one["frame"]) - SPAN // 2, int(one["frame"]) + SPAN // 2)
        streaks.append(_summed(window, frames, (one["row"], one["col"])))
        empty.append(_summed(window, frames, _bare(window, frames, generator)))
    return streaks, empty


def _bare(
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
    corner = [
        min(max(round(at) - size // 2, 0), edge - size)
        for at, size, edge in zip(place, BOX, window.differences.shape, strict=True)
    ]
    top, left = corner
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
        for frames in self.run.chunks:
            some = range(max(first_frame, frames.start), min(last_frame + 1, frames.stop))
            if some:
                folder = self.run.differences_of(frames)
                cut = slice(some.start - frames.start, some.stop - frames.start)
                for place, inside, within in _parts(top, left, bottom, right):
                    roots = _tile(folder, *place)[(cut, *within)].astype(np.uint16)
                    total[inside] += np.sum(roots * roots, axis=0, dtype=np.uint32)
        return total


def _parts(
    top: int, left: int, bottom: int, right: int
) -> Iterator[tuple[tuple[int, int], tuple[slice, slice], tuple[slice, slice]]]:
    """Yield the tiles that a box touches: which, where in the box, and where in the tile."""
    height, width = TILE
    for row in range(top // height, (bottom - 1) // height + 1):
        for col in range(left // width, (right - 1) // width + 1):
            rows = max(top, row * height), min(bottom, (row + 1) * height)
            cols = max(left, col * width), min(right, (col + 1) * width)
            inside = slice(rows[0] - top, rows[1] - top), slice(cols[0] - left, cols[1] - left)
            within = tuple(
                slice(ends[0] - at * size, ends[1] - at * size)
                for ends, at, size in ((rows, row, height), (cols, col, width))
            )
            yield (row, col), inside, (within[0], within[1])


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
