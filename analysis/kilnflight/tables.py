"""Columns, units and checks of the tables that steps exchange.

Conventions: one row is one particle in one frame. Columns ``x``, ``y``, ``z`` are in
millimetres, ``row`` and ``col`` in pixels; ``particle`` is a track. Other columns carry
their unit in the name. On the belt ``x`` points along the transport direction and ``y``
across it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from kilnflight.arrays import Index, Whole
from kilnflight.checks import (
    InputError,
    check_columns,
    check_finite,
    check_number,
    check_whole,
)

AXES = ("x", "y", "z")
PIXEL = ("row", "col")
LIMITS: Any = {key: {"least": -1} for key in ("particle", "t0_at_bound")}
LIMITS |= {"z": {"above": 0}, "points": {"least": 0}}
HIGHEST_ORDER = 6  # of a regressed trajectory, section 4.3


@dataclass(frozen=True)
class Column:
    """Name, kind (int, float, bool, str), unit and meaning; NaN only if ``missing``."""

    name: str
    kind: type
    unit: str
    meaning: str
    missing: bool = False


class Table:
    """Columns of a table that one step returns and the next takes."""

    def __init__(self, name: str, *columns: Column) -> None:
        self.name = name
        self.columns = columns
        self.names = [column.name for column in columns]

    def empty(self) -> pd.DataFrame:
        """Return the table without rows, with the right columns and types."""
        return pd.DataFrame(
            {column.name: pd.Series(dtype=column.kind) for column in self.columns}
        )

    def check(
        self, table: pd.DataFrame, where: str = "", once: bool = False
    ) -> pd.DataFrame:
        """Return the columns of this table, in order; numbers are int64 or float64.

        Raises
        ------
        InputError
            If a column is missing, is not of its kind, or holds a value that is not
            finite or below its limit. With ``once`` also if two rows have the same
            numbers in all columns, or a frame is below 0.
        """
        check_columns(table, self.names, where := where or self.name)
        checked = table[self.names].set_axis(
            table.index.set_names([None] * table.index.nlevels)
        )
        for column in self.columns:
            values = checked[column.name]
            place = f"{where}: column {column.name}"
            if column.kind in (int, float):
                read: Any = check_whole if column.kind is int else check_finite
                found = read(values, place, **{"gaps": True} if column.missing else {})
                checked[column.name] = found  # fmin: without NaN
                check_number(
                    np.fmin.reduce(found, initial=1),
                    place,
                    **LIMITS.get(column.name, {}),
                )
            elif not all(type(value) is column.kind for value in values):
                raise InputError(
                    f"{place} holds {values.dtype}, expected {column.kind.__name__}."
                )
        if once:  # two particles may be at one pixel, in discs of two sizes
            every = table.select_dtypes("number").assign(**checked)
            for row in checked.index[every.duplicated() | (checked["frame"] < 0)][:1]:
                raise InputError(
                    f"{where}: row {row} is there twice, or its frame is below 0."
                )
        return checked


def _by_axis(
    axes: Sequence[str], name: str, kind: type, *more: Any
) -> tuple[Column, ...]:
    """Return one column per axis; ``{}`` in the name stands for it. Then unit, meaning,
    missing.
    """
    return tuple(Column(name.format(axis), kind, *more) for axis in axes)


def _coefficients(k: int) -> tuple[Column, ...]:
    return _by_axis(
        AXES, f"coefficient_{{}}_{k}", float, f"mm/s^{k}", "of (t - t0)^k", True
    )


BELT_TRACKS = Table(
    "belt tracks",
    Column("frame", int, "1", "time step, counted from 0"),
    Column("particle", int, "1", "identity of the particle"),
    Column("time_s", float, "s", "time of the frame"),
    *_by_axis("xy", "{}", float, "mm", "along and across the belt"),
)

MEASURED = Table("measured", BELT_TRACKS.columns[0], *BELT_TRACKS.columns[3:])

BELT_LAST = Table(
    "last observation before the prediction phase",
    Column("particle", int, "1", "identity of the particle"),
    Column("time_s", float, "s", "t_Last"),
    *_by_axis("xy", "{}", float, "mm", "position at t_Last"),
    *_by_axis("xy", "velocity_{}_mm_s", float, "mm/s", "at t_Last"),
    *_by_axis("xy", "acceleration_{}_mm_s2", float, "mm/s^2", "at t_Last"),
)

BELT_ARRIVAL = Table(
    "arrivals at the prediction target",
    Column("particle", int, "1", "identity of the particle"),
    Column("time_s", float, "s", "t_Ref, interpolated as in Fig. 5 of the 2020 paper"),
    Column("y", float, "mm", "lateral position at t_Ref"),
    Column("velocity_y_mm_s", float, "mm/s", "lateral velocity across the target"),
)

BELT_PREDICTED = Table(
    "predicted arrivals",
    Column("particle", int, "1", "identity of the particle or track"),
    Column("time_s", float, "s", "predicted time at the valves", missing=True),
    Column("y", float, "mm", "predicted place across the belt", missing=True),
)

VALVE_EVENTS = Table(
    "valve events",
    Column("valve", int, "1", "counted from 0 at y = 0"),
    *_by_axis(
        ("open", "close"),
        "{}_s",
        float,
        "s",
        "time of that command; the air comes later",
    ),
)

BELT_SPOTS = Table(
    "particles in the pictures of the belt's camera",
    Column("frame", int, "1", "frame of the camera, counted from 0"),
    *_by_axis(
        PIXEL, "{}", float, "px", "centroid, counted down and to the right from 0"
    ),
    Column("area_px", float, "px^2", "number of its pixels"),
    Column("touching", int, "1", "1: larger than one particle, several may touch"),
    *_by_axis("xy", "{}", float, "mm", "along and across the belt, by the calibration"),
)

BELT_STATES = Table(
    "states of the tracks on the belt",
    Column("frame", int, "1", "frame of the camera"),
    Column("particle", int, "1", "identity of the track"),
    Column(
        "row", int, "1", "row of the table of detections; -1: missed, predicted only"
    ),
    Column("valid", int, "1", "1: the score has reached the upper threshold"),
    Column("score", float, "1", "log likelihood ratio of particle against dirt"),
    *_by_axis("xy", "{}", float, "mm", "filtered"),
    *_by_axis("xy", "velocity_{}_mm_s", float, "mm/s", "filtered"),
    *_by_axis("xy", "acceleration_{}_mm_s2", float, "mm/s^2", "filtered; 0 without it"),
)

BELT_ENDS = Table(
    "ends of the tracks on the belt",
    Column("particle", int, "1", "identity of the track"),
    Column("frame", int, "1", "its last frame"),
    Column("valid", int, "1", "1: its score has ever reached the upper threshold"),
)

DETECTIONS = Table(
    "detections",
    Column("frame", int, "1", "number of the frame in its recording"),
    *_by_axis(PIXEL, "{}", float, "px", "centre, counted down and to the right from 0"),
    Column("radius_px", float, "px", "size: radius of the disc it covers"),
    Column("gray", float, "1", "mean grey value of the frame within that disc"),
    *_by_axis(
        AXES,
        "{}",
        float,
        "mm",
        "mean of its points, camera coordinates, calibrated",
        True,
    ),
    Column("points", int, "1", "number of its points in space; 0: x, y, z are missing"),
    Column(
        "case",
        int,
        "1",
        "which case of chapter 3.1 decided it; 0: found in the picture alone",
    ),
)
PLACES = Table("places", *DETECTIONS.columns[5:8])  # x, y, z
TO_TRACK = Table("detections to track", *DETECTIONS.columns[:3], PLACES.columns[2])


def plain(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose index has no names, as linkers give them, and without
    categories.

    Levels of the index that are no columns become columns. `InputError`: it is no
    table.

    Examples
    --------
    >>> list(plain(pd.DataFrame({"row": [2.5]}, pd.Index([3], name="frame"))).columns)
    ['frame', 'row']
    """
    check_columns(table, getattr(table, "columns", ()), "table")
    names = [name for name in table.index.names if name not in (None, *table.columns)]
    table = table.reset_index(names) if names else table
    kinds = {
        name: table[name].cat.categories.dtype
        for name in table.select_dtypes("category")
    }
    return table.set_axis(table.index.set_names([None] * table.index.nlevels)).astype(
        kinds
    )


