"""Track tables as arrays, and back.

Tracklets come one after the other, each by ascending frame. A row whose ``particle`` is -1 belongs
to no track. It stays in the table, so that no step loses a detection; `tracked` leaves such rows
out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError, check_columns, check_whole, known_numbers, order_tracks

Integers = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]

LOST = -1
FARTHEST = 1e100  # of a position; squares of distances stay finite
PIXELS = ("row", "col")
DEPTHS = ("z", "x", "y")  # mm; z first, so that it is always column 2 of `Paths.place`


class Paths(NamedTuple):
    """Tracklets in the order of their first frames and positions.

    Attributes
    ----------
    rows
        (n,) positions in the table of the rows that belong to a track.
    frame
        (n,) ascending within a tracklet.
    place
        (n, 3 or more) row, col in px and z in mm, NaN where unknown, then x and y where
        the table has them.
    starts
        (m + 1,) first point of each tracklet.
    """

    rows: Integers
    frame: Integers
    place: Floats
    starts: Integers

    def names(self) -> Integers:
        """Return the number of each point's tracklet."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))


def read_paths(tracks: pd.DataFrame, where: str) -> Paths:
    """Return the tracklets of a table, whatever the order of its rows.

    Raises
    ------
    InputError
        If a column is missing or holds what it must not, or if a tracklet has two rows in
        one frame.
    """
    rows, particle, frame = order_tracks(tracks, where)
    place = _known_places(tracks, where)[rows]
    _, first, name = np.unique(particle, return_index=True, return_inverse=True)
    rank = np.lexsort((particle[first], place[first, 1], place[first, 0], frame[first]))
    number = np.argsort(rank)[name]
    points = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[points], np.arange(len(first) + 1))
    return Paths(rows[points], frame[points], place[points], starts)


def _known_places(tracks: pd.DataFrame, where: str) -> Floats:
    """Return the checked places of every row."""
    check_columns(tracks, PIXELS, where)
    names = _places(tracks)
    check_columns(tracks, names, where)
    place = np.full((len(tracks), max(3, len(names))), np.nan)
    for column, name in enumerate(names):
        place[:, column] = known_numbers(tracks[name], f"{where}: column {name}")
        unknown = np.isnan(place[:, column]) & (column >= len(PIXELS))
        bad = np.flatnonzero(~(unknown | (np.abs(place[:, column]) <= FARTHEST)))
        if len(bad):
            raise InputError(
                f"{where}: column {name} is {place[bad[0], column]} in row "
                f"{tracks.index[bad[0]]}. Leave rows without a position out; only a depth may "
                "be missing (NaN)."
            )
    return place


def _places(tracks: pd.DataFrame) -> list[str]:
    """Return the columns that hold places; x and y without a z are none."""
    depths = DEPTHS if "z" in tracks.columns else ()
    return [*PIXELS, *(name for name in depths if name in tracks.columns)]


def write_paths(tracks: pd.DataFrame, paths: Paths, names: Integers) -> pd.DataFrame:
    """Return the table with new particles and places.

    Rows keep their order. Rows that ``paths`` does not name, and those with a name below 0, get
    particle -1. Particles are numbered from 0 by first frame, then first position.
    """
    changed = {}
    for number, name in enumerate(_places(tracks)):
        values = tracks[name].to_numpy(np.float64, na_value=np.nan).copy()
        values[paths.rows] = paths.place[:, number]
        changed[name] = values
    particle = np.full(len(tracks), LOST, dtype=np.int64)
    particle[paths.rows] = np.maximum(names, LOST)
    table = tracks.assign(**changed, particle=particle)
    ordered = read_paths(table, "tracks")
    particle[ordered.rows] = ordered.names()
    return table.assign(particle=particle)


def velocities(frame: Integers, place: Floats) -> Floats:
    """Return velocities (n - 1, 2) between consecutive points (Eq. 4.17).

    In px/frame. Between two paths the value means nothing, and frames may be the same.
    """
    step = np.diff(frame)
    return np.diff(place[:, :2], axis=0) / np.where(step == 0, 1, step)[:, None]


def turns(before: Floats, after: Floats) -> tuple[Floats, Floats]:
    """Return angle and difference of velocities (n, 2) (Eq. 4.19).

    In degrees and px/frame. A velocity of zero has no direction: the angle is then 0.
    """
    across = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    along = (before * after).sum(axis=1)
    change = np.hypot(*(after - before).T)
    # The arctangent of 0 and -0 would be 180 degrees.
    standing = (across == 0.0) & (along == 0.0)
    angle = np.where(standing, 0.0, np.degrees(np.arctan2(np.abs(across), along)))
    return angle, change


def means(part: Integers, values: Floats, count: int) -> Floats:
    """Return the mean of the values in each of ``count`` parts, or 0."""
    number = np.maximum(np.bincount(part, minlength=count), 1)
    return np.asarray(np.bincount(part, values, minlength=count) / number)


def largest(part: Integers, values: Floats, count: int) -> Floats:
    """Return the largest value of each of ``count`` parts, 0 without any."""
    found = np.zeros(count)
    np.maximum.at(found, part, values)
    return found


def fastest_steps(paths: Paths) -> Floats:
    """Return the largest speed of each tracklet between two points, px/frame; 0 of one point."""
    names = paths.names()
    inside = np.diff(names) == 0
    speed = np.hypot(*velocities(paths.frame, paths.place)[inside].T)
    return largest(names[1:][inside], speed, len(paths.starts) - 1)


def joined_speed(paths: Paths, i: int, k: int) -> float:
    """Return the largest speed in the image of two tracklets joined, px/frame.

    In a common frame the place is the mean of both.
    """
    parts = [slice(*paths.starts[n : n + 2]) for n in (i, k)]
    frame, place = (np.concatenate([values[part] for part in parts]) for values in paths[1:3])
    frame, at, count = np.unique(frame, return_inverse=True, return_counts=True)
    row, col = (np.bincount(at, values) / count for values in place[:, :2].T)
    return float(np.max(np.hypot(np.diff(row), np.diff(col)) / np.diff(frame), initial=0.0))


def ranges(begin: Integers, end: Integers) -> tuple[Integers, Integers]:
    """Return all numbers of several ranges, after the range of each."""
    size = np.maximum(end - begin, 0)
    owner = np.repeat(np.arange(len(size)), size)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(size) - size, size) + begin[owner]


def tracked(tracks: pd.DataFrame) -> pd.DataFrame:
    """Return the rows that belong to a track."""
    check_columns(tracks, ("particle",), "tracks")
    return tracks[check_whole(tracks["particle"], "tracks: column particle") >= 0]
