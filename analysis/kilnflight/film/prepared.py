"""A recording as it is searched, changed frame by frame when it is read."""

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from kilnflight.arrays import Anything
from kilnflight.recording.files import WHITE
from kilnflight.recording.frames import Attributes, Frame, Gray, Recording

KEPT_PX = 128_000_000  # of the frames that are kept; 256 MB


class Kept:
    """A recording without depth, whose last frames stay in memory: all of a short film.

    They are read many times while settings are chosen, and in the windows of medians.
    Another process reads them again.

    Parameters
    ----------
    original
        The recording.
    """

    def __init__(self, original: Recording) -> None:
        self.original = original
        self.attributes = original.attributes
        most = KEPT_PX // math.prod(self.attributes.size)
        self.frame = lru_cache(most)(original.frame)

    def __reduce__(self) -> Any:
        return Kept, (self.original,)

    def __len__(self) -> int:
        return len(self.original)

    def gray(self, t: int) -> Gray:
        """Return the grey values (rows, cols) of frame ``t``."""
        return self.frame(t).gray


@dataclass(frozen=True)
class Prepared:
    """A recording as it is searched: bright particles, even light, or a part of it.

    It is a `kilnflight.chain.Source`, identified by its content and not by its place.

    Parameters
    ----------
    original
        The recording.
    content
        Its `StoredRecording.content`, where tables are stored.
    dark
        Whether grey values are inverted.
    level
        Median grey value that every frame is brought to; None: frames stay.
    roi
        First row, row after the last, first column, column after the last; None: all.
    """

    original: Recording = field(repr=False, compare=False)
    content: str = ""
    dark: bool = False
    level: float | None = None
    roi: tuple[int, int, int, int] | None = None

    @property
    def name(self) -> str:
        """Name of the recording."""
        return self.original.attributes.name

    @property
    def attributes(self) -> Attributes:
        """Facts about the recording."""
        if self.roi is None:
            return self.original.attributes
        top, bottom, left, right = self.roi
        corners = ((top, left), (top, right), (bottom, right), (bottom, left))
        return replace(self.original.attributes, roi=corners)

    def __len__(self) -> int:
        return len(self.original)

    def recording(self) -> Recording:
        """Return the recording, changed."""
        return self

    def gray(self, t: int) -> Gray:
        """Return the grey values (rows, cols) of frame ``t``."""
        return self._changed(self.original.gray(t))

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, its grey values changed."""
        frame = self.original.frame(t)
        return replace(frame, gray=self._changed(frame.gray))

    def _changed(self, gray: Gray) -> Gray:
        if self.level is not None:
            even = gray * (self.level / max(level_of(gray), 1.0))
            gray = np.minimum(np.rint(even), WHITE).astype(np.uint16)
        if self.dark:
            return np.subtract(WHITE, gray, dtype=np.uint16)
        return gray


def mean_level(recording: Recording) -> float | None:
    """Return the mean grey level if the light changes by more than 1 %, else None."""
    levels = [level_of(recording.gray(t)) for t in spread(len(recording), 30)]
    mean = float(np.mean(levels))
    if np.std(levels) > 0.01 * mean:
        return mean
    return None


def level_of(gray: Anything) -> float:
    """Return the median grey value of every fourth pixel of every fourth row."""
    return float(np.median(gray[::4, ::4]))


def spread(length: int, number: int) -> list[int]:
    """Return ``number`` indices, or all, spread evenly over a length."""
    return np.unique(np.linspace(0, length - 1, number).round().astype(int)).tolist()
