"""Static frame difference: mean or median of the frames around.

Section 2.2.1 of the thesis.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kilnflight.background.difference import HeldFrames, Image, WindowModel
from kilnflight.background.sliding_median import CHUNK, surrounding, window_medians


def window_means(
    held: HeldFrames, indices: Sequence[int], window: int
) -> Iterator[tuple[int, Image]]:
    """Yield each index with the mean of the frames around it.

    The ``window`` frames do not include the frame itself. ``held`` needs room for ``window + 1``.
    Integer frames are summed exactly, from one index to the next. Float frames are summed anew
    each time, as the excess over the frame itself: rounding depends on nothing else, and a still
    recording equals its mean.
    """
    total, summed = np.empty(0), range(0)
    for index in indices:
        around = surrounding(index, window, held.length)
        gone = [other for other in summed if other not in around]
        if len(gone) >= len(around) // 2:  # summing anew costs no more
            gone, summed = [], range(0)
        for other in gone:
            total -= held[other]
        held.fetch(around)
        frame, whole = held[index], held.pixels.dtype.kind != "f"
        if not (summed and whole):
            total, summed = np.zeros(held.shape, np.int64 if whole else np.float64), range(0)
        for other in around:
            if other not in summed:
                total += held[other] if whole else np.subtract(held[other], frame, dtype=np.float64)
        summed = around
        others = max(len(around) - 1, 1)
        mean = (total - frame) / others if whole else frame + total / others
        yield index, (mean if len(around) > 1 else frame).astype(held.precise)


@dataclass(frozen=True)
class Mean(WindowModel):
    """Take the absolute difference from the mean of the frames around.

    Source: section 2.2.1 (static frame difference) and Table 5.4, Zhang 2023.

    Notes
    -----
    Table 5.4 counts 50 frames as 25 previous and 25 subsequent ones, so the frame itself
    is not among them. At the ends of the recording the window is shifted to stay inside.
    Of a recording no longer than the window all other frames are taken. A single frame is
    its own background.
    """

    window: int = 50  # frames, Table 5.4

    def _backgrounds(self, held: HeldFrames, indices: Sequence[int]) -> Iterator[tuple[int, Image]]:
        return window_means(held, indices, self.window)


@dataclass(frozen=True)
class Median(WindowModel):
    """Take the absolute difference from the median of the frames around.

    Exact: of an even number of frames, the mean of the two middle values. Source: section
    2.2.1 (static frame difference) and Table 5.4, Zhang 2023.

    Notes
    -----
    Table 5.4 counts 150 frames as 75 previous and 75 subsequent ones, so the frame itself
    is not among them. The ends of the recording are as in `Mean`. Up to 31 frames more than
    the window are held, because neighbours share the work.
    """

    window: int = 150  # frames, Table 5.4
    _room: ClassVar[int] = CHUNK

    def _backgrounds(self, held: HeldFrames, indices: Sequence[int]) -> Iterator[tuple[int, Image]]:
        return window_medians(held, indices, self.window)
