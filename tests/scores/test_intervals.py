import math
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from kilnflight.checks import InputError
from kilnflight.scores import score_tracks
from kilnflight.scores.intervals import (
    Bootstrap,
    TrackBootstrap,
    difference,
    difference_of_medians,
    share,
)

DRAW = Bootstrap()


def dwell_times(seed=0, n=40):
    return np.random.default_rng(seed).gamma(4.0, 0.1, n)


@pytest.mark.parametrize(
    ("statistic", "groups"),
    [
        (np.median, (dwell_times(),)),
        (difference_of_medians, (dwell_times(), dwell_times(1, 25))),
    ],
)
def test_the_same_draws_give_what_scipy_gives(statistic, groups):
    ours = DRAW(statistic, groups, np.random.default_rng(5))
    peer = stats.bootstrap(
        groups,
        statistic,
        n_resamples=DRAW.draws,
        method="percentile",
        rng=np.random.default_rng(5),
        axis=-1,
    ).confidence_interval
    assert (ours.low, ours.high) == pytest.approx((peer.low, peer.high), rel=1e-9)
    assert ours.estimate == statistic(*groups)
    assert ours.numbers == tuple(map(len, groups))


def test_it_covers_the_truth_about_as_often_as_it_says():
    generator = np.random.default_rng(2)
    few = Bootstrap(draws=400)
    inside = 0
    for _ in range(200):
        interval = few(np.median, [generator.normal(0.0, 1.0, 30)], generator)
        inside += interval.low <= 0.0 <= interval.high
    assert 180 <= inside <= 199


@settings(deadline=None)
@given(st.integers(0, 100), st.floats(-100, 100))
def test_a_shift_shifts_the_interval_and_leaves_a_difference(seed, shift):
    few = Bootstrap(draws=50)
    still = few(np.median, [dwell_times()], np.random.default_rng(seed))
    moved = few(np.median, [dwell_times() + shift], np.random.default_rng(seed))
    np.testing.assert_allclose(np.array(moved[:3]) - shift, still[:3], atol=1e-9)
    gap = few(difference_of_medians, [dwell_times() + shift] * 2, np.random.default_rng(seed))
    assert gap.estimate == 0.0


def test_small_samples_say_little():
    none = DRAW(np.median, [[]], np.random.default_rng(0))
    assert math.isnan(none.estimate)
    for n in (1, 5):
        few = DRAW(np.median, [np.full(n, 0.3)], np.random.default_rng(0))
        assert few == (0.3, -math.inf, math.inf, (n,))
        assert not few.resolves()
    assert DRAW(np.median, [np.full(6, 0.3)], np.random.default_rng(0)).high == 0.3


def test_what_a_sample_can_resolve():
    apart = DRAW(
        difference_of_medians, [dwell_times(), dwell_times(1) + 0.5], np.random.default_rng(0)
    )
    assert apart.resolves()
    small = DRAW(
        difference_of_medians,
        [dwell_times(), dwell_times(1) + 0.5],
        np.random.default_rng(0),
        sizes=(6, 6),
    )
    assert small.numbers == (6, 6)
    assert small.high - small.low > 1.5 * (apart.high - apart.low)
    alike = [dwell_times(), dwell_times(1)]
    assert not DRAW(difference_of_medians, alike, np.random.default_rng(0)).resolves()


@settings(deadline=None)
@given(st.integers(0, 50), st.integers(1, 50), st.floats(0.5, 0.999))
def test_a_share_is_wilsons(number, counted, level):
    number = min(number, counted)
    ours = share(number, counted, level)
    peer = stats.binomtest(number, counted).proportion_ci(level, method="wilson")
    assert ours[1:3] == pytest.approx((peer.low, peer.high), abs=1e-9)
    assert 0 <= ours.low <= ours.estimate <= ours.high <= 1


def test_none_of_many_is_not_exactly_none():
    assert share(0, 40).low == 0.0
    assert share(0, 40).high == pytest.approx(0.0876, abs=1e-4)
    assert share(0, 0)[1:] == (0.0, 1.0, (0,))


