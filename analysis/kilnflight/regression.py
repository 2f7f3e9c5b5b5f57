"""Trajectories: polynomials through the lance's outlet at one t0 (sec. 4.3).

    tracks -> `regress_all` -> `kilnflight.tables.TRAJECTORIES` -> `fits`

`regress` returns the `Fit` of one track (Eqs 4.26 to 4.33), `regress_all` a table
(Table 5.18).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import zip_longest
from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.polynomial import legendre
from pandas import DataFrame, Series
from scipy.optimize import brentq

from kilnflight.arrays import Array, ArrayLike, Facts, Shape, Two
from kilnflight.checks import (
    InputError,
    Range,
    Settings,
    Share,
    check_finite,
    check_number,
)
from kilnflight.tables import (
    AXES,
    HIGHEST_ORDER,
    PLACES,
    TRAJECTORIES,
    order_tracks,
    plain,
)

Three = tuple[float, float, float]
Orders = Shape
Timed = tuple[int, Array, Array]  # particle, times (n,) in s, places (n, 3) in mm

UNKNOWN: Three = (np.nan,) * 3  # a measure that is not defined along any axis
FITTED = "fitted"
NO_DEPTH = "no depth"
TOO_FEW = "too few points"
Measure = Literal["rmse_mm", "mape_percent", "r2", "r2_adjusted"]
AXIS_MEASURES = get_args(Measure)
Order = Annotated[int, Range(least=1, most=9)]  # of a polynomial
BETTER = np.array([-1.0, -1.0, 1.0, 1.0])  # sign of a gain: errors fall, R2 rises
# Columns of `TRAJECTORIES` and fields of `Fit`; ``{}`` stands for x, y, z.
_FIELDS = {
    "points": "points",
    "first_s": "first_s",
    "last_s": "last_s",
    "t0_s": "t0",
    "t0_at_bound": "t0_at_bound",
}
_FIELDS_BY_AXIS = {
    "exit_{}": "exit_point_mm",
    "order_{}": "orders",
    "rmse_{}_mm": "rmse_mm",
    "mape_{}_percent": "mape_percent",
    "r2_{}": "r2",
    "r2_adjusted_{}": "r2_adjusted",
}
ROUNDING_MM = 1e-6  # an RMSE below it is rounding
# Sets of three points: "a few randomly selected points", section 4.3; number is ours.
TRIPLES = 20
# Seconds from the exit to the first detection; ours: the longest flights (Fig. 5.19).
LONGEST_S = 1.0
GRID = 65  # values of t0 on the grid that is searched downhill
# Share of the duration after the first detection; steps grow with the distance from it.
DENSE = 0.1
SHORTEST = 1e-6  # least time from t0 to the first detection, as share of the duration


@dataclass(frozen=True)
class Fit:
    """A regressed trajectory: positions in mm as a function of time in s.

    Along each axis (x, y, z) the position is ``exit + c_1 (t - t0) + c_2 (t - t0)^2 +
    ...`` (Eq. 4.29 in powers of t - t0). A measure that is not defined along an axis is
    NaN.

    Parameters
    ----------
    exit_point_mm
        The lance's outlet.
    t0
        Time at the outlet, s.
    t0_at_bound
        -1: t0 is the earliest of its range, 1: the latest, 0: between.
    t0_range_s
        Earliest and latest t0.
    orders
        Order of the polynomial along each axis.
    coefficients
        c_1, c_2, ... along each axis, in mm/s, mm/s^2, ...
    first_s, last_s
        Time of the first and of the last detection.
    points
        Number of detections.
    rmse_mm
        Root mean square of the residuals along each axis (Eq. 4.30).
    mape_percent
        Mean absolute percentage error along each axis (Eq. 4.31).
    r2, r2_adjusted
        Coefficient of determination along each axis, and adjusted by the number of
        coefficients (Eqs 4.32 and 4.33).

    Examples
    --------
    >>> fit = Fit((0.0, 0.0, 6500.0), 0.1, 0, (0.0, 0.1), (2, 2, 2),
    ...           ((1.0, 0.0), (0.0, -4.9), (-9000.0, 0.0)), 0.2, 0.5, 60)
    >>> fit(0.2).round(3).tolist()
    [[0.1, -0.049, 5600.0]]
    """

    exit_point_mm: Three
    t0: float
    t0_at_bound: int
    t0_range_s: Two
    orders: Orders
    coefficients: tuple[tuple[float, ...], ...]
    first_s: float
    last_s: float
    points: int
    rmse_mm: Three = UNKNOWN
    mape_percent: Three = UNKNOWN
    r2: Three = UNKNOWN
    r2_adjusted: Three = UNKNOWN

    def __call__(self, time_s: ArrayLike) -> Array:
        """Return positions (n, 3) in mm at times (n,) or one time, in s."""
        factors = [(0.0, *axis) for axis in self.coefficients]
        return self._sums(factors, time_s) + self.exit_point_mm

    def velocity(self, time_s: ArrayLike) -> Array:
        """Return velocities (n, 3) in mm/s at times (n,) or one time, in s."""
        rates = [[k * c for k, c in enumerate(axis, 1)] for axis in self.coefficients]
        return self._sums(rates, time_s)

    def _sums(self, factors: Sequence[Sequence[float]], time_s: ArrayLike) -> Array:
        """Return sums (n, 3) of factors times ascending powers of t - t0, from power 0.

        ``factors`` holds one sequence per axis; ``time_s`` (n,) or one number is in s.
        """
        since = np.atleast_1d(check_finite(time_s, "Fit: time_s")) - self.t0
        return np.stack([np.polyval(axis[::-1], since) for axis in factors], axis=-1)


class Regression(Settings):
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

    Parameters
    ----------
    lowest, highest
        Orders of the polynomials, section 4.3; at most 9, since higher ones are not
        separated from rounding.
    gain
        Smallest relative improvement that an order more must bring, section 4.3.
    measures
        Names of the measures that must all improve, section 4.3.

    Examples
    --------
    A particle leaves the lance at 0.1 s with 10 m/s.

    >>> time = np.linspace(0.2, 0.4, 30)
    >>> places = np.stack([0 * time, 0 * time, 6500 - 1e4 * (time - 0.1)], axis=1)
    >>> fit = Regression()(time, places, np.array([0.0, 0.0, 6500.0]))
    >>> round(fit.t0, 6), fit.velocity(0.3).round(3).tolist()
    (0.1, [[0.0, 0.0, -10000.0]])
    """

    lowest: Order = 2
    highest: Order = 6
    gain: Share = 0.01
    measures: tuple[Measure, ...] = AXIS_MEASURES

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lowest > self.highest or not self.measures:
            raise InputError(
                "Regression: highest is below lowest, or measures names none."
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
        start, _ = solve(orders)
        t0, earliest, latest = [
            float(time[0] + share * duration) for share in (start, *limits)
        ]
        near = np.isclose(start, limits, rtol=0, atol=1e-9 * np.ptp(limits))
        rmse, mape, r2, r2_adjusted = map(tuple, measure(orders).T.tolist())
        return Fit(
            exit_point_mm=tuple(exit_point.tolist()),
            t0=t0,
            t0_at_bound=int(near[1]) - int(near[0]),
            t0_range_s=(earliest, latest),
            orders=orders,
            coefficients=_coefficients(unit, moved, start, orders, duration),
            first_s=float(time[0]),
            last_s=float(time[-1]),
            points=len(time),
            rmse_mm=rmse,
            mape_percent=mape,
            r2=r2,
            r2_adjusted=r2_adjusted,
        )

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


def _coefficients(
    time: Array, moved: Array, start: float, orders: Orders, duration: float
) -> tuple[tuple[float, ...], ...]:
    """Return the best coefficients of each axis in mm/s, mm/s^2, ...

    ``time`` (n,) and t0, ``start``, are in durations of the track, ``duration`` in s;
    ``moved`` (3, n) is in mm from the outlet.
    """
    since = (time - start) / (1.0 - start)  # so that the powers stay within 0 and 1
    factors = []
    for order, places in zip(orders, moved, strict=True):
        powers = np.arange(1, order + 1)
        solved = np.linalg.lstsq(since[:, None] ** powers, places)[0]
        solved = solved / ((1.0 - start) * duration) ** powers
        factors.append(tuple(solved.tolist()))
    return tuple(factors)


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
    others = at[:, [[1, 2], [0, 2], [0, 1]]]
    differences = 1.0 / np.prod(at[:, :, None] - others, axis=2)

    def cost(start: Array) -> Array:
        """Return the squared residual (TRIPLES, g) of Eq. 4.29 at t0 (g, TRIPLES)."""
        factors = differences / (at - start[..., None])
        left = np.einsum("gdk,adk->adg", factors, moved[:, drawn]) ** 2
        return left.sum(axis=0) / (factors**2).sum(axis=2).T

    low, high = np.tile(widest[:, None], TRIPLES)
    # With 65 values exact flights miss their minimum. Each finer grid has 16 steps over
    # two of the last.
    for count in [129] + 10 * [17]:
        grid = np.linspace(low, high, count)
        best = np.argmin(cost(grid), axis=1)
        around = np.clip(best + np.array([[-1], [0], [1]]), 0, count - 1)
        low, solved, high = np.take_along_axis(grid, around, axis=0)
    margin = max(np.ptp(solved), np.diff(time).min())
    limits = np.clip([solved.min() - margin, solved.max() + margin], *widest)
    return limits, np.median(solved)


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
    powers: Any = legendre.legvander(2 * time - 1, highest - 1)
    # Denser towards the first detection, where the cost changes faster with t0.
    grid = DENSE - np.geomspace(DENSE - limits[0], DENSE - limits[1], GRID)
    grid = np.clip(grid, *limits)
    fitted = partial(_best_places, time, moved, powers)

    @cache
    def costs(order: int) -> Array:
        """Return the squared residuals (3, GRID) in mm^2 on the grid of t0."""
        return ((moved[:, None] - fitted(grid, (order,) * 3)) ** 2).sum(axis=-1)

    @cache
    def slope(start: float, orders: Orders) -> float:
        """Return half the derivative of the total cost by t0, in mm^2 per duration.

        The best places are (t - t0) q. The cost is least in q, so q may be held fixed,
        and a later t0 moves the places by -q. Every t0 is before the first detection.
        """
        best = fitted(np.array([start]), orders)[:, 0]
        return (((moved - best) * best) @ (1.0 / (time - start))).sum()

    def solve(orders: Orders) -> tuple[float, Array]:
        """Return t0 and the fitted positions (3, n) in mm."""
        cost = np.sum([costs(order)[axis] for axis, order in enumerate(orders)], axis=0)
        at = _downhill(cost, int(np.argmin(np.abs(grid - first))))
        start = grid[at]
        rising = slope(start, orders)
        other = grid[np.clip(at - int(np.sign(rising)), 0, GRID - 1)]
        if rising * slope(other, orders) < 0:
            start = brentq(slope, start, other, (orders,), xtol=1e-14)
        return start, fitted(np.array([start]), orders)[:, 0]

    return solve


def _best_places(
    time: Array, moved: Array, powers: Array, start: Array, orders: Orders
) -> Array:
    """Return the best positions (3, k, n) in mm for each t0, ``start`` (k,).

    ``powers`` (n, highest order) are the polynomials that are multiplied by t - t0.
    """
    most = max(orders)
    factors = (time - start[:, None])[:, :, None] * powers[:, :most]
    basis = np.linalg.qr(factors)[0]
    shares = moved @ basis  # (k, 3, highest order), share of each vector of the basis
    shares[:, np.arange(most) >= np.array(orders)[:, None]] = 0.0
    return np.swapaxes(shares @ basis.mT, 0, 1)


def _downhill(cost: Array, at: int) -> int:
    """Return the index of the local minimum of ``cost`` (n,) downhill of ``at``."""
    cost = np.append(cost, np.inf)  # index -1 and index n lie beyond the ends
    while True:
        step = (0, -1, 1)[np.argmin(cost[[at, at - 1, at + 1]])]
        if step == 0:
            return at
        at += step


def fit_measures(places: Array, fitted: Array, order: int) -> Array:
    """Return RMSE, MAPE, R2 and adjusted R2 (4,) of one axis (Eqs 4.30 to 4.33).

    ``places`` and ``fitted`` (n,) are in mm, and so is the RMSE. MAPE, in %, leaves out
    points whose place is 0. Points near 0 make it large, so Table 5.18 gives medians.
    R2 is NaN without motion.
    """
    squares = np.sum((places - fitted) ** 2)
    free = len(places) - (order + 1)
    mape = np.nan
    known = places != 0
    if known.any():
        relative = np.abs((places[known] - fitted[known]) / places[known])
        mape = 100 * relative.mean()
    r2 = np.nan
    if places.min() < places.max():
        r2 = 1 - squares / np.sum((places - places.mean()) ** 2)
    return np.array([np.sqrt(squares / free), mape, r2, r2 - (1 - r2) * order / free])


def regress(
    track: DataFrame,
    exit_point: ArrayLike,
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

    Returns
    -------
    Fit
        The trajectory, which may be called at a time.

    Raises
    ------
    InputError
        If the track holds several particles or too few points, or an argument is
        invalid.

    Examples
    --------
    A particle leaves the lance in frame 10 with 10 m/s.

    >>> track = DataFrame({"frame": range(20, 50), "x": 0.0, "y": 0.0})
    >>> track["z"] = 6500.0 - 100.0 * (track["frame"] - 10)
    >>> fit = regress(track, (0.0, 0.0, 6500.0), frame_rate_hz=100.0)
    >>> round(fit.t0, 6), fit.orders
    (0.1, (2, 2, 2))
    """
    track = plain(track)
    if not len(track) or len(track.get("particle", Series()).unique()) > 1:
        raise InputError("track: must hold one particle; call regress_all for several.")
    ((_, time, places),) = _located(track.assign(particle=0), frame_rate_hz, "track")
    method = parameters or Regression()
    return method(time, places, check_finite(exit_point, "exit_point", (3,)))


def regress_all(
    tracks: DataFrame,
    exit_point: ArrayLike,
    frame_rate_hz: float | None = None,
    parameters: Regression | None = None,
) -> DataFrame:
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
    exit_mm = check_finite(exit_point, "exit_point", (3,))
    timed = _located(tracks, frame_rate_hz, "tracks")
    rows = [_row(method, exit_mm, *each) for each in timed]
    if not rows:
        return TRAJECTORIES.empty()
    return DataFrame(rows, columns=TRAJECTORIES.names)


def fits(trajectories: DataFrame) -> dict[int, Fit]:
    """Return the `Fit` of each fitted particle of a trajectory table, by particle.

    Parameters
    ----------
    trajectories
        `kilnflight.tables.TRAJECTORIES`, as `regress_all` returns it.

    Raises
    ------
    InputError
        If the table is not such a table, or has a particle twice.
    """
    table = TRAJECTORIES.check(trajectories, "trajectories")
    table = table[table["outcome"] == FITTED]
    # The measures alone may be NaN.
    solved = table.loc[:, "first_s" : f"coefficient_z_{HIGHEST_ORDER}"]
    check_finite(solved, "trajectories of fitted particles")
    known_order = table[_names("order_{}")].isin(range(1, HIGHEST_ORDER + 1))
    if table["particle"].duplicated().any() or not known_order.to_numpy().all():
        raise InputError(
            "trajectories: a particle twice, or an order that is not 1 to 6."
        )
    return {row["particle"]: _fit(row) for row in table.to_dict("records")}


def _fit(row: dict[Any, Any]) -> Fit:
    """Return the trajectory in a row of `kilnflight.tables.TRAJECTORIES`."""
    fields = {field: row[column] for column, field in _FIELDS.items()}
    for template, field in _FIELDS_BY_AXIS.items():
        fields[field] = tuple(row[name] for name in _names(template))
    coefficients = []
    for axis, order in zip(AXES, fields["orders"], strict=True):
        powers = range(1, order + 1)
        coefficients.append(tuple(row[f"coefficient_{axis}_{k}"] for k in powers))
    range_s = (row["t0_earliest_s"], row["t0_latest_s"])
    return Fit(coefficients=tuple(coefficients), t0_range_s=range_s, **fields)


def _row(
    method: Regression, exit_mm: Array, particle: int, time: Array, places: Array
) -> Facts:
    """Return one track's row of `kilnflight.tables.TRAJECTORIES`; NaN is left out."""
    row: Facts = {"particle": particle, "points": len(time), "t0_at_bound": 0}
    row |= dict(zip(_names("exit_{}"), exit_mm.tolist(), strict=True))
    row |= dict.fromkeys(_names("order_{}"), 0)
    if not len(time):
        return row | {"outcome": NO_DEPTH}
    if len(time) < method.fewest:
        return row | {"outcome": TOO_FEW, "first_s": time[0], "last_s": time[-1]}
    fit = method(time, places, exit_mm)
    row["outcome"] = FITTED
    row |= {column: getattr(fit, field) for column, field in _FIELDS.items()}
    row["t0_earliest_s"], row["t0_latest_s"] = fit.t0_range_s
    for template, field in _FIELDS_BY_AXIS.items():
        row |= dict(zip(_names(template), getattr(fit, field), strict=True))
    for axis, factors in zip(AXES, fit.coefficients, strict=True):
        padded = zip_longest(range(1, HIGHEST_ORDER + 1), factors, fillvalue=0.0)
        row |= {f"coefficient_{axis}_{k}": factor for k, factor in padded}
    return row


def _names(name: str) -> list[str]:
    """Return the columns of all axes; ``{}`` in the name stands for the axis."""
    return [name.format(axis) for axis in AXES]


def _located(tracks: DataFrame, rate_hz: float | None, where: str) -> Iterator[Timed]:
    """Yield each particle with its times (n,) in s and places (n, 3) in mm.

    Detections without depth are left out, so n may be 0. Times are frame / ``rate_hz``,
    or the column ``time_s`` if ``rate_hz`` is None.
    """
    clock = "time_s"
    rate = 1.0
    if rate_hz is not None:
        clock = "frame"
        rate = check_number(rate_hz, "frame_rate_hz", above=0)
    rows, particle, moment = order_tracks(tracks, where, clock)
    places = PLACES.check(tracks, where).to_numpy()[rows]
    time = moment / rate
    names, starts = np.unique(particle, return_index=True)
    parts = np.split(np.arange(len(rows)), starts[1:])
    for name, part in zip(names, parts, strict=False):
        known = part[np.isfinite(places[part]).all(axis=1)]
        yield int(name), time[known], places[known]
