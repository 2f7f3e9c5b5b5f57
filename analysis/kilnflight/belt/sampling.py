"""Tracks at a lower rate: what a slower camera would have seen."""

from __future__ import annotations

import pandas as pd

from kilnflight.checks import check_count


def thinned(tracks: pd.DataFrame, every: int) -> pd.DataFrame:
    """Return every n-th frame, renumbered; times are kept.

    Parameters
    ----------
    tracks
        With a column ``frame``, as `kilnflight.tables.BELT_TRACKS`.
    every
        1 keeps all; 10 makes 100 Hz of 1000 Hz.
    """
    check_count(every, "thinned: every")
    kept = tracks[tracks["frame"] % every == 0]
    return kept.assign(frame=kept["frame"] // every).reset_index(drop=True)
