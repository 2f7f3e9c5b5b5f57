"""Frames of a recording and its attributes.

A recording has `attributes`, a length and ``frame(t)``. Positions t count the frames
there are, from 0; a gap in a camera's numbers shows in `Frame.index` and
`Frame.time_s`. Pixels are row, col. Millimetres are x, y, z in camera coordinates as
captured, before the recording's depth calibration.
"""

from dataclasses import dataclass, field
from typing import Protocol, Self, runtime_checkable

import numpy as np
from pandas import DataFrame

from kilnflight.arrays import (
    Array,
    ArrayLike,
    Facts,
    Gray,
    Integers,
    Picture,
    Single,
    TwoInts,
)
from kilnflight.camera import DepthCalibration, calibrate_points, read_calibration
from kilnflight.checks import (
    LARGEST_WHOLE,
    Count,
    CountFrom0,
    InputError,
    NotNegative,
    Number,
    Positive,
    Settings,
    check_number,
)

LABELS = (
    "wall",
    "flame",
    "burning in air",
    "non-burning in air",
    "burning on the wall",
)


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame.

    Parameters
    ----------
    index
        Number of the frame in the file names and the truth tables.
    time_s
        Time of exposure; it grows from frame to frame.
    gray
        (rows, cols) uint16.
    pixels
        (n, 2) int32: row and col of the pixels with a captured position, each once.
    xyz
        (n, 3) float32: those positions in mm, camera coordinates as captured, without
        the depth calibration; finite.
    labels
        (rows, cols) uint8, classes of Table 5.1, Zhang 2023 (`LABELS`), where known.

    Examples
    --------
    >>> frame = Frame(index=7, time_s=0.02, gray=np.full((24, 32), 900, np.uint16))
    >>> frame.gray.shape, frame.xyz.shape, frame.labels
    ((24, 32), (0, 3), None)
    """

    index: int
    time_s: float
    gray: Gray
    pixels: Integers = field(default_factory=lambda: np.empty((0, 2), np.int32))
    xyz: Single = field(default_factory=lambda: np.empty((0, 3), np.float32))
    labels: Picture | None = None


class Attributes(Settings):
    """Facts about a whole recording; None where unknown.

    Parameters
    ----------
    name
        Every error about the recording names it.
    frame_rate_hz
        Frames per second; 330 in the thesis.
    rows, columns
        Size of each frame in px.
    fraction
        Material of the particles, such as ``"wood chip"``.
    pressure_bar
        Air pressure at the lance.
    lance_mm
        Outlet of the lance: x, y, z in mm, camera coordinates as captured.
    roi
        Vertices (row, col) in px of the polygon outside which the optics leave
        artefacts.
    flame_roi
        (row0, row1, col0, col1) of the burner flame in px, the ends excluded.
    depth_calibration
        Calibration of the captured depths, the lance's too; None: they are true.
    notes
        Sentences about the conversion to this form: missing frames, colours, scaled
        grey values.
    um_per_px
        Width of a pixel in the plane of the particles, in um.
    timed
        Whether the frame rate is known; else it is 1.

    Raises
    ------
    InputError
        If a value is impossible; the message names the recording and the attribute.

    Examples
    --------
    >>> known = Attributes("chips", 330.0, 24, 32, lance_mm=(-10.0, 240.0, 8950.0))
    >>> known.size, known.exit_point_mm
    ((24, 32), (-10.0, 240.0, 8950.0))
    """

    name: str
    frame_rate_hz: Positive
    rows: Count
    columns: Count
    fraction: str | None = None
    pressure_bar: Positive | None = None
    lance_mm: tuple[Number, Number, Number] | None = None
    roi: tuple[tuple[NotNegative, NotNegative], ...] | None = None
    flame_roi: tuple[CountFrom0, CountFrom0, CountFrom0, CountFrom0] | None = None
    depth_calibration: DepthCalibration | None = None
    notes: tuple[str, ...] = ()
    um_per_px: Positive | None = field(default=None, repr=False)
    timed: bool = field(default=True, repr=False)

    def __post_init__(self) -> None:
        where = f"recording {self.name}"
        super().__post_init__(where)
        roi = self.roi
        top, bottom, left, right = self.flame_roi or (0, self.rows, 0, self.columns)
        fits = {
            "name": self.name.strip() and "/" not in self.name,
            "roi": roi is None
            or (len(roi) >= 3 and np.less_equal(roi, self.size).all()),
            "flame_roi": top < bottom <= self.rows and left < right <= self.columns,
        }
        for key, usable in fits.items():
            if not usable:
                raise InputError(
                    f"{where}: {key} cannot be used: {getattr(self, key)!r:.80} in a "
                    f"picture of {self.size} px; rows come first."
                )

    @property
    def stated(self) -> str:
        """All attributes; hashes of older recordings are of a text without the last."""
        untimed = "" if self.timed else "without a rate"
        return f"{self}{self.um_per_px or ''}{untimed}"

    @property
    def size(self) -> TwoInts:
        """Rows and columns of a frame."""
        return self.rows, self.columns

    @property
    def exit_point_mm(self) -> tuple[float, float, float] | None:
        """Outlet of the lance, its depth calibrated; None if it is not known."""
        if self.lance_mm is None:
            return None
        return tuple(
            calibrate_points([self.lance_mm], self.depth_calibration)[0].tolist()
        )

    @classmethod
    def from_json(cls, values: Facts) -> Self:
        """Return the attributes from values of JSON or TOML; lists become tuples."""
        calibration = read_calibration(values.get("depth_calibration"))
        return cls(**values | {"depth_calibration": calibration})


class Recording(Protocol):
    """Frames in order, read one by one."""

    @property
    def attributes(self) -> Attributes:
        """Facts about the whole recording."""

    def __len__(self) -> int: ...

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0; an `InputError` if there is none."""

    def gray(self, t: int) -> Gray:
        """Return the grey values (rows, cols) of frame ``t`` alone."""


