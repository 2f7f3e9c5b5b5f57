"""Films, stacks, pictures, arrays and manifests of other programs, opened as recordings.

`open_any` takes

==========================  ================================================================
AVI, MP4, MOV, MKV          decoded by OpenCV, 8 bit
TIFF of several pages       axis T of ImageJ and OME, or pages without a name; z is refused,
                            and channels unless one is named
folder or pattern           PNG, TIFF, JPEG, NPY, ... one file a frame: ``film/*.png`` or
                            ``film/a_{frame}_8bit.png``; the frame's number stands at
                            ``{frame}``, or is the last one in the name
NPY, NPZ, MAT, HDF5         (frame, row, col), also with a last axis of colours
array, or anything indexed  the same, or pictures (row, col) one by one
Zarr                        what ``kilnflight import``, ``export`` or ``run`` wrote
TOML                        a manifest, where depth, labels or metadata come in
==========================  ================================================================

Numbers that are not there are frames that are not there. Of coloured pictures one channel is
taken, by default the brightest of the first frame. Whole grey values from 0 to 65535 are taken as
they are (8, 10, 12, 16 bit); others, such as floats from 0 to 1, are scaled linearly to that
range, by the least and the largest value of the recording. `Attributes.notes` says so.

A manifest says what lies where. Patterns are relative to it::

    name = "chips-4.5bar"             # every error names it
    frame_rate_hz = 330.0
    fraction = "wood chip"            # any text
    pressure_bar = 4.5
    lance_mm = [-10.0, 240.0, 8950.0]               # outlet: x, y, z
    roi = [[0, 200], [0, 1800], [1535, 1900], [1535, 100]]     # vertices: row, col
    flame_roi = [900, 1200, 850, 1150]              # row0, row1, col0, col1
    depth_calibration = [[1020, 1000], [2110, 2000]]           # captured, true depth

    [gray]                            # anything that `open_any` takes
    pattern = "gray/frame_{frame:04d}.tif"
    channel = "red"                   # of coloured pictures

    [coordinates]
    pattern = "xyz/frame_{frame:04d}.mat"
    key = "XYZ"                       # variable or data set, where a file holds several
    form = "grid"                     # (rows, cols, 3) in MAT, HDF5, NPY, NPZ or TIFF
    invalid = "nan"                   # or a number: the depth of a pixel that has none
    unit = "mm"                       # or "m"

    [labels]                          # PNG, TIFF, NPY, NPZ, MAT, HDF5
    pattern = "labels/frame_{frame:04d}.png"
    classes = { 0 = 0, 60 = 1, 120 = 2, 180 = 3, 240 = 4 }     # theirs = Table 5.1

Only ``name``, ``frame_rate_hz`` and ``[gray]`` are needed. Coordinates and labels may cover some
frames only. With ``form = "points"`` each file lists points: row, col, x, y, z in CSV or a
structured NPY by name, in other arrays (n, 5) by position. ``columns = ["v", "u", "X", "Y", "Z"]``
gives other names in the same order, ``origin = 1`` counts pixels from 1.

Classes of Table 5.1: 0 wall, 1 flame, 2 burning in air, 3 non-burning in air, 4 burning on the
wall. Coordinates, the lance's too, are those of the camera as captured. ``depth_calibration`` makes
true depths of them: pairs of captured and true depth in mm, a fit (``breakpoints_mm``,
``coefficients`` in mm, highest power first), ``"zhang-2023"`` (Eq. 2.4, which holds for that one
camera), or ``"none"``, the default.
"""

from __future__ import annotations

import glob
import hashlib
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.arrays import Picture
from kilnflight.checks import InputError, check_columns, check_shape, known_numbers
from kilnflight.recording.frames import Attributes, Frame, Recording, check_frame, check_position
from kilnflight.recording.pictures import (
    CHANNELS,
    FILMS,
    PICTURES,
    TIFFS,
    Anything,
    Channel,
    Film,
    PictureFiles,
    channel_position,
    read_array,
)
from kilnflight.recording.store import open_recording, summarise_recording, write_recording

SMALL_TYPES = (np.bool_, np.uint8, np.uint16)  # they hold nothing but grey values of 16 bits
WHITE = 65_535  # the largest grey value


