"""Say what is wrong with a running sorter: each thing once.

A wrong unit or frame interval, swapped axes, a filter that loses particles, and a
calibration that no longer holds all show in what is measured. The limits are choices.
"""

import warnings
from collections import Counter, defaultdict, deque
from dataclasses import dataclass, field

import numpy as np

from kilnflight.arrays import Array, Integers, Named, Two, Words
from kilnflight.belt.models import Predictor
from kilnflight.belt.tracker import LOST, RUNNING, SIDEWAYS, BeltTracker
from kilnflight.belt.valves import ValveBar
from kilnflight.checks import InputError
from kilnflight.tracking.filter import Detected
from kilnflight.tracking.tracker import Tracks

ENOUGH = 100  # tracks that have ended, before their share says something
PLACES = 1000  # measured, before their share says something: some 20 particles
LATEST = 40  # particles whose median says something: as many as calibrate
MOST_LOST = 0.05  # share of lost tracks
INTERVAL = "interval"  # that is wrong, or the unit: nothing else can be judged
DIRT = "dirt"  # tracks that end before they are taken for particles
SLOWEST, FASTEST = 0.5, 1.1  # velocities of particles, in that of the belt
TOLERATED_S = 0.0005  # drift that no valve feels: half of what a particle takes to pass
NEAR_MM = 5.0  # a particle is as near to its prediction, or three deviations more
COMING = ("time_s", "y", "velocity_x_mm_s", "time_sd_s", "y_sd_mm")


