"""Intervals of medians, shares and measures of tracks, against draws and print."""

import math

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.scores import intervals, score_tracks
from kilnflight.scores.intervals import (
    difference_interval,
    median_interval,
    share,
    track_draws,
)

DWELL_S = np.random.default_rng(0).gamma(4.0, 0.1, 40)


@pytest.mark.parametrize("number", [40, 1200])  # the latter in two parts
def test_a_median_has_the_bootstrap_interval_of_plain_draws(number):
    sample = np.resize(DWELL_S, number)
    generator = np.random.default_rng(5)
    ours = median_interval(sample, generator)
    again = np.random.default_rng(5).integers(0, number, (intervals.DRAWS, number))
    plain = np.quantile(np.median(sample[again], axis=1), [0.025, 0.975])
    assert (ours.low, ours.high) == pytest.approx(tuple(plain), rel=1e-9)
    assert (ours.estimate, ours.number) == (np.median(sample), number)
    # the generator is left as it was
    assert median_interval(sample, generator) == ours


def test_small_samples_have_no_interval():
    assert math.isnan(median_interval([], np.random.default_rng(0)).estimate)
    few = median_interval(np.full(5, 0.3), np.random.default_rng(0))
    assert few == (0.3, -math.inf, math.inf, 5)
    assert median_interval(np.full(6, 0.3), np.random.default_rng(0)).high == 0.3


def test_a_share_is_wilsons():
    assert share(0, 40) == (0.0, 0.0, pytest.approx(0.0876, abs=1e-4), 40)
    assert share(0, 0)[1:] == (0.0, 1.0, 0)
    with pytest.raises(InputError, match="number"):
        share(3, 2)


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
    interval = difference_interval(share(*first), share(*second))
    assert interval[1:3] == pytest.approx((low, high), abs=6e-5)
    unknown = difference_interval(share(*first), share(0, 0))
    assert unknown[1:3] == (-math.inf, math.inf)


def scored(paired, false=0):
    """Score twelve true tracks, of which some are followed, beside false tracks."""
    parts = [
        pd.DataFrame(
            {"frame": np.arange(10) + 20 * k, "particle": k, "row": 0.0, "col": 0.0}
        )
        for k in range(12 + false)
    ]
    return score_tracks(
        pd.concat(parts[:12]), pd.concat([*parts[:paired], *parts[12:]]), gate=5.0
    )


def test_true_trajectories_and_false_tracks_are_drawn():
    assert (track_draws(scored(12), 1, [1, 1]) == 1).all()
    half = track_draws(scored(6), 1, [1, 1])  # binomial: six of twelve are followed
    assert half[:, 0].std() == pytest.approx(math.sqrt(0.25 / 12), rel=0.1)
    np.testing.assert_allclose(half, np.tile(half[:, :1], 4))  # no false track
    spurious = track_draws(scored(12, false=4), 1, [1, 1])
    assert (spurious[:, 0] == 1).all()  # alpha ignores them
    times = (1 / spurious[:, 3] - 1) * 12  # number of false tracks drawn: Poisson's law
    assert (times.mean(), times.var()) == (
        pytest.approx(4, rel=0.1),
        pytest.approx(4, rel=0.2),
    )
    six, ten = (track_draws(scored(count), 1, [1, count]) for count in (6, 10))
    assert (ten - six)[:, 0].min() >= 0  # ten of the same follow at least as many
    assert (track_draws(scored(6), 1, [1, 6]) == six).all()


@pytest.mark.parametrize(
    ("number", "counted"), [(-1, 4), (5, 4), (0.5, 4), (0, -1), (0, 2.5), ("1", 4)]
)
def test_a_share_is_of_whole_counts(number, counted):
    with pytest.raises(InputError, match="share"):
        share(number, counted)
