"""What becomes of tracks too short, with an impossible jump, or without depth (chapter 4.2)."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.tracklets import STEPS, Connection, postprocess, tracked


def straight(first, count, z=np.nan):
    """A tracklet that flies 7 px a frame; ``z`` in mm."""
    frame = np.arange(first, first + count)
    return frame, 7.0 * frame, 3.0 + 2.0 * frame, z


@pytest.mark.parametrize("count", [1, 2])
def test_a_track_of_one_or_two_detections_is_false(table, count):
    """Eq. 4.15 asks for more than two frames."""
    assert (postprocess(table(straight(0, count)))["particle"] == -1).all()
    # nor is it connected, since what is false goes first (Fig. 4.3)
    both = postprocess(table(straight(0, 10), straight(12, count)))
    assert both["particle"].tolist() == [0] * 10 + [-1] * count


def test_a_track_of_three_detections_stays_and_is_connected(table):
    alone = table(straight(0, 3, 5000.0))
    pd.testing.assert_frame_equal(postprocess(alone), alone)
    both = postprocess(table(straight(0, 3), straight(5, 3)))
    assert (both["particle"] == 0).all()


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("depth", [np.nan, 5000.0, [5000.0, 8000.0, 5000.0]])
@pytest.mark.parametrize("step", STEPS)
def test_every_step_takes_short_tracks_with_any_depth(table, step, count, depth):
    short = table(straight(0, count, depth if np.isscalar(depth) else depth[:count]))
    result = step(short)
    assert len(result) == count
    assert result["particle"].isin([0, -1]).all()
    assert result[["row", "col"]].equals(short[["row", "col"]])


def test_a_jump_of_three_metres_in_depth_connects_nothing(table):
    """Eqs 4.22 and 4.23: 3000 mm in one frame are above 1500 mm/frame, in three frames below."""
    far = table(straight(0, 10, 5000.0), straight(10, 10, 8000.0))
    assert tracked(postprocess(far))["particle"].nunique() == 2
    later = table(straight(0, 10, 5000.0), straight(12, 10, 8000.0))
    assert set(postprocess(later)["particle"]) == {0}
    assert tracked(Connection(depth=900.0)(later))["particle"].nunique() == 2


def test_a_jump_of_three_metres_within_a_track_is_left_to_the_flights(table):
    """Outliers are judged in the picture alone (Eq. 4.18); depth is never removed here."""
    z = np.where(np.arange(20) == 9, 8000.0, 5000.0)
    jumping = table(straight(0, 20, z))
    pd.testing.assert_frame_equal(postprocess(jumping), jumping)


def test_a_jump_in_the_picture_is_an_outlier_or_cut_nowhere(table):
    """One wild position goes (Eq. 4.18); two halves far apart are not connected.

    The wilder one makes the whole tracklet irregular, and those go first (Fig. 4.3, Eq. 4.15).
    """
    frame, row, col, z = straight(0, 20)
    for off, lost in ((60.0, [9]), (900.0, list(range(20)))):
        wild = table((frame, row, np.where(frame == 9, col + off, col), z))
        kept = postprocess(wild)
        assert kept.index[kept["particle"] == -1].tolist() == lost
    there = straight(11, 10)
    apart = table(straight(0, 10), (there[0], there[1] + 900.0, there[2], z))
    assert tracked(postprocess(apart))["particle"].nunique() == 2


@pytest.mark.parametrize("seed", range(4))
def test_without_depths_and_with_equal_ones_tracks_are_the_same(flights, seed):
    """The terms of depth are then 0 (Eqs 4.22 to 4.24)."""
    tracks = flights(seed, 8)
    missing = postprocess(tracks.assign(z=np.nan))
    equal = postprocess(tracks.assign(z=5000.0))
    absent = postprocess(tracks.drop(columns="z"))
    assert missing["z"].isna().all()
    assert (equal["z"] == 5000.0).all()
    pd.testing.assert_frame_equal(missing.drop(columns="z"), absent)
    pd.testing.assert_frame_equal(equal.drop(columns="z"), absent)
