from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.tracklets import Elimination, eliminate
from kilnflight.tracklets.paths import velocities

T = np.arange(6)


def mean_speed(frame, place):
    return eliminate.mean_speed(np.zeros(len(frame), int), frame, place).item()


def regularity(frame, place):
    return eliminate.regularity(np.zeros(len(frame), int), frame, place).item()


def survivors(table):
    return sorted(set(Elimination()(table)["particle"]) - {-1})


def test_velocity_and_mean_speed_are_eqs_4_16_and_4_17():
    frame = np.array([0, 1, 3])
    place = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 10.0]])
    assert velocities(frame, place).tolist() == [[3.0, 4.0], [0.0, 3.0]]
    assert mean_speed(frame, place) == (5.0 + 3.0) / 2
    assert mean_speed(frame[:1], place[:1]) == 0.0


@pytest.mark.parametrize(
    ("tracklet", "stays"),
    [
        (([0, 1], [0.0, 9.0], 0.0), False),  # two frames are not more than two
        (([0, 1, 2], [0.0, 9.0, 18.0], 0.0), True),
        (([0, 4, 9], [0.0, 9.0, 18.0], 0.0), True),  # assigned frames count
        ((T, 1.0 * T, 0.0), False),  # 1 px/frame is not more than 1
        ((T, 1.1 * T, 0.0), True),
        ((T, 9.0, 4.0), False),  # lies on the wall
        ((T, 2.0 * T**2, 3.0 * T), True),
        ((T, [0, 9, 0, 9, 0, 9], 0.0), False),
        ((T, 10 * T + np.array([0, 2, 0, -2, 0, 2]), 5.0), True),  # col does not move
    ],
)
def test_the_three_conditions_of_fig_4_4(table, tracklet, stays):
    assert survivors(table(tracklet)) == ([0] if stays else [])


def test_a_short_path_and_one_at_rest_are_regular():
    place = np.random.default_rng(0).normal(size=(9, 2))
    for count in range(1, 4):
        assert regularity(np.arange(count), place[:count]) == 1.0
    assert regularity(np.arange(9), np.full((9, 2), 3.7)) == 1.0
    assert regularity(T, np.stack([T**2, -T * (T + 1.0)], axis=1)) == pytest.approx(1.0, abs=1e-12)


@given(st.integers(0, 2**32 - 1), st.integers(4, 30))
def test_regularity_is_the_correlation_with_numpy_polyfit(plain, seed, count):
    rng = np.random.default_rng(seed)
    frame = np.sort(rng.choice(100, count, replace=False))
    place = rng.normal(0, 10, (count, 2)) + rng.normal(0, 1, 2) * frame[:, None]
    expected = plain.correlation(list(zip(frame, place, strict=True)))
    assert regularity(frame, place) == pytest.approx(expected, abs=1e-7)
    assert regularity(frame + 5, place[:, ::-1].copy()) == pytest.approx(expected, abs=1e-7)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_it_is_the_plain_definition(flights, plain, same_tracks, seed):
    tracks = flights(seed, 6)
    same_tracks(Elimination()(tracks), plain.eliminate(plain.tracklets_of(tracks)))


def test_limits_are_fields(table):
    tracks = table((T, 1.0 * T, 0.0))
    assert (replace(Elimination(), speed=0.9)(tracks)["particle"] == 0).all()


@pytest.mark.parametrize("field", ["duration", "speed", "regularity"])
@pytest.mark.parametrize("bad", [np.nan, -3, "a", None, True])
def test_what_is_no_limit_is_refused(field, bad):
    with pytest.raises(InputError, match=f"Elimination: {field}: must be"):
        Elimination(**{field: bad})


def test_a_correlation_above_one_is_refused():
    with pytest.raises(InputError, match="regularity: must be"):
        Elimination(regularity=5)