def with_pixels(table: pd.DataFrame) -> pd.DataFrame:
    """Return a plain table of other programs with row and col, from y and x in px; z is
    a plane.

    A table that has row or col already keeps its columns: there x, y, z are mm.

    Examples
    --------
    >>> list(with_pixels(pd.DataFrame({"y": [2.5], "x": [7.0], "frame": [3]})).columns)
    ['row', 'col', 'frame']
    """
    table = plain(table)
    columns = set(table.columns)
    if {"x", "y"} <= columns and not {"row", "col"} & columns:
        table = table.rename(columns={"x": "col", "y": "row", "z": "plane"})
    return table


def order_tracks(
    table: pd.DataFrame, where: str, clock: str = "frame"
) -> tuple[Index, Whole, Any]:
    """Return rows, particles and times of tracks, by particle and time.

    Rows of particle -1 are in no track. Times are whole frames, or floats of another
    ``clock``.

    Raises
    ------
    InputError
        If a column is missing or not made of such numbers, a particle is below -1, or
        one has two rows at one time.
    """
    columns = (
        Column(clock, int if clock == "frame" else float, "", ""),
        FLIGHTS.columns[0],
    )
    read = Table(where, *columns).check(table)
    time = read[clock].to_numpy()
    particle = read["particle"].to_numpy()
    rows = np.lexsort((time, particle))[np.sum(particle < 0) :]
    particle = particle[rows]
    time = time[rows]
    for k in np.flatnonzero((np.diff(particle) == 0) & (np.diff(time) == 0))[:1]:
        raise InputError(
            f"{where}: particle {particle[k]} twice in {clock} {time[k]}. Keep one."
        )
    return rows, particle, time


