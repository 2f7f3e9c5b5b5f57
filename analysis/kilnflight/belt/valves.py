"""Hit particles by a bar of valves, by predictions of their arrival.

The purpose of the predictions in both papers (Fig. 1 of each): an array of nozzles
across the belt blows particles out. Neither paper evaluates it, so the numbers of the
bar are choices.
"""

from typing import Annotated, NamedTuple

import numpy as np
from pandas import DataFrame, Series

from kilnflight.arrays import Array, ArrayLike, Flags, Integers
from kilnflight.belt.models import BELT_WIDTH_MM, Columns
from kilnflight.checks import (
    NotNegative,
    Number,
    Positive,
    Range,
    Settings,
    check_flags,
    real_numbers,
)

# Valve, and times in s of the commands to open and to close, (k,) each.
Events = tuple[Integers, Array, Array]


class Separation(NamedTuple):
    """Which of n particles are hit, and which were to be; a share of none is NaN."""

    hit: Flags  # (n,), was at a valve while it was open
    chosen: Flags  # (n,), was to be blown out

    @property
    def hit_share(self) -> float:
        """Share of blown-out particles among those to be blown out."""
        return float(Series(self.hit[self.chosen]).mean())

    @property
    def inadvertent_share(self) -> float:
        """Share of blown-out particles among the others: co-deflections."""
        return float(Series(self.hit[~self.chosen]).mean())


