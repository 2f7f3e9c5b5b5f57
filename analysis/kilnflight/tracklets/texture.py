"""Laws' texture energies, which show a streak between two tracklets.

Section 4.2.3 of the thesis.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from kilnflight.checks import check_finite, check_positive, check_shape

Array = npt.NDArray[np.float64]

# Eq. 4.25, thesis: level, edge, spot, wave, ripple.
MASKS = {
    "L": np.array([1.0, 4.0, 6.0, 4.0, 1.0]),
    "E": np.array([-1.0, -2.0, 0.0, 2.0, 1.0]),
    "S": np.array([-1.0, 0.0, 2.0, 0.0, -1.0]),
    "W": np.array([-1.0, 2.0, 0.0, -2.0, 1.0]),
    "R": np.array([1.0, -4.0, 6.0, -4.0, 1.0]),
}
MARGIN = 2  # px around a window that the masks reach


class Differences(Protocol):
    """Sums of the frame differences of one recording.

    A difference is the absolute value of frame minus background.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """Return the rows and columns of the frames."""
        ...

    def __call__(
        self, first_frame: int, last_frame: int, top: int, left: int, bottom: int, right: int
    ) -> npt.NDArray[np.generic]:
        """Return the sum over frames, first to last, within a box.

        Both frames are counted. The box lies within ``shape``; the sum is (bottom - top, right -
        left). Frames that the recording does not have count as empty.
        """
        ...


def energies(window: npt.ArrayLike, inside: npt.ArrayLike | None = None) -> dict[str, float]:
    """Return the 15 texture energies of a sum of frame differences.

    Their names are "LL" to "RR" (Fig. 4.13).

    Parameters
    ----------
    window
        (rows, cols) sum of frame differences.
    inside
        (rows, cols) bool, the pixels that count; None: all.

    Raises
    ------
    InputError
        If the window is not a finite image, or ``inside`` has another shape.

    Notes
    -----
    The absolute responses of a mask and of its transpose are averaged. Their sum is divided by the
    number of pixels that are not zero. The thesis does not mention absolute values. Without them a
    streak's two edges cancel in the sum, and the two transposes on one of the diagonals. Beyond
    its border the window goes on with its outermost pixels.
    """
    image = check_finite(window, "energies: window")
    check_shape(image, (None, None), "energies: window")
    counted = np.ones(image.shape, bool) if inside is None else np.asarray(inside, dtype=np.bool_)
    check_shape(counted, image.shape, "energies: inside")
    pairs = combinations_with_replacement(MASKS, 2)
    return {a + b: _energy(image, counted, MASKS[a], MASKS[b]) for a, b in pairs}


def _energy(image: Array, inside: npt.NDArray[np.bool_], first: Array, second: Array) -> float:
    """Return the energy of a mask combination and its transpose."""
    if not inside.any():
        return 0.0
    responses = [
        cv2.sepFilter2D(image, cv2.CV_64F, along, across, borderType=cv2.BORDER_REPLICATE)
        for along, across in ((first, second), (second, first))
    ]
    values = (np.abs(responses[0]) + np.abs(responses[1]))[inside] / 2
    return float(values.sum() / max(np.count_nonzero(values), 1))


@dataclass(frozen=True)
class LevelEdge:
    """Measure the level-edge energy between two tracklets (F of Eq. 4.24).

    The window is a parallelogram. Called with two positions (row, col), the first and last frame
    to sum, and the differences. The positions are the last one of the earlier tracklet and the
    first one of the later.

    Notes
    -----
    Readings. (1) "Within the time period of the tracklets' appearance" is from the first frame of
    the pair to its last. (2) The vertices printed span a parallelogram from one position to the
    other. It is 2 w wide along the columns where the connection is at least as long along the
    rows, else along the rows. A pixel counts if its centre is inside, and the line between the
    positions has at least one. (3) The masks see the pixels around the window; beyond the image
    its outermost ones go on. Source: section 4.2.3 and Eq. 4.25, thesis.
    """

    half_width: float = 15.0  # px, w, Table 5.16

    def __post_init__(self) -> None:
        """Refuse a window without width."""
        check_positive(self.half_width, "LevelEdge: half_width")

    def __call__(
        self,
        start: tuple[float, float],
        end: tuple[float, float],
        period: tuple[int, int],
        differences: Differences,
    ) -> float:
        """Return the energy; 0 where the window lies outside the image.

        Raises
        ------
        InputError
            If ``differences`` does not return finite numbers in the shape of the box.
        """
        upright = abs(end[0] - start[0]) >= abs(end[1] - start[1])
        lying = 0 if upright else 1  # the axis along which the window runs
        shape = differences.shape
        low, high = np.minimum(start, end), np.maximum(start, end)
        low[1 - lying] -= self.half_width
        high[1 - lying] += self.half_width
        top_left = np.clip(np.floor(low) - MARGIN, 0, shape).astype(int)
        bottom_right = np.clip(np.ceil(high) + MARGIN + 1, 0, shape).astype(int)
        if (top_left >= bottom_right).any():
            return 0.0
        box = (*top_left.tolist(), *bottom_right.tolist())
        where = f"differences of frames {period[0]} to {period[1]} in {box}"
        image = check_finite(differences(*period, *box), where)
        check_shape(image, tuple((bottom_right - top_left).tolist()), where)
        inside = self._inside(np.array(start), np.array(end), lying, top_left, image.shape)
        return _energy(image, inside, MASKS["L"], MASKS["E"])

    def corners(self, start: tuple[float, float], end: tuple[float, float]) -> Array:
        """Return the vertices (4, 2) of the window, row and col, in turn around it."""
        upright = abs(end[0] - start[0]) >= abs(end[1] - start[1])
        aside = np.array([0.0, self.half_width] if upright else [self.half_width, 0.0])
        first, last = np.array(start), np.array(end)
        return np.array([first - aside, first + aside, last + aside, last - aside])

    def _inside(
        self, start: Array, end: Array, lying: int, corner: npt.NDArray[np.int_], shape: tuple
    ) -> npt.NDArray[np.bool_]:
        """Return which pixels of the box lie within the parallelogram."""
        along, across = (np.arange(shape[a]) + corner[a] for a in (lying, 1 - lying))
        first, last = sorted((start[lying], end[lying]))
        share = (along - start[lying]) / ((end[lying] - start[lying]) or 1.0)
        centre = start[1 - lying] + np.clip(share, 0, 1) * (end[1 - lying] - start[1 - lying])
        # Rounded, so that a connection shorter than a pixel still has a line of pixels.
        within = (along >= np.floor(first + 0.5)) & (along <= np.floor(last + 0.5))
        near = np.abs(across - centre[:, None]) <= self.half_width
        result: npt.NDArray[np.bool_] = within[:, None] & near
        return result if lying == 0 else result.T
