"""The motion of particles, from nearest neighbours in consecutive pictures.

A belt or a flow moves all particles alike: the common step is where the differences of
positions crowd. What is left after it is the spread of velocities and their change.
"""

from collections.abc import Sequence

import cv2
import numpy as np
import pandas as pd
from scipy.spatial import KDTree

from kilnflight.arrays import Array, Integers, Single
from kilnflight.checks import check_number
from kilnflight.recording.frames import Recording
from kilnflight.tracking.filter import ConstantVelocity, Gate, Motion
from kilnflight.tracking.tracker import read_detections

REACH = (
    0.1  # of the picture's longer side: the longest common step that is searched for
)
NEAR_PX = 2.0  # differences of positions that count as one step
PAIRS = 60  # of consecutive pictures; more take longer and change nothing


def motion_of(detections: pd.DataFrame, max_step: float | None = None) -> Motion:
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
    particles wander. Quantiles of 90 % are 2.15 standard deviations in two dimensions;
    a tenth may be false links.
    """
    if max_step is not None:
        check_number(max_step, "max_step", above=0)
    places = {each.frame: each.positions for each in read_detections(detections)}
    starts = np.array([t for t in sorted(places) if t + 1 in places], int)
    starts = starts[:: 1 + len(starts) // PAIRS]
    limit = np.inf if max_step is None else max_step
    wide = (
        np.ptp(np.concatenate(list(places.values())), axis=0).max() if places else 0.0
    )
    reach = min(REACH * wide, limit)
    flow = common_step([(places[t], places[t + 1]) for t in starts], reach)
    steps = [np.empty((0, 2))]
    changes = [np.empty((0, 2))]
    for t in starts:
        before, middle, after = (places.get(t + k, np.empty((0, 2))) for k in range(3))
        i, k = _linked(before, middle, flow, limit)
        first = middle[k] - before[i]
        steps.append(first)
        j, n = _linked(middle, after, flow, limit)
        _, one, other = np.intersect1d(k, j, return_indices=True)
        changes.append(after[n[other]] - middle[j[other]] - first[one])
    apart = np.hypot(*(np.concatenate(steps) - flow).T)
    turned = np.hypot(*np.concatenate(changes).T)
    spread = (
        np.quantile(apart, 0.9) / 2.15 if len(apart) else ConstantVelocity().spreads[1]
    )
    change = np.quantile(turned, 0.9) / 2.15 if len(turned) else spread
    inert = change <= spread or not len(turned)
    if inert:  # a few may be much slower than the rest
        spread = max(spread, np.quantile(apart, 0.99) / 3.03) if len(apart) else spread
    spread = spread if max_step is None else max_step / Gate().distance
    change = min(change, spread) if inert else spread
    spread, noise = (float(f"{max(value, 0.1):.3g}") for value in (spread, change))
    kind, of_velocity = (Motion, spread) if inert else (Wandering, 1e-3)
    return kind(
        tuple(flow.round(2).tolist()), (max(noise / 4, 0.3), of_velocity), noise
    )


class Wandering(Motion):
    """Motion without inertia: a common velocity, and steps that do not depend on those
    before.
    """

    def process_noise(self, frames: float) -> Array:
        """Return the covariance (4, 4) of the position after some frames; the velocity
        stays.
        """
        return np.diag([self.noise**2 * frames] * 2 + [0.0] * 2)


def common_step(pairs: Sequence[tuple[Array, Array]], reach: float) -> Array:
    """Return the step (2,) in px that most particles make, 0 if it brings them no
    nearer.

    ``pairs`` are positions (n, 2) and (m, 2) in consecutive pictures; ``reach`` is the
    longest step in px that is searched for.
    """
    none = np.zeros(2)
    parts = [np.empty((0, 2))]
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
    apart = [
        np.concatenate(
            [KDTree(after).query(before + step)[0] for before, after in pairs]
        )
        for step in (none, flow)
    ]
    return np.asarray(flow) if np.median(apart[1]) < 0.5 * np.median(apart[0]) else none


def _linked(
    before: Array, after: Array, flow: Array, limit: float
) -> tuple[Integers, Integers]:
    """Return the pairs of positions that are nearest neighbours of each other, two
    (k,).
    """
    if not len(after) or not len(before):
        return np.empty(0, int), np.empty(0, int)
    expected = before + flow
    apart, to = map(np.asarray, KDTree(after).query(expected))
    back = np.asarray(KDTree(expected).query(after)[1])
    mutual = np.flatnonzero((back[to] == np.arange(len(before))) & (apart <= limit))
    return mutual, to[mutual]


def more_rests(moving: Sequence[Array], every: Sequence[Array]) -> bool:
    """Return whether more particles rest than move, so that a median would take them
    away.

    Both are row, col, radius and strength (n, 4) of the spots in some frames: over a
    median, and over each frame's surroundings. More rest where the median leaves a
    fiftieth of the spots that are at least half as strong as what it leaves, or less
    than 0.87 of a spot's strength; of a slow disc it leaves crescents. 0.87 was set on
    simulated films: above 0.89 the median is right.
    """
    left = np.concatenate(moving)[:, 3]
    least = np.median(left) / 2 if len(left) else 0.0
    total = int((np.concatenate(every)[:, 3] >= least).sum())
    shares = [np.empty(0)]
    for spots, whole in zip(moving, every, strict=True):
        if len(spots) and len(whole):
            apart, which = map(np.asarray, KDTree(whole[:, :2]).query(spots[:, :2]))
            shares.append(
                (spots[:, 3] / whole[which, 3])[apart < whole[which, 2] + NEAR_PX]
            )
    share = np.concatenate(shares)
    return bool(50 * len(left) < total or (len(share) and np.median(share) < 0.87))


def shaken_px(recording: Recording) -> float:
    """Return by how many px a still picture moves from frame to frame; 0 without one.

    The middles of frames are registered on their median by phase correlation, without
    what is wider than some 20 px, as light is. Particles alone are no still picture.
    """
    count = len(recording)
    frames = dict[int, Single]()
    middle = tuple(
        slice(max(n // 2 - 512, 0), n // 2 + 512) for n in recording.attributes.size
    )
    for t in {*range(0, count, 1 + count // 30), *range(min(count, 12))}:
        gray = recording.gray(t)[middle].astype(np.float32)
        frames[t] = gray - cv2.GaussianBlur(gray, (0, 0), 8.0)
    still = np.median(list(frames.values()), axis=0)
    window = cv2.createHanningWindow(still.shape[::-1], 5)
    found = [
        cv2.phaseCorrelate(still, frames[t], window)[0] for t in range(min(count, 12))
    ]
    shaken = float(np.median(np.hypot(*np.diff(found, axis=0).T)))
    return shaken if still.std() > 0.4 * np.std(frames[0]) else 0.0
