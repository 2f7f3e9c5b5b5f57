"""Which true particle a track followed (2016 paper, section IV.B)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import check_columns

Array = npt.NDArray[np.float64]

PLACED = ["frame", "particle", "x", "y"]


def match(states: pd.DataFrame, truth: pd.DataFrame) -> pd.DataFrame:
    """Return the true particle of each track: the one with the least distance function.

    Parameters
    ----------
    states
        Tracks: ``frame``, ``particle``, ``x``, ``y``, as `kilnflight.tables.BELT_STATES`.
    truth
        The same columns of the particles, in the same frames.

    Returns
    -------
    DataFrame
        ``particle`` (the track), ``truth``, ``rms_mm`` (root of the mean squared distance). A
        track that no particle accompanies in all of its frames has no row.

    Notes
    -----
    The function is "the euclidean norm of the euclidean distances between all estimated
    positions and all corresponding ground truth positions". The paper does not say what counts
    for a particle that is not there in some of the frames; here it is no candidate. Two tracks
    may match the same particle.
    """
    check_columns(states, PLACED, "states")
    check_columns(truth, PLACED, "truth")
    tracks = states[PLACED].sort_values(["particle", "frame"], kind="stable")
    known = truth[PLACED].sort_values("frame", kind="stable")
    columns = tuple(known[name].to_numpy() for name in PLACED)
    rows = []
    for who, one in tracks.groupby("particle", sort=True):
        best = _best(one["frame"].to_numpy(), one[["x", "y"]].to_numpy(), columns)
        if best is not None:
            rows.append((who, *best))
    table = pd.DataFrame(rows, columns=["particle", "truth", "rms_mm"])
    return table.astype({"particle": np.int64, "truth": np.int64, "rms_mm": np.float64})


def _best(frames: Any, places: Array, known: tuple[Any, ...]) -> tuple[int, float] | None:
    """Return the particle closest to one track over all of its frames, and its distance."""
    frame, particle, x, y = known
    near = slice(*np.searchsorted(frame, [frames[0], frames[-1] + 1]))
    at = np.searchsorted(frames, frame[near])
    same = frames[at] == frame[near]
    names, who = np.unique(particle[near][same], return_inverse=True)
    if not len(names):
        return None
    apart = np.column_stack([x[near], y[near]])[same] - places[at[same]]
    total = np.bincount(who, (apart**2).sum(axis=1))
    total[np.bincount(who) < len(frames)] = np.inf
    first = int(np.argmin(total))
    if not np.isfinite(total[first]):
        return None
    return int(names[first]), float(np.sqrt(total[first] / len(frames)))
