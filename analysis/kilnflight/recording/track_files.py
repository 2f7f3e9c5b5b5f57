"""Files of tracks, exchanged with other programs.

What they write can be scored, and what we track can be seen there.

==========================  =======================  ==========================================
read                        write                    format
==========================  =======================  ==========================================
`read_challenge`            `write_challenge`        XML of the particle tracking challenge
                                                     (Chenouard et al. 2014; Icy, TrackMate)
`read_trackpy`              `write_trackpy`          CSV of a trackpy table: (z,) y, x, frame,
                                                     particle
`from_trackpy`              `to_trackpy`             the same table in memory
`read_trackmate`            `write_trackmate`        TrackMate's table of spots, CSV
`read_napari`               `write_napari`           CSV of a napari tracks layer: ID, T, (Z,)
                                                     Y, X
`from_napari`               `to_napari`              the same as the layer's array
`read_manual`               `write_manual`           the thesis's ground truth, Fig. 5.11: a
                                                     folder of texts, one per trajectory
==========================  =======================  ==========================================

Every reader returns a table with ``frame``, ``particle``, ``row``, ``col`` and, where the format
has a third axis, ``plane``, sorted by particle and frame; ``row`` is y and ``col`` is x, in the
units of the file and counted from 0 as the file does. Every writer takes such a table, leaves out
rows in no track (particle -1; TrackMate alone has a place for them), and writes numbers so that
they are read back to the last digit. A file is there whole or not at all.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import (
    LARGEST_WHOLE,
    InputError,
    check_columns,
    check_finite,
    check_new,
    check_target,
    check_whole,
)
from kilnflight.project.cache import make_whole
from kilnflight.tables import order_tracks

NAMES = ("frame", "particle", "row", "col", "plane")
# The names of other programs for the same columns, and their order there.
TRACKPY = {"plane": "z", "row": "y", "col": "x", "frame": "frame", "particle": "particle"}
NAPARI = {"particle": "ID", "frame": "T", "plane": "Z", "row": "Y", "col": "X"}
CHALLENGE = {"particle": "particle", "frame": "t", "col": "x", "row": "y", "plane": "z"}
TRACKMATE = dict(
    zip(NAMES, ("FRAME", "TRACK_ID", "POSITION_Y", "POSITION_X", "POSITION_Z"), strict=True)
)
CONTEST = "TrackContestISBI2012"
NO_TRACK = ("", "None")  # as TrackMate 7 and older ones write a spot in no track
# Since version 7 three lines follow the names: long names, short names, units.
HEADER = """LABEL,ID,TRACK_ID,POSITION_X,POSITION_Y,POSITION_Z,FRAME
Label,Spot ID,Track ID,X,Y,Z,Frame
Label,Spot ID,Track ID,X,Y,Z,Frame
,,,(pixel),(pixel),(pixel),
"""


def read_challenge(path: str | Path) -> pd.DataFrame:
    """Return the tracks of a file of the challenge, with ``plane`` (z).

    Particles have no names in this format: they are numbered as they come, from 0. An element
    without detections keeps its number and has no rows.

    Raises
    ------
    InputError
        If the file cannot be read, is no such file, or a detection lacks a number; the message
        names the particle and its detection.
    """
    try:
        root = ElementTree.parse(path, ElementTree.XMLParser(target=_Plain())).getroot()
    except OSError as error:
        again = "Give a file of the challenge."
        raise InputError(f"{path}: cannot be read ({error.strerror}). {again}") from error
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # the latter: its encoding
        raise InputError(f"{path}: is no whole XML file ({error}).") from error
    contest = next(root.iter(CONTEST), None)
    if contest is None:
        raise InputError(f"{path}: has no element {CONTEST}; it is no file of the challenge.")
    for name, place in (("particle", "particle"), ("detection", "particle/detection")):
        if len(list(root.iter(name))) != len(contest.findall(place)):
            raise InputError(
                f"{path}: a {name} stands where the format has none. Move or remove it."
            )
    rows = {
        f"{path}, particle {k}, detection {n}": {**detection.attrib, "particle": str(k)}
        for k, particle in enumerate(contest.iter("particle"))
        for n, detection in enumerate(particle.iter("detection"))
    }
    texts = pd.DataFrame.from_dict(rows, orient="index", dtype=str)
    return _tracks(texts.reindex(columns=list(CHALLENGE.values())).fillna(""), CHALLENGE, path)


class _Plain(ElementTree.TreeBuilder):
    """Elements of a file without a document type.

    A document type's entities could be of any size.
    """

    def doctype(self, *_: object) -> None:
        """Refuse the file before an entity is read."""
        raise ValueError("a document type; files of the challenge have none: remove it")


def write_challenge(tracks: pd.DataFrame, path: str | Path) -> None:
    """Write tracks as a file of the challenge; without ``plane``, z is 0."""
    table = in_tracks(tracks, "write_challenge: tracks")
    table = table.assign(plane=table.get("plane", 0.0)).rename(columns=CHALLENGE)
    root = ElementTree.Element("root")
    contest = ElementTree.SubElement(root, CONTEST, snr="", density="", scenario="")
    for _, track in table.groupby("particle"):
        particle = ElementTree.SubElement(contest, "particle")
        for detection in track[["t", "x", "y", "z"]].to_dict("records"):
            fields = {str(name): repr(number) for name, number in detection.items()}
            ElementTree.SubElement(particle, "detection", fields)
    ElementTree.indent(root)
    _write(path, ElementTree.tostring(root, "unicode", xml_declaration=True))


def from_trackpy(table: pd.DataFrame) -> pd.DataFrame:
    """Return the tracks of a trackpy table; its other columns are left out.

    Examples
    --------
    >>> table = pd.DataFrame({"y": [2.5], "x": [7.0], "frame": [3], "particle": [0], "mass": [9]})
    >>> from_trackpy(table).to_dict("records")
    [{'frame': 3, 'particle': 0, 'row': 2.5, 'col': 7.0}]
    """
    where = "from_trackpy: table"
    check_columns(table, [TRACKPY[name] for name in NAMES[:4]], where)
    ours = {theirs: name for name, theirs in TRACKPY.items()}
    return check_tracks(table.rename(columns=ours), where)


def to_trackpy(tracks: pd.DataFrame) -> pd.DataFrame:
    """Return tracks as trackpy has them, sorted by particle and frame."""
    return _as(TRACKPY, tracks, "to_trackpy: tracks")


def read_trackpy(path: str | Path) -> pd.DataFrame:
    """Return the tracks of a trackpy table saved as CSV, with or without its index."""
    return _tracks(_read_csv(path, TRACKPY), TRACKPY, path)


def write_trackpy(tracks: pd.DataFrame, path: str | Path) -> None:
    """Write tracks as the CSV of a trackpy table, without an index."""
    _write(path, to_trackpy(tracks).to_csv(index=False, lineterminator="\n"))


def read_trackmate(path: str | Path) -> pd.DataFrame:
    """Return the spots of a TrackMate CSV, with ``plane``.

    A spot in no track is particle -1.

    Notes
    -----
    Positions are in the units of TrackMate's calibration (third line below the names) and
    are taken as they are. A track that splits or merges has two spots in one frame;
    both are returned, and `score_tracks` will refuse them.
    """
    texts = _read_csv(path, TRACKMATE, third=True)
    counts = pd.to_numeric(texts["FRAME"], errors="coerce").notna()
    named = (np.arange(len(texts)) < HEADER.count("\n") - 1) & ~counts.cummax()
    texts = texts[~named]
    track = texts["TRACK_ID"].str.strip()
    texts = texts.assign(TRACK_ID=track.where(~track.isin(NO_TRACK), "-1"))
    return _tracks(texts, TRACKMATE, path)


def write_trackmate(tracks: pd.DataFrame, path: str | Path) -> None:
    """Write tracks as a TrackMate CSV; without ``plane``, POSITION_Z is 0."""
    table = check_tracks(tracks, "write_trackmate: tracks")
    table = table.assign(plane=table.get("plane", 0.0), ID=range(len(table)))
    table = table.rename(columns=TRACKMATE).assign(LABEL=[f"ID{spot}" for spot in table["ID"]])
    table["TRACK_ID"] = table["TRACK_ID"].astype(str).replace("-1", "")
    columns = HEADER.split("\n")[0].split(",")
    _write(path, HEADER + table[columns].to_csv(index=False, header=False, lineterminator="\n"))


def from_napari(data: npt.ArrayLike) -> pd.DataFrame:
    """Return the tracks of a layer's data.

    Parameters
    ----------
    data
        (n, 4) ID, T, Y, X or (n, 5) ID, T, Z, Y, X.

    Examples
    --------
    >>> from_napari([[7, 3, 2.5, 9.0]]).to_dict("records")
    [{'frame': 3, 'particle': 7, 'row': 2.5, 'col': 9.0}]
    """
    array = check_finite(data, "from_napari: data")
    if array.ndim != 2 or array.shape[1] not in (4, 5):
        raise InputError(f"from_napari: data has shape {array.shape}, expected (n, 4) or (n, 5).")
    names = [name for name in NAPARI if name != "plane" or array.shape[1] == 5]
    return check_tracks(pd.DataFrame(array, columns=names), "from_napari: data")


def to_napari(tracks: pd.DataFrame) -> npt.NDArray[np.float64]:
    """Return the data of a layer, sorted by ID and T.

    It is (n, 4) or, with ``plane``, (n, 5).
    """
    return _as(NAPARI, tracks, "to_napari: tracks").to_numpy(dtype=np.float64)


def read_napari(path: str | Path) -> pd.DataFrame:
    """Return the tracks of a CSV with the columns ID, T, (Z,) Y, X in any order."""
    return _tracks(_read_csv(path, NAPARI), NAPARI, path)


def write_napari(tracks: pd.DataFrame, path: str | Path) -> None:
    """Write tracks as a CSV with the columns ID, T, (Z,) Y, X."""
    table = _as(NAPARI, tracks, "write_napari: tracks")
    _write(path, table.to_csv(index=False, lineterminator="\n"))


def _as(names: Mapping[str, str], tracks: pd.DataFrame, where: str) -> pd.DataFrame:
    """Return the rows in tracks with the names and the order of another program."""
    table = in_tracks(tracks, where).rename(columns=names)
    return table[[name for name in names.values() if name in table]]


def read_manual(folder: str | Path) -> pd.DataFrame:
    """Return the trajectories of all .txt files of a folder.

    The files have lines of frame, row, col.

    Notes
    -----
    The files are numbered from 0 in the order of their names, 2.txt before 10.txt. A line with
    NaN says that the particle "does not appear in this frame, or it is simply invisible": there
    is no row for it. A file of such lines alone keeps its number and has no rows.
    """
    paths = sorted(Path(folder).glob("*.txt"), key=_natural)
    if not paths:
        raise InputError(f"{folder}: is no folder with .txt files, one per trajectory.")
    rows = {}
    for particle, path in enumerate(paths):
        for line, text in enumerate(_read_text(path).splitlines(), start=1):
            fields = text.split()
            if len(fields) not in (0, 3):
                raise InputError(
                    f"{path}, line {line}: {len(fields)} columns, expected frame, row, col."
                )
            if fields and [field.lower() for field in fields[1:]] != ["nan", "nan"]:
                rows[f"{path}, line {line}"] = [fields[0], str(particle), *fields[1:]]
    texts = pd.DataFrame.from_dict(rows, orient="index", columns=list(NAMES[:4]), dtype=str)
    return _tracks(texts, {name: name for name in NAMES}, folder)


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts numbers in names by their size."""
    return [(int(part or -1), text) for text, part in re.findall(r"(\D*)(\d*)", path.name)]


