"""Warnings of missing or doubtful results, each with what to change; no truth is
needed.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from scipy.spatial import KDTree

from kilnflight.film.report import Tables
from kilnflight.film.spreading import followed, speeds
from kilnflight.flight import kept

TRY = (
    "Try --detector otsu for long ones, --dark, --background none for resting ones, or "
    "a lower --threshold; `kilnflight preview` shows what is found."
)
FOLLOW = "Try a longer --max-step or --memory; with depth, --in-air."
FASTER = "Links are doubtful; record faster, or raise --threshold."
FEW = 10  # detections; hardly a particle was found
LANCE = "Is the lance's outlet right (mm, as captured), and the depth_calibration?"


def doubts(tables: Tables) -> Iterator[str]:
    """Yield warnings of missing or doubtful results, each with what to change."""
    yield from doubtful_links(tables["tracks"])
    flights = tables["flights"]
    from_lance = flights[flights["from_lance"]]
    if len(flights) and from_lance.empty:
        yield (
            f"No flight starts at the lance: {flights['start_mm'].median():.0f} mm "
            f"off. {LANCE}"
        )
    refused = len(from_lance) - len(kept(from_lance))
    if 2 * refused > len(from_lance):
        yield (
            f"{refused} of {len(from_lance)} flights are refused, no particle flies "
            f"so. {LANCE}"
        )


def doubtful_links(tracks: pd.DataFrame) -> Iterator[str]:
    """Yield warnings of missing or doubtful tracks, each with what to change.

    ``tracks`` has all detections: columns frame, particle (-1: in no track), row, col
    (px).
    """
    linked = followed(tracks)
    if len(tracks) < FEW:
        yield f"{len(tracks)} particles were detected. {TRY}"
    elif 2 * len(linked) < len(tracks) and np.ptp(tracks["frame"]):
        yield f"Only {len(linked)} of {len(tracks)} detections are linked. {FOLLOW}"
    steps = speeds(linked)
    apart = neighbour_px(tracks)
    if len(steps) and (step := float(np.median(steps))) > apart / 2:
        yield (
            f"Steps of {step:.1f} px exceed half of {apart:.1f} px between "
            f"neighbours. {FASTER}"
        )


def neighbour_px(detections: pd.DataFrame, frames: int = 30) -> float:
    """Return the median distance of nearest neighbours in some frames; inf without
    neighbours.
    """
    places = [
        at[["row", "col"]].to_numpy(float) for _, at in detections.groupby("frame")
    ]
    some = [each for each in places[:: 1 + len(places) // frames] if len(each) > 1]
    apart = [np.asarray(KDTree(each).query(each, 2)[0])[:, 1] for each in some]
    return float(np.median(np.concatenate(apart))) if apart else np.inf
