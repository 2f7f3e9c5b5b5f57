"""Scores of tracks: hand-made worlds with known numbers, the definition, invariants."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.definitions import track_measures

from kilnflight.checks import InputError
from kilnflight.scores import score_tracks


def line(frames, particle=0, row=0.0, step=1.0):
    """One particle that moves along a row of the image."""
    frames = np.asarray(frames)
    return pd.DataFrame(
        {"frame": frames, "particle": particle, "row": row, "col": step * frames}
    )


def points(score):
    return score.tp, score.fn, score.fp


TRUTH = line(range(10))
TWO = pd.concat([TRUTH, line(range(10), 1, row=3.0)], ignore_index=True)
SPURIOUS = pd.concat([TRUTH, line([0, 1, 4], 9, row=500.0)], ignore_index=True)
SWAPPED = TWO.assign(particle=(TWO["particle"] + (TWO["frame"] >= 6)) % 2)


@pytest.mark.parametrize(
    ("truth", "candidate", "gate", "of_points", "of_tracks", "alpha", "beta"),
    [
        (TWO, TWO, 5.0, (20, 0, 0), (2, 0, 0), 1.0, 1.0),
        (TRUTH, TRUTH.assign(row=2.0), 8.0, (10, 0, 0), (1, 0, 0), 0.75, 0.75),
        (
            TRUTH,
            TRUTH.assign(row=45.0),
            45.0,
            (0, 10, 10),
            (0, 1, 1),
            0.0,
            0.0,
        ),  # at the gate
        (TRUTH, line([0, 1, 2, 6, 7, 8, 9]), 5.0, (7, 3, 0), (1, 0, 0), 0.7, 0.7),
        (
            line([0, 4]),
            line(range(5)),
            5.0,
            (5, 0, 0),
            (1, 0, 0),
            1.0,
            1.0,
        ),  # filled in between
        (line([0, 4]), line([0, 4]), 5.0, (2, 3, 0), (1, 0, 0), 0.4, 0.4),
        # every frame beyond the truth is false, even without a point
        (TRUTH, line([-3, *range(10), 12]), 5.0, (10, 0, 6), (1, 0, 0), 0.4, 0.4),
        (TRUTH, SPURIOUS, 5.0, (10, 0, 3), (1, 0, 1), 1.0, 10 / 15),
        (TWO, SWAPPED, 2.0, (12, 8, 8), (2, 0, 0), 0.6, 0.6),
        # a pair no better than the dummy is none: three matches, two frames beyond the
        # truth
        (line(range(3)), line(range(5), row=1.0), 3.0, (0, 3, 5), (0, 1, 1), 0.0, 0.0),
        (line([3]), line([4], step=0.75), 1.0, (0, 1, 1), (0, 1, 1), 0.0, 0.0),
        (
            TRUTH,
            TRUTH.assign(particle=-1, row=np.nan),
            5.0,
            (0, 10, 0),
            (0, 1, 0),
            0.0,
            0.0,
        ),
    ],
)
def test_worlds_with_known_numbers(
    truth, candidate, gate, of_points, of_tracks, alpha, beta
):
    score = score_tracks(truth, candidate, gate)
    of_both = (points(score), (score.tp_tracks, score.fn_tracks, score.fp_tracks))
    assert of_both == (of_points, of_tracks)
    assert (score.alpha, score.beta) == pytest.approx((alpha, beta))
    tp, fn, fp = of_points
    assert score.jsc == tp / (tp + fn + fp)
    assert score.jsc_theta == of_tracks[0] / sum(of_tracks)


def test_a_gap_costs_nothing_where_neither_track_has_a_position():
    """Eq. 5.2: the distance is 0 if none exists, and the gate if one does."""
    seen = line([0, 1, 8, 9])
    assert score_tracks(seen, seen, 5.0).alpha == pytest.approx(4 / 10)
    assert score_tracks(seen, seen, 5.0, bridged=False).alpha == 1.0
    more = score_tracks(seen, line([0, 1, 4, 8]), 5.0, bridged=False)
    assert points(more) == (3, 1, 1)
    assert more.alpha == pytest.approx(
        2 / 4
    )  # a gate for what is missed, one for what is not seen


def test_a_long_gap_takes_no_memory():
    score = score_tracks(line([0, 10**12]), line([0, 10**6, 10**12]), gate=5.0)
    assert points(score) == (3, 10**12 - 2, 0)


def test_y_x_in_px_stand_for_row_col_which_come_first():
    space = TRUTH.assign(x=0.0, y=0.0)
    assert score_tracks(space, space.assign(y=4.0), 8.0).alpha == 1.0
    other = TRUTH.rename(columns={"row": "y", "col": "x"})
    assert score_tracks(TRUTH, other[["x", "particle", "y", "frame"]], 5.0).alpha == 1.0


coordinate = st.integers(-5, 5)
rows = st.lists(
    st.tuples(st.integers(0, 9), st.integers(0, 3), coordinate, coordinate, coordinate),
    min_size=1,
    max_size=25,
    unique_by=lambda row: row[:2],
)


@given(
    rows, rows, st.sampled_from([1.0, 2.5, 6.0, 20.0]), st.integers(1, 3), st.booleans()
)
def test_the_measures_are_their_definitions(
    truth, candidate, gate, dimensions, bridged
):
    every = ["frame", "particle", "x", "y", "z"]
    names = every[: 2 + dimensions]
    tables = [pd.DataFrame(first, columns=every)[names] for first in (truth, candidate)]
    score = score_tracks(*tables, gate, columns=names[2:], bridged=bridged)
    read = track_measures.filled if bridged else track_measures.unfilled
    true, candidates = map(read, tables)
    empty = gate * sum(map(len, true.values()))
    pairs = dict(score.pairs[["truth", "candidate"]].to_numpy().tolist())
    rest = sum(len(first) for c, first in candidates.items() if c not in pairs.values())
    best = track_measures.least(true, candidates, gate)
    assert score.alpha == pytest.approx(1 - best / empty, abs=1e-9)
    assert score.beta == pytest.approx((empty - best) / (empty + gate * rest), abs=1e-9)
    assert track_measures.counts(true, candidates, pairs, gate) == points(score)
    for t, c, apart in score.pairs.itertuples(index=False):
        assert apart == pytest.approx(
            track_measures.distance(true[t], candidates[c], gate)
        )


@given(rows, rows, st.sampled_from([1.0, 4.0, 9.0]), st.integers(0, 2**32 - 1))
def test_order_numbers_and_unit_do_not_matter(truth, candidate, gate, seed):
    names = ["frame", "particle", "row", "col"]
    first, second = (
        pd.DataFrame(x, columns=[*names, "z"])[names] for x in (truth, candidate)
    )
    score, numbers = (
        score_tracks(first, second, gate),
        np.random.default_rng(seed).permutation(50),
    )
    assert 0 <= score.beta <= score.alpha <= 1
    named = second.assign(particle=numbers[second["particle"]])
    unit = {"frame": 1, "particle": 1, "row": 64.0, "col": 64.0}
    scaled = [(table * unit).sample(frac=1) for table in (first, named)]
    again = score_tracks(*scaled, 64.0 * gate)
    assert (again.alpha, again.beta, points(again)) == (
        score.alpha,
        score.beta,
        points(score),
    )


HALVES = pd.concat([line(range(5), 7), line(range(5, 10), 8)])  # one track in two
LATE = pd.concat([line(range(4)), line(range(4, 10), 1, row=30.0)])


@pytest.mark.parametrize(
    ("truth", "candidate", "gate", "hota", "mota"),
    [
        (TWO, TWO, 5.0, 1.0, 1.0),
        (TRUTH, TRUTH.assign(row=45.0), 45.0, 0.0, -1.0),  # all missed, all false
        (TRUTH, TRUTH[:0], 5.0, 0.0, 0.0),
        (TRUTH, TRUTH[:4], 5.0, 0.4, 0.4),  # 4 of 10, in one track: root of 0.4 * 0.4
        (TRUTH, HALVES, 5.0, np.sqrt(0.5), 0.9),  # all found, one switch
        # after 6 of 10 frames both change their track: 12 * 6 / 14 + 8 * 4 / 16 of 20
        (TWO, SWAPPED, 2.0, np.sqrt((12 * 6 / 14 + 8 * 4 / 16) / 20), 0.9),
        (TRUTH, SPURIOUS, 5.0, np.sqrt(10 / 13), 0.7),
        # each position is 0.7 alike: 14 of 19 thresholds are met
        (TRUTH, TRUTH.assign(row=3.0), 10.0, 14 / 19, 1.0),
        # 4 of 10 pairs, 4 in its track; the rest are missed and false
        (TRUTH, LATE, 5.0, np.sqrt(4 / 16 * 0.4), 1 - 12 / 10),
    ],
)
def test_worlds_with_known_hota_and_mota(truth, candidate, gate, hota, mota):
    score = score_tracks(truth, candidate, gate)
    assert (score.hota, score.mota) == pytest.approx((hota, mota))


def test_a_pair_stays_while_it_is_near():
    """Track 1 comes nearer to the particle of track 0, which is still in the gate."""
    truth = line(range(10), step=0.0)
    drifts = line(range(10), 0).assign(col=0.3 * np.arange(10))
    comes = line(range(5, 10), 1, step=0.0)
    score = score_tracks(truth, pd.concat([drifts, comes]), 4.0)
    assert score.mota == pytest.approx(1 - 5 / 10)  # five false, no switch


@given(rows, rows, st.sampled_from([1.0, 2.5, 6.0, 20.0]), st.booleans())
def test_hota_and_mota_are_their_definitions(truth, candidate, gate, bridged):
    every = ["frame", "particle", "x", "y", "z"]
    tables = [pd.DataFrame(first, columns=every) for first in (truth, candidate)]
    # no two pairs are equally good
    rng = np.random.default_rng(0)
    tables = [table.assign(x=table["x"] + rng.random(len(table))) for table in tables]
    score = score_tracks(*tables, gate, columns=every[2:], bridged=bridged)
    true, candidates = map(track_measures.unfilled, tables)
    assert score.hota == pytest.approx(track_measures.hota(true, candidates, gate))
    assert score.mota == pytest.approx(track_measures.mota(true, candidates, gate))


@pytest.mark.parametrize("bridged", ["no", 0, 1.0, None])
def test_gaps_are_bridged_or_not(bridged):
    tracks = pd.DataFrame({"frame": [0, 1], "particle": 0, "row": 1.0, "col": 1.0})
    assert score_tracks(tracks, tracks, 5.0, bridged=np.bool_(False)).alpha == 1.0
    with pytest.raises(InputError, match="bridged"):
        score_tracks(tracks, tracks, 5.0, bridged=bridged)
