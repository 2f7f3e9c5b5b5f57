"""The region of interest, a polygon in the picture."""

import cv2
import numpy as np

from kilnflight.arrays import Array, ArrayLike, Flags, Index
from kilnflight.checks import InputError, check_finite, check_shape


def check_polygon(polygon: ArrayLike, where: str = "polygon") -> Array:
    """Return the corners (n, 2) of a polygon, row and col in px.

    Raises
    ------
    InputError
        As `inside`. A corner 10^7 px away is an error, too: to draw it takes seconds.
    """
    corners = check_finite(polygon, where, (None, 2), most=1e7)
    if len(corners) < 3 or np.linalg.matrix_rank(corners - corners[0]) < 2:
        raise InputError(
            f"{where}: pass three or more corners (row, col), not all in one line."
        )
    return corners


def inside(polygon: ArrayLike, row: ArrayLike, col: ArrayLike) -> Flags:
    """Return whether each pixel lies in a polygon, such as the region of interest.

    The result has the shape of ``row`` and ``col``; one of them may be a number.

    Parameters
    ----------
    polygon
        (n, 2) row, col of its corners in px and in order, such as
        `kilnflight.recording.frames.Attributes.roi`; the last is joined to the first.
    row, col
        Places in px, whole or not.

    Raises
    ------
    InputError
        If the polygon has fewer than three different corners or no extent, or a number
        is not finite.

    Notes
    -----
    The thesis excludes "the particles outside the polygon", so its border counts as
    inside. A polygon that crosses itself is filled by the even-odd rule.

    Examples
    --------
    >>> inside([(0, 0), (0, 9), (9, 0)], [1, 8, 0], [1, 8, 4]).tolist()
    [True, False, True]
    """
    contour = check_polygon(polygon).astype(np.float32)
    r = check_finite(row, "row")
    c = check_finite(col, "col")
    check_shape(c, r.shape if r.ndim and c.ndim else c.shape, "col")
    places = np.broadcast(r, c)
    side = [cv2.pointPolygonTest(contour, place, measureDist=False) for place in places]
    return np.greater_equal(side, 0).reshape(places.shape)


def within(roi: ArrayLike | None, places: Array) -> Index:
    """Return the row numbers of the places (n, 2) in the region of interest (k, 2)."""
    if roi is None:
        return np.arange(len(places))
    return np.flatnonzero(inside(roi, places[:, 0], places[:, 1]))
