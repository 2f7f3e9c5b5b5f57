"""TrackMate's table of spots, as its window "Tracks" exports it to CSV."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from kilnflight.checks import InputError
from kilnflight.tracking.files.rows import (
    Row,
    check_tracks,
    make_tracks,
    number,
    read_csv,
    whole,
    write_lines,
)

NAMES = ("FRAME", "TRACK_ID", "POSITION_X", "POSITION_Y", "POSITION_Z")
NO_TRACK = ("", "None")  # as version 7 and older ones write a spot in no track
# Since version 7 three lines follow the names: long names, short names, units.
HEADER = (
    "LABEL,ID,TRACK_ID,POSITION_X,POSITION_Y,POSITION_Z,FRAME\n",
    "Label,Spot ID,Track ID,X,Y,Z,Frame\n",
    "Label,Spot ID,Track ID,X,Y,Z,Frame\n",
    ",,,(pixel),(pixel),(pixel),\n",
)


def read_trackmate(path: str | Path) -> pd.DataFrame:
    """Return the spots of a TrackMate CSV, with ``plane``; a spot in no track is particle -1.

    Notes
    -----
    Positions are in the units of TrackMate's calibration, which the third line below the names
    tells; they are taken as they are. A track that splits or merges has two spots in one frame;
    both are returned, and `score_tracks` will refuse them.
    """
    path = Path(path)
    rows: list[Row] = []
    _, lines = read_csv(path, NAMES)
    for line, fields in lines:
        if line <= len(HEADER) and not rows and not _counts(fields["FRAME"]):
            continue
        at = {name: f"{path}, line {line}, column {name}" for name in NAMES}
        track = fields["TRACK_ID"].strip()
        particle = -1 if track in NO_TRACK else whole(track, at["TRACK_ID"])
        x, y, z = (number(fields[name], at[name]) for name in NAMES[2:])
        rows.append((whole(fields["FRAME"], at["FRAME"]), particle, y, x, z))
    return make_tracks(rows, planes=True)


def _counts(text: str) -> bool:
    """Return whether this is a number, and so no line of names or units."""
    try:
        number(text, "")
    except InputError:
        return False
    return True


def write_trackmate(tracks: pd.DataFrame, path: str | Path) -> None:
    """Write tracks as a TrackMate CSV; without ``plane``, POSITION_Z is 0."""
    table = check_tracks(tracks, "write_trackmate: tracks")
    write_lines(Path(path), _lines(table.assign(plane=table.get("plane", 0.0))))


def _lines(table: pd.DataFrame) -> Iterator[str]:
    yield from HEADER
    columns = [table[name].tolist() for name in ("particle", "col", "row", "plane", "frame")]
    for spot, (particle, x, y, z, t) in enumerate(zip(*columns, strict=True)):
        track = "" if particle < 0 else particle
        yield f"ID{spot},{spot},{track},{x!r},{y!r},{z!r},{t}\n"
