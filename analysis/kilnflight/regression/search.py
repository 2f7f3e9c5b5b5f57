"""The best t0 of every combination of orders (thesis, section 4.3)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.regression.loss import Loss
from kilnflight.regression.projection import COST, CURVATURE, SLOPE, profile_at

Array = npt.NDArray[np.float64]

PLACES = 65  # values of t0 at which a few points are tried, to find the right valley
RADIUS = 0.1  # of the range of t0; first radius of the trust region
STEPS = 60  # of the trust region, at most
SHORTEST = 1e-6  # of the track's duration, from t0 to the first detection
SETTLED = 1e-10  # of the range of t0; a shorter step ends the search


@njit(cache=True)
def descend(
    time: Any, places: Any, orders: Any, loss: int, limits: Any, start: float, radius: float
) -> Any:
    """Return the t0 of least cost within ``limits`` and the cost (3,) per axis.

    A trust region for the one unknown that is left: the Gauss-Newton step, no longer than
    the radius and not beyond the limits; the radius follows how well the model foretold.
    """
    trial = np.zeros((3, orders.max() + 1, 3))
    here = _sum(time, places, start, orders, loss, trial)
    per_axis = np.array([trial[axis, orders[axis], COST] for axis in range(3)])
    for _ in range(STEPS):
        if here[CURVATURE] <= 0.0:
            break
        step = min(max(-here[SLOPE] / here[CURVATURE], -radius), radius)
        step = min(max(start + step, limits[0]), limits[1]) - start
        if abs(step) <= SETTLED * (limits[1] - limits[0]):
            break
        there = _sum(time, places, start + step, orders, loss, trial)
        foretold = -(2.0 * here[SLOPE] + here[CURVATURE] * step) * step
        gained = here[COST] - there[COST]
        if gained < 0.25 * foretold:
            radius = 0.25 * abs(step)
        elif gained > 0.75 * foretold:
            radius = max(radius, 2.0 * abs(step))
        if gained > 0.0:
            bend = (there[SLOPE] - here[SLOPE]) / step
            start, here = min(max(start + step, limits[0]), limits[1]), there
            if bend > 0.0:  # the true curvature, which Gauss and Newton leave a part of out
                here[CURVATURE] = bend
            per_axis = np.array([trial[axis, orders[axis], COST] for axis in range(3)])
    return start, per_axis


@njit(cache=True)
def _sum(time: Any, places: Any, start: float, orders: Any, loss: int, trial: Any) -> Any:
    """Return cost, slope and curvature of one combination, and leave its profile in ``trial``."""
    profile_at(time, places, start, orders, orders, loss, trial)
    return trial[0, orders[0]] + trial[1, orders[1]] + trial[2, orders[2]]


class Combinations:
    """The combinations of orders of one track: each is solved when it is first asked for.

    Parameters
    ----------
    time, places
        (n,) and (3, n), coordinates minus exit over their scale.
    lowest, highest
        Orders from ``lowest`` to ``highest`` (3,).
    loss
        A `kilnflight.regression.loss.Loss`, as a number.
    limits, first
        Earliest and latest t0, and where to begin.
    """

    def __init__(
        self,
        time: Array,
        places: Array,
        lowest: int,
        highest: Any,
        loss: int,
        limits: Any,
        first: float,
    ) -> None:
        self.time, self.places, self.lowest, self.loss = time, places, lowest, loss
        self.limits, self.first = limits, first
        self.shape = tuple(int(order) - lowest + 1 for order in highest)
        self.solved: dict[tuple[int, int, int], tuple[float, Array]] = {}

    def __getitem__(self, place: tuple[int, int, int]) -> Array:
        """Return the cost (3,) per axis of the orders ``lowest`` + ``place``."""
        return self._solve(place)[1]

    def start(self, place: tuple[int, int, int]) -> float:
        """Return the best t0 of the orders ``lowest`` + ``place``."""
        return float(self._solve(place)[0])

    def _solve(self, place: tuple[int, int, int]) -> tuple[float, Array]:
        if place not in self.solved:
            orders, radius = np.array(place) + self.lowest, RADIUS * np.diff(self.limits)[0]
            self.solved[place] = descend(
                self.time, self.places, orders, self.loss, self.limits, self.first, radius
            )
        return self.solved[place]


@njit(cache=True)
def solve_draws(time: Any, places: Any, draws: Any, loss: int, limits: Any) -> Any:
    """Return the t0 (draws,) of Eq. 4.29, quadratic, through a few points each (draws, 3)."""
    orders = np.full(3, 2)
    grid = np.linspace(limits[0], limits[1], PLACES)
    total, found = np.zeros(PLACES), np.zeros(len(draws))
    profile = np.zeros((3, 3, 3))
    for k in range(len(draws)):
        few, there = time[draws[k]], places[:, draws[k]]
        for g in range(PLACES):
            total[g] = _sum(few, there, grid[g], orders, loss, profile)[COST]
        start = grid[np.argmin(total)]
        found[k], _ = descend(few, there, orders, loss, limits, start, grid[1] - grid[0])
    return found


def range_of_start(
    time: Array, places: Array, draws: int, longest: float, generator: np.random.Generator
) -> tuple[Array, float]:
    """Return the earliest and latest t0, and the first guess: what random points say.

    ``time`` runs from 0 to 1, the first and the last detection; so do the results.

    Each draw solves Eq. 4.29 for three points, the fewest that tell seven unknowns. The
    median of the solutions is the first guess. Their range, widened by itself on both sides,
    as a few draws do not reach its ends, and by at least a step between detections, is
    that of t0; it ends before the first detection.
    """
    widest = np.array([-max(longest, 2 * SHORTEST), -SHORTEST])
    triples = np.argsort(generator.random((draws, len(time))), axis=1)[:, :3]
    found = solve_draws(time, places, np.sort(triples, axis=1), int(Loss.SQUARES), widest)
    margin = max(float(np.ptp(found)), float(np.diff(time).min()))
    limits = np.clip([found.min() - margin, found.max() + margin], *widest)
    return limits, float(np.median(found))
