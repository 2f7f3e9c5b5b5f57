"""Arrays, pictures, stacks and films in files of other programs."""

import fnmatch
import glob
import io
import logging
import math
import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pandas as pd
import scipy.io
import tifffile
from PIL import Image

from kilnflight.arrays import Anything, Facts, Named, Texts
from kilnflight.checks import InputError, check_number
from kilnflight.recording.frames import count_frames

FILMS = (".avi", ".mkv", ".mov", ".mp4")
TIFFS = (".tif", ".tiff")
PICTURES = (".bmp", ".jpeg", ".jpg", ".png", *TIFFS)
TEXTS = (".csv", ".txt", ".dat", ".asc")
GRAY_16 = 0x10003159  # OpenCV's name of grey values of 16 bits
ROUNDED_S = 6e-4  # some films state the time of a frame in whole ms
# readers.toml has names of columns, and what ImageJ and OME state of a TIFF.
_KNOWN = tomllib.loads(Path(__file__).with_name("readers.toml").read_text("utf-8"))
POINT: list[str] = _KNOWN["point"]
NAMED = (POINT, *_KNOWN["named"])
SAME = _KNOWN["same"]
UNITS = _KNOWN["units"]
STATED = _KNOWN["stated"]
MOST_COLUMNS = 20_000  # of a text; no camera has more
MOST_PX = 200_000_000  # no camera has more; a small file may state more
Key = str | Texts | None  # variable or data set; several become columns

# tifffile would print what is raised here.
logging.getLogger("tifffile").setLevel(logging.CRITICAL)


@dataclass(frozen=True)
class PictureFiles:
    """Pictures in one file each."""

    files: Sequence[Path]
    key: Key = None

    def __getitem__(self, t: int) -> Anything:
        """Return the picture of frame ``t``."""
        file = self.files[t]
        picture = read_array(file, self.key)
        if picture.ndim == 3 and picture.shape[2] > 4:  # no colours
            raise InputError(
                f"{file}: {len(picture)} pages, but the first file has one. Save each "
                "frame as a file, or all as one."
            )
        return picture


class Layers(PictureFiles):
    """Pictures (rows, cols) that lie in one file as (rows, cols, n)."""

    def __getitem__(self, t: int) -> Anything:
        """Return the picture of frame ``t``."""
        return read_layers(self.files[0], self.key)[..., t]


@dataclass(frozen=True)
class Slabs(PictureFiles):
    """Pictures that lie in one HDF5 file as (n, rows, cols), read one by one."""

    array: Any = None

    def __getitem__(self, t: int) -> Anything:
        """Return the picture of frame ``t``."""
        try:
            return self.array[t]
        except OSError as error:
            raise InputError(f"{self.files[0]}, frame {t}: is damaged.") from error


class Pages(PictureFiles):
    """Pages of several files; a file stands once for each of its pages."""

    def __getitem__(self, t: int) -> Anything:
        """Return the picture of frame ``t``."""
        file = self.files[t]
        return read_pages(file)[t - self.files.index(file)]


class Film:
    """Frames of a film, decoded in order; a step back decodes from the start.

    Their ``numbers`` follow from time stamps, which some films round to ms. The header
    may state a mean rate, and another number of frames.
    """

    def __init__(self, path: Path) -> None:
        self.files = [path]
        capture = self._capture = self._opened()
        times = []
        while capture.grab():
            times.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
        if not times:
            raise InputError(
                f"{path}: no frame can be decoded. Convert it: ffmpeg -i FILM a.avi"
            )
        self._next = len(times)
        rate_hz = capture.get(cv2.CAP_PROP_FPS)
        length = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        stamps = np.array(times)
        if rate_hz and not np.diff(stamps).all():  # none, or several in 1 ms
            stamps = np.arange(self._next) / rate_hz
            length = 0
        exact = stamps * rate_hz
        counted = np.rint(exact)
        if not np.allclose(exact, counted, 0, ROUNDED_S * rate_hz):
            counted = stamps  # that rate is a mean
        self.numbers, _ = count_frames(counted)
        if np.diff(self.numbers).min(initial=1) < 1:
            raise InputError(
                f"{path}: its time stamps go backwards, or it states 0 frames/s. "
                "Convert it: ffmpeg -i FILM -vf setpts=N/25/TB a.mkv"
            )
        self.facts = Facts(frame_rate_hz=rate_hz, length=length)
        steps = np.ptp(self.numbers)
        if round(np.ptp(stamps) * rate_hz) != steps:
            self.facts = Facts(frame_rate_hz=steps / np.ptp(stamps))
        bits = int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) >> 24
        if 8 < bits < 16:
            self.facts["notes"] = [f"of {bits} bits 8 are read: make them 16 first"]

    def _opened(self) -> cv2.VideoCapture:
        """Return the film at its start; grey values of 16 bits are not converted."""
        capture = cv2.VideoCapture(str(self.files[0]))
        if capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT) == GRAY_16:
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        return capture

    def __getitem__(self, t: int) -> Anything:
        """Return the picture of frame ``t``, colours as red, green, blue."""
        if t < self._next:
            self._capture = self._opened()
            self._next = 0
        for _ in range(self._next, t + 1):
            self._capture.grab()
        self._next = t + 1
        return _from_bgr(self._capture.retrieve()[1])


