"""The whole way from a frame to a flight; it is written out only here.

frame -> view -> detections -> tracks -> trajectories -> flights, slices

Each arrow is a table that is made once and cached. Detection, which takes nearly all of the
time, is done in chunks of frames by processes or a cluster. A killed run goes on with the
first table that is missing. The tracks are made without the texture term of Eq. 4.24: its
frame differences would take 2.8 MB a frame, 68 GB for eight campaigns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pandas as pd
import zarr
from tqdm import tqdm
from zarr.codecs import ZstdCodec

from kilnflight import flight, regression
from kilnflight.association import GNN
from kilnflight.background import BackgroundModel, Median
from kilnflight.background.sliding_median import stack_median
from kilnflight.camera import calibrate_points
from kilnflight.checks import InputError
from kilnflight.detection.combination import Combination, View, mean_gray
from kilnflight.detection.otsu import flame_mask
from kilnflight.detection.peaks import Smoother
from kilnflight.detection.wall import Cylinder, InAir
from kilnflight.project import paths
from kilnflight.project.cache import CachedTable, clear_parts, make_whole
from kilnflight.project.parallel import Workers
from kilnflight.recording.frames import Frame, Recording
from kilnflight.recording.store import StoredRecording, open_recording
from kilnflight.regression import Regression
from kilnflight.tables import DETECTIONS, FLIGHTS, TRAJECTORIES
from kilnflight.tracking.tracker import track
from kilnflight.tracklets import Cutting, postprocess, tracked
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import cached_scene

CHUNK = 100  # frames; every chunk reads the median's window, 150 frames, anew
LONG_CHUNK = 500  # frames, where no differences are stored: the window costs less
TILE = (384, 512)  # of a stored difference, so that a small box is read fast
BACKGROUND_FRAMES = 21  # in the median picture that stands for the background; ours

Vector = tuple[float, float, float]
Names = tuple[str, ...]


@dataclass(frozen=True)
class TwinSource:
    """A scene of the twin by name and seed, opened once per process."""

    name: str
    seed: int = 0

    @lru_cache(maxsize=2)  # noqa: B019  of equal sources
    def recording(self) -> Twin:
        """Return the twin; its flights are computed once per process."""
        return cached_scene(self.name, self.seed)


@dataclass(frozen=True)
class StoredSource:
    """A recording on disk, known by its content and not by its place."""

    name: str
    content: str  # of `StoredRecording.content`
    folder: Path = field(repr=False)

    @lru_cache(maxsize=2)  # noqa: B019  of equal sources
    def recording(self) -> StoredRecording:
        """Return the recording."""
        return open_recording(self.folder)


Source = TwinSource | StoredSource


def stored_source(folder: Path | str) -> StoredSource:
    """Return the source of a recording; errors as of `open_recording`."""
    recording = open_recording(folder)
    name, folder = recording.attributes.name, recording.path.resolve()
    return StoredSource(name, recording.content(), folder)


class FrameBuffer:
    """Stack of a recording's grey values; each needed frame is read once.

    Background models read a frame before its turn; it is held until its last use.

    Parameters
    ----------
    recording
        The recording.
    uses
        Frame numbers that `take` will be called with.
    """

    def __init__(self, recording: Recording, uses: Iterable[int] = ()) -> None:
        self._recording, self._uses = recording, Counter(uses)
        self._held: dict[int, Frame] = {}

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._recording)

    def __getitem__(self, t: int) -> npt.NDArray[np.uint16]:
        """Return the grey values (rows, cols) of frame ``t``."""
        return self._fetch(t).gray if self._uses[t] else self._recording.gray(t)

    def take(self, t: int) -> Frame:
        """Return frame ``t``, and release it after its last use."""
        frame = self._fetch(t)
        self._uses[t] -= 1
        if self._uses[t] <= 0:
            del self._held[t]
        return frame

    def _fetch(self, t: int) -> Frame:
        if t not in self._held:
            frame = self._recording.frame(t)
            gray = frame.gray.view()
            gray.flags.writeable = False  # models may hold it without a copy
            self._held[t] = replace(frame, gray=gray, labels=None)
        return self._held[t]


def views(
    recording: Recording, frames: Iterable[int], background: BackgroundModel | None = None
) -> Iterator[tuple[int, View]]:
    """Yield the number and the view of each frame.

    The default background is the temporal median over 150 frames (section 5.1.2). The first frame
    is compared with the one after it, as no frame precedes it.
    """
    frames, attributes, smooth = list(frames), recording.attributes, Smoother()
    before = [t - 1 if t > 0 else min(1, len(recording) - 1) for t in frames]
    buffer = FrameBuffer(recording, [*frames, *before])
    foregrounds = (background or Median())(buffer, frames)
    for t, beside, foreground in zip(frames, before, foregrounds, strict=True):
        previous, frame = buffer.take(beside).gray, buffer.take(t)
        pixels, xyz = frame.pixels, calibrate_points(frame.xyz, attributes.depth_calibration)
        if attributes.flame_roi is not None:
            flame = flame_mask(frame.gray, attributes.flame_roi)
            foreground[flame] = 0  # in place: each model returns a new array
            keep = ~flame[tuple(pixels.T)]
            pixels, xyz = pixels.compress(keep, axis=0), xyz.compress(keep, axis=0)
        yield t, View(frame.gray, previous, foreground, pixels, xyz, smooth)


def detect(
    recording: Recording,
    frames: Sequence[int],
    detector: Combination | None = None,
    background: BackgroundModel | None = None,
    differences: Path | None = None,
    progress: bool = False,
) -> pd.DataFrame:
    """Return the detections of the combined detector.

    The table is `kilnflight.tables.DETECTIONS`. The roots of the foregrounds are stored in the
    Zarr array ``differences``, if there is one.
    """
    detector = detector or Combination()
    size, roi, parts, store = recording.attributes.size, recording.attributes.roi, [], None
    if differences is not None:
        tile = [min(sides) for sides in zip(TILE, size, strict=True)]
        store = zarr.create_array(
            differences,
            shape=(len(frames), *size),
            chunks=(1, *tile),
            dtype="uint8",
            compressors=ZstdCodec(level=1),
        )
    frame_views = views(recording, frames, background)
    bar = tqdm(frame_views, total=len(frames), unit="frame", disable=None if progress else True)
    for k, (t, view) in enumerate(bar):
        if store is not None:
            store[k] = np.rint(np.sqrt(view.foreground)).astype(np.uint8)
        parts.append(detector(view, roi, frame=t))
    return pd.concat([DETECTIONS.empty(), *parts], ignore_index=True)


@dataclass(frozen=True)
class DetectionRun:
    """Detection in consecutive frames of a recording.

    Parameters
    ----------
    source
        Of the recording.
    start, stop
        First frame, and the one after the last.
    detector, background
        The combined detector, and what is subtracted before.
    chunk
        Frames that are worked on at once.
    differences
        Whether differences to the background are stored beside: 2.8 MB a frame.
    folder
        Of all tables; data/derived if None.
    """

    source: Source
    start: int
    stop: int
    detector: Combination
    background: BackgroundModel = field(default_factory=Median)
    chunk: int = CHUNK
    differences: bool = True
    folder: Path | None = None

    @property
    def chunks(self) -> list[range]:
        """Return the frames in pieces of ``chunk``, cut at its multiples."""
        first = self.start // self.chunk * self.chunk
        ends = range(first, self.stop, self.chunk)
        pieces = [range(max(a, self.start), min(a + self.chunk, self.stop)) for a in ends]
        return [piece for piece in pieces if piece]

    def table(self, frames: range) -> CachedTable:
        """Return the table of a chunk's detections."""
        return CachedTable(
            "detections",
            partial(_detect_chunk, self, frames),
            {
                "source": self.source,
                "frames": [frames.start, frames.stop],
                "detector": self.detector,
                "background": self.background,
            },
            self.folder,
            whole=partial(self.has_differences, frames),
        )

    def differences_of(self, frames: range) -> Path:
        """Return the path of a chunk's frame differences."""
        path = self.table(frames).path
        return path.with_name(path.name.replace("detections", "differences")).with_suffix(".zarr")

    def has_differences(self, frames: range) -> bool:
        """Return whether a chunk has its differences or needs none."""
        return not self.differences or self.differences_of(frames).is_dir()

    def detections(self) -> pd.DataFrame:
        """Return all detections; missing ones are made in this process."""
        parts = [self.table(frames)() for frames in self.chunks]
        return pd.concat([DETECTIONS.empty(), *parts], ignore_index=True)


