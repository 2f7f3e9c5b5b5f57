"""Adaptive background learning: a mean that follows the scene (Eqs 2.7 and 2.8)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.background.sliding_mean import window_means
from kilnflight.background.window import (
    Foreground,
    Frames,
    Held,
    Image,
    check_indices,
    check_share,
    differences,
)
from kilnflight.checks import check_count

TILE = 4096  # pixels that stay in cache while the recursion runs over the frames


@njit(cache=True)
def _copy(source: Image, out: Image) -> None:
    """Fill ``out`` or as much of it as there is; a slice assigned is slow to compile."""
    for p in range(min(source.size, out.size)):
        out[p] = source[p]


@njit(cache=True)
def _learn(pixels: Image, slots: npt.NDArray[np.intp], rate: float, background: Image) -> None:
    """Eq. 2.8 in place over the frames in ``slots``, as B + alpha (I - B): exact at rest."""
    state = np.empty(TILE)
    for first in range(0, background.size, TILE):
        last = min(first + TILE, background.size)
        _copy(background[first:last], state)
        for slot in slots:
            frame = pixels[slot, first:last]
            for p in range(frame.size):
                state[p] += rate * (np.float64(frame[p]) - state[p])
        _copy(state, background[first:last])


@dataclass(frozen=True)
class Adaptive:
    """Absolute difference from an adaptively learnt background (Eqs 2.7 and 2.8, Zhang 2023).

    Notes
    -----
    The thesis leaves open how many times Eq. 2.8 is applied. Table 5.4 places the 50
    frames of the initial mean B_0 (Eq. 2.7) around the wanted frame, 25 previous and 25
    subsequent; the recursion then runs over the 25 previous frames and the wanted one.
    Thus B_t depends on frames around t only, never on what else is asked for. At the ends
    the mean's window is shifted as in `Mean`, and the recursion starts at frame 0 at the
    earliest.
    """

    window: int = 50  # frames of the initial mean, Table 5.4
    learning_rate: float = 0.05  # alpha of Eq. 2.8, weight of the current frame, Table 5.4

    def __post_init__(self) -> None:
        """Refuse a window that holds nothing, and a rate that is no weight."""
        check_count(self.window, "Adaptive: window")
        check_share(self.learning_rate, "Adaptive: learning_rate")

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield the foreground of each wanted frame, (rows, cols) float32; see `Mean`."""
        held = Held(frames, self.window + 1)
        return differences(held, self._learnt(held, check_indices(indices, held.length)))

    def backgrounds(self, frames: Frames, indices: Iterable[int]) -> Iterator[Image]:
        """Yield the background of each wanted frame, (rows, cols), as `__call__` takes it."""
        held = Held(frames, self.window + 1)
        learnt = self._learnt(held, check_indices(indices, held.length))
        return (image.copy() for _, image in learnt)

    def _learnt(self, held: Held, indices: tuple[int, ...]) -> Iterator[tuple[int, Image]]:
        for t, background in window_means(held, indices, self.window):
            slots = held.fetch(range(max(t - self.window // 2, 0), t + 1))
            _learn(held.pixels, slots, self.learning_rate, background.ravel())
            yield t, background
