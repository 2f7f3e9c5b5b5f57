"""What a plenoptic camera delivers: frames, their attributes, the way to ask.

A recording is anything with `attributes`, a length and ``frame(t)``; the twin renders
its frames on demand, `kilnflight.recording.store.StoredRecording` reads them from disk, and
the methods cannot tell which one they were given. Pixels are row, col; millimetres
are x, y, z in camera coordinates as captured, before the recording's depth calibration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
import numpy.typing as npt

from kilnflight.camera import DepthCalibration, calibrate_points, read_calibration
from kilnflight.checks import InputError, check_positive, check_shape

FRACTIONS = ("wood chip", "confetti", "paper shred", "PE granule", "mixed")
LABELS = ("wall", "flame", "burning in air", "non-burning in air", "burning on the wall")


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame.

    Parameters
    ----------
    index
        Number of the frame in the file names and the truth tables; where a part of a
        recording is a recording of its own, frames keep their numbers.
    time_s
        Time of exposure; it grows from frame to frame.
    gray
        (rows, cols) uint16.
    pixels
        (n, 2) int32: row and col of the pixels that have a captured position, each once.
    xyz
        (n, 3) float32: those positions in mm, camera coordinates as captured, that is
        without the depth calibration; always finite.
    labels
        (rows, cols) uint8, classes of Table 5.1, Zhang 2023 (`LABELS`), where known.
    """

    index: int
    time_s: float
    gray: npt.NDArray[np.uint16]
    pixels: npt.NDArray[np.int32]
    xyz: npt.NDArray[np.float32]
    labels: npt.NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class Attributes:
    """What is known of a whole recording; None where it is not.

    Parameters
    ----------
    name
        Every error about the recording names it.
    frame_rate_hz, rows, columns
        Frames per second, and the size of each.
    fraction
        One of `FRACTIONS`.
    pressure_bar
        Air pressure at the lance.
    lance_mm
        Outlet of the lance: x, y, z in camera coordinates.
    roi
        Vertices (row, col) of the polygon outside which the optics leave artefacts.
    flame_roi
        (row0, row1, col0, col1) of the burner flame, the ends excluded.
    depth_calibration
        What its captured depths, the lance's too, need; None: they are true.
    """

    name: str
    frame_rate_hz: float
    rows: int
    columns: int
    fraction: str | None = None
    pressure_bar: float | None = None
    lance_mm: tuple[float, float, float] | None = None
    roi: tuple[tuple[float, float], ...] | None = None
    flame_roi: tuple[int, int, int, int] | None = None
    depth_calibration: DepthCalibration | None = None

    def __post_init__(self) -> None:
        """Refuse what no recording has, with the name of the recording."""
        if not self.name.strip():
            raise InputError("recording: its name is empty. Name it; every error refers to it.")
        where, lance, roi, flame = f"recording {self.name}", self.lance_mm, self.roi, self.flame_roi
        for key in ("frame_rate_hz", "rows", "columns", "pressure_bar"):
            if getattr(self, key) is not None:
                check_positive(getattr(self, key), f"{where}, {key}")
        known = self.fraction in (None, *FRACTIONS)
        lance_fits = lance is None or (len(lance) == 3 and all(map(math.isfinite, lance)))
        roi_fits = roi is None or (len(roi) >= 3 and self._hold(*roi))
        ascending = flame is None or (
            len(flame) == 4 and flame[0] < flame[1] and flame[2] < flame[3]
        )
        flame_fits = flame is None or (ascending and self._hold(flame[::2], flame[1::2]))
        names, size = ", ".join(FRACTIONS), f"inside the image of {self.rows} x {self.columns}"
        faults = {
            f"unknown fraction {self.fraction!r}; use one of {names}, or leave it out": known,
            f"lance_mm is {lance}, expected x, y, z in mm": lance_fits,
            f"roi needs three or more vertices (row, col) {size}, got {roi}": roi_fits,
            f"flame_roi is {flame}, expected row0 < row1 and col0 < col1 {size}": flame_fits,
        }
        for fault, fits in faults.items():
            if not fits:
                raise InputError(f"{where}: {fault}.")

    def _hold(self, *corners: tuple[float, ...]) -> bool:
        """Return whether corners are (row, col) in the image."""
        rows, columns = self.size
        return all(len(c) == 2 and 0 <= c[0] <= rows and 0 <= c[1] <= columns for c in corners)

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
        return self.rows, self.columns

    @property
    def exit_point_mm(self) -> tuple[float, float, float] | None:
        """Outlet of the lance, its depth calibrated; None if it is not known."""
        if self.lance_mm is None:
            return None
        x, y, z = calibrate_points([self.lance_mm], self.depth_calibration)[0].tolist()
        return x, y, z

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Return the attributes from what JSON or TOML gives; lists become tuples."""
        calibration = read_calibration(values.get("depth_calibration"))
        others = {key: _tuples(value) for key, value in values.items()}
        return cls(**others | {"depth_calibration": calibration})


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list | tuple) else value


class Recording(Protocol):
    """What every step that measures works on."""

    @property
    def attributes(self) -> Attributes:
        """What is known of the whole recording."""

    def __len__(self) -> int: ...

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0; an `InputError` where there is none."""

    def gray(self, t: int) -> npt.NDArray[np.uint16]:
        """Return its grey values (rows, cols) alone.

        Backgrounds need them by the hundred.
        """