def _detect_chunk(run: DetectionRun, frames: range) -> pd.DataFrame:
    """Return the detections of a chunk, after storing its differences."""
    cv2.setNumThreads(1)
    find = partial(detect, run.source.recording(), frames, run.detector, run.background)
    if not run.differences:
        return find()
    path, tables = run.differences_of(frames), []
    clear_parts(path)
    make_whole(path, lambda part: tables.append(find(differences=part)))
    return tables[0]


def detections(run: DetectionRun, workers: Workers | None = None) -> pd.DataFrame:
    """Detect in a recording and return its detections; errors as of `detect_all`."""
    detect_all([run], workers, f"detection in {run.source.name}")
    return run.detections()


def detect_all(
    runs: Sequence[DetectionRun], workers: Workers | None = None, label: str = "detection"
) -> None:
    """Make the detections that are missing, with progress.

    Without ``workers`` one process does so.

    Raises
    ------
    InputError
        If something cannot be read or written, or a worker writes to another folder.
    """
    runs = [_placed(run) for run in runs]
    pieces = [(run, frames, run.table(frames).path) for run in runs for frames in run.chunks]
    ready = [path.is_file() and run.has_differences(frames) for run, frames, path in pieces]
    missing = [piece for piece, done in zip(pieces, ready, strict=True) if not done]
    lengths = [len(frames) for _, frames, _ in missing]
    before = sum(len(frames) for _, frames, _ in pieces) - sum(lengths)
    (workers or Workers())(_make_chunk, missing, lengths, label, before)
    lost = [path for *_, path in missing if not path.is_file()]
    if lost:
        raise InputError(
            f"{lost[0]}: a worker has made this, but not here. Give the workers the same folder "
            "under the same name."
        )


