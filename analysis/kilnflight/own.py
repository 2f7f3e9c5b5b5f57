"""A recording of one's own, made ready for the whole way from pictures to flights.

What nobody tells is taken from the recording itself where that can be done, and said: the
threshold from its noise, the kiln's wall from a cloud of its own.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from kilnflight import kiln
from kilnflight.camera import calibrate_points
from kilnflight.checks import InputError, check_positive
from kilnflight.detection import DBSCAN, DoG
from kilnflight.detection.combination import Combination
from kilnflight.detection.wall import Cylinder, CylinderFit, InAir
from kilnflight.flight import Rules
from kilnflight.ignition import Ignition
from kilnflight.kiln import LONG_CHUNK, DetectionRun, KilnRun, Vector, stored_source
from kilnflight.recording.frames import PictureRecording
from kilnflight.recording.store import StoredRecording, open_recording

NOISE_FRAMES = 5  # spread over the first 150, the median's window
WALL_FRAMES = 5  # spread over the recording
PIECES = 8  # that a recording is detected in at least, if it is long enough: work for --jobs
LEAST_CHUNK = 25  # frames; every piece reads the median's window, 150 frames, anew
BLOCK_PX = 32  # side of the blocks in which noise is looked for
NOISY_SHARE = 0.9  # of the blocks are quieter: noise grows with light, particles are few
TIMES_NOISE = 5.0  # as `Combination.prominence`: what stands out of the noise
LEAST_NOISE = 1.0  # a grey value; a picture without any noise is one that was made up
MEDIAN_TO_SIGMA = 1.4826  # median of |noise| -> standard deviation of Gaussian noise
UNEVEN = 0.01  # share by which intervals between frames may differ from the frame rate
_FINEST = DoG()


@dataclass(frozen=True)
class Wishes:
    """What the user says about a recording; None where it is left to the recording.

    Parameters
    ----------
    threshold
        Of DoG, grey values.
    exit_point_mm
        Outlet of the lance: camera coordinates as captured, before Eq. 2.4, as ``lance_mm`` of
        a manifest.
    in_air_mm
        Largest distance from the kiln's axis of what is in the air.
    bright
        Grey value that only what burns reaches, such as the camera's full scale: a particle whose
        first grey values reach it and that shows no step was alight when it was first seen. None:
        nothing tells it from a bright unlit one, and it counts as unlit, as in the thesis, which
        prints no such value (`kilnflight.ignition.Ignition`).
    above_background
        Whether ignition is a step of the grey values above those of the background, and not as
        they are (`kilnflight.kiln.background_gray`).
    """

    threshold: float | None = None
    exit_point_mm: Vector | None = None
    in_air_mm: float = 800.0  # sec. 5.1.4
    bright: float | None = None
    above_background: bool = False

    def __post_init__(self) -> None:
        """Refuse what is no threshold, no distance and no grey value."""
        if self.threshold is not None:
            check_positive(self.threshold, "threshold")
        check_positive(self.in_air_mm, "in_air_mm")
        if self.bright is not None:
            check_positive(self.bright, "bright")

    @property
    def given(self) -> tuple[str, ...]:
        """The names of what is not left to the recording."""
        names = ("threshold", "exit_point_mm")
        return tuple(name for name in names if getattr(self, name) is not None)


class Prepared(NamedTuple):
    """A recording ready to go, and what the reader is to know about it."""

    run: KilnRun
    notes: tuple[str, ...]


def prepare(folder: Path, target: Path, wishes: Wishes) -> Prepared:
    """Return how a stored recording is worked on.

    Parameters
    ----------
    folder
        Of the recording.
    target
        Folder in which everything is kept.
    wishes
        What the user says.

    Raises
    ------
    InputError
        If there is no recording, it has depth and nobody says where the lance ends, or the
        target is in the recording's own folder.
    """
    source = stored_source(folder)
    _check_apart(folder, target)
    recording = open_recording(folder)
    notes: list[str] = []
    threshold = _threshold(recording, wishes, notes)
    lance = wall = None
    if recording.per_frame["points"].any():
        lance = _exit_point(recording, wishes)
        wall = _wall(recording, notes)
    else:
        notes.append(
            "The recording has no depth: tracks are 2D. Trajectories, dwell times, velocities "
            "and ignition times need depth and were not made."
        )
    _check_times(recording.per_frame["time_s"], recording.attributes.frame_rate_hz, notes)
    detector, parts = Combination(DoG(threshold)), target / "parts"
    detection = DetectionRun(
        source,
        0,
        len(recording),
        detector,
        chunk=chunk(len(recording)),
        differences=False,
        folder=parts,
    )
    ignition = Ignition(bright=wishes.bright)
    rules = Rules(ignition=ignition, above_background=wishes.above_background)
    run = KilnRun(detection, lance, wall, InAir(wishes.in_air_mm), rules=rules)
    return Prepared(run, tuple(notes))


def beside(folder: Path) -> Path:
    """Return where a run is kept if nobody says: beside the recording, ``-run`` after its name.

    Examples
    --------
    >>> beside(Path("kiln/chips.zarr")).as_posix()
    'kiln/chips-run'
    """
    named = folder if folder.name not in ("", "..") else folder.resolve()
    return named.with_name(named.name.removesuffix(".zarr") + "-run")


def chunk(frames: int) -> int:
    """Return how many frames are detected in one piece, whoever does the work.

    Examples
    --------
    >>> [chunk(frames) for frames in (10, 1001, 24_000)]
    [25, 126, 500]
    """
    return min(LONG_CHUNK, max(LEAST_CHUNK, -(-frames // PIECES)))


def _check_apart(folder: Path, target: Path) -> None:
    if target.resolve().is_relative_to(folder.resolve()):
        raise InputError(
            f"--to {target}: lies in the recording {folder}, which is only read. Give a folder "
            f"of its own, such as {beside(folder)}."
        )
    if target.exists() and not target.is_dir():
        raise InputError(f"--to {target}: is a file. Give a folder, such as {beside(folder)}.")


def _threshold(recording: PictureRecording, wishes: Wishes, notes: list[str]) -> float:
    if wishes.threshold is not None:
        return wishes.threshold
    found = noise_threshold(recording)
    noise = f"{TIMES_NOISE:g} times the noise of the first frames"
    if found <= TIMES_NOISE * LEAST_NOISE:
        noise = (
            f"{TIMES_NOISE:g} times the least noise there is; the first frames have less (are they "
            "all of one grey value, saturated or made up?)"
        )
    notes.append(
        f"No threshold was given: {found:g} grey values are {noise}. It decides how much is "
        "found; compare others with --threshold."
    )
    return found


def noise_threshold(recording: PictureRecording) -> float:
    """Return a threshold of DoG from the noise of the first frames, in grey values.

    Notes
    -----
    The thesis tunes its threshold on labelled frames; without labels noise is all there is.
    In each of a few frames the finest difference of Gaussians, which is what the threshold is
    held against, is looked at in small blocks: 1.4826 times the median of its absolute value
    is a standard deviation of Gaussian noise, and particles, which cover a small part of a
    block, hardly move it. Noise grows with light, so a noisy block counts, the one that nine
    tenths are quieter than. Of the frames the median is taken, times five. That bounds false
    alarms of noise; flicker of a flame's light is not noise of a pixel, and a higher threshold
    may be better.
    """
    wanted = np.unique(np.linspace(0, min(len(recording), 150) - 1, NOISE_FRAMES).round())
    frames = [int(t) for t in wanted]
    noise = [block_noise(view.foreground) for _, view in kiln.views(recording, frames)]
    return round(TIMES_NOISE * max(float(np.median(noise)), LEAST_NOISE), 1)


def block_noise(foreground: npt.NDArray[np.float32], detector: DoG = _FINEST) -> float:
    """Return the noise of a foreground's difference of Gaussians, in a noisy part of it."""
    first = detector.sigma
    scales = (first, first * 2 ** (1 / detector.layers))
    blurred = [
        cv2.GaussianBlur(foreground, (0, 0), np.sqrt(scale**2 - detector.camera_blur**2))
        for scale in scales
    ]
    response = np.abs(blurred[0] - blurred[1])
    rows, cols = foreground.shape
    size = min(BLOCK_PX, rows, cols)
    cut = response[: rows // size * size, : cols // size * size]
    blocks = cut.reshape(rows // size, size, cols // size, size).swapaxes(1, 2)
    middle = np.median(blocks.reshape(-1, size * size), axis=1)
    return float(np.quantile(middle, NOISY_SHARE)) * MEDIAN_TO_SIGMA


def _exit_point(recording: PictureRecording, wishes: Wishes) -> Vector:
    known = wishes.exit_point_mm or recording.attributes.lance_mm
    if known is None:
        raise InputError(
            f"recording {recording.attributes.name}: where the lance ends is not known. Give "
            "--exit-point x,y,z (mm, camera coordinates as captured), or lance_mm in its manifest."
        )
    x, y, z = calibrate_points([known])[0].tolist()
    return x, y, z


def _wall(recording: StoredRecording, notes: list[str]) -> Cylinder | None:
    """Return the kiln, from a few frames with points; a note and None where it fails."""
    known = np.flatnonzero(recording.per_frame["points"])
    some = np.unique(np.linspace(0, len(known) - 1, WALL_FRAMES).round().astype(int))
    try:
        return fitted_wall(recording, known[some].tolist())
    except InputError as error:
        notes.append(
            f"The kiln's wall was not found ({error}) What lies on it was tracked like what "
            "flies; dwell times, velocities and ignition were not made."
        )
        return None


def fitted_wall(recording: PictureRecording, frames: Iterable[int]) -> Cylinder:
    """Return the cylinder of the largest cluster in some frames (sections 3.1 and 3.2).

    The clouds of the frames are put together: a still wall is denser so, what flies is not.
    """
    points = np.concatenate([calibrate_points(recording.frame(t).xyz) for t in frames])
    labels = DBSCAN(eps=50.0, min_points=10)(points)
    if not (labels >= 0).any():
        raise InputError(f"{len(points)} points make no cluster.")
    largest = np.bincount(labels[labels >= 0]).argmax()
    return CylinderFit()(points[labels == largest])


def _check_times(time_s: npt.NDArray[np.float64], rate_hz: float, notes: list[str]) -> None:
    off = np.abs(np.diff(time_s) * rate_hz - 1.0)
    if off.size and off.max() > UNEVEN:
        notes.append(
            f"Frames are not evenly spaced: after frame {int(off.argmax())} the next one comes "
            f"{np.diff(time_s)[off.argmax()] * rate_hz:.2f} intervals later. Times are counted as "
            f"frames at {rate_hz:g} Hz."
        )


def point(text: str) -> Vector:
    """Return x, y, z of a text, or raise an `InputError`.

    Examples
    --------
    >>> point("-77, 250.7,6828")
    (-77.0, 250.7, 6828.0)
    """
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = np.nan
    if not np.isfinite([x, y, z]).all():
        raise InputError(f"--exit-point {text}: write x,y,z in mm, such as -77,250.7,6828.")
    return x, y, z
