"""The motion of particles, from nearest neighbours in consecutive pictures.

A belt or a flow moves all particles alike: the common step is where the differences of
positions crowd. What is left after it is the spread of velocities and their change.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from pandas import DataFrame
from scipy.spatial import KDTree

from kilnflight.arrays import Array, Integers, Pair
from kilnflight.checks import check_number
from kilnflight.recording.frames import Recording
from kilnflight.tracking.filter import ConstantVelocity, Gate, Motion
from kilnflight.tracking.tracker import read_detections

REACH = 0.1  # share of the picture's longer side: the longest common step searched for
NEAR_PX = 2.0  # differences of positions that count as one step
PAIRS = 60  # pairs of consecutive pictures; more take longer and change nothing
OF_90_PERCENT = 2.15  # standard deviations, of a distance in two dimensions
OF_99_PERCENT = 3.03
MOST_LINKS = 20_000  # in which the largest turn is looked for, to save time
FAR = 4.0  # times a change of step, neighbours are not mistaken; choice
LEAST_PX = 0.1  # no spread is taken smaller
NONE = np.empty((0, 2))


def motion_of(detections: DataFrame, max_step: float | None = None) -> Motion:
    """Return the motion that the first links of detections show.

    Parameters
    ----------
    detections
        Columns frame, row, col (px).
    max_step
        Longest step in px a frame; None: as the links tell.

    Notes
    -----
    A link is a pair of nearest neighbours of each other. The spread of its steps is
    that of a new track's velocity; the spread of changes of step is the noise of the
    acceleration. If that is the larger one, steps do not depend on those before, and
    particles wander. Quantiles are taken, as a tenth may be false links.
    """
    limit = np.inf
    if max_step is not None:
        limit = check_number(max_step, "max_step", above=0)
    places = {each.frame: each.positions for each in read_detections(detections)}
    every = np.array([t for t in sorted(places) if t + 1 in places], int)
    starts = every[:: 1 + len(every) // PAIRS]
    reach = min(REACH * _width(places), limit)
    flow = common_step([(places[t], places[t + 1]) for t in starts], reach)
    steps, changes = _links(places, starts, flow, limit)
    apart = np.hypot(*(steps - flow).T)
    turned = np.hypot(*changes.T)
    first = ConstantVelocity().spreads[1]
    if len(apart):
        first = np.quantile(apart, 0.9) / OF_90_PERCENT
    change = first
    if len(turned):
        change = np.quantile(turned, 0.9) / OF_90_PERCENT
    inert = change <= first
    if inert and len(apart):  # a few may be much slower than the rest
        first = max(first, np.quantile(apart, 0.99) / OF_99_PERCENT)
    if max_step is not None:
        first = max_step / Gate().distance
    first = _rounded(first)
    velocity = tuple(flow.round(2).tolist())
    if not inert:
        return Wandering(velocity, (_place_error(first), 1e-3), first)
    # Where neighbours are far apart, a link with a large change of the step is right: a
    # particle has bounced. The gate takes what is less than that.
    between = neighbour_px(detections)
    some = every[:: 1 + len(detections) // MOST_LINKS]
    _, changes = _links(places, some, flow, between / FAR)
    largest = np.hypot(*changes.T).max(initial=0.0)
    turn = largest / Gate().distance
    if FAR * largest <= between and turn > 2 * change:
        change = turn
    change = min(_rounded(change), first)
    return Motion(velocity, (_place_error(change), first), change)


def _place_error(noise: float) -> float:
    """Return the standard deviation of a first position in px, for a motion's noise."""
    return max(noise / 4, 0.3)