def _placed(run: DetectionRun) -> DetectionRun:
    """Return the run with an absolute folder, which workers need."""
    return replace(run, folder=(run.folder or paths.derived()).absolute())


def _make_chunk(piece: tuple[DetectionRun, range, Path]) -> None:
    run, frames, expected = piece
    table = run.table(frames)
    if table.path != expected:
        raise InputError(
            f"{run.source.name}: this worker has another version of kilnflight than the "
            f"caller ({table.path.name}, expected {expected.name}). Install the same one."
        )
    table()


@dataclass(frozen=True)
class KilnRun:
    """A recording with all parameters of its flights.

    Parameters
    ----------
    detection
        Recording, frames, detector, and the folder of all tables.
    exit_point_mm
        Outlet of the lance, its depth calibrated; None: there are no trajectories.
    wall
        The kiln; None: no detection counts as on the wall, and there are no flights.
    in_air
        Which detections are in the air.
    tracker, cutting, regression
        Makes one track of each particle's detections; cuts tracks at steps that no particle
        makes; fits three polynomials to each.
    rules
        Which tracks are flights, and how these are read.
    """

    detection: DetectionRun
    exit_point_mm: Vector | None = None
    wall: Cylinder | None = None
    in_air: InAir = field(default_factory=InAir)
    tracker: GNN = field(default_factory=GNN)
    cutting: Cutting = field(default_factory=Cutting)
    regression: Regression = field(default_factory=Regression)
    rules: flight.Rules = field(default_factory=flight.Rules)

    @property
    def frames(self) -> range:
        """Return the range of frames."""
        return range(self.detection.start, self.detection.stop)

    @property
    def frame_rate_hz(self) -> float:
        """Return the number of frames per second."""
        return self.detection.source.recording().attributes.frame_rate_hz

    def table(self, step: str) -> CachedTable:
        """Return the table of one of `KILN_STEPS`."""
        make, tables, options = KILN_STEPS[step]
        depends_on = {name: self._files(name) for name in tables}
        depends_on |= {name: getattr(self, name) for name in options}
        return CachedTable(step, partial(make, self), depends_on, self.detection.folder)

    def _files(self, step: str) -> list[str]:
        run = self.detection
        if step == "detections":
            return [run.table(frames).path.name for frames in run.chunks]
        return [self.table(step).path.name]


