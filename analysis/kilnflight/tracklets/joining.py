"""Joining of tracklets of one particle: connection, merging and fusion.

Sections 4.2.3 and 4.2.4 of the thesis.
"""

import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np

from kilnflight.arrays import Array, Flags, Index, Integers, Whole
from kilnflight.association import assign
from kilnflight.checks import NotNegative, Positive, Settings, Unlimited
from kilnflight.compiled import compiled
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
        limits = np.array([self.gap, self.overlap, self.distance, self.jump])
        tested = paths, changed, limits, self.nested
        parts = list[Candidates]()
        begin = 0
        while not parts or begin < len(changed):
            pairs, usual, begin = _near(*tested, begin, MOST_PAIRS)
            parts.append(self._possible(paths, pairs, usual))
        return Candidates(*map(np.concatenate, zip(*parts, strict=True)))

    def _possible(self, paths: Paths, pairs: Index, usual: Array) -> Candidates:
        """Return those of some pairs that are within the limits, with their cost.

        ``pairs`` and ``usual`` are those of `_near`.
        """
        earlier, later, gap, *fields = pairs.reshape(-1, 6).T
        overlap = Overlap(*fields)
        median, largest = usual[:, [earlier, later]].max(axis=1)
        limit = median + self.jump
        parts = connected_parts(paths, earlier, later, overlap)
        turned, allowed = self._judge(*parts, limit)
        cost = turned + self.costs.overlap * overlap.common
        cost += self.costs.gap * np.maximum(gap, 0)
        most = np.maximum(limit, largest)
        joined = np.flatnonzero(allowed & (gap <= 0))
        # Steps within an overlap, too, must not be faster. That keeps tracklets far
        # apart from being joined, which Eq. 4.18 alone does not (section 4.2.3).
        both = np.append(earlier[joined], later[joined])
        owner, points = ranges(paths.starts[both], paths.starts[both + 1])
        count = len(joined)
        names, _, *place = _united(paths, owner % count, points, owner >= count)
        pair, speed = step_speeds(names, *place)
        allowed[joined[pair[speed > most[joined[pair]]]]] = False
        return _take(Candidates(earlier, later, cost), allowed)

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
    """Overlap in time of the tracklets of p pairs, (p,) each.

    Points are indices in `Paths`. Without a common frame, the earlier tracklet ends
    before the later one starts, and the later one starts after the earlier one ends.
    """

    common: Integers  # number of common frames
    # past the earlier one's last point to connect: its first common frame's
    until: Integers
    since: Integers  # the later one's first point to connect: its last common frame's


@compiled
def _near(
    paths: Any, changed: Any, limits: Any, nested: bool, begin: int, most: int
) -> Any:
    """Return the pairs with a changed tracklet (m,) that are near in time and place.

    ``limits`` are gap, overlap, distance and jump of `Joining`. Some ``most`` come at a
    time, those of the tracklets from ``begin`` on. Compiled, ten times faster than
    with arrays of all pairs.

    Returns
    -------
    pairs
        (6 p,): earlier tracklet, later one, gap in frames, which is 0 or less if they
        overlap, and the fields of `Overlap`.
    usual
        (2, m) median and largest speed in px/frame of each tracklet of a pair.
    end
        ``begin`` of the next pairs; m: there are none.
    """
    usual = np.full((2, len(changed)), -1.0)
    found = [0 for _ in range(0)]
    there = np.flatnonzero(np.diff(paths.starts))
    first = np.zeros_like(paths.starts)
    last = np.zeros_like(paths.starts)
    first[there] = paths.frame[paths.starts[there]]
    last[there] = paths.frame[paths.starts[there + 1] - 1]
    missed = last[:-1] - first[:-1] + 1 - np.diff(paths.starts)
    for n in range(begin, len(there)):
        if len(found) > 6 * most:
            return np.array(found), usual, n
        for other in there[n + 1 :]:
            i = there[n]
            k = other
            if first[k] - last[i] >= max(limits[0], 1):
                break
            if not (changed[i] or changed[k]):
                continue
            # If two start together, the one that ends first is the earlier.
            if first[i] == first[k] and last[k] < last[i]:
                i = other
                k = there[n]
            # They share at least the overlap less the frames that both miss.
            gap = first[k] - last[i]
            shared = min(1 - gap, last[k] - first[k] + 1) - missed[i] - missed[k]
            possible = nested or last[k] > last[i]
            possible &= gap > 0 or shared < limits[1]
            if possible:
                both = _overlap_within(paths, i, k, gap, limits, usual)
                if both[0] >= 0:
                    found.extend((i, k, gap, *both))
    return np.array(found), usual, len(changed)


