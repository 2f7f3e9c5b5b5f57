"""Your own recordings: other programs' files -> a recording of kilnflight's.

A small TOML file, the manifest, says what lies where. Patterns are relative to it::

    name = "chips-4.5bar"             # every error names it
    frame_rate_hz = 330.0
    fraction = "wood chip"            # or confetti, paper shred, PE granule, mixed
    pressure_bar = 4.5
    lance_mm = [-10.0, 240.0, 8950.0]               # outlet: x, y, z
    roi = [[0, 200], [0, 1800], [1535, 1900], [1535, 100]]     # vertices: row, col
    flame_roi = [900, 1200, 850, 1150]              # row0, row1, col0, col1
    depth_calibration = [[1020, 1000], [2110, 2000]]           # captured, true depth

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
on the wall. Coordinates, the lance's too, are those of the camera as captured.
``depth_calibration`` makes true depths of them: pairs of captured and true depth in mm,
a fit (``breakpoints_mm``, ``coefficients`` in mm, highest power first), ``"zhang-2023"``
(Eq. 2.4, which holds for that one camera), or ``"none"``, the default.

The ending of a file names its format (`kilnflight.recording.array_files`).

The published benchmark of 50 annotated frames (MDPI Data 2022, 7(12), 179) should come
in this way, but its format is not known to us, and the importer has not met it yet.
"""

from __future__ import annotations

import glob
import re
import shutil
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError, check_new, check_shape, is_number
from kilnflight.recording.array_files import read_array, read_points
from kilnflight.recording.frames import (
    LABELS,
    NO_POINTS,
    Attributes,
    Frame,
    check_array,
    check_cloud,
    check_points,
    check_position,
)
from kilnflight.recording.store import write_recording
from kilnflight.recording.summary import summarise

NEEDED = object()  # in place of a default
FORMS, UNITS = ("grid", "points"), ("mm", "m")
INT32 = np.iinfo(np.int32)

Points = tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]
Section = Mapping[str, Any]  # a table of the manifest, complete with defaults


# The tables of the manifest: each key with its default.
SECTIONS: dict[str, Section] = {
    "gray": {"pattern": NEEDED, "key": None},
    "coordinates": {
        **{"pattern": NEEDED, "form": NEEDED, "key": None, "invalid": "nan", "unit": "mm"},
        **{"columns": ("row", "col", "x", "y", "z"), "origin": 0},
    },
    "labels": {"pattern": NEEDED, "classes": NEEDED, "key": None},
}
# Of each key: which values it takes, and the fault of any other.
RULES: dict[str, tuple[Callable[[Any], bool], str]] = {
    "pattern": (lambda v: isinstance(v, str), "pattern is {!r}, expected str"),
    "key": (lambda v: isinstance(v, str), "key is {!r}, expected str"),
    "form": (FORMS.__contains__, f"form is {{!r}}, expected one of {FORMS}"),
    "invalid": (
        lambda v: v == "nan" or is_number(v) or isinstance(v, float),  # TOML has inf and nan
        "invalid is {!r}, expected a number or 'nan'",
    ),
    "unit": (UNITS.__contains__, f"unit is {{!r}}, expected one of {UNITS}"),
    "columns": (lambda v: isinstance(v, list) and len(v) == 5, "columns must be five names"),
    "origin": ((0, 1).__contains__, "origin must be 0 or 1"),
    "classes": (lambda v: isinstance(v, dict), "classes is {!r}, expected dict"),
}


