from itertools import permutations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from kilnflight import scores
from kilnflight.checks import InputError
from kilnflight.scores import count_in_air, rates, score_detections
from kilnflight.scores.detections import FrameScore, pair, particle_centroids

SQUARE = [(0, 0), (0, 100), (100, 100), (100, 0)]
places = st.lists(st.tuples(st.integers(0, 300), st.integers(0, 300)), max_size=12)


def counts(score):
    return score.tp, score.fp, score.fn


def test_five_detections_and_five_particles_as_in_fig_3_13():
    """The figure's numbers are not in the text; its outcome is: d4 is FP and p3 is FN."""
    particles = [(100, 100), (100, 140), (300, 300), (200, 100), (200, 160)]
    detections = [(103, 104), (110, 135), (205, 108), (400, 100), (190, 150)]
    score = score_detections(particles, detections)
    assert score.pairs.tolist() == [[0, 0], [1, 1], [3, 2], [4, 4]]
    assert score.missed.tolist() == [2]
    assert score.spurious.tolist() == [3]
    assert (score.precision, score.recall, score.f1) == (0.8, 0.8, pytest.approx(0.8))


def test_the_gate_itself_belongs_to_the_gate():
    assert counts(score_detections([(0, 0)], [(27, 36)])) == (1, 0, 0)
    assert counts(score_detections([(0, 0)], [(27, 36.001)])) == (0, 1, 1)
    assert counts(score_detections([(0, 0)], [(27, 36)], gate=44.9)) == (0, 1, 1)


def test_more_pairs_are_worth_more_than_shorter_ones():
    score = score_detections([(0, 0), (0, 44)], [(0, 43), (0, 85)])
    assert score.pairs.tolist() == [[0, 0], [1, 1]]


@given(places, places, st.integers(0, 99))
def test_counts_add_up_and_do_not_depend_on_order_or_side(truth, detected, seed):
    generator = np.random.default_rng(seed)
    score = score_detections(truth, detected)
    assert score.tp + score.fn == len(truth)
    assert score.tp + score.fp == len(detected)
    np.testing.assert_array_equal(np.sort([*score.pairs[:, 0], *score.missed]), range(len(truth)))
    shuffled = [generator.permutation(np.reshape(x, (-1, 2))) for x in (truth, detected)]
    assert counts(score_detections(*shuffled)) == counts(score)
    assert counts(score_detections(detected, truth)) == (score.tp, score.fn, score.fp)
    assert score_detections(truth, truth).f1 == (1.0 if truth else 0.0)


@given(places, places, st.integers(1, 60), st.integers(0, 60))
def test_a_wider_gate_never_loses_a_pair(truth, detected, gate, more):
    assert score_detections(truth, detected, gate).tp <= (
        score_detections(truth, detected, gate + more).tp
    )


@given(places, places)
def test_outside_the_region_nothing_counts(truth, detected):
    score = score_detections(truth, detected, roi=SQUARE)
    inside = [
        [i for i, (r, c) in enumerate(first) if r <= 100 and c <= 100]
        for first in (truth, detected)
    ]
    kept = [
        np.reshape(first, (-1, 2))[rows]
        for first, rows in zip((truth, detected), inside, strict=True)
    ]
    assert counts(score) == counts(score_detections(*kept))
    assert set(score.pairs[:, 0]) | set(score.missed) == set(inside[0])
    assert set(score.pairs[:, 1]) | set(score.spurious) == set(inside[1])


def labelled():
    """Two particles, 7 with nine pixels and 4 with two, and an unlabelled one, 5."""
    image = np.zeros((20, 30), dtype=np.int32)
    image[2:5, 2:5], image[10, 20:22], image[15, 15] = 7, 4, 5
    return image


CENTROIDS = particle_centroids(labelled(), [4, 7])


def score_in_pixels(image, particles, detected, roi=None):
    return scores.score_in_pixels(image, particle_centroids(image, particles), detected, roi)


