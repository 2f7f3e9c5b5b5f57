import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.tables import DETECTIONS
from kilnflight.tracklets import STEPS, postprocess, stages, tracked

EVERY = pytest.mark.parametrize("step", [*STEPS, postprocess], ids=lambda s: str(s)[:12])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_the_whole_is_the_plain_definition(flights, plain, same_tracks, seed, count):
    tracks = flights(seed, count)
    same_tracks(postprocess(tracks), plain.postprocess(tracks))


@EVERY
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_nothing_is_lost_and_the_order_of_rows_is_nothing(flights, step, seed):
    tracks = flights(seed, 6)
    before = tracks.copy()
    result = step(tracks)
    pd.testing.assert_frame_equal(tracks, before)  # the caller's table is left alone
    assert list(result.columns) == list(tracks.columns)
    for column in ("frame", "gray"):  # gray is different in every row
        np.testing.assert_array_equal(result[column], tracks[column])
    np.testing.assert_array_equal(result.index, tracks.index)
    shuffled = tracks.sample(frac=1, random_state=seed)
    pd.testing.assert_frame_equal(step(shuffled).sort_index(), result)
    named = tracks.assign(particle=97 - 3 * tracks["particle"] % 97)
    pd.testing.assert_frame_equal(step(named), result)


@EVERY
def test_particles_are_numbered_by_first_frame_and_place(flights, step):
    result = tracked(step(flights(3, 20)))
    assert sorted(set(result["particle"])) == list(range(result["particle"].nunique()))
    assert not result.duplicated(["frame", "particle"]).any()
    first = result.sort_values("frame").groupby("particle")[["frame", "row", "col"]].first()
    pd.testing.assert_frame_equal(first.sort_values(["frame", "row", "col"]), first)


@EVERY
def test_a_table_without_rows_or_tracks_is_normal(table, step):
    empty = DETECTIONS.empty().assign(particle=pd.Series(dtype=int))
    result = step(empty)
    assert list(result.columns) == list(empty.columns)
    assert len(result) == 0
    assert result["particle"].dtype == np.int64
    assert len(step(pd.DataFrame(columns=["frame", "particle", "row", "col"]))) == 0
    lost = table(([1, 1], [2.0, 3.0], 4.0))[lambda t: t["frame"] > 5]
    assert len(step(lost)) == 0
    nobody = table(([1, 2], [2.0, 3.0], 4.0)).assign(particle=-1)
    pd.testing.assert_frame_equal(step(nobody), nobody)


@EVERY
def test_one_good_track_stays_as_it_is(table, step):
    frame = np.arange(20)
    tracks = table((frame, 7.0 * frame, 0.1 * frame**2, 3000.0))
    pd.testing.assert_frame_equal(step(tracks), tracks)
    flat = tracks.drop(columns=["z", "gray"])
    pd.testing.assert_frame_equal(step(flat), flat)


@pytest.mark.parametrize("step", STEPS)
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_each_step_changes_nothing_the_second_time(flights, step, seed):
    once = step(flights(seed, 8))
    pd.testing.assert_frame_equal(step(once), once)


def test_stages_lead_to_the_result(flights):
    tracks = flights(5, 20)
    named = dict(stages(tracks))
    assert list(named) == ["Elimination", "OutlierRemoval", "Connection", "Fusion"]
    pd.testing.assert_frame_equal(named["Fusion"], postprocess(tracks))
    pd.testing.assert_frame_equal(named["OutlierRemoval"], postprocess(tracks, steps=STEPS[:2]))
    count = [tracked(table)["particle"].nunique() for table in (tracks, *named.values())]
    assert count[0] > count[1] >= count[2] > count[3] >= count[4]


def test_x_and_y_follow_the_depth_and_whole_pixels_become_floats(table):
    frame = np.arange(20)
    tracks = table((frame[:12], 5 * frame[:12], 0, 3000.0), (frame[9:], 5 * frame[9:], 4, 3200.0))
    tracks = tracks.astype({"row": int, "col": int}).assign(x=tracks["z"] / 10, y=1.0)
    result = tracked(postprocess(tracks)).set_index("frame")
    assert result.loc[[9, 10, 11], "x"].tolist() == [310.0] * 3
    assert result.loc[[9, 10, 11], "z"].tolist() == [3100.0] * 3
    assert result["row"].dtype == float


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop(columns="row"), "column.s. row missing"),
        (lambda t: t.assign(col=[1.0, np.nan, 2.0]), "column col is nan in row 1"),
        (lambda t: t.assign(row=[1.0, 2.0, np.inf]), "column row is inf in row 2"),
        (lambda t: t.assign(z=[1.0, np.nan, -np.inf]), "column z is -inf in row 2"),
        (lambda t: t.assign(frame=[0.0, 0.5, 2.0]), "column frame: 0.5 in row 1"),
        (lambda t: t.assign(particle=-7), "particle -7; tracks are numbered from 0"),
        (lambda t: t.assign(row=1j), "column row is not made of numbers"),
        (lambda t: pd.concat([t, t["row"]], axis=1), "more than one column row"),
        (lambda t: t.assign(particle="a"), "column particle holds"),
        (lambda t: t.assign(row="a"), "column row is not made of numbers"),
        (lambda t: t.assign(frame=[0, 1, 1]), "particle 0 has two rows in frame 1"),
        (lambda t: t.to_numpy(), "no table"),
    ],
)
@EVERY
def test_what_is_no_track_table_is_refused(table, step, change, message):
    tracks = table(([0, 1, 2], [0.0, 5.0, 10.0], 0.0))
    with pytest.raises(InputError, match=message):
        step(change(tracks))


def test_two_rows_of_no_track_in_one_frame_are_normal(table):
    tracks = table(([0, 1, 2], [0.0, 5.0, 10.0], 0.0))
    clutter = tracks.assign(particle=-1)
    both = pd.concat([tracks, clutter, clutter], ignore_index=True)
    assert postprocess(both)["particle"].tolist() == [0] * 3 + [-1] * 6


@EVERY
def test_whole_frames_may_be_held_as_floats(flights, step):
    tracks = flights(2, 6)
    floats = tracks.astype({"frame": float, "particle": float})
    expected = step(tracks)
    pd.testing.assert_frame_equal(step(floats), expected.astype({"frame": float}))
