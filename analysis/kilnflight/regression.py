"""Trajectories in space: three polynomials through the lance's exit at one t0 (section 4.3).

    tracks -> `regress_all` -> `kilnflight.tables.TRAJECTORIES` -> `fits`

================  =============  ===============================================================
call              source         gives
================  =============  ===============================================================
`regress`         Eqs 4.26-4.33  the `Fit` of one track
`regress_all`     Table 5.18     a table, one row per track; `fits` takes the fits out of it
`order_measures`  Fig. 4.23      the measures under orders that are the same for all axes
`Regression`      section 4.3    the method, its parameters and how it was read
================  =============  ===============================================================

A robust loss with the scatter of each axis bears depth jumps, for example
``Regression(robust=True, scale_mm=(10.0, 10.0, 150.0))``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from numpy.polynomial import Chebyshev, chebyshev, legendre

from kilnflight.checks import (
    InputError,
    check_between,
    check_columns,
    check_count,
    check_finite,
    check_kind,
    check_positive,
    check_shape,
    check_whole,
    known_numbers,
)
from kilnflight.tables import AXES, HIGHEST_ORDER, TRAJECTORIES

Array = npt.NDArray[np.float64]
Three = tuple[float, float, float]
Orders = tuple[int, int, int]
Located = tuple[int, Array, Array]

FITTED, NO_DEPTH, TOO_FEW = "fitted", "no depth", "too few points"
# Fields of a `Fit` with several values and their columns in the table; others keep their names.
PER_AXIS = {"exit_point_mm": "exit_{}", "orders": "order_{}", "rmse_mm": "rmse_{}_mm"}
PER_AXIS |= {"mape_percent": "mape_{}_percent", "r2": "r2_{}", "r2_adjusted": "r2_adjusted_{}"}
COLUMNS = {name: [column.format(axis) for axis in AXES] for name, column in PER_AXIS.items()}
COLUMNS |= {"t0_range_s": ["t0_earliest_s", "t0_latest_s"]}
COLUMNS |= {name: [name] for name in ("t0_s", "t0_at_bound", "first_s", "last_s", "points")}
MEASURES = ("rmse_mm", "mape_percent", "r2", "r2_adjusted")
EXACT = 1e-6  # of the scale; a scatter below it is rounding, and no order can better it
FARTHEST = 1e100  # mm; squares stay finite
HIGHEST = 9  # order that the fit still tells apart from rounding
GRID = 65  # values of t0 on the grid that finds the valley
ZOOMS = 10  # times that the grid of the random points is refined, each time by 8
DENSE = 0.1  # of the track's duration; the grid's steps grow with the distance from here
SHORTEST = 1e-6  # of the track's duration, from t0 to the first detection
CLOSE = 1e-11  # of the robust cost; farther from the polynomial, its interval is halved
HALVINGS = 20  # at most
STEPS = 50  # of the robust fit at most
SETTLED = 1e-12  # of the cost; a step of the robust fit that gains less is the last
DEGREE = 12  # of the cost as a polynomial in t0 between three values of the grid
NODES = chebyshev.chebpts1(DEGREE + 1)
TO_CURVE = np.linalg.inv(chebyshev.chebvander(NODES, DEGREE))  # costs at these -> the polynomial


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
    orders: Orders
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


class Solution(NamedTuple):
    """The best trajectory of one combination of orders, in units of the duration and scale."""

    start: float  # t0
    costs: Array  # (3,) per axis
    target: Array  # (3, n) what the polynomials are fitted to by least squares


@dataclass(frozen=True)
class Regression:
    """Nonlinear least squares over t0 and the coefficients, with an order for each axis.

    Called with times (n,) in s, places (n, 3) in mm and the lance's exit (3,) in mm, it
    returns a `Fit`. Without scatter and robust loss the cost is the sum of the squared
    residuals of all three axes, as printed.

    Notes
    -----
    Readings. (1) For a given t0 the best coefficients are linear and solved for, so one
    unknown is left, t0: a grid, then the cost as a polynomial in t0. The ranges that the thesis
    sets for the coefficients keep its solver in bounds; here they are not needed. Under a
    robust loss the best coefficients for a given t0 are those of a convex problem. (2) The
    range of t0 and its first guess come from `draws` times three random points
    (`range_of_start`); where depth scatters the range is all that `longest_s` allows. The
    minimum found is the one downhill of the first guess; it need not be the least of all.
    `Fit.t0_at_bound` tells a t0 at an end of its range. At the latest end the first detection
    is as near the exit as its scatter can tell, which is common for particles detected from
    the exit on. At the earliest end the track does not lead back to the exit.
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
    scale_mm: Three = (1.0, 1.0, 1.0)
    robust: bool = False  # squares, as printed; True: scipy's "soft_l1", which is ours
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
        check_kind(self.robust, bool, "Regression: robust")
        check_count(self.draws, "Regression: draws")
        check_positive(self.longest_s, "Regression: longest_s")
        check_count(self.seed, "Regression: seed", 0)

    @property
    def fewest(self) -> int:
        """The fewest points that leave RMSE a degree of freedom (Eq. 4.30)."""
        return max(self.lowest, 2) + 2

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
        repeated = np.flatnonzero(np.diff(time) <= 0)
        if len(repeated):
            raise InputError(
                f"track: two points at {time[repeated[0]]} s. A particle is at one place at a "
                "time; keep one of them."
            )
        return self._fit(time, places, exit_point)

    def _fit(self, time: Array, places: Array, exit_point: Array) -> Fit:
        """Return the fit of sorted points."""
        duration = time[-1] - time[0]
        unit, scaled = (time - time[0]) / duration, ((places - exit_point) / self.scale_mm).T
        generator, longest = np.random.default_rng(self.seed), self.longest_s / duration
        limits, first = range_of_start(unit, scaled, self.draws, longest, generator)
        highest = min(self.highest, len(time) - 2)
        solve = cache(trajectory_solver(unit, scaled, highest, limits, first, self.robust))
        orders = self.choose(lambda orders: solve(orders).costs, highest, len(time))
        start, _, target = solve(orders)
        near = 1e-9 * (limits[1] - limits[0])
        since = (unit - start) / (1.0 - start)  # so that the powers stay within 0 and 1
        factors, quality = [], []
        for axis, order in enumerate(orders):
            powers = np.arange(1, order + 1)
            basis = since[:, None] ** powers
            solved = np.linalg.lstsq(basis, target[axis] * self.scale_mm[axis])[0]
            factors.append(tuple((solved / ((1.0 - start) * duration) ** powers).tolist()))
            quality.append(measures(places[:, axis], exit_point[axis] + basis @ solved, order))
        return Fit(
            tuple(exit_point.tolist()),
            float(time[0] + start * duration),
            int(start >= limits[1] - near) - int(start <= limits[0] + near),
            tuple((time[0] + limits * duration).tolist()),
            orders,
            tuple(factors),
            float(time[0]),
            float(time[-1]),
            len(time),
            *zip(*quality, strict=True),
        )

    def choose(self, costs: Callable[[Orders], Array], highest: int, points: int) -> Orders:
        """Return the orders by reading (3), from the cost (3,) per axis of any orders."""

        def rmse(orders: Orders) -> Array:
            return np.sqrt(costs(orders) / (points - np.array(orders) - 1))  # Eq. 4.30

        orders = (self.lowest,) * 3
        while True:
            reached, gains, higher = rmse(orders), np.full(3, -np.inf), [orders] * 3
            for axis in range(3):
                if orders[axis] < highest and reached[axis] >= EXACT:
                    x, y, z = (order + (axis == k) for k, order in enumerate(orders))
                    higher[axis] = x, y, z
                    gains[axis] = 1 - rmse((x, y, z))[axis] / reached[axis]
            best = int(np.argmax(gains))
            if gains[best] < self.gain:
                return orders
            orders = higher[best]


