"""Tables as trackpy has them: y, x, frame, particle and, in three dimensions, z."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from kilnflight.checks import InputError, check_columns
from kilnflight.tracking.files.rows import (
    NAMES,
    check_tracks,
    csv_text,
    in_tracks,
    read_table,
    write_lines,
)

NAMES_OF = {"frame": "frame", "particle": "particle", "row": "y", "col": "x", "plane": "z"}


def from_trackpy(table: pd.DataFrame) -> pd.DataFrame:
    """Return the tracks of a trackpy table; its other columns are left out.

    Examples
    --------
    >>> table = pd.DataFrame({"y": [2.5], "x": [7.0], "frame": [3], "particle": [0], "mass": [9]})
    >>> from_trackpy(table).to_dict("records")
    [{'frame': 3, 'particle': 0, 'row': 2.5, 'col': 7.0}]
    """
    where = "from_trackpy: table"
    check_columns(table, [NAMES_OF[name] for name in NAMES[:4]], where)
    names = [name for name in NAMES if NAMES_OF[name] in table.columns]
    found = pd.DataFrame({name: table[NAMES_OF[name]].to_numpy() for name in names})
    for name in NAMES[:2]:  # after a merge or a CSV, whole numbers come as floats
        values = pd.to_numeric(found[name], errors="coerce").to_numpy(np.float64)
        if not (np.isfinite(values) & (values == np.floor(values))).all():
            raise InputError(f"{where}: column {name} is not made of whole numbers.")
        found[name] = values.astype(np.int64)
    return check_tracks(found.astype(dict.fromkeys(names[2:], np.float64)), where)


def to_trackpy(tracks: pd.DataFrame) -> pd.DataFrame:
    """Return tracks as trackpy has them, sorted by particle and frame."""
    table = in_tracks(tracks, "to_trackpy: tracks").rename(columns=NAMES_OF)
    return table[[name for name in ("z", "y", "x", "frame", "particle") if name in table]]


def read_trackpy(path: str | Path) -> pd.DataFrame:
    """Return the tracks of a trackpy table that was saved as CSV, with or without its index."""
    return read_table(Path(path), [NAMES_OF[name] for name in NAMES[:4]], "z")


def write_trackpy(tracks: pd.DataFrame, path: str | Path) -> None:
    """Write tracks as the CSV of a trackpy table, without an index."""
    write_lines(Path(path), [csv_text(to_trackpy(tracks))])
