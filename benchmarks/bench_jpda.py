"""Probabilities of joint events against Stone Soup.

Stone Soup's associator gets its hypotheses ready made, with their likelihoods, and ours
the same likelihoods as arrays. Both group, sum and normalise.
"""

from __future__ import annotations

import datetime

import numpy as np
from measure import Row, compare
from stonesoup.dataassociator.probability import JPDAwithEHM2
from stonesoup.hypothesiser.probability import PDAHypothesiser
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import (
    CombinedLinearGaussianTransitionModel,
    ConstantVelocity,
)
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.detection import Detection
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.updater.kalman import KalmanUpdater

from kilnflight.association import joint_probabilities

NOW = datetime.datetime(2023, 1, 1)
# Name, tracks, side of the image part in px: about 1.1, 1.7 and 4.6 detections per
# gate. With 7.3 (20 tracks in 50 px) ours takes 8 ms and Stone Soup did not end within
# 4 minutes.
SCENES = (("sparse", 60, 550.0), ("crowded", 60, 260.0), ("dense group", 20, 70.0))
SPREAD = np.diag([20.0, 5.0, 20.0, 5.0])  # px^2, covariance of the tracks
NOISE = np.eye(2) * 4.0  # px^2
P_D = 0.9
P_G = 0.999
CLUTTER = 1e-4  # per px^2
GATE = -2 * np.log(1 - P_G)


class Ready:
    """A hypothesiser whose hypotheses are known."""

    def __init__(self, hypotheses: dict) -> None:
        self.hypotheses = hypotheses

    def hypothesise(self, track: Track, *_: object, **__: object) -> object:
        return self.hypotheses[track]


def scene(count: int, side: float) -> tuple[np.ndarray, np.ndarray]:
    """Return places of tracks and of detections, nine of ten seen and a tenth
    clutter.
    """
    rng = np.random.default_rng(count)
    tracks = rng.uniform(0, side, (count, 2))
    detections = tracks + rng.normal(0, 4, tracks.shape)
    clutter = rng.random(count) < 0.1
    detections[clutter] = rng.uniform(0, side, (clutter.sum(), 2))
    return tracks, detections


def ours_from_places(
    tracks: np.ndarray, detections: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return likelihood and nonassignment as Stone Soup defines them."""
    residual = SPREAD[::2, ::2] + NOISE
    difference = detections[None] - tracks[:, None]
    distance = np.einsum(
        "tdi,ij,tdj->td", difference, np.linalg.inv(residual), difference
    )
    density = np.exp(-distance / 2) / (2 * np.pi * np.sqrt(np.linalg.det(residual)))
    likelihood = np.where(distance <= GATE, P_D * density / CLUTTER, 0.0)
    return likelihood, np.full(len(tracks), 1 - P_D * P_G)


def stone_soup(
    tracks: np.ndarray, detections: np.ndarray
) -> tuple[list, list, PDAHypothesiser]:
    """Return the same scene in Stone Soup's objects."""
    measurement = LinearGaussian(4, (0, 2), NOISE)
    still = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.0)] * 2)
    hypothesiser = PDAHypothesiser(
        KalmanPredictor(still), KalmanUpdater(measurement), CLUTTER, P_D, P_G
    )
    states = [GaussianState([row, 0, col, 0], SPREAD, NOW) for row, col in tracks]
    seen = [
        Detection(place, NOW, measurement_model=measurement) for place in detections
    ]
    return [Track([state]) for state in states], seen, hypothesiser


def as_weights(found: dict, tracks: list, seen: list) -> np.ndarray:
    """Return Stone Soup's hypotheses as weights (tracks, 1 + detections)."""
    column = {id(detection): 1 + k for k, detection in enumerate(seen)}
    weights = np.zeros((len(tracks), 1 + len(seen)))
    for row, track in zip(weights, tracks, strict=True):
        for hypothesis in found[track]:
            at = column[id(hypothesis.measurement)] if hypothesis else 0
            row[at] = float(hypothesis.probability)
    return weights


def joint(name: str, count: int, side: float) -> Row:
    """Return the comparison of one scene."""
    places = scene(count, side)
    likelihood, missed = ours_from_places(*places)
    tracks, seen, hypothesiser = stone_soup(*places)
    ready = {track: hypothesiser.hypothesise(track, seen, NOW) for track in tracks}
    peer = JPDAwithEHM2(Ready(ready))
    expected = as_weights(peer.associate(tracks, set(seen), NOW), tracks, seen)
    np.testing.assert_allclose(
        joint_probabilities(likelihood, missed), expected, atol=1e-9
    )
    return compare(
        (f"joint probabilities, {name}", "tracks", count, "Stone Soup JPDAwithEHM2"),
        lambda: joint_probabilities(likelihood, missed),
        lambda: peer.associate(tracks, set(seen), NOW),
    )


def rows() -> list[Row]:
    """Return every comparison, the results checked to be equal."""
    return [joint(*scene) for scene in SCENES]