def write_manual(tracks: pd.DataFrame, folder: str | Path) -> None:
    """Write a new folder with one text per trajectory.

    Each text goes from the first frame to the last.

    Frames in which a trajectory has no row hold NaN; ``plane`` has no place in this format.
    """
    table = in_tracks(tracks, "write_manual: tracks")
    order_tracks(table, "write_manual: tracks")  # a line of this format holds one place
    check_new(Path(folder))
    if table.empty:
        raise InputError("write_manual: tracks holds no track; there is nothing to write.")
    frames = pd.RangeIndex(table["frame"].min(), table["frame"].max() + 1)

    def write(part: Path) -> None:
        part.mkdir()
        for particle, track in table.groupby("particle"):
            lines = track.set_index("frame")[["row", "col"]].reindex(frames)
            text = lines.to_csv(sep="\t", header=False, na_rep="NaN", lineterminator="\n")
            (part / f"trajectory_{particle:04d}.txt").write_text(text)

    _make(folder, write)


def check_tracks(tracks: pd.DataFrame, where: str) -> pd.DataFrame:
    """Return the table's own columns, sorted by particle and frame.

    Otherwise raise an `InputError`.
    """
    check_columns(tracks, NAMES[:4], where)
    names = [name for name in NAMES if name in tracks.columns]
    whole = {name: check_whole(tracks[name], f"{where}: column {name}") for name in NAMES[:2]}
    tracks = tracks[names].assign(**whole)
    check_finite(tracks.to_numpy(), f"{where}, columns {', '.join(names)}")
    if (tracks["particle"] < -1).any():
        raise InputError(f"{where}: particles are numbered from 0, -1 is in no track.")
    tracks = tracks.astype(dict.fromkeys(names[2:], np.float64))
    return tracks.sort_values(["particle", "frame"], kind="stable", ignore_index=True)


