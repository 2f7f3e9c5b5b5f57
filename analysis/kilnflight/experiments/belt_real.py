"""The models of the 2020 paper on the authors' recordings of a real belt."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
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
from kilnflight.belt.velocity import BeltVelocity
from kilnflight.checks import InputError
from kilnflight.experiments import belt_claims
from kilnflight.experiments.belt_2020 import Key, over_draws
from kilnflight.experiments.belt_claims import REPLICATES, Order
from kilnflight.project import claims
from kilnflight.tracking.motion import Motion

#: Key of a recording: its material and its name.
Recorded = tuple[str, str]

# What the camera sees of the belt, px: read off the recordings; choice.
VISIBLE = Area(0, 1700, 2250)
BIASED = "belt20-2 CV is worst"  # "due to the large biases" (5.2): a spread sees none
FILTER = "CV filter"  # of models without acceleration


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


def judge_straight(
    models: pd.DataFrame,
    followed: Mapping[Key, Followed],
    measured: Mapping[str, pd.DataFrame],
    phase: PredictionPhase,
    scale: str,
    seed: int,
) -> claims.Verdict:
    """Return the verdict on belt20-22: constant velocity against straight on a real belt.

    ``models`` is from `compare_on_recordings`, the others are as there. Tracks are resampled.
    """
    observed = {
        name: observe(tracks, measured[name], phase, 1.0)
        for (name, kind), tracks in followed.items()
        if kind == FILTER
    }
    across = models[(models["filter"] == FILTER) & (models["quantity"] == "lateral_px")]
    samples = belt_claims.resample(observed, phase, lateral_deviations, REPLICATES[scale], seed)
    values = belt_claims.compared({"": across}, {"": samples})
    answer = {}
    for name in observed:
        less = values.less(Order("belt20-22", name, ("CV-CV",), ("Straight",)))
        text = values.sizes(name, "CV-CV", "Straight")
        answer[f"{name}: {text} px"] = belt_claims.agree(less)
    note = "MAE and IQR must agree beyond chance (tracks resampled); places as measured, with the "
    note += "filter of constant velocity; the authors' recordings of a belt sorter, where the "
    note += "sentence speaks of other ones, of an industrial sorter (its reference 8)"
    return claims.with_cause(belt_claims.judge("belt20-22", answer, note, because="method"))


def hold_on_recordings(table: pd.DataFrame) -> pd.DataFrame:
    """Return which sentences of the 2020 paper hold on recordings of a real belt.

    The recordings are the authors'. Each model has the filter that fits it: constant velocity for
    most, constant acceleration for CA. No verdict: the paper is on other data; the last
    sentence is `judge_straight`'s.

    Parameters
    ----------
    table
        ``data_set``, ``filter`` ("CV filter", "CA filter"), ``quantity`` ("arrival_frames",
        "lateral_px"), ``model``, ``mae`` and ``iqr``.

    Returns
    -------
    DataFrame
        Index: the sentences; a column per data set: yes or no, open where mean absolute error and
        interquartile range differ. The bias of CV is seen by the mean absolute error alone.
    """
    by_error, by_spread = (_sentences(table, measure) for measure in ("mae", "iqr"))
    by_spread.loc[BIASED] = by_error.loc[BIASED]
    words = by_error.replace({True: "yes", False: "no"}).where(by_error == by_spread, "open")
    return words[table["data_set"].unique()]


def _sentences(table: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Return whether each sentence holds by one measure."""
    wide = {
        key: part.pivot(index="data_set", columns="model", values=measure)
        for key, part in table.groupby(["filter", "quantity"])
    }
    along, across = (wide[FILTER, name] for name in ("arrival_frames", "lateral_px"))
    ca = wide["CA filter", "arrival_frames"]["CA"]
    ca_across = wide["CA filter", "lateral_px"]["CA-CA"]
    holds = {
        "belt20-1 IV is worst of the plotted": along["IV"]
        >= np.maximum(along.drop(columns="CV").max(axis=1), ca),
        BIASED: along["CV"] >= np.maximum(along.max(axis=1), ca),
        "belt20-3 CA is worse than CVBC": ca > along["CVBC"],
        "belt20-5 IA is best": along["IA"] <= np.minimum(along.min(axis=1), ca),
        "belt20-8 CA beats CV across": ca_across < across["CV-CV"],
        "belt20-10 Ratio is best across": across["IA-Ratio"]
        <= np.minimum(across.min(axis=1), ca_across),
        "belt20-22 CV is better than Straight": across["CV-CV"] < across["Straight"],
    }
    return pd.DataFrame(holds).T


