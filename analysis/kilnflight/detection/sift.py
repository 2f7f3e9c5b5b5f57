"""Particles as keypoints of SIFT: maxima of differences of Gaussians.

Section 2.2.3 of the thesis, which uses position and scale of a keypoint only.
Orientation and descriptor (Eqs 2.29 ff.) are not computed.
"""

import math
from itertools import pairwise
from typing import Annotated, Any

import cv2
import numpy as np
from numba import njit

from kilnflight.arrays import Array, ArrayLike, Flags, Shape, Single, TwoInts
from kilnflight.checks import NotNegative, Range, Settings
from kilnflight.compiled import compiled
from kilnflight.detection.otsu import check_foreground
from kilnflight.detection.region import check_polygon

Polygon = ArrayLike  # (n, 2) row, col of its corners in px
_Box = tuple[int, int, int, int]  # first row, end row, first column, end column

# Lowe 2004 ([66] of the thesis), sections 3 and 4.
LAYERS = 3  # scales per octave that are searched; k of Eq. 2.23 is 2^(1/LAYERS)
SIGMA_PX = 1.6  # blur of the first scale of an octave, in px of the octave
_FITS = 3  # fits of the quadratic at a maximum; after each it may move by one sample
_MOVE = 0.6  # offset in px from which the fit moves to the next sample
# Offset in samples from which a keypoint is rejected: beyond the three fitted ones.
_BELIEVED = 1.0
_WALK = _FITS  # px around a sample that its fits can reach
# Side in px of the blocks whose range bounds the differences.
_BLOCK = 4
# Rows and columns, in blocks, of the tiles that are blurred one at a time.
_TILE_ROWS = 8
_TILE_COLS = 32


def _taps(sigma: float) -> Single:
    """Return the centre and right half (1 + r,) of a Gaussian kernel (Eq. 2.22).

    ``sigma`` is in px; the whole kernel sums to 1 and ends at r = 4 sigma.
    """
    away = np.arange(math.ceil(4.0 * sigma) + 1)  # what is cut off weighs 6e-5
    weight = np.exp(-0.5 * (away / max(sigma, 1e-9)) ** 2)  # 0 px changes nothing
    return np.asarray(weight / (2 * weight.sum() - weight[0]), dtype=np.float32)


def _positive(inner: Single, outer: Single) -> tuple[int, float]:
    """Return radius (px) and sum of a difference of Gaussians' positive weights.

    ``inner`` and ``outer`` are `_taps`, (1 + r,) each; the weights are those of inner -
    outer in 2D. `_reachable` bounds the difference by them.
    """
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
# Blurs the first scale of an octave to twice as much.
_NEXT = _taps(SIGMA_PX * math.sqrt(3.0))
_BOUNDS = [(*_positive(a, b), len(b) - 1) for a, b in pairwise(_KERNELS[1:-1])]


