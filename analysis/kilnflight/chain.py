"""From frames to flights: the whole chain of steps, with cached tables.

frame -> view -> detections -> tracks -> trajectories -> flights, slices

Each arrow after the view is a table that is made once. Detection takes nearly all of
the time; processes or a cluster share it by chunks of frames. A killed run continues
with the first missing table. Tracks are made without the texture term of Eq. 4.24: it
needs the frame differences, some 3 MB a frame.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from pandas import DataFrame
from tqdm import tqdm

from kilnflight import flight, regression
from kilnflight.association import GNN
from kilnflight.background import BackgroundModel, Median
from kilnflight.camera import calibrate_points
from kilnflight.checks import Count, InputError, Number, Settings
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

CHUNK_FRAMES = 500  # each chunk reads the median's window, 150 frames, again
# Tables after the detections.
CHAIN_STEPS = ("tracks", "trajectories", "flights", "slices")
Vector = tuple[Number, Number, Number]  # x, y, z in mm


def views(
    recording: Recording,
    frames: Iterable[int],
    background: BackgroundModel | None = None,
) -> Iterator[tuple[int, View]]:
    """Yield the position t, from 0, and the view of each of ``frames``.

    `View.number` is the camera's number. A view has no flame; its depths are calibrated
    as the recording states. The default background is the temporal median over 150
    frames (section 5.1.2). `View.previous` of the first frame is the one after it, as
    no frame precedes it.
    """
    frames = list(frames)
    attributes = recording.attributes
    smooth = Smoother()
    neighbours = [t - 1 if t > 0 else min(1, len(recording) - 1) for t in frames]
    buffer = FrameBuffer(recording, [*frames, *neighbours])
    foregrounds = (background or Median())(buffer, frames)
    for t, neighbour, foreground in zip(frames, neighbours, foregrounds, strict=True):
        previous = buffer.take(neighbour).gray
        frame = buffer.take(t)
        pixels = frame.pixels
        xyz = frame.xyz
        if attributes.flame_roi is not None:
            flame = flame_mask(frame.gray, attributes.flame_roi)
            foreground[flame] = 0  # each model returns a new array
            kept = ~flame.take(pixels[:, 0] * flame.shape[1] + pixels[:, 1])
            pixels = pixels.compress(kept, axis=0)
            xyz = xyz.compress(kept, axis=0)
        yield (
            t,
            View(
                gray=frame.gray,
                previous=previous,
                foreground=foreground,
                pixels=pixels,
                xyz=calibrate_points(xyz, attributes.depth_calibration),
                smooth=smooth,
                number=frame.index,
            ),
        )


def detect_frames(
    recording: Recording,
    frames: Sequence[int],
    detector: Combination | Planar | None = None,
    background: BackgroundModel | None = None,
    progress: bool = False,
) -> DataFrame:
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
    hidden = None if progress else True  # None: only without a terminal
    bar = tqdm(seen, total=len(frames), unit="frame", disable=hidden)
    first = recording.frame(0).index  # a gap in the numbers is a gap in time
    return DETECTIONS.join(
        detector(view, roi, frame=view.number - first) for _, view in bar
    )


class DetectionRun(Settings):
    """Detection in consecutive frames of a recording, in one cached table per chunk.

    Parameters
    ----------
    source
        Names and opens the recording.
    frames
        Frames to detect in.
    detector, background
        Combined detector and background model.
    chunk
        Frames per table.
    folder
        Folder of all tables; `kilnflight.store.paths.derived` by default.
    """

    source: Source
    frames: range
    detector: Combination | Planar
    background: BackgroundModel
    chunk: Count
    folder: Path = field(default_factory=lambda: paths.derived().absolute())

    @property
    def chunks(self) -> list[range]:
        """Frames of each table: ranges cut at multiples of ``chunk``."""
        first = -(self.frames.start % self.chunk)
        cuts = range(first, len(self.frames), self.chunk)
        pieces = [self.frames[max(cut, 0) : cut + self.chunk] for cut in cuts]
        return [piece for piece in pieces if piece]

    def table(self, frames: range) -> CachedTable:
        """Return the table of a chunk's detections."""
        depends_on = {
            "source": self.source,
            "detector": self.detector,
            "background": self.background,
            "frames": frames,
        }
        make = partial(self._detect, frames)
        return CachedTable("detections", make, depends_on, self.folder)

    def _detect(self, frames: range) -> DataFrame:
        return detect_frames(
            self.source.recording(), frames, self.detector, self.background
        )

    def detections(self) -> DataFrame:
        """Return all detections (`DETECTIONS`); this process makes missing tables."""
        return DETECTIONS.join(self.table(frames)() for frames in self.chunks)


