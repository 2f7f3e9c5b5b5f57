"""The filters of the belt's tracker: the kiln's motion models with a belt's numbers (mm, s)."""

from __future__ import annotations

import numpy as np

from kilnflight.checks import check_positive
from kilnflight.tracking.motion import ConstantAcceleration, ConstantVelocity

BELT_FRAME_S = 0.005  # 200 frames/s, section IV.B


def constant_velocity(
    frame_s: float = BELT_FRAME_S, spread_mm: float = 0.127, acceleration_mm_s2: float = 2000.0
) -> ConstantVelocity:
    """Return the filter of section II.B for a belt of 1500 mm/s.

    Parameters
    ----------
    frame_s
        Time between two frames in s.
    spread_mm
        Standard deviation of a measurement; the default is a choice, the size that rounding to
        whole pixels of 0.44 mm would have, 0.44 / sqrt(12). See the notes.
    acceleration_mm_s2
        By which the velocity may change from frame to frame; the default is 0.2 g, a belt's
        drag.

    Notes
    -----
    No number is printed. A particle comes with anything from 0 to the belt's 1500 mm/s: mean
    750, standard deviation 433. The noise changes its velocity by ``acceleration_mm_s2`` times
    ``frame_s`` in a frame.

    ``spread_mm`` was set before places were held against the truth, and is not fitted to it.
    Centroids are not rounded to pixels: what they scatter is less. But a place is that of the
    belt below a particle as the camera sees it, off by up to 0.5 mm for a sphere at the start of
    the belt and changing slowly from there on, so that errors of successive frames are not
    independent, as the filter takes them to be. Notebook 42 (belt16-pictures) has bias and root
    mean square (spheres: some 0.27 mm along the belt, 0.1 mm across it); neither follows from the
    error of the calibration, which is that of the corners.
    """
    check_positive(frame_s, "constant_velocity: frame_s")
    noise = acceleration_mm_s2 * np.sqrt(frame_s)
    return ConstantVelocity((750.0, 0.0), 433.0, float(noise), spread_mm)


def constant_acceleration(
    frame_s: float = BELT_FRAME_S, spread_mm: float = 0.127
) -> ConstantAcceleration:
    """Return the same with a constant acceleration, disturbed by white noise of the jerk.

    Notes
    -----
    The acceleration is 0 give or take 2000 mm/s^2 at first. It ends when the particle moves
    with the belt, after some 0.2 s: the noise changes it by its size in that time.
    """
    noise = 2000.0 / np.sqrt(0.2)
    return ConstantAcceleration((750.0, 0.0), 433.0, 2000.0, float(noise), spread_mm)
