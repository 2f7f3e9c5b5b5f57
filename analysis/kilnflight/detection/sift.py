"""Particles as keypoints of SIFT: extrema of differences of Gaussians.

Section 2.2.3 of the thesis, which uses position and scale of a keypoint only. So the orientation
and the descriptor (Eqs 2.29 ff.) are not computed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.ndimage import find_objects, label

from kilnflight.checks import InputError, check_at_least, check_count, check_positive
from kilnflight.detection.otsu import check_foreground

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.float32]
Polygon = Sequence[tuple[float, float]]
Box = tuple[int, int, int, int]  # first row, end row, first column, end column

REACH = 4.0  # standard deviations after which a Gaussian is cut; what is cut weighs 6e-5
FITS = 3  # at how many samples, at most, the quadratic is fitted until it stays where it is
MOVE = 0.6  # offset in px from which the fit moves to the next sample
BELIEVED = 1.0  # offset in samples to which a quadratic through three of them is believed
WALK = FITS  # px around a sample at which a fit that moves may look
BLOCK = 8  # side in px of the blocks whose range bounds the differences
TILE = 16  # side in blocks of the tiles that are blurred one at a time


@dataclass(frozen=True)
class DoG:
    """Find bright blobs, the keypoints of SIFT, with position and size.

    Parameters
    ----------
    threshold
        Smallest difference of Gaussians at the interpolated maximum, in grey values
        (Eq. 2.27; "local maximum of DoG" of Tables 5.6 and 5.7).
    layers
        Scales per octave that are searched for maxima; k of Eq. 2.23 is 2^(1/layers).
    sigma
        Blur of the first scale of an octave, in px of the octave.
    edge
        Largest ratio of the curvatures across a blob, r of Eq. 2.28.
    camera_blur
        Blur that the image is taken to have, in px.

    Notes
    -----
    The difference is the narrow minus the wide Gaussian, the negative of Eq. 2.23. A bright blob
    is the "local maximum" of Tables 5.6 and 5.7. Minima, which the text also names, are gaps
    between particles in |frame - background| and are left out. The threshold applies to the
    difference itself, neither divided by the number of layers (as OpenCV does) nor scaled by the
    grey values' range. A sample below half of it is not followed, as in OpenCV.

    The thesis starts from the original image, which finds blobs with a radius from about 2.8 px.
    Lowe doubles it first: pass the image at twice its size and twice the ``camera_blur``. The
    radius is that of the uniform disc that answers most strongly at the keypoint's scale
    (`disc_radius`). For a Gaussian blob it is the square root of 2 times its standard deviation.
    The thesis does not say how it draws its circles.

    Sources: Eqs 2.21-2.28, thesis; Lowe 2004 ([66] of the thesis), sections 3 and 4, for 3
    layers, 1.6 px, camera blur 0.5 px and r = 10.
    """

    threshold: float = 500.0  # grey values; empirical value of section 5.1.2
    layers: int = 3
    sigma: float = 1.6  # px
    edge: float = 10.0
    camera_blur: float = 0.5  # px

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        check_at_least(self.threshold, 0, "DoG threshold")
        check_count(self.layers, "DoG layers")
        check_positive(self.sigma, "DoG sigma")
        check_at_least(self.edge, 1, "DoG edge, a ratio of curvatures,")
        if not 0 <= self.camera_blur <= self.sigma:
            raise InputError(
                f"DoG camera_blur: the image would have a blur of {self.camera_blur} px, the "
                f"first scale {self.sigma} px; take a camera_blur from 0 to that."
            )

    def __call__(self, foreground: npt.NDArray[np.generic], within: Polygon | None = None) -> Array:
        """Return the particles in a foreground.

        Parameters
        ----------
        foreground
            (rows, cols) grey values: integers of 8 or 16 bits, or floats; computed in float32.
        within
            Corners (row, col) of a polygon. All particles in it are found; most of those
            outside are skipped, which saves time.

        Returns
        -------
        ndarray
            (n, 3) row, col, radius in px, by octave, row and column. None in a foreground
            of one grey value. A saturated plateau is one blob with the size of the plateau.

        Raises
        ------
        InputError
            If the foreground is not 2D, not of numbers or not finite.
        """
        return self.graded(foreground, within)[:, :3]

    def graded(self, foreground: npt.NDArray[np.generic], within: Polygon | None = None) -> Array:
        """Return the particles (n, 4) with the largest threshold of each.

        At the threshold in column 3 a particle is just found: the rows not below any higher
        threshold are its particles, to the bit. Arguments are those of a call.
        """
        image = check_foreground(foreground, "DoG").astype(np.float32, copy=False)
        octaves, spacing = [np.empty((0, 4))], 1.0
        if image.size:
            image = blurred(image, math.sqrt(self.sigma**2 - self.camera_blur**2))
        while min(image.shape) >= 3:  # an extremum has a neighbour on each side
            octaves.append(self._octave(image, spacing, within))
            image = blurred(image, self.sigma * math.sqrt(3.0), step=2)
            spacing *= 2
        return np.concatenate(octaves)

    def _octave(self, image: Image, spacing: float, within: Polygon | None) -> Array:
        """Return the keypoints (n, 4) of an octave.

        Columns as of `graded`. ``image`` has a blur of `sigma` of its px, each ``spacing`` px
        wide.
        """
        scales = self.sigma * 2.0 ** (np.arange(self.layers + 3) / self.layers)
        sigmas = tuple(np.sqrt(scales**2 - self.sigma**2).tolist())
        live = reachable(image, sigmas, self.threshold / 2)
        if within is not None:
            live &= _near(within, live.shape, BLOCK * spacing)
        kernels = tuple(taps(sigma) for sigma in sigmas)
        boxes = np.array(_boxes(live, image.shape), np.int64).reshape(-1, 4)
        points = np.asarray(_search(image, boxes, kernels, self.threshold, self.edge))
        # Two maxima may lead to one sample, at which the fit is the same; the higher counts.
        points = points[np.argsort(-points[:, 6], kind="stable")]
        points = points[np.unique(points[:, [1, 2, 0]], axis=0, return_index=True)[1]]
        scale = self.sigma * 2.0 ** ((points[:, 0] + points[:, 3]) / self.layers)
        discs = np.column_stack([points[:, 1:3] + points[:, 4:6], scale * disc_radius(self.layers)])
        return np.column_stack([discs * spacing, points[:, 6]])


def disc_radius(layers: int) -> float:
    """Return the best disc's radius at scale 1, the kernel's zero.

    Examples
    --------
    >>> round(disc_radius(3), 2)
    1.58
    """
    k = 2.0 ** (1.0 / layers)
    return k * math.sqrt(2.0 * math.log(k**2) / (k**2 - 1.0))


@lru_cache(maxsize=64)
def taps(sigma: float) -> Image:
    """Return the centre and right half of a Gaussian kernel (Eq. 2.22)."""
    away = np.arange(math.ceil(REACH * sigma) + 1)
    weight = np.exp(-0.5 * (away / max(sigma, 1e-9)) ** 2)  # 0 px changes nothing
    return np.asarray(weight / (2 * weight.sum() - weight[0]), dtype=np.float32)


@njit(cache=True)
def _inward(i: int, length: int) -> int:
    """Return the inner sample that mirrors one beyond the border."""
    period = max(2 * (length - 1), 1)
    i %= period
    return period - i if i >= length else i


@njit(cache=True)
def _pass(source: Any, low: Any, high: Any, weights: Any, target: Any) -> None:
    """Blur a line of a flat array with its neighbouring lines.

    Neighbours begin at ``low`` and ``high``. Three pairs at a time save reads and writes.
    """
    size, full = len(target), 1 + 3 * ((len(weights) - 1) // 3)
    centre, weight = source[low[0] : low[0] + size], weights[0]
    for x in range(size):
        target[x] = weight * centre[x]
    for j in range(1, full, 3):
        a, b, u = source[low[j] : low[j] + size], source[high[j] : high[j] + size], weights[j]
        k = j + 1
        c, d, v = source[low[k] : low[k] + size], source[high[k] : high[k] + size], weights[k]
        k = j + 2
        e, f, w = source[low[k] : low[k] + size], source[high[k] : high[k] + size], weights[k]
        for x in range(size):
            target[x] += u * (a[x] + b[x]) + v * (c[x] + d[x]) + w * (e[x] + f[x])
    for j in range(full, len(weights)):
        a, b, u = source[low[j] : low[j] + size], source[high[j] : high[j] + size], weights[j]
        for x in range(size):
            target[x] += u * (a[x] + b[x])


def blurred(image: Image, sigma: float, step: int = 1) -> Image:
    """Return every ``step``-th pixel of a blurred image (Eq. 2.21)."""
    return np.asarray(_blur(np.ascontiguousarray(image), taps(sigma), step))


@njit(cache=True)
def _blur(image: Any, weights: Any, step: int) -> Any:
    """Blur an image row by row, mirrored beyond its border."""
    radius, (rows, cols) = len(weights) - 1, image.shape
    down, across = np.empty(cols + 2 * radius, np.float32), np.empty(cols, np.float32)
    inner, flat = down[radius : radius + cols], image.ravel()
    away = np.arange(radius + 1)
    left, right, low, high = radius - away, radius + away, away.copy(), away.copy()
    out = np.empty(((rows + step - 1) // step, (cols + step - 1) // step), np.float32)
    for i in range(len(out)):
        for j in range(radius + 1):
            low[j] = _inward(step * i - j, rows) * cols
            high[j] = _inward(step * i + j, rows) * cols
        _pass(flat, low, high, weights, inner)
        for x in range(1, radius + 1):
            down[radius - x] = inner[_inward(-x, cols)]
            down[radius + cols - 1 + x] = inner[_inward(cols - 1 + x, cols)]
        _pass(down, left, right, weights, across)
        target = out[i]
        for x in range(len(target)):  # a slice assigned is slow to compile
            target[x] = across[step * x]
    return out


@njit(cache=True)
def _patch(image: Any, box: Box) -> Any:
    """Return the rows of a box in one line, mirrored beyond the border."""
    (rows, cols), (top, bottom, left, right) = image.shape, box
    out = np.empty((bottom - top) * (right - left), dtype=np.float32)
    inner, end = max(left, 0), min(right, cols)
    for i in range(top, bottom):
        line, begin = image[_inward(i, rows)], (i - top) * (right - left) - left
        source, target = line[inner:end], out[begin + inner : begin + end]
        for x in range(len(target)):
            target[x] = source[x]
        for j in range(left, inner):
            out[begin + j] = line[_inward(j, cols)]
        for j in range(end, right):
            out[begin + j] = line[_inward(j, cols)]
    return out


@njit(cache=True)
def differences(image: Any, box: Box, kernels: Any) -> Any:
    """Return the differences of Gaussians in a box of an image.

    Shape (kernels - 1, rows, cols), narrow minus wide: bright blobs are positive. The box may
    reach beyond the border, where the image is mirrored. ``kernels`` are `taps` from narrow to
    wide. Compiled: the box stays in the cache, which takes half of OpenCV's time.
    """
    top, bottom, left, right = box
    rows, cols = bottom - top, right - left
    gaussians = np.empty((len(kernels), rows, cols), dtype=np.float32)
    for index in range(len(kernels)):
        size = len(kernels[index])
        radius, stride, away = size - 1, cols + 2 * size - 2, np.arange(size)
        patch = _patch(image, (top - radius, bottom + radius, left - radius, right + radius))
        # The ends of the lines are blurred across, too; they are cut off below.
        down = np.empty((rows + 2) * stride, dtype=np.float32)
        low, high = (radius - away) * stride, (radius + away) * stride
        _pass(patch, low, high, kernels[index], down[stride:-stride])
        across = np.empty(rows * stride, dtype=np.float32)
        _pass(down, stride - away, stride + away, kernels[index], across)
        gaussians[index] = across.reshape(rows, stride)[:, radius : radius + cols]
    return gaussians[:-1] - gaussians[1:]


@njit(cache=True)
def _search(image: Any, boxes: Any, kernels: Any, threshold: float, edge: float) -> Any:
    """Return the `keypoints` (n, 7) of all boxes, one after the other, in the image's pixels.

    Compiled: some hundred boxes a frame, each passed from Python, cost a fifth of their time.
    """
    found, count = np.empty((64, 7)), 0
    rows, cols = image.shape
    for index in range(len(boxes)):
        first, start = boxes[index, 0] - WALK, boxes[index, 2] - WALK
        box = (first, boxes[index, 1] + WALK, start, boxes[index, 3] + WALK)
        stack = differences(image, box, kernels)
        visit = (1 - first, rows - 1 - first, 1 - start, cols - 1 - start)
        points = keypoints(stack, visit, threshold, edge)
        if count + len(points) > len(found):
            longer = np.empty((2 * (count + len(points)), 7))
            longer[:count] = found[:count]
            found = longer
        for point in points:
            found[count] = point
            found[count, 1] += first
            found[count, 2] += start
            count += 1
    return found[:count].copy()


@njit(cache=True)
def maxima(stack: Any, level: float) -> Any:
    """Return layer, row, col (n, 3) of each local maximum of a stack.

    A maximum is larger than its 26 neighbours; of equal samples the first is the larger. None is
    below ``level``, 0 or less, or nearer than `WALK` to the border.
    """
    layers, rows, cols = stack.shape
    places = np.empty((layers * (rows // 2 + 1) * (cols // 2 + 1), 3), np.intp)
    count = 0
    for layer in range(1, layers - 1):
        for row in range(WALK, rows - WALK):
            line, high = stack[layer, row], False
            for col in range(WALK, cols - WALK):  # several at a time; most lines are low
                high |= line[col] >= level
            for col in range(WALK, (cols - WALK) * high):
                value = line[col]
                if value < level or value <= line[col - 1] or value < line[col + 1]:
                    continue  # most samples
                cube = stack[layer - 1 : layer + 2, row - 1 : row + 2, col - 1 : col + 2]
                highest = value > 0
                for place, other in np.ndenumerate(cube):
                    before = place < (1, 1, 1)
                    highest = highest and not (other > value or (before and other == value))
                if highest:
                    places[count] = layer, row, col
                    count += 1
    return places[:count].copy()


@njit(cache=True)
def keypoints(stack: Any, visit: Box, threshold: float, edge: float) -> Any:
    """Return the keypoints (n, 7) of a stack (Eqs 2.25 to 2.28).

    A quadratic is fitted at each maximum. Columns: layer, row, col of the sample, the extremum's
    offset from it, and the largest threshold at which that maximum still gives this keypoint. The
    fit moves by one pixel at a time within ``visit``; its layer stays. Compiled: most boxes hold
    one maximum or none, too few for numpy.
    """
    places = maxima(stack, threshold / 2)
    points, count = np.empty((len(places), 7)), 0
    for layer, row, col in places:
        sample = np.float64(stack[layer, row, col])
        for fit in range(FITS):
            cube = stack[layer - 1 : layer + 2, row - 1 : row + 2, col - 1 : col + 2]
            value, gradient, hessian = derivatives(cube.astype(np.float64))
            offset = extremum(gradient, hessian)
            down = int(offset[1] > MOVE) - int(offset[1] < -MOVE)
            right = int(offset[2] > MOVE) - int(offset[2] < -MOVE)
            if fit < FITS - 1:
                row += down if visit[0] <= row + down < visit[1] else 0
                col += right if visit[2] <= col + right < visit[3] else 0
        trace = hessian[1, 1] + hessian[2, 2]
        determinant = hessian[1, 1] * hessian[2, 2] - hessian[1, 2] ** 2
        blob = determinant > 0 and trace**2 * edge < (edge + 1) ** 2 * determinant
        peak = value + np.dot(gradient, offset) / 2
        if blob and np.abs(offset).max() < BELIEVED and peak >= threshold:
            points[count, 0], points[count, 1], points[count, 2] = layer, row, col
            points[count, 3:6] = offset
            points[count, 6] = min(peak, 2 * sample)
            count += 1
    return points[:count].copy()


@njit(cache=True)
def derivatives(cube: Any) -> Any:
    """Return value, gradient and Hessian in the middle of a cube."""
    gradient, hessian = np.empty(3), np.empty((3, 3))
    values, steps = cube.ravel(), (9, 3, 1)  # from a sample to the next along each axis
    for i in range(3):
        a = steps[i]
        gradient[i] = (values[13 + a] - values[13 - a]) / 2
        hessian[i, i] = values[13 + a] + values[13 - a] - 2 * values[13]
        for j in range(i):
            b, c = 13 + steps[j], 13 - steps[j]
            hessian[i, j] = (values[b + a] - values[b - a] - values[c + a] + values[c - a]) / 4
            hessian[j, i] = hessian[i, j]
    return values[13], gradient, hessian


@njit(cache=True)
def extremum(gradient: Any, hessian: Any) -> Any:
    """Return the offset of the quadratic's extremum (Eq. 2.26), or NaN."""
    first = np.cross(hessian[1], hessian[2])
    determinant = np.dot(hessian[0], first)
    if determinant == 0:
        return np.full(3, np.nan)
    second, third = np.cross(hessian[2], hessian[0]), np.cross(hessian[0], hessian[1])
    solution = first * gradient[0] + second * gradient[1] + third * gradient[2]
    return -solution / determinant


