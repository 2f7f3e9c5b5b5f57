"""Trajectories: polynomials through the lance's outlet at one t0 (sec. 4.3).

    tracks -> `regress_all` -> `kilnflight.tables.TRAJECTORIES` -> `fits`

`regress` returns the `Fit` of one track (Eqs 4.26 to 4.33), `regress_all` a table
(Table 5.18).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
import pandas as pd
from numpy.polynomial import legendre
from scipy.optimize import brentq

from kilnflight.arrays import Array
from kilnflight.checks import InputError, check_columns, check_finite, check_number
from kilnflight.tables import (
    AXES,
    HIGHEST_ORDER,
    PLACES,
    TRAJECTORIES,
    order_tracks,
    plain,
)

Three = tuple[float, float, float]
Orders = tuple[int, ...]
Timed = tuple[int, Array, Array]  # particle, times (n,) in s, places (n, 3) in mm

FITTED = "fitted"
NO_DEPTH = "no depth"
TOO_FEW = "too few points"
AXIS_MEASURES = ("rmse_mm", "mape_percent", "r2", "r2_adjusted")
BETTER = np.array([-1.0, -1.0, 1.0, 1.0])  # sign of a gain: errors fall, R2 rises
ROUNDING_MM = 1e-6  # an RMSE below it is rounding
# of three points: "a few randomly selected points", section 4.3; the number is ours
TRIPLES = 20
LONGEST_S = (
    1.0  # from the exit to the first detection; ours: the longest flights (Fig. 5.19)
)
GRID = 65  # values of t0 on the grid that is searched downhill
# of the duration after the first detection; steps grow with the distance from it
DENSE = 0.1
SHORTEST = 1e-6  # of the duration, from t0 to the first detection


@dataclass(frozen=True)
class Fit:
    """A regressed trajectory: positions in mm as a function of time in s.

    Along each axis (x, y, z) the position is ``exit + c_1 (t - t0) + c_2 (t - t0)^2 +
    ...`` (Eq. 4.29 in powers of t - t0). A measure that is not defined along an axis is
    NaN.

    >>> fit = Fit((0.0, 0.0, 6500.0), 0.1, 0, (0.0, 0.1), (2, 2, 2),
    ...           ((1.0, 0.0), (0.0, -4.9), (-9000.0, 0.0)), 0.2, 0.5, 60)
    >>> fit(0.2).round(3).tolist()
    [[0.1, -0.049, 5600.0]]
    """

    exit_point_mm: Three  # the lance's outlet
    t0: float  # s, time at the outlet
    t0_at_bound: int  # -1: t0 is the earliest of its range, 1: the latest, 0: between
    t0_range_s: tuple[float, float]  # earliest and latest
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
        """Return positions (n, 3) in mm at times (n,) in s or at one time (n = 1)."""
        return (
            self._sums([(0.0, *axis) for axis in self.coefficients], time_s)
            + self.exit_point_mm
        )

    def velocity(self, time_s: npt.ArrayLike) -> Array:
        """Return velocities (n, 3) in mm/s at times (n,) in s or at one time (n = 1)."""
        rates = [[k * c for k, c in enumerate(axis, 1)] for axis in self.coefficients]
        return self._sums(rates, time_s)

    def _sums(self, factors: Sequence[Sequence[float]], time_s: npt.ArrayLike) -> Array:
        """Return sums (n, 3) of factors times ascending powers of t - t0, from power 0.

        ``factors`` holds one sequence per axis; ``time_s`` (n,) or one number is in s.
        """
        time = np.atleast_1d(check_finite(time_s, "Fit: time_s"))
        return np.stack(
            [np.polyval(axis[::-1], time - self.t0) for axis in factors], axis=-1
        )


@dataclass(frozen=True)
class Regression:
    """Least-squares fit of t0, the time at the lance, and of one polynomial per axis.

    Notes
    -----
    Readings of section 4.3. (1) For a given t0 the best coefficients solve a linear
    problem, so t0 is the only unknown left. (2) The range of t0 and its first guess are
    computed from three random points, `TRIPLES` times. The trust region of section 4.3
    descends from its start. So t0 is the local minimum downhill of the guess, not the
    global one. (3) "The regression process is stopped if the optimization of the
    measures is less than 1% for each order of enhancement": an order more counts if
    each of the four measures improves by ``gain`` of its value. (4) An order k leaves n
    - (k + 1) > 0 degrees of freedom for n points. (5) All axes have the same weight.
    """

    lowest: int = 2  # order, section 4.3
    highest: int = 6  # order, section 4.3
    gain: float = 0.01  # relative, section 4.3
    measures: tuple[str, ...] = (
        AXIS_MEASURES  # those that must all improve, section 4.3
    )

    def __post_init__(self) -> None:
        for name, least in ("lowest", 1), ("highest", self.lowest):
            order = getattr(self, name)
            where = f"Regression: {name}"
            # 9: higher ones are not separated from rounding
            check_number(order, where, least=least, most=9, whole=True)
        check_number(self.gain, "Regression: gain", least=0, most=1)
        if not self.measures or set(self.measures) - set(AXIS_MEASURES):
            raise InputError(
                f"Regression: measures: name some of {', '.join(AXIS_MEASURES)}."
            )

    @property
    def fewest(self) -> int:
        """Return the smallest number of points that can be fitted.

        It leaves the RMSE (Eq. 4.30) a degree of freedom at order 2, or at ``lowest``
        if that is higher.
        """
        return max(self.lowest, 2) + 2

    def __call__(self, time: Array, places: Array, exit_point: Array) -> Fit:
        """Return the trajectory of n detections with depth.

        Parameters
        ----------
        time
            (n,) in s, strictly ascending.
        places
            (n, 3) x, y, z in mm.
        exit_point
            (3,) the lance's outlet in mm.

        Raises
        ------
        InputError
            If there are fewer points than `fewest`.
        """
        if len(time) < self.fewest:
            raise InputError(
                f"track: {len(time)} points; order {self.lowest} needs {self.fewest}."
            )
        duration = time[-1] - time[0]
        highest = min(self.highest, len(time) - 2)
        unit = (time - time[0]) / duration
        moved = (places - exit_point).T
        limits, first = range_of_start(unit, moved, LONGEST_S / duration)
        solve = cache(trajectory_solver(unit, moved, highest, limits, first))

        def measure(orders: Orders) -> Array:
            """Return the measures (3, 4) of the polynomials of these orders."""
            fitted = (solve(orders)[1].T + exit_point).T
            return np.array(list(map(fit_measures, places.T, fitted, orders)))

        orders = self.choose(measure, highest)
        start = solve(orders)[0]
        quality = measure(orders).T
        since = (unit - start) / (1.0 - start)  # so that the powers stay within 0 and 1
        factors = []
        for axis, order in enumerate(orders):
            powers = np.arange(1, order + 1)
            basis = since[:, None] ** powers
            solved = np.linalg.lstsq(basis, moved[axis])[0]
            factors.append(
                tuple((solved / ((1.0 - start) * duration) ** powers).tolist())
            )
        t0, *range_s = (time[0] + np.array([start, *limits]) * duration).tolist()
        early, late = np.isclose(
            start, limits, rtol=0, atol=1e-9 * np.ptp(limits)
        ).astype(int)
        fields = (
            tuple(exit_point.tolist()),
            t0,
            int(late - early),
            tuple(range_s),
            orders,
        )
        span = [*time[[0, -1]].tolist(), len(time)]
        return Fit(*fields, tuple(factors), *span, *map(tuple, quality.tolist()))

    def choose(self, measure: Callable[[Orders], Array], highest: int) -> Orders:
        """Return the orders (3,) of the polynomials in x, y, z (section 4.3).

        All axes start at the lowest order. The gain of an axis by one order more is the
        smallest relative improvement among ``measures``. In each round the axis that
        gains most gets that order. It ends when no axis gains the share ``gain`` (1 %).

        Parameters
        ----------
        measure
            Function from orders (3,) to RMSE, MAPE, R2 and adjusted R2 of each axis,
            (3, 4).
        highest
            Highest order allowed.
        """
        judged = [AXIS_MEASURES.index(name) for name in self.measures]
        orders: Orders = (self.lowest,) * 3
        while True:
            before = measure(orders)
            gains = {}
            for axis in range(3):
                if orders[axis] == highest or before[axis, 0] < ROUNDING_MM:
                    continue
                higher = (*orders[:axis], orders[axis] + 1, *orders[axis + 1 :])
                change = BETTER * (measure(higher)[axis] - before[axis])
                share = change[judged] / np.abs(before[axis, judged])
                if share.min() >= self.gain:  # False for NaN: R2 without motion
                    gains[higher] = share.min()
            if not gains:
                return orders
            orders = max(gains, key=lambda each: gains[each])


def range_of_start(time: Array, moved: Array, longest: float) -> tuple[Array, float]:
    """Return the range (2,) of t0 and its first guess, from random points.

    Times are in durations of the track after the first detection, so t0 is below 0.
    Each draw solves Eq. 4.29 for three points, the fewest that determine its seven
    unknowns. The guess is the median of the solutions. Their range is widened by its
    own width or by the shortest step in time.

    Parameters
    ----------
    time
        (n,) from 0 to 1.
    moved
        (3, n) positions from the lance's outlet, mm.
    longest
        Longest time from the outlet to the first detection.
    """
    widest = np.array([-max(longest, 2 * SHORTEST), -SHORTEST])
    order = np.argsort(np.random.default_rng(0).random((TRIPLES, len(time))), axis=1)
    drawn = np.sort(order[:, :3], axis=1)
    at = time[drawn]
    # Quadratics through the exit at t0 have vanishing second divided differences of
    # moved / (t - t0). The residual is the difference that is left.
    differences = 1.0 / np.prod(
        at[:, :, None] - at[:, [[1, 2], [0, 2], [0, 1]]], axis=2
    )

    def cost(start: Array) -> Array:
        """Return the squared residual (TRIPLES, g) of Eq. 4.29 at t0 (g, TRIPLES)."""
        factors = differences / (at - start[..., None])
        left = np.einsum("gdk,adk->adg", factors, moved[:, drawn]) ** 2
        return left.sum(axis=0) / (factors**2).sum(axis=2).T

    low, high = np.tile(widest[:, None], TRIPLES)
    # 129: with 65, exact flights miss their minimum. Then 16 steps over two of the
    # last.
    for count in [129] + 10 * [17]:
        grid = np.linspace(low, high, count)
        best = np.argmin(cost(grid), axis=1)
        around = np.clip(best + np.array([[-1], [0], [1]]), 0, count - 1)
        low, solved, high = np.take_along_axis(grid, around, axis=0)
    margin = max(float(np.ptp(solved)), float(np.diff(time).min()))
    limits = np.clip([solved.min() - margin, solved.max() + margin], *widest)
    return limits, float(np.median(solved))


def trajectory_solver(
    time: Array, moved: Array, highest: int, limits: Array, first: float
) -> Callable[[Orders], tuple[float, Array]]:
    """Return a function from orders to the best t0 and the positions fitted there.

    Positions (3, n) are in mm from the outlet; t0 is in durations of the track.

    A polynomial through the exit at t0 is t - t0 times a polynomial of one order less.
    One orthogonal basis of these serves all orders.

    Parameters
    ----------
    time
        (n,) from 0 to 1, in durations of the track.
    moved
        (3, n) positions from the lance's outlet, mm.
    highest
        Highest order that the function will be called with.
    limits, first
        Range (2,) and first guess of t0, of `range_of_start`.
    """
    powers = legendre.legvander(2 * time - 1, highest - 1)
    # Denser towards the first detection, where the cost changes faster with t0.
    grid = np.clip(
        DENSE - np.geomspace(DENSE - limits[0], DENSE - limits[1], GRID), *limits
    )

    def fitted(start: Array, orders: Orders) -> Array:
        """Return the best positions (3, k, n) in mm for each given t0 (k,)."""
        basis = np.linalg.qr(
            (time - start[:, None])[:, :, None] * powers[:, : max(orders)]
        )[0]
        shares = moved @ basis  # of each vector of the basis, (k, 3, highest order)
        shares[:, np.arange(max(orders)) >= np.array(orders)[:, None]] = 0.0
        return np.swapaxes(shares @ np.swapaxes(basis, 1, 2), 0, 1)

    @cache
    def costs(order: int) -> Array:
        """Return the squared residuals (3, GRID) in mm^2 on the grid of t0."""
        return ((moved[:, None] - fitted(grid, (order,) * 3)) ** 2).sum(axis=-1)

    @cache
    def slope(start: float, orders: Orders) -> float:
        """Return half the derivative of the total cost by t0, at the best coefficients."""
        best = fitted(np.array([start]), orders)[:, 0]
        return float((((moved - best) * best) @ (1.0 / (time - start))).sum())

    def solve(orders: Orders) -> tuple[float, Array]:
        """Return t0 and the fitted positions (3, n) in mm.

        t0 descends on the grid from its first guess; a root of the slope refines it.
        """
        cost = np.sum([costs(order)[axis] for axis, order in enumerate(orders)], axis=0)
        cost = np.append(cost, np.inf)
        at = int(np.argmin(np.abs(grid - first)))
        while step := (0, -1, 1)[np.argmin(cost[[at, at - 1, at + 1]])]:  # downhill
            at += step
        start = float(grid[at])
        side = at - 1 if slope(start, orders) > 0 else at + 1
        other = float(grid[np.clip(side, 0, GRID - 1)])
        if slope(start, orders) * slope(other, orders) < 0:
            start = brentq(slope, start, other, (orders,), xtol=1e-14)
        return start, fitted(np.array([start]), orders)[:, 0]

    return solve


def fit_measures(places: Array, fitted: Array, order: int) -> Array:
    """Return RMSE, MAPE, R2 and adjusted R2 (4,) of one axis (Eqs 4.30 to 4.33).

    ``places`` and ``fitted`` (n,) are in mm, and so is the RMSE. MAPE, in %, leaves out
    points at
    0. Points near 0 make it large, so Table 5.18 gives medians. R2 is NaN without
       motion.
    """
    squares = np.sum((places - fitted) ** 2)
    free = len(places) - (order + 1)
    known = places != 0
    relative = np.abs((places[known] - fitted[known]) / places[known])
    mape = 100 * relative.mean() if known.any() else np.nan
    about_mean = (
        np.sum((places - places.mean()) ** 2) if places.min() < places.max() else 0.0
    )
    r2 = (
        1 - squares / about_mean if about_mean > 0 else np.nan
    )  # Eq. 4.32 divides by it
    return np.array([np.sqrt(squares / free), mape, r2, r2 - (1 - r2) * order / free])


def regress(
    track: pd.DataFrame,
    exit_point: npt.ArrayLike,
    frame_rate_hz: float | None = None,
    parameters: Regression | None = None,
) -> Fit:
    """Return the trajectory of one track.

    Parameters
    ----------
    track
        One row per detection: ``x``, ``y``, ``z`` in mm (rows with NaN are left out),
        and ``frame``, or ``time_s`` without a frame rate.
    exit_point
        (3,) the lance's outlet in mm.
    frame_rate_hz
        None: times are ``time_s``.
    parameters
        None: `Regression` with its defaults.

    Raises
    ------
    InputError
        If the track holds several particles or too few points, or an argument is
        invalid.
    """
    track = plain(track)
    if not len(track) or ("particle" in track and len(track["particle"].unique()) > 1):
        raise InputError("track: must hold one particle; call regress_all for several.")
    ((_, time, places),) = _located(track.assign(particle=0), frame_rate_hz, "track")
    return (parameters or Regression())(time, places, _outlet(exit_point))


def regress_all(
    tracks: pd.DataFrame,
    exit_point: npt.ArrayLike,
    frame_rate_hz: float | None = None,
    parameters: Regression | None = None,
) -> pd.DataFrame:
    """Return `kilnflight.tables.TRAJECTORIES`, one row per particle.

    A track that cannot be regressed keeps its row: ``outcome`` is the reason, unknown
    values are NaN or 0.

    Parameters
    ----------
    tracks
        One row per detection: ``particle`` (-1: in no track), ``x``, ``y``, ``z`` in mm
        (NaN where unknown), and ``frame``, or ``time_s`` without a frame rate.
    exit_point, frame_rate_hz, parameters
        As for `regress`.

    Raises
    ------
    InputError
        If a column or an argument is invalid, or the highest order is above 6, the last
        one in the table.
    """
    method = parameters or Regression()
    if method.highest > HIGHEST_ORDER:
        raise InputError(
            f"regress_all: parameters.highest is above {HIGHEST_ORDER}; use regress."
        )
    exit_mm = _outlet(exit_point)
    rows = [
        _row(method, exit_mm, timed)
        for timed in _located(tracks, frame_rate_hz, "tracks")
    ]
    return (
        pd.DataFrame(rows, columns=TRAJECTORIES.names) if rows else TRAJECTORIES.empty()
    )


def fits(trajectories: pd.DataFrame) -> dict[int, Fit]:
    """Return the `Fit` of each fitted particle of a trajectory table, by particle.

    The columns are read by their order in `kilnflight.tables.TRAJECTORIES`.
    """
    table = TRAJECTORIES.check(trajectories, "trajectories")
    known = dict[int, Fit]()
    table = table[table["outcome"] == FITTED]
    check_finite(
        table.iloc[:, 3 : -3 * len(AXIS_MEASURES)], "trajectories of fitted particles"
    )
    known_order = (
        table.filter(regex="^order_").isin(range(1, HIGHEST_ORDER + 1)).to_numpy().all()
    )
    if table["particle"].duplicated().any() or not known_order:
        raise InputError(
            "trajectories: a particle twice, or an order that is not 1 to 6."
        )
    for row in table.itertuples(index=False, name=None):
        particle, _, points, first, last, t0, earliest, latest, at_bound, *rest = row
        exit_mm, orders, *factors = (
            tuple(rest[k : k + 3]) for k in range(0, len(rest), 3)
        )
        by_axis = zip(orders, zip(*factors[:HIGHEST_ORDER], strict=True), strict=True)
        coefficients = tuple(axis[:order] for order, axis in by_axis)
        range_s = (earliest, latest)
        span = (first, last, points)
        known[particle] = Fit(
            exit_mm,
            t0,
            at_bound,
            range_s,
            orders,
            coefficients,
            *span,
            *factors[HIGHEST_ORDER:],
        )
    return known


def _row(method: Regression, exit_mm: Array, timed: Timed) -> list[object]:
    """Return one track's row, in the order of `kilnflight.tables.TRAJECTORIES`."""
    particle, time, places = timed
    row: list[object] = [particle, TOO_FEW if len(time) else NO_DEPTH, len(time)]
    if len(time) < method.fewest:
        span = [time[0], time[-1]] if len(time) else 2 * [np.nan]
        row += [*span, *3 * [np.nan], 0, *exit_mm.tolist(), 0, 0, 0]
        return row + (len(TRAJECTORIES.names) - len(row)) * [np.nan]
    fit = method(time, places, exit_mm)
    factors = np.zeros((HIGHEST_ORDER, 3))
    for axis, solved in enumerate(fit.coefficients):
        factors[: len(solved), axis] = solved
    row = [
        particle,
        FITTED,
        fit.points,
        fit.first_s,
        fit.last_s,
        fit.t0,
        *fit.t0_range_s,
    ]
    row += [fit.t0_at_bound, *exit_mm.tolist(), *fit.orders, *factors.ravel().tolist()]
    return row + [value for name in AXIS_MEASURES for value in getattr(fit, name)]


def _outlet(exit_point: npt.ArrayLike) -> Array:
    """Return the lance's outlet (3,) in mm, checked."""
    return check_finite(exit_point, "exit_point", (3,))


def _located(
    tracks: pd.DataFrame, rate_hz: float | None, where: str
) -> Iterator[Timed]:
    """Yield each particle with its times (n,) in s and places (n, 3) in mm.

    Detections without depth are left out, so n may be 0. Times are frame / ``rate_hz``,
    or the column ``time_s`` if ``rate_hz`` is None.
    """
    clock, rate = ("time_s", 1.0) if rate_hz is None else ("frame", rate_hz)
    check_number(rate, "frame_rate_hz", above=0)
    check_columns(tracks, ("particle", clock, *AXES), where)
    rows, particle, moment = order_tracks(tracks, where, clock)
    places = PLACES.check(tracks, where).to_numpy()
    time = moment.astype(np.float64) / rate
    places = places[rows]
    names, starts = np.unique(particle, return_index=True)
    for name, part in zip(
        names, np.split(np.arange(len(rows)), starts[1:]), strict=False
    ):
        known = part[np.isfinite(places[part]).all(axis=1)]
        yield int(name), time[known], places[known]
