"""What all formats share: the table of tracks, numbers in text, files that are whole."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from kilnflight.checks import InputError, check_columns, check_finite, check_whole
from kilnflight.project.cache import make_whole

# A reader's row: frame, particle, row, col and, with a third axis, plane.
Row = tuple[int, int, float, float] | tuple[int, int, float, float, float]
NAMES = ("frame", "particle", "row", "col", "plane")


def make_tracks(rows: Sequence[Row], planes: bool) -> pd.DataFrame:
    """Return the table of rows, sorted by particle and frame, with or without ``plane``."""
    names = NAMES if planes else NAMES[:4]
    table = pd.DataFrame(list(rows), columns=list(names))
    table = table.astype({name: np.int64 if name in NAMES[:2] else np.float64 for name in names})
    return table.sort_values(["particle", "frame"], kind="stable", ignore_index=True)


def check_tracks(tracks: pd.DataFrame, where: str) -> pd.DataFrame:
    """Return the table's own columns, sorted by particle and frame, or raise an `InputError`."""
    check_columns(tracks, NAMES[:4], where)
    names = [name for name in NAMES if name in tracks.columns]
    whole = {name: check_whole(tracks[name], f"{where}: column {name}") for name in NAMES[:2]}
    tracks = tracks.assign(**whole)
    check_finite(tracks[names].to_numpy(), f"{where}, columns {', '.join(names)}")
    if (tracks["particle"] < -1).any():
        raise InputError(f"{where}: particles are numbered from 0, -1 is in no track.")
    return tracks[names].sort_values(["particle", "frame"], kind="stable", ignore_index=True)


def in_tracks(tracks: pd.DataFrame, where: str) -> pd.DataFrame:
    """Return the checked rows that are in a track."""
    checked = check_tracks(tracks, where)
    return checked[checked["particle"] >= 0].reset_index(drop=True)


def number(text: str, where: str) -> float:
    """Return a finite number, or raise an `InputError`."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {text!r} is no finite number. Correct or remove the line.")
    return value


def whole(text: str, where: str) -> int:
    """Return a whole number, which may be written as 3.0, or raise an `InputError`."""
    value = number(text, where)
    if not value.is_integer() or abs(value) > 2**53:
        raise InputError(f"{where}: {text!r} is no whole number. Correct or remove the line.")
    return int(value)


def read_text(path: Path) -> str:
    """Return a text file, or raise an `InputError` that names it."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error}).") from error


def read_csv(
    path: Path, required: Sequence[str]
) -> tuple[list[str], Iterator[tuple[int, Mapping[str, str]]]]:
    """Return the names of the first line, and each further line's number and fields by name."""
    lines = csv.reader(io.StringIO(read_text(path), newline=""))
    header = [name.strip() for name in next(lines, [])]
    missing = [name for name in required if name not in header]
    if missing:
        raise InputError(
            f"{path}, line 1: column(s) {', '.join(missing)} missing; it has "
            f"{', '.join(header) or 'none'}."
        )
    return header, _fields(path, header, lines)


def _fields(
    path: Path, header: Sequence[str], lines: Iterator[list[str]]
) -> Iterator[tuple[int, Mapping[str, str]]]:
    line = 1
    try:
        for line, fields in enumerate(lines, start=2):
            if len(fields) not in (0, len(header)):
                raise InputError(
                    f"{path}, line {line}: {len(fields)} fields, but line 1 names {len(header)}. "
                    "The file is cut off or damaged."
                )
            if fields:
                yield line, dict(zip(header, fields, strict=True))
    except csv.Error as error:
        raise InputError(f"{path}, after line {line}: {error}.") from error


def read_table(path: Path, names: Sequence[str], third: str) -> pd.DataFrame:
    """Return tracks from a CSV; ``names`` of frame, particle, row, col, ``third`` of plane."""
    header, lines = read_csv(path, names)
    used = [*names, third] if third in header else list(names)
    rows: list[Row] = []
    for line, fields in lines:
        where = [f"{path}, line {line}, column {name}" for name in used]
        t, k = (whole(fields[name], at) for name, at in zip(used[:2], where[:2], strict=True))
        place = [number(fields[name], at) for name, at in zip(used[2:], where[2:], strict=True)]
        rows.append((t, k, *place))  # type: ignore[arg-type]
    return make_tracks(rows, planes=third in header)


def csv_text(table: pd.DataFrame) -> str:
    """Return a table as CSV; a number is read back to the last digit."""
    lines = [",".join(map(str, table.columns))]
    columns = [map(repr, table[name].tolist()) for name in table.columns]
    return "\n".join(lines + [",".join(fields) for fields in zip(*columns, strict=True)]) + "\n"


def make_beside(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` make a file or folder that is then there whole, in a folder there is."""
    if not path.parent.is_dir():
        raise InputError(f"{path}: its folder does not exist. Make it first.")
    make_whole(path, write)


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Write a text file; it is there whole or not at all."""
    make_beside(path, lambda part: part.write_text("".join(lines), encoding="utf-8", newline="\n"))
