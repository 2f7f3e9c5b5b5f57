"""Joining of tracklets of one particle: connection, merging and fusion.

Sections 4.2.3 and 4.2.4 of the thesis.
"""

from collections.abc import Callable, Iterator
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pandas import Series

from kilnflight.arrays import Array, Flags, Index, Integers, Whole
from kilnflight.association import assign
from kilnflight.checks import NotNegative, Positive, Settings, Unlimited
from kilnflight.tracklets.eliminate import Elimination, regularity
from kilnflight.tracklets.outliers import OutlierRemoval
from kilnflight.tracklets.paths import (
    Paths,
    PathStep,
    means,
    ranges,
    step_speeds,
    turns,
    velocities,
)
from kilnflight.tracklets.texture import level_edge

_OUTLIERS = OutlierRemoval()
_FALSE = Elimination()  # Eqs 4.18 and 4.15, of the connected part
MOST_PAIRS = 2**20  # tested at a time; they take some 500 MB
_MORE = 1 + 1e-9  # a value at the limit may be rounded above it


class Candidates(NamedTuple):
    """Possible pairs of tracklets, p in number: a sparse cost matrix.

    All other pairs are impossible, cost C in Fig. 4.14. Few are possible, so the (m, m)
    matrix is never made.
    """

    earlier: Index  # (p,) index of the tracklet in `Paths`
    later: Index  # (p,) index of the tracklet that follows it
    cost: Array  # (p,) Eq. 4.24, without unit; finite and at least 0


def dual_nearest(pairs: Candidates) -> Index:
    """Return the indices (q,) of pairs that are mutual nearest neighbours, ascending.

    These are the dual nearest neighbours (DNN) of section 4.2.3; the indices are places
    in ``pairs``.

    Notes
    -----
    A tracklet has one nearest neighbour, before or after it, the first one at equal
    cost. So each iteration joins it at most once. The cheapest of all pairs is always
    joined. Source: section 4.2.3, thesis.
    """
    tracklet = np.append(pairs.earlier, pairs.later)
    neighbour = np.append(pairs.later, pairs.earlier)
    order = np.lexsort((neighbour, np.tile(pairs.cost, 2), tracklet))
    first = order[np.unique(tracklet[order], return_index=True)[1]]
    return np.intersect1d(first, first - len(pairs.cost))  # nearest of both


def hungarian(pairs: Candidates) -> Index:
    """Return the indices (q,) of the pairs of least total cost, ascending.

    The indices are places in ``pairs``. As many pairs as possible are taken. This is
    the Kuhn-Munkres method, which Fig. 4.14 compares with `dual_nearest`. Costs must be
    at least 0, and a pair must be listed once. A tracklet may get one partner before
    and one after it.
    """
    order = np.lexsort((pairs.later, pairs.earlier))
    earlier, later, cost = _take(pairs, order)
    most = min(len(np.unique(earlier)), len(np.unique(later)))
    # A tracklet without partner costs more than all pairs together, so no pair is given
    # up.
    alone = 1.0 + cost.max(initial=0.0) * most
    missed = np.full(earlier.max(initial=-1) + 1, alone)
    return np.sort(order[assign(earlier, later, cost, missed)])


class Costs(Settings):
    """Weights of the six terms of the cost of a pair (Eq. 4.24).

    Parameters
    ----------
    angle
        a, 1/degree, Table 5.16.
    change
        b, frame/px, Table 5.16.
    depth
        c, frame/mm, Table 5.16.
    gap
        d, 1/frame, Table 5.16.
    overlap
        e, 1/frame, Table 5.16.
    feature
        f, grey values, Table 5.16.
    """

    angle: NotNegative = 2.0
    change: NotNegative = 2.0
    depth: NotNegative = 0.1
    gap: NotNegative = 1.0
    overlap: NotNegative = 2.0
    feature: NotNegative = 1e11


