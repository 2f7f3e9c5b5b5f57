"""Calibration of the plenoptic camera's depth.

The plenoptic camera reports a captured depth. A test plate at 1, 2, ..., 11 m showed
that it is off by a few decimetres, differently in three ranges. Eq. 2.4 maps captured
to true depth with one quadratic per range (section 2.1.5, thesis). It is that camera's:
a recording says which calibration its depths need, and none is applied unasked. Depths
are in mm.
"""

from dataclasses import replace
from itertools import pairwise, zip_longest
from typing import Any, Self

import numpy as np

from kilnflight.arrays import Array, ArrayLike, Index
from kilnflight.checks import InputError, Number, Settings, check_finite


class DepthCalibration(Settings):
    """Map captured to true depth by one polynomial per segment.

    Parameters
    ----------
    breakpoints_mm
        Captured depths at which the segment changes, ascending; one fewer than
        segments.
    coefficients
        Per segment, of mm to mm, highest power first (as `numpy.polyval` takes them).
    closed_left
        Per breakpoint: whether the breakpoint itself belongs to the segment above it;
        empty: all do. Eq. 2.4 gives both 3000 and 5000 mm to the middle segment.

    Examples
    --------
    >>> DepthCalibration.from_table([(1000, 1500), (2000, 2000)])([1000, 3000]).tolist()
    [1500.0, 2500.0]
    """

    breakpoints_mm: tuple[Number, ...]
    coefficients: tuple[tuple[Number, ...], ...]
    closed_left: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        ascending = all(low < high for low, high in pairwise(self.breakpoints_mm))
        count = len(self.breakpoints_mm)
        one_each = len(self.closed_left) in (0, count)
        if not (ascending and one_each and len(self.coefficients) == count + 1):
            raise InputError(
                "depth calibration: breakpoints ascend, one fewer than polynomials, "
                "each with its closed_left or none."
            )

    @classmethod
    def from_table(cls, pairs: ArrayLike) -> Self:
        """Return straight lines between measured depths, extended beyond them.

        Parameters
        ----------
        pairs
            (n, 2) captured and true depth of a plate at n distances, at least two, mm.

        Raises
        ------
        InputError
            If there are fewer than two, or the true depth does not increase with the
            captured one.
        """
        table = check_finite(pairs, "depth table", (None, 2))
        table = table[np.argsort(table[:, 0], kind="stable")]
        steps = np.diff(table, axis=0)
        if len(steps) < 1 or (steps <= 0).any():
            raise InputError(
                "depth table: two or more pairs (captured, true), both ascending."
            )
        slopes = steps[:, 1] / steps[:, 0]
        lines = np.column_stack([slopes, table[:-1, 1] - slopes * table[:-1, 0]])
        return cls(tuple(table[1:-1, 0].tolist()), tuple(map(tuple, lines.tolist())))

    def segment(self, captured_mm: ArrayLike) -> Index:
        """Return the segment of each captured depth in mm, in its shape.

        Segments are numbered 0, 1, ... by ascending depth.
        """
        depth = np.asarray(captured_mm, float)
        closed = self.closed_left or (True,) * len(self.breakpoints_mm)
        index = np.zeros(depth.shape, np.intp)
        for point, left in zip(self.breakpoints_mm, closed, strict=True):
            index += (depth >= point) if left else (depth > point)
        return index

    def __call__(self, captured_mm: ArrayLike) -> Array:
        """Return the true depth of each captured depth in mm, in its shape."""
        depth = check_finite(captured_mm, "captured depth")
        index = self.segment(depth)
        lowest_first = (powers[::-1] for powers in self.coefficients)
        true = np.zeros_like(depth)
        for powers in reversed([*zip_longest(*lowest_first, fillvalue=0.0)]):
            true = true * depth + np.take(powers, index)
        return true

    def jumps(self) -> Array:
        """Return right minus left limit at each breakpoint, (n,) in mm."""
        ends = zip(pairwise(self.coefficients), self.breakpoints_mm, strict=True)
        return np.array([np.polyval(b, at) - np.polyval(a, at) for (a, b), at in ends])

    def falling(self, low_mm: float, high_mm: float) -> Array:
        """Return the captured depths in mm at which the calibrated depth falls, (n,).

        They lie between ``low_mm`` and ``high_mm``, in steps of 0.1 mm. A
        calibration that falls gives two particles in the wrong order of depth. Jumps
        between segments are left to `jumps`.
        """
        depth = np.arange(low_mm, high_mm, 0.1)
        slopes = tuple(tuple(np.polyder(np.array(c))) for c in self.coefficients)
        return depth[replace(self, coefficients=slopes)(depth) < 0]


# Eq. 2.4, thesis section 2.1.5, as printed. z is the captured depth in mm.
EQUATION_2_4 = DepthCalibration(
    breakpoints_mm=(3000.0, 5000.0),
    coefficients=(
        (-0.002055, 10.65, -10230.0),
        (-0.00004158, 1.367, -857.5),
        (0.00004504, 0.3219, 2189.0),
    ),
    closed_left=(True, False),
)

