"""Kalman predict and update of all tracks at once against one filterpy object per track."""

from __future__ import annotations

import numpy as np
from filterpy.kalman import KalmanFilter
from measure import Row, compare

from kilnflight import kalman
from kilnflight.motion import ConstantVelocity

TRACKS = (50, 500, 5000)
MOTION = ConstantVelocity()
F, Q = MOTION.transition(1.0), MOTION.process_noise(1.0)
H, R = MOTION.measurement(), MOTION.measurement_noise()


def ours(state: np.ndarray, covariance: np.ndarray, seen: np.ndarray, weights: np.ndarray) -> tuple:
    """Return state and covariance after one frame."""
    state, covariance = kalman.predict(state, covariance, F, Q)
    return kalman.update(state, covariance, seen, weights, H, R)


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
        weights = np.eye(tracks, 1 + tracks, 1)  # track i takes detection i
        filters = objects(state, covariance)
        one_by_one(filters, seen)
        moved, spread = ours(state, covariance, seen, weights)
        np.testing.assert_allclose(moved, [one.x for one in filters], rtol=1e-9)
        np.testing.assert_allclose(spread, [one.P for one in filters], rtol=1e-9, atol=1e-9)
        arguments = (state, covariance, seen, weights)
        result.append(
            compare(
                ("Kalman predict and update", "tracks", tracks, "filterpy, one object per track"),
                lambda arguments=arguments: ours(*arguments),
                lambda filters=filters, seen=seen: one_by_one(filters, seen),
                repeats=5,
            )
        )
    return result
