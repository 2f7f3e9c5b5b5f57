"""The authors' data: DEM tracks, and recordings of their real sorter.

The DEM tracks are those of the 2020 paper.

A DEM file is a zip with one CSV without header. Rows are time steps of 10 ms. Columns alternate x
and y of one particle in metres, ``nan`` while it is not on the belt.

A recording ``NNN.csv`` (or ``.csv.gz``) has a row per frame: its number, the number of measured
midpoints, and x, y of each in pixels, then NaN. ``NNN_trackHistory_NothingDeleted.csv`` has one
pair of columns for each of the authors' tracks. The belt runs along y. Neither the frame rate nor
the size of a pixel is given.
"""

from __future__ import annotations

import os
import zlib
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError
from kilnflight.project import data, paths
from kilnflight.tables import BELT_TRACKS

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

TIME_STEP_S = 0.01  # of the public DEM files; the paper itself evaluated at 0.001 s
MATERIALS = {"spheres": "Kugeln", "wheat": "Weizen", "cylinders": "Zylinder"}
TRACKED = "_trackHistory_NothingDeleted"
ENDINGS = (".csv", ".csv.gz")


def find_dem() -> dict[str, Path]:
    """Return all three bulk materials' DEM files, or nothing if none was fetched.

    Raises
    ------
    InputError
        If a file is damaged, or some but not all are there.
    """
    files = {name: data.find(file) for name, file in data.BELT_DEM.items()}
    there = {name: path for name, path in files.items() if path is not None}
    if there and len(there) < len(files):
        missing = ", ".join(sorted(set(files) - set(there)))
        raise InputError(f"the authors' DEM tracks of {missing} are missing; run make data.")
    return there


def read_dem(path: Path | str) -> pd.DataFrame:
    """Return the tracks of one of the authors' zip files, or of its CSV.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_TRACKS`, x and y in mm; particles without a single
        position have no row. ``attrs["particles"]`` is how many the file has columns for.

    Raises
    ------
    InputError
        If the file is no zip with one CSV, the number of columns is odd, a cell is no number or
        infinite, or only one of x and y is given.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; make data fetches the authors' files.")
    cells = _cells(path, header=None)
    if np.isinf(cells).any():
        row, column = np.argwhere(np.isinf(cells))[0]
        raise InputError(
            f"{path.name}: row {row + 1}, column {column + 1} is infinite. A particle that is not "
            "on the belt is nan."
        )
    frame, particle, x, y = _pairs(cells, path)
    half = np.argwhere(np.isnan(cells[:, 0::2]) != np.isnan(cells[:, 1::2]))
    if len(half):
        row, pair = half[0]
        raise InputError(
            f"{path.name}: row {row + 1}, columns {2 * pair + 1} and {2 * pair + 2}: "
            "only one of x and y is given. Complete the pair or leave both empty."
        )
    columns = (frame, particle, frame * TIME_STEP_S, 1000.0 * x, 1000.0 * y)
    table = pd.DataFrame(dict(zip(BELT_TRACKS.names, columns, strict=True)))
    tracks = table.sort_values(["particle", "frame"], ignore_index=True)
    tracks.attrs["particles"] = cells.shape[1] // 2
    return tracks


def find_recordings() -> dict[str, list[Path]]:
    """Return the files of measured positions by material.

    Where there are none, nothing is returned.

    The folder is ``KILNFLIGHT_RECORDINGS`` if this variable is set, else ``belt_recordings`` beside
    the authors' other data. There ``make data`` puts them, and they must be the published ones.
    Files may be packed (``.csv.gz``).

    Raises
    ------
    InputError
        If the folder of the variable has none, or a file beside the authors' other data is not the
        published one.
    """
    named = os.environ.get("KILNFLIGHT_RECORDINGS")
    folder = Path(named) if named else paths.external() / data.RECORDINGS_FOLDER
    files = {name: _measured(folder / part) for name, part in MATERIALS.items()}
    if not named:
        _check_published(folder)
    elif not any(files.values()):
        raise InputError(
            f"KILNFLIGHT_RECORDINGS is {named}, which has no recording in "
            f"{', '.join(MATERIALS.values())}. Put them there or unset the variable."
        )
    return {name: paths for name, paths in files.items() if paths}


def read_recording(path: Path) -> pd.DataFrame:
    """Return the measured positions of one recording and the authors' track of each.

    Returns
    -------
    DataFrame
        ``frame``, as the file counts (FrameNr); ``x`` along the belt and ``y`` across it in px;
        ``author_track``, the authors' track, -1 where it is in none.

    Raises
    ------
    InputError
        If a file is no table of pairs, or its frame numbers do not ascend.
    """
    cells = _cells(path)
    row, _, across, along = _pairs(cells[:, 2:], path)
    table = pd.DataFrame({"frame": _frames(cells, path)[row], "x": along, "y": across})
    beside = [path.with_name(_stem(path) + TRACKED + ending) for ending in ENDINGS]
    history = next((file for file in beside if file.is_file()), None)
    if history is None:
        return table.assign(author_track=-1)
    _, particle, across, along = _pairs(_cells(history), history)
    tracked = pd.DataFrame({"x": along, "y": across, "author_track": particle})
    merged = table.merge(tracked.drop_duplicates(["x", "y"]), on=["x", "y"], how="left")
    return merged.fillna({"author_track": -1}).astype({"author_track": np.int64})


def _stem(path: Path) -> str:
    return path.name.removesuffix(".gz").removesuffix(".csv")


def _measured(folder: Path) -> list[Path]:
    """Return the recordings of one material, packed or not, each once."""
    every = [path for ending in reversed(ENDINGS) for path in folder.glob(f"*{ending}")]
    by_stem = {_stem(path): path for path in every if TRACKED not in path.name}
    return [by_stem[stem] for stem in sorted(by_stem)]


def _check_published(folder: Path) -> None:
    """Raise an `InputError` if a file that `data.RECORDINGS` lists is another one."""
    for name in data.RECORDINGS:
        plain = folder.parent / name
        for path in (plain, plain.with_name(f"{plain.name}.gz")):
            if path.is_file():
                data.check(path, name)


def _cells(path: Path, header: int | None = 0) -> Array:
    """Return the numbers of a CSV file, packed or not."""
    try:
        table = pd.read_csv(path, header=header)
        return table.to_numpy(dtype=np.float64)
    except (OSError, ValueError, EOFError, BadZipFile, zlib.error, RuntimeError) as error:
        raise InputError(f"{path.name}: no table of numbers ({error}); fetch it again.") from error


def _frames(cells: Array, path: Path) -> Integers:
    """Return FrameNr of each row.

    Frames may be missing, but never come twice or go back.
    """
    numbers = cells[:, 0]
    whole = np.isfinite(numbers) & (numbers == np.round(numbers)) & (numbers >= 0)
    wrong = ~whole | (np.diff(numbers, prepend=-1.0) <= 0)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{path.name}: FrameNr is {numbers[row]} in row {row + 1}; whole numbers must ascend. "
            "Sort the rows by frame, one row each, or give the recordings as separate files."
        )
    return numbers.astype(np.int64)


def _pairs(cells: Array, path: Path) -> tuple[Integers, Integers, Array, Array]:
    """Return row and column of pairs, and both numbers of every pair that is there."""
    if cells.shape[1] % 2:
        raise InputError(
            f"{path.name}: {cells.shape[1]} columns of x and y; one is missing. Fetch it again."
        )
    pairs = cells.reshape(len(cells), cells.shape[1] // 2, 2)
    row, column = np.nonzero(np.isfinite(pairs).all(axis=2))
    return row, column, *pairs[row, column].T
