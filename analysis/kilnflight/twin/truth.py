"""What is true about a recording of the twin: per particle, and per particle and frame."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.path import Path as Polygon
from tqdm import tqdm

from kilnflight.twin.outcomes import crossing_times
from kilnflight.twin.scene import Twin

SUBSETS = ("V1", "V2", "V3", "V4", "V5")  # section 5.1.1
LABELLED = range(75, 85)  # ten frames of each, with 75 before and after for the backgrounds
FRAMES = 160
CROSSINGS_M = (1.0, 2.0, 3.0, 4.0, 5.0)  # distances from the lance (sec. 5.3.1)
CLASSES = {2: "burning in air", 3: "non-burning in air", 4: "burning on the wall"}  # Table 5.1


def tables(twin: Twin, frames: range | None = None) -> dict[str, pd.DataFrame]:
    """Return both tables of the truth by name; every wanted frame is looked at once."""
    wanted = frames if frames is not None else range(len(twin))
    bar = tqdm(wanted, desc=f"truth of {twin.scene.name}", unit="frame", disable=None)
    parts = [sightings(twin, t) for t in bar]
    return {"particles": particles(twin), "sightings": pd.concat(parts, ignore_index=True)}


def particles(twin: Twin) -> pd.DataFrame:
    """Return the truth about every particle of a scene, one row each.

    Returns
    -------
    DataFrame
        The columns of `kilnflight.twin.life.live`, and ``crossing_1m_s`` ... ``crossing_5m_s``:
        when the particle first was that far from the lance along the kiln, in s from its
        release; NaN if never.
    """
    table = twin.life.table.copy()
    for distance in CROSSINGS_M:
        times = crossing_times(twin.life.flights, distance, twin.scene.geometry.lance_m[0])
        table[f"crossing_{distance:.0f}m_s"] = times
    return table


def marked(twin: Twin, wanted: Iterable[int]) -> pd.DataFrame:
    """Return what a person marks in frames: the `sightings` that are visible and in the ROI.

    The evaluation of detectors counts nothing else (section 5.1.3).
    """
    parts = [sightings(twin, t) for t in wanted]
    seen = pd.concat(parts, ignore_index=True)
    return seen[seen["visible"] & seen["in_roi"]].reset_index(drop=True)


def instances(twin: Twin, t: int) -> npt.NDArray[np.int32]:
    """Return which particle each pixel (rows, columns) of frame ``t`` shows; -1 is none."""
    seen = twin.see(t)
    image = np.full(seen.labels.shape, -1, dtype=np.int32)
    blob = seen.pixels.blob[seen.show]
    image.reshape(-1)[seen.pixels.place[seen.show]] = seen.blobs.particle[blob]
    return image


def sightings(twin: Twin, t: int) -> pd.DataFrame:
    """Return every particle that frame ``t`` could show, one row each.

    Returns
    -------
    DataFrame
        ``frame``, ``time_s``, ``particle``; ``row``, ``col`` in pixels; ``pixels`` that a
        person would mark, and ``radius_px`` of a disc of as many; ``visible`` by the rule of
        `kilnflight.twin.drawing`; ``label`` as Table 5.1 (2, 3, 4); ``in_roi``;
        ``has_depth``: at least one valid point on it (as section 5.1.1 counts "3D available");
        true ``x``, ``y``, ``z`` in mm and ``velocity_x_m_s`` ... in camera coordinates.
    """
    seen = twin.see(t)
    moment, geometry = seen.moment, twin.scene.geometry
    count = np.bincount(seen.pixels.blob[seen.show], minlength=len(moment.particle))
    place = geometry.to_camera(moment.position_m)
    velocity = moment.velocity_m_s @ geometry.axes
    inside = (seen.blobs.row >= -0.5) & (seen.blobs.row <= geometry.rows - 0.5)
    inside &= (seen.blobs.column >= -0.5) & (seen.blobs.column <= geometry.columns - 0.5)
    roi = Polygon(np.array(twin.attributes.roi))
    return pd.DataFrame(
        {
            "frame": t,
            "time_s": twin.time_s(t),
            "particle": moment.particle,
            "row": seen.blobs.row,
            "col": seen.blobs.column,
            "pixels": count,
            "radius_px": np.sqrt(count / np.pi),
            "visible": seen.visible & inside,
            "label": seen.kinds,
            "in_roi": roi.contains_points(np.stack([seen.blobs.row, seen.blobs.column], axis=1)),
            "has_depth": np.isin(seen.blobs.particle, twin.points_of(t, seen)),
            **{axis: place[:, k] for k, axis in enumerate("xyz")},
            **{f"velocity_{axis}_m_s": velocity[:, k] for k, axis in enumerate("xyz")},
        }
    )