def open_images(
    pattern: str, folder: Path, key: Key = None
) -> tuple[Any, Sequence[int], Facts]:
    """Open the pictures of a file, folder or pattern.

    Parameters
    ----------
    pattern
        Path or pattern, relative to ``folder``.
    folder
        Folder of the manifest, or the working directory.
    key
        Variable or data set, where a file holds several.

    Returns
    -------
    images
        Pictures (rows, cols) or (rows, cols, channels), read one by one.
    numbers
        Number of each frame, ascending.
    facts
        Attributes that the files state, with ``notes`` and a film's ``length``.
    """
    forget()
    path = folder / pattern
    if path.is_file():
        if path.suffix.lower() in FILMS:
            film = Film(path)
            return film, film.numbers, film.facts
        stack: Any = read_stack(path, key)
        numbers = range(len(stack))
        if isinstance(stack, h5py.Dataset):
            stack = Slabs([path], key, stack)
        return stack, numbers, _stated(path)[0]
    files = number_files(pattern, folder)
    paths = [*files.values()]
    read_stack(paths[0], key)  # it raises where that file is damaged
    facts, text = _stated(paths[0])
    if paths[-1].name in text:  # a set in OME, which its first file opens
        paths = paths[:1]
    elif facts.get("length", 1) == 1:
        return PictureFiles(paths, key), [*files], facts
    facts["notes"].append(f"{len(files)} files with pages are one film")
    paths = [path for path in paths for _ in read_pages(path)]
    return Pages(paths), range(len(paths)), facts


def _stated(path: Path) -> tuple[Facts, str]:
    """Return what ImageJ or OME state of a TIFF, as `open_images`, and their text."""
    if path.suffix.lower() not in TIFFS:
        return {"notes": []}, ""
    notes = []
    with tifffile.TiffFile(path) as tif:
        page = tif.pages.first
        if "Z" in tif.series[0].axes:
            notes.append("slices along z are read as frames in time")
        facts = Facts(notes=notes, length=len(tif.pages))
    # unit=um in a line of ImageJ's, PhysicalSizeX="0.65" in OME
    told = STATED | Facts(re.findall(r'(\w+)="?([^"\n]+)', page.description))
    for key in STATED:
        value = told[key]
        try:
            told[key] = check_number(float(UNITS.get(value, value) or 0), key, least=0)
        except ValueError:
            notes.append(f"{path.name}: {key} is {value!r}: not used")
            told[key] = 0.0
    across = told["PhysicalSizeX"]
    along = told["PhysicalSizeY"]
    width = told["unit"] / (page.resolution[0] or np.inf)
    width += across * told["PhysicalSizeXUnit"]
    step = told["TimeIncrement"] * told["TimeIncrementUnit"]
    step = step or told["finterval"] * told["tunit"]
    if "DeltaT" in told:
        notes.append("times of single frames (DeltaT) are not used")
    if across * along and not np.isclose(across, along, 0.01):
        notes.append("pixels are not square: the scale is not used")
    elif width:
        facts["um_per_px"] = width
        notes.append(f"the file states {width:g} um/px")
    if step:
        facts["frame_rate_hz"] = 1 / step
        notes.append(f"the file states {step:g} s a frame")
    return facts, page.description


def _split(pattern: str, folder: Path) -> tuple[Path, str]:
    """Return the folder of a pattern that exists, and the rest, which is a pattern.

    FRAME stands for the number of a frame.
    """
    place = folder / pattern
    while not place.is_dir() and place != place.parent:
        place = place.parent
    rest = str((folder / pattern).relative_to(place))
    return place, re.sub(r"\{frame[^}]*\}", "FRAME", rest)


