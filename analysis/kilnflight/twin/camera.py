"""The camera: positions, light into grey values, depth and its error.

The positions are those of kiln and lance.

Camera coordinates are millimetres: x to the right, y up, z away from the camera. Kiln
coordinates are metres: s from the lance exit along the axis towards the camera, x to the
side, y up, both from the kiln's axis. Row 0, column 0 is the centre of the upper left pixel.

The thesis publishes the fitted cylinder (Table 5.12) and the pixel of the lance exit (Fig.
5.11). It publishes neither the pose of the camera nor the depth of the lance. Those two are
chosen once, within the bounds of the printed numbers, and varied as scenarios.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from kilnflight.camera import PLATE_DISTANCES_MM, invert_depth
from kilnflight.checks import InputError, check_number
from kilnflight.twin.light import Light, band_radiance

Array = npt.NDArray[np.float64]

FULL_SCALE = 65535.0  # uint16 (sec. 5.1.3)
# The test plate with black dots (sec. 2.1.5).
DOT_MM = 14.0  # diameter
PITCH_MM = 28.0  # of the dots
HALF_PLATE_MM = 420.0  # of the plate, a square; Fig. 2.13 gives no number
BEYOND_MM = np.array([-1e5, 1e5])  # to which the captured depth is continued
TAIL = 4.0  # degrees of freedom of Student's t: "lots of outliers"


def unit_vectors(vectors: Array) -> Array:
    """Return vectors (..., 3) scaled to length 1; a zero vector stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


@dataclass(frozen=True)
class Geometry:
    """Kiln, lance and camera."""

    kiln_radius_mm: float = 700.0  # inner diameter 1.4 m (sec. 2.1.1)
    kiln_length_mm: float = 8400.0  # sec. 2.1.1
    inlet_depth_mm: float = 9100.0  # Table 5.12 scaled from the fitted 772 mm to 700 mm
    # A point of the axis: the centre of Table 5.12 scaled by 700/772.18.
    axis_far_mm: tuple[float, float, float] = (67.3, 448.7, 8392.3)
    # Height of the axis over the camera at depth 0; bounded only (0 to 745 mm).
    axis_height_mm: float = 300.0
    # Depth of the lance exit; bounded only (6 to 7 m, from RMSE and MAPE of Table 5.18).
    lance_depth_mm: float = 6500.0
    lance_pixel: tuple[float, float] = (483.8, 936.3)  # row, column (Fig. 5.11)
    rows: int = 1536  # sec. 2.1.4
    columns: int = 2048  # sec. 2.1.4
    # 85 mm lens (sec. 2.1.4) over 11 um: two sensor pixels of 5.5 um each (R12 data sheet).
    focal_length_px: float = 85.0 / 0.011

    def __post_init__(self) -> None:
        """Refuse a lance outside the kiln, and a wall outside the picture."""
        for name in ("kiln_radius_mm", "lance_depth_mm", "focal_length_px", "rows", "columns"):
            check_number(float(getattr(self, name)), f"Geometry: {name}", above=0)
        radius_mm = 1000.0 * float(np.hypot(*self.lance_m[1:]))
        if radius_mm >= self.kiln_radius_mm or not self.inlet_m <= 0.0 <= self.outlet_m:
            raise InputError(
                f"Geometry: the lance exit is {radius_mm:.0f} mm from the axis at a depth of "
                f"{self.lance_depth_mm:.0f} mm, outside the kiln. Change lance_depth_mm, "
                "axis_height_mm or lance_pixel."
            )
        if not self._shows_wall():
            raise InputError(
                f"Geometry: the wall is out of the picture with axis_height_mm "
                f"{self.axis_height_mm:.0f} and axis_far_mm {self.axis_far_mm}. Change one of them."
            )

    def _shows_wall(self) -> bool:
        """Return whether one of 81 pixels all over the picture shows the wall."""
        row, column = np.meshgrid(*(np.linspace(0, n - 1, 9) for n in (self.rows, self.columns)))
        seen = self.to_kiln(self.unproject(row, column, self.wall_depth(row, column)))
        along, radius = seen[..., 0], 1000.0 * np.hypot(seen[..., 1], seen[..., 2])
        wall = np.abs(radius - self.kiln_radius_mm) < 1.0
        return bool((wall & (along > self.inlet_m) & (along < self.outlet_m)).any())

    @cached_property
    def lance_mm(self) -> Array:
        """The lance exit in camera coordinates, (3,)."""
        return self.unproject(*self.lance_pixel, self.lance_depth_mm)

    @cached_property
    def axes(self) -> Array:
        """Kiln axes s, x, y as rows of unit vectors in camera coordinates, (3, 3)."""
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
        return float((self.lance_depth_mm - self.inlet_depth_mm) / 1000.0)

    @property
    def outlet_m(self) -> float:
        """Coordinate s of the outlet."""
        return self.inlet_m + self.kiln_length_mm / 1000.0

    def to_camera(self, position_m: Array) -> Array:
        """Return camera coordinates (..., 3) in mm of kiln coordinates (..., 3) in m."""
        return self.origin_mm + 1000.0 * (position_m @ self.axes)

    def to_kiln(self, position_mm: Array) -> Array:
        """Return kiln coordinates (..., 3) in m of camera coordinates (..., 3) in mm."""
        return (np.asarray(position_mm) - self.origin_mm) @ self.axes.T / 1000.0

    def project(self, position_mm: Array) -> tuple[Array, Array]:
        """Return row and column of camera coordinates (..., 3); depth must be positive."""
        scale = self.focal_length_px / position_mm[..., 2]
        row = (self.rows - 1) / 2 - position_mm[..., 1] * scale
        column = (self.columns - 1) / 2 + position_mm[..., 0] * scale
        return row, column

    def unproject(
        self, row: npt.ArrayLike, column: npt.ArrayLike, depth_mm: npt.ArrayLike
    ) -> Array:
        """Return camera coordinates (..., 3) of pixels at a depth in mm."""
        depth = np.asarray(depth_mm, dtype=np.float64)
        x = (np.asarray(column) - (self.columns - 1) / 2) * depth / self.focal_length_px
        y = ((self.rows - 1) / 2 - np.asarray(row)) * depth / self.focal_length_px
        points = np.empty((*np.broadcast_shapes(x.shape, y.shape), 3))
        points[..., 0], points[..., 1], points[..., 2] = x, y, depth
        return points

    def wall_depth(self, row: Array, column: Array) -> Array:
        """Return the depth in mm at which a pixel's ray meets wall or inlet plate.

        The ray starts at the camera; of its two intersections with the cylinder the far
        one is the wall that is seen. Rays that leave the cylinder behind the inlet end at
        the plate.
        """
        ray = self.unproject(row, column, np.ones(np.broadcast(row, column).shape))
        local = ray @ self.axes.T
        start = -self.origin_mm @ self.axes.T
        a = (local[..., 1:] ** 2).sum(axis=-1)
        b = (local[..., 1:] * start[1:]).sum(axis=-1)
        c = (start[1:] ** 2).sum() - self.kiln_radius_mm**2
        wall = (-b + np.sqrt(np.maximum(b**2 - a * c, 0.0))) / np.maximum(a, 1e-12)
        plate = (1000.0 * self.inlet_m - start[0]) / local[..., 0]
        return np.minimum(wall, plate)