def test_a_detection_in_the_pixels_of_a_particle_counts_once():
    detected = [(2, 2), (3.4, 2.6), (10.4, 21.4), (10.6, 21), (15, 15), (-1, 0), (1e30, 3), (2, 5)]
    score = score_in_pixels(labelled(), [4, 7], detected)
    assert score.pairs.tolist() == [[0, 2], [1, 1]]
    assert score.spurious.tolist() == [0, 3, 4, 5, 6, 7]
    assert counts(score_in_pixels(labelled(), [4, 7, 5], detected)) == (3, 5, 0)
    assert counts(score_in_pixels(labelled() - 1, [3, 6, -1], [(0, 0)])) == (1, 0, 2)


def test_pixels_outside_the_region_do_not_count():
    roi = [(0, 0), (0, 10), (19, 10), (19, 0)]
    score = score_in_pixels(labelled(), [4, 7], [(3, 3), (10, 20), (9, 9)], roi=roi)
    assert counts(score) == (1, 1, 0)
    assert score.spurious.tolist() == [2]


@given(
    st.lists(st.tuples(st.floats(-3, 14), st.floats(-3, 14)), max_size=12),
    st.integers(0, 2**32 - 1),
)
def test_pixels_are_scored_as_one_would_by_hand(detected, seed):
    image = np.random.default_rng(seed).integers(0, 6, (12, 12))
    ids = [i for i in (3, 1, 5) if (image == i).any()]
    score = score_in_pixels(image, ids, detected)
    hits = []
    for r, c in detected:
        pixel = int(np.floor(r + 0.5)), int(np.floor(c + 0.5))
        on_image = all(0 <= x < 12 for x in pixel)
        hits.append(int(image[pixel]) if on_image else -1)
    assert counts(score) == (
        len(set(hits) & set(ids)),
        len(hits) - len(set(hits) & set(ids)),
        len(set(ids) - set(hits)),
    )
    assert all(hits[d] == ids[t] for t, d in score.pairs)


def test_nothing_scores_nothing():
    for score in (
        score_detections([], []),
        score_detections(np.empty((0, 2)), [], roi=SQUARE),
        score_in_pixels(labelled(), [], []),
    ):
        assert counts(score) == (0, 0, 0)
        assert score.pairs.shape == (0, 2)
        assert score.pairs.dtype == score.missed.dtype == score.spurious.dtype == np.intp
        assert score.f1 == 0
    assert counts(score_in_pixels(labelled(), [], [(3, 3)])) == (0, 1, 0)
    assert counts(score_in_pixels(labelled(), [4], [])) == (0, 0, 1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: score_detections([(0, np.nan)], []), "truth: 1 value"),
        (lambda: score_detections([], [(0, 0, 0)]), r"detected: shape \(1, 3\)"),
        (lambda: score_detections([], [], gate=0.0), "gate"),
        (lambda: score_detections([], [], gate=np.nan), "gate"),
        (lambda: score_detections([], [], roi=[(0, 0), (1, 1)]), "2 different corner"),
        (lambda: score_in_pixels(np.zeros(4, int), [], []), "image: shape"),
        (lambda: score_in_pixels(np.zeros((4, 4)), [], []), "float64, expected whole"),
        (lambda: scores.score_in_pixels(np.zeros((4, 4)), CENTROIDS, []), "image is float64"),
        (lambda: scores.score_in_pixels(labelled(), pd.DataFrame(), []), "row, col missing"),
        (lambda: score_in_pixels(labelled(), [4, 4], []), "each once"),
        (lambda: score_in_pixels(labelled(), [4.5], []), "whole numbers"),
        (lambda: score_in_pixels(labelled(), [4, 9], []), "have no pixel, the first is 9"),
        (lambda: score_in_pixels(labelled(), [4], [(np.inf, 0)]), "detected"),
    ],
)
def test_what_cannot_be_scored_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_a_score_is_its_counts():
    score = FrameScore(np.zeros((3, 2), np.intp), np.arange(1), np.arange(2), (4, 5))
    assert [score.precision, score.recall, score.f1] == rates(3, 2, 1).loc[0].tolist()


numbers = st.integers(0, 10_000)


@given(numbers, numbers, numbers)
def test_rates_are_their_definitions(tp, fp, fn):
    precision = tp / (tp + fp) if tp + fp else 0.0
    recall = tp / (tp + fn) if tp + fn else 0.0
    both = precision + recall
    f1 = 2 * precision * recall / both if both else 0.0
    assert rates(tp, fp, fn).loc[0].tolist() == pytest.approx([precision, recall, f1])