def in_tracks(tracks: pd.DataFrame, where: str) -> pd.DataFrame:
    """Return the checked rows that are in a track."""
    checked = check_tracks(tracks, where)
    return checked[checked["particle"] >= 0].reset_index(drop=True)


def _tracks(texts: pd.DataFrame, names: Mapping[str, str], path: str | Path) -> pd.DataFrame:
    """Return the tracks of texts, whose index says where each row stands in its file."""
    columns = {}
    for name, theirs in names.items():
        if theirs in texts:
            columns[name] = numbers = texts[theirs].map(_number).astype(np.float64)
            kind, fits = "finite", numbers.abs() < np.inf
            if name in NAMES[:2]:
                kind, fits = "whole", (numbers % 1 == 0) & (numbers.abs() <= LARGEST_WHOLE)
            if not fits.all():
                row = int(fits.argmin())
                raise InputError(
                    f"{texts.index[row]}, column {theirs}: {texts[theirs].iloc[row]!r} is no "
                    f"{kind} number. Correct or remove the line."
                )
    return check_tracks(pd.DataFrame(columns), str(path))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def _read_text(path: str | Path) -> str:
    """Return a text file, or raise an `InputError` that names it."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"{path}: cannot be read as text ({reason}). Give another file."
        ) from error


def _read_csv(path: str | Path, names: Mapping[str, str], third: bool = False) -> pd.DataFrame:
    """Return the texts of a CSV, indexed by file and line.

    ``third``: plane is needed, too.
    """
    lines = csv.reader(io.StringIO(_read_text(path), newline=""))
    try:
        header = [name.strip() for name in next(lines, [])]
        rows = {f"{path}, line {k}": fields for k, fields in enumerate(lines, start=2) if fields}
    except csv.Error as error:
        raise InputError(f"{path}, after line {lines.line_num - 1}: {error}.") from error
    needed = [names[name] for name in NAMES[: 5 if third else 4]]
    missing = [name for name in needed if name not in header]
    if missing:
        raise InputError(
            f"{path}, line 1: column(s) {', '.join(missing)} missing; it has "
            f"{', '.join(header) or 'none'}."
        )
    for where, fields in rows.items():
        if len(fields) != len(header):
            raise InputError(
                f"{where}: {len(fields)} fields, but line 1 names {len(header)}. The file is cut "
                "off or damaged."
            )
    return pd.DataFrame(list(rows.values()), index=list(rows), columns=header, dtype=str)


def _write(path: str | Path, text: str) -> None:
    """Write a text file; it is there whole or not at all."""
    _make(path, lambda part: part.write_text(text, encoding="utf-8", newline="\n"))


def _make(path: str | Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` make a file or folder that is then there whole.

    It is made in a folder there is.
    """
    check_target(Path(path))
    make_whole(Path(path), write)
