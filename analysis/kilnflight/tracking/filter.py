"""Motion models, Kalman filter and 2.5D gate of all tracks at once.

Sections 2.3.1, 2.3.3, 4.1.1 and 4.1.2 of the thesis. A state is one row of an (n, k) array, its
covariance one (k, k) slice of an (n, k, k) array. It lists all positions, then all velocities (Eq.
4.1), then all accelerations. Lengths are in px and times in frames; the belt takes mm and s. The
control input B u of Eq. 2.42 is 0.

======================  =========  ==================================  ==============
motion                  equation   default of the noise                source
======================  =========  ==================================  ==============
`ConstantVelocity`      4.1-4.5    1 px/frame^1.5, tumbling sheets     thesis, 4.1.1
`ConstantAcceleration`  white      0.3 px/frame^2.5, particles that    belt papers
                        jerk       a belt accelerates                  2016 and 2020
======================  =========  ==================================  ==============

Notes
-----
The thesis prints neither process nor measurement noise. The defaults follow from the scene: 330
frames/s and about 3 mm per px at the lance make 5 to 30 px/frame. Drag changes that by a fraction
of a px/frame in each frame. The centroid of a tumbling sheet, lit from the side, jumps by 1 to 3
px. The defaults are not tuned to any result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from filterpy.common import Q_continuous_white_noise
from scipy.linalg import toeplitz
from scipy.special import gammainc

from kilnflight.arrays import Array, Integers
from kilnflight.association import Pairs
from kilnflight.checks import InputError, check_finite, check_number, check_shape

NO_ROWS: Integers = np.zeros(0, np.intp)


@dataclass(frozen=True)
class Motion:
    """Motion in d dimensions whose highest derivative is constant but for white noise.

    A state has k = d times the number of ``spreads`` entries. The noise is continuous, so two steps
    of one frame equal one step of two frames.

    Parameters
    ----------
    velocity
        (d,) px/frame, of a new track.
    spreads
        Standard deviations of a measurement (px), of a new track's velocity (px/frame) and, if
        given, of its acceleration (px/frame^2).
    noise
        Root of the density of the white noise: px/frame^1.5 of an acceleration, px/frame^2.5 of a
        jerk.
    """

    velocity: tuple[float, ...]
    spreads: tuple[float, ...]
    noise: float

    def __post_init__(self) -> None:
        check_shape(check_finite(self.velocity, "motion: velocity"), (None,), "motion: velocity")
        check_number(len(self.velocity), "motion: dimensions of velocity", least=1)
        names = ("measurement_sd", "velocity_sd", "acceleration_sd")
        for name, spread in zip(names, self.spreads, strict=False):
            check_number(spread, f"motion: {name}", above=0, most=1e30)
        check_number(self.noise, "motion: noise", above=0, most=1e30)

    def transition(self, frames: float) -> Array:
        """Return the transition matrix F (k, k) over a number of frames (Eq. 4.4)."""
        powers = [frames**k / math.factorial(k) for k in range(len(self.spreads))]
        block = toeplitz(np.eye(1, len(powers))[0], powers)
        return np.asarray(np.kron(block, np.eye(len(self.velocity))), dtype=np.float64)

    def process_noise(self, frames: float) -> Array:
        """Return the covariance Q (k, k) of the white noise over a number of frames."""
        order, axes, density = len(self.spreads), len(self.velocity), self.noise**2
        noise = Q_continuous_white_noise(order, float(frames), density, axes, order_by_dim=False)
        return np.asarray(noise, dtype=np.float64)

    def measurement(self) -> Array:
        """Return the measurement matrix H (d, k), which selects positions (sec. 4.1.4)."""
        axes = len(self.velocity)
        return np.eye(axes, axes * len(self.spreads))

    def measurement_noise(self) -> Array:
        """Return the covariance R (d, d) of a measurement in px^2, equal for all axes."""
        return self.spreads[0] ** 2 * np.eye(len(self.velocity))

    def initial(self, positions: Array) -> tuple[Array, Array]:
        """Return states (n, k) and covariances (n, k, k) of new tracks.

        ``positions`` (n, d) are those of their first detections, px.
        """
        axes, count = len(self.velocity), len(positions)
        variance = np.repeat(np.square(self.spreads), axes)
        state = np.zeros((count, len(variance)))
        state[:, :axes], state[:, axes : 2 * axes] = positions, self.velocity
        return state, np.repeat(np.diag(variance)[None], count, axis=0)


def ConstantVelocity(  # noqa: N802  named as the model
    velocity: tuple[float, ...] = (0.0, 0.0),
    velocity_sd: float = 15.0,  # px/frame: 30 px/frame, the fastest, are two of it
    acceleration_noise: float = 1.0,  # px/frame^1.5: 1 px/frame in a frame
    measurement_sd: float = 2.0,  # px: centroid of a tumbling sheet, 1 to 3
) -> Motion:
    """Return uniform motion with white noise of the acceleration (Eqs 4.1 to 4.5).

    Eq. 4.5 prints no Q. The thesis takes the motion between two frames as uniform (section 2.3.1).
    """
    return Motion(velocity, (measurement_sd, velocity_sd), acceleration_noise)


def ConstantAcceleration(  # noqa: N802  named as the model
    velocity: tuple[float, ...] = (0.0, 0.0),
    velocity_sd: float = 15.0,  # px/frame, as for constant velocity
    acceleration_sd: float = 1.0,  # px/frame^2: a fraction is usual in the kiln
    jerk_noise: float = 0.3,  # px/frame^2.5: 0.3 px/frame^2 in a frame
    measurement_sd: float = 2.0,  # px, as for constant velocity
) -> Motion:
    """Return uniform acceleration with white noise of the jerk.

    This is the motion model of the belt papers of 2016 and 2020. A new track has acceleration 0
    with standard deviation ``acceleration_sd``.
    """
    return Motion(velocity, (measurement_sd, velocity_sd, acceleration_sd), jerk_noise)


def predict(
    state: Array, covariance: Array, transition: Array, process_noise: Array
) -> tuple[Array, Array]:
    """Return the state (n, k) and covariance (n, k, k) of all tracks one step later.

    F and Q, (k, k), are the same for all tracks.

    Notes
    -----
    Eqs 2.44 and 2.45, with B u = 0. Eq. 2.45 prints the prior covariance on its right, but the
    text below it says posterior, and so does Eq. 4.6. The posterior is taken here.
    """
    spread = transition @ covariance @ transition.T + process_noise
    return state @ transition.T, _symmetric(spread)


def residual_covariance(covariance: Array, measurement: Array, noise: Array) -> Array:
    """Return the residual covariance S = H P H' + R, (n, d, d) in px^2.

    P is ``covariance`` (n, k, k), H ``measurement`` (d, k) and R ``noise`` (d, d). The gate and the
    association measure distances in S.
    """
    return _symmetric(measurement @ covariance @ measurement.T + noise)


def update(
    state: Array,
    covariance: Array,
    factor: Array,
    positions: Array,
    weights: Array,
    measurement: Array,
) -> tuple[Array, Array]:
    """Return the state (n, k) and covariance (n, k, k) after one frame's detections.

    Parameters
    ----------
    state, covariance
        Predictions of n tracks, (n, k) and (n, k, k).
    factor
        Cholesky factors L (n, d, d) of their residual covariances, `Pairs.factor`.
    positions
        Detections in this frame, (m, d) in px.
    weights
        (n, 1 + m), rows sum to 1; column 0 is "missed". A one-hot row is the textbook update (Eqs
        2.46-2.48). Weight 1 on "missed" returns the prediction bit by bit.
    measurement
        H (d, k).

    Notes
    -----
    Eqs 2.52-2.56. Eq. 2.55 is taken as printed, by Cholesky's factor L of S. With W' = L^-1 H P,
    the gain is K = W L^-1 and K S K' = W W'. Eq. 2.56 is computed as the scatter of the
    innovations about their mean, "missed" counting as an innovation of zero. This is the printed
    term, as a sum of squares.
    """
    root = np.linalg.solve(factor, measurement @ covariance)  # W' (n, d, k)
    expected = (state @ measurement.T)[:, :, None]
    shares = weights[:, 1:, None]
    mean = np.linalg.solve(factor, positions.T @ shares - shares.sum(axis=1)[:, None] * expected)
    moved = state + (root.mT @ mean)[:, :, 0]  # Eqs 2.46 and 2.52
    spread = covariance - (1.0 - weights[:, :1, None]) * (root.mT @ root)  # Eq. 2.54 with 2.55
    several = np.flatnonzero((weights > 0).sum(axis=1) > 1)
    if len(several):
        innovations = np.linalg.solve(factor[several], positions.T - expected[several])
        apart = np.concatenate([0.0 * mean[several], innovations], axis=2) - mean[several]
        scatter = (weights[several, None] * apart) @ apart.mT
        spread[several] += root[several].mT @ scatter @ root[several]  # Eq. 2.56
    missed = weights[:, 0] == 1.0
    moved[missed] = state[missed]
    spread = _symmetric(spread)
    spread[missed] = covariance[missed]
    return moved, spread


def _symmetric(matrices: Array) -> Array:
    return np.asarray(0.5 * (matrices + matrices.mT), dtype=np.float64)


class Detected(NamedTuple):
    """Detections of one frame, m in number and in d dimensions."""

    positions: Array  # (m, d), px; on the belt mm
    depth_mm: Array | None = None  # (m,), NaN: no depth
    points: Array | None = None  # (m,), number of 3D points; NaN: unknown
    frame: int = 0  # its number
    span: float = 1.0  # since the `Detected` before, in the unit of the motion: frames, or s (belt)
    rows: Integers = NO_ROWS  # (m,), row numbers in the table of detections


@dataclass(frozen=True)
class Gate:
    """Limit the distance of detections from a track (Eq. 4.8).

    The gate is an elliptical cylinder (Fig. 4.2). A pair is inside if its Mahalanobis distance in
    the image and its difference in depth are both strictly below their limits. With ``distance`` 0
    no pair passes.

    Notes
    -----
    Eq. 4.7 prints the covariance P of the state and the state x itself. A 2D distance between a
    prediction and a detection needs the predicted position. The covariance of their difference is
    S = H P H' + R, as in Eq. 2.50. These two are taken here.

    Neither limit is printed. ``distance`` 4 loses one detection of a thesis-like Gaussian
    track in 3000 (P_G = 0.9997), "a possibly large gating threshold" (4.1.3). JPDA's is "smaller
    than GNN" (section 5.2.3), by how much is not printed. ``depth_mm`` is the only step in depth
    that is printed, z_eps of Table 5.16. It holds for a gap of any length, since the error of the
    depth outweighs the motion. A pair without depth on either side is judged in the image alone.
    """

    distance: float = 4.0  # d_ij,eps, in standard deviations; not printed
    depth_mm: float = 1500.0  # d_z,eps; not printed, z_eps of Table 5.16; may be infinite

    def __post_init__(self) -> None:
        check_number(self.distance, "Gate: distance", least=0, most=1e6)  # areas stay finite
        if self.depth_mm != math.inf:
            check_number(self.depth_mm, "Gate: depth_mm", least=0)

    def __call__(
        self,
        expected: Array,
        residual: Array,
        detected: Detected,
        depth_mm: Array | None = None,
        points: Array | None = None,
    ) -> Pairs:
        """Return the distances of all pairs of n tracks and m detections.

        Every pair is an entry (n, m); those outside the gate have an infinite distance. A pair
        whose depth is unknown on either side is judged by its distance in the image alone.

        Parameters
        ----------
        expected, residual
            Predicted positions (n, d) in px and residual covariances S (n, d, d) in px^2; on the
            belt in mm and mm^2.
        detected
            The m detections of the frame.
        depth_mm, points
            (n,) last known depth and number of 3D points of each track; NaN: unknown. None: unknown
            for all.

        Returns
        -------
        Pairs
            By pair (n, m): squared Mahalanobis distance, inf outside the gate, and difference in 3D
            points, 0 outside or where unknown. By track: ``ln |S|`` (n,), area V of the gate (n,),
            the predictions (n, d), S and its Cholesky factor (n, d, d). One number: P_G, the
            probability of a detection within the ellipse. Associators and `update` need these.

        Raises
        ------
        InputError
            If a residual covariance is singular.
        """
        try:
            factor = np.asarray(np.linalg.cholesky(residual), np.float64)
        except np.linalg.LinAlgError as error:
            raise InputError(
                "motion: a residual covariance (S = H P H' + R) is singular. Give the motion more "
                "measurement noise."
            ) from error
        apart = detected.positions.T - expected[:, :, None]
        squares = np.square(np.linalg.solve(factor, apart)).sum(axis=1)
        steps = _differences(depth_mm, detected.depth_mm, squares.shape)
        outside = (squares >= self.distance**2) | (steps >= self.depth_mm)  # NaN passes
        sizes = _differences(points, detected.points, squares.shape)
        sizes[outside | np.isnan(sizes)] = 0.0
        logs = 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        d = expected.shape[1]
        ball = np.pi ** (d / 2) / math.gamma(d / 2 + 1)  # volume of the unit ball
        areas = ball * self.distance**d * np.exp(logs / 2)
        probability = float(gammainc(d / 2, self.distance**2 / 2))
        squares = np.where(outside, np.inf, squares)
        return Pairs(squares, logs, sizes, areas, probability, expected, residual, factor)


def _differences(tracks: Array | None, detections: Array | None, shape: tuple[int, ...]) -> Array:
    """Return absolute differences (n, m) of tracks (n,) and detections (m,).

    NaN where either is unknown. ``shape`` is (n, m).
    """
    if tracks is None or detections is None:
        return np.full(shape, np.nan)
    return np.abs(tracks[:, None] - detections)
