"""The camera above the belt: where a place on the belt is seen (2016 paper, section IV.B).

It makes pictures; whoever measures in them must not know it, but finds the belt's corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kilnflight.belt.area import BELT, Area
from kilnflight.checks import check_between, check_count, check_positive

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """A pinhole camera above the middle of the belt, without distortion of the lens.

    Notes
    -----
    The paper gives the picture's size, its scale and its rate. Height and the small errors
    of mounting are assumptions; they are what makes "an imperfect calibration" matter, since
    a particle's centre lies above the plane that the belt's corners calibrate.
    """

    rows: int = 708  # px, section IV.B
    cols: int = 1064  # px, section IV.B
    mm_per_px: float = 0.44  # at the belt, section IV.B
    frames_per_s: float = 200.0  # section IV.B
    height_mm: float = 1000.0  # above the belt; assumption
    turned_deg: float = 0.3  # about its own axis; assumption: mounted by hand
    tilted_deg: float = 0.3  # against the vertical, along the belt; assumption
    belt: Area = BELT

    def __post_init__(self) -> None:
        """Refuse a camera that sees nothing."""
        check_count(self.rows, "View: rows")
        check_count(self.cols, "View: cols")
        for name in ("mm_per_px", "frames_per_s", "height_mm"):
            check_positive(getattr(self, name), f"View: {name}")
        for name in ("turned_deg", "tilted_deg"):
            check_between(getattr(self, name), -20, 20, f"View: {name}")

    def pixels(self, places: Array) -> Array:
        """Return row and col (n, 2) of places (n, 3): x, y and height above the belt in mm."""
        turn, tilt = np.deg2rad([self.turned_deg, self.tilted_deg])
        c, s = np.cos(turn), np.sin(turn)
        about_axis = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        c, s = np.cos(tilt), np.sin(tilt)
        about_y = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        middle = self.belt.corners.mean(axis=0)
        # Seen from above: x to the right, y down, depth away from the camera.
        seen = np.column_stack([places[:, :2] - middle, self.height_mm - places[:, 2]])
        seen = seen @ (about_axis @ about_y).T
        # The camera is moved sideways so that the tilted axis still meets the belt's middle.
        seen[:, :2] -= (about_axis @ about_y)[:2, 2] * self.height_mm
        scale = self.height_mm / self.mm_per_px / seen[:, 2:]
        col, row = (seen[:, :2] * scale).T
        return np.column_stack([row + (self.rows - 1) / 2, col + (self.cols - 1) / 2])
