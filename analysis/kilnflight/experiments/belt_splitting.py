"""What it gains to split spots of particles that touch, which neither belt paper mentions."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from kilnflight.belt.tracker import BELT_FRAME_S
from kilnflight.belt.valves import ValveBar
from kilnflight.experiments import belt_2016
from kilnflight.experiments.belt_camera import PictureTracks, place_errors
from kilnflight.experiments.belt_claims import TRACKING
from kilnflight.sorter.rendering import at_rate

_BAR = ValveBar()


def compare_splitting(
    pictured: Mapping[tuple[str, str], PictureTracks],
    bodies: Mapping[str, pd.DataFrame],
    bar: ValveBar = _BAR,
) -> pd.DataFrame:
    """Count predictions from images by material and by how spots were found.

    Parameters
    ----------
    pictured
        By material and the name of the spots.
    bodies
        The true tracks by material.
    bar
        What a prediction is good for.

    Returns
    -------
    DataFrame
        ``material``, ``spots``; ``fed``, ``predicted``, ``predicted_twice``, ``not_predicted`` of
        `kilnflight.experiments.belt_2016.predicted_counts`. ``wrong``: predictions that are off by
        more than half a valve's pitch, or half its time. Times count from the median deviation,
        which CVBC would correct. ``wrong_exact``: the same from exact positions, so by the motion
        and not by the spots. ``rms_along_mm``, ``rms_across_mm``: of the places of spots that
        are marked as several, against the nearest true centre.
    """
    rows = []
    exact = {
        name: _count_wrong(belt_2016.noise_free(tracks), bar) for name, tracks in bodies.items()
    }
    for (material, name), measured in pictured.items():
        tracks, spots = bodies[material], measured.spots
        images = belt_2016.from_images(measured, tracks)
        shared = spots.assign(touching=1 - spots["touching"])
        errors = place_errors(shared, at_rate(tracks, 1 / BELT_FRAME_S))
        row = {"material": material, "spots": name, **belt_2016.predicted_counts(tracks, images)}
        rms = {key: errors[key] for key in ("rms_along_mm", "rms_across_mm")}
        wrong = {"wrong": _count_wrong(images, bar), "wrong_exact": exact[material]}
        rows.append({**row, **wrong, **rms})
    return pd.DataFrame(rows)


def _count_wrong(table: pd.DataFrame, bar: ValveBar) -> int:
    """Return how many predictions by tracking are off by half of a valve or of its time."""
    part = table[table["approach"] == TRACKING]
    late = (part["temporal_ms"] - part["temporal_ms"].median()).abs() > 500 * bar.open_s
    return int((late | (part["lateral_mm"].abs() > bar.pitch_mm / 2)).sum())
