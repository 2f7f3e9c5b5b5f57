"""Warnings of missing or doubtful results, each with what to change."""

from collections.abc import Iterator

import numpy as np
from pandas import DataFrame

from kilnflight.film.motion import neighbour_px
from kilnflight.film.report import Tables
from kilnflight.film.spreading import followed, speeds
from kilnflight.flight import kept

TRY = (
    "In a film, try --detector otsu for long ones, --dark, --background none for "
    "resting ones, or a lower --threshold; `kilnflight preview` shows what is found."
)
FOLLOW = "Try a longer --max-step or --memory; with depth, --in-air."
FASTER = "Links are doubtful; record faster, or raise --threshold."
JUMPED = (
    "Most tracks begin anew in frame {}: does the picture jump there? Then track what "
    "is before and after by itself (--frames), or register it first."
)
FEW = 10  # detections; with fewer hardly a particle was found
LANCE = "Is the lance's outlet right (mm, as captured), and the depth_calibration?"


def doubts(tables: Tables) -> Iterator[str]:
    """Yield warnings of missing or doubtful results, each with what to change."""
    yield from doubtful_links(tables["tracks"])
    flights = tables["flights"]
    from_lance = flights[flights["from_lance"]]
    if len(flights) and from_lance.empty:
        off = f"{flights['start_mm'].median():.0f} mm off"
        yield f"No flight starts at the lance: {off}. {LANCE}"
    refused = len(from_lance) - len(kept(from_lance))
    if 2 * refused > len(from_lance):
        share = f"{refused} of {len(from_lance)} flights"
        yield f"{share} are refused, no particle flies so. {LANCE}"


def doubtful_links(tracks: DataFrame) -> Iterator[str]:
    """Yield warnings of missing or doubtful tracks, each with what to change.

    Parameters
    ----------
    tracks
        All detections: columns frame, particle (-1: in no track), row, col (px).
    """
    linked = followed(tracks)
    if len(tracks) < FEW:
        yield f"{len(tracks)} particles were detected. {TRY}"
    elif 2 * len(linked) < len(tracks) and np.ptp(tracks["frame"]):
        yield f"Only {len(linked)} of {len(tracks)} detections are linked. {FOLLOW}"
    # Shares that were set on simulated films, moving and diffusing ones.
    ordered = tracks.sort_values("frame")
    begin = ~ordered.duplicated("particle")
    share = begin.groupby(ordered["frame"]).mean()[1:]
    if len(tracks) > FEW * len(share) and share.max() > 0.6 and share.median() < 0.25:
        yield JUMPED.format(share.idxmax())
    steps = speeds(linked)
    if not len(steps):
        return
    step = np.median(steps)
    apart = neighbour_px(tracks)
    if step > apart / 2:
        between = f"{apart:.1f} px between neighbours"
        yield f"Steps of {step:.1f} px exceed half of {between}. {FASTER}"
