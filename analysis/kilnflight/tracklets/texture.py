"""Laws' texture energies, which show a streak between two tracklets.

Section 4.2.3 of the thesis.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from kilnflight.arrays import Array

LAWS_LEVEL = np.array([1.0, 4.0, 6.0, 4.0, 1.0])  # Eq. 4.25, thesis
LAWS_EDGE = np.array([-1.0, -2.0, 0.0, 2.0, 1.0])


def texture_energy(
    window: Array, first: Array, second: Array, inside: Any = ..., average: bool = False
) -> float:
    """Return the texture energy of two masks on a sum of frame differences.

    The masks are Laws' (Eq. 4.25); the level-edge pair responds most to streaks (Fig.
    4.13).

    Parameters
    ----------
    window
        (rows, cols) sum of frame differences, grey values.
    first, second
        Masks of Laws, (5,), one along the rows and one along the columns.
    inside
        (rows, cols) bool, pixels that count; default: all.
    average
        Whether to divide by the number of responses that are not zero.

    Returns
    -------
    float
        Sum of the absolute responses, grey values.

    Notes
    -----
    The absolute responses of the masks and of their transpose are averaged, then
    summed. Section 4.2.3 goes on to divide by the number of pixels that are not zero.
    But its energies are "of order 10^8" (Fig. 4.13), which a sum over a window reaches.
    A mean does not: one frame adds at most 16 x 3 x 65,535 = 3e6 to a response. So the
    sum is taken. The thesis does not mention absolute values. Without them a streak's
    two edges cancel in the sum, and the two transposes on one of the diagonals. Beyond
    its border the window goes on with its outermost pixels.
    """
    responses = [
        np.abs(
            cv2.sepFilter2D(window, cv2.CV_64F, *masks, borderType=cv2.BORDER_REPLICATE)
        )
        for masks in ((first, second), (second, first))
    ]
    values = (responses[0] + responses[1])[inside] / 2
    total = float(values.sum())
    if average:
        total /= max(int(np.count_nonzero(values)), 1)
    return total


def level_edge(
    start: Array,
    end: Array,
    period: tuple[int, int],
    differences: Any,
    half_width: float = 15.0,
    average: bool = False,
) -> float:
    """Return the level-edge energy between two tracklets (F of Eq. 4.24).

    A high energy shows a streak in the frame differences: the particle flew from one to
    the other.

    Parameters
    ----------
    start, end
        (2,) last position (row, col) of the earlier tracklet and first one of the
        later, in px.
    period
        First and last frame to sum, both included.
    differences
        (frames, rows, cols), see `kilnflight.tracklets.postprocess`.
    half_width
        w of Table 5.16, px.
    average
        As for `texture_energy`.

    Returns
    -------
    float
        The energy, 0 where the window lies outside the image.

    Notes
    -----
    Readings. (1) "Within the time period of the tracklets' appearance" is from the
    first frame of the pair to its last. (2) The vertices printed span a parallelogram
    from one position to the other. It is 2 w wide along the columns where the
    connection is at least as long along the rows, else along the rows. A pixel counts
    if its centre is inside, and the line between the positions has at least one. (3)
    The masks see the pixels around the window; beyond the image its outermost ones go
    on. Source: section 4.2.3 and Eq. 4.25, thesis.
    """
    corners = window_corners(start, end, half_width)
    shape = differences.shape[1:]
    low = np.clip(np.floor(corners.min(axis=0)) - 2, 0, shape).astype(
        int
    )  # reach of the masks
    high = np.clip(np.ceil(corners.max(axis=0)) + 3, 0, shape).astype(int)
    if (low >= high).any():
        return 0.0
    frames = differences[period[0] : period[1] + 1, low[0] : high[0], low[1] : high[1]]
    image = np.asarray(frames).sum(axis=0, dtype=np.float64)
    lying = int(corners[0, 0] != corners[1, 0])  # the axis along which the window runs
    along, across = (np.arange(low[axis], high[axis]) for axis in (lying, 1 - lying))
    first, last = sorted((start[lying], end[lying]))
    share = (along - start[lying]) / ((end[lying] - start[lying]) or 1.0)
    centre = start[1 - lying] + np.clip(share, 0, 1) * (
        end[1 - lying] - start[1 - lying]
    )
    # Rounded, so that a connection shorter than a pixel still has a line of pixels.
    within = (along >= np.floor(first + 0.5)) & (along <= np.floor(last + 0.5))
    inside = within[:, None] & (np.abs(across - centre[:, None]) <= half_width)
    if lying:
        inside = inside.T
    return texture_energy(image, LAWS_LEVEL, LAWS_EDGE, inside, average)


def window_corners(start: Array, end: Array, half_width: float = 15.0) -> Array:
    """Return the vertices (4, 2) of the window of `level_edge`, row and col in px.

    ``start`` and ``end`` (2,) are row and col in px. Vertices 0 and 1 lie beside
    ``start``, 2 and 3 beside ``end``.
    """
    upright = abs(end[0] - start[0]) >= abs(end[1] - start[1])
    aside = np.array([0.0, half_width] if upright else [half_width, 0.0])
    return np.array([start - aside, start + aside, end + aside, end - aside])
