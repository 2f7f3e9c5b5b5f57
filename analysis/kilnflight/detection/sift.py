"""Particles as keypoints of SIFT: maxima of differences of Gaussians.

Section 2.2.3 of the thesis, which uses position and scale of a keypoint only. Orientation and
descriptor (Eqs 2.29 ff.) are not computed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.ndimage import find_objects, label

from kilnflight.arrays import Array, Flags, Single
from kilnflight.checks import check_number
from kilnflight.detection.otsu import check_foreground

Polygon = Sequence[tuple[float, float]]
_Box = tuple[int, int, int, int]  # first row, end row, first column, end column

# Lowe 2004 ([66] of the thesis), sections 3 and 4.
LAYERS = 3  # scales per octave that are searched; k of Eq. 2.23 is 2^(1/LAYERS)
SIGMA_PX = 1.6  # blur of the first scale of an octave, in px of the octave
EDGE = 10.0  # largest ratio of the curvatures across a blob, r of Eq. 2.28
_FITS = 3  # of the quadratic, one sample after the other
_MOVE = 0.6  # offset in px from which the fit moves to the next sample
_BELIEVED = 1.0  # offset in samples to which a quadratic through three of them is believed
_WALK = _FITS  # px around a sample that its fits can reach
_BLOCK = 8  # side in px of the blocks whose range bounds the differences
_TILE = 16  # side in blocks of the tiles that are blurred one at a time


def _taps(sigma: float) -> Single:
    """Return the centre and right half of a Gaussian kernel (Eq. 2.22)."""
    away = np.arange(math.ceil(4.0 * sigma) + 1)  # what is cut off weighs 6e-5
    weight = np.exp(-0.5 * (away / max(sigma, 1e-9)) ** 2)  # 0 px changes nothing
    return np.asarray(weight / (2 * weight.sum() - weight[0]), dtype=np.float32)


def _positive(inner: Single, outer: Single) -> tuple[int, float]:
    """Return radius and sum of the positive weights of inner - outer (both `_taps`)."""
    wide = np.concatenate([outer[:0:-1], outer])
    narrow = np.pad(np.concatenate([inner[:0:-1], inner]), len(outer) - len(inner))
    weight = np.multiply.outer(narrow, narrow) - np.multiply.outer(wide, wide)
    radius = int(np.abs(np.argwhere(weight > 0) - (len(outer) - 1)).max(initial=0))
    return radius, float(weight[weight > 0].sum(dtype=np.float64))


_K = 2.0 ** (1.0 / LAYERS)
_SCALES = SIGMA_PX * 2.0 ** (np.arange(LAYERS + 3) / LAYERS)
_KERNELS = tuple(_taps(sigma) for sigma in np.sqrt(_SCALES**2 - SIGMA_PX**2).tolist())
# Radius of the best disc at scale 1, the zero of the difference of Gaussians.
DISC_RADIUS = _K * math.sqrt(2.0 * math.log(_K**2) / (_K**2 - 1.0))
_NEXT = _taps(SIGMA_PX * math.sqrt(3.0))  # from the first scale of an octave to twice as much
_BOUNDS = [(*_positive(a, b), len(b) - 1) for a, b in pairwise(_KERNELS[1:-1])]
_MARGIN = len(_KERNELS[-1]) - 1 + _WALK  # px that are mirrored beyond the border


@dataclass(frozen=True)
class DoG:
    """Find bright blobs, the keypoints of SIFT, with position and size.

    Parameters
    ----------
    threshold
        Smallest difference of Gaussians at the interpolated maximum, in grey values
        (Eq. 2.27; "local maximum of DoG" of Tables 5.6 and 5.7).
    camera_blur
        Blur of the image as captured, in px.

    Notes
    -----
    The difference is the narrow minus the wide Gaussian, the negative of Eq. 2.23: a bright blob
    is the "local maximum" of Tables 5.6 and 5.7. Minima, which the text also names, are gaps
    between particles in |frame - background| and are left out. The threshold applies to the
    difference itself, neither divided by the number of layers (as in OpenCV) nor scaled by the
    range of the grey values. A sample below half of it is not fitted, as in OpenCV.

    The thesis starts from the original image, which finds blobs with a radius from about 2.8 px.
    Lowe doubles it first: pass the image at twice its size and twice the ``camera_blur``. The
    radius is that of the uniform disc with the strongest response at the keypoint's scale. For
    a Gaussian blob it is the square root of 2 times its standard deviation. The thesis does not
    say how it draws its circles.

    Sources: Eqs 2.21 to 2.28, thesis; Lowe 2004 for `LAYERS`, `SIGMA_PX`, `EDGE`, camera blur.
    """

    threshold: float = 500.0  # grey values; empirical value of section 5.1.2
    camera_blur: float = 0.5  # px

    def __post_init__(self) -> None:
        check_number(self.threshold, "DoG: threshold", least=0)
        check_number(self.camera_blur, "DoG: camera_blur", least=0, most=SIGMA_PX)

    def __call__(self, foreground: npt.ArrayLike, within: Polygon | None = None) -> Array:
        """Return row, col and radius (n, 3) in px of each particle.

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

    def graded(self, foreground: npt.ArrayLike, within: Polygon | None = None) -> Array:
        """Return row, col, radius (px) and largest threshold (grey values) of particles, (n, 4).

        The rows not below a higher threshold are the particles at that threshold, bit for bit.
        So one call serves a table of thresholds (Table 5.6). ``foreground`` (rows, cols) and
        ``within``, a polygon of (row, col), are as for a detector without thresholds.
        """
        image = check_foreground(foreground, "DoG").astype(np.float32, copy=False)
        octaves, spacing = [np.empty((0, 4))], 1.0
        if image.size:
            first = _taps(math.sqrt(SIGMA_PX**2 - self.camera_blur**2))
            image = _blur(_mirrored(image), first, 1)
        while min(image.shape) >= 3:  # a maximum has a neighbour on each side
            padded = _mirrored(image)
            octaves.append(self._octave(image, padded, spacing, within))
            image = _blur(padded, _NEXT, 2)
            spacing *= 2
        return np.concatenate(octaves)

    def _octave(
        self, image: Single, padded: Single, spacing: float, within: Polygon | None
    ) -> Array:
        """Return the keypoints (n, 4) of an octave, in px of the image at full size.

        One pixel of the octave's ``image`` is ``spacing`` px; ``padded`` is the image mirrored.
        """
        live = _reachable(image, self.threshold / 2)
        if within is not None:
            live &= _near(within, live.shape, _BLOCK * spacing)
        boxes = np.array(_boxes(live, image.shape), np.int64).reshape(-1, 4)
        points = np.asarray(_search(padded, boxes, _KERNELS, self.threshold))
        # Two maxima may lead to one sample, at which the fit is the same; the higher counts.
        points = points[np.argsort(-points[:, 6], kind="stable")]
        points = points[np.unique(points[:, [1, 2, 0]], axis=0, return_index=True)[1]]
        scale = SIGMA_PX * 2.0 ** ((points[:, 0] + points[:, 3]) / LAYERS)
        discs = np.column_stack([points[:, 1:3] + points[:, 4:6], scale * DISC_RADIUS])
        return np.column_stack([discs * spacing, points[:, 6]])


