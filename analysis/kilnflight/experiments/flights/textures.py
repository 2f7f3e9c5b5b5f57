"""Textures of streaks (notebook 31)."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np

from kilnflight.arrays import Array
from kilnflight.checks import InputError
from kilnflight.experiments.flights.tracking import Window
from kilnflight.tracklets.texture import LAWS_EDGE, LAWS_LEVEL, texture_energy

BOX = (
    60,
    30,
)  # px, rows and columns of a box for the textures; 30 = 2 w, w of Table 5.16
SPAN = 11  # frames that such a box sums
MASKS = {
    "L": LAWS_LEVEL,
    "E": LAWS_EDGE,
    "S": np.array([-1.0, 0.0, 2.0, 0.0, -1.0]),
}  # Eq. 4.25
MASKS |= {
    "W": np.array([-1.0, 2.0, 0.0, -2.0, 1.0]),
    "R": np.array([1.0, -4.0, 6.0, -4.0, 1.0]),
}


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
        Sums over `SPAN` frames, (60, 30) grey values each. The first lie around true
        positions, the second in the same frames, over 180 px from every true position.
    """
    with_track = []
    without_track = []
    for _ in range(count):
        position = window.truth.iloc[int(generator.integers(len(window.truth)))]
        frames = (
            int(position["frame"]) - SPAN // 2,
            int(position["frame"]) + SPAN // 2,
        )
        with_track.append(_summed(window, frames, (position["row"], position["col"])))
        without_track.append(
            _summed(window, frames, _empty_place(window, frames, generator))
        )
    return with_track, without_track


def energies(window: Array) -> dict[str, float]:
    """Return the 15 texture energies "LL" to "RR" of a sum of frame differences.

    ``window`` is (rows, cols) grey values. Fig. 4.13 compares energies with and without
    a track.
    """
    pairs = combinations_with_replacement(MASKS, 2)
    return {a + b: texture_energy(window, MASKS[a], MASKS[b]) for a, b in pairs}


def _empty_place(
    window: Window, frames: tuple[int, int], generator: np.random.Generator
) -> tuple[float, float]:
    """Return a random place (row, col) in px, over 180 px from all true positions.

    Only positions in ``frames`` (first and last) count. The distance is three times the
    box.
    """
    rows, cols = window.differences.shape[1:]
    now = window.visible[window.visible["frame"].between(*frames)]
    for _ in range(1000):
        row, col = generator.uniform(BOX, (rows - BOX[0], cols - BOX[1]))
        if np.hypot(now["row"] - row, now["col"] - col).min() > 3 * max(BOX):
            return float(row), float(col)
    raise InputError(f"{window.fraction}: no place without a track in frames {frames}.")


def _summed(
    window: Window, frames: tuple[int, int], place: tuple[float, float]
) -> Array:
    """Return the sum of differences (60, 30) in grey values around a place.

    ``place`` is row, col in px, ``frames`` are first and last, both included. At the
    border the box is moved into the image.
    """
    top, left = (
        min(max(round(at) - size // 2, 0), edge - size)
        for at, size, edge in zip(place, BOX, window.differences.shape[1:], strict=True)
    )
    return window.differences(*frames, top, left, top + BOX[0], left + BOX[1])
