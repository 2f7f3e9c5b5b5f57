"""Ignition of a particle, by its grey values or by the trace it leaves in a picture.

Section 5.3.2 of the thesis judges confetti and shreds by the first, wood and PE by the second::

    grey values along a track -> the best single step -> a step, and upwards? -> IgnitionResult
    differences along a track -> light or dark? -> light from some place on? -> yes or no

The thesis prints no rule for either: `Ignition` and `LitTrace` are our tests of its sentences.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter
from scipy.stats import mannwhitneyu, theilslopes

from kilnflight.checks import (
    InputError,
    check_at_least,
    check_between,
    check_count,
    check_finite,
    check_limit,
)

Array = npt.NDArray[np.float64]

SEEN, BEFORE, NONE, TOO_FEW = "seen", "before seen", "none", "too few points"
EXACT = 200  # values; above, the normal approximation of the rank sum is as good
SIGMA = 1.4826  # median of absolute deviations -> standard deviation of a Gaussian


class IgnitionResult(NamedTuple):
    """Result of the search for ignition in one track.

    Attributes
    ----------
    outcome
        "seen": a step was found; "before seen": bright from the first detection on;
        "none": no step; "too few points": even the clearest step could be chance.
    time_s
        Midway between the last detection before the step and the first after it; NaN
        unless "seen".
    before, after
        Grey levels (medians) on both sides of the best step; both the same without one. Above
        the background, if that is what was looked at.
    scatter
        About these levels, as a standard deviation.
    p_value
        Of the best step, corrected for the search; 1 without one.
    """

    outcome: str
    time_s: float = math.nan
    before: float = math.nan
    after: float = math.nan
    scatter: float = math.nan
    p_value: float = 1.0


@dataclass(frozen=True)
class Ignition:
    """Find one step upwards in the grey values of a track.

    "If the gray value increases abruptly, the particles can be assumed ignited" (section
    5.3.2). The best step is the one that leaves the least sum of absolute deviations from
    the medians on both sides, among all upward ones. It is an ignition if

    1. the rank sum of the values before it is too small for chance: exact Wilcoxon test,
       times the number of places tested (Bonferroni), at most ``significance``;
    2. it is abrupt: it leaves less deviation than the straight line of Theil and Sen;
    3. the levels are ``rise`` standard deviations of the scatter about them apart, and
       ``share`` of the grey value before;
    4. where the background is known, the particle is brighter than it afterwards.

    Notes
    -----
    The thesis prints no criterion; all of this is ours. Medians and ranks do not feel a single
    flash, and a factor on the grey values changes nothing. Ties, as between saturated values,
    count against the rise, which keeps the test valid. The test takes the values of a track as
    exchangeable but for the step; slow changes, which are not, are what 2 is for. With the
    defaults no track of fewer than 12 detections can be judged. The thesis makes the test for
    confetti and shreds alone; wood and PE are judged by their optical picture (Fig. 5.17), and a
    slight rise near the wall is expressly no ignition (5.2.4). The grey value of a small particle
    contains much of what is behind it. An unlit particle that flies from before a dark end plate
    to before a hot wall also brightens abruptly, but stays darker than the wall. A burning one is
    brighter than what is behind it, hence 4. With ``above_background`` the rise above the
    background is taken. A particle that is alight from its first detection on has no step. It is
    "before seen" if ``bright`` is given and its first values reach it, else "none". Without a
    level nothing tells it from a bright unlit one.
    """

    significance: float = 0.01  # of a track without a step; not printed
    least_points: int = 3  # on each side: the median of three ignores one flash
    rise: float = 2.0  # standard deviations of the scatter; not printed
    share: float = 0.1  # of the level before; not printed
    bright: float | None = None  # grey value of what burns for sure, e.g. the full scale
    above_background: bool = False  # the step is of the rise above it; section 5.3.2: as it is

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        check_between(self.significance, 0.0, 1.0, "Ignition: significance")
        check_count(self.least_points, "Ignition: least_points")
        check_limit(self.rise, "Ignition: rise")
        check_limit(self.share, "Ignition: share")
        if self.bright is not None:
            check_at_least(self.bright, 0.0, "Ignition: bright")

    def __call__(
        self, time_s: npt.ArrayLike, gray: npt.ArrayLike, background: npt.ArrayLike | None = None
    ) -> IgnitionResult:
        """Return whether and when the grey values rise.

        Parameters
        ----------
        time_s
            (n,) ascending.
        gray
            (n,) grey values, not below 0.
        background
            (n,) grey values of the background at the same places; None: not known.

        Raises
        ------
        InputError
            If lengths differ, a value is not finite or below 0, times do not ascend, or
            ``above_background`` is asked for and no background is given.
        """
        time, light = _course(time_s, gray)
        if background is None and self.above_background:
            raise InputError("Ignition: above_background needs the background's grey values.")
        behind = None if background is None else _course(time_s, background)[1]
        values = light if behind is None or not self.above_background else light - behind
        least = int(self.least_points)
        searched = len(values) - 2 * least + 1
        if searched < 1 or searched > self.significance * math.comb(len(values), len(values) // 2):
            return IgnitionResult(TOO_FEW)
        split, deviation = best_step(values, least)
        level = float(np.median(values))
        if split < 0:
            return IgnitionResult(self._without(light), before=level, after=level)
        before, after = float(np.median(values[:split])), float(np.median(values[split:]))
        off = np.concatenate([values[:split] - before, values[split:] - after])
        scatter = SIGMA * float(np.median(np.abs(off)))
        p_value = min(1.0, searched * rank_sum_p(values[:split], values[split:]))
        is_step = (
            p_value <= self.significance
            and deviation < line_deviation(time, values)
            and after - before >= max(self.rise * scatter, self.share * np.median(light[:split]))
            and (behind is None or np.median(light[split:] - behind[split:]) > 0.0)
        )
        moment = float(time[split - 1] + time[split]) / 2
        if is_step:
            return IgnitionResult(SEEN, moment, before, after, scatter, p_value)
        return IgnitionResult(self._without(light), math.nan, before, after, scatter, p_value)

    def _without(self, values: Array) -> str:
        """Return the outcome of a track without a step."""
        first = np.median(values[: self.least_points])
        return BEFORE if self.bright is not None and first >= self.bright else NONE


@dataclass(frozen=True)
class LitTrace:
    """Tell whether a particle's trace lights up in the optical picture (Fig. 5.17).

    That picture is a background plus the difference of every frame from it (section 5.2.2).
    What a particle adds at its place is its grey value less the background's. The trace is light
    where it is more than ``share`` of the background above it. It lights up where it turns from
    dark to light and stays so for ``least`` detections. Traces that cross are kept apart.

    Parameters
    ----------
    share
        Of the background. 0.1: brighter than the kiln behind, by more than the "slight" rise
        near the wall, which is no ignition (5.2.4). 1: what nothing dark does, even where
        absolute differences are added, as it cannot take away more than all light. Both ours:
        the thesis looks at the picture ("as Figure 5.17 reveals") and prints no measure.
    least
        Detections; also the length of the running median, which ignores a single flash. Ours.
    """

    share: float = 0.1
    least: int = 3

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        check_at_least(self.share, 0.0, "LitTrace: share")
        check_count(self.least, "LitTrace: least")

    def __call__(
        self, time_s: npt.ArrayLike, gray: npt.ArrayLike, background: npt.ArrayLike
    ) -> str:
        """Return whether the trace lights up; parameters and errors are those of `Ignition`.

        "seen": it turns light; "before seen": it is light from the first detection on, and never
        turns so; "none"; "too few points": shorter than twice ``least``.
        """
        time, light = _course(time_s, gray)
        above = light - _course(time_s, background)[1]
        if len(time) < 2 * self.least:
            return TOO_FEW
        excess = median_filter(above - self.share * (light - above), self.least, mode="nearest")
        is_light: npt.NDArray[np.bool_] = np.greater(excess, 0.0)
        windows = np.lib.stride_tricks.sliding_window_view(is_light, self.least)
        lasting: npt.NDArray[np.bool_] = np.all(windows, axis=1)
        if (lasting[1:] & ~is_light[: len(lasting) - 1]).any():
            return SEEN
        return BEFORE if lasting[0] else NONE


def best_step(values: Array, least: int) -> tuple[int, float]:
    """Return the best step upwards and the deviation that it leaves.

    Best is the least sum of absolute deviations from the medians on both sides, among the splits
    whose median is higher after than before. Of splits equal but for rounding it is the first.

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
    median_after, spread_after = (side[::-1] for side in _growing(values[::-1]))
    rounding = count * np.finfo(np.float64).eps * np.abs(values).sum()
    split, deviation = -1, np.inf
    for k in range(least, count - least + 1):
        rest = float(spread[k - 1] + spread_after[k])
        if median_after[k] > median[k - 1] and rest < deviation - rounding:
            split, deviation = k, rest
    return split, deviation


