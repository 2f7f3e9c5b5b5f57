"""The truth of a recording of the twin, and the true values of its flights.

Values of flights need no picture: every particle counts, also one that no camera could
have seen. Their distances are along the kiln from the lance.
"""

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
import pandas as pd
from pandas import DataFrame
from tqdm import tqdm

from kilnflight.arrays import Array, Integers, Pair, Single, Tables
from kilnflight.checks import InputError
from kilnflight.detection.region import inside
from kilnflight.scores.flights import MARKS_M, FlightValues
from kilnflight.simulated.kiln.geometry import FULL_SCALE
from kilnflight.simulated.kiln.laws import BURNT_OUT, LANDED, Flights
from kilnflight.simulated.kiln.picture import VISIBLE_PX
from kilnflight.simulated.kiln.scene import SceneView, Twin
from kilnflight.store.cache import CachedTable

# A person who notes positions on an 8-bit screen recognises an object at a contrast of
# 5 % (WMO, meteorological optical range); assumption. The wall has 78 of 255 steps, so
# that is 4.
NOTED_STEPS = 4
# Table 5.1
CLASSES = {2: "burning in air", 3: "non-burning in air", 4: "burning on the wall"}


def tables(twin: Twin, frames: range) -> Tables:
    """Return the tables `particles` and `sightings` of some frames.

    Raises
    ------
    InputError
        If the recording has not all of these frames.
    """
    if not frames or frames[0] < 0 or frames[-1] >= len(twin):
        raise InputError(
            f"scene {twin.scene.name}: it has frames 0 to {len(twin) - 1}."
        )
    bar = tqdm(frames, desc=f"truth of {twin.scene.name}", unit="frame", disable=None)
    parts = [sightings(twin, t) for t in bar]
    return {
        "particles": particles(twin),
        "sightings": pd.concat(parts, ignore_index=True),
    }


def particles(twin: Twin) -> DataFrame:
    """Return the truth about every particle of a scene, one row each.

    Returns
    -------
    DataFrame
        The columns of `kilnflight.simulated.kiln.life.Life`, and ``crossing_1m_s`` ...
        ``crossing_5m_s``: when the particle first was that far from the lance along the
        kiln, in s from its release; NaN if never.
    """
    columns = [f"crossing_{m}m_s" for m in MARKS_M]
    crossed = DataFrame(twin.life.flights.crossings(), columns=columns)
    return twin.life.table.join(crossed)


def marked(twin: Twin, frames: Iterable[int]) -> DataFrame:
    """Return what a person marks in frames.

    That is the `sightings` that are visible and in the region of interest, without
    ``has_depth``. The evaluation of detectors counts nothing else (section 5.1.3).
    """
    return _join_marks(_see(twin, t, twin.view(t)) for t in frames)


def noted(twin: Twin, frames: Iterable[int]) -> DataFrame:
    """Return what is `marked` in frames, with the places noted for tracking.

    Section 5.2.1: positions are noted by hand, NaN where a particle is invisible. Fig.
    5.11 has means of 14 to 31 pixels.

    Returns
    -------
    DataFrame
        The rows of `marked` with ``noted_row`` and ``noted_col``: the centroid, in px,
        of the pixels in which the particle is lighter than the kiln behind it by
        `NOTED_STEPS` of 255. NaN with fewer than `VISIBLE_PX` of them.
    """
    parts = []
    for t in frames:
        view = twin.view(t)
        row, col = _light_centroids(view, twin.empty(t))
        parts.append(_see(twin, t, view).assign(noted_row=row, noted_col=col))
    return _join_marks(parts)


def _join_marks(parts: Iterable[DataFrame]) -> DataFrame:
    table = pd.concat(parts, ignore_index=True)
    return table[table["visible"] & table["in_roi"]].reset_index(drop=True)


def _light_centroids(view: SceneView, empty: Single) -> Pair:
    """Return row and column (m,) in px of the light pixels of each particle in a view.

    ``empty`` (rows, columns) is the picture without particles. See `noted`.
    """
    place = view.pixels.place
    seen = np.minimum(view.picture.take(place), FULL_SCALE)
    lighter = seen - np.minimum(empty.take(place), FULL_SCALE)
    light = np.flatnonzero(view.shown & (lighter >= NOTED_STEPS * FULL_SCALE / 255))
    blob = view.pixels.blob[light]
    count = np.bincount(blob, minlength=len(view.visible)).astype(float)
    count[count < VISIBLE_PX] = np.nan
    row, col = np.divmod(place[light], empty.shape[1])
    rows = np.bincount(blob, row, len(count))
    return rows / count, np.bincount(blob, col, len(count)) / count


