"""Recursive backgrounds, which learn from frame to frame.

Both recursions are OpenCV's weighted accumulation, B <- (1 - weight) B + weight I. They run
over what exceeds a reference frame, so that a still recording has no foreground at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from kilnflight.background.difference import (
    Foreground,
    Frames,
    HeldFrames,
    Image,
    WindowModel,
    check_indices,
)
from kilnflight.background.static import window_means
from kilnflight.checks import check_at_least, check_between, check_count


@dataclass(frozen=True)
class Adaptive(WindowModel):
    """Take the absolute difference from an adaptively learnt background.

    Eqs 2.7 and 2.8, Zhang 2023.

    Notes
    -----
    The thesis leaves open how many times Eq. 2.8 is applied. Table 5.4 places the 50
    frames of the initial mean B_0 (Eq. 2.7) around the requested frame, 25 previous and 25
    subsequent. The recursion then runs over the 25 previous frames and the frame itself.
    Thus B_t depends on frames around t only, never on what else is asked for. At the ends
    the mean's window is shifted as in `Mean`, and the recursion starts at frame 0 at the
    earliest.
    """

    window: int = 50  # frames of the initial mean, Table 5.4
    learning_rate: float = 0.05  # alpha of Eq. 2.8, weight of the current frame, Table 5.4

    def __post_init__(self) -> None:
        """Refuse a window without frames, and a rate that is no weight."""
        super().__post_init__()
        check_between(self.learning_rate, 0, 1, "Adaptive: learning_rate")

    def _backgrounds(self, held: HeldFrames, indices: Sequence[int]) -> Iterator[tuple[int, Image]]:
        means = window_means(held, indices, self.window)
        return ((t, self._learn(held, t, mean)) for t, mean in means)

    def _learn(self, held: HeldFrames, t: int, mean: Image) -> Image:
        """Return the background by Eq. 2.8 over frame t and those before."""
        past = range(max(t - self.window // 2, 0), t + 1)
        held.fetch(past)
        excess = np.subtract(mean, held[t], dtype=np.float64)
        for other in past:
            image = np.subtract(held[other], held[t], dtype=np.float64)
            cv2.accumulateWeighted(image, excess, self.learning_rate)
        return (held[t] + excess).astype(held.precise)


@dataclass(frozen=True)
class RunningGaussian:
    """Take the difference from a running average where it is significant.

    Eqs 2.9 and 2.10, Zhang 2023: the absolute difference where it exceeds k standard deviations, 0
    elsewhere.

    Notes
    -----
    Eq. 2.9 gives alpha to the current frame; with the 0.99 of Table 5.4 the background
    would be the current frame. The text says that the first image dominates it, so 0.99
    is read as the weight of the previous average, here ``memory``. The recursion runs
    over the 10 frames that end with the requested frame. It starts with the first of them
    and a standard deviation of 0, which follows by the same recursion of squared deviations.
    Near the start of a recording there are fewer, and frame 0 has no foreground. Section
    5.1.2 subtracts this background too, so the selected pixels keep their difference.
    """

    window: int = 10  # frames, the one asked for the last of them, Table 5.4
    memory: float = 0.99  # alpha of Table 5.4, weight of the previous average
    k: float = 0.4  # standard deviations, Table 5.4

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        check_count(self.window, "RunningGaussian: window")
        check_between(self.memory, 0, 1, "RunningGaussian: memory")
        check_at_least(self.k, 0, "RunningGaussian: k")

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield each requested frame's foreground; arguments as of `Mean`."""
        return (foreground for _, foreground in self._averaged(frames, indices))

    def backgrounds(self, frames: Frames, indices: Iterable[int]) -> Iterator[Image]:
        """Yield the average of each requested frame, (rows, cols)."""
        return (mean for mean, _ in self._averaged(frames, indices))

    def _averaged(
        self, frames: Frames, indices: Iterable[int]
    ) -> Iterator[tuple[Image, Foreground]]:
        held = HeldFrames(frames, self.window)
        return (self._average(held, t) for t in check_indices(indices, held.length))

    def _average(self, held: HeldFrames, t: int) -> tuple[Image, Foreground]:
        """Return mean and foreground of frame t by Eqs 2.9 and 2.10."""
        first, *past = range(max(t - self.window + 1, 0), t + 1)
        held.fetch(range(first, t + 1))
        mean, variance, deviation = (np.zeros(held.shape) for _ in range(3))
        for other in past:
            image = np.subtract(held[other], held[first], dtype=np.float64)
            cv2.accumulateWeighted(image, mean, 1 - self.memory)
            deviation = image - mean
            cv2.accumulateWeighted(deviation**2, variance, 1 - self.memory)
        selected = deviation**2 > self.k**2 * variance
        foreground = np.where(selected, np.abs(deviation), 0).astype(np.float32)
        return (held[first] + mean).astype(held.precise), foreground
