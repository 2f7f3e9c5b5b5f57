"""The thesis's ground truth of tracking (section 5.2.1, Fig. 5.11): one text per trajectory.

::

    64   NaN          NaN
    65   483.785714   936.285714      frame, row, col
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from kilnflight.checks import InputError
from kilnflight.tracking.files.rows import (
    Row,
    in_tracks,
    make_beside,
    make_tracks,
    number,
    read_text,
    whole,
)


def read_manual(folder: str | Path) -> pd.DataFrame:
    """Return the trajectories of all .txt files of a folder.

    Notes
    -----
    The files are numbered from 0 in the order of their names, 2.txt before 10.txt. A line with
    NaN says that the particle "does not appear in this frame, or it is simply invisible": there
    is no row for it. A file of such lines alone keeps its number and has no rows.
    """
    folder = Path(folder)
    paths = sorted(folder.glob("*.txt"), key=lambda path: _natural(path.name))
    if not paths:
        raise InputError(f"{folder}: is no folder with .txt files, one per trajectory.")
    return make_tracks([row for k, one in enumerate(paths) for row in _rows(one, k)], planes=False)


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts numbers in names by their size."""
    return [(int(part or -1), text) for text, part in re.findall(r"(\D*)(\d*)", name)]


def _rows(path: Path, particle: int) -> Iterator[Row]:
    for line, text in enumerate(read_text(path).splitlines(), start=1):
        fields = text.split()
        where = f"{path}, line {line}"
        if len(fields) not in (0, 3):
            raise InputError(f"{where}: {len(fields)} columns, expected frame, row, col.")
        if not fields:
            continue
        frame = whole(fields[0], f"{where}, column 1")
        if [field.lower() for field in fields[1:]] == ["nan", "nan"]:
            continue
        row, col = (number(fields[k], f"{where}, column {k + 1}") for k in (1, 2))
        yield frame, particle, row, col


def write_manual(tracks: pd.DataFrame, folder: str | Path) -> None:
    """Write a new folder with one text per trajectory, each from the first frame to the last.

    Frames in which a trajectory has no row hold NaN; ``plane`` has no place in this format.
    """
    table = in_tracks(tracks, "write_manual: tracks")
    folder = Path(folder)
    if folder.exists():
        raise InputError(f"{folder}: exists already. Delete it or choose another folder.")
    if table.empty:
        raise InputError("write_manual: tracks holds no track, and a folder without files is none.")
    make_beside(folder, lambda part: _write(table, part))


def _write(table: pd.DataFrame, folder: Path) -> None:
    folder.mkdir()
    missing = "NaN\tNaN"
    frames = range(table["frame"].min(), table["frame"].max() + 1)
    for particle, of_one in table.groupby("particle"):
        columns = [of_one[name].tolist() for name in ("frame", "row", "col")]
        known = {t: f"{row!r}\t{col!r}" for t, row, col in zip(*columns, strict=True)}
        lines = "".join(f"{t}\t{known.get(t, missing)}\n" for t in frames)
        (folder / f"trajectory_{particle:04d}.txt").write_text(lines)
