"""Laws' texture energies, which show a streak between two tracklets.

Section 4.2.3 of the thesis.
"""

from typing import Any

import cv2
import numpy as np

from kilnflight.arrays import Array, Flags, Integers, TwoInts

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

    def response(rows: Array, cols: Array) -> Array:
        border = cv2.BORDER_REPLICATE
        found = cv2.sepFilter2D(window, cv2.CV_64F, rows, cols, borderType=border)
        return np.abs(found)

    values = (response(first, second) + response(second, first))[inside] / 2
    total = values.sum()
    if average:
        total /= max(np.count_nonzero(values), 1)
    return total


def level_edge(
    start: Array,
    end: Array,
    period: TwoInts,
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
    # The masks reach two pixels farther.
    low = np.clip(np.floor(corners.min(axis=0)) - 2, 0, shape).astype(int)
    high = np.clip(np.ceil(corners.max(axis=0)) + 3, 0, shape).astype(int)
    if (low >= high).any():
        return 0.0
    first, last = period
    frames = differences[first : last + 1, low[0] : high[0], low[1] : high[1]]
    image = np.asarray(frames).sum(axis=0, dtype=np.float64)
    rows = np.arange(low[0], high[0])
    cols = np.arange(low[1], high[1])
    if corners[0, 0] == corners[1, 0]:
        inside = _inside(rows, cols, start, end, half_width)
    else:  # it runs along the columns
        inside = _inside(cols, rows, start[::-1], end[::-1], half_width).T
    return texture_energy(image, LAWS_LEVEL, LAWS_EDGE, inside, average)


def _inside(
    along: Integers, across: Integers, start: Array, end: Array, half_width: float
) -> Flags:
    """Return which pixels (n, m) have their centre inside the window.

    ``along`` (n,) and ``across`` (m,) are the pixels along the window and across it,
    the axes of ``start`` and ``end`` (2,).
    """
    length = (end[0] - start[0]) or 1.0
    share = np.clip((along - start[0]) / length, 0, 1)
    centre = start[1] + share * (end[1] - start[1])
    # Rounded, so that a connection shorter than a pixel still has a line of pixels.
    first, last = np.floor(np.sort([start[0], end[0]]) + 0.5)
    within = (along >= first) & (along <= last)
    return within[:, None] & (np.abs(across - centre[:, None]) <= half_width)


def window_corners(start: Array, end: Array, half_width: float = 15.0) -> Array:
    """Return the vertices (4, 2) of the window of `level_edge`, row and col in px.

    ``start`` and ``end`` (2,) are row and col in px. Vertices 0 and 1 lie beside
    ``start``, 2 and 3 beside ``end``.
    """
    rows, cols = np.abs(end - start)
    aside = np.array([half_width, 0.0])
    if rows >= cols:
        aside = np.array([0.0, half_width])
    return np.array([start - aside, start + aside, end + aside, end - aside])
