"""Sort particles picture by picture, as a camera gives them.

picture -> spots -> step of the tracker -> tracks that leave the view -> arrivals ->
valves

The parts are those of a whole recording (`MeasureSpots`, `BeltTracker`, `last_states`,
the models, `ValveBar.events`), so the same pictures give the same tracks and events. A
frame's time is its number times the tracker's ``frame_s``. Memory does not grow with
the number of frames.
"""

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd

from kilnflight.arrays import Array, Flags, Integers, Picture
from kilnflight.belt.camera import BELT
from kilnflight.belt.models import ArrivalModel, Columns, LateralModel
from kilnflight.belt.pictures import MeasureSpots
from kilnflight.belt.tracker import LEFT, BeltTracker, with_acceleration
from kilnflight.belt.valves import ValveBar
from kilnflight.checks import InputError, check_number
from kilnflight.tables import BELT_LAST, VALVE_EVENTS
from kilnflight.tracking.filter import Detected
from kilnflight.tracking.tracker import Tracks

PLACE_MM = slice(4, 6)  # columns x, y of what `MeasureSpots` returns
MOST_S = 1.0  # longest prediction: 10 cm at 100 mm/s; choice
_TRACKER = BeltTracker()


def predict_arrivals(
    last: Columns,
    arrival: ArrivalModel,
    lateral: LateralModel,
    target_mm: float,
    most_s: float = np.inf,
) -> pd.DataFrame:
    """Predict when and where particles pass the valves.

    Parameters
    ----------
    last
        Columns of `kilnflight.tables.BELT_LAST`.
    arrival, lateral
        Models, calibrated.
    target_mm
        Place x of the valves.
    most_s
        Longest time in s from the last observation to the arrival.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_PREDICTED`. The time is NaN where a model predicts no
        arrival, one before the last observation, or one after ``most_s``. So is the
        place, except that of `Straight`.
    """
    check_number(most_s, "most_s", least=0, infinite=True)
    time = arrival(last, target_mm)
    seen = np.asarray(last["time_s"])
    time = np.where((time >= seen) & (time - seen <= most_s), time, np.nan)
    return pd.DataFrame(
        {
            "particle": np.asarray(last["particle"]),
            "time_s": time,
            "y": lateral(last, time - seen),
        }
    )


