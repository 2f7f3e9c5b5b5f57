"""Columns, units and checks of the tables that steps exchange.

Conventions: one row is one particle in one frame. Columns ``x``, ``y``, ``z`` are in millimetres,
``row`` and ``col`` in pixels; ``particle`` is a track. Other columns carry their unit in the name.
On the belt ``x`` points along the transport direction and ``y`` across it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from kilnflight.checks import InputError, check_columns


@dataclass(frozen=True)
class Column:
    """Name, kind, unit and meaning of one column.

    The kind is ``int``, ``float``, ``bool`` or ``str``. A column that may be ``missing`` holds NaN
    where nothing was measured.
    """

    name: str
    kind: type
    unit: str
    meaning: str
    missing: bool = False


class Table:
    """A table that one step hands to the next."""

    def __init__(self, name: str, *columns: Column) -> None:
        self.name, self.columns = name, columns

    @property
    def names(self) -> list[str]:
        """Return the names of the columns, in order."""
        return [column.name for column in self.columns]

    def empty(self) -> pd.DataFrame:
        """Return the table without rows, with the right columns and types."""
        return pd.DataFrame({column.name: pd.Series(dtype=column.kind) for column in self.columns})

    def check(self, table: pd.DataFrame, where: str = "") -> pd.DataFrame:
        """Return the table's own columns, or raise an `InputError`.

        Raises
        ------
        InputError
            If a column is missing, not of its kind, or holds a value that is not finite.
        """
        where = where or self.name
        if not isinstance(table, pd.DataFrame) or list(table.columns) != self.names:
            check_columns(table, self.names, where)
            table = table[self.names]
        for column in self.columns:
            values = table[column.name]
            if not _holds(values, column.kind):
                raise InputError(
                    f"{where}: column {column.name} holds {values.dtype}, expected "
                    f"{column.kind.__name__} ({column.unit}). Convert it first."
                )
            numbers = np.zeros(0) if column.kind is str else values.to_numpy(np.float64)
            finite = np.isfinite(numbers) | (np.isnan(numbers) & column.missing)
            if not finite.all():
                row = table.index[int(finite.argmin())]
                raise InputError(
                    f"{where}: column {column.name} is not finite in row {row}. Leave rows "
                    "without a measurement out; this column has no place-holders."
                )
        return table


def _holds(values: pd.Series, kind: type) -> bool:
    """Return whether a column is of a kind; whole numbers are floats too."""
    types = pd.api.types
    if kind is str:
        return types.is_string_dtype(values) and not values.isna().any()
    if kind is bool:
        return types.is_bool_dtype(values)
    number = types.is_numeric_dtype(values) and not types.is_bool_dtype(values)
    return number and (kind is float or types.is_integer_dtype(values))


BELT_TRACKS = Table(
    "belt tracks",
    Column("frame", int, "1", "time step, counted from 0"),
    Column("particle", int, "1", "identity of the particle"),
    Column("time_s", float, "s", "time of the frame"),
    Column("x", float, "mm", "along the belt"),
    Column("y", float, "mm", "across the belt"),
)

BELT_LAST = Table(
    "last observation before the prediction phase",
    Column("particle", int, "1", "identity of the particle"),
    Column("time_s", float, "s", "t_Last"),
    Column("x", float, "mm", "x_Last"),
    Column("y", float, "mm", "y_Last"),
    Column("velocity_x_mm_s", float, "mm/s", "first derivative of x at t_Last"),
    Column("velocity_y_mm_s", float, "mm/s", "first derivative of y at t_Last"),
    Column("acceleration_x_mm_s2", float, "mm/s^2", "second derivative of x at t_Last"),
    Column("acceleration_y_mm_s2", float, "mm/s^2", "second derivative of y at t_Last"),
)

BELT_ARRIVAL = Table(
    "what happened at the prediction target",
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
    Column("open_s", float, "s", "time of the command to open; the air comes a latency later"),
    Column("close_s", float, "s", "time of the command to close; likewise"),
)

BELT_SPOTS = Table(
    "particles seen by the belt's camera",
    Column("frame", int, "1", "frame of the camera, counted from 0"),
    Column("row", float, "px", "centroid, counted down from 0"),
    Column("col", float, "px", "centroid, counted to the right from 0"),
    Column("area_px", float, "px^2", "number of its pixels"),
    Column("touching", int, "1", "1: larger than one particle, several may touch"),
    Column("x", float, "mm", "along the belt, by the calibration"),
    Column("y", float, "mm", "across the belt"),
)

BELT_STATES = Table(
    "states of the tracks on the belt",
    Column("frame", int, "1", "frame of the camera"),
    Column("particle", int, "1", "identity of the track"),
    Column("row", int, "1", "row of the table of detections; -1: missed, predicted only"),
    Column("valid", int, "1", "1: the score has reached the upper threshold"),
    Column("score", float, "1", "log likelihood ratio of particle against dirt"),
    Column("x", float, "mm", "filtered, along the belt"),
    Column("y", float, "mm", "filtered, across the belt"),
    Column("velocity_x_mm_s", float, "mm/s", "filtered"),
    Column("velocity_y_mm_s", float, "mm/s", "filtered"),
    Column("acceleration_x_mm_s2", float, "mm/s^2", "filtered; 0 where velocity is constant"),
    Column("acceleration_y_mm_s2", float, "mm/s^2", "filtered; likewise"),
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
    Column("row", float, "px", "centre, counted down from 0"),
    Column("col", float, "px", "centre, counted to the right from 0"),
    Column("radius_px", float, "px", "size: radius of the disc it covers"),
    Column("gray", float, "1", "mean grey value of the frame within that disc"),
    Column("x", float, "mm", "mean of its points, camera coordinates", missing=True),
    Column("y", float, "mm", "likewise", missing=True),
    Column("z", float, "mm", "likewise, depth calibrated", missing=True),
    Column("points", int, "1", "number of its points in space; 0: x, y, z are missing"),
    Column("case", int, "1", "which of the five cases of chapter 3.1 decided it"),
)
TO_TRACK = Table("detections to track", *DETECTIONS.columns[:3])  # frame, row, col


def with_pixels(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of other programs with row and col, from y and x in pixels; z is a plane.

    A table that has row or col already is returned as it is: there x, y, z are mm.

    Examples
    --------
    >>> list(with_pixels(pd.DataFrame({"y": [2.5], "x": [7.0], "frame": [3]})).columns)
    ['row', 'col', 'frame']
    """
    if not {"x", "y"} <= set(table.columns) or {"row", "col"} & set(table.columns):
        return table
    return table.rename(columns={"x": "col", "y": "row", "z": "plane"})


