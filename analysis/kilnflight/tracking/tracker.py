"""The tracking loop: from detections to tracks (thesis, section 4.1).

Stop, predict, gate, associate, update, start. One loop over frames, `follow`, serves
the kiln and the belt, every associator and every motion; within a frame all tracks are
one array. Tracks consist of the original detections; the filter is used only for
association. A probabilistic track is recorded at the mean of its weighted detections
(section 5.2.3).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pandas import DataFrame
from tqdm import tqdm

from kilnflight.arrays import Anything, Array, Flags, Index, Integers
from kilnflight.association import GNN, Associator, Pairs
from kilnflight.checks import (
    CountFrom0,
    Settings,
    Share,
    check_columns,
    check_finite,
    check_flags,
)
from kilnflight.tables import TO_TRACK, plain, with_pixels
from kilnflight.tracking.filter import (
    ConstantVelocity,
    Detected,
    Gate,
    Motion,
    predict,
    update,
)

# Structured, one entry per track, the older first: the columns of `_blank`.
Tracks = npt.NDArray[np.void]
# Columns of tracks beside those of `_blank`.
ExtraColumns = Mapping[str, Anything]
Shares = tuple[Integers, Integers, Any]  # (q,) each, see `_shares`


# Weight in a track from which a detection starts none; ours: with a tenth of the weight
# it is part of the recorded position.
USED = 0.1


class Step(NamedTuple):
    """Detections, gated pairs, weights and tracks of one frame.

    The frame has m detections; n tracks reach it.
    """

    detected: Detected
    pairs: Pairs  # p of the n tracks that live and the m detections
    weights: Array | Flags  # (p,)
    particle: Integers  # (m,), id of the track of each detection, old or new; -1: none
    owner: Integers  # (m,), index of the old track that is recorded with it; -1: none
    tracks: Tracks  # the n tracks after the update, then the new ones


class Management(Settings):
    """End tracks that are visible too seldom or missed too long (Eq. 4.14).

    A track ends if its visibility, recorded detections by frames of life, is below
    ``visibility``, or if it was missed in more than ``invisible`` frames in a row.
    Detections that no track has used start new tracks.

    Notes
    -----
    No value is printed. ``invisible``: five frames are 15 ms, in which a particle of 30
    px/frame that brakes by 0.3 px/frame^2 leaves its prediction by about 5 px. Longer
    gaps, up to 15 frames, are closed afterwards (t_eps,CONNECT of Table 5.16).
    ``visibility``: SIFT finds about half of the particles that do not burn and all of
    those that do (section 5.1), so a true track nearly always lies above 0.4. As
    printed it is tested from the first frame on: one miss in the second frame makes
    0.5, another 1/3. Frames without detections count.

    Parameters
    ----------
    visibility
        v_eps, smallest share of the frames of a track's life; not printed.
    invisible
        CIC_eps, largest number of missed frames in a row; not printed.

    Examples
    --------
    A particle is hidden in frames 1 and 2.

    >>> seen = DataFrame({"frame": [0, 3, 4], "row": [0.0, 9.0, 12.0], "col": 0.0})
    >>> track(seen, management=Management())["particle"].tolist()
    [0, 1, 1]
    >>> track(seen, management=Management(visibility=0.2))["particle"].tolist()
    [0, 0, 0]
    """

    visibility: Share = 0.4
    invisible: CountFrom0 = 5

    def keeps(self, tracks: Tracks, frame: int) -> Flags:
        """Return whether each of n tracks lives on in ``frame``, (n,)."""
        seldom = tracks["visible"] < self.visibility * (frame - tracks["born"])
        return ~seldom & (frame - 1 - tracks["last"] <= self.invisible)


# Weights (p,), extra columns (n,) of tracks, and (m,) of detections if they start one.
Associate = Callable[
    [Tracks, Detected, Pairs], tuple[Array | Flags, ExtraColumns, ExtraColumns]
]
Keeps = Callable[[Tracks, int], Flags]  # which tracks live on in a frame
_GNN = GNN()
_MOTION = ConstantVelocity()
_GATE = Gate()
_MANAGEMENT = Management()


def track(
    detections: DataFrame,
    associator: Associator = _GNN,
    motion: Motion = _MOTION,
    gate: Gate = _GATE,
    management: Management = _MANAGEMENT,
    progress: bool = False,
    link: bool = False,
) -> DataFrame:
    """Return ``detections`` with the column ``particle``, the number of the track.

    Tracks are numbered 0, 1, ... in order of birth.

    Parameters
    ----------
    detections
        Columns frame (from 0; floats may hold them) and row, col or y, x (px). Where
        present, z (mm) and points are used; NaN in z, and NaN or 0 in points, mean
        unknown. Other columns are carried along.
    associator, motion, gate, management
        Association of a frame, motion of particles, limits of distance, end of tracks.
    progress
        Whether to show a bar in a terminal.
    link
        Whether to add the column ``link``: how sure the link to the track is, from 1 to
        0. It is 1 minus the Mahalanobis distance over the gate's, or a weight of `PDA`
        or `JPDA`; NaN where a track begins.

    Returns
    -------
    table
        The same rows in the same order, with the same index. A detection that no other
        follows is a track of its own. Detections that a track has used, and did not
        record, have ``particle`` -1. Rows that come with -1 stay so and are left out;
        any other particle is overwritten. With `PDA` or `JPDA`, a row holds the
        recorded position of its track: row, col, x, y, z are weighted means of the
        detections in the gate, other columns are those of the row itself.

    Raises
    ------
    InputError
        If a column is missing or there twice, a frame is below 0 or no whole number, or
        a position is not finite.

    Notes
    -----
    "JPDA computes the average coordinates of all detections within the gate as the
    temporal track locations" (section 5.2.3; "a weighted position", Fig. 2.22). Here a
    track is recorded in a frame if all its detections together outweigh "missed" (Eq.
    4.10), in the row of its heaviest detection. It may also take a row whose detection
    alone outweighs "missed". A third kind of row belongs to some track with a
    probability above 0.5 and to this one with the largest. Pairs are taken by
    descending weight; each track and each detection is taken once.

    Within a frame, detections are sorted by row, col, z, points, so neither tracks nor
    ids depend on the order of the table.

    Examples
    --------
    Two particles, 50 px apart, move to the right by 4 px/frame.

    >>> seen = DataFrame({"frame": [0, 0, 1, 1, 2, 2], "row": [10.0, 60.0] * 3})
    >>> track(seen.assign(col=4.0 * seen["frame"]))["particle"].tolist()
    [0, 1, 0, 1, 0, 1]
    """
    check_flags("track: progress and link", progress, link)
    detections = plain(detections)
    check_columns(detections, ["frame"], TO_TRACK.name)
    particle = np.full(len(detections), -1, np.int64)
    links = np.full(len(detections), np.nan)
    shared = list[Shares]()
    bar = tqdm(
        steps(detections, associator, motion, gate, management),
        "tracking",
        detections["frame"].nunique(),
        unit="frame",
        disable=None if progress else True,
    )
    for step in bar:
        pairs = step.pairs
        rows = step.detected.rows
        particle[rows] = step.particle
        sure: Any = 1 - np.sqrt(pairs.distance_squared) / gate.distance
        if step.weights.dtype != np.bool_:
            shared.append(_shares(step))
            sure = step.weights
        taken = step.owner[pairs.detection] == pairs.track
        links[rows[pairs.detection[taken]]] = sure[taken]
    if shared:
        detections = _averaged(detections, shared)
    if link:
        detections = detections.assign(link=links)
    return detections.assign(particle=particle)


def _shares(step: Step) -> Shares:
    """Return which rows of the table the recorded tracks of a frame consist of.

    Returns
    -------
    recorded, used, weights
        For each detection that a track uses: the row that gets the track's mean, the
        row of the detection, and its weight above 0, (q,) each.
    """
    rows = step.detected.rows
    at = np.full(len(step.pairs.expected), -1)
    taken = np.flatnonzero(step.owner >= 0)
    at[step.owner[taken]] = rows[taken]
    recorded = at[step.pairs.track]
    used = (recorded >= 0) & (step.weights > 0)
    return recorded[used], rows[step.pairs.detection[used]], step.weights[used]


def _averaged(detections: DataFrame, shared: Sequence[Shares]) -> DataFrame:
    """Return the table with weighted mean positions where a track used several rows.

    Means are of row, col, x, y, z; an unknown value has no weight.
    """
    at, rows, weights = map(np.concatenate, zip(*shared, strict=True))
    names = detections.columns.intersection(["row", "col", "x", "y", "z"])
    places = detections[names].astype(float)
    used = places.iloc[rows]
    sums = used.mul(weights, axis=0).groupby(at).sum()
    means = sums / used.notna().mul(weights, axis=0).groupby(at).sum()
    several = np.flatnonzero(np.bincount(at) > 1)
    places.iloc[several] = means.loc[several].to_numpy()
    return detections.assign(**places)


def steps(
    detections: DataFrame,
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
        return associator(pairs), {}, {}  # no extra columns

    frames = read_detections(detections)
    yield from follow(frames, motion, gate, associate, management.keeps)


def read_detections(table: DataFrame) -> Iterator[Detected]:
    """Yield the detections of each frame that has any, by ascending frame.

    Rows of ``particle`` -1 (excluded by the caller) are left out. A table with y, x in
    px in place of row, col is renamed. ``span`` is the number of frames since the last
    frame with detections, 0 in the first one. Unknown z and points are NaN, or None
    where all are. Within a frame, detections are sorted by row, col, z, points: ids of
    new tracks and ties then do not depend on the order of the table.
    """
    table = with_pixels(table)
    rows = np.arange(len(table))
    if "particle" in table.columns:
        rows = rows[(table["particle"] != -1).to_numpy(bool, na_value=True)]
        table = table.iloc[rows]
    if "z" not in table.columns:
        table = table.assign(z=np.nan)
    frames, row, col, z = TO_TRACK.check(table, once=True).to_numpy(float).T
    points = np.full(len(table), np.nan)
    if "points" in table.columns:
        where = f"{TO_TRACK.name}: column points"
        points = check_finite(table["points"], where, gaps=True)
        points = np.where(points > 0, points, np.nan)
    # One key of both numbers: rows that are in order are hardly sorted.
    order = np.argsort(frames + 1j * row, kind="stable")
    if not np.diff([frames[order], row[order]]).any(axis=0).all():
        order = np.lexsort((points, z, col, row, frames))
    rows = rows[order]
    places = np.stack([row, col], axis=1)[order]
    depth = _unless_unknown(z[order])
    sizes = _unless_unknown(points[order])
    numbers, starts = np.unique(frames[order], return_index=True)
    spans = np.diff(numbers, prepend=numbers[:1])
    parts = map(slice, starts, [*starts[1:], len(order)])
    for number, span, part in zip(numbers, spans, parts, strict=True):
        yield Detected(
            positions=places[part],
            depth_mm=None if depth is None else depth[part],
            points=None if sizes is None else sizes[part],
            frame=int(number),
            span=float(span),
            rows=rows[part],
        )


def _unless_unknown(values: Array) -> Array | None:
    """Return the values, or None if all are NaN, which saves time in the gate."""
    return None if np.isnan(values).all() else values


def _blank(motion: Motion, extra_columns: Sequence[tuple[str, type]]) -> Tracks:
    """Return a track at the origin, (1,), with one field per column.

    The state has k numbers: positions, velocities and so on of ``motion``.
    """
    state, covariance = motion.initial()
    k = len(state)
    columns = [
        ("particle", np.int64),  # ids in order of birth
        ("state", np.float64, (k,)),
        ("covariance", np.float64, (k, k)),
        ("depth_mm", np.float64),  # last known; NaN: never known
        ("points", np.float64),  # last known number of 3D points; NaN: never known
        ("born", np.int64),  # frame
        ("last", np.int64),  # frame of the last recorded detection
        ("visible", np.int64),  # number of recorded detections, V in Eq. 4.14
        # Row of the table that was recorded in this frame; -1: missed.
        ("row", np.int64),
        *extra_columns,
    ]
    track = np.zeros(1, np.dtype(columns))
    track["state"] = state
    track["covariance"] = covariance
    track["depth_mm"] = np.nan
    track["points"] = np.nan
    return track


def follow(
    frames: Iterable[Detected],
    motion: Motion,
    gate: Gate,
    associate: Associate,
    keeps: Keeps,
    extra_columns: Sequence[tuple[str, type]] = (),
) -> Iterator[Step]:
    """Yield the `Step` of each frame, in the kiln and on the belt.

    Parameters
    ----------
    frames
        Detections by ascending frame. Tracks are predicted over the ``span`` of each.
    motion, gate
        Motion of particles, limits of distance.
    associate
        Function of tracks, detections and gated pairs. It returns weights (p,), extra
        columns of the n tracks, and extra columns of the m tracks that the detections
        would start.
    keeps
        Function of tracks and frame number that returns which tracks live on, (n,).
    extra_columns
        Names and types of the columns that ``associate`` fills.
    """
    noise = motion.measurement_noise()
    d = len(noise)  # coordinates of a position
    # The n tracks, and blank ones behind them: numpy copies structured arrays fast, but
    # joins them slowly. The last one is always blank.
    storage = _blank(motion, extra_columns)
    n = 0
    next_id = 0
    span = None
    for detected in frames:
        kept = np.flatnonzero(keeps(storage[:n], detected.frame))
        # Index -1 copies the blank track: one for each detection, and one that stays.
        blank = np.full(len(detected.positions) + 1, -1)
        storage = storage.take(np.concatenate([kept, blank]))
        tracks = storage[: len(kept)]
        if detected.span != span:  # the matrices change only with it
            span = detected.span
            moves = motion.transition(span), motion.process_noise(span)
        state, covariance = predict(tracks["state"], tracks["covariance"], *moves)
        residual = covariance[:, :d, :d] + noise  # S = H P H' + R; H selects positions
        pairs = gate(
            state[:, :d], residual, detected, tracks["depth_mm"], tracks["points"]
        )
        weights, extra, extra_of_new = associate(tracks, detected, pairs)
        state, covariance = update(state, covariance, pairs, weights)
        tracks["state"] = state
        tracks["covariance"] = covariance
        tracks["row"] = -1
        for name, values in extra.items():
            tracks[name] = values
        owner = choose_owners(pairs, weights)
        unused = _unused(pairs, weights, owner)
        n = len(kept) + len(unused)
        track_of = owner.copy()
        track_of[unused] = np.arange(len(kept), n)
        _begin(storage[len(kept) : n], next_id, detected, unused, extra_of_new)
        next_id += len(unused)
        tracks = storage[:n]
        particle = _write(tracks, track_of, detected)
        yield Step(detected, pairs, weights, particle, owner, tracks)


def _unused(pairs: Pairs, weights: Array | Flags, owner: Index) -> Index:
    """Return the detections (k,) that each start a track, as no track has used them.

    A track uses a detection with a weight of at least `USED`, if it is recorded, as
    ``owner`` (m,) says.
    """
    unused = owner < 0
    if weights.dtype != np.bool_:  # else a detection with a weight is recorded
        used = np.isin(pairs.track, owner) & (weights >= USED)
        unused[pairs.detection[used]] = False
    return np.flatnonzero(unused)


def _begin(
    new: Tracks, first: int, detected: Detected, unused: Index, extra: ExtraColumns
) -> None:
    """Start tracks, numbered from ``first`` on, at the detections ``unused`` (k,)."""
    new["particle"] = np.arange(first, first + len(unused))
    new["born"] = detected.frame
    new["state"][:, : detected.positions.shape[1]] = detected.positions[unused]
    for name, values in extra.items():
        new[name] = values[unused]


def _write(tracks: Tracks, track_of: Index, detected: Detected) -> Integers:
    """Write recorded detections into their tracks and return their particles (m,).

    ``track_of`` (m,) is the index of each detection's track; -1: none, which is
    particle -1. A track keeps its depth and number of 3D points where a detection has
    none.
    """
    recorded = np.flatnonzero(track_of >= 0)
    at = track_of[recorded]
    tracks["visible"][at] += 1
    tracks["last"][at] = detected.frame
    tracks["row"][at] = detected.rows[recorded]
    for name, values in (("depth_mm", detected.depth_mm), ("points", detected.points)):
        if values is not None:
            known = ~np.isnan(values[recorded])
            tracks[name][at[known]] = values[recorded[known]]
    particle = np.full(len(track_of), -1)
    particle[recorded] = tracks["particle"][at]
    return particle


def choose_owners(pairs: Pairs, weights: Array | Flags) -> Index:
    """Return the index of the track (m,) recorded at each detection; -1: none.

    ``weights`` (p,) are those of the pairs. The rule is in the notes of `track`. At
    equal weight the older track comes first, then the first detection.
    """
    owner = np.full(pairs.detections, -1)
    n = len(pairs.expected)
    if weights.dtype == np.bool_:
        owner[pairs.detection[weights]] = pairs.track[weights]
        return owner
    order = np.argsort(-1.0 * weights, kind="stable")
    order = order[weights[order] > 0]
    track = pairs.track[order]
    detection = pairs.detection[order]
    weight = weights[order]
    given = np.bincount(pairs.track, weights, n)[track]
    real = np.bincount(detection, weight, len(owner))[detection]
    chosen = weight > 1.0 - given
    chosen |= _first(detection) & (real > 0.5)
    chosen |= _first(track) & (given > 0.5)
    free = np.ones(n, bool)
    for i, j in zip(track[chosen].tolist(), detection[chosen].tolist(), strict=True):
        if free[i] and owner[j] < 0:
            owner[j] = i
            free[i] = False
    return owner


def _first(values: Index) -> Flags:
    """Return which values (n,) are the first of their kind."""
    first = np.zeros(len(values), bool)
    first[np.unique(values, return_index=True)[1]] = True
    return first
