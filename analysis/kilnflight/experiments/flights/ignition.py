"""Ignition: whose grey value rises, the optical picture (Fig. 5.17), and errors of the
test.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from kilnflight.background.sliding_median import stack_median
from kilnflight.experiments.flights.campaigns import (
    CampaignKey,
    Results,
    of_campaign,
    rows_by_campaign,
)
from kilnflight.experiments.flights.comparison import Array, interval_columns
from kilnflight.flight import kept
from kilnflight.flight.empty import EMPTY_FRAMES, background_gray
from kilnflight.ignition import LEAST_POINTS, SEEN, SHARE, TOO_FEW, Ignition
from kilnflight.recording.frames import Recording
from kilnflight.scores import intervals

STRETCH = 151  # frames with one median background: 75 before and 75 after (Table 5.4)


def trace_shares(results: Results, both: pd.DataFrame, test: Ignition) -> pd.DataFrame:
    """Return how many flights light up, one row per campaign.

    "If the gray value increases abruptly, the particles can be assumed ignited"
    (section 5.3.2): a particle that is light at first sight is not. The test is the
    same for all fractions. Only detections before the end of a flight count: the wall
    ignites all that land (5.1.1).

    Parameters
    ----------
    results
        The campaigns and their tables.
    both
        Measured beside true, from
        `kilnflight.experiments.flights.accuracy.compare_campaigns`.
    test
        Of a rise of the grey values.

    Returns
    -------
    DataFrame
        ``fraction``, ``pressure_bar``; numbers of flights: ``light_up`` (by ``test``),
        ``light_at_first`` (its first `LEAST_POINTS` detections are lighter than the
        kiln behind by `SHARE`), ``too_few`` (points to judge); ``number``,
        ``estimate``, ``low``, ``high`` of the share that lights up (Wilson). For
        ``unlit`` and ``lit``, judged flights whose particle truly stays unlit or
        ignites: their number; ``_up`` that light up; ``_light`` that light up or are
        light at first; ``_gray``, median grey value along their flights.
    """
    rows: dict[CampaignKey, dict[str, float]] = {}
    for campaign in results.campaigns:
        tracks, _, flights, _ = (
            of_campaign(each, campaign.key) for each in results.tables
        )
        flights = kept(flights[flights["from_lance"]])
        tracks = tracks[tracks["particle"].isin(flights["particle"])]
        behind = background_gray(tracks, campaign.run.detection.source, campaign.frames)
        time_s = tracks["frame"] / campaign.run.frame_rate_hz
        tracks = tracks.assign(background=behind, time_s=time_s)
        known = of_campaign(both, campaign.key).query("track >= 0 and particle >= 0")
        ignites = known.set_index("track")["true_ignition_s"].notna()
        rows[campaign.key] = count_lit(flights, tracks, ignites, test)
    return rows_by_campaign(rows)


def count_lit(
    flights: pd.DataFrame, tracks: pd.DataFrame, ignites: pd.Series, test: Ignition
) -> dict[str, float]:
    """Return the numbers of `trace_shares` for one campaign.

    Parameters
    ----------
    flights
        Accepted flights from the lance.
    tracks
        Their detections: ``particle``, ``frame``, ``time_s``, ``gray``, and
        ``background``, the grey value of the kiln behind.
    ignites
        Whether the true particle ignites in flight, by track; tracks without one are
        missing.
    test
        Of a rise of the grey values.
    """
    end_s = tracks["particle"].map(flights.set_index("particle")["end_s"])
    flying = tracks[tracks["time_s"] <= end_s].sort_values("frame")
    by_particle = flying.groupby("particle")
    found = {
        name: test(one["time_s"], one["gray"], one["background"]).outcome
        for name, one in by_particle
    }
    outcome = pd.Series(found, dtype=object).reindex(
        flights["particle"], fill_value=TOO_FEW
    )
    first = by_particle.head(LEAST_POINTS)
    lighter = first["gray"] > (1.0 + SHARE) * first["background"]
    at_first = lighter.groupby(first["particle"]).all()
    at_first = at_first.reindex(outcome.index, fill_value=False)
    rises = outcome == SEEN
    few = outcome == TOO_FEW
    count: dict[str, float] = {
        "light_up": rises.sum(),
        "light_at_first": at_first.sum(),
        "too_few": few.sum(),
    }
    count |= interval_columns(intervals.share(int(rises.sum()), len(flights)))
    gray = by_particle["gray"].median().reindex(outcome.index)
    judged = ~few & outcome.index.isin(ignites.index)
    truly = ignites.reindex(outcome.index, fill_value=False).astype(bool)
    for name, kind in (("unlit", judged & ~truly), ("lit", judged & truly)):
        count[name] = kind.sum()
        count[f"{name}_up"] = (kind & rises).sum()
        count[f"{name}_light"] = (kind & (rises | at_first)).sum()
        count[f"{name}_gray"] = gray[kind].median()
    return count


def optical_picture(recording: Recording, frames: range) -> Array:
    """Return background plus greatest difference (rows, cols) in grey values.

    Fig. 5.17 shows this picture. The difference of each pixel is signed; of all
    ``frames`` the one of greatest absolute value counts. The thesis sums the
    differences. Here the flicker of the kiln would sum up to more than one passing
    particle. The background is the median of `kilnflight.flight.empty.EMPTY_FRAMES`
    frames in each stretch of about `STRETCH` frames; it is "constant over a specific
    time period" (5.1.2). The picture shows that of the last stretch.
    """
    most = np.zeros(
        (recording.attributes.rows, recording.attributes.columns), np.float32
    )
    for part in np.array_split(np.asarray(frames), -(-len(frames) // STRETCH)):
        steps = np.linspace(part[0], part[-1], EMPTY_FRAMES).round().astype(int)
        pictures = {t: recording.gray(t) for t in np.unique(steps).tolist()}
        background = stack_median(list(pictures.values())).astype(np.float32)
        for t in part.tolist():
            change = (
                pictures.pop(t) if t in pictures else recording.gray(t)
            ) - background
            np.copyto(most, change, where=np.abs(change) > np.abs(most))
    return (background + most).astype(np.float64)