def calibrated_cloud(recording: Recording, t: int) -> npt.NDArray[np.float64]:
    """Return the points (n, 3) of frame ``t`` in mm, their depth calibrated."""
    return calibrate_points(recording.frame(t).xyz, recording.attributes.depth_calibration)


@dataclass(frozen=True, eq=False)
class ArrayRecording:
    """Frames in memory, without depth.

    Parameters
    ----------
    attributes
        Name, frame rate and size.
    images
        (n, rows, cols) uint16.
    """

    attributes: Attributes
    images: npt.NDArray[np.uint16]

    def __post_init__(self) -> None:
        """Refuse images of another size or type."""
        size = (None, self.attributes.rows, self.attributes.columns)
        check_array(self.images, "uint16", size, f"recording {self.attributes.name}: gray")

    def __len__(self) -> int:
        return len(self.images)

    def gray(self, t: int) -> npt.NDArray[np.uint16]:
        """Return the grey values (rows, cols) of frame ``t``."""
        check_position(t, len(self), self.attributes.name)
        return self.images[t]

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0."""
        return Frame(t, t / self.attributes.frame_rate_hz, self.gray(t), *NO_POINTS)


NO_POINTS = (np.empty((0, 2), np.int32), np.empty((0, 3), np.float32))  # pixels, xyz
GRAY_REMEDY = (
    " Give the camera's 16-bit frames; stretched 8-bit or rescaled frames have lost the gray "
    "values that thresholds mean."
)


def check_array(
    array: npt.NDArray[Any], kind: str, shape: tuple[int | None, ...], where: str
) -> None:
    """Raise an `InputError` unless an array of a frame has its type and shape.

    ``where`` ends in the name of the array.
    """
    if array.dtype != kind:
        verb = "are" if where.endswith("s") else "is"
        remedy = GRAY_REMEDY if where.endswith(" gray") else " Convert it first."
        raise InputError(f"{where} {verb} {array.dtype}, expected {kind}.{remedy}")
    check_shape(array, shape, where)


def check_position(t: int, length: int, name: str) -> None:
    """Raise an `InputError` unless a recording of that length has a frame ``t``."""
    if not 0 <= t < length:
        raise InputError(
            f"recording {name}: there is no frame {t}; it has {length} frames, counted from 0."
        )


def check_points(valid: npt.ArrayLike, pixels: npt.NDArray[Any], where: str, fault: str) -> None:
    """Raise an `InputError` for the first point that is not valid.

    ``fault`` is a format.
    """
    invalid = np.flatnonzero(np.logical_not(valid))
    if len(invalid):
        row, col = pixels[invalid[0]]
        text = fault.format(count=len(invalid), row=row, col=col, point=invalid[0])
        raise InputError(f"{where}: {text}")


def check_cloud(
    pixels: npt.NDArray[Any], xyz: npt.NDArray[Any], size: tuple[int, int], where: str
) -> None:
    """Raise an `InputError` unless each point is finite and has a pixel of its own."""
    check_array(pixels, "int32", (None, 2), f"{where}: pixels")
    check_array(xyz, "float32", (None, 3), f"{where}: xyz")
    if len(pixels) != len(xyz):
        raise InputError(
            f"{where}: {len(pixels)} pixels but {len(xyz)} positions. Give one of each per point."
        )
    inside = ((pixels >= 0) & (pixels < size)).all(axis=1)
    fault = (
        f"{{count}} point(s) outside the image of {size[0]} x {size[1]}, the first at row {{row}}, "
        "col {col} (point {point}). Pixels are counted from 0, rows first."
    )
    check_points(inside, pixels, where, fault)
    finite = np.isfinite(xyz).all(axis=1)
    fault = (
        f"{'{count} of' if finite.any() else 'all'} {len(xyz)} points are not finite, the first at "
        "row {row}, col {col}. A pixel without depth is left out, not marked."
    )
    check_points(finite, pixels, where, fault)
    taken = np.zeros(size, bool)
    taken[pixels[:, 0], pixels[:, 1]] = True
    twice = len(pixels) - np.count_nonzero(taken)
    if twice:
        raise InputError(f"{where}: {twice} point(s) share a pixel with another. Give each once.")


def check_frame(frame: Frame, attributes: Attributes) -> Frame:
    """Return the frame, or raise an `InputError` naming the recording and the frame."""
    where, size = f"recording {attributes.name}, frame {frame.index}", attributes.size
    if frame.index < 0 or not math.isfinite(frame.time_s):
        raise InputError(
            f"{where}: index {frame.index} and time {frame.time_s} s; expected a number from 0 "
            "up and a finite time."
        )
    check_array(frame.gray, "uint16", size, f"{where}: gray")
    check_cloud(frame.pixels, frame.xyz, size, where)
    if attributes.depth_calibration is not None:
        try:
            calibrate_points(frame.xyz, attributes.depth_calibration)
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
    if frame.labels is not None:
        check_array(frame.labels, "uint8", size, f"{where}: labels")
        if frame.labels.size and int(frame.labels.max()) >= len(LABELS):
            raise InputError(
                f"{where}: label {frame.labels.max()} is no class; 0 to {len(LABELS) - 1} stand "
                f"for {', '.join(LABELS)}."
            )
    return frame
