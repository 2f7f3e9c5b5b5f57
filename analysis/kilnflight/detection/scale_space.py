"""The Gaussian scale space in which `kilnflight.detection.dog` looks for particles.

Every blur is one separable sum over a sampled Gaussian, cut at four standard deviations
and normalised; beyond the border the image is mirrored about its outermost pixels.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

Image = npt.NDArray[np.float32]
Taps = tuple[Image, ...]
Box = tuple[int, int, int, int]

REACH = 4.0  # standard deviations after which a Gaussian is cut; what is cut weighs 6e-5
BLOCK = 8  # side in px of the blocks whose range is kept


def gaussian_taps(sigma: float) -> Image:
    """Return the centre and right half of a normalised Gaussian (Eq. 2.22, one axis).

    Parameters
    ----------
    sigma
        Standard deviation in px; 0 gives the kernel that changes nothing.
    """
    offset = np.arange(int(np.ceil(REACH * sigma)) + 1)
    weight = np.exp(-0.5 * (offset / max(sigma, 1e-9)) ** 2)
    return np.asarray(weight / (2 * weight.sum() - weight[0]), dtype=np.float32)


def reach_and_mass(narrow: Image, wide: Image) -> tuple[int, float]:
    """Return radius and sum of the positive weights of the 2D difference narrow - wide.

    The weights sum to zero, so the answer to an image is at most the mass times (the
    largest value within the radius - the smallest value under the kernel).
    """
    return _reach_and_mass(narrow.tobytes(), wide.tobytes())


@lru_cache(maxsize=64)
def _reach_and_mass(some: bytes, more: bytes) -> tuple[int, float]:
    """Work `reach_and_mass` out, once for each pair: a sweep asks for the same few."""
    narrow, wide = np.frombuffer(some, np.float32), np.frombuffer(more, np.float32)
    size = len(wide) - 1
    inner = np.pad(np.concatenate([narrow[:0:-1], narrow]), len(wide) - len(narrow))
    outer = np.concatenate([wide[:0:-1], wide])
    weight = np.multiply.outer(inner, inner) - np.multiply.outer(outer, outer)
    radius = int(np.abs(np.argwhere(weight > 0) - size).max(initial=0))
    return radius, float(weight[weight > 0].sum(dtype=np.float64))


@njit(cache=True)
def _inward(i: int, length: int) -> int:
    """Return the sample that stands for one beyond the border, mirrored as often as needed."""
    if length == 1:
        return 0
    period = 2 * (length - 1)
    i %= period
    return period - i if i >= length else i


@njit(cache=True)
def _neighbours(begin: int, stride: int, taps: Any) -> Any:
    """Return where a line's neighbours begin, ``stride`` apart before it and behind it."""
    low, high = np.empty(len(taps), np.int64), np.empty(len(taps), np.int64)
    for j in range(len(taps)):
        low[j], high[j] = begin - j * stride, begin + j * stride
    return low, high


