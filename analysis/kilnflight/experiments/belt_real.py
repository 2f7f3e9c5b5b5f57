"""The models of the 2020 paper on the authors' recordings of a real belt."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from kilnflight.belt.camera import Area
from kilnflight.belt.evaluation import (
    SUMMARY,
    Evaluation,
    arrival_deviations,
    lateral_deviations,
    observe,
)
from kilnflight.belt.phase import PredictionPhase
from kilnflight.belt.tracker import Appearance, BeltTracker, Followed
from kilnflight.belt.velocity import BeltVelocity, join_followed
from kilnflight.experiments.belt_2020 import Key, over_draws
from kilnflight.tracking.motion import Motion

#: Key of a recording: its material and its name.
Recorded = tuple[str, str]

# What the camera sees of the belt, px: read off the recordings; choice.
VISIBLE = Area(0, 1700, 2250)


def track_recordings(
    measured: Mapping[Recorded, pd.DataFrame],
    velocities: Mapping[Recorded, BeltVelocity],
    material: str,
    motion: Callable[[tuple[float, float]], Motion],
) -> Followed:
    """Return the tracks of one material's recordings, joined, each at its own velocity.

    ``motion`` makes a motion model from the velocity at which particles enter, px per frame.
    """
    parts = []
    for key in (key for key in measured if key[0] == material):
        step = velocities[key].px_per_frame
        appearance = Appearance(VISIBLE, 0.5, entry_mm=step, entry_blur_mm=10.0)  # px stand for mm
        tracker = BeltTracker(motion((step, 0.0)), appearance, frame_s=1.0)
        parts.append((measured[key], tracker(measured[key])))
    return join_followed(parts)


def tabulate_velocities(
    measured: Mapping[Recorded, pd.DataFrame], velocities: Mapping[Recorded, BeltVelocity]
) -> pd.DataFrame:
    """Return each recording's velocity, and beside it that of the authors' own links.

    Returns
    -------
    DataFrame
        ``material``, ``recording``, the fields of `BeltVelocity`, and ``linked_px_per_frame``: the
        median distance along the belt between consecutive frames of the authors' tracks, NaN where
        there are none.
    """
    table = pd.DataFrame(velocities.values(), pd.MultiIndex.from_tuples(velocities))
    table = table.rename_axis(["material", "recording"])
    for key, places in measured.items():
        tracked = places[places["author_track"] >= 0].sort_values(["author_track", "frame"])
        step = tracked[["author_track", "frame", "x"]].diff()
        linked = (step["author_track"] == 0) & (step["frame"] == 1)
        table.loc[key, "linked_px_per_frame"] = step.loc[linked, "x"].median()
    return table.reset_index()


def compare_on_recordings(
    followed: Mapping[Key, Followed],
    measured: Mapping[str, pd.DataFrame],
    phase: PredictionPhase,
    evaluation: Evaluation,
    seed: int,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return deviations on recordings of a real belt, and how many tracks are left out.

    CALV and LV-DSC need the belt's velocity, which is not published; they are left out. Tracks
    are by data set and filter; their px and frames stand for mm and s.

    Returns
    -------
    models : DataFrame
        ``data_set``, ``filter``, ``quantity`` (arrival_frames, lateral_px), ``model``, `SUMMARY`,
        ``left_out``.
    omitted : DataFrame
        ``data_set``, ``filter``, ``predicted``, and tracks left out by reason.
    """
    # Arrivals come in thousandths of a frame.
    quantities = {"arrival_frames": (arrival_deviations, 0.001)}
    quantities["lateral_px"] = lateral_deviations, 1.0
    parts, omitted = [], []
    for (data_set, name), tracks in followed.items():
        keys: dict[str, Any] = {"data_set": data_set, "filter": name}
        observed = observe(tracks, measured[data_set], phase, 1.0)
        omitted.append(keys | {"predicted": len(observed.last)} | observed.left_out)
        keys["left_out"] = sum(observed.left_out.values())
        for quantity, (deviations, unit) in quantities.items():
            table = over_draws(evaluation(observed, phase, deviations, seed))
            table[SUMMARY[1:8]] *= unit
            parts.append(table.assign(**keys, quantity=quantity))
    columns = ["data_set", "filter", "quantity", "model", *SUMMARY, "left_out"]
    models = pd.concat(parts) if parts else pd.DataFrame(columns=columns)
    models = models.loc[~models["model"].isin(["CALV", "LV-DSC"]), columns]
    return models.reset_index(drop=True), pd.DataFrame(omitted)


def hold_on_recordings(table: pd.DataFrame) -> pd.DataFrame:
    """Return which sentences of the 2020 paper hold on recordings of a real belt.

    The recordings are the authors'.
    Each model has the filter that fits it: constant velocity for most, constant acceleration
    for CA. No verdict: nobody claimed it of these recordings.

    Parameters
    ----------
    table
        ``data_set``, ``filter`` ("CV filter", "CA filter"), ``quantity`` ("arrival_frames",
        "lateral_px"), ``model``, ``mae`` and ``iqr``.

    Returns
    -------
    DataFrame
        Index: the sentences; a column per data set.
    """
    wide = {
        (*key, measure): part.pivot(index="data_set", columns="model", values=measure)
        for key, part in table.groupby(["filter", "quantity"])
        for measure in ("mae", "iqr")
    }
    mae, spread = (wide["CV filter", "arrival_frames", measure] for measure in ("mae", "iqr"))
    across, ca = (
        wide["CV filter", "lateral_px", "iqr"],
        wide["CA filter", "arrival_frames", "mae"]["CA"],
    )
    ca_across = wide["CA filter", "lateral_px", "iqr"]["CA-CA"]
    holds = {
        "belt20-1 IV has the widest box": spread["IV"] >= spread.max(axis=1),
        "belt20-2 CV is worst": mae["CV"] >= np.maximum(mae.max(axis=1), ca),
        "belt20-3 CA is worse than CVBC": ca > mae["CVBC"],
        "belt20-5 IA is best": mae["IA"] <= np.minimum(mae.min(axis=1), ca),
        "belt20-7 CV is below Straight": across["CV-CV"] < across["Straight"],
        "belt20-8 CA beats CV across": ca_across < across["CV-CV"],
        "belt20-10 Ratio is best across": across["IA-Ratio"]
        <= np.minimum(across.min(axis=1), ca_across),
    }
    return pd.DataFrame(holds).T.replace({True: "yes", False: "no"})[table["data_set"].unique()]
