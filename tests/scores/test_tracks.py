"""Hand-made worlds with known numbers, and what must not change them."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.scores import score_tracks


def line(frames, particle=0, row=0.0, step=1.0):
    """One particle that moves along a row of the image."""
    frames = np.asarray(frames)
    return pd.DataFrame({"frame": frames, "particle": particle, "row": row, "col": step * frames})


def join(*tracks):
    return pd.concat(tracks, ignore_index=True)


TRUTH = line(range(10))


def points(score):
    return score.tp, score.fn, score.fp


def tracks(score):
    return score.tp_tracks, score.fn_tracks, score.fp_tracks


def test_the_truth_itself_is_perfect():
    truth = join(TRUTH, line(range(5, 25), particle=7, row=40.0))
    score = score_tracks(truth, truth, gate=5.0)
    assert (score.alpha, score.beta, score.jsc, score.jsc_theta) == (1, 1, 1, 1)
    assert points(score) == (30, 0, 0)
    assert score.pairs.to_numpy().tolist() == [[0, 0, 0], [7, 7, 0]]


def test_a_shift_costs_its_share_of_the_gate():
    score = score_tracks(TRUTH, TRUTH.assign(row=2.0), gate=8.0)
    assert (score.alpha, score.beta, score.jsc) == (0.75, 0.75, 1.0)
    assert score.pairs["distance"].tolist() == [20.0]


def test_a_distance_of_the_gate_is_beyond_it():
    shifted = TRUTH.assign(row=27.0, col=TRUTH["col"] + 36.0)
    assert points(score_tracks(TRUTH, shifted, gate=45.0)) == (0, 10, 10)
    score = score_tracks(TRUTH, shifted, gate=45.1)
    assert points(score) == (10, 0, 0)
    assert 0 < score.alpha < 0.003


def test_a_gap_of_the_candidate_is_missed_but_not_false():
    score = score_tracks(TRUTH, line([0, 1, 2, 6, 7, 8, 9]), gate=5.0)
    assert score.alpha == score.beta == 0.7
    assert points(score) == (7, 3, 0)


def test_a_gap_of_the_truth_is_filled_on_the_straight_line():
    truth = line([0, 4])
    score = score_tracks(truth, line(range(5)), gate=5.0)
    assert score.alpha == 1.0
    assert points(score) == (5, 0, 0)
    assert score_tracks(truth, truth, gate=5.0).alpha == 0.4


def test_every_frame_beyond_the_truth_is_false_even_without_a_point():
    score = score_tracks(TRUTH, line([-3, *range(10), 12]), gate=5.0)
    assert points(score) == (10, 0, 3 + 3)
    assert score.fp_spurious_only == 0
    assert (score.jsc, score.jsc_spurious_only) == (10 / 16, 1.0)
    assert score.alpha == score.beta == 0.4


def test_a_point_beside_the_truth_is_missed_and_false():
    beside = TRUTH.assign(row=np.where(TRUTH["frame"] == 4, 9.0, 0.0))
    assert points(score_tracks(TRUTH, beside, gate=5.0)) == (9, 1, 1)


def test_spurious_tracks_cost_beta_and_not_alpha():
    spurious = line([0, 1, 4], particle=9, row=500.0)
    score = score_tracks(TRUTH, join(TRUTH, spurious), gate=5.0)
    assert (score.alpha, score.beta) == (1.0, 10 / 15)
    assert points(score) == (10, 0, 3)
    assert score.fp_spurious_only == 3
    assert score.jsc == score.jsc_spurious_only == 10 / 13
    assert tracks(score) == (1, 0, 1)
    assert score.jsc_theta == 0.5


def test_swapped_identities():
    """Two particles exchange their numbers after six of ten frames."""
    truth = join(line(range(10), 0), line(range(10), 1, row=100.0))
    late = truth["frame"] >= 6
    detected = truth.assign(particle=np.where(late, 1 - truth["particle"], truth["particle"]))
    score = score_tracks(truth, detected, gate=5.0)
    assert score.pairs[["truth", "candidate"]].to_numpy().tolist() == [[0, 0], [1, 1]]
    assert score.alpha == score.beta == 0.6
    assert points(score) == (12, 8, 8)
    assert score.fp_spurious_only == 0


def test_two_particles_and_one_candidate():
    truth = join(TRUTH, line(range(10), 1, row=3.0))
    score = score_tracks(truth, TRUTH.assign(row=2.0, particle=4), gate=5.0)
    assert score.pairs.to_numpy() == pytest.approx(np.array([[1, 4, 10.0]]))
    assert score.alpha == score.beta == pytest.approx(0.4)
    assert points(score) == (10, 10, 0)
    assert tracks(score) == (1, 1, 0)


def test_the_sum_decides_not_the_single_pair():
    """The nearest candidate of one particle is the only one that another can have."""
    truth = join(line(range(4), 0, row=0.0), line(range(4), 1, row=6.0))
    detected = join(line(range(4), 0, row=2.0), line(range(4), 1, row=-4.0))
    score = score_tracks(truth, detected, gate=10.0)
    assert score.pairs.to_numpy() == pytest.approx(np.array([[0, 1, 16.0], [1, 0, 16.0]]))


def test_a_pair_no_better_than_none_is_none():
    """Three matches at a third of the gate are eaten up by two frames beyond the truth."""
    score = score_tracks(line(range(3)), line(range(5)).assign(row=1.0), gate=3.0)
    assert tracks(score) == (0, 1, 1)
    assert points(score) == (0, 3, 5)
    assert tracks(score_tracks(line(range(3)), line(range(5)).assign(row=0.99), gate=3.0))[0] == 1


def test_single_points_and_disjoint_frames():
    assert points(score_tracks(line([3]), line([3]), gate=1e-9)) == (1, 0, 0)
    assert tracks(score_tracks(line([3]), line([4], step=0.75), gate=1.0)) == (0, 1, 1)


def test_a_long_gap_takes_no_memory():
    score = score_tracks(line([0, 10**12]), line([0, 10**6, 10**12]), gate=5.0)
    assert points(score) == (3, 10**12 - 2, 0)


def test_no_candidates_score_nothing():
    for none in (TRUTH[:0], TRUTH.assign(particle=-1), TRUTH.assign(particle=-1, row=np.nan)):
        score = score_tracks(TRUTH, none, gate=5.0)
        assert (score.alpha, score.beta, score.jsc, score.jsc_theta) == (0, 0, 0, 0)
        assert points(score) == (0, 10, 0)
        assert tracks(score) == (0, 1, 0)
        assert score.pairs.columns.tolist() == ["truth", "candidate", "distance"]
        assert score.pairs.dtypes.tolist() == [np.int64, np.int64, np.float64]


def test_any_coordinates_and_any_type_of_whole_number():
    truth = pd.DataFrame({"frame": [0.0, 1.0], "particle": [2.0, 2.0], "x": [0, 1], "z": [5, 5]})
    assert score_tracks(truth, truth, gate=1.0, columns=["x"]).alpha == 1.0
    far = truth.assign(y=[0, 0])
    assert score_tracks(far, far.assign(y=[2, 4]), gate=8.0, columns=("x", "y", "z")).alpha == 0.625


coordinate = st.integers(-6, 6)
rows = st.lists(
    st.tuples(st.integers(0, 8), st.integers(0, 3), coordinate, coordinate),
    min_size=1,
    max_size=25,
    unique_by=lambda row: row[:2],
)


def table(positions):
    return pd.DataFrame(positions, columns=["frame", "particle", "row", "col"])


@given(rows, rows, st.sampled_from([1.0, 4.0, 9.0]), st.integers(0, 2**32 - 1))
def test_neither_the_order_of_rows_nor_the_numbers_of_particles_matter(
    truth, candidate, gate, seed
):
    generator = np.random.default_rng(seed)
    score = score_tracks(table(truth), table(candidate), gate)
    numbers = generator.permutation(50)
    again = score_tracks(
        table(truth).sample(frac=1, random_state=seed),
        table(candidate).assign(particle=lambda one: numbers[one["particle"]]).sample(frac=1),
        gate,
    )
    assert (again.alpha, again.beta) == (score.alpha, score.beta)
    assert points(again) == points(score)
    assert again.pairs["distance"].sum() == pytest.approx(score.pairs["distance"].sum())


@given(rows, rows, st.sampled_from([0.5, 4.0, 9.0]), st.sampled_from([2.0**-9, 0.5, 64.0]))
def test_measures_are_in_their_bounds_and_have_no_unit(truth, candidate, gate, unit):
    truth, candidate = table(truth), table(candidate)
    score = score_tracks(truth, candidate, gate)
    assert 0 <= score.beta <= score.alpha <= 1
    assert 0 <= score.jsc <= score.jsc_spurious_only <= 1
    assert score.fp_spurious_only <= score.fp
    assert score.tp_tracks + score.fn_tracks == truth["particle"].nunique()
    assert score.tp_tracks + score.fp_tracks == candidate["particle"].nunique()
    if not score.fp_tracks:
        assert score.alpha == score.beta
    scaled = [
        first.assign(row=unit * first["row"], col=unit * first["col"])
        for first in (truth, candidate)
    ]
    assert score_tracks(*scaled, gate * unit).alpha == score.alpha


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"truth": TRUTH[:0]}, "truth holds no track, so alpha is 0 / 0"),
        ({"truth": TRUTH.assign(particle=-1)}, "truth holds no track"),
        ({"truth": TRUTH.assign(particle=-2)}, "truth: particle -2"),
        ({"truth": TRUTH.assign(row=np.nan)}, r"truth, row: 10 value\(s\) are not finite"),
        ({"candidate": TRUTH.drop(columns="col")}, r"candidate: column\(s\) col missing"),
        ({"candidate": TRUTH.assign(frame=0.5)}, "candidate: column frame: 0.5 in row 0"),
        ({"candidate": TRUTH.assign(frame=1e300)}, "candidate: column frame: 1e[+]300"),
        ({"candidate": TRUTH.assign(particle=np.nan)}, "candidate: column particle"),
        ({"candidate": TRUTH.assign(particle="a")}, "candidate: column particle holds"),
        ({"candidate": TRUTH.assign(row=1j)}, "not made of numbers"),
        ({"truth": pd.concat([TRUTH, TRUTH["row"]], axis=1)}, "truth: more than one column row"),
        ({"candidate": join(TRUTH, TRUTH[3:4])}, "particle 0 has two rows in frame 3"),
        ({"candidate": [1, 2]}, "list is no table"),
        ({"gate": 0.0}, "gate: must be above 0"),
        ({"gate": np.nan}, "gate: must be above 0"),
        ({"gate": True}, "gate: must be above 0"),
        ({"columns": ()}, "no columns to measure"),
        ({"columns": ("row", "row")}, "name one twice"),
        ({"columns": "row"}, "pass a list of names"),
        ({"columns": None}, "pass a list of names"),
    ],
)
def test_what_cannot_be_scored_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        score_tracks(**{"truth": TRUTH, "candidate": TRUTH, "gate": 5.0, **change})


@pytest.mark.parametrize("kind", [list, np.array, pd.Index])
def test_columns_in_any_list(kind):
    score = score_tracks(TRUTH, TRUTH, gate=5.0, columns=kind(["row", "col"]))
    assert score.alpha == 1.0
