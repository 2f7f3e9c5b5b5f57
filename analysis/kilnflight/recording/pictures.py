"""Pictures and arrays in the files of other programs.

The ending of a file names its format: PNG, JPEG, TIFF; NPY, NPZ; MAT (v5, v7.3), HDF5; CSV. A
key names the array where a file holds several.
"""

from __future__ import annotations

import logging
import struct
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import numpy.typing as npt
import pandas as pd
import scipy.io
import tifffile
from scipy.io.matlab import MatReadError

from kilnflight.checks import InputError

FILMS = (".avi", ".mkv", ".mov", ".mp4")
TIFFS = (".tif", ".tiff")
PICTURES = (".jpeg", ".jpg", ".png")
CHANNELS = ("red", "green", "blue")
# What the libraries raise on files that are cut, damaged or of another kind.
ODD = (MatReadError, struct.error, zipfile.BadZipFile, zlib.error)
UNREADABLE = (EOFError, LookupError, OSError, RuntimeError, ValueError, *ODD)

Anything = npt.NDArray[Any]
Channel = str | int | None

logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # it would print what is raised here


def channel_position(channel: Channel, count: int, where: str) -> int:
    """Return the position of a channel on an axis of ``count``."""
    position = CHANNELS.index(channel) if channel in CHANNELS else channel or 0
    if position not in range(count):
        raise InputError(f"{where}: channel {channel!r} is not there; there are {count}.")
    return int(position)


@dataclass(frozen=True)
class PictureFiles:
    """Pictures in one file each."""

    files: Sequence[Path]
    key: str | None = None

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, t: int) -> Anything:
        """Return the picture of frame ``t``."""
        return read_array(self.files[t], self.key)


class Film:
    """Frames of a film, decoded in order; a step back decodes it again from the start."""

    def __init__(self, path: Path) -> None:
        self.files, self._capture, self._next = [path], cv2.VideoCapture(str(path)), 0
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.frame_rate_hz = rate if 0 < rate < 1e9 else 1.0
        while self._capture.grab():  # the header may announce another length
            self._next += 1
        self._length = self._next
        if not self._length:
            raise InputError(f"{path}: no frame can be decoded. Convert it: ffmpeg -i FILM a.avi")

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, t: int) -> Anything:
        """Return the picture of frame ``t``, colours as red, green, blue."""
        if t < self._next:
            self._capture, self._next = cv2.VideoCapture(str(self.files[0])), 0
        for _ in range(self._next, t + 1):
            self._capture.grab()
        self._next = t + 1
        return _from_bgr(self._capture.retrieve()[1])


def read_array(path: Path, key: Channel = None, stack: bool = False) -> Anything:
    """Return the array or picture in a file, by its ending; colours as red, green, blue.

    Parameters
    ----------
    path
        The file. MAT v7.3 comes in MATLAB's order of axes, CSV as a structured array.
    key
        Variable or data set, where a file holds several; of a TIFF stack the channel.
    stack
        Whether a TIFF file of one page is a stack of one.

    Raises
    ------
    InputError
        If it cannot be read, naming the file.
    """
    ending = path.suffix.lower()
    try:
        if ending in TIFFS:
            array = _tiff(path, key)
            return array if stack or len(array) > 1 else array[0]
        if ending in PICTURES:
            content = np.frombuffer(path.read_bytes() or b"0", np.uint8)
            return _from_bgr(cv2.imdecode(content, cv2.IMREAD_UNCHANGED))
        if ending == ".csv":
            return pd.read_csv(path, skipinitialspace=True).to_records(index=False)
        if ending == ".npy":
            return np.load(path, mmap_mode="r")
        if ending == ".npz":
            with path.open("rb") as opened:
                return _chosen(np.load(opened), key)
        if ending in (".h5", ".hdf5", ".mat") and h5py.is_hdf5(path):
            with h5py.File(path) as file:
                return _chosen(file, key).T if ending == ".mat" else _chosen(file, key)
        if ending == ".mat":
            return _chosen(scipy.io.loadmat(path), key)
        raise ValueError("this kind of file is not known; convert it")
    except UNREADABLE as error:
        reason = " ".join(str(error).split()) or "cut off"
        raise InputError(f"{path}: cannot be read: {reason}. Is it cut off or damaged?") from error


def _chosen(content: Any, key: Channel) -> Anything:
    """Return an array of a file by its key, or the only one."""
    names = [name for name in content if not name.startswith("__")]  # as loadmat's own
    name = names[0] if key is None and len(names) == 1 else key
    if not name or name not in content:
        raise ValueError(f"key {key!r} is none of {', '.join(names)}")
    return np.asarray(content[name])


def _from_bgr(image: Anything | None) -> Anything:
    if image is None:
        raise ValueError("it cannot be decoded")
    return image if image.ndim == 2 else image[..., [2, 1, 0, *range(3, image.shape[2])]]


def _tiff(path: Path, channel: Channel) -> Anything:
    """Return the pages (n, rows, cols) or with colours, on disk where they can be mapped."""
    with tifffile.TiffFile(path) as tif:
        series, page = tif.series[0], tif.pages[0]
        tif.filehandle.seek(tif.pages.next_page_offset or 0)
        if any(tif.filehandle.read(4)):
            raise ValueError("it ends within its pages")
        try:
            images = tif.asarray(slice(None) if len(tif.series) > 1 else None, out="memmap")
        except ValueError as error:
            if "imagecodecs" not in str(error):
                raise
            images = np.array(cv2.imreadmulti(str(path), flags=cv2.IMREAD_UNCHANGED)[1])  # LZW
    if images.dtype.newbyteorder("=") != page.dtype:
        raise ValueError(f"its compression of {page.dtype} is not known")
    axes = dict(zip(series.axes, series.shape, strict=True))
    lead = {axis: n for axis, n in axes.items() if axis not in "YXS" and n > 1}
    if set(lead) - set("TIQC") or ("C" in lead and channel is None):
        remedy = "Save one plane, name a channel, or call the axis T (ImageJ: Image > Properties)"
        raise ValueError(f"of the axes {axes} only time (T) is read. {remedy}")
    if "C" in lead:
        position = channel_position(channel, lead["C"], str(path))
        images = images.reshape(*lead.values(), *page.shape)
        images = images.take(position, axis=list(lead).index("C"))
    return images.reshape(-1, *page.shape)
