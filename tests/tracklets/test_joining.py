from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from kilnflight.checks import InputError
from kilnflight.tracklets import (
    Connection,
    Costs,
    DualNearest,
    Fusion,
    Hungarian,
    Pairs,
    tracked,
)
from kilnflight.tracklets.paths import read_paths

ONLY = dict.fromkeys(Costs.__dataclass_fields__, 0.0)


def pairs(tracks, **costs):
    paths = read_paths(tracks, "here")
    step = Connection(costs=Costs(**{**ONLY, **costs}) if costs else Costs())
    result = step.candidates(paths, np.ones(len(paths.starts) - 1, dtype=bool))
    return list(zip(*(values.tolist() for values in result), strict=True))


def line(first, last, col=0.0, step=1, z=np.nan):
    frame = np.arange(first, last + 1, step)
    return frame, 5.0 * frame, col, z


def ahead(first, last, jump):
    frame, row, col, z = line(first, last)
    return frame, row + jump, col, z


def number(tracks, step=None):
    return tracked((step or Connection())(tracks))["particle"].nunique()


def test_fig_4_10_left_a_gap_is_connected(table):
    first, other = [1, 3, 4, 5, 7, 8], [11, 13, 14, 15]
    tracks = table((first, 5.0 * np.array(first), 0.0), (other, 5.0 * np.array(other), 0.0))
    assert pairs(tracks) == [(0, 1, pytest.approx(3.0))]  # d times 11 - 8
    result = Connection()(tracks)
    assert (result["particle"] == 0).all()
    np.testing.assert_array_equal(result["row"], tracks["row"])


def test_fig_4_10_right_an_overlap_is_merged_to_the_mean(table):
    first, other = [1, 3, 4, 5, 7, 9, 10, 11], [8, 9, 11, 13, 14, 15, 16]
    tracks = table((first, 5.0 * np.array(first), 0.0, 3000.0), (other, 5.0 * np.array(other), 2.0))
    (pair,) = pairs(tracks, overlap=2.0)
    assert pair == (0, 1, 4.0)  # e times two common frames, 9 and 11
    result = Connection()(tracks)
    lost = result["particle"] == -1
    assert result[lost].index.tolist() == [9, 10]  # frames 9 and 11 of the second
    assert (result.loc[lost, "col"] == 2.0).all()  # keep their own place
    merged = result[~lost].set_index("frame")
    assert merged.loc[[9, 11], "col"].tolist() == [1.0, 1.0]
    assert merged.loc[[9, 11], "z"].tolist() == [3000.0, 3000.0]
    assert merged.index.is_unique


def test_the_row_with_a_depth_stays(table):
    tracks = table(line(0, 9), line(9, 15, z=3000.0)).assign(x=7.0, y=np.nan)
    result = Connection()(tracks)
    assert result.index[result["particle"] == -1].tolist() == [9]
    assert result.loc[10, ["row", "z", "x"]].tolist() == [45.0, 3000.0, 7.0]


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
        (line(0, 9), line(12, 20, col=4.0), True),
        (line(0, 9), ahead(11, 20, 36.0), True),  # (36 + 2 * 5) / 2 = 5 + 18 px/frame
        (line(0, 9), ahead(11, 20, 37.0), False),  # 23.5 px/frame, straight ahead
        (line(0, 9), ahead(23, 30, 300.0), False),  # far apart
        (line(0, 12, step=2), line(9, 21, col=20.0, step=2), True),  # 20.6 px/frame to and fro
        (line(0, 12, step=2), line(9, 21, col=25.0, step=2), False),  # 25.5 > 5 + 18
        ((np.arange(4), 0.5 * np.arange(4), 0.0), (np.arange(5, 9), 3.0, 0.0), False),  # slow
        (line(0, 9, z=1000.0), line(10, 19, z=2400.0), True),  # Eq. 4.22
        (line(0, 9, z=1000.0), line(10, 19, z=2500.0), False),
        (line(0, 9, z=1000.0), line(11, 19, z=3900.0), True),  # over two frames
        (line(0, 0), line(1, 1), True),  # single points give what they have
        (line(0, 0), line(0, 0), False),
    ],
)
def test_the_criteria(table, one, other, joined):
    tracks = table(one, other)
    assert number(tracks) == (1 if joined else 2)
    assert number(tracks.iloc[::-1]) == (1 if joined else 2)


def test_an_irregular_connected_part_is_false(table):
    zigzag = np.array([0.0, 8.0, 0.0])
    tracks = table(([0, 1, 2], zigzag, 0.0), ([3, 4, 5], 8.0 - zigzag, 0.0))
    assert number(tracks) == 2
    anything = replace(Connection(), false=replace(Connection().false, regularity=0.0))
    assert number(tracks, anything) == 1