class Joining(PathStep):
    """Join tracklets of one particle until no allowed pair is left (Fig. 4.8).

    Each iteration joins the pairs that ``matching`` takes, the cheapest first. A merged
    frame keeps one row with the mean row, col, x, y and z. It is the row of the earlier
    tracklet, or of the later where only that has a depth. The other row gets particle
    -1 and keeps its own place.

    Parameters
    ----------
    gap
        Largest number of frames from the end of the one to the start of the other; 0:
        both must overlap.
    overlap
        Number of common frames from which on a pair is not joined.
    distance
        Largest mean distance in the common frames in px; if finite, there must be some.
    depth
        z_eps, change of depth in mm/frame from which on a pair is not joined, Table
        5.16.
    jump
        px/frame by which a step may exceed the usual ones of both tracklets.
    half_width
        w, half width of the window of the texture in px, Table 5.16.
    average
        Whether F of Eq. 4.24 is divided by pixels; see `texture_energy`.
    costs
        Weights of the terms of Eq. 4.24.
    matching
        Function that returns the indices of the pairs to join.
    """

    gap: NotNegative = 0.0
    overlap: Unlimited = np.inf
    distance: Unlimited = np.inf
    depth: Unlimited = 1500.0
    jump: Unlimited = np.inf
    half_width: Positive = 15.0
    average: bool = False
    costs: Costs = Costs()
    matching: Callable[[Candidates], Index] = dual_nearest
    # Whether the later tracklet may end before the earlier one.
    nested: ClassVar[bool] = False

    def apply(self, paths: Paths, differences: Any = None) -> Paths:
        """Return the tracklets, joined until no pair is within the limits.

        ``differences`` (frames, rows, cols) are differences of frames and background,
        in grey values. Without them the last term of Eq. 4.24, for the streak, is left
        out. In each iteration only pairs with a tracklet that was just joined get a new
        cost.
        """
        changed = np.ones(len(paths.starts) - 1, bool)
        none: Any = np.empty(0, np.intp)
        known = Candidates(none, none, none)
        while True:
            new = self.candidates(paths, changed)
            if differences is not None:
                new = self._with_feature(paths, new, differences)
            old = _take(known, ~(changed[known.earlier] | changed[known.later]))
            known = Candidates(*map(np.append, old, new))
            chosen = _once(_take(known, self.matching(known)))
            if not len(chosen.earlier):
                return paths.grouped(paths.names())
            paths = _merge(paths, chosen)
            changed[:] = False
            changed[chosen.earlier] = True
            changed[chosen.later] = True

    def candidates(self, paths: Paths, changed: Flags) -> Candidates:
        """Return the p pairs within the limits that hold a changed tracklet.

        ``changed`` (m,) says which of the m tracklets have changed. The cost (p,) is
        Eq. 4.24 without its last term, that of the streak.
        """
        path, speed = step_speeds(paths.names(), paths.frame, paths.place)
        usual = Series(speed).groupby(path).agg(["median", "max"])
        # They are 0 without a step.
        speeds = usual.reindex(range(len(changed)), fill_value=0.0).to_numpy().T
        near = self._in_time(paths, changed)
        parts = [self._possible(paths, pairs, speeds) for pairs in near]
        return Candidates(*map(np.concatenate, zip(*parts, strict=True)))

    def _possible(self, paths: Paths, pairs: Candidates, speeds: Array) -> Candidates:
        """Return those of some pairs that are within the limits, with their cost.

        ``speeds`` (2, m) are the median and the largest speed of all tracklets in
        px/frame.
        """
        overlap = overlap_in_time(paths, pairs.earlier, pairs.later)
        median, largest = speeds[:, [pairs.earlier, pairs.later]].max(axis=1)
        limit = median + self.jump
        # Eq. 4.21, and the step over a gap, which the connected part has, too
        merged = (overlap.common < self.overlap) & (overlap.distance <= self.distance)
        start = paths.place[paths.starts[pairs.later], :2]
        end = paths.place[paths.starts[pairs.earlier + 1] - 1, :2]
        slow = np.hypot(*(start - end).T) <= _MORE * limit * np.maximum(pairs.cost, 1)
        possible = np.where(pairs.cost > 0, slow, merged)
        pairs = _take(pairs, possible)
        overlap = _take(overlap, possible)
        limit = limit[possible]
        parts = connected_parts(paths, pairs.earlier, pairs.later, overlap)
        turned, allowed = self._judge(*parts, limit)
        gap = np.maximum(pairs.cost, 0)
        cost = turned + self.costs.overlap * overlap.common + self.costs.gap * gap
        most = np.maximum(limit, largest[possible])
        joined = np.flatnonzero(allowed & (pairs.cost <= 0))
        # Steps within an overlap, too, must not be faster. That keeps tracklets far
        # apart from being joined, which Eq. 4.18 alone does not (section 4.2.3).
        both = np.append(pairs.earlier[joined], pairs.later[joined])
        owner, points = ranges(paths.starts[both], paths.starts[both + 1])
        count = len(joined)
        names, _, *place = _united(paths, owner % count, points, owner >= count)
        pair, speed = step_speeds(names, *place)
        allowed[joined[pair[speed > most[joined[pair]]]]] = False
        return _take(pairs._replace(cost=cost), allowed)

    def _in_time(self, paths: Paths, changed: Flags) -> Iterator[Candidates]:
        """Yield the pairs near enough in time that hold a changed tracklet (m,).

        Their cost (p,) is here the gap in frames; 0 or less means that they overlap.
        Some `MOST_PAIRS` come at a time.
        """
        there = np.flatnonzero(np.diff(paths.starts))
        first = paths.frame[paths.starts[there]]
        last = paths.frame[paths.starts[there + 1] - 1]
        missing = last - first + 1 - np.diff(paths.starts)[there]
        low = np.minimum.reduceat(paths.place[:, :2], paths.starts[there])
        high = np.maximum.reduceat(paths.place[:, :2], paths.starts[there])
        until = np.searchsorted(first, np.maximum(last + 1, last + self.gap))
        for one, other in _pairs_up_to(until):
            # If two start together, the one that ends first is the earlier.
            swapped = (first[one] == first[other]) & (last[other] < last[one])
            i = np.where(swapped, other, one)
            k = np.where(swapped, one, other)
            taken = changed[there[i]] | changed[there[k]]
            if not self.nested:
                taken &= last[k] > last[i]
            i = i[taken]
            k = k[taken]
            gap = first[k] - last[i]
            # Overlapping ones share at least the overlap less the frames that both
            # miss, and are at least as far apart as their boxes: Eq. 4.21 forbids some
            # at once.
            common = np.minimum(last[i], last[k]) - first[k] + 1
            common -= missing[i] + missing[k]
            apart = np.maximum(low[i] - high[k], low[k] - high[i]).max(axis=1)
            merged = (apart <= self.distance * _MORE) & (common < self.overlap)
            pairs = Candidates(earlier=there[i], later=there[k], cost=gap.astype(float))
            yield _take(pairs, merged | (gap > 0))

    def _judge(
        self, names: Index, frame: Whole, place: Array, limit: Array
    ) -> tuple[Array, Flags]:
        """Return three terms of Eq. 4.24 and which pairs are allowed, (p,) each.

        The terms are those of angle, change and depth. Allowed are connected parts
        without outliers (Eq. 4.18), not false (Eq. 4.15) and without a jump in depth
        (Eq. 4.22).

        Parameters
        ----------
        names
            (q,) pair of each point of the connected parts.
        frame, place
            (q,) its frame and (q, 3) its row, col (px) and z (mm).
        limit
            (p,) largest speed in px/frame.
        """
        steps = velocities(frame, place)
        count = len(limit)
        angle, change = turns(steps[:-1], steps[1:])
        within = names[2:] == names[:-2]
        part = names[2:][within]
        turned = (self.costs.angle * angle + self.costs.change * change)[within]
        sharp = (angle > _OUTLIERS.angle_deg) & (change > _OUTLIERS.change)
        path, speed = step_speeds(names, frame, place)
        allowed = means(path, speed, count) > _FALSE.speed
        allowed &= regularity(names, frame, place) > _FALSE.regularity
        allowed[part[sharp[within]]] = False
        allowed[path[speed > limit[path]]] = False
        deep = ~np.isnan(place[:, 2])
        within = np.diff(names[deep]) == 0
        rate = np.abs(velocities(frame[deep], place[deep, 2:])[within, 0])
        deeper = names[deep][1:][within]
        cost = means(part, turned, count)
        cost += self.costs.depth * means(deeper, rate, count)
        allowed[deeper[rate >= self.depth]] = False  # Eq. 4.22
        return cost, allowed

    def _with_feature(
        self, paths: Paths, pairs: Candidates, differences: Any
    ) -> Candidates:
        """Return the pairs, the last term of Eq. 4.24 added to their cost (p,).

        The term is f / F, F the level-edge energy of ``differences`` (frames, rows,
        cols): small if a streak runs from the end of the earlier tracklet to the start
        of the later.
        """
        first = paths.starts[:-1]
        last = paths.starts[1:] - 1
        energy = np.zeros(len(pairs.cost))
        for n, (i, k) in enumerate(zip(pairs.earlier, pairs.later, strict=True)):
            start = paths.place[last[i], :2]
            end = paths.place[first[k], :2]
            period = paths.frame[first[i]], paths.frame[last[[i, k]]].max()
            energy[n] = level_edge(
                start, end, period, differences, self.half_width, self.average
            )
        streak = self.costs.feature / np.maximum(energy, 1.0)
        return pairs._replace(cost=pairs.cost + streak)


