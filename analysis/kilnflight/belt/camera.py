"""The belt and the camera above it: from pixels to millimetres.

Section IV.B of the 2016 paper.

The belt's four corners are found in a picture (`FindCorners`) and give the mapping
(`calibrate_camera`). Of the camera that made it nothing is known.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from scipy.stats import linregress, theilslopes

from kilnflight.belt.models import BELT_EDGE_MM, BELT_START_MM, BELT_WIDTH_MM
from kilnflight.checks import (
    InputError,
    check_between,
    check_count,
    check_finite,
    check_picture,
    check_positive,
    check_shape,
)
from kilnflight.project import cache

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Picture = npt.NDArray[np.uint8]

VERSION = 1  # of the file of a calibration
DRIFT_PX = 1.0  # 0.44 mm: as much as errors of places; ten times the error of a corner; choice
MOST_UNLIKE = 1.5  # ratio of the scales along and across: a camera that is 48 deg askew; choice
SIDES = ("side y = 0", "end", "far side", "start")  # from corner k to corner k + 1


@dataclass(frozen=True)
class Area:
    """A rectangle of the belt in the coordinates of the tracks; y runs from 0."""

    start_mm: float = BELT_START_MM
    end_mm: float = BELT_EDGE_MM
    width_mm: float = BELT_WIDTH_MM

    def __post_init__(self) -> None:
        """Refuse a rectangle without area."""
        check_finite([self.start_mm, self.end_mm], "Area: start_mm and end_mm")
        if not self.start_mm < self.end_mm:
            raise InputError(f"Area: end_mm {self.end_mm} is not beyond start_mm {self.start_mm}.")
        check_positive(self.width_mm, "Area: width_mm")

    @property
    def corners(self) -> Array:
        """Its corners (4, 2), x and y in mm: start, end, end, start; y = 0 first."""
        start, end, width = self.start_mm, self.end_mm, self.width_mm
        return np.array([[start, 0.0], [end, 0.0], [end, width], [start, width]])

    @property
    def square_mm(self) -> float:
        """Its size in mm^2."""
        return (self.end_mm - self.start_mm) * self.width_mm

    def contains(self, places: Array) -> Flags:
        """Return which places (n, 2), x and y, lie in it."""
        x, y = places.T
        return (x >= self.start_mm) & (x <= self.end_mm) & (y >= 0) & (y <= self.width_mm)


BELT = Area()
TRACKED = Area(
    end_mm=BELT_EDGE_MM - 100.0
)  # the last 10 cm are the prediction phase, 2016, section IV


class Corners(NamedTuple):
    """Corners in the order of `Area.corners`, each from two edges."""

    places: Array  # (4, 2), row and col in px
    spread_px: Array  # (4,), standard error from the scatter of the edges' points
    hidden: Flags  # (4,), the corner itself is not visible


class _Line(NamedTuple):
    point: Array  # (2,), row and col, in the middle of the points
    along: Array  # (2,), unit vector
    variance: Array  # (2,), of the offset in px^2 and of the slope
    inliers: Flags  # (profiles,), which points lie on it


@dataclass(frozen=True)
class FindCorners:
    """Lines through the belt's four edges; where two meet is a corner.

    The edge is where the grey value crosses the middle between belt and surroundings, to a
    fraction of a pixel, on profiles across each side.

    Notes
    -----
    The paper detects "the corners of the belt" and does not say how. Lines use the whole edge and
    have an error of their own. A hidden corner is still where its two edges meet.
    """

    profiles: int = 200  # across each side
    reach_px: float = 12.0  # a profile's length to each side of the edge
    tolerance_px: float = 1.0  # farther from the line is no point of it
    least_visible: float = 0.5  # share of an edge that must be seen

    def __post_init__(self) -> None:
        """Refuse settings that find no line."""
        check_count(self.profiles, "FindCorners: profiles", least=20)
        check_positive(self.reach_px, "FindCorners: reach_px")
        check_positive(self.tolerance_px, "FindCorners: tolerance_px")
        check_between(self.least_visible, 0.1, 1, "FindCorners: least_visible")

    def __call__(self, picture: Picture) -> Corners:
        """Return the corners of the belt in the middle of ``picture`` (rows, cols).

        The belt fills the middle.

        The belt is taken to run to the right, with y growing downwards.

        Raises
        ------
        InputError
            If nothing in the middle stands out, the belt reaches the picture's border, or too
            little of an edge is visible. The message names the edge.
        """
        rough, level = _outline(picture)
        lines = [
            self._line(picture, rough[k], rough[(k + 1) % 4], level, SIDES[k]) for k in range(4)
        ]
        places, spreads, hidden = np.empty((4, 2)), np.empty(4), np.zeros(4, dtype=bool)
        last = self.profiles // 10  # an edge's end: its last tenth
        for k in range(4):
            before, after = lines[k - 1], lines[k]
            places[k], spreads[k] = _meet(before, after)
            hidden[k] = min(before.inliers[-last:].mean(), after.inliers[:last].mean()) < 0.5
        return Corners(places, spreads, hidden)

    def _line(self, picture: Picture, start: Array, stop: Array, level: float, side: str) -> _Line:
        """Return the line through the edge's points between two rough corners."""
        share = (np.arange(self.profiles) + 0.5) / self.profiles
        middle = start + share[:, None] * (stop - start)
        along = (stop - start) / np.linalg.norm(stop - start)
        inwards = np.array([along[1], -along[0]])
        steps = np.arange(-self.reach_px, self.reach_px + 0.25, 0.5)
        grid = (middle[:, None, :] + steps[:, None] * inwards).astype(np.float32)
        profile = cv2.remap(picture, grid[..., 1], grid[..., 0], cv2.INTER_LINEAR).astype(float)
        depth = _crossing(profile - level, steps)
        visible = np.isfinite(depth)
        self._check_visible(visible, side)
        # A line through the points that agree on one, from the median of slopes on.
        u, v = middle @ along, middle @ inwards + depth
        slope, offset = theilslopes(v[visible], u[visible])[:2]
        for _ in range(5):
            inliers = visible & (np.abs(v - offset - slope * u) < self.tolerance_px)
            self._check_visible(inliers, side)
            middle_u = u[inliers].mean()
            # With u counted from its mean, the errors of slope and intercept are independent.
            fit = linregress(u[inliers] - middle_u, v[inliers])
            slope, offset = fit.slope, fit.intercept - fit.slope * middle_u
        point = middle_u * along + fit.intercept * inwards
        turned = along + slope * inwards
        variance = np.array([fit.intercept_stderr, fit.stderr]) ** 2
        return _Line(point, turned / np.linalg.norm(turned), variance, inliers)

    def _check_visible(self, visible: Flags, side: str) -> None:
        """Raise an `InputError` if too little of an edge is visible."""
        if visible.mean() < self.least_visible:
            raise InputError(
                f"the belt's edge ({side}) is seen over {visible.mean():.0%} of its length only, "
                f"at least {self.least_visible:.0%} are needed. Clear the view, or light the belt "
                "so that its edges stand out."
            )


