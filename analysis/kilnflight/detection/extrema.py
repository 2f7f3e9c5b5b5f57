"""Extrema of a stack of differences of Gaussians, and where exactly they lie.

Eqs 2.25 to 2.28 of the thesis, on samples of one octave.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

FITS = 3  # at how many samples, at most, the quadratic is fitted until it stays where it is
MOVE = 0.6  # offset in px from which the fit moves to the next sample
TRUST = 1.0  # offset in samples to which a quadratic through three of them is believed


@njit(cache=True)
def is_maximum(stack: Any, sign: float, layer: int, row: int, col: int) -> bool:
    """Tell whether a sample is larger than its 26 neighbours; of equal ones the first is."""
    value = sign * stack[layer, row, col]
    for i in range(-1, 2):
        for j in range(-1, 2):
            for k in range(-1, 2):
                other = sign * stack[layer + i, row + j, col + k]
                before = (i, j, k) < (0, 0, 0)
                if other > value or (before and other == value):
                    return False
    return True


@njit(cache=True)
def derivatives(stack: Any, layer: int, row: int, col: int) -> Any:
    """Return gradient and Hessian at a sample by central differences; (layer, row, col)."""
    cube = stack[layer - 1 : layer + 2, row - 1 : row + 2, col - 1 : col + 2].astype(np.float64)
    gradient = np.empty(3)
    gradient[0] = (cube[2, 1, 1] - cube[0, 1, 1]) / 2
    gradient[1] = (cube[1, 2, 1] - cube[1, 0, 1]) / 2
    gradient[2] = (cube[1, 1, 2] - cube[1, 1, 0]) / 2
    hessian = np.empty((3, 3))
    hessian[0, 0] = cube[2, 1, 1] + cube[0, 1, 1] - 2 * cube[1, 1, 1]
    hessian[1, 1] = cube[1, 2, 1] + cube[1, 0, 1] - 2 * cube[1, 1, 1]
    hessian[2, 2] = cube[1, 1, 2] + cube[1, 1, 0] - 2 * cube[1, 1, 1]
    hessian[0, 1] = (cube[2, 2, 1] - cube[2, 0, 1] - cube[0, 2, 1] + cube[0, 0, 1]) / 4
    hessian[0, 2] = (cube[2, 1, 2] - cube[2, 1, 0] - cube[0, 1, 2] + cube[0, 1, 0]) / 4
    hessian[1, 2] = (cube[1, 2, 2] - cube[1, 2, 0] - cube[1, 0, 2] + cube[1, 0, 0]) / 4
    hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]
    return gradient, hessian


@njit(cache=True)
def offset_of(gradient: Any, hessian: Any) -> Any:
    """Return Eq. 2.26, the extremum of the quadratic, from its sample; NaN if there is none."""
    first = np.cross(hessian[1], hessian[2])
    determinant = np.dot(hessian[0], first)
    if determinant == 0:
        return np.full(3, np.nan)
    second = np.cross(hessian[2], hessian[0])
    third = np.cross(hessian[0], hessian[1])
    solution = first * gradient[0] + second * gradient[1] + third * gradient[2]
    return -solution / determinant


@njit(cache=True)
def is_edge(hessian: Any, ratio: float) -> bool:
    """Tell whether the curvatures along the image differ by more than ``ratio``; Eq. 2.28."""
    trace = hessian[1, 1] + hessian[2, 2]
    determinant = hessian[1, 1] * hessian[2, 2] - hessian[1, 2] ** 2
    return determinant <= 0 or trace**2 * ratio >= (ratio + 1) ** 2 * determinant


@njit(cache=True)
def refine(stack: Any, layer: int, row: int, col: int, shape: Any) -> Any:
    """Return the sample at which the fit stays, its offset, gradient and Hessian.

    The fit moves by one pixel at a time; in scale it stays with the largest layer.
    ``shape``: first row, end row, first column, end column that may be visited.
    """
    for _ in range(FITS - 1):
        gradient, hessian = derivatives(stack, layer, row, col)
        offset = offset_of(gradient, hessian)
        down = int(offset[1] > MOVE) - int(offset[1] < -MOVE)
        right = int(offset[2] > MOVE) - int(offset[2] < -MOVE)
        down = down if shape[0] <= row + down < shape[1] else 0
        right = right if shape[2] <= col + right < shape[3] else 0
        if down == 0 and right == 0:
            return row, col, offset, gradient, hessian
        row, col = row + down, col + right
    gradient, hessian = derivatives(stack, layer, row, col)
    return row, col, offset_of(gradient, hessian), gradient, hessian


@njit(cache=True)
def keypoints(stack: Any, start: Any, visit: Any, threshold: float, edge: float, signs: Any) -> Any:
    """Return the keypoints of a stack of differences that begin in ``start``.

    Parameters
    ----------
    stack
        (layers + 2, rows, cols) differences of Gaussians.
    start, visit
        First row, end row, first column, end column in which a maximum is looked for,
        and to which the fit may move.
    threshold
        Smallest interpolated value (Eq. 2.27); a sample below half of it is not followed.
    edge
        Largest ratio of the curvatures, r of Eq. 2.28.
    signs
        1 for maxima, -1 for minima.

    Returns
    -------
    ndarray
        (n, 7): layer, row, col of the sample, the offset of the extremum from it, and the
        largest threshold with which the same keypoint is found from the same maximum.
    """
    found = np.empty((stack[1:-1].size * len(signs) // 8 + stack.size // 4 + 8, 7))
    count = 0
    for layer in range(1, len(stack) - 1):
        for row in range(start[0], start[1]):
            line = stack[layer, row]
            for col in range(start[2], start[3]):
                sample = line[col]
                if abs(sample) < threshold / 2:
                    continue
                for sign in signs:
                    # Most samples fail against the pixel before or after.
                    if (
                        sign * line[col - 1] >= sign * sample
                        or sign * line[col + 1] > sign * sample
                    ):
                        continue
                    if sign * sample <= 0 or not is_maximum(stack, sign, layer, row, col):
                        continue
                    at_row, at_col, offset, gradient, hessian = refine(
                        stack, layer, row, col, visit
                    )
                    if not np.max(np.abs(offset)) < TRUST or is_edge(hessian, edge):
                        continue
                    peak = stack[layer, at_row, at_col] + np.dot(gradient, offset) / 2
                    if sign * peak < threshold:
                        continue
                    found[count, 0], found[count, 1], found[count, 2] = layer, at_row, at_col
                    found[count, 3], found[count, 4], found[count, 5] = offset
                    found[count, 6] = min(sign * peak, 2 * np.float64(sign * sample))
                    count += 1
    return found[:count].copy()
