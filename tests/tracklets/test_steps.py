"""Post-processing: all steps, each against its plain definition, and situations of
chapter 4.2.
"""

import tracemalloc

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
    joining,
    postprocess,
)
from kilnflight.tracklets.joining import Candidates, dual_nearest, hungarian
from kilnflight.tracklets.paths import read_paths, tracked

seeds = st.integers(0, 2**32 - 1)
T = np.arange(40)


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
    scatter = np.random.default_rng(seed).normal(0, 30, len(tracks))
    for table in (tracks, tracks.assign(col=tracks["col"] + scatter)):
        left = map(plain.without_outliers, plain.tracklets_of(table))
        same_tracks(OutlierRemoval()(table), [t for t in left if t])
    for step, fusion in ((Connection(), False), (Fusion(), True)):
        pairs = step.candidates(
            read_paths(tracks, "tracks"), np.ones(len(given_tracks), bool)
        )
        costs = np.full(2 * (len(given_tracks),), np.inf)
        costs[pairs.earlier, pairs.later] = pairs.cost
        np.testing.assert_allclose(costs, plain.matrix(given_tracks, fusion), atol=1e-9)
        same_tracks(step(tracks), plain.join(given_tracks, fusion))
    same_tracks(postprocess(tracks), plain.postprocess(tracks))


@pytest.mark.parametrize("step", [*STEPS, postprocess], ids=lambda s: str(s)[:12])
def test_particles_are_numbered_by_first_frame_and_place(step):
    tracks = make_flights(3, 20)
    result = step(tracks)
    named = tracks.assign(particle=97 - 3 * tracks["particle"] % 97)
    pd.testing.assert_frame_equal(step(named), result)
    result = tracked(result)
    assert sorted(set(result["particle"])) == list(range(result["particle"].nunique()))
    first = (
        result.sort_values("frame").groupby("particle")[["frame", "row", "col"]].first()
    )
    pd.testing.assert_frame_equal(first.sort_values(["frame", "row", "col"]), first)
    renamed = tracks.drop(columns="z").rename(columns={"row": "y", "col": "x"})
    expected = step(tracks.drop(columns="z")).rename(columns={"row": "y", "col": "x"})
    pd.testing.assert_frame_equal(step(renamed), expected)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("seed", range(4))
def test_each_step_is_idempotent(step, seed):
    once = step(make_flights(seed, 8))
    pd.testing.assert_frame_equal(step(once), once)


def test_a_merged_frame_is_the_mean_and_the_other_row_keeps_its_place():
    """Fig. 4.10, right: two common frames, 9 and 11."""
    first, other = (
        np.array([1, 3, 4, 5, 7, 9, 10, 11]),
        np.array([8, 9, 11, 13, 14, 15, 16]),
    )
    tracks = make_table(
        (first, 5.0 * first, 0.0, 3000.0), (other, 5.0 * other, 2.0, 3200.0)
    )
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


def test_the_three_conditions_of_fig_4_4():
    tracks = make_table(
        ([0, 1], [0.0, 9.0], 0.0),  # two frames are not more than two
        ([0, 4, 9], [0.0, 9.0, 18.0], 0.0),  # assigned frames count
        (T[:6], 1.0 * T[:6], 0.0),  # 1 px/frame is not more than 1
        (T[:6], 1.1 * T[:6], 0.0),
        (T[:6], [0, 9, 0, 9, 0, 9], 0.0),
        (T[:6], 10 * T[:6] + np.array([0, 2, 0, -2, 0, 2]), 5.0),  # col is constant
    )
    stays = Elimination()(tracks)["particle"] >= 0
    assert tracks.loc[stays, "particle"].unique().tolist() == [1, 3, 5]


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
        (
            [0, 1, 2, 12, 13],
            [0, 5, 10, 60, 65.0],
            [0, 0, 0, 50, 50.0],
            [],
        ),  # over a gap
    ],
)
def test_situations_of_figs_4_5_to_4_7(frame, row, col, removed):
    result = OutlierRemoval()(make_table((frame, row, col)))
    assert (np.flatnonzero(result["particle"] == -1) + 1).tolist() == removed