class Connection(Joining):
    """Connect tracklets over a gap and merge those that overlap (section 4.2.3).

    Notes
    -----
    Readings. (1) Eq. 4.21 holds case by case; with its "or" every pair would pass. (2)
    Of two tracklets the one that starts first is the earlier; of two that start
    together the one that ends first. The later one must end after the earlier one (Fig.
    4.9); one within another continues nothing and is left to `Fusion`. (3) A tracklet
    with fewer than three points gives what it has to the connected part. One common
    frame counts as one point, the mean; of two that overlap without a common frame, the
    points before and after the overlap count. (4) The terms of Eq. 4.24 are means over
    the connected part, 0 without a value. Weight d is for the gap and e for the
    overlap, as printed (the sentence after it and Table 5.16 agree). (5) Without
    ``differences`` the last term is left out. (6) A tracklet is joined once per
    iteration (`dual_nearest`). (7) The text says of Eq. 4.18 that it "avoids connecting
    two trajectories far apart". As printed it spares a jump straight ahead, however
    far, and to and fro between two that overlap. So no step of the connected part may
    be faster than both tracklets usually are (the larger of their median steps) by more
    than ``jump``, the change of velocity that Eq. 4.18 allows. Nor may a step of the
    joined tracklet, unless one of the two has such a step itself. Source: Eqs 4.21 to
    4.25 and Fig. 4.14, thesis.

    Parameters
    ----------
    gap
        t_eps connect, frames, Table 5.16.
    overlap
        kn_eps merge, common frames, Table 5.16.
    jump
        Delta V_eps, px/frame, Table 5.16; see (7).
    distance, depth, half_width, average, costs, matching
        As for `Joining`.

    Examples
    --------
    See `kilnflight.tracklets.postprocess`; here the gap is too long.

    >>> import pandas as pd
    >>> tracks = pd.DataFrame({"frame": [*range(9), *range(12, 20)], "col": 7.0})
    >>> tracks["row"] = 5.0 * tracks["frame"]
    >>> tracks["particle"] = (tracks["frame"] > 9).astype(int)
    >>> Connection(gap=3.0)(tracks)["particle"].nunique()
    2
    """

    gap: NotNegative = 15.0
    overlap: Unlimited = 5.0
    jump: Unlimited = 18.0


