"""Ignition: flights whose grey value rises, and the optical picture (Fig. 5.17)."""

import numpy as np
import pandas as pd

from kilnflight.arrays import Array
from kilnflight.background.sliding_median import stack_median
from kilnflight.experiments.flights.comparison import interval_columns
from kilnflight.flight.empty import EMPTY_FRAMES
from kilnflight.ignition import LEAST_POINTS, NONE, SEEN, SHARE, Ignition
from kilnflight.recording.frames import Recording
from kilnflight.scores import intervals

STRETCH = 151  # frames with one median background: 75 before and 75 after (Table 5.4)


def count_lit(
    flights: pd.DataFrame, tracks: pd.DataFrame, ignites: pd.Series, test: Ignition
) -> dict[str, float]:
    """Return how many flights of a campaign light up.

    "If the gray value increases abruptly, the particles can be assumed ignited"
    (section 5.3.2): a particle that is light at first sight is not. The test is the
    same for all fractions. Only detections before the end of a flight count: the wall
    ignites all that land (5.1.1).

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

    Returns
    -------
    dict
        Numbers of flights: ``light_up`` (by ``test``), ``light_at_first`` (its first
        `LEAST_POINTS` detections are lighter than the kiln behind by `SHARE`),
        ``too_few`` (points to judge); ``number``, ``estimate``, ``low``, ``high`` of
        the share that lights up (Wilson). For ``unlit`` and ``lit``, judged flights
        whose particle truly stays unlit or ignites: their number; ``_up`` that light
        up; ``_light`` that light up or are light at first; ``_gray``, median grey value
        along their flights.
    """
    ended = tracks.merge(flights[["particle", "end_s"]])
    flying = ended[ended["time_s"] <= ended["end_s"]].sort_values("frame")
    traces = _traces(flying, test).reindex(flights["particle"])
    rises = traces["outcome"] == SEEN
    few = ~rises & (traces["outcome"] != NONE)
    at_first = traces["at_first"].eq(True)  # no detection: missing
    share = intervals.share(int(rises.sum()), len(flights))
    count: dict[str, float] = {
        "light_up": rises.sum(),
        "light_at_first": at_first.sum(),
        "too_few": few.sum(),
        **interval_columns(share),
    }
    truly = ignites.reindex(traces.index)
    for name, burns in (("unlit", False), ("lit", True)):
        kind = ~few & truly.eq(burns)
        count[name] = kind.sum()
        count[f"{name}_up"] = (kind & rises).sum()
        count[f"{name}_light"] = (kind & (rises | at_first)).sum()
        count[f"{name}_gray"] = traces.loc[kind, "gray"].median()
    return count


def _traces(flying: pd.DataFrame, test: Ignition) -> pd.DataFrame:
    """Return ``outcome`` of the test, ``at_first`` and median ``gray``, by particle."""
    by_particle = flying.groupby("particle")
    outcome = {
        particle: test(one["time_s"], one["gray"], one["background"]).outcome
        for particle, one in by_particle
    }
    first = by_particle.head(LEAST_POINTS)
    lighter = first["gray"] > (1.0 + SHARE) * first["background"]
    return pd.DataFrame(
        {
            "outcome": pd.Series(outcome, dtype=object),
            "at_first": lighter.groupby(first["particle"]).all(),
            "gray": by_particle["gray"].median(),
        }
    )


def optical_picture(recording: Recording, frames: range) -> Array:
    """Return background plus greatest difference (rows, cols) in grey values.

    Fig. 5.17 shows this picture. The difference of each pixel is signed; of all
    ``frames`` the one of greatest absolute value counts. The thesis sums the
    differences. Here the flicker of the kiln would sum up to more than one passing
    particle. The background is the median of `kilnflight.flight.empty.EMPTY_FRAMES`
    frames in each stretch of about `STRETCH` frames; it is "constant over a specific
    time period" (5.1.2). The picture shows that of the last stretch.
    """
    most = np.zeros(recording.attributes.size, np.float32)
    for part in np.array_split(np.asarray(frames), -(-len(frames) // STRETCH)):
        steps = np.linspace(part[0], part[-1], EMPTY_FRAMES).round().astype(int)
        known = {t: recording.gray(t) for t in np.unique(steps).tolist()}
        background = stack_median(list(known.values())).astype(np.float32)
        for t in part.tolist():
            gray = known[t] if t in known else recording.gray(t)
            change = gray - background
            np.copyto(most, change, where=np.abs(change) > np.abs(most))
    return (background + most).astype(np.float64)
