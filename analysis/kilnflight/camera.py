"""Calibrations of cameras: depth, region of interest, wall temperature.

The plenoptic camera reports a captured depth. A test plate at 1, 2, ..., 11 m showed that
it is off by a few decimetres, differently in three ranges. Eq. 2.4 maps captured to true
depth with one quadratic per range (section 2.1.5, thesis). It is that camera's: a recording
says which calibration its depths need, and none is applied unasked. Depths are in mm.

In an infrared picture a strip of the wall is a trapezoid, narrow where it is far. A
projective transform makes a rectangle of it, and the mean of each row is the profile along
the kiln (Fig. 2.4, thesis).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self

import cv2
import numpy as np
import numpy.typing as npt
from scipy.linalg import null_space

from kilnflight.checks import InputError, check_count, check_finite, check_shape

Array = npt.NDArray[np.float64]
Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class DepthCalibration:
    """Map captured to true depth by one polynomial per segment.

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
        """Refuse breakpoints that descend or do not fit the polynomials."""
        if any(high <= low for low, high in pairwise(self.breakpoints_mm)):
            raise InputError(f"breakpoints {self.breakpoints_mm} do not ascend; sort them.")
        if len(self.coefficients) != len(self.breakpoints_mm) + 1:
            raise InputError(
                f"{len(self.breakpoints_mm)} breakpoints make {len(self.breakpoints_mm) + 1} "
                f"segments, but there are {len(self.coefficients)} polynomials."
            )
        check_finite(np.concatenate([self.breakpoints_mm, *self.coefficients]), "depth calibration")

    @classmethod
    def from_table(cls, pairs: npt.ArrayLike) -> Self:
        """Return straight lines between measured depths; the outer ones go on beyond.

        Parameters
        ----------
        pairs
            (n, 2) captured and true depth of n plates, at least two, in mm.

        Raises
        ------
        InputError
            If there are fewer than two, or the true depth does not grow with the captured one.
        """
        table = check_finite(pairs, "depth table")
        check_shape(table, (None, 2), "depth table")
        table = table[np.argsort(table[:, 0], kind="stable")]
        steps = np.diff(table, axis=0)
        if len(steps) < 1 or (steps <= 0).any():
            raise InputError(
                "depth table: give two or more pairs (captured, true) in mm, the true depth "
                "growing with the captured one."
            )
        slopes = steps[:, 1] / steps[:, 0]
        lines = np.column_stack([slopes, table[:-1, 1] - slopes * table[:-1, 0]])
        return cls(tuple(table[1:-1, 0].tolist()), tuple(map(tuple, lines.tolist())))

    def segment(self, captured_mm: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Return the segment of each captured depth."""
        depth = np.asarray(captured_mm, dtype=np.float64)
        closed = self.closed_left or (True,) * len(self.breakpoints_mm)
        index = np.zeros(depth.shape, dtype=np.intp)
        for point, left in zip(self.breakpoints_mm, closed, strict=True):
            index += (depth >= point) if left else (depth > point)
        return index

    def __call__(self, captured_mm: npt.ArrayLike) -> Array:
        """Return the calibrated depth in mm, in the shape of the input."""
        depth = check_finite(captured_mm, "captured depth")
        segment = self.segment(depth)
        segments = [segment == index for index in range(len(self.coefficients))]
        polynomials = [np.poly1d(powers) for powers in self.coefficients]
        return np.asarray(np.piecewise(depth, segments, polynomials))

    def jumps(self) -> Array:
        """Return right limit minus left limit at each breakpoint, in mm."""
        ends = zip(pairwise(self.coefficients), self.breakpoints_mm, strict=True)
        return np.array([np.polyval(b, at) - np.polyval(a, at) for (a, b), at in ends])

    def falling(self, low_mm: float, high_mm: float, step_mm: float = 0.1) -> Array:
        """Return the captured depths at which the calibrated depth falls.

        They lie between ``low_mm`` and ``high_mm``. A calibration that falls gives two particles
        in the wrong order of depth. The slope is evaluated on a grid; jumps are reported by
        `jumps`.
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

CALIBRATIONS = {"none": None, "zhang-2023": EQUATION_2_4}  # what a recording can name

# The plate stood at 1 m to 11 m; beyond them Eq. 2.4 extrapolates.
PLATE_DISTANCES_MM = tuple(1000.0 * metre for metre in range(1, 12))


def read_calibration(stated: Any) -> DepthCalibration | None:
    """Return the depth calibration that a recording states.

    Parameters
    ----------
    stated
        None or ``"none"``: depths are true as they are. ``"zhang-2023"``: Eq. 2.4. Pairs of
        captured and true depth, in mm: see `DepthCalibration.from_table`. A mapping with
        ``breakpoints_mm`` and ``coefficients``: the fields of `DepthCalibration`.

    Raises
    ------
    InputError
        If it is none of these.
    """
    if stated is None or isinstance(stated, DepthCalibration):
        return stated
    if isinstance(stated, str) and stated in CALIBRATIONS:
        return CALIBRATIONS[stated]
    if isinstance(stated, list | tuple):
        return DepthCalibration.from_table(stated)
    try:
        breakpoints, rows = stated["breakpoints_mm"], stated["coefficients"]
        closed = tuple(map(bool, stated.get("closed_left", ())))
        return DepthCalibration(tuple(breakpoints), tuple(map(tuple, rows)), closed)
    except (TypeError, KeyError, AttributeError):
        raise InputError(
            f"depth_calibration is {stated!r}; expected one of {', '.join(CALIBRATIONS)}, pairs "
            "[captured, true] in mm, or breakpoints_mm with coefficients."
        ) from None


def calibrate_depth(z: npt.ArrayLike) -> Array:
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


def captured_depths(true_mm: float, calibration: DepthCalibration = EQUATION_2_4) -> list[float]:
    """Return the captured depths of a true depth, ascending.

    Eq. 2.4 is not one to one: a true depth of 3 m is reached from 2065 and 3118 mm.
    """
    solutions = _solutions(np.array([float(true_mm)]), calibration)[0]
    return np.sort(solutions[np.isfinite(solutions)]).tolist()


def _solutions(true_mm: Array, calibration: DepthCalibration) -> Array:
    """Return all captured depths of each true depth (n,), a row each, filled up with NaN."""
    found = []
    for index, coefficients in enumerate(calibration.coefficients):
        roots = _roots(np.trim_zeros(np.array(coefficients), "f"), true_mm)
        real = np.where(np.abs(roots.imag) < 1e-9 * np.abs(roots), roots.real, np.nan)
        here = (real > 0) & (calibration.segment(real) == index)
        found.append(np.where(here, real, np.nan))
    return np.concatenate(found, axis=1)


def _roots(coefficients: Array, values: Array) -> npt.NDArray[np.complexfloating]:
    """Return the roots of a polynomial minus each value (n,), a row each.

    They are the eigenvalues of its companion matrix. `numpy.roots` does so for one value at a time,
    which takes two hundred times as long.
    """
    degree = max(len(coefficients) - 1, 0)
    companion = np.tile(np.eye(degree, k=-1), (len(values), 1, 1))
    if degree:
        companion[:, 0] = -coefficients[1:] / coefficients[0]
        companion[:, 0, -1] = -(coefficients[-1] - values) / coefficients[0]
    return np.asarray(np.linalg.eigvals(companion), dtype=np.complex128)


def invert_depth(true_mm: npt.ArrayLike, calibration: DepthCalibration = EQUATION_2_4) -> Array:
    """Return the captured depth of each true depth.

    Of several solutions it is the one nearest to the true depth. The text settles the ambiguity
    likewise ("the median depth from 3 m to 5 m is very close to the actual value").

    Raises
    ------
    InputError
        If a depth is not finite or no captured depth leads to it.
    """
    true = check_finite(true_mm, "true depth")
    flat = true.reshape(-1)
    solutions = _solutions(flat, calibration)
    apart = np.where(np.isnan(solutions), np.inf, np.abs(solutions - flat[:, None]))
    if (lost := np.isinf(apart).all(axis=1)).any():
        missed = flat[lost][0]
        raise InputError(f"no captured depth gives {missed} mm; the calibration skips it.")
    nearest = np.argmin(apart, axis=1)
    return np.asarray(solutions[np.arange(len(flat)), nearest].reshape(true.shape))


def fit_depth_segments(
    captured_mm: npt.ArrayLike,
    true_mm: npt.ArrayLike,
    breakpoints_mm: tuple[float, ...] = (3000.0, 5000.0),
    degree: int = 2,
    *,
    continuous: bool = False,
) -> DepthCalibration:
    """Fit one polynomial per segment of the captured depth, as in Eq. 2.4.

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
        Whether neighbours must agree at the breakpoints. If not, the result may jump there, as
        Eq. 2.4 does by -356 mm at 3000 mm.

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
    check_count(degree, "fit_depth_segments: degree", 0)
    segments, size = len(breakpoints_mm) + 1, degree + 1
    frame = DepthCalibration(tuple(breakpoints_mm), ((0.0,),) * segments)
    # per point one column of powers for each segment; metres, so that powers stay of one size
    member = frame.segment(captured)[:, None] == np.arange(segments)
    powers = np.vander(captured / 1000.0, size)
    design = (member[:, :, None] * powers[:, None]).reshape(captured.size, -1)
    basis = np.eye(segments * size)
    if continuous and breakpoints_mm:  # neighbours agree at the breakpoint between them
        borders = np.vander(np.array(breakpoints_mm) / 1000.0, size)
        sides = np.eye(segments)[:-1] - np.eye(segments)[1:]
        basis = null_space((sides[:, :, None] * borders[:, None]).reshape(len(borders), -1))
    solution, _, rank, _ = np.linalg.lstsq(design @ basis, true, rcond=None)
    if rank < basis.shape[1]:
        counts = [len(np.unique(captured[here])) for here in member.T]
        raise InputError(
            f"the points do not determine {basis.shape[1]} coefficients: the segments hold "
            f"{counts} different captured depths. Add plates, lower the degree, or join segments."
        )
    fitted = (basis @ solution).reshape(segments, size) / 1000.0 ** np.arange(degree, -1, -1)
    return DepthCalibration(frame.breakpoints_mm, tuple(tuple(row) for row in fitted.tolist()))


def calibrate_points(captured_mm: npt.ArrayLike, calibration: DepthCalibration | None) -> Array:
    """Return points (n, 3) with their true depth, in mm.

    Parameters
    ----------
    captured_mm
        (n, 3) x, y, z in camera coordinates as captured.
    calibration
        That of the recording's camera (`Attributes.depth_calibration`); None: depths are
        true as captured.

    Raises
    ------
    InputError
        If a point is behind the camera, as captured or by the calibration.

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
    if calibration is None:
        return points
    true = calibration(depth)
    if not (true > 0).all():
        k = int(np.argmin(true))
        raise InputError(
            f"captured points: the recording's depth calibration makes {true[k, 0]:.0f} mm of "
            f"{depth[k, 0]:.0f} mm. Each camera has its own: state the one of this camera, or "
            'depth_calibration = "none".'
        )
    return points * (true / depth)


def inside(polygon: npt.ArrayLike, row: npt.ArrayLike, col: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Return whether each pixel lies in a region of interest.

    The shape is that of ``row`` and ``col``.

    Parameters
    ----------
    polygon
        (n, 2) row, col of its corners in order, as `frames.Attributes.roi`; the
        last is joined to the first.
    row, col
        Pixels, whole or not.

    Raises
    ------
    InputError
        If the polygon has fewer than three different corners or no extent, or a number is
        not finite.

    Notes
    -----
    The thesis excludes "the particles outside the polygon", so its border counts as inside.
    A polygon that crosses itself is filled by the even-odd rule.

    Examples
    --------
    >>> inside([(0, 0), (0, 9), (9, 0)], [1, 8, 0], [1, 8, 4]).tolist()
    [True, False, True]
    """
    corners = check_finite(polygon, "polygon")
    check_shape(corners, (None, 2), "polygon")
    different = len(np.unique(corners, axis=0))
    if different < 3:
        raise InputError(
            f"polygon: {different} different corner(s); a region of interest has three or more "
            "(row, col)."
        )
    if np.linalg.matrix_rank(corners - corners[0]) < 2:
        raise InputError("polygon: its corners are in one line; it encloses nothing.")
    r, c = np.broadcast_arrays(check_finite(row, "row"), check_finite(col, "col"))
    contour = corners.astype(np.float32)
    places = zip(r.ravel().tolist(), c.ravel().tolist(), strict=True)
    side = [cv2.pointPolygonTest(contour, place, measureDist=False) for place in places]
    return np.greater_equal(side, 0).reshape(r.shape)


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
    trapezoid = np.array(corners, dtype=np.float32)[:, ::-1].copy()  # OpenCV takes column, row
    if (trapezoid < 0).any() or (trapezoid > np.array(values.shape[::-1]) - 1).any():
        raise InputError(f"corners {corners} leave the picture of {values.shape}; keep inside.")
    if not cv2.isContourConvex(trapezoid) or not cv2.contourArea(trapezoid):
        raise InputError(f"corners {corners} make no convex area in this order; go around once.")
    target = [(0, 0), (columns - 1, 0), (columns - 1, rows - 1), (0, rows - 1)]
    transform = cv2.getPerspectiveTransform(trapezoid, np.array(target, dtype=np.float32))
    return cv2.warpPerspective(values, transform, (columns, rows)).astype(np.float64)


def wall_profile(
    picture: npt.NDArray[np.generic], corners: Corners, rows: int = 200, columns: int = 100
) -> Array:
    """Return the mean of each row of the equalised trapezoid.

    An array (rows,), the far end first. Rows are evenly spaced on the wall if the trapezoid is a
    strip of constant width seen in perspective.
    """
    return equalize(picture, corners, rows, columns).mean(axis=1)