class Fusion(Joining):
    """Fuse trajectories that overlap in time, however long.

    As `Connection` but for the limit on common frames and the terms for gap and
    overlap.

    Notes
    -----
    Readings. (1) The text sets no limit to the distance of two trajectories. The
    connected part then bounds it only by the velocity of the jump from one to the
    other. Over 40 common frames, 200 px are 5 px/frame, and neighbours would be fused.
    So their mean distance in the common frames must not exceed ``distance``, and there
    must be such frames. Its value is the "epsilon = 10 pixel" that Table 5.16 lists
    without a place in chapter 4.2. It may as well be the gate of Eq. 5.1, which has no
    other value. (2) A trajectory within another may be fused: duplicates are often
    shorter. (3) Points, rows and depths are treated as in `Connection`. Source: section
    4.2.4, thesis.

    Parameters
    ----------
    distance
        epsilon, px, Table 5.16; see (1).
    costs
        Weights of the terms of Eq. 4.24; section 4.2.4 omits those for gap and overlap.
    gap, overlap, depth, jump, half_width, average, matching
        As for `Joining`.

    Examples
    --------
    Two tracklets of 20 frames each are 3 px apart.

    >>> import pandas as pd
    >>> tracks = pd.DataFrame({"frame": [*range(20)] * 2})
    >>> tracks["particle"] = [0] * 20 + [1] * 20
    >>> tracks = tracks.assign(row=5.0 * tracks["frame"], col=3.0 * tracks["particle"])
    >>> Fusion()(tracks)["particle"].unique().tolist()
    [0, -1]
    """

    distance: Unlimited = 10.0
    costs: Costs = Costs(gap=0.0, overlap=0.0)
    nested: ClassVar[bool] = True