AXES = ("x", "y", "z")
HIGHEST_ORDER = 6  # of a regressed trajectory, section 4.3


def _per_axis(name: str, kind: type, unit: str, meaning: str) -> tuple[Column, ...]:
    """Return one column per axis; ``{}`` in the name stands for it."""
    return tuple(
        Column(name.format(axis), kind, unit, f"{meaning}, {axis}", missing=kind is float)
        for axis in AXES
    )


TRAJECTORIES = Table(
    "regressed trajectories",
    Column("particle", int, "1", "identity of the track"),
    Column("outcome", str, "1", "fitted, or in a few words why not"),
    Column("points", int, "1", "number of its detections with depth"),
    Column("first_s", float, "s", "time of the first of them", missing=True),
    Column("last_s", float, "s", "time of the last of them", missing=True),
    Column("t0_s", float, "s", "time at the lance's outlet", missing=True),
    Column("t0_earliest_s", float, "s", "where the range of t0 begins", missing=True),
    Column("t0_latest_s", float, "s", "where the range of t0 ends", missing=True),
    Column("t0_at_bound", int, "1", "-1: t0 is the earliest, 1: the latest, 0: between"),
    *_per_axis("exit_{}", float, "mm", "the lance's outlet"),
    *_per_axis("order_{}", int, "1", "order of the polynomial, 0: none"),
    *(
        column
        for k in range(1, HIGHEST_ORDER + 1)
        for column in _per_axis(
            f"coefficient_{{}}_{k}", float, f"mm/s^{k}", f"factor of (t - t0)^{k}"
        )
    ),
    *_per_axis("rmse_{}_mm", float, "mm", "Eq. 4.30, thesis"),
    *_per_axis("mape_{}_percent", float, "%", "Eq. 4.31"),
    *_per_axis("r2_{}", float, "1", "Eq. 4.32"),
    *_per_axis("r2_adjusted_{}", float, "1", "Eq. 4.33"),
)