@dataclass(frozen=True)
class Part:
    """Files of grey values, coordinates or labels: one table of a manifest."""

    pattern: str
    key: str | None = None
    channel: Channel = None
    form: str = "grid"
    invalid: float | str = "nan"
    unit: str = "mm"
    columns: Sequence[str] = ("row", "col", "x", "y", "z")
    origin: int = 0
    classes: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        allowed = {"form": ("grid", "points"), "unit": ("mm", "m"), "origin": (0, 1)}
        wrong = [key for key, values in allowed.items() if getattr(self, key) not in values]
        wrong += [name for name in self.classes if not name.lstrip("-").isdecimal()]
        wrong += ["invalid"] if isinstance(self.invalid, str) and self.invalid != "nan" else []
        if wrong or len(self.columns) != 5 or not isinstance(self.key, str | None):
            raise InputError(f"{', '.join(wrong) or 'key or columns'}: not as a manifest has it")


Parts = Mapping[str, tuple[Part, dict[int, Path]]]  # with the files by number of the frame


@dataclass(frozen=True, eq=False)
class FileRecording:
    """Frames in the files of other programs, or in memory.

    Parameters
    ----------
    attributes
        Facts about the whole recording.
    numbers
        Number of each frame, ascending.
    images
        Pictures (rows, cols) or (rows, cols, channels), read one by one.
    channel
        Position on the last axis of coloured pictures.
    scale
        Value that becomes 0, and grey values per unit; None: whole grey values as they are.
    parts
        Coordinates and labels.
    """

    attributes: Attributes
    numbers: Sequence[int] = field(repr=False)
    images: Any = field(repr=False)
    channel: int = 0
    scale: tuple[float, float] | None = None
    parts: Parts = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.numbers)

    def gray(self, t: int) -> npt.NDArray[np.uint16]:
        """Return the grey values (rows, cols) of frame ``t``, counted from 0."""
        check_position(t, len(self), self.attributes.name)
        where = f"recording {self.attributes.name}, frame {self.numbers[t]}"
        image = _one_channel(self.images[t], self.channel, where)
        check_shape(image, self.attributes.size, where)
        if self.scale is not None:
            image = np.rint((image.astype(np.float64) - self.scale[0]) * self.scale[1])
        elif not (image.dtype in SMALL_TYPES or _is_gray(image)):
            raise InputError(f"{where}: its values are not whole numbers from 0 to {WHITE}.")
        return np.ascontiguousarray(image, np.uint16)

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0, with its points and labels."""
        gray, number, more = self.gray(t), self.numbers[t], dict[str, Any]()
        for name, (part, files) in self.parts.items():
            if number in files:
                read = _points if name == "coordinates" else _labels
                more |= read(part, files[number], gray.shape)
        time_s = (number - self.numbers[0]) / self.attributes.frame_rate_hz
        return check_frame(Frame(number, time_s, gray, **more), self.attributes)

    def content(self) -> str:
        """Return a hash (12 hex digits) of attributes and the files' names, sizes and times.

        Arrays in memory are hashed frame by frame.
        """
        files = [*getattr(self.images, "files", ())]
        digest = hashlib.sha256(repr((self, list(self.numbers))).encode())
        for t in range(0 if files else len(self)):
            digest.update(self.gray(t).tobytes())
        for path in files + [path for _, found in self.parts.values() for path in found.values()]:
            digest.update(repr((path.name, path.stat().st_size, path.stat().st_mtime_ns)).encode())
        return digest.hexdigest()[:12]


def open_any(
    source: Any, *, channel: Channel = None, frame_rate_hz: float | None = None
) -> Recording:
    """Open a recording of any kind.

    Parameters
    ----------
    source
        Path of a film, stack, folder, pattern, array, Zarr recording or manifest; or an array
        (frame, row, col), with colours (frame, row, col, 3); or anything indexable of pictures.
    channel
        ``"red"``, ``"green"``, ``"blue"``, or a position from 0; None: of coloured pictures the
        brightest.
    frame_rate_hz
        None: that of the film, or 1. Zarr recordings and manifests state their own.

    Raises
    ------
    InputError
        If it cannot be read; the message names the file or the frame.

    Examples
    --------
    >>> recording = open_any(np.linspace(0, 1, 3)[:, None, None] * np.ones((24, 32)))
    >>> len(recording), int(recording.gray(1)[0, 0])
    (3, 32768)
    """
    if not isinstance(source, str | os.PathLike):
        if not hasattr(source, "__len__") or not hasattr(source, "__getitem__"):
            raise InputError(f"source: {source!r} is no path and no array of frames.")
        given = {"name": "array", "frame_rate_hz": frame_rate_hz}
        return _recording(source, range(len(source)), given, channel, {})
    path, text = Path(source), os.fspath(source)
    if path.suffix.lower() == ".toml":
        return read_manifest(path)
    if (path / "zarr.json").is_file() or not (path.exists() or re.search(r"[*?{\[]", text)):
        return open_recording(path)
    given = {"name": path.stem or path.resolve().name, "frame_rate_hz": frame_rate_hz}
    return _recording(*_images(Part(text, channel=channel), Path()), given, channel, {})


def _recording(
    images: Any, numbers: Sequence[int], given: Mapping[str, Any], channel: Channel, parts: Parts
) -> FileRecording:
    """Return the recording of some images; the first one decides size and channel."""
    where, notes, scale = f"recording {given.get('name')}", list[str](), None
    if not numbers:
        raise InputError(f"{where}: it has no frames.")
    first, position = np.asarray(images[0]), 0
    if first.ndim == 3:
        position, colours = channel_position(channel, first.shape[2], where), first[..., :3]
        if channel is None and (colours != colours[..., :1]).any():
            position = int(colours.mean(axis=(0, 1)).argmax())
            notes.append(f"coloured pictures: channel {CHANNELS[position]}, the brightest, is used")
    if missing := numbers[-1] - numbers[0] + 1 - len(numbers):
        notes.append(f"{missing} of the frames {numbers[0]} to {numbers[-1]} are missing")
    first = _one_channel(first, position, where)
    if first.dtype not in SMALL_TYPES:
        ends, fits = [], True
        for t, number in enumerate(numbers):
            image = _one_channel(images[t], position, f"{where}, frame {number}")
            ends += [float(image.min()), float(image.max())]
            fits = fits and _is_gray(image)
        if not fits:
            scale = min(ends), WHITE / ((max(ends) - min(ends)) or 1.0)
            notes.append(f"grey values: {min(ends):g} to {max(ends):g} are scaled to 0 to {WHITE}")
    rate = given.get("frame_rate_hz") or getattr(images, "frame_rate_hz", 1.0)
    found = {"name": None, "rows": first.shape[0], "columns": first.shape[1], "notes": notes}
    attributes = Attributes.from_json({**found, **given, "frame_rate_hz": rate})
    return FileRecording(attributes, numbers, images, position, scale, parts)


def _one_channel(image: Any, channel: int, where: str) -> Anything:
    """Return one channel of a picture, or raise an `InputError`."""
    array = np.asarray(image)
    array = array[..., channel] if array.ndim == 3 and array.shape[2] <= 4 else array
    real = array.dtype.kind in "buif" and not np.ma.isMaskedArray(image)
    if array.ndim != 2 or not array.size or not real or not np.isfinite(array).all():
        kind = f"{array.dtype} of shape {np.shape(image)}"
        rule = "(rows, cols) without a mask, or with a last axis of up to four channels"
        raise InputError(f"{where}: {kind} is no picture. Give finite numbers {rule}.")
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _is_gray(image: Anything) -> bool:
    """Return whether all values are whole numbers of 16 bits."""
    return not (image % 1).any() and bool(image.min() >= 0) and bool(image.max() <= WHITE)


def _images(part: Part, folder: Path) -> tuple[Any, Sequence[int]]:
    """Return the pictures of a file, folder or pattern, and the frames' numbers."""
    path, ending = folder / part.pattern, Path(part.pattern).suffix.lower()
    if not path.is_file():
        found = _numbered(part.pattern, folder)
        return PictureFiles(list(found.values()), part.key), list(found)
    images: Any = Film(path) if ending in FILMS else PictureFiles([path])
    if ending not in FILMS + PICTURES:
        images = read_array(path, part.channel if ending in TIFFS else part.key, stack=True)
    return images, range(len(images))


