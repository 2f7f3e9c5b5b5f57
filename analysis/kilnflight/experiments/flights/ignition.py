"""Ignition: flights whose grey value rises, and the optical picture (Fig. 5.17)."""

from collections.abc import Mapping

import numpy as np
from pandas import DataFrame, Series

from kilnflight.arrays import Array, Numbers
from kilnflight.background.sliding_median import stack_median
from kilnflight.experiments.flights.comparison import interval_columns
from kilnflight.flight.empty import EMPTY_FRAMES
from kilnflight.ignition import LEAST_POINTS, NONE, SEEN, SHARE
from kilnflight.recording.frames import Recording
from kilnflight.scores import intervals

STRETCH = 151  # frames with one median background: 75 before and 75 after (Table 5.4)


def count_lit(
    flights: DataFrame,
    flying: DataFrame,
    outcomes: Mapping[int, str],
    ignites: Series,
) -> Numbers:
    """Count flights that ignite by the test, and how often it is right.

    "If the gray value increases abruptly, the particles can be assumed ignited"
    (section 5.3.2). A particle already bright at first sight has not ignited.

    Parameters
    ----------
    flights
        Flights from the lance; column ``particle``.
    flying
        Their detections up to the end of each flight, in order of frames: ``particle``,
        ``gray``, and ``background``, the grey value of the kiln behind.
    outcomes
        Outcome of `kilnflight.ignition.Ignition` by particle. A flight without one has
        too few points: all its detections are after its end.
    ignites
        Whether the true particle ignites in flight, by track. Tracks of no particle are
        missing.

    Returns
    -------
    dict
        Numbers of flights. ``light_up``: their grey values rise, by ``outcomes``.
        ``light_at_first``: the first `LEAST_POINTS` detections are brighter than the
        kiln behind by `SHARE`. ``too_few``: not judged. ``number``: all, with
        ``estimate``, ``low`` and ``high`` of the share that lights up (Wilson).

        ``unlit`` and ``lit``: judged flights whose particle truly stays unlit or
        ignites. Of these ``_up`` light up, ``_light`` light up or are light at first,
        and ``_gray`` is the median of their median grey values.
    """
    outcome = Series(outcomes, dtype=object).reindex(flights["particle"])
    first = flying.groupby("particle").head(LEAST_POINTS)
    brighter = first["gray"] > (1.0 + SHARE) * first["background"]
    light = brighter.groupby(first["particle"]).all().reindex(outcome.index)
    gray = flying.groupby("particle")["gray"].median().reindex(outcome.index)
    rises = outcome == SEEN
    few = ~rises & (outcome != NONE)
    at_first = light.eq(True)  # NaN: no detection
    share = intervals.share(int(rises.sum()), len(flights))
    count: Numbers = {
        "light_up": rises.sum(),
        "light_at_first": at_first.sum(),
        "too_few": few.sum(),
        **interval_columns(share),
    }
    truly = ignites.reindex(outcome.index)
    for name, burns in (("unlit", False), ("lit", True)):
        judged = ~few & truly.eq(burns)
        count[name] = judged.sum()
        count[f"{name}_up"] = (judged & rises).sum()
        count[f"{name}_light"] = (judged & (rises | at_first)).sum()
        count[f"{name}_gray"] = gray[judged].median()
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
    most = np.zeros(recording.attributes.size, np.float32)
    for part in np.array_split(np.asarray(frames), -(-len(frames) // STRETCH)):
        steps = np.linspace(part[0], part[-1], EMPTY_FRAMES).round().astype(int)
        known = {t: recording.gray(t) for t in np.unique(steps).tolist()}
        background = stack_median(list(known.values())).astype(np.float32)
        for t in part.tolist():
            gray = known[t] if t in known else recording.gray(t)
            change = gray - background
            np.copyto(most, change, where=np.abs(change) > np.abs(most))
    return (background + most).astype(float)