FLIGHTS = Table(
    "flights",
    Column("particle", int, "1", "track that the flight was worked out from"),
    Column("t0_s", float, "s", "when it left the lance, on the recording's clock"),
    Column("first_s", float, "s", "first detection"),
    Column("last_s", float, "s", "last detection"),
    Column("end_s", float, "s", "end of the flight, on the recording's clock"),
    Column("dwell_s", float, "s", "end_s - t0_s; a lower bound if it was lost"),
    Column("ending", str, "1", "landed, burnt out or lost"),
    Column("from_lance", bool, "1", "whether it starts at the lance"),
    Column("start_mm", float, "mm", "distance of its first positions from the lance"),
    Column("ignition", str, "1", "seen, before seen, none or too few points"),
    Column("ignition_s", float, "s", "after t0_s; NaN unless ignition was seen", missing=True),
    Column("rise_gray", float, "1", "grey values between both levels, 0 without a step"),
    Column("wall_mm", float, "mm", "last distance from the kiln's axis"),
    Column("refused", str, "1", "why no particle flies so; empty: it counts"),
)

SLICES = Table(
    "space-sliced velocities",
    Column("particle", int, "1", "track"),
    Column("slice_m", float, "m", "far end of the slice from the lance; below 0: behind it"),
    Column("velocity_m_s", float, "m/s", "V_n of Eq. 5.8; below 0: away from the camera"),
    Column("observed", bool, "1", "whether it was reached after the first detection"),
)


class Bound(NamedTuple):
    """What numbers a column of a saved table may hold, by its name."""

    pattern: str  # searched in "table/column", in lower case; the first that fits counts
    least: float
    greatest: float
    source: str  # unit, and why


