"""Your own recordings: files that other programs wrote -> a recording of kilnflight's.

A small TOML file, the manifest, says what lies where. Patterns are relative to it::

    name = "chips-4.5bar"             # every error names it
    frame_rate_hz = 330.0
    fraction = "wood chip"            # or confetti, paper shred, PE granule, mixed
    pressure_bar = 4.5
    lance_mm = [-10.0, 240.0, 8950.0]               # outlet: x, y, z
    roi = [[0, 200], [0, 1800], [1535, 1900], [1535, 100]]     # vertices: row, col
    flame_roi = [900, 1200, 850, 1150]              # row0, row1, col0, col1

    [gray]                            # 16-bit: TIFF, PNG, MAT, HDF5, NPY, NPZ
    pattern = "gray/frame_{frame:04d}.tif"

    [coordinates]
    pattern = "xyz/frame_{frame:04d}.mat"
    key = "XYZ"                       # variable or data set, where a file holds several
    form = "grid"                     # (rows, cols, 3) in MAT, HDF5, NPY, NPZ or TIFF
    invalid = "nan"                   # or a number: the depth of a pixel that has none
    unit = "mm"                       # or "m"

    [labels]                          # PNG, TIFF, NPY, NPZ, MAT, HDF5
    pattern = "labels/frame_{frame:04d}.png"
    classes = { 0 = 0, 60 = 1, 120 = 2, 180 = 3, 240 = 4 }     # theirs = Table 5.1

Only ``name``, ``frame_rate_hz`` and ``[gray]`` must be there. ``{frame}`` stands for the
number of a frame; frames are taken in the order of their numbers, and every number
between the first and the last must be there. Labels may cover some frames only.

With ``form = "points"`` each file lists points: row, col, x, y, z in CSV, PLY or a
structured NPY by name, in other arrays (n, 5) by position. ``columns = ["v", "u", "X",
"Y", "Z"]`` gives other names in the same order, ``origin = 1`` counts pixels from 1.

Classes of Table 5.1: 0 wall, 1 flame, 2 burning in air, 3 non-burning in air, 4 burning
on the wall. Coordinates are those of the camera as captured, before Eq. 2.4.

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

The published benchmark of 50 annotated frames (MDPI Data 2022, 7(12), 179) should come
in this way, but its format is not known to us, and the importer has not met it yet.
"""

from __future__ import annotations

import glob
import logging
import re
import shutil
import struct
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, Literal, TypeVar

import h5py
import numpy as np
import numpy.typing as npt
import pandas as pd
import plyfile
import scipy.io
import tifffile
from PIL import Image
from scipy.io.matlab import MatReadError

from kilnflight.checks import InputError, check_shape
from kilnflight.recording.frames import (
    LABELS,
    Attributes,
    Frame,
    check_cloud,
    check_gray,
    check_position,
)
from kilnflight.recording.store import write_recording
from kilnflight.recording.summary import Report, summarise

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

Section = TypeVar("Section", "Gray", "Coordinates", "Labels")
Points = tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]


@dataclass(frozen=True)
class Gray:
    """The manifest's ``[gray]``."""

    pattern: str
    key: str | None = None

    def read(self, path: Path, where: str) -> npt.NDArray[np.uint16]:
        """Return the image of one file."""
        image = read_array(path, self.key, where)
        if image.ndim != 2:
            raise InputError(f"{where}: {path} has shape {image.shape}, expected (rows, cols).")
        return image