@dataclass
class ValveSchedule:
    """Commands of a bar of valves while predictions become known, as in a sorter.

    If every prediction is known at least ``dead_s`` before its valve is to open, the
    commands are the windows of `ValveBar.events`. A later one opens the valve late: at
    once, or after its dead time. After its window it never opens. Both are counted.

    Parameters
    ----------
    bar
        Valves and their times.
    late, never
        Number of predictions that came too late to open the valve in time, and of those
        that came too late to open it at all.
    """

    bar: ValveBar
    late: int = 0
    never: int = 0
    # Opening and closing in s of the windows of a valve that have not closed.
    _windows: dict[int, list[tuple[float, float]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    # Last closing of a valve in s.
    _closed_s: dict[int, float] = field(
        default_factory=lambda: defaultdict(lambda: -np.inf)
    )

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
            closed = [close_s for _, close_s in windows if close_s < now_s]
            self._closed_s[valve] = max([*closed, self._closed_s[valve]])
            self._windows[valve] = [window for window in windows if window[1] >= now_s]
        for valve, *window in zip(*self.bar.windows(predicted), strict=True):
            self._plan(now_s, int(valve), *map(float, window))
        due = sorted(
            (max(open_s, now_s), valve, min(close_s, until_s))
            for valve, windows in self._windows.items()
            for open_s, close_s in windows
            if open_s < until_s
        )
        events = pd.DataFrame(due, columns=["open_s", "valve", "close_s"])
        return events[VALVE_EVENTS.names].astype(VALVE_EVENTS.dtypes)

    def _plan(self, now_s: float, valve: int, open_s: float, close_s: float) -> None:
        """Plan the opening of a valve from ``now_s`` on; merge it with those near it.

        A window that cannot open in time is counted in ``late``, or in ``never`` and
        left out.
        """
        earliest = max(open_s, now_s)
        closed_s = self._closed_s[valve]
        if not self.bar.are_apart(closed_s, earliest):
            earliest = closed_s + self.bar.dead_s
        if earliest > close_s:
            self.never += 1
            return
        self.late += earliest > open_s
        others = []
        for window in self._windows[valve]:
            before = self.bar.are_apart(window[1], earliest)
            if before or self.bar.are_apart(close_s, window[0]):
                others.append(window)
            else:  # windows lie apart, so merging does not reach another one
                earliest = min(earliest, window[0])
                close_s = max(close_s, window[1])
        self._windows[valve] = [*others, (earliest, close_s)]


class Decision(NamedTuple):
    """Measurements, tracks and commands of a frame."""

    frame: int
    measured: Array  # (m, 6), columns of BELT_SPOTS after the first (frame)
    tracks: Tracks  # tracks after the frame; "row" is that of ``measured``, -1: missed
    # BELT_PREDICTED of the particles to be blown out, known from this frame on.
    predicted: pd.DataFrame
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
    """Track particles picture by picture, and yield what the valves are to do.

    A decision may take the time of one frame: that of frame k is made when frame k + 1
    comes, and `Decision.due` covers the time from then to frame k + 2.

    Parameters
    ----------
    pictures
        Frame number and picture (rows, cols) uint8, by ascending number. Frames that
        are lost count neither as seen nor as missed; a particle that left in such a gap
        is predicted from where it was last seen.
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

    Yields
    ------
    Decision
        Spots, tracks, predictions and commands of one frame.

    Raises
    ------
    InputError
        If a picture does not fit, numbers do not ascend, or the target is in view.

    Examples
    --------
    A spot of 8 by 8 px moves by 6 mm in a frame of 5 ms:

    >>> from kilnflight.belt.camera import Calibration
    >>> from kilnflight.belt.models import CV, LateralCV
    >>> from kilnflight.belt.pictures import Spots
    >>> film = np.zeros((70, 200, 420), np.uint8)
    >>> for k in range(1, 50):
    ...     film[k, 100:108, 6 * k + 12 : 6 * k + 20] = 200
    >>> mm = np.array([[1.0, 0, 378], [0, 1, -10], [0, 0, 1]])
    >>> measure = MeasureSpots(film[0], Spots(), Calibration(mm, 0.0, 1.0))
    >>> schedule = ValveSchedule(ValveBar(open_s=0.002))
    >>> sorter = sort_pictures(enumerate(film), measure, (CV(), LateralCV()), schedule)
    >>> pd.concat([decision.due for decision in sorter]).round(3)
       valve  open_s  close_s
    0     16   0.328     0.33
    """
    if target_mm <= tracker.appearance.area.end_mm:
        raise InputError(
            f"target_mm: {target_mm} lies in the area where particles are tracked."
        )
    # `follow` pulls frames, the camera pushes them. Each next(steps) takes the one that
    # waits; None, which never waits, would end it.
    waiting = deque[Detected]()
    steps = tracker.follow(iter(waiting.popleft, None))
    previous = -1
    last: Tracks = np.zeros(0, [("particle", np.int64)])
    for frame, picture in pictures:
        check_number(frame, "pictures: number of the frame", above=previous, whole=True)
        measured = measure(picture, frame)
        rows = np.arange(len(measured))
        waiting.append(
            tracker.detections(frame, measured[:, PLACE_MM], rows, frame - previous)
        )
        previous = frame
        tracks = next(steps).tracks
        # Those missed keep the state in which they were last measured.
        before = last
        last = tracks.copy()
        missed = tracks["row"] < 0
        if missed.any():
            particle = tracks["particle"][missed]
            last[missed] = before[np.searchsorted(before["particle"], particle)]
        left = last[tracks["valid"] & (tracker.reasons(tracks) == LEFT)]
        if chooses is not None:
            left = left[chooses(left["particle"])]
        seen_s = left["last"] * tracker.frame_s
        columns = left["particle"], seen_s, *with_acceleration(left).T
        states = dict(zip(BELT_LAST.names, columns, strict=True))
        predicted = predict_arrivals(states, *models, target_mm, MOST_S)
        now_s = (frame + 1) * tracker.frame_s
        until_s = (frame + 2) * tracker.frame_s
        yield Decision(
            frame=frame,
            measured=measured,
            tracks=tracks,
            predicted=predicted,
            due=schedule.step(now_s, until_s, predicted),
        )