def range_of_start(
    time: Array, places: Array, draws: int, longest: float, generator: np.random.Generator
) -> tuple[Array, float]:
    """Return the earliest and latest t0 and the first guess, from random points.

    ``time`` (n,) runs from 0 to 1, the first and the last detection; so do the results.
    ``places`` (3, n) are from the exit on.

    Each draw solves Eq. 4.29 for three points, the fewest that tell seven unknowns. The
    median of the solutions is the first guess. Their range, widened by itself on both sides,
    as a few draws do not reach its ends, and by at least a step between detections, is
    that of t0; it ends before the first detection.
    """
    widest = np.array([-max(longest, 2 * SHORTEST), -SHORTEST])
    drawn = np.sort(np.argsort(generator.random((draws, len(time))), axis=1)[:, :3], axis=1)
    at = time[drawn]
    # Second divided differences are blind to the quadratics through the exit at t0, if each
    # place is divided by its time since t0: what is left of the places is the residual.
    others = [[1, 2], [0, 2], [0, 1]]
    differences = 1.0 / np.prod(at[:, :, None] - at[:, others], axis=2)

    def cost(start: Array) -> Array:
        factors = differences / (at - start[..., None])
        left = np.einsum("gdk,adk->adg", factors, places[:, drawn]) ** 2
        return left.sum(axis=0) / (factors**2).sum(axis=2).T

    low, high = np.tile(widest[:, None], draws)
    for count in [GRID] + [17] * ZOOMS:
        grid = np.linspace(low, high, count)
        best = np.argmin(cost(grid), axis=1)
        around = np.clip(best + np.array([[-1], [0], [1]]), 0, count - 1)
        low, solved, high = np.take_along_axis(grid, around, axis=0)
    margin = max(float(np.ptp(solved)), float(np.diff(time).min()))
    limits = np.clip([solved.min() - margin, solved.max() + margin], *widest)
    return limits, float(np.median(solved))


