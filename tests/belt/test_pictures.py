"""Spots that are measured in pictures of discs."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from kilnflight.belt.camera import BELT, Calibration
from kilnflight.belt.pictures import MeasureSpots, Spots, average
from kilnflight.checks import InputError
from kilnflight.tables import BELT_SPOTS

EMPTY = np.full((120, 160), 60, dtype=np.uint8)
# Two pixels per mm; the belt's first corner is pixel (0, 0).
HALF = Calibration(np.array([[0.5, 0, 388.0], [0, 0.5, 0], [0, 0, 1]]), 0.0, 0.5)
MEASURE = MeasureSpots(EMPTY, Spots(), HALF)


def with_discs(*places, radius=5):
    picture = EMPTY.copy()
    for row, col in places:
        cv2.circle(picture, (col, row), radius, 200, -1)
    return picture


def test_the_background_is_the_mean():
    assert (average([EMPTY, EMPTY + 10, EMPTY + 21]) == 70).all()
    for wrong in (
        [],
        [EMPTY, EMPTY[1:]],
        [EMPTY, None],
        [np.zeros((4, 4, 3), np.uint8)],
    ):
        with pytest.raises(InputError, match="pictures"):
            average(wrong)


def test_particles_that_touch_are_one_spot_and_marked():
    apart, touching = (
        with_discs((30, 40), (80, 100)),
        with_discs((30, 40), (38, 46), (80, 100)),
    )
    spots = Spots().calibrated([apart], EMPTY)
    assert spots(apart, EMPTY)[:, 3].tolist() == [0, 0]
    measured = spots(touching, EMPTY)
    assert measured[:, 3].tolist() == [1, 0]
    np.testing.assert_allclose(
        measured[0, :2], [34, 43], atol=0.1
    )  # their common centroid
    assert Spots()(touching, EMPTY)[:, 3].tolist() == [
        0,
        0,
    ]  # not calibrated: marks none


@pytest.mark.parametrize(
    "centres", [[(30, 40), (38, 46)], [(40, 30), (40, 40), (40, 50), (50, 50)]]
)
def test_a_spot_of_several_is_split_at_the_centres(centres):
    alone, touching = with_discs((80, 100)), with_discs(*centres, (80, 100))
    spots = Spots(split=True).calibrated([alone], EMPTY)
    np.testing.assert_array_equal(
        spots(alone, EMPTY), replace(spots, split=False)(alone, EMPTY)
    )
    measured = spots(touching, EMPTY)
    assert measured[:, 3].tolist() == [0] + [1] * len(centres)
    parts = measured[1:][np.lexsort(measured[1:, 1::-1].T)]
    np.testing.assert_allclose(parts[:, :2], sorted(centres), atol=0.5)
    assert parts[:, 2].sum() == replace(spots, split=False)(touching, EMPTY)[:, 2].max()
    np.testing.assert_array_equal(spots(touching, EMPTY), measured)  # no chance in it
    assert len(Spots(split=True)(touching, EMPTY)) == 2  # not calibrated: splits none
    hand = with_discs((60, 80), radius=40)  # too large for touching particles
    np.testing.assert_allclose(spots(hand, EMPTY)[:, [0, 1, 3]], [[60, 80, 1]])


def test_an_empty_belt_has_no_spots():
    assert Spots()(EMPTY, EMPTY).shape == (0, 4)
    for pictures in ([EMPTY, EMPTY], []):
        table = MEASURE.table(pictures)
        assert table.columns.tolist() == BELT_SPOTS.names
        assert len(BELT_SPOTS.check(table)) == 0
    with pytest.raises(InputError, match="pictures"):
        Spots().calibrated([EMPTY], EMPTY)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_spots_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    places = rng.integers(0, [120, 160], (rng.integers(0, 12), 2))
    picture = with_discs(*places.tolist(), radius=int(rng.integers(1, 8)))
    labels, count = ndimage.label(picture != EMPTY, np.ones((3, 3)))
    index = np.arange(1, count + 1)
    area = ndimage.sum_labels(labels > 0, labels, index)
    centres = np.array(ndimage.center_of_mass(labels > 0, labels, index)).reshape(-1, 2)
    expected = np.column_stack([centres, area])[area >= 12]
    measured = Spots()(picture, EMPTY)[:, :3]
    order, other = np.lexsort(measured.T), np.lexsort(expected.T)
    np.testing.assert_allclose(measured[order], expected[other])


def test_places_are_millimetres_and_outside_is_left_out():
    pictures = [with_discs((30, 40)), EMPTY, with_discs((30, 40), (90, 140))]
    table = BELT_SPOTS.check(replace(MEASURE, area=BELT).table(pictures))
    assert table["frame"].tolist() == [0, 2, 2]
    np.testing.assert_allclose(table[["x", "y"]].iloc[2], [388 + 70, 45])
    narrow = replace(MEASURE, area=replace(BELT, end_mm=428.0))
    assert narrow.table(pictures)["frame"].tolist() == [0, 2]


@pytest.mark.parametrize("wrong", [None, [[1, 2]], EMPTY[1:], EMPTY.astype(float)])
def test_pictures_that_do_not_fit_are_refused(wrong):
    with pytest.raises(InputError, match="picture"):
        Spots()(wrong, EMPTY)
    with pytest.raises(InputError, match="frame 1"):
        MEASURE.table([EMPTY, wrong])
    matrix = HALF.matrix - 5000 * np.eye(3)[0][:, None] * np.eye(3)[2]
    with pytest.raises(
        InputError, match="picture"
    ):  # the calibration of another camera
        replace(MEASURE, calibration=HALF._replace(matrix=matrix))(EMPTY)