class DoG(Settings):
    """Find bright blobs, the keypoints of SIFT, with position and size.

    Parameters
    ----------
    threshold
        Smallest difference of Gaussians at the interpolated maximum, in grey values
        (Eq. 2.27; "local maximum of DoG" of Tables 5.6 and 5.7).
    camera_blur
        Blur of the image as captured, in px.
    enlarge
        Search the image at so many times its size, which finds smaller blobs: 1 to 4.
    edge
        Largest ratio of the curvatures across a blob, r of Eq. 2.28: "a user-defined
        threshold", which the thesis does not print.

    Notes
    -----
    The difference is the narrow minus the wide Gaussian, the negative of Eq. 2.23: a
    bright blob is the "local maximum" of Tables 5.6 and 5.7. Minima, which the text
    also names, are gaps between particles in the absolute difference of frame and
    background, and are left out. The threshold applies to the difference itself,
    neither divided by the number of layers (as in OpenCV) nor scaled by the range of
    the grey values. A sample below half of it is not fitted, as in OpenCV.

    The thesis starts from the original image, which finds blobs with a radius from
    about 2.8 px. Lowe doubles it first (``enlarge``). The radius is that of the uniform
    disc with the strongest response at the keypoint's scale. For a Gaussian blob it is
    the square root of 2 times its standard deviation. The thesis does not say how it
    draws its circles.

    Sources: Eqs 2.21 to 2.28, thesis; Lowe 2004 for `LAYERS`, `SIGMA_PX`, ``edge``,
    camera blur.

    OpenCV's SIFT takes 8 bits only, and 5 to 10 times as long (benchmarks.csv). Here
    16 bits are searched, and only where the range of the grey values allows a keypoint.

    Examples
    --------
    >>> row, col = np.ogrid[:60, :80]
    >>> blob = 9000 * np.exp(-((row - 20) ** 2 + (col - 33) ** 2) / (2 * 3.0**2))
    >>> DoG(threshold=500.0)(blob).round(1).tolist()  # radius 3 px times the root of 2
    [[20.0, 33.0, 4.2]]
    """

    threshold: NotNegative = 500.0  # grey values; empirical value of section 5.1.2
    camera_blur: Annotated[float, Range(least=0, most=SIGMA_PX)] = 0.5  # px
    enlarge: Annotated[int, Range(least=1, most=4)] = 1
    edge: Annotated[float, Range(least=1)] = 10.0  # Lowe 2004, section 4.1

    def __call__(self, foreground: ArrayLike, within: Polygon | None = None) -> Array:
        """Return row, col and radius (n, 3) in px of each particle.

        Parameters
        ----------
        foreground
            (rows, cols) grey values: integers of 8 or 16 bits, or floats; computed in
            float32.
        within
            Corners (row, col) of a polygon. All particles in it are found; most of
            those outside are skipped, which saves time.

        Returns
        -------
        ndarray
            (n, 3) row, col, radius in px, by octave, row and column. None in a
            foreground of one grey value. A saturated plateau is one blob with the size
            of the plateau.

        Raises
        ------
        InputError
            If the foreground is not 2D, not of numbers or not finite.
        """
        return self.graded(foreground, within)[:, :3]

    def graded(self, foreground: ArrayLike, within: Polygon | None = None) -> Array:
        """Return row, col, radius and largest threshold (n, 4) of each particle.

        Lengths are in px, thresholds in grey values. A particle is found at every
        threshold up to its largest one. So the rows with at least a higher threshold
        are what a detector with that threshold finds, bit for bit. One call serves a
        table of thresholds (Table 5.6).

        Parameters
        ----------
        foreground
            (rows, cols) grey values.
        within
            Corners (row, col) of a polygon in px, or None: the whole image.
        """
        image = check_foreground(foreground, "DoG").astype(np.float32, copy=False)
        spacing = 1.0 / self.enlarge
        shift = (1.0 - spacing) / 2  # px from a pixel's middle to its first part's
        corners = None
        if within is not None:
            corners = check_polygon(within, "DoG: within") + shift
        octaves = [np.empty((0, 4))]
        if image.size:
            if self.enlarge > 1:
                image = enlarged(image, self.enlarge)
            blur = min(self.enlarge * self.camera_blur, SIGMA_PX)
            first = _taps(math.sqrt(SIGMA_PX**2 - blur**2))
            image = _blur(np.ascontiguousarray(image), first, 1)
        while min(image.shape) >= 3:  # a maximum has a neighbour on each side
            octaves.append(self._octave(image, spacing, corners))
            image = _blur(image, _NEXT, 2)
            spacing *= 2
        return np.concatenate(octaves) - [shift, shift, 0, 0]

    def _octave(self, image: Single, spacing: float, within: Array | None) -> Array:
        """Return row, col, radius, largest threshold (n, 4) of an octave's keypoints.

        Places and radii are in px of the image at full size; one pixel of the octave's
        ``image`` (rows, cols) is ``spacing`` of them.
        """
        live = _reachable(image, self.threshold / 2)
        if within is not None:
            live &= _near(within, live.shape, _BLOCK * spacing)
        boxes = np.array(_boxes(live, image.shape), np.int64).reshape(-1, 4)
        levels = float(self.threshold), float(self.edge)
        points = np.concatenate(_search(image, boxes, _KERNELS, *levels))
        # Two maxima may lead to one sample, at which the fit is the same; the higher
        # counts.
        points = points[np.argsort(-points[:, 6], kind="stable")]
        points = points[np.unique(points[:, [1, 2, 0]], axis=0, return_index=True)[1]]
        scale = SIGMA_PX * 2.0 ** ((points[:, 0] + points[:, 3]) / LAYERS)
        discs = np.column_stack([points[:, 1:3] + points[:, 4:6], scale * DISC_RADIUS])
        return np.column_stack([discs * spacing, points[:, 6]])


