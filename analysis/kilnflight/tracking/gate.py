"""2.5D gate: which detections a track may take at all (thesis, section 4.1.2).

An elliptical cylinder around each prediction (Fig. 4.2): an ellipse in the image by the
Mahalanobis distance, and a limit of the step in depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.special import gammainc

from kilnflight.association import Pairs
from kilnflight.checks import InputError, check_between, check_finite, check_limit, check_shape
from kilnflight.tracking.kalman import factor

Array = npt.NDArray[np.float64]

WIDEST = 1e6  # standard deviations; more lets everything pass and its area is no number


class Predicted(NamedTuple):
    """Where n tracks are expected in a frame, in d dimensions of the image."""

    positions: Array  # (n, d), px
    residual_covariance: Array  # (n, d, d), px^2: S = H P H' + R
    depth_mm: Array  # (n,), z of the last detection that had one; NaN: none ever had
    points: Array  # (n,), 3D points of the last detection that had any; NaN: none ever had


class Detected(NamedTuple):
    """The m detections of a frame."""

    positions: Array  # (m, d), px
    depth_mm: Array  # (m,), NaN: no depth
    points: Array  # (m,), number of 3D points; NaN: unknown


@dataclass(frozen=True)
class Gate:
    """Elliptical cylinder, Eq. 4.8: both distances strictly below their limits.

    A ``distance`` of 0 is the gate that nothing passes.

    Notes
    -----
    Eq. 4.7 prints the covariance P of the state and the state x itself. A 2D distance
    between a prediction and a detection needs the prediction's position and the covariance
    of their difference, S = H P H' + R, as in Eq. 2.50; that is what is taken.

    Neither limit is printed. ``distance`` 4 loses one detection of a thesis-like Gaussian
    track in 3000 (P_G = 0.9997), "a possibly large gating threshold" (4.1.3); the thesis
    gives JPDA a smaller one. ``depth_mm`` is the only step in depth that is printed, z_eps
    of Table 5.16; it holds for a track's gap of any length, since the error of the depth
    outweighs the motion. A detection without depth, or a track that never had one, passes.
    """

    distance: float = 4.0  # d_ij,eps, in standard deviations; not printed
    depth_mm: float = 1500.0  # d_z,eps; not printed, z_eps of Table 5.16

    def __post_init__(self) -> None:
        """Refuse a gate that is no distance; no limit at all (inf) is none for depth only."""
        check_between(self.distance, 0, WIDEST, "Gate: distance")
        check_limit(self.depth_mm, "Gate: depth_mm")

    def __call__(self, predicted: Predicted, detected: Detected) -> Pairs:
        """Return distances, determinants, differences in size, and areas of the gates.

        ``size_difference`` is 0 outside the gate and where either number is unknown.

        Raises
        ------
        InputError
            If shapes do not fit, positions are not finite, or a residual covariance is
            singular; the message names the track.
        """
        n, d = predicted.positions.shape
        check_shape(predicted.residual_covariance, (n, d, d), "residual covariance")
        check_shape(detected.positions, (None, d), "positions of detections")
        for name, places in (("predictions", predicted[0]), ("detections", detected[0])):
            if not np.isfinite(places).all():  # the quick look first
                check_finite(places, f"positions of {name}")
        # plain arrays: for others numba would compile it again
        known: list[Any] = [np.array(part, np.float64, order="C") for part in predicted]
        known += [np.array(part, np.float64, order="C") for part in detected]
        known += [float(self.distance) ** 2, float(self.depth_mm)]
        squares, logs, sizes, singular = _gate(*known)
        if singular >= 0:
            raise InputError(
                f"Gate: the residual covariance of track {singular} is singular or not finite. "
                "Give the motion model some measurement noise."
            )
        ball = np.pi ** (d / 2) / math.gamma(d / 2 + 1)  # volume of the unit ball
        areas = ball * self.distance**d * np.exp(logs / 2)
        return Pairs(squares, logs, sizes, areas, float(gammainc(d / 2, self.distance**2 / 2)), d)


@njit(cache=True)
def _gate(
    expected: Any,
    residual: Any,
    depths: Any,
    sizes: Any,
    seen: Any,
    seen_depths: Any,
    seen_sizes: Any,
    limit: float,
    depth: float,
) -> Any:
    """Return d^2 (inf outside), ln |S|, differences in size, and the first singular track.

    The strip of the first axis that holds the ellipse is looked at first; few pairs are left.
    Sorting or a tree would pay beyond a thousand tracks only (1000 x 1000 pairs: see
    benchmarks/bench_tracking.py).
    """
    n, d = expected.shape
    m = len(seen)
    squares, differences, logs = np.full((n, m), np.inf), np.zeros((n, m)), np.zeros(n)
    lower, apart = np.zeros((d, d)), np.empty(d)
    for i in range(n):
        if not factor(residual[i], lower):
            return squares, logs, differences, i
        for a in range(d):
            logs[i] += 2.0 * np.log(lower[a, a])
        reach = np.sqrt(limit * residual[i, 0, 0])
        for j in range(m):
            apart[0] = seen[j, 0] - expected[i, 0]
            if abs(apart[0]) > reach:
                continue
            if abs(seen_depths[j] - depths[i]) >= depth:  # NaN passes
                continue
            for a in range(1, d):
                apart[a] = seen[j, a] - expected[i, a]
            square = _squared(apart, lower)
            if square < limit:
                squares[i, j] = square
                difference = abs(seen_sizes[j] - sizes[i])
                differences[i, j] = 0.0 if np.isnan(difference) else difference
    return squares, logs, differences, -1


@njit(cache=True)
def _squared(apart: Any, lower: Any) -> float:
    """Return the squared Mahalanobis distance; ``apart`` is used up."""
    square = 0.0
    for a in range(len(apart)):
        for b in range(a):
            apart[a] -= lower[a, b] * apart[b]
        apart[a] /= lower[a, a]
        square += apart[a] * apart[a]
    return square