def neighbour_px(detections: DataFrame) -> float:
    """Return the median distance of nearest neighbours in 30 frames.

    It is infinite where no frame has two detections.
    """
    places = [
        at.to_numpy(float) for _, at in detections.groupby("frame")[["row", "col"]]
    ]
    some = [each for each in places[:: 1 + len(places) // 30] if len(each) > 1]
    if not some:
        return np.inf
    apart = [KDTree(each).query(each, [2])[0] for each in some]
    return np.median(np.concatenate(apart))


def _width(places: Mapping[int, Array]) -> float:
    """Return the larger extent in px of all positions by frame."""
    if not places:
        return 0.0
    return np.ptp(np.concatenate(list(places.values())), axis=0).max()


def _links(
    places: Mapping[int, Array], starts: Integers, flow: Array, limit: float
) -> Pair:
    """Return the steps (n, 2) of linked particles and their changes (m, 2), in px.

    Links go from each start to the next frame, and on to the one after.
    """
    steps = [NONE]
    changes = [NONE]
    for t in starts:
        before, middle = places[t], places[t + 1]
        after = places.get(t + 2, NONE)
        i, k = _linked(before, middle, flow, limit)
        first = middle[k] - before[i]
        steps.append(first)
        j, n = _linked(middle, after, flow, limit)
        _, one, other = np.intersect1d(k, j, return_indices=True)
        changes.append(after[n[other]] - middle[j[other]] - first[one])
    return np.concatenate(steps), np.concatenate(changes)


def _rounded(spread: float) -> float:
    """Return a spread in px with three digits, at least `LEAST_PX`."""
    return float(f"{max(spread, LEAST_PX):.3g}")


class Wandering(Motion):
    """Motion without inertia: steps do not depend on those before."""

    def process_noise(self, frames: float) -> Array:
        """Return the covariance (4, 4) after some frames; the velocity stays."""
        moved = self.noise**2 * frames
        return np.diag([moved, moved, 0.0, 0.0])


def common_step(pairs: Sequence[Pair], reach: float) -> Array:
    """Return the step (2,) in px that most particles make.

    It is 0 if that step brings the particles no nearer to each other.

    Parameters
    ----------
    pairs
        Positions (n, 2) and (m, 2) in consecutive pictures.
    reach
        Longest step in px that is searched for.
    """
    none = np.zeros(2)
    parts = [NONE]
    for before, after in pairs:
        few = before[:: 1 + len(before) * len(after) // 2_000_000]  # bounds memory
        near = KDTree(few).sparse_distance_matrix(
            KDTree(after), reach, output_type="ndarray"
        )
        parts.append(after[near["j"]] - few[near["i"]])
    steps = np.concatenate(parts)
    if not len(steps):
        return none
    tree = KDTree(steps)
    some = steps[:: 1 + len(steps) // 4000]
    crowd = some[tree.query_ball_point(some, NEAR_PX, return_length=True).argmax()]
    flow = np.median(steps[tree.query_ball_point(crowd, NEAR_PX)], axis=0)
    if _median_gap(pairs, flow) < 0.5 * _median_gap(pairs, none):
        return flow
    return none


def _median_gap(pairs: Sequence[Pair], step: Array) -> float:
    """Return the median distance of moved positions from the nearest one after."""
    gaps = [KDTree(after).query(before + step)[0] for before, after in pairs]
    return np.median(np.concatenate(gaps))


def _linked(
    before: Array, after: Array, flow: Array, limit: float
) -> tuple[Integers, Integers]:
    """Return pairs of nearest neighbours of each other, as two (k,)."""
    if not len(after):
        return np.empty(0, int), np.empty(0, int)
    expected = before + flow
    apart, to = map(np.asarray, KDTree(after).query(expected))
    back = np.asarray(KDTree(expected).query(after)[1])
    mutual = np.flatnonzero((back[to] == np.arange(len(before))) & (apart <= limit))
    return mutual, to[mutual]


def more_rests(moving: Sequence[Array], every: Sequence[Array]) -> bool:
    """Return whether so many particles rest that a median would take them away.

    Parameters
    ----------
    moving
        Row, col, radius and strength (n, 4) of the spots over a median, by frame.
    every
        The same of the spots over each frame's surroundings.

    Notes
    -----
    More rest where the median leaves a fiftieth of the spots that are at least half as
    strong as what it leaves, or less than 0.87 of a spot's strength; of a slow disc it
    leaves crescents. 0.87 was set on simulated films: above 0.89 the median is right.
    """
    left = np.concatenate(moving)[:, 3]
    least = 0.0
    if len(left):
        least = np.median(left) / 2
    total = (np.concatenate(every)[:, 3] >= least).sum()
    if 50 * len(left) < total:
        return True
    shares = [np.empty(0)]  # of its strength, that a median leaves of each spot
    for spots, whole in zip(moving, every, strict=True):
        if len(whole):
            apart, which = map(np.asarray, KDTree(whole[:, :2]).query(spots[:, :2]))
            same = apart < whole[which, 2] + NEAR_PX
            shares.append((spots[:, 3] / whole[which, 3])[same])
    share = np.concatenate(shares)
    return bool(len(share) and np.median(share) < 0.87)


def shaken_px(recording: Recording) -> float:
    """Return by how many px the ground moves from frame to frame; 0 without a texture.

    In the first 13 frames what is brighter and darker than its surroundings is
    registered by phase correlation; a steady drift is no shaking. Particles that move
    by themselves cover too little: their frames agree by less than 0.6 (set on
    simulated films).
    """
    frames = []
    for t in range(13):
        gray = recording.gray(t).astype(np.float32)
        frames.append(np.sign(gray - cv2.GaussianBlur(gray, (0, 0), 8.0)))
    window = cv2.createHanningWindow(frames[0].shape[::-1], 5)
    found = [cv2.phaseCorrelate(frames[0], each, window) for each in frames[1:]]
    if np.median([alike for _, alike in found]) < 0.6:
        return 0.0
    steps = np.diff([place for place, _ in found], axis=0)
    return np.median(np.hypot(*(steps - np.median(steps, axis=0)).T))
