"""JPDA against Stone Soup, given the same likelihoods."""

import datetime

import numpy as np
import pytest

from kilnflight.association import joint_probabilities

pytest.importorskip("stonesoup", reason="Stone Soup is not installed (extra: peer)")

from stonesoup.dataassociator import probability
from stonesoup.types.detection import Detection, MissedDetection
from stonesoup.types.hypothesis import SingleProbabilityHypothesis
from stonesoup.types.multihypothesis import MultipleHypothesis
from stonesoup.types.track import Track

NOW = datetime.datetime(2023, 1, 1)


class Ready:
    """A hypothesiser whose hypotheses are known."""

    def __init__(self, hypotheses):
        self.hypotheses = hypotheses

    def hypothesise(self, track, detections, timestamp, **kwargs):
        return self.hypotheses[track]


def stone_soup(likelihood, nonassignment, associator):
    tracks = [Track() for _ in likelihood]
    detections = [Detection([column, 0.0], NOW) for column in range(likelihood.shape[1])]
    hypotheses = {
        track: MultipleHypothesis(
            [SingleProbabilityHypothesis(None, MissedDetection(timestamp=NOW), missed)]
            + [
                SingleProbabilityHypothesis(None, detection, value)
                for detection, value in zip(detections, row, strict=True)
                if value > 0
            ]
        )
        for track, row, missed in zip(tracks, likelihood, nonassignment, strict=True)
    }
    found = associator(Ready(hypotheses)).associate(tracks, set(detections), NOW)
    weights = np.zeros((len(tracks), 1 + len(detections)))
    for row, track in zip(weights, tracks, strict=True):
        for hypothesis in found[track]:
            at = 1 + detections.index(hypothesis.measurement) if hypothesis else 0
            row[at] = float(hypothesis.probability)
    return weights


@pytest.mark.parametrize("associator", [probability.JPDA, probability.JPDAwithEHM2])
def test_the_same_probabilities(associator):
    rng = np.random.default_rng(4)
    likelihood = rng.exponential(1, (4, 5)) * (rng.random((4, 5)) < 0.6)
    missed = rng.exponential(0.5, 4)
    expected = stone_soup(likelihood, missed, associator)
    np.testing.assert_allclose(joint_probabilities(likelihood, missed), expected, atol=1e-9)
