"""Local grey-value peaks in small areas of an image.

The combined detector decides its five cases by counting local peaks (thesis, chapter 3.1); the
thesis does not say what counts as one. Here a peak counts when it stands out by a given prominence
from the saddle to any higher peak. The highest peak must stand out from the median of the area's
border. A peak must lie inside the area: on the border, the highest pixel is merely the foot of
something outside.

The thesis looks for peaks or troughs on the frame and on the absolute difference to the frame
before. Here both pictures are smoothed a little, and a peak must stand out from the noise. The
noise is measured on the frame itself, so nothing depends on the exposure.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba
import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_positive, check_shape

Float32 = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
NEAR_PX = 48  # distance to which a higher pixel is searched before the area is sorted
LARGEST_AREA_PX = 250_000  # a larger area is no particle
SMOOTHING_PX = 1.0  # standard deviation of the Gaussian; smaller than any visible particle
SAMPLES = 140_000  # pixels that measure the noise, to 0.3 % of it
LEAST_NOISE = 0.5  # grey values; rounding to whole ones leaves so much
NO, UNSURE, SURE = 0, 1, 2  # whether a peak is there, judged from around its pixel


def find_peaks(
    image: npt.NDArray[np.generic], area: npt.NDArray[np.integer], prominence: float
) -> npt.NDArray[np.float64]:
    """Return the peaks (k, 3) in a rectangle, the highest first.

    Columns are row, column and prominence.

    Parameters
    ----------
    image
        (rows, cols), smoothed against noise by the caller; made float32.
    area
        (4,) first row, row after the last, first column, column after the last; clipped to
        the image.
    prominence
        By how many grey values a peak must stand out; above 0.

    Notes
    -----
    An area without inner pixels, flat, or above `LARGEST_AREA_PX` has no peak. Among equal
    pixels the first in row order counts as the higher one.
    """
    picture, boxes = _checked(image, np.asarray(area)[None], prominence)
    return np.asarray(_area_peaks(picture, boxes[0], prominence))


def have_peaks(
    image: npt.NDArray[np.generic], areas: npt.NDArray[np.integer], prominence: float
) -> npt.NDArray[np.bool_]:
    """Return whether each of several areas (n, 4) holds a peak.

    Arguments are those of `find_peaks`.
    """
    return np.asarray(_any_peaks(*_checked(image, areas, prominence), prominence))


def _checked(
    image: npt.NDArray[np.generic], areas: npt.NDArray[np.integer], prominence: float
) -> tuple[Float32, Index]:
    check_positive(prominence, "find_peaks: prominence")
    picture = np.ascontiguousarray(image, dtype=np.float32)
    if picture.ndim != 2:
        raise InputError(f"find_peaks: the image has {picture.ndim} axes, expected rows, cols.")
    boxes = np.ascontiguousarray(areas, dtype=np.int64)
    check_shape(boxes, (None, 4), "find_peaks: areas")
    return picture, boxes


@numba.njit(cache=True)
def _clipped(image: Float32, box: Index) -> tuple[Float32, int, int]:
    """Return a box of the image with its first row and column.

    The box is empty if it can hold no peak.
    """
    top, left = max(box[0], 0), max(box[2], 0)
    area = image[top : max(box[1], 0), left : max(box[3], 0)]
    if min(area.shape) < 3 or area.size > LARGEST_AREA_PX:
        area = area[:0]
    return area, top, left


@numba.njit(cache=True)
def _area_peaks(image: Float32, box: Index, prominence: float) -> npt.NDArray[np.float64]:
    """Return the peaks (k, 3) of one area.

    Pixels emerge from high to low, as water falls, and join their neighbours.
    """
    area, top, left = _clipped(image, box)
    height, width = area.shape
    value = area.copy().reshape(-1)
    if not area.size or value.max() - min(value.min(), _border_median(area)) < prominence:
        return np.empty((0, 3))  # nothing can stand out so far
    order = np.argsort(-value, kind="mergesort")
    parent = np.full(area.size, -1)  # -1: still under water
    summit, height_above = np.arange(area.size), np.zeros(area.size)
    for pixel in order:
        row, col = pixel // width, pixel % width
        parent[pixel] = pixel
        for i in range(max(row - 1, 0), min(row + 2, height)):
            for j in range(max(col - 1, 0), min(col + 2, width)):
                if parent[i * width + j] < 0:
                    continue
                first, second = _root(parent, pixel), _root(parent, i * width + j)
                if first == second:
                    continue
                low, high = summit[first], summit[second]
                if value[low] > value[high] or (value[low] == value[high] and low < high):
                    low, high = high, low
                height_above[low] = value[low] - value[pixel]
                parent[first] = second
                summit[second] = high
    height_above[order[0]] = value[order[0]] - _border_median(area)
    relief = height_above.reshape(height, width)
    relief[0], relief[-1], relief[:, 0], relief[:, -1] = 0.0, 0.0, 0.0, 0.0  # feet, no peaks
    kept = order[height_above[order] >= prominence]
    peaks = np.empty((len(kept), 3))
    peaks[:, 0], peaks[:, 1] = top + kept // width, left + kept % width
    peaks[:, 2] = height_above[kept]
    return peaks


@numba.njit(cache=True)
def _any_peaks(image: Float32, boxes: Index, prominence: float) -> npt.NDArray[np.bool_]:
    """Return whether each area has a peak."""
    peaks = np.zeros(len(boxes), np.bool_)
    for k in range(len(boxes)):
        answer = _has_peak(_clipped(image, boxes[k])[0], prominence)
        peaks[k] = answer == SURE
        if answer == UNSURE:
            peaks[k] = len(_area_peaks(image, boxes[k], prominence)) > 0
    return peaks


@numba.njit(cache=True)
def _has_peak(area: Float32, prominence: float) -> int:
    """Return whether an area has a peak: `SURE`, `UNSURE` or `NO`.

    The pixels are not sorted, which saves time.
    """
    if not area.size:
        return NO
    least, highest = _extremes(area)
    most, border = highest.max(), _border_median(area)
    if most - min(least, border) < prominence:
        return NO
    single = np.sum(area == most) == 1
    low_summit = most - border < prominence and single
    answer = NO
    visited, stack = np.zeros(area.shape, np.int64), np.empty((area.size, 2), np.int64)
    for row in range(1, area.shape[0] - 1):
        if highest[row] - least < prominence:
            continue
        for col in range(1, area.shape[1] - 1):
            value = area[row, col]
            if value - least < prominence or (low_summit and value == most):
                continue
            if value < area[row, col - 1] or value < area[row, col + 1]:
                continue
            if value < most:
                answer = max(answer, _stands_out(area, (row, col), prominence, visited, stack))
            else:  # the highest must stand out from the border; of equal ones the first
                answer = max(answer, SURE if single else UNSURE)
            if answer == SURE:
                return SURE
    return answer


@numba.njit(cache=True, fastmath={"nnan", "nsz"})  # several pixels at a time; none is NaN
def _extremes(area: Float32) -> tuple[float, Float32]:
    """Return the lowest value of all, and the highest of each row."""
    least, highest = area[0, 0], area[:, 0].copy()
    for row in range(area.shape[0]):
        line, low, high = area[row], area[row, 0], area[row, 0]
        for col in range(area.shape[1]):
            low, high = min(low, line[col]), max(high, line[col])
        least, highest[row] = min(least, low), high
    return least, highest


@numba.njit(cache=True)
def _stands_out(
    area: Float32, place: tuple[int, int], prominence: float, visited: Index, stack: Index
) -> int:
    """Return whether a pixel is a peak: `SURE`, `UNSURE` or `NO`.

    From a peak no higher pixel can be reached without a descent by the prominence. Whether the
    first of several equal pixels lies inside the border stays open. ``visited`` (as the area)
    holds for which pixel each was visited last; ``stack`` has room for all.
    """
    row, col = place
    value, mark = area[row, col], row * area.shape[1] + col
    stack[0], count, answer = place, 1, SURE
    visited[row, col] = mark
    while count:
        count -= 1
        at_row, at_col = stack[count]
        for i in range(max(at_row - 1, 0), min(at_row + 2, area.shape[0])):
            for j in range(max(at_col - 1, 0), min(at_col + 2, area.shape[1])):
                if area[i, j] > value:
                    return NO
                if visited[i, j] == mark or value - area[i, j] >= prominence:
                    continue
                if max(abs(i - row), abs(j - col)) > NEAR_PX:
                    return UNSURE
                if area[i, j] == value:
                    answer = UNSURE
                visited[i, j] = mark
                stack[count] = (i, j)
                count += 1
    return answer


@numba.njit(cache=True)
def _border_median(area: Float32) -> float:
    """Return the median of the outermost pixels."""
    sides = np.concatenate((area[0], area[-1], area[1:-1, 0], area[1:-1, -1]))
    return float(np.median(sides))


@numba.njit(cache=True)
def _root(parent: Index, pixel: int) -> int:
    while parent[pixel] != pixel:
        parent[pixel] = parent[parent[pixel]]
        pixel = parent[pixel]
    return pixel


@dataclass(frozen=True)
class Evidence:
    """Smoothed pictures of a frame, and the thresholds of their peaks."""

    gray: Float32  # (rows, cols), smoothed
    change: Float32  # (rows, cols), absolute difference to the frame before, smoothed
    threshold: float  # grey values by which a peak stands out in `gray`
    change_threshold: float  # and in `change`
    share: float  # of the highest peak, for the second

    @classmethod
    def of(
        cls,
        gray: npt.NDArray[np.generic],
        previous: npt.NDArray[np.generic],
        prominence: float,
        share: float,
    ) -> Evidence:
        """Return the evidence of a frame.

        Parameters
        ----------
        gray, previous
            (rows, cols) of the frame and of the one before.
        prominence
            By how many times the noise a peak must stand out.
        share
            By which share of the highest peak of an area a second one must stand out.

        Notes
        -----
        Noise is the median absolute deviation of the smoothed difference of the two frames,
        times 1.4826. That of one frame is smaller by the square root of 2. The difference is
        smoothed before its absolute value is taken, so that noise averages out.
        """
        if gray.shape != previous.shape:
            raise InputError(
                f"frame of {gray.shape} after one of {previous.shape}: all frames of a "
                "recording have one size."
            )
        now, before = _smoothed(gray), _smoothed(previous)
        frames = ((previous, before), (gray, now))
        _recent[:] = [each for each in frames if not each[0].flags.writeable]
        flat = slice(None, None, max(now.size // SAMPLES, 1) | 1)  # odd: no column twice
        sample = now.reshape(-1)[flat] - before.reshape(-1)[flat]
        spread = float(np.median(np.abs(sample - np.median(sample))))
        threshold = prominence * max(1.4826 * spread, LEAST_NOISE)
        change = np.asarray(cv2.absdiff(now, before), np.float32)
        return cls(now, change, threshold / np.sqrt(2.0), threshold, share)

    def peaks(self, area: npt.NDArray[np.integer]) -> npt.NDArray[np.float64]:
        """Return the peaks (k, 3) of an area (4,), the highest first."""
        peaks = find_peaks(self.gray, area, self.threshold)
        return peaks[peaks[:, 2] >= self.share * peaks[:, 2].max(initial=0.0)]

    def moved(self, areas: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
        """Return whether each area (n, 4) has changed.

        Only a changed area can be `real`.
        """
        return have_peaks(self.change, areas, self.change_threshold)

    def real(self, area: npt.NDArray[np.integer]) -> bool:
        """Return whether an area (4,) has changed and has a peak or trough."""
        if not self.moved(area[None]).any():
            return False
        top, bottom, left, right = np.maximum(area, 0).tolist()
        part = self.gray[top:bottom, left:right]
        whole = np.array([0, part.shape[0], 0, part.shape[1]])
        return any(len(find_peaks(sign * part, whole, self.threshold)) for sign in (1, -1))


_recent: list[tuple[npt.NDArray[np.generic], Float32]] = []  # frames with their blurred pictures


def _smoothed(image: npt.NDArray[np.generic]) -> Float32:
    """Return a frame blurred by a Gaussian of `SMOOTHING_PX`; do not write into it.

    The Gaussian is cut at four standard deviations. A frame is needed twice, as the present one
    and as the previous one, so the last two are kept. Only read-only frames are: others may have
    changed in place.
    """
    for frame, blurred in _recent:
        if frame is image:
            return blurred
    picture, side = image.astype(np.float32), 2 * round(4 * SMOOTHING_PX) + 1
    cv2.GaussianBlur(picture, (side, side), SMOOTHING_PX, dst=picture)
    return picture
