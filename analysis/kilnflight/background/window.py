"""The frames a background model looks at: which ones, and held for as long as they are needed."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator, Sequence
from numbers import Real
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.checks import InputError

Image = npt.NDArray[Any]
Foreground = npt.NDArray[np.float32]
GRAY_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")


class Frames(Protocol):
    """A stack of images that is read lazily; an array of shape (frames, rows, cols) is one."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Any: ...


def check_indices(indices: Iterable[int], length: int) -> tuple[int, ...]:
    """Return the wanted frames as ints, or raise an `InputError` naming the first bad one."""
    try:
        wanted = tuple(operator.index(index) for index in indices)
    except TypeError as error:
        raise InputError(
            f"indices: {indices!r} is no series of frame numbers ({error}). Pass whole numbers, "
            "for example range(75, 85)."
        ) from error
    for index in wanted:
        if not 0 <= index < length:
            raise InputError(
                f"indices: there is no frame {index}; the stack has {length} frames, counted "
                "from 0."
            )
    return wanted


def check_share(share: float, where: str) -> None:
    """Raise an `InputError` unless ``share`` is from 0 to 1."""
    if not (isinstance(share, Real) and 0 <= share <= 1):
        raise InputError(f"{where}: is a weight, it must be from 0 to 1, got {share!r}.")


def surrounding(index: int, window: int, length: int) -> range:
    """Return frame ``index`` together with the ``window`` other frames nearest to it in time.

    As many before as after (of an odd window, one more before); at the ends of the
    recording shifted to stay inside; all frames if the recording has no more than that.

    Examples
    --------
    >>> surrounding(100, 150, 1000)
    range(25, 176)
    >>> surrounding(3, 150, 1000), surrounding(3, 150, 80)
    (range(0, 151), range(0, 80))
    """
    size = min(window + 1, length)
    start = min(max(index - (window + 1) // 2, 0), length - size)
    return range(start, start + size)


class Held:
    """Copies of the frames that are in use, fetched from a stack when first asked for.

    Lives for one call of a model. A frame stays until the room is needed; then those
    farthest in time from the wanted ones go first.

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
        self._capacity = min(capacity, self.length)
        self._free = list(range(self._capacity))[::-1]
        self._slots: dict[int, int] = {}
        self._first = -1

    @property
    def precise(self) -> np.dtype[Any]:
        """The float type that holds every gray value of the stack exactly."""
        return np.result_type(self.pixels.dtype, np.float32)

    def fetch(self, wanted: Sequence[int]) -> npt.NDArray[np.intp]:
        """Return the rows of `pixels` that hold the wanted frames, fetching what is missing."""
        missing = [index for index in dict.fromkeys(wanted) if index not in self._slots]
        excess = len(missing) - len(self._free)
        if excess > 0:
            low, high, kept = min(wanted), max(wanted), set(wanted)
            others = [index for index in self._slots if index not in kept]
            others.sort(key=lambda index: max(low - index, index - high), reverse=True)
            self._free += [self._slots.pop(index) for index in others[:excess]]
        for index in missing:
            self._copy(index)
        return np.array([self._slots[index] for index in wanted], dtype=np.intp)

    def __getitem__(self, index: int) -> Image:
        """Return a held frame, (rows, cols)."""
        return self.pixels[self._slots[index]].reshape(self.shape)

    def _copy(self, index: int) -> None:
        frame = np.asarray(self._frames[index])
        kind = frame.dtype.newbyteorder("=")
        if self._first < 0:
            self._accept(frame, kind, index)
        if frame.shape != self.shape or kind != self.pixels.dtype:
            raise InputError(
                f"frame {index}: {kind} of shape {frame.shape}, but frame {self._first} is "
                f"{self.pixels.dtype} of shape {self.shape}. Split the stack where it changes."
            )
        if kind.kind == "f" and not np.isfinite(frame).all():
            bad = tuple(int(i) for i in np.argwhere(~np.isfinite(frame))[0])
            raise InputError(
                f"frame {index}: the gray value at row, col {bad} is {frame[bad]}. Fill or "
                "leave out such pixels before the call."
            )
        slot = self._free.pop()
        self.pixels[slot] = frame.ravel()
        self._slots[index] = slot

    def _accept(self, frame: Image, kind: np.dtype[Any], index: int) -> None:
        if frame.ndim != 2 or not frame.size:
            raise InputError(
                f"frame {index}: shape {frame.shape}, expected (rows, cols) with pixels. Pass one "
                "gray channel."
            )
        if kind.name not in GRAY_TYPES:
            raise InputError(
                f"frame {index}: gray values of type {kind} are not supported; convert them to one "
                f"of {', '.join(GRAY_TYPES)}."
            )
        self.shape, self._first = frame.shape, index
        # Memory is taken page by page as slots are filled, so capacity costs nothing unused.
        self.pixels = np.empty((self._capacity, frame.size), kind)


@njit(cache=True)
def _absolute_difference(frame: Image, background: Image, out: Foreground) -> None:
    for pixel in range(out.size):
        out[pixel] = abs(np.float64(frame[pixel]) - np.float64(background[pixel]))


def difference(frame: Image, background: Image) -> Foreground:
    """Return the absolute difference of two images of any gray types, (rows, cols) float32."""
    out = np.empty(frame.shape, np.float32)
    _absolute_difference(frame.ravel(), background.ravel(), out.ravel())
    return out


def differences(held: Held, backgrounds: Iterable[tuple[int, Image]]) -> Iterator[Foreground]:
    """Yield the absolute difference of each held frame and its background."""
    for index, background in backgrounds:
        yield difference(held[index], background)
