"""Local grey-value peaks in small areas of an image, by how far they stand out.

The combined detector decides its five cases by counting local peaks (thesis, chapter 3.1);
the thesis does not say what counts as one. Here a peak counts when it stands out from the
saddle to any higher peak (or, the highest one, from the median of the area's border) by at
least a given prominence, and when it lies inside the area and not on its border, where the
highest pixel is merely the foot of something outside.

The thesis looks for peaks or troughs on the frame and on the absolute difference to the frame
before. Here both pictures are smoothed a little and a peak must stand out from the noise, which
is measured on the frame itself; so nothing depends on the exposure.
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
NEAR_PX = 48  # how far a higher pixel is looked for before the whole area is sorted
LARGEST_AREA_PX = 250_000  # a larger area is no particle
SMOOTHING_PX = 1.0  # standard deviation of the Gaussian; smaller than any visible particle
SAMPLES = 140_000  # pixels that measure the noise, to 0.3 % of it
LEAST_NOISE = 0.5  # grey values; rounding to whole ones leaves so much
NO, UNSURE, SURE = 0, 1, 2  # whether a peak is there, as far as a look around its pixel says


def find_peaks(
    image: npt.NDArray[np.generic], areas: npt.NDArray[np.integer], prominence: npt.ArrayLike
) -> tuple[Index, npt.NDArray[np.float64]]:
    """Return the peaks inside each rectangular area.

    Parameters
    ----------
    image
        (rows, cols), smoothed against noise by the caller; made float32.
    areas
        (n, 4) first row, row after the last, first column, column after the last; clipped
        to the image.
    prominence
        By how many grey values a peak must stand out; above 0, one number or one per area.

    Returns
    -------
    area : (m,) int64
        To which area each peak belongs, ascending; within an area the highest peak first.
    place : (m, 3) float64
        Row, column and prominence.

    Notes
    -----
    An area without inner pixels, flat, or above `LARGEST_AREA_PX` has no peak. Among equal
    pixels the first in row order counts as the higher one.
    """
    picture, boxes, needed = _checked(image, areas, prominence)
    found = [_area_peaks(picture, box, need) for box, need in zip(boxes, needed, strict=True)]
    counts = [len(one) for one in found]
    place = np.concatenate([np.empty((0, 3)), *found])
    return np.repeat(np.arange(len(boxes)), counts), place


def have_peaks(
    image: npt.NDArray[np.generic], areas: npt.NDArray[np.integer], prominence: npt.ArrayLike
) -> npt.NDArray[np.bool_]:
    """Return which areas (n,) hold a peak at all; arguments as `find_peaks`."""
    return _any_peaks(*_checked(image, areas, prominence))


def _checked(
    image: npt.NDArray[np.generic], areas: npt.NDArray[np.integer], prominence: npt.ArrayLike
) -> tuple[Float32, Index, npt.NDArray[np.float64]]:
    check_positive(float(np.min(prominence, initial=1.0)), "find_peaks: prominence")
    picture = np.ascontiguousarray(image, dtype=np.float32)
    if picture.ndim != 2:
        raise InputError(f"find_peaks: the image has {picture.ndim} axes, expected rows, cols.")
    boxes = np.ascontiguousarray(areas, dtype=np.int64)
    check_shape(boxes, (None, 4), "find_peaks: areas")
    needed = np.full(len(boxes), prominence, dtype=np.float64)
    return picture, boxes, needed


@numba.njit(cache=True)
def _area_peaks(image: Float32, box: Index, prominence: float) -> npt.NDArray[np.float64]:
    """Return (k, 3) peaks of one area: pixels from high to low, joined as water falls."""
    top, bottom = max(box[0], 0), min(box[1], image.shape[0])
    left, right = max(box[2], 0), min(box[3], image.shape[1])
    height, width = bottom - top, right - left
    if height < 3 or width < 3 or height * width > LARGEST_AREA_PX:
        return np.empty((0, 3))
    area = image[top:bottom, left:right].copy()
    value = area.reshape(-1)
    around = _around(area)
    if value.max() - min(value.min(), around) < prominence:  # nothing can stand out so far
        return np.empty((0, 3))
    order = np.argsort(-value, kind="mergesort")
    parent = np.full(height * width, -1)  # -1: still under water
    summit = np.arange(height * width)
    stands_out = np.zeros(height * width)
    for pixel in order:
        row, column = pixel // width, pixel % width
        parent[pixel] = pixel
        for down in range(-1, 2):
            for across in range(-1, 2):
                near_row, near_column = row + down, column + across
                if not (0 <= near_row < height and 0 <= near_column < width):
                    continue
                near = near_row * width + near_column
                if near == pixel or parent[near] < 0:
                    continue
                one, other = _root(parent, pixel), _root(parent, near)
                if one == other:
                    continue
                low, high = summit[one], summit[other]
                if value[low] > value[high] or (value[low] == value[high] and low < high):
                    low, high = high, low
                stands_out[low] = value[low] - value[pixel]
                parent[one] = other
                summit[other] = high
    highest = order[0]
    stands_out[highest] = value[highest] - around
    return _kept(stands_out, order, width, height, top, left, prominence)


@numba.njit(cache=True)
def _any_peaks(
    image: Float32, boxes: Index, needed: npt.NDArray[np.float64]
) -> npt.NDArray[np.bool_]:
    """Return whether each area has a peak."""
    found = np.zeros(len(boxes), np.bool_)
    for k in range(len(boxes)):
        answer = _looked_for(image, boxes[k], needed[k])
        found[k] = answer == SURE
        if answer == UNSURE:
            found[k] = len(_area_peaks(image, boxes[k], needed[k])) > 0
    return found


@numba.njit(cache=True)
def _looked_for(image: Float32, box: Index, prominence: float) -> int:
    """Tell whether some inner pixel stands out so far, without sorting the area."""
    top, bottom = max(box[0], 0), min(box[1], image.shape[0])
    left, right = max(box[2], 0), min(box[3], image.shape[1])
    if bottom - top < 3 or right - left < 3 or (bottom - top) * (right - left) > LARGEST_AREA_PX:
        return NO
    area = image[top:bottom, left:right]
    least, highest = _extremes(area)
    most = highest.max()
    around = _around(area)
    if most - min(least, around) < prominence:
        return NO
    single = np.sum(area == most) == 1
    low_summit = most - around < prominence and single
    answer = NO
    seen, stack = np.zeros(area.shape, np.int64), np.empty((area.size, 2), np.int64)
    for row in range(1, bottom - top - 1):
        if highest[row] - least < prominence:
            continue
        for col in range(1, right - left - 1):
            value = area[row, col]
            if value - least < prominence or (low_summit and value == most):
                continue
            if value < area[row, col - 1] or value < area[row, col + 1]:
                continue
            if value < most:
                answer = max(answer, _stands_out(area, (row, col), prominence, seen, stack))
            else:  # the highest must stand out from the border; of equal ones the first
                answer = max(answer, SURE if single else UNSURE)
            if answer == SURE:
                return SURE
    return answer


@numba.njit(cache=True, fastmath={"nnan", "nsz"})  # several pixels at a time; none is NaN
def _extremes(area: Float32) -> tuple[float, Float32]:
    """Return the lowest value and the highest of each row."""
    least, highest = area[0, 0], area[:, 0].copy()
    for row in range(area.shape[0]):
        line, low, high = area[row], area[row, 0], area[row, 0]
        for col in range(area.shape[1]):
            low, high = min(low, line[col]), max(high, line[col])
        least, highest[row] = min(least, low), high
    return least, highest


@numba.njit(cache=True)
def _stands_out(
    area: Float32, place: tuple[int, int], prominence: float, seen: Index, stack: Index
) -> int:
    """Tell whether no higher pixel can be reached without a descent by the prominence.

    Whether of several equal ones the first lies inside the border is not looked at.
    ``seen`` (as the area) marks what was visited for which pixel, ``stack`` has room for all.
    """
    row, col = place
    value, mark = area[row, col], row * area.shape[1] + col
    stack[0], count, answer = place, 1, SURE
    seen[row, col] = mark
    while count:
        count -= 1
        at_row, at_col = stack[count]
        for i in range(max(at_row - 1, 0), min(at_row + 2, area.shape[0])):
            for j in range(max(at_col - 1, 0), min(at_col + 2, area.shape[1])):
                if area[i, j] > value:
                    return NO
                if seen[i, j] == mark or value - area[i, j] >= prominence:
                    continue
                if max(abs(i - row), abs(j - col)) > NEAR_PX:
                    return UNSURE
                if area[i, j] == value:
                    answer = UNSURE
                seen[i, j] = mark
                stack[count] = (i, j)
                count += 1
    return answer


@numba.njit(cache=True)
def _around(area: Float32) -> float:
    """Return the median of the border."""
    sides = np.concatenate((area[0], area[-1], area[1:-1, 0], area[1:-1, -1]))
    return float(np.median(sides))


@numba.njit(cache=True)
def _root(parent: Index, pixel: int) -> int:
    while parent[pixel] != pixel:
        parent[pixel] = parent[parent[pixel]]
        pixel = parent[pixel]
    return pixel


@numba.njit(cache=True)
def _kept(
    stands_out: npt.NDArray[np.float64],
    order: Index,
    width: int,
    height: int,
    top: int,
    left: int,
    prominence: float,
) -> npt.NDArray[np.float64]:
    """Return row, column and prominence of the peaks inside the border, highest first."""
    kept = np.empty((len(order), 3))
    count = 0
    for pixel in order:
        row, column = pixel // width, pixel % width
        inner = 0 < row < height - 1 and 0 < column < width - 1
        if inner and stands_out[pixel] >= prominence:
            kept[count, 0] = top + row
            kept[count, 1] = left + column
            kept[count, 2] = stands_out[pixel]
            count += 1
    return kept[:count].copy()


@dataclass(frozen=True)
class Evidence:
    """The two pictures and what stands out in them."""

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
        times 1.4826; that of one frame is smaller by the square root of 2. The difference is
        smoothed before its absolute value is taken, so that noise averages out.
        """
        if gray.shape != previous.shape:
            raise InputError(
                f"frame of {gray.shape} after one of {previous.shape}: all frames of a "
                "recording have one size."
            )
        now, before = _smoothed(gray), _smoothed(previous)
        flat = slice(None, None, max(now.size // SAMPLES, 1) | 1)  # odd: no column twice
        some = now.reshape(-1)[flat] - before.reshape(-1)[flat]
        spread = float(np.median(np.abs(some - np.median(some))))
        noise = max(1.4826 * spread, LEAST_NOISE)
        needed = prominence * noise
        moved = np.asarray(cv2.absdiff(now, before), dtype=np.float32)
        return cls(now, moved, needed / np.sqrt(2.0), needed, share)

    def peaks(self, area: npt.NDArray[np.integer]) -> npt.NDArray[np.float64]:
        """Return the peaks (k, 3) of the frame in an area (4,), highest first."""
        _, found = find_peaks(self.gray, area[None], self.threshold)
        return found[found[:, 2] >= self.share * found[:, 2].max(initial=0.0)]

    def moved(self, areas: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
        """Return in which areas (n, 4) something has changed; nothing else can be `real`."""
        return have_peaks(self.change, areas, self.change_threshold)

    def real(self, area: npt.NDArray[np.integer]) -> bool:
        """Return whether something stands out in the frame and has changed there."""
        if not self.moved(area[None]).any():
            return False
        top, bottom, left, right = np.maximum(area, 0).tolist()
        inside = self.gray[top:bottom, left:right]
        whole = np.array([[0, inside.shape[0], 0, inside.shape[1]]])
        return any(len(find_peaks(sign * inside, whole, self.threshold)[1]) for sign in (1, -1))


def _smoothed(image: npt.NDArray[np.generic]) -> Float32:
    """Return a frame blurred by a Gaussian of `SMOOTHING_PX`, cut at four of it."""
    taps = cv2.getGaussianKernel(2 * round(4 * SMOOTHING_PX) + 1, SMOOTHING_PX, cv2.CV_32F)
    blurred = cv2.sepFilter2D(image.astype(np.float32), cv2.CV_32F, taps, taps)
    return np.asarray(blurred, dtype=np.float32)
