import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.tracklets import Cutting, OutlierRemoval
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


def off(where, count, by=40.0):
    """Columns of a straight tracklet with one position off, counted from 1."""
    return by * (np.arange(1, count + 1) == where)


@pytest.mark.parametrize("count", [5, 6, 10])
def test_one_wrong_position_goes_alone_wherever_it_is_but_second(table, count):
    """Section 4.2.2 screens "except for the initial position", for which it has a rule."""
    for where in {*range(1, count + 1)} - {2}:
        assert removed(table, 5.0 * T[:count], off(where, count)) == [where - 1]


def test_eq_4_20_at_the_second_alone_costs_it_for_what_the_third_or_fourth_did(table):
    def lost(where, **reading):
        tracks = table((T, 5.0 * T, off(where, 10)))
        result = OutlierRemoval(**reading)(tracks)
        return (np.flatnonzero(result["particle"] == -1) + 1).tolist()

    assert [lost(where) for where in (3, 4, 5)] == [[3], [4], [5]]  # Fig. 4.5, situation 3
    assert {2, 3, 4} <= {*lost(4, from_last=False)}
    assert {2, 3} <= {*lost(3, from_last=False)}
    assert lost(5, from_last=False) == [5]


def test_a_jump_over_missed_frames_is_divided_by_them(table):
    frame = np.array([0, 1, 2, 12, 13])
    assert removed(table, [0, 5, 10, 60, 65.0], [0, 0, 0, 50, 50.0], frame) == []


def test_fewer_than_three_points_cannot_be_judged(table):
    assert removed(table, [0.0, 500.0], [0.0, 0.0]) == []
    assert removed(table, [0.0], [0.0]) == []


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.floats(1, 60), st.booleans())
def test_it_is_the_plain_definition(table, plain, same_tracks, seed, scatter, from_last):
    rng = np.random.default_rng(seed)
    tracklets = []
    for count in rng.integers(1, 25, 5):
        frame = np.sort(rng.choice(40, count, replace=False))
        row, col = rng.normal(0, scatter, (2, count)) + 6.0 * frame
        tracklets.append((frame, row, col))
    tracks = table(*tracklets)
    expected = [plain.without_outliers(t, from_last) for t in plain.tracklets_of(tracks)]
    same_tracks(OutlierRemoval(from_last=from_last)(tracks), expected)


@pytest.mark.parametrize("field", ["angle_deg", "change"])
@pytest.mark.parametrize("bad", [np.nan, -3, "a", None, True])
def test_what_is_no_limit_is_refused(field, bad):
    with pytest.raises(InputError, match=f"OutlierRemoval: {field}: must be"):
        OutlierRemoval(**{field: bad})


def test_a_reading_of_eq_4_20_is_on_or_off():
    with pytest.raises(InputError, match="OutlierRemoval: from_last: must be a bool, got 'yes'"):
        OutlierRemoval(from_last="yes")


def test_no_angle_at_all_is_a_limit(table):
    """Every change of direction counts then; without a change of speed it is still none."""
    tracks = table((T[:6], 5.0 * T[:6], 0.1 * T[:6]))
    pd.testing.assert_frame_equal(OutlierRemoval(angle_deg=0, change=1)(tracks), tracks)


def flight(speed_z=-8.0, speed_x=2.0, count=30, start=0, z=6000.0, x=0.0):
    """A straight flight of mm a millisecond, seen 330 times a second."""
    frame = start + np.arange(count)
    t = 1000 * (frame - start) / 330
    places = {"x": x + speed_x * t, "y": 100.0, "z": z + speed_z * t}
    return pd.DataFrame({"frame": frame, "particle": 0, "row": 500.0, "col": 3.0 * t, **places})


def parts(tracks, **limits):
    """The frames of each track after cutting."""
    table = Cutting(**limits)(tracks, 330.0)
    assert list(table["frame"]) == list(tracks["frame"])
    return [list(part["frame"]) for name, part in table.groupby("particle") if name >= 0]


def joined(*flights):
    return pd.concat(flights, ignore_index=True)


def test_a_track_is_cut_at_a_step_that_no_particle_makes():
    whole = flight()
    assert parts(whole) == [list(range(30))]
    fast = flight(speed_z=-31.0)  # below twice the lance's air
    assert parts(fast) == [list(range(30))]
    aside = joined(flight(count=12), flight(start=12, count=18, x=400.0, z=5700.0))
    assert parts(aside) == [list(range(12)), list(range(12, 30))]  # 300 mm aside in 3 ms
    later = joined(flight(count=12), flight(start=22, count=18, x=400.0, z=5700.0))
    assert parts(later) == [[*range(12), *range(22, 40)]]  # in 33 ms it may
    assert parts(later, fastest_m_s=5.0) == [list(range(12)), list(range(22, 40))]


