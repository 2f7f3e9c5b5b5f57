"""The burner's flame, removed from images before detection.

Chapter 3.1 and Fig. 3.4 of the thesis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError
from kilnflight.detection.otsu import otsu_threshold

Rectangle = tuple[int, int, int, int]


class Flame(NamedTuple):
    """The flame's pixels in a rectangle of the image."""

    rectangle: Rectangle  # first row, row after the last, first column, column after the last
    mask: npt.NDArray[np.bool_]  # (rows, cols) of the rectangle

    def cover(self, image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return a copy of a foreground (rows, cols), 0 in the flame."""
        cleared = image.copy()
        self.clear(cleared)
        return cleared

    def clear(self, image: npt.NDArray[np.float32]) -> None:
        """Set the flame's pixels of a foreground to 0, in place."""
        top, bottom, left, right = self.rectangle
        image[top:bottom, left:right][self.mask] = 0

    def holds(self, pixels: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
        """Return whether each pixel (n, 2) of row and col is flame."""
        top, bottom, left, right = self.rectangle
        row, col = pixels[:, 0], pixels[:, 1]
        inside = (row >= top) & (row < bottom) & (col >= left) & (col < right)
        flame = np.zeros(len(pixels), dtype=bool)
        flame[inside] = self.mask[row[inside] - top, col[inside] - left]
        return flame


def segment_flame(gray: npt.NDArray[np.uint16], rectangle: Rectangle) -> Flame:
    """Return the flame: pixels above Otsu's threshold of a rectangle.

    Parameters
    ----------
    gray
        (rows, cols), one frame.
    rectangle
        First row, row after the last, first column, column after the last.

    Notes
    -----
    Otsu's method splits any picture, so a rectangle without a flame loses its brighter half;
    draw one only where a flame is. A rectangle of one grey value has no flame.
    """
    top, bottom, left, right = rectangle
    if not (0 <= top < bottom <= gray.shape[0] and 0 <= left < right <= gray.shape[1]):
        raise InputError(
            f"segment_flame: rectangle {rectangle} is not inside the image of "
            f"{gray.shape[0]} x {gray.shape[1]}; give row0 < row1 and col0 < col1."
        )
    part = gray[top:bottom, left:right]
    return Flame(rectangle, part > otsu_threshold(part))
