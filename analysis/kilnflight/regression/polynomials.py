"""Three polynomials in time that pass the lance's exit at one t0 (thesis, section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kilnflight.checks import (
    InputError,
    check_between,
    check_count,
    check_finite,
    check_kind,
    check_positive,
    check_shape,
)
from kilnflight.regression.fit import Array, Fit, measures
from kilnflight.regression.loss import Loss
from kilnflight.regression.projection import reweight
from kilnflight.regression.search import Combinations, range_of_start

EXACT = 1e-6  # of the scale; a scatter below it is rounding, and no order can better it
FARTHEST = 1e100  # mm; squares stay finite
HIGHEST = 9  # order that the recurrence still tells apart from rounding
Orders = tuple[int, int, int]


@dataclass(frozen=True)
class Regression:
    """Nonlinear least squares over t0 and the coefficients, with an order for each axis.

    Called with times (n,) in s, places (n, 3) in mm and the lance's exit (3,) in mm, it
    returns a `Fit`. Without scatter and robust loss the cost is the sum of the squared
    residuals of all three axes, as printed.

    Notes
    -----
    Readings. (1) For a given t0 the best coefficients are linear and solved for, so the
    trust region has one unknown, t0: `kilnflight.regression.search.descend`, in place of scipy's
    over all unknowns, which ends at the same minimum and takes far longer (benchmarks). The
    ranges that the thesis sets for the coefficients keep its solver in bounds; here they are not
    needed. (2) The range of t0 and its first guess come
    from `draws` times three random points (`kilnflight.regression.search.range_of_start`);
    where depth scatters the range is all that `longest_s` allows. The minimum found is the
    one downhill of the first guess, as by any trust region; it need not be the least of
    all. A t0 at an end of its range is told, not hidden: at the latest end the first
    detection is as near the exit as its scatter can tell, which is common for particles
    seen from the exit on; at the earliest end the track does not lead back to the exit.
    (3) "Stopped if the optimization of the measures is less than 1% for each order of
    enhancement" is taken as: from the lowest orders, the axis whose RMSE (Eq. 4.30, which
    counts the coefficients) falls most by one order more gets it, until none falls by 1 %.
    Combinations that this never looks at are not solved.
    (4) An order leaves at least one degree of freedom, n - (k + 1) > 0, by the number n of
    detections. (5) The thesis prints no weights between the axes; `scale_mm` states them.
    With a robust loss the residual over the scale goes into it, and RMSE in (3) is that of
    the loss; the measures in the result are always those printed, over all detections.
    """

    lowest: int = 2  # order, section 4.3
    highest: int = 6  # order, section 4.3
    gain: float = 0.01  # relative, section 4.3
    # Scatter in mm by which each axis is divided; equal: not weighted, as printed.
    scale_mm: tuple[float, float, float] = (1.0, 1.0, 1.0)
    loss: Loss = Loss.SQUARES
    draws: int = 20  # "a few randomly selected points", section 4.3; the number is ours
    # From the exit to the first detection; ours: as long as the longest flights (Fig. 5.19).
    longest_s: float = 1.0
    seed: int = 0  # of the random points; the same for every track

    def __post_init__(self) -> None:
        """Refuse parameters that no regression has."""
        check_count(self.lowest, "Regression: lowest")
        check_count(self.highest, "Regression: highest", int(self.lowest))
        check_between(self.highest, 1, HIGHEST, "Regression: highest")
        check_between(self.gain, 0.0, 1.0, "Regression: gain")
        check_shape(np.array(self.scale_mm), (3,), "Regression: scale_mm")
        for scale in self.scale_mm:
            check_positive(scale, "Regression: scale_mm")
        check_kind(self.loss, Loss, "Regression: loss")
        check_count(self.draws, "Regression: draws")
        check_positive(self.longest_s, "Regression: longest_s")
        check_count(self.seed, "Regression: seed", 0)

    def __call__(
        self, time_s: npt.ArrayLike, places_mm: npt.ArrayLike, exit_point_mm: npt.ArrayLike
    ) -> Fit:
        """Return the regressed trajectory, whatever the order of the points.

        Raises
        ------
        InputError
            If there are too few points, two at one time, or what is no finite number.
        """
        time, places = check_finite(time_s, "time"), check_finite(places_mm, "places")
        exit_point = check_finite(exit_point_mm, "exit_point")
        check_shape(exit_point, (3,), "exit_point")
        check_shape(time, (None,), "time")
        check_shape(places, (len(time), 3), "places")
        if len(time) < self.fewest:
            raise InputError(
                f"track: {len(time)} points, but order {self.lowest} needs {self.fewest}. "
                "Leave short tracks out or lower the order."
            )
        if np.abs(places).max() > FARTHEST:
            raise InputError(f"places: farther than {FARTHEST:g} mm. Convert them to millimetres.")
        rank = np.argsort(time, kind="stable")
        time, places = time[rank], places[rank]
        twice = np.flatnonzero(np.diff(time) <= 0)
        if len(twice):
            raise InputError(
                f"track: two points at {time[twice[0]]} s. A particle is at one place at a "
                "time; keep one of them."
            )
        return self._fit(time, places, exit_point)

    @property
    def fewest(self) -> int:
        """The fewest points that leave RMSE a degree of freedom (Eq. 4.30)."""
        return max(self.lowest, 2) + 2

    def _fit(self, time: Array, places: Array, exit_point: Array) -> Fit:
        """Return the fit of sorted points."""
        duration = time[-1] - time[0]
        unit = (time - time[0]) / duration
        scaled = np.ascontiguousarray(((places - exit_point) / self.scale_mm).T)
        generator = np.random.default_rng(self.seed)
        longest = self.longest_s / duration
        limits, first = range_of_start(unit, scaled, self.draws, longest, generator)
        highest = np.full(3, min(self.highest, len(time) - 2))
        tried = Combinations(unit, scaled, self.lowest, highest, int(self.loss), limits, first)
        chosen = self.choose(tried, len(time))
        start = tried.start(chosen)
        x, y, z = chosen
        orders = x + self.lowest, y + self.lowest, z + self.lowest
        near = 1e-9 * (limits[1] - limits[0])
        at_bound = int(start >= limits[1] - near) - int(start <= limits[0] + near)
        factors, found = [], []
        for axis, order in enumerate(orders):
            moved = places[:, axis] - exit_point[axis]
            factor, fitted = self._polynomial(unit - start, moved, scaled[axis], order)
            factors.append(tuple((factor / duration ** np.arange(1, order + 1)).tolist()))
            found.append(measures(places[:, axis], exit_point[axis] + fitted, order))
        t0, earliest, latest = (float(time[0] + s * duration) for s in (start, *limits))
        point = (float(exit_point[0]), float(exit_point[1]), float(exit_point[2]))
        of_track = float(time[0]), float(time[-1]), len(time)
        how_well = zip(*found, strict=True)
        return Fit(
            point, t0, at_bound, (earliest, latest), orders, tuple(factors), *of_track, *how_well
        )

    def _polynomial(
        self, since: Array, moved: Array, scaled: Array, order: int
    ) -> tuple[Array, Array]:
        """Return the factors (order,) of one axis, and its values (n,), from the exit on."""
        # Over the time from t0 to the last point the powers stay within 0 and 1.
        u, powers = since / since[-1], np.arange(1, order + 1)
        weights = reweight(u, scaled, order, int(self.loss), np.zeros((order + 1, 3)))
        basis, root = u[:, None] ** powers, np.sqrt(weights)
        solved = np.linalg.lstsq(root[:, None] * basis, root * moved)[0]
        return solved / since[-1] ** powers, basis @ solved

    def choose(self, costs: Array | Combinations, points: int) -> Orders:
        """Return the place of the chosen orders in the costs (a, b, c, 3) per axis."""

        def rmse(place: Orders, axis: int) -> float:
            order = place[axis] + self.lowest
            return float(np.sqrt(costs[place][axis] / (points - (order + 1))))  # Eq. 4.30

        here = (0, 0, 0)
        while True:
            best, best_gain = here, self.gain
            for axis in range(3):
                there = _raised(here, axis)
                if there[axis] == costs.shape[axis] or rmse(here, axis) < EXACT:
                    continue
                gain = 1 - rmse(there, axis) / rmse(here, axis)
                if gain >= self.gain and (best == here or gain > best_gain):
                    best, best_gain = there, gain
            if best == here:
                return here
            here = best


def _raised(orders: Orders, axis: int) -> Orders:
    """Return the orders with that of one axis one higher."""
    x, y, z = (order + (axis == a) for a, order in enumerate(orders))
    return x, y, z
