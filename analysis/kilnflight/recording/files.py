"""Films, stacks, pictures, arrays and manifests of other programs, opened as
recordings.

`open_any` takes

==========================  ================================================================
AVI, MP4, MOV, MKV          decoded by OpenCV, 8 bit TIFF of several pages       axis T
of ImageJ and OME, or pages without a name; z and channels
                            are refused
folder or pattern           PNG, TIFF, JPEG, NPY, ... one file a frame: ``film/*.png``
or
                            ``film/a_{frame}_8bit.png``; the frame's number stands at
                            ``{frame}``, or is the last one in the name
NPY, MAT, HDF5              (frame, row, col), also with a last axis of colours
array, or anything indexed  the same, or pictures (row, col) one by one
Zarr                        what ``kilnflight import``, ``export`` or ``run`` wrote
TOML                        a manifest, where depth, labels or metadata come in
==========================  ================================================================

Numbers that are not there are frames that are not there. Of coloured pictures one
channel is taken, by default that which varies most in the first frame. Whole grey
values from 0 to 65535 are taken as they are (8, 10, 12, 16 bit); others, such as floats
from 0 to 1, are scaled linearly to that range, by the least and the largest value of
the recording. `Attributes.notes` says so.

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
    # channel = "red"                 # only of coloured pictures; refused for grey ones

    [coordinates]
    pattern = "xyz/frame_{frame:04d}.mat"
    key = "XYZ"                       # variable or data set, where a file holds several
    form = "grid"                     # (rows, cols, 3) in MAT, HDF5, NPY or TIFF
    invalid = "nan"                   # or a number: the depth of a pixel that has none
    unit = "mm"                       # or "m"

    [labels]                          # PNG, TIFF, NPY, MAT, HDF5
    pattern = "labels/frame_{frame:04d}.png"
    classes = { 0 = 0, 60 = 1, 120 = 2, 180 = 3, 240 = 4 }     # theirs = Table 5.1

Only ``name``, ``frame_rate_hz`` and ``[gray]`` are needed. Coordinates and labels may
cover some frames only. With ``form = "points"`` each file lists row, col, x, y, z of
points: in CSV by name, in arrays (n, 5) by position. ``origin = 1`` counts pixels from
1.

Classes of Table 5.1: 0 wall, 1 flame, 2 burning in air, 3 non-burning in air, 4 burning
on the wall. Coordinates, the lance's too, are those of the camera as captured.
``depth_calibration`` makes true depths of them: pairs of captured and true depth in mm,
a fit (``breakpoints_mm``, ``coefficients`` in mm, highest power first),
``"zhang-2023"`` (Eq. 2.4, which holds for that one camera), or ``"none"``, the default.
"""

from __future__ import annotations

import fnmatch
import glob
import hashlib
import logging
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import numpy.typing as npt
import pandas as pd
import scipy.io
import tifffile

from kilnflight.checks import InputError, check_columns, check_shape, real_numbers
from kilnflight.recording.frames import (
    Attributes,
    Frame,
    Gray,
    check_frame,
    check_position,
    count_frames,
)
from kilnflight.recording.store import StoredRecording, open_recording
from kilnflight.recording.track_files import read_csv

FILMS = (".avi", ".mkv", ".mov", ".mp4")
TIFFS = (".tif", ".tiff")
PICTURES = (".bmp", ".jpeg", ".jpg", ".png")
CHANNELS = ("red", "green", "blue")
POINT = ["row", "col", "x", "y", "z"]
SMALL_TYPES = (
    np.bool_,
    np.uint8,
    np.uint16,
)  # they hold nothing but grey values of 16 bits
WHITE = 65_535
MOST_PX = 200_000_000  # the largest grey value, the largest picture
Anything = npt.NDArray[Any]
# Keys of a manifest and of its tables, each with a regular expression of its value's
# `repr`
TEXT = r"['\"].*"
NUMBER = r"-?(?:inf|nan|\d[\d.e+-]*)"
PARTS = ("gray", "coordinates", "labels")
MANIFEST = dict.fromkeys(("name", "fraction"), TEXT) | dict.fromkeys(PARTS, r"\{.*\}")
MANIFEST |= dict.fromkeys(("frame_rate_hz", "pressure_bar"), NUMBER) | {
    "name": r"['\"][^/]+"
}
MANIFEST |= {
    "lance_mm": rf"\[{NUMBER}, {NUMBER}, {NUMBER}\]",
    "flame_roi": r"\[(\d+(, |\])){4}",
}
MANIFEST |= {
    "roi": rf"\[(\[{NUMBER}, {NUMBER}\](, )?)+\]",
    "depth_calibration": r"['\"\[{].*",
}
PART = dict.fromkeys(("pattern", "key", "channel"), TEXT) | {
    "invalid": f"'nan'|{NUMBER}"
}
PART |= {"form": "'grid'|'points'", "unit": "'mm'|'m'", "origin": "[01]"}
PART |= {"classes": r"\{('-?\d+': [0-4](, )?)*\}"}  # of Table 5.1
DEFAULTS = {"form": "grid", "invalid": "nan", "unit": "mm", "origin": 0, "classes": {}}

