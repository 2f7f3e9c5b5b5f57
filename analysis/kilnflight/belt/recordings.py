"""The authors' recordings of their real sorter: measured positions and their own tracks.

``NNN.csv`` (or ``.csv.gz``) holds, for each frame, its number, how many midpoints were
measured, and x, y of each in pixels (NaN where there are no more);
``NNN_trackHistory_NothingDeleted.csv`` one pair of columns for each track that the authors
found. The belt runs along y. Neither the frame rate nor the size of a pixel is told.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError
from kilnflight.project import data, paths

Array = npt.NDArray[np.float64]

Pairs = tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Array, Array]

MATERIALS = {"spheres": "Kugeln", "wheat": "Weizen", "cylinders": "Zylinder"}
TRACKED = "_trackHistory_NothingDeleted"
ENDINGS = (".csv", ".csv.gz")


def find_recordings() -> dict[str, list[Path]]:
    """Return the files of measured positions by material; nothing where there are none.

    Looked for in the folder that ``KILNFLIGHT_RECORDINGS`` names, else in
    ``belt_recordings`` beside the authors' other data, where ``make data`` puts them and
    they must be the published ones. Packed (``.csv.gz``) they will do as well.

    Raises
    ------
    InputError
        If the folder that is named has none, or a file beside the authors' other data is not the
        published one.
    """
    named = os.environ.get("KILNFLIGHT_RECORDINGS")
    folder = Path(named) if named else paths.external() / data.RECORDINGS_FOLDER
    found = {name: _measured(folder / part) for name, part in MATERIALS.items()}
    if not named:
        _check_published(folder)
    if named and not any(found.values()):
        raise InputError(
            f"KILNFLIGHT_RECORDINGS is {named}, which has no recording in "
            f"{', '.join(MATERIALS.values())}. Put them there or unset the variable."
        )
    return {name: files for name, files in found.items() if files}


def read_recording(path: Path) -> pd.DataFrame:
    """Return the measured positions of one recording and whose they are to its authors.

    Returns
    -------
    DataFrame
        ``frame``, as the file counts (FrameNr); ``x`` along the belt and ``y`` across it in
        px; ``theirs``, the authors' track, -1 where it is in none.

    Raises
    ------
    InputError
        If a file is no table of pairs, or its frame numbers do not ascend.
    """
    cells = _cells(path)
    row, _, across, along = _pairs(cells[:, 2:], path)
    table = pd.DataFrame({"frame": _frames(cells, path)[row], "x": along, "y": across})
    beside = [path.with_name(_stem(path) + TRACKED + ending) for ending in ENDINGS]
    history = next((one for one in beside if one.is_file()), None)
    if history is None:
        return table.assign(theirs=-1)
    _, particle, across, along = _pairs(_cells(history), history)
    theirs = pd.DataFrame({"x": along, "y": across, "theirs": particle})
    both = table.merge(theirs.drop_duplicates(["x", "y"]), on=["x", "y"], how="left")
    return both.fillna({"theirs": -1}).astype({"theirs": np.int64})


def joined(recordings: Iterable[pd.DataFrame], pause: int = 100) -> pd.DataFrame:
    """Return recordings one after the other, ``pause`` frames apart, names of tracks kept apart.

    A recording without a measurement has no last frame: it adds the pause and nothing else.

    Raises
    ------
    InputError
        If there is no recording.
    """
    parts, frame, particle = [], 0, 0
    for one in recordings:
        theirs = one["theirs"].where(one["theirs"] < 0, one["theirs"] + particle)
        parts.append(one.assign(frame=one["frame"] + frame, theirs=theirs))
        frame += pause + (int(one["frame"].max()) if len(one) else 0)
        particle += 1 + (int(one["theirs"].max()) if len(one) else -1)
    if not parts:
        raise InputError("no recording to join; give at least one.")
    return pd.concat(parts, ignore_index=True)


def links(table: pd.DataFrame, column: str) -> pd.MultiIndex:
    """Return which rows follow each other in a track, as pairs of row numbers.

    Rows whose track is -1 are in none.
    """
    name, frame = table[column].to_numpy(), table["frame"].to_numpy()
    order = np.lexsort((frame, name))
    same = (np.diff(name[order]) == 0) & (name[order][:-1] >= 0)
    return pd.MultiIndex.from_arrays([order[:-1][same], order[1:][same]])


def _stem(path: Path) -> str:
    return path.name.removesuffix(".gz").removesuffix(".csv")


def _measured(folder: Path) -> list[Path]:
    """Return the recordings of one material, packed or not, each once."""
    every = [path for ending in reversed(ENDINGS) for path in folder.glob(f"*{ending}")]
    known = {_stem(path): path for path in every if TRACKED not in path.name}
    return [known[stem] for stem in sorted(known)]


def _check_published(folder: Path) -> None:
    """Raise an `InputError` if a file that `data.RECORDINGS` lists is another one."""
    for name in data.RECORDINGS:
        plain = folder.parent / name
        for path in (plain, plain.with_name(f"{plain.name}.gz")):
            if path.is_file():
                data.check(path, name)


def _cells(path: Path) -> Array:
    """Return the numbers of a file."""
    try:
        return pd.read_csv(path).to_numpy(dtype=np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path.name}: no table of numbers ({error}); fetch it again.") from error


def _frames(cells: Array, path: Path) -> npt.NDArray[np.int64]:
    """Return FrameNr of each row; frames may be missing, but never come twice or go back."""
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


def _pairs(cells: Array, path: Path) -> Pairs:
    """Return row, column of pairs, and both numbers of every pair that is there."""
    if cells.shape[1] % 2:
        raise InputError(f"{path.name}: {cells.shape[1]} columns of x and y; one is missing.")
    pairs = cells.reshape(len(cells), cells.shape[1] // 2, 2)
    row, column = np.nonzero(np.isfinite(pairs).all(axis=2))
    first, second = pairs[row, column].T
    return row.astype(np.int64), column.astype(np.int64), first, second
