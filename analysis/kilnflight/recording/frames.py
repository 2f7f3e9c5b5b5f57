"""What a plenoptic camera delivers: frames, their attributes, and the one way to ask for them.

A recording is anything with `attributes`, a length and ``frame(t)``; the twin renders
its frames on demand, `kilnflight.recording.store.StoredRecording` reads them from disk, and
the methods cannot tell which one they were given. Pixels are row, col; millimetres
are x, y, z in camera coordinates as captured, before Eq. 2.4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Protocol, Self

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_positive, check_shape

FRACTIONS = ("wood chip", "confetti", "paper shred", "PE granule", "mixed")
LABELS = ("wall", "flame", "burning in air", "non-burning in air", "burning on the wall")


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame.

    Parameters
    ----------
    index
        Number of the frame in its first recording (in the file names, in the
        truth tables); a part of a recording keeps it.
    time_s
        Time of exposure; it grows from frame to frame.
    gray
        (rows, cols) uint16.
    pixels
        (n, 2) int32: row and col of the pixels that have a captured position, each once.
    xyz
        (n, 3) float32: those positions in mm, camera coordinates as captured, that is
        without Eq. 2.4; always finite.
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

    def __post_init__(self) -> None:
        where = f"recording {self.name}"
        if not self.name.strip():
            raise InputError("recording: its name is empty. Name it; every error refers to it.")
        for key in ("frame_rate_hz", "rows", "columns", "pressure_bar"):
            value = getattr(self, key)
            if value is not None:
                check_positive(value, f"{where}, {key}")
        if self.fraction not in (None, *FRACTIONS):
            raise InputError(
                f"{where}: unknown fraction {self.fraction!r}; use one of {', '.join(FRACTIONS)}, "
                "or leave it out."
            )
        lance, roi, flame = self.lance_mm, self.roi, self.flame_roi
        if lance is not None and not (len(lance) == 3 and all(map(math.isfinite, lance))):
            raise InputError(f"{where}: lance_mm is {lance}, expected x, y, z in mm.")
        size = f"inside the image of {self.rows} x {self.columns}"
        if roi is not None and not (
            len(roi) >= 3 and all(len(vertex) == 2 and self._holds(*vertex) for vertex in roi)
        ):
            raise InputError(
                f"{where}: roi needs three or more vertices (row, col) {size}, got {roi}."
            )
        if flame is not None and not (
            len(flame) == 4
            and flame[0] < flame[1]
            and flame[2] < flame[3]
            and self._holds(*flame[::2])
            and self._holds(*flame[1::2])
        ):
            raise InputError(
                f"{where}: flame_roi is {flame}, expected row0 < row1 and col0 < col1 {size}."
            )

    def _holds(self, row: float, col: float) -> bool:
        return 0 <= row <= self.rows and 0 <= col <= self.columns

    def to_json(self) -> dict[str, Any]:
        """Return the attributes as JSON keeps them."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Return the attributes from what JSON or TOML gives; lists become tuples."""
        known = {field.name for field in fields(cls)}
        unknown = sorted(set(values) - known)
        if unknown:
            raise InputError(
                f"recording {values.get('name', '')}: unknown attribute(s) {', '.join(unknown)}; "
                f"known are {', '.join(sorted(known))}."
            )
        return cls(**{key: _tuples(value) for key, value in values.items()})


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list | tuple) else value


