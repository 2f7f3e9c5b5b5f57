"""The prediction phase: last observations before it, arrivals at its target.

2020 paper, Figs 2 and 5: a particle is observed until the prediction phase begins. After that only
the crossing of the target is used, as the reference value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt.models import BELT_EDGE_MM
from kilnflight.checks import InputError
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST, BELT_TRACKS

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]


class Observed(NamedTuple):
    """The same particles in the same order in both tables; the others are counted."""

    last: pd.DataFrame  # kilnflight.tables.BELT_LAST
    arrival: pd.DataFrame  # kilnflight.tables.BELT_ARRIVAL
    left_out: dict[str, int]  # reason -> number of particles


@dataclass(frozen=True)
class PredictionPhase:
    """Where observation ends and where a particle is predicted to.

    The paper predicts to the edge of the belt from 150 mm before it.
    The public tracks end at that edge, so no observation lies beyond it. The last position of every
    particle is between 773 and 788 mm. Therefore target and start are moved upstream by 15 mm,
    which keeps the length of the phase.
    """

    start_mm: float = BELT_EDGE_MM - 165.0  # 150 mm before the target (sec. 5)
    target_mm: float = BELT_EDGE_MM - 15.0  # the largest whole mm that has an observation after it

    def __post_init__(self) -> None:
        """Refuse a phase that does not lead downstream."""
        if not self.start_mm < self.target_mm:
            raise InputError(
                f"prediction phase from {self.start_mm} to {self.target_mm} mm: the target "
                "must lie downstream of the start."
            )

    def observe(self, tracks: pd.DataFrame) -> Observed:
        """Split tracks into last observations and arrivals at the target.

        Velocity and acceleration come from the parabola through the last three positions. With
        noise-free positions "only the last few observations are required" (sec. 5.1). For a
        constant acceleration the result is exact.

        Parameters
        ----------
        tracks
            `kilnflight.tables.BELT_TRACKS`, sampled evenly in time.

        Returns
        -------
        Observed
            Particles are left out, and counted by the first reason that applies: a gap in the
            track; fewer than three observations before the phase; the target never reached.

        Raises
        ------
        InputError
            If a particle has two rows in one frame, or the time between frames varies.
        """
        table = BELT_TRACKS.check(tracks).sort_values(["particle", "frame"], kind="stable")
        _check_frames(table)
        columns = {name: table[name].to_numpy() for name in BELT_TRACKS.names}
        starts = np.flatnonzero(np.diff(columns["particle"], prepend=np.nan) != 0)
        ends = np.append(starts, len(table))[1:]
        gap = columns["frame"][ends - 1] - columns["frame"][starts] + 1 != ends - starts
        before = _first(columns["x"] >= self.start_mm, starts, ends) - 1
        after = _first(columns["x"] >= self.target_mm, starts, ends)
        short, missed = before - starts < 2, after == ends
        keep = ~(gap | short | missed)
        left_out = {
            "gap in the track": int(gap.sum()),
            "fewer than three observations before the phase": int((short & ~gap).sum()),
            "target never reached": int((missed & ~short & ~gap).sum()),
        }
        return Observed(_last(columns, before[keep]), self._arrival(columns, after[keep]), left_out)

    def carry(self, observed: Observed) -> Observed:
        """Return last states carried on to the start of the phase by their own acceleration.

        At 100 Hz the last observation lies up to a step of 14 mm before the phase; at the paper's
        1000 Hz (section 5) up to 1.4 mm. Only what was observed before the phase is used. A
        particle that would stop before keeps its state.
        """
        last = observed.last
        gap = self.start_mm - last["x"]
        speed, gain = last["velocity_x_mm_s"], last["acceleration_x_mm_s2"]
        square = speed**2 + 2 * gain * gap
        wait = (2 * gap / (speed + np.sqrt(square.clip(lower=0.0)))).where(square > 0, 0.0)
        moved = {"time_s": last["time_s"] + wait}
        for axis in ("x", "y"):
            velocity, change = last[f"velocity_{axis}_mm_s"], last[f"acceleration_{axis}_mm_s2"]
            moved[axis] = last[axis] + wait * velocity + wait**2 * change / 2
            moved[f"velocity_{axis}_mm_s"] = velocity + wait * change
        return observed._replace(last=last.assign(**moved)[BELT_LAST.names])

    def _arrival(self, columns: dict[str, Array], after: Rows) -> pd.DataFrame:
        """Interpolate linearly between the observations around the target (Fig. 5)."""
        names = ("time_s", "x", "y")
        time, x, y = (columns[name][after - 1] for name in names)
        duration, way, across = (columns[name][after] - columns[name][after - 1] for name in names)
        share = (self.target_mm - x) / way
        arrived = (time + share * duration, y + share * across, across / duration)
        parts = zip(BELT_ARRIVAL.names, (columns["particle"][after], *arrived), strict=True)
        return pd.DataFrame(dict(parts))


def _check_frames(table: pd.DataFrame) -> None:
    """Refuse two rows in one frame and frames that are not evenly spaced in time."""
    steps = table.groupby("particle")[["frame", "time_s"]].diff()
    repeated = (steps["frame"] <= 0).to_numpy()
    if repeated.any():
        row = table.iloc[int(np.argmax(repeated))]
        raise InputError(
            f"particle {row['particle']:.0f} has two rows in frame {row['frame']:.0f}; keep one."
        )
    step = (steps["time_s"] / steps["frame"]).to_numpy()
    inside = np.flatnonzero(np.isfinite(step))
    median = np.median(step[inside]) if len(inside) else 1.0
    off = np.abs(step[inside] - median)
    if len(inside) and (step[inside].min() <= 0 or np.ptp(step[inside]) > 1e-3 * median):
        row = table.iloc[inside[np.argmax(off)]]
        raise InputError(
            f"particle {row['particle']:.0f}, frame {row['frame']:.0f}: time_s does not grow "
            f"evenly with the frame (median step {median:g} s). Resample the track."
        )


def _first(flags: npt.NDArray[np.bool_], starts: Rows, ends: Rows) -> Rows:
    """Return the first flagged row of each particle, or its end."""
    rows = np.append(np.flatnonzero(flags), len(flags))
    return np.minimum(rows[np.searchsorted(rows, starts)], ends)


def _last(columns: dict[str, Array], row: Rows) -> pd.DataFrame:
    """Return the state at ``row`` from a parabola.

    The parabola goes through it and the two rows before.
    """
    step = columns["time_s"][row] - columns["time_s"][row - 1]
    state = {"particle": columns["particle"][row], "time_s": columns["time_s"][row]}
    for axis in ("x", "y"):
        newest, middle, oldest = (columns[axis][row - back] for back in range(3))
        state[axis] = newest
        state[f"velocity_{axis}_mm_s"] = (3 * newest - 4 * middle + oldest) / (2 * step)
        state[f"acceleration_{axis}_mm_s2"] = (newest - 2 * middle + oldest) / step**2
    return pd.DataFrame(state)[BELT_LAST.names]