class Chain(Settings):
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
    in_air: InAir = InAir()
    tracker: GNN = GNN()
    motion: Motion = ConstantVelocity()
    management: Management = Management()
    post_processing: bool = True
    cutting: Cutting = Cutting()
    regression: Regression = Regression()
    rules: flight.Rules = flight.Rules()

    @property
    def frames(self) -> range:
        """Frames with detections."""
        return self.detection.frames

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

    @cached(
        "detected",
        "wall",
        "in_air",
        "tracker",
        "motion",
        "management",
        "post_processing",
        "cutting",
    )
    def tracks(self) -> DataFrame:
        """Tracks of the detections in the air, post-processed and split.

        The table is that of the detections that are not on the wall, and ``particle``:
        the track (-1: none). Tracks are split at impossible steps. Without
        post-processing it has the column ``link``, too.
        """
        table = self.detection.detections()
        if self.wall is not None:
            on_wall = self.in_air.on_wall(table[["x", "y", "z"]], self.wall)
            table = table[~on_wall].reset_index(drop=True)
        done = track(
            table,
            self.tracker,
            self.motion,
            management=self.management,
            link=not self.post_processing,
        )
        if self.post_processing:
            return self.cutting(postprocess(done), self.frame_rate_hz)
        return done

    @cached("tracks", "exit_point_mm", "regression")
    def trajectories(self) -> DataFrame:
        """Fitted trajectories (`TRAJECTORIES`); none without the lance's outlet."""
        if self.exit_point_mm is None:
            return TRAJECTORIES.empty()
        tracks = tracked(self.tracks())
        rate = self.frame_rate_hz
        return regression.regress_all(tracks, self.exit_point_mm, rate, self.regression)

    @cached("tracks", "trajectories", "rules")
    def flights(self) -> DataFrame:
        """Flights of the trajectories (`FLIGHTS`); none without a wall."""
        return flights_from(self, self.tracks(), regression.fits(self.trajectories()))

    @cached("trajectories", "flights")
    def slices(self) -> DataFrame:
        """Velocities by metre of accepted flights from the lance (`SLICES`)."""
        return slices_from(self.flights(), regression.fits(self.trajectories()))


class Piece(NamedTuple):
    """A table that a worker makes: a chunk of frames to detect in, or a step."""

    run: Chain
    what: range | str
    frames: int  # their number, for the progress bar

    @property
    def table(self) -> CachedTable:
        """The table."""
        return self.run.table(self.what)


def make_tables(
    runs: Sequence[Chain],
    workers: Workers | int | None = None,
    steps: Sequence[str] = CHAIN_STEPS,
) -> None:
    """Make all missing tables with progress, one process by default.

    Workers of a cluster only detect. The later steps take ``workers.jobs`` processes on
    this machine, one per recording.

    Parameters
    ----------
    runs
        Chains of recordings.
    workers
        Processes or a cluster; a number of processes; None: this process.
    steps
        Steps whose tables are made after the detections.

    Raises
    ------
    InputError
        If something cannot be read or written, or a worker writes to another folder.
    """
    workers = workers_of(workers)
    chunks = []
    for run in runs:
        chunks += [Piece(run, frames, len(frames)) for frames in run.detection.chunks]
    _make_missing(chunks, workers, "detection")
    local = replace(workers, scheduler=None)
    for step in steps:
        pieces = [Piece(run, step, len(run.frames)) for run in runs]
        _make_missing(pieces, local, step)


def workers_of(given: Workers | int | None) -> Workers:
    """Return workers, or so many processes; None: one."""
    if callable(given):
        return given
    return Workers(1 if given is None else given)


def _make_missing(pieces: Sequence[Piece], workers: Workers, label: str) -> None:
    """Make the missing tables; ``label`` names them in the progress bar.

    Raises an `InputError` if a worker wrote elsewhere.
    """
    expected = {piece.table.path: piece for piece in pieces}
    missing = {path: each for path, each in expected.items() if not path.is_file()}
    lengths = [piece.frames for piece in missing.values()]
    before = sum(piece.frames for piece in pieces) - sum(lengths)
    workers(_make_table, list(missing.items()), lengths, label, before)
    for path in missing:
        if not path.is_file():
            raise InputError(
                f"{path}: was made by a worker elsewhere. Give workers the same folder "
                "by the same name."
            )


def _make_table(expected: tuple[Path, Piece]) -> None:
    """Make the table of a piece in a worker; another file than expected is refused."""
    path, piece = expected
    table = piece.table
    if table.path != path:
        raise InputError(
            f"{path.name}: this worker has another version of kilnflight than the "
            f"caller ({table.path.name}). Install the same one."
        )
    table()


def flights_from(
    run: Chain, tracks: DataFrame, fits: Mapping[int, regression.Fit]
) -> DataFrame:
    """Return the flights of ``tracks``; none without a wall.

    They are `kilnflight.tables.FLIGHTS`. ``fits`` are the trajectories by particle.
    Studies call it with other fits than the run's.
    """
    if run.wall is None:
        return FLIGHTS.empty()
    source = run.detection.source
    recording = source.recording()
    table = tracked(tracks)
    table = table.assign(background=background_gray(table, source, run.frames))
    last = recording.frame(run.frames[-1]).index - recording.frame(0).index
    view = flight.FieldOfView(recording.attributes.roi, range(last + 1))
    return flight.flights(
        table, fits, run.wall, run.in_air, run.frame_rate_hz, run.rules, view
    )


def slices_from(flights: DataFrame, fits: Mapping[int, regression.Fit]) -> DataFrame:
    """Return the space-sliced velocities of accepted flights from the lance.

    It is `kilnflight.tables.SLICES`, in m/s. ``flights`` is
    `kilnflight.tables.FLIGHTS`, and ``fits`` are the trajectories by particle.
    """
    counted = flight.kept(flights[flights["from_lance"]])
    ends = dict(zip(counted["particle"].tolist(), counted["end_s"], strict=True))
    return flight.slices({particle: fits[particle] for particle in ends}, ends)
