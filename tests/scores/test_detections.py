import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.scores import (
    FrameScore,
    rates,
    score_detections,
    score_in_pixels,
)

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
        [i for i, (r, c) in enumerate(one) if r <= 100 and c <= 100] for one in (truth, detected)
    ]
    kept = [
        np.reshape(one, (-1, 2))[rows] for one, rows in zip((truth, detected), inside, strict=True)
    ]
    assert counts(score) == counts(score_detections(*kept))
    assert set(score.pairs[:, 0]) | set(score.missed) == set(inside[0])
    assert set(score.pairs[:, 1]) | set(score.spurious) == set(inside[1])


def labelled():
    """Two particles, 7 with nine pixels and 4 with two, and an unlabelled one, 5."""
    image = np.zeros((20, 30), dtype=np.int32)
    image[2:5, 2:5], image[10, 20:22], image[15, 15] = 7, 4, 5
    return image


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
        (lambda: score_in_pixels(np.zeros(4, int), [], []), "particle_of_pixel"),
        (lambda: score_in_pixels(np.zeros((4, 4)), [], []), "float64, expected whole"),
        (lambda: score_in_pixels(labelled(), [4, 4], []), "each once"),
        (lambda: score_in_pixels(labelled(), [4.5], []), "whole numbers"),
        (lambda: score_in_pixels(labelled(), [4, 9], []), "have no pixel, the first is 9"),
        (lambda: score_in_pixels(labelled(), [4], [(np.inf, 0)]), "detected"),
    ],
)
def test_what_cannot_be_scored_is_told(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_a_score_is_its_counts():
    score = FrameScore(np.zeros((3, 2), np.intp), np.arange(1), np.arange(2), (4, 5))
    assert [score.precision, score.recall, score.f1] == rates(3, 2, 1).loc[0].tolist()
