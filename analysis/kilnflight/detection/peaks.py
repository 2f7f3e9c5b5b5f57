"""Local grey-value peaks in small areas of an image.

The combined detector decides its five cases by counting local peaks (thesis, chapter
3.1); the thesis does not define one. Here a peak stands out by a given prominence from
the saddle to any higher peak, and the highest peak from the median of the area's
border. A peak lies inside the area: the highest pixel of the border belongs to
something outside.

The thesis looks for peaks or troughs in the frame and in the absolute difference to the
frame before. Here both pictures are smoothed a little, and a peak must stand out from
the noise. The noise is measured in the frame itself, so nothing depends on the
exposure.
"""

import heapq
from collections.abc import Callable
from typing import Any, NamedTuple, Self

import cv2
import numpy as np

from kilnflight.arrays import Array, Flags, Integers, Single, TwoInts
from kilnflight.compiled import compiled

# Multiple of the noise by which a peak must stand out; ours. In an area of noise alone,
# of some hundred pixels, the highest stands out by about 3.5.
PROMINENCE = 5.0
# A second peak must stand out by this share of the highest: in saturated or flickering
# flames the noise is larger than elsewhere; ours.
SHARE = 0.1
LARGEST_AREA_PX = 250_000  # a larger area is no particle
# Standard deviation of the Gaussian, smaller than any visible particle.
SMOOTHING_PX = 1.0
_SAMPLES = 140_000  # pixels that measure the noise, to 0.3 % of it
_ROUNDING = 0.5  # grey values; the least noise, left by rounding to whole ones


def find_peaks(image: Single, area: Integers, prominence: float) -> Array:
    """Return row, column and prominence (k, 3) of an area's peaks, highest first.

    Parameters
    ----------
    image
        (rows, cols) grey values, smoothed against noise.
    area
        (4,) first row, row after the last, first column, column after the last, in px;
        clipped to the image.
    prominence
        Grey values by which a peak must stand out; above 0.

    Notes
    -----
    An area without inner pixels, flat, or above `LARGEST_AREA_PX` has no peak. Among
    equal pixels the first in row order counts as the higher one.
    """
    peaks = _area_peaks(_part(image, area), prominence, True)
    peaks[:, :2] += np.maximum(area[::2], 0)
    return peaks


@compiled
def _part(image: Single, area: Integers) -> Single:
    """Return a copy (rows, cols) of an area (4,) of the image.

    It is empty where there can be no peak: without inner pixels or above
    `LARGEST_AREA_PX`.
    """
    top, bottom, left, right = np.maximum(area, 0)
    part = image[top:bottom, left:right]
    if min(part.shape) < 3 or part.size > LARGEST_AREA_PX:
        part = part[:0]
    return part.copy()


