"""Local grey-value peaks in small areas of an image, by how far they stand out.

The combined detector decides its five cases by counting local peaks (thesis, chapter 3.1);
the thesis does not say what counts as one. Here a peak counts when it stands out from the
saddle to any higher peak (or, the highest one, from the median of the area's border) by at
least a given prominence, and when it lies inside the area and not on its border, where the
highest pixel is merely the foot of something outside.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_positive, check_shape

Float32 = npt.NDArray[np.float32]
Index = npt.NDArray[np.int64]
NEAR_PX = 12  # how far a higher pixel is looked for before the whole area is sorted
LARGEST_AREA_PX = 250_000  # a larger area is no particle


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
    needed = np.broadcast_to(np.asarray(prominence, dtype=np.float64), len(boxes))
    return picture, boxes, np.ascontiguousarray(needed)


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
        if _may_have_peaks(image, boxes[k], needed[k]):
            found[k] = len(_area_peaks(image, boxes[k], needed[k])) > 0
    return found


@numba.njit(cache=True)
def _may_have_peaks(image: Float32, box: Index, prominence: float) -> bool:
    """Tell whether some inner pixel may stand out so far; a fast bound, never too low."""
    top, bottom = max(box[0], 0), min(box[1], image.shape[0])
    left, right = max(box[2], 0), min(box[3], image.shape[1])
    if bottom - top < 3 or right - left < 3:
        return False
    area = image[top:bottom, left:right]
    least, most = area[0, 0], area[0, 0]
    for row in range(bottom - top):
        line = area[row]
        for col in range(right - left):
            least, most = min(least, line[col]), max(most, line[col])
    around = _around(area)
    if most - min(least, around) < prominence:
        return False
    low_summit = most - around < prominence and np.sum(area == most) == 1
    for row in range(1, bottom - top - 1):
        for col in range(1, right - left - 1):
            value = area[row, col]
            if value - least < prominence or (low_summit and value == most):
                continue
            if value < area[row, col - 1] or value < area[row, col + 1]:
                continue
            if _may_stand_out(area, row, col, prominence):
                return True
    return False


@numba.njit(cache=True)
def _may_stand_out(area: Float32, row: int, col: int, prominence: float) -> bool:
    """Tell whether no higher pixel is near without a descent by the prominence."""
    value, side = area[row, col], 2 * NEAR_PX + 1
    seen = np.zeros((side, side), np.bool_)
    stack = np.empty((side * side, 2), np.int64)
    stack[0], count = (row, col), 1
    seen[NEAR_PX, NEAR_PX] = True
    while count:
        count -= 1
        at_row, at_col = stack[count]
        for i in range(max(at_row - 1, 0), min(at_row + 2, area.shape[0])):
            for j in range(max(at_col - 1, 0), min(at_col + 2, area.shape[1])):
                if area[i, j] > value:
                    return False
                down, across = i - row + NEAR_PX, j - col + NEAR_PX
                if not (0 <= down < side and 0 <= across < side):
                    return True  # too wide to tell
                if not seen[down, across] and value - area[i, j] < prominence:
                    seen[down, across] = True
                    stack[count] = (i, j)
                    count += 1
    return True


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
