"""Depth calibration of a point cloud against the textbook way in numpy, and point by point."""

from __future__ import annotations

import numpy as np
from measure import Row, compare

from kilnflight.camera import calibrate_depth

POINTS = (50_000, 200_000, 1_000_000)


def piecewise(depth: np.ndarray) -> np.ndarray:
    """Return Eq. 2.4 by numpy.piecewise."""
    return np.piecewise(
        depth,
        [depth < 3000, (depth >= 3000) & (depth <= 5000), depth > 5000],
        [
            lambda z: -0.002055 * z**2 + 10.65 * z - 10230,
            lambda z: -0.00004158 * z**2 + 1.367 * z - 857.5,
            lambda z: 0.00004504 * z**2 + 0.3219 * z + 2189,
        ],
    )


def rows() -> list[Row]:
    """Return every comparison, the results checked to be equal."""
    found = []
    for points in POINTS:
        depth = np.random.default_rng(points).uniform(1000.0, 11_000.0, points)
        np.testing.assert_allclose(calibrate_depth(depth), piecewise(depth), atol=1e-6)
        found.append(
            compare(
                ("depth calibration, Eq. 2.4", "points", points, "numpy.piecewise"),
                lambda depth=depth: calibrate_depth(depth),
                lambda depth=depth: piecewise(depth),
            )
        )
    return found
