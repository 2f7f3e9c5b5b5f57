"""The list of tracks that are alive: who is in it, who is taken out, who comes in.

Thesis, section 4.1.4 and Eq. 4.14. A list is arrays, one entry per track, the older first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kilnflight.checks import check_between, check_count
from kilnflight.tracking.gate import Detected
from kilnflight.tracking.motion import Motion

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Management:
    """When a track is given up, Eq. 4.14: seen too seldom, or not for too long.

    Notes
    -----
    No value is printed. ``invisible``: five frames are 15 ms, in which a particle of
    30 px/frame that brakes by 0.3 px/frame^2 leaves its prediction by some 5 px; longer
    gaps, up to 15 frames, are closed afterwards (t_eps,CONNECT of Table 5.16).
    ``visibility``: SIFT finds about half of the particles that do not burn and all of those
    that do (section 5.1), so a true track lies above 0.4 but for bad luck. Since one miss in
    the second frame makes 0.5 and another 1/3, it is tested from ``visibility_age`` on only.
    Frames that have no detection at all count like any other.
    """

    visibility: float = 0.4  # v_eps, share of the frames of its life; not printed
    invisible: int = 5  # CIC_eps, frames in a row; not printed
    visibility_age: int = 4  # frames of life from which visibility is tested; not printed

    def __post_init__(self) -> None:
        """Refuse what is no share and no number of frames."""
        check_between(self.visibility, 0, 1, "Management: visibility")
        check_count(self.invisible, "Management: invisible", least=0)
        check_count(self.visibility_age, "Management: visibility_age", least=0)

    def keeps(self, seen: Integers, age: Integers, missed: Integers) -> npt.NDArray[np.bool_]:
        """Return which tracks live on, by times seen, frames of life, frames since last seen."""
        seldom = (age >= self.visibility_age) & (seen < self.visibility * age)
        return ~(seldom | (missed > self.invisible))


class Tracks(NamedTuple):
    """The n tracks that are alive, as they stood in the frame ``step`` last looked at."""

    particle: Integers  # (n,), ids in order of birth
    state: Array  # (n, k)
    covariance: Array  # (n, k, k)
    depth_mm: Array  # (n,), last known; NaN: never known
    points: Array  # (n,), last known number of 3D points; NaN: never known
    born: Integers  # (n,), frame
    last: Integers  # (n,), frame of the last recorded detection
    seen: Integers  # (n,), number of recorded detections, V in Eq. 4.14


def living(tracks: Tracks, management: Management, frame: int) -> Tracks:
    """Return the tracks that Eq. 4.14 keeps at the end of ``frame``."""
    age, missed = frame - tracks.born + 1, frame - tracks.last
    keep = management.keeps(tracks.seen, age, missed)
    return tracks if keep.all() else Tracks._make(_chosen(tuple(tracks), np.flatnonzero(keep)))


@njit(cache=True)
def _chosen(tracks: Any, keep: Any) -> Any:
    """Return the tracks of these places; compiled, as are the next, for the many small arrays."""
    particle, state, covariance, depth, points, born, last, seen = tracks
    return (
        particle[keep],
        state[keep],
        covariance[keep],
        depth[keep],
        points[keep],
        born[keep],
        last[keep],
        seen[keep],
    )


def joined(old: Tracks, new: Tracks) -> Tracks:
    """Return both lists as one, the older tracks first."""
    return old if not len(new.particle) else Tracks._make(_concatenated(tuple(old), tuple(new)))


@njit(cache=True)
def _concatenated(old: Any, new: Any) -> Any:
    return (
        np.concatenate((old[0], new[0])),
        np.concatenate((old[1], new[1])),
        np.concatenate((old[2], new[2])),
        np.concatenate((old[3], new[3])),
        np.concatenate((old[4], new[4])),
        np.concatenate((old[5], new[5])),
        np.concatenate((old[6], new[6])),
        np.concatenate((old[7], new[7])),
    )


def seen(
    tracks: Tracks, state: Array, covariance: Array, here: Detected, owner: Integers, frame: int
) -> Tracks:
    """Return the updated tracks, with what their recorded detections tell.

    ``owner`` (m,) is the place of the track that each detection is recorded for, -1: none.
    A detection without depth, or without 3D points, leaves the last known one.
    """
    depth, points, last, times = _told(
        tracks.depth_mm, tracks.points, tracks.last, tracks.seen, here[1], here[2], owner, frame
    )
    return Tracks(tracks.particle, state, covariance, depth, points, tracks.born, last, times)


@njit(cache=True)
def _told(
    depth: Any, points: Any, last: Any, seen: Any, depths: Any, sizes: Any, owner: Any, frame: int
) -> Any:
    """Return what the recorded detections tell: how deep, how large, when and how often."""
    depth, points, last, seen = depth.copy(), points.copy(), last.copy(), seen.copy()
    for j in range(len(owner)):
        i = owner[j]
        if i >= 0:
            last[i] = frame
            seen[i] += 1
            if not np.isnan(depths[j]):
                depth[i] = depths[j]
            if not np.isnan(sizes[j]):
                points[i] = sizes[j]
    return depth, points, last, seen


def born(motion: Motion, frame: int, started: int, alone: Detected) -> Tracks:
    """Return one new track for each detection that is in none (section 4.1.4)."""
    state, covariance = motion.initial(alone.positions)
    count = len(state)
    return Tracks(
        started + np.arange(count),
        state,
        covariance,
        alone.depth_mm,
        alone.points,
        np.full(count, frame),
        np.full(count, frame),
        np.ones(count, dtype=np.int64),
    )