def _numbered(pattern: str, folder: Path) -> dict[int, Path]:
    """Return the files of a folder or pattern by the number of their frame, in order."""
    whole, parts = folder / pattern, re.split(r"\{frame[^}]*\}", str(Path(pattern)))
    texts = [re.escape(text).replace(r"\*", ".*").replace(r"\?", ".") for text in parts]
    rule = r"(\d+)".join(texts) + "$"
    paths = [folder / name for name in glob.glob("*".join(parts), root_dir=folder)]
    if whole.is_dir():
        paths = [path for path in whole.iterdir() if path.suffix.lower() in PICTURES + TIFFS]
    files: dict[int, Path] = {}
    for path in sorted(paths):
        found = re.search(rule, str(path)) if len(parts) > 1 else re.search(r"(\d+)\D*$", path.stem)
        number = int(found.groups()[-1]) if found else -1
        if number in files or number < 0:
            rule = "Write {frame} where the number stands: film/a_{frame}_8bit.png"
            raise InputError(f"{path}: has no number, or that of another file ({number}). {rule}.")
        files[number] = path
    if not files:
        raise InputError(f"{whole}: no file fits the pattern, or none is a picture.")
    return dict(sorted(files.items()))


def _points(part: Part, path: Path, size: tuple[int, ...]) -> dict[str, Anything]:
    """Return pixels and positions in one file, without pixels that have no depth."""
    array, names = read_array(path, part.key), list(part.columns)
    pixels: Anything
    if part.form == "grid":
        check_shape(array, (*size, 3), str(path))
        pixels, xyz = np.indices(size).reshape(2, -1).T, array.reshape(-1, 3)
    else:
        table = pd.DataFrame(array, columns=None if array.dtype.names else names)
        check_columns(table, names, str(path))
        columns = [known_numbers(table[name], f"{path}: column {name}") for name in names]
        pixels, xyz = np.stack(columns[:2], 1) - part.origin, np.stack(columns[2:], 1)
    missing: Any = np.isnan(xyz).any(axis=1)
    if not np.isnan(invalid := np.float32(part.invalid)):
        missing = xyz[:, 2].astype(np.float32) == invalid
    pixels, xyz = pixels[~missing], xyz[~missing]
    if not (np.abs(pixels) < 2**31).all() or (pixels % 1).any() or (len(missing) and not len(xyz)):
        raise InputError(f"{path}: row and col of a point are not whole, or none has a position.")
    with np.errstate(over="ignore"):  # what is too large becomes infinite, which is refused
        positions = (xyz * (1000.0 if part.unit == "m" else 1.0)).astype(np.float32)
    return {"pixels": pixels.astype(np.int32), "xyz": positions}


