"""Post-processing step by step, two ways of matching, and textures of streaks (notebook 31)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
import pandas as pd

from kilnflight import tracklets
from kilnflight.arrays import Array
from kilnflight.checks import InputError
from kilnflight.experiments.tracking import Window, cells
from kilnflight.experiments.tracking_scores import GATE_PX, MEAN, MEASURES, difference, measures_of
from kilnflight.scores import score_tracks
from kilnflight.tracking.tracker import track
from kilnflight.tracklets.joining import Joining, hungarian
from kilnflight.tracklets.texture import LAWS_EDGE, LAWS_LEVEL, texture_energy

BOX = (60, 30)  # px, rows and columns of a box for the textures; 30 = 2 w, w of Table 5.16
SPAN = 11  # frames that such a box sums
HUNGARIAN = "Hungarian - dual nearest"
MASKS = {"L": LAWS_LEVEL, "E": LAWS_EDGE, "S": np.array([-1.0, 0.0, 2.0, 0.0, -1.0])}  # Eq. 4.25
MASKS |= {"W": np.array([-1.0, 2.0, 0.0, -2.0, 1.0]), "R": np.array([1.0, -4.0, 6.0, -4.0, 1.0])}


def compare_steps(
    windows: Iterable[Window],
) -> tuple[pd.DataFrame, dict[str, dict[str, pd.DataFrame]]]:
    """Return measures and tracks after GNN and each step (Figs 4.16 to 4.21).

    All tracks are scored, not only those from the lance.

    Returns
    -------
    measures : DataFrame
        ``fraction``, ``step`` ("tracker" or the step's class), number of ``tracks`` and
        ``positions``, and `MEASURES` with a scoring distance of 10 px.
    tracks : dict
        Tracks by fraction, then by step.
    """
    rows, tracks_by_step = [], {}
    for window in windows:
        table = track(window.detections)
        stages = {"tracker": table}
        for step in tracklets.STEPS:
            table = step(table, window.differences)
            stages[type(step).__name__] = table
        tracks_by_step[window.fraction] = stages
        for name, table in stages.items():
            kept = tracklets.tracked(table)
            row: dict[str, object] = {"fraction": window.fraction, "step": name}
            row |= {"tracks": kept["particle"].nunique(), "positions": len(kept)}
            rows.append(row | measures_of(score_tracks(window.truth, table, GATE_PX)))
    columns = ["fraction", "step", "tracks", "positions", *MEASURES]
    return pd.DataFrame(rows)[columns], tracks_by_step


def compare_matchings(windows: Sequence[Window]) -> pd.DataFrame:
    """Return by how much the Hungarian method changes alpha (Fig. 4.14).

    It replaces dual nearest neighbours in the two joining steps. Scored are GNN's tracks from the
    lance after all steps.

    Returns
    -------
    DataFrame
        A row per fraction and one of their mean: ``fraction``, ``step`` (`HUNGARIAN`), ``alpha``
        (Hungarian minus dual nearest), ``alpha_low`` and ``alpha_high`` (95 % interval).
    """
    steps = tracklets.STEPS
    joining = [replace(step, matching=hungarian) for step in steps if isinstance(step, Joining)]
    # the last two of the four steps join tracklets
    ways: dict[str, Any] = {"dual nearest": steps, "Hungarian": (*steps[:2], *joining)}
    tracked = {
        (window.fraction, name): {
            "with": tracklets.postprocess(track(window.detections), window.differences, each)
        }
        for window in windows
        for name, each in ways.items()
    }
    found, fractions = cells(windows, tracked), [window.fraction for window in windows]
    rows = [difference(found, (name, HUNGARIAN, "with"), "alpha") for name in (*fractions, MEAN)]
    names = {"tracker": "step", "recomputed": "alpha", "low": "alpha_low", "high": "alpha_high"}
    return pd.DataFrame(rows).rename(columns=names)[["fraction", *names.values()]]


def texture_boxes(
    window: Window, count: int, generator: np.random.Generator
) -> tuple[list[Array], list[Array]]:
    """Return sums of frame differences with a track and without one (Fig. 4.13).

    Parameters
    ----------
    window
        Frames with true positions and stored differences.
    count
        Number of boxes of each kind.
    generator
        Draws the boxes.

    Returns
    -------
    with_track, without_track : list
        Sums over `SPAN` frames, (60, 30) grey values each. The first lie around true positions,
        the second in the same frames, over 180 px from every true position.
    """
    with_track, without_track = [], []
    for _ in range(count):
        position = window.truth.iloc[int(generator.integers(len(window.truth)))]
        frames = (int(position["frame"]) - SPAN // 2, int(position["frame"]) + SPAN // 2)
        with_track.append(_summed(window, frames, (position["row"], position["col"])))
        without_track.append(_summed(window, frames, _empty_place(window, frames, generator)))
    return with_track, without_track


def energies(window: Array) -> dict[str, float]:
    """Return the 15 texture energies "LL" to "RR" of a sum of frame differences.

    ``window`` is (rows, cols) grey values. Fig. 4.13 compares energies with and without a track.
    """
    pairs = combinations_with_replacement(MASKS, 2)
    return {a + b: texture_energy(window, MASKS[a], MASKS[b]) for a, b in pairs}


def _empty_place(
    window: Window, frames: tuple[int, int], generator: np.random.Generator
) -> tuple[float, float]:
    """Return a random place (row, col) in px, over 180 px from all true positions.

    Only positions in ``frames`` (first and last) count. The distance is three times the box.
    """
    rows, cols = window.differences.shape[1:]
    now = window.visible[window.visible["frame"].between(*frames)]
    for _ in range(1000):
        row, col = generator.uniform(BOX, (rows - BOX[0], cols - BOX[1]))
        if np.hypot(now["row"] - row, now["col"] - col).min() > 3 * max(BOX):
            return float(row), float(col)
    raise InputError(f"{window.fraction}: no place without a track in frames {frames}.")


def _summed(window: Window, frames: tuple[int, int], place: tuple[float, float]) -> Array:
    """Return the sum of differences (60, 30) in grey values around a place.

    ``place`` is row, col in px, ``frames`` are first and last, both included. At the border the box
    is moved into the image.
    """
    top, left = (
        min(max(round(at) - size // 2, 0), edge - size)
        for at, size, edge in zip(place, BOX, window.differences.shape[1:], strict=True)
    )
    return window.differences(*frames, top, left, top + BOX[0], left + BOX[1])