@lru_cache(maxsize=64)
def _positive(narrow: float, wide: float) -> tuple[int, float]:
    """Return radius and sum of the positive weights of narrow - wide.

    The weights sum to zero, so the answer to an image is at most the sum times (the
    largest value within the radius - the smallest value under the kernel).
    """
    inner, outer = (np.concatenate([taps(s)[:0:-1], taps(s)]) for s in (narrow, wide))
    inner, middle = np.pad(inner, (len(outer) - len(inner)) // 2), len(outer) // 2
    weight = np.multiply.outer(inner, inner) - np.multiply.outer(outer, outer)
    radius = int(np.abs(np.argwhere(weight > 0) - middle).max(initial=0))
    return radius, float(weight[weight > 0].sum(dtype=np.float64))


@njit(cache=True, fastmath={"nnan", "nsz"})  # several pixels at a time; none is NaN
def block_ranges(image: Any) -> Any:
    """Return the smallest and the largest value of each block."""
    rows, cols = image.shape
    out = np.empty((2, -(-rows // BLOCK), -(-cols // BLOCK)), np.float32)
    low, high = np.empty(cols, np.float32), np.empty(cols, np.float32)
    for i in range(out.shape[1]):
        low[:] = image[i * BLOCK]
        high[:] = image[i * BLOCK]
        for row in range(i * BLOCK + 1, min(rows, (i + 1) * BLOCK)):
            line = image[row]
            for x in range(cols):
                low[x] = min(low[x], line[x])
                high[x] = max(high[x], line[x])
        for j in range(out.shape[2]):
            least, most = low[j * BLOCK], high[j * BLOCK]
            for x in range(j * BLOCK + 1, min(cols, (j + 1) * BLOCK)):
                least, most = min(least, low[x]), max(most, high[x])
            out[0, i, j], out[1, i, j] = least, most
    return out


def reachable(image: Image, sigmas: tuple[float, ...], level: float) -> npt.NDArray[np.bool_]:
    """Return the blocks where an inner difference can reach ``level``.

    A bound, never an estimate. In a block left out, no sample of the inner differences
    (those with a neighbour on both sides) is as large as ``level``.
    """
    low, high = block_ranges(image)
    # A sum of products of float32 is off by less than this; the bound must not be.
    rounding = 1e-5 * max(abs(float(low.min())), abs(float(high.max())))
    live = np.zeros(low.shape, dtype=np.bool_)
    for narrow, wide in pairwise(sigmas[1:-1]):
        radius, mass = _positive(narrow, wide)
        near, far = (np.ones(2 * [2 * -(-r // BLOCK) + 1]) for r in (radius, len(taps(wide)) - 1))
        live |= (cv2.dilate(high, near) - cv2.erode(low, far)) * mass + rounding >= level
    return live


def _near(polygon: Polygon, shape: tuple[int, ...], side: float) -> npt.NDArray[np.bool_]:
    """Return the blocks near a polygon, where its particles can be found.

    A margin of two blocks of ``side`` px is more than a fit may move and rounding may shift.
    """
    corners = np.floor(np.asarray(polygon, dtype=np.float64)[:, ::-1] / side).astype(np.int32)
    drawn = cv2.fillPoly(np.zeros(shape, dtype=np.uint8), [corners], 1)
    return np.asarray(cv2.dilate(drawn, np.ones((5, 5), dtype=np.uint8)) > 0)


def _boxes(live: npt.NDArray[np.bool_], shape: tuple[int, ...]) -> list[Box]:
    """Return boxes around connected live blocks, cut to tiles."""
    boxes = []
    for rows, cols in find_objects(label(live)[0]):
        tiles = product(range(rows.start, rows.stop, TILE), range(cols.start, cols.stop, TILE))
        for i, j in tiles:
            below, beside = min(i + TILE, rows.stop), min(j + TILE, cols.stop)
            if live[i:below, j:beside].any():
                top, left = max(i * BLOCK, 1), max(j * BLOCK, 1)
                bottom = max(top, min(below * BLOCK, shape[0] - 1))
                boxes.append((top, bottom, left, max(left, min(beside * BLOCK, shape[1] - 1))))
    return boxes
