"""A sorter that takes one picture at a time, as its camera does.

picture -> spots -> step of the tracker -> tracks that leave the view -> arrivals -> valves

The parts are those of a whole recording (`measure_spots`, `BeltTracker`, `last_states`, the models,
`ValveBar.events`), so the same pictures give the same tracks and events. A frame's time is its
number times the tracker's ``frame_s``. Nothing grows with the number of frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt.camera import BELT, TRACKED, Area
from kilnflight.belt.models import BELT_VELOCITY_MM_S, ArrivalModel, LateralModel, TableOrColumns
from kilnflight.belt.pictures import MeasureSpots, Picture
from kilnflight.belt.tracker import (
    BELT_FRAME_S,
    LEFT,
    Appearance,
    BeltTracker,
    constant_velocity,
)
from kilnflight.belt.valves import ValveBar, ValveSchedule
from kilnflight.belt.velocity import WatchVelocity
from kilnflight.checks import (
    LARGEST_WHOLE,
    InputError,
    check_between,
    check_count,
    check_positive,
)
from kilnflight.tables import BELT_LAST, BELT_PREDICTED
from kilnflight.tracking.filter import Detected
from kilnflight.tracking.tracker import Step, Tracks

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]
Flags = npt.NDArray[np.bool_]

NONE = BELT_PREDICTED.empty()  # made once: that takes longer than a copy
MOVES, STANDS, EMPTY, UNCLEAR = "moves", "stands", "empty", "unclear"
MOST_COVERED = 0.3  # share of the area; a loaded belt has 0.02, another light 0.5 and more; choice
STANDS_MM_S = 100.0  # slower is at rest: some three errors of a velocity from two places; choice


class Decision(NamedTuple):
    """What a frame has brought."""

    frame: int
    measured: Array  # (m, 6), columns of BELT_SPOTS after the first
    tracks: Tracks  # after the frame; "row" is that of ``measured``, -1: missed
    predicted: pd.DataFrame  # BELT_PREDICTED: particles to be blown out, known from now on
    due: pd.DataFrame  # VALVE_EVENTS to command until the next frame's decision
    events: pd.DataFrame  # VALVE_EVENTS that have ended
    belt: str  # MOVES, STANDS, EMPTY (nothing but what lay there before) or UNCLEAR


def predict_arrivals(
    last: TableOrColumns,
    arrival: ArrivalModel,
    lateral: LateralModel,
    target_mm: float,
    most_s: float = np.inf,
) -> pd.DataFrame:
    """Return `kilnflight.tables.BELT_PREDICTED` of last observations (BELT_LAST).

    Time and place are NaN where a model predicts no arrival, one before the last observation, or
    one more than ``most_s`` after it.
    """
    time, seen = arrival(last, target_mm), np.asarray(last["time_s"])
    time = np.where((time >= seen) & (time - seen <= most_s), time, np.nan)
    y = lateral(last, time - seen)
    columns = np.asarray(last["particle"]), time, y
    return pd.DataFrame(dict(zip(BELT_PREDICTED.names, columns, strict=True)))


@dataclass
class OnlineSorter:
    """One picture in, valve events out.

    The defaults are of the papers' belt; `of_belt` sets another one throughout.

    What frame k shows is taken as known when frame k + 1 is due, so the sorter may take a frame's
    time for it. ``schedule.late`` and ``schedule.never`` count predictions that came too late.

    Notes
    -----
    Frames lost: give the next picture its number. Tracks are predicted over the gap and not taken
    for missed in it; what left the view meanwhile is predicted from where it was last seen.
    `Decision.due` ends with the next frame. So if frames may be lost, command what
    ``schedule.due`` has for a longer time, until the next decision.

    Another light: the background is fixed. A picture that differs from it over 30 % of the area is
    UNCLEAR and counts as one without measurements. Only particles seen before are predicted.

    A belt that stands: `Decision.belt` tells. Particles in view stay tracks, as the background
    is fixed, and open no valve before they leave the view. Those beyond it were predicted for a
    belt that moves: they come later than their air. So let go by what leaves the belt first when
    it starts again. A belt that stops at once leaves tracks with next to no velocity: what would
    take longer than ``most_s`` to arrive is out of reach.

    Python's collector of cycles stops everything for some 60 ms when it looks at all that was
    imported. ``gc.freeze()`` before the first picture takes that out of its sight.
    """

    measure: MeasureSpots
    arrival: ArrivalModel  # calibrated, as the next
    lateral: LateralModel
    bar: ValveBar
    tracker: BeltTracker = field(default_factory=BeltTracker)
    target_mm: float = BELT.end_mm  # where the valves are
    chooses: Callable[[Integers], Flags] | None = None  # which tracks to blow out; None: all
    watch: WatchVelocity | None = None  # of the belt's velocity
    most_s: float = 1.0  # from the last observation to the valves; 10 cm at 100 mm/s; choice
    frame: int = -1  # the last one; -1: none yet

    def __post_init__(self) -> None:
        """Refuse valves in view, parts of two belts and raw models; start without tracks."""
        tracked, seen = self.tracker.appearance.area, self.measure.area
        if not self.target_mm > tracked.end_mm:
            raise InputError(
                f"OnlineSorter: target_mm {self.target_mm} lies in the area where particles are "
                f"tracked, up to {tracked.end_mm} mm. Track less of the belt."
            )
        if not seen.contains(tracked.corners).all() or self.bar.belt_mm != tracked.width_mm:
            raise InputError(
                f"OnlineSorter: parts are of two belts: measured is {seen}, tracked {tracked}, and "
                f"the bar has belt_mm {self.bar.belt_mm}. OnlineSorter.of_belt sets all alike."
            )
        check_positive(self.most_s, "OnlineSorter: most_s")
        predict_arrivals(BELT_LAST.empty(), self.arrival, self.lateral, self.target_mm)
        self.schedule = ValveSchedule(self.bar)
        self._waiting = deque[Detected]()
        self._steps = self.tracker.follow(iter(self._waiting.popleft, None))
        self._last: Tracks | None = None  # of each track that lives, as it was last seen
        self._at_rest = deque[int](maxlen=200)  # tracks at rest in the last frames that moved

    @classmethod
    def of_belt(
        cls,
        belt: Area,
        measure: MeasureSpots,
        arrival: ArrivalModel,
        lateral: LateralModel,
        bar: ValveBar,
        *,
        velocity_mm_s: float = BELT_VELOCITY_MM_S,
        frame_s: float = BELT_FRAME_S,
        untracked_mm: float = BELT.end_mm - TRACKED.end_mm,
        **settings: Any,
    ) -> Self:
        """Return the sorter of a belt with valves at its end.

        Parameters
        ----------
        belt
            Whose corners the calibration of ``measure`` has.
        measure, arrival, lateral, bar, settings
            As of the class; area and width are set here.
        velocity_mm_s, frame_s
            Of the belt itself, and from picture to picture. Entry and filter follow from them.
        untracked_mm
            The belt's last part, where the valves get their time.
        """
        check_positive(velocity_mm_s, "OnlineSorter: velocity_mm_s")
        area = replace(belt, end_mm=belt.end_mm - untracked_mm)
        motion, share = constant_velocity(frame_s), velocity_mm_s / BELT_VELOCITY_MM_S
        along, across = (share * each for each in motion.velocity)
        spreads = motion.spreads[0], share * motion.spreads[1]
        motion = replace(motion, velocity=(along, across), spreads=spreads)
        tracker = BeltTracker(
            motion, Appearance(area, entry_mm=velocity_mm_s * frame_s), frame_s=frame_s
        )
        measure, bar = replace(measure, area=area), replace(bar, belt_mm=belt.width_mm)
        return cls(measure, arrival, lateral, bar, tracker, belt.end_mm, **settings)

    def __call__(self, picture: Picture, frame: int) -> Decision:
        """Return what a frame brings.

        Parameters
        ----------
        picture
            (rows, cols) uint8, as the background.
        frame
            Its number by the camera, above that of the frame before.

        Raises
        ------
        InputError
            If the picture does not fit, or the number is none or not above the last. Nothing has
            changed then.
        """
        check_count(frame, "OnlineSorter: frame", least=0)
        check_between(frame, 0, LARGEST_WHOLE, "OnlineSorter: frame")
        if frame <= self.frame:
            raise InputError(
                f"OnlineSorter: frame {frame} after frame {self.frame}; numbers must ascend. If "
                "the camera has started again, start a new sorter."
            )
        measured, now_s = self.measure(picture, frame), (frame + 1) * self.tracker.frame_s
        is_clear = self.measure.covered(measured) <= MOST_COVERED
        measured = measured if is_clear else measured[:0]
        tracks = self.track(measured[:, 4:], frame).tracks
        predicted = self.predict(tracks)
        events = self.schedule.step(now_s, predicted)
        due = self.schedule.due((frame + 2) * self.tracker.frame_s)  # then now_s, bit for bit
        belt = self.belt(tracks) if is_clear else UNCLEAR
        return Decision(frame, measured, tracks, predicted, due, events, belt)

    def track(self, places: Array, frame: int) -> Step:
        """Return the tracker's step of places (m, 2) in mm."""
        frames = 1 if self.frame < 0 else frame - self.frame
        self._waiting.append(self.tracker.detections(places, frame, frames))
        self.frame = frame
        if self.watch is not None:
            self.watch.add(frame, places)
        return next(self._steps)

    def predict(self, tracks: Tracks) -> pd.DataFrame:
        """Return BELT_PREDICTED of chosen tracks that now enter the prediction phase."""
        last, missed = tracks.copy(), tracks["row"] < 0
        if self._last is not None:
            before = np.searchsorted(self._last["particle"], tracks["particle"][missed])
            last[missed] = self._last[before]
        entering = last[tracks["valid"] & (self.tracker.reasons(tracks) == LEFT)]
        self._last = last[self.tracker.keeps(tracks, self.frame)]
        if self.chooses is not None:
            chosen = np.asarray(self.chooses(entering["particle"]))
            if chosen.dtype != np.bool_ or chosen.shape != entering.shape:
                raise InputError(
                    f"OnlineSorter: chooses returned {chosen.dtype} {chosen.shape} for "
                    f"{len(entering)} tracks; return True or False of each."
                )
            entering = entering[chosen]
        if not len(entering):
            return NONE.copy()
        state = np.zeros((len(entering), 6))
        state[:, : entering["state"].shape[1]] = entering["state"]
        columns = entering["particle"], entering["last"] * self.tracker.frame_s, *state.T
        observed = dict(zip(BELT_LAST.names, columns, strict=True))
        return predict_arrivals(observed, self.arrival, self.lateral, self.target_mm, self.most_s)

    def belt(self, tracks: Tracks) -> str:
        """Return whether the belt moves, by tracks in view.

        It stands if none moves and more are at rest than mostly while the belt moved: dirt, a ghost
        or a particle that sticks to a wall was at rest before.
        """
        seen = tracks[tracks["valid"] & (tracks["row"] >= 0)]
        at_rest = seen["state"][:, 2] < STANDS_MM_S
        if not at_rest.all():
            self._at_rest.append(int(at_rest.sum()))
            return MOVES
        usual = np.median(self._at_rest) if self._at_rest else 0
        return STANDS if len(seen) > usual else EMPTY

    def close(self) -> pd.DataFrame:
        """Return the events that are left when the camera has stopped."""
        return self.schedule.step(np.inf, NONE)