def test_points_without_a_depth_are_skipped(table):
    z = np.array([np.nan, 1000.0, np.nan, np.nan, 3000.0, np.nan])
    tracks = table((np.arange(3), 5.0 * np.arange(3), 0.0, z[:3]),
                   (np.arange(3, 6), 5.0 * np.arange(3, 6), 0.0, z[3:]))  # fmt: skip
    (pair,) = pairs(tracks, depth=1.0)
    assert pair[2] == pytest.approx(2000.0 / 3)


def test_each_term_of_eq_4_24(table):
    """A right angle at constant speed: one turn of 90 degrees among four."""
    tracks = table(([0, 1, 2], [0, 4, 8.0], 0.0), ([3, 4, 5], 8.0, [4, 8, 12.0]))
    expected = {"angle": 90 / 4, "change": np.hypot(4, 4) / 4, "depth": 0, "gap": 1, "overlap": 0}
    for term, value in expected.items():
        (pair,) = pairs(tracks, **{term: 1.0})
        assert pair[2] == pytest.approx(value)
    (pair,) = pairs(tracks)
    assert pair[2] == pytest.approx(2 * 90 / 4 + 2 * np.hypot(4, 4) / 4 + 1)


def test_the_cheapest_is_joined_and_then_judged_anew(table):
    tracks = table(line(0, 5), line(8, 12), line(8, 30, col=6.0), line(15, 20))
    result = Connection()(tracks)
    names = result.groupby(np.repeat(np.arange(4), [6, 5, 23, 6]))["particle"].first()
    assert names.tolist() == [0, 0, 1, 0]


def test_munkres_is_the_alternative(table):
    tracks = table(line(0, 5), line(8, 12), line(15, 20))
    assert number(tracks, Connection(matching=Hungarian())) == 1


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.sampled_from([0, 12]))
def test_it_is_the_plain_definition(flights, plain, same_tracks, seed, count, digits):
    tracks = flights(seed, count).round({"row": digits, "col": digits})
    expected = [(i, k, c) for i, k, c in pairs(tracks)]
    matrix = plain.matrix(plain.tracklets_of(tracks), False)
    result = np.argwhere(np.isfinite(matrix))
    assert sorted((i, k) for i, k, _ in expected) == [tuple(x) for x in result.tolist()]
    for i, k, cost in expected:
        assert cost == pytest.approx(matrix[i, k], abs=1e-4)  # arc cosine near 0 degrees
    same_tracks(Connection()(tracks), plain.join(plain.tracklets_of(tracks)))


@pytest.mark.parametrize("bad", [-1.0, np.nan, "a", None, True])
def test_what_is_no_limit_is_refused(bad):
    for field in ("gap", "overlap", "depth"):
        with pytest.raises(InputError, match=f"Connection: {field}: must be"):
            Connection(**{field: bad})
    for field in Costs.__dataclass_fields__:
        with pytest.raises(InputError, match=f"Costs: {field}: must be"):
            Costs(**{field: bad})


def test_a_weight_without_end_is_refused():
    with pytest.raises(InputError, match="Costs: angle"):
        Costs(angle=np.inf)


@pytest.mark.parametrize("step", [Connection, Fusion])
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"outliers": 3}, "outliers: must be a OutlierRemoval, got 3"),
        ({"costs": 3}, "costs: must be a Costs, got 3"),
        ({"false": None}, "false: must be a Elimination, got None"),
        ({"matching": "dnn"}, "matching: 'dnn' cannot be used"),
        ({"matching": Hungarian}, "matching: Hungarian is a class"),
        ({"feature": 1.0}, "feature: 1.0 cannot be used"),
    ],
)
def test_parts_of_another_kind_are_refused(step, wrong, message):
    with pytest.raises(InputError, match=f"{step.__name__}: {message}"):
        step(**wrong)


T = np.arange(40)


def number_fused(tracks):
    return tracked(Fusion()(tracks))["particle"].nunique()


@pytest.mark.parametrize(
    ("one", "other", "fused"),
    [
        ((T, 5.0 * T, 0.0), (T + 5, 5.0 * T + 25, 8.0), True),  # Fig. 4.15 right
        ((T, 5.0 * T, 0.0), (T + 5, 5.0 * T + 25, 10.0), True),
        ((T, 5.0 * T, 0.0), (T + 5, 5.0 * T + 25, 11.0), False),
        ((T, 5.0 * T, 0.0), (T, 5.0 * T, 3.0), True),  # the same frames
        ((T, 5.0 * T, 0.0), (T[9:20], 5.0 * T[9:20], 3.0), True),  # within
        ((T, 5.0 * T, 0.0), (T + 40, 5.0 * T + 200, 0.0), False),  # no overlap
        ((T[::2], 5.0 * T[::2], 0.0), (T[1::2], 5.0 * T[1::2], 0.0), False),  # none in common
    ],
)
def test_what_runs_side_by_side_is_fused(table, one, other, fused):
    assert number_fused(table(one, other)) == (1 if fused else 2)


