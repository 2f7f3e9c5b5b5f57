"""Confidence intervals of medians and shares of particles, and of the measures of tracks.

Medians and their differences: bootstrap over particles. Shares: Wilson's interval, and
Newcombe's of a difference, because a bootstrap of "none of 40 ignited" has no width.

A particle is the unit. Particles of one handful fly through the same gusts and share frames, so
they are less independent than the intervals assume. Differences between whole recordings (gas,
light, bias of depth) are in none of them.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.stats import binomtest

from kilnflight.checks import InputError, check_count, check_finite, check_inside
from kilnflight.scores.tracks import TrackScore

Array = npt.NDArray[np.float64]
Statistic = Callable[..., Array]

BLOCK = 2_000_000  # values drawn at a time


class Interval(NamedTuple):
    """An estimate and its confidence interval.

    Attributes
    ----------
    estimate
        NaN if a group is empty: there is nothing to estimate.
    low, high
        Infinite where the sample is too small to say (-1, 0 or 1 for shares).
    numbers
        Particles in each group.
    """

    estimate: float
    low: float
    high: float
    numbers: tuple[int, ...]

    def resolves(self) -> bool:
        """Return whether the interval excludes 0."""
        return not self.low <= 0.0 <= self.high


def difference_of_medians(first: Array, second: Array, axis: int = -1) -> Array:
    """Return the median of the first group minus that of the second."""
    return np.asarray(np.median(first, axis=axis) - np.median(second, axis=axis))


def percentiles(values: npt.ArrayLike, level: float = 0.95) -> tuple[float, float]:
    """Return the ends of the interval that holds the middle ``level`` of draws."""
    tail = (1 - level) / 2
    low, high = np.quantile(np.asarray(values, dtype=np.float64), [tail, 1 - tail])
    return float(low), float(high)


@dataclass(frozen=True)
class _Draws:
    """What all bootstraps share: how often to draw, and the interval of the draws."""

    level: float = 0.95
    draws: int = 2000
    least: int = 6  # particles or true trajectories in each group

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        name = type(self).__name__
        check_inside(self.level, 0, 1, f"{name}: level")
        check_count(self.draws, f"{name}: draws")
        check_count(self.least, f"{name}: least")

    def interval(self, estimate: float, values: Array, numbers: tuple[int, ...]) -> Interval:
        """Return the percentiles of draws of a measure, or of a difference of measures."""
        few = min(numbers) < self.least
        low, high = (-math.inf, math.inf) if few else percentiles(values, self.level)
        return Interval(estimate, low, high, numbers)


@dataclass(frozen=True)
class Bootstrap(_Draws):
    """Estimate the interval of a statistic from its percentiles.

    Particles are drawn with replacement (Efron).

    Notes
    -----
    Written out, since `scipy.stats.bootstrap` (same draws, same percentiles) draws no other
    ``sizes``. Percentiles and not BCa: the latter corrects by a jackknife, which is not consistent
    for medians. The range of n values holds the median with probability 1 - 2^(1 - n), 94 % for 5,
    so fewer than 6 cannot reach 95 %. Their interval is infinite.
    """

    def __call__(
        self,
        statistic: Statistic,
        groups: Sequence[npt.ArrayLike],
        generator: np.random.Generator,
        sizes: Sequence[int] | None = None,
    ) -> Interval:
        """Return the interval of ``statistic(*groups)``.

        Parameters
        ----------
        statistic
            `numpy.median`, `difference_of_medians`, or any other that takes arrays (draws, n)
            and ``axis=-1``.
        groups
            One array of values per group; each is drawn from on its own.
        generator
            Of the draws. It is left as it was: the same particles have the same interval
            wherever it is asked for, whatever was asked before.
        sizes
            Particles to draw from each group, if not as many as there are: what the interval
            would be with such samples.

        Raises
        ------
        InputError
            If a value is not finite, or sizes do not fit the groups.
        """
        samples = [check_finite(values, "Bootstrap: values").ravel() for values in groups]
        numbers = tuple(len(values) for values in samples)
        drawn = numbers if sizes is None else tuple(sizes)
        if not samples or len(drawn) != len(numbers):
            raise InputError(f"Bootstrap: {len(drawn)} sizes for {len(numbers)} groups.")
        for size in drawn:
            check_count(size, "Bootstrap: sizes", least=0)
        if min(numbers) == 0:
            return Interval(math.nan, -math.inf, math.inf, drawn)
        estimate = float(statistic(*samples, axis=-1))
        if min(min(numbers), min(drawn)) < self.least:
            return Interval(estimate, -math.inf, math.inf, drawn)
        draw, rounds = copy.deepcopy(generator).integers, max(1, BLOCK // max(drawn))
        values = []
        for count in np.diff([*range(0, self.draws, rounds), self.draws]).tolist():
            rows = (draw(0, n, (count, size)) for n, size in zip(numbers, drawn, strict=True))
            resampled = (sample[row] for sample, row in zip(samples, rows, strict=True))
            values.append(statistic(*resampled, axis=-1))
        return self.interval(estimate, np.concatenate(values), drawn)


def share(number: int, counted: int, level: float = 0.95) -> Interval:
    """Return the interval of a share, ``number`` of ``counted`` (Wilson 1927).

    None of none is unknown: any share from 0 to 1.
    """
    check_count(counted, "share: counted", least=0)
    check_count(number, "share: number", least=0)
    if number > counted:
        raise InputError(f"share: {number} of {counted} is no share.")
    check_inside(level, 0, 1, "share: level")
    if counted == 0:
        return Interval(math.nan, 0.0, 1.0, (0,))
    interval = binomtest(number, counted).proportion_ci(level, method="wilson")
    return Interval(number / counted, float(interval.low), float(interval.high), (counted,))


def difference(first: Interval, second: Interval) -> Interval:
    """Return the difference of two independent estimates with its interval (Newcombe 1998).

    The distances from the estimates to the ends add as squares. Unknown is any difference.
    """
    numbers, estimate = (*first.numbers, *second.numbers), first.estimate - second.estimate
    down = math.hypot(first.estimate - first.low, second.high - second.estimate)
    up = math.hypot(first.high - first.estimate, second.estimate - second.low)
    if math.isnan(estimate + down + up):
        return Interval(estimate, -math.inf, math.inf, numbers)
    return Interval(estimate, estimate - down, estimate + up, numbers)


@dataclass(frozen=True)
class TrackBootstrap(_Draws):
    """Draw the measures of tracks again: alpha, beta, JSC, JSC_theta.

    Drawn are true trajectories, each with what its partner saves and spoils: as many as there
    are, with replacement. Each false track comes up as often as Poisson's law of mean 1 says, so
    that their number varies too. The pairing is not repeated.

    Notes
    -----
    Scores of one window hold the same true trajectories in the same order. Drawn with the same
    ``seed`` they get the same ones: their difference is paired. False tracks of two trackers are
    not the same; give each its own ``false_seed``. A share of 0 or 1 keeps no width. A window is
    one stretch of one recording: how other stretches would differ is in no interval.
    """

    def __call__(
        self, score: TrackScore, seed: int | Sequence[int], false_seed: int | Sequence[int]
    ) -> Array:
        """Return the measures of each draw, (draws, 4).

        Raises
        ------
        InputError
            If there is no true trajectory, so that alpha is 0 / 0.
        """
        count = len(score.true_tracks)
        if count == 0:
            raise InputError("TrackBootstrap: no true trajectory to draw; alpha would be 0 / 0.")
        columns = ["length", "gain", "tp", "fp", "paired"]
        true = score.true_tracks[columns].to_numpy(np.float64)
        false = score.false_tracks[["length", "positions"]].to_numpy(np.float64)
        generator = np.random.default_rng(seed)
        times = generator.multinomial(count, np.full(count, 1 / count), self.draws)
        length, gain, tp, fp, paired = (times @ true).T
        again = np.random.default_rng(false_seed).poisson(1.0, (self.draws, len(false)))
        beyond, positions = (again @ false).T
        return np.column_stack(
            [
                gain / length,
                gain / (length + beyond),
                tp / (length + fp + positions),
                paired / (count + again.sum(axis=1)),
            ]
        )
