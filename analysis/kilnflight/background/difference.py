"""Moving frame difference: neighbouring frames as background.

Eqs 2.5 and 2.6 of the thesis. The models share what else stands here: the frames in use, the
absolute difference, the window.
"""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.checks import InputError, check_count

Image = npt.NDArray[Any]
Foreground = npt.NDArray[np.float32]
GRAY_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")


class Frames(Protocol):
    """A stack of images that is read lazily.

    An array of shape (frames, rows, cols) is one.
    """

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Any: ...


def check_indices(indices: Iterable[int], length: int) -> tuple[int, ...]:
    """Return the frame numbers as ints, or raise an `InputError`."""
    try:
        numbers = tuple(operator.index(index) for index in indices)
    except TypeError as error:
        raise InputError(
            f"indices: {indices!r} is no series of frame numbers ({error}). Pass whole numbers, "
            "for example range(75, 85)."
        ) from error
    for index in numbers:
        if not 0 <= index < length:
            raise InputError(
                f"indices: there is no frame {index}; the stack has {length} frames, counted "
                "from 0."
            )
    return numbers


class HeldFrames:
    """Copies of the frames in use, each read from its stack once.

    Lives for one call of a model. When room is needed, the frames farthest in time from
    those asked for go first.

    Parameters
    ----------
    frames
        The stack: ``frames[t]`` is a (rows, cols) image, all of one shape and type.
    capacity
        How many frames are held at most.
    """

    def __init__(self, frames: Frames, capacity: int) -> None:
        self.length = len(frames)
        self.shape: tuple[int, ...] = (0, 0)
        self.pixels = np.empty((0, 0), np.uint16)  # (capacity, rows * cols), row = slot
        self._frames = frames
        self._free = list(range(min(capacity, self.length)))[::-1]
        self._slots: dict[int, int] = {}

    @property
    def precise(self) -> np.dtype[Any]:
        """Return the float type that holds every grey value exactly."""
        return np.result_type(self.pixels.dtype, np.float32)

    def fetch(self, indices: Sequence[int]) -> npt.NDArray[np.intp]:
        """Return the rows of `pixels` with these frames; read missing ones."""
        missing = [index for index in dict.fromkeys(indices) if index not in self._slots]
        excess = len(missing) - len(self._free)
        if excess > 0:
            low, high = min(indices), max(indices)
            others = [index for index in self._slots if index not in indices]
            others.sort(key=lambda index: max(low - index, index - high), reverse=True)
            self._free += [self._slots.pop(index) for index in others[:excess]]
        for index in missing:
            image = self._read(index)
            self._slots[index] = self._free.pop()
            self.pixels[self._slots[index]] = image.ravel()
        return np.array([self._slots[index] for index in indices], dtype=np.intp)

    def __getitem__(self, index: int) -> Image:
        """Return a held frame, (rows, cols)."""
        return self.pixels[self._slots[index]].reshape(self.shape)

    def _read(self, index: int) -> Image:
        image = np.asarray(self._frames[index])
        kind = image.dtype.newbyteorder("=")
        if image.ndim != 2 or not image.size:
            raise InputError(
                f"frame {index}: shape {image.shape}, expected (rows, cols) with pixels. Pass one "
                "gray channel."
            )
        if kind.name not in GRAY_TYPES:
            raise InputError(
                f"frame {index}: gray values of type {kind} are not supported; convert them to one "
                f"of {', '.join(GRAY_TYPES)}."
            )
        if not self.pixels.size:
            # Memory is taken page by page as slots are filled, so capacity costs nothing unused.
            self.shape, self.pixels = image.shape, np.empty((len(self._free), image.size), kind)
        if image.shape != self.shape or kind != self.pixels.dtype:
            raise InputError(
                f"frame {index}: {kind} of shape {image.shape}, but frame {min(self._slots)} is "
                f"{self.pixels.dtype} of shape {self.shape}. Split the stack where it changes."
            )
        if kind.kind == "f" and not np.isfinite(image).all():
            bad = tuple(int(i) for i in np.argwhere(~np.isfinite(image))[0])
            raise InputError(
                f"frame {index}: the gray value at row, col {bad} is {image[bad]}. Fill or "
                "leave out such pixels before the call."
            )
        return image


def difference(frame: Image, background: Image) -> Foreground:
    """Return the absolute difference of two images as float32."""
    kind = np.result_type(frame, background, np.float32)  # exact for both
    if (frame.dtype, background.dtype) == (np.uint16, np.float32):
        return np.asarray(_apart(frame.ravel(), background.ravel())).reshape(frame.shape)
    apart = cv2.absdiff(frame.astype(kind, copy=False), background.astype(kind, copy=False))
    return np.asarray(apart, dtype=np.float32)


@njit(cache=True)
def _apart(frame: Image, background: Image) -> Foreground:
    """Return the absolute difference without a float copy of the frame, which takes a third."""
    out = np.empty(frame.size, np.float32)
    for p in range(out.size):
        out[p] = abs(np.float32(frame[p]) - background[p])
    return out


def excess(frame: Image, background: Image) -> Foreground:
    """Return by how much a frame exceeds a background, elsewhere 0, as float32."""
    kind = np.result_type(frame, background, np.float32)  # exact for both
    over = np.subtract(frame, background, dtype=kind)
    return np.maximum(over, 0, out=over).astype(np.float32, copy=False)