@dataclass(frozen=True, eq=False)
class FileRecording:
    """A recording in the files of others; `read_manifest` gives it.

    ``sections`` are the tables of the manifest, ``files`` their files by number of the frame.
    """

    attributes: Attributes
    sections: Mapping[str, Section]
    files: Mapping[str, Mapping[int, Path]] = field(repr=False)  # too many to print

    def __len__(self) -> int:
        return len(self.files["gray"])

    def gray(self, t: int) -> npt.NDArray[np.uint16]:
        """Return the grey values (rows, cols) of frame ``t``; errors name its file."""
        check_position(t, len(self), self.attributes.name)
        number, path = list(self.files["gray"].items())[t]
        where = _where(self.attributes.name, number)
        gray = read_array(path, self.sections["gray"]["key"], where)
        check_array(gray, "uint16", self.attributes.size, f"{where}: {path}: gray")
        return gray

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0, read from its files; errors name them."""
        gray = self.gray(t)
        numbers, size = list(self.files["gray"]), self.attributes.size
        where, points, labels = _where(self.attributes.name, numbers[t]), NO_POINTS, None
        if path := self.files["coordinates"].get(numbers[t]):
            points = _points(self.sections["coordinates"], path, size, where)
            check_cloud(*points, size, f"{where}: {path}")
        if path := self.files["labels"].get(numbers[t]):
            labels = _labels(self.sections["labels"], path, size, where)
        time_s = (numbers[t] - numbers[0]) / self.attributes.frame_rate_hz
        return Frame(numbers[t], time_s, gray, *points, labels)


def _where(name: str, number: int) -> str:
    return f"recording {name}, frame {number}"


def _points(section: Section, path: Path, size: tuple[int, int], where: str) -> Points:
    """Return pixels and positions of one file, those without depth left out."""
    if section["form"] == "grid":
        xyz = read_array(path, section["key"], where)
        check_shape(xyz, (*size, 3), f"{where}: coordinates of {path}")
        pixels, xyz = np.indices(size).reshape(2, -1).T, xyz.reshape(-1, 3)
    else:
        table = read_points(path, section["key"], section["columns"], where)
        pixels, xyz = table[:, :2] - section["origin"], table[:, 2:]
    if np.isnan(float(section["invalid"])):
        valid = ~np.isnan(xyz).any(axis=1)
        if len(xyz) and not valid.any():
            raise InputError(f"{where}: {path} holds no position, every one is NaN.")
    else:
        valid = xyz[:, 2].astype(np.float32) != np.float32(section["invalid"])
    pixels, xyz = pixels[valid], xyz[valid]
    whole = (pixels == np.round(pixels)).all(axis=1)  # NaN is not equal
    fault = "row {row:g}, col {col:g} is no pixel; whole numbers expected."
    check_points(whole, pixels, f"{where}: {path}", fault)
    with np.errstate(over="ignore"):  # what is too large becomes infinite, which is refused
        positions = (xyz * (1000.0 if section["unit"] == "m" else 1.0)).astype(np.float32)
    return np.clip(pixels, INT32.min, INT32.max).astype(np.int32), positions


def _labels(
    section: Section, path: Path, size: tuple[int, int], where: str
) -> npt.NDArray[np.uint8]:
    """Return the classes of Table 5.1 of one file."""
    image = read_array(path, section["key"], where)
    check_shape(image, size, f"{where}: labels of {path}")
    labels = np.full(size, len(LABELS), np.uint8)
    for theirs, ours in section["classes"].items():
        labels[image == int(theirs)] = ours
    unknown = np.argwhere(labels == len(LABELS))
    if len(unknown):
        row, col = unknown[0]
        raise InputError(
            f"{where}: {path} has the unknown class {image[row, col]} in {len(unknown)} "
            f"pixel(s), the first at row {row}, col {col}. Add it to classes."
        )
    return labels


def import_recording(manifest: Path | str, target: Path | str) -> pd.DataFrame:
    """Import a recording, all of it or nothing; return what it holds (`summarise`).

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
    check_new(target)
    recording = read_manifest(manifest)
    work = target.with_name(f".{target.name}.import")
    shutil.rmtree(work, ignore_errors=True)  # of an import that was killed
    try:
        work.mkdir(parents=True)
        stored = write_recording(recording, work / target.name)
        summary = summarise(stored)
        stored.path.rename(target)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return summary


