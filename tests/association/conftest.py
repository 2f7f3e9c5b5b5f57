"""Small worlds of tracks and detections, and the definitions written out."""

from itertools import product

import numpy as np
import pytest

from kilnflight.association import Pairs

GATE = 16.0  # squared Mahalanobis distance


def _pairs(tracks, detections, sigma=5.0, size=None):
    """Pairs of round gates of one sigma, in px, at places (n, 2) and (m, 2)."""
    tracks = np.reshape(np.asarray(tracks, dtype=float), (-1, 2))
    detections = np.reshape(np.asarray(detections, dtype=float), (-1, 2))
    distance = ((tracks[:, None] - detections[None]) ** 2).sum(axis=2) / sigma**2
    distance[distance >= GATE] = np.inf
    return Pairs(
        distance_squared=distance,
        log_determinant=np.full(len(tracks), np.log(sigma**4)),
        size_difference=np.zeros(distance.shape) if size is None else np.asarray(size, float),
        gate_area=np.full(len(tracks), np.pi * GATE * sigma**2),
        gate_probability=1 - np.exp(-GATE / 2),
    )


def _crowd(seed, count=12, box=60.0):
    """Pairs of as many tracks as detections near them, in a box of px."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, box, (count, 2))
    return _pairs(places, rng.permutation(places + rng.normal(0, 5, places.shape)))


def _events(tracks, detections):
    """Yield every joint event, by trying all: the detection of each track, or -1."""
    for event in product(range(-1, detections), repeat=tracks):
        used = [detection for detection in event if detection >= 0]
        if len(set(used)) == len(used):
            yield event


def _plain_probabilities(likelihood, nonassignment):
    """Eq. 2.64 as it stands: a sum over joint events."""
    tracks, detections = likelihood.shape
    factors = np.column_stack([likelihood, nonassignment])  # index -1: missed
    sums = np.zeros((tracks, 1 + detections))
    for event in _events(tracks, detections):
        sums[range(tracks), np.array(event) + 1] += factors[range(tracks), event].prod()
    return sums / sums.sum(axis=1, keepdims=True)


@pytest.fixture(scope="session")
def make_pairs():
    return _pairs


@pytest.fixture(scope="session")
def crowd():
    return _crowd


@pytest.fixture(scope="session")
def events():
    return _events


@pytest.fixture(scope="session")
def plain_probabilities():
    return _plain_probabilities
