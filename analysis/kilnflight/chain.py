"""From frames to flights: the whole chain of steps, with cached tables.

frame -> view -> detections -> tracks -> trajectories -> flights, slices

Each arrow after the view is a table that is made once. Detection takes nearly all of
the time; processes or a cluster share it by chunks of frames. A killed run continues
with the first missing table. Tracks are made without the texture term of Eq. 4.24: it
needs the frame differences, some 3 MB a frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from kilnflight import flight, regression
from kilnflight.association import GNN
from kilnflight.background import BackgroundModel, Median
from kilnflight.camera import calibrate_points
from kilnflight.checks import InputError
from kilnflight.detection.combination import Combination, Planar, View
from kilnflight.detection.otsu import flame_mask
from kilnflight.detection.peaks import Smoother
from kilnflight.detection.wall import Cylinder, InAir
from kilnflight.flight.empty import background_gray
from kilnflight.recording.buffer import FrameBuffer
from kilnflight.recording.frames import Recording, Source
from kilnflight.regression import Regression
from kilnflight.store import paths
from kilnflight.store.cache import CachedTable, cached
from kilnflight.store.parallel import Workers
from kilnflight.tables import DETECTIONS, FLIGHTS, TRAJECTORIES
from kilnflight.tracking.filter import ConstantVelocity, Motion
from kilnflight.tracking.tracker import Management, track
from kilnflight.tracklets import Cutting, postprocess, tracked

CHUNK_FRAMES = 500  # of one chunk; each reads the median's window, 150 frames, again
CHAIN_STEPS = (
    "tracks",
    "trajectories",
    "flights",
    "slices",
)  # tables after the detections
TRACKED_BY = (
    "wall",
    "in_air",
    "tracker",
    "motion",
    "management",
    "post_processing",
    "cutting",
)
Vector = tuple[float, float, float]  # x, y, z in mm


def views(
    recording: Recording,
    frames: Iterable[int],
    background: BackgroundModel | None = None,
) -> Iterator[tuple[int, View]]:
    """Yield the number and the view, without the flame, of each of ``frames``.

    The default background is the temporal median over 150 frames (section 5.1.2).
    Depths are calibrated as the recording states. The first frame is compared with the
    one after it, as no frame precedes it.
    """
    frames = list(frames)
    attributes = recording.attributes
    smooth = Smoother()
    before = [t - 1 if t > 0 else min(1, len(recording) - 1) for t in frames]
    buffer = FrameBuffer(recording, [*frames, *before])
    foregrounds = (background or Median())(buffer, frames)
    for t, beside, foreground in zip(frames, before, foregrounds, strict=True):
        previous = buffer.take(beside).gray
        frame = buffer.take(t)
        pixels = frame.pixels
        xyz = calibrate_points(frame.xyz, attributes.depth_calibration)
        if attributes.flame_roi is not None:
            flame = flame_mask(frame.gray, attributes.flame_roi)
            foreground[flame] = 0  # in place: each model returns a new array
            keep = ~flame.take(pixels[:, 0] * flame.shape[1] + pixels[:, 1])
            pixels = pixels.compress(keep, axis=0)
            xyz = xyz.compress(keep, axis=0)
        yield (
            t,
            View(frame.gray, previous, foreground, pixels, xyz, smooth, frame.index),
        )


def detect_frames(
    recording: Recording,
    frames: Sequence[int],
    detector: Combination | Planar | None = None,
    background: BackgroundModel | None = None,
    progress: bool = False,
) -> pd.DataFrame:
    """Return the detections of a recording's frames by the combined detector.

    Parameters
    ----------
    recording
        Recording with its region of interest and flame.
    frames
        Frame numbers from 0.
    detector, background
        Combined detector and background model; None: the defaults, `Combination` and
        `Median`.
    progress
        Whether to show a progress bar.

    Returns
    -------
    DataFrame
        `kilnflight.tables.DETECTIONS`.
    """
    detector = detector or Combination()
    roi = recording.attributes.roi
    seen = views(recording, frames, background)
    bar = tqdm(
        seen, total=len(frames), unit="frame", disable=None if progress else True
    )
    first = recording.frame(0).index  # a gap in the numbers is a gap in time
    parts = [detector(view, roi, frame=view.number - first) for _, view in bar]
    return pd.concat([DETECTIONS.empty(), *parts], ignore_index=True)


@dataclass(frozen=True)
class DetectionRun:
    """Detection in consecutive frames of a recording, in one cached table per chunk.

    Parameters
    ----------
    source
        Names and opens the recording.
    start, stop
        First frame, and the one after the last.
    detector, background
        Combined detector and background model.
    chunk
        Frames per table.
    folder
        Folder of all tables; `kilnflight.store.paths.derived` by default.
    """

    source: Source
    start: int
    stop: int
    detector: Combination | Planar
    background: BackgroundModel = field(default_factory=Median)
    chunk: int = CHUNK_FRAMES
    folder: Path = field(default_factory=lambda: paths.derived().absolute())

    @property
    def chunks(self) -> list[range]:
        """Frames of each table: ranges cut at multiples of ``chunk``."""
        first = self.start // self.chunk * self.chunk
        ends = range(first, self.stop, self.chunk)
        pieces = [
            range(max(a, self.start), min(a + self.chunk, self.stop)) for a in ends
        ]
        return [piece for piece in pieces if piece]

    def table(self, frames: range) -> CachedTable:
        """Return the table of a chunk's detections."""
        names = ("source", "detector", "background")
        depends_on = {name: getattr(self, name) for name in names} | {"frames": frames}
        return CachedTable(
            "detections", partial(self._detect, frames), depends_on, self.folder
        )

    def _detect(self, frames: range) -> pd.DataFrame:
        return detect_frames(
            self.source.recording(), frames, self.detector, self.background
        )

    def detections(self) -> pd.DataFrame:
        """Return all detections (`DETECTIONS`); this process makes missing tables."""
        parts = [self.table(frames)() for frames in self.chunks]
        return pd.concat([DETECTIONS.empty(), *parts], ignore_index=True)