def read_manifest(manifest: Path | str) -> FileRecording:
    """Return the recording of a manifest, whose files are there.

    The first file gives the size.
    """
    manifest = Path(manifest)
    again = "Give the manifest of a recording, a TOML file."
    try:
        table = tomllib.loads(manifest.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{manifest}: cannot be read ({error.strerror}). {again}") from error
    except ValueError as error:  # no TOML, or no text at all
        raise InputError(f"{manifest}: is not TOML ({error}). {again}") from error
    if "gray" not in table:
        raise InputError(f"{manifest}: there is no [gray]; give it at least a pattern.")
    sections: dict[str, Section] = {}
    files: dict[str, dict[int, Path]] = {name: {} for name in SECTIONS}
    for name in SECTIONS:
        if name in table:
            where = f"{manifest}, [{name}]"
            sections[name] = _section(name, table.pop(name), where)
            files[name] = _find(manifest.parent, sections[name]["pattern"], where)
            _check_numbers(files[name], files["gray"], name, sections[name]["pattern"], where)
    attributes = _attributes(table, sections["gray"], next(iter(files["gray"].items())), manifest)
    return FileRecording(attributes, sections, files)


def _section(name: str, table: object, where: str) -> Section:
    """Return a table of the manifest with its defaults, or raise an `InputError`."""
    if not isinstance(table, dict):
        raise InputError(f"{where} is {table!r}, expected a table with a pattern.")
    defaults = SECTIONS[name]
    needed = [key for key, default in defaults.items() if default is NEEDED]
    _check_keys(table, needed, defaults, where, f"its keys are {', '.join(defaults)}")
    for key, value in table.items():
        fits, fault = RULES[key]
        if not fits(value):
            raise InputError(f"{where}: {fault.format(value)}.")
    for theirs, ours in table.get("classes", {}).items():
        if not re.fullmatch(r"-?\d+", theirs) or ours not in range(len(LABELS)):
            raise InputError(
                f"{where}: classes has {theirs} = {ours!r}, expected their number = 0 to "
                f"{len(LABELS) - 1} ({', '.join(LABELS)})."
            )
    return {**defaults, **table}


def _check_keys(
    table: Section, needed: Sequence[str], known: Collection[str], where: str, rule: str
) -> None:
    """Raise an `InputError` if a table lacks keys or has others than those known."""
    unknown = [name for name in table if name not in known]
    missing = [name for name in needed if name not in table]
    faults = {"unknown": unknown, "missing": missing}
    parts = [f"{fault}: {', '.join(names)}" for fault, names in faults.items() if names]
    if parts:
        raise InputError(f"{where}: {'; '.join(parts)}; {rule}.")


def _check_numbers(
    files: Mapping[int, Path], images: Mapping[int, Path], name: str, pattern: str, where: str
) -> None:
    """Raise an `InputError` unless files are of all frames; labels may be of some."""
    first, last = min(images), max(images)
    missing = [number for number in range(first, last + 1) if number not in files]
    if missing and name != "labels":
        raise InputError(
            f"{where}: frame {missing[0]} is missing ({pattern.format(frame=missing[0])}), "
            f"{len(missing)} in all of {first} to {last}. Every frame between the first and the "
            "last is needed; parts without gaps can be imported one by one."
        )
    extra = [number for number in files if number not in images]
    if extra:
        raise InputError(f"{where}: {files[extra[0]]} is of frame {extra[0]}, which has no gray.")


def _attributes(
    table: dict[str, Any], gray: Section, first: tuple[int, Path], manifest: Path
) -> Attributes:
    """Return the attributes in a manifest; the first image gives rows and columns."""
    known = [item.name for item in fields(Attributes) if item.name not in ("rows", "columns")]
    rule = f"it takes {', '.join(known)}, and the tables gray, coordinates and labels"
    _check_keys(table, ("name", "frame_rate_hz"), known, f"{manifest}", rule)
    if not isinstance(table["name"], str):
        raise InputError(f"{manifest}: name is {table['name']!r}, expected text in quotes.")
    number, path = first
    where = _where(table["name"], number)
    size = read_array(path, gray["key"], where).shape
    if len(size) != 2:
        raise InputError(f"{where}: {path} has shape {size}, expected (rows, cols).")
    try:
        return Attributes.from_json({**table, "rows": size[0], "columns": size[1]})
    except InputError as error:
        raise InputError(f"{manifest}: {error}") from error
    except (TypeError, AttributeError) as error:  # a word where a number belongs
        raise InputError(f"{manifest}: a value has the wrong type ({error}).") from error


def _find(folder: Path, pattern: str, where: str) -> dict[int, Path]:
    """Return the files of a pattern by the number of their frame, in order."""
    parts = re.split(r"\{frame(?::0(\d+)d)?\}", pattern)
    texts, widths = parts[::2], parts[1::2]  # a width may be None
    if not widths or any("{" in text or "}" in text for text in texts):
        raise InputError(
            f"{where}: pattern {pattern!r} needs {{frame}}, or {{frame:04d}} for 0001, where the "
            "number of the frame stands."
        )
    parts[::2] = map(re.escape, texts)
    parts[1::2] = [rf"(\d{{{width or 1},}})" for width in widths]
    files: dict[int, Path] = {}
    for name in glob.glob("*".join(map(glob.escape, texts)), root_dir=folder):
        match = re.fullmatch("".join(parts), name)
        numbers = {int(group) for group in match.groups()} if match else set()
        if len(numbers) == 1:
            number = numbers.pop()
            if number in files:
                both = f"{files[number].name} and {name}"
                raise InputError(f"{where}: {both} are both frame {number}.")
            files[number] = folder / name
    if not files:
        raise InputError(f"{where}: no file in {folder} fits the pattern {pattern!r}.")
    return dict(sorted(files.items()))
