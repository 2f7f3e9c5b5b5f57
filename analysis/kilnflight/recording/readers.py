"""One file -> one array, whatever program wrote it; the ending tells the format.

=====================  =====================================================
TIFF, PNG              the image
NPY, NPZ               the array; in an NPZ the one named by the key
MAT                    the variable named by the key; v7.3 in MATLAB's order of axes
HDF5 (.h5, .hdf5)      the data set named by the key, for example ``a/gray``
CSV, PLY               points only, by the names of their columns
=====================  =====================================================

A key may be left out where a file holds one array. Every file that cannot be read ends
in an `InputError` that names it.
"""

from __future__ import annotations

import logging
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
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

# What the libraries raise on files that are cut, damaged or of another kind.
UNREADABLE = (
    EOFError,
    IndexError,
    KeyError,
    MatReadError,
    MemoryError,  # a damaged header may announce any size
    OSError,
    SyntaxError,  # Pillow, on a broken PNG
    TypeError,
    ValueError,  # among them those of pandas, tifffile and numpy
    plyfile.PlyParseError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


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
    array = _guarded(lambda: _ARRAYS[_ending(path, _ARRAYS, where)](path, key), path, where)
    if array.dtype.names is None and array.dtype.kind not in "biuf":
        raise InputError(f"{where}: {path} holds {array.dtype}, expected numbers.")
    if not array.size and array.ndim != 2:  # how tifffile answers to a cut TIFF
        raise InputError(f"{where}: {path} holds no data; it is cut off or empty.")
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def read_points(
    path: Path, key: str | None, columns: Sequence[str], where: str
) -> npt.NDArray[np.float64]:
    """Return (n, 5) float64: row, col, x, y, z, from columns of these names or in this order.

    CSV, PLY and structured arrays are read by name, plain arrays by position.
    """
    if path.suffix.lower() in (".csv", ".ply"):
        reader = _csv if path.suffix.lower() == ".csv" else _ply
        return _guarded(lambda: reader(path, columns), path, where)
    array = read_array(path, key, where)
    if array.dtype.names is not None:
        return _guarded(lambda: _by_name(array, columns), path, where)
    if array.ndim != 2 or array.shape[1] != len(columns):
        raise InputError(
            f"{where}: {path} has shape {array.shape}, expected (n, {len(columns)}) for "
            f"{', '.join(columns)}."
        )
    return array.astype(np.float64)


def _ending(path: Path, known: Mapping[str, object], where: str) -> str:
    ending = path.suffix.lower()
    if ending not in known:
        raise InputError(f"{where}: {path} is none of {', '.join(sorted(known))}.")
    return ending


def _guarded(read: Callable[[], npt.NDArray[Any]], path: Path, where: str) -> npt.NDArray[Any]:
    try:
        return read()
    except InputError:
        raise
    except UNREADABLE as error:
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


def _npy(path: Path, key: str | None) -> npt.NDArray[Any]:
    with path.open("rb") as file:
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


def _npz(path: Path, key: str | None) -> npt.NDArray[Any]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        return np.asarray(archive[_one(key, archive.files)])


def _mat(path: Path, key: str | None) -> npt.NDArray[Any]:
    if h5py.is_hdf5(path):  # v7.3 keeps MATLAB's order of axes, the last one first
        return _hdf5(path, key).T
    names = [name for name, _, _ in scipy.io.whosmat(path)]
    name = _one(key, names)
    return np.asarray(scipy.io.loadmat(path, variable_names=[name])[name])


def _hdf5(path: Path, key: str | None) -> npt.NDArray[Any]:
    with h5py.File(path, "r") as file:
        names: list[str] = []
        file.visititems(
            lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None
        )
        return np.asarray(file[_one(key and key.strip("/"), names)][()])


def _one(key: str | None, names: Sequence[str]) -> str:
    if key is None and len(names) == 1:
        return names[0]
    if key is None or key not in names:
        wanted = "needs a key" if key is None else f"has no {key!r}"
        raise ValueError(f"it {wanted}; it holds {', '.join(names) or 'nothing'}")
    return key


def _csv(path: Path, columns: Sequence[str]) -> npt.NDArray[np.float64]:
    lines = path.read_bytes().rstrip().split(b"\n")
    if lines[-1].count(b",") != lines[0].count(b","):
        raise ValueError("its last line has fewer columns than its first")
    table = pd.read_csv(path, skipinitialspace=True)
    missing = [name for name in columns if name not in table.columns]
    if missing:
        raise ValueError(f"no column {', '.join(missing)}; it has {', '.join(table.columns)}")
    return table[list(columns)].to_numpy(np.float64)


def _ply(path: Path, columns: Sequence[str]) -> npt.NDArray[np.float64]:
    return _by_name(np.asarray(plyfile.PlyData.read(path)["vertex"].data), columns)


def _by_name(array: npt.NDArray[Any], columns: Sequence[str]) -> npt.NDArray[np.float64]:
    missing = [name for name in columns if name not in (array.dtype.names or ())]
    if missing:
        has = ", ".join(array.dtype.names or ())
        raise ValueError(f"no property {', '.join(missing)}; it has {has}")
    return np.column_stack([array[name].astype(np.float64) for name in columns])


_ARRAYS: dict[str, Callable[[Path, str | None], npt.NDArray[Any]]] = {
    ".tif": _tiff,
    ".tiff": _tiff,
    ".png": _picture,
    ".npy": _npy,
    ".npz": _npz,
    ".mat": _mat,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
}
