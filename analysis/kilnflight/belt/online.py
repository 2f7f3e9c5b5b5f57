"""Sort particles frame by frame, as a camera gives them.

picture -> spots -> step of the tracker -> tracks that leave the view -> arrivals ->
valves

The parts are those of a whole recording (`MeasureSpots`, `BeltTracker`, `last_states`,
the models, `ValveBar.events`), so the same pictures give the same tracks and events. A
frame's time is its number times the tracker's ``frame_s``. Memory does not grow with
the number of frames.
"""

import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from numbers import Real
from operator import itemgetter
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from kilnflight.arrays import Array, Flags, Named, Picture, Two
from kilnflight.belt.models import Columns, Predictor
from kilnflight.belt.pictures import MeasureSpots
from kilnflight.belt.tracker import LEFT, BeltTracker, state_columns
from kilnflight.belt.valves import ValveBar
from kilnflight.belt.watch import ENOUGH, Watch
from kilnflight.checks import (
    LARGEST_WHOLE,
    InputError,
    check_flags,
    check_number,
    check_shape,
    real_numbers,
)
from kilnflight.tracking.filter import Detected
from kilnflight.tracking.tracker import Tracks

T = TypeVar("T")
Chooses = Callable[[Named], Flags]
Clock = Callable[[], float]  # time in s
PLACE = slice(2)  # columns x, y of spots
PLACE_MM = slice(4, 6)  # columns x, y of what `MeasureSpots` returns
NUMBER = "number of the frame (-1: a time stamp in s that does not follow the last)"
FOLLOWED = 0.05  # share of a stamp's jitter that `Numbered` takes for drift; choice
LONGEST_S = 1.0  # after a longer gap `Numbered` waits for a second stamp; choice
_TRACKER = BeltTracker()


