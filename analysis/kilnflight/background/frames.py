"""Stacks of grey frames, and the frames of one that are held in memory."""

import operator
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np

from kilnflight.arrays import Anything, Shape
from kilnflight.checks import InputError, check_finite, real_numbers

GRAY_TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8")


class Frames(Protocol):
    """Stack of grey images (rows, cols) read lazily, such as an array."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Any: ...


def check_indices(indices: Iterable[int], length: int) -> Shape:
    """Return frame numbers as ints, as given, or raise an `InputError`.

    They are whole numbers, numpy's too, from 0 to ``length`` - 1.
    """
    try:
        numbers = tuple(operator.index(index) for index in indices)
    except TypeError as error:
        raise InputError(
            f"indices: no series of frame numbers ({error}). Pass whole numbers."
        ) from error
    for index in numbers:
        if not 0 <= index < length:
            raise InputError(
                f"indices: there is no frame {index}; the stack has {length} frames."
            )
    return numbers


def surrounding(index: int, window: int, length: int) -> range:
    """Return the numbers of a frame and of the ``window`` frames nearest in time.

    ``index`` is the frame's number, ``length`` the frames of the recording. As many are
    before as after (of an odd window, one more before). At the ends of the recording
    the window is shifted to stay inside. A shorter recording gives all its frames.

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


class HeldFrames:
    """Frames in use, each read from its stack once.

    An array that its owner may change is copied. ``shape`` and ``kind``, the type, are
    those of the first frame read.

    Parameters
    ----------
    frames
        The stack; all frames have one shape and type.
    capacity
        Largest number of frames held. The frames farthest in time are evicted first.
    """

    def __init__(self, frames: Frames, capacity: int) -> None:
        if not hasattr(frames, "__getitem__") or not hasattr(frames, "__len__"):
            raise InputError(
                f"frames: {type(frames).__name__} is no stack of pictures."
            )
        self.length = len(frames)
        self.shape: Shape = (0, 0)
        self.kind: np.dtype[Any] = np.dtype(np.uint16)
        self._frames = frames
        self._capacity = capacity
        self._images: dict[int, Anything] = {}  # key: frame number

    @property
    def precise(self) -> np.dtype[Any]:
        """Return the float type that holds every grey value exactly."""
        return np.result_type(self.kind, np.float32)

    def fetch(self, indices: Sequence[int]) -> None:
        """Read these frames unless they are held; there are at most ``capacity``."""
        low = min(indices)
        high = max(indices)
        for index in indices:
            if index not in self._images:
                if len(self._images) == self._capacity:
                    others = (other for other in self._images if other not in indices)
                    del self._images[max(others, key=lambda t: max(low - t, t - high))]
                self._images[index] = self._read(index)

    def __getitem__(self, index: int) -> Anything:
        """Return a held frame, (rows, cols)."""
        return self._images[index]

    def _read(self, index: int) -> Anything:
        """Return a frame (rows, cols), checked, in the machine's byte order."""
        image = real_numbers(self._frames[index], f"frame {index}")
        kind = image.dtype.newbyteorder("=")
        if image.ndim != 2 or not image.size or kind.str[1:] not in GRAY_TYPES:
            raise InputError(
                f"frame {index}: {kind} of shape {image.shape}, expected one gray "
                "channel (rows, cols) of integers up to 32 bit, float32 or float64. "
                "Convert it."
            )
        if not self._images:
            self.shape = image.shape
            self.kind = kind
        if image.shape != self.shape or kind != self.kind:
            raise InputError(
                f"frame {index}: {kind} of shape {image.shape}, but frame "
                f"{min(self._images)} is {self.kind} of shape {self.shape}. Split the "
                "stack where it changes."
            )
        if kind.kind == "f":
            check_finite(image, f"frame {index}")
        if image.flags.writeable:  # its owner may change it
            return np.array(image, kind, order="C")
        return np.ascontiguousarray(image, kind)
