"""Predictions of when and where a particle passes the edge of the belt (2016 paper, IV)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from kilnflight.belt import arrival, lateral
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.belt.tracker import LEFT, Followed
from kilnflight.checks import InputError, check_columns, check_positive
from kilnflight.tables import BELT_ARRIVAL, BELT_LAST, BELT_STATES

_CV = arrival.CV()


def last_states(followed: Followed, frame_s: float) -> pd.DataFrame:
    """Return what is known of each track when it enters the prediction phase.

    Parameters
    ----------
    followed
        From `kilnflight.belt.tracker.BeltTracker`, whose area ends where the phase begins.
    frame_s
        Time between two frames.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_LAST`, the filtered state in the frame of the last measurement,
        and ``row`` of that measurement. Only tracks that were valid and left at the end of the
        area: "only tracks that are deemed valid while entering the prediction phase trigger a
        separation event".
    """
    check_positive(frame_s, "last_states: frame_s")
    states = BELT_STATES.check(followed.states)
    ends = followed.ends
    entering = ends.loc[(ends["valid"] == 1) & (ends["reason"] == LEFT), "particle"]
    seen = states[(states["row"] >= 0) & states["particle"].isin(entering)]
    last = seen.sort_values(["particle", "frame"]).groupby("particle").tail(1)
    table = last.assign(time_s=last["frame"] * frame_s)
    return table[[*BELT_LAST.names, "row"]].reset_index(drop=True)


def observe(
    followed: Followed, measured: pd.DataFrame, phase: PredictionPhase, frame_s: float
) -> Observed:
    """Return what a filter knew before the prediction phase, and what was measured after it.

    Parameters
    ----------
    followed, measured
        From `kilnflight.belt.tracker.BeltTracker` and what it was given; its area covers the
        target, so that what happens there is observed, too.
    phase
        Where observation ends and what is predicted to; `PredictionPhase.observe` says which
        tracks are left out.
    frame_s
        Time between two frames.
    """
    states = BELT_STATES.check(followed.states)
    seen = states[states["row"] >= 0].assign(time_s=lambda one: one["frame"] * frame_s)
    where = measured[["x", "y"]].to_numpy()[seen["row"].to_numpy()]
    tracks = seen[["frame", "particle", "time_s"]].assign(x=where[:, 0], y=where[:, 1])
    observed = phase.observe(tracks)
    filtered = seen.set_index(["particle", "time_s"])[BELT_LAST.names[2:]]
    keys = pd.MultiIndex.from_frame(observed.last[["particle", "time_s"]])
    last = filtered.loc[keys].reset_index()[BELT_LAST.names]
    return observed._replace(last=last)


def deviations(
    last: pd.DataFrame,
    reference: pd.DataFrame,
    target_mm: float,
    when: arrival.ArrivalModel = _CV,
) -> pd.DataFrame:
    """Return how far predictions with constant velocity and straight ones are off.

    Parameters
    ----------
    last, reference
        `kilnflight.tables.BELT_LAST` and `kilnflight.tables.BELT_ARRIVAL` of the same
        particles in the same order.
    target_mm
        The edge of the belt.
    when
        What predicts the time: constant velocity, as in the paper, or another model.

    Returns
    -------
    DataFrame
        ``particle``; ``lateral_mm`` (prediction minus truth); ``straight_mm``, the same for
        a movement straight along the belt; ``temporal_ms``, positive where the particle has
        arrived earlier than predicted (Fig. 6). NaN where the velocity never leads there.

    Raises
    ------
    InputError
        If the tables do not hold the same particles in the same order.
    """
    check_columns(last, BELT_LAST.names, BELT_LAST.name)
    check_columns(reference, BELT_ARRIVAL.names, BELT_ARRIVAL.name)
    if list(last["particle"]) != list(reference["particle"]):
        raise InputError(
            "deviations: both tables must hold the same particles in the same order; match the "
            "tracks with the truth first."
        )
    state = BELT_LAST.check(last)
    moving = (state["velocity_x_mm_s"] > 0).to_numpy()
    time = np.full(len(state), np.nan)
    time[moving] = when(state[moving], target_mm)
    remaining = time - state["time_s"].to_numpy()
    true_y = reference["y"].to_numpy()
    return pd.DataFrame(
        {
            "particle": state["particle"].to_numpy(),
            "lateral_mm": lateral.CV()(state, remaining) - true_y,
            "straight_mm": lateral.Straight()(state, np.zeros(len(state))) - true_y,
            "temporal_ms": 1000.0 * (time - reference["time_s"].to_numpy()),
        }
    )