logging.getLogger("tifffile").setLevel(
    logging.CRITICAL
)  # it would print what is raised here


# Tables of a manifest by name, each with its files by number of the frame
Parts = Mapping[str, tuple[Mapping[str, Any], dict[int, Path]]]


@dataclass(frozen=True, eq=False)
class FileRecording:
    """Frames in the files of other programs, or in memory.

    Parameters
    ----------
    attributes
        Facts about the whole recording.
    numbers
        Number of each frame in the files, ascending.
    index
        Number of each frame: ``numbers``, or counted from 0 where those go in longer
        steps.
    images
        Pictures (rows, cols) or (rows, cols, channels), read one by one.
    channel
        Of coloured pictures, one of `CHANNELS`.
    scale
        Value that becomes 0, and grey values per unit; None: whole grey values as they
        are.
    parts
        Coordinates and labels.
    """

    attributes: Attributes
    numbers: Sequence[int] = field(repr=False)
    index: Sequence[int] = field(repr=False)
    images: Any = field(repr=False)
    channel: str | None = None
    scale: tuple[float, float] | None = None
    parts: Parts = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.numbers)

    def gray(self, t: int) -> Gray:
        """Return the grey values (rows, cols) of frame ``t``, counted from 0."""
        check_position(t, len(self), self.attributes.name)
        where = f"recording {self.attributes.name}, frame {self.numbers[t]}"
        if getattr(self.images, "_mmap", None) is not None:
            self.images._mmap.madvise(
                4
            )  # DONTNEED: else all that was read stays in memory
        image = _one_channel(self.images[t], self.channel, where)
        check_shape(image, self.attributes.size, where)
        if self.scale is not None:
            image = np.rint((image.astype(np.float64) - self.scale[0]) * self.scale[1])
        elif not (image.dtype in SMALL_TYPES or _ends(image)[2]):
            raise InputError(
                f"{where}: its values are not whole numbers from 0 to {WHITE}."
            )
        return np.ascontiguousarray(image, np.uint16)

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0, with its points and labels."""
        gray = self.gray(t)
        number = self.numbers[t]
        more = dict[str, Any]()
        for name, (part, files) in self.parts.items():
            if number in files:
                read = _points if name == "coordinates" else _labels
                more |= read(part, files[number], gray.shape)
        time_s = (self.index[t] - self.index[0]) / self.attributes.frame_rate_hz
        return check_frame(Frame(self.index[t], time_s, gray, **more), self.attributes)

    @property
    def files(self) -> list[Path]:
        """The files of single frames, and a film."""
        parts = [path for _, found in self.parts.values() for path in found.values()]
        return [*getattr(self.images, "files", ()), *parts]

    def content(self) -> str:
        """Return a hash (12 hex digits) of attributes and the files' names, sizes and
        times.

        Arrays in memory are hashed frame by frame.
        """
        digest = hashlib.sha256(repr((self, list(self.numbers))).encode())
        for t in range(0 if hasattr(self.images, "files") else len(self)):
            digest.update(self.gray(t).tobytes())
        for path in self.files:
            digest.update(
                repr((path.name, path.stat().st_size, path.stat().st_mtime_ns)).encode()
            )
        return digest.hexdigest()[:12]


def open_any(
    source: Any, *, channel: str | None = None, frame_rate_hz: float | None = None
) -> FileRecording | StoredRecording:
    """Open a recording of any kind.

    Parameters
    ----------
    source
        Path of a film, stack, folder, pattern, array, Zarr recording or manifest; or an
        array (frame, row, col), with colours (frame, row, col, 3); or anything
        indexable of pictures.
    channel
        ``"red"``, ``"green"`` or ``"blue"``; None: of coloured pictures that which
        varies most.
    frame_rate_hz
        None: that of the film, or 1. Zarr recordings and manifests state rate and
        channel themselves; with them both are refused.

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
    if hasattr(source, "attributes"):  # open already
        return source
    name = "array"
    indexed = hasattr(source, "__len__") and hasattr(source, "__getitem__")
    if isinstance(source, str | Path):
        path = Path(source)
        manifest = Path(source).suffix.lower() == ".toml"
        is_there = path.exists() or re.search(r"[*?{\[]", str(path))
        if manifest or not is_there or (path / "zarr.json").is_file():
            if is_there and (channel is not None or frame_rate_hz is not None):
                raise InputError(
                    f"{path}: leave out channel and frame_rate_hz; it states both."
                )
            return _manifest(path) if manifest else open_recording(path)
        # of a pattern that of its folder
        name = (
            path.stem
            if path.is_file()
            else Path(path, "_" * path.is_dir(), "..").resolve().name
        )
        images, numbers = _images(DEFAULTS | {"pattern": str(path)}, Path())
    elif indexed and not hasattr(source, "keys") and getattr(source, "shape", True):
        images = source
        numbers = range(len(source))
    else:
        raise InputError(
            f"source: {type(source).__name__} is no path and no array of frames."
        )
    return _recording(
        images, numbers, {"name": name, "frame_rate_hz": frame_rate_hz}, channel, {}
    )


