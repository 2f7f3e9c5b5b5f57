"""Calibrate the camera above the belt: from pixels to millimetres.

2016 paper, section IV.B. `find_corners` finds the belt's four corners in a picture,
`calibrate_camera` maps them to mm. No parameter of the camera is used.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
import scipy  # scipy.stats loads on first use: it takes a quarter of a second

from kilnflight.arrays import Array, Flags, Picture, TwoInts
from kilnflight.belt.models import BELT_EDGE_MM, BELT_START_MM, BELT_WIDTH_MM
from kilnflight.checks import InputError, Number, Positive, Settings, check_finite

# All five are choices.
PROFILES = 200  # across each side of the belt
REACH_PX = 12.0  # a profile's length to each side of the edge
TOLERANCE_PX = 1.0  # farthest point of a line from it
LEAST_VISIBLE = 0.5  # share of an edge
MOST_UNLIKE = 1.5  # ratio of the scales along and across: a camera 48 deg askew
# Side k joins corners k and k + 1.
SIDES = ("side y = 0", "end", "far side", "start")


def check_picture(
    picture: object, where: str, shape: Sequence[int] | None = None
) -> None:
    """Raise an `InputError` unless it is (rows, cols) uint8, of ``shape`` if given."""
    array = np.asarray(picture)
    fits = array.ndim == 2 and array.size > 0 and shape in (None, array.shape)
    if array is not picture or not fits or array.dtype != np.uint8:
        raise InputError(
            f"{where}: must be a picture {shape or '(rows, cols)'} of uint8, got "
            f"{array.shape} {array.dtype}. Convert or cut it, and take all pictures "
            "with one camera."
        )


class Area(Settings):
    """A rectangle of the belt in the coordinates of the tracks.

    Parameters
    ----------
    start_mm, end_mm
        Limits of x, along the belt. The defaults are the belt of the authors' files,
        "a total length of 40 cm" (2016, section IV).
    width_mm
        Limit of y, across the belt, from 0 (2020, section 3).
    """

    start_mm: Number = BELT_START_MM
    end_mm: Number = BELT_EDGE_MM
    width_mm: Positive = BELT_WIDTH_MM

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.start_mm >= self.end_mm:
            raise InputError(f"Area: end_mm must be beyond start_mm: {self}.")

    @property
    def corners(self) -> Array:
        """Its corners (4, 2), x and y in mm: start, end, end, start; y = 0 first."""
        x = [self.start_mm, self.end_mm, self.end_mm, self.start_mm]
        return np.column_stack([x, [0.0, 0.0, self.width_mm, self.width_mm]])

    @property
    def square_mm(self) -> float:
        """Its size in mm^2."""
        return (self.end_mm - self.start_mm) * self.width_mm

    def contains(self, places: Array) -> Flags:
        """Return whether each place (n, 2), x and y in mm, is inside or on an edge."""
        x, y = places.T
        along = (x >= self.start_mm) & (x <= self.end_mm)
        return along & (y >= 0) & (y <= self.width_mm)


BELT = Area()
# The last 10 cm are the prediction phase, 2016, section IV.
TRACKED = Area(end_mm=BELT_EDGE_MM - 100.0)


class BeltCorners(NamedTuple):
    """Corners in the order of `Area.corners`, each from two edges."""

    places: Array  # (4, 2), row and col in px
    spread_px: Array  # (4,), standard error from the scatter of the edges' points


class _Line(NamedTuple):
    """Line through the points of one edge of the belt, in px of the picture."""

    point: Array  # (2,), row and col, in the middle of the points
    along: Array  # (2,), unit vector
    variance: Array  # (2,), of the offset in px^2 and of the slope


def find_corners(picture: Picture) -> BeltCorners:
    """Return the corners in px of the belt in the middle of a picture (rows, cols).

    The belt runs to the right, y grows downwards. A corner is where lines through two
    edges meet. On profiles across each side, an edge is where the grey value is halfway
    between belt and surroundings, to a fraction of a pixel.

    Raises
    ------
    InputError
        If nothing in the middle stands out, the belt reaches the picture's border, or
        too little of an edge is visible. The message names the edge.

    Notes
    -----
    The paper detects "the corners of the belt" and does not say how. Lines use the
    whole edge and have an error of their own. A hidden corner is still where its two
    edges meet.
    """
    rough, level = _outline(picture)
    lines = [
        _find_line(picture, start, stop, level, side)
        for start, stop, side in zip(
            rough, np.roll(rough, -1, axis=0), SIDES, strict=True
        )
    ]
    corners = [_meet(lines[k - 1], line) for k, line in enumerate(lines)]
    places, spreads = zip(*corners, strict=True)
    return BeltCorners(np.array(places), np.array(spreads))


def _find_line(
    picture: Picture, start: Array, stop: Array, level: float, side: str
) -> _Line:
    """Return the line through an edge's points between two rough corners.

    ``start`` and ``stop`` (2,) are row and col of the corners in px, ``level`` the grey
    value of the edge, and ``side`` its name for errors.
    """
    share = (np.arange(PROFILES) + 0.5) / PROFILES
    middle = start + share[:, None] * (stop - start)
    along = (stop - start) / np.linalg.norm(stop - start)
    # Corners go round the belt clockwise, so the belt is to the right of the edge.
    inwards = np.array([along[1], -along[0]])
    steps = np.arange(-REACH_PX, REACH_PX + 0.25, 0.5)
    grid = (middle[:, None, :] + steps[:, None] * inwards).astype(np.float32)
    profile = cv2.remap(picture, grid[..., 1], grid[..., 0], cv2.INTER_LINEAR)
    offset = _crossing(profile.astype(float) - level, steps)
    # Of v over u, a line that most points agree on; NaN is no point.
    u = middle @ along
    v = middle @ inwards + offset
    visible = np.isfinite(v)
    _check_visible(visible, side)
    # The median of slopes is a robust start.
    slope, offset = scipy.stats.theilslopes(v[visible], u[visible])[:2]
    for _ in range(5):
        inliers = np.abs(v - offset - slope * u) < TOLERANCE_PX
        _check_visible(inliers, side)
        mean_u = u[inliers].mean()
        # From the middle on, so that errors of slope and intercept are independent.
        fit = scipy.stats.linregress(u[inliers] - mean_u, v[inliers])
        slope = fit.slope
        offset = fit.intercept - slope * mean_u
    turned = along + fit.slope * inwards
    return _Line(
        point=mean_u * along + fit.intercept * inwards,
        along=turned / np.linalg.norm(turned),
        variance=np.array([fit.intercept_stderr, fit.stderr]) ** 2,
    )


def _check_visible(visible: Flags, side: str) -> None:
    """Raise an `InputError` unless enough profiles (n,) of an edge show it."""
    if visible.mean() < LEAST_VISIBLE:
        raise InputError(
            f"picture: the belt's edge ({side}) is seen over {visible.mean():.0%} of "
            f"its length, at least {LEAST_VISIBLE:.0%} are needed. Clear the view, or "
            "light the belt."
        )


def _outline(picture: Picture) -> tuple[Array, float]:
    """Return rough corners (4, 2) of the middle area, and its edge's grey value.

    Corners are row and col in px, the upper left one first, then clockwise. The grey
    value is halfway between the medians of the area and of the rest.
    """
    check_picture(picture, "picture")
    rows, cols = picture.shape
    smooth = cv2.medianBlur(picture, 5)
    level, _ = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    alike = (smooth > level) == (smooth[rows // 2, cols // 2] > level)
    labels = cv2.connectedComponents(alike.astype(np.uint8))[1]
    area = labels == labels[rows // 2, cols // 2]
    if area[[0, -1]].any() or area[:, [0, -1]].any() or area.mean() < 0.01:
        raise InputError(
            "picture: no belt with its whole outline in view. Show all four edges, "
            "belt and surroundings of different grey."
        )
    inside = np.median(picture[area])
    outside = np.median(picture[~area])
    points = np.argwhere(area)[:, ::-1].astype(np.float32)
    box = cv2.boxPoints(cv2.minAreaRect(points)).astype(float)[:, ::-1]  # row, col
    down, right = (box - box.mean(axis=0)).T
    upper_left_first = np.argsort(np.arctan2(down, right))
    return box[upper_left_first], float(inside + outside) / 2


def _crossing(height: Array, steps: Array) -> Array:
    """Return where each of n profiles crosses zero, in px along it (n,).

    ``height`` (n, s) are grey values minus that of the edge, ``steps`` (s,) the places
    of samples along a profile, evenly spaced in px. NaN without a crossing or with two
    far apart.
    """
    sign = height > 0
    changes = sign[:, 1:] != sign[:, :-1]
    first = changes.argmax(axis=1)
    # A noisy edge may cross several times within four samples. Farther apart, something
    # hides it.
    last = changes.shape[1] - 1 - changes[:, ::-1].argmax(axis=1)
    once = (last - first <= 4) & (sign[:, 0] != sign[:, -1])
    rows = np.arange(len(height))
    before = height[rows, first]
    after = height[rows, first + 1]
    share = np.full_like(before, np.nan)
    np.divide(before, before - after, out=share, where=once)
    return steps[first] + share * (steps[1] - steps[0])


def _meet(line: _Line, other: _Line) -> tuple[Array, float]:
    """Return row and col (2,) where two lines cross, and the standard error, in px."""
    directions = np.column_stack([line.along, -other.along])
    far = np.linalg.solve(directions, other.point - line.point)
    variance = sum(
        edge.variance[0] + distance**2 * edge.variance[1]
        for edge, distance in zip((line, other), far, strict=True)
    )
    return line.point + far[0] * line.along, float(np.sqrt(variance))


class Calibration(NamedTuple):
    """A plane-to-plane mapping (homography) and its error."""

    matrix: Array  # (3, 3), (col, row, 1) to (x, y, 1) up to a factor
    error_mm: float  # largest standard error of a corner, on the belt
    mm_per_px: float  # mean over the belt's edges

    def millimetres(self, places: Array) -> Array:
        """Return x and y on the belt in mm (n, 2) of row and col in px (n, 2)."""
        return _mapped(self.matrix, places[:, ::-1])

    def pixels(self, places: Array) -> Array:
        """Return row and col in px (n, 2) of x and y on the belt in mm (n, 2)."""
        inverse = np.asarray(np.linalg.inv(self.matrix), float)
        return _mapped(inverse, places)[:, ::-1]

    def window(
        self, area: Area, margin_px: float, shape: TwoInts
    ) -> tuple[slice, slice]:
        """Return the rows and columns of a picture that show an area and a margin.

        ``shape`` is that of the picture; the window is clipped to it.
        """
        corners = self.pixels(area.corners)
        low = np.floor(corners.min(axis=0) - margin_px).clip(0).astype(int)
        high = np.ceil(corners.max(axis=0) + margin_px).astype(int) + 1
        top, left = low
        bottom, right = np.minimum(high, shape)
        return slice(top, bottom), slice(left, right)


def _mapped(matrix: Array, places: Array) -> Array:
    """Return places (n, 2) mapped by a homography (3, 3)."""
    mapped = np.column_stack([places, np.ones(len(places))]) @ matrix.T
    return mapped[:, :2] / mapped[:, 2:]


def calibrate_camera(corners: BeltCorners, belt: Area = BELT) -> Calibration:
    """Return the mapping from pixels to mm on the belt, by the belt's four corners.

    Parameters
    ----------
    corners
        From `find_corners`; places are row and col (4, 2) in px.
    belt
        The whole belt, in mm; the default is that of both papers.

    Returns
    -------
    Calibration
        The homography (3, 3), the error of a corner in mm, and mm per px.

    Raises
    ------
    InputError
        If the corners are in another order or three of them in a line, or the scales
        along and across differ by more than the factor `MOST_UNLIKE`: the belt does not
        run to the right, or has another size.

    Notes
    -----
    Four corners fix the eight numbers of a homography and leave no residual. So the
    error is that of the corners, from the scatter of the edges' points. It leaves out
    parallax: a camera at height h sees a particle's centre at height z displaced
    outwards. The displacement is about z / h times the distance from the place under
    the camera.

    Examples
    --------
    >>> places = np.array([[10, 10], [10, 810], [370, 810], [370, 10]])
    >>> calibration = calibrate_camera(BeltCorners(places, spread_px=np.full(4, 0.02)))
    >>> calibration.mm_per_px, calibration.error_mm
    (0.5, 0.01)
    >>> calibration.millimetres(np.array([[190.0, 410.0]])).round(3)
    array([[588.,  90.]])
    """
    places = check_finite(corners.places, "corners", (4, 2))
    spread = check_finite(corners.spread_px, "corners: spread_px", (4,))
    pixels = places[:, ::-1].astype(np.float32)
    clockwise = cv2.contourArea(pixels, oriented=True) > 0
    if places.sum(axis=1).argmin() or not (clockwise and cv2.isContourConvex(pixels)):
        raise InputError(
            "corners: pass upper left, upper right, lower right, lower left, no three "
            "of them in a line."
        )
    matrix = cv2.getPerspectiveTransform(pixels, belt.corners.astype(np.float32))
    mm = _sides(belt.corners)
    px = _sides(places)
    along, across = (mm[:2] + mm[2:]) / (px[:2] + px[2:])
    if max(along, across) > MOST_UNLIKE * min(along, across):
        raise InputError(
            f"belt: {along:.3g} mm per px along it, {across:.3g} across it. Turn the "
            "picture so that the belt runs to the right, or set the belt's length and "
            "width."
        )
    scale = float(mm.sum() / px.sum())
    return Calibration(
        matrix=np.asarray(matrix, float),
        error_mm=scale * float(spread.max()),
        mm_per_px=scale,
    )


def _sides(corners: Array) -> Array:
    """Return the lengths (4,) of the sides from each corner (4, 2) to the next."""
    return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1))
