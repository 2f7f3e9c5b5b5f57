"""Linear Kalman filter of all tracks at once (thesis, sections 2.3.1 and 2.3.3).

A state is one row of an (n, k) array, its covariance one (k, k) slice of an (n, k, k)
array. The update takes association weights, so one function serves the textbook filter
(rows of 0 and 1) and probabilistic data association (rows of probabilities).
"""

from kilnflight.tracking.kalman.correction import update
from kilnflight.tracking.kalman.matrices import factor, residual_covariance
from kilnflight.tracking.kalman.prediction import predict

__all__ = ["factor", "predict", "residual_covariance", "update"]