def _names(pattern: str, place: Path) -> list[str]:
    """Return the names that fit a pattern; a file that exists is not a pattern."""
    if (place / pattern).is_file():
        return [pattern]
    return glob.glob(pattern, root_dir=place)


def number_files(pattern: str, folder: Path) -> dict[int, Path]:
    """Find the files of a folder or pattern by the number of their frame, in order.

    Raises
    ------
    InputError
        If there is none, or the numbers do not ascend.
    """
    place, text = _split(pattern, folder)
    endings: Any = ""
    if text == ".":
        text = "*"
        endings = PICTURES
    number = r"(?P<number>\d+)"
    form = rf"{number}[^\d/]*\.\w+$"  # the last number of the name
    ordered_by = r"\d+"
    if "FRAME" in text:
        form = r"\A" + fnmatch.translate(text).replace("FRAME", number, 1)
        ordered_by = form
    files = dict[int, Path]()
    previous = -1
    names = _names(text.replace("FRAME", "*"), place)
    for name in sorted(names, key=lambda n: [*map(int, re.findall(ordered_by, n))]):
        path = place / name
        found = re.search(form, name)
        other = "FRAME" in text and not found
        if other or not name.lower().endswith(endings) or not path.is_file():
            continue
        if not found or not previous < int(found["number"]) < 2**63:
            advice = "Write {frame} where the number stands: film/a_{frame}_8bit.png"
            raise InputError(
                f"{path}: has no number above that of the file before. {advice}."
            )
        previous = int(found["number"])
        files[previous] = path
    if not files:
        raise InputError(
            f"{folder / pattern}: no file fits the pattern, or none is a picture."
        )
    return files


def expression(pattern: str) -> str:
    """Return a pattern, its subset and class aside, as a regular expression."""
    text = re.sub(r"FRAME|\\\{frame[^}]*\}", r"\\d+", re.escape(pattern))
    return text.replace(r"\*", "[^/]*")


def find_file(pattern: str, folder: Path) -> Path:
    """Find the one file of a pattern."""
    place, rest = _split(pattern, folder)
    names = _names(rest, place)
    if len(names) != 1:
        raise InputError(
            f"{folder / pattern}: {len(names)} files fit, but one holds all."
        )
    return place / names[0]


def find_subsets(pattern: str, folder: Path) -> list[str]:
    """Find what stands for ``{subset}`` in the files of a pattern, in order."""
    place, text = _split(pattern, folder)
    form = expression(text).replace(r"\{subset\}", "(?P<subset>[^/]+?)", 1)
    form = form.replace(r"\{subset\}", "(?P=subset)")
    names = _names(text.replace("FRAME", "*").replace("{subset}", "*"), place)
    fitting = [re.fullmatch(form, name) for name in names]
    found = sorted({match["subset"] for match in fitting if match})
    if not found:
        raise InputError(f"{folder / pattern}: no file fits the pattern.")
    return found


def read_array(path: Path, key: Key = None, named: bool = True) -> Anything:
    """Read the array or picture in a file; parameters as for `read_stack`."""
    array = np.asanyarray(read_stack(path, key, named))
    is_picture = path.suffix.lower() in PICTURES and len(array) == 1
    return array[0] if is_picture else array


def read_stack(path: Path, key: Key = None, named: bool = True) -> Anything:
    """Read the array in a file, by its ending, or its pictures (n, rows, cols).

    Parameters
    ----------
    path
        The file. MAT v7.3 comes in MATLAB's order of axes; colours come as red, green,
        blue in a last axis. Text comes as (n, k) numbers, with a header as one of
        `NAMED`.
    key
        Variable or data set, where a file holds several; a list of them is stacked
        along a last axis.
    named
        Whether a header of text chooses columns; else all of them are read.

    Raises
    ------
    InputError
        If it cannot be read; the message names the file.
    """
    try:
        return _read(path, key, named)
    except Exception as error:  # libraries raise anything on damaged bytes
        text = getattr(error, "strerror", None) or " ".join(str(error).split())
        reason = text or "no content"
        if not isinstance(error, InputError | OSError | MemoryError):
            reason += ". Is it cut off or damaged?"
        raise InputError(f"{path}: {reason}") from error


