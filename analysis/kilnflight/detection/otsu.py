"""Particles as bright regions above Otsu's threshold; the burner's flame.

Section 2.2.2, chapter 3.1 and Fig. 3.4 of the thesis.
"""

import cv2
import numpy as np

from kilnflight.arrays import Anything, Array, ArrayLike, Flags, Integers
from kilnflight.checks import (
    InputError,
    NotNegative,
    Settings,
    check_number,
    check_shape,
    real_numbers,
)

_LARGEST = 1e9  # far beyond any grey value, and safe in float32
_LEVELS = 65_536  # grey levels of 16 bits, L of Eqs 2.11 to 2.20
# px: a pixel and its four neighbours, the smallest region with an inside; ours
SMALLEST_PX = 5


def check_foreground(foreground: ArrayLike, where: str) -> Anything:
    """Return the foreground (rows, cols) in the machine's byte order.

    Half floats become float32, other types stay. ``where`` begins the error's message.

    Raises
    ------
    InputError
        If it is not 2D, holds no integers or floats, or a float is not finite or above
        1e9.
    """
    image = real_numbers(foreground, f"{where}: foreground (rows, cols)")
    check_shape(image, (None, None), f"{where}: foreground (rows, cols)")
    # numba reads neither half floats nor foreign byte orders
    if image.dtype == np.float16:
        image = image.astype(np.float32)
    image = image.astype(image.dtype.newbyteorder("="), copy=False)
    least = image.min(initial=0)  # NaN if a value is
    if (
        image.dtype.kind == "f"
        and not -_LARGEST < least <= image.max(initial=0) < _LARGEST
    ):
        row, col = np.argwhere(~(np.abs(image) < _LARGEST))[0].tolist()
        raise InputError(
            f"{where}: the foreground is {image[row, col]} at row {row}, col {col}; "
            "set such pixels to 0."
        )
    return image


def otsu_threshold(values: ArrayLike) -> int:
    """Return the grey level with the largest variance between classes (Eq. 2.19).

    Values above it are foreground, values up to it background (Eqs 2.11 and 2.12).
    `Otsu` and `flame_mask` use it.

    Parameters
    ----------
    values
        Grey values of any shape: integers, or floats, which are rounded.

    Returns
    -------
    int
        The threshold. Ties go to the lowest level: for two separate modes, the highest
        level of the lower one. If all values are equal, that value.

    Raises
    ------
    InputError
        If there are no values, one is not finite, or they span more than 16 bits.

    Notes
    -----
    The criterion does not depend on an offset, so levels are counted from the smallest
    value. `skimage.filters.threshold_otsu` sums in float32, which moves the threshold
    of a flame by some levels. Here Eq. 2.19 is evaluated in float64.

    Examples
    --------
    >>> otsu_threshold(np.array([3, 3, 4, 900, 901], np.uint16))
    4
    """
    line = np.reshape(values, (1, -1))
    levels = _rounded(check_foreground(line, "otsu_threshold: values"))[0]
    if levels.size == 0:
        raise InputError("otsu_threshold: no values; pass at least one pixel.")
    low = int(levels.min())
    high = int(levels.max())
    check_number(high - low, "otsu_threshold: range of the values", below=_LEVELS)
    if low == high:
        return low
    # Unsafe, as unsigned values of 64 bits do not fit; their differences do.
    counts = np.bincount(np.subtract(levels, low, dtype=np.intp, casting="unsafe"))
    return low + int(np.argmax(_criterion(counts)))


def _rounded(image: Anything) -> Anything:
    """Return grey values as whole numbers; halves go to the even one."""
    if image.dtype.kind == "f":
        return np.rint(image)
    return image


def _criterion(counts: Integers) -> Array:
    """Return the share eta(k) of the variance between the classes (Eqs 2.19, 2.20).

    ``counts`` (L,) is the histogram of grey levels; the first and the last must not be
    0. There is one value for each level k but the last, (L - 1,).
    """
    level = np.arange(len(counts), dtype=np.float64)
    total = counts.sum()
    p = counts / total
    omega = np.cumsum(counts)[:-1] / total
    mu = np.cumsum(counts * np.arange(len(counts)))[:-1] / total
    mean = level @ p
    variance = (level - mean) ** 2 @ p
    return (mean * omega - mu) ** 2 / (variance * omega * (1 - omega))


class Otsu(Settings):
    """Find connected regions above Otsu's threshold of the foreground.

    Parameters
    ----------
    least
        Grey values up to it are noise and count as 0; ours.

    Notes
    -----
    "No parameters require to be defined" (section 5.1.3). The thesis does not say how
    pixels above the threshold become particles. Here a region of pixels that touch,
    corners included, is one particle; regions below `SMALLEST_PX` are noise.

    Examples
    --------
    >>> foreground = np.zeros((60, 80), np.uint16)
    >>> foreground[20:29, 30:39] = 5000
    >>> Otsu()(foreground).round(1).tolist()  # row, col, radius of a disc of 81 px
    [[24.0, 34.0, 5.1]]
    """

    least: NotNegative = 0.0

    def __call__(self, foreground: ArrayLike, within: object = None) -> Array:
        """Return row, col and radius (n, 3) in px of each particle.

        Parameters
        ----------
        foreground
            (rows, cols) grey values: integers that span up to 16 bits, or floats, which
            are rounded.
        within
            Not used, as the threshold depends on every pixel; `DoG` uses it.

        Returns
        -------
        ndarray
            (n, 3) row and col of the centroid and the radius of the circle of the same
            area, in px, by row and column. None in a foreground of one grey value.

        Raises
        ------
        InputError
            If the foreground is not 2D, not of numbers or not finite, or spans more
            than 16 bits.
        """
        image = check_foreground(foreground, "Otsu")
        if image.size == 0:
            return np.empty((0, 3))
        if self.least:
            image = np.where(image > self.least, image, 0)
        above = _rounded(image) > otsu_threshold(image)
        _, _, regions, centroids = cv2.connectedComponentsWithStats(
            above.view(np.uint8), connectivity=8
        )
        area = regions[1:, cv2.CC_STAT_AREA]
        particles = np.column_stack([centroids[1:, ::-1], np.sqrt(area / np.pi)])
        particles = particles[area >= SMALLEST_PX]
        return particles[np.lexsort((particles[:, 1], particles[:, 0]))]


def flame_mask(gray: Integers, rectangle: tuple[int, int, int, int]) -> Flags:
    """Return the pixels (rows, cols) of the burner's flame (Fig. 3.4).

    They are the largest region above Otsu's threshold of a rectangle. Detection leaves
    them out.

    Parameters
    ----------
    gray
        (rows, cols), grey values of one frame.
    rectangle
        First row, row after the last, first column, column after the last, in px, as
        `kilnflight.Attributes` has checked it.

    Notes
    -----
    Section 3.1 and Fig. 3.4 segment *the* flame: one region of pixels that touch,
    corners included, within the rectangle. Particles apart from it stay. A rectangle of
    one grey value has no flame.
    """
    top, bottom, left, right = rectangle
    flame = np.zeros(gray.shape, bool)
    part = gray[top:bottom, left:right]
    above = part > otsu_threshold(part)
    _, regions = cv2.connectedComponents(above.astype(np.uint8), connectivity=8)
    if above.any():
        flame[top:bottom, left:right] = regions == np.bincount(regions[above]).argmax()
    return flame