class Overlap(NamedTuple):
    """Overlap in time of the tracklets of p pairs, (p,) each."""

    common: Integers  # number of common frames
    distance: Array  # mean distance in the common frames, px; infinite without any
    # past the earlier one's last point to connect: its first common frame's
    until: Integers
    since: Integers  # the later one's first point to connect: its last common frame's


def _pairs_up_to(until: Index) -> Iterator[tuple[Index, Integers]]:
    """Yield all pairs of m tracklets with those after them, up to ``until`` (m,).

    Some `MOST_PAIRS` come at a time, (p,) each.
    """
    begin = np.arange(len(until)) + 1
    part = np.cumsum(until - begin) // MOST_PAIRS
    for rows in np.split(begin - 1, np.flatnonzero(np.diff(part)) + 1):
        one, other = ranges(begin[rows], until[rows])
        yield rows[one], other


def overlap_in_time(paths: Paths, i: Index, k: Index) -> Overlap:
    """Return the common frames of p pairs, and where to cut both to connect them.

    ``i`` (p,) are the tracklets that start earlier, ``k`` (p,) the later ones, as
    indices in ``paths``. ``until`` and ``since`` are indices of its points. Without a
    common frame, the earlier one ends before the later one starts, and the later one
    starts after the earlier ends.
    """
    low = paths.frame.min(initial=0)
    width = paths.frame.max(initial=0) - low + 2
    key = paths.names() * width + paths.frame - low  # ascends
    first = paths.frame[paths.starts[k]] - low
    last = paths.frame[paths.starts[i + 1] - 1] - low
    before = np.searchsorted(key, i * width + first)
    after = np.searchsorted(key, k * width + last, side="right")
    pair, point = ranges(before, paths.starts[i + 1])
    # The key of each point's frame in the later tracklet.
    same = k[pair] * width + paths.frame[point] - low
    match = np.minimum(np.searchsorted(key, same), len(key) - 1)
    both = key[match] == same
    pair = pair[both]
    point = point[both]
    match = match[both]
    common = np.bincount(pair, minlength=len(i))
    apart = np.hypot(*(paths.place[point, :2] - paths.place[match, :2]).T)
    distance = np.where(common > 0, means(pair, apart, len(i)), np.inf)
    # The last assignment counts: the first common frame, then the last one.
    before[pair[::-1]] = point[::-1] + 1
    after[pair] = match
    return Overlap(common=common, distance=distance, until=before, since=after)


