"""Measures of tracks against a double loop over tracks in Python, and cost against tracks."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from measure import Row, compare
from scipy.optimize import linear_sum_assignment

from kilnflight.scores import score_tracks

GATE = 10.0
FRAMES = 300
Points = dict[int, tuple[float, float]]


def tables(tracks: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return flights across the image, and as a tracker may have seen them."""
    rng = np.random.default_rng(tracks)
    frame, particle = (a.ravel() for a in np.meshgrid(np.arange(FRAMES), np.arange(tracks)))
    start, velocity = rng.uniform(0, 1500, (tracks, 2)), rng.normal(0, 2, (tracks, 2))
    row, col = (start[particle] + velocity[particle] * frame[:, None]).T
    truth = pd.DataFrame({"frame": frame, "particle": particle, "row": row, "col": col})
    seen = truth[rng.random(len(truth)) > 0.1].copy()
    seen[["row", "col"]] += rng.normal(0, 3, (len(seen), 2))
    broken = (seen["particle"] % 3 == 0) & (seen["frame"] > 200)
    return truth, seen.assign(particle=seen["particle"] + tracks * broken)


def points(table: pd.DataFrame) -> list[Points]:
    """Return each track as frame -> row, col."""
    found: dict[int, Points] = {}
    for frame, particle, row, col in table.itertuples(index=False):
        found.setdefault(particle, {})[frame] = row, col
    return list(found.values())


def apart(true: Points, seen: Points) -> float:
    """Return Eq. 5.2; the truth of this benchmark has no gaps."""
    first, last = min(seen), max(seen)
    total = 0.0
    for frame, (row, col) in true.items():
        at = seen.get(frame)
        total += GATE if at is None else min(math.hypot(row - at[0], col - at[1]), GATE)
    return total + GATE * sum(frame not in true for frame in range(first, last + 1))


def double_loop(truth: pd.DataFrame, seen: pd.DataFrame) -> float:
    """Return alpha by Eq. 5.3, each true track with its own dummy."""
    true, found = points(truth), points(seen)
    cost = np.full((len(true), len(found) + len(true)), np.inf)
    for i, one in enumerate(true):
        for j, other in enumerate(found):
            cost[i, j] = apart(one, other)
        cost[i, len(found) + i] = GATE * len(one)
    return 1 - cost[linear_sum_assignment(cost)].sum() / (GATE * sum(map(len, true)))


def rows() -> list[Row]:
    """Return every comparison, the results checked to be equal."""
    found = []
    # the loop grows with the square of the tracks: beyond 100 it is no longer waited for
    for tracks in (25, 50, 100):
        truth, seen = tables(tracks)
        np.testing.assert_allclose(score_tracks(truth, seen, GATE).alpha, double_loop(truth, seen))
        found.append(
            compare(
                ("alpha, beta, JSC of 300 frames", "tracks", tracks, "double loop in Python"),
                lambda truth=truth, seen=seen: score_tracks(truth, seen, GATE),
                lambda truth=truth, seen=seen: double_loop(truth, seen),
                repeats=2,
            )
        )
    return found
