"""The belt's corners in a picture of the empty belt (2016 paper, section IV.B)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError, check_between, check_count, check_positive

Array = npt.NDArray[np.float64]
SIDES = ("side y = 0", "end", "far side", "start")  # from corner k to corner k + 1


class Corners(NamedTuple):
    """Corners in the order of `kilnflight.belt.area.Area.corners`, each from two edges."""

    places: Array  # (4, 2), row and col in px
    spread_px: Array  # (4,), standard error from the scatter of the edges' points
    hidden: npt.NDArray[np.bool_]  # (4,), not seen itself: where its two edges would meet


class _Line(NamedTuple):
    point: Array  # (2,), row and col, in the middle of the points
    along: Array  # (2,), unit vector
    variance: Array  # (2,), of the offset in px^2 and of the slope
    seen: npt.NDArray[np.bool_]  # (profiles,), which points lie on it


@dataclass(frozen=True)
class FindCorners:
    """Lines through the belt's four edges; where two meet is a corner.

    The edge is where the grey value crosses the middle between belt and surroundings, to a
    fraction of a pixel, on profiles across each side.

    Notes
    -----
    The paper detects "the corners of the belt" and does not say how. Lines are taken since
    they use the whole edge and say themselves how well they are known, and since a corner that
    something hides is still where its two edges meet.
    """

    profiles: int = 200  # across each side
    reach_px: float = 12.0  # a profile's length to each side of the edge
    tolerance_px: float = 1.0  # farther from the line is no point of it
    least_seen: float = 0.5  # share of an edge that must be seen

    def __post_init__(self) -> None:
        """Refuse what finds no line."""
        check_count(self.profiles, "FindCorners: profiles", least=20)
        check_positive(self.reach_px, "FindCorners: reach_px")
        check_positive(self.tolerance_px, "FindCorners: tolerance_px")
        check_between(self.least_seen, 0.1, 1, "FindCorners: least_seen")

    def __call__(self, picture: npt.NDArray[np.uint8]) -> Corners:
        """Return the corners of the belt that fills the middle of ``picture`` (rows, cols).

        The belt is taken to run to the right, with y growing downwards.

        Raises
        ------
        InputError
            If nothing in the middle stands out, the belt reaches the picture's border, or
            too little is seen of an edge; the message names the edge.
        """
        rough, level = _outline(picture)
        ends = list(zip(rough, np.roll(rough, -1, axis=0), strict=True))
        lines = [
            self._line(picture, start, stop, level, name)
            for (start, stop), name in zip(ends, SIDES, strict=True)
        ]
        places, spreads, hidden = np.empty((4, 2)), np.empty(4), np.zeros(4, dtype=bool)
        last = self.profiles // 10  # an edge's end: its last tenth
        for k in range(4):
            before, after = lines[k - 1], lines[k]
            places[k], spreads[k] = _meet(before, after)
            hidden[k] = min(before.seen[-last:].mean(), after.seen[:last].mean()) < 0.5
        return Corners(places, spreads, hidden)

    def _line(
        self, picture: npt.NDArray[np.uint8], start: Array, stop: Array, level: float, name: str
    ) -> _Line:
        """Return the line through the edge's points between two rough corners."""
        share = (np.arange(self.profiles) + 0.5) / self.profiles
        middle = start + share[:, None] * (stop - start)
        along = (stop - start) / np.linalg.norm(stop - start)
        inwards = np.array([along[1], -along[0]])
        steps = np.arange(-self.reach_px, self.reach_px + 0.25, 0.5)
        grid = (middle[:, None, :] + steps[:, None] * inwards).astype(np.float32)
        profile = cv2.remap(picture, grid[..., 1], grid[..., 0], cv2.INTER_LINEAR).astype(float)
        depth = _crossing(profile - level, steps)
        points = middle + depth[:, None] * inwards
        return self._fitted(points, along, np.isfinite(depth), name)

    def _fitted(
        self, points: Array, along: Array, found: npt.NDArray[np.bool_], name: str
    ) -> _Line:
        """Fit a line to the points that agree on one; start from the median of slopes."""
        if found.mean() < self.least_seen:
            self._refuse(name, found.mean())
        across = np.array([along[1], -along[0]])
        u, v = points @ along, points @ across
        apart = len(u) // 2
        both = found[:apart] & found[-apart:]
        slopes = (v[-apart:] - v[:apart])[both] / (u[-apart:] - u[:apart])[both]
        slope = float(np.median(slopes)) if both.any() else 0.0
        offset = float(np.median((v - slope * u)[found]))
        for _ in range(5):
            on = found & (np.abs(v - offset - slope * u) < self.tolerance_px)
            if on.mean() < self.least_seen:
                self._refuse(name, on.mean())
            slope, offset = np.polyfit(u[on], v[on], 1)
        rest, mean = (v - offset - slope * u)[on], u[on].mean()
        noise = (rest**2).sum() / (on.sum() - 2)
        point = mean * along + (offset + slope * mean) * across
        turned = along + slope * across
        variance = noise / np.array([on.sum(), ((u[on] - mean) ** 2).sum()])
        return _Line(point, turned / np.linalg.norm(turned), variance, on)

    def _refuse(self, name: str, share: float) -> None:
        raise InputError(
            f"the belt's edge ({name}) is seen over {share:.0%} of its length only, at least "
            f"{self.least_seen:.0%} are needed. Clear the view, or light the belt so that its "
            "edges stand out."
        )


def _outline(picture: npt.NDArray[np.uint8]) -> tuple[Array, float]:
    """Return rough corners (4, 2) of the area in the middle, and the grey value of its edge."""
    if picture.ndim != 2 or picture.dtype != np.uint8:
        raise InputError(f"a picture must be (rows, cols) uint8, got {picture.dtype}.")
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
    where = changes.argmax(axis=1)
    rows = np.arange(len(height))
    before, after = height[rows, where], height[rows, where + 1]
    # A noisy edge may cross to and fro within two pixels; farther apart, something is there.
    last = changes.shape[1] - 1 - changes[:, ::-1].argmax(axis=1)
    once = changes.any(axis=1) & (last - where <= 4) & (sign[:, 0] != sign[:, -1])
    step = np.divide(before, before - after, out=np.zeros_like(before), where=once)
    return np.where(once, steps[where] + step * (steps[1] - steps[0]), np.nan)


def _meet(one: _Line, other: _Line) -> tuple[Array, float]:
    """Return where two lines cross and the standard error of that place in px."""
    far = np.linalg.solve(np.column_stack([one.along, -other.along]), other.point - one.point)
    variances = [
        line.variance[0] + distance**2 * line.variance[1]
        for line, distance in zip((one, other), far, strict=True)
    ]
    return one.point + far[0] * one.along, float(np.sqrt(sum(variances)))
