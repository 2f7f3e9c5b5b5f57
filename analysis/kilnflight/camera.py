"""Depth calibration of the plenoptic camera (thesis, section 2.1.5).

The camera reports a captured depth; a test plate at 1, 2, ..., 11 m showed that it is
off by a few decimetres, differently in three ranges. Eq. 2.4 maps captured to true
depth with one quadratic per range. All depths are in millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.linalg import null_space

from kilnflight.checks import InputError, check_finite, check_shape

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class DepthCalibration:
    """Polynomials from captured to true depth, one per segment of the captured depth.

    Parameters
    ----------
    breakpoints_mm
        Captured depths at which the segment changes, ascending; one fewer than segments.
    coefficients
        Per segment, highest power first (as `numpy.polyval` takes them), in mm.
    closed_left
        Per breakpoint: whether the breakpoint itself belongs to the segment above it.
        Eq. 2.4 gives both 3000 and 5000 mm to the middle segment.
    """

    breakpoints_mm: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    closed_left: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        """Refuse breakpoints that do not ascend, and a number of segments that does not fit."""
        if any(high <= low for low, high in pairwise(self.breakpoints_mm)):
            raise InputError(f"breakpoints {self.breakpoints_mm} do not ascend; sort them.")
        if len(self.coefficients) != len(self.breakpoints_mm) + 1:
            raise InputError(
                f"{len(self.breakpoints_mm)} breakpoints make {len(self.breakpoints_mm) + 1} "
                f"segments, but there are {len(self.coefficients)} polynomials."
            )

    def segment(self, captured_mm: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Return the segment of each captured depth."""
        depth = np.asarray(captured_mm, dtype=np.float64)
        closed = self.closed_left or (True,) * len(self.breakpoints_mm)
        index = np.zeros(depth.shape, dtype=np.intp)
        for point, left in zip(self.breakpoints_mm, closed, strict=True):
            index += (depth >= point) if left else (depth > point)
        return index

    def __call__(self, captured_mm: npt.ArrayLike) -> Array:
        """Return the calibrated depth, in mm, in the shape of ``captured_mm``."""
        depth = check_finite(captured_mm, "captured depth")
        segment, found = self.segment(depth), np.empty(depth.shape)
        for index, coefficients in enumerate(self.coefficients):
            here = segment == index
            found[here] = np.polyval(coefficients, depth[here])
        return found

    def jumps(self) -> Array:
        """Return right limit minus left limit at each breakpoint, in mm."""
        return np.array(
            [
                np.polyval(right, point) - np.polyval(left, point)
                for point, (left, right) in zip(
                    self.breakpoints_mm, pairwise(self.coefficients), strict=True
                )
            ]
        )

    def falling(self, low_mm: float, high_mm: float, step_mm: float = 0.1) -> Array:
        """Return the captured depths in [low, high] at which the calibrated depth falls.

        A calibration that falls gives two particles in the wrong order of depth. The
        slope is evaluated on a grid; jumps are reported by `jumps`.
        """
        depth = np.arange(low_mm, high_mm, step_mm)
        slopes = np.stack([np.polyval(np.polyder(np.array(c)), depth) for c in self.coefficients])
        return depth[np.take_along_axis(slopes, self.segment(depth)[None], axis=0)[0] < 0]


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

# The plate stood at 1 m to 11 m; beyond what was seen at those ends Eq. 2.4 extrapolates.
PLATE_DISTANCES_MM = tuple(1000.0 * metre for metre in range(1, 12))