def trajectory_solver(
    time: Array, places: Array, highest: int, limits: Array, first: float, robust: bool = False
) -> Callable[[Orders], Solution]:
    """Return what solves a combination of orders, by least squares or under the robust loss.

    A polynomial through the exit at t0 is the time u since t0 times a polynomial of one order
    less. Its orthogonal basis serves all orders at once, and t0 is the only unknown left.
    The cost is a smooth curve over t0: between two steps of the grid a polynomial.
    """
    powers = legendre.legvander(2 * time - 1, highest - 1)
    # Denser towards the first detection, where the cost changes faster with t0.
    grid = np.clip(DENSE - np.geomspace(DENSE - limits[0], DENSE - limits[1], GRID), *limits)

    @cache
    def bases(*starts: float) -> Array:
        return np.linalg.qr((time - np.array(starts)[:, None])[:, :, None] * powers)[0]

    @cache
    def costs(axis: int, order: int, *starts: float) -> Array:
        return loss(residuals(bases(*starts)[:, :, :order], places[axis], robust), robust)

    def total(orders: Orders, starts: Array) -> Array:
        """Return the cost (n,) of orders for each of the t0."""
        return np.sum([costs(*of, *starts.tolist()) for of in enumerate(orders)], axis=0)

    def solve(orders: Orders) -> Solution:
        cost = total(orders, grid)
        at = int(np.argmin(np.abs(grid - first)))
        before, after = max(at - 1, 0), min(at + 1, GRID - 1)
        while cost[at] > min(cost[before], cost[after]):  # downhill
            at = before if cost[before] < cost[after] else after
            before, after = max(at - 1, 0), min(at + 1, GRID - 1)
        low, high = float(grid[before]), float(grid[after])
        for _ in range(HALVINGS if robust else 1):
            nodes = low + (NODES + 1) * (high - low) / 2
            cost = total(orders, nodes)
            curve = Chebyshev(TO_CURVE @ cost, [low, high])
            flat = curve.deriv().roots()
            inside = (flat.imag == 0) & (low < flat.real) & (flat.real < high)
            ends = np.append(flat.real[inside], [low, high])
            start = float(ends[np.argmin(curve(ends))])
            basis = bases(start)
            left = np.concatenate(
                [residuals(basis[:, :, :k], p, robust) for k, p in zip(orders, places, strict=True)]
            )
            if abs(loss(left, robust).sum() - curve(start)) <= CLOSE * cost.max():
                break
            reach = (high - low) / 4
            low, high = max(low, start - reach), min(high, start + reach)
        return Solution(start, loss(left, robust), places - left if robust else places)

    return solve


def loss(left: Array, robust: bool) -> Array:
    """Return the sum of squares over the last axis, or of the robust 2 (sqrt(1 + r^2) - 1)."""
    squares = left**2
    # written so that small residuals do not cancel
    return np.asarray((2 * squares / (1 + np.sqrt(1 + squares)) if robust else squares).sum(-1))