@compiled
def _overlap_within(
    paths: Any, i: int, k: int, gap: int, limits: Any, usual: Any
) -> Any:
    """Return the `Overlap` of a pair, of which ``common`` is -1 beyond the limits."""
    _, overlap, distance, jump = limits
    mean, both = overlap_in_time(paths, i, k, overlap, distance)
    if gap <= 0 and (both[0] >= overlap or mean > distance):  # Eq. 4.21
        return -1, 0, 0
    for path in (i, k):
        if usual[0, path] < 0:
            usual[:, path] = _speeds(paths, path)
    if gap > 0:
        # The step over the gap is one of the connected part.
        end = paths.place[paths.starts[i + 1] - 1]
        start = paths.place[paths.starts[k]]
        step = math.hypot(start[0] - end[0], start[1] - end[1])
        if step > _MORE * gap * (max(usual[0, i], usual[0, k]) + jump):
            return -1, 0, 0
    return both


@compiled
def _speeds(paths: Any, path: int) -> Any:
    """Return the median and the largest speed (2,) of a tracklet; 0 without a step."""
    start = paths.starts[path]
    end = paths.starts[path + 1]
    steps = paths.place[start + 1 : end] - paths.place[start : end - 1]
    frames = np.diff(paths.frame[start:end])
    if not len(frames):
        return np.zeros(2)
    speeds = np.hypot(steps[:, 0] / frames, steps[:, 1] / frames)
    return np.array([np.median(speeds), speeds.max()])


@compiled
def overlap_in_time(
    paths: Any, i: int, k: int, most: float = np.inf, distance: float = np.inf
) -> Any:
    """Return the mean distance in the common frames in px, and the `Overlap`.

    The tracklet i starts earlier, k later; both are indices in ``paths``. Without a
    common frame the distance is infinite. The count ends where there are ``most``
    common frames or the mean must exceed ``distance``.
    """
    one = paths.starts[i]
    end = paths.starts[i + 1]
    other = paths.starts[k]
    other_end = paths.starts[k + 1]
    # As far on as frames have passed, and back over those without a point.
    one = min(end, one + paths.frame[other] - paths.frame[one])
    while one > paths.starts[i] and paths.frame[one - 1] >= paths.frame[other]:
        one -= 1
    last = min(paths.frame[end - 1], paths.frame[other_end - 1])
    farthest = distance * _MORE * (last - paths.frame[other] + 1)
    until = one
    since = other
    common = 0
    total = 0.0
    while one < end and other < other_end and common < most and total <= farthest:
        later = paths.frame[one] - paths.frame[other]
        if later == 0:
            if common == 0:
                until = one + 1
            since = other
            common += 1
            row = paths.place[one, 0] - paths.place[other, 0]
            col = paths.place[one, 1] - paths.place[other, 1]
            total += math.sqrt(row * row + col * col)
        one += later <= 0
        other += later >= 0
    if common == 0:
        return np.inf, (0, until, other)
    return total / common, (common, until, since)


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
    # One key of nearly sorted numbers: a sort by three takes three times as long.
    frame = paths.frame[points] - paths.frame[:1].sum()
    key = (names * (frame.max(initial=0) + 1) + frame) * 2 + later
    order = np.argsort(key, kind="stable")
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
