"""Tables of detections and tracks in files, also for other programs.

=========  ==========================================================================
csv        every column, read and written; also Parquet, by the ending of the file
challenge  XML of the particle tracking challenge (Chenouard et al. 2014; Icy,
           TrackMate)
napari     CSV of a tracks layer: ID, T, (Z,) Y, X
trackmate  TrackMate's table of spots, CSV
trackpy    CSV of a trackpy table: (z,) y, x, frame, particle
=========  ==========================================================================

The last four have the rows in tracks (particle 0 and above), sorted by particle and
frame; ``row`` is y, ``col`` is x, ``plane`` is z. Numbers are written to the last
digit. A file is there whole or not at all.
"""

import csv
import io
from pathlib import Path

import pandas as pd

from kilnflight.checks import InputError, check_columns, check_whole
from kilnflight.store.cache import write_whole
from kilnflight.tables import with_pixels

ENDINGS = ("", ".csv", ".txt", ".parquet")
FORMATS = {  # our columns, in the order and with the names of the other program
    "challenge": {
        "particle": "particle",
        "frame": "t",
        "col": "x",
        "row": "y",
        "plane": "z",
    },
    "napari": {"particle": "ID", "frame": "T", "plane": "Z", "row": "Y", "col": "X"},
    "trackmate": {
        "label": "LABEL",
        "spot": "ID",
        "particle": "TRACK_ID",
        "col": "POSITION_X",
        "row": "POSITION_Y",
        "plane": "POSITION_Z",
        "frame": "FRAME",
    },
    "trackpy": {
        "plane": "z",
        "row": "y",
        "col": "x",
        "frame": "frame",
        "particle": "particle",
    },
}
# Since TrackMate 7 three lines follow the names: long names, short names, units.
SPOT_NAMES = "Label,Spot ID,Track ID,X,Y,Z,Frame\n"
SPOT_LINES = f"{SPOT_NAMES}{SPOT_NAMES},,,(pixel),(pixel),(pixel),\n"


def check_table_target(path: Path, form: str = "csv", source: Path = Path()) -> None:
    """Raise an `InputError` unless a table can get this name and is not the source."""
    there = path.parent.is_dir() and not path.match("/dev/*")
    known = form != "csv" or path.suffix in ENDINGS
    if not (there and known) or path.resolve() == source.resolve():
        raise InputError(
            f"{path}: name another table .csv or .parquet, in a folder that exists."
        )


def read_csv(path: Path) -> pd.DataFrame:
    """Read a table; each line has as many cells as there are names, each name once."""
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
    r"""Read a table of detections or tracks, in any order of columns.

    Parameters
    ----------
    path
        CSV or, by its ending, Parquet.

    Returns
    -------
    DataFrame
        All its columns. Where it has x and y in px and no row and col, as tables of
        other programs, these are renamed.

    Raises
    ------
    InputError
        If it cannot be read or has no frame, row and col.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp(), "spots.csv")
    >>> _ = path.write_text("frame,x,y\n0,7.5,3.0\n1,9.5,3.0\n")
    >>> read_table(path)["col"].tolist()
    [7.5, 9.5]
    """
    try:
        table = pd.read_parquet(path) if path.suffix == ".parquet" else read_csv(path)
    except Exception as error:  # libraries raise anything on damaged bytes
        raise InputError(
            f"{path}: cannot be read ({error}). Give frame, row, col."
        ) from error
    if table.empty:  # its columns have no type
        table = table.astype(int)
    return with_pixels(table)


def write_table(table: pd.DataFrame, path: Path, form: str = "csv") -> None:
    """Write a table of detections or tracks, whole or not at all.

    Parameters
    ----------
    table
        Any table for ``"csv"``; for the other programs frame, particle, row, col (px),
        and plane if there is one.
    path
        The file; with form ``"csv"`` its ending decides between CSV and Parquet.
    form
        ``"csv"`` or one of `FORMATS`.

    Raises
    ------
    InputError
        If the file cannot have that name, or the table is not as described.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp(), "tracks.csv")
    >>> tracks = pd.DataFrame({"frame": [0, 1], "particle": 0, "row": 3.0, "col": 7.5})
    >>> write_table(tracks, path, form="napari")
    >>> path.read_text().split()
    ['ID,T,Y,X', '0,0,3.0,7.5', '0,1,3.0,7.5']
    """
    check_table_target(path, form)
    if form != "csv":
        content = _exported(table, form).encode()
    elif path.suffix == ".parquet":
        content = table.to_parquet()
    else:
        content = csv_of(table).encode()
    write_whole(path, content)


def csv_of(table: pd.DataFrame) -> str:
    """Return a table as CSV; a quote keeps spreadsheets from computing a text."""
    return table.replace(r"^(?=[=+@\t\r-])", "'", regex=True).to_csv(index=False)


def _exported(table: pd.DataFrame, form: str) -> str:
    """Return the rows in tracks as another program reads them."""
    check_columns(table, ["frame", "particle", "row", "col"], "tracks")
    order = ["particle", "frame"]
    whole = {name: check_whole(table[name], f"tracks: {name}") for name in order}
    tracks = table.assign(**whole).query("particle >= 0")
    tracks = tracks.sort_values(order, ignore_index=True)
    if form in ("challenge", "trackmate"):
        tracks = tracks.assign(plane=tracks.get("plane", 0.0), spot=tracks.index)
        tracks["label"] = "ID" + tracks["spot"].astype(str)
    columns = FORMATS[form]
    tracks = tracks.filter([*columns]).rename(columns=columns)
    if form == "challenge":
        return _xml(tracks)
    text = tracks.to_csv(index=False, lineterminator="\n")
    if form == "trackmate":
        text = text.replace("\n", f"\n{SPOT_LINES}", 1)
    return text


def _xml(tracks: pd.DataFrame) -> str:
    """Return the XML of the challenge; it holds nothing but numbers."""
    text = "<?xml version='1.0'?>\n<root>\n"
    text += '<TrackContestISBI2012 snr="" density="" scenario="">\n'
    for _, track in tracks.groupby("particle"):
        text += "<particle>\n"
        for spot in track.drop(columns="particle").to_dict("records"):
            marks = " ".join(f'{name}="{value!r}"' for name, value in spot.items())
            text += f"<detection {marks} />\n"
        text += "</particle>\n"
    return f"{text}</TrackContestISBI2012>\n</root>"
