"""Temperature profile of the kiln's wall from an infrared picture (thesis, Fig. 2.4).

A strip of the wall appears as a trapezoid, narrow where it is far. A projective transform
makes a rectangle of it, and the mean of each row is the profile along the kiln.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_finite

Array = npt.NDArray[np.float64]
Corners = tuple[tuple[float, float], ...]


def equalize(picture: npt.NDArray[np.generic], corners: Corners, rows: int, columns: int) -> Array:
    """Return a trapezoid of a picture as a rectangle.

    Parameters
    ----------
    picture
        (rows, columns) of the infrared camera, for example temperatures.
    corners
        Four corners (row, col) of the trapezoid: far left, far right, near right, near left.
    rows, columns
        Size of the rectangle; row 0 is the far end.

    Returns
    -------
    ndarray
        (rows, columns), interpolated linearly.

    Raises
    ------
    InputError
        If there are not four corners, they do not make a convex area in this order, or one
        lies outside the picture.
    """
    values = check_finite(picture, "infrared picture").astype(np.float32)
    if values.ndim != 2 or len(corners) != 4:
        raise InputError(
            f"a picture of shape {values.shape} and {len(corners)} corners: pass one picture and "
            "four corners (row, col)."
        )
    given = np.array(corners, dtype=np.float32)
    if (given < 0).any() or (given > np.array(values.shape) - 1).any():
        raise InputError(f"corners {corners} leave the picture of {values.shape}; keep inside.")
    sides = np.roll(given, -1, axis=0) - given
    following = np.roll(sides, -1, axis=0)
    turns = sides[:, 0] * following[:, 1] - sides[:, 1] * following[:, 0]
    if not ((turns < 0).all() or (turns > 0).all()):
        raise InputError(f"corners {corners} make no convex area in this order; go around once.")
    target = [(0, 0), (columns - 1, 0), (columns - 1, rows - 1), (0, rows - 1)]
    transform = cv2.getPerspectiveTransform(
        given[:, ::-1].copy(), np.array(target, dtype=np.float32)
    )
    return cv2.warpPerspective(values, transform, (columns, rows)).astype(np.float64)


def wall_profile(
    picture: npt.NDArray[np.generic], corners: Corners, rows: int = 200, columns: int = 100
) -> Array:
    """Return the mean of each row of the equalised trapezoid, (rows,), far end first.

    Rows are evenly spaced on the wall if the trapezoid is a strip of constant width seen in
    perspective.
    """
    return equalize(picture, corners, rows, columns).mean(axis=1)
