"""Tables of detections and tracks in files, also for other programs.

=========  ==========================================================================
csv        every column, read and written; also Parquet, by the ending of the file
challenge  XML of the particle tracking challenge (Chenouard et al. 2014; Icy); also
           the simple XML of tracks of TrackMate
napari     CSV of a tracks layer: ID, T, (Z,) Y, X
trackmate  TrackMate's table of spots, CSV
trackpy    CSV of a trackpy table: particle, frame, (z,) y, x
btrack     CSV: ID, t, (z,) y, x
laptrack   CSV: track_id, frame, (z,) y, x
=========  ==========================================================================

The last six have the rows in tracks (particle 0 and above), sorted by particle and
frame; ``row`` is y, ``col`` is x, ``plane`` is z. Numbers are written to the last
digit. A file is there whole or not at all. `read_table` reads each of them, whatever
its ending. Lines of numbers without names are MOTChallenge's: frame from 1, id (-1:
none), left, top, width, height. A box becomes its middle, left + width / 2.
"""

import csv
import io
import os
import re
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from pandas import DataFrame

from kilnflight.checks import InputError, check_columns, check_number
from kilnflight.store.cache import is_device, write_whole
from kilnflight.tables import FORMATS, in_tracks, with_pixels

MOST_COLUMNS = 10_000  # more take minutes
ENDINGS = {"csv": ("", ".csv", ".txt", ".parquet"), "challenge": ("", ".xml")}
# Since TrackMate 7 three lines follow the names: long names, short names, units.
SPOT_NAMES = "Label,Spot ID,Track ID,Frame,Z,Y,X\n"
SPOT_LINES = f"{SPOT_NAMES}{SPOT_NAMES},,,,(pixel),(pixel),(pixel)\n"
UNIT = r'(spaceUnits="|\n,.*\()(micron|inch|.m)\b'  # of its XML, and of that line


def check_table_target(path: Path, form: str = "csv", source: Path = Path()) -> None:
    """Raise an `InputError` unless a table can get this name and is not the source."""
    place = Path(os.path.realpath(path))  # resolve() raises for links in a circle
    there = place.parent.is_dir() and not is_device(path)
    known = path.suffix in ENDINGS.get(form, ("", ".csv"))
    if not (there and known) or place == source.resolve():
        raise InputError(
            f"{path}: name another table .csv (csv: or .parquet; challenge: .xml), in "
            "a folder that exists."
        )


def read_text(path: Path) -> DataFrame:
    """Read a table; each line has as many cells as there are names, each name once.

    Between them are commas; where the names have none, semicolons or tabs.
    """
    text = path.read_text("utf-8-sig")
    unit = re.search(UNIT, text)
    if unit:
        told = f"positions are in {unit[2]} and taken as px: give px, or divide them"
        warnings.warn(f"{path}: {told} by the width of a pixel", stacklevel=2)
    if text.startswith("<"):
        return _read_xml(text)
    if not text.endswith("\n"):
        warnings.warn(f"{path}: its last line has no end. Is it whole?", stacklevel=2)
    if "," not in text.partition("\n")[0]:
        text = text.translate(str.maketrans(",;\t", ".,,"))
    rows = csv.reader(io.StringIO(text), skipinitialspace=True)
    names = next(rows, [""])
    if names[0].isdecimal():
        return _read_boxes(text)
    check_number(len(names), "columns", most=MOST_COLUMNS)
    check_columns(DataFrame(columns=names), names, "its first line")
    for row in rows:
        if len(row) not in (0, len(names)):
            raise InputError(f"line {rows.line_num}: {len(row)} cells of {len(names)}")
    skipped = None
    if "\nLabel,Spot ID," in text:
        skipped = [1, 2, 3]  # lines of TrackMate
    return pd.read_csv(io.StringIO(text), skipinitialspace=True, skiprows=skipped)


def _read_xml(text: str) -> DataFrame:
    """Return the detections of the challenge's XML."""
    root = ElementTree.fromstring(text)
    if root.tag not in ("root", "Tracks"):
        raise InputError(f"XML of {root.tag}; in TrackMate: Export tracks to XML file")
    if "".join(root.itertext()).strip():
        raise InputError("it holds text between its tags")
    rows = []
    for number, track in enumerate(root.iter("particle")):
        rows += [place.attrib | {"particle": number} for place in track]
    return DataFrame(rows, columns=[*FORMATS["challenge"].values()]).astype(float)


def _read_boxes(text: str) -> DataFrame:
    """Return the middles of MOTChallenge's boxes; number -1 is no track."""
    cells = np.loadtxt(io.StringIO(text), delimiter=",", usecols=range(6), ndmin=2)
    check_number(cells[:, 0].min(), "MOTChallenge's frames, from 1", least=1)
    cells[:, 0] -= 1
    cells[:, 2:4] += cells[:, 4:] / 2
    table = DataFrame(cells[:, :4], columns=["frame", "particle", "col", "row"])
    return table.replace({"particle": {-1: np.nan}})


def read_table(path: Path | str) -> DataFrame:
    r"""Read a table of detections or tracks, in any order of columns.

    Parameters
    ----------
    path
        CSV, XML or text; or, by its ending, Parquet.

    Returns
    -------
    DataFrame
        All its columns. Where it has the names of another program and no row and col,
        as in `kilnflight.tables.FORMATS`, these are renamed.

    Warns
    -----
    UserWarning
        If positions are not in px, or the last line has no line break.

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
    return with_pixels(read_columns(Path(path), "frame, row, col"))


def read_columns(path: Path, needed: str) -> DataFrame:
    """Read a table with any columns, as `read_table`; errors name those ``needed``."""
    try:
        if path.suffix == ".parquet":
            table = pd.read_parquet(path, page_checksum_verification=True)
        else:
            table = read_text(path)
    except Exception as error:  # libraries raise anything on damaged bytes
        raise InputError(f"{path}: cannot be read ({error}). Give {needed}.") from error
    if table.empty:  # its columns have no type
        table = table.astype(int)
    return table


def write_table(table: DataFrame, path: Path, form: str = "csv") -> None:
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
    check_columns(table, getattr(table, "columns", ()), "table")
    if form != "csv":
        content = _exported(table, form).encode()
    elif path.suffix == ".parquet":
        content = table.to_parquet(write_page_checksum=True)
    else:
        content = csv_of(table).encode()
    write_whole(path, content)


def csv_of(table: DataFrame) -> str:
    """Return a table as CSV; a quote keeps spreadsheets from computing a text."""
    return table.replace(r"^(?=[=+@\t\r-])", "'", regex=True).to_csv(index=False)


def _exported(table: DataFrame, form: str) -> str:
    """Return the rows in tracks as another program reads them."""
    table = with_pixels(table).reset_index(drop=True)
    tracks = in_tracks(table, "tracks")
    if "plane" in table or form in ("challenge", "trackmate"):
        tracks = tracks.assign(plane=table.get("plane", 0.0))
    columns = FORMATS[form]
    if form == "trackmate":
        spot = np.arange(len(tracks))
        tracks = tracks.assign(label=[f"ID{k}" for k in spot], spot=spot)
        columns = {"label": "LABEL", "spot": "ID"} | columns
    tracks = tracks.filter([*columns]).rename(columns=columns)
    if form == "challenge":
        return _xml(tracks)
    text = tracks.to_csv(index=False, lineterminator="\n")
    if form == "trackmate":
        text = text.replace("\n", f"\n{SPOT_LINES}", 1)
    return text


def _xml(tracks: DataFrame) -> str:
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