def _mirrored(image: Single) -> Single:
    """Return the image, mirrored by `_MARGIN` beyond its border."""
    border = cv2.copyMakeBorder(image, _MARGIN, _MARGIN, _MARGIN, _MARGIN, cv2.BORDER_REFLECT_101)
    return np.asarray(border, np.float32)


@njit(cache=True)
def _pass(source: Any, low: Any, high: Any, weights: Any, target: Any) -> None:
    """Write into a line (size,) its weighted sum with r neighbours on either side.

    ``source`` (n,) is flat, float32. ``low`` and ``high`` (1 + r,) are the first elements of the
    neighbours at distance 0 to r, ``weights`` (1 + r,) half a symmetric kernel. Three pairs at a
    time save reads and writes; another order of the sum would change the last bit.
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


@njit(cache=True)
def _blur(padded: Any, weights: Any, step: int) -> Any:
    """Return every ``step``-th pixel of the blurred image (Eq. 2.21), float32.

    ``padded`` (rows + 2 margins, cols + 2 margins) is mirrored at the border; ``weights`` are those
    of `_pass`, which blurs down the rows first, then across.
    """
    (height, width), away, flat = padded.shape, np.arange(len(weights)), padded.ravel()
    rows, cols = height - 2 * _MARGIN, width - 2 * _MARGIN
    down, across = np.empty(width, np.float32), np.empty(cols, np.float32)
    out = np.empty(((rows + step - 1) // step, (cols + step - 1) // step), np.float32)
    for i in range(len(out)):
        middle, target = _MARGIN + step * i, out[i]
        _pass(flat, (middle - away) * width, (middle + away) * width, weights, down)
        _pass(down, _MARGIN - away, _MARGIN + away, weights, across)
        for x in range(len(target)):  # a slice assigned is slow to compile
            target[x] = across[step * x]
    return out


@njit(cache=True)
def _differences(padded: Any, box: _Box, kernels: Any) -> Any:
    """Return the differences of Gaussians (kernels - 1, rows, cols) in a box of an image.

    Narrow minus wide: bright blobs are positive. Compiled: the box stays in the cache of the
    processor, which takes half of OpenCV's time.
    """
    top, bottom, left, right = box
    rows, cols = bottom - top, right - left
    gaussians = np.empty((len(kernels), rows, cols), dtype=np.float32)
    for index in range(len(kernels)):
        size = len(kernels[index])
        radius, stride, away = size - 1, cols + 2 * size - 2, np.arange(size)
        patch = np.empty((rows + 2 * radius) * stride, dtype=np.float32)
        for i in range(rows + 2 * radius):
            line = padded[top - radius + i, left - radius : right + radius]
            target = patch[i * stride : (i + 1) * stride]
            for x in range(stride):
                target[x] = line[x]
        # The ends of the lines are blurred across, too; they are cut off below.
        down = np.empty((rows + 2) * stride, dtype=np.float32)
        low, high = (radius - away) * stride, (radius + away) * stride
        _pass(patch, low, high, kernels[index], down[stride:-stride])
        across = np.empty(rows * stride, dtype=np.float32)
        _pass(down, stride - away, stride + away, kernels[index], across)
        gaussians[index] = across.reshape(rows, stride)[:, radius : radius + cols]
    return gaussians[:-1] - gaussians[1:]


@njit(cache=True)
def _search(padded: Any, boxes: Any, kernels: Any, threshold: float) -> Any:
    """Return the `_keypoints` (n, 7) of all boxes, in pixels of the image.

    Compiled: some hundred boxes a frame, each passed from Python, cost a fifth of their time.
    """
    found, count, inner = np.empty((64, 7)), 0, _MARGIN - _WALK
    rows, cols = padded.shape[0] - 2 * _MARGIN, padded.shape[1] - 2 * _MARGIN
    for index in range(len(boxes)):
        top, bottom, left, right = boxes[index]
        box = (top + inner, bottom + _MARGIN + _WALK, left + inner, right + _MARGIN + _WALK)
        first, start = top - _WALK, left - _WALK
        visit = (1 - first, rows - 1 - first, 1 - start, cols - 1 - start)
        points = _keypoints(_differences(padded, box, kernels), visit, threshold)
        if count + len(points) > len(found):
            found = np.concatenate((found, np.empty((len(found) + len(points), 7))))
        for point in points:
            found[count] = point
            found[count, 1] += first
            found[count, 2] += start
            count += 1
    return found[:count].copy()


@njit(cache=True)
def _maxima(stack: Any, level: float) -> Any:
    """Return layer, row, col (n, 3) of each local maximum of a stack.

    A maximum is larger than its 26 neighbours; ties go to the first sample. Maxima are positive,
    at least ``level``, and at least `_WALK` px from the border.
    """
    layers, rows, cols = stack.shape
    places = np.empty((layers * (rows // 2 + 1) * (cols // 2 + 1), 3), np.intp)
    count = 0
    for layer in range(1, layers - 1):
        for row in range(_WALK, rows - _WALK):
            line, high = stack[layer, row], False
            for col in range(_WALK, cols - _WALK):  # several at a time; most lines are low
                high |= line[col] >= level
            for col in range(_WALK, (cols - _WALK) * high):
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
def _keypoints(stack: Any, visit: _Box, threshold: float) -> Any:
    """Return the keypoints (n, 7) of a stack (Eqs 2.25 to 2.28).

    A quadratic is fitted at each maximum. Columns: layer, row, col of the sample, the extremum's
    offset from it, and the largest threshold at which that maximum still gives this keypoint. The
    fit moves by one pixel at a time within ``visit``; its layer stays. Compiled: most boxes hold
    one maximum or none, too few for numpy.
    """
    places = _maxima(stack, threshold / 2)
    points, count = np.empty((len(places), 7)), 0
    for layer, row, col in places:
        sample = np.float64(stack[layer, row, col])
        for fit in range(_FITS):
            cube = stack[layer - 1 : layer + 2, row - 1 : row + 2, col - 1 : col + 2]
            value, gradient, hessian = _derivatives(cube.astype(np.float64))
            offset = _extremum(gradient, hessian)
            down = int(offset[1] > _MOVE) - int(offset[1] < -_MOVE)
            right = int(offset[2] > _MOVE) - int(offset[2] < -_MOVE)
            if fit < _FITS - 1:
                row += down if visit[0] <= row + down < visit[1] else 0
                col += right if visit[2] <= col + right < visit[3] else 0
        trace = hessian[1, 1] + hessian[2, 2]
        determinant = hessian[1, 1] * hessian[2, 2] - hessian[1, 2] ** 2
        blob = determinant > 0 and trace**2 * EDGE < (EDGE + 1) ** 2 * determinant
        peak = value + np.dot(gradient, offset) / 2
        if blob and np.abs(offset).max() < _BELIEVED and peak >= threshold:
            points[count, 0], points[count, 1], points[count, 2] = layer, row, col
            points[count, 3:6] = offset
            points[count, 6] = min(peak, 2 * sample)
            count += 1
    return points[:count].copy()


@njit(cache=True)
def _derivatives(cube: Any) -> Any:
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
def _extremum(gradient: Any, hessian: Any) -> Any:
    """Return the offset (3,) of the quadratic's extremum (Eq. 2.26), or NaN."""
    first = np.cross(hessian[1], hessian[2])
    determinant = np.dot(hessian[0], first)
    if determinant == 0:
        return np.full(3, np.nan)
    second, third = np.cross(hessian[2], hessian[0]), np.cross(hessian[0], hessian[1])
    solution = first * gradient[0] + second * gradient[1] + third * gradient[2]
    return -solution / determinant