def calibrate_depth(z: npt.ArrayLike) -> Array:
    """Return the true depth of captured depths by Eq. 2.4 of the thesis.

    Parameters
    ----------
    z
        Captured depth in mm, any shape.

    Returns
    -------
    ndarray
        Calibrated depth in mm. The equation is evaluated as printed everywhere; it was
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


def captured_depths(true_mm: float, calibration: DepthCalibration = EQUATION_2_4) -> list[float]:
    """Return every captured depth that the calibration maps to ``true_mm``, ascending.

    Eq. 2.4 is not one to one: a true depth of 3 m is reached from 2065 and 3118 mm.
    """
    solutions = []
    for index, coefficients in enumerate(calibration.coefficients):
        polynomial = np.array(coefficients, dtype=np.float64)
        polynomial[-1] -= true_mm
        roots = np.roots(polynomial)
        real = roots[np.abs(roots.imag) < 1e-9 * np.abs(roots)].real
        solutions += [float(z) for z in real if z > 0 and calibration.segment(z) == index]
    return sorted(solutions)


def invert_depth(true_mm: npt.ArrayLike, calibration: DepthCalibration = EQUATION_2_4) -> Array:
    """Return the captured depth of true depths: the solution nearest to the true depth.

    The rule settles the ambiguity as the text does ("the median depth from 3 m to 5 m is
    very close to the actual value").

    Raises
    ------
    InputError
        If a depth is not finite or no captured depth leads to it.
    """
    true = check_finite(true_mm, "true depth")
    captured = np.empty(true.shape)
    for index, depth in np.ndenumerate(true):
        solutions = captured_depths(float(depth), calibration)
        if not solutions:
            raise InputError(f"no captured depth gives {depth} mm; the calibration skips it.")
        captured[index] = min(solutions, key=lambda z: abs(z - float(depth)))
    return captured


def fit_depth_segments(
    captured_mm: npt.ArrayLike,
    true_mm: npt.ArrayLike,
    breakpoints_mm: tuple[float, ...] = (3000.0, 5000.0),
    degree: int = 2,
    *,
    continuous: bool = False,
) -> DepthCalibration:
    """Fit one polynomial per segment of the captured depth, as led to Eq. 2.4.

    Least squares of the true on the captured depth. With ``continuous`` the polynomials
    are fitted together, under the condition that neighbours agree at the breakpoints
    (solved in the null space of that condition).

    Parameters
    ----------
    captured_mm, true_mm
        Captured depth of plate points and the distance of their plate, (n,) each.
    breakpoints_mm
        Borders between segments, ascending; Eq. 2.4 has 3000 and 5000 mm.
    degree
        Of every polynomial; Eq. 2.4 has 2.
    continuous
        Whether the result may jump at a breakpoint (Eq. 2.4 does, by -356 mm).

    Raises
    ------
    InputError
        If the arrays differ in shape, breakpoints do not ascend, or the points do not
        determine the coefficients (each segment needs ``degree + 1`` different captured
        depths; fewer with ``continuous``, where the neighbours lend theirs).
    """
    captured = check_finite(captured_mm, "captured depth").ravel()
    true = check_finite(true_mm, "true depth").ravel()
    if captured.shape != true.shape:
        raise InputError(f"{captured.size} captured depths, but {true.size} true ones; pair them.")
    if not isinstance(degree, int) or degree < 0:
        raise InputError(f"degree {degree!r}: a polynomial's degree is a whole number from 0.")
    frame = DepthCalibration(tuple(breakpoints_mm), ((0.0,),) * (len(breakpoints_mm) + 1))
    segment = frame.segment(captured)
    scale = 1000.0  # metres inside, so that powers stay of one size
    powers = np.vander(captured / scale, degree + 1)
    design = np.zeros((captured.size, (degree + 1) * len(frame.coefficients)))
    for index in range(len(frame.coefficients)):
        columns = slice(index * (degree + 1), (index + 1) * (degree + 1))
        design[segment == index, columns] = powers[segment == index]
    basis = _continuity(frame.breakpoints_mm, degree, scale) if continuous else None
    free = design if basis is None else design @ basis
    solution, _, rank, _ = np.linalg.lstsq(free, true, rcond=None)
    if rank < free.shape[1]:
        counts = [len(np.unique(captured[segment == i])) for i in range(len(frame.coefficients))]
        raise InputError(
            f"the points do not determine {free.shape[1]} coefficients: the segments hold "
            f"{counts} different captured depths. Add plates, lower the degree, or join segments."
        )
    fitted = (solution if basis is None else basis @ solution).reshape(-1, degree + 1)
    fitted /= scale ** np.arange(degree, -1, -1)
    return DepthCalibration(frame.breakpoints_mm, tuple(tuple(map(float, c)) for c in fitted))


def _continuity(breakpoints_mm: tuple[float, ...], degree: int, scale: float) -> Array:
    """Return a basis of the coefficients whose segments agree at every breakpoint."""
    size = degree + 1
    conditions = np.zeros((len(breakpoints_mm), size * (len(breakpoints_mm) + 1)))
    for row, point in enumerate(breakpoints_mm):
        powers = np.vander([point / scale], size)[0]
        conditions[row, row * size : (row + 1) * size] = powers
        conditions[row, (row + 1) * size : (row + 2) * size] = -powers
    return null_space(conditions) if len(breakpoints_mm) else np.eye(size)


def calibrate_points(captured_mm: npt.ArrayLike) -> Array:
    """Return points (n, 3) with their depth after Eq. 2.4, in mm.

    Parameters
    ----------
    captured_mm
        (n, 3) x, y, z in camera coordinates as captured.

    Notes
    -----
    The thesis calibrates depth and does not say what becomes of x and y. A point belongs to
    a pixel, so it stays on that pixel's ray: x and y change in proportion to z.
    """
    points = check_finite(captured_mm, "captured points")
    if points.size == 0:
        return np.empty((0, 3))
    check_shape(points, (None, 3), "captured points")
    depth = points[:, 2:]
    if not (depth > 0).all():
        raise InputError(
            f"captured points: point {int(np.argmin(depth))} has depth {depth.min():g} mm; the "
            "camera sees what is before it (z above 0)."
        )
    return points * (calibrate_depth(depth) / depth)


def inside(
    polygon: npt.ArrayLike,
    row: npt.ArrayLike,
    col: npt.ArrayLike,
    shape: tuple[int, int] | None = None,
) -> npt.NDArray[np.bool_]:
    """Return which pixels lie in a region of interest, in the shape of ``row`` and ``col``.

    Parameters
    ----------
    polygon
        (n, 2) row, col of its corners in order, as `frames.Attributes.roi`; the
        last is joined to the first.
    row, col
        Pixels, whole or not.
    shape
        Rows and columns of the image, to refuse a polygon beside it.

    Raises
    ------
    InputError
        If the polygon has fewer than three different corners or no extent, lies beside the
        image, or a number is not finite.

    Notes
    -----
    The thesis excludes "the particles outside the polygon", so its border counts as inside.
    A polygon that crosses itself is filled by the even-odd rule.

    Examples
    --------
    >>> inside([(0, 0), (0, 9), (9, 0)], [1, 8, 0], [1, 8, 4]).tolist()
    [True, False, True]
    """
    corners = _corners(polygon, shape)
    r, c = np.broadcast_arrays(check_finite(row, "row"), check_finite(col, "col"))
    odd = np.zeros(r.shape, dtype=bool)
    border = np.zeros(r.shape, dtype=bool)
    for (r0, c0), (r1, c1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side = (c1 - c0) * (r - r0) - (r1 - r0) * (c - c0)
        border |= (
            (side == 0)
            & (np.minimum(r0, r1) <= r)
            & (r <= np.maximum(r0, r1))
            & (np.minimum(c0, c1) <= c)
            & (c <= np.maximum(c0, c1))
        )
        # An edge counts if it spans the row (one end included) to the right of the pixel.
        odd ^= ((r0 <= r) != (r1 <= r)) & ((side > 0) == (r1 > r0)) & (side != 0)
    return odd | border


def _corners(polygon: npt.ArrayLike, shape: tuple[int, int] | None) -> Array:
    """Return the corners (n, 2) of a polygon, or raise an `InputError`."""
    corners = check_finite(polygon, "polygon")
    check_shape(corners, (None, 2), "polygon")
    if len(np.unique(corners, axis=0)) < 3:
        raise InputError(
            f"polygon: {len(np.unique(corners, axis=0))} different corner(s); a region of interest "
            "has three or more (row, col)."
        )
    if np.linalg.matrix_rank(corners - corners[0]) < 2:
        raise InputError("polygon: its corners are in one line; it encloses nothing.")
    if shape is not None:
        low, high = corners.min(axis=0), corners.max(axis=0)
        if (high < 0).any() or (low > np.array(shape) - 1).any():
            raise InputError(
                f"polygon: it spans rows {low[0]:g} to {high[0]:g} and columns {low[1]:g} to "
                f"{high[1]:g}, beside the image of {shape[0]} x {shape[1]}. Corners are (row, col)."
            )
    return corners
