"""`kilnflight run`: all steps on a stored recording, with a report.

recording + `Options` -> `prepare` -> `kilnflight.kiln` -> `Results` -> tables, summary, page

Missing options are taken from the recording where possible, with a note: the threshold from its
noise, the kiln's wall from its clouds. `open`, `detect`, `track` and `plot_tracks` are the same
steps in Python, and also names of `kilnflight` itself.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pandas as pd
from skimage.util import view_as_blocks

from kilnflight import kiln, tracking
from kilnflight.association import GNN, Associator
from kilnflight.checks import InputError, check_positive
from kilnflight.detection import DBSCAN, DoG
from kilnflight.detection.combination import Combination
from kilnflight.detection.sift import LAYERS, SIGMA_PX
from kilnflight.detection.wall import Cylinder, InAir, fit_cylinder
from kilnflight.flight import Plausible, Rules
from kilnflight.ignition import Ignition
from kilnflight.kiln import KILN_STEPS, LONG_CHUNK, DetectionRun, KilnRun, Vector
from kilnflight.project.cache import clear_parts, locked, write_resumable
from kilnflight.project.parallel import Workers
from kilnflight.recording.files import Channel, open_any
from kilnflight.recording.frames import Recording, calibrated_cloud
from kilnflight.recording.store import StoredRecording, aligned
from kilnflight.run.lance import place_in_picture
from kilnflight.run.report import Results, Row, collect, listed, page, plot_tracks, summary
from kilnflight.tracklets import Cutting, postprocess

__all__ = ["Options", "detect", "fitted_wall", "open", "plot_tracks", "run", "track"]

NOISE_FRAMES = 5  # spread over the first 150, the median's window
WALL_FRAMES = 5  # spread over the recording
PIECES = 8  # that a recording is detected in at least, if it is long enough: work for --jobs
LEAST_CHUNK = 25  # frames; every piece reads the median's window, 150 frames, anew
BLOCK_PX = 32  # side of the blocks in which noise is measured
NOISY_SHARE = 0.9  # of the blocks are quieter: noise grows with light, particles are few
TIMES_NOISE = 5.0  # as `Combination.prominence`: what stands out of the noise
LEAST_NOISE = 1.0  # a grey value; a picture without any noise is a made-up one
MEDIAN_TO_SIGMA = 1.4826  # median of |noise| -> standard deviation of Gaussian noise
MEASURED = "the noise of the first frames"
NO_NOISE = (
    "the least noise there is; the first frames have less (are they all of one grey value, "
    "saturated or made up?)"
)
UNEVEN = 0.01  # share by which intervals between frames may differ from the frame rate

_GNN = GNN()


@dataclass(frozen=True)
class Options:
    """The user's options; None leaves one to the recording.

    Parameters
    ----------
    threshold
        Of DoG, grey values.
    exit_point_mm
        Outlet of the lance: camera coordinates as captured, as ``lance_mm`` of a manifest.
    in_air_mm
        Largest distance from the kiln's axis of what is in the air.
    bright
        Grey value that only what burns reaches, such as the camera's full scale. A particle whose
        first grey values reach it, and that shows no step, was alight when first seen. None: it
        counts as unlit, as in the thesis, which prints no such value
        (`kilnflight.ignition.Ignition`).
    above_background
        Whether ignition is a step of the grey values above those of the background, and not as
        they are (`kilnflight.kiln.background_gray`).
    air_m_s
        Velocity of the air at the lance's outlet; default: the thesis's at 5 bar (sec. 2.1.1).
        Flights faster than twice as much are refused (`kilnflight.flight.Plausible`), and tracks
        cut where they are (`kilnflight.tracklets.Cutting`).
    """

    threshold: float | None = None
    exit_point_mm: Vector | None = None
    in_air_mm: float = 800.0  # sec. 5.1.4
    bright: float | None = None
    above_background: bool = False
    air_m_s: float = Plausible().air_m_s

    def __post_init__(self) -> None:
        """Refuse options that are not above 0."""
        for name in ("threshold", "in_air_mm", "bright", "air_m_s"):
            if getattr(self, name) is not None:
                check_positive(getattr(self, name), name)


def open(source: Any, frame_rate_hz: float | None = None, channel: Channel = None) -> Recording:
    """Open a recording of any kind for `detect` and `plot_tracks`.

    Parameters and errors are those of `kilnflight.recording.files.open_any`.

    Examples
    --------
    >>> len(open(np.zeros((3, 24, 32), np.uint16)))
    3
    """
    return open_any(source, channel=channel, frame_rate_hz=frame_rate_hz)


def detect(
    recording: Recording, threshold: float | None = None, progress: bool = False
) -> pd.DataFrame:
    """Return the detections in all frames (`kilnflight.tables.DETECTIONS`).

    Parameters
    ----------
    recording
        As `open` or `kilnflight.twin.scenes.open_scene` gives it.
    threshold
        Of DoG in grey values; five times the noise if None (`noise_threshold`).
    progress
        Whether to show a bar in a terminal.
    """
    threshold = noise_threshold(recording) if threshold is None else threshold
    frames, detector = range(len(recording)), Combination(DoG(threshold))
    return kiln.detect(recording, frames, detector, progress=progress)


def track(
    detections: pd.DataFrame, associator: Associator = _GNN, raw: bool = False
) -> pd.DataFrame:
    """Return detections with ``particle``, post-processed unless ``raw``.

    A ``particle`` of -1 means in no track. Parameters and errors are those of
    `kilnflight.tracking.track`.
    """
    tracks = tracking.track(detections, associator)
    return tracks if raw else postprocess(tracks)


def run(folder: Path, target: Path | None, options: Options, workers: Workers) -> None:
    """Run all steps and print the results.

    A killed run goes on where it stopped.

    Raises
    ------
    InputError
        As `prepare` and `publish`.
    """
    target = target or beside(folder)
    prepared, notes = prepare(folder, target, options)
    for note in notes:
        print(f"note: {note}")
    kiln.make_tables([prepared], workers)
    jobs = str(workers.jobs) if workers.scheduler is None else f"those of {workers.scheduler}"
    results = collect(prepared, notes, settings(prepared, options, jobs))
    for note in results.notes[len(notes) :]:
        print(f"note: {note}")
    report = publish(results, prepared.detection.source.recording(), target)
    print(aligned(summary(results)))
    print(f"tables and report: {report}")


def beside(folder: Path) -> Path:
    """Return a run's default folder, beside its recording.

    Examples
    --------
    >>> beside(Path("kiln/chips.zarr")).as_posix()
    'kiln/chips-run'
    """
    path = folder if folder.name not in ("", "..") else folder.resolve()
    return path.with_name(path.name.removesuffix(".zarr") + "-run")


def prepare(folder: Path, target: Path, options: Options) -> tuple[KilnRun, tuple[str, ...]]:
    """Return the run of a stored recording, and notes for the reader.

    Raises
    ------
    InputError
        If there is no recording, it has depth and the lance's outlet is not known, or the
        target is in the recording's own folder.
    """
    source = kiln.stored_source(folder)
    if target.resolve().is_relative_to(folder.resolve()):
        raise InputError(
            f"--to {target}: lies in the recording {folder}, which is only read. Give a folder "
            f"of its own, such as {beside(folder)}."
        )
    if target.exists() and not target.is_dir():
        raise InputError(f"--to {target}: is a file. Give a folder, such as {beside(folder)}.")
    recording = source.recording()
    notes: list[str] = []
    threshold = options.threshold or _threshold(recording, notes)
    lance = wall = None
    if recording.per_frame["points"].any():
        attributes = recording.attributes
        if options.exit_point_mm:
            attributes = replace(attributes, lance_mm=options.exit_point_mm)
        try:
            lance = attributes.exit_point_mm
        except InputError as error:
            raise InputError(f"recording {source.name}: lance: {error}") from error
        if lance is None:
            raise InputError(
                f"recording {source.name}: where the lance ends is not known. Give --exit-point "
                "x,y,z (mm, camera coordinates as captured), or lance_mm in its manifest."
            )
        _check_lance(recording, lance, notes)
        wall = _wall(recording, notes)
    else:
        notes.append(
            "The recording has no depth: tracks are 2D. Trajectories, dwell times, velocities "
            "and ignition times need depth and were not made."
        )
    _check_times(recording, notes)
    frames, detector, parts = len(recording), Combination(DoG(threshold)), target / "parts"
    detection = DetectionRun(
        source, 0, frames, detector, chunk=chunk(frames), differences=False, folder=parts
    )
    plausible = Plausible(options.air_m_s)
    rules = Rules(
        ignition=Ignition(bright=options.bright, above_background=options.above_background),
        plausible=plausible,
    )
    in_air, cutting = InAir(options.in_air_mm), Cutting(plausible.fastest_m_s)
    run = KilnRun(detection, lance, wall, in_air, cutting=cutting, rules=rules)
    return run, tuple(notes)


def chunk(frames: int) -> int:
    """Return the number of frames that are detected in one piece.

    It is the same for any number of workers.

    Examples
    --------
    >>> [chunk(frames) for frames in (10, 1001, 24_000)]
    [25, 126, 500]
    """
    return min(LONG_CHUNK, max(LEAST_CHUNK, -(-frames // PIECES)))


def _threshold(recording: Recording, notes: list[str]) -> float:
    threshold = noise_threshold(recording)
    noise = MEASURED if threshold > TIMES_NOISE * LEAST_NOISE else NO_NOISE
    notes.append(
        f"No threshold was given: {threshold:g} grey values are {TIMES_NOISE:g} times {noise}. It "
        "decides how much is found; compare others with --threshold."
    )
    return threshold


def noise_threshold(recording: Recording) -> float:
    """Return a threshold of DoG in grey values, from the noise.

    Notes
    -----
    The thesis tunes its threshold on labelled frames; without labels noise is all there is. In
    each of a few frames the finest difference of Gaussians is measured in small blocks. The median
    of its absolute value, times 1.4826, is a standard deviation of Gaussian noise. Particles,
    which cover a small part of a block, hardly move it. Noise grows with light, so a noisy block
    counts, the one that nine tenths are quieter than. Of the frames the median is taken, times
    five. That bounds false alarms of noise; flicker of a flame's light is not noise of a pixel,
    and a higher threshold may be better.
    """
    frames = _spread(min(len(recording), 150), NOISE_FRAMES)  # 150: the median's window
    noise = [block_noise(view.foreground) for _, view in kiln.views(recording, frames)]
    return round(TIMES_NOISE * max(float(np.median(noise)), LEAST_NOISE), 1)


def _spread(length: int, number: int) -> list[int]:
    """Return ``number`` indices, or all, spread evenly over a length."""
    return np.unique(np.linspace(0, length - 1, number).round().astype(int)).tolist()


def block_noise(foreground: npt.NDArray[np.float32]) -> float:
    """Return the noise of a foreground's difference of Gaussians.

    It is measured in a noisy block, as `noise_threshold` explains.
    """
    fine, coarse = (
        cv2.GaussianBlur(foreground, (0, 0), np.sqrt(scale**2 - DoG().camera_blur ** 2))
        for scale in (SIGMA_PX, SIGMA_PX * 2 ** (1 / LAYERS))
    )
    rows, cols = foreground.shape
    size = min(BLOCK_PX, rows, cols)
    response = np.abs(fine - coarse)[: rows // size * size, : cols // size * size]
    middle = np.median(view_as_blocks(response, (size, size)), axis=(2, 3))
    return float(np.quantile(middle, NOISY_SHARE)) * MEDIAN_TO_SIGMA


def _check_lance(recording: StoredRecording, lance: Vector, notes: list[str]) -> None:
    """Note an outlet outside the picture."""
    size = recording.attributes.size
    known = np.flatnonzero(recording.per_frame["points"])
    place = place_in_picture(recording, known[_spread(len(known), WALL_FRAMES)].tolist(), lance)
    if place is not None and not all(0 <= at < n for at, n in zip(place, size, strict=True)):
        notes.append(
            f"The lance ends outside the picture, at row {place[0]:.0f} and column {place[1]:.0f} "
            f"of {size[0]} x {size[1]} pixels: particles come into view later, and what they do "
            "before is not seen. Is its outlet right (mm, as captured), and the depth_calibration?"
        )


def _wall(recording: StoredRecording, notes: list[str]) -> Cylinder | None:
    """Return the kiln's wall from a few frames, or None with a note."""
    known = np.flatnonzero(recording.per_frame["points"])
    try:
        return fitted_wall(recording, known[_spread(len(known), WALL_FRAMES)].tolist())
    except InputError as error:
        notes.append(
            f"The kiln's wall was not found ({error}) What lies on it was tracked like what "
            "flies; dwell times, velocities and ignition were not made."
        )
        return None


