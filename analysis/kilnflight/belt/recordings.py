"""Read the authors' data: DEM tracks, and recordings of their real sorter.

The DEM tracks are those of the 2020 paper. A DEM file is a zip with one CSV without
header. Rows are time steps of 10 ms. Columns alternate x and y of one particle in
metres, ``nan`` while it is not on the belt.

A recording ``NNN.csv`` (or ``.csv.gz``) has a row per frame: its number, the number of
measured midpoints, and x, y of each in pixels, then NaN.
``NNN_trackHistory_NothingDeleted.csv`` has one pair of columns for each of the authors'
tracks. In the files the belt runs along y; in our tables it runs along x. Frame time
and size of a pixel stand in the models of the same repository
(KIT-ISAS/TrackSort_Neural_Public, branch jakob_master, cv_model.py and main.py).
"""

from pathlib import Path

import numpy as np
import pandas as pd
from pandas import DataFrame

from kilnflight.arrays import Array, Index
from kilnflight.checks import InputError

TIME_STEP_S = 0.01  # public DEM files; the paper itself evaluated at 0.001 s
REAL_FRAME_S = 0.005  # cv_model.py: dt
MM_PER_PX = 0.056  # cv_model.py: "1 Pixel = 0.056 mm"
# The authors predict from here: main.py, virtual_belt_edge_x_position.
CAMERA_END_PX = 800.0
# main.py: virtual_nozzle_array_x_position; cv_model.py: x_pred_to.
NOZZLES_PX = 1550.0
MATERIAL_FOLDERS = {"spheres": "Kugeln", "wheat": "Weizen", "cylinders": "Zylinder"}
HISTORY = "_trackHistory_NothingDeleted"
ENDINGS = (".csv", ".csv.gz")


def read_dem(path: Path) -> DataFrame:
    """Return the tracks of particles that the authors simulated (2020 paper).

    They used the discrete element method (DEM). A file is a zip with one CSV, or that
    CSV.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_TRACKS` by particle and frame, x and y in mm; particles
        without a single position have no row. ``attrs["particles"]`` is the number of
        particles in the file.

    Raises
    ------
    InputError
        If the file is no zip with one CSV, the number of columns is odd, a cell is no
        number or infinite, or only one of x and y is given.
    """
    cells = _cells(path, header=None)
    frame, particle, x, y = _pairs(cells, path)
    given = ~np.isnan(cells)
    if np.isinf(cells).any() or (given[:, 0::2] != given[:, 1::2]).any():
        raise InputError(
            f"{path.name}: x and y must both be finite, or both nan off the belt."
        )
    table = DataFrame({"frame": frame, "particle": particle})
    table["time_s"] = frame * TIME_STEP_S
    table["x"] = 1000.0 * x
    table["y"] = 1000.0 * y
    tracks = table.sort_values(["particle", "frame"], ignore_index=True)
    tracks.attrs["particles"] = cells.shape[1] // 2
    return tracks


def list_recordings(folder: Path) -> dict[str, list[Path]]:
    """Return the files of measured positions in a folder by material, sorted.

    Keys are those of `MATERIAL_FOLDERS` that have files. Of a file that is there packed
    and unpacked, the unpacked one is returned.
    """
    files = {}
    for name, part in MATERIAL_FOLDERS.items():
        by_stem = {}
        for ending in reversed(ENDINGS):
            for path in (folder / part).glob(f"*{ending}"):
                if HISTORY not in path.name:
                    by_stem[_stem(path)] = path
        if by_stem:
            files[name] = [by_stem[stem] for stem in sorted(by_stem)]
    return files


def read_recording(path: Path) -> DataFrame:
    """Return the measured positions of one recording and the authors' track of each.

    Returns
    -------
    DataFrame
        ``frame``, as the file counts (FrameNr); ``x`` along the belt and ``y`` across
        it in px; ``author_track``, the authors' track, -1 where it is in none.

    Raises
    ------
    InputError
        If a file is no table of pairs, or its frame numbers do not ascend.
    """
    cells = _cells(path)
    row, _, across, along = _pairs(cells[:, 2:], path)
    number = cells[:, 0]
    # Frames may be missing, but never come twice or go back.
    ascends = np.diff(number, prepend=-1.0) > 0
    if not ((number % 1 == 0) & ascends).all():
        raise InputError(
            f"{path.name}: FrameNr must be whole numbers that ascend, a row each."
        )
    frame = number.astype(np.int64)[row]
    table = DataFrame({"frame": frame, "x": along, "y": across})
    beside = [path.with_name(_stem(path) + HISTORY + ending) for ending in ENDINGS]
    history = next((file for file in beside if file.is_file()), None)
    if history is None:
        return table.assign(author_track=-1)
    _, particle, across, along = _pairs(_cells(history), history)
    tracked = DataFrame({"x": along, "y": across, "author_track": particle})
    merged = table.merge(tracked.drop_duplicates(["x", "y"]), on=["x", "y"], how="left")
    return merged.fillna({"author_track": -1}).astype({"author_track": np.int64})


def _stem(path: Path) -> str:
    return path.name.removesuffix(".gz").removesuffix(".csv")


def _cells(path: Path, header: int | None = 0) -> Array:
    """Return the numbers (rows, columns) of a CSV file, packed or not.

    ``header`` is the line of the column names, None if there is none.
    """
    try:
        return pd.read_csv(path, header=header).to_numpy(float)
    except Exception as error:  # libraries raise anything on damaged bytes
        raise InputError(
            f"{path.name}: no table of numbers ({error}); fetch it again."
        ) from error


def _pairs(cells: Array, path: Path) -> tuple[Index, Index, Array, Array]:
    """Return row, pair of columns, and both numbers of each finite pair, (n,) each.

    Columns 2 k and 2 k + 1 of ``cells`` (rows, columns) are pair k, one place or
    particle.
    """
    if cells.shape[1] % 2:
        raise InputError(
            f"{path.name}: {cells.shape[1]} columns of x and y; one is missing."
        )
    pairs = cells.reshape(len(cells), cells.shape[1] // 2, 2)
    row, column = np.nonzero(np.isfinite(pairs).all(axis=2))
    return row, column, *pairs[row, column].T
