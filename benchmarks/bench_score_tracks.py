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


def gated(true: Points, seen: Points, frame: int) -> float:
    """Return Eq. 5.1; the truth of this benchmark has no gaps."""
    if frame in true and frame in seen:
        return min(math.dist(true[frame], seen[frame]), GATE)
    return GATE


def distances(true: list[Points], found: list[Points]) -> np.ndarray:
    """Return Eq. 5.2 of every pair and, on the diagonal behind them, of the dummies."""
    cost = np.full((len(true), len(found) + len(true)), np.inf)
    for i, one in enumerate(true):
        for j, other in enumerate(found):
            span = range(min(min(one), min(other)), max(max(one), max(other)) + 1)
            cost[i, j] = sum(gated(one, other, frame) for frame in span)
        cost[i, len(found) + i] = GATE * len(one)
    return cost


def double_loop(truth: pd.DataFrame, seen: pd.DataFrame) -> tuple[float, float, int]:
    """Return alpha, beta and the matches: Eqs 5.2 and 5.3 pair by pair, frame by frame."""
    true, found = points(truth), points(seen)
    cost = distances(true, found)
    row, col = linear_sum_assignment(cost)
    nothing, paired = GATE * sum(map(len, true)), col < len(found)
    saved = nothing - cost[row, col].sum()
    spurious = [found[j] for j in set(range(len(found))) - set(col.tolist())]
    rest = GATE * sum(max(one) - min(one) + 1 for one in spurious)
    tp = sum(
        gated(true[i], found[j], frame) < GATE
        for i, j in zip(row[paired], col[paired], strict=True)
        for frame in true[i]
    )
    return saved / nothing, saved / (nothing + rest), tp


def ours(truth: pd.DataFrame, seen: pd.DataFrame) -> tuple[float, float, int]:
    """Return the same by one call."""
    score = score_tracks(truth, seen, GATE)
    return score.alpha, score.beta, score.tp


def rows() -> list[Row]:
    """Return every comparison, the results checked to be equal."""
    found = []
    for tracks in (25, 50, 100):
        truth, seen = tables(tracks)
        np.testing.assert_allclose(ours(truth, seen), double_loop(truth, seen))
        found.append(
            compare(
                ("alpha, beta, JSC of 300 frames", "tracks", tracks, "double loop in Python"),
                lambda truth=truth, seen=seen: ours(truth, seen),
                lambda truth=truth, seen=seen: double_loop(truth, seen),
                repeats=2,
            )
        )
    for tracks in (200, 400, 800):  # the loop, quadratic, is waited for on 1 % of the pairs only
        truth, seen = tables(tracks)
        true, candidates = points(truth)[: tracks // 100], points(seen)
        row = compare(
            ("alpha, beta, JSC of 300 frames", "tracks", tracks, "double loop, 100 x 1 % of it"),
            lambda truth=truth, seen=seen: ours(truth, seen),
            lambda true=true, candidates=candidates: distances(true, candidates),
            repeats=2,
        )
        found.append(row._replace(peer_s=100 * row.peer_s, ratio=100 * row.ratio))
    return found