@dataclass(frozen=True)
class Coordinates:
    """The manifest's ``[coordinates]``."""

    pattern: str
    form: Literal["grid", "points"]
    key: str | None = None
    invalid: float | str = "nan"
    unit: Literal["mm", "m"] = "mm"
    columns: tuple[str, ...] = ("row", "col", "x", "y", "z")
    origin: int = 0

    def __post_init__(self) -> None:
        for name, allowed in (("form", ("grid", "points")), ("unit", ("mm", "m"))):
            if getattr(self, name) not in allowed:
                raise InputError(f"{name} is {getattr(self, name)!r}, expected one of {allowed}")
        number = isinstance(self.invalid, int | float) and not isinstance(self.invalid, bool)
        if self.invalid != "nan" and not number:
            raise InputError(f"invalid is {self.invalid!r}, expected a number or 'nan'")
        if len(self.columns) != 5 or self.origin not in (0, 1):
            raise InputError("columns must be five names, origin 0 or 1")

    def read(self, path: Path, size: tuple[int, int], where: str) -> Points:
        """Return the pixels and positions of one file, those without depth left out."""
        pixels: npt.NDArray[Any]
        if self.form == "grid":
            grid = read_array(path, self.key, where)
            check_shape(grid, (*size, 3), f"{where}: coordinates of {path}")
            xyz = grid.reshape(-1, 3)
        else:
            table = read_points(path, self.key, self.columns, where)
            xyz = table[:, 2:]
        if np.isnan(float(self.invalid)):
            valid = ~np.isnan(xyz).any(axis=1)
            if len(xyz) and not valid.any():
                raise InputError(f"{where}: {path} holds no position, every one is NaN.")
        else:
            valid = xyz[:, 2].astype(np.float32) != np.float32(self.invalid)
        grid_form = self.form == "grid"
        pixels = np.argwhere(valid.reshape(size)) if grid_form else table[valid, :2] - self.origin
        xyz = xyz[valid]
        broken = np.flatnonzero((pixels != np.round(pixels)).any(axis=1))  # NaN is not equal
        if len(broken):
            row, col = pixels[broken[0]]
            raise InputError(
                f"{where}: {path}: row {row:g}, col {col:g} is no pixel; whole numbers expected."
            )
        limits = np.iinfo(np.int32)
        with np.errstate(over="ignore"):  # what is too large becomes infinite, which is refused
            positions = (xyz * (1000.0 if self.unit == "m" else 1.0)).astype(np.float32)
        return np.clip(pixels, limits.min, limits.max).astype(np.int32), positions


@dataclass(frozen=True)
class Labels:
    """The manifest's ``[labels]``."""

    pattern: str
    classes: Mapping[str, int]
    key: str | None = None

    def __post_init__(self) -> None:
        for theirs, ours in self.classes.items():
            if not re.fullmatch(r"-?\d+", theirs) or ours not in range(len(LABELS)):
                raise InputError(
                    f"classes has {theirs} = {ours!r}, expected their number = 0 to "
                    f"{len(LABELS) - 1} ({', '.join(LABELS)})"
                )

    def read(self, path: Path, size: tuple[int, int], where: str) -> npt.NDArray[np.uint8]:
        """Return the classes of Table 5.1 of one file."""
        image = read_array(path, self.key, where)
        check_shape(image, size, f"{where}: labels of {path}")
        labels = np.full(size, len(LABELS), np.uint8)
        for theirs, ours in self.classes.items():
            labels[image == int(theirs)] = ours
        unknown = np.argwhere(labels == len(LABELS))
        if len(unknown):
            row, col = unknown[0]
            raise InputError(
                f"{where}: {path} has the unknown class {image[row, col]} in {len(unknown)} "
                f"pixel(s), the first at row {row}, col {col}. Add it to classes."
            )
        return labels