@dataclass(frozen=True)
class Chain:
    """A recording with all parameters of its flights.

    Each of `CHAIN_STEPS` is an attribute: the `CachedTable` of that name.

    Parameters
    ----------
    detection
        Recording, frames, detector, and the folder of all tables.
    exit_point_mm
        Outlet of the lance, its depth calibrated; None: no trajectories.
    wall
        The kiln; None: no detection counts as on the wall, and there are no flights.
    in_air
        Selects the detections in the air.
    tracker, motion, management, cutting, regression
        Parameters of tracking, of splitting tracks at impossible steps, and of the
        fits.
    post_processing
        Whether tracklets are joined and filtered (chapter 4.2), and split.
    rules
        Criteria of flights.
    """

    detection: DetectionRun
    exit_point_mm: Vector | None = None
    wall: Cylinder | None = None
    in_air: InAir = field(default_factory=InAir)
    tracker: GNN = field(default_factory=GNN)
    motion: Motion = field(default_factory=ConstantVelocity)
    management: Management = field(default_factory=Management)
    post_processing: bool = True
    cutting: Cutting = field(default_factory=Cutting)
    regression: Regression = field(default_factory=Regression)
    rules: flight.Rules = field(default_factory=flight.Rules)

    @property
    def frames(self) -> range:
        """Frames with detections."""
        return range(self.detection.start, self.detection.stop)

    @property
    def frame_rate_hz(self) -> float:
        """Frames per second."""
        return self.detection.source.recording().attributes.frame_rate_hz

    @property
    def folder(self) -> Path:
        """Folder of all tables."""
        return self.detection.folder

    @property
    def detected(self) -> list[CachedTable]:
        """Tables of detections."""
        return [self.detection.table(frames) for frames in self.detection.chunks]

    def table(self, what: range | str) -> CachedTable:
        """Return the table of a chunk's detections, or of one of `CHAIN_STEPS`."""
        if isinstance(what, range):
            return self.detection.table(what)
        table: CachedTable = getattr(self, what)
        return table

    @cached("detected", *TRACKED_BY)
    def tracks(self) -> pd.DataFrame:
        """Post-processed tracks of the detections in the air, split at impossible
        steps.

        The table is that of the detections that are not on the wall, and ``particle``:
        the track (-1: none).
        """
        table = self.detection.detections()
        if self.wall is not None:
            on_wall = self.in_air.on_wall(table[["x", "y", "z"]], self.wall)
            table = table[~on_wall].reset_index(drop=True)
        done = track(table, self.tracker, self.motion, management=self.management)
        return (
            self.cutting(postprocess(done), self.frame_rate_hz)
            if self.post_processing
            else done
        )

    @cached("tracks", "exit_point_mm", "regression")
    def trajectories(self) -> pd.DataFrame:
        """Fitted trajectories (`TRAJECTORIES`); none without the lance's outlet."""
        if self.exit_point_mm is None:
            return TRAJECTORIES.empty()
        tracks = tracked(self.tracks())
        rate = self.frame_rate_hz
        return regression.regress_all(tracks, self.exit_point_mm, rate, self.regression)

    @cached("tracks", "trajectories", "rules")
    def flights(self) -> pd.DataFrame:
        """Flights of the trajectories (`FLIGHTS`); none without a wall."""
        return flights_from(self, self.tracks(), regression.fits(self.trajectories()))

    @cached("trajectories", "flights")
    def slices(self) -> pd.DataFrame:
        """Velocities within each metre of accepted flights from the lance (`SLICES`)."""
        return slices_from(self.flights(), regression.fits(self.trajectories()))