read_pages = lru_cache(maxsize=1)(read_stack)  # pages are asked for one by one


# Arrays whose last axis counts frames: grey values and coordinates of one file.
read_layers = lru_cache(maxsize=2)(read_array)


def forget() -> None:
    """Forget what was read of files, which may be others now."""
    read_pages.cache_clear()
    read_layers.cache_clear()


def variables(path: Path) -> dict[Key, Anything]:
    """Read all arrays of a file by name; None where it holds one without a name."""
    if path.suffix.lower() not in (".mat", ".h5", ".hdf5"):
        return {None: read_array(path)}
    try:
        if h5py.is_hdf5(path):
            with h5py.File(path) as file:
                names = list[str]()
                file.visit(names.append)
                held = [name for name in names if isinstance(file[name], h5py.Dataset)]
        else:
            held = [*_read_mat(path)]
    except Exception as error:  # libraries raise anything on damaged bytes
        raise InputError(f"{path}: cannot be read. Is it cut off?") from error
    return {name: read_array(path, name) for name in held}


def _read(path: Path, key: Key, named: bool) -> Anything:
    if isinstance(key, list | tuple):
        return np.squeeze(np.stack([_read(path, name, named) for name in key], axis=-1))
    ending = path.suffix.lower()
    if ending in TIFFS:
        return _read_tiff(path)
    if ending in PICTURES:
        if ending == ".png":
            with Image.open(path) as image:
                if image.mode == "P":  # OpenCV would read its colours
                    return np.array(image)[None]
        content = np.frombuffer(path.read_bytes() or b"0", np.uint8)
        return _from_bgr(cv2.imdecode(content, cv2.IMREAD_UNCHANGED))[None]
    if ending in TEXTS:
        return _read_text(path, named)
    if ending == ".npy":
        return np.atleast_1d(np.load(path, mmap_mode="r"))
    if ending == ".mat" and not h5py.is_hdf5(path):
        return _choose(_read_mat(path), key)
    if ending in (".h5", ".hdf5", ".mat"):
        array = _choose(h5py.File(path), key)  # open as long as the array is
        return np.transpose(array) if ending == ".mat" else array
    raise InputError("this kind of file is not known. Convert it.")


def _read_mat(path: Path) -> Named:
    """Return the arrays of a MAT file (v5) by name, fields of a struct by its path."""
    held = Named()
    for name, value in scipy.io.loadmat(path).items():
        if name.startswith("__"):
            continue
        if value.dtype.names is None:
            held[name] = value
            continue
        for field in value.dtype.names:
            held[f"{name}/{field}"] = value[field].flat[0]
    return held


def _read_text(path: Path, named: bool) -> Anything:
    """Return the numbers of a text table, (n, k); the first line may name columns."""
    text = path.read_text("utf-8-sig")
    if not text.endswith("\n"):
        raise InputError("its last line is cut")
    text = re.sub(r"^[%#\s]+", "", text)  # MATLAB's and numpy's mark of a comment
    first = text.partition("\n")[0]
    separator = next((each for each in ";\t," if each in first), r"\s+")
    if len(re.findall(separator, first)) > MOST_COLUMNS:
        raise InputError(f"it has more than {MOST_COLUMNS} columns")
    decimal = "."
    if separator != "," and re.search(r"\d,\d", text):
        decimal = ","
    words = re.findall(r"[a-z_]+", first.lower())
    header = 0 if {*words} - {"nan", "inf", "e"} else None
    table = pd.read_csv(
        io.StringIO(text),
        sep=separator,
        decimal=decimal,
        header=header,
        skipinitialspace=True,
    )
    if header is None or not named:
        return table.to_numpy(float)
    units = r"\s*([\[(].*[\])]|_mm)$"
    table.columns = (
        table.columns.str.strip().str.lower().str.replace(units, "", regex=True)
    )
    table = table.rename(columns=SAME)
    for names in NAMED:
        if {*names} <= {*table.columns}:
            return table[names].to_numpy(float)
    told = " or ".join(", ".join(names) for names in NAMED)
    raise InputError(f"its columns are {', '.join(table.columns)}; name them {told}")