def _outline(picture: Picture) -> tuple[Array, float]:
    """Return rough corners (4, 2) of the area in the middle, and a grey value.

    The grey value is that of the area's edge.
    """
    check_picture(picture, "FindCorners")
    rows, cols = picture.shape
    smooth = cv2.medianBlur(picture, 5)
    level, _ = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    alike = (smooth > level) == (smooth[rows // 2, cols // 2] > level)
    labels = cv2.connectedComponents(alike.astype(np.uint8))[1]
    area = labels == labels[rows // 2, cols // 2]
    border = area[0].any() or area[-1].any() or area[:, 0].any() or area[:, -1].any()
    if border or area.mean() < 0.01:
        raise InputError(
            "no belt with its whole outline in view: the area in the middle of the picture "
            + ("reaches its border." if border else "is next to nothing.")
            + " Show all four edges, belt and surroundings of different grey."
        )
    inside, outside = np.median(picture[area]), np.median(picture[~area])
    points = np.argwhere(area)[:, ::-1].astype(np.float32)
    box = cv2.boxPoints(cv2.minAreaRect(points)).astype(float)[:, ::-1]  # row, col
    by_angle = np.argsort(np.arctan2(*(box - box.mean(axis=0)).T))  # upper left first
    return box[by_angle], float(inside + outside) / 2


def _crossing(height: Array, steps: Array) -> Array:
    """Return where each profile (n, s) changes its sign; NaN unless it does so once."""
    sign = height > 0
    changes = sign[:, 1:] != sign[:, :-1]
    first = changes.argmax(axis=1)
    # A noisy edge may cross to and fro within two pixels; farther apart, something is there.
    last = changes.shape[1] - 1 - changes[:, ::-1].argmax(axis=1)
    once = changes.any(axis=1) & (last - first <= 4) & (sign[:, 0] != sign[:, -1])
    rows = np.arange(len(height))
    before, after = height[rows, first], height[rows, first + 1]
    share = np.divide(before, before - after, out=np.full_like(before, np.nan), where=once)
    return steps[first] + share * (steps[1] - steps[0])


def _meet(line: _Line, other: _Line) -> tuple[Array, float]:
    """Return where two lines cross and the standard error of that place in px."""
    far = np.linalg.solve(np.column_stack([line.along, -other.along]), other.point - line.point)
    variances = [
        edge.variance[0] + distance**2 * edge.variance[1]
        for edge, distance in zip((line, other), far, strict=True)
    ]
    return line.point + far[0] * line.along, float(np.sqrt(sum(variances)))


class Calibration(NamedTuple):
    """A plane-to-plane mapping (homography) and its error."""

    matrix: Array  # (3, 3), (col, row, 1) to (x, y, 1) up to a factor
    error_mm: float  # largest standard error of a corner, on the belt
    mm_per_px: float  # mean over the belt's edges
    hidden: int  # corners that are not visible themselves

    def millimetres(self, places: Array) -> Array:
        """Return x and y (n, 2) of row and col (n, 2)."""
        check_shape(places, (None, 2), "places (row, col)")
        return _mapped(self.matrix, places[:, ::-1])

    def pixels(self, places: Array) -> Array:
        """Return row and col (n, 2) of x and y (n, 2) on the belt."""
        check_shape(places, (None, 2), "places (x, y)")
        return _mapped(np.asarray(np.linalg.inv(self.matrix), np.float64), places)[:, ::-1]

    def window(self, area: Area, margin_px: float, shape: tuple[int, int]) -> tuple[slice, slice]:
        """Return the rows and columns of a picture that show an area and a margin."""
        corners = self.pixels(area.corners)
        low = np.floor(corners.min(axis=0) - margin_px).clip(0).astype(int)
        high = np.ceil(corners.max(axis=0) + margin_px).astype(int) + 1
        return slice(low[0], min(shape[0], high[0])), slice(low[1], min(shape[1], high[1]))


def _mapped(matrix: Array, places: Array) -> Array:
    mapped = np.column_stack([places, np.ones(len(places))]) @ matrix.T
    return mapped[:, :2] / mapped[:, 2:]


def calibrate_camera(corners: Corners, belt: Area = BELT) -> Calibration:
    """Return the mapping of detected corners onto the belt's true corners.

    Parameters
    ----------
    corners
        From `FindCorners`.
    belt
        Whose corners they are.

    Raises
    ------
    InputError
        If three corners lie on one line, or numbers are not finite. Also if the scales along and
        across differ by more than half: the belt does not run to the right, or is another.

    Notes
    -----
    Four corners fix the eight numbers of a homography and leave no residual. So the error is that
    of the corners, from the scatter of the edges' points. It leaves out parallax: a camera at
    height h shows a centre at height z farther from the middle, by the share z / h.
    """
    places = check_finite(corners.places, "corners")
    check_shape(places, (4, 2), "corners")
    for a, b, c in (np.roll(places, k, axis=0)[:3] for k in range(4)):
        if abs(np.linalg.det([b - a, c - a])) < 1.0:
            raise InputError(f"three corners of the belt lie on one line: {a}, {b}, {c} px.")
    matrix = cv2.getPerspectiveTransform(
        places[:, ::-1].astype(np.float32), belt.corners.astype(np.float32)
    )
    sides = [
        np.linalg.norm(np.roll(ends, -1, axis=0) - ends, axis=1) for ends in (belt.corners, places)
    ]
    along, across = (sides[0][k::2].sum() / sides[1][k::2].sum() for k in (0, 1))
    if max(along, across) > MOST_UNLIKE * min(along, across):
        raise InputError(
            f"the belt has {along:.3g} mm per px along it and {across:.3g} across it. Turn the "
            "picture so that the belt runs to the right, or set the belt's length and width."
        )
    scale = float(sides[0].sum() / sides[1].sum())
    error = scale * float(corners.spread_px.max())
    return Calibration(np.asarray(matrix, np.float64), error, scale, int(corners.hidden.sum()))


def save_calibration(calibration: Calibration, path: Path | str) -> None:
    """Write a calibration as JSON: a version, a hash of the numbers, the numbers."""
    values = calibration._asdict() | {"matrix": calibration.matrix.tolist()}
    content = {"version": VERSION, "sha256": _digest(values), **values}
    cache.write_whole(Path(path), json.dumps(content, indent=1).encode())


def load_calibration(path: Path | str) -> Calibration:
    """Return the calibration of a file that `save_calibration` wrote.

    Raises
    ------
    InputError
        If there is no such file, it is damaged, or of another version.
    """
    try:
        values = json.loads(Path(path).read_bytes())
        version, digest = values.pop("version"), values.pop("sha256")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path}: no calibration ({error!r}). Give a file of save_calibration."
        ) from error
    if version != VERSION or digest != _digest(values):
        fault = "damaged" if version == VERSION else f"of version {version}, not {VERSION}"
        raise InputError(f"{path}: the calibration is {fault}. Calibrate the camera again.")
    return Calibration(**values | {"matrix": np.array(values["matrix"])})


def _digest(values: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def corner_shifts(calibration: Calibration, corners: Corners, belt: Area = BELT) -> Array:
    """Return how far the belt's corners (4,) have moved since the calibration, in px.

    Parameters
    ----------
    calibration
        That is in use.
    corners
        Found anew, in the average of later pictures. Beyond `DRIFT_PX` the camera or the belt has
        moved: calibrate again.
    belt
        Whose corners they are.
    """
    away = corners.places - calibration.pixels(belt.corners)
    return np.asarray(np.hypot(*away.T), np.float64)
