"""The 2.5D gate: the detections that a track may take (section 4.1.2).

An elliptical cylinder around each prediction (Fig. 4.2): an ellipse in the image by the
Mahalanobis distance, and a limit of the step in depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import gammainc

from kilnflight.association import Pairs
from kilnflight.checks import check_between, check_finite, check_limit, check_shape
from kilnflight.tracking.kalman import factor

Array = npt.NDArray[np.float64]

WIDEST = 1e6  # standard deviations; more lets everything pass and its area is no number


class Predicted(NamedTuple):
    """Predictions of n tracks in a frame, in d dimensions of the image."""

    positions: Array  # (n, d), px
    residual_covariance: Array  # (n, d, d), px^2: S = H P H' + R
    depth_mm: Array | None = None  # (n,), z of the last detection that had one; NaN: none had
    points: Array | None = None  # (n,), 3D points of the last detection that had any; NaN: none


class Detected(NamedTuple):
    """The m detections of a frame."""

    positions: Array  # (m, d), px
    depth_mm: Array | None = None  # (m,), NaN: no depth
    points: Array | None = None  # (m,), number of 3D points; NaN: unknown


@dataclass(frozen=True)
class Gate:
    """Limit the distance of detections from a track (Eq. 4.8).

    The gate is an elliptical cylinder: both distances are strictly below their limits. A
    ``distance`` of 0 is the gate that nothing passes.

    Notes
    -----
    Eq. 4.7 prints the covariance P of the state and the state x itself. A 2D distance between a
    prediction and a detection needs the prediction's position. Its covariance is that of their
    difference, S = H P H' + R, as in Eq. 2.50. These two are taken here.

    Neither limit is printed. ``distance`` 4 loses one detection of a thesis-like Gaussian
    track in 3000 (P_G = 0.9997), "a possibly large gating threshold" (4.1.3). JPDA's is "smaller
    than GNN" (section 5.2.3), by how much is not printed. ``depth_mm`` is the only step in depth
    that is printed, z_eps of Table 5.16. It holds for a track's gap of any length, since the error
    of the depth outweighs the motion. A detection without depth, or a track that never had one,
    passes.
    """

    distance: float = 4.0  # d_ij,eps, in standard deviations; not printed
    depth_mm: float = 1500.0  # d_z,eps; not printed, z_eps of Table 5.16

    def __post_init__(self) -> None:
        """Refuse limits that are no distances; depth may be unlimited."""
        check_between(self.distance, 0, WIDEST, "Gate: distance")
        check_limit(self.depth_mm, "Gate: depth_mm")

    def __call__(self, predicted: Predicted, detected: Detected) -> Pairs:
        """Return the pairs of tracks and detections within the gate.

        The size difference is 0 outside the gate and where either number is unknown.

        Raises
        ------
        InputError
            If shapes do not fit, positions are not finite, or a residual covariance is
            singular; the message names the track.
        """
        n, d = predicted.positions.shape
        check_shape(predicted.residual_covariance, (n, d, d), "residual covariance")
        check_shape(detected.positions, (None, d), "positions of detections")
        check_finite(detected.positions, "positions of detections")
        lower = factor(predicted.residual_covariance)
        apart = detected.positions.T - predicted.positions[:, :, None]
        squares = np.square(np.linalg.solve(lower, apart)).sum(axis=1)
        steps = _differences(predicted.depth_mm, detected.depth_mm, squares.shape)
        outside = (squares >= self.distance**2) | (steps >= self.depth_mm)  # NaN passes
        sizes = _differences(predicted.points, detected.points, squares.shape)
        sizes[outside | np.isnan(sizes)] = 0.0
        logs = 2.0 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        ball = np.pi ** (d / 2) / math.gamma(d / 2 + 1)  # volume of the unit ball
        areas = ball * self.distance**d * np.exp(logs / 2)
        probability = float(gammainc(d / 2, self.distance**2 / 2))
        return Pairs(np.where(outside, np.inf, squares), logs, sizes, areas, probability, d)


def _differences(tracks: Array | None, detections: Array | None, shape: tuple[int, ...]) -> Array:
    """Return absolute differences (n, m), NaN where either is unknown."""
    if tracks is None or detections is None:
        return np.full(shape, np.nan)
    return np.abs(np.asarray(tracks)[:, None] - detections)
