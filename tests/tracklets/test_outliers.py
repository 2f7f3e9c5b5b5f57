import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.tracklets import OutlierRemoval
from kilnflight.tracklets.paths import turns

T = np.arange(10)


def removed(table, row, col, frame=None):
    tracks = table((np.arange(len(row)) if frame is None else frame, row, col))
    result = OutlierRemoval()(tracks)
    return np.flatnonzero(result["particle"] == -1).tolist()


def turn(before, after):
    angle, change = turns(np.array([before]), np.array([after]))
    return angle[0], change[0]


def test_angle_and_change_are_those_of_fig_4_5():
    assert turn((3.0, 0.0), (0.0, 4.0)) == pytest.approx((90.0, 5.0))
    assert turn((1.0, 1.0), (-1.0, -1.0)) == pytest.approx((180.0, 2 * np.sqrt(2)))
    for side in (30.0, -30.0):
        assert turn((0.0, 0.0), (0.0, side)) == (0.0, 30.0)  # rest has no direction
        assert turn((side, side), (-0.0, 0.0))[0] == 0.0


def test_situation_1_an_angle_alone_is_none(table):
    assert removed(table, [0, 5, 10, 5, 0, -5.0], np.zeros(6)) == []  # up, then down


def test_situation_2_a_change_alone_is_none(table):
    assert removed(table, [0, 5, 10, 60, 110, 160.0], np.zeros(6)) == []


def test_situation_3_both_make_an_outlier(table):
    col = np.zeros(10)
    col[5] = 60.0
    assert removed(table, 5.0 * T, col) == [5]
    col[9] = 60.0
    assert removed(table, 5.0 * T, col) == [5, 9]


def test_the_first_point_is_compared_with_the_mean_of_three_velocities(table):
    col = np.zeros(10)
    col[0] = 60.0
    assert removed(table, 5.0 * T, col) == [0]


def test_the_second_point_is_judged_backwards(table):
    col = np.array([0.0, 40.0, 0.0, 0.0])
    assert removed(table, 5.0 * T[:4], col) == [1]  # forwards it would be the third
    # from five points on, the order of the text gives up the first point too (Notes, 4)
    assert removed(table, 5.0 * T, np.append(col, np.zeros(6))) == [0, 1]


def test_a_jump_over_missed_frames_is_divided_by_them(table):
    frame = np.array([0, 1, 2, 12, 13])
    assert removed(table, [0, 5, 10, 60, 65.0], [0, 0, 0, 50, 50.0], frame) == []


def test_fewer_than_three_points_cannot_be_judged(table):
    assert removed(table, [0.0, 500.0], [0.0, 0.0]) == []
    assert removed(table, [0.0], [0.0]) == []


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.floats(1, 60))
def test_it_is_the_plain_definition(table, plain, same_tracks, seed, scatter):
    rng = np.random.default_rng(seed)
    tracklets = []
    for count in rng.integers(1, 25, 5):
        frame = np.sort(rng.choice(40, count, replace=False))
        row, col = rng.normal(0, scatter, (2, count)) + 6.0 * frame
        tracklets.append((frame, row, col))
    tracks = table(*tracklets)
    expected = [plain.without_outliers(t) for t in plain.tracklets_of(tracks)]
    same_tracks(OutlierRemoval()(tracks), expected)


@pytest.mark.parametrize("field", ["angle_deg", "change"])
@pytest.mark.parametrize("bad", [np.nan, -3, "a", None, True])
def test_what_is_no_limit_is_refused(field, bad):
    with pytest.raises(InputError, match=f"OutlierRemoval: {field}: must be 0 or above"):
        OutlierRemoval(**{field: bad})


def test_no_angle_at_all_is_a_limit(table):
    """Every change of direction counts then; without a change of speed it is still none."""
    tracks = table((T[:6], 5.0 * T[:6], 0.1 * T[:6]))
    pd.testing.assert_frame_equal(OutlierRemoval(angle_deg=0, change=1)(tracks), tracks)
