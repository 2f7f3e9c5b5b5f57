"""Track tables as arrays, and back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
from pandas import DataFrame

from kilnflight.arrays import Array, Index, Integers, Pair, Whole
from kilnflight.checks import Settings, check_columns, check_finite, check_whole
from kilnflight.tables import order_tracks


class Paths(NamedTuple):
    """m tracklets with n points, one after the other, each by ascending frame.

    Tracklets are in the order of their first frame, then first row, then first col.
    """

    rows: Index  # (n,) row numbers in the table
    frame: Whole  # (n,)
    place: Array  # (n, 3 or more) row, col in px, z in mm or NaN, then x and y if given
    starts: Index  # (m + 1,) index of the first point of each tracklet, and n

    def names(self) -> Index:
        """Return the number (n,) of each point's tracklet, counted from 0."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))

    def grouped(self, names: Integers) -> Paths:
        """Return the points grouped by ``names`` (n,), without those below 0.

        Tracklets are numbered by first frame, then row, then col. The names must ascend
        but for those below 0, and the frames of one name, as nothing is sorted.
        """
        kept = np.flatnonzero(names >= 0)
        begin = np.flatnonzero(np.diff(names[kept], prepend=-1))
        end = np.append(begin[1:], len(kept))[: len(begin)]
        at = kept[begin]
        rank = np.lexsort((self.place[at, 1], self.place[at, 0], self.frame[at]))
        points = kept[ranges(begin[rank], end[rank])[1]]
        starts = np.cumsum(np.append(0, (end - begin)[rank]))
        return Paths(
            rows=self.rows[points],
            frame=self.frame[points],
            place=self.place[points],
            starts=starts,
        )


class PathStep(Settings, ABC):
    """A step of post-processing.

    `apply` maps `Paths` to `Paths`, a call maps a track table to a track table.
    """

    def __call__(self, tracks: DataFrame, differences: Any = None) -> DataFrame:
        """Return the table after this step, with the same rows and columns.

        Parameters
        ----------
        tracks
            Track table, see `kilnflight.tracklets`.
        differences
            (frames, rows, cols) differences of frames and background, in grey values;
            used by `Joining` alone, see `kilnflight.tracklets.postprocess`.

        Raises
        ------
        InputError
            If the table is not a track table.
        """
        paths = read_paths(tracks, f"{type(self).__name__}: tracks")
        return write_paths(tracks, self.apply(paths, differences))

    @abstractmethod
    def apply(self, paths: Paths, differences: Any = None) -> Paths:
        """Return the tracklets after this step.

        ``differences`` (frames, rows, cols) are differences of frames and background,
        or None.
        """


def read_paths(tracks: DataFrame, where: str) -> Paths:
    """Return the tracklets of a track table, whose rows may have any order.

    ``where`` names the table in errors.

    Raises
    ------
    InputError
        If a column is missing or holds other values, or if a tracklet has two rows in a
        frame.
    """
    rows, particle, frame = order_tracks(tracks, where)
    names = _places(tracks)
    check_columns(tracks, names, where)
    place = np.full((len(tracks), max(3, len(names))), np.nan)
    for k, name in enumerate(names):
        place[:, k] = check_finite(tracks[name], f"{where}: column {name}", gaps=k > 1)
    ungrouped = Paths(rows=rows, frame=frame, place=place[rows], starts=rows[:0])
    return ungrouped.grouped(particle)


def _places(tracks: DataFrame) -> list[str]:
    """Return the names of the columns of places, in the order of `Paths.place`.

    These are row, col (or y, x) in px; with a z, also z and, where present, x and y in
    mm.
    """
    names = set(tracks.columns)
    if {"row", "col"}.isdisjoint(names) and {"x", "y"} <= names:
        return ["y", "x"]
    if "z" not in names:
        return ["row", "col"]
    return ["row", "col", *(name for name in ("z", "x", "y") if name in names)]


def write_paths(tracks: DataFrame, paths: Paths) -> DataFrame:
    """Return the table with the particles and places of paths, -1 for other rows.

    ``tracks`` must be the table from which `read_paths` made the paths: `Paths.rows`
    are its row numbers.
    """
    particle = np.full(len(tracks), -1, np.int64)
    particle[paths.rows] = paths.names()
    table = tracks.assign(particle=particle)
    for k, name in enumerate(_places(tracks)):
        values = tracks[name].to_numpy(float, na_value=np.nan).copy()
        values[paths.rows] = paths.place[:, k]
        table[name] = values
    return table


def velocities(frame: Whole, place: Array) -> Array:
    """Return velocities (n - 1, 2) between consecutive points in px/frame (Eq. 4.17).

    ``frame`` is (n,), ``place`` (n, 2 or more) holds row and col in px. Between two
    paths the value has no meaning; between two points of one frame it is their
    distance.
    """
    frames = np.maximum(np.diff(frame), 1)
    return np.diff(place[:, :2], axis=0) / frames[:, None]


def step_speeds(names: Index, frame: Whole, place: Array) -> tuple[Index, Array]:
    """Return the path (k,) and the speed (k,) of each step within a path, in px/frame.

    ``names`` (n,) is the path of each point; points are sorted by path and frame.
    """
    within = np.diff(names) == 0
    return names[1:][within], np.hypot(*velocities(frame, place)[within].T)


def turns(before: Array, after: Array) -> Pair:
    """Return the change of direction (n,) in degrees and of velocity (n,) in px/frame.

    ``before`` and ``after`` (n, 2) are velocities in px/frame (Eq. 4.19, Fig. 4.5). The
    angle is 0 where a velocity is zero.
    """
    across = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    along = (before * after).sum(axis=1)
    change = np.hypot(*(after - before).T)
    # Without + 0.0 the angle of 0 and -0 would be 180 degrees.
    return np.degrees(np.arctan2(np.abs(across), along + 0.0)), change


def means(part: Integers, values: Array, count: int) -> Array:
    """Return the mean (count,) of the values of each part; 0 without values.

    ``part`` (n,) is the part, below ``count``, of each of the ``values`` (n,).
    """
    number = np.bincount(part, minlength=count)
    total = np.bincount(part, values, minlength=count)
    return total / np.maximum(number, 1)


def ranges(begin: Integers, end: Integers) -> tuple[Index, Integers]:
    """Return the whole numbers of p ranges, one range after the other.

    ``begin`` and ``end`` (p,) are the ends, the latter excluded. The first result (q,)
    is the index of each number's range, the second (q,) the number.
    """
    size = np.maximum(end - begin, 0)
    owner = np.repeat(np.arange(len(size)), size)
    passed = np.cumsum(size) - size  # numbers of all ranges before
    return owner, np.arange(len(owner)) - passed[owner] + begin[owner]


def tracked(tracks: DataFrame) -> DataFrame:
    """Return the rows that belong to a track: ``particle`` is not -1."""
    check_columns(tracks, ("particle",), "tracks")
    particle = check_whole(tracks["particle"], "tracks: column particle")
    return tracks[particle >= 0]