def check_position(t: int, length: int, name: str) -> None:
    """Raise an `InputError` unless a recording of that length has a frame ``t``."""
    if not 0 <= t < length:
        raise InputError(
            f"recording {name}: there is no frame {t} in 0 to {length - 1}."
        )


def check_frame(frame: Frame, attributes: Attributes) -> Frame:
    """Return the frame if its number and points fit the recording; shapes do already.

    Raises
    ------
    InputError
        If the index is no frame number, points lie outside or share a pixel, or a depth
        cannot be calibrated. It names the recording and the frame.
    """
    where = f"recording {attributes.name}, frame {frame.index}"
    pixels = frame.pixels
    check_number(
        frame.index, f"{where}: index", least=0, most=LARGEST_WHOLE, whole=True
    )
    outside = ((pixels < 0) | (pixels >= attributes.size)).any(axis=1)
    twice = DataFrame(pixels).duplicated().to_numpy()
    wrong = outside | twice
    if wrong.any():
        place = f"the first at row, col {pixels[wrong.argmax()].tolist()}"
        raise InputError(
            f"{where}: {wrong.sum()} point(s), {place}, are outside or given twice."
        )
    # It raises for a point behind the camera; the calibrated points are not needed.
    calibrate_points(
        frame.xyz, attributes.depth_calibration, f"{where}: captured points"
    )
    return frame


@runtime_checkable
class Source(Protocol):
    """A recording by name, opened by each process for itself.

    Equal sources have an equal ``repr``; names of files depend on it.
    """

    def __hash__(self) -> int: ...

    @property
    def name(self) -> str:
        """Name of the recording."""

    def recording(self) -> Recording:
        """Return the recording."""


def calibrated_cloud(recording: Recording, t: int) -> Array:
    """Return the points (n, 3) of frame ``t`` in mm, their depth calibrated."""
    return calibrate_points(
        recording.frame(t).xyz, recording.attributes.depth_calibration
    )


def count_frames(numbers: ArrayLike) -> tuple[list[int], float]:
    """Return a frame for each number, and the step of the numbers.

    Steps of 10, or of time, become steps of 1 from 0. With any step of 1 the numbers
    are frames.

    Examples
    --------
    >>> count_frames([1700, 1733, 1767, 1867])
    ([0, 1, 2, 5], 34.0)
    """
    each, place = np.unique(numbers, return_inverse=True)
    steps = np.diff(each)
    step = 1.0
    frames = each
    if len(steps) and steps.min() != 1:
        step = float(np.quantile(steps, 0.5, method="lower"))  # time stamps vary
        frames = np.append(0, np.maximum(np.rint(steps / step), 1).cumsum())
    return frames[place].astype(int).tolist(), step
