"""How far particles move from frame to frame, estimated from where they were measured.

No paper prints the velocity on the real belt, and recordings differ. Each recording is asked
itself: pairs of measurements in consecutive frames, side by side across the belt, are mostly one
particle twice, and their distances along the belt gather at the belt's step. Pairs of different
particles lie anywhere. No tracker is needed, so the estimate can be a tracker's input.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt.tracker import MEASURED, Followed
from kilnflight.checks import InputError, check_columns

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


def _steps(measured: pd.DataFrame) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return the distances along the belt of pairs side by side, and each pair's first row."""
    places = measured[["frame", "x", "y"]].reset_index(drop=True)
    after = places.assign(frame=places["frame"] - 1)
    pairs = places.reset_index().merge(after, on="frame", suffixes=("", "_after"))
    along, across = pairs["x_after"] - pairs["x"], pairs["y_after"] - pairs["y"]
    beside = (across.abs() <= BESIDE_PX) & along.between(LEAST_PX, MOST_PX)
    return along[beside].to_numpy(np.float64), pairs.loc[beside, "index"].to_numpy(np.int64)


def join_followed(parts: list[tuple[pd.DataFrame, Followed]], pause: int = 100) -> Followed:
    """Join tracks of recordings as `kilnflight.belt.recordings.join_recordings` joins these.

    Parameters
    ----------
    parts
        By recording: its measurements and their tracks.
    pause
        Frames between two recordings.

    Raises
    ------
    InputError
        If there is no recording.
    """
    if not parts:
        raise InputError("no recording to join; give at least one.")
    states, ends, frame, row, particle = [], [], 0, 0, 0
    for measured, followed in parts:
        seen = followed.states["row"] >= 0
        states.append(
            followed.states.assign(
                frame=followed.states["frame"] + frame,
                particle=followed.states["particle"] + particle,
                row=(followed.states["row"] + row).where(seen, -1),
            )
        )
        ended = followed.ends
        columns = {"particle": ended["particle"] + particle, "frame": ended["frame"] + frame}
        ends.append(ended.assign(**columns))
        frame += pause + (int(measured["frame"].max()) if len(measured) else 0)
        row += len(measured)
        particle += 1 + (int(ended["particle"].max()) if len(ended) else -1)
    return Followed(pd.concat(states, ignore_index=True), pd.concat(ends, ignore_index=True))