def residuals(basis: Array, places: Array, robust: bool) -> Array:
    """Return what the best combination of bases (t0, n, order) leaves of places, (t0, n).

    Under the robust loss the problem is convex and solved by damped Newton steps. With a
    damping of 1 or more the weights are at least those of reweighted least squares, whose
    steps never raise the cost.
    """
    left = np.asarray(places - (basis @ (places @ basis)[..., None])[..., 0])
    cost, damping = loss(left, robust), np.ones(len(basis))
    for _ in range(STEPS if robust else 0):
        root = np.sqrt(1 + left**2)
        weights = root**-3 + damping[:, None] / root
        matrix = basis.swapaxes(1, 2) @ (weights[:, :, None] * basis)
        pull = (left / root)[:, None] @ basis
        stepped = left - (basis @ np.linalg.solve(matrix, pull.swapaxes(1, 2)))[..., 0]
        gain = cost - loss(stepped, robust)
        left = np.where(gain[:, None] > 0, stepped, left)
        damping = np.where(gain > 0, damping / 10, np.maximum(10 * damping, 1.0))
        if (np.abs(gain) <= SETTLED * (cost + EXACT)).all():
            break
        cost = np.minimum(cost, cost - gain)
    return left


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


def regress(
    track: pd.DataFrame,
    exit_point: npt.ArrayLike,
    frame_rate_hz: float | None = None,
    parameters: Regression | None = None,
) -> Fit:
    """Return the regressed trajectory of one track.

    Parameters
    ----------
    track
        One row per detection in any order: ``x``, ``y``, ``z`` in mm, NaN where there is no
        depth (such rows are left out), and ``frame``, or ``time_s`` if no frame rate is
        given.
    exit_point
        (3,) the lance's exit in mm.
    parameters
        What regresses; None: `Regression` as published.

    Raises
    ------
    InputError
        If the track cannot be regressed: no depth, too few points, two at one time, more
        than one particle, or values that are no numbers.
    """
    check_columns(track, AXES, "track")
    if "particle" in track.columns and len(track["particle"].unique()) > 1:
        raise InputError("track: more than one particle; call regress_all.")
    for _, time, places in _located(track.assign(particle=0), frame_rate_hz, "track"):
        if not len(time):
            raise InputError("track: no depth, x, y and z are missing everywhere. Leave it out.")
        return (parameters or Regression())(time, places, exit_point)
    raise InputError("track: no points. Leave empty tracks out.")


def regress_all(
    tracks: pd.DataFrame,
    exit_point: npt.ArrayLike,
    frame_rate_hz: float | None = None,
    parameters: Regression | None = None,
) -> pd.DataFrame:
    """Return `kilnflight.tables.TRAJECTORIES`, one row per particle by ascending number.

    The arguments are those of `regress`, with whole numbers in the column ``particle``;
    rows of particle -1 belong to no track. What cannot be regressed keeps its row: the
    column ``outcome`` says why, and what is not known is NaN, orders 0.

    Raises
    ------
    InputError
        If a column is missing or no numbers, or a particle is in two places at one time.
    """
    parameters = parameters or Regression()
    if parameters.highest > HIGHEST_ORDER:
        raise InputError(f"regress_all: the table ends at order {HIGHEST_ORDER}; use regress.")
    exit_mm = check_finite(exit_point, "exit_point")
    check_shape(exit_mm, (3,), "exit_point")
    points = _located(tracks, frame_rate_hz, "tracks")
    rows = [_row(*points_of_track, exit_mm, parameters) for points_of_track in points]
    if not rows:
        return TRAJECTORIES.empty()
    kinds: dict[str, Any] = {column.name: column.kind for column in TRAJECTORIES.columns}
    return TRAJECTORIES.check(pd.DataFrame(rows, columns=TRAJECTORIES.names).astype(kinds))


def fits(trajectories: pd.DataFrame) -> dict[int, Fit]:
    """Return the `Fit` of every fitted particle of a table of `regress_all`."""
    table = TRAJECTORIES.check(trajectories)
    fitted = table[table["outcome"] == FITTED]
    return {row["particle"]: _fit(row) for row in fitted.to_dict("records")}