def test_fused_places_are_means_and_three_become_one(table):
    result = Fusion()(table(*((T, 5.0 * T, col) for col in (0.0, 2.0, 7.0))))
    assert (tracked(result)["col"] == (1.0 + 7.0) / 2).all()  # of the cheapest pair, then the third
    assert (result["particle"] == -1).sum() == 80


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_fusion_is_the_plain_definition(table, plain, same_tracks, seed):
    rng = np.random.default_rng(seed)
    tracklets = []
    for _ in range(6):
        frame = np.arange(*np.sort(rng.choice(30, 2, replace=False)))
        row, col = 6.0 * frame + rng.normal(0, 4, (2, len(frame)))
        tracklets.append((frame, row, col, rng.normal(3000, 500, len(frame))))
    tracks = table(*tracklets)
    same_tracks(Fusion()(tracks), plain.join(plain.tracklets_of(tracks), fusion=True))


def test_what_is_no_limit_of_fusion_is_refused():
    for bad in (-1.0, np.nan, "a", None):
        with pytest.raises(InputError, match="Fusion: distance: must be"):
            Fusion(distance=bad)


C = np.inf
MATCHINGS = (DualNearest(), Hungarian())


def listed(matrix):
    """The possible pairs of a cost matrix: infinite where a pair is impossible."""
    matrix = np.asarray(matrix)
    earlier, later = np.nonzero(matrix != C)
    return Pairs(earlier, later, matrix[earlier, later])


def chosen(matching, matrix):
    pairs = listed(matrix)
    result = matching(pairs)
    return sorted(zip(pairs.earlier[result].tolist(), pairs.later[result].tolist(), strict=True))


def test_munkres_gives_up_the_nearest_pair_and_dnn_does_not():
    """As in Fig. 4.14, whose numbers the text does not give: 1-2 is best, Munkres takes 1-3."""
    matrix = np.full((4, 4), C)
    matrix[0, 1], matrix[0, 2], matrix[3, 1] = 1.0, 5.0, 4.0
    assert chosen(DualNearest(), matrix) == [(0, 1)]
    assert chosen(Hungarian(), matrix) == [(0, 2), (3, 1)]


def test_a_tracklet_has_one_nearest_neighbour_on_either_side():
    matrix = np.full((3, 3), C)
    matrix[0, 1], matrix[1, 2] = 2.0, 1.0
    assert chosen(DualNearest(), matrix) == [(1, 2)]
    assert chosen(Hungarian(), matrix) == [(0, 1), (1, 2)]


@pytest.mark.parametrize("matching", MATCHINGS)
def test_nothing_possible_is_nothing(matching):
    for size in (0, 3):
        result = matching(listed(np.full((size, size), C)))
        assert result.shape == (0,)
        assert result.dtype == np.int64
    assert chosen(matching, [[C, 0.0], [C, C]]) == [(0, 1)]


def random_matrix(seed, size, levels):
    rng = np.random.default_rng(seed)
    matrix = rng.integers(0, levels, (size, size)).astype(float)
    matrix[rng.random((size, size)) < 0.6] = C
    return np.triu(matrix, 1) + np.tril(np.full((size, size), C))


matrices = st.builds(
    random_matrix, st.integers(0, 2**32 - 1), st.integers(1, 9), st.sampled_from([3, 10**6])
)


@given(matrices)
def test_dual_nearest_is_mutual_and_holds_the_cheapest(matrix):
    either = np.minimum(matrix, matrix.T)
    nearest = either.argmin(axis=1)
    expected = [
        (i, int(k))
        for i, k in enumerate(nearest)
        if i < k and nearest[k] == i and np.isfinite(either[i, k])
    ]
    assert chosen(DualNearest(), matrix) == expected
    if np.isfinite(matrix).any():
        assert min(matrix[i, k] for i, k in expected) == matrix.min()


@given(matrices)
def test_hungarian_costs_what_scipy_costs(matrix):
    first, other = linear_sum_assignment(np.where(np.isfinite(matrix), matrix, 1e9))
    costs = matrix[first, other]
    result = chosen(Hungarian(), matrix)
    assert len(result) == np.isfinite(costs).sum()
    assert sum(matrix[i, k] for i, k in result) == pytest.approx(costs[np.isfinite(costs)].sum())
