"""Static frame difference: the mean or the median of the frames around (section 2.2.1)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from kilnflight.background.sliding_mean import window_means
from kilnflight.background.sliding_median import CHUNK, window_medians
from kilnflight.background.window import (
    Foreground,
    Frames,
    Held,
    Image,
    check_indices,
    differences,
)
from kilnflight.checks import check_count


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
        """Yield the foreground of each wanted frame, (rows, cols) float32.

        Parameters
        ----------
        frames
            Stack of gray images, ``frames[t]`` of shape (rows, cols), read lazily.
        indices
            Wanted frames, counted from 0, in any order.

        Raises
        ------
        InputError
            If there is no such frame, or frames differ in shape or type.
        """
        held = Held(frames, self.window + 1)
        wanted = check_indices(indices, held.length)
        return differences(held, window_means(held, wanted, self.window))

    def backgrounds(self, frames: Frames, indices: Iterable[int]) -> Iterator[Image]:
        """Yield the background of each wanted frame, (rows, cols), as `__call__` takes it."""
        held = Held(frames, self.window + 1)
        wanted = check_indices(indices, held.length)
        return (image.copy() for _, image in window_means(held, wanted, self.window))


@dataclass(frozen=True)
class Median:
    """Absolute difference from the median of the frames around.

    Exact: of an even number of frames, the mean of the two middle values. Source: section
    2.2.1 (static frame difference) and Table 5.4, Zhang 2023.

    Notes
    -----
    Table 5.4 counts 150 frames as 75 previous and 75 subsequent ones, so the frame itself
    is not among them. At the ends of the recording the window is shifted to stay inside;
    of a recording no longer than the window all other frames are taken; a single frame is
    its own background. Up to 31 frames more than the window are held, because neighbours
    share the work.
    """

    window: int = 150  # frames, Table 5.4

    def __post_init__(self) -> None:
        """Refuse a window that holds nothing."""
        check_count(self.window, "Median: window")

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Foreground]:
        """Yield the foreground of each wanted frame; see `Mean`."""
        held = Held(frames, self.window + CHUNK)
        wanted = check_indices(indices, held.length)
        return differences(held, window_medians(held, wanted, self.window))

    def backgrounds(self, frames: Frames, indices: Iterable[int]) -> Iterator[Image]:
        """Yield the background of each wanted frame, (rows, cols), as `__call__` takes it."""
        held = Held(frames, self.window + CHUNK)
        wanted = check_indices(indices, held.length)
        return (image.copy() for _, image in window_medians(held, wanted, self.window))
