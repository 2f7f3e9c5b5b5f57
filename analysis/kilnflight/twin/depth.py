"""What the plenoptic camera says about depth: who has one, and how wrong it is.

Errors are stated in true millimetres, as the thesis sees them after calibration, and then
pushed through the inverse of Eq. 2.4, so that calibrating gives them back where Eq. 2.4
can. All statistics here are published inputs or assumptions; that they reappear in a
measurement validates nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from kilnflight.camera import PLATE_DISTANCES_MM, invert_depth

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class DepthCamera:
    """Availability and error of the depth."""

    wall_points: int = 200_000  # valid points per frame (sec. 5.1.3)
    kept_per_frame: float = 0.85  # of the pixels that can have depth; assumption
    wall_error: float = 0.022  # relative, common to a patch (sec. 2.1.5: about 1 m range at 8 m)
    wall_error_near_mm: float = 350.0  # between 2.6 and 3.4 m (sec. 2.1.5: more than 1 m range)
    patch_px: int = 28  # over which the wall's error is common; assumption
    white_mm: float = 0.6  # per point; more would contradict Fig. 5.7
    tilt_mm_px: float = 1.5  # slope across a particle; assumption
    outlier_share: float = 0.02  # of the particle errors; assumption ("lots of outliers")
    outlier_factor: float = 5.0
    scale: float = 1.0  # scenario: all errors times this
    static_bias: float = 0.0  # scenario: relative, smooth over the picture
    points_per_pixel: float = 0.6  # of an unsaturated particle; assumption
    # Table 5.18, RMSE in z, mm: medians over tracks.
    particle_error_mm: tuple[tuple[str, float], ...] = (
        ("wood chip", 143.56),
        ("confetti", 140.15),
        ("paper shred", 218.99),
        ("PE granule", 170.24),
    )
    # Table 5.2, share with 3D information: burning and unlit in air, burning on the wall.
    available: tuple[float, float, float] = (0.9939, 0.7879, 0.9309)

    @cached_property
    def error_of(self) -> dict[str, float]:
        """Standard deviation of a particle's common error in mm, by fraction."""
        return dict(self.particle_error_mm)

    def captured(self, true_mm: npt.ArrayLike) -> Array:
        """Return the captured depth of a true depth in mm.

        The line through the captured depths of the plate at 1 m, 2 m, ... 11 m: monotone,
        equal to the inverse of Eq. 2.4 at those distances, and continued beyond them.
        """
        plate, medians = np.array(PLATE_DISTANCES_MM), self._medians
        true = np.asarray(true_mm, dtype=np.float64)
        captured = np.interp(true, plate, medians)
        first = (medians[1] - medians[0]) / (plate[1] - plate[0])
        last = (medians[-1] - medians[-2]) / (plate[-1] - plate[-2])
        captured = captured + last * np.maximum(true - plate[-1], 0.0)
        return np.asarray(captured + first * np.minimum(true - plate[0], 0.0))

    @cached_property
    def _medians(self) -> Array:
        """Captured depths of the plate in mm."""
        return invert_depth(np.array(PLATE_DISTANCES_MM))

    def wall_scale(self, depth_mm: Array) -> Array:
        """Return the standard deviation of the wall's patch error in mm at a true depth."""
        near = (depth_mm > 2600.0) & (depth_mm < 3400.0)
        return self.scale * np.where(near, self.wall_error_near_mm, self.wall_error * depth_mm)