def at_notes(table: DataFrame) -> DataFrame:
    """Return the rows of `noted` that have a noted place, at that place."""
    seen = table.dropna(subset="noted_row")
    return seen.assign(row=seen["noted_row"], col=seen["noted_col"])


def followed(table: DataFrame) -> DataFrame:
    """Return the rows of `marked` particles in the air with five positions or more.

    "For some time" (section 5.2.1) is all that was printed.
    """
    flying = table[table["label"] != 4]
    long = flying.groupby("particle")["frame"].transform("size") >= 5
    return flying[long].reset_index(drop=True)


def kept_marks(
    twin: Twin, frames: range, make: Callable[[Twin, range], DataFrame] = marked
) -> CachedTable:
    """Return the table that keeps what is `marked`, or `noted`, in some frames."""
    depends_on = {"scene": twin.scene, "frames": [frames.start, frames.stop]}
    return CachedTable(make.__name__, partial(make, twin, frames), depends_on)


def instances(twin: Twin, t: int) -> Integers:
    """Return the particle that each pixel (rows, columns) of frame ``t`` shows.

    -1 means no particle.
    """
    view = twin.view(t)
    image = np.full(view.labels.shape, -1, np.int32)
    blob = view.pixels.blob[view.shown]
    image.reshape(-1)[view.pixels.place[view.shown]] = view.moment.particle[blob]
    return image


def sightings(twin: Twin, t: int) -> DataFrame:
    """Return every particle that frame ``t`` could show, one row each.

    Returns
    -------
    DataFrame
        ``frame``, ``time_s``, ``particle``; ``row``, ``col`` in pixels; ``pixels`` that
        a person would mark, and ``radius_px`` of a disc of as many; ``visible`` by the
        rule of `kilnflight.simulated.kiln.picture`; ``label`` as Table 5.1 (2, 3, 4);
        ``in_roi``; true ``x``, ``y``, ``z`` in mm and ``velocity_x_m_s`` ..., without
        flutter, in camera coordinates; ``has_depth``: at least one valid point on it
        (as section 5.1.1 counts "3D available").
    """
    view = twin.view(t)
    deep = np.isin(view.moment.particle, twin.particles_with_depth(t, view))
    return _see(twin, t, view).assign(has_depth=deep)


def _see(twin: Twin, t: int, view: SceneView) -> DataFrame:
    """Return the `sightings` of a view of frame ``t`` without ``has_depth``."""
    moment = view.moment
    geometry = twin.scene.geometry
    row = view.blobs.row
    col = view.blobs.column
    count = np.bincount(view.pixels.blob[view.shown], minlength=len(moment.particle))
    place = geometry.to_camera(moment.position_m)
    velocity = moment.velocity_m_s @ geometry.axes
    in_picture = (row >= -0.5) & (row <= geometry.rows - 0.5)
    in_picture &= (col >= -0.5) & (col <= geometry.columns - 0.5)
    return DataFrame(
        {
            "frame": t,
            "time_s": twin.time_s(t),
            "particle": moment.particle,
            "row": row,
            "col": col,
            "pixels": count,
            "radius_px": np.sqrt(count / np.pi),
            "visible": view.visible & in_picture,
            "label": view.kinds,
            "in_roi": inside(twin.attributes.roi or (), row, col),
            **dict(zip("xyz", place.T, strict=True)),
            **{f"velocity_{axis}_m_s": velocity[:, k] for k, axis in enumerate("xyz")},
        }
    )


def metre_velocities(flights: Flights) -> Array:
    """Return each particle's mean velocity within each metre in m/s, (n, 5) (Eq. 5.8).

    NaN where a particle did not pass the whole metre.
    """
    return 1.0 / np.diff(flights.crossings(), axis=1, prepend=0.0)


def true_flight_values(flights: Flights) -> FlightValues:
    """Return the true values of the flights, particle by particle.

    A dwell time ends by landing or burning out (sec. 5.3.1). What leaves the kiln or
    still flies has none: it is lost at the end of its flight.
    """
    complete = np.isin(flights.end, (LANDED, BURNT_OUT))
    return FlightValues(
        dwell_s=flights.end_s[complete],
        velocity_m_s=metre_velocities(flights),
        ignition_s=flights.ignition_s,
        reached_m=flights.along(flights.end_s),
        lost=~complete,
    )