@pytest.mark.parametrize(
    ("first", "second", "low", "high"),
    [  # Newcombe 1998, Table II, method 10
        ((56, 70), (48, 80), 0.0524, 0.3339),
        ((9, 10), (3, 10), 0.1705, 0.8090),
        ((10, 10), (0, 10), 0.6075, 1.0),
        ((0, 10), (0, 10), -0.2775, 0.2775),
    ],
)
def test_a_difference_of_shares_is_newcombes(first, second, low, high):
    interval = difference(share(*first), share(*second))
    assert interval[1:3] == pytest.approx((low, high), abs=6e-5)
    mirrored = difference(share(*second), share(*first))
    assert (-mirrored.high, -mirrored.low) == pytest.approx((interval.low, interval.high))


def test_bad_input_is_refused():
    generator = np.random.default_rng(0)
    with pytest.raises(InputError, match="not finite"):
        DRAW(np.median, [[1.0, np.nan]], generator)
    with pytest.raises(InputError, match="2 sizes for 1 groups"):
        DRAW(np.median, [dwell_times()], generator, sizes=(3, 4))
    with pytest.raises(InputError, match="sizes"):
        DRAW(np.median, [dwell_times()], generator, sizes=(-3,))
    with pytest.raises(InputError, match="3 of 2 is no share"):
        share(3, 2)
    for level in (0.0, 1.0, 95):
        with pytest.raises(InputError, match="level"):
            share(1, 2, level)
        with pytest.raises(InputError, match="level"):
            Bootstrap(level=level)


def test_the_median_is_the_quantile_in_the_middle():
    ours = DRAW(partial(np.quantile, q=0.5), [dwell_times()], np.random.default_rng(3))
    peer = DRAW(np.median, [dwell_times()], np.random.default_rng(3))
    assert ours[:3] == pytest.approx(peer[:3])
    lower = DRAW(partial(np.quantile, q=0.25), [dwell_times()], np.random.default_rng(3))
    assert lower.low < lower.estimate < ours.estimate


def test_the_same_particles_have_the_same_interval_whatever_was_asked_before():
    generator = np.random.default_rng(3)
    alone = DRAW(np.median, [dwell_times()], generator)
    DRAW(difference_of_medians, [dwell_times(), dwell_times(1)], generator)
    assert DRAW(np.median, [dwell_times()], generator) == alone


def scored(paired, false=0, length=10):
    """Score as many true tracks, of which some are followed, beside false tracks."""
    spans = [np.arange(length) + 2 * length * k for k in range(12 + false)]
    parts = [
        pd.DataFrame({"frame": span, "particle": k, "row": 0.0, "col": 0.0})
        for k, span in enumerate(spans)
    ]
    truth, wrong = pd.concat(parts[:12]), pd.concat([*parts[:paired], *parts[12:]])
    return score_tracks(truth, wrong, gate=5.0)


def test_what_is_drawn_again_are_true_trajectories_and_false_tracks():
    bootstrap = TrackBootstrap(draws=4000)
    perfect = bootstrap(scored(12), 1, [1, 1])
    assert (perfect == 1).all()
    half = bootstrap(scored(6), 1, [1, 1])
    # the share of those that are followed among twelve that are drawn is binomial
    assert half[:, 0].std() == pytest.approx(math.sqrt(0.25 / 12), rel=0.05)
    assert np.allclose(half, half[:, :1])  # no false track: all four are that share
    spurious = bootstrap(scored(12, false=4), 1, [1, 1])
    assert (spurious[:, 0] == 1).all()  # alpha is blind to them
    times = (1 / spurious[:, 3] - 1) * 12  # how many false tracks were drawn: Poisson's law
    assert (times.mean(), times.var()) == (pytest.approx(4, rel=0.05), pytest.approx(4, rel=0.1))


def test_two_scores_of_one_truth_are_drawn_together():
    bootstrap = TrackBootstrap()
    six, ten = (bootstrap(scored(count), 1, [1, count]) for count in (6, 10))
    apart = (ten - six)[:, 0]
    assert apart.min() >= 0  # whatever is drawn, ten of the same follow at least as many
    again = bootstrap(scored(6), 1, [1, 6])
    assert (again == six).all()
    assert bootstrap.interval(1 / 3, apart, (12, 12)).resolves()
    assert bootstrap.interval(1 / 3, apart, (12, 5)).low == -math.inf


def test_no_truth_cannot_be_drawn():
    score = replace(scored(6), true_tracks=scored(6).true_tracks[:0])
    with pytest.raises(InputError, match="no true trajectory"):
        TrackBootstrap()(score, 1, [1, 1])
    with pytest.raises(InputError, match="TrackBootstrap: draws"):
        TrackBootstrap(draws=0)