def _labels(part: Part, path: Path, size: tuple[int, ...]) -> dict[str, Picture]:
    """Return the classes of Table 5.1 in one file."""
    image = read_array(path, part.key)
    check_shape(image, size, str(path))
    labels = np.full(size, 255, np.uint8)
    for theirs, ours in part.classes.items():
        labels[image == int(theirs)] = ours
    if (unknown := image[labels == 255]).size:
        raise InputError(f"{path}: class {unknown[0]} is not in classes. Add it.")
    return {"labels": labels}


def read_manifest(manifest: Path | str) -> FileRecording:
    """Return the recording that a manifest describes; its first image gives the size.

    Raises
    ------
    InputError
        If it is not TOML, a value is not possible, or a file is missing.
    """
    manifest, folder = Path(manifest), Path(manifest).parent
    try:
        table = tomllib.loads(manifest.read_text(encoding="utf-8"))
        names: list[str] = [name for name in ("gray", "coordinates", "labels") if name in table]
        parts = {name: Part(**table.pop(name)) for name in names}
        if "gray" not in parts:
            raise InputError("there is no [gray]; give it a pattern")
        gray = parts.pop("gray")
        images, numbers = _images(gray, folder)
        files = {name: (part, _numbered(part.pattern, folder)) for name, part in parts.items()}
        for _, found in files.values():
            if extra := found.keys() - set(numbers):
                raise InputError(f"{found[min(extra)]} is of frame {min(extra)}, without gray.")
        return _recording(images, numbers, table, gray.channel, files)
    except (OSError, TypeError, ValueError) as error:  # not there, a wrong type, no TOML or text
        raise InputError(f"{manifest}: {getattr(error, 'strerror', None) or error}") from error


def import_recording(source: Path | str, target: Path | str) -> pd.DataFrame:
    """Import a recording of any kind (`open_any`), all of it or nothing.

    Returns
    -------
    DataFrame
        What it holds, as `summarise_recording` reads it from the new folder.
    """
    return summarise_recording(write_recording(open_any(source), target))