def join_recordings(recordings: Iterable[pd.DataFrame], pause: int = 100) -> pd.DataFrame:
    """Join recordings into one table with different track numbers.

    The recordings are ``pause`` frames apart.

    A recording without a measurement has no last frame: it adds the pause and nothing else.

    Raises
    ------
    InputError
        If there is no recording.
    """
    parts, frame, track = [], 0, 0
    for table in recordings:
        parts.append(_moved_on(table, frame=frame, author_track=track))
        frame += pause + _greatest(table["frame"], 0)
        track += 1 + _greatest(table["author_track"], -1)
    if not parts:
        raise InputError("no recording to join; give at least one.")
    return pd.concat(parts, ignore_index=True)


def join_followed(parts: Iterable[tuple[pd.DataFrame, Followed]], pause: int = 100) -> Followed:
    """Join tracks of recordings as `join_recordings` joins these.

    ``parts`` has the measurements of each recording and their tracks, ``pause`` is as there.

    Raises
    ------
    InputError
        If there is no recording.
    """
    states, ends, frame, row, track = [], [], 0, 0, 0
    for measured, followed in parts:
        states.append(_moved_on(followed.states, frame=frame, particle=track, row=row))
        ends.append(_moved_on(followed.ends, frame=frame, particle=track))
        frame += pause + _greatest(measured["frame"], 0)
        row += len(measured)
        track += 1 + _greatest(followed.ends["particle"], -1)
    if not states:
        raise InputError("no recording to join; give at least one.")
    return Followed(pd.concat(states, ignore_index=True), pd.concat(ends, ignore_index=True))


def _moved_on(table: pd.DataFrame, **offsets: int) -> pd.DataFrame:
    """Return a table with numbers in columns moved on; -1 (none) stays."""
    moved = {name: table[name] + by * (table[name] >= 0) for name, by in offsets.items()}
    return table.assign(**moved)


def _greatest(numbers: pd.Series, if_none: int) -> int:
    return int(numbers.max()) if len(numbers) else if_none


def links(table: pd.DataFrame, column: str) -> pd.MultiIndex:
    """Return which rows follow each other in a track, as pairs of row numbers.

    Rows whose track is -1 are in none.
    """
    track, frame = table[column].to_numpy(), table["frame"].to_numpy()
    order = np.lexsort((frame, track))
    same = (np.diff(track[order]) == 0) & (track[order][:-1] >= 0)
    return pd.MultiIndex.from_arrays([order[:-1][same], order[1:][same]])


def compare_links(measured: pd.DataFrame, followed: Followed) -> dict[str, float]:
    """Compare the links of a tracker with those of the authors.

    Parameters
    ----------
    measured
        Of `join_recordings`, a row per measurement.
    followed
        Tracks of these measurements.

    Returns
    -------
    dict
        ``measurements``, ``links_authors``, ``links_tracker``; ``recall_percent``: share of the
        authors' links that the tracker has; ``agreed_percent``: share of its links that the authors
        have; ``tracks REASON``: how many tracks ended for each reason.
    """
    states = followed.states[followed.states["row"] >= 0]
    track = pd.Series(states["particle"].to_numpy(), states["row"])
    track = track.reindex(range(len(measured)), fill_value=-1)
    tracker = links(measured.assign(track=track.to_numpy()), "track")
    authors = links(measured, "author_track")
    shared = 100 * len(tracker.intersection(authors))
    ends = followed.ends["reason"].value_counts()
    return {
        "measurements": len(measured),
        "links_authors": len(authors),
        "links_tracker": len(tracker),
        "recall_percent": shared / len(authors),
        "agreed_percent": shared / len(tracker),
        **{f"tracks {reason}": int(count) for reason, count in ends.items()},
    }