def _recording(
    images: Any,
    numbers: Sequence[int],
    given: Mapping[str, Any],
    channel: str | None,
    parts: Parts,
) -> FileRecording:
    """Return the recording of some images; the first one decides size and channel."""
    where = f"recording {given.get('name')}"
    notes = list[str]()
    scale = None
    if not numbers:
        raise InputError(f"{where}: it has no frames.")
    first = np.asarray(images[0])
    colours = first[..., :3] if first.ndim == 3 else np.empty((1, 1, 0))
    if channel is None and (colours != colours[..., :1]).any():
        channel = CHANNELS[colours.std(axis=(0, 1)).argmax()]
        notes.append(
            f"coloured pictures: channel {channel}, which varies most, is used"
        )
    elif channel not in (None, *CHANNELS[: colours.shape[2]]):
        raise InputError(
            f"{where}: it has no channel {channel!r}. Leave it out, or name a colour."
        )
    index, step = count_frames(numbers)
    if step != 1:
        notes.append(f"numbers go in steps of {step:g}: frames are counted from 0")
    missing = max(index[-1] - index[0] + 1, getattr(images, "stated", 0)) - len(index)
    if missing:
        notes.append(f"{missing} of {missing + len(index)} frames are missing")
    first = _one_channel(first, channel, f"{where}, frame {numbers[0]}")
    if first.dtype not in SMALL_TYPES or first.max() <= 1:
        frames = (f"{where}, frame {number}" for number in numbers)
        ends = [
            _ends(_one_channel(images[t], channel, at)) for t, at in enumerate(frames)
        ]
        low = min(end[0] for end in ends)
        high = max(end[1] for end in ends)
        if high == 1 or not all(whole for *_, whole in ends):
            scale = low, WHITE / ((high - low) or 1.0)
            notes.append(f"grey values: {low:g} to {high:g} are scaled to 0 to {WHITE}")
    found = {"rows": first.shape[0], "columns": first.shape[1], "notes": notes}
    found["frame_rate_hz"] = getattr(images, "frame_rate_hz", 1.0)
    found |= {key: value for key, value in given.items() if value is not None}
    return FileRecording(
        Attributes.from_json(found), numbers, index, images, channel, scale, parts
    )