def partner(index: int, step: int, length: int) -> int:
    """Return the frame ``step`` frames away, or as far the other way.

    If neither is in the recording, it is the farther end.
    """
    for candidate in (index + step, index - step):
        if 0 <= candidate < length:
            return candidate
    return 0 if index > length - 1 - index else length - 1


@dataclass(frozen=True)
class TwoFrame:
    """Take the absolute difference from an earlier frame (Eq. 2.5).

    Notes
    -----
    The first frames have no frame ``interval`` before them. They are compared with the
    frame as far after, and in a recording shorter than that with its farther end.
    """

    interval: int = 3  # frames, i of Eqs 2.5 and 2.6, Table 5.4
    _sides: ClassVar[tuple[int, ...]] = (-1,)  # compared with: -1 an earlier frame, 1 a later one

    def __post_init__(self) -> None:
        """Refuse an interval below one frame."""
        check_count(self.interval, f"{type(self).__name__}: interval")

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield each requested frame's foreground; arguments as of `Mean`."""
        held = HeldFrames(frames, 2 * self.interval + 1)
        return (self._foreground(held, t) for t in check_indices(indices, held.length))

    def _foreground(self, held: HeldFrames, t: int) -> Foreground:
        beside = [partner(t, side * self.interval, held.length) for side in self._sides]
        held.fetch(sorted([t, *beside]))
        total = difference(held[t], held[beside[0]])
        for other in beside[1:]:
            total += difference(held[t], held[other])
        total /= len(beside)
        return total


@dataclass(frozen=True)
class ThreeFrame(TwoFrame):
    """Average the differences from an earlier and a later frame (Eq. 2.6).

    Notes
    -----
    Where there is no earlier or no later frame, the other one counts twice. In a
    recording shorter than the interval its farther end stands for both.
    """

    _sides: ClassVar[tuple[int, ...]] = (-1, 1)


class WindowModel(ABC):
    """Compare each frame with a background made of frames around it."""

    window: int
    _room: ClassVar[int] = 1  # frames held beside the window

    def __post_init__(self) -> None:
        """Refuse a window without frames."""
        check_count(self.window, f"{type(self).__name__}: window")

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield the foreground of each requested frame, (rows, cols) float32.

        Parameters
        ----------
        frames
            Stack of grey images, ``frames[t]`` of shape (rows, cols), read lazily.
        indices
            Numbers of frames, counted from 0, in any order.

        Raises
        ------
        InputError
            If there is no such frame, or frames differ in shape or type.
        """
        held, backgrounds = self._prepared(frames, indices)
        return (difference(held[t], image) for t, image in backgrounds)

    def with_frames(
        self, frames: Frames, indices: Iterable[int]
    ) -> Iterator[tuple[Image, Foreground]]:
        """Yield a copy of each requested frame, and its foreground as of a call.

        The copy is read-only: results computed from it stay valid and may be cached.
        """
        held, backgrounds = self._prepared(frames, indices)
        for t, image in backgrounds:
            frame = held[t].copy()
            frame.flags.writeable = False
            yield frame, difference(frame, image)

    def backgrounds(self, frames: Frames, indices: Iterable[int]) -> Iterator[Image]:
        """Yield the background of each requested frame, (rows, cols)."""
        return (image.copy() for _, image in self._prepared(frames, indices)[1])

    def _prepared(
        self, frames: Frames, indices: Iterable[int]
    ) -> tuple[HeldFrames, Iterator[tuple[int, Image]]]:
        held = HeldFrames(frames, self.window + self._room)
        return held, self._backgrounds(held, check_indices(indices, held.length))

    def brighter(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield by how much each requested frame exceeds its background, elsewhere 0.

        Arguments and errors are those of a call.
        """
        held, backgrounds = self._prepared(frames, indices)
        return (excess(held[t], image) for t, image in backgrounds)

    @abstractmethod
    def _backgrounds(self, held: HeldFrames, indices: Sequence[int]) -> Iterator[tuple[int, Image]]:
        """Yield each index with its background, valid until the next."""


@dataclass(frozen=True)
class StopsAtZero:
    """Subtract a background and stop at zero: what is darker than it vanishes.

    The other reading of section 2.2.1. Bars of an absolute value stand in Eqs 2.5, 2.6 and
    2.10; for mean, median and adaptive learning no difference is printed. "Dark particles might
    be deleted" by the subtraction "depending on the applied background model" (section 3.1,
    case 4), which an absolute difference does not do.

    Parameters
    ----------
    model
        `Mean`, `Median` or `Adaptive`.

    Raises
    ------
    InputError
        If the equation of the model is printed with bars.
    """

    model: WindowModel

    def __post_init__(self) -> None:
        """Refuse a model whose equation has bars."""
        if not isinstance(self.model, WindowModel):
            raise InputError(
                f"StopsAtZero: {self.model!r} is printed as an absolute difference (Eqs 2.5, 2.6, "
                "2.10). Pass Mean, Median or Adaptive."
            )

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield each requested frame's foreground; arguments as of `Mean`."""
        return self.model.brighter(frames, indices)
