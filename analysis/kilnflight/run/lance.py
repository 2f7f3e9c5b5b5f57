"""Where the lance's outlet lies in the picture of a recording.

A recording holds no focal length. Its points in space do: each has a pixel, and a pinhole camera
sees a point at x/z and y/z.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from kilnflight.camera import calibrate_points
from kilnflight.recording.frames import Recording

LEAST_POINTS = 10  # in space, of two unknowns a direction


def place_in_picture(
    recording: Recording, frames: Iterable[int], point_mm: tuple[float, float, float]
) -> tuple[float, float] | None:
    """Return row and column of a point in space, fitted to the clouds of some frames.

    Parameters
    ----------
    recording
        With depth.
    frames
        Whose clouds are used.
    point_mm
        In front of the camera, its depth calibrated.

    Returns
    -------
    tuple
        May lie outside the picture; None if the clouds are too small, or all in one line.
    """
    calibration, parts = recording.attributes.depth_calibration, []
    for frame in map(recording.frame, frames):
        places = calibrate_points(frame.xyz, calibration)
        parts.append(np.hstack([frame.pixels, places])[places[:, 2] > 0])
    table = np.concatenate(parts) if parts else np.empty((0, 5))
    if len(table) < LEAST_POINTS:
        return None
    found = []
    for pixel, axis in ((0, 3), (1, 2)):  # rows run with y, columns with x
        ray = np.column_stack([np.ones(len(table)), table[:, axis] / table[:, 4]])
        solution, _, rank, _ = np.linalg.lstsq(ray, table[:, pixel], rcond=None)
        if rank < 2:
            return None
        found.append(float(solution @ [1.0, point_mm[axis - 2] / point_mm[2]]))
    return found[0], found[1]
