"""What came out of a recording, in a short table that a person reads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

from kilnflight import pipeline, stages
from kilnflight.flight import remaining
from kilnflight.ignition import BEFORE, SEEN
from kilnflight.intervals import Bootstrap, Interval, median, share
from kilnflight.pipeline import Passage
from kilnflight.tracklets import tracked

SEED = 0  # of the bootstrap


class Outcome(NamedTuple):
    """All tables of one recording."""

    name: str
    frames: int
    detections: pd.DataFrame
    tracks: pd.DataFrame
    trajectories: pd.DataFrame
    flights: pd.DataFrame
    slices: pd.DataFrame
    notes: tuple[str, ...]

    @property
    def counted(self) -> pd.DataFrame:
        """The flights that start at the lance; only these count (section 5.3.1)."""
        return self.flights[self.flights["from_lance"]]


def outcome(passage: Passage, notes: tuple[str, ...] = ()) -> Outcome:
    """Return the tables of a recording, made where they are not there."""
    stretch = passage.stretch
    return Outcome(
        stretch.origin.name,
        stretch.stop - stretch.start,
        stages.detections(stretch),
        pipeline.tracks(passage),
        pipeline.trajectories(passage),
        pipeline.flights(passage),
        pipeline.slices(passage),
        notes,
    )


def summary(found: Outcome) -> pd.DataFrame:
    """Return the outcome in rows of ``what`` and ``value``, both texts.

    In brackets: 95 % intervals, by bootstrap over particles and of shares by Wilson; none of
    fewer than six.
    """
    linked = tracked(found.tracks)
    rows = [
        ("recording", found.name),
        ("frames", str(found.frames)),
        ("detections", f"{len(found.detections)}, with depth {_with_depth(found.detections)}"),
        ("detections in the air or without depth", str(len(found.tracks))),
        ("tracks", f"{linked['particle'].nunique()} with {len(linked)} detections"),
    ]
    ways = found.trajectories["outcome"].value_counts().sort_index()
    rows += [("trajectories fitted", str(int(ways.get("fitted", 0))))]
    rows += [(f"not fitted: {why}", str(n)) for why, n in ways.items() if why != "fitted"]
    rows += [*_flown(found), *_velocities(found)]
    return pd.DataFrame(rows, columns=["what", "value"])


def _with_depth(detections: pd.DataFrame) -> int:
    return int(detections["z"].notna().sum())


def _flown(found: Outcome) -> list[tuple[str, str]]:
    counted = found.counted
    rows = [
        ("flights from the lance", str(len(counted))),
        ("left out: not from the lance", str(len(found.flights) - len(counted))),
    ]
    endings = counted["ending"].value_counts().sort_index()
    rows += [(f"flights {ending}", str(n)) for ending, n in endings.items()]
    if counted.empty:
        return rows
    dwell = Bootstrap()(median, [counted["dwell_s"]], np.random.default_rng(SEED))
    rows.append(("dwell time, median", f"{_said(dwell, 3)} s"))
    for what, outcomes in (("ignition seen", [SEEN]), ("ignited", [SEEN, BEFORE])):
        lit = share(int(counted["ignition"].isin(outcomes).sum()), len(counted))
        rows.append((what, f"{_said(lit, 0, 100)} %"))
    return rows


def _said(interval: Interval, digits: int, factor: float = 1.0) -> str:
    """Return an estimate with its interval, or without one if the sample is too small."""
    estimate, low, high = (f"{factor * value:.{digits}f}" for value in interval[:3])
    return f"{estimate} [{low}, {high}]" if np.isfinite(interval[1:3]).all() else estimate


def _velocities(found: Outcome) -> list[tuple[str, str]]:
    table = remaining(found.slices, len(found.counted))
    return [
        (
            f"velocity in the metre up to {far:g} m",
            f"median {median:.1f} m/s, {100 * share:.0f} % of the flights",
        )
        for far, median, share in table[["slice_m", "median_m_s", "share"]].to_numpy()
    ]


def text(table: pd.DataFrame) -> str:
    """Return a summary as lines of two columns."""
    width = int(table["what"].str.len().max())
    return "\n".join(f"{what:<{width}}  {value}" for what, value in table.to_numpy().tolist())
