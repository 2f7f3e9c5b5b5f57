"""Scores of detections: worked examples, all assignments tried out, invariants."""

from itertools import permutations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.publication import notebooks
from kilnflight.scores import rates, score_detections, score_in_pixels
from kilnflight.scores.detections import pair, particle_centroids

SQUARE = [(0, 0), (0, 100), (100, 100), (100, 0)]
few_places = st.lists(st.tuples(st.integers(0, 120), st.integers(0, 60)), max_size=5)
places = st.lists(st.tuples(st.integers(0, 300), st.integers(0, 300)), max_size=12)


def counts(score):
    return score.tp, score.fp, score.fn


def test_five_detections_and_five_particles_as_in_fig_3_13():
    """The figure's numbers are not in the text; its outcome is: d4 FP and p3 FN."""
    particles = [(100, 100), (100, 140), (300, 300), (200, 100), (200, 160)]
    detections = [(103, 104), (110, 135), (205, 108), (400, 100), (190, 150)]
    score = score_detections(particles, detections)
    assert score.pairs.tolist() == [[0, 0], [1, 1], [3, 2], [4, 4]]
    assert (score.missed.tolist(), score.spurious.tolist()) == ([2], [3])
    assert (score.precision, score.recall, score.f1) == (0.8, 0.8, pytest.approx(0.8))


def test_the_gate_itself_belongs_to_the_gate():
    assert counts(score_detections([(0, 0)], [(27, 36)])) == (1, 0, 0)
    assert counts(score_detections([(0, 0)], [(27, 36.001)])) == (0, 1, 1)
    assert counts(score_detections([(0, 0)], [(27, 36)], gate=44.9)) == (0, 1, 1)


@given(places, places, st.integers(0, 99), st.integers(1, 60))
def test_invariants_of_counts(truth, detected, seed, gate):
    generator = np.random.default_rng(seed)
    score = score_detections(truth, detected)
    assert (score.tp + score.fn, score.tp + score.fp) == (len(truth), len(detected))
    shuffled = [
        generator.permutation(np.reshape(x, (-1, 2))) for x in (truth, detected)
    ]
    assert counts(score_detections(*shuffled)) == counts(score)
    assert counts(score_detections(detected, truth)) == (score.tp, score.fn, score.fp)
    assert score_detections(truth, truth).f1 == (1.0 if truth else 0.0)
    assert score_detections(truth, detected, gate).tp <= (
        score_detections(truth, detected, gate + 30).tp
    )
    kept = [[x for x in first if max(x) <= 100] for first in (truth, detected)]
    assert counts(score_detections(truth, detected, roi=SQUARE)) == counts(
        score_detections(*kept)
    )


@given(few_places, few_places, st.integers(1, 80))
def test_no_other_assignment_is_better(first, second, gate):
    """Most pairs within the gate, then the least sum of distances (Eq. 3.4)."""
    one, two = (np.array(x, dtype=float).reshape(-1, 2) for x in (first, second))
    pairs, best = pair(one, two, gate), (0, 0.0)
    distances = np.hypot(*(one[pairs[:, 0]] - two[pairs[:, 1]]).T)
    assert all(len(np.unique(column)) == len(pairs) for column in pairs.T)
    short, long = sorted((one, two), key=len)
    for order in permutations(range(len(long)), len(short)):
        apart = np.hypot(*(short - long[list(order)]).T)
        best = min(best, (-int((apart <= gate).sum()), apart[apart <= gate].sum()))
    assert (-len(pairs), distances.sum()) == (best[0], pytest.approx(best[1]))


def test_a_detection_in_the_pixels_of_a_particle_counts_once():
    image = np.zeros((20, 30), dtype=np.int32)
    image[2:5, 2:5], image[10, 20:22], image[15, 15] = 7, 4, 5

    def score(particles, detected, roi=None):
        centroids = particle_centroids(image, np.array(particles, int))
        return score_in_pixels(image, centroids, detected, roi)

    detected = [
        (2, 2),
        (3.4, 2.6),
        (10.4, 21.4),
        (10.6, 21),
        (15, 15),
        (-1, 0),
        (1e30, 3),
        (2, 5),
    ]
    found = score([4, 7], detected)
    assert found.pairs.tolist() == [[0, 2], [1, 1]]
    assert found.spurious.tolist() == [0, 3, 4, 5, 6, 7]
    assert counts(score([4, 7, 5], detected)) == (3, 5, 0)
    left = [(0, 0), (0, 10), (19, 10), (19, 0)]
    assert counts(score([4, 7], [(3, 3), (10, 20), (9, 9)], left)) == (1, 1, 0)
    assert counts(score([], [(3, 3)])) == (0, 1, 0)
    assert counts(score([4], [])) == (0, 0, 1)


def test_particles_in_the_air_are_counted_as_in_tables_5_13_and_5_14():
    count_in_air = notebooks.borrow("25_wall").count_in_air
    truth = [(0, 0), (0, 100), (100, 0), (100, 100), (200, 200)]
    flies = [True, True, True, False, False]
    itself = score_detections(truth, truth)
    classified = [True, False, True, True, False]
    assert count_in_air(itself, flies, classified) == {"tp": 2, "fp": 1, "fn": 1}
    detected = score_detections(truth, [(0, 1), (0, 101), (101, 100), (300, 300)])
    # Not detected or classified as on the wall: two FN; on the wall or spurious: two
    # FP.
    counted = count_in_air(detected, flies, [True, False, True, True])
    assert counted == {"tp": 1, "fp": 2, "fn": 2}


def test_rates_of_whole_counts_from_0():
    found = rates([3, 0], np.array([1.0, 0.0]), pd.Series([2, 0]))
    assert found.loc[0].tolist() == pytest.approx([3 / 4, 3 / 5, 2 / 3])
    assert found.loc[1].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    "wrong", [-1, 0.5, np.nan, np.inf, "3", True, None, [1, 2], [[1]], 10**400]
)
@pytest.mark.parametrize("which", range(3))
def test_other_counts_are_refused(which, wrong):
    given = [3, 1, 2]
    given[which] = wrong
    with pytest.raises(InputError, match="counts"):
        rates(*given)