def make_tables(
    runs: Sequence[Chain],
    workers: Workers | int | None = None,
    steps: Sequence[str] = CHAIN_STEPS,
) -> None:
    """Make all missing tables, or those up to ``steps``, with progress; one process by
    default.

    Workers of a cluster only detect. The later steps take ``workers.jobs`` processes on
    this machine, one per recording.

    Raises
    ------
    InputError
        If something cannot be read or written, or a worker writes to another folder.
    """
    workers = Workers(workers) if isinstance(workers, int) else workers or Workers()
    chunks = [
        (run, frames, len(frames)) for run in runs for frames in run.detection.chunks
    ]
    _make_missing(chunks, workers, "detection")
    for step in steps:
        pieces = [(run, step, len(run.frames)) for run in runs]
        _make_missing(pieces, replace(workers, scheduler=None), step)


def _make_missing(
    pieces: Sequence[tuple[Chain, range | str, int]], workers: Workers, label: str
) -> None:
    """Make the missing ones of ``pieces``: run, its chunk or step, number of frames.

    ``label`` names them in the progress bar. `InputError`: a worker wrote elsewhere.
    """
    wanted = [(run, what, run.table(what).path, size) for run, what, size in pieces]
    missing = [each for each in wanted if not each[2].is_file()]
    lengths = [size for *_, size in missing]
    before = sum(size for *_, size in wanted) - sum(lengths)
    workers(_make_table, [each[:3] for each in missing], lengths, label, before)
    for lost in [path for *_, path, _ in missing if not path.is_file()][:1]:
        elsewhere = (
            "was made by a worker elsewhere. Give workers the same folder by the "
            "same name"
        )
        raise InputError(f"{lost}: {elsewhere}.")


def _make_table(piece: tuple[Chain, range | str, Path]) -> None:
    """Make the table of a run's chunk or step, in a worker.

    Last in ``piece`` is the file that the caller expects; another one is an
    `InputError`.
    """
    run, what, expected = piece
    table = run.table(what)
    if table.path != expected:
        raise InputError(
            f"{expected.name}: this worker has another version of kilnflight than the "
            f"caller ({table.path.name}). Install the same one."
        )
    table()


def flights_from(
    run: Chain, tracks: pd.DataFrame, fits: Mapping[int, regression.Fit]
) -> pd.DataFrame:
    """Return the flights of ``tracks``; none without a wall.

    They are `kilnflight.tables.FLIGHTS`. ``fits`` are the trajectories by particle.
    Studies call it with other fits than the run's.
    """
    if run.wall is None:
        return FLIGHTS.empty()
    recording = run.detection.source.recording()
    table = tracked(tracks)
    table = table.assign(
        background=background_gray(table, run.detection.source, run.frames)
    )
    first, last = (recording.frame(t).index for t in (0, run.frames[-1]))
    view = flight.FieldOfView(recording.attributes.roi, range(last - first + 1))
    return flight.flights(
        table, fits, run.wall, run.in_air, run.frame_rate_hz, run.rules, view
    )


def slices_from(
    flights: pd.DataFrame, fits: Mapping[int, regression.Fit]
) -> pd.DataFrame:
    """Return the space-sliced velocities of accepted flights from the lance.

    It is `kilnflight.tables.SLICES`, in m/s. ``flights`` is
    `kilnflight.tables.FLIGHTS`, and ``fits`` are the trajectories by particle.
    """
    counted = flight.kept(flights[flights["from_lance"]])
    ends = dict(
        zip(counted["particle"].tolist(), counted["end_s"].tolist(), strict=True)
    )
    return flight.slices({particle: fits[particle] for particle in ends}, ends)
