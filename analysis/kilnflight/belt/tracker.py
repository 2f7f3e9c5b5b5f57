"""Multitarget tracking on the belt (2016 paper, section II.B).

predict, gate, associate with extra rows and columns, update, score, start, stop

Loop, filter, gate and assignment are those of the kiln's tracker. The belt brings its costs, the
likelihoods that tracks begin and end, and the score that separates particles from dirt. Lengths are
in mm, times in s. All likelihoods are taken as -ln, so the likeliest association is the cheapest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.special import ndtr

from kilnflight.association import Pairs, assign, one_hot
from kilnflight.belt.camera import TRACKED, Area
from kilnflight.checks import (
    InputError,
    check_between,
    check_columns,
    check_count,
    check_offers,
    check_positive,
    check_shape,
    check_whole,
)
from kilnflight.tables import BELT_ENDS, BELT_STATES, Column, Table
from kilnflight.tracking.filter import ConstantVelocity, Detected, Gate, Motion
from kilnflight.tracking.tracker import ExtraColumns, Step, Tracks, follow

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]

Frames = int | Sequence[int] | Integers | None  # number of frames, or their numbers

BELT_FRAME_S = 0.005  # 200 frames/s, section IV.B
LEAST_PROBABILITY = 1e-12  # of those whose logarithm is taken
MEASURED = Table(
    "measurements on the belt",
    Column("frame", int, "1", "frame of the camera"),
    Column("x", float, "mm", "along the belt"),
    Column("y", float, "mm", "across the belt"),
)
LEFT, BACK, SIDEWAYS = "left at the end", "left at the start", "left sideways"
LOST, RUNNING = "lost", "recording ends"
REASONS = (LEFT, BACK, SIDEWAYS, LOST, RUNNING)
SCORES = (
    ("score", np.float64),
    ("best", np.float64),  # highest score so far
    ("valid", np.bool_),  # whether it has ever reached the upper threshold
    ("outside", np.float64),  # probability that the prediction lies outside the area
)


def constant_velocity(
    frame_s: float = BELT_FRAME_S, spread_mm: float = 0.127, acceleration_mm_s2: float = 2000.0
) -> Motion:
    """Return the filter of section II.B for a belt of 1500 mm/s.

    Parameters
    ----------
    frame_s
        Time between two frames in s.
    spread_mm
        Standard deviation of a measurement. The default is a choice: that of rounding to whole
        pixels of 0.44 mm, 0.44 / sqrt(12). See the notes.
    acceleration_mm_s2
        By which the velocity may change from frame to frame; the default is 0.2 g, a belt's
        drag.

    Notes
    -----
    No number is printed. A particle comes with anything from 0 to the belt's 1500 mm/s: mean
    750, standard deviation 433. The noise changes its velocity by ``acceleration_mm_s2`` times
    ``frame_s`` in a frame.

    ``spread_mm`` was set before places were compared with the truth, and is not fitted to it.
    Centroids are not rounded to pixels and scatter less. But parallax shifts the place of a sphere
    by up to 0.5 mm at the start of the belt, and changes slowly from there on. So errors of
    successive frames are not independent, as the filter assumes.
    """
    check_positive(frame_s, "constant_velocity: frame_s")
    noise = acceleration_mm_s2 * np.sqrt(frame_s)
    return ConstantVelocity((750.0, 0.0), 433.0, float(noise), spread_mm)


@dataclass(frozen=True)
class Appearance:
    """Likelihoods by place on the belt that a track begins or is no longer observed.

    Notes
    -----
    Fig. 2 shows both curves without a scale. By its text, particles appear mostly at the
    beginning of the observed region, and likely disappear behind its end. Here both follow from
    counting. A new particle lies within the distance that the belt moves in a frame. A track is
    missed with the probability that its prediction lies outside. Beyond the sides is outside,
    too.
    """

    area: Area = TRACKED
    arrivals: float = 1.0  # per frame; the order of 4000 particles in 15 s at 200 frames/s
    entry_mm: float = 7.5  # in which they are first seen: 1500 mm/s for 5 ms
    entry_blur_mm: float = 2.5  # softness of its end: radius of a sphere
    clutter: float = 0.1  # per frame, anywhere: dirt, or particles found again; assumption
    missed: float = 0.1  # share of particles in view without a spot of their own; assumption

    def __post_init__(self) -> None:
        """Refuse numbers and lengths that are not positive, and shares outside 0 to 1."""
        for name in ("arrivals", "entry_mm", "entry_blur_mm", "clutter"):
            check_positive(getattr(self, name), f"Appearance: {name}")
        check_between(self.missed, LEAST_PROBABILITY, 1 - LEAST_PROBABILITY, "Appearance: missed")

    @property
    def clutter_density(self) -> float:
        """Expected number of measurements per frame and mm^2 that are of no new particle."""
        return self.clutter / self.area.square_mm

    def new(self, places: Array) -> Array:
        """Return the expected number of new tracks per mm^2 at places (m, 2) in mm."""
        check_shape(places, (None, 2), "places")
        density = self.arrivals / (self.entry_mm * self.area.width_mm)
        end = self.area.start_mm + self.entry_mm
        entry_share: Array = ndtr((end - places[:, 0]) / self.entry_blur_mm)
        return self.clutter_density + density * entry_share

    def unobserved_likelihood(self, places: Array, residual: Array) -> tuple[Array, Array]:
        """Return the probability that tracks are not observed, and that they are outside.

        Parameters
        ----------
        places
            Predicted, (n, 2) in mm.
        residual
            S (n, 2, 2) in mm^2, covariance of a measurement. Its ellipse is taken along the axes.
        """
        check_shape(places, (None, 2), "places")
        check_shape(residual, (len(places), 2, 2), "residual")
        spread = np.sqrt(np.diagonal(residual, axis1=1, axis2=2))
        corners = self.area.corners[[0, 2]]
        below, above = (ndtr((corner - places) / spread) for corner in corners)
        inside: Array = (above - below).prod(axis=1)
        return np.maximum(LEAST_PROBABILITY, 1.0 - (1.0 - self.missed) * inside), 1.0 - inside


_MOTION, _APPEARANCE, _GATE = constant_velocity(), Appearance(), Gate()


class Likelihoods(NamedTuple):
    """Likelihoods that the association of a frame is made of (Fig. 3)."""

    costs: Array  # (n, m), -ln of (1 - missed) N(z; prediction, S); inf outside the gate
    unobserved: Array  # (n,), likelihood that a track is not observed
    new: Array  # (m,), that a measurement starts a track, per mm^2 as are the pairs
    outside: Array  # (n,), probability that the prediction lies outside the area

    def detection(self) -> Integers:
        """Return the measurement (n,) of each track in the likeliest association.

        -1 means none.

        Notes
        -----
        Each measurement has an extra row of its own, each track an extra column. So every
        measurement costs its ``new`` unless it goes to a track. Taking ``new`` off the pairs
        gives the same optimum from the (n, m) part alone.
        """
        return assign(self.costs + np.log(self.new), -np.log(self.unobserved))


def pair_costs(pairs: Pairs, missed: float) -> Array:
    """Return -ln of (1 - missed) N(z; prediction, S), (n, m); inf outside the gate."""
    logs = pairs.log_determinant + pairs.expected.shape[1] * np.log(2.0 * np.pi)
    costs = 0.5 * logs[:, None] - np.log(1.0 - missed) + 0.5 * pairs.distance_squared
    return np.asarray(costs, dtype=np.float64)


class Followed(NamedTuple):
    """What became of a recording."""

    states: pd.DataFrame  # kilnflight.tables.BELT_STATES
    ends: pd.DataFrame  # kilnflight.tables.BELT_ENDS, and reason: one of REASONS


@dataclass(frozen=True)
class BeltTracker:
    """Global nearest neighbour with track scores.

    It has likelihoods of appearing and leaving.

    A track's score is the log likelihood ratio of a particle against dirt (Blackman and Popoli,
    ch. 6). It starts with that of a new particle at this place. Each measurement adds
    ln((1 - missed) N / clutter), each miss ln(unobserved). The track is valid from ln((1 - b) / a)
    on. It is lost when the score falls below its best by more than ln((1 - a) / b).

    Notes
    -----
    The paper names the score and its purpose, no thresholds. A missed track that is outside
    with a probability above one half has left; that is no loss.
    """

    motion: Motion = _MOTION
    appearance: Appearance = _APPEARANCE
    gate: Gate = _GATE  # "beyond a certain Mahalanobis distance": 4, as in the kiln
    frame_s: float = BELT_FRAME_S
    false_valid: float = 1e-4  # a: share of dirt tracks that become valid; assumption
    false_lost: float = 1e-6  # b: share of particles given up; six misses in a row; assumption

    def __post_init__(self) -> None:
        """Refuse parts that cannot be used."""
        check_offers(self.appearance, ("new", "unobserved_likelihood"), "BeltTracker: appearance")
        check_positive(self.frame_s, "BeltTracker: frame_s")
        check_between(self.false_valid, 1e-12, 0.5, "BeltTracker: false_valid")
        check_between(self.false_lost, 1e-12, 0.5, "BeltTracker: false_lost")

    def __call__(self, measured: pd.DataFrame, frames: Frames = None) -> Followed:
        """Return the states of all tracks in all frames, and how each ended.

        Parameters
        ----------
        measured
            Columns frame, x, y (mm), as `kilnflight.tables.BELT_SPOTS`; those outside the area are
            ignored.
        frames
            Number of frames of the camera, so that tracks may end after the last measurement; None:
            up to that one. Or the numbers of the frames that there are, if others were lost: tracks
            are predicted over a gap, and nothing is taken for missed in it.

        Raises
        ------
        InputError
            If a column is missing or not numeric, or ``frames`` is no whole number from 0, or no
            ascending numbers with those of all measurements. Also if one frame has two measurements
            at the same place: they would be two tracks of one particle.
        """
        numbers, parts = [], []
        for step in self.steps(measured, frames):
            numbers.append(np.full(len(step.tracks), step.detected.frame))
            parts.append(step.tracks)
        if not parts:
            return Followed(BELT_STATES.empty(), BELT_ENDS.empty().assign(reason=""))
        frame, tracks = np.concatenate(numbers), np.concatenate(parts)
        return Followed(_states(frame, tracks), self._ends(frame, tracks))

    def steps(self, measured: pd.DataFrame, frames: Frames = None) -> Iterator[Step]:
        """Yield the step of each frame from the first measurement on.

        Arguments are as for a call.
        """
        frame, rows, places = self._read(measured)
        numbers = _taken(frames, frame)
        if not len(frame):
            return
        numbers = numbers[numbers >= frame[0]]
        edges = np.searchsorted(frame, numbers[1:])
        spans = self.frame_s * np.diff(numbers, prepend=numbers[0] - 1)
        parts = np.split(rows, edges), np.split(places, edges)
        yield from self.follow(
            Detected(place, frame=number, span=span, rows=row)
            for number, span, row, place in zip(
                numbers.tolist(), spans.tolist(), *parts, strict=True
            )
        )

    def follow(self, frames: Iterable[Detected]) -> Iterator[Step]:
        """Yield the step of each frame as it comes; spans are in s."""
        return follow(frames, self.motion, self.gate, self.associate, self.keeps, SCORES)

    def detections(self, places: Array, number: int, frames: int = 1) -> Detected:
        """Return what `follow` takes of one frame.

        Parameters
        ----------
        places
            (m, 2) in mm; those outside the area are ignored.
        number
            Of the frame.
        frames
            Since the frame before: above 1 if others were lost.
        """
        rows = np.flatnonzero(self.appearance.area.contains(places))
        rows = rows[np.lexsort((places[rows, 1], places[rows, 0]))]
        inside = np.ascontiguousarray(places[rows])
        _check_unique(np.full(len(rows), number), inside, rows)
        return Detected(inside, frame=number, span=self.frame_s * frames, rows=rows)

    @property
    def thresholds(self) -> tuple[float, float]:
        """The score from which a track is valid, and the fall by which it is lost."""
        a, b = self.false_valid, self.false_lost
        return float(np.log((1 - b) / a)), float(np.log((1 - a) / b))

    def likelihoods(self, detected: Detected, pairs: Pairs) -> Likelihoods:
        """Return the likelihoods that the association of a frame is made of."""
        unobserved, outside = self.appearance.unobserved_likelihood(pairs.expected, pairs.residual)
        costs = pair_costs(pairs, self.appearance.missed)
        return Likelihoods(costs, unobserved, self.appearance.new(detected.positions), outside)

    def associate(
        self, tracks: Tracks, detected: Detected, pairs: Pairs
    ) -> tuple[Array, ExtraColumns, ExtraColumns]:
        """Return weights of 0 and 1, and the scores, `SCORES`, of tracks and of new ones."""
        likelihoods = self.likelihoods(detected, pairs)
        clutter = np.log(self.appearance.clutter_density)
        detection = likelihoods.detection()
        gain, detected_tracks = np.log(likelihoods.unobserved), np.flatnonzero(detection >= 0)
        pair_cost = likelihoods.costs[detected_tracks, detection[detected_tracks]]
        gain[detected_tracks] = -(pair_cost + clutter)
        scores = self._scores(tracks["score"] + gain, tracks["best"], likelihoods.outside)
        first = np.log(likelihoods.new) - clutter
        return (
            one_hot(detection, len(first)),
            scores,
            self._scores(first, first, np.zeros(len(first))),
        )

    def _scores(self, score: Array, best: Array, outside: Array) -> ExtraColumns:
        """Return `SCORES` of tracks."""
        best = np.maximum(best, score)
        valid = best >= self.thresholds[0]
        return {"score": score, "best": best, "valid": valid, "outside": outside}

    def keeps(self, tracks: Tracks, frame: int) -> npt.NDArray[np.bool_]:
        """Return which tracks live on: those seen, and those neither outside nor lost."""
        lost = tracks["best"] - tracks["score"] > self.thresholds[1]
        return (tracks["row"] >= 0) | ~((tracks["outside"] > 0.5) | lost)

    def _read(self, measured: pd.DataFrame) -> tuple[Integers, Integers, Array]:
        """Return frames, rows and places of the measurements inside, by frame and place."""
        check_columns(measured, MEASURED.names, MEASURED.name)
        table = MEASURED.check(measured[MEASURED.names]) if len(measured) else MEASURED.empty()
        places = table[["x", "y"]].to_numpy(np.float64)
        frames = table["frame"].to_numpy(np.int64)
        if len(frames) and frames.max() - frames.min() > 100 * len(frames) + 10000:
            raise InputError(
                f"{MEASURED.name}: frames run from {frames.min()} to {frames.max()} with "
                f"{len(frames)} measurements; count the frames of one recording."
            )
        inside = np.flatnonzero(self.appearance.area.contains(places))
        order = inside[np.lexsort((places[inside, 1], places[inside, 0], frames[inside]))]
        _check_unique(frames[order], places[order], order)
        return frames[order], order, np.ascontiguousarray(places[order])

    def reasons(self, tracks: Tracks) -> npt.NDArray[np.str_]:
        """Return why each track ends after its last step: one of `REASONS`."""
        area = self.appearance.area
        x, y = tracks["state"][:, :2].T
        sideways = ((y < 0) | (y > area.width_mm)) & (x < area.end_mm)
        # What is outside by probability may lie just inside: the nearer end decides.
        way = np.where(2.0 * x < area.start_mm + area.end_mm, BACK, LEFT)
        reason = np.where(tracks["outside"] > 0.5, np.where(sideways, SIDEWAYS, way), LOST)
        return np.where(self.keeps(tracks, 0), RUNNING, reason)

    def _ends(self, frame: Integers, tracks: Tracks) -> pd.DataFrame:
        """Return why each track ended: out at an end or over a side, lost, or not at all."""
        order = np.lexsort((frame, tracks["particle"]))
        last = order[np.append(np.diff(tracks["particle"][order]) != 0, True)]
        ended = tracks[last]
        valid, reason = ended["valid"].astype(np.int64), self.reasons(ended)
        columns = (ended["particle"], frame[last], valid, reason)
        return pd.DataFrame(dict(zip([*BELT_ENDS.names, "reason"], columns, strict=True)))


def _taken(frames: Frames, measured: Integers) -> Integers:
    """Return the numbers of the frames that there are, those measured (ascending) among them."""
    if frames is None or isinstance(frames, int | float | str | np.number):
        check_count(frames or 0, "BeltTracker: frames", least=0)
        first, last = (measured[0], measured[-1]) if len(measured) else (0, -1)
        return np.arange(first, max(last + 1, frames or 0))
    numbers = check_whole(pd.Series(frames), "BeltTracker: frames")
    if (np.diff(numbers) <= 0).any() or not np.isin(measured, numbers).all():
        raise InputError(
            "BeltTracker: frames: the numbers must ascend, and have those of all measurements."
        )
    return numbers


def _check_unique(frames: Integers, places: Array, rows: Integers) -> None:
    """Raise an `InputError` if a measurement is there twice.

    Measurements are sorted by frame and place.
    """
    again = (np.diff(frames) == 0) & (np.diff(places, axis=0) == 0).all(axis=1)
    if again.any():
        k = int(np.argmax(again))
        raise InputError(
            f"{MEASURED.name}: frame {frames[k]} has two measurements at x {places[k, 0]:g}, "
            f"y {places[k, 1]:g} mm (rows {rows[k]} and {rows[k + 1]}); they would be two tracks "
            "of one particle. Keep one of them (pandas: drop_duplicates)."
        )


def _states(frame: Integers, tracks: Tracks) -> pd.DataFrame:
    state = np.zeros((len(frame), 6))
    state[:, : tracks["state"].shape[1]] = tracks["state"]
    columns = (
        frame,
        tracks["particle"],
        tracks["row"],
        tracks["valid"].astype(np.int64),
        tracks["score"],
        *state.T,
    )
    return pd.DataFrame(dict(zip(BELT_STATES.names, columns, strict=True)))
