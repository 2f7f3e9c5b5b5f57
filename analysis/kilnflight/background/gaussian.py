"""Running Gaussian average: what leaves its own scatter is foreground (Eqs 2.9 and 2.10)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.background.window import (
    Foreground,
    Frames,
    Held,
    Image,
    check_indices,
    check_share,
)
from kilnflight.checks import check_at_least, check_count

TILE = 4096  # pixels that stay in cache while the recursion runs over the frames


@njit(cache=True)
def _average(
    pixels: Image, slots: npt.NDArray[np.intp], memory: float, k: float, mean: Image, out: Image
) -> None:
    """Eqs 2.9 and 2.10 over the frames in ``slots``; mean of the last and its foreground."""
    mu = np.empty(TILE)
    variance = np.empty(TILE)
    for first in range(0, out.size, TILE):
        last = min(first + TILE, out.size)
        begin = pixels[slots[0], first:last]
        for p in range(begin.size):  # a slice assigned is slow to compile
            mu[p] = begin[p]
        variance[:] = 0.0
        for slot in slots[1:]:
            frame = pixels[slot, first:last]
            for p in range(frame.size):
                mu[p] += (1.0 - memory) * (np.float64(frame[p]) - mu[p])
                deviation = np.float64(frame[p]) - mu[p]
                variance[p] += (1.0 - memory) * (deviation * deviation - variance[p])
        current = pixels[slots[-1], first:last]
        for p in range(current.size):
            deviation = np.float64(current[p]) - mu[p]
            selected = deviation * deviation > k * k * variance[p]
            out[first + p] = abs(deviation) if selected else 0.0
            mean[first + p] = mu[p]


@dataclass(frozen=True)
class RunningGaussian:
    """Absolute difference from a running average, where it exceeds k standard deviations.

    Eqs 2.9 and 2.10, Zhang 2023; elsewhere the foreground is 0.

    Notes
    -----
    Eq. 2.9 gives alpha to the current frame; with the 0.99 of Table 5.4 the background
    would be the current frame. The text says that the first image dominates it, so 0.99
    is read as the weight of the previous average, here ``memory``. The recursion runs
    over the 10 frames that end with the wanted one and starts with the first of them and
    a standard deviation of 0, which follows by the same recursion of squared deviations;
    near the start of a recording there are fewer, and frame 0 has no foreground. Section
    5.1.2 subtracts this background too, so the selected pixels keep their difference.
    """

    window: int = 10  # frames, the wanted one the last of them, Table 5.4
    memory: float = 0.99  # alpha of Table 5.4, weight of the previous average
    k: float = 0.4  # standard deviations, Table 5.4

    def __post_init__(self) -> None:
        """Refuse a window that holds nothing, a weight that is none, a negative threshold."""
        check_count(self.window, "RunningGaussian: window")
        check_share(self.memory, "RunningGaussian: memory")
        check_at_least(self.k, 0, "RunningGaussian: k")

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield the foreground of each wanted frame, (rows, cols) float32; see `Mean`."""
        held = Held(frames, self.window)
        averaged = self._averaged(held, check_indices(indices, held.length))
        return (foreground for _, foreground in averaged)

    def backgrounds(self, frames: Frames, indices: Iterable[int]) -> Iterator[Image]:
        """Yield the average of each wanted frame, (rows, cols)."""
        held = Held(frames, self.window)
        averaged = self._averaged(held, check_indices(indices, held.length))
        return (mean for mean, _ in averaged)

    def _averaged(self, held: Held, indices: tuple[int, ...]) -> Iterator[tuple[Image, Foreground]]:
        for t in indices:
            slots = held.fetch(range(max(t - self.window + 1, 0), t + 1))
            mean = np.empty(held.shape, held.precise)
            foreground = np.empty(held.shape, np.float32)
            _average(held.pixels, slots, self.memory, self.k, mean.ravel(), foreground.ravel())
            yield mean, foreground