@dataclass(frozen=True)
class Optics:
    """The way from light to grey values: radiation, exposure and noise.

    Section 2.1.4 of the thesis; R12 camera.

    These levels are not published; scenes have those of `kilnflight.twin.fitted` instead.
    The thesis's DoG threshold of 450 to 550 grey values bounds the scale only loosely, so
    no threshold may be copied from there.
    """

    wall_level: float = 5200.0  # grey value of a surface at the wall's temperature; assumption
    wall_k: float = 1423.0  # temperature of that surface
    read_noise: float = 40.0  # grey values, standard deviation, four raw pixels averaged
    shot_gain: float = 0.6  # grey values^2 of variance per grey value, likewise
    exposure_s: float = 2.5e-3  # just below the frame period of 330/s; 6 ms at 153.85/s
    # The next two were set once by Fig. 3.12, a published input (mean radius 7.7 px, nearly all
    # below 15 px): 5 mm and 0.5 were tried first and gave burning particles of 12 px.
    flame_mm: float = 2.5  # by which a flame stands off its particle
    curl: float = 0.4  # half axes of a burning sheet over those before
    # Light on a particle over the wall's own; below 1 the open outlet and the cool inlet plate
    # show. Assumption.
    irradiance: float = 1.0
    flame_softness: float = 0.35  # width of its edge over its radius; assumption
    edge_softness_px: float = 0.8  # blur of the processed image; assumption
    light: Light = field(default_factory=Light)

    def __post_init__(self) -> None:
        """Refuse levels that are not positive, and light of which nothing would be left."""
        for name in ("wall_level", "wall_k", "read_noise", "shot_gain", "exposure_s"):
            check_number(float(getattr(self, name)), f"Optics: {name}", above=0)
        if self.at_wall >= FULL_SCALE:
            raise InputError(
                f"Optics: the wall's grey value would be {self.at_wall:.0f}, so that all is "
                f"saturated (full scale {FULL_SCALE:.0f}); lower exposure_s or wall_level."
            )

    @property
    def at_wall(self) -> float:
        """Grey value of a black surface as hot as the wall at this exposure."""
        return self.wall_level * (self.exposure_s / self.light.shutter_s)

    def glow(self, temperature_k: npt.ArrayLike) -> Array:
        """Return the grey value of a black surface by Planck's law, beyond full scale, too."""
        return self.at_wall * band_radiance(temperature_k) / band_radiance(self.wall_k)

    def noise(self, level: npt.ArrayLike) -> Array:
        """Return the standard deviation of the noise at a grey value."""
        variance = self.read_noise**2 + self.shot_gain * np.asarray(level, dtype=np.float64)
        return np.sqrt(variance)


