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


def mirrored(image: Image, width: int) -> Image:
    """Return the image continued by ``width`` px on all sides, mirrored at the border."""
    rows, cols = (np.pad(np.arange(n), width, mode="reflect") for n in image.shape)
    wide = np.empty((len(rows), len(cols)), dtype=np.float32)
    wide[width:-width, width:-width] = image
    wide[width:-width, :width] = image[:, cols[:width]]
    wide[width:-width, -width:] = image[:, cols[-width:]]
    wide[:width] = wide[rows[:width] + width]
    wide[-width:] = wide[rows[-width:] + width]
    return wide


@njit(cache=True)
def _pass(source: Any, begin: int, stride: int, taps: Any, target: Any) -> None:
    """Blur a flat array along neighbours ``stride`` apart, from ``begin`` on.

    The sum is the same for every pixel, in the same order, wherever the array begins.
    Three taps at a time, because reading and writing the sum costs more than adding to it.
    """
    end = begin + len(target)
    centre, weight = source[begin:end], taps[0]
    for x in range(len(target)):
        target[x] = weight * centre[x]
    full = 1 + 3 * ((len(taps) - 1) // 3)
    for j in range(1, full, 3):
        one, two, three = j * stride, (j + 1) * stride, (j + 2) * stride
        a, b, u = source[begin - one : end - one], source[begin + one : end + one], taps[j]
        c, d, v = source[begin - two : end - two], source[begin + two : end + two], taps[j + 1]
        e, f, w = (
            source[begin - three : end - three],
            source[begin + three : end + three],
            taps[j + 2],
        )
        for x in range(len(target)):
            target[x] += u * (a[x] + b[x]) + v * (c[x] + d[x]) + w * (e[x] + f[x])
    for j in range(full, len(taps)):
        a, b = (
            source[begin - j * stride : end - j * stride],
            source[begin + j * stride : end + j * stride],
        )
        weight = taps[j]
        for x in range(len(target)):
            target[x] += weight * (a[x] + b[x])


@njit(cache=True)
def _smooth(wide: Any, taps: Any, step: int) -> Any:
    """Return the blur of a mirrored image at every ``step``-th pixel."""
    radius, stride = len(taps) - 1, wide.shape[1]
    height, width = wide.shape[0] - 2 * radius, stride - 2 * radius
    flat = wide.ravel()
    column, line = np.empty(stride, dtype=np.float32), np.empty(width, dtype=np.float32)
    out = np.empty(((height + step - 1) // step, (width + step - 1) // step), dtype=np.float32)
    for row in range(0, height, step):
        _pass(flat, (row + radius) * stride, stride, taps, column)
        _pass(column, radius, 1, taps, line)
        target = out[row // step]
        for x in range(len(target)):  # a slice assigned is slow to compile
            target[x] = line[step * x]
    return out


def smooth(image: Image, sigma: float, step: int = 1) -> Image:
    """Return the image blurred by a Gaussian (Eq. 2.21), at every ``step``-th pixel."""
    taps = gaussian_taps(sigma)
    if len(taps) == 1:
        return image[::step, ::step]
    return np.asarray(_smooth(mirrored(image, len(taps) - 1), taps, step))


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
    return np.asarray(_smooth(mirrored(image, len(taps) - 1), taps, 1))


@njit(cache=True)
def _inward(i: int, length: int) -> int:
    """Return the sample that stands for one beyond the border, mirrored as often as needed."""
    if length == 1:
        return 0
    period = 2 * (length - 1)
    i %= period
    return period - i if i >= length else i


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
        _pass(flat, radius * stride, stride, taps[index], down[stride:-stride])
        along = np.empty(rows * stride, dtype=np.float32)
        _pass(down, stride, 1, taps[index], along)
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
