"""Options and recording -> `KilnRun`: threshold, lance, wall and notes for the reader.

Missing options are estimated from the recording, with a note.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from skimage.util import view_as_blocks

from kilnflight import kiln
from kilnflight.arrays import Single
from kilnflight.checks import InputError, check_number
from kilnflight.detection import DBSCAN, DoG
from kilnflight.detection.combination import Combination
from kilnflight.detection.sift import LAYERS, SIGMA_PX
from kilnflight.detection.wall import Cylinder, InAir, fit_cylinder
from kilnflight.flight import Plausible, Rules
from kilnflight.ignition import Ignition
from kilnflight.kiln import Vector
from kilnflight.recording.frames import Attributes, Frame, Recording, calibrated_cloud
from kilnflight.recording.store import StoredRecording, open_recording
from kilnflight.tracklets import Cutting

Settings = dict[str, str]  # name -> value, for the reader


@dataclass(frozen=True)
class Options:
    """Options of a run; None is estimated from the recording.

    Parameters
    ----------
    threshold
        Threshold of DoG, grey values.
    exit_point_mm
        Outlet of the lance: camera coordinates as captured, as ``lance_mm`` of a manifest.
    in_air_mm
        Largest distance of flying particles from the kiln's axis.
    bright
        Grey value that only burning particles reach, such as the camera's full scale. A particle
        that starts there and shows no step was alight when first seen. None: it counts as unlit,
        as in the thesis (`kilnflight.ignition.Ignition`).
    above_background
        Whether ignition is a step of the grey values above the background
        (`kilnflight.kiln.background_gray`).
    air_m_s
        Velocity of the air at the lance's outlet; default: the thesis's at 5 bar (sec. 2.1.1).
        Twice this velocity is the limit for flights (`kilnflight.flight.Plausible`) and for steps
        within tracks (`kilnflight.tracklets.Cutting`).
    dark
        Whether particles are darker than the background.

    Raises
    ------
    InputError
        If a number is not above 0.
    """

    threshold: float | None = None
    exit_point_mm: Vector | None = None
    in_air_mm: float = 800.0  # sec. 5.1.4
    bright: float | None = None
    above_background: bool = False
    air_m_s: float = Plausible().air_m_s
    dark: bool = False

    def __post_init__(self) -> None:
        for name in ("threshold", "in_air_mm", "bright", "air_m_s"):
            if (value := getattr(self, name)) is not None:
                check_number(value, name, above=0)


class Inverted:
    """A recording with inverted grey values: dark particles become bright."""

    def __init__(self, recording: Recording) -> None:
        self._recording, self.attributes = recording, recording.attributes

    def __len__(self) -> int:
        return len(self._recording)

    def gray(self, t: int) -> npt.NDArray[np.uint16]:
        """Return the inverted grey values (rows, cols) of frame ``t``."""
        return np.iinfo(np.uint16).max - self._recording.gray(t)

    def frame(self, t: int) -> Frame:
        """Return frame ``t`` with inverted grey values."""
        frame = self._recording.frame(t)
        return replace(frame, gray=np.iinfo(np.uint16).max - frame.gray)


@dataclass(frozen=True)
class StoredSource:
    """A recording on disk, identified by its content and not by its place."""

    name: str
    content: str  # of `StoredRecording.content`
    dark: bool
    folder: Path = field(repr=False)

    def recording(self) -> Recording:
        """Return the recording, with inverted grey values if ``dark``."""
        recording = open_recording(self.folder)
        return Inverted(recording) if self.dark else recording


def prepare(
    recording: StoredRecording, target: Path, options: Options
) -> tuple[kiln.KilnRun, Settings, list[str]]:
    """Return the run of a stored recording, its settings, and notes for the reader.

    Raises
    ------
    InputError
        If the recording has depth and no known lance.
    """
    attributes, frames = recording.attributes, len(recording)
    settings = {name.replace("_", " "): f"{value}" for name, value in asdict(options).items()}
    threshold = options.threshold or noise_threshold(recording)
    settings["threshold"] = f"{threshold:g} grey values"
    notes = [*attributes.notes, *_uneven(recording)]
    if not options.threshold:
        notes.append(
            f"No threshold was given: {threshold:g} grey values are five times the noise of the "
            "first frames, at least five. It decides how much is found; compare others with "
            "--threshold."
        )
    lance, wall = _geometry(recording, options.exit_point_mm, settings, notes)
    folder = recording.path.resolve()
    source = StoredSource(attributes.name, recording.content(), options.dark, folder)
    detector, chunk = Combination(DoG(threshold)), chunk_frames(frames)
    detection = kiln.DetectionRun(
        source, 0, frames, detector, chunk=chunk, folder=target.absolute() / "parts"
    )
    plausible, in_air = Plausible(options.air_m_s), InAir(options.in_air_mm)
    ignition = Ignition(bright=options.bright, above_background=options.above_background)
    rules, cutting = Rules(ignition=ignition, plausible=plausible), Cutting(plausible.fastest_m_s)
    run = kiln.KilnRun(detection, lance, wall, in_air, cutting=cutting, rules=rules)
    return run, settings, notes


def _uneven(recording: StoredRecording) -> list[str]:
    """Return a note on intervals that differ from the frame rate by more than 1 %."""
    rate = recording.attributes.frame_rate_hz
    intervals = np.diff(recording.per_frame["time_s"]) * rate
    return [
        f"Frames are not evenly spaced: after frame {t} the next one comes {intervals[t]:.2f} "
        f"intervals later. Times are counted as frames at {rate:g} Hz."
        for t in np.flatnonzero(np.abs(intervals - 1.0) > 0.01)[:1]
    ]


def _geometry(
    recording: StoredRecording, given: Vector | None, settings: Settings, notes: list[str]
) -> tuple[Vector | None, Cylinder | None]:
    """Return outlet of the lance and wall, None if unknown; add settings and notes."""
    deep, attributes = np.flatnonzero(recording.per_frame["points"]), recording.attributes
    if not len(deep):
        notes.append(
            "The recording has no depth: tracks are 2D. Trajectories, dwell times, velocities "
            "and ignition times need depth and were not made."
        )
        return None, None
    seen = deep[_spread(len(deep), 5)].tolist()
    lance = _lance(replace(attributes, lance_mm=given or attributes.lance_mm))
    settings["exit point mm"] = f"{listed(lance, 1)}, depth calibrated"
    try:
        wall = fitted_wall(recording, seen)
    except InputError as error:
        notes.append(
            f"The kiln's wall was not found ({error}) What lies on it was tracked like what "
            "flies; dwell times, velocities and ignition were not made."
        )
        return lance, None
    settings["kiln's axis"] = f"{listed(wall.centre_mm, 0)} mm, {listed(wall.direction, 4)}"
    settings["kiln's radius"] = f"{wall.radius_mm:.0f} mm"
    place, size = place_in_picture(recording, seen, lance), attributes.size
    if not all(0 <= at < n for at, n in zip(place, size, strict=True)):
        notes.append(
            f"The lance ends outside the picture, at row {place[0]:.0f} and column {place[1]:.0f} "
            f"of {size[0]} x {size[1]} pixels: particles come into view later, and what they do "
            "before is not seen. Is its outlet right (mm, as captured), and the depth_calibration?"
        )
    return lance, wall


def listed(values: Sequence[float], digits: int) -> str:
    """Return numbers with ``digits`` decimals, separated by commas."""
    return ", ".join(f"{value:.{digits}f}" for value in values)


def chunk_frames(frames: int) -> int:
    """Return the frames of a chunk, the part of a recording that one worker writes to one file.

    Eight chunks show progress and can be shared; fewer than 25 frames are not worth the window of
    the background that each chunk reads again. Any number of workers makes the same files.

    Examples
    --------
    >>> [chunk_frames(frames) for frames in (10, 1001, 24_000)]
    [25, 126, 500]
    """
    return min(kiln.CHUNK_FRAMES, max(25, -(-frames // 8)))


def noise_threshold(recording: Recording) -> float:
    """Return a threshold of DoG in grey values, five times the noise.

    Notes
    -----
    The thesis tunes its threshold on labelled frames; without labels only noise is known. The
    finest difference of Gaussians is measured in five frames, in small blocks. The median of its
    absolute value, times 1.4826, is the standard deviation of Gaussian noise; particles cover too
    little of a block to change it. Noise grows with light, so the 90 % quantile over blocks
    counts, and the median over frames. Five times the noise bounds its false alarms. Flicker of a
    flame is not noise of a pixel; a higher threshold may be better there.
    """
    frames = _spread(min(len(recording), 150), 5)  # 150: the median's window
    noise = [block_noise(view.foreground) for _, view in kiln.views(recording, frames)]
    return round(5.0 * max(float(np.median(noise)), 1.0), 1)  # made-up pictures have no noise


def block_noise(foreground: Single) -> float:
    """Return the noise of a foreground's finest difference of Gaussians, in a noisy block."""
    fine, coarse = (
        cv2.GaussianBlur(foreground, (0, 0), np.sqrt(scale**2 - DoG().camera_blur ** 2))
        for scale in (SIGMA_PX, SIGMA_PX * 2 ** (1 / LAYERS))
    )
    rows, cols = foreground.shape
    size = min(32, rows, cols)
    response = np.abs(fine - coarse)[: rows // size * size, : cols // size * size]
    middle = np.median(view_as_blocks(response, (size, size)), axis=(2, 3))
    return float(np.quantile(middle, 0.9)) * 1.4826


def _spread(length: int, number: int) -> list[int]:
    """Return ``number`` indices, or all, spread evenly over a length."""
    return np.unique(np.linspace(0, length - 1, number).round().astype(int)).tolist()


def _lance(attributes: Attributes) -> Vector:
    """Return the lance's outlet, depth calibrated."""
    try:
        lance = attributes.exit_point_mm
    except InputError as error:
        raise InputError(f"recording {attributes.name}: lance: {error}") from error
    if lance is None:
        raise InputError(
            f"recording {attributes.name}: where the lance ends is not known. Give --exit-point "
            "X Y Z (mm, camera coordinates as captured), or lance_mm in its manifest."
        )
    return lance


def place_in_picture(
    recording: Recording, frames: Sequence[int], point_mm: Vector
) -> tuple[float, float]:
    """Return row and column of a point in space, also outside the picture.

    A recording holds no focal length, but its points have pixels. A pinhole camera projects
    linearly in x/z and y/z; both lines are fitted to the clouds of some frames.
    """
    places = np.concatenate([calibrated_cloud(recording, t) for t in frames])
    pixels = np.concatenate([recording.frame(t).pixels for t in frames])
    x, y, z = places.T
    x0, y0, z0 = point_mm
    row = np.polynomial.Polynomial.fit(y / z, pixels[:, 0], 1)(y0 / z0)
    col = np.polynomial.Polynomial.fit(x / z, pixels[:, 1], 1)(x0 / z0)
    return float(row), float(col)


def fitted_wall(recording: Recording, frames: Sequence[int]) -> Cylinder:
    """Return the cylinder of the largest cluster in the clouds of some frames.

    Sections 3.1 and 3.2 of the thesis. Together the clouds make a still wall denser than what
    flies.
    """
    points = np.concatenate([calibrated_cloud(recording, t) for t in frames])
    labels = DBSCAN(eps=50.0, min_points=10)(points)  # wall pass, sec. 5.1.3
    if not (labels >= 0).any():
        raise InputError(f"{len(points)} points make no cluster.")
    largest = np.bincount(labels[labels >= 0]).argmax()
    return fit_cylinder(points[labels == largest])
