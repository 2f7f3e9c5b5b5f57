"""Static frame difference: the mean or the median of the frames around (section 2.2.1)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kilnflight.background.difference import (
    Foreground,
    Frames,
    HeldFrames,
    Image,
    check_indices,
    differences,
)
from kilnflight.background.sliding_median import CHUNK, surrounding, window_medians
from kilnflight.checks import check_count


def window_means(
    held: HeldFrames, indices: Sequence[int], window: int
) -> Iterator[tuple[int, Image]]:
    """Yield each index with the mean of the ``window`` frames around it, itself left out.

    ``held`` needs room for ``window + 1``. Integer frames are summed exactly, from one
    index to the next; float frames anew each time as what exceeds the own frame, so that
    rounding depends on nothing else and a still recording is its own mean.
    """
    total, summed = np.empty(0), range(0)
    for index in indices:
        around = surrounding(index, window, held.length)
        gone = [other for other in summed if other not in around]
        if len(gone) >= len(around) // 2:
            gone, summed = [], range(0)
        for other in gone:
            total -= held[other]
        held.fetch(around)
        own, whole = held[index], held.pixels.dtype.kind != "f"
        if not (summed and whole):
            total, summed = np.zeros(held.shape, np.int64 if whole else np.float64), range(0)
        for other in around:
            if other not in summed:
                total += held[other] if whole else np.subtract(held[other], own, dtype=np.float64)
        summed = around
        others = max(len(around) - 1, 1)
        mean = (total - own) / others if whole else own + total / others
        yield index, (mean if len(around) > 1 else own).astype(held.precise)


@dataclass(frozen=True)
class Mean:
    """Absolute difference from the mean of the frames around.

    Source: section 2.2.1 (static frame difference) and Table 5.4, Zhang 2023.

    Notes
    -----
    Table 5.4 counts 50 frames as 25 previous and 25 subsequent ones, so the frame itself
    is not among them. At the ends of the recording the window is shifted to stay inside;
    of a recording no longer than the window all other frames are taken; a single frame is
    its own background.
    """

    window: int = 50  # frames, Table 5.4

    def __post_init__(self) -> None:
        """Refuse a window that holds nothing."""
        check_count(self.window, "Mean: window")

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield the foreground of each requested frame, (rows, cols) float32.

        Parameters
        ----------
        frames
            Stack of gray images, ``frames[t]`` of shape (rows, cols), read lazily.
        indices
            Numbers of frames, counted from 0, in any order.

        Raises
        ------
        InputError
            If there is no such frame, or frames differ in shape or type.
        """
        return differences(*self._means(frames, indices))

    def backgrounds(self, frames: Frames, indices: Iterable[int]) -> Iterator[Image]:
        """Yield the background of each requested frame, (rows, cols), as `__call__` takes it."""
        return (image for _, image in self._means(frames, indices)[1])

    def _means(
        self, frames: Frames, indices: Iterable[int]
    ) -> tuple[HeldFrames, Iterator[tuple[int, Image]]]:
        held = HeldFrames(frames, self.window + 1)
        return held, window_means(held, check_indices(indices, held.length), self.window)


@dataclass(frozen=True)
class Median:
    """Absolute difference from the median of the frames around.

    Exact: of an even number of frames, the mean of the two middle values. Source: section
    2.2.1 (static frame difference) and Table 5.4, Zhang 2023.

    Notes
    -----
    Table 5.4 counts 150 frames as 75 previous and 75 subsequent ones, so the frame itself
    is not among them. The ends of the recording are as in `Mean`. Up to 31 frames more than
    the window are held, because neighbours share the work.
    """

    window: int = 150  # frames, Table 5.4

    def __post_init__(self) -> None:
        """Refuse a window that holds nothing."""
        check_count(self.window, "Median: window")

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield the foreground of each requested frame; see `Mean`."""
        return differences(*self._medians(frames, indices))

    def backgrounds(self, frames: Frames, indices: Iterable[int]) -> Iterator[Image]:
        """Yield the background of each requested frame, (rows, cols), as `__call__` takes it."""
        return (image.copy() for _, image in self._medians(frames, indices)[1])

    def _medians(
        self, frames: Frames, indices: Iterable[int]
    ) -> tuple[HeldFrames, Iterator[tuple[int, Image]]]:
        held = HeldFrames(frames, self.window + CHUNK)
        return held, window_medians(held, check_indices(indices, held.length), self.window)
