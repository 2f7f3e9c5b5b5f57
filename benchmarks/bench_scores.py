"""Assignment of detections against the whole cost matrix of Eq. 3.4, and pixels one by one."""

from __future__ import annotations

import math

import numpy as np
from measure import Row, compare
from scipy.optimize import linear_sum_assignment

from kilnflight.scores import score_detections, score_in_pixels
from kilnflight.scores.detections import particle_centroids

PARTICLES = (120, 400, 1200)


def matrix(truth: np.ndarray, detected: np.ndarray) -> np.ndarray:
    """Return Eq. 3.4, entry by entry."""
    cost = np.full((len(truth), len(detected)), 1e6)
    for i, (row, col) in enumerate(truth.tolist()):
        for j, (r, c) in enumerate(detected.tolist()):
            distance = math.hypot(row - r, col - c)
            if distance <= 45.0:
                cost[i, j] = distance
    return cost


def hungarian(truth: np.ndarray, detected: np.ndarray) -> np.ndarray:
    """Return the pairs of the whole matrix."""
    cost = matrix(truth, detected)
    row, col = linear_sum_assignment(cost)
    allowed = cost[row, col] < 1e6
    return np.stack([row[allowed], col[allowed]], axis=1)


def by_particle(image: np.ndarray, ids: np.ndarray, detected: np.ndarray) -> int:
    """Return how many particles hold a detection, one particle after the other."""
    pixels = {tuple(p) for p in np.floor(detected + 0.5).astype(int).tolist()}
    return sum(not pixels.isdisjoint(map(tuple, np.argwhere(image == k).tolist())) for k in ids)


def rows() -> list[Row]:
    """Return every comparison, the results checked to be equal."""
    found = []
    generator = np.random.default_rng(0)
    for count in PARTICLES:
        truth = generator.uniform((0, 0), (1536, 2048), (count, 2))
        detected = np.concatenate([truth + generator.normal(0, 5, truth.shape), truth[::5] + 60])
        pairs = score_detections(truth, detected).pairs
        np.testing.assert_array_equal(pairs, hungarian(truth, detected))
        found.append(
            compare(
                ("assignment, Eq. 3.4", "particles", count, "matrix in a loop, scipy"),
                lambda truth=truth, seen=detected: score_detections(truth, seen),
                lambda truth=truth, seen=detected: hungarian(truth, seen),
            )
        )
    image = np.full((1536, 2048), -1, dtype=np.int32)
    ids = np.arange(120)
    truth = truth[:120]
    for number, (row, col) in enumerate(truth.astype(int).tolist()):
        image[max(row - 7, 0) : row + 8, max(col - 7, 0) : col + 8] = number
    ids = ids[np.isin(ids, image)]

    def ours() -> int:
        return score_in_pixels(image, particle_centroids(image, ids), truth).tp

    assert ours() == by_particle(image, ids, truth)
    found.append(
        compare(
            ("detections within pixels", "particles", len(ids), "particle by particle"),
            ours,
            lambda: by_particle(image, ids, truth),
        )
    )
    return found