def on_ray(tracks, depth_mm):
    """The same pixels at other depths: a place stays on its pixel's ray (section 4.1.2)."""
    shift = pd.Series(depth_mm, tracks.index) / tracks["z"]
    return tracks.assign(**{axis: tracks[axis] * shift for axis in "xyz"})


@pytest.mark.parametrize("by", [3000.0, -3000.0, 1500.0])
def test_a_jump_along_the_ray_that_stays_is_a_step(by):
    track = flight(x=300.0)
    late = track["frame"] >= 14
    assert parts(on_ray(track, track["z"] + by * late)) == [list(range(14)), list(range(14, 30))]
    back = on_ray(track, track["z"] + by * track["frame"].between(14, 17))
    expected = [list(range(14)), list(range(14, 18)), list(range(18, 30))]
    assert parts(back) == expected
    assert parts(back, depth_mm=1100.0 + abs(by)) == [list(range(30))]


@pytest.mark.parametrize("frames", [[14], [14, 15], [3, 9, 10, 20], [0, 1], [28, 29]])
def test_a_wrong_depth_that_comes_back_soon_is_scatter_and_no_step(frames):
    track = flight(x=300.0)
    wrong = on_ray(track, track["z"] + 3000.0 * track["frame"].isin(frames))
    assert parts(wrong) == [list(range(30))]


def test_depths_that_scatter_as_printed_are_no_steps():
    """Table 5.18: RMSE in depth of 219 mm, the largest of the four fractions."""
    track = flight(count=2000, speed_z=-0.5, x=300.0)
    scatter = np.random.default_rng(1).normal(0.0, 219.0, len(track))
    assert parts(on_ray(track, track["z"] + scatter)) == [list(range(2000))]


def test_in_a_gap_of_the_depth_a_particle_flies_on():
    """A metre in 33 ms is 30 m/s; in one frame it is none that a particle makes."""
    whole = flight(count=40, speed_z=-30.0, x=300.0, z=9000.0)
    gap = whole[~whole["frame"].between(15, 24)].reset_index(drop=True)
    assert parts(gap) == [[*range(15), *range(25, 40)]]
    near = gap.assign(frame=gap["frame"] - 10 * (gap["frame"] > 20))
    assert parts(near) == [list(range(15)), list(range(15, 30))]


def test_an_error_of_the_depth_moves_a_place_along_its_line_of_sight_and_is_no_step_across():
    track = flight(speed_x=0.0, speed_z=0.0, x=600.0)
    assert parts(on_ray(track, 6000.0 * (1 + 0.1 * (track["frame"] % 2)))) == [list(range(30))]


def test_short_parts_are_in_no_track_and_what_has_no_depth_stays_with_what_came_before():
    short = joined(flight(count=2), flight(start=2, x=400.0))
    assert parts(short) == [list(range(2, 32))]
    assert parts(short, least=2) == [[0, 1], list(range(2, 32))]
    aside = joined(flight(count=12), flight(start=12, count=18, x=700.0))
    aside.loc[10:13, ["x", "y", "z"]] = np.nan
    assert parts(aside) == [list(range(14)), list(range(14, 30))]


def test_without_places_in_space_and_without_steps_nothing_changes(table):
    other = flight(start=3).assign(particle=7)
    for tracks in (joined(other, flight()), flight().drop(columns="x"), flight()[:0], flight()[:1]):
        assert Cutting()(tracks, 330.0) is tracks
    blind = flight().assign(x=np.nan, y=np.nan, z=np.nan)
    assert Cutting()(blind, 330.0) is blind
    behind = flight(z=-100.0)
    assert Cutting()(behind, 330.0) is behind


def test_cutting_again_changes_nothing_and_the_order_of_rows_does_not_matter():
    tracks = joined(flight(count=12), flight(start=12, count=18, x=500.0))
    tracks = joined(tracks, flight(start=5, x=-300.0).assign(particle=1))
    cut = Cutting()(tracks, 330.0)
    assert cut["particle"].nunique() == 3
    assert Cutting()(cut, 330.0) is cut
    mixed = tracks.sample(frac=1.0, random_state=2)
    pd.testing.assert_frame_equal(Cutting()(mixed, 330.0).sort_index(), cut)


@pytest.mark.parametrize("field", ["fastest_m_s", "across_mm", "depth_mm", "least"])
def test_what_is_no_limit_of_a_step_is_refused(field):
    with pytest.raises(InputError, match=f"Cutting: {field}"):
        Cutting(**{field: -1})
    with pytest.raises(InputError, match="frame_rate_hz"):
        Cutting()(flight(), 0.0)
