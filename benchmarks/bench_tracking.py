"""Tracking of easy recordings, 60 and 600 detections per frame, against three other
trackers.

Each tracker's links are held against the truth before anything is timed: on this
recording each finds nearly all of them, so each does the same work. Stone Soup takes
the same motion model, noise and gate as ours; trackpy and laptrack take a largest step.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import peers
from measure import Row, check_links, compare
from scipy.spatial.distance import cdist

from kilnflight.tracking.filter import Detected, Gate
from kilnflight.tracking.tracker import track
from kilnflight.tracklets import postprocess

LONGEST_STEP = 14.0  # px: speeds are 3 to 10 px/frame, jitter 0.5 px
LIFE = 50  # frames


def recording(frames: int, per_frame: int = 60) -> pd.DataFrame:
    """Return straight flights of 50 frames each, about so many in every frame."""
    rng = np.random.default_rng(frames)
    count = per_frame * (frames + LIFE) // LIFE
    start = np.linspace(-LIFE, frames, count).astype(int)[:, None] + np.arange(LIFE)
    angle = rng.uniform(0, 2 * np.pi, count)
    speed = rng.uniform(3, 10, count)
    velocity = speed * np.array([np.sin(angle), np.cos(angle)])
    place = rng.uniform(0, 1, (2, count)) * np.array([[1536], [2048]])
    path = place[:, :, None] + velocity[:, :, None] * np.arange(LIFE)
    row, col = path + rng.normal(0, 0.5, path.shape)
    truth = np.repeat(np.arange(count), LIFE)
    table = pd.DataFrame(
        {"frame": start.ravel(), "row": row.ravel(), "col": col.ravel()}
    )
    table = table.assign(truth=truth)[(start >= 0).ravel() & (start < frames).ravel()]
    return table.sort_values(["frame", "row", "col"], ignore_index=True)


# Called as their packages are: the table is in order, and nothing of ours checks it.
TRACKPY = peers.Trackpy(LONGEST_STEP).link
LAPTRACK = peers.LapTrack(LONGEST_STEP).link
STONE_SOUP = peers.StoneSoupGNN().link


def with_ours(table: pd.DataFrame) -> np.ndarray:
    """Return the particle of each detection."""
    return track(table)["particle"].to_numpy()


def against(name: str, peer: Callable, frames: int, per_frame: int) -> Row:
    """Return one comparison, the links of both checked to be right."""
    table = recording(frames, per_frame)
    for tracker in (with_ours, peer):  # in a crowd they confuse some
        check_links(table, tracker(table), name, 0.99 if per_frame < 100 else 0.95)
    what = (f"GNN tracking, {per_frame} detections per frame", "frames", frames, name)
    return compare(what, lambda: with_ours(table), lambda: peer(table))


def gating(tracks: int) -> Row:
    """Return the gate's comparison with scipy's distances, one call per track."""
    rng = np.random.default_rng(tracks)
    where, seen = rng.uniform(0, 1500, (2, tracks, 2))
    residual = np.tile([[30.0, 5.0], [5.0, 20.0]], (tracks, 1, 1))
    predicted = where, residual, Detected(seen)

    def by_scipy() -> np.ndarray:
        inverse = np.linalg.inv(residual)
        distance = [
            cdist(where[i : i + 1], seen, "mahalanobis", VI=inverse[i])[0]
            for i in range(tracks)
        ]
        return np.square(distance)

    found = Gate()(*predicted)
    expected = by_scipy()
    np.testing.assert_array_equal(np.argwhere(expected < 16.0), np.transpose(found[:2]))
    np.testing.assert_allclose(found.distance_squared, expected[expected < 16.0])
    what = (
        "gate, Eqs 4.7 and 4.8",
        "tracks and detections",
        tracks,
        "scipy.cdist per track",
    )
    return compare(what, lambda: Gate()(*predicted), by_scipy)


def campaign(frames: int = 3000) -> list[Row]:
    """Return post-processing of a campaign, without and with tracking, against
    trackpy.link.

    trackpy only links.
    """
    table = recording(frames)
    what = ("frames", frames, "trackpy.link")
    tracks = track(table)

    def theirs():
        return TRACKPY(table)

    check_links(table, postprocess(tracks)["particle"].to_numpy(), "post-processing")
    check_links(table, theirs(), "trackpy")
    both = "GNN tracking and post-processing of a campaign"
    return [
        compare(
            ("post-processing of a campaign", *what),
            lambda: postprocess(tracks),
            theirs,
        ),
        compare((both, *what), lambda: postprocess(track(table)), theirs),
    ]


def rows() -> list[Row]:
    """Return every comparison; the slower the peer, the fewer the frames."""
    return [
        gating(300),
        against("trackpy.link", TRACKPY, 1000, 60),
        against("trackpy.link", TRACKPY, 100, 600),
        *campaign(),
        against("laptrack", LAPTRACK, 1000, 60),
        against("laptrack", LAPTRACK, 100, 600),
        against("Stone Soup, GNNWith2DAssignment", STONE_SOUP, 20, 60),
    ]