class ValveBar(Settings):
    """Evenly spaced valves across the belt, and when each of them opens.

    For each prediction the nearest valve opens for ``open_s``. The middle of that time
    is ``delay_s`` after the predicted time. Openings of one valve that overlap, or lie
    nearer than ``dead_s``, become one. A particle is hit if its centre passes an open
    valve, also one that was opened for another; its size and the air's way are
    neglected. The belt's walls keep particles on it, so a place predicted beyond them
    is taken to be at the wall.

    Parameters
    ----------
    valves
        Their number; 32 have a pitch of 5.6 mm, about one particle. Not printed. Jets
        have no gap and no overlap.
    belt_mm
        Width of the belt, and of the bar (2020, section 3).
    open_s
        Time that a valve is open; not printed, as are the next.
    latency_s
        Time from the command to the air at the belt.
    delay_s
        Time from the prediction to the middle of the window; below 0: before it.
    dead_s
        Shortest pause of a valve from closing to opening.
    deviations
        Standard deviations of a prediction by which its window is longer, before and
        after, and wider, to each side; 0: all windows are equal. Then ``open_s`` is the
        time that a particle's size takes.

    Examples
    --------
    >>> predicted = DataFrame({"time_s": [0.1, 0.104], "y": 90.0})
    >>> bar = ValveBar()
    >>> valve, opens, closes = bar.events(predicted)  # both windows are merged
    >>> f"valve {valve[0]}: {1000 * opens[0]:.1f} to {1000 * closes[0]:.1f} ms"
    'valve 16: 97.5 to 106.5 ms'
    >>> arrival = DataFrame({"time_s": [0.1, 0.107, 0.1], "y": [91.0, 91.0, 20.0]})
    >>> bar(predicted, arrival, chosen=np.array([True, True, False])).hit_share
    0.5
    """

    valves: Annotated[int, Range(least=1, most=10_000)] = 32
    belt_mm: Positive = BELT_WIDTH_MM
    open_s: Positive = 0.005
    latency_s: NotNegative = 0.0
    delay_s: Number = 0.0
    dead_s: NotNegative = 0.0
    deviations: NotNegative = 0.0

    @property
    def pitch_mm(self) -> float:
        """The distance from one valve to the next."""
        return self.belt_mm / self.valves

    @property
    def middles_mm(self) -> Array:
        """The places (valves,) of the valves across the belt."""
        steps = np.arange(self.valves, dtype=np.float64) + 0.5 - self.valves / 2
        return self.belt_mm / 2 + self.pitch_mm * steps

    def windows(self, predicted: Columns) -> Events:
        """Return valve, opening and closing command of each window, (n,) each.

        Commands are times in s. ``predicted`` are columns of
        `kilnflight.tables.BELT_PREDICTED`, and ``time_sd_s``, ``y_sd_mm``, if there are
        ``deviations``; rows whose time or place is NaN open no valve.
        """
        names = ["time_s", "y"]
        if self.deviations:
            names += ["time_sd_s", "y_sd_mm"]
        columns = [
            real_numbers(predicted[name], f"predicted: {name}") for name in names
        ]
        known = np.isfinite(columns).all(axis=0)
        time, y, *spreads = (column[known] for column in columns)
        early, side = self.deviations * np.array(spreads or np.zeros((2, len(y))))
        first = self._nearest(y - side)
        number = self._nearest(y + side) - first + 1
        # Numbers 0, 1, ... within each prediction.
        step = np.arange(number.sum()) - np.repeat(number.cumsum() - number, number)
        middle = time + self.delay_s - self.latency_s
        half = self.open_s / 2 + early
        opens, closes = np.repeat([middle - half, middle + half], number, axis=1)
        return np.repeat(first, number) + step, opens, closes

    def _nearest(self, y: Array) -> Integers:
        """Return the valve (n,) whose middle is nearest to each place."""
        steps = (y.clip(0, self.belt_mm) - self.middles_mm[0]) / self.pitch_mm
        return np.floor(steps + 0.5).clip(0, self.valves - 1).astype(np.int64)

    def events(self, predicted: Columns) -> Events:
        """Return valve, opening and closing command of the merged windows, (k,) each.

        They are sorted by valve and time (s), and all predictions are known in advance.
        ``predicted`` is `kilnflight.tables.BELT_PREDICTED`.
        `kilnflight.belt.online.ValveSchedule` takes predictions as they become known.
        """
        windows = self.windows(predicted)
        order = np.lexsort((windows[1], windows[0]))
        valve, opens, closes = (column[order] for column in windows)
        closes = Series(closes).groupby(valve).cummax().to_numpy()
        first = np.diff(valve, prepend=-1) != 0
        first[1:] |= self.are_apart(closes[:-1], opens[1:])
        return valve[first], opens[first], closes[np.roll(first, -1)]

    def are_apart(self, close_s: ArrayLike, open_s: ArrayLike) -> Flags:
        """Return whether a valve may close at ``close_s`` and open again at ``open_s``.

        Both are times of commands in s, of one shape.
        """
        pause = np.subtract(open_s, close_s)
        return np.asarray((pause > 0) & (pause >= self.dead_s))

    def hits(self, events: Events, time_s: Array, y: Array) -> Flags:
        """Return which particles (n,) are hit.

        Parameters
        ----------
        events
            From `events`: sorted by valve and time, and not overlapping.
        time_s, y
            True time (s) and place (mm) of each particle at the valves, (n,) each.
        """
        hit = np.zeros(len(time_s), bool)
        valve, opens, closes = events
        for number, middle in enumerate(self.middles_mm):
            near = np.flatnonzero(np.abs(y - middle) <= self.pitch_mm / 2)
            own = valve == number
            # The first event is one that nothing meets.
            closing = np.append(-np.inf, closes[own] + self.latency_s)
            time = time_s[near]
            latest = np.searchsorted(opens[own] + self.latency_s, time, side="right")
            hit[near] |= time <= closing[latest]
        return hit

    def __call__(
        self, predicted: Columns, arrival: DataFrame, chosen: Flags
    ) -> Separation:
        """Return which particles are hit if each prediction opens a valve.

        Parameters
        ----------
        predicted
            `kilnflight.tables.BELT_PREDICTED` of the particles to be blown out.
        arrival
            All true arrivals (n,): ``time_s`` and ``y`` of
            `kilnflight.tables.BELT_ARRIVAL`.
        chosen
            (n,), which of them are to be blown out.
        """
        time_s, y = arrival[["time_s", "y"]].to_numpy(float).T
        hit = self.hits(self.events(predicted), time_s, y)
        check_flags("ValveBar: chosen", *chosen)
        return Separation(hit, np.asarray(chosen))
