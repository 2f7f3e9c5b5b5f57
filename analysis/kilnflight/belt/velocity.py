"""How far particles move from frame to frame, estimated from where they were measured.

No paper prints the velocity on the real belt, and recordings differ. Each recording is asked
itself: pairs of measurements in consecutive frames, side by side across the belt, are mostly one
particle twice, and their distances along the belt gather at the belt's step. Pairs of different
particles lie anywhere. No tracker is needed, so the estimate can be a tracker's input.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt.camera import TRACKED
from kilnflight.belt.tracker import MEASURED
from kilnflight.checks import InputError, check_columns, check_count, check_finite, check_positive

Array = npt.NDArray[np.float64]

LEAST_PX, MOST_PX = 5.0, 500.0  # per frame; what moves less lies still (dirt); choice
BESIDE_PX = 8.0  # across the belt, by which a particle may move in a frame; choice
BIN_PX = 4.0  # of the distances; choice
AROUND = 0.2  # of the step: what counts to its peak; choice
LEAST_PAIRS = 20  # in the peak; choice
RIVAL = 0.5  # a second peak this high makes the step ambiguous; choice
MAD_TO_SD = 1.4826  # of a normal distribution


class BeltVelocity(NamedTuple):
    """The step of particles from frame to frame."""

    px_per_frame: float  # median of the pairs in the peak
    spread_px: float  # 1.4826 times their median absolute deviation
    pairs: int  # in the peak
    share_percent: float  # of all measurements but those of the last frame that have such a pair


def estimate_velocity(measured: pd.DataFrame, name: str = "recording") -> BeltVelocity:
    """Return how far particles move along the belt in a frame.

    The distances along the belt of all pairs in consecutive frames that lie side by side are
    counted in bins. The highest bin, with its neighbours, is the peak; the step is the median of
    the distances within a fifth of it.

    Parameters
    ----------
    measured
        ``frame``, ``x`` along the belt (in which it runs) and ``y`` across it, px.
    name
        Of the recording, for errors.

    Raises
    ------
    InputError
        If fewer than 20 pairs make the peak, or a second peak is half as high: nothing moves
        with the belt, or too much at once to tell. Give the velocity by hand then.
    """
    check_columns(measured, MEASURED.names, name)
    steps, first = _steps(measured)
    counts, edges = np.histogram(steps, np.arange(LEAST_PX, MOST_PX + BIN_PX, BIN_PX))
    peaks = np.convolve(counts, np.ones(3), mode="same")
    highest = int(np.argmax(peaks))
    centre = 0.5 * (edges[highest] + edges[highest + 1])
    near = np.abs(steps - centre) <= max(AROUND * centre, 2 * BIN_PX)
    if near.sum() < LEAST_PAIRS:
        raise InputError(
            f"{name}: only {near.sum()} pairs of measurements move alike from frame to frame; "
            f"{LEAST_PAIRS} are needed for the belt's velocity. Give it by hand, in px per frame."
        )
    middle = 0.5 * (edges[:-1] + edges[1:])
    apart = np.abs(middle - centre) > max(AROUND * centre, 2 * BIN_PX) + BIN_PX
    rival = int(np.argmax(np.where(apart, peaks, -1.0)))
    if apart.any() and peaks[rival] >= RIVAL * peaks[highest]:
        raise InputError(
            f"{name}: particles move by {centre:.0f} or by {middle[rival]:.0f} px per frame, and "
            "nothing tells which. Give the belt's velocity by hand, in px per frame."
        )
    step = float(np.median(steps[near]))
    spread = MAD_TO_SD * float(np.median(np.abs(steps[near] - step)))
    before_last = int((measured["frame"] < measured["frame"].max()).sum())
    share = 100 * len(np.unique(first[near])) / before_last
    return BeltVelocity(step, spread, int(near.sum()), share)


@dataclass
class WatchVelocity:
    """Whether particles still move as they did, by the measurements of the last frames.

    They speed up along the belt. So only those near the end of the tracked area count, or a belt
    that fills would seem slower. Another material has another velocity on the same belt.

    To ask takes some milliseconds: do it once a second, not in every frame.
    """

    px_per_frame: float  # at the start, as `of_spots` has it
    mm_per_px: float  # of the calibration
    from_mm: float = TRACKED.end_mm - 90.0  # along the belt: places before do not count; choice
    frames: int = 200  # that are kept: one second
    limit: float = 0.05  # share of the velocity: CV errs by as much of the way's time; choice

    def __post_init__(self) -> None:
        """Refuse numbers that are not positive."""
        for name in ("px_per_frame", "mm_per_px", "limit"):
            check_positive(getattr(self, name), f"WatchVelocity: {name}")
        check_count(self.frames, "WatchVelocity: frames", least=2)
        check_finite(self.from_mm, "WatchVelocity: from_mm")
        self._recent = deque[Array](maxlen=self.frames)

    @classmethod
    def of_spots(cls, spots: pd.DataFrame, mm_per_px: float, from_mm: float) -> Self:
        """Return a watch that starts with the velocity in `kilnflight.tables.BELT_SPOTS`."""
        check_columns(spots, MEASURED.names, "WatchVelocity: spots")
        counted = spots.loc[spots["x"] > from_mm, MEASURED.names] / [1, mm_per_px, mm_per_px]
        return cls(estimate_velocity(counted).px_per_frame, mm_per_px, from_mm)

    def add(self, frame: int, places: Array) -> None:
        """Take the measurements of a frame, (m, 2) in mm."""
        counted = places[places[:, 0] > self.from_mm]
        self._recent.append(np.column_stack([np.full(len(counted), frame), counted]))

    def change(self) -> float:
        """Return the change of the velocity, a share of that at the start.

        NaN if the last frames do not tell: an empty belt, one that stands, or no two frames in a
        row, as if every second one is lost.
        """
        rows = np.concatenate([np.empty((0, 3)), *self._recent]) / [1, *2 * [self.mm_per_px]]
        table = pd.DataFrame(rows, columns=MEASURED.names).astype({"frame": np.int64})
        try:
            return estimate_velocity(table).px_per_frame / self.px_per_frame - 1.0
        except InputError:
            return np.nan

    def has_drifted(self) -> bool | None:
        """Return whether the velocity has changed by more than ``limit``; None: not known."""
        change = self.change()
        return None if np.isnan(change) else abs(change) > self.limit


def _steps(measured: pd.DataFrame) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return the distances along the belt of pairs side by side, and each pair's first row."""
    places = measured[["frame", "x", "y"]].reset_index(drop=True)
    after = places.assign(frame=places["frame"] - 1)
    pairs = places.reset_index().merge(after, on="frame", suffixes=("", "_after"))
    along, across = pairs["x_after"] - pairs["x"], pairs["y_after"] - pairs["y"]
    beside = (across.abs() <= BESIDE_PX) & along.between(LEAST_PX, MOST_PX)
    return along[beside].to_numpy(np.float64), pairs.loc[beside, "index"].to_numpy(np.int64)
