"""Particles as bright regions above Otsu's threshold.

Section 2.2.2 of the thesis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_count

Array = npt.NDArray[np.float64]

LARGEST = 1e9  # far beyond any grey value, and safe in float32
LEVELS = 65_536  # grey levels of 16 bits, L of Eqs 2.11 to 2.20


def check_foreground(foreground: npt.NDArray[np.generic], where: str) -> npt.NDArray[Any]:
    """Return the foreground as an array, or raise an `InputError`.

    Raises
    ------
    InputError
        If it is not 2D, is not made of integers or floats, or a float is not finite (or
        beyond any grey value).
    """
    image = np.asarray(foreground)
    if image.ndim != 2:
        raise InputError(f"{where}: the foreground has shape {image.shape}; pass (rows, cols).")
    if image.dtype.kind not in "uif":
        raise InputError(f"{where}: the foreground is of {image.dtype}; pass integers or floats.")
    # compiled code takes the machine's byte order, and no half floats
    kind = np.dtype(np.float32) if image.dtype == np.float16 else image.dtype.newbyteorder("=")
    image = image.astype(kind, copy=False)
    least, most = (image.min(), image.max()) if image.size else (0, 0)  # NaN if one is
    if image.dtype.kind == "f" and not -LARGEST < least <= most < LARGEST:
        row, col = (int(i) for i in np.argwhere(~(np.abs(image) < LARGEST))[0])
        raise InputError(
            f"{where}: the foreground is {image[row, col]} at row {row}, col {col}; "
            "set such pixels to 0 before the call."
        )
    return image


def otsu_threshold(values: npt.NDArray[np.generic]) -> int:
    """Return the grey level k that maximises the criterion of Eq. 2.19.

    Values above it are foreground, values up to it background (Eqs 2.11 and 2.12).

    Parameters
    ----------
    values
        Grey values of any shape, for instance an image or the rectangle of the flame;
        16-bit integers, or floats, which are rounded to whole grey values.

    Returns
    -------
    int
        The threshold. If several levels have the same criterion, the lowest: between
        two heaps with nothing in between, the top of the lower one. If all values are
        equal, that value, so that nothing is above it.

    Raises
    ------
    InputError
        If there are no values, a float is not finite, or they span more than 16 bits.

    Notes
    -----
    A constant added to all grey values does not change the criterion, so levels are counted from
    the smallest value. `skimage.filters.threshold_otsu` sums in float32, which moves the threshold
    of a frame's flame by some levels; so Eq. 2.19 stands here in float64.

    Examples
    --------
    >>> otsu_threshold(np.array([3, 3, 4, 900, 901], dtype=np.uint16))
    4
    """
    line = check_foreground(np.asarray(values).reshape(1, -1), "otsu_threshold")[0]
    if line.size == 0:
        raise InputError("otsu_threshold: there are no values; pass at least one pixel.")
    levels = line if line.dtype.kind in "ui" else np.rint(line)  # halves go to the even
    low, high = int(levels.min()), int(levels.max())
    if high - low >= LEVELS:
        raise InputError(
            f"otsu_threshold: values from {low} to {high} span more than {LEVELS} grey levels; "
            "scale them to 16 bits."
        )
    if low == high:
        return low
    counts = np.bincount((levels - levels.min()).astype(np.int32))
    return low + int(np.argmax(criterion(counts)))


def criterion(counts: npt.NDArray[np.int64]) -> Array:
    """Return eta(k) of Eq. 2.19 for each level k but the last (Eq. 2.20).

    Parameters
    ----------
    counts
        (L,) pixels per level; the first and the last level are occupied.
    """
    level = np.arange(len(counts), dtype=np.float64)
    p = counts / counts.sum()
    omega = np.cumsum(counts)[:-1] / counts.sum()
    mu = np.cumsum(counts * np.arange(len(counts)))[:-1] / counts.sum()
    mean = float(level @ p)
    variance = float((level - mean) ** 2 @ p)
    return (mean * omega - mu) ** 2 / (variance * omega * (1 - omega))


@dataclass(frozen=True)
class Otsu:
    """Find connected regions above Otsu's threshold of the foreground.

    Parameters
    ----------
    smallest_px
        Pixels that a region must have to be a particle.

    Notes
    -----
    "No parameters require to be defined" (section 5.1.3): the threshold has none. The thesis does
    not say how pixels above it become particles. Here a region of pixels that touch, corners
    included, is one particle. Single noisy pixels are no particles. 5 px is a pixel with its four
    neighbours, the smallest region that has an inside (the text speaks of tiny particles "with
    several pixels in size").
    """

    smallest_px: int = 5

    def __post_init__(self) -> None:
        """Refuse a size below one pixel."""
        check_count(self.smallest_px, "Otsu smallest_px")

    def __call__(self, foreground: npt.NDArray[np.generic], _within: object = None) -> Array:
        """Return the particles in a foreground.

        Parameters
        ----------
        foreground
            (rows, cols) 16-bit grey values, or floats, which are rounded. A polygon has no effect,
            since the threshold depends on every pixel.

        Returns
        -------
        ndarray
            (n, 3) row and col of the centroid and the radius of the circle of the same
            area, in px, by row and column. None in a foreground of one grey value.

        Raises
        ------
        InputError
            If the foreground is not 2D, not of numbers or not finite, or spans more than
            16 bits.
        """
        image = check_foreground(foreground, "Otsu")
        if image.size == 0:
            return np.empty((0, 3))
        rounded = image if image.dtype.kind in "ui" else np.rint(image)
        above = rounded > otsu_threshold(image)
        _, _, regions, centroids = cv2.connectedComponentsWithStats(
            above.view(np.uint8), connectivity=8
        )
        area = regions[1:, cv2.CC_STAT_AREA]
        particles = np.column_stack([centroids[1:, ::-1], np.sqrt(area / np.pi)])
        particles = particles[area >= self.smallest_px]
        return particles[np.lexsort((particles[:, 1], particles[:, 0]))]