@dataclass(frozen=True)
class DepthCamera:
    """Say which pixels have a depth, and how wrong it is.

    Errors are true millimetres, as the thesis sees them after calibration. They are pushed
    through the inverse of Eq. 2.4, so that calibration gives them back where Eq. 2.4 can.
    All statistics are published inputs or assumptions: that a measurement finds them again
    validates nothing.
    """

    wall_points: int = 200_000  # valid points per frame (sec. 5.1.3)
    kept_per_frame: float = 0.85  # of the pixels that can have depth; assumption
    wall_error: float = 0.022  # relative, common to a patch (sec. 2.1.5: about 1 m range at 8 m)
    wall_error_near_mm: float = 350.0  # between 2.6 and 3.4 m (sec. 2.1.5: more than 1 m range)
    patch_px: int = 28  # over which the wall's error is common; assumption
    white_mm: float = 0.6  # per point; more would contradict Fig. 5.7
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

    @cached_property
    def error_of(self) -> dict[str, float]:
        """Standard deviation of a particle's common error in mm, by fraction."""
        return dict(self.particle_error_mm)

    def captured(self, true_mm: npt.ArrayLike) -> Array:
        """Return the captured depth of a true depth in mm.

        It lies on the line through the captured depths of the plate at 1 m, 2 m, ... 11 m. The
        line is monotone, equal to the inverse of Eq. 2.4 there, and continued beyond.
        """
        return np.interp(np.asarray(true_mm, dtype=np.float64), *self._knots)

    @cached_property
    def _knots(self) -> tuple[Array, Array]:
        """Return true and captured depths of the plate in mm.

        Its first and last line are made longer.
        """
        true = np.array(PLATE_DISTANCES_MM)
        captured = invert_depth(true)
        ends = captured[[0, -1]] + np.diff(captured)[[0, -1]] / np.diff(true)[[0, -1]] * BEYOND_MM
        return (
            np.concatenate([true[:1] + BEYOND_MM[0], true, true[-1:] + BEYOND_MM[1]]),
            np.concatenate([ends[:1], captured, ends[1:]]),
        )

    def wall_scale(self, depth_mm: Array) -> Array:
        """Return the standard deviation of the wall's patch error in mm at a true depth."""
        near = (depth_mm > 2600.0) & (depth_mm < 3400.0)
        return self.scale * np.where(near, self.wall_error_near_mm, self.wall_error * depth_mm)


def see_plate(
    distance_mm: float,
    points: int,
    generator: np.random.Generator,
    camera: DepthCamera | None = None,
    geometry: Geometry | None = None,
) -> Array:
    """Return captured positions (points, 3) in mm of the test plate at one distance.

    A plate with black dots stands across the line of sight (sec. 2.1.5). The camera finds
    depth at the edges of dots inside the picture. The error of a patch of the picture is
    common to its points, as everywhere in the twin, and heavy-tailed. The scatter is an
    input, stated after the words of section 2.1.5: that it reappears validates nothing.

    Raises
    ------
    InputError
        If the distance is not positive.
    """
    check_number(distance_mm, "see_plate: distance_mm", above=0)
    camera, geometry = camera or DepthCamera(), geometry or Geometry()
    size = np.array([geometry.columns - 1, geometry.rows - 1])
    half_view = size / 2 * distance_mm / geometry.focal_length_px
    half = np.minimum(half_view, HALF_PLATE_MM)
    dots = np.round(generator.uniform(-half, half, (points, 2)) / PITCH_MM) * PITCH_MM
    angle = generator.uniform(0.0, 2 * np.pi, points)
    edge = dots + DOT_MM / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    place = np.column_stack([np.clip(edge, -half_view, half_view), np.full(points, distance_mm)])
    row, column = geometry.project(place)
    patch = np.stack([row // camera.patch_px, column // camera.patch_px], axis=1)
    patches, number = np.unique(patch, axis=0, return_inverse=True)
    common = generator.standard_t(TAIL, len(patches)) / np.sqrt(TAIL / (TAIL - 2))
    error = common[number.reshape(-1)] * camera.wall_scale(place[:, 2])
    error = error + camera.white_mm * generator.standard_normal(points)
    return geometry.unproject(row, column, camera.captured(distance_mm + error))


def see_all_plates(points: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """Return captured and true depth in mm, (11, points) each, at 1 m to 11 m."""
    captured = [see_plate(distance, points, generator)[:, 2] for distance in PLATE_DISTANCES_MM]
    true = np.repeat(np.array(PLATE_DISTANCES_MM)[:, None], points, axis=1)
    return np.stack(captured), true
