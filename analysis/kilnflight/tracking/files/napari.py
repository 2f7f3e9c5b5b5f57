"""Tracks layers of napari: ID, T, (Z,) Y, X, as an array or as the columns of a CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError, check_finite
from kilnflight.tracking.files.rows import csv_text, in_tracks, make_tracks, read_table, write_lines


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
    if (array[:, :2] != np.floor(array[:, :2])).any() or (array[:, 0] < -1).any():
        raise InputError("from_napari: ID and T must be whole numbers, ID not below 0.")
    order = [1, 0, 2, 3] if array.shape[1] == 4 else [1, 0, 3, 4, 2]
    rows = list(map(tuple, array[:, order].tolist()))
    return make_tracks(rows, planes=array.shape[1] == 5)


def to_napari(tracks: pd.DataFrame) -> npt.NDArray[np.float64]:
    """Return the data of a layer, (n, 4) or, with ``plane``, (n, 5), sorted by ID and T."""
    table = _layer(tracks, "to_napari: tracks")
    return table.to_numpy(dtype=np.float64)


def read_napari(path: str | Path) -> pd.DataFrame:
    """Return the tracks of a CSV with the columns ID, T, (Z,) Y, X in any order."""
    return read_table(Path(path), ("T", "ID", "Y", "X"), "Z")


def write_napari(tracks: pd.DataFrame, path: str | Path) -> None:
    """Write tracks as a CSV with the columns ID, T, (Z,) Y, X."""
    write_lines(Path(path), [csv_text(_layer(tracks, "write_napari: tracks"))])


def _layer(tracks: pd.DataFrame, where: str) -> pd.DataFrame:
    names = {"particle": "ID", "frame": "T", "plane": "Z", "row": "Y", "col": "X"}
    table = in_tracks(tracks, where).rename(columns=names)
    return table[[name for name in names.values() if name in table]]