@compiled
def _area_peaks(area: Single, prominence: float, every: bool) -> Array:
    """Return row, column and prominence (k, 3) of an area's peaks, the highest first.

    The area (rows, cols) holds grey values; rows and columns count from its corner.
    Without ``every`` the first in row order is enough, which saves time.
    """
    if not area.size:
        return np.empty((0, 3))
    height, width = area.shape
    least = area.min()
    top = area.argmax()  # the first of equal ones
    above = np.full(area.shape, -1.0)  # no peak
    for row in range(1, height - 1):
        for col in range(1, width - 1):
            value = area[row, col]
            if value - least < prominence:
                continue
            if value < area[row, col - 1] or value < area[row, col + 1]:
                continue
            if row * width + col == top:
                above[row, col] = value - _border_median(area)
            else:
                above[row, col] = _above_saddle(area, (row, col))
            if not every and above[row, col] >= prominence:
                return np.array([[float(row), float(col), above[row, col]]])
    peak = np.flatnonzero(above >= prominence)
    peak = peak[np.argsort(-area.ravel()[peak], kind="mergesort")]
    return np.column_stack((peak // width, peak % width, above.ravel()[peak]))


@compiled
def _border_median(area: Single) -> float:
    """Return the median of the outermost pixels of an area (rows, cols), each once."""
    sides = np.concatenate((area[0], area[-1], area[1:-1, 0], area[1:-1, -1]))
    return float(np.median(sides))


@compiled
def _moved(now: Single, before: Single, areas: Integers, prominence: float) -> Flags:
    """Return whether each area (n, 4) has a peak where two pictures differ.

    The peak is in the absolute difference. Both are (rows, cols), ``prominence`` is in
    grey values. Compiled: some hundred areas of a frame take half of the time of a loop
    in Python.
    """
    changes = [np.abs(_part(now, area) - _part(before, area)) for area in areas]
    return np.array(
        [len(_area_peaks(change, prominence, False)) > 0 for change in changes]
    )


@compiled
def _above_saddle(area: Single, place: TwoInts) -> float:
    """Return how far a pixel is above the saddle to a higher one, in grey values.

    ``place`` is row and column in the area (rows, cols), which has a higher pixel. The
    way goes on at the highest pixel that it has come by; the saddle is the lowest one
    on it. An equal pixel that comes first counts as higher.
    """
    height, width = area.shape
    value = area[place]
    number = place[0] * width + place[1]
    seen = np.zeros(area.shape, np.bool_)
    seen[place] = True
    saddle = value
    shore = [(-value, number)]
    reached = shore[0]
    while reached >= (-value, number):
        reached = heapq.heappop(shore)
        saddle = min(saddle, -reached[0])
        row, col = divmod(reached[1], width)
        for i in range(max(row - 1, 0), min(row + 2, height)):
            for j in range(max(col - 1, 0), min(col + 2, width)):
                if not seen[i, j]:
                    seen[i, j] = True
                    heapq.heappush(shore, (-area[i, j], i * width + j))
    return value - saddle


@compiled
def disc_pixels(discs: Any, smallest: float, shape: Any) -> Any:
    """Return disc, row and column (3, m) of each pixel within a disc.

    Compiled: discs of a flame cover a million pixels, for which numpy makes fifteen
    arrays.

    Parameters
    ----------
    discs
        (n, 3) row, column and radius in px.
    smallest
        Least radius in px; smaller discs get it.
    shape
        Rows and columns of the image.
    """
    radius = np.maximum(discs[:, 2:], smallest)
    low = np.maximum(np.ceil(discs[:, :2] - radius), 0).astype(np.intp)
    above = np.floor(discs[:, :2] + radius) + 1
    high = np.minimum(above, np.array(shape)).astype(np.intp)
    sides = np.maximum(high - low, 0)
    found = np.empty((3, (sides[:, 0] * sides[:, 1]).sum()), np.intp)
    count = 0
    for disc in range(len(discs)):
        limit = radius[disc, 0] ** 2
        for row in range(low[disc, 0], high[disc, 0]):
            for col in range(low[disc, 1], high[disc, 1]):
                if (row - discs[disc, 0]) ** 2 + (col - discs[disc, 1]) ** 2 <= limit:
                    found[0, count] = disc
                    found[1, count] = row
                    found[2, count] = col
                    count += 1
    return found[:, :count]


def _middle(values: Single) -> Any:
    """Return the median of an odd number of values, ten times as fast as numpy's."""
    half = values.size // 2
    return np.partition(values, half)[half]


def smoothed(image: Integers) -> Single:
    """Return a picture (rows, cols) blurred by a Gaussian, float32.

    Its standard deviation is `SMOOTHING_PX`; the kernel ends at four of them.
    """
    picture = image.astype(np.float32)
    side = 2 * round(4 * SMOOTHING_PX) + 1
    return np.asarray(
        cv2.GaussianBlur(picture, (side, side), SMOOTHING_PX, dst=picture)
    )


class Smoother:
    """Smooth frames and keep the last two, as each frame is next the previous one.

    A frame is recognised by identity, so its array must not be changed afterwards.
    """

    def __init__(self) -> None:
        self._recent: list[tuple[Integers, Single]] = []

    def __call__(self, image: Integers) -> Single:
        """Return a frame (rows, cols) as `smoothed`; the result must not be changed."""
        for frame, picture in self._recent:
            if frame is image:
                return picture
        self._recent = [*self._recent[-1:], (image, smoothed(image))]
        return self._recent[-1][1]


class Evidence(NamedTuple):
    """Smoothed pictures of a frame, and the thresholds of their peaks.

    The five cases of `kilnflight.detection.combination` are decided by them (chapter
    3.1).
    """

    gray: Single  # (rows, cols), smoothed
    before: Single  # (rows, cols), the frame before, smoothed
    threshold: float  # least prominence of a peak in `gray`, grey values
    change_threshold: float  # the same in the difference of both pictures

    @classmethod
    def of(
        cls,
        gray: Integers,
        previous: Integers,
        smooth: Callable[[Integers], Single] = smoothed,
    ) -> Self:
        """Return the evidence of a frame.

        Parameters
        ----------
        gray, previous
            (rows, cols) of the frame and of the one before.
        smooth
            Function that smooths either; a `Smoother` remembers the frame before.

        Notes
        -----
        Noise is the median absolute deviation of the smoothed difference of the two
        frames, times 1.4826: the standard deviation of a normal distribution. That of
        one frame is smaller by the square root of 2. The difference is smoothed before
        its absolute value is taken, so that noise averages out.
        """
        before = smooth(previous)
        now = smooth(gray)
        step = max(now.size // _SAMPLES, 1) | 1  # odd, so that no column counts twice
        sample = now.reshape(-1)[::step] - before.reshape(-1)[::step]
        sample = sample[: (sample.size - 1) | 1]  # an odd number has one middle
        spread = float(_middle(np.abs(sample - _middle(sample))))
        threshold = PROMINENCE * max(1.4826 * spread, _ROUNDING)
        return cls(
            gray=now,
            before=before,
            threshold=threshold / np.sqrt(2.0),
            change_threshold=threshold,
        )

    def peaks(self, area: Integers) -> Array:
        """Return the peaks (k, 3) of ``gray`` in an area (4,), as `find_peaks` does.

        Peaks below `SHARE` of the largest prominence are left out.
        """
        peaks = find_peaks(self.gray, area, self.threshold)
        return peaks[peaks[:, 2] >= SHARE * peaks[:, 2].max(initial=0.0)]

    def moved(self, areas: Integers) -> Flags:
        """Return whether each area (n, 4) has a peak where both frames differ.

        The peak, as of `find_peaks`, is in the absolute difference; `real` needs one.
        """
        return _moved(self.gray, self.before, areas, self.change_threshold)

    def real(self, area: Integers) -> bool:
        """Return whether an area (4,) holds a particle (cases 4 and 5 of chapter 3.1).

        It must have a peak in the difference, and a peak or a trough in ``gray``.
        """
        if not self.moved(area[None])[0]:
            return False
        part = _part(self.gray, area)
        return any(
            len(_area_peaks(sign * part, self.threshold, False)) for sign in (1, -1)
        )