def make_tables(runs: Sequence[KilnRun], workers: Workers | None = None) -> None:
    """Make all missing tables, with progress.

    Then ``run.table(step)()`` reads a table. Without ``workers`` one process does everything.
    Workers of a cluster detect only; ``workers.jobs`` processes on this machine do the later
    steps, a recording each.
    """
    workers = workers or Workers()
    detect_all([run.detection for run in runs], workers)
    runs = [replace(run, detection=_placed(run.detection)) for run in runs]
    for step in KILN_STEPS:
        missing = [run for run in runs if not run.table(step).path.is_file()]
        lengths = [len(run.frames) for run in missing]
        before = sum(len(run.frames) for run in runs) - sum(lengths)
        pieces = [(run, step) for run in missing]
        replace(workers, scheduler=None)(_make_table, pieces, lengths, step, before)


def _make_table(piece: tuple[KilnRun, str]) -> None:
    run, step = piece
    run.table(step)()


def _track(run: KilnRun) -> pd.DataFrame:
    """Return the post-processed tracks of the detections in the air."""
    table = run.detection.detections()
    if run.wall is not None:
        on_wall = run.in_air.on_wall(table[["x", "y", "z"]], run.wall)
        table = table[~on_wall].reset_index(drop=True)
    return run.cutting(postprocess(track(table, run.tracker)), run.frame_rate_hz)


def _regress(run: KilnRun) -> pd.DataFrame:
    if run.exit_point_mm is None:
        return TRAJECTORIES.empty()
    tracks, rate = tracked(run.table("tracks")()), run.frame_rate_hz
    return regression.regress_all(tracks, run.exit_point_mm, rate, run.regression)


def _fly(run: KilnRun) -> pd.DataFrame:
    fits = regression.fits(run.table("trajectories")())
    return flights_from(run, run.table("tracks")(), fits)


def _slice(run: KilnRun) -> pd.DataFrame:
    fits = regression.fits(run.table("trajectories")())
    return slices_from(run.table("flights")(), fits)


def flights_from(
    run: KilnRun, tracks: pd.DataFrame, fits: Mapping[int, regression.Fit]
) -> pd.DataFrame:
    """Return the flights of tracks with these fits; none without a wall."""
    if run.wall is None:
        return FLIGHTS.empty()
    recording, table = run.detection.source.recording(), tracked(tracks)
    table = table.assign(background=background_gray(table, run.detection.source, run.frames))
    view, rate = flight.FieldOfView(recording.attributes.roi, run.frames), run.frame_rate_hz
    return flight.flights(table, fits, run.wall, run.in_air, rate, run.rules, view)


def slices_from(flights: pd.DataFrame, fits: Mapping[int, regression.Fit]) -> pd.DataFrame:
    """Return the space-sliced velocities of flights from the lance that are not refused."""
    counted = flight.kept(flights[flights["from_lance"]])
    ends = dict(zip(counted["particle"].tolist(), counted["end_s"].tolist(), strict=True))
    return flight.slices({particle: fits[particle] for particle in ends}, ends)


def background_gray(
    detections: pd.DataFrame, source: Source, frames: range
) -> npt.NDArray[np.float64]:
    """Return the kiln's mean grey value (n,) behind each detection's disc.

    The kiln is the median of `BACKGROUND_FRAMES` pictures spread over ``frames``
    (`kilnflight.ignition.Ignition` says what for).
    """
    picture = _empty_kiln(source, frames).astype(np.float64)
    return mean_gray(picture, detections[["row", "col", "radius_px"]].to_numpy(np.float64))


@lru_cache(maxsize=8)  # of a study's campaigns: 12 MB each
def _empty_kiln(source: Source, frames: range) -> npt.NDArray[np.floating]:
    """Return the median picture (rows, cols) of a recording; kept, as pictures cost seconds."""
    steps = np.linspace(frames.start, frames.stop - 1, BACKGROUND_FRAMES).round().astype(int)
    return stack_median([source.recording().gray(t) for t in np.unique(steps).tolist()])


# The function of each table, with the tables and options it needs.
KILN_STEPS: dict[str, tuple[Callable[[KilnRun], pd.DataFrame], Names, Names]] = {
    "tracks": (_track, ("detections",), ("wall", "in_air", "tracker", "cutting")),
    "trajectories": (_regress, ("tracks",), ("exit_point_mm", "regression")),
    "flights": (_fly, ("tracks", "trajectories"), ("rules",)),
    "slices": (_slice, ("trajectories", "flights"), ()),
}
