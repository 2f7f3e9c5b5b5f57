"""Trajectories: polynomials through the lance's outlet at one t0 (sec. 4.3).

    tracks -> `regress_all` -> `kilnflight.tables.TRAJECTORIES` -> `fits`

`regress` returns the `Fit` of one track (Eqs 4.26 to 4.33), `regress_all` a table (Table 5.18).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from numpy.polynomial import chebyshev, legendre

from kilnflight.checks import (
    InputError,
    check_between,
    check_columns,
    check_count,
    check_finite,
    check_positive,
    check_shape,
    known_numbers,
    order_tracks,
)
from kilnflight.tables import AXES, HIGHEST_ORDER, TRAJECTORIES

Array = npt.NDArray[np.float64]
Three = tuple[float, float, float]
Orders = tuple[int, ...]
Row = dict[str, Any]
Located = Iterator[tuple[int, Array, Array]]

FITTED, NO_DEPTH, TOO_FEW = "fitted", "no depth", "too few points"
# Columns of the table by field of a `Fit`; the other fields keep their names.
PER_AXIS = {"exit_point_mm": "exit_{}", "orders": "order_{}", "rmse_mm": "rmse_{}_mm"}
PER_AXIS |= {"mape_percent": "mape_{}_percent", "r2": "r2_{}", "r2_adjusted": "r2_adjusted_{}"}
COLUMNS = {name: [column.format(axis) for axis in AXES] for name, column in PER_AXIS.items()}
COLUMNS |= {"t0": ["t0_s"], "t0_range_s": ["t0_earliest_s", "t0_latest_s"]}
COLUMNS |= {name: [name] for name in ("t0_at_bound", "first_s", "last_s", "points")}
FACTORS = [[f"coefficient_{axis}_{k}" for k in range(1, HIGHEST_ORDER + 1)] for axis in AXES]
MEASURES = ("rmse_mm", "mape_percent", "r2", "r2_adjusted")
EXACT = 1e-6  # of the scale; a scatter below it is rounding, and no order can better it
FARTHEST = 1e100  # mm; squares stay finite
HIGHEST = 9  # order that the fit still tells apart from rounding
GRID = 65  # values of t0 on the grid that finds the valley
ZOOMS = 10  # times that the grid of the random points is refined, each time by 8
DENSE = 0.1  # of the track's duration; the grid's steps grow with the distance from here
SHORTEST = 1e-6  # of the track's duration, from t0 to the first detection
CLOSE = 1e-11  # of the robust cost; farther from the polynomial, its interval is halved
HALVINGS, NEWTON_STEPS = 20, 50  # of the interval, and of the robust fit, at most
SETTLED = 1e-12  # of the cost; a step of the robust fit that gains less is the last
DEGREE = 12  # of the cost as a polynomial in t0 between three values of the grid
NODES = chebyshev.chebpts1(DEGREE + 1)
TO_CURVE = np.linalg.inv(chebyshev.chebvander(NODES, DEGREE))  # costs at these -> the polynomial
TO_SLOPE = chebyshev.chebder(np.eye(DEGREE + 1))  # polynomial -> its derivative


@dataclass(frozen=True)
class Fit:
    """A regressed trajectory: a function of time in s, places in mm.

    Along each axis (x, y, z) the place is ``exit + c_1 (t - t0) + c_2 (t - t0)^2 + ...``
    (Eq. 4.29 by the time since t0). A measure that is not defined along an axis is NaN.

    >>> fit = Fit((0.0, 0.0, 6500.0), 0.1, 0, (0.0, 0.1), (2, 2, 2),
    ...           ((1.0, 0.0), (0.0, -4.9), (-9000.0, 0.0)), 0.2, 0.5, 60)
    >>> fit(0.2).round(3).tolist()
    [[0.1, -0.049, 5600.0]]
    """

    exit_point_mm: Three  # the lance's outlet
    t0: float  # s, time at the outlet
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

    def __call__(self, time_s: npt.ArrayLike) -> Array:
        """Return places (n, 3) in mm at times (n,) or one time in s."""
        return self._sums([(0.0, *axis) for axis in self.coefficients], time_s) + self.exit_point_mm

    def velocity(self, time_s: npt.ArrayLike) -> Array:
        """Return velocities (n, 3) in mm/s at times (n,) or one time in s."""
        rates = [[k * c for k, c in enumerate(axis, 1)] for axis in self.coefficients]
        return self._sums(rates, time_s)

    def _sums(self, factors: Sequence[Sequence[float]], time_s: npt.ArrayLike) -> Array:
        """Return sums (n, 3) of factors times ascending powers of t - t0."""
        time = np.atleast_1d(check_finite(time_s, "Fit: time"))
        check_shape(time, (None,), "Fit: time")
        return np.stack([np.polyval(axis[::-1], time - self.t0) for axis in factors], axis=-1)


class Solution(NamedTuple):
    """The best trajectory of given orders, in units of duration and scale."""

    start: float  # t0
    costs: Array  # (3,) per axis
    target: Array  # (3, n) what the polynomials are fitted to by least squares


@dataclass(frozen=True)
class Regression:
    """Fit t0 and the coefficients of three polynomials by least squares.

    Called with ascending times (n,) in s, finite places (n, 3) in mm and the lance's outlet (3,) in
    mm, it returns a `Fit`. Readings: (1) For a given t0 the best coefficients follow from a linear
    problem (convex under a robust loss), so t0 is the one unknown left. (2) The range of t0 and its
    first guess come from three random points, `draws` times. Section 4.3 has a trust region, which
    goes downhill from its start. So the minimum is the one downhill of the guess, on a grid of t0,
    and not the deepest of the range. At the earliest t0 of the range the track does not lead back
    to the exit. (3) From the lowest orders, the axis whose RMSE (Eq. 4.30, of the loss) falls most
    by one order more gets it. This ends when none falls by 1 %. Section 4.3 has "the measures"
    improve by less, and does not say whether one or all of the four; RMSE alone is ours. (4) An
    order leaves n - (k + 1) > 0 degrees of freedom. (5) No weights of the axes are printed;
    `scale_mm` states them. Measures are as printed.
    """

    lowest: int = 2  # order, section 4.3
    highest: int = 6  # order, section 4.3
    gain: float = 0.01  # relative, section 4.3
    scale_mm: Three = (1.0, 1.0, 1.0)  # scatter that divides each axis; equal as printed
    robust: bool = False  # squares, as printed; True: scipy's "soft_l1", which is ours
    draws: int = 20  # "a few randomly selected points", section 4.3; the number is ours
    longest_s: float = 1.0  # from exit to first detection; ours: the longest flights (Fig. 5.19)
    seed: int = 0  # of the random points; the same for every track

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        for name, least in ("lowest", 1), ("highest", self.lowest), ("draws", 1), ("seed", 0):
            check_count(getattr(self, name), f"Regression: {name}", int(least))
        check_between(self.highest, 1, HIGHEST, "Regression: highest")
        check_between(self.gain, 0.0, 1.0, "Regression: gain")
        check_positive(self.longest_s, "Regression: longest_s")

    @property
    def fewest(self) -> int:
        """Return the fewest points that leave RMSE a degree of freedom."""
        return max(self.lowest, 2) + 2

    def __call__(self, time: Array, places: Array, exit_point: Array) -> Fit:
        """Return the trajectory of ascending times, or raise an `InputError`."""
        if len(time) < self.fewest:
            raise InputError(
                f"track: {len(time)} points, but order {self.lowest} needs {self.fewest}."
            )
        if np.abs(places).max() > FARTHEST:
            raise InputError(f"places: farther than {FARTHEST:g} mm. Convert them to millimetres.")
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
            exit_point_mm=tuple(exit_point.tolist()),
            t0=float(time[0] + start * duration),
            t0_at_bound=int(start >= limits[1] - near) - int(start <= limits[0] + near),
            t0_range_s=tuple((time[0] + limits * duration).tolist()),
            orders=orders,
            coefficients=tuple(factors),
            first_s=float(time[0]),
            last_s=float(time[-1]),
            points=len(time),
            **dict(zip(MEASURES, map(tuple, np.transpose(quality).tolist()), strict=True)),
        )

    def choose(self, costs: Callable[[Orders], Array], highest: int, points: int) -> Orders:
        """Return the orders by reading (3), from the costs (3,) of orders."""

        def rmse(orders: Orders) -> Array:
            return np.sqrt(costs(orders) / (points - np.array(orders) - 1))  # Eq. 4.30

        orders: Orders = (self.lowest,) * 3
        while True:
            before, gains = rmse(orders), np.full(3, -np.inf)
            higher = [(*orders[:k], orders[k] + 1, *orders[k + 1 :]) for k in range(3)]
            for k in range(3):
                if orders[k] < highest and before[k] >= EXACT:
                    gains[k] = 1 - rmse(higher[k])[k] / before[k]
            best = int(np.argmax(gains))
            if gains[best] < self.gain:
                return orders
            orders = higher[best]


def range_of_start(
    time: Array, places: Array, draws: int, longest: float, generator: np.random.Generator
) -> tuple[Array, float]:
    """Return the range of t0 and the first guess, from random points.

    ``time`` (n,) runs from 0 to 1, as do the results; ``places`` (3, n) are from the exit on.
    Each draw solves Eq. 4.29 for three points, the fewest that tell seven unknowns. The guess
    is the median of the solutions; their range is widened by itself or by a step.
    """
    widest = np.array([-max(longest, 2 * SHORTEST), -SHORTEST])
    drawn = np.sort(np.argsort(generator.random((draws, len(time))), axis=1)[:, :3], axis=1)
    at = time[drawn]
    # Second divided differences of place over time since t0 vanish for quadratics through the
    # exit at t0: what is left is the residual.
    differences = 1.0 / np.prod(at[:, :, None] - at[:, [[1, 2], [0, 2], [0, 1]]], axis=2)

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
    """Return a function that fits a trajectory of given orders.

    A polynomial through the exit at t0 is the time since t0 times one of an order less, so one
    orthogonal basis serves all orders. Between steps of the grid the cost is a polynomial.
    """
    powers = legendre.legvander(2 * time - 1, highest - 1)
    # Denser towards the first detection, where the cost changes faster with t0.
    grid = np.clip(DENSE - np.geomspace(DENSE - limits[0], DENSE - limits[1], GRID), *limits)

    @cache
    def bases(*ends: float) -> Array:
        """Return bases on the grid, at one t0, or at nodes between two."""
        starts = np.array(ends) if ends else grid
        if len(ends) == 2:
            starts = ends[0] + (NODES + 1) * (ends[1] - ends[0]) / 2
        return np.linalg.qr((time - starts[:, None])[:, :, None] * powers)[0]

    @cache
    def costs(axis: int, order: int, *ends: float) -> Array:
        return loss(residuals(bases(*ends)[:, :, :order], places[axis], robust), robust)

    def total(orders: Orders, *ends: float) -> Array:
        return np.sum([costs(*of, *ends) for of in enumerate(orders)], axis=0)

    def solve(orders: Orders) -> Solution:
        cost, at = total(orders), int(np.argmin(np.abs(grid - first)))
        before, after = max(at - 1, 0), min(at + 1, GRID - 1)
        while cost[at] > min(cost[before], cost[after]):  # downhill
            at = before if cost[before] < cost[after] else after
            before, after = max(at - 1, 0), min(at + 1, GRID - 1)
        low, high = float(grid[before]), float(grid[after])
        for _ in range(HALVINGS if robust else 1):
            cost = total(orders, low, high)
            curve = TO_CURVE @ cost
            flat = chebyshev.chebroots(TO_SLOPE @ curve)
            flat = np.append(flat.real[(flat.imag == 0) & (np.abs(flat) < 1)], [-1.0, 1.0])
            values = chebyshev.chebval(flat, curve)
            lowest = low + (flat[np.argmin(values)] + 1) * (high - low) / 2
            start = float(np.clip(lowest, low, high))
            parts = zip(orders, places, strict=True)
            left = np.concatenate([residuals(bases(start)[:, :, :k], p, robust) for k, p in parts])
            if abs(loss(left, robust).sum() - values.min()) <= CLOSE * cost.max():
                break
            reach = (high - low) / 4
            low, high = np.clip([start - reach, start + reach], low, high).tolist()
        return Solution(start, loss(left, robust), places - left if robust else places)

    return solve


def loss(left: Array, robust: bool) -> Array:
    """Return the sum of squares over the last axis, or the robust loss."""
    squares = left**2  # robust: 2 (sqrt(1 + r^2) - 1), without cancellation
    return np.asarray((2 * squares / (1 + np.sqrt(1 + squares)) if robust else squares).sum(-1))


def residuals(basis: Array, places: Array, robust: bool) -> Array:
    """Return residuals (t0, n) of the best fit of bases (t0, n, order)."""
    left = np.asarray(places - (basis @ (places @ basis)[..., None])[..., 0])
    if not robust:
        return left
    cost, damping = loss(left, robust), np.ones(len(basis))
    for _ in range(NEWTON_STEPS):  # damped Newton; a damping of 1 or more never raises the cost
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


def measures(places: Array, fitted: Array, order: int) -> Array:
    """Return RMSE, MAPE, R2 and adjusted R2 of an axis (Eqs 4.30 to 4.33).

    MAPE, in %, leaves out points at 0; points near 0 make it large, so Table 5.18 gives medians.
    """
    squares, free = np.sum((places - fitted) ** 2), len(places) - (order + 1)
    known = places != 0
    relative = np.abs((places[known] - fitted[known]) / places[known])
    mape = 100 * relative.mean() if known.any() else np.nan
    about_mean = np.sum((places - places.mean()) ** 2) if places.min() < places.max() else 0.0
    r2 = 1 - squares / about_mean if about_mean > 0 else np.nan  # Eq. 4.32 divides by it
    return np.array([np.sqrt(squares / free), mape, r2, r2 - (1 - r2) * order / free])


def regress(
    track: pd.DataFrame,
    exit_point: npt.ArrayLike,
    frame_rate_hz: float | None = None,
    parameters: Regression | None = None,
) -> Fit:
    """Return the trajectory of one track, or raise an `InputError`.

    ``track`` has one row per detection: ``x``, ``y``, ``z`` in mm (rows with NaN are left out),
    and ``frame``, or ``time_s`` without a frame rate. ``exit_point`` (3,) is the lance's, mm.
    """
    check_columns(track, AXES, "track")
    if "particle" in track.columns and len(track["particle"].unique()) > 1:
        raise InputError("track: more than one particle; call regress_all.")
    for _, time, places in _located(track.assign(particle=0), frame_rate_hz, "track"):
        return (parameters or Regression())(time, places, _outlet(exit_point))
    raise InputError("track: no points. Leave empty tracks out.")


def regress_all(
    tracks: pd.DataFrame,
    exit_point: npt.ArrayLike,
    frame_rate_hz: float | None = None,
    parameters: Regression | None = None,
) -> pd.DataFrame:
    """Return `kilnflight.tables.TRAJECTORIES`, one row per particle.

    As `regress`, with a column ``particle``; rows of -1 are in no track. What cannot be
    regressed keeps its row: ``outcome`` says why, what is unknown is NaN or 0.
    """
    method = parameters or Regression()
    if method.highest > HIGHEST_ORDER:
        raise InputError(f"regress_all: the table ends at order {HIGHEST_ORDER}; use regress.")
    exit_mm, located = _outlet(exit_point), _located(tracks, frame_rate_hz, "tracks")
    rows = [_row(*points, exit_mm, method) for points in located]
    kinds: dict[str, Any] = {column.name: column.kind for column in TRAJECTORIES.columns}
    absent = {name: 0 for name, kind in kinds.items() if kind is int}
    table = pd.DataFrame(rows, columns=TRAJECTORIES.names).fillna(absent)
    return TRAJECTORIES.check(table.astype(kinds))


def fits(trajectories: pd.DataFrame) -> dict[int, Fit]:
    """Return the `Fit` of each fitted particle of a trajectory table."""
    table, known = TRAJECTORIES.check(trajectories), {}
    for row in table[table["outcome"] == FITTED].to_dict("records"):
        values = {name: tuple(row[c] for c in columns) for name, columns in COLUMNS.items()}
        fields: Row = {name: v if len(v) > 1 else v[0] for name, v in values.items()}
        factors = zip(FACTORS, fields["orders"], strict=True)
        fields["coefficients"] = tuple(tuple(row[c] for c in cs[:k]) for cs, k in factors)
        known[row["particle"]] = Fit(**fields)
    return known


def _outlet(exit_point: npt.ArrayLike) -> Array:
    """Return the lance's outlet, (3,), or raise an `InputError`."""
    point = check_finite(exit_point, "exit_point")
    check_shape(point, (3,), "exit_point")
    return point