def fitted_wall(recording: Recording, frames: Iterable[int]) -> Cylinder:
    """Return the cylinder of the largest cluster in some frames.

    Sections 3.1 and 3.2 of the thesis. The clouds of the frames are put together, which makes a
    still wall denser than what flies.
    """
    points = np.concatenate([calibrated_cloud(recording, t) for t in frames])
    labels = DBSCAN(eps=50.0, min_points=10)(points)  # mm and points of the wall pass, sec. 5.1.3
    if not (labels >= 0).any():
        raise InputError(f"{len(points)} points make no cluster.")
    largest = np.bincount(labels[labels >= 0]).argmax()
    return fit_cylinder(points[labels == largest])


def _check_times(recording: StoredRecording, notes: list[str]) -> None:
    rate = recording.attributes.frame_rate_hz
    intervals = np.diff(recording.per_frame["time_s"]) * rate
    off = np.abs(intervals - 1.0)
    if off.size and off.max() > UNEVEN:
        worst = int(off.argmax())
        notes.append(
            f"Frames are not evenly spaced: after frame {worst} the next one comes "
            f"{intervals[worst]:.2f} intervals later. Times are counted as frames at {rate:g} Hz."
        )


def settings(prepared: KilnRun, options: Options, jobs: str) -> tuple[Row, ...]:
    """Return the settings of a run, as rows of name and value.

    ``jobs`` says in a few words which processes did the work.
    """
    lance, wall, rules = prepared.exit_point_mm, prepared.wall, prepared.rules
    bright, rows = rules.ignition.bright, []
    if isinstance(prepared.detection.detector.detector, DoG):
        threshold = prepared.detection.detector.detector.threshold
        source = "given" if options.threshold else "not given, from the noise"
        rows.append(("threshold of DoG", f"{threshold:g} grey values ({source})"))
    if lance is None:
        rows.append(("lance's outlet", "not used"))
    else:
        source = "given" if options.exit_point_mm else "as recorded"
        rows.append(("lance's outlet, depth calibrated", f"{listed(lance, 1)} mm ({source})"))
    if wall is None:
        rows.append(("kiln's wall", "not used"))
    else:
        axis = f"through {listed(wall.centre_mm, 0)} mm along {listed(wall.direction, 4)}"
        level = "not asked" if bright is None else f"from {bright:g} grey values on (given)"
        above = "above the background" if rules.ignition.above_background else "as they are"
        rows += [
            ("kiln's axis", axis),
            ("kiln's radius", f"{wall.radius_mm:.0f} mm"),
            ("taken for in the air", f"up to {prepared.in_air.threshold_mm:g} mm from the axis"),
            ("taken for alight when first seen", level),
            ("ignition", f"a step of the grey values {above}"),
            ("refused as too fast", f"above {rules.plausible.fastest_m_s:g} m/s"),
        ]
    rows.append(("post-processing of tracks", "without the texture term of Eq. 4.24"))
    return (*rows, ("jobs", jobs))


def publish(results: Results, recording: Recording, folder: Path) -> Path:
    """Write the tables, the summary and the report; return its path.

    Each file is there whole or not at all; what ``parts`` holds lets a run go on.

    Raises
    ------
    InputError
        If a file cannot be written, as on a full disk.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = ("detections", *KILN_STEPS)
    contents = {f"{name}.parquet": getattr(results, name).to_parquet(index=False) for name in names}
    contents["summary.csv"] = summary(results).to_csv(index=False).encode()
    contents["report.html"] = page(results, recording).encode()
    with locked(folder):
        for name, content in contents.items():
            clear_parts(folder / name)
            write_resumable(folder / name, content)
    return folder / "report.html"
