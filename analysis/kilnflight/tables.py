"""Columns, units and checks of the tables that steps exchange.

Conventions: one row is one particle in one frame. Columns ``x``, ``y``, ``z`` are in
millimetres, ``row`` and ``col`` in pixels; ``particle`` is a track. ``link`` says how
sure the link to the track is, from 1 to 0 (`kilnflight.track`). Other columns carry
their unit in the name. On the belt ``x`` points along the transport direction and ``y``
across it. tables.csv lists the columns of all tables.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pandas import DataFrame, Series

from kilnflight.arrays import Facts, Index, Whole
from kilnflight.checks import (
    InputError,
    check_columns,
    check_finite,
    check_number,
    check_whole,
)

AXES = ("x", "y", "z")
GAPS = complex  # kind of a column of floats that may be NaN
LIMITS: dict[str, Facts] = {
    "particle": {"least": -1},
    "t0_at_bound": {"least": -1},
    "z": {"above": 0},
    "points": {"least": 0},
}
HIGHEST_ORDER = 6  # order of a regressed trajectory, section 4.3


class Table:
    """Columns of a table that one step returns and the next takes.

    Parameters
    ----------
    name
        Name in messages.
    **kinds
        Kind of each column: int, float, bool, str, or `GAPS` for floats that may be
        NaN.
    """

    def __init__(self, name: str, **kinds: type) -> None:
        self.name = name
        self.kinds = kinds
        self.names = [*kinds]
        self.dtypes = {
            name: float if kind is GAPS else kind for name, kind in kinds.items()
        }

    def empty(self) -> DataFrame:
        """Return the table without rows, with the right columns and types."""
        return DataFrame(columns=self.names).astype(self.dtypes)

    def join(self, parts: Iterable[DataFrame]) -> DataFrame:
        """Return tables, one after the other; without any, one without rows."""
        return pd.concat([self.empty(), *parts], ignore_index=True)

    def check(self, table: DataFrame, where: str = "", once: bool = False) -> DataFrame:
        """Return the columns of this table, in order; numbers are int64 or float64.

        Raises
        ------
        InputError
            If a column is missing, is not of its kind, or holds a value that is not
            finite or below its limit. With ``once`` also if two rows have the same
            numbers in all columns, or a frame is below 0.
        """
        where = where or self.name
        check_columns(table, self.names, where)
        checked = _unnamed(table[self.names])
        for name, kind in self.kinds.items():
            place = f"{where}: column {name}"
            checked[name] = _checked(checked[name], kind, place, LIMITS.get(name, {}))
        if once:  # two particles may be at one pixel, in discs of two sizes
            twice = checked.iloc[:, :2].duplicated()  # two columns tell nearly all
            if twice.any():
                twice = table.select_dtypes("number").assign(**checked).duplicated()
            wrong = checked.index[twice | (checked["frame"] < 0)]
            if len(wrong):
                raise InputError(
                    f"{where}: row {wrong[0]} is there twice, or its frame is below 0."
                )
        return checked


def _checked(values: Series, kind: type, place: str, limit: Facts) -> Any:
    """Return the values of a column of a kind, or raise an `InputError`."""
    if kind in (bool, str):
        if not all(type(value) is kind for value in values):
            raise InputError(f"{place} holds {values.dtype}, expected {kind.__name__}.")
        return values
    if kind is int:
        found: Any = check_whole(values, place)
    else:
        found = check_finite(values, place, gaps=kind is GAPS)
    least = np.fmin.reduce(found, initial=1)  # NaN is passed over
    check_number(least, place, **limit)
    return found


KINDS = {"whole": int, "number": float, "gaps": GAPS, "text": str, "flag": bool}


def read_beside(module: str, name: str, **options: Any) -> Any:
    """Read a CSV file that lies beside a module, given as ``__file__``."""
    return pd.read_csv(Path(module).with_name(name), **options)


# Names of our columns in the tables of tracks of other programs.
FORMATS: dict[str, Facts] = read_beside(
    __file__, "formats.csv", index_col="ours"
).to_dict()
# A row of tables.csv is a column: its table, name, kind, and unit with meaning.
_COLUMNS = read_beside(__file__, "tables.csv", index_col="column")
TABLES = {
    name: Table(name, **rows["kind"].map(KINDS))
    for name, rows in _COLUMNS.groupby("table", sort=False)
}
BELT_TRACKS = TABLES["belt tracks"]
MEASURED = TABLES["measured"]
BELT_LAST = TABLES["last observation before the prediction phase"]
BELT_ARRIVAL = TABLES["arrivals at the prediction target"]
BELT_PREDICTED = TABLES["predicted arrivals"]
BELT_SPOTS = TABLES["particles in the pictures of the belt's camera"]
BELT_STATES = TABLES["states of the tracks on the belt"]
BELT_ENDS = TABLES["ends of the tracks on the belt"]
DETECTIONS = TABLES["detections"]
PLACES = TABLES["places"]
TO_TRACK = TABLES["detections to track"]
TRACKED = TABLES["tracks"]
TRAJECTORIES = TABLES["regressed trajectories"]
FLOWN = TABLES["tracks of flights"]
FLIGHTS = TABLES["flights"]
SLICES = TABLES["space-sliced velocities"]
SQUARES = TABLES["square displacements"]


def plain(table: DataFrame) -> DataFrame:
    """Return a table without categories and objects, whose index has no names.

    Linkers give such. Levels of the index that are no columns become columns.

    Raises
    ------
    InputError
        If it is no table.

    Examples
    --------
    >>> list(plain(pd.DataFrame({"row": [2.5]}, pd.Index([3], name="frame"))).columns)
    ['frame', 'row']
    """
    check_columns(table, getattr(table, "columns", ()), "table")
    names = [name for name in table.index.names if name not in (None, *table.columns)]
    if names:
        table = table.reset_index(names)
    named = table.select_dtypes("category")
    kinds = {name: named[name].cat.categories.dtype for name in named}
    kinds |= dict.fromkeys(table.select_dtypes("float16"), np.dtype(float))
    return _unnamed(table).astype(kinds).infer_objects()


def _unnamed(table: DataFrame) -> DataFrame:
    """Return a table whose index has no names."""
    return table.set_axis(table.index.set_names([None] * table.index.nlevels))


def with_pixels(table: DataFrame) -> DataFrame:
    """Return a plain table of other programs with our names, row and col in px.

    The program of `FORMATS` is the one with most of the columns. Its z is a plane. A
    table that has row or col keeps its columns: x, y, z are mm.

    Examples
    --------
    >>> list(with_pixels(pd.DataFrame({"y": [2.5], "x": [7.0], "frame": [3]})).columns)
    ['row', 'col', 'frame']
    >>> list(with_pixels(pd.DataFrame({"ID": [1], "t": [0], "y": 2.5, "x": 7.0})))
    ['particle', 'frame', 'row', 'col']
    """
    table = plain(table)
    held = set(table.columns)
    names = max(FORMATS.values(), key=lambda each: len(held & {*each.values()}))
    if {"row", "col"} & held or not {names["row"], names["col"]} <= held:
        return table
    return table.rename(columns={name: ours for ours, name in names.items()})


def in_tracks(table: DataFrame, where: str) -> DataFrame:
    """Return `TRACKED` of the rows in tracks, sorted by particle and frame.

    ``where`` begins an error.

    Raises
    ------
    InputError
        As `order_tracks`, or if a position is not finite.
    """
    table = with_pixels(table)
    return TRACKED.check(table.iloc[order_tracks(table, where)[0]], where)


def order_tracks(
    table: DataFrame, where: str, clock: str = "frame"
) -> tuple[Index, Whole, Any]:
    """Return row numbers, particles and times of tracks, sorted by particle and time.

    Rows of particle -1, in no track, are left out. ``where`` begins an error. Times are
    whole frames, or floats of another ``clock``.

    Raises
    ------
    InputError
        If a column is missing or not made of such numbers, a particle is below -1, or
        one has two rows at one time.
    """
    kind = int if clock == "frame" else float
    read = Table(where, **{clock: kind}, particle=int).check(table)
    time = read[clock].to_numpy()
    particle = read["particle"].to_numpy()
    rows = np.lexsort((time, particle))[np.sum(particle < 0) :]
    particle = particle[rows]
    time = time[rows]
    twice = np.flatnonzero((np.diff(particle) == 0) & (np.diff(time) == 0))
    if len(twice):
        k = twice[0]
        raise InputError(
            f"{where}: particle {particle[k]} twice in {clock} {time[k]}. Keep one."
        )
    return rows, particle, time
