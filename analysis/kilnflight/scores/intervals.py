"""Confidence intervals of medians, of shares, and of the measures of tracks.

Medians: bootstrap over particles. Shares: Wilson's interval, because a bootstrap of
"none of 40 ignited" has no width. Differences: Newcombe's.

A particle is the unit. Particles of one handful fly through the same gusts and share
frames, so they are less independent than the intervals assume. Differences between
whole recordings (gas, light, bias of depth) are in none of them.
"""

import copy
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy  # stats on first use: they take a quarter of a second

from kilnflight.arrays import Array, ArrayLike, Generator
from kilnflight.checks import check_finite, check_number
from kilnflight.scores.tracks import TrackScore

LEVEL = 0.95
DRAWS = 2000  # samples of a bootstrap
# The range of n values holds the median with probability 1 - 2^(1 - n).
LEAST = 6  # particles


class Interval(NamedTuple):
    """An estimate and its 95 % confidence interval.

    Attributes
    ----------
    estimate
        NaN if a group is empty: there is nothing to estimate.
    low, high
        Infinite where the sample is too small to say (-1, 0 or 1 for shares).
    number
        Particles, in both groups of a difference.
    """

    estimate: float
    low: float
    high: float
    number: int


def percentiles(values: ArrayLike) -> Array:
    """Return the ends (2,) of the middle 95 % of draws (n,)."""
    draws = check_finite(values, "percentiles: values", (None,))
    return np.quantile(draws, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])


def median_interval(values: ArrayLike, generator: Generator) -> Interval:
    """Return the median of finite values (n,) with its bootstrap interval (Efron).

    The interval has the values' unit. ``generator`` is copied, not advanced, so that
    the same particles have the same interval everywhere.

    Notes
    -----
    Percentiles and not BCa: the latter corrects by a jackknife, which is not consistent
    for medians. The interval is infinite with fewer than `LEAST` values.
    """
    sample = check_finite(values, "median_interval: values", (None,))
    number = len(sample)
    if number == 0:
        return Interval(math.nan, -math.inf, math.inf, 0)
    estimate = np.median(sample)
    if number < LEAST:
        return Interval(estimate, -math.inf, math.inf, number)
    low, high = scipy.stats.bootstrap(
        (sample,),
        np.median,
        n_resamples=DRAWS,
        batch=max(1, 2_000_000 // number),  # bounds memory
        confidence_level=LEVEL,
        method="percentile",
        rng=copy.deepcopy(generator),
    ).confidence_interval
    return Interval(estimate, low, high, number)


def share(number: int, counted: int) -> Interval:
    """Return the share ``number`` of ``counted`` with its interval (Wilson 1927).

    Shares are 0 to 1. With ``counted`` 0 the share is NaN and the interval 0 to 1.

    Examples
    --------
    >>> none = share(0, 40)
    >>> none.estimate, round(none.high, 3)
    (0.0, 0.088)
    """
    counted = check_number(counted, "share: counted", least=0, whole=True)
    check_number(number, "share: number", least=0, most=counted, whole=True)
    if counted == 0:
        return Interval(math.nan, 0.0, 1.0, 0)
    test = scipy.stats.binomtest(number, counted)
    low, high = test.proportion_ci(LEVEL, method="wilson")
    return Interval(number / counted, float(low), float(high), counted)


def track_draws(
    score: TrackScore, seed: int | Sequence[int], false_seed: int | Sequence[int]
) -> Array:
    """Return bootstrap draws (DRAWS, 4) of alpha, beta, JSC and JSC_theta.

    Table 5.17 gets its intervals from them. True trajectories are drawn with
    replacement, each with the gain and the matches of its partner. The number of times
    a false track is drawn follows Poisson's law of mean 1, so that their number varies
    too. The pairing is not repeated.

    Parameters
    ----------
    score
        Of `kilnflight.scores.score_tracks`, with at least one true track.
    seed, false_seed
        Of the draws of true trajectories and of false tracks.

    Notes
    -----
    Scores of one window hold the same true trajectories in the same order. With the
    same ``seed`` the same ones are drawn, and the difference is paired. Two trackers
    have different false tracks; give each its own ``false_seed``. A share of 0 or 1 has
    no width. A window is one stretch of one recording; no interval covers other
    stretches.
    """
    count = len(score.true_tracks)
    generator = np.random.default_rng(seed)
    true = score.true_tracks[["length", "gain", "tp", "fp", "paired"]].to_numpy(float)
    false = score.false_tracks[["length", "positions"]].to_numpy(float)
    times = generator.multinomial(count, np.full(count, 1 / count), DRAWS)
    length, gain, tp, fp, paired = (times @ true).T
    again = np.random.default_rng(false_seed).poisson(1.0, (DRAWS, len(false)))
    beyond, positions = (again @ false).T
    measures = [gain / length, gain / (length + beyond), tp / (length + fp + positions)]
    return np.column_stack([*measures, paired / (count + again.sum(axis=1))])


def difference_interval(first: Interval, second: Interval) -> Interval:
    """Return first minus second with its interval (Newcombe 1998).

    The estimates must be independent. The distances from the estimates to the ends add
    as squares. An unknown end makes the interval infinite.
    """
    number = first.number + second.number
    estimate = first.estimate - second.estimate
    down = math.hypot(first.estimate - first.low, second.high - second.estimate)
    up = math.hypot(first.high - first.estimate, second.estimate - second.low)
    if math.isnan(estimate + down + up):
        return Interval(estimate, -math.inf, math.inf, number)
    return Interval(estimate, estimate - down, estimate + up, number)