class Command(NamedTuple):
    """A valve, and the times in s of the commands to open and to close it."""

    valve: int
    open_s: float
    close_s: float


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
    _windows: dict[int, list[Two]] = field(default_factory=lambda: defaultdict(list))
    # Last closing of a valve in s.
    _closed_s: dict[int, float] = field(
        default_factory=lambda: defaultdict(lambda: -np.inf)
    )

    def step(self, now_s: float, until_s: float, predicted: Columns) -> list[Command]:
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
        list
            Commands, in the order of opening.
        """
        for valve, windows in self._windows.items():
            closed = [close_s for _, close_s in windows if close_s < now_s]
            self._closed_s[valve] = max([*closed, self._closed_s[valve]])
            self._windows[valve] = [window for window in windows if window[1] >= now_s]
        for valve, *window in zip(*self.bar.windows(predicted), strict=True):
            self._plan(now_s, int(valve), *map(float, window))
        due = [
            Command(valve, max(open_s, now_s), min(close_s, until_s))
            for valve, windows in self._windows.items()
            for open_s, close_s in windows
            if open_s < until_s
        ]
        return sorted(due, key=itemgetter(1, 0))

    def _plan(self, now_s: float, valve: int, open_s: float, close_s: float) -> None:
        """Plan the opening of a valve from ``now_s`` on; merge it with those near it.

        A window that cannot open in time is counted in ``late``, or in ``never`` and
        left out.
        """
        earliest = max(open_s, now_s, self._closed_s[valve] + self.bar.dead_s)
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
    measured: Array  # (m, k), what was measured: x, y, class, or columns of BELT_SPOTS
    tracks: Tracks  # tracks after the frame; "row" is that of ``measured``, -1: missed
    # What `Predictor` returns of the particles to be blown out, known from this frame
    # on; "frame" and "row", where each was seen last; "class", -1 without one.
    predicted: Named
    due: list[Command]  # until the next frame's decision
    took_s: float  # time from the frame to this decision
    late_s: float  # how much later it came than its commands begin


def read_spots(spots: Any, frame: int) -> Array:
    """Return the particles of a frame (m, k): x, y, and a class."""
    where = f"spots of frame {frame}"
    found = real_numbers(spots, where).astype(np.float64)
    if found.size == 0:
        return np.zeros((0, 2))
    if found.ndim != 2 or found.shape[1] not in (2, 3):
        raise InputError(f"{where}: shape {found.shape}. Give x, y and a class.")
    kinds = np.where(np.isnan(found[:, 2:]), -1.0, found[:, 2:])
    if (kinds % 1 != 0).any() or (np.abs(kinds) > LARGEST_WHOLE).any():
        raise InputError(f"{where}: a class is no whole number.")
    found[:, 2:] = kinds
    return found


def sort_spots(
    spots: Iterable[tuple[int, Any]],
    predictor: Predictor,
    schedule: ValveSchedule,
    tracker: BeltTracker = _TRACKER,
    chooses: Chooses | None = None,
    clock: Clock = time.perf_counter,
    measure: Callable[[Any, int], Array] = read_spots,
    place: slice = PLACE,
) -> Iterator[Decision]:
    """Track particles frame by frame, and yield what the valves are to do.

    A decision may take the time of one frame: that of frame k is made when frame k + 1
    comes, and `Decision.due` covers the time from then to frame k + 2. If it takes
    longer, its commands begin when it is made, and so do those of frames that wait. The
    time until the next decision is asked for counts, too.

    Parameters
    ----------
    spots
        Number of a frame and its particles (m, 2), x and y in mm, or (m, 3) with a
        class, a whole number, -1 or NaN: none; by ascending number. `Numbered` counts
        time stamps.
        Frames that are lost count neither as seen nor as missed; a particle that left
        in such a gap is predicted from where it was last seen.
    predictor
        Models of arrivals, calibrated; its valves are beyond the tracker's area.
    schedule
        Bar of valves; it is changed in place.
    tracker
        Tracker of the same belt. Particles outside its area are not used.
    chooses
        Maps the columns of `Decision.predicted` to flags (n,): which to blow out. None:
        all.
    clock
        Returns a time in s, for ``took_s``.
    measure, place
        Returns the particles (m, k) of what comes, by it and its number; columns x, y.

    Yields
    ------
    Decision
        Tracks, predictions and commands of one frame.

    Warns
    -----
    UserWarning
        Once for each of what `Watch` finds. A frame that cannot be used counts as lost.

    Raises
    ------
    InputError
        If the first frame, or `ENOUGH` in a row, cannot be used, if ``chooses`` does
        not return a flag for each particle, if the valves are in view, or the parts do
        not fit one another: width of belt and bar, time between frames.

    Examples
    --------
    A particle moves by 6 mm in a frame of 5 ms:

    >>> from kilnflight.belt.valves import ValveBar
    >>> spots = [(k, np.array([[390.0 + 6 * k, 90.0]])) for k in range(70)]
    >>> schedule = ValveSchedule(ValveBar(open_s=0.002))
    >>> stopped = lambda: 0.0  # of this example; a sorter's clock runs
    >>> sorter = sort_spots(spots, Predictor(), schedule, clock=stopped)
    >>> for decision in sorter:
    ...     for valve, open_s, close_s in decision.due:
    ...         print(f"valve {valve}: {open_s:.4f} to {close_s:.4f} s")
    valve 16: 0.3307 to 0.3327 s
    """
    # `follow` pulls frames, the camera pushes them. Each next(steps) takes the one that
    # waits; None, which never waits, would end it.
    waiting = deque[Detected]()
    steps = tracker.follow(iter(waiting.popleft, None))
    watch = Watch(tracker, predictor, schedule.bar)
    _compile(tracker)
    frame_s = tracker.frame_s
    done_s = 0.0
    last = np.zeros(0, np.void)
    for frame, measured, gap, begun_s in _usable(spots, measure, watch, clock):
        rows = np.arange(len(measured))
        detected = tracker.detections(frame, measured[:, place], rows, gap)
        waiting.append(detected)
        tracks = next(steps).tracks
        last = _last_measured(tracks, last)
        reasons = tracker.reasons(tracks)
        left = tracks["valid"] & (reasons == LEFT)
        predicted = _predict(predictor, last[left], frame_s)
        predicted["class"] = watch.step(
            detected, measured, place, tracks, reasons, predicted
        )
        if chooses is not None:
            predicted = _chosen(predicted, chooses)
        decided_s = clock()
        took_s = decided_s - begun_s
        done_s = max(done_s, frame * frame_s) + took_s
        due_s = (frame + 1) * frame_s
        now_s = max(done_s, due_s)
        yield Decision(
            frame=frame,
            measured=measured,
            tracks=tracks,
            predicted=predicted,
            due=schedule.step(now_s, now_s + frame_s, predicted),
            took_s=took_s,
            late_s=now_s - due_s,
        )
        done_s += clock() - decided_s
        if schedule.never:
            watch.tell(
                "never",
                f"frame {frame}: a window was over before it could open. See late_s, "
                "or the latency of the bar; ValveSchedule.never counts them.",
            )


def _compile(tracker: BeltTracker) -> None:
    """Track a particle in two frames of its own: the first frame would wait for it."""
    area = tracker.appearance.area
    middle = np.array([[area.start_mm + area.end_mm, area.width_mm]]) / 2
    seen = tracker.detections(0, middle, np.arange(1))
    deque(tracker.follow(iter([seen, seen])), 0)


def _chosen(predicted: Named, chooses: Chooses) -> Named:
    """Return the columns of the particles that ``chooses`` takes."""
    kept = np.asarray(chooses(predicted))
    check_shape(kept, predicted["class"].shape, "chooses")
    check_flags("chooses", *kept)
    return {name: each[kept.astype(bool)] for name, each in predicted.items()}


def _usable(
    spots: Iterable[tuple[int, T]],
    measure: Callable[[T, int], Array],
    watch: Watch,
    clock: Clock,
) -> Iterator[tuple[int, Array, int, float]]:
    """Yield number, particles, frames since the one before, and when it came."""
    frame_s = watch.tracker.frame_s
    given_s = getattr(spots, "frame_s", frame_s)
    if given_s != frame_s:
        raise InputError(
            f"spots: frame_s is {given_s}, the tracker's {frame_s}. Give the same to "
            "both."
        )
    previous = -1
    lost = 0
    for frame, content in spots:
        begun_s = clock()
        try:
            check_number(frame, NUMBER, above=previous, whole=True)
            measured = measure(content, frame)
        except InputError as error:
            lost += 1
            if previous < 0 or lost == ENOUGH:
                raise
            watch.tell("unusable", f"{error} It counts as a lost frame.")
            continue
        yield frame, measured, frame - previous, begun_s
        previous = frame
        lost = 0


def sort_pictures(
    pictures: Iterable[tuple[int, Picture]],
    measure: MeasureSpots,
    predictor: Predictor,
    schedule: ValveSchedule,
    tracker: BeltTracker = _TRACKER,
    chooses: Chooses | None = None,
    clock: Clock = time.perf_counter,
) -> Iterator[Decision]:
    """Track particles picture by picture, and yield what the valves are to do.

    All is as for `sort_spots`, but for ``pictures``, (rows, cols) uint8, and
    ``measure``, which returns their spots.

    Examples
    --------
    A spot of 8 by 8 px moves by 6 mm in a frame of 5 ms:

    >>> from kilnflight.belt.camera import Calibration
    >>> from kilnflight.belt.pictures import Spots
    >>> from kilnflight.belt.valves import ValveBar
    >>> film = np.zeros((70, 200, 420), np.uint8)
    >>> for k in range(1, 50):
    ...     film[k, 100:108, 6 * k + 12 : 6 * k + 20] = 200
    >>> mm = np.array([[1.0, 0, 378], [0, 1, -10], [0, 0, 1]])
    >>> measure = MeasureSpots(film[0], Spots(), Calibration(mm, 0.0, 1.0))
    >>> schedule = ValveSchedule(ValveBar(open_s=0.002))
    >>> shown = enumerate(film)
    >>> stopped = lambda: 0.0
    >>> sorter = sort_pictures(shown, measure, Predictor(), schedule, clock=stopped)
    >>> [[valve for valve, *_ in each.due] for each in sorter if each.due]
    [[16]]
    """
    return sort_spots(
        pictures, predictor, schedule, tracker, chooses, clock, measure, PLACE_MM
    )


@dataclass
class Numbered(Generic[T]):
    """Give what has time stamps the number of its frame.

    Stamps may jitter by 0.4 of a frame; gaps are gaps. A clock that runs a
    little faster or slower than ``frame_s`` says is followed. A stamp that is no
    number, or does not grow, has the number -1: that frame counts as lost. So has one
    more than `LONGEST_S` ahead, unless it is as near to the one before.

    Parameters
    ----------
    stamped
        Pairs of a time stamp in s and something else.
    frame_s
        Time in s between two frames.
    start_s
        Time of frame 0 by the clock of the stamps, as it runs at the latest frame. It
        is to be added to the times of commands.
    """

    stamped: Iterable[tuple[Any, T]]
    frame_s: float
    start_s: float = np.nan

    def __iter__(self) -> Iterator[tuple[int, T]]:
        """Yield number and content of each frame."""
        number = -1
        before = np.nan
        for seen, (stamp, content) in enumerate(self.stamped, 1):
            if not isinstance(stamp, Real):
                stamp = np.nan
            if number < 0:
                self.start_s = stamp
            ahead = stamp - self.start_s - number * self.frame_s
            follows = ahead < LONGEST_S or 0 < stamp - before < LONGEST_S
            before = stamp
            if not (ahead > 0 and follows):
                yield -1, content
                continue
            number += max(1, round(ahead / self.frame_s))
            off = stamp - self.start_s - number * self.frame_s
            self.start_s += max(FOLLOWED, 1.0 / seen) * off
            yield number, content


def _predict(predictor: Predictor, left: Tracks, frame_s: float) -> Named:
    """Return what `Decision.predicted` has of tracks (n,), but for their class."""
    states = state_columns(left)
    seen = {"particle": left["particle"], "time_s": left["last"] * frame_s}
    predicted = predictor(states | seen)
    predicted["velocity_x_mm_s"] = states["velocity_x_mm_s"]
    return predicted | {"frame": left["last"], "row": left["row"]}


def _last_measured(tracks: Tracks, before: Tracks) -> Tracks:
    """Return tracks (n,); those missed have the state in which they were last measured.

    ``before`` is what this returned for the frame before.
    """
    last = tracks.copy()
    missed = tracks["row"] < 0
    if missed.any():
        particle = tracks["particle"][missed]
        last[missed] = before[np.searchsorted(before["particle"], particle)]
    return last
