"""From pixels to millimetres on the belt, by the belt's corners (2016 paper, section IV.B)."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from kilnflight.belt.area import BELT, Area
from kilnflight.belt.corners import Corners
from kilnflight.checks import InputError, check_finite, check_shape

Array = npt.NDArray[np.float64]
Window = tuple[slice, slice]


class Calibration(NamedTuple):
    """A plane-to-plane mapping (homography) and how well it is known."""

    matrix: Array  # (3, 3), (col, row, 1) to (x, y, 1) up to a factor
    error_mm: float  # largest standard error of a corner, on the belt
    mm_per_px: float  # mean over the belt's edges
    hidden: int  # corners that were not seen themselves

    def millimetres(self, places: Array) -> Array:
        """Return x and y (n, 2) of row and col (n, 2)."""
        check_shape(places, (None, 2), "places (row, col)")
        whole = np.column_stack([places[:, 1], places[:, 0], np.ones(len(places))])
        mapped = whole @ self.matrix.T
        return mapped[:, :2] / mapped[:, 2:]

    def pixels(self, places: Array) -> Array:
        """Return row and col (n, 2) of x and y (n, 2) on the belt."""
        check_shape(places, (None, 2), "places (x, y)")
        mapped = np.column_stack([places, np.ones(len(places))]) @ np.linalg.inv(self.matrix).T
        return (mapped[:, :2] / mapped[:, 2:])[:, ::-1]

    def window(self, area: Area, margin_px: float, shape: tuple[int, int]) -> Window:
        """Return the rows and columns of a picture that show an area and a margin."""
        corners = self.pixels(area.corners)
        low = np.floor(corners.min(axis=0) - margin_px).astype(int)
        high = np.ceil(corners.max(axis=0) + margin_px).astype(int) + 1
        rows, cols = (
            slice(max(0, int(first)), min(length, int(last)))
            for first, last, length in zip(low, high, shape, strict=True)
        )
        return rows, cols


def calibrate(corners: Corners, belt: Area = BELT) -> Calibration:
    """Return the mapping of the corners found onto the belt's known corners.

    Parameters
    ----------
    corners
        From `kilnflight.belt.corners.FindCorners`.
    belt
        Where these corners are known to lie, in mm.

    Raises
    ------
    InputError
        If three corners lie on one line, or numbers are not finite.

    Notes
    -----
    Four corners fix the eight numbers of a homography, so that nothing is left over to judge
    it by; the error reported is that of the corners, from the scatter of the edges' points.
    It knows nothing of what is no error of the corners: a particle's centre lies above the
    belt, and a camera at the height h shows what is z higher z / h farther from the middle.
    """
    found = check_finite(corners.places, "corners")
    check_shape(found, (4, 2), "corners")
    for k in range(4):
        a, b, c = found[k - 2], found[k - 1], found[k]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) < 1.0:
            raise InputError(f"three corners of the belt lie on one line: {a}, {b}, {c} px.")
    matrix = cv2.getPerspectiveTransform(
        found[:, ::-1].astype(np.float32), belt.corners.astype(np.float32)
    )
    edges = [np.roll(one, -1, axis=0) - one for one in (belt.corners, found)]
    lengths = [np.linalg.norm(one, axis=1).sum() for one in edges]
    scale = float(lengths[0] / lengths[1])
    error = scale * float(corners.spread_px.max())
    return Calibration(np.asarray(matrix, np.float64), error, scale, int(corners.hidden.sum()))
