"""Post-processing: all steps, each against its plain definition, and situations of chapter 4.2."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from tests.definitions import plain_tracklets as plain
from tests.definitions.plain_tracklets import make_flights, make_table

from kilnflight.tracklets import (
    STEPS,
    Connection,
    Elimination,
    Fusion,
    OutlierRemoval,
    eliminate,
    postprocess,
    tracked,
)
from kilnflight.tracklets.joining import Candidates, Costs, dual_nearest, hungarian
from kilnflight.tracklets.paths import read_paths, turns, velocities

seeds = st.integers(0, 2**32 - 1)
every = pytest.mark.parametrize("step", [*STEPS, postprocess], ids=lambda s: str(s)[:12])
T, C = np.arange(40), np.inf


def same_tracks(found, expected):
    """Raise unless a table holds the tracklets of the plain definition."""
    found = plain.tracklets_of(found)
    expected = sorted(expected, key=lambda t: (min(t), t[min(t)][:2]))
    assert [sorted(t) for t in found] == [sorted(t) for t in expected]
    for first, other in zip(found, expected, strict=True):
        for frame, place in first.items():
            np.testing.assert_allclose(place, other[frame], rtol=1e-9, atol=1e-9)


def line(first, last, col=0.0, step=1, z=np.nan):
    """A straight tracklet of 5 px/frame."""
    frame = np.arange(first, last + 1, step)
    return frame, 5.0 * frame, col, z


def number(tracks, step=postprocess):
    return tracked(step(tracks))["particle"].nunique()


@pytest.mark.parametrize("digits", [0, 12])  # whole pixels have ties
@given(seeds, st.integers(1, 6))
def test_the_plain_definitions(digits, seed, count):
    tracks = make_flights(seed, count).round({"row": digits, "col": digits})
    given_tracks = plain.tracklets_of(tracks)
    same_tracks(Elimination()(tracks), plain.eliminate(given_tracks))
    left = [t for t in map(plain.without_outliers, given_tracks) if t]
    same_tracks(OutlierRemoval()(tracks), left)
    same_tracks(Connection()(tracks), plain.join(given_tracks))
    same_tracks(Fusion()(tracks), plain.join(given_tracks, fusion=True))
    same_tracks(postprocess(tracks), plain.postprocess(tracks))


@given(seeds)
def test_the_plain_definitions_of_outliers_and_of_tracks_side_by_side(seed):
    rng, parts = np.random.default_rng(seed), []
    for _ in range(6):
        frame = np.arange(*np.sort(rng.choice(30, 2, replace=False)))
        row, col = 6.0 * frame + rng.normal(0, 4, (2, len(frame)))
        parts.append((frame, row, col, rng.normal(3000, 500, len(frame))))
    tracks = make_table(*parts)
    same_tracks(Fusion()(tracks), plain.join(plain.tracklets_of(tracks), fusion=True))
    scattered = tracks.assign(col=tracks["col"] + rng.normal(0, 30, len(tracks)))
    left = [plain.without_outliers(t) for t in plain.tracklets_of(scattered)]
    same_tracks(OutlierRemoval()(scattered), [t for t in left if t])


@every
def test_rows_stay_and_particles_are_numbered_by_first_frame_and_place(step):
    tracks = make_flights(3, 20)
    result = step(tracks)
    kept = ["frame", "gray"]  # gray is different in every row
    pd.testing.assert_frame_equal(result[kept], tracks[kept])
    named = tracks.assign(particle=97 - 3 * tracks["particle"] % 97)
    pd.testing.assert_frame_equal(step(named), result)
    result = tracked(result)
    assert sorted(set(result["particle"])) == list(range(result["particle"].nunique()))
    first = result.sort_values("frame").groupby("particle")[["frame", "row", "col"]].first()
    pd.testing.assert_frame_equal(first.sort_values(["frame", "row", "col"]), first)
    renamed = tracks.drop(columns="z").rename(columns={"row": "y", "col": "x"})
    expected = step(tracks.drop(columns="z")).rename(columns={"row": "y", "col": "x"})
    pd.testing.assert_frame_equal(step(renamed), expected)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("seed", range(4))
def test_each_step_is_idempotent(step, seed):
    once = step(make_flights(seed, 8))
    pd.testing.assert_frame_equal(step(once), once)


def test_steps_one_by_one_are_the_whole():
    table = make_flights(5, 20)
    expected, counts = postprocess(table), [table["particle"].nunique()]
    for step in STEPS:
        table = step(table)
        counts.append(tracked(table)["particle"].nunique())
    assert counts[0] > counts[1] >= counts[2] > counts[3] >= counts[4]
    pd.testing.assert_frame_equal(tracked(table), tracked(expected))


def test_a_merged_frame_is_the_mean_and_the_other_row_keeps_its_place():
    """Fig. 4.10, right: two common frames, 9 and 11."""
    first, other = np.array([1, 3, 4, 5, 7, 9, 10, 11]), np.array([8, 9, 11, 13, 14, 15, 16])
    tracks = make_table((first, 5.0 * first, 0.0, 3000.0), (other, 5.0 * other, 2.0, 3200.0))
    tracks = tracks.assign(x=tracks["z"] / 10, y=1.0)
    result = postprocess(tracks)
    lost = result["particle"] == -1
    pd.testing.assert_frame_equal(result[lost].assign(particle=1), tracks.loc[[9, 10]])
    merged = result[~lost].set_index("frame").loc[[9, 11]]
    assert merged[["col", "z", "x"]].to_numpy().tolist() == [[1.0, 3100.0, 310.0]] * 2
    deep = make_table(line(0, 9), line(9, 15, z=3000.0))  # the row with a depth stays
    result = Connection()(deep)
    assert result.index[result["particle"] == -1].tolist() == [9]
    assert result.loc[10, ["row", "z"]].tolist() == [45.0, 3000.0]


@pytest.mark.parametrize(
    ("tracklet", "stays"),
    [
        (([0, 1], [0.0, 9.0], 0.0), False),  # two frames are not more than two
        (([0, 4, 9], [0.0, 9.0, 18.0], 0.0), True),  # assigned frames count
        ((T[:6], 1.0 * T[:6], 0.0), False),  # 1 px/frame is not more than 1
        ((T[:6], 1.1 * T[:6], 0.0), True),
        ((T[:6], [0, 9, 0, 9, 0, 9], 0.0), False),
        ((T[:6], 10 * T[:6] + np.array([0, 2, 0, -2, 0, 2]), 5.0), True),  # col is constant
    ],
)
def test_the_three_conditions_of_fig_4_4(tracklet, stays):
    assert number(make_table(tracklet), Elimination()) == stays


def test_speed_and_regularity():
    """Eqs 4.16 and 4.17; up to three points and without motion the correlation is 1."""
    frame, place = np.array([0, 1, 3]), np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 10.0]])
    names = np.zeros(9, int)
    assert velocities(frame, place).tolist() == [[3.0, 4.0], [0.0, 3.0]]
    assert eliminate.mean_speed(names[:3], frame, place).tolist() == [(5.0 + 3.0) / 2]
    assert eliminate.mean_speed(names[:1], frame[:1], place[:1]).tolist() == [0.0]
    assert eliminate.regularity(names[:3], frame, place).tolist() == [1.0]
    assert eliminate.regularity(names, T[:9], np.full((9, 2), 3.7)).tolist() == [1.0]


def test_angle_and_change_are_those_of_fig_4_5():
    before = np.array([[3.0, 0.0], [1.0, 1.0], [0.0, 0.0], [-30.0, -30.0]])
    after = np.array([[0.0, 4.0], [-1.0, -1.0], [0.0, 30.0], [-0.0, 0.0]])
    angle, change = turns(before, after)
    np.testing.assert_allclose(angle, [90.0, 180.0, 0.0, 0.0])  # rest has no direction
    np.testing.assert_allclose(change, [5.0, 8**0.5, 30.0, 1800**0.5])


def off(where, count):
    """Columns of a straight tracklet with positions off, counted from 1."""
    return 60.0 * np.isin(np.arange(1, count + 1), where)


@pytest.mark.parametrize(
    ("frame", "row", "col", "removed"),
    [
        (T[:6], [0, 5, 10, 5, 0, -5.0], 0.0, []),  # situation 1: an angle alone
        (T[:6], [0, 5, 10, 60, 110, 160.0], 0.0, []),  # situation 2: a change alone
        (T[:10], 5.0 * T[:10], off([6, 10], 10), [6, 10]),  # situation 3: both
        (T[:10], 5.0 * T[:10], off(1, 10), [1]),
        (T[:4], 5.0 * T[:4], off(2, 4), [2]),  # judged backwards
        (T[:10], 5.0 * T[:10], off(2, 10), [1, 2]),  # the first point comes first
        (T[:6], 5.0 * T[:6], off(4, 6), [4]),  # Fig. 4.5, situation 3
        ([0, 1, 2, 12, 13], [0, 5, 10, 60, 65.0], [0, 0, 0, 50, 50.0], []),  # over a gap
        (T[:2], [0.0, 500.0], 0.0, []),
    ],
)
def test_situations_of_figs_4_5_to_4_7(frame, row, col, removed):
    result = OutlierRemoval()(make_table((frame, row, col)))
    assert (np.flatnonzero(result["particle"] == -1) + 1).tolist() == removed


@pytest.mark.parametrize(
    ("one", "other", "joined"),
    [
        (line(0, 9), line(23, 30), True),  # gap 14
        (line(0, 9), line(24, 30), False),  # gap 15
        (line(0, 9), line(6, 20), True),  # 4 common frames
        (line(0, 9), line(5, 20), False),  # 5
        (line(0, 12, step=2), line(9, 21, step=2), True),  # overlap, none in common
        (line(0, 20), line(8, 10), False),  # one within the other
        (line(0, 9), line(12, 20, col=200.0), False),  # an outlier in the connected part
        (
            line(0, 9),
            (T[11:21], 5.0 * T[11:21] + 36, 0.0),
            True,
        ),  # (36 + 2 * 5) / 2 = 5 + 18 px/frame
        (line(0, 9), (T[11:21], 5.0 * T[11:21] + 37, 0.0), False),  # 23.5 px/frame, straight ahead
        (line(0, 12, step=2), line(9, 21, col=20.0, step=2), True),  # 20.6 px/frame to and fro
        (line(0, 12, step=2), line(9, 21, col=25.0, step=2), False),  # 25.5 > 5 + 18
        ((T[:4], 0.5 * T[:4], 0.0), (T[5:9], 3.0, 0.0), False),  # slow
        ((T[:3], [0.0, 8.0, 0.0], 0.0), (T[3:6], [8.0, 0.0, 8.0], 0.0), False),  # irregular
        (line(0, 9, z=1000.0), line(10, 19, z=2400.0), True),  # Eq. 4.22
        (line(0, 9, z=1000.0), line(10, 19, z=2500.0), False),
        (line(0, 9, z=1000.0), line(11, 19, z=3900.0), True),  # over two frames
        (line(0, 0), line(1, 1), True),  # single points give what they have
        (line(0, 0), line(0, 0), False),
    ],
)
def test_the_criteria_of_a_connection(one, other, joined):
    tracks = make_table(one, other)
    assert number(tracks, Connection()) == number(tracks[::-1], Connection()) == 2 - joined


@pytest.mark.parametrize(
    ("other", "fused"),
    [
        ((T + 5, 5.0 * T + 25, 10.0), True),  # Fig. 4.15 right
        ((T + 5, 5.0 * T + 25, 11.0), False),
        ((T[9:20], 5.0 * T[9:20], 3.0), True),  # within
        ((T + 40, 5.0 * T + 200, 0.0), False),  # no overlap
        ((T[1::2] + 0, 5.0 * T[1::2], 0.0), True),
    ],
)
def test_tracks_side_by_side_are_fused(other, fused):
    assert number(make_table((T, 5.0 * T, 0.0), other), Fusion()) == 2 - fused


def test_each_term_of_eq_4_24():
    """A right angle at constant speed: one turn of 90 degrees among four."""
    tracks = make_table(([0, 1, 2], [0, 4, 8.0], 0.0), ([3, 4, 5], 8.0, [4, 8, 12.0]))
    paths, none = read_paths(tracks, "tracks"), dict.fromkeys(vars(Costs()), 0.0)
    terms = {"angle": 90 / 4, "change": np.hypot(4, 4) / 4, "depth": 0, "gap": 1, "overlap": 0}
    for term, value in terms.items():
        step = Connection(costs=Costs(**none | {term: 1.0}))
        assert step.candidates(paths, np.ones(2, bool)).cost == pytest.approx([value])


def chosen(matching, matrix):
    """The pairs that are joined of a cost matrix, infinite where a pair is impossible."""
    earlier, later = np.nonzero(np.asarray(matrix) != C)
    result = matching(Candidates(earlier, later, np.asarray(matrix)[earlier, later]))
    return sorted(zip(earlier[result].tolist(), later[result].tolist(), strict=True))


def test_munkres_gives_up_the_nearest_pair_and_dnn_does_not():
    """As in Fig. 4.14, whose numbers the text does not give: 1-2 is best, Munkres takes 1-3."""
    matrix = np.full((4, 4), C)
    assert chosen(dual_nearest, matrix) == chosen(hungarian, matrix) == []
    matrix[0, 1], matrix[0, 2], matrix[3, 1] = 1.0, 5.0, 4.0
    assert chosen(dual_nearest, matrix) == [(0, 1)]
    assert chosen(hungarian, matrix) == [(0, 2), (3, 1)]
    tracks = make_table(line(0, 5), line(8, 12), line(15, 20))
    assert number(tracks, Connection(matching=hungarian)) == 1


@given(seeds, st.integers(1, 9), st.sampled_from([3, 10**6]))
def test_matchings_of_any_matrix(seed, size, levels):
    rng = np.random.default_rng(seed)
    matrix = rng.integers(0, levels, (size, size)).astype(float)
    matrix[(rng.random((size, size)) < 0.6) | (np.tri(size) > 0)] = C
    either = np.minimum(matrix, matrix.T)
    nearest = either.argmin(axis=1)
    mutual = [(i, int(k)) for i, k in enumerate(nearest) if i < k and nearest[k] == i]
    assert chosen(dual_nearest, matrix) == [pair for pair in mutual if matrix[pair] < C]
    costs = matrix[linear_sum_assignment(np.where(matrix < C, matrix, 1e9))]
    result = chosen(hungarian, matrix)
    assert len(result) == np.isfinite(costs).sum()
    assert sum(matrix[pair] for pair in result) == pytest.approx(costs[costs < C].sum())