def _one_channel(image: Any, channel: str | None, where: str) -> Anything:
    """Return one channel of a picture, or raise an `InputError`."""
    array = np.asarray(image)
    if array.ndim == 3 and array.shape[2] <= 4:
        if channel is None and (array[..., :3] != array[..., :1]).any():
            raise InputError(f"{where}: coloured, as the first is not. Name a channel.")
        array = array[..., CHANNELS.index(channel or CHANNELS[0])]
    # of four columns or fewer: the rows of one coloured picture
    fits = (
        array.dtype.kind in "buif"
        and not np.ma.isMaskedArray(image)
        and array.shape[-1:] > (4,)
    )
    if array.ndim != 2 or not array.size or not fits or not np.isfinite(array).all():
        kind = f"{array.dtype} of shape {np.shape(image)}"
        raise InputError(
            f"{where}: {kind}. Give (frame, row, col), finite, without a mask."
        )
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _ends(image: Anything) -> tuple[float, float, bool]:
    """Return the least and largest value, and whether all are whole numbers of 16 bits."""
    low = float(image.min())
    high = float(image.max())
    return low, high, low >= 0 and high <= WHITE and not (image % 1).any()


def _images(part: Mapping[str, Any], folder: Path) -> tuple[Any, Sequence[int]]:
    """Return the pictures of a file, folder or pattern, and the frames' numbers."""
    path = folder / part["pattern"]
    ending = Path(part["pattern"]).suffix.lower()
    if not path.is_file():
        found = _numbered(part["pattern"], folder)
        return PictureFiles(list(found.values()), part.get("key")), list(found)
    images: Any = (
        Film(path) if ending in FILMS else read_array(path, part.get("key"), stack=True)
    )
    return images, range(len(images))


def _numbered(pattern: str, folder: Path) -> dict[int, Path]:
    """Return the files of a folder or pattern by the number of their frame, in order."""
    whole = (folder / pattern).is_dir()
    number = r"(?P<number>\d+)"
    text = re.sub(r"\{frame[^}]*\}", "FRAME", str(Path(pattern))) + "/*" * whole
    last = number + r"[^\d/]*\.\w+$"
    named = fnmatch.translate(text).replace("FRAME", number, 1)
    files = dict[int, Path]()
    endings = PICTURES + TIFFS if whole else ("",)
    names = glob.glob(text.replace("FRAME", "*"), root_dir=folder)
    names = [n for n in names if n.lower().endswith(endings) and (folder / n).is_file()]
    form, all_numbers = (named, named) if "FRAME" in text else (last, r"\d+")
    for name in sorted(
        names, key=lambda name: [*map(int, re.findall(all_numbers, name))]
    ):
        found = re.search(form, name)
        path = folder / name
        if not found or not max(files, default=-1) < int(found["number"]) < 2**63:
            advice = "Write {frame} where the number stands: film/a_{frame}_8bit.png"
            raise InputError(
                f"{path}: has no number above that of the file before. {advice}."
            )
        files[int(found["number"])] = path
    if not files:
        raise InputError(
            f"{folder / pattern}: no file fits the pattern, or none is a picture."
        )
    return dict(sorted(files.items()))


def _points(
    part: Mapping[str, Any], path: Path, size: tuple[int, ...]
) -> dict[str, Anything]:
    """Return pixels and positions in one file, without pixels that have no depth."""
    array = real_numbers(read_array(path, part.get("key")), str(path))
    grid = part["form"] == "grid"
    check_shape(array, (*size, 3) if grid else (None, 5), str(path))
    pixels: Any = (
        np.indices(size).reshape(2, -1).T if grid else array[:, :2] - part["origin"]
    )
    xyz = array[..., -3:].reshape(-1, 3)
    missing = np.isnan(xyz).any(axis=1) | (
        xyz[:, 2].astype("f4") == np.float32(part["invalid"])
    )
    pixels = pixels[~missing]
    xyz = xyz[~missing]
    if (
        not (np.abs(pixels) < 2**31).all()
        or (pixels % 1).any()
        or (len(missing) and not len(xyz))
    ):
        raise InputError(
            f"{path}: row and col of a point are not whole, or none has a position."
        )
    with np.errstate(
        over="ignore"
    ):  # what is too large becomes infinite, which is refused
        positions = (xyz * (1000.0 if part["unit"] == "m" else 1.0)).astype(np.float32)
    return {"pixels": pixels.astype(np.int32), "xyz": positions}


