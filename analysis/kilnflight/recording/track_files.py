"""Tables of detections and tracks in files, also for other programs.

==============  ==================================================================================
csv             every column, read and written; also Parquet, by the ending of the file
challenge       XML of the particle tracking challenge (Chenouard et al. 2014; Icy,
TrackMate) napari          CSV of a tracks layer: ID, T, (Z,) Y, X trackmate
TrackMate's table of spots, CSV trackpy         CSV of a trackpy table: (z,) y, x,
frame, particle
==============  ==================================================================================

The last four have the rows in tracks (particle 0 and above), sorted by particle and
frame; ``row`` is y, ``col`` is x, ``plane`` is z. Numbers are written to the last
digit. A file is there whole or not at all.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pandas as pd

from kilnflight.checks import InputError, check_columns, check_whole
from kilnflight.store.cache import write_whole
from kilnflight.tables import with_pixels

ENDINGS = ("", ".csv", ".txt", ".parquet")
TRACKPY = {
    "plane": "z",
    "row": "y",
    "col": "x",
    "frame": "frame",
    "particle": "particle",
}
CHALLENGE = {"particle": "particle", "frame": "t", "col": "x", "row": "y", "plane": "z"}
NAPARI = {"particle": "ID", "frame": "T", "plane": "Z", "row": "Y", "col": "X"}
TRACKMATE = {
    "label": "LABEL",
    "spot": "ID",
    "particle": "TRACK_ID",
    "col": "POSITION_X",
}
TRACKMATE |= {"row": "POSITION_Y", "plane": "POSITION_Z", "frame": "FRAME"}
FORMATS = {
    "challenge": CHALLENGE,
    "napari": NAPARI,
    "trackmate": TRACKMATE,
    "trackpy": TRACKPY,
}
# Since TrackMate 7 three lines follow the names: long names, short names, units.
SPOT_LINES = (
    2 * "Label,Spot ID,Track ID,X,Y,Z,Frame\n" + ",,,(pixel),(pixel),(pixel),\n"
)


def check_table_target(path: Path, form: str = "csv", source: Path = Path()) -> None:
    """Raise an `InputError` unless a table can get this name and is not the source."""
    new = (
        path.parent.is_dir()
        and path.resolve() != source.resolve()
        and not path.match("/dev/*")
    )
    if not new or (form == "csv" and path.suffix not in ENDINGS):
        raise InputError(
            f"{path}: name another table .csv or .parquet, in a folder that exists."
        )


def read_csv(path: Path) -> pd.DataFrame:
    """Return a table whose lines all have as many cells as there are names, each name
    once.
    """
    text = path.read_text("utf-8-sig")
    rows = csv.reader(io.StringIO(text), skipinitialspace=True)
    names = next(rows, [])
    widths = {len(row) for row in rows if row}
    if widths - {len(names)} or len({*names}) < len(names) or not text.endswith("\n"):
        raise InputError(
            "a line has other cells than names, a name is twice, or the end is cut."
        )
    return pd.read_csv(io.StringIO(text), skipinitialspace=True)


def read_table(path: Path) -> pd.DataFrame:
    """Return a table with frame, and row, col or x, y in pixels, in any order of
    columns.
    """
    try:
        table = pd.read_parquet(path) if path.suffix == ".parquet" else read_csv(path)
    except Exception as error:  # libraries raise anything on damaged bytes
        raise InputError(
            f"{path}: cannot be read ({error}). Give frame, row, col."
        ) from error
    return with_pixels(
        table if len(table) else table.astype(int)
    )  # no rows: columns of no kind


def write_table(table: pd.DataFrame, path: Path, form: str = "csv") -> None:
    """Write a table whole or not at all; forms other than csv take tracks."""
    check_table_target(path, form)
    if form == "csv":
        binary = path.suffix == ".parquet"
        return write_whole(
            path, table.to_parquet() if binary else csv_of(table).encode()
        )
    check_columns(table, ["frame", "particle", "row", "col"], "tracks")
    whole = {
        name: check_whole(table[name], f"tracks: {name}")
        for name in ("particle", "frame")
    }
    tracks = (
        table.assign(**whole)
        .query("particle >= 0")
        .sort_values([*whole], ignore_index=True)
    )
    if form in ("challenge", "trackmate"):
        tracks = tracks.assign(plane=tracks.get("plane", 0.0), spot=tracks.index)
        tracks = tracks.assign(label="ID" + tracks["spot"].astype(str))
    columns = FORMATS[form]
    tracks = tracks[[name for name in columns if name in tracks]].rename(
        columns=columns
    )
    text = (
        _xml(tracks)
        if form == "challenge"
        else tracks.to_csv(index=False, lineterminator="\n")
    )
    if form == "trackmate":
        text = text.replace("\n", f"\n{SPOT_LINES}", 1)
    write_whole(path, text.encode())


def csv_of(table: pd.DataFrame) -> str:
    """Return a table as CSV for people; a quote keeps spreadsheets from computing a
    text.
    """
    return table.replace(r"^(?=[=+@\t\r-])", "'", regex=True).to_csv(index=False)


def _xml(tracks: pd.DataFrame) -> str:
    """Return the XML of the challenge; it holds nothing but numbers."""
    text = '<root>\n<TrackContestISBI2012 snr="" density="" scenario="">\n'
    for _, track in tracks.groupby("particle"):
        spots = track.drop(columns="particle").to_dict("records")
        marks = (
            " ".join(f'{name}="{value!r}"' for name, value in spot.items())
            for spot in spots
        )
        text += (
            "<particle>\n"
            + "".join(f"<detection {m} />\n" for m in marks)
            + "</particle>\n"
        )
    return f"<?xml version='1.0'?>\n{text}</TrackContestISBI2012>\n</root>"
