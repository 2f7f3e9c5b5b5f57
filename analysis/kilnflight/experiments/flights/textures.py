"""Joints of tracklets and textures of streaks (notebook 31)."""

from dataclasses import replace
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from pandas import DataFrame

from kilnflight.arrays import Array, Generator, Index, Numbers, Two, TwoInts
from kilnflight.checks import InputError
from kilnflight.experiments.flights.tracking import Window
from kilnflight.tracklets import Connection
from kilnflight.tracklets.joining import Candidates
from kilnflight.tracklets.paths import read_paths
from kilnflight.tracklets.texture import LAWS_EDGE, LAWS_LEVEL, texture_energy

BOX = np.array([60, 30])  # px, rows and columns for the textures; 30 is 2 w, Table 5.16
SPAN = 11  # frames that such a box sums
MASKS = {  # Eq. 4.25
    "L": LAWS_LEVEL,
    "E": LAWS_EDGE,
    "S": np.array([-1.0, 0.0, 2.0, 0.0, -1.0]),
    "W": np.array([-1.0, 2.0, 0.0, -2.0, 1.0]),
    "R": np.array([1.0, -4.0, 6.0, -4.0, 1.0]),
}


def joints(tracks: DataFrame, connection: Connection, differences: Any) -> DataFrame:
    """Return the pairs of tracklets that a connection joins, in order (Fig. 4.12).

    A tracklet that was joined may be joined again in a later iteration.

    Returns
    -------
    DataFrame
        ``earlier`` and ``later``, particles that meet; ``kind``, "connection" or
        "merging"; ``start_row``, ``start_col``, ``end_row`` and ``end_col`` in px, the
        last position of the earlier and the first of the later; ``first_frame`` and
        ``last_frame`` of both.
    """
    pairs: list[TwoInts] = []

    def matching(possible: Candidates) -> Index:
        taken = connection.matching(possible)
        pairs.extend(zip(possible.earlier[taken], possible.later[taken], strict=True))
        return taken

    replace(connection, matching=matching)(tracks, differences)
    paths = read_paths(tracks, "joints: tracks")
    first = paths.starts[:-1].copy()
    last = paths.starts[1:] - 1
    met = []
    for i, k in pairs:
        met.append((last[i], first[k], first[i], last[k]))
        joined = min(i, k)
        first[joined] = first[i]
        last[joined] = last[k]
    end, start, begin, finish = np.array(met, np.intp).reshape(-1, 4).T
    particle = tracks["particle"].to_numpy()[paths.rows]
    frame = paths.frame
    found = DataFrame({"earlier": particle[end], "later": particle[start]})
    found["kind"] = np.where(frame[start] <= frame[end], "merging", "connection")
    found[["start_row", "start_col"]] = paths.place[end, :2]
    found[["end_row", "end_col"]] = paths.place[start, :2]
    found["first_frame"] = frame[begin]
    found["last_frame"] = frame[finish]
    return found


def texture_boxes(
    window: Window, count: int, generator: Generator
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
        first = int(position["frame"]) - SPAN // 2
        frames = range(first, first + SPAN)
        there = (position["row"], position["col"])
        elsewhere = _empty_place(window, frames, generator)
        with_track.append(_summed(window, frames, there))
        without_track.append(_summed(window, frames, elsewhere))
    return with_track, without_track


def energies(box: Array) -> Numbers:
    """Return the 15 texture energies "LL" to "RR" of a sum of frame differences.

    ``box`` is (rows, cols) grey values. Fig. 4.13 compares energies with and without a
    track.
    """
    pairs = combinations_with_replacement(MASKS, 2)
    return {a + b: texture_energy(box, MASKS[a], MASKS[b]) for a, b in pairs}


def _empty_place(window: Window, frames: range, generator: Generator) -> Two:
    """Return a random place (row, col) in px, over 180 px from all true positions.

    Only positions in ``frames`` count. The distance is three times the longer side of a
    box.
    """
    now = window.visible[window.visible["frame"].isin(frames)]
    for _ in range(1000):
        row, col = generator.uniform(BOX, window.differences.shape[1:] - BOX)
        if np.hypot(now["row"] - row, now["col"] - col).min() > 3 * BOX[0]:
            return row, col
    raise InputError(f"{window.fraction}: no place without a track in {frames}.")


def _summed(window: Window, frames: range, place: Two) -> Array:
    """Return the sum of differences (60, 30) in grey values around a place (row, col).

    At the border the box is moved into the image.
    """
    first = np.rint(place).astype(int) - BOX // 2
    top, left = first.clip(0, window.differences.shape[1:] - BOX)
    box = window.differences[
        frames.start : frames.stop, top : top + BOX[0], left : left + BOX[1]
    ]
    return box.sum(axis=0, dtype=np.float64)