TRAJECTORIES = Table(
    "regressed trajectories",
    Column("particle", int, "1", "identity of the track"),
    Column("outcome", str, "1", "fitted, no depth or too few points"),
    Column("points", int, "1", "number of its detections with depth"),
    *_by_axis(("first", "last"), "{}_s", float, "s", "time of that one of them", True),
    Column("t0_s", float, "s", "time at the lance's outlet", missing=True),
    *_by_axis(
        ("earliest", "latest"), "t0_{}_s", float, "s", "end of the range of t0", True
    ),
    Column(
        "t0_at_bound", int, "1", "-1: t0 is the earliest, 1: the latest, 0: between"
    ),
    *_by_axis(AXES, "exit_{}", float, "mm", "the lance's outlet", True),
    *_by_axis(AXES, "order_{}", int, "1", "order of the polynomial, 0: none"),
    *sum((_coefficients(k) for k in range(1, HIGHEST_ORDER + 1)), start=()),
    *_by_axis(AXES, "rmse_{}_mm", float, "mm", "Eq. 4.30, thesis", True),
    *_by_axis(AXES, "mape_{}_percent", float, "%", "Eq. 4.31", True),
    *_by_axis(AXES, "r2_{}", float, "1", "Eq. 4.32", True),
    *_by_axis(AXES, "r2_adjusted_{}", float, "1", "Eq. 4.33", True),
)

FLIGHTS = Table(
    "flights",
    Column("particle", int, "1", "track of the flight"),
    *_by_axis(
        ("t0", "first", "last", "end"), "{}_s", float, "s", "on the recording's clock"
    ),
    Column("dwell_s", float, "s", "end_s - t0_s; a lower bound if it left or was lost"),
    Column("ending", str, "1", "landed, burnt out, left the view or lost"),
    Column("from_lance", bool, "1", "whether it starts at the lance"),
    Column("start_mm", float, "mm", "distance of its first positions from the lance"),
    Column("ignition", str, "1", "seen, none or too few points"),
    Column(
        "ignition_s",
        float,
        "s",
        "after t0_s; NaN unless ignition was seen",
        missing=True,
    ),
    Column("wall_mm", float, "mm", "last distance from the kiln's axis"),
    Column("refused", str, "1", "reason for rejection; empty if accepted"),
)

SLICES = Table(
    "space-sliced velocities",
    Column("particle", int, "1", "track"),
    Column(
        "slice_m", float, "m", "far end of the slice from the lance; below 0: behind it"
    ),
    Column(
        "velocity_m_s", float, "m/s", "V_n of Eq. 5.8; below 0: away from the camera"
    ),
    Column("observed", bool, "1", "whether it was reached after the first detection"),
)