_BY_NAME = {"none": None, "zhang-2023": EQUATION_2_4}  # a recording may name these

# The plate stood at 1 m to 11 m; beyond them Eq. 2.4 extrapolates.
PLATE_DISTANCES_MM = tuple(1000.0 * metre for metre in range(1, 12))


def read_calibration(stated: Any) -> DepthCalibration | None:
    """Return the depth calibration that a recording states.

    Parameters
    ----------
    stated
        None or ``"none"``: depths are true as they are. ``"zhang-2023"``: Eq. 2.4.
        Pairs of captured and true depth, in mm: see `DepthCalibration.from_table`. A
        mapping with ``breakpoints_mm`` and ``coefficients``: the fields of
        `DepthCalibration`.

    Raises
    ------
    InputError
        If it is none of these.
    """
    if stated is None or isinstance(stated, DepthCalibration):
        return stated
    if isinstance(stated, str) and stated in _BY_NAME:
        return _BY_NAME[stated]
    if isinstance(stated, list | tuple):
        return DepthCalibration.from_table(stated)
    try:
        return DepthCalibration(
            breakpoints_mm=tuple(stated["breakpoints_mm"]),
            coefficients=tuple(map(tuple, stated["coefficients"])),
            closed_left=tuple(stated.get("closed_left", ())),
        )
    except (TypeError, KeyError, AttributeError):
        known = f"{', '.join(_BY_NAME)}, pairs, or breakpoints_mm with coefficients"
        raise InputError(f"depth_calibration: {stated!r} is not {known}.") from None


def calibrate_depth(z: ArrayLike) -> Array:
    """Return the true depth of captured depths by Eq. 2.4 of the thesis.

    Parameters
    ----------
    z
        Captured depth in mm, any shape.

    Returns
    -------
    ndarray
        Calibrated depth in mm. The equation is evaluated as printed everywhere. It was
        fitted to plates from 1 m to 11 m, falls between 2591 and 3000 mm and is
        negative below 1274 mm (see notebook 02).

    Raises
    ------
    InputError
        If a depth is not finite (a pixel without depth has no row in a point cloud).

    Examples
    --------
    >>> calibrate_depth([4053.1, 10071.8]).round(0).tolist()
    [4000.0, 10000.0]
    """
    return EQUATION_2_4(z)


def captured_depths(true_mm: float) -> list[float]:
    """Return all captured depths of a true depth by Eq. 2.4, both in mm, ascending.

    There may be none or several: both 2065 and 3118 mm become 3 m.
    """
    found: list[float] = []
    for index, coefficients in enumerate(EQUATION_2_4.coefficients):
        roots = np.roots([*coefficients[:-1], coefficients[-1] - true_mm])
        real = roots[np.abs(roots.imag) < 1e-9 * np.abs(roots)].real
        found += real[(real > 0) & (EQUATION_2_4.segment(real) == index)].tolist()
    return sorted(found)


def invert_depth(true_mm: ArrayLike) -> Array:
    """Return the captured depth of each true depth by Eq. 2.4 in mm, in the same shape.

    Of several solutions it is the one nearest to the true depth, as in section 2.1.5
    ("the median depth from 3 m to 5 m is very close to the actual value").

    Raises
    ------
    InputError
        If a depth is not finite or no captured depth leads to it.
    """
    true = check_finite(true_mm, "true depth")
    nearest = []
    for depth in true.flat:
        solutions = captured_depths(depth)
        if not solutions:
            raise InputError(f"true depth: no captured depth gives {depth} mm.")
        nearest.append(solutions[np.argmin(np.abs(np.subtract(solutions, depth)))])
    return np.reshape(nearest, true.shape)


def calibrate_points(
    captured_mm: ArrayLike,
    calibration: DepthCalibration | None,
    where: str = "captured points",
) -> Array:
    """Return points (n, 3) x, y, z with their true depth, in mm.

    Parameters
    ----------
    captured_mm
        (n, 3) x, y, z in camera coordinates as captured.
    calibration
        That of the recording's camera (`Attributes.depth_calibration`); None: depths
        are true as captured.
    where
        Begins the message of an error.

    Raises
    ------
    InputError
        If a point is behind the camera, as captured or by the calibration.

    Notes
    -----
    The thesis calibrates depth and does not say what becomes of x and y. A point
    belongs to a pixel, so it stays on that pixel's ray: x and y change in proportion to
    z.
    """
    points = check_finite(captured_mm, where, (None, 3))
    depth = points[:, 2].copy()  # along narrow rows numpy is slow
    if not (depth > 0).all():
        raise InputError(
            f"{where}: point {np.argmin(depth)} has depth {depth.min():g} mm."
        )
    if calibration is None:
        return points
    true = calibration(depth)
    if not (true > 0).all():
        raise InputError(
            f"{where}: the recording's depth calibration makes {true.min():.0f} mm of "
            f"{depth[true.argmin()]:.0f} mm. Each camera has its own: state the one of "
            "this camera."
        )
    return points * (true / depth)[:, None]