@pytest.mark.parametrize(
    ("step", "one", "other", "joined"),
    [
        (Connection(), line(0, 9), line(23, 30), True),  # gap 14
        (Connection(), line(0, 9), line(24, 30), False),  # gap 15
        (Connection(), line(0, 9), line(6, 20), True),  # 4 common frames
        (Connection(), line(0, 9), line(5, 20), False),  # 5
        (Connection(), line(0, 20), line(8, 10), False),  # one within the other
        (Connection(), line(0, 9, z=1000.0), line(10, 19, z=2400.0), True),  # Eq. 4.22
        (Connection(), line(0, 9, z=1000.0), line(10, 19, z=2500.0), False),
        (
            Connection(),
            line(0, 9, z=1000.0),
            line(11, 19, z=3900.0),
            True,
        ),  # over two frames
        # the speed across the gap: up to (36 + 2 * 5) / 2 = 5 + 18 px/frame
        (Connection(), line(0, 9), (T[11:21], 5.0 * T[11:21] + 36, 0.0), True),
        (Connection(), line(0, 9), (T[11:21], 5.0 * T[11:21] + 37, 0.0), False),
        (Fusion(), line(0, 39), line(5, 44, col=10.0), True),  # Fig. 4.15 right
        (Fusion(), line(0, 39), line(5, 44, col=11.0), False),
    ],
)
def test_the_criteria_of_a_connection_and_a_fusion(step, one, other, joined):
    tracks = make_table(one, other)
    assert number(tracks, step) == number(tracks[::-1], step) == 2 - joined


def chosen(matching, matrix):
    """The joined pairs of a cost matrix, infinite where a pair is impossible."""
    earlier, later = np.nonzero(matrix < np.inf)
    result = matching(Candidates(earlier, later, matrix[earlier, later]))
    return sorted(zip(earlier[result].tolist(), later[result].tolist(), strict=True))


def test_munkres_gives_up_the_nearest_pair_and_dnn_does_not():
    """As in Fig. 4.14, whose numbers the text does not give: 1-2 is best, Munkres takes
    1-3.
    """
    matrix = np.full((4, 4), np.inf)
    matrix[0, 1], matrix[0, 2], matrix[3, 1] = 1.0, 5.0, 4.0
    assert chosen(dual_nearest, matrix) == [(0, 1)]
    assert chosen(hungarian, matrix) == [(0, 2), (3, 1)]
    tracks = make_table(line(0, 5), line(8, 12), line(15, 20))
    assert number(tracks, Connection(matching=hungarian)) == 1


@given(seeds, st.integers(1, 9), st.sampled_from([3, 10**6]))
def test_munkres_joins_most_pairs_at_the_least_cost(seed, size, levels):
    rng = np.random.default_rng(seed)
    matrix = rng.integers(0, levels, (size, size)).astype(float)
    matrix[(rng.random((size, size)) < 0.6) | (np.tri(size) > 0)] = np.inf
    costs = matrix[linear_sum_assignment(np.where(matrix < np.inf, matrix, 1e9))]
    result = chosen(hungarian, matrix)
    assert len(result) == np.isfinite(costs).sum()
    assert sum(matrix[pair] for pair in result) == pytest.approx(
        costs[costs < np.inf].sum()
    )


def test_pairs_tested_part_by_part_are_joined_alike(monkeypatch):
    tracks = make_flights(5, 12)
    expected = postprocess(tracks)
    for most in (1, 17):
        monkeypatch.setattr(joining, "MOST_PAIRS", most)
        pd.testing.assert_frame_equal(postprocess(tracks), expected)


def test_memory_does_not_grow_with_the_pairs_of_tracklets_at_one_time(monkeypatch):
    """500 tracks born in 20 frames are 125,000 pairs, which take above 40 MB."""
    rng = np.random.default_rng(0)
    born, length = rng.integers(0, 20, 500), rng.integers(4, 20, 500)
    tracks = pd.DataFrame({"particle": np.repeat(np.arange(500), length)})
    age = tracks.groupby("particle").cumcount()
    place, step = rng.uniform(0, 4000, (500, 2)), rng.normal(0, 4, (500, 2))
    tracks["frame"] = born[tracks["particle"]] + age
    tracks[["row", "col"]] = (
        place[tracks["particle"]] + step[tracks["particle"]] * age.to_numpy()[:, None]
    )
    expected = Connection()(tracks)
    monkeypatch.setattr(joining, "MOST_PAIRS", 2**12)
    tracemalloc.start()
    found = Connection()(tracks)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    pd.testing.assert_frame_equal(found, expected)
    assert peak < 15e6
