"""Ignition of a particle, by its grey values (section 5.3.2 of the thesis).

    grey values of a track -> above the background -> best step -> `IgnitionResult`

The thesis prints no rule: `Ignition` is our test of its sentence.
"""

import math
from typing import Literal, NamedTuple

import numpy as np
import scipy  # stats on first use: they take a quarter of a second

from kilnflight.arrays import Array, ArrayLike, Pair
from kilnflight.checks import InputError, Settings, check_finite

SEEN = "seen"
NONE = "none"
TOO_FEW = "too few points"
SIGNIFICANCE = 0.01  # share of tracks without a step that pass; not printed
LEAST_POINTS = 3  # points on each side: the median of three ignores one flash
RISE = 2.0  # standard deviations of the scatter; not printed
SHARE = 0.1  # least step over the level before it; not printed


class IgnitionResult(NamedTuple):
    """Result of the search for ignition in one track.

    Attributes
    ----------
    outcome
        "seen": a step was found; "none": no step; "too few points": even the clearest
        step could be chance.
    time_s
        Midway between the last detection before the step and the first after it, on the
        clock of the input; NaN unless "seen".
    before, after
        Grey levels (medians) on both sides of the best step, equal without a step. They
        are measured from the background where it is known, unless ``above_background``
        is False.
    scatter
        Of the grey values about these levels, as a standard deviation.
    p_value
        Of the best step, corrected for the search; 1 without a step.
    """

    outcome: str
    time_s: float = math.nan
    before: float = math.nan
    after: float = math.nan
    scatter: float = math.nan
    p_value: float = 1.0