def _labels(
    part: Mapping[str, Any], path: Path, size: tuple[int, ...]
) -> dict[str, Anything]:
    """Return the classes of Table 5.1 in one file."""
    image = read_array(path, part.get("key"))
    check_shape(image, size, str(path))
    labels = pd.Series(image.ravel()).map(
        {int(k): ours for k, ours in part["classes"].items()}
    )
    for unknown in image.ravel()[labels.isna()][:1]:
        raise InputError(f"{path}: class {unknown} is not in classes. Add it.")
    return {"labels": labels.to_numpy(np.uint8).reshape(size)}


def _manifest(manifest: Path) -> FileRecording:
    """Return the recording that a manifest describes."""
    folder = manifest.parent
    try:
        # a longer one, of dots alone, is read for hours
        table = tomllib.loads(
            manifest.read_text("utf-8-sig")[: 2**15].replace("\\", "/")
        )
        _check_table(table, MANIFEST, "name", "frame_rate_hz", "gray")
        for name in table.keys() & set(PARTS):
            _check_table(table[name], PART, "pattern", where=f"[{name}] ")
        parts = {name: DEFAULTS | table.pop(name) for name in PARTS if name in table}
        gray = parts.pop("gray")
        images, numbers = _images(gray, folder)
        files = {
            name: (part, _numbered(part["pattern"], folder))
            for name, part in parts.items()
        }
        for _, found in files.values():
            extra = found.keys() - set(numbers)
            if extra:
                raise InputError(
                    f"{found[min(extra)]} is of frame {min(extra)}, without gray."
                )
        return _recording(images, numbers, table, gray.get("channel"), files)
    # not there, a wrong type, no TOML or text, nested too deep
    except (OSError, TypeError, ValueError, RecursionError) as error:
        raise InputError(
            f"{manifest}: {getattr(error, 'strerror', None) or error}"
        ) from error


def _check_table(
    table: Any, rules: Mapping[str, str], *needed: str, where: str = ""
) -> None:
    """Raise an `InputError` that names a key, if one is missing, unknown or of another
    form.
    """
    for key in (*needed, *table):
        if not re.fullmatch(rules.get(key, ""), repr(table.get(key))):
            wrong = (
                f"= {table[key]!r:.80} cannot be used" if key in table else "is missing"
            )
            raise InputError(
                f"{where}{key} {wrong}; see pydoc kilnflight.recording.files."
            )


@dataclass(frozen=True)
class PictureFiles:
    """Pictures in one file each."""

    files: Sequence[Path]
    key: str | None = None

    def __getitem__(self, t: int) -> Anything:
        """Return the picture of frame ``t``."""
        return read_array(self.files[t], self.key)


class Film:
    """Frames of a film, decoded in order; a step back decodes it again from the start."""

    def __init__(self, path: Path) -> None:
        self.files = [path]
        self._capture = cv2.VideoCapture(str(path))
        self.frame_rate_hz = self._capture.get(cv2.CAP_PROP_FPS) or 1.0
        self.stated = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        # counted: the header may announce another length
        self._length = self._next = sum(1 for _ in iter(self._capture.grab, False))
        if not self._length:
            raise InputError(
                f"{path}: no frame can be decoded. Convert it: ffmpeg -i FILM a.avi"
            )

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, t: int) -> Anything:
        """Return the picture of frame ``t``, colours as red, green, blue."""
        if t < self._next:
            self._capture = cv2.VideoCapture(str(self.files[0]))
            self._next = 0
        for _ in range(self._next, t + 1):
            self._capture.grab()
        self._next = t + 1
        return _from_bgr(self._capture.retrieve()[1])


