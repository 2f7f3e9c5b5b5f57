"""Kalman predict and update of all tracks at once against one filterpy object per track.

Ours is told the dense weights of an associator, (tracks, 1 + detections), as in the tracker;
filterpy is told the detection of each track.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import KalmanFilter
from measure import Row, compare

from kilnflight.tracking.filter import ConstantVelocity, predict, residual_covariance, update

TRACKS = (50, 500, 5000)
PEER = "filterpy, one object per track"
MOTION = ConstantVelocity()
F, Q = MOTION.transition(1.0), MOTION.process_noise(1.0)
H, R = MOTION.measurement(), MOTION.measurement_noise()


def ours(state: np.ndarray, covariance: np.ndarray, seen: np.ndarray, weights: np.ndarray) -> tuple:
    """Return state and covariance after one frame."""
    state, covariance = predict(state, covariance, F, Q)
    factor = np.linalg.cholesky(residual_covariance(covariance, H, R))
    return update(state, covariance, factor, seen, weights, H)


def one_by_one(filters: list[KalmanFilter], seen: np.ndarray) -> None:
    """Take every track through the same frame; its detection is known."""
    for one, position in zip(filters, seen, strict=True):
        one.predict()
        one.update(position)


def objects(state: np.ndarray, covariance: np.ndarray) -> list[KalmanFilter]:
    """Return a filterpy object per track."""
    filters = []
    for x, p in zip(state, covariance, strict=True):
        one = KalmanFilter(dim_x=4, dim_z=2)
        one.x, one.P, one.F, one.Q, one.H, one.R = x.copy(), p.copy(), F, Q, H, R
        filters.append(one)
    return filters


def rows() -> list[Row]:
    """Return every comparison, the results checked to be equal."""
    result = []
    for tracks in TRACKS:
        generator = np.random.default_rng(tracks)
        seen = generator.uniform(0, 1500, (tracks, 2))
        state, covariance = MOTION.initial(seen + generator.normal(0, 5, seen.shape))
        filters = objects(state, covariance)
        one_by_one(filters, seen)
        expected = [one.x for one in filters], [one.P for one in filters]
        weights = np.eye(tracks, 1 + tracks, 1)  # track i has detection i
        arguments = (state, covariance, seen, weights)
        moved, spread = ours(*arguments)
        np.testing.assert_allclose(moved, expected[0], rtol=1e-9)
        np.testing.assert_allclose(spread, expected[1], rtol=1e-9, atol=1e-9)
        what = "Kalman predict and update", "tracks", tracks, PEER
        result.append(
            compare(
                what,
                lambda arguments=arguments: ours(*arguments),
                lambda filters=filters, seen=seen: one_by_one(filters, seen),
                repeats=9,
            )
        )
    return result