INF = math.inf
COUNTED = (
    "tp|fp|fn|frames?|particles|tracks|flights|detections|spots|trajectories|positions|pixels|"
    "points|inliers|outliers|lost|refused|tracked|predicted|detected|(un)?lit|from_lance"
)
BOUNDS = [
    Bound(r"(/|_| )(n|number)$", 0, INF, "a count"),
    Bound(r"mape", 0, INF, "%, Eq. 4.31"),
    Bound(r"percent|\(%|has_depth|in_roi", 0, 100, "%, a share"),
    Bound(r"mm_s2$", -1e7, 1e7, "mm/s^2, a belt's contacts"),
    Bound(r"mm_s$", -5000, 5000, "mm/s, several times the belt's velocity"),
    Bound(
        r"(?<!m)m_s$|\(m/s\)|velocity-medians/(estimate|true|low|high)$",
        -30,
        32,
        "m/s, twice the lance's air",
    ),
    Bound(r"(remaining|true-velocity)/(value|low|high)$", -30, 100, "% or m/s, as both"),
    Bound(r"ignition.*(_s|\(s\))$|fig-5-25.*_s$", -0.05, 6, "s, as dwell"),
    Bound(r"dwell.*(_s|\(s\)|/(low|high|median|q\d+|whisker))$", 0, 6, "s, 8.4 m at 1.5 m/s"),
    Bound(r"/(expected_)?z(_captured)?(_mm)?$|depth.*_mm$", 0, 15e3, "mm, kiln and camera"),
    Bound(r"depth.*_m$", 0, 15, "m, kiln and camera"),
    Bound(r"along_kiln_m$", -6, 10, "m from the lance, inside the kiln"),
    Bound(r"radius.*_mm$", 0, 2000, "mm, the kiln's is 700 mm (sec. 2.1.1)"),
    Bound(r"/[xy](_mm)?$", -5000, 5000, "mm, beyond any wall"),
    Bound(r"/r2", -INF, 1, "1, Eq. 4.32"),
    Bound(r"/(precision|recall|f1|jsc|alpha|beta|event|share|weight|p)(_|$)", 0, 1, "1, a share"),
    Bound(r"class-recall/.*(air|wall)|shares/(estimate|low|high)$", 0, 1, "1, a share"),
    Bound(r"/(expected_)?(row|col)$", -2000, 5000, "px, a picture's size beyond the picture"),
    Bound(r"gray|grey", 0, 65_535, "1, 16 bit"),
    Bound(r"pressure_bar", 0, 10, "bar, the lance has 5 (sec. 2.1.1)"),
    Bound(r"_k$", 200, 3000, "K, a kiln"),
    Bound(r"_deg$", -360, 360, "degrees, a turn"),
    Bound(r"_mm$", -20e3, 20e3, "mm, beyond kiln and belt"),
    Bound(r"_m$|\(m\)", -20, 20, "m, beyond kiln and belt"),
    Bound(r"_px$|_hz$|_mib$", 0, 1e7, "px, Hz or MiB, never below 0"),
    Bound(r"(_s|\(s\)|seconds\w*)$", -2, 1e6, "s, a clock, a computing time"),
    Bound(r"_ms$", -1e6, 1e6, "ms, a belt's delay, a computing time"),
    Bound(rf"(/|_| )({COUNTED})$", 0, INF, "a count"),
]
# These may be below 0 in any unit, and those never are.
DIFFERENCE = (
    r"/.*(error|minus|differ|bias|(_| )off|gain|misfit|deviation|change|correct)"
    r"|-steps/.*_s_(low|high)$"
)
SPREAD = r"/.*(rmse|spread)|/(mae|iqr)"
SUFFIX = (
    r"_(low|high|min|max|bias|spread|published|calibrated|inputs_only|second_look|"
    r"(above|before)_[a-z]+)$"
)


def bound_of(column: str, identifier: str = "") -> Bound | None:
    """Return the bound of a column of a saved table; None: no unit and no known name.

    A difference of two values may be as large as their range, in both directions; a spread
    likewise, but not below 0. The ends of an interval have the bound of what they enclose.
    """
    name = f"{identifier}/{column}".lower()
    plain = re.sub(SUFFIX, "", name)
    bound = next((bound for bound in BOUNDS if re.search(bound.pattern, plain)), None)
    spread, difference = re.search(SPREAD, name), re.search(DIFFERENCE, name)
    if bound is None or not (spread or difference):
        return bound
    width = bound.greatest - bound.least
    return bound._replace(least=-width if difference else 0.0, greatest=width)


def impossible(table: pd.DataFrame, identifier: str = "") -> list[str]:
    """Return a sentence for every column that holds a number outside its `bound_of`."""
    sentences = []
    for column in table.select_dtypes("number"):
        bound = bound_of(str(column), identifier)
        values = table[column].to_numpy(np.float64)
        least, greatest = (bound.least, bound.greatest) if bound else (-INF, INF)
        outside = values[(values < least) | (values > greatest)]
        if bound and len(outside):
            sentences.append(
                f"column {column}: {len(outside)} of {len(values)} outside {least:g} to "
                f"{greatest:g} ({bound.source}), worst {max(outside, key=abs):g}"
            )
    return sentences