def _growing(values: Array) -> tuple[Array, Array]:
    """Return the medians of the first 1, 2, ... values, and the deviations.

    A deviation is the sum of absolute deviations from the median.
    """
    number = np.arange(len(values))
    there = number <= number[:, None]
    ordered = np.sort(np.where(there, values, np.inf), axis=1)
    median = (ordered[number, number // 2] + ordered[number, (number + 1) // 2]) / 2
    return median, (np.abs(values - median[:, None]) * there).sum(axis=1)


def rank_sum_p(before: Array, after: Array) -> float:
    """Return the p-value of a rise from ``before`` to ``after`` (Wilcoxon).

    It is the probability that equal distributions give such low values before. One-sided; exact
    for up to `EXACT` values together, the normal approximation above. A tie counts as if the
    earlier value were the higher one: the probability is then too large rather than too small.
    """
    values, earlier = np.append(before, after), np.arange(len(before) + len(after)) < len(before)
    rank = np.argsort(np.lexsort((earlier, values)))
    method: Literal["exact", "asymptotic"] = "exact" if len(values) <= EXACT else "asymptotic"
    test = mannwhitneyu(rank[earlier], rank[~earlier], alternative="less", method=method)
    return float(test.pvalue)


def line_deviation(time: Array, values: Array) -> float:
    """Return the sum of absolute deviations from the line of Theil and Sen."""
    rest = values - theilslopes(values, time).slope * time
    return float(np.abs(rest - np.median(rest)).sum())


def _course(time_s: npt.ArrayLike, gray: npt.ArrayLike) -> tuple[Array, Array]:
    """Return the checked times and grey values."""
    time = check_finite(time_s, "Ignition: time_s").ravel()
    values = check_finite(gray, "Ignition: gray").ravel()
    if len(time) != len(values):
        raise InputError(f"Ignition: {len(time)} times, but {len(values)} grey values.")
    if (np.diff(time) <= 0).any():
        k = int(np.argmax(np.diff(time) <= 0))
        raise InputError(
            f"Ignition: time_s {time[k + 1]} follows {time[k]}; sort the track by time, one "
            "detection per frame."
        )
    if (values < 0).any():
        raise InputError(f"Ignition: a grey value is {values.min()}; pass the camera's values.")
    return time, values