def order_measures(
    tracks: pd.DataFrame,
    exit_point: npt.ArrayLike,
    frame_rate_hz: float | None = None,
    orders: Iterable[int] = range(2, 8),
) -> pd.DataFrame:
    """Return the measures of each track under fixed orders, the same for all axes (Fig. 4.23).

    Tracks with too few points for the highest of the orders are left out under all, so
    that every order is measured on the same tracks.

    Returns
    -------
    Columns particle, order, axis, rmse_mm, mape_percent, r2, r2_adjusted.
    """
    methods = [Regression(lowest=k, highest=k) for k in orders]
    fewest = max((method.fewest for method in methods), default=0)
    kinds = {"particle": int, "order": int, "axis": str} | dict.fromkeys(MEASURES, float)
    rows = []
    for particle, time, places in _located(tracks, frame_rate_hz, "tracks"):
        for method in methods if len(time) >= fewest else []:
            fit = method(time, places, exit_point)
            values = zip(AXES, *(getattr(fit, name) for name in MEASURES), strict=True)
            rows += [(particle, method.lowest, *of_axis) for of_axis in values]
    return pd.DataFrame(rows, columns=list(kinds)).astype(kinds)


def _located(tracks: pd.DataFrame, frame_rate_hz: float | None, where: str) -> Iterator[Located]:
    """Yield of each particle, by ascending number, its rows with a place, by ascending time.

    Particle, times (n,) in s and places (n, 3) in mm.
    """
    clock = "time_s" if frame_rate_hz is None else "frame"
    check_columns(tracks, ("particle", clock, *AXES), where)
    particle = check_whole(tracks["particle"], f"{where}: column particle")
    if frame_rate_hz is None:
        time = check_finite(tracks[clock].to_numpy(), f"{where}: column time_s")
    else:
        check_positive(frame_rate_hz, "frame_rate_hz")
        time = check_whole(tracks[clock], f"{where}: column frame") / frame_rate_hz
    places = np.stack([known_numbers(tracks[a], f"{where}: column {a}") for a in AXES], axis=1)
    if np.isinf(places).any():
        row = tracks.index[int(np.argwhere(np.isinf(places))[0, 0])]
        raise InputError(f"{where}: a place is infinite in row {row}. Use NaN where it is unknown.")
    rank = np.lexsort((time, particle))
    rank = rank[particle[rank] >= 0]
    particle, time, places = particle[rank], time[rank], places[rank]
    repeated = np.flatnonzero((np.diff(particle) == 0) & (np.diff(time) == 0))
    if len(repeated):
        row = repeated[0]
        raise InputError(
            f"{where}: two rows of particle {particle[row]} at {time[row]:.9g} s. A particle is at "
            "one place at a time; keep one, or give it another number or -1."
        )
    names, starts = np.unique(particle, return_index=True)
    for name, rows in zip(names, np.split(np.arange(len(rank)), starts[1:]), strict=False):
        known = rows[np.isfinite(places[rows]).all(axis=1)]
        yield int(name), time[known], places[known]


def _row(
    particle: int, time: Array, places: Array, exit_mm: Array, parameters: Regression
) -> dict[str, object]:
    """Return the row of one track in the table."""
    row: dict[str, Any] = {
        column.name: np.nan if column.kind is float else 0 for column in TRAJECTORIES.columns
    }
    row |= {"particle": particle, "points": len(time)}
    row |= zip(COLUMNS["exit_point_mm"], exit_mm.tolist(), strict=True)
    if not len(time):
        return row | {"outcome": NO_DEPTH}
    row |= {"first_s": time[0], "last_s": time[-1]}
    if len(time) < parameters.fewest:
        return row | {"outcome": TOO_FEW}
    fit = parameters(time, places, exit_mm)
    for name, columns in COLUMNS.items():
        row |= zip(columns, np.atleast_1d(getattr(fit, name)).tolist(), strict=True)
    for axis, factors in zip(AXES, fit.coefficients, strict=True):
        padded = (*factors, *[0.0] * HIGHEST_ORDER)[:HIGHEST_ORDER]
        row |= {f"coefficient_{axis}_{k}": factor for k, factor in enumerate(padded, 1)}
    return row | {"outcome": FITTED}


def _fit(row: dict[Any, Any]) -> Fit:
    """Return the fit that a row of the table stands for."""
    values = {name: tuple(row[column] for column in columns) for name, columns in COLUMNS.items()}
    fields: dict[str, Any] = {name: v if len(v) > 1 else v[0] for name, v in values.items()}
    fields["coefficients"] = tuple(
        tuple(row[f"coefficient_{axis}_{k}"] for k in range(1, order + 1))
        for axis, order in zip(AXES, fields["orders"], strict=True)
    )
    return Fit(**fields)
