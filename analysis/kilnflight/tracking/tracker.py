"""The tracking loop: from detections to tracks (thesis, section 4.1).

Predict, gate, associate, update, start, stop. One loop over frames, `follow`, serves the kiln and
the belt, every associator and every motion; within a frame all tracks are one array. Tracks consist
of the original detections; the filter is used only for association. A probabilistic track is
recorded at the mean of its weighted detections (section 5.2.3).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from tqdm import tqdm

from kilnflight.arrays import Array, Flags, Index, Integers
from kilnflight.association import GNN, Associator, Pairs
from kilnflight.checks import check_columns, check_finite, check_number
from kilnflight.tables import TO_TRACK, plain, with_pixels
from kilnflight.tracking.filter import (
    ConstantVelocity,
    Detected,
    Gate,
    Motion,
    predict,
    residual_covariance,
    update,
)

# Structured, one entry per track, the older first: the columns of `layout`.
Tracks = npt.NDArray[np.void]
ExtraColumns = Mapping[str, npt.NDArray[Any]]  # of tracks, beside those of `layout`


class Step(NamedTuple):
    """Detections, gated pairs, weights and tracks of one frame.

    The frame has m detections; n tracks reach it.
    """

    detected: Detected
    pairs: Pairs  # of the n tracks that live and the m detections
    weights: Array  # (n, 1 + m)
    particle: Integers  # (m,), id of the track of each detection, old or new; -1: none
    owner: Integers  # (m,), row of ``weights``: the old track recorded with it; -1: none
    tracks: Tracks  # the n tracks after the update, then the new ones


@dataclass(frozen=True)
class Management:
    """End tracks that are visible too seldom or missed too long (Eq. 4.14).

    A track ends if its visibility, recorded detections by frames of life, is below ``visibility``,
    or if it was missed in more than ``invisible`` frames in a row. Detections that no track has
    used start new tracks.

    Notes
    -----
    No value is printed. ``invisible``: five frames are 15 ms, in which a particle of 30 px/frame
    that brakes by 0.3 px/frame^2 leaves its prediction by about 5 px. Longer gaps, up to 15 frames,
    are closed afterwards (t_eps,CONNECT of Table 5.16). ``visibility``: SIFT finds about half of
    the particles that do not burn and all of those that do (section 5.1), so a true track nearly
    always lies above 0.4. One miss in the second frame makes 0.5 and another 1/3, so it is tested
    from ``visibility_age`` on only. Frames without detections count. ``used``: a detection with a
    tenth of a track's weight is part of the recorded position.
    """

    visibility: float = 0.4  # v_eps, share of the frames of its life; not printed
    invisible: int = 5  # CIC_eps, frames in a row; not printed
    visibility_age: int = 4  # frames of life from which visibility is tested; not printed
    used: float = 0.1  # weight in a track from which a detection starts none; not printed

    def __post_init__(self) -> None:
        check_number(self.visibility, "Management: visibility", least=0, most=1)
        check_number(self.invisible, "Management: invisible", least=0, whole=True)
        check_number(self.visibility_age, "Management: visibility_age", least=0, whole=True)
        check_number(self.used, "Management: used", least=0, most=1)

    def keeps(self, tracks: Tracks, frame: int) -> Flags:
        """Return whether each of n tracks lives on in ``frame``, (n,)."""
        age = frame - tracks["born"]
        seldom = (age >= self.visibility_age) & (tracks["visible"] < self.visibility * age)
        return np.asarray(~seldom & (frame - 1 - tracks["last"] <= self.invisible))


# Weights (n, 1 + m), extra columns (n,) of tracks, and (m,) of detections if they start one.
Associate = Callable[[Tracks, Detected, Pairs], tuple[Array, ExtraColumns, ExtraColumns]]
Keeps = Callable[[Tracks, int], Flags]  # which tracks live on in a frame
_GNN, _MOTION, _GATE, _MANAGEMENT = GNN(), ConstantVelocity(), Gate(), Management()


def track(
    detections: pd.DataFrame,
    associator: Associator = _GNN,
    motion: Motion = _MOTION,
    gate: Gate = _GATE,
    management: Management = _MANAGEMENT,
    progress: bool = False,
) -> pd.DataFrame:
    """Return ``detections`` with the column ``particle``, the number of the track.

    Tracks are numbered 0, 1, ... in order of birth.

    Parameters
    ----------
    detections
        Columns frame (from 0; floats may hold them) and row, col or y, x (px). Where present, z
        (mm) and points are used; NaN in z, and NaN or 0 in points, mean unknown. Other columns
        are carried along.
    associator, motion, gate, management
        Association of a frame, motion of particles, limits of distance, end of tracks.
    progress
        Whether to show a bar in a terminal.

    Returns
    -------
    table
        The same rows in the same order, with the same index. A detection that no other
        follows is a track of its own. Detections that a track has used, and did not record, have
        ``particle`` -1. Rows that come with -1 stay so and are left out; any other particle is
        overwritten. With `PDA` or `JPDA`, a row holds the recorded position of its track: row,
        col, x, y, z are weighted means of the detections in the gate, other columns are those of
        the row itself.

    Raises
    ------
    InputError
        If a column is missing or there twice, a frame is below 0 or no whole number, or a position
        is not finite.

    Notes
    -----
    "JPDA computes the average coordinates of all detections within the gate as the temporal track
    locations" (section 5.2.3; "a weighted position", Fig. 2.22). Here a track is recorded in a
    frame if all its detections together outweigh "missed" (Eq. 4.10), in the row of its heaviest
    detection. It may also take a row whose detection alone outweighs "missed". A third kind of row
    belongs to some track with a probability above 0.5 and to this one with the largest. Pairs are
    taken by descending weight; each track and each detection is taken once.

    Within a frame, detections are sorted by row, col, z, points, so neither tracks nor ids
    depend on the order of the table.
    """
    detections = plain(detections)
    check_columns(detections, ["frame"], TO_TRACK.name)
    particle = np.full(len(detections), -1, dtype=np.int64)
    shared = list[tuple[Integers, Integers, Array]]()
    each, hidden = (
        steps(detections, associator, motion, gate, management),
        None if progress else True,
    )
    for step in tqdm(each, "tracking", detections["frame"].nunique(), unit="frame", disable=hidden):
        rows, recorded = step.detected.rows, np.flatnonzero(step.owner >= 0)
        particle[rows] = step.particle
        shares = step.weights[step.owner[recorded], 1:]
        several = (shares > 0).sum(axis=1) > 1
        if several.any():
            shared.append((rows[recorded[several]], rows, shares[several]))
    return _averaged(detections, shared).assign(particle=particle)


def _averaged(
    detections: pd.DataFrame, shared: Sequence[tuple[Integers, Integers, Array]]
) -> pd.DataFrame:
    """Return the table with weighted mean positions where a track used several rows.

    ``shared`` has, per frame, the k rows (k,) that get a mean, the m rows of its detections (m,),
    and the weights (k, m). Means are of row, col, x, y, z; an unknown value has no weight.
    """
    if not shared:
        return detections
    names = [name for name in ("row", "col", "x", "y", "z") if name in detections.columns]
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
    """Yield the `Step` of each frame with detections; `track` makes a table of them.

    Parameters
    ----------
    detections, associator, motion, gate, management
        As for `track`.
    """

    def associate(tracks: Tracks, detected: Detected, pairs: Pairs) -> Any:
        return associator(pairs), {}, {}

    frames = read_detections(detections)
    yield from follow(frames, motion, gate, associate, management.keeps, used=management.used)


def read_detections(table: pd.DataFrame) -> Iterator[Detected]:
    """Yield the detections of each frame that has any, by ascending frame.

    Rows of ``particle`` -1 (excluded by the caller) are left out. A table with y, x in px in place
    of row, col is renamed. ``span`` is the number of frames since the last frame with detections, 0
    in the first one. Unknown z and points are NaN. Within a frame, detections are sorted by row,
    col, z, points: ids of new tracks and ties then do not depend on the order of the table.
    """
    table = with_pixels(table)
    optional = [name for name in ("particle", "z", "points") if name in table.columns]
    rows = np.arange(len(table))
    if "particle" in optional:
        rows = rows[(table["particle"] != -1).to_numpy(dtype=bool, na_value=True)]
        table = table.iloc[rows]
    table = table if "z" in optional else table.assign(z=np.nan)
    frames, row, col, z = TO_TRACK.check(table, once=True).to_numpy(np.float64).T
    points = np.full(len(table), np.nan)
    if "points" in optional:
        points = check_finite(table["points"], "detections to track: column points", gaps=True)
        points = np.where(points > 0, points, np.nan)
    extra = [values for values in (points, z) if not np.isnan(values).all()]
    order = np.lexsort((*extra, col, row, frames))
    numbers, starts = np.unique(frames[order].astype(np.int64), return_index=True)
    spans = np.diff(numbers, prepend=numbers[:1]).astype(np.float64)
    parts = np.split(order, starts[1:]) if len(order) else []
    for number, span, part in zip(numbers.tolist(), spans.tolist(), parts, strict=True):
        yield Detected(
            np.stack([row[part], col[part]], axis=1),
            z[part],
            points[part],
            number,
            span,
            rows[part],
        )


def _layout(motion: Motion, extra_columns: Sequence[tuple[str, type]]) -> np.dtype[np.void]:
    """Return the dtype of `Tracks`: one field per column.

    The state has k numbers: positions, velocities and so on of ``motion``.
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
    frames: Iterable[Detected],
    motion: Motion,
    gate: Gate,
    associate: Associate,
    keeps: Keeps,
    extra_columns: Sequence[tuple[str, type]] = (),
    used: float = 1.0,
) -> Iterator[Step]:
    """Yield the `Step` of each frame, in the kiln and on the belt.

    Parameters
    ----------
    frames
        Detections by ascending frame. Tracks are predicted over the ``span`` of each.
    motion, gate
        Motion of particles, limits of distance.
    associate
        Function of tracks, detections and gated pairs. It returns weights (n, 1 + m), extra columns
        of the n tracks, and extra columns of the m tracks that the detections would start.
    keeps
        Function of tracks and frame number that returns which tracks live on, (n,).
    extra_columns
        Names and types of the columns that ``associate`` fills.
    used
        Weight in a recorded track from which a detection starts no new one.
    """
    measurement, noise = motion.measurement(), motion.measurement_noise()
    tracks, started, span = np.zeros(0, _layout(motion, extra_columns)), 0, -1.0
    for detected in frames:
        tracks = tracks[keeps(tracks, detected.frame)]
        if detected.span != span:
            span = detected.span
            moves = motion.transition(span), motion.process_noise(span)
        state, covariance = predict(tracks["state"], tracks["covariance"], *moves)
        residual = residual_covariance(covariance, measurement, noise)
        expected = state @ measurement.T
        pairs = gate(expected, residual, detected, tracks["depth_mm"], tracks["points"])
        weights, extra, extra_of_new = associate(tracks, detected, pairs)
        tracks["state"], tracks["covariance"] = update(
            state, covariance, pairs.factor, detected.positions, weights, measurement
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
        _record(old, detected, taken)
        tracks[owner[taken]] = old
        new = np.zeros(len(alone), tracks.dtype)
        new["particle"] = started + np.arange(len(new))
        new["state"], new["covariance"] = motion.initial(detected.positions[alone])
        new["depth_mm"] = new["points"] = np.nan
        new["born"], new["visible"] = detected.frame, 1
        for name, values in extra_of_new.items():
            new[name] = values[alone]
        _record(new, detected, alone)
        particle = np.full(len(owner), -1)
        particle[taken], particle[alone] = old["particle"], new["particle"]
        tracks, started = np.concatenate([tracks, new]), started + len(new)
        yield Step(detected, pairs, weights, particle, owner, tracks)


def _record(tracks: Tracks, detected: Detected, recorded: Index) -> None:
    """Write k recorded detections into their k tracks, in place.

    ``recorded`` (k,) are the indices of the detections. A track keeps its depth (mm) and number of
    3D points where a detection has none.
    """
    tracks["last"], tracks["row"] = detected.frame, detected.rows[recorded]
    for name, values in (("depth_mm", detected.depth_mm), ("points", detected.points)):
        if values is not None:
            known = values[recorded]
            tracks[name] = np.where(np.isnan(known), tracks[name], known)


def record(weights: Array) -> Integers:
    """Return the index of the track (m,) recorded at each detection; -1: none.

    ``weights`` is (n, 1 + m), column 0 = missed. The rule is in the notes of `track`. At equal
    weight the older track comes first, then the first detection.
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
