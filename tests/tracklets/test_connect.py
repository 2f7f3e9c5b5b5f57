from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.tracklets import Connection, Costs, Fusion, Hungarian, tracked
from kilnflight.tracklets.paths import read_paths

ONLY = dict.fromkeys(Costs.__dataclass_fields__, 0.0)


def pairs(tracks, **costs):
    paths = read_paths(tracks, "here")
    step = Connection(costs=Costs(**{**ONLY, **costs}) if costs else Costs())
    found = step.candidates(paths, np.ones(len(paths.starts) - 1, dtype=bool))
    return list(zip(*(values.tolist() for values in found), strict=True))


def line(first, last, col=0.0, step=1, z=np.nan):
    frame = np.arange(first, last + 1, step)
    return frame, 5.0 * frame, col, z


def number(tracks, step=None):
    return tracked((step or Connection())(tracks))["particle"].nunique()


def test_fig_4_10_left_a_gap_is_connected(table):
    one, other = [1, 3, 4, 5, 7, 8], [11, 13, 14, 15]
    tracks = table((one, 5.0 * np.array(one), 0.0), (other, 5.0 * np.array(other), 0.0))
    assert pairs(tracks) == [(0, 1, pytest.approx(3.0))]  # d times 11 - 8
    result = Connection()(tracks)
    assert (result["particle"] == 0).all()
    np.testing.assert_array_equal(result["row"], tracks["row"])


def test_fig_4_10_right_an_overlap_is_merged_to_the_mean(table):
    one, other = [1, 3, 4, 5, 7, 9, 10, 11], [8, 9, 11, 13, 14, 15, 16]
    tracks = table((one, 5.0 * np.array(one), 0.0, 3000.0), (other, 5.0 * np.array(other), 2.0))
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
    found = np.argwhere(np.isfinite(matrix))
    assert sorted((i, k) for i, k, _ in expected) == [tuple(x) for x in found.tolist()]
    for i, k, cost in expected:
        assert cost == pytest.approx(matrix[i, k], abs=1e-4)  # arc cosine near 0 degrees
    same_tracks(Connection()(tracks), plain.join(plain.tracklets_of(tracks)))


@pytest.mark.parametrize("bad", [-1.0, np.nan, "a", None, True])
def test_what_is_no_limit_is_refused(bad):
    for field in ("gap", "overlap", "depth"):
        with pytest.raises(InputError, match=f"Connection: {field}: must be 0 or above"):
            Connection(**{field: bad})
    for field in Costs.__dataclass_fields__:
        with pytest.raises(InputError, match=f"Costs: {field}: must be 0 or above"):
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
