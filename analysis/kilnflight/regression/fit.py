"""Three polynomials in time through one point, and how well they fit (thesis, section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kilnflight.checks import check_finite, check_shape

Array = npt.NDArray[np.float64]
Three = tuple[float, float, float]


@dataclass(frozen=True)
class Fit:
    """A regressed trajectory: called with times (n,) in s, it returns places (n, 3) in mm.

    What holds one value per axis is in the order x, y, z. Along each axis the place is
    ``exit + c_1 (t - t0) + c_2 (t - t0)^2 + ...``, Eq. 4.29 written with the time since t0.
    R2 and its adjusted form are NaN along an axis along which the detections do not move,
    MAPE is NaN along one where all coordinates are 0: there they are not defined.

    >>> fit = Fit((0.0, 0.0, 6500.0), 0.1, 0, (0.0, 0.1), (2, 2, 2),
    ...           ((1.0, 0.0), (0.0, -4.9), (-9000.0, 0.0)), 0.2, 0.5, 60)
    >>> fit(0.2).round(3).tolist()
    [[0.1, -0.049, 5600.0]]
    """

    exit_point_mm: Three  # the lance's exit
    t0_s: float  # time at the exit
    t0_at_bound: int  # -1: t0 is the earliest of its range, 1: the latest, 0: between
    t0_range_s: tuple[float, float]  # from the earliest to the latest
    orders: tuple[int, int, int]
    coefficients: tuple[tuple[float, ...], ...]  # mm/s, mm/s^2, ... per axis
    first_s: float  # first detection
    last_s: float  # last detection
    points: int  # number of detections
    rmse_mm: Three = (np.nan,) * 3  # Eq. 4.30
    mape_percent: Three = (np.nan,) * 3  # Eq. 4.31
    r2: Three = (np.nan,) * 3  # Eq. 4.32
    r2_adjusted: Three = (np.nan,) * 3  # Eq. 4.33

    @property
    def t0(self) -> float:
        """The time at the exit in s, by its symbol."""
        return self.t0_s

    def __call__(self, time_s: npt.ArrayLike) -> Array:
        """Return the places (n, 3) in mm at times (n,) in s, or at one time."""
        since = self._since(time_s)
        curves = [np.polyval([*reversed(axis), 0.0], since) for axis in self.coefficients]
        places: Array = np.stack(curves, axis=-1) + np.array(self.exit_point_mm)
        return places

    def velocity(self, time_s: npt.ArrayLike) -> Array:
        """Return the velocities (n, 3) in mm/s at times (n,) in s, or at one time."""
        since = self._since(time_s)
        rates = [[c * (k + 1) for k, c in enumerate(axis)] for axis in self.coefficients]
        return np.stack([np.polyval(axis[::-1], since) for axis in rates], axis=-1)

    def _since(self, time_s: npt.ArrayLike) -> Array:
        """Return the times since t0."""
        time = np.atleast_1d(check_finite(time_s, "Fit: time"))
        check_shape(time, (None,), "Fit: time")
        return time - self.t0_s


def measures(places: Array, fitted: Array, order: int) -> tuple[float, float, float, float]:
    """Return RMSE, MAPE in %, R2 and adjusted R2 of one axis (Eqs 4.30 to 4.33, thesis).

    Parameters
    ----------
    places, fitted
        (n,) coordinates in mm, measured and regressed; n - (order + 1) is above 0.

    Notes
    -----
    Points whose coordinate is exactly 0 have no relative error (Eq. 4.31 divides by it);
    they are left out of its sum and of its n. Points near 0 stay, as printed: one of
    them can make MAPE large, which is why Table 5.18 gives medians over trajectories.
    """
    n, k = len(places), order
    squares = float(np.sum((places - fitted) ** 2))
    rmse = float(np.sqrt(squares / (n - (k + 1))))
    there = places != 0
    relative = np.abs((places[there] - fitted[there]) / places[there])
    mape = float(100 * relative.mean()) if there.any() else np.nan
    about_mean = float(np.sum((places - places.mean()) ** 2))
    if places.min() == places.max() or about_mean == 0:  # Eq. 4.32 divides by it
        return rmse, mape, np.nan, np.nan
    r2 = 1 - squares / about_mean
    return rmse, mape, r2, r2 - (1 - r2) * k / (n - (k + 1))
