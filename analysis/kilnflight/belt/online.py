"""A sorter that takes one picture at a time, as its camera does.

picture -> spots -> step of the tracker -> tracks that leave the view -> arrivals ->
valves

The parts are those of a whole recording (`MeasureSpots`, `BeltTracker`, `last_states`,
the models, `ValveBar.events`), so the same pictures give the same tracks and events. A
frame's time is its number times the tracker's ``frame_s``. Memory does not grow with
the number of frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd

from kilnflight.arrays import Array, Flags, Integers, Picture
from kilnflight.belt.camera import BELT
from kilnflight.belt.models import ArrivalModel, Columns, LateralModel
from kilnflight.belt.pictures import MeasureSpots
from kilnflight.belt.tracker import LEFT, BeltTracker
from kilnflight.belt.valves import ValveBar
from kilnflight.checks import InputError, check_number
from kilnflight.tables import BELT_LAST, BELT_PREDICTED, VALVE_EVENTS
from kilnflight.tracking.filter import Detected
from kilnflight.tracking.tracker import Tracks

MOST_S = 1.0  # from the last observation to the valves; 10 cm at 100 mm/s; choice
_TRACKER = BeltTracker()


def predict_arrivals(
    last: Columns,
    arrival: ArrivalModel,
    lateral: LateralModel,
    target_mm: float,
    most_s: float = np.inf,
) -> pd.DataFrame:
    """Return `kilnflight.tables.BELT_PREDICTED` of last observations (BELT_LAST).

    The time is NaN where a model predicts no arrival, one before the last observation,
    or one more than ``most_s`` after it. So is the place, except that of `Straight`.
    ``target_mm`` is the place x of the valves.
    """
    time = arrival(last, target_mm)
    seen = np.asarray(last["time_s"])
    time = np.where((time >= seen) & (time - seen <= most_s), time, np.nan)
    y = lateral(last, time - seen)
    columns = np.asarray(last["particle"]), time, y
    return pd.DataFrame(dict(zip(BELT_PREDICTED.names, columns, strict=True)))


@dataclass
class ValveSchedule:
    """Commands of a bar of valves while predictions become known, as in a sorter.

    If every prediction is known at least ``dead_s`` before its valve is to open, the
    commands are the windows of `ValveBar.events`. A later one opens the valve late: at
    once, or after its dead time. After its window it never opens. Both are counted.
    """

    bar: ValveBar
    late: int = 0  # predictions that came too late to open the valve in time
    never: int = 0  # predictions that came too late to open it at all
    _windows: dict[int, list[tuple[float, float]]] = field(
        default_factory=dict
    )  # not yet closed
    _closed_s: dict[int, float] = field(
        default_factory=dict
    )  # last closing of each valve

    def step(
        self, now_s: float, until_s: float, predicted: pd.DataFrame
    ) -> pd.DataFrame:
        """Return the commands from ``now_s`` to ``until_s``, new predictions included.

        Parameters
        ----------
        now_s, until_s
            Times in s, not before those of the last step. A window that goes on is cut
            at ``until_s``, and continues in the next step.
        predicted
            `kilnflight.tables.BELT_PREDICTED`, known since the last step.

        Returns
        -------
        DataFrame
            `kilnflight.tables.VALVE_EVENTS`, in the order of opening.
        """
        for valve, windows in self._windows.items():
            ended = [close_s for _, close_s in windows if close_s < now_s]
            self._closed_s[valve] = max([*ended, self._closed_s.get(valve, -np.inf)])
            self._windows[valve] = [window for window in windows if window[1] >= now_s]
        for event in zip(
            *(part.tolist() for part in self.bar.windows(predicted)), strict=True
        ):
            self._add(now_s, *event)
        due = sorted(
            (max(open_s, now_s), valve, min(close_s, until_s))
            for valve, windows in self._windows.items()
            for open_s, close_s in windows
            if open_s < until_s
        )
        opens, valves, closes = np.array(due, dtype=np.float64).reshape(-1, 3).T
        columns = valves.astype(np.int64), opens, closes
        return pd.DataFrame(dict(zip(VALVE_EVENTS.names, columns, strict=True)))

    def _add(self, now_s: float, valve: int, open_s: float, close_s: float) -> None:
        """Plan the opening of a valve from ``now_s`` on; merge it with those near it.

        A window that cannot open in time is counted in ``late``, or in ``never`` and
        left out.
        """
        earliest = max(open_s, now_s)
        closed_s = self._closed_s.get(valve, -np.inf)
        if not self.bar.are_apart(closed_s, earliest):
            earliest = closed_s + self.bar.dead_s
        if earliest > close_s:
            self.never += 1
            return
        self.late += earliest > open_s
        near = [(earliest, close_s)]
        others = list[tuple[float, float]]()
        for window in self._windows.get(valve, []):
            pauses = (window[1], earliest), (close_s, window[0])
            (
                others if any(self.bar.are_apart(*pause) for pause in pauses) else near
            ).append(window)
        opens, closes = zip(*near, strict=True)
        self._windows[valve] = [*others, (min(opens), max(closes))]


class Decision(NamedTuple):
    """Result of a frame: its measurements, the tracks, and what the valves are to do."""

    frame: int
    measured: Array  # (m, 6), columns of BELT_SPOTS after the first (frame)
    tracks: Tracks  # after the frame; "row" is that of ``measured``, -1: missed
    predicted: (
        pd.DataFrame
    )  # BELT_PREDICTED: particles to be blown out, known from now on
    due: pd.DataFrame  # VALVE_EVENTS to command until the next frame's decision


def sort_pictures(
    pictures: Iterable[tuple[int, Picture]],
    measure: MeasureSpots,
    models: tuple[ArrivalModel, LateralModel],
    schedule: ValveSchedule,
    tracker: BeltTracker = _TRACKER,
    target_mm: float = BELT.end_mm,
    chooses: Callable[[Integers], Flags] | None = None,
) -> Iterator[Decision]:
    """Yield the decision of each picture as it comes.

    Frame k is taken as known when frame k + 1 is due, so a decision may take a frame's
    time. `Decision.due` ends with the next frame.

    Parameters
    ----------
    pictures
        Number by the camera and picture (rows, cols) uint8 of each frame. Numbers
        ascend. Over a gap tracks are predicted and not taken for missed; a particle
        that left in it is predicted from where it was last seen.
    measure
        Spots of a picture in mm.
    models
        Arrival and lateral model, calibrated.
    schedule
        Bar of valves; it is changed in place.
    tracker
        Tracker of the same belt.
    target_mm
        Where the valves are, beyond the tracker's area.
    chooses
        Maps numbers of tracks (n,) to flags (n,): which to blow out. None: all.

    Raises
    ------
    InputError
        If a picture does not fit, numbers do not ascend, or the target is in view.
    """
    if target_mm <= tracker.appearance.area.end_mm:
        raise InputError(
            f"target_mm: {target_mm} lies in the area where particles are tracked."
        )
    waiting = deque[Detected]()
    number = -1
    known: Tracks = np.zeros(0, [("particle", np.int64)])
    steps = tracker.follow(iter(waiting.popleft, None))
    for frame, picture in pictures:
        check_number(frame, "pictures: number of the frame", above=number, whole=True)
        measured = measure(picture, frame)
        rows = np.arange(len(measured))
        span = frame - number if number >= 0 else 1
        waiting.append(tracker.detections(frame, measured[:, 4:], rows, span))
        tracks = next(steps).tracks
        number = frame
        last = tracks.copy()
        missed = tracks["row"] < 0
        if missed.any():  # their state as they were last seen
            last[missed] = known[
                np.searchsorted(known["particle"], tracks["particle"][missed])
            ]
        known = last[tracker.keeps(tracks, frame)]
        entering = last[tracks["valid"] & (tracker.reasons(tracks) == LEFT)]
        if chooses is not None:
            entering = entering[chooses(entering["particle"])]
        predicted = _predict(entering, models, target_mm, tracker.frame_s)
        now_s = (frame + 1) * tracker.frame_s
        until_s = (frame + 2) * tracker.frame_s
        due = schedule.step(now_s, until_s, predicted)
        yield Decision(frame, measured, tracks, predicted, due)


def _predict(
    entering: Tracks,
    models: tuple[ArrivalModel, LateralModel],
    target_mm: float,
    frame_s: float,
) -> pd.DataFrame:
    """Return BELT_PREDICTED of n tracks as they were last measured."""
    state = np.zeros((len(entering), 6))
    state[:, : entering["state"].shape[1]] = entering["state"]
    columns = entering["particle"], entering["last"] * frame_s, *state.T
    last = dict(zip(BELT_LAST.names, columns, strict=True))
    return predict_arrivals(last, *models, target_mm, MOST_S)
