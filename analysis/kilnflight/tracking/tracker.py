"""The tracking loop: from detections to tracks (thesis, section 4.1).

Predict, gate, associate, update, start, stop. One loop over frames, `follow`, serves the kiln and
the belt, every associator and every motion model; within a frame all tracks are one array. What is
linked is the detections themselves: the filter decides, but no filtered position is ever handed on.
A probabilistic track is recorded where its weighted detections are (section 5.2.3).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.association import GNN, Associator, Pairs
from kilnflight.checks import (
    InputError,
    check_between,
    check_columns,
    check_count,
    check_offers,
    check_whole,
    is_real,
    known_numbers,
)
from kilnflight.tables import TO_TRACK
from kilnflight.tracking import kalman
from kilnflight.tracking.gate import Detected, Gate, Predicted
from kilnflight.tracking.motion import ConstantVelocity, Motion

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.integer]
Booleans = npt.NDArray[np.bool_]
# Structured, one entry per track, the older first: the columns of `layout`.
Tracks = npt.NDArray[np.void]
ExtraColumns = Mapping[str, npt.NDArray[Any]]  # of tracks, beside those of `layout`


class FrameDetections(NamedTuple):
    """The detections of one frame."""

    number: int
    span: float  # time since the frame before, in the units of the motion
    rows: Integers  # (m,), rows of the table, by position; the m detections in this order
    detected: Detected


class Step(NamedTuple):
    """Predictions, weights and tracks of one frame.

    Figs 4.2 and 2.20 to 2.22 of the thesis and Fig. 3 of the belt paper are drawn from it.
    """

    frame: int
    rows: Integers  # (m,), rows of the table, by position; the m detections in this order
    predicted: Predicted  # where the n tracks were expected; S: ellipses of the gates
    detected: Detected
    pairs: Pairs
    weights: Array  # (n, 1 + m)
    particle: Integers  # (m,), the track each detection went to or started; -1: used, neither
    owner: Integers  # (m,), the row of ``weights`` of the track recorded with it; -1: none
    tracks: Tracks  # the n tracks after the update, then those that started


@dataclass(frozen=True)
class Management:
    """End tracks that are visible too seldom or missed too long (Eq. 4.14).

    And which detections start one: those that no track has used.

    Notes
    -----
    No value is printed. ``invisible``: five frames are 15 ms, in which a particle of 30 px/frame
    that brakes by 0.3 px/frame^2 leaves its prediction by some 5 px. Longer gaps, up to 15 frames,
    are closed afterwards (t_eps,CONNECT of Table 5.16). ``visibility``: SIFT finds about half of
    the particles that do not burn and all of those that do (section 5.1), so a true track nearly
    always lies above 0.4. Since one miss in the second frame makes 0.5 and another 1/3, it is
    tested from ``visibility_age`` on only. Frames that have no detection at all count like any
    other. ``used``: what moved a track by a tenth of its way or more is in the position that the
    track is recorded with.
    """

    visibility: float = 0.4  # v_eps, share of the frames of its life; not printed
    invisible: int = 5  # CIC_eps, frames in a row; not printed
    visibility_age: int = 4  # frames of life from which visibility is tested; not printed
    used: float = 0.1  # weight in some track from which a detection starts none; not printed

    def __post_init__(self) -> None:
        """Refuse a share or a number of frames out of range."""
        check_between(self.visibility, 0, 1, "Management: visibility")
        check_count(self.invisible, "Management: invisible", least=0)
        check_count(self.visibility_age, "Management: visibility_age", least=0)
        check_between(self.used, 0, 1, "Management: used")

    def keeps(self, tracks: Tracks, frame: int) -> Booleans:
        """Return whether each track lives on in ``frame``."""
        age = frame - tracks["born"]
        seldom = (age >= self.visibility_age) & (tracks["visible"] < self.visibility * age)
        return np.asarray(~seldom & (frame - 1 - tracks["last"] <= self.invisible))


# Which track takes which detection: weights (n, 1 + m); extra columns of each track, and of each
# detection in case it starts one. `Keeps` says which tracks live on when a frame comes.
Associate = Callable[[Tracks, Predicted, Detected, Pairs], tuple[Array, ExtraColumns, ExtraColumns]]
Keeps = Callable[[Tracks, int], Booleans]
AVERAGED = ("row", "col", "x", "y", "z")  # where a track is recorded
_GNN, _MOTION, _GATE, _MANAGEMENT = GNN(), ConstantVelocity(), Gate(), Management()


def track(
    detections: pd.DataFrame,
    associator: Associator = _GNN,
    motion: Motion = _MOTION,
    gate: Gate = _GATE,
    management: Management = _MANAGEMENT,
) -> pd.DataFrame:
    """Return ``detections`` with the column ``particle``.

    Tracks are numbered 0, 1, ... in order of birth.

    Parameters
    ----------
    detections
        Columns frame (from 0; floats may hold them), row, col (px); z (mm) and points
        are used where present. NaN in z, and NaN or 0 in points, mean unknown. Other columns
        are carried along.
    associator, motion, gate, management
        Which detection a track takes, how particles move, what is possible, when tracks end.

    Returns
    -------
    table
        The same rows in the same order, with the same index. A detection that no other
        follows is a track of its own. With probabilities, a row stands where its track is
        recorded: row, col, x, y, z are weighted means of the detections in the gate, what else
        it has is that of the heaviest; those that a track has used so, and did not record,
        have ``particle`` -1. Rows that come with -1 stay so and are left out; any other particle
        is overwritten.

    Raises
    ------
    InputError
        If a column is missing or there twice, a frame is below 0 or no whole number, a position
        is not finite, or a part is not of its kind (a class instead of an instance, say). The
        message names the row.

    Notes
    -----
    "JPDA computes the average coordinates of all detections within the gate as the temporal
    track locations" (section 5.2.3; "a weighted position", Fig. 2.22). So a track is there if all
    its detections together outweigh "missed" (Eq. 4.10). The row of the table that holds its
    place is that of its heaviest detection, or of another one that alone beats "missed". A
    detection that more probably belongs to some track than to none goes to the track it weighs
    most for. Largest weight first; a track or detection that is taken is passed over.

    Within a frame, detections are taken by row, col, z, points, so neither tracks nor ids
    depend on the order of the table. Rows equal in all of these are taken as they stand.
    """
    check_columns(detections, TO_TRACK.names, TO_TRACK.name)
    left_out = np.zeros(len(detections), dtype=bool)
    if "particle" in detections.columns:
        check_columns(detections, ["particle"], TO_TRACK.name)
        left_out = (detections["particle"] == -1).to_numpy(dtype=bool, na_value=False)
    particle = np.full(len(detections), -1, dtype=np.int64)
    rows, shared = np.flatnonzero(~left_out), list[tuple[Integers, Integers, Array]]()
    for step in steps(detections[~left_out], associator, motion, gate, management):
        here, recorded = rows[step.rows], np.flatnonzero(step.owner >= 0)
        particle[here] = step.particle
        shares = step.weights[step.owner[recorded], 1:]
        several = (shares > 0).sum(axis=1) > 1
        if several.any():
            shared.append((here[recorded[several]], here, shares[several]))
    return _averaged(detections, shared).assign(particle=particle)


def _averaged(
    detections: pd.DataFrame, shared: Sequence[tuple[Integers, Integers, Array]]
) -> pd.DataFrame:
    """Return the table with weighted means where tracks share detections.

    Of each frame the rows (n,) that hold a mean, those (m,) it is of, and their weights (n, m).
    """
    if not shared:
        return detections
    names = [name for name in AVERAGED if name in detections.columns]
    places = detections[names].to_numpy(np.float64)
    means = places.copy()
    for at, rows, weights in shared:
        known = ~np.isnan(places[rows])
        with np.errstate(invalid="ignore"):  # unknown in all of them stays unknown
            means[at] = weights @ np.where(known, places[rows], 0.0) / (weights @ known)
    table = detections.copy()
    table[names] = means
    return table


def steps(
    detections: pd.DataFrame,
    associator: Associator = _GNN,
    motion: Motion = _MOTION,
    gate: Gate = _GATE,
    management: Management = _MANAGEMENT,
) -> Iterator[Step]:
    """Yield the step of each frame with detections, as `track` makes it.

    Arguments are those of `track`.
    """
    check_offers(associator, ("__call__",), "track: associator")
    check_parts(motion, gate, "track")
    check_offers(management, ("keeps",), "track: management")
    frames, rows, *known = _read(detections)
    numbers, starts = np.unique(frames, return_index=True)
    spans = np.diff(numbers, prepend=numbers[:1]).astype(np.float64)
    parts = np.split(np.arange(len(frames)), starts[1:])
    sequence = (
        FrameDetections(number, span, rows[part], Detected(*(values[part] for values in known)))
        for number, span, part in zip(numbers.tolist(), spans.tolist(), parts, strict=False)
    )

    def associate(tracks: Tracks, predicted: Predicted, detected: Detected, pairs: Pairs) -> Any:
        return associator(pairs), {}, {}

    yield from follow(sequence, motion, gate, associate, management.keeps, used=management.used)


def check_parts(motion: Motion, gate: Gate, where: str) -> None:
    """Raise an `InputError` unless motion and gate have their methods."""
    moves = ("transition", "process_noise", "measurement", "measurement_noise", "initial")
    check_offers(motion, moves, f"{where}: motion")
    check_offers(gate, ("__call__",), f"{where}: gate")


def layout(motion: Motion, extra_columns: Sequence[tuple[str, type]] = ()) -> np.dtype[np.void]:
    """Return the columns of `Tracks`.

    ``extra_columns`` are names and types of columns that the belt adds.
    """
    k = motion.measurement().shape[1]
    return np.dtype(
        [
            ("particle", np.int64),  # ids in order of birth
            ("state", np.float64, (k,)),
            ("covariance", np.float64, (k, k)),
            ("depth_mm", np.float64),  # last known; NaN: never known
            ("points", np.float64),  # last known number of 3D points; NaN: never known
            ("born", np.int64),  # frame
            ("last", np.int64),  # frame of the last recorded detection
            ("visible", np.int64),  # number of recorded detections, V in Eq. 4.14
            ("row", np.int64),  # of the table: what was recorded in this frame; -1: missed
            *extra_columns,
        ]
    )


def follow(
    frames: Iterable[FrameDetections],
    motion: Motion,
    gate: Gate,
    associate: Associate,
    keeps: Keeps,
    extra_columns: Sequence[tuple[str, type]] = (),
    used: float = 1.0,
) -> Iterator[Step]:
    """Yield the step of each frame, in the kiln as on the belt.

    Kiln and belt bring ``associate`` and ``keeps``; ``extra_columns`` are those of `layout`,
    ``used`` is as in `Management`.
    """
    measurement, noise = motion.measurement(), motion.measurement_noise()
    tracks, started, span = np.zeros(0, layout(motion, extra_columns)), 0, -1.0
    for frame in frames:
        tracks, detected = tracks[keeps(tracks, frame.number)], frame.detected
        if frame.span != span:
            span = frame.span
            moves = motion.transition(span), motion.process_noise(span)
        state, covariance = kalman.predict(tracks["state"], tracks["covariance"], *moves)
        residual = kalman.residual_covariance(covariance, measurement, noise)
        expected = state @ measurement.T
        last_known = tracks["depth_mm"].copy(), tracks["points"].copy()  # recorded anew below
        predicted = Predicted(expected, residual, *last_known)
        pairs = gate(predicted, detected)
        weights, extra, extra_of_new = associate(tracks, predicted, detected, pairs)
        tracks["state"], tracks["covariance"] = kalman.update(
            state, covariance, detected.positions, weights, measurement, noise
        )
        owner = record(weights)
        taken = np.flatnonzero(owner >= 0)
        free = weights[owner[taken], 1:].max(axis=0, initial=0.0) < used
        alone = np.flatnonzero((owner < 0) & free)
        tracks["row"] = -1
        for name, values in extra.items():
            tracks[name] = values
        old = tracks[owner[taken]]
        old["visible"] += 1
        _record(old, frame, taken)
        tracks[owner[taken]] = old
        new = np.zeros(len(alone), tracks.dtype)
        new["particle"] = started + np.arange(len(new))
        new["state"], new["covariance"] = motion.initial(detected.positions[alone])
        new["depth_mm"] = new["points"] = np.nan
        new["born"], new["visible"] = frame.number, 1
        for name, values in extra_of_new.items():
            new[name] = values[alone]
        _record(new, frame, alone)
        particle = np.full(len(owner), -1)
        particle[taken], particle[alone] = old["particle"], new["particle"]
        tracks, started = np.concatenate([tracks, new]), started + len(new)
        what = (predicted, detected, pairs, weights, particle, owner, tracks)
        yield Step(frame.number, frame.rows, *what)


def _record(tracks: Tracks, frame: FrameDetections, detection: Integers) -> None:
    """Write the recorded detections into their tracks.

    Where a detection has no depth or points, those of the track stay.
    """
    tracks["last"], tracks["row"] = frame.number, frame.rows[detection]
    for name, values in zip(("depth_mm", "points"), frame.detected[1:], strict=True):
        if values is not None:
            known = values[detection]
            tracks[name] = np.where(np.isnan(known), tracks[name], known)


def _read(table: pd.DataFrame) -> tuple[Integers, Integers, Array, Array, Array]:
    """Return the columns of a table, sorted by frame and place.

    Frames, positions of the rows, places, depth, points.
    """
    check_columns(table, TO_TRACK.names, TO_TRACK.name)
    frames = check_whole(table["frame"], f"{TO_TRACK.name}: column frame")
    if (frames < 0).any():
        where = table.index[int(np.argmin(frames))]
        raise InputError(
            f"{TO_TRACK.name}: frame {frames.min()} in row {where}; frames are counted from 0. "
            "Leave rows that belong to no frame out."
        )
    needed = table[TO_TRACK.names].assign(frame=frames)
    for name in TO_TRACK.names[1:]:
        if len(table) and not is_real(table[name]):
            raise InputError(
                f"{TO_TRACK.name}: column {name} holds {table[name].dtype}, not "
                "numbers. Convert it first."
            )
    positions = (TO_TRACK.check(needed) if len(table) else needed)[["row", "col"]].to_numpy(float)
    depth, points = _optional(table, "z"), _optional(table, "points")
    points = np.where(points > 0, points, np.nan)
    extra = [values for values in (points, depth) if not np.isnan(values).all()]
    rows = np.lexsort((*extra, positions[:, 1], positions[:, 0], frames))
    return frames[rows], rows, positions[rows], depth[rows], points[rows]


def _optional(table: pd.DataFrame, name: str) -> Array:
    """Return a column as floats, NaN where unknown."""
    if name not in table.columns:
        return np.full(len(table), np.nan)
    check_columns(table, [name], TO_TRACK.name)
    values = known_numbers(table[name], f"{TO_TRACK.name}: column {name}")
    if np.isinf(values).any():
        where = table.index[int(np.argmax(np.isinf(values)))]
        raise InputError(
            f"{TO_TRACK.name}: {name} is infinite in row {where}; use NaN for unknown."
        )
    return values


def record(weights: Array) -> Integers:
    """Return the track (m,) that each detection is recorded for, -1: none.

    See `track`. Of equal weights the older track's, and of these the first detection's,
    comes first. Rows of 0 and 1 are read off as they are.
    """
    pairs = weights[:, 1:]
    owner, free = np.full(pairs.shape[1], -1), np.ones(len(pairs), dtype=np.bool_)
    if not pairs.size:
        return owner
    first = pairs.argmax(axis=0) == np.arange(len(pairs))[:, None]
    likely = (pairs.sum(axis=0) > 0.5) & first
    heaviest = pairs.argmax(axis=1)[:, None] == np.arange(pairs.shape[1])
    there = heaviest & (pairs.sum(axis=1, keepdims=True) > weights[:, :1])
    tracks, detections = np.nonzero(likely | there | (pairs > weights[:, :1]))
    order = np.argsort(-pairs[tracks, detections], kind="stable")
    for i, j in zip(tracks[order].tolist(), detections[order].tolist(), strict=True):
        if free[i] and owner[j] < 0:
            owner[j], free[i] = i, False
    return owner