def enlarged(image: Single, times: int) -> Single:
    """Return the image (rows, cols) at ``times`` its size, by linear interpolation."""
    return np.asarray(
        cv2.resize(image, None, fx=times, fy=times, interpolation=cv2.INTER_LINEAR)
    )


@compiled
def _mirrored(start: int, stop: int, size: int) -> Any:
    """Return the pixel (stop - start,) at each place along a mirrored axis.

    The axis has ``size`` px; the outermost ones are not repeated.
    """
    places = np.arange(start, stop)
    period = max(2 * size - 2, 1)
    return np.minimum(places % period, -places % period)


@compiled
def _pass(source: Any, low: Any, high: Any, weights: Any, target: Any) -> None:
    """Write a line, blurred along one axis of an image, into ``target`` (size,).

    A line is ``size`` consecutive elements of ``source`` (n,): an image, row after row,
    float32. Lines j px before and after it begin at the elements ``low[j]`` and
    ``high[j]``, (1 + r,) each; ``low[0]`` is its own, ``high[0]`` is not read.
    ``weights`` (1 + r,) are those of `_taps`. Three pairs at a time save reads and
    writes; the order of the sum may not change, as it decides the last bit.
    """
    size = len(target)
    full = 1 + 3 * ((len(weights) - 1) // 3)
    centre = source[low[0] : low[0] + size]
    weight = weights[0]
    for x in range(size):
        target[x] = weight * centre[x]
    for j in range(1, full, 3):
        a = source[low[j] : low[j] + size]
        b = source[high[j] : high[j] + size]
        u = weights[j]
        k = j + 1
        c = source[low[k] : low[k] + size]
        d = source[high[k] : high[k] + size]
        v = weights[k]
        k = j + 2
        e = source[low[k] : low[k] + size]
        f = source[high[k] : high[k] + size]
        w = weights[k]
        for x in range(size):
            target[x] += u * (a[x] + b[x]) + v * (c[x] + d[x]) + w * (e[x] + f[x])
    for j in range(full, len(weights)):
        a = source[low[j] : low[j] + size]
        b = source[high[j] : high[j] + size]
        u = weights[j]
        for x in range(size):
            target[x] += u * (a[x] + b[x])


@compiled
def _blur(image: Any, weights: Any, step: int) -> Any:
    """Return every ``step``-th pixel of the blurred image (Eq. 2.21), float32.

    The image is (rows, cols), mirrored at its border. ``weights`` (1 + r,) are those of
    `_taps`. Columns are blurred first, then rows.
    """
    rows, cols = image.shape
    reach = len(weights) - 1
    away = np.arange(len(weights))
    lines = _mirrored(-reach, rows + reach, rows) * cols
    ends = _mirrored(-reach, cols + reach, cols)
    down = np.empty(cols + 2 * reach, np.float32)
    across = np.empty(cols, np.float32)
    out = np.empty(((rows + step - 1) // step, (cols + step - 1) // step), np.float32)
    for i in range(len(out)):
        middle = step * i + reach
        target = out[i] if step == 1 else across
        low = lines[middle - away]
        high = lines[middle + away]
        _pass(image.ravel(), low, high, weights, down[reach : reach + cols])
        for x in range(reach):
            down[x] = down[reach + ends[x]]
            down[-1 - x] = down[reach + ends[-1 - x]]
        _pass(down, reach - away, reach + away, weights, target)
        if step > 1:
            for x in range(out.shape[1]):  # a slice assigned is slow to compile
                out[i, x] = across[step * x]
    return out


@compiled
def _differences(image: Any, box: _Box, kernels: Any, level: float) -> Any:
    """Return the differences of Gaussians (kernels - 1 or 2, rows, cols) in a box.

    Float32, in grey values; narrow minus wide, so bright blobs are positive. The last
    one is left out where the one before is below ``level``, the least of a maximum:
    then none needs it. Noise has small scales, which spares a third of its time.
    ``box`` is in px of the image (rows, cols), which is mirrored at its border.
    ``kernels`` are `_taps`, (1 + r,) each, the narrowest first. Compiled: the box stays
    in the cache of the processor, which takes half of OpenCV's time.
    """
    top, bottom, left, right = box
    rows = bottom - top
    cols = right - left
    most = len(kernels[-1]) - 1
    stride = cols + 2 * most
    lines = _mirrored(top - most, bottom + most, image.shape[0])
    places = _mirrored(left - most, right + most, image.shape[1])
    patch = np.empty(len(lines) * stride, np.float32)
    for i in range(len(lines)):
        line = image[lines[i]]
        target = patch[i * stride : (i + 1) * stride]
        for x in range(stride):
            target[x] = line[places[x]]
    # The ends of the lines are blurred across, too; they are cut off below.
    down = np.empty((rows + 2) * stride, np.float32)
    across = np.empty(rows * stride, np.float32)
    gaussians = np.empty((len(kernels), rows, cols), dtype=np.float32)
    for index in range(len(kernels)):
        if index == len(kernels) - 1 and (gaussians[-3] - gaussians[-2]).max() < level:
            return gaussians[:-2] - gaussians[1:-1]
        away = np.arange(len(kernels[index]))
        low = (most - away) * stride
        high = (most + away) * stride
        _pass(patch, low, high, kernels[index], down[stride:-stride])
        _pass(down, stride - away, stride + away, kernels[index], across)
        gaussians[index] = across.reshape(rows, stride)[:, most : most + cols]
    return gaussians[:-1] - gaussians[1:]


@compiled
def _search(image: Any, boxes: Any, kernels: Any, threshold: float, edge: float) -> Any:
    """Return a list of the keypoints (n, 7) of each box, columns as of `_keypoints`.

    ``boxes`` (n, 4) and the rows and columns of keypoints are in px of the image (rows,
    cols). ``kernels`` are `_taps`, the narrowest first, and ``threshold`` is in grey
    values; ``edge`` as in `DoG`. Compiled: some hundred boxes a frame, each passed from
    Python, cost a fifth of their time.
    """
    rows, cols = image.shape
    found = [np.empty((0, 7))]
    for top, bottom, left, right in boxes:
        first = top - _WALK
        start = left - _WALK
        box = (first, bottom + _WALK, start, right + _WALK)
        visit = (1 - first, rows - 1 - first, 1 - start, cols - 1 - start)
        stack = _differences(image, box, kernels, threshold / 2)
        points = _keypoints(stack, visit, threshold, edge)
        points[:, 1] += first
        points[:, 2] += start
        found.append(points)
    return found


@compiled
def _maxima(stack: Any, level: float) -> Any:
    """Return a list of layer, row, col of each local maximum of a stack.

    The stack (layers, rows, cols) holds differences of Gaussians. A maximum is larger
    than its 26 neighbours; ties go to the first sample. It is positive, at least
    ``level`` in grey values, and at least `_WALK` px from the border.
    """
    layers, rows, cols = stack.shape
    places = []
    for layer in range(1, layers - 1):
        for row in range(_WALK, rows - _WALK):
            line = stack[layer, row]
            high = False
            for col in range(_WALK, cols - _WALK):  # several at a time
                high |= line[col] >= level
            if not high:
                continue  # most lines
            for col in range(_WALK, cols - _WALK):
                value = line[col]
                if value < level or value <= line[col - 1] or value < line[col + 1]:
                    continue  # most samples
                cube = stack[
                    layer - 1 : layer + 2, row - 1 : row + 2, col - 1 : col + 2
                ]
                if value > 0 and cube.argmax() == 13:  # the middle; of equal ones first
                    places.append((layer, row, col))
    return places


@compiled
def _keypoints(stack: Any, visit: _Box, threshold: float, edge: float) -> Any:
    """Return the keypoints (n, 7) of a stack (Eqs 2.25 to 2.28).

    The stack (layers, rows, cols) holds differences of Gaussians of one box. A
    quadratic is fitted at each maximum. Columns: layer, row, col of the sample; offset
    of the quadratic's extremum from it along the same axes, in samples; largest
    threshold. That is the largest one, in grey values, at which the maximum still gives
    this keypoint. The fit moves by one pixel at a time; its layer stays. ``visit`` are
    the rows and columns of the stack that it may reach, half open. Compiled: most boxes
    hold one maximum or none, too few for numpy.
    """
    places = _maxima(stack, threshold / 2)
    points = np.empty((len(places), 7))
    count = 0
    for layer, row, col in places:
        sample = np.float64(stack[layer, row, col])
        for fit in range(_FITS):
            cube = stack[layer - 1 : layer + 2, row - 1 : row + 2, col - 1 : col + 2]
            value, gradient, hessian = _derivatives(cube.astype(np.float64))
            offset = _extremum(gradient, hessian)
            down = int(offset[1] > _MOVE) - int(offset[1] < -_MOVE)
            right = int(offset[2] > _MOVE) - int(offset[2] < -_MOVE)
            if fit < _FITS - 1:
                if visit[0] <= row + down < visit[1]:
                    row += down
                if visit[2] <= col + right < visit[3]:
                    col += right
        trace = hessian[1, 1] + hessian[2, 2]
        determinant = hessian[1, 1] * hessian[2, 2] - hessian[1, 2] ** 2
        blob = determinant > 0 and trace**2 * edge < (edge + 1) ** 2 * determinant
        peak = value + np.dot(gradient, offset) / 2
        if blob and np.abs(offset).max() < _BELIEVED and peak >= threshold:
            points[count, :3] = layer, row, col
            points[count, 3:6] = offset
            points[count, 6] = min(peak, 2 * sample)
            count += 1
    return points[:count].copy()


@compiled
def _derivatives(cube: Any) -> Any:
    """Return value, gradient (3,) and Hessian (3, 3) in the middle of a cube.

    The cube (3, 3, 3) is layer, row, col; differences are central and per sample.
    """
    gradient = np.empty(3)
    hessian = np.empty((3, 3))
    values = cube.ravel()
    steps = (9, 3, 1)  # distance to the next sample along each axis
    for i in range(3):
        a = steps[i]
        gradient[i] = (values[13 + a] - values[13 - a]) / 2
        hessian[i, i] = values[13 + a] + values[13 - a] - 2 * values[13]
        for j in range(i):
            b = 13 + steps[j]
            c = 13 - steps[j]
            hessian[i, j] = (
                values[b + a] - values[b - a] - values[c + a] + values[c - a]
            ) / 4
            hessian[j, i] = hessian[i, j]
    return values[13], gradient, hessian


@compiled
def _extremum(gradient: Any, hessian: Any) -> Any:
    """Return the offset (3,) in samples of a quadratic's extremum (Eq. 2.26).

    ``gradient`` is (3,), ``hessian`` (3, 3); NaN where the Hessian is singular.
    """
    first = np.cross(hessian[1], hessian[2])
    determinant = np.dot(hessian[0], first)
    if determinant == 0:
        return np.full(3, np.nan)
    second = np.cross(hessian[2], hessian[0])
    third = np.cross(hessian[0], hessian[1])
    solution = first * gradient[0] + second * gradient[1] + third * gradient[2]
    return -solution / determinant


@njit(cache=True, fastmath={"nnan", "nsz"})  # several pixels at a time; none is NaN
def _block_ranges(image: Any) -> Any:
    """Return the smallest and the largest value of each block (block rows, block cols).

    A block is `_BLOCK` px wide and high, cut at the border of the image (rows, cols).
    Its lines come first, several pixels at a time.
    """
    rows, cols = image.shape
    lowest = np.full((-(-rows // _BLOCK), -(-cols // _BLOCK)), np.inf, np.float32)
    highest = -lowest
    low = np.empty(cols, np.float32)
    high = np.empty_like(low)
    for i in range(len(lowest)):
        low[:] = np.inf
        high[:] = -np.inf
        for row in range(i * _BLOCK, min((i + 1) * _BLOCK, rows)):
            line = image[row]
            for x in range(cols):
                low[x] = min(low[x], line[x])
                high[x] = max(high[x], line[x])
        for x in range(cols):
            j = x // _BLOCK
            lowest[i, j] = min(lowest[i, j], low[x])
            highest[i, j] = max(highest[i, j], high[x])
    return lowest, highest


def _reachable(image: Single, level: float) -> Flags:
    """Return whether a keypoint can lie in each block, (block rows, block cols).

    That is where a searched difference of Gaussians can reach ``level`` in grey values;
    other blocks are skipped to save time. The weights of a difference sum to zero. So
    it is at most the sum of the positive ones times (largest value within their radius
    - smallest value under the kernel).
    """
    low, high = _block_ranges(image)
    # A sum of products of float32 is off by less than this; the bound must not be.
    rounding = 1e-5 * max(abs(float(low.min())), abs(float(high.max())))
    live = np.zeros(low.shape, bool)
    for radius, mass, reach in _BOUNDS:
        near, far = (np.ones(2 * [2 * -(-r // _BLOCK) + 1]) for r in (radius, reach))
        span = cv2.dilate(high, near) - cv2.erode(low, far)
        live |= span * mass + rounding >= level
    return live


def _near(polygon: Array, shape: Shape, side: float) -> Flags:
    """Return whether each block, of ``shape``, is in a polygon or two blocks from it.

    Corners (n, 2), row and col, of the polygon and the ``side`` of a block are in px of
    the image at full size. Two blocks are more than a fit may move and rounding may
    shift.
    """
    corners = np.floor(polygon[:, ::-1] / side).astype(np.int32)
    drawn = cv2.fillPoly(np.zeros(shape, np.uint8), [corners], 1)
    return cv2.dilate(drawn, np.ones((5, 5), np.uint8)) > 0


@compiled
def _boxes(live: Any, shape: TwoInts) -> Any:
    """Return a list of the boxes to search, in px.

    A box is the part of a tile with blocks that are live, columns as of `_Box`.
    ``live`` (block rows, block cols) is from `_reachable`, ``shape`` that of the image
    in px. Boxes leave out the outermost pixels of the image. Compiled: there are some
    hundred tiles.
    """
    boxes = []
    for i in range(0, live.shape[0], _TILE_ROWS):
        for j in range(0, live.shape[1], _TILE_COLS):
            rows, cols = np.nonzero(live[i : i + _TILE_ROWS, j : j + _TILE_COLS])
            if len(rows):
                top = max((i + rows[0]) * _BLOCK, 1)
                left = max((j + cols.min()) * _BLOCK, 1)
                bottom = min((i + rows[-1] + 1) * _BLOCK, shape[0] - 1)
                right = min((j + cols.max() + 1) * _BLOCK, shape[1] - 1)
                boxes.append((top, max(top, bottom), left, max(left, right)))
    return boxes
