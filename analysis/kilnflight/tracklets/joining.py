"""The iteration that connection and fusion share (Fig. 4.8, thesis, section 4.2.3)."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import check_kind, check_offers
from kilnflight.tracklets.criteria import Limits, Pool, Weights, candidates, merged
from kilnflight.tracklets.eliminate import Elimination
from kilnflight.tracklets.laws import Differences, LevelEdge
from kilnflight.tracklets.matching import Matching, Pairs
from kilnflight.tracklets.outliers import OutlierRemoval
from kilnflight.tracklets.paths import Paths, read_paths, write_paths


class Feature(NamedTuple):
    """The last term of Eq. 4.24: its weight f, its measure, and what it measures on."""

    weight: float
    measure: LevelEdge
    differences: Differences | None


def refuse(
    step: object, outliers: object, false: object, feature: object, matching: object
) -> None:
    """Raise an `InputError` if a part of a step is of another kind than its field."""
    name = type(step).__name__
    check_kind(outliers, OutlierRemoval, f"{name}: outliers")
    check_kind(false, Elimination, f"{name}: false")
    check_offers(feature, ("__call__",), f"{name}: feature")
    check_offers(matching, ("__call__",), f"{name}: matching")


class Joining(Protocol):
    """What `Connection` and `Fusion` have in common, as far as limits go."""

    @property
    def depth(self) -> float:
        """Change of depth, mm/frame (Eq. 4.22)."""

    @property
    def outliers(self) -> OutlierRemoval:
        """Eq. 4.18, for the connected part."""

    @property
    def false(self) -> Elimination:
        """Eq. 4.15 without duration, for the connected part."""


def limits_of(
    step: Joining, *, gap: float, overlap: float, distance: float, nested: bool
) -> Limits:
    """Return what a pair must keep to: where two steps differ, and what they share."""
    return Limits(
        gap=float(gap),
        overlap=float(overlap),
        distance=float(distance),
        nested=float(nested),
        angle=float(step.outliers.angle_deg),
        change=float(step.outliers.change),
        speed=float(step.false.speed),
        regularity=float(step.false.regularity),
        depth=float(step.depth),
    )


def join(
    tracks: pd.DataFrame, limits: Limits, weights: Weights, feature: Feature, matching: Matching
) -> pd.DataFrame:
    """Return the table with tracklets joined until no pair is left that may be.

    Only pairs with a tracklet that has just been joined are judged anew.
    """
    paths = read_paths(tracks, "tracks to join")
    begin = paths.starts[:-1].copy()
    first = paths.frame[begin]
    pool = Pool(paths.rows, paths.frame, paths.place, begin, paths.starts[1:].copy(), first)
    changed = np.ones(len(begin), dtype=np.bool_)
    known = Pairs(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
    while True:
        new = _with_feature(pool, Pairs(*candidates(pool, changed, limits, weights)), feature)
        stays = ~(changed[known.one] | changed[known.other])
        known = Pairs(*(np.append(a[stays], b) for a, b in zip(known, new, strict=True)))
        chosen = _choose(known, matching)
        if not chosen:
            break
        pool, changed = _merge(pool, chosen)
    return _write(tracks, pool)


def _with_feature(pool: Pool, pairs: Pairs, feature: Feature) -> Pairs:
    """Return the pairs with the last term of Eq. 4.24 in their cost."""
    if feature.differences is None:
        return pairs
    cost = pairs.cost.copy()
    for number, (i, k) in enumerate(zip(pairs.one.tolist(), pairs.other.tolist(), strict=True)):
        end, start = pool.end[i] - 1, pool.begin[k]
        last = int(max(pool.frame[end], pool.frame[pool.end[k] - 1]))
        energy = feature.measure(
            (pool.place[end, 0], pool.place[end, 1]),
            (pool.place[start, 0], pool.place[start, 1]),
            (int(pool.first[i]), last),
            feature.differences,
        )
        cost[number] += feature.weight / max(energy, 1.0)
    return Pairs(pairs.one, pairs.other, cost)


def _choose(pairs: Pairs, matching: Matching) -> list[tuple[int, int]]:
    """Return the pairs to join now.

    Where a matching names a tracklet twice, the cheaper pair is joined first and the
    other one meets the joined tracklet in the next iteration.
    """
    found = matching(pairs)
    order = np.lexsort((pairs.other[found], pairs.one[found], pairs.cost[found]))
    used: set[int] = set()
    chosen = []
    for number in found[order].tolist():
        pair = int(pairs.one[number]), int(pairs.other[number])
        if used.isdisjoint(pair):
            used.update(pair)
            chosen.append(pair)
    return chosen


def _merge(pool: Pool, chosen: list[tuple[int, int]]) -> tuple[Pool, npt.NDArray[np.bool_]]:
    """Return the pool with the pairs joined, and which tracklets have changed."""
    begin, end = pool.begin.copy(), pool.end.copy()
    changed = np.zeros(len(begin), dtype=np.bool_)
    added = [merged(pool, i, k) for i, k in chosen]
    size = len(pool.rows)
    for (i, k), (rows, _, _) in zip(chosen, added, strict=True):
        stays, goes = min(i, k), max(i, k)
        begin[stays], end[stays] = size, size + len(rows)
        begin[goes] = end[goes] = 0
        size += len(rows)
        changed[[i, k]] = True
    rows, frame, place = (
        np.concatenate([old, *new])
        for old, new in zip(pool[:3], zip(*added, strict=True), strict=True)
    )
    return Pool(rows, frame, place, begin, end, pool.first), changed


def _write(tracks: pd.DataFrame, pool: Pool) -> pd.DataFrame:
    """Return the table with the tracklets of the pool; rows merged away get particle -1."""
    lengths = pool.end - pool.begin
    starts = np.append(0, np.cumsum(lengths)).astype(np.int64)
    points = np.repeat(pool.begin - starts[:-1], lengths) + np.arange(starts[-1])
    paths = Paths(pool.rows[points], pool.frame[points], pool.place[points], starts)
    return write_paths(tracks, paths, paths.names())