def read_array(path: Path, key: str | None = None, stack: bool = False) -> Anything:
    """Return the array or picture in a file, by its ending; colours as red, green,
    blue.

    Parameters
    ----------
    path
        The file. MAT v7.3 comes in MATLAB's order of axes, CSV as a structured array.
    key
        Variable or data set, where a file holds several.
    stack
        Whether one picture is a stack of one.

    Raises
    ------
    InputError
        If it cannot be read, naming the file.
    """
    ending = path.suffix.lower()
    try:
        if ending in TIFFS:
            pages = _tiff(path)
            return pages if stack or len(pages) > 1 else pages[0]
        if ending in PICTURES:
            content = np.frombuffer(path.read_bytes() or b"0", np.uint8)
            picture = _from_bgr(cv2.imdecode(content, cv2.IMREAD_UNCHANGED))
            return picture[None] if stack else picture
        if ending == ".csv":
            table = read_csv(path)
            check_columns(table, POINT, str(path))
            return table[POINT].to_numpy()
        if ending == ".npy":
            return np.atleast_1d(np.load(path, mmap_mode="r"))
        if ending in (".h5", ".hdf5") or (ending == ".mat" and h5py.is_hdf5(path)):
            with h5py.File(path) as file:
                return _chosen(file, key).T if ending == ".mat" else _chosen(file, key)
        if ending == ".mat":
            return _chosen(scipy.io.loadmat(path), key)
        raise InputError("this kind of file is not known. Convert it.")
    except Exception as error:  # libraries raise anything on damaged bytes
        reason = (
            getattr(error, "strerror", None)
            or " ".join(str(error).split())
            or "no content"
        )
        damaged = (
            ""
            if isinstance(error, InputError | OSError)
            else ". Is it cut off or damaged?"
        )
        raise InputError(f"{path}: {reason}{damaged}") from error


def _check_size(shape: Sequence[int]) -> None:
    """Raise an `InputError` if a picture of an array is larger than any camera's."""
    if np.prod(sorted(shape)[-2:], dtype=np.float64) > MOST_PX:
        raise InputError(f"pictures of {shape} px are above {MOST_PX} px. Cut them.")


def _chosen(content: Any, key: str | None) -> Anything:
    """Return an array of a file by its key, or the only one."""
    names = [
        name for name in map(str, content) if not name.startswith("__")
    ]  # as loadmat's own
    chosen = content.get(names[0] if key is None and len(names) == 1 else key or "/")
    if not hasattr(chosen, "shape"):
        missing = "" if key is None else f", and no array {key!r}"
        raise InputError(
            f"it holds {', '.join(names)}{missing}. Name an array: key in a manifest."
        )
    _check_size(chosen.shape)
    elsewhere = getattr(chosen, "is_virtual", False) or getattr(
        chosen, "external", None
    )
    if elsewhere or getattr(chosen, "file", content) != content:
        raise InputError("its values lie in another file. Copy them into this one.")
    return np.atleast_1d(chosen)


def _from_bgr(image: Anything | None) -> Anything:
    if image is None:
        raise InputError("a picture cannot be decoded. Is the file damaged?")
    return (
        image if image.ndim == 2 else image[..., [2, 1, 0, *range(3, image.shape[2])]]
    )


def _tiff(path: Path) -> Anything:
    """Return the pages (n, rows, cols) or with colours, on disk where they can be
    mapped.
    """
    with tifffile.TiffFile(path) as tif:
        empty = not tif.series  # this reads the table of pages
        tif.filehandle.seek(tif.pages.next_page_offset or 0)
        if empty or tif.filehandle.read(4) != bytes(4):
            raise ValueError("it ends within its pages")
        series = tif.series[0]
        page = tif.pages.first
        count = len(tif.pages)
        _check_size(page.shape[:2])
        try:
            images = tif.asarray(
                slice(None) if len(tif.series) > 1 else None, out="memmap"
            )
        except ValueError:  # a compression that tifffile leaves to another package
            images = np.array(
                [*map(_from_bgr, cv2.imreadmulti(str(path), flags=-1)[1])]
            )
    if images.dtype.newbyteorder("=") != page.dtype or images.size < page.size * count:
        raise ValueError(
            f"its compression of {page.dtype} is not known, or it is damaged"
        )
    axes = {axis for axis, n in zip(series.axes, series.shape, strict=True) if n > 1}
    if axes - set("TIQYXS") or page.photometric not in (1, 2, 6):  # grey, RGB, JPEG's
        remedy = (
            "Save grey values of one plane, black as 0; time is T (ImageJ: Image > "
            "Properties)"
        )
        raise InputError(f"axes {series.axes}, colours {page.photometric!r}. {remedy}.")
    return images.reshape(-1, *page.shape)
