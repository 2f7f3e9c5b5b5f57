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

The published benchmark of 50 annotated frames (MDPI Data 2022, 7(12), 179) should come
in this way, but its format is not known to us, and the importer has not met it yet.
"""

from __future__ import annotations

import glob
import re
import shutil
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from kilnflight.checks import InputError
from kilnflight.recording.frames import Attributes, Frame, check_cloud, check_gray, check_position
from kilnflight.recording.sources import Coordinates, Gray, Labels, Points, from_table
from kilnflight.recording.store import write_recording
from kilnflight.recording.summary import Report, summarise


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
    table = _toml(manifest)
    folder, where = manifest.parent, f"{manifest}, "
    if "gray" not in table:
        raise InputError(f"{manifest}: there is no [gray]; give it at least a pattern.")
    gray = from_table(Gray, table.pop("gray"), where + "[gray]")
    images = _find(folder, gray.pattern, where + "[gray]")
    every = range(min(images), max(images) + 1)
    _check_frames(every, images, gray.pattern, where + "[gray]")
    coordinates = labels = None
    clouds: dict[int, Path] = {}
    classes: dict[int, Path] = {}
    if "coordinates" in table:
        coordinates = from_table(Coordinates, table.pop("coordinates"), where + "[coordinates]")
        clouds = _find(folder, coordinates.pattern, where + "[coordinates]")
        _check_frames(every, clouds, coordinates.pattern, where + "[coordinates]")
    if "labels" in table:
        labels = from_table(Labels, table.pop("labels"), where + "[labels]")
        classes = _find(folder, labels.pattern, where + "[labels]")
    for found, name in ((clouds, "coordinates"), (classes, "labels")):
        extra = [number for number in found if number not in images]
        if extra:
            raise InputError(
                f"{where}[{name}]: {found[extra[0]]} is of frame {extra[0]}, which has no gray."
            )
    files = tuple((k, file, clouds.get(k), classes.get(k)) for k, file in images.items())
    attributes = _attributes(table, gray, files[0], manifest)
    return FileRecording(attributes, gray, coordinates, labels, files)


def _toml(manifest: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(manifest.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{manifest}: cannot be read ({error.strerror}).") from error
    except ValueError as error:  # no TOML, or no text at all
        raise InputError(f"{manifest}: is not TOML ({error}).") from error


def _attributes(
    table: dict[str, Any], gray: Gray, first: tuple[int, Path, Any, Any], manifest: Path
) -> Attributes:
    needed, given = ("name", "frame_rate_hz"), {"rows", "columns"}
    known = [item.name for item in fields(Attributes) if item.name not in given]
    unknown = [key for key in table if key not in known]
    missing = [key for key in needed if key not in table]
    if unknown or missing:
        said = [f"unknown: {', '.join(unknown)}"] if unknown else []
        said += [f"missing: {', '.join(missing)}"] if missing else []
        raise InputError(
            f"{manifest}: {'; '.join(said)}. It takes {', '.join(known)}, and the tables gray, "
            "coordinates and labels."
        )
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
    found: dict[int, Path] = {}
    for name in glob.glob("*".join(map(glob.escape, texts)), root_dir=folder):
        match = re.fullmatch(expression, name)
        numbers = {int(group) for group in match.groups()} if match else set()
        if len(numbers) != 1:
            continue
        number = numbers.pop()
        if number in found:
            raise InputError(f"{where}: {found[number].name} and {name} are both frame {number}.")
        found[number] = folder / name
    if not found:
        raise InputError(f"{where}: no file in {folder} fits the pattern {pattern!r}.")
    return dict(sorted(found.items()))


def _check_frames(wanted: range, found: Mapping[int, Path], pattern: str, where: str) -> None:
    first = next((number for number in wanted if number not in found), None)
    if first is not None:
        count = len(wanted) - sum(number in wanted for number in found)
        raise InputError(
            f"{where}: frame {first} is missing ({pattern.format(frame=first)}), {count} in all "
            f"of {wanted[0]} to {wanted[-1]}. Every frame between the first and the last is "
            "needed; parts without gaps can be imported one by one."
        )