class Recording(Protocol):
    """What every step that measures is given."""

    @property
    def attributes(self) -> Attributes:
        """What is known of the whole recording."""

    def __len__(self) -> int: ...

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0; an `InputError` where there is none."""


class PictureRecording(Recording, Protocol):
    """A recording that also gives grey values alone, which backgrounds need by the hundred."""

    def gray(self, t: int) -> npt.NDArray[np.uint16]:
        """Return the grey values (rows, cols) of frame ``t``, as `frame` has them."""


def check_position(t: int, length: int, name: str) -> None:
    """Raise an `InputError` unless a recording of that length has a frame ``t``."""
    if not 0 <= t < length:
        raise InputError(
            f"recording {name}: there is no frame {t}; it has {length} frames, counted from 0."
        )


def check_gray(gray: npt.NDArray[Any], attributes: Attributes, where: str) -> None:
    """Raise an `InputError` unless ``gray`` is a 16-bit image of the recording's size."""
    if gray.dtype != np.uint16:
        raise InputError(
            f"{where}: gray is {gray.dtype}, expected uint16. Give the camera's 16-bit frames; "
            "stretched 8-bit or rescaled frames have lost the gray values that thresholds mean."
        )
    check_shape(gray, (attributes.rows, attributes.columns), f"{where}: gray")


def check_cloud(
    pixels: npt.NDArray[Any],
    xyz: npt.NDArray[Any],
    attributes: Attributes,
    where: str,
) -> None:
    """Raise an `InputError` unless each point is finite and has a pixel of its own."""
    check_shape(pixels, (None, 2), f"{where}: pixels")
    check_shape(xyz, (None, 3), f"{where}: xyz")
    if pixels.dtype != np.int32 or xyz.dtype != np.float32:
        raise InputError(
            f"{where}: pixels are {pixels.dtype} and xyz {xyz.dtype}, expected int32 and float32."
        )
    if len(pixels) != len(xyz):
        raise InputError(
            f"{where}: {len(pixels)} pixels but {len(xyz)} positions. Give one of each per point."
        )
    size = np.array([attributes.rows, attributes.columns])
    outside = np.flatnonzero(((pixels < 0) | (pixels >= size)).any(axis=1))
    if len(outside):
        row, col = pixels[outside[0]]
        raise InputError(
            f"{where}: {len(outside)} point(s) outside the image of {size[0]} x {size[1]}, the "
            f"first at row {row}, col {col} (point {outside[0]}). Pixels are counted from 0, "
            "rows first."
        )
    bad = np.flatnonzero(~np.isfinite(xyz).all(axis=1))
    if len(bad):
        share = "all" if len(bad) == len(xyz) else f"{len(bad)} of"
        raise InputError(
            f"{where}: {share} {len(xyz)} points are not finite, the first at row "
            f"{pixels[bad[0], 0]}, col {pixels[bad[0], 1]}. A pixel without depth is left out, "
            "not marked."
        )
    taken = np.zeros(tuple(size), bool)
    taken[pixels[:, 0], pixels[:, 1]] = True
    twice = len(pixels) - np.count_nonzero(taken)
    if twice:
        raise InputError(f"{where}: {twice} point(s) share a pixel with another. Give each once.")


def check_labels(labels: npt.NDArray[Any], attributes: Attributes, where: str) -> None:
    """Raise an `InputError` unless ``labels`` holds classes of Table 5.1 for every pixel."""
    if labels.dtype != np.uint8:
        raise InputError(f"{where}: labels are {labels.dtype}, expected uint8 (Table 5.1).")
    check_shape(labels, (attributes.rows, attributes.columns), f"{where}: labels")
    if labels.size and int(labels.max()) >= len(LABELS):
        raise InputError(
            f"{where}: label {labels.max()} is no class; 0 to {len(LABELS) - 1} stand for "
            f"{', '.join(LABELS)}."
        )


def check_frame(frame: Frame, attributes: Attributes, where: str = "") -> Frame:
    """Return the frame, or raise an `InputError` naming the recording and the frame."""
    where = where or f"recording {attributes.name}, frame {frame.index}"
    if frame.index < 0 or not math.isfinite(frame.time_s):
        raise InputError(
            f"{where}: index {frame.index} and time {frame.time_s} s; expected a number from 0 "
            "up and a finite time."
        )
    check_gray(frame.gray, attributes, where)
    check_cloud(frame.pixels, frame.xyz, attributes, where)
    if frame.labels is not None:
        check_labels(frame.labels, attributes, where)
    return frame
