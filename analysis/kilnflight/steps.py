"""One step in a course of values: where it is, whether chance makes it, what a line would do."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

Array = npt.NDArray[np.float64]

EXACT = 200  # values; above, the normal approximation of the rank sum is as good


@njit(cache=True)
def best_step(values: Any, least: int) -> tuple[int, float]:
    """Return the best step upwards: first index after it, and what it leaves.

    Best is the least sum of absolute deviations from the medians on both sides, among the
    splits whose median is higher after than before; the first of those equal but for rounding.

    Parameters
    ----------
    values
        (n,) float64.
    least
        Values on each side, at least.

    Returns
    -------
    split, deviation
        -1 and infinity where no split goes upwards.
    """
    count = len(values)
    median, spread = _growing(values)
    median_after, spread_after = _growing(values[::-1])
    rounding = count * np.finfo(np.float64).eps * np.abs(values).sum()
    split, deviation = -1, np.inf
    for k in range(least, count - least + 1):
        rest = spread[k - 1] + spread_after[count - k - 1]
        if median_after[count - k - 1] > median[k - 1] and rest < deviation - rounding:
            split, deviation = k, rest
    return split, deviation


@njit(cache=True)
def _growing(values: Any) -> tuple[Any, Any]:
    """Return median and sum of absolute deviations from it of the first 1, 2, ... values."""
    count = len(values)
    ordered = np.empty(count)
    median, spread = np.empty(count), np.empty(count)
    for n in range(1, count + 1):
        place = np.searchsorted(ordered[: n - 1], values[n - 1])
        for i in range(n - 1, place, -1):
            ordered[i] = ordered[i - 1]
        ordered[place] = values[n - 1]
        median[n - 1] = (ordered[(n - 1) // 2] + ordered[n // 2]) / 2
        total = 0.0
        for i in range(n // 2):
            total += ordered[n - 1 - i] - ordered[i]
        spread[n - 1] = total
    return median, spread


def rank_sum_p(before: Array, after: Array) -> float:
    """Return how probably values that are all alike come out so low before (Wilcoxon).

    One-sided; exact for up to `EXACT` values together, the normal approximation above. A
    tie counts as if the earlier value were the higher one: the probability is then too
    large rather than too small.
    """
    # Pairs in which the earlier value is not below the later one.
    inversions = int(np.searchsorted(np.sort(after), before, side="right").sum())
    few, many = sorted((len(before), len(after)))
    if few + many <= EXACT:
        return float(_inversions_p(inversions, few, many))
    sigma = math.sqrt(few * many * (few + many + 1) / 12)
    return math.erfc((few * many / 2 - inversions - 0.5) / sigma / math.sqrt(2)) / 2


@njit(cache=True)
def _inversions_p(inversions: int, few: int, many: int) -> float:
    """Return the probability of at most so many inversions between two random sets.

    Their numbers are the coefficients of the Gaussian binomial, built factor by factor:
    (1 - q^(many + i)) / (1 - q^i), i = 1 ... few; each is divided by its sum, so that
    nothing overflows.
    """
    most = few * many
    if inversions >= most:
        return 1.0
    upper = 2 * inversions >= most  # the numbers are the same from both ends
    top = most - inversions - 1 if upper else inversions
    share = np.zeros(top + 1)
    share[0] = 1.0
    for i in range(1, few + 1):
        for j in range(top, many + i - 1, -1):
            share[j] -= share[j - many - i]
        for j in range(i, top + 1):
            share[j] += share[j - i]
        share *= i / (many + i)
    tail = share.sum()
    return 1.0 - tail if upper else tail


def line_deviation(time: Array, values: Array) -> float:
    """Return the sum of absolute deviations from the line of Theil and Sen.

    The slope is the median of those between all pairs of values, the offset the median of
    what is left.
    """
    first, second = np.triu_indices(len(time), 1)
    slope = np.median((values[second] - values[first]) / (time[second] - time[first]))
    rest = values - slope * time
    return float(np.abs(rest - np.median(rest)).sum())