@dataclass(frozen=True, eq=False)
class FileRecording:
    """A recording in the files of others; `read_manifest` gives it."""

    attributes: Attributes
    gray: Gray
    coordinates: Coordinates | None
    labels: Labels | None
    files: tuple[tuple[int, Path, Path | None, Path | None], ...]  # number, gray, xyz, labels

    def __len__(self) -> int:
        return len(self.files)

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0, read from its files; errors name them."""
        attributes = self.attributes
        check_position(t, len(self), attributes.name)
        number, gray_file, xyz_file, labels_file = self.files[t]
        where, size = _where(attributes.name, number), (attributes.rows, attributes.columns)
        gray = self.gray.read(gray_file, where)
        check_gray(gray, attributes, f"{where}: {gray_file}")
        points: Points = (np.empty((0, 2), np.int32), np.empty((0, 3), np.float32))
        if self.coordinates and xyz_file:
            points = self.coordinates.read(xyz_file, size, where)
            check_cloud(*points, attributes, f"{where}: {xyz_file}")
        labels = None
        if self.labels and labels_file:
            labels = self.labels.read(labels_file, size, where)
        time_s = (number - self.files[0][0]) / attributes.frame_rate_hz
        return Frame(number, time_s, gray, *points, labels)


def import_recording(manifest: Path | str, target: Path | str) -> Report:
    """Import a recording and return what it holds; all of it or nothing.

    Parameters
    ----------
    manifest
        The TOML file.
    target
        The new folder, for `kilnflight.recording.store.open_recording`. Until everything is
        read and checked, the work is done in ``.<target>.import`` beside it.

    Raises
    ------
    InputError
        One for the first thing that is wrong, naming file and frame; nothing is left then.
    """
    target = Path(target)
    if target.exists():
        raise InputError(f"{target}: exists already. Delete it or choose another target.")
    recording = read_manifest(manifest)
    work = target.with_name(f".{target.name}.import")
    shutil.rmtree(work, ignore_errors=True)  # of an import that was killed
    try:
        work.mkdir(parents=True)
        stored = write_recording(recording, work / target.name)
        report = summarise(stored)
        stored.path.rename(target)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return report


def read_manifest(manifest: Path | str) -> FileRecording:
    """Return what a manifest describes: all files found, the first frame's size known."""
    manifest = Path(manifest)
    try:
        table = tomllib.loads(manifest.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{manifest}: cannot be read ({error.strerror}).") from error
    except ValueError as error:  # no TOML, or no text at all
        raise InputError(f"{manifest}: is not TOML ({error}).") from error
    if "gray" not in table:
        raise InputError(f"{manifest}: there is no [gray]; give it at least a pattern.")
    gray, images = _section(Gray, table, manifest, None)
    coordinates, clouds = _section(Coordinates, table, manifest, images)
    labels, classes = _section(Labels, table, manifest, images)
    files = tuple((k, file, clouds.get(k), classes.get(k)) for k, file in images.items())
    attributes = _attributes(table, gray, files[0], manifest)
    return FileRecording(attributes, gray, coordinates, labels, files)


def _section(
    kind: type[Section], table: dict[str, Any], manifest: Path, images: dict[int, Path] | None
) -> tuple[Any, dict[int, Path]]:
    """Return a section of the manifest, taken out of it, and its files by frame number.

    None without files where there is no such section. ``images`` are those of ``[gray]``.
    """
    name = kind.__name__.lower()
    where = f"{manifest}, [{name}]"
    if name not in table:
        return None, {}
    section = _filled(kind, table.pop(name), where)
    files = _find(manifest.parent, section.pattern, where)
    images = files if images is None else images
    every = range(min(images), max(images) + 1)
    missing = [number for number in every if number not in files]
    if missing and kind is not Labels:
        raise InputError(
            f"{where}: frame {missing[0]} is missing ({section.pattern.format(frame=missing[0])}), "
            f"{len(missing)} in all of {every[0]} to {every[-1]}. Every frame between the first "
            "and the last is needed; parts without gaps can be imported one by one."
        )
    extra = [number for number in files if number not in images]
    if extra:
        raise InputError(f"{where}: {files[extra[0]]} is of frame {extra[0]}, which has no gray.")
    return section, files


def _filled(kind: type[Section], table: object, where: str) -> Section:
    """Return a section from its table in the manifest, or raise an `InputError`."""
    if not isinstance(table, dict):
        raise InputError(f"{where} is {table!r}, expected a table with a pattern.")
    known = {item.name: item for item in fields(kind)}
    needed = [name for name, item in known.items() if item.default is MISSING]
    _check_keys(table, needed, known, f"{where}", f"its keys are {', '.join(known)}")
    for name, expected in (("pattern", str), ("key", str), ("columns", list), ("classes", dict)):
        if name in table and not isinstance(table[name], expected):
            raise InputError(f"{where}: {name} is {table[name]!r}, expected {expected.__name__}.")
    try:
        return kind(**table)
    except InputError as error:
        raise InputError(f"{where}: {error}.") from error


def _check_keys(
    table: Mapping[str, Any], needed: Sequence[str], known: Iterable[str], where: str, rule: str
) -> None:
    """Raise an `InputError` if a table lacks keys or has others than those known."""
    unknown = [name for name in table if name not in known]
    missing = [name for name in needed if name not in table]
    if unknown or missing:
        faults = [f"unknown: {', '.join(unknown)}"] if unknown else []
        faults += [f"missing: {', '.join(missing)}"] if missing else []
        raise InputError(f"{where}: {'; '.join(faults)}; {rule}.")


def _attributes(
    table: dict[str, Any], gray: Gray, first: tuple[int, Path, Any, Any], manifest: Path
) -> Attributes:
    known = [item.name for item in fields(Attributes) if item.name not in ("rows", "columns")]
    rule = f"it takes {', '.join(known)}, and the tables gray, coordinates and labels"
    _check_keys(table, ("name", "frame_rate_hz"), known, f"{manifest}", rule)
    if not isinstance(table["name"], str):
        raise InputError(f"{manifest}: name is {table['name']!r}, expected text in quotes.")
    rows, columns = gray.read(first[1], _where(table["name"], first[0])).shape
    try:
        return Attributes.from_json({**table, "rows": rows, "columns": columns})
    except InputError as error:
        raise InputError(f"{manifest}: {error}") from error
    except (TypeError, AttributeError) as error:  # a word where a number belongs
        raise InputError(f"{manifest}: a value has the wrong type ({error}).") from error


def _where(name: str, number: int) -> str:
    return f"recording {name}, frame {number}"


def _find(folder: Path, pattern: str, where: str) -> dict[int, Path]:
    """Return the files of a pattern by the number of their frame, in order."""
    parts = re.split(r"\{frame(?::0(\d+)d)?\}", pattern)
    texts, widths = parts[::2], parts[1::2]
    if not widths or any("{" in text or "}" in text for text in texts):
        raise InputError(
            f"{where}: pattern {pattern!r} needs {{frame}}, or {{frame:04d}} for 0001, where the "
            "number of the frame stands."
        )
    expression = re.escape(texts[0])
    for width, text in zip(widths, texts[1:], strict=True):
        expression += rf"(\d{{{int(width or 1)},}})" + re.escape(text)
    files: dict[int, Path] = {}
    for name in glob.glob("*".join(map(glob.escape, texts)), root_dir=folder):
        match = re.fullmatch(expression, name)
        numbers = {int(group) for group in match.groups()} if match else set()
        if len(numbers) != 1:
            continue
        number = numbers.pop()
        if number in files:
            raise InputError(f"{where}: {files[number].name} and {name} are both frame {number}.")
        files[number] = folder / name
    if not files:
        raise InputError(f"{where}: no file in {folder} fits the pattern {pattern!r}.")
    return dict(sorted(files.items()))


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
        raise InputError(f"{where}: {path} is none of {', '.join(sorted(ARRAYS))}.")
    array = _guarded(lambda: ARRAYS[ending](path, key), path, where)
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
        return _guarded(lambda: _by_name(pd.DataFrame(array), columns), path, where)
    if array.ndim != 2 or array.shape[1] != len(columns):
        raise InputError(
            f"{where}: {path} has shape {array.shape}, expected (n, {len(columns)}) for "
            f"{', '.join(columns)}."
        )
    return array.astype(np.float64)


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
        return np.asarray(archive[_chosen(key, archive.files)])


def _mat(path: Path, key: str | None) -> npt.NDArray[Any]:
    if h5py.is_hdf5(path):  # v7.3 keeps MATLAB's order of axes, the last one first
        return _hdf5(path, key).T
    names = [name for name, _, _ in scipy.io.whosmat(path)]
    name = _chosen(key, names)
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


def _csv(path: Path, columns: Sequence[str]) -> npt.NDArray[np.float64]:
    lines = path.read_bytes().rstrip().split(b"\n")
    if lines[-1].count(b",") != lines[0].count(b","):
        raise ValueError("its last line has fewer columns than its first")
    return _by_name(pd.read_csv(path, skipinitialspace=True), columns)


def _ply(path: Path, columns: Sequence[str]) -> npt.NDArray[np.float64]:
    return _by_name(pd.DataFrame(plyfile.PlyData.read(path)["vertex"].data), columns)


def _by_name(table: pd.DataFrame, columns: Sequence[str]) -> npt.NDArray[np.float64]:
    missing = [name for name in columns if name not in table]
    if missing:
        raise ValueError(f"no column {', '.join(missing)}; it has {', '.join(map(str, table))}")
    return table[list(columns)].to_numpy(np.float64)


ARRAYS: dict[str, Callable[[Path, str | None], npt.NDArray[Any]]] = {
    ".tif": _tiff,
    ".tiff": _tiff,
    ".png": _picture,
    ".npy": _npy,
    ".npz": _npz,
    ".mat": _mat,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
}