def test_rates_of_many_stand_one_per_row():
    table = rates([3256, 0], [76, 5], [1131, 7])
    assert table["f1"].round(4).tolist() == [0.8436, 0.0]


@pytest.mark.parametrize("bad", [-1, np.nan])
def test_counts_must_be_counts(bad):
    with pytest.raises(InputError, match="numbers"):
        rates(bad, 1, 1)


def test_who_flies_is_counted_as_in_tables_5_13_and_5_14():
    truth = [(0, 0), (0, 100), (100, 0), (100, 100), (200, 200)]
    flies = [True, True, True, False, False]
    itself = score_detections(truth, truth)
    classified = [True, False, True, True, False]
    assert count_in_air(itself, flies, classified) == {"tp": 2, "fp": 1, "fn": 1}
    detected = score_detections(truth, [(0, 1), (0, 101), (101, 100), (300, 300)])
    # Not detected or classified as on the wall: two FN; on the wall or nothing: two FP.
    counted = count_in_air(detected, flies, [True, False, True, True])
    assert counted == {"tp": 1, "fp": 2, "fn": 2}
    assert count_in_air(score_detections([], []), [], []) == {"tp": 0, "fp": 0, "fn": 0}


def test_as_many_classes_as_particles_and_detections():
    with pytest.raises(InputError, match="count_in_air: detected: shape"):
        count_in_air(score_detections([], []), [], [True])
    with pytest.raises(InputError, match="count_in_air: truth: shape"):
        count_in_air(score_detections([(1, 1)], []), [], [])


points = st.lists(st.tuples(st.integers(0, 120), st.integers(0, 60)), max_size=5)


def best_of_all(first, second, gate):
    """Number of pairs and sum of distances of the best of every possible assignment."""
    if len(first) > len(second):
        first, second = second, first
    best = (0, 0.0)
    for order in permutations(range(len(second)), len(first)):
        distances = [np.hypot(*np.subtract(first[i], second[j])) for i, j in enumerate(order)]
        within = [d for d in distances if d <= gate]
        best = min(best, (-len(within), sum(within)))
    return -best[0], best[1]


@settings(deadline=None)
@given(points, points, st.integers(1, 80))
def test_no_other_assignment_is_better(first, second, gate):
    one, two = (np.array(x, dtype=float).reshape(-1, 2) for x in (first, second))
    pairs = pair(one, two, gate)
    distances = np.hypot(*(one[pairs[:, 0]] - two[pairs[:, 1]]).T)
    assert (distances <= gate).all()
    assert all(len(np.unique(column)) == len(pairs) for column in pairs.T)
    count, cost = best_of_all(first, second, gate)
    assert len(pairs) == count
    np.testing.assert_allclose(distances.sum(), cost)


def test_hundreds_are_assigned_as_the_whole_matrix_of_eq_3_4():
    generator = np.random.default_rng(0)
    for size in (50, 300):
        first = generator.uniform(0, 1000, (size, 2))
        second = generator.uniform(0, 1000, (size + 70, 2))
        distance = cdist(first, second)
        cost = np.where(distance <= 45, distance, 1e6)
        row, col = linear_sum_assignment(cost)
        expected = np.stack([row, col], axis=1)[cost[row, col] < 1e6]
        pairs = pair(first, second, 45.0)
        np.testing.assert_array_equal(pairs[np.argsort(pairs[:, 0])], expected)


def test_equal_places_are_paired_once_each():
    pairs = pair(np.zeros((3, 2)), np.zeros((2, 2)), 1.0)
    assert len(pairs) == len(np.unique(pairs[:, 0])) == len(np.unique(pairs[:, 1])) == 2


def test_nothing_pairs_with_nothing():
    for first, second in ((0, 0), (0, 3), (3, 0)):
        pairs = pair(np.zeros((first, 2)), np.zeros((second, 2)), 1.0)
        assert pairs.shape == (0, 2)
        assert pairs.dtype == np.intp
    assert pair(np.zeros((1, 2)), np.ones((1, 2)), 1.0).shape == (0, 2)
