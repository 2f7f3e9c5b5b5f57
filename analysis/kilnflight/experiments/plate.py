"""The test plate of section 2.1.5: black dots at a known distance, seen by the depth camera."""

from __future__ import annotations

import numpy as np

from kilnflight.arrays import Array
from kilnflight.camera import PLATE_DISTANCES_MM, invert_depth
from kilnflight.checks import check_number
from kilnflight.twin.geometry import Geometry

DOT_MM = 14.0  # diameter
PITCH_MM = 28.0  # of the dots
HALF_PLATE_MM = 420.0  # of the plate, a square; Fig. 2.13 gives no number
PATCH_PX = 28  # of the picture, over which the error is common; assumption
WHITE_MM = 0.6  # error of a point; more would contradict Fig. 5.7
FAR_ERROR, NEAR_MM, NEAR_ERROR_MM = 0.022, (2600.0, 3400.0), 350.0  # relative; ranges of sec. 2.1.5
TAIL = 4.0  # degrees of freedom of Student's t: "lots of outliers"


def captured_mm(true_mm: Array) -> Array:
    """Return the captured depth of true depths in mm.

    It lies on the line through the captured depths of the plate at 1 m, 2 m, ... 11 m, continued
    beyond: monotone, and equal to the inverse of Eq. 2.4 there.
    """
    true = np.array(PLATE_DISTANCES_MM)
    captured = invert_depth(true)
    ends, beyond = [0, -1], np.array([-1e5, 1e5])
    slopes = np.diff(captured)[ends] / np.diff(true)[ends]
    first, last = captured[ends] + slopes * beyond
    knots = np.concatenate([true[:1] - 1e5, true, true[-1:] + 1e5])
    return np.asarray(np.interp(true_mm, knots, [first, *captured, last]), dtype=np.float64)


def see_plate(
    distance_mm: float, points: int, generator: np.random.Generator, scatter: bool = True
) -> Array:
    """Return captured positions (points, 3) in mm of the test plate at one distance.

    The plate stands across the line of sight. The camera finds depth at the edges of dots inside
    the picture. The error of a patch of the picture is common to its points and heavy-tailed. The
    scatter is an input, after the words of section 2.1.5: that it reappears validates nothing.
    """
    check_number(distance_mm, "see_plate: distance_mm", above=0)
    geometry = Geometry()
    size = np.array([geometry.columns - 1, geometry.rows - 1])
    half_view = size / 2 * distance_mm / geometry.focal_length_px
    half = np.minimum(half_view, HALF_PLATE_MM)
    dots = np.round(generator.uniform(-half, half, (points, 2)) / PITCH_MM) * PITCH_MM
    angle = generator.uniform(0.0, 2 * np.pi, points)
    edge = dots + DOT_MM / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    place = np.column_stack([np.clip(edge, -half_view, half_view), np.full(points, distance_mm)])
    row, column = geometry.project(place)
    patch = np.stack([row // PATCH_PX, column // PATCH_PX], axis=1)
    patches, number = np.unique(patch, axis=0, return_inverse=True)
    common = generator.standard_t(TAIL, len(patches)) / np.sqrt(TAIL / (TAIL - 2))
    near = NEAR_MM[0] < distance_mm < NEAR_MM[1]
    error = common[number.reshape(-1)] * (NEAR_ERROR_MM if near else FAR_ERROR * distance_mm)
    error = scatter * (error + WHITE_MM * generator.standard_normal(points))
    return geometry.unproject(row, column, captured_mm(distance_mm + error))


def see_all_plates(points: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """Return captured and true depth in mm, (11, points) each, at 1 m to 11 m."""
    captured = [see_plate(distance, points, generator)[:, 2] for distance in PLATE_DISTANCES_MM]
    true = np.repeat(np.array(PLATE_DISTANCES_MM)[:, None], points, axis=1)
    return np.stack(captured), true
