"""Background models of Table 5.4 (thesis, section 2.2.1).

The recursive ones use OpenCV's weighted accumulation, B <- (1 - weight) B + weight I.
It runs over differences from a reference frame, so that a still recording has no
foreground.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import field
from typing import ClassVar

import cv2
import numpy as np

from kilnflight.arrays import Anything, Shape, Single
from kilnflight.background.frames import Frames, HeldFrames, check_indices, surrounding
from kilnflight.background.sliding_median import (
    MEDIAN_CHUNK,
    Backgrounds,
    window_medians,
)
from kilnflight.checks import Count, NotNegative, Settings, Share

WIDTH_PX = 20.0  # standard deviation of the Gaussian of `Surroundings`


def _partner(index: int, step: int, length: int) -> int:
    """Return the number of the frame ``step`` frames away, or as far the other way.

    If neither is in the recording of ``length`` frames, return its farther end.
    """
    for candidate in (index + step, index - step):
        if 0 <= candidate < length:
            return candidate
    return 0 if index > length - 1 - index else length - 1


class Subtraction(Settings):
    """Subtract a background from each frame.

    Parameters
    ----------
    absolute
        Whether the difference is absolute. False: it stops at zero, as that of two
        pictures of 16 bits does in MATLAB, so that pixels darker than the background
        vanish. Eqs 2.5, 2.6 and 2.10 have bars; for mean, median and adaptive learning
        no difference is printed, and section 3.1 says that dark particles "might be
        deleted".
    """

    absolute: bool = field(default=False, kw_only=True)

    def _difference(self, frame: Anything, background: Anything) -> Single:
        """Return the difference of two images (rows, cols), float32."""
        kind = np.result_type(frame, background, np.float32)  # exact for both
        apart = np.subtract(frame, background, dtype=kind)
        if self.absolute:
            np.abs(apart, out=apart)
        else:
            np.maximum(apart, 0, out=apart)
        return np.asarray(apart, np.float32)


class TwoFrame(Subtraction):
    """Take the difference from an earlier frame (Eq. 2.5).

    Parameters
    ----------
    interval
        Frames from a frame to the one compared, i of Eqs 2.5 and 2.6.

    Notes
    -----
    The first frames have no frame ``interval`` before them. They are compared with the
    frame as far after. A recording shorter than that uses its farther end.

    Examples
    --------
    >>> frames = np.float32([[[5, 5]], [[5, 5]], [[5, 5]], [[5, 9]]])
    >>> next(TwoFrame(interval=3)(frames, [3]))
    array([[0., 4.]], dtype=float32)
    """

    interval: Count = 3  # frames, Table 5.4
    _sides: ClassVar[Shape] = (-1,)  # -1: an earlier frame, 1: a later one

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Single]:
        """Yield the foreground of each requested frame, (rows, cols) float32.

        ``frames[t]`` are grey images (rows, cols) of one stack; ``indices`` are frame
        numbers from 0, in any order.
        """
        held = HeldFrames(frames, 2 * self.interval + 1)
        return (self._foreground(held, t) for t in check_indices(indices, held.length))

    def _foreground(self, held: HeldFrames, t: int) -> Single:
        """Return the mean difference (rows, cols) of frame t from those beside it."""
        beside = [
            _partner(t, side * self.interval, held.length) for side in self._sides
        ]
        held.fetch([t, *beside])
        apart = [self._difference(held[t], held[other]) for other in beside]
        return np.mean(apart, axis=0)


class ThreeFrame(TwoFrame):
    """Average the differences from an earlier and a later frame (Eq. 2.6).

    Parameters
    ----------
    interval
        Frames from a frame to the two compared, i of Eq. 2.6.

    Notes
    -----
    Where there is no earlier or no later frame, the other one counts twice. A recording
    shorter than the interval uses its farther end for both.

    Examples
    --------
    >>> frames = np.float32([[[5, 5]], [[5, 9]], [[5, 7]]])
    >>> next(ThreeFrame(interval=1)(frames, [1]))  # 4 from before and 2 from after
    array([[0., 3.]], dtype=float32)
    """

    _sides: ClassVar[Shape] = (-1, 1)


class WindowModel(Subtraction, ABC):
    """Compare each frame with a background made of the frames around it.

    Parameters
    ----------
    window
        Frames around each frame, from 1.
    """

    window: Count
    _room: ClassVar[int] = 1  # frames held beside the window

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Single]:
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
        return (self._difference(held[t], image) for t, image in backgrounds)

    def backgrounds(self, frames: Frames, indices: Iterable[int]) -> Iterator[Anything]:
        """Yield the background (rows, cols) of each requested frame, as in Fig. 5.2."""
        return (image.copy() for _, image in self._prepared(frames, indices)[1])

    def _prepared(
        self, frames: Frames, indices: Iterable[int]
    ) -> tuple[HeldFrames, Backgrounds]:
        """Return the frames held, and each frame number with its background."""
        held = HeldFrames(frames, self.window + self._room)
        return held, self._backgrounds(held, check_indices(indices, held.length))

    @abstractmethod
    def _backgrounds(self, held: HeldFrames, indices: Sequence[int]) -> Backgrounds:
        """Yield frame numbers with backgrounds (rows, cols), valid until the next."""


class Mean(WindowModel):
    """Subtract the mean of the frames around each frame.

    Source: section 2.2.1 (static frame difference) and Table 5.4, Zhang 2023.

    Parameters
    ----------
    window
        Frames around each frame (Table 5.4).

    Notes
    -----
    Table 5.4 counts 50 frames as 25 previous and 25 subsequent ones, so the frame
    itself is not among them. At the ends of the recording the window is shifted to stay
    inside. A recording no longer than the window gives all other frames. A single frame
    is its own background.

    Examples
    --------
    >>> frames = np.float32([[[5, 5]], [[5, 9]], [[5, 7]]])
    >>> next(Mean(window=2)(frames, [1]))  # 9 above the mean of 5 and 7
    array([[0., 3.]], dtype=float32)
    """

    window: Count = 50  # frames, Table 5.4

    def _backgrounds(self, held: HeldFrames, indices: Sequence[int]) -> Backgrounds:
        return ((t, _mean(held, t, self.window)) for t in indices)


def _mean(held: HeldFrames, t: int, window: int) -> Anything:
    """Return the mean (rows, cols) of the frames around frame t, without itself.

    It is the background of `Mean`, and B_0 of `Adaptive` (Eq. 2.7).
    """
    around = surrounding(t, window, held.length)
    held.fetch(around)
    total = np.zeros(held.shape)  # sums differences: a still film equals its mean
    for other in around:
        cv2.accumulate(np.subtract(held[other], held[t], dtype=held.precise), total)
    return (held[t] + total / max(len(around) - 1, 1)).astype(held.precise)


class Median(WindowModel):
    """Subtract the median of the frames around each frame.

    The mean of the two middle values for an even number of frames. Source: section
    2.2.1 (static frame difference) and Table 5.4, Zhang 2023.

    Parameters
    ----------
    window
        Frames around each frame (Table 5.4).

    Notes
    -----
    Table 5.4 counts 150 frames as 75 previous and 75 subsequent ones, so the frame
    itself is not among them. The ends of the recording are as in `Mean`. Up to
    `MEDIAN_CHUNK` frames more than the window are held, because neighbours share the
    work.

    Examples
    --------
    >>> frames = np.float32([[[5]], [[5]], [[90]], [[6]], [[7]]])
    >>> next(Median(window=4)(frames, [2]))  # 90 above the median of 5, 5, 6 and 7
    array([[84.5]], dtype=float32)
    """

    window: Count = 150  # frames, Table 5.4
    _room: ClassVar[int] = MEDIAN_CHUNK

    def _backgrounds(self, held: HeldFrames, indices: Sequence[int]) -> Backgrounds:
        return window_medians(held, indices, self.window)


class Adaptive(WindowModel):
    """Subtract a background that learns from frame to frame (Eqs 2.7, 2.8).

    Parameters
    ----------
    window
        Frames of the initial mean.
    learning_rate
        alpha of Eq. 2.8, weight of the current frame, from 0 to 1.

    Notes
    -----
    The thesis leaves open how many times Eq. 2.8 is applied. Table 5.4 places the 50
    frames of the initial mean B_0 (Eq. 2.7) around the requested frame, 25 previous and
    25 subsequent. The recursion then runs over the 25 previous frames and the frame
    itself. Thus B_t depends only on frames around t. At the ends of the recording the
    mean's window is shifted as in `Mean`, and the recursion starts at frame 0 at the
    earliest.

    Examples
    --------
    >>> frames = np.float32([[[5.0]], [[9.0]], [[5.0]]])
    >>> next(Adaptive(window=2, learning_rate=0.5).backgrounds(frames, [1]))
    array([[7.]], dtype=float32)
    """

    window: Count = 50  # frames, Table 5.4
    learning_rate: Share = 0.05  # Table 5.4

    def _backgrounds(self, held: HeldFrames, indices: Sequence[int]) -> Backgrounds:
        for t in indices:
            start = _mean(held, t, self.window)  # Eq. 2.7
            past = range(max(t - self.window // 2, 0), t + 1)
            held.fetch(past)
            excess = np.subtract(start, held[t], dtype=np.float64)
            for other in past:  # Eq. 2.8
                image = np.subtract(held[other], held[t], dtype=np.float64)
                cv2.accumulateWeighted(image, excess, self.learning_rate)
            yield t, (held[t] + excess).astype(held.precise)


class RunningGaussian(WindowModel):
    """Keep differences from a running average that are significant (Eqs 2.9, 2.10).

    The foreground is the difference where it exceeds ``k`` standard deviations, 0
    elsewhere.

    Parameters
    ----------
    window
        Frames of the recursion; the requested one is the last.
    memory
        alpha of Table 5.4, weight of the previous average, from 0 to 1.
    k
        Standard deviations.

    Notes
    -----
    Eq. 2.9 gives alpha to the current frame; with the 0.99 of Table 5.4 the background
    would be the current frame. The text says that the first image dominates it, so 0.99
    is read as the weight of the previous average, here ``memory``. The recursion runs
    over the 10 frames that end with the requested frame. It starts with the first of
    them and a standard deviation of 0, which follows by the same recursion of squared
    deviations. Near the start of a recording there are fewer, and frame 0 has no
    foreground. Section 5.1.2 subtracts this background too, so the selected pixels keep
    their difference.

    Examples
    --------
    >>> frames = np.float32([[[5, 5]], [[5, 5]], [[5, 15]]])
    >>> next(RunningGaussian()(frames, [2])).round(1)  # 1 % of the step is learned
    array([[0. , 9.9]], dtype=float32)
    """

    window: Count = 10  # frames, Table 5.4
    memory: Share = 0.99  # Table 5.4
    k: NotNegative = 0.4  # Table 5.4

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Single]:
        """Yield the foreground of each requested frame, (rows, cols) float32.

        ``frames[t]`` are grey images (rows, cols) of one stack; ``indices`` are frame
        numbers from 0, in any order.
        """
        held = HeldFrames(frames, self.window)
        numbers = check_indices(indices, held.length)
        return (self._average(held, t)[1] for t in numbers)

    def _backgrounds(self, held: HeldFrames, indices: Sequence[int]) -> Backgrounds:
        return ((t, self._average(held, t)[0]) for t in indices)

    def _average(self, held: HeldFrames, t: int) -> tuple[Anything, Single]:
        """Return mean and foreground (rows, cols) of frame t by Eqs 2.9 and 2.10."""
        first, *past = range(max(t - self.window + 1, 0), t + 1)
        held.fetch(range(first, t + 1))
        mean, variance, deviation = (np.zeros(held.shape) for _ in range(3))
        for other in past:
            image = np.subtract(held[other], held[first], dtype=np.float64)
            cv2.accumulateWeighted(image, mean, 1 - self.memory)
            deviation = image - mean
            cv2.accumulateWeighted(deviation**2, variance, 1 - self.memory)
        selected = deviation**2 > self.k**2 * variance
        foreground = self._difference(
            np.where(selected, deviation, 0), np.zeros(held.shape)
        )
        return (held[first] + mean).astype(held.precise), foreground


class Surroundings(Settings):
    """Subtract each frame's own blur, for particles that rest; not in the thesis.

    Positive differences stay, as with `Median`. What is wider than `WIDTH_PX` is
    background.
    """

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[Single]:
        """Yield the foreground of each requested frame, (rows, cols) float32."""
        held = HeldFrames(frames, 1)
        for t in check_indices(indices, held.length):
            held.fetch([t])
            image = held[t].astype(np.float32)
            yield np.maximum(image - cv2.GaussianBlur(image, (0, 0), WIDTH_PX), 0)