@njit(cache=True, fastmath={"nnan", "nsz"})  # several pixels at a time; none is NaN
def _block_ranges(image: Any) -> Any:
    """Return the smallest and the largest value of each block, (2, blocks, blocks)."""
    rows, cols = image.shape
    out = np.empty((2, -(-rows // _BLOCK), -(-cols // _BLOCK)), np.float32)
    low, high = np.empty(cols, np.float32), np.empty(cols, np.float32)
    for i in range(out.shape[1]):
        low[:] = image[i * _BLOCK]
        high[:] = image[i * _BLOCK]
        for row in range(i * _BLOCK + 1, min(rows, (i + 1) * _BLOCK)):
            line = image[row]
            for x in range(cols):
                low[x] = min(low[x], line[x])
                high[x] = max(high[x], line[x])
        for j in range(out.shape[2]):
            least, most = low[j * _BLOCK], high[j * _BLOCK]
            for x in range(j * _BLOCK + 1, min(cols, (j + 1) * _BLOCK)):
                least, most = min(least, low[x]), max(most, high[x])
            out[0, i, j], out[1, i, j] = least, most
    return out


def _reachable(image: Single, level: float) -> Flags:
    """Return the blocks in which an inner difference can reach ``level``.

    A bound: weights of a difference sum to zero, so it is at most the sum of the positive ones
    times (largest value within their radius - smallest value under the kernel).
    """
    low, high = _block_ranges(image)
    # A sum of products of float32 is off by less than this; the bound must not be.
    rounding = 1e-5 * max(abs(float(low.min())), abs(float(high.max())))
    live = np.zeros(low.shape, dtype=np.bool_)
    for radius, mass, reach in _BOUNDS:
        near, far = (np.ones(2 * [2 * -(-r // _BLOCK) + 1]) for r in (radius, reach))
        live |= (cv2.dilate(high, near) - cv2.erode(low, far)) * mass + rounding >= level
    return live


def _near(polygon: Polygon, shape: tuple[int, ...], side: float) -> Flags:
    """Return the blocks near a polygon; its corners are in units of 1 / ``side`` blocks.

    A margin of two blocks is more than a fit may move and rounding may shift.
    """
    corners = np.floor(np.asarray(polygon, dtype=np.float64)[:, ::-1] / side).astype(np.int32)
    drawn = cv2.fillPoly(np.zeros(shape, dtype=np.uint8), [corners], 1)
    return np.asarray(cv2.dilate(drawn, np.ones((5, 5), dtype=np.uint8)) > 0)


def _boxes(live: Flags, shape: tuple[int, ...]) -> list[_Box]:
    """Return boxes in px around connected live blocks, cut to tiles and without the border."""
    boxes = []
    for rows, cols in find_objects(label(live)[0]):
        tiles = product(range(rows.start, rows.stop, _TILE), range(cols.start, cols.stop, _TILE))
        for i, j in tiles:
            below, beside = min(i + _TILE, rows.stop), min(j + _TILE, cols.stop)
            if live[i:below, j:beside].any():
                top, left = max(i * _BLOCK, 1), max(j * _BLOCK, 1)
                bottom = max(top, min(below * _BLOCK, shape[0] - 1))
                boxes.append((top, bottom, left, max(left, min(beside * _BLOCK, shape[1] - 1))))
    return boxes