@dataclass
class Watch:
    """Counts of a running sorter, and warnings of what they mean.

    Parameters
    ----------
    tracker, predictor, bar
        Those of the sorter.
    """

    tracker: BeltTracker
    predictor: Predictor
    bar: ValveBar
    _told: set[str] = field(default_factory=set)
    _measured: int = 0
    _inside: int = 0
    _beside: int = 0
    # Numbers of the reasons why tracks ended.
    _ends: Counter[str] = field(default_factory=Counter)
    # How often each class was measured, by track.
    _classes: defaultdict[int, Counter[float]] = field(
        default_factory=lambda: defaultdict(Counter)
    )
    # Velocities in mm/s of the latest particles.
    _velocities: deque[float] = field(default_factory=lambda: deque(maxlen=LATEST))
    # How much later in s the latest passed the valves than predicted; its deviation.
    _late: deque[Two] = field(default_factory=lambda: deque(maxlen=LATEST))
    # Those before the valves: columns `COMING` of their predictions.
    _coming: list[tuple[float, ...]] = field(default_factory=list)

    def __post_init__(self) -> None:
        # What this imports takes a quarter of a second; no frame may wait for it.
        self.tracker.motion.process_noise(self.tracker.frame_s)
        area = self.tracker.appearance.area
        if self.bar.belt_mm != area.width_mm:
            raise InputError(
                f"bar: belt_mm: {self.bar.belt_mm}, the tracked area is "
                f"{area.width_mm} mm wide. Give the same to both."
            )
        target_mm = self.predictor.target_mm
        if target_mm <= area.end_mm:
            raise InputError(
                f"target_mm: {target_mm} lies in the area where particles are tracked."
            )

    def tell(self, what: str, text: str) -> None:
        """Warn of something, the first time; of nothing after a wrong interval."""
        if self._told.isdisjoint((what, INTERVAL)):
            self._told.add(what)
            warnings.warn(text, stacklevel=4)

    def step(
        self,
        detected: Detected,
        measured: Array,
        place: slice,
        tracks: Tracks,
        reasons: Words,
        predicted: Named,
    ) -> Integers:
        """Count what a frame shows, and return the classes (k,) of those that left.

        The class is the most frequent one of a track's measurements; -1: none.

        Parameters
        ----------
        detected
            What the tracker got.
        measured, place
            All measurements (m, k), and columns x, y of them; the next is a class.
        tracks, reasons
            Tracks (n,) and why they end, from `BeltTracker.reasons`.
        predicted
            What `Predictor` returns of the k that left, and their ``velocity_x_mm_s``.
        """
        places = measured[:, place]
        self._count_places(detected, places)
        self._count_ends(tracks, reasons)
        self._check_velocity(tracks["state"][tracks["valid"] & (reasons != RUNNING), 2])
        self._check_arrivals(detected.frame * self.tracker.frame_s, places, predicted)
        if measured.shape[1] > place.stop:
            seen = tracks[tracks["row"] >= 0]
            known = measured[seen["row"], place.stop].tolist()
            for particle, kind in zip(seen["particle"].tolist(), known, strict=True):
                self._classes[particle][kind] += 1
        votes = [self._classes[particle] for particle in predicted["particle"].tolist()]
        for particle in tracks["particle"][reasons != RUNNING].tolist():
            self._classes.pop(particle, None)
        most = [max(each, key=each.__getitem__, default=-1) for each in votes]
        return np.array(most, np.int64)

    def _count_places(self, detected: Detected, places: Array) -> None:
        area = self.tracker.appearance.area
        inside = int(area.contains(places).sum())
        used = len(detected.positions)
        self._measured += len(places)
        self._inside += inside
        y = places[:, 1]
        self._beside += int(((y < 0) | (y > area.width_mm)).sum())
        if inside > used or not np.isfinite(places).all():
            told = f"frame {detected.frame}: a particle is there twice, or not finite"
            self.tell("unusable particle", f"{told}. These are always left out.")
        few = MOST_LOST * self._measured
        if self._measured >= PLACES and (self._inside < few or self._beside > few):
            low = places.min(axis=0, initial=np.inf)
            high = places.max(axis=0, initial=-np.inf)
            self.tell(
                "outside",
                f"of {self._measured} places {self._inside} lie in the tracked "
                f"{area}, {self._beside} beside it; x is {low[0]:g} to {high[0]:g}, y "
                f"{low[1]:g} to {high[1]:g}: no mm, y not from 0, or x and y swapped?",
            )

    def _count_ends(self, tracks: Tracks, reasons: Words) -> None:
        ended = reasons != RUNNING
        kinds = np.where(tracks["valid"], reasons, DIRT)[ended]
        self._ends.update(kinds.tolist())
        dirt = self._ends[DIRT]
        valid = self._ends.total() - dirt
        lost = self._ends[LOST] + self._ends[SIDEWAYS]
        if dirt + valid >= ENOUGH and dirt > valid:
            self.tell(
                INTERVAL,
                f"{dirt} of {dirt + valid} tracks end before they are taken for "
                "particles: is the frame interval wrong, the unit, or the belt's "
                "velocity?",
            )
        if valid >= ENOUGH and lost > MOST_LOST * valid:
            self.tell(
                "lost",
                f"{lost} of {valid} particles are lost or leave sideways: give the "
                "places more spread, or the motion more noise of acceleration.",
            )

    def _check_velocity(self, velocities: Array) -> None:
        self._velocities.extend(velocities)
        if len(self._velocities) < LATEST:
            return
        belt = 2.0 * self.tracker.motion.velocity[0]  # new tracks have half of it
        velocity = np.median(self._velocities)
        if not SLOWEST * belt < velocity < FASTEST * belt:
            self.tell(
                INTERVAL,
                f"particles move at {velocity:.0f} mm/s, the belt at {belt:.0f}: is "
                "the frame interval wrong, or the unit?",
            )

    def _check_arrivals(self, now_s: float, places: Array, predicted: Named) -> None:
        """Compare particles with their predictions in the last frame before the valves.

        A camera that does not see so far shows none of them.
        """
        new = zip(*(predicted[name].tolist() for name in COMING), strict=True)
        coming = [*self._coming, *new]
        until_s = now_s + self.tracker.frame_s
        self._coming = [each for each in coming if each[0] >= until_s]
        for time_s, y, velocity, late_sd, y_sd in coming:
            if time_s >= until_s:
                continue
            if np.isnan(time_s):  # the models predict no arrival
                self._late.append((np.inf, 0.0))
                continue
            x = self.predictor.target_mm - velocity * (time_s - now_s)
            apart = places - (x, y)
            reach = 3.0 * np.array([velocity * late_sd, y_sd]) + NEAR_MM
            near = apart[(np.abs(apart) < reach).all(axis=1), 0]
            if len(near) == 1:
                self._late.append((-near[0] / velocity, late_sd))
            elif not len(near) and (apart[:, 0] > 0).any():  # the camera sees so far
                self._late.append((reach[0] / velocity, late_sd))
        if len(self._late) < LATEST:
            return
        late_s, spread_s = np.median(self._late, axis=0)
        if abs(late_s) > max(spread_s, TOLERATED_S):
            self.tell(
                "calibration",
                f"particles pass the valves {1000 * late_s:+.1f} ms later than "
                "predicted, or none does near its place: calibrate again.",
            )