@njit(cache=True)
def _pass(source: Any, low: Any, high: Any, taps: Any, target: Any) -> None:
    """Blur a line of a flat array with its neighbours, which begin at ``low`` and ``high``.

    The sum is the same for every pixel, in the same order, wherever the line begins.
    Three taps at a time, because reading and writing the sum costs more than adding to it.
    """
    size = len(target)
    centre, weight = source[low[0] : low[0] + size], taps[0]
    for x in range(size):
        target[x] = weight * centre[x]
    full = 1 + 3 * ((len(taps) - 1) // 3)
    for j in range(1, full, 3):
        a, b, u = source[low[j] : low[j] + size], source[high[j] : high[j] + size], taps[j]
        k = j + 1
        c, d, v = source[low[k] : low[k] + size], source[high[k] : high[k] + size], taps[k]
        k = j + 2
        e, f, w = source[low[k] : low[k] + size], source[high[k] : high[k] + size], taps[k]
        for x in range(size):
            target[x] += u * (a[x] + b[x]) + v * (c[x] + d[x]) + w * (e[x] + f[x])
    for j in range(full, len(taps)):
        a, b, u = source[low[j] : low[j] + size], source[high[j] : high[j] + size], taps[j]
        for x in range(size):
            target[x] += u * (a[x] + b[x])


@njit(cache=True)
def _smooth(image: Any, taps: Any, step: int) -> Any:
    """Return the blur of an image at every ``step``-th pixel."""
    radius, (rows, cols) = len(taps) - 1, image.shape
    flat = image.ravel()
    column, line = np.empty(cols + 2 * radius, np.float32), np.empty(cols, np.float32)
    inner = column[radius : radius + cols]
    low, high = _neighbours(0, 1, taps)
    left, right = _neighbours(radius, 1, taps)
    out = np.empty(((rows + step - 1) // step, (cols + step - 1) // step), dtype=np.float32)
    for row in range(0, rows, step):
        for j in range(radius + 1):
            low[j], high[j] = _inward(row - j, rows) * cols, _inward(row + j, rows) * cols
        _pass(flat, low, high, taps, inner)
        for x in range(1, radius + 1):
            column[radius - x] = inner[_inward(-x, cols)]
            column[radius + cols - 1 + x] = inner[_inward(cols - 1 + x, cols)]
        _pass(column, left, right, taps, line)
        target = out[row // step]
        for x in range(len(target)):  # a slice assigned is slow to compile
            target[x] = line[step * x]
    return out


def smooth(image: Image, sigma: float, step: int = 1) -> Image:
    """Return the image blurred by a Gaussian (Eq. 2.21), at every ``step``-th pixel."""
    taps = gaussian_taps(sigma)
    if len(taps) == 1:
        return image[::step, ::step]
    return np.asarray(_smooth(np.ascontiguousarray(image), taps, step))


@njit(cache=True)
def doubled(image: Any) -> Any:
    """Return the image with a linearly interpolated sample between any two (Lowe, 3.3)."""
    rows, cols = image.shape
    out = np.empty((2 * rows - 1, 2 * cols - 1), dtype=np.float32)
    half = np.float32(0.5)
    for row in range(rows):
        line, fine = image[row], out[2 * row]
        for x in range(cols - 1):
            fine[2 * x] = line[x]
            fine[2 * x + 1] = half * (line[x] + line[x + 1])
        fine[2 * cols - 2] = line[cols - 1]
        if row > 0:
            above, between = out[2 * row - 2], out[2 * row - 1]
            for x in range(len(fine)):
                between[x] = half * (above[x] + fine[x])
    return out


def smooth_doubled(image: Image, sigma: float) -> Image:
    """Return every second pixel of `smooth` of the `doubled` image, without making that.

    Interpolation, blur and omission are together one blur of the original: a sample of
    the doubled image is an original one or the mean of two.
    """
    fine = np.pad(gaussian_taps(sigma), (0, 3))
    fine = np.concatenate([fine[1:2], fine])
    taps = fine[1:-1:2] + (fine[:-2:2] + fine[2::2]) / 2
    return np.asarray(_smooth(np.ascontiguousarray(image), taps, 1))


@njit(cache=True)
def _patch(image: Any, top: int, bottom: int, left: int, right: int) -> Any:
    """Return rows and columns of an image one after the other, mirrored beyond its border."""
    rows, cols = image.shape
    out = np.empty((bottom - top) * (right - left), dtype=np.float32)
    inner, end = max(left, 0), min(right, cols)
    for i in range(top, bottom):
        line = image[_inward(i, rows)]
        begin = (i - top) * (right - left) - left
        target, source = out[begin + inner : begin + end], line[inner:end]
        for x in range(len(target)):
            target[x] = source[x]
        for j in range(left, inner):
            out[begin + j] = line[_inward(j, cols)]
        for j in range(end, right):
            out[begin + j] = line[_inward(j, cols)]
    return out


@njit(cache=True)
def differences(image: Any, box: Box, taps: Any) -> Any:
    """Return the differences of neighbouring Gaussians in a box of the image.

    Parameters
    ----------
    image
        (rows, cols), at least 2 px wide and high.
    box
        First row, end row, first column, end column.
    taps
        One kernel per Gaussian, from narrow to wide, all relative to the image.

    Returns
    -------
    ndarray
        (Gaussians - 1, rows, columns): narrow minus wide, so bright blobs are positive.
    """
    top, bottom, left, right = box
    rows, cols = bottom - top, right - left
    out = np.empty((len(taps) - 1, rows, cols), dtype=np.float32)
    for index in range(len(taps)):
        radius = len(taps[index]) - 1
        stride = cols + 2 * radius
        flat = _patch(image, top - radius, bottom + radius, left - radius, right + radius)
        # The ends of the lines are blurred across, too; they are cut off below.
        down = np.empty((rows + 2) * stride, dtype=np.float32)
        low, high = _neighbours(radius * stride, stride, taps[index])
        _pass(flat, low, high, taps[index], down[stride:-stride])
        along = np.empty(rows * stride, dtype=np.float32)
        low, high = _neighbours(stride, 1, taps[index])
        _pass(down, low, high, taps[index], along)
        blurred = along.reshape(rows, stride)[:, radius : radius + cols]
        for row in range(rows):
            line = blurred[row]
            if index > 0:
                narrower = out[index - 1, row]
                for x in range(cols):
                    narrower[x] -= line[x]
            if index < len(taps) - 1:
                target = out[index, row]
                for x in range(cols):
                    target[x] = line[x]
    return out


@njit(cache=True)
def _block_ranges(image: Any, block: int) -> Any:
    """Return smallest and largest value of each block."""
    rows, cols = image.shape
    shape = (2, (rows + block - 1) // block, (cols + block - 1) // block)
    out = np.empty(shape, dtype=np.float32)
    low, high = np.empty(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    for i in range(shape[1]):
        low[:] = image[i * block]
        high[:] = image[i * block]
        for row in range(i * block + 1, min(rows, (i + 1) * block)):
            line = image[row]
            for x in range(cols):
                low[x] = min(low[x], line[x])
                high[x] = max(high[x], line[x])
        for j in range(shape[2]):
            least, most = low[j * block], high[j * block]
            for x in range(j * block + 1, min(cols, (j + 1) * block)):
                least, most = min(least, low[x]), max(most, high[x])
            out[0, i, j], out[1, i, j] = least, most
    return out


def reachable(
    image: Image, taps: Taps, level: float, signs: tuple[float, ...]
) -> npt.NDArray[np.bool_]:
    """Return the blocks in which an inner difference of Gaussians can reach ``level``.

    A bound, never an estimate: in a block left out, no sample of the inner differences
    (those with a neighbour on both sides), times any of ``signs``, is as large as ``level``.
    """
    low, high = _block_ranges(image, BLOCK)
    # A sum of products of float32 is off by less than this; the bound must not be.
    rounding = 1e-5 * max(abs(float(low.min())), abs(float(high.max())))
    live = np.zeros(low.shape, dtype=np.bool_)
    for narrow, wide in pairwise(taps[1:-1]):
        radius, mass = reach_and_mass(narrow, wide)
        near, far = (np.ones(2 * [2 * -(-r // BLOCK) + 1]) for r in (radius, len(wide) - 1))
        if 1.0 in signs:
            live |= (cv2.dilate(high, near) - cv2.erode(low, far)) * mass + rounding >= level
        if -1.0 in signs:
            live |= (cv2.dilate(high, far) - cv2.erode(low, near)) * mass + rounding >= level
    return live
