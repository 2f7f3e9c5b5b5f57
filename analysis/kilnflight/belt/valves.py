"""Particles that a bar of valves hits, by predictions of their arrival.

The purpose of the predictions in both papers (Fig. 1 of each): an array of nozzles across the belt
blows particles out. Neither evaluates it; numbers of a real bar are for the user to set.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt.models import BELT_WIDTH_MM
from kilnflight.checks import (
    InputError,
    check_at_least,
    check_columns,
    check_count,
    check_finite,
    check_positive,
    check_shape,
)
from kilnflight.tables import BELT_PREDICTED, VALVE_EVENTS

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]
Flags = npt.NDArray[np.bool_]


class Separation(NamedTuple):
    """Which of n particles are hit, and which were to be. A share of nothing is NaN."""

    hit: Flags  # (n,), was at a valve while it was open
    chosen: Flags  # (n,), was to be blown out

    @property
    def hit_share(self) -> float:
        """Share of blown-out particles among those to be blown out."""
        return _mean(self.hit[self.chosen])

    @property
    def inadvertent_share(self) -> float:
        """Share of blown-out particles among the others: co-deflections."""
        return _mean(self.hit[~self.chosen])

    @property
    def purity_blown_out(self) -> float:
        """Share of particles to be blown out among those that were."""
        return _mean(self.chosen[self.hit])

    @property
    def purity_left(self) -> float:
        """Share of the others among those that were not blown out."""
        return _mean(~self.chosen[~self.hit])


def _mean(flags: Flags) -> float:
    return float(flags.mean()) if len(flags) else np.nan


@dataclass(frozen=True)
class ValveBar:
    """Evenly spaced valves across the belt, and when each of them opens.

    For each prediction the valve nearest to the predicted place blows for ``open_s``, the middle of
    which is ``delay_s`` after the predicted time. Windows of a valve that overlap, or lie nearer
    than ``dead_s``, are merged. A particle is hit if its centre passes an open valve, for whichever
    particle that was opened; its size and the air's way are neglected.

    The belt's walls keep particles on it, so a place predicted beyond them is taken to be at the
    wall. A bar may be narrower than the belt; a particle beside all jets is out of reach and opens
    none.
    """

    valves: int = 32  # a pitch of 5.6 mm, about one particle; not printed
    belt_mm: float = BELT_WIDTH_MM
    bar_mm: float | None = None  # in the middle of the belt; None: over the whole belt
    valve_mm: float | None = None  # width of a jet; None: the pitch, no gap and no overlap
    open_s: float = 0.005  # not printed, as are the next
    latency_s: float = 0.0  # from the command to the air at the belt
    delay_s: float = 0.0  # of the window's middle after the predicted time; below 0: before it
    dead_s: float = 0.0  # shortest pause of a valve from closing to opening

    def __post_init__(self) -> None:
        """Refuse a number or width that is not positive, and times below 0."""
        check_count(self.valves, "ValveBar: valves")
        check_positive(self.belt_mm, "ValveBar: belt_mm")
        for name in ("bar_mm", "valve_mm"):
            if getattr(self, name) is not None:
                check_positive(getattr(self, name), f"ValveBar: {name}")
        for name in ("open_s", "latency_s", "dead_s"):
            check_at_least(getattr(self, name), 0, f"ValveBar: {name}")
        check_finite([self.delay_s], "ValveBar: delay_s")

    @property
    def pitch_mm(self) -> float:
        """The way from one valve to the next."""
        return (self.bar_mm or self.belt_mm) / self.valves

    @property
    def width_mm(self) -> float:
        """The width of a jet: as set, else the pitch."""
        return self.pitch_mm if self.valve_mm is None else self.valve_mm

    @property
    def middles_mm(self) -> Array:
        """The places of the valves across the belt."""
        steps = np.arange(self.valves, dtype=np.float64) + 0.5 - self.valves / 2
        return self.belt_mm / 2 + self.pitch_mm * steps

    def windows(self, predicted: pd.DataFrame) -> tuple[Integers, Array, Array]:
        """Return valve, opening and closing command of each prediction that opens one.

        Parameters
        ----------
        predicted
            `kilnflight.tables.BELT_PREDICTED`. Where time or place is NaN, no valve opens.
        """
        table = BELT_PREDICTED.check(predicted)
        time, y = table["time_s"].to_numpy(), table["y"].to_numpy()
        place = y.clip(0, self.belt_mm)
        valve = self._nearest(place)
        away = np.abs(place - self.middles_mm[valve])
        reach = max(self.width_mm, self.pitch_mm) / 2 + 1e-9
        reached = np.isfinite(time) & (away <= reach)
        middle = time[reached] + self.delay_s - self.latency_s
        return valve[reached], middle - self.open_s / 2, middle + self.open_s / 2

    def events(self, predicted: pd.DataFrame) -> pd.DataFrame:
        """Return `kilnflight.tables.VALVE_EVENTS`, in the order of opening.

        All predictions are known in advance; `ValveSchedule` takes them as they become known.
        ``predicted`` is as for `windows`.
        """
        return _table(*self._merged(predicted))

    def _merged(self, predicted: pd.DataFrame) -> tuple[Integers, Array, Array]:
        """Return valve, opening and closing command of each event, by valve and time."""
        valve, opens, closes = self.windows(predicted)
        order = np.lexsort((opens, valve))
        valve, opens, closes = valve[order], opens[order], closes[order]
        first = np.diff(valve, prepend=-1) != 0
        first[1:] |= self.are_apart(closes[:-1], opens[1:])
        # All windows are equally long, so the last of those merged closes last.
        return valve[first], opens[first], closes[np.roll(first, -1)]

    def are_apart(self, close_s: npt.ArrayLike, open_s: npt.ArrayLike) -> Flags:
        """Return whether a valve may close and open again, by the times of these commands."""
        pause = np.subtract(open_s, close_s)
        return np.asarray((pause > 0) & (pause >= self.dead_s))

    def hits(self, events: pd.DataFrame, time_s: Array, y: Array) -> Flags:
        """Return which particles (n,) are hit.

        Parameters
        ----------
        events
            Of `events` or `ValveSchedule`.
        time_s, y
            True time and place (mm) of each particle at the valves, (n,) each; finite.
        """
        columns = VALVE_EVENTS.check(events).to_numpy(np.float64)
        valve, opens, closes = columns[np.lexsort(columns.T[1::-1])].T
        return self._hits(valve, opens, closes, time_s, y)

    def _hits(
        self, valve: Integers | Array, opens: Array, closes: Array, time_s: Array, y: Array
    ) -> Flags:
        """Return which particles are hit by events in the order of `_merged`."""
        check_shape(y, time_s.shape, "ValveBar: true places")
        check_finite(np.stack([time_s, y]), "ValveBar: true times and places")
        hit = np.zeros(len(time_s), dtype=bool)
        if not len(valve) or not len(hit):
            return hit
        opens, closes = opens + self.latency_s, closes + self.latency_s
        # All valves are on one axis, one after the other, each with its events in time.
        start = min(opens.min(), time_s.min())
        whole = 1.0 + max(opens.max(), time_s.max()) - start
        keys, nearest = valve * whole + (opens - start), self._nearest(y)
        reach = int(np.ceil(self.width_mm / self.pitch_mm / 2))
        middles, half = self.middles_mm, self.width_mm / 2
        for passed in (nearest + step for step in range(-reach, reach + 1)):
            away = np.abs(y - middles[passed.clip(0, self.valves - 1)])
            near = np.flatnonzero((away <= half) & ~hit)  # to search the events takes most time
            number, time = passed[near], time_s[near]
            latest = np.searchsorted(keys, number * whole + (time - start), side="right") - 1
            is_open = (latest >= 0) & (valve[latest] == number) & (time <= closes[latest])
            hit[near] = is_open
        return hit

    def _nearest(self, y: Array) -> Integers:
        """Return the valve whose middle is nearest to places across the belt, (n,)."""
        steps = np.nan_to_num((y - self.middles_mm[0]) / self.pitch_mm)
        return np.floor(steps + 0.5).clip(0, self.valves - 1).astype(np.int64)

    def __call__(self, predicted: pd.DataFrame, arrival: pd.DataFrame, chosen: Flags) -> Separation:
        """Return which particles are hit if each prediction opens a valve.

        Parameters
        ----------
        predicted
            `kilnflight.tables.BELT_PREDICTED` of all that is taken for a particle to be blown out.
        arrival
            What truly arrives: ``time_s`` and ``y`` of `kilnflight.tables.BELT_ARRIVAL`.
        chosen
            (n,), which of it is to be blown out.
        """
        if chosen.dtype != np.bool_:
            raise InputError(f"ValveBar: chosen holds {chosen.dtype}, pass True and False.")
        check_columns(arrival, ["time_s", "y"], "ValveBar: arrival")
        check_shape(chosen, (len(arrival),), "ValveBar: chosen")
        true = arrival["time_s"].to_numpy(np.float64), arrival["y"].to_numpy(np.float64)
        return Separation(self._hits(*self._merged(predicted), *true), chosen)


@dataclass
class ValveSchedule:
    """The events of a bar of valves while predictions become known, as in a running sorter.

    A window that is still open or to come may grow when a later prediction is merged with it. So
    an event is returned when its valve has closed; `due` says what to command meanwhile.

    If every prediction is known at least ``dead_s`` before its valve is to open, the events are
    those of `ValveBar.events`. One that comes later opens the valve late: at once, or when its dead
    time is over. After its window it never does. Both are counted.
    """

    bar: ValveBar
    now_s: float = -np.inf  # of the last step
    late: int = 0  # predictions that came too late to open the valve in time
    never: int = 0  # predictions that came too late to open it at all
    out_of_reach: int = 0  # predictions that are NaN or beyond the bar
    _windows: dict[int, list[tuple[float, float]]] = field(default_factory=dict)  # not yet closed
    _closed_s: dict[int, float] = field(default_factory=dict)  # last closing of each valve

    def step(self, now_s: float, predicted: pd.DataFrame) -> pd.DataFrame:
        """Take new predictions at ``now_s``; return the events that closed before.

        Parameters
        ----------
        now_s
            Not before that of the last step; infinity returns all events that are left.
        predicted
            `kilnflight.tables.BELT_PREDICTED`: what became known since the last step.

        Returns
        -------
        DataFrame
            `kilnflight.tables.VALVE_EVENTS`; each event once.
        """
        if not now_s >= self.now_s:
            raise InputError(
                f"ValveSchedule: time {now_s} s after {self.now_s} s; take the steps in order."
            )
        self.now_s = now_s
        closed = [
            (valve, *window)
            for valve, windows in self._windows.items()
            for window in windows
            if window[1] < now_s
        ]
        for valve, _, close_s in closed:
            self._closed_s[valve] = max(close_s, self._closed_s.get(valve, -np.inf))
        self._windows = {
            valve: [window for window in windows if window[1] >= now_s]
            for valve, windows in self._windows.items()
        }
        windows = self.bar.windows(predicted)
        self.out_of_reach += len(predicted) - len(windows[0])
        for valve, open_s, close_s in zip(*(part.tolist() for part in windows), strict=True):
            self._add(valve, open_s, close_s)
        return _table(*np.array(closed, dtype=np.float64).reshape(-1, 3).T)

    def due(self, until_s: float) -> pd.DataFrame:
        """Return the commands from the last step up to ``until_s``.

        Returns
        -------
        DataFrame
            `kilnflight.tables.VALVE_EVENTS`, cut to that time. What is open at ``until_s`` goes on
            with the commands after the next step.
        """
        if not until_s >= self.now_s:
            raise InputError(f"ValveSchedule: due until {until_s} s, before {self.now_s} s.")
        rows = [
            (valve, max(open_s, self.now_s), min(close_s, until_s))
            for valve, windows in self._windows.items()
            for open_s, close_s in windows
            if open_s < until_s
        ]
        return _table(*np.array(rows, dtype=np.float64).reshape(-1, 3).T)

    def _add(self, valve: int, open_s: float, close_s: float) -> None:
        """Plan a window from now on, and merge it with those near it."""
        earliest = max(open_s, self.now_s)
        closed_s = self._closed_s.get(valve, -np.inf)
        if not self.bar.are_apart(closed_s, earliest):
            earliest = closed_s + self.bar.dead_s
        if earliest > close_s:
            self.never += 1
            return
        self.late += earliest > open_s
        near, others = [(earliest, close_s)], list[tuple[float, float]]()
        for window in self._windows.get(valve, []):
            pauses = (window[1], earliest), (close_s, window[0])
            (others if any(self.bar.are_apart(*pause) for pause in pauses) else near).append(window)
        opens, closes = zip(*near, strict=True)
        self._windows[valve] = [*others, (min(opens), max(closes))]


def _table(valve: npt.ArrayLike, opens: Array, closes: Array) -> pd.DataFrame:
    """Return events in the order of opening."""
    number = np.asarray(valve, dtype=np.int64)
    order = np.lexsort((number, opens))
    columns = number[order], opens[order], closes[order]
    return pd.DataFrame(dict(zip(VALVE_EVENTS.names, columns, strict=True)))
