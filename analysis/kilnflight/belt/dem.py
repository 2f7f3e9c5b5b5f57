"""The authors' DEM tracks (2020 paper): from their CSV to a table.

Each file is a zip with one CSV without header: rows are time steps of 10 ms, columns
alternate x and y of one particle in metres, ``nan`` while it is not on the belt.
"""

from __future__ import annotations

import warnings
import zipfile
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError
from kilnflight.project import data
from kilnflight.tables import BELT_TRACKS

TIME_STEP_S = 0.01  # of the public files; the paper itself evaluated at 0.001 s


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
        If the file is no zip with one CSV, its rows differ in length, a cell is no
        number, the number of columns is odd, or only one of x and y is given.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; make data fetches the authors' files.")
    cells = _cells(path)
    if not cells.size:
        raise InputError(f"{path.name}: no row in it; fetch the file again.")
    if np.isinf(cells).any():
        row, column = np.argwhere(np.isinf(cells))[0]
        raise InputError(
            f"{path.name}: row {row + 1}, column {column + 1} is infinite. A particle that is not "
            "on the belt is nan."
        )
    if cells.shape[1] % 2:
        raise InputError(
            f"{path.name}: {cells.shape[1]} columns, but x and y of each particle make an even "
            "number. A column is missing; fetch the file again."
        )
    x, y = cells[:, 0::2], cells[:, 1::2]
    seen = ~np.isnan(x)
    torn = np.argwhere(seen != ~np.isnan(y))
    if len(torn):
        frame, particle = torn[0]
        raise InputError(
            f"{path.name}: row {frame + 1}, columns {2 * particle + 1} and {2 * particle + 2}: "
            "only one of x and y is given. Complete the pair or leave both empty."
        )
    particle, frame = np.nonzero(seen.T)
    tracks = pd.DataFrame(
        {
            "frame": frame,
            "particle": particle,
            "time_s": frame * TIME_STEP_S,
            "x": 1000.0 * x[frame, particle],
            "y": 1000.0 * y[frame, particle],
        }
    )[BELT_TRACKS.names]
    tracks.attrs["particles"] = x.shape[1]
    return tracks


def _cells(path: Path) -> npt.NDArray[np.float64]:
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "loadtxt: input contained no data")  # told by us
            return _load(path)
    except (zipfile.BadZipFile, EOFError, zlib.error, RuntimeError) as error:
        raise InputError(f"{path.name}: no whole zip file ({error}); fetch it again.") from error
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path.name}: not a table of numbers: {error}.") from error


def _load(path: Path) -> npt.NDArray[np.float64]:
    if path.suffix != ".zip":
        return np.loadtxt(path, delimiter=",", ndmin=2)
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        if len(names) != 1:
            raise InputError(f"{path.name}: holds {len(names)} files, expected one CSV.")
        with archive.open(names[0]) as text:
            return np.loadtxt(text, delimiter=",", ndmin=2)


def find_dem() -> dict[str, Path]:
    """Return the files of all three bulk materials, or nothing if none was fetched.

    Raises
    ------
    InputError
        If a file is damaged, or some but not all are there.
    """
    found = {name: data.find(file) for name, file in data.BELT_DEM.items()}
    there = {name: path for name, path in found.items() if path is not None}
    if there and len(there) < len(found):
        missing = ", ".join(sorted(set(found) - set(there)))
        raise InputError(f"the authors' DEM tracks of {missing} are missing; run make data.")
    return there
