"""When a particle ignites: an abrupt, lasting rise of its grey values (thesis, section 5.3.2).

::

    grey values along a track -> the best single step -> is it a step, and upwards? -> Ignited
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import (
    InputError,
    check_at_least,
    check_between,
    check_columns,
    check_count,
    check_finite,
    check_limit,
    check_positive,
    check_whole,
)
from kilnflight.steps import best_step, line_deviation, rank_sum_p

Array = npt.NDArray[np.float64]

SEEN, BEFORE, NONE, TOO_FEW = "seen", "before seen", "none", "too few points"
SIGMA = 1.4826  # median of absolute deviations -> standard deviation of a Gaussian


class Ignited(NamedTuple):
    """What the grey values of one track say.

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
        the background, if that was given.
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
    """Look for one step upwards in the grey values of a track.

    "If the gray value increases abruptly, the particles can be assumed ignited" (section
    5.3.2). The best step is the one that leaves the least sum of absolute deviations from
    the medians on both sides, among all upward ones. It is an ignition if

    1. the rank sum of the values before it is too small for chance: exact Wilcoxon test,
       times the number of places looked at (Bonferroni), at most ``significance``;
    2. it is abrupt: it leaves less deviation than the straight line of Theil and Sen;
    3. the levels are ``rise`` standard deviations of the scatter about them apart, and
       ``share`` of the grey value before.

    Notes
    -----
    The thesis prints no criterion; all of this is ours. Medians and ranks do not feel a
    single flash, and a factor on the grey values changes nothing. Ties, as between saturated
    values, count against the rise, which keeps the test valid. The test takes the values of a
    track as exchangeable but for the step; slow changes, which are not, are what 2 is for.
    With the defaults no track of fewer than 12 detections can be judged.
    The grey value of a particle of a few pixels has much of what is behind it in it: one that
    flies from before a dark end plate to before a hot wall also brightens abruptly. As
    published the grey value is taken as it is; with ``background`` it is the rise above the
    background that is looked at. A particle that is alight from its first detection on has no
    step: it is "before seen" if ``bright`` is given and its first values reach it, else
    "none", for without a level nothing tells it from a bright unlit one.
    """

    significance: float = 0.01  # of a track without a step; not printed
    least_points: int = 3  # on each side: the median of three ignores one flash
    rise: float = 2.0  # standard deviations of the scatter; not printed
    share: float = 0.1  # of the level before; not printed
    bright: float | None = None  # grey value of what burns for sure, e.g. the full scale

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
        check_between(self.significance, 0.0, 1.0, "Ignition: significance")
        check_count(self.least_points, "Ignition: least_points")
        check_limit(self.rise, "Ignition: rise")
        check_limit(self.share, "Ignition: share")
        if self.bright is not None:
            check_at_least(self.bright, 0.0, "Ignition: bright")

    def __call__(
        self, time_s: npt.ArrayLike, gray: npt.ArrayLike, background: npt.ArrayLike = 0.0
    ) -> Ignited:
        """Return when the grey values rise.

        Parameters
        ----------
        time_s
            (n,) ascending.
        gray
            (n,) grey values, not below 0.
        background
            (n,) grey values of the background at the same places; levels are then above it.

        Raises
        ------
        InputError
            If lengths differ, a value is not finite or below 0, or times do not ascend.
        """
        time, light = _course(time_s, gray)
        values = light - _course(time_s, np.broadcast_to(background, light.shape))[1]
        least = int(self.least_points)
        searched = len(values) - 2 * least + 1
        if searched < 1 or searched > self.significance * math.comb(len(values), len(values) // 2):
            return Ignited(TOO_FEW)
        split, deviation = best_step(values, least)
        level = float(np.median(values))
        if split < 0:
            return Ignited(self._without(light), before=level, after=level)
        before, after = float(np.median(values[:split])), float(np.median(values[split:]))
        off = np.concatenate([values[:split] - before, values[split:] - after])
        scatter = SIGMA * float(np.median(np.abs(off)))
        p_value = min(1.0, searched * rank_sum_p(values[:split], values[split:]))
        is_step = (
            p_value <= self.significance
            and deviation < line_deviation(time, values)
            and after - before >= max(self.rise * scatter, self.share * np.median(light[:split]))
        )
        moment = float(time[split - 1] + time[split]) / 2
        if is_step:
            return Ignited(SEEN, moment, before, after, scatter, p_value)
        return Ignited(self._without(light), math.nan, before, after, scatter, p_value)

    def _without(self, values: Array) -> str:
        """Return the outcome of a track without a step."""
        first = np.median(values[: self.least_points])
        return BEFORE if self.bright is not None and first >= self.bright else NONE


def ignitions(
    tracks: pd.DataFrame, frame_rate_hz: float, method: Ignition | None = None
) -> pd.DataFrame:
    """Return what each track's grey values say, one row per particle.

    Parameters
    ----------
    tracks
        ``frame``, ``particle``, ``gray``; rows with a particle below 0 are in no track. If it
        has a column ``background``, the rise above that is looked at.
    frame_rate_hz
        Of the recording.
    method
        `Ignition` with its defaults unless told otherwise.

    Returns
    -------
    DataFrame
        ``particle`` and the attributes of `Ignited`.
    """
    check_columns(tracks, ("frame", "particle", "gray"), "ignitions: tracks")
    check_positive(frame_rate_hz, "ignitions: frame_rate_hz")
    particle = check_whole(tracks["particle"], "ignitions: particle")
    frame = check_whole(tracks["frame"], "ignitions: frame")
    gray = check_finite(tracks["gray"].to_numpy(), "ignitions: gray")
    known = "background" in tracks.columns
    behind = check_finite(tracks["background"], "ignitions: background") if known else 0 * gray
    order = np.lexsort((frame, particle))
    order = order[particle[order] >= 0]
    names, starts = np.unique(particle[order], return_index=True)
    test = method if method is not None else Ignition()
    rows = []
    for name, part in zip(names, np.split(order, starts[1:]), strict=False):
        try:
            found = test(frame[part] / frame_rate_hz, gray[part], behind[part])
        except InputError as error:
            raise InputError(f"particle {name}: {error}") from error
        rows.append({"particle": int(name), **found._asdict()})
    empty = {"particle": np.int64, "outcome": str} | dict.fromkeys(Ignited._fields[1:], float)
    table = pd.DataFrame(rows, columns=list(empty))
    return table if rows else table.astype(empty)


def _course(time_s: npt.ArrayLike, gray: npt.ArrayLike) -> tuple[Array, Array]:
    """Return times and grey values, checked."""
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