class Ignition(Settings):
    """Test for one step upwards in the grey values of a track, above those behind it.

    "If the gray value increases abruptly, the particles can be assumed ignited"
    (section 5.3.2). The best step leaves the least sum of absolute deviations from the
    medians on both sides, among all upward ones. It is an ignition if

    1. the rank sum of the values before it is too small for chance: exact Wilcoxon
       test, times the number of places tested (Bonferroni), at most `SIGNIFICANCE`;
    2. it leaves less deviation than the straight line of Theil and Sen;
    3. the levels are `RISE` standard deviations of the scatter about them apart, and
       `SHARE` of the grey value before;
    4. where the background is known, the particle is brighter than it afterwards.

    Notes
    -----
    The thesis prints no criterion; all of this is ours. Medians and ranks are robust
    against single flashes, and a factor on the grey values changes nothing. Ties, as
    between saturated values, count against the rise, which keeps the test valid. The
    test takes the values of a track as exchangeable but for the step; 2 excludes slow
    changes. No track of fewer than 12 detections can be judged. The grey value of a
    small particle contains much of the background. An unlit particle that flies from a
    dark end plate to a hot wall brightens abruptly, too. Hence the rise above the
    background, and 4; a slight rise near the wall is expressly no ignition (5.2.4). A
    particle that is light from its first detection on has no step: its grey value does
    not rise.

    Parameters
    ----------
    above_background
        Whether the rise is measured above the background, where that is known; else it
        is the rise of the grey value itself.

    Examples
    --------
    >>> time_s = np.arange(60) / 330
    >>> gray = np.where(time_s < 0.1, 3000.0, 9000.0)
    >>> found = Ignition()(time_s, gray)
    >>> found.outcome, round(found.time_s, 3), found.after - found.before
    ('seen', 0.098, 6000.0)
    """

    above_background: bool = True

    def __call__(
        self,
        time_s: ArrayLike,
        gray: ArrayLike,
        background: ArrayLike | None = None,
    ) -> IgnitionResult:
        """Return whether and when the grey values of one track rise.

        Parameters
        ----------
        time_s
            (n,) ascending.
        gray
            (n,) grey values, not below 0.
        background
            (n,) grey values of the background at the same positions; None: not known,
            so that the rise is that of the grey value.

        Raises
        ------
        InputError
            If lengths differ, a value is not finite or below 0, or times do not ascend.
        """
        time, light = _course(time_s, gray)
        behind = np.zeros(len(light))
        if background is not None:
            behind = _course(time_s, background)[1]
        values = light
        if self.above_background:
            values = light - behind
        count = len(values)
        splits = count - 2 * LEAST_POINTS + 1
        # Otherwise even the clearest step could be chance: p = splits / C(n, n // 2).
        if not 1 <= splits <= SIGNIFICANCE * math.comb(count, count // 2):
            return IgnitionResult(TOO_FEW)
        split, deviation = best_step(values, LEAST_POINTS)
        if split < 0:
            level = float(np.median(values))
            return IgnitionResult(NONE, before=level, after=level)
        before = float(np.median(values[:split]))
        after = float(np.median(values[split:]))
        off = np.concatenate([values[:split] - before, values[split:] - after])
        # 1.4826 makes it the standard deviation of a Gaussian.
        scatter = 1.4826 * float(np.median(np.abs(off)))
        p_value = min(1.0, splits * rank_sum_p(values[:split], values[split:]))
        is_step = (
            p_value <= SIGNIFICANCE
            and deviation < line_deviation(time, values)
            and after - before >= max(RISE * scatter, SHARE * np.median(light[:split]))
            and np.median(light[split:] - behind[split:]) > 0.0
        )
        found = IgnitionResult(
            NONE, before=before, after=after, scatter=scatter, p_value=p_value
        )
        if is_step:
            moment = float(time[split - 1] + time[split]) / 2
            found = found._replace(outcome=SEEN, time_s=moment)
        return found


def best_step(values: Array, least: int) -> tuple[int, float]:
    """Return the best step upwards in grey values and the deviation that it leaves.

    Best is the least sum of absolute deviations from the medians on both sides, among
    the splits whose median is higher afterwards. Of splits equal within rounding it is
    the first.

    Parameters
    ----------
    values
        (n,) float64.
    least
        Smallest number of values on each side.

    Returns
    -------
    split, deviation
        Index of the first value after the step, and the sum in grey values; -1 and
        infinity where no split goes upwards.
    """
    count = len(values)
    median, spread = _growing(values)
    median_after, spread_after = np.flip(_growing(values[::-1]), axis=1)
    rounding = count * np.finfo(np.float64).eps * np.abs(values).sum()
    split = np.arange(least, count - least + 1)
    rises = median_after[split] > median[split - 1]
    split = split[rises]
    if not len(split):
        return -1, np.inf
    deviation = spread[split - 1] + spread_after[split]
    best = np.argmax(deviation <= deviation.min() + rounding)
    return split[best], deviation[best]


def _growing(values: Array) -> Pair:
    """Return medians (n,) of the first 1, 2, ... values, and their deviations (n,).

    A deviation is the sum of absolute deviations from the median. Memory grows as n^2.
    """
    number = np.arange(len(values))
    there = number <= number[:, None]
    ordered = np.sort(np.where(there, values, np.inf), axis=1)
    median = (ordered[number, number // 2] + ordered[number, (number + 1) // 2]) / 2
    return median, (np.abs(values - median[:, None]) * there).sum(axis=1)


def rank_sum_p(before: Array, after: Array) -> float:
    """Return the p-value of a rise from ``before`` to ``after`` (Wilcoxon, one-sided).

    Both are grey values, (k,) and (n - k,). Exact for n up to 200, the normal
    approximation above. A tie counts as if the earlier value were the higher one, so
    the p-value is too large rather than too small.
    """
    values = np.append(before, after)
    earlier = np.arange(len(values)) < len(before)
    rank = np.argsort(np.lexsort((earlier, values)))
    method: Literal["exact", "asymptotic"] = "exact"
    if len(values) > 200:
        method = "asymptotic"
    test = scipy.stats.mannwhitneyu(
        rank[earlier], rank[~earlier], alternative="less", method=method
    )
    return float(test.pvalue)


def line_deviation(time: Array, values: Array) -> float:
    """Return the sum of absolute deviations from the line of Theil and Sen.

    ``time`` and ``values`` are (n,). A step must leave less, else the change is slow.
    """
    rest = values - scipy.stats.theilslopes(values, time).slope * time
    return np.abs(rest - np.median(rest)).sum()


def _course(time_s: ArrayLike, gray: ArrayLike) -> Pair:
    """Return the times (n,) and grey values (n,), checked."""
    time = check_finite(time_s, "Ignition: time_s", (None,))
    values = check_finite(gray, "Ignition: gray", (None,))
    if len(time) != len(values):
        raise InputError(
            f"Ignition: {len(time)} times in time_s, but {len(values)} grey values."
        )
    if (np.diff(time) <= 0).any():
        raise InputError(
            "Ignition: time_s must ascend; sort the track, one detection per frame."
        )
    if (values < 0).any():
        raise InputError(
            f"Ignition: gray holds {values.min()}; pass the camera's values."
        )
    return time, values