def _located(tracks: pd.DataFrame, frame_rate_hz: float | None, where: str) -> Located:
    """Yield each particle with times (n,) in s and known places (n, 3)."""
    clock, rate = ("time_s", 1.0) if frame_rate_hz is None else ("frame", frame_rate_hz)
    check_positive(rate, "frame_rate_hz")
    check_columns(tracks, ("particle", clock, *AXES), where)
    rows, particle, moment = order_tracks(tracks, where, clock)
    places = np.stack([known_numbers(tracks[a], f"{where}: column {a}") for a in AXES], axis=1)
    if np.isinf(places).any():
        row = tracks.index[int(np.argwhere(np.isinf(places))[0, 0])]
        raise InputError(f"{where}: a place is infinite in row {row}. Use NaN where it is unknown.")
    time, places = moment.astype(np.float64) / rate, places[rows]
    names, starts = np.unique(particle, return_index=True)
    for name, part in zip(names, np.split(np.arange(len(rows)), starts[1:]), strict=False):
        known = part[np.isfinite(places[part]).all(axis=1)]
        yield int(name), time[known], places[known]


def _row(particle: int, time: Array, places: Array, exit_mm: Array, method: Regression) -> Row:
    """Return one track's row of the table, without unknown values."""
    row: Row = {"particle": particle, "points": len(time)}
    row |= zip(COLUMNS["exit_point_mm"], exit_mm.tolist(), strict=True)
    if len(time):
        row |= {"first_s": time[0], "last_s": time[-1]}
    if len(time) < method.fewest:
        return row | {"outcome": TOO_FEW if len(time) else NO_DEPTH}
    fit = method(time, places, exit_mm)
    for name, columns in COLUMNS.items():
        row |= zip(columns, np.atleast_1d(getattr(fit, name)).tolist(), strict=True)
    for columns, factors in zip(FACTORS, fit.coefficients, strict=True):
        row |= dict.fromkeys(columns, 0.0) | dict(zip(columns, factors, strict=False))
    return row | {"outcome": FITTED}