def connected_parts(
    paths: Paths, i: Index, k: Index, overlap: Overlap
) -> tuple[Any, Any, Any]:
    """Return the connected parts of p pairs of tracklets as q points (Fig. 4.10).

    A part has the last three points of the earlier tracklet i and the first three of
    the later one k. In an overlap the former end with the first common frame and the
    latter start with the last. A single common frame is one point, the mean of both.

    Returns
    -------
    names : array (q,)
        Pair of each point, an index in ``i`` and ``k``; ascending.
    frame : array (q,)
        Frame of each point, ascending within a pair.
    place : array (q, 3)
        Row and col in px, z in mm or NaN.
    """
    three = np.arange(3)[:, None]
    point = np.append(overlap.until - 3 + three, overlap.since + three, axis=0)
    there = np.concatenate(
        [point[:3] >= paths.starts[i], point[3:] < paths.starts[k + 1]]
    )
    point = np.where(there, point, 0)
    frame = paths.frame[point]
    place = paths.place[point, :3]
    single = overlap.common == 1
    place[2, single] = _mean(place[2, single], place[3, single])
    there[3, single] = False
    names = np.broadcast_to(np.arange(len(i)), there.shape)
    return names.T[there.T], frame.T[there.T], place.swapaxes(0, 1)[there.T]


def _once(pairs: Candidates) -> Candidates:
    """Return the pairs to join in this iteration, cheapest first, each tracklet once.

    Where the matching takes two pairs of one tracklet, the dearer waits for the next
    iteration.
    """
    used = set[int]()
    chosen = list[int]()
    for k in np.lexsort((pairs.later, pairs.earlier, pairs.cost)).tolist():
        pair = pairs.earlier[k], pairs.later[k]
        if used.isdisjoint(pair):
            used.update(pair)
            chosen.append(k)
    return _take(pairs, np.array(chosen, np.int64))


def _merge(paths: Paths, chosen: Candidates) -> Paths:
    """Return the paths with the chosen pairs joined.

    A joined tracklet gets the lower of its two numbers. The other number remains, with
    no points, so that indices in known `Candidates` stay valid.
    """
    number = np.arange(len(paths.starts) - 1)
    later = np.isin(number, chosen.later)
    higher = np.maximum(chosen.earlier, chosen.later)
    number[higher] = np.minimum(chosen.earlier, chosen.later)
    of = paths.names()
    points = np.arange(len(paths.rows))
    names, rows, frame, place = _united(paths, number[of], points, later[of])
    starts = np.searchsorted(names, np.arange(len(number) + 1))
    return Paths(rows=rows, frame=frame, place=place, starts=starts)


def _united(
    paths: Paths, names: Index, points: Integers, later: Flags
) -> tuple[Any, ...]:
    """Return names, rows, frames and places of points, one in each frame of a name.

    ``points`` (q,) are indices in `Paths`, ``names`` (q,) their tracklets after
    joining, ``later`` (q,) says which come from the later one. Results are (r,) and (r,
    3 or more), r <= q, sorted by name and frame. In a common frame the place is the
    mean of both. The row is that of the earlier one, unless only the later one has a
    depth.
    """
    order = np.lexsort((later, paths.frame[points], names))
    names = names[order]
    points = points[order]
    rows = paths.rows[points]
    frame = paths.frame[points]
    place = paths.place[points]
    twice = np.flatnonzero((np.diff(names) == 0) & (np.diff(frame) == 0))
    blind = np.isnan(place[twice, 2]) & ~np.isnan(place[twice + 1, 2])
    rows[twice] = np.where(blind, rows[twice + 1], rows[twice])
    place[twice] = _mean(place[twice], place[twice + 1])
    kept = np.delete(np.arange(len(rows)), twice + 1)
    return names[kept], rows[kept], frame[kept], place[kept]


def _take(table: Any, chosen: Flags | Integers) -> Any:
    """Return the chosen entries of every array of `Candidates` or `Overlap`.

    ``chosen`` are flags (p,) or indices (q,).
    """
    return type(table)(*(values[chosen] for values in table))


def _mean(first: Array, second: Array) -> Array:
    """Return the mean of two arrays of places; of a NaN and a value, the value."""
    return (np.fmin(first, second) + np.fmax(first, second)) / 2