def _choose(content: Any, key: Any) -> Anything:
    """Return an array of a file by its key, or the only one."""
    names = [name for name in map(str, content) if not name.startswith("__")]
    name = key or "/"
    if key is None and len(names) == 1:
        name = names[0]
    chosen = content.get(name)
    if not hasattr(chosen, "shape"):
        missing = f", and no array {key!r}" if key is not None else ""
        raise InputError(
            f"it holds {', '.join(names)}{missing}. Name an array: key in a manifest."
        )
    _check_size(chosen.shape)
    if isinstance(chosen, h5py.Dataset):
        if chosen.is_virtual or chosen.external or chosen.file != content:
            raise InputError("its values lie in another file. Copy them into this one.")
        _check_written(chosen)
    return chosen if chosen.ndim else np.atleast_1d(chosen)


def _check_written(array: h5py.Dataset) -> None:
    """Raise an `InputError` if a part was never written: it would be read as black."""
    lost = array.size and not array.id.get_storage_size()
    if array.chunks:
        grid = -(-np.array(array.shape) // array.chunks)
        lost = array.id.get_num_chunks() < np.prod(grid)
    if lost:
        raise InputError(f"parts of {array.name} were never written. Write them.")


def _check_size(shape: Sequence[int]) -> None:
    """Raise an `InputError` if a picture of an array is larger than any camera's."""
    if math.prod(sorted(shape)[-2:]) > MOST_PX:
        raise InputError(f"pictures of {shape} px are above {MOST_PX} px. Cut them.")


def _from_bgr(image: Anything | None) -> Anything:
    if image is None:
        raise InputError("a picture cannot be decoded. Is the file damaged?")
    if image.ndim == 2:
        return image
    return image[..., [2, 1, 0, *range(3, image.shape[2])]]


def _read_tiff(path: Path) -> Anything:
    """Return the pages (n, rows, cols) or with colours, mapped where it is possible."""
    with tifffile.TiffFile(path) as tif:
        _check_pages(tif)
        every = slice(None) if tif.series[1:] else None
        try:
            images = tif.asarray(every, out="memmap")
        except RuntimeError as error:
            raise InputError("its pages differ in size or in bits.") from error
        except ValueError:  # a compression that tifffile leaves to another package
            pages = cv2.imreadmulti(str(path), flags=cv2.IMREAD_UNCHANGED)[1]
            images = np.array([_from_bgr(page) for page in pages])
        page = tif.pages.first
        expected = page.size * len(tif.pages)
    if images.dtype.newbyteorder("=") != page.dtype or images.size < expected:
        raise ValueError(
            f"its compression of {page.dtype} is not known, or it is damaged"
        )
    return images.reshape(-1, *page.shape)


def _check_pages(tif: tifffile.TiffFile) -> None:
    """Raise an error unless the pages are whole and grey or coloured frames in time."""
    empty = not tif.series  # this reads the table of pages
    tif.filehandle.seek(tif.pages.next_page_offset or 0)
    if empty or tif.filehandle.read(4) != bytes(4):
        raise ValueError("it ends within its pages")
    page: Any = tif.pages.first
    spread = [each for each in tif.series if each.dataoffset is None]
    if any(0 in each.dataoffsets for series in spread for each in series if each):
        raise ValueError("parts of its pages were never written")
    last: Any = tif.pages[-1].aspage()
    tif.filehandle.seek(last.offset)
    number = tif.filehandle.read(tif.tiff.tagnosize)
    stated = np.frombuffer(number, tif.tiff.tagnoformat)
    # a description may state the number of frames, a last page that none follow
    if "\0" in page.description or len(last.tags) < stated:
        raise ValueError("its description or its last page holds zeros")
    series = tif.series[0]
    if series.kind == "ome" and None in [*series]:  # tifffile would read 0
        lost = {*re.findall(r'FileName="([^"]+)', f"{tif.ome_metadata}")}
        lost -= {*os.listdir(tif.filehandle.dirname)}
        raise InputError(f"pages of its set are missing: {', '.join(sorted(lost))}")
    _check_size(page.shape[:2])
    axes = {axis for axis, n in zip(series.axes, series.shape, strict=True) if n > 1}
    if not axes & set("TIQ"):
        axes -= {"Z"}  # one plane at a time
    if axes - set("TIQYXS") or page.photometric not in (1, 2, 6):  # grey, RGB, JPEG's
        raise InputError(
            f"axes {series.axes}, colours {page.photometric.name}. Take one channel "
            "or slice (ImageJ: Image > Duplicate), grey or RGB, black as 0; time is T "
            "(Image > Properties)."
        )
