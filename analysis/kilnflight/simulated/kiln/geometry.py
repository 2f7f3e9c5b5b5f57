"""Kiln, lance and camera: where things are, and where they are seen.

Camera coordinates are millimetres: x to the right, y up, z away from the camera. Kiln
coordinates are metres: s from the lance along the axis towards the camera, y to the
side, z up, both from the kiln's axis. Row 0, column 0 is the centre of the upper left
pixel.

The thesis publishes the fitted cylinder (Table 5.12) and the pixel of the lance's
outlet (Fig. 5.11). It publishes neither the pose of the camera nor the depth of the
lance. Both are constants here, set once by Tables 5.3, 5.12 and 5.18 and Figs 3.11 and
5.11; lengths of Table 5.12 are taken as 1.111 times the true ones.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kilnflight.arrays import Array, ArrayLike, Pair, Two

FULL_SCALE = 65535.0  # uint16 (sec. 5.1.3)


@dataclass(frozen=True)
class Geometry:
    """Kiln, lance and camera.

    Parameters
    ----------
    kiln_radius_mm, kiln_length_mm
        Inner radius and length in mm (section 2.1.1).
    inlet_depth_mm
        Depth of the inlet plate in mm (Table 5.12 over the scale of lengths).
    axis_far_mm
        A point of the kiln's axis in camera coordinates (likewise).
    axis_height_mm
        Height of the axis over the camera at depth 0; 0 to 745 mm are possible.
    lance_depth_mm
        Depth of the lance exit in mm; bounded by RMSE and MAPE of Table 5.18.
    lance_pixel
        Row and column of the lance exit (Fig. 5.11).
    rows, columns
        Size of the picture in px (section 2.1.4).
    focal_length_px
        A lens of 85 mm (section 2.1.4) over 11 um, which are two sensor pixels of
        5.5 um each (R12 data sheet).
    """

    kiln_radius_mm: float = 700.0
    kiln_length_mm: float = 8400.0
    inlet_depth_mm: float = 9035.0
    axis_far_mm: tuple[float, float, float] = (66.8, 445.5, 8332.8)
    axis_height_mm: float = 617.7
    lance_depth_mm: float = 5856.0
    lance_pixel: Two = (483.8, 936.3)
    rows: int = 1536
    columns: int = 2048
    focal_length_px: float = 85.0 / 0.011

    @cached_property
    def lance_mm(self) -> Array:
        """The lance exit in camera coordinates, (3,)."""
        return self.unproject(*self.lance_pixel, self.lance_depth_mm)

    @cached_property
    def axes(self) -> Array:
        """Kiln axes s, y, z as rows of unit vectors in camera coordinates, (3, 3)."""
        far = np.array(self.axis_far_mm)
        towards_camera = np.array([0.0, self.axis_height_mm, 0.0]) - far
        s = towards_camera / np.linalg.norm(towards_camera)
        up = np.array([0.0, 1.0, 0.0]) - s[1] * s
        up /= np.linalg.norm(up)
        return np.stack([s, np.cross(up, -s), up])

    @cached_property
    def origin_mm(self) -> Array:
        """The point of the axis beside the lance exit, in camera coordinates, (3,)."""
        far = np.array(self.axis_far_mm)
        return far + self.axes[0] * ((self.lance_mm - far) @ self.axes[0])

    @property
    def lance_m(self) -> Array:
        """The lance exit in kiln coordinates, (3,)."""
        return self.to_kiln(self.lance_mm)

    @property
    def inlet_m(self) -> float:
        """Coordinate s of the inlet plate (negative: behind the lance exit)."""
        return (self.lance_depth_mm - self.inlet_depth_mm) / 1000.0

    @property
    def outlet_m(self) -> float:
        """Coordinate s of the outlet."""
        return self.inlet_m + self.kiln_length_mm / 1000.0

    def to_camera(self, position_m: Array) -> Array:
        """Turn kiln coordinates (..., 3) in m into camera coordinates in mm."""
        return self.origin_mm + 1000.0 * (position_m @ self.axes)

    def to_kiln(self, position_mm: Array) -> Array:
        """Turn camera coordinates (..., 3) in mm into kiln coordinates in m."""
        return (position_mm - self.origin_mm) @ self.axes.T / 1000.0

    def project(self, position_mm: Array) -> Pair:
        """Return row and column of camera coordinates (..., 3) of positive depth."""
        scale = self.focal_length_px / position_mm[..., 2]
        row = (self.rows - 1) / 2 - position_mm[..., 1] * scale
        column = (self.columns - 1) / 2 + position_mm[..., 0] * scale
        return row, column

    def unproject(
        self, row: ArrayLike, column: ArrayLike, depth_mm: ArrayLike
    ) -> Array:
        """Return camera coordinates (..., 3) of pixels at a depth in mm."""
        depth = np.asarray(depth_mm, float)
        x = (np.asarray(column) - (self.columns - 1) / 2) * depth / self.focal_length_px
        y = ((self.rows - 1) / 2 - np.asarray(row)) * depth / self.focal_length_px
        return np.stack(np.broadcast_arrays(x, y, depth), axis=-1)

    def rays(self, row: ArrayLike, column: ArrayLike) -> Pair:
        """Return the rays of pixels along the kiln's axes.

        Returns
        -------
        start : array (3,)
            The camera, in mm from `origin_mm`.
        direction : array (..., 3)
            The way in mm along each ray as its depth grows by 1 mm.
        """
        start = -self.origin_mm @ self.axes.T
        return start, self.unproject(row, column, 1.0) @ self.axes.T

    def wall_depth(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Return the depth in mm at which a pixel's ray meets wall or inlet plate.

        The ray starts at the camera; of its two intersections with the cylinder the far
        one is the wall that is seen. Rays that leave the cylinder behind the inlet end
        at the plate.
        """
        start, ray = self.rays(row, column)
        a, b, root = meet_tube(start, ray, self.kiln_radius_mm)
        plate = (1000.0 * self.inlet_m - start[0]) / ray[..., 0]
        return np.minimum((-b + root) / a, plate)


def meet_tube(start: Array, ray: Array, radius_mm: float) -> tuple[Array, ...]:
    """Return a, b and root (...,): rays meet a tube at the depths (-b ± root) / a.

    The tube lies along the first axis, from which the start (3,) of the rays (..., 3)
    counts. A root is NaN where a ray passes beside the tube.
    """
    a = (ray[..., 1:] ** 2).sum(axis=-1)
    b = (ray[..., 1:] * start[1:]).sum(axis=-1)
    c = (start[1:] ** 2).sum() - radius_mm**2
    return a, b, np.sqrt(b**2 - a * c)
