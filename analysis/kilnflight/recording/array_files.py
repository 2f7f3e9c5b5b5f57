"""Images, arrays and points in the files of other programs.

The ending of a file names its format:

=====================  =====================================================
TIFF, PNG              the image
NPY, NPZ               the array; in an NPZ the one named by the key
MAT                    the variable named by the key; v7.3 in MATLAB's order of axes
HDF5 (.h5, .hdf5)      the data set named by the key, for example ``a/gray``
CSV, PLY               points only, by the names of their columns
=====================  =====================================================

A key may be left out where a file holds one array. Every file that cannot be read ends in an
`InputError` that names it.
"""

from __future__ import annotations

import logging
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import pandas as pd
import plyfile
import scipy.io
import tifffile
from PIL import Image
from scipy.io.matlab import MatReadError

from kilnflight.checks import InputError

# What the libraries raise on files that are cut, damaged or of another kind. SyntaxError: Pillow,
# on a broken PNG; MemoryError: a damaged header may announce any size.
UNREADABLE = (EOFError, LookupError, MemoryError, OSError, SyntaxError, TypeError, ValueError)
DAMAGED = (MatReadError, plyfile.PlyParseError, struct.error, zipfile.BadZipFile, zlib.error)


def read_array(path: Path, key: str | None, where: str) -> npt.NDArray[Any]:
    """Return the array in a file, in the byte order of this machine.

    Parameters
    ----------
    path
        The file.
    key
        Name of the variable or data set, for formats that hold several.
    where
        What the error names besides the file.

    Raises
    ------
    InputError
        If the file is missing, damaged, of an unknown kind, or lacks the key.
    """
    ending = path.suffix.lower()
    if ending not in ARRAYS:
        raise InputError(f"{where}: {path} is not one of {', '.join(sorted(ARRAYS))}; convert it.")
    with _reading(path, where):
        array = ARRAYS[ending](path, key)
    if array.dtype.names is None and array.dtype.kind not in "biuf":
        raise InputError(f"{where}: {path} holds {array.dtype}, expected numbers.")
    if not array.size and array.ndim != 2:  # how tifffile answers to a cut TIFF
        raise InputError(f"{where}: {path} holds no data; it is cut off or empty.")
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def read_points(
    path: Path, key: str | None, columns: Sequence[str], where: str
) -> npt.NDArray[np.float64]:
    """Return (n, 5) float64: row, col, x, y, z.

    They come from columns of these names or in this order.

    CSV, PLY and structured arrays are read by name, plain arrays by position.
    """
    ending = path.suffix.lower()
    if ending not in TABLES:
        array = read_array(path, key, where)
        if array.dtype.names is None:
            if array.ndim != 2 or array.shape[1] != len(columns):
                raise InputError(
                    f"{where}: {path} has shape {array.shape}, expected (n, {len(columns)}) for "
                    f"{', '.join(columns)}."
                )
            return array.astype(np.float64)
    with _reading(path, where):
        table = TABLES[ending](path) if ending in TABLES else pd.DataFrame(array)
        missing = [name for name in columns if name not in table]
        if missing:
            raise ValueError(f"no column {', '.join(missing)}; it has {', '.join(map(str, table))}")
        return table[list(columns)].to_numpy(np.float64)


@contextmanager
def _reading(path: Path, where: str) -> Iterator[None]:
    """Raise an `InputError` that names the file instead of what the libraries raise."""
    try:
        yield
    except (*UNREADABLE, *DAMAGED) as error:
        reason = " ".join(str(error).split()) or "cut off"
        raise InputError(
            f"{where}: {path} cannot be read ({type(error).__name__}: {reason}). It is cut off, "
            "damaged, or not what its ending says."
        ) from error


def _tiff(path: Path, key: str | None) -> npt.NDArray[Any]:
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # it would print what we raise
    try:
        return tifffile.imread(path)
    except ValueError as error:
        if "imagecodecs" not in str(error):
            raise
    return _picture(path, key)  # LZW and the like, which Pillow knows


def _picture(path: Path, key: str | None) -> npt.NDArray[Any]:
    with Image.open(path) as image:
        array = np.asarray(image)
        # older versions of Pillow open 16-bit PNGs as 32-bit integers
        return array.astype(np.uint16) if image.mode == "I" else array


def _numpy(path: Path, key: str | None) -> npt.NDArray[Any]:
    with path.open("rb") as file:
        content = np.load(file, allow_pickle=False)
        archived = isinstance(content, np.lib.npyio.NpzFile)
        return np.asarray(content[_chosen(key, content.files)] if archived else content)


def _mat(path: Path, key: str | None) -> npt.NDArray[Any]:
    if h5py.is_hdf5(path):  # v7.3 keeps MATLAB's order of axes, the last one first
        return _hdf5(path, key).T
    name = _chosen(key, [name for name, _, _ in scipy.io.whosmat(path)])
    return np.asarray(scipy.io.loadmat(path, variable_names=[name])[name])


def _hdf5(path: Path, key: str | None) -> npt.NDArray[Any]:
    with h5py.File(path, "r") as file:
        names: list[str] = []
        file.visititems(
            lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None
        )
        return np.asarray(file[_chosen(key and key.strip("/"), names)][()])


def _chosen(key: str | None, names: Sequence[str]) -> str:
    if key is None and len(names) == 1:
        return names[0]
    if key is None or key not in names:
        fault = "needs a key" if key is None else f"has no {key!r}"
        raise ValueError(f"it {fault}; it holds {', '.join(names) or 'nothing'}")
    return key


def _csv(path: Path) -> pd.DataFrame:
    lines = path.read_bytes().rstrip().split(b"\n")
    if lines[-1].count(b",") != lines[0].count(b","):
        raise ValueError("its last line has fewer columns than its first")
    return pd.read_csv(path, skipinitialspace=True)


TABLES: dict[str, Callable[[Path], pd.DataFrame]] = {
    ".csv": _csv,
    ".ply": lambda path: pd.DataFrame(plyfile.PlyData.read(path)["vertex"].data),
}
ARRAYS: dict[str, Callable[[Path, str | None], npt.NDArray[Any]]] = {
    **dict.fromkeys((".tif", ".tiff"), _tiff),
    **dict.fromkeys((".npy", ".npz"), _numpy),
    **dict.fromkeys((".h5", ".hdf5"), _hdf5),
    ".png": _picture,
    ".mat": _mat,
}
