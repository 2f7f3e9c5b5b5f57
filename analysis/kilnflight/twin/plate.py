"""The test plate of section 2.1.5 as the twin's camera sees it.

A plate with black dots of 14 mm at 28 mm pitch stands across the line of sight at 1 m, 2 m,
... 11 m. The camera finds depth at the edges of the dots. The scatter is an input (see
`kilnflight.twin.depth`), stated after the words of section 2.1.5: that it reappears
validates nothing.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kilnflight.camera import PLATE_DISTANCES_MM
from kilnflight.checks import check_positive
from kilnflight.twin.depth import DepthCamera
from kilnflight.twin.geometry import Geometry

Array = npt.NDArray[np.float64]

DOT_MM = 14.0  # diameter (sec. 2.1.5)
PITCH_MM = 28.0  # of the dots (sec. 2.1.5)
HALF_SIZE_MM = 420.0  # of the plate, a square; Fig. 2.13 gives no number
TAIL = 4.0  # degrees of freedom of Student's t: "lots of outliers" (sec. 2.1.5)


def see_plate(
    distance_mm: float,
    points: int,
    generator: np.random.Generator,
    camera: DepthCamera | None = None,
    geometry: Geometry | None = None,
) -> Array:
    """Return captured positions (points, 3) in mm of a plate at one distance.

    Points lie on the edges of dots inside the picture. The error of a patch of the picture
    is common to its points, as everywhere in the twin, and heavy-tailed.

    Raises
    ------
    InputError
        If the distance is not positive.
    """
    check_positive(distance_mm, "see_plate: distance_mm")
    camera, geometry = camera or DepthCamera(), geometry or Geometry()
    size = np.array([geometry.columns - 1, geometry.rows - 1])
    seen = size / 2 * distance_mm / geometry.focal_length_px
    half = np.minimum(seen, HALF_SIZE_MM)
    dots = np.round(generator.uniform(-half, half, (points, 2)) / PITCH_MM) * PITCH_MM
    angle = generator.uniform(0.0, 2 * np.pi, points)
    edge = dots + DOT_MM / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    place = np.column_stack([np.clip(edge, -seen, seen), np.full(points, distance_mm)])
    row, column = geometry.project(place)
    error = _patch_error(row, column, generator, camera) * camera.wall_scale(place[:, 2])
    error = error + camera.white_mm * generator.standard_normal(points)
    return geometry.unproject(row, column, camera.captured(distance_mm + error))


def _patch_error(
    row: Array, column: Array, generator: np.random.Generator, camera: DepthCamera
) -> Array:
    """Return heavy-tailed errors of unit variance, one per patch, (points,)."""
    patch = np.stack([row // camera.patch_px, column // camera.patch_px], axis=1)
    known, number = np.unique(patch, axis=0, return_inverse=True)
    draws = generator.standard_t(TAIL, len(known)) / np.sqrt(TAIL / (TAIL - 2))
    return draws[number.reshape(-1)]


def see_all_plates(
    points: int, generator: np.random.Generator, camera: DepthCamera | None = None
) -> tuple[Array, Array]:
    """Return captured and true depth in mm, (11, points) each, at 1 m to 11 m."""
    captured = [
        see_plate(distance, points, generator, camera)[:, 2] for distance in PLATE_DISTANCES_MM
    ]
    true = np.repeat(np.array(PLATE_DISTANCES_MM)[:, None], points, axis=1)
    return np.stack(captured), true
