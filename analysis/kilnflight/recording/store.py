"""Recordings on disk, read frame by frame.

A recording is a Zarr 3 group::

    gray       (frame, row, col)   uint16    one frame, one chunk
    pixels     (frame, point, 2)   int32     row, col of the points
    xyz        (frame, point, 3)   float32   mm, camera coordinates as captured
    labels     (frame, row, col)   uint8     Table 5.1, only of the frames that have any
    index, time_s, points, labelled (frame)  number, time, number of points, labels known
    truth/     <name>.parquet                tables of the truth, where there is one

The second axis of ``pixels`` and ``xyz`` is as long as an image has pixels; only the
first ``points[t]`` entries of frame t exist, in chunks of `POINTS_PER_CHUNK`. All is
zstd with a checksum. A recording grows in a folder ``<name>.*.part`` and is moved out
after its last frame.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import zarr
from tqdm import tqdm
from zarr.codecs import ZstdCodec

from kilnflight.checks import InputError
from kilnflight.recording.frames import (
    Attributes,
    Frame,
    Gray,
    Recording,
    check_position,
)
from kilnflight.store.cache import clear_parts, locked, make_whole

FORMAT = "kilnflight recording 2"  # 1 did not say which depth calibration it needs
POINTS_PER_CHUNK = 65_536
KINDS = {"gray": "uint16", "pixels": "int32", "xyz": "float32", "labels": "uint8"}
WIDTH = {"pixels": 2, "xyz": 3}  # numbers of a point
PER_FRAME = {
    "index": "int64",
    "time_s": "float64",
    "points": "int64",
    "labelled": "bool",
}


@dataclass(frozen=True, eq=False)
class StoredRecording:
    """A recording on disk, made by `open_recording`."""

    path: Path
    attributes: Attributes
    arrays: Mapping[str, zarr.Array[Any]]
    per_frame: Mapping[str, npt.NDArray[Any]]  # of the names in PER_FRAME
    stated: str | None = None  # its `content` when it was written

    def __len__(self) -> int:
        return len(self.per_frame["index"])

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0, from its own chunks.

        Raises
        ------
        InputError
            If there is no such frame, or it is damaged on disk.
        """
        gray = self.gray(t)
        index, time_s, n, labelled = (self.per_frame[name][t] for name in PER_FRAME)
        pixels, xyz = (self._read(name, t, int(n)) for name in ("pixels", "xyz"))
        labels = self._read("labels", t) if labelled else None
        return Frame(int(index), float(time_s), gray, pixels, xyz, labels)

    def gray(self, t: int) -> Gray:
        """Return the grey values (rows, cols) of frame ``t`` alone; errors as for
        `frame`.
        """
        check_position(t, len(self), self.attributes.name)
        return self._read("gray", t)

    def _read(self, name: str, t: int, n: int | None = None) -> npt.NDArray[Any]:
        """Return frame ``t`` of an array, of a point array its first ``n`` points."""
        array = self.arrays[name]
        folder = self.path / name / "c" / str(t)
        try:
            count = 1 if n is None else -(-n // array.chunks[1])
            if not all((folder / str(k) / "0").is_file() for k in range(count)):
                raise OSError("a chunk is missing")  # zarr would make zeros of it
            return np.asarray(array[t, :n])
        except (
            RuntimeError,
            ValueError,
            OSError,
        ) as error:  # of codecs, too, on broken bytes
            raise InputError(
                f"{self.path}, frame {t}: its {name} is lost or damaged."
            ) from error

    def content(self) -> str:
        """Return a hash (12 hex digits) of attributes and frames, independent of the
        place.

        Every chunk ends in the checksum of its values (zstd), so the end of each file
        is read, of the arrays' metadata all. An `InputError` if the hash is not that of
        the writing: something was changed afterwards. Hidden files, as of a file
        browser, do not count.
        """
        digest = hashlib.sha256(repr(self.attributes).encode())
        for values in self.per_frame.values():
            digest.update(values.tobytes())
        for name in KINDS:  # a missing chunk is reported when it is read
            for path in sorted(
                p for p in (self.path / name).rglob("[!.]*") if p.is_file()
            ):
                with path.open("rb") as file:
                    end = file.seek(max(path.stat().st_size - 4096, 0))
                    digest.update(
                        f"{path.relative_to(self.path)} {end} ".encode() + file.read()
                    )
        if self.stated not in (None, found := digest.hexdigest()[:12]):
            raise InputError(
                f"{self.path}: was changed after it was written. Write it again."
            )
        return found


def open_recording(path: Path | str) -> StoredRecording:
    """Open a stored recording; memory does not depend on its length.

    Raises
    ------
    InputError
        If there is none, its writing was cut off, or it is damaged.
    """
    path = Path(path)
    try:
        group: Any = zarr.open_group(path, mode="r")
        given = dict(group.attrs)
        if given.pop("format", None) != FORMAT:
            raise InputError(f"a Zarr group, but not a {FORMAT}")
        content = given.pop("content", None)
        attributes = Attributes.from_json(given)
        per_frame = {
            name: np.asarray(group[name][:], kind) for name, kind in PER_FRAME.items()
        }
        arrays = {name: group[name] for name in KINDS}
        for name, how in _layout(attributes, len(pd.DataFrame(per_frame))):
            if any(getattr(arrays[name], key) != value for key, value in how.items()):
                raise InputError(
                    f"its {name} is not of the size and type that it states"
                )
        return StoredRecording(path, attributes, arrays, per_frame, content)
    except Exception as error:  # zarr raises anything on damaged bytes
        raise InputError(
            f"{path}: no such file, or no whole recording ({error})."
        ) from error


def write_recording(
    recording: Recording,
    path: Path | str,
    frames: range | None = None,
    truth: Mapping[str, pd.DataFrame] | None = None,
) -> StoredRecording:
    """Write a recording to disk and return it from there.

    Parameters
    ----------
    recording
        Frames as `kilnflight.recording.frames.check_frame` describes them.
    path
        The new folder, usually named ``.zarr``.
    frames
        Positions of the frames to write, all by default. They keep their index and
        time.
    truth
        Tables by name, stored as Parquet.

    Raises
    ------
    InputError
        If the target exists, or the numbers or times of the frames do not grow.
    """
    path = Path(path)
    frames = range(len(recording)) if frames is None else frames
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path.with_name(f".{path.name}.lock")):  # another process waits
        if path.exists() or not frames or frames[0] < 0 or frames[-1] >= len(recording):
            raise InputError(
                f"{path}: exists already, or the recording has no such frames."
            )
        clear_parts(path)
        make_whole(path, partial(_write, recording, frames, truth or {}))
    return open_recording(path)


def _write(recording: Recording, frames: range, truth: Any, part: Path) -> None:
    """Write a recording to a new folder; arguments as for `write_recording`."""
    where = f"recording {recording.attributes.name}"
    rows = []
    group, arrays = _create(part, recording.attributes, len(frames))
    # disable=None: a bar in a terminal, nothing in logs and notebooks
    for position, t in enumerate(tqdm(frames, desc=where, unit="frame", disable=None)):
        frame = recording.frame(t)
        arrays["gray"][position] = frame.gray
        for name in WIDTH if len(frame.xyz) else ():
            arrays[name][position, : len(frame.xyz)] = getattr(frame, name)
        if frame.labels is not None:
            arrays["labels"][position] = frame.labels
        rows.append(
            (frame.index, frame.time_s, len(frame.xyz), frame.labels is not None)
        )
    if (np.diff([row[:2] for row in rows], axis=0) <= 0).any():
        raise InputError(f"{where}: number and time must grow from frame to frame.")
    for (name, kind), values in zip(
        PER_FRAME.items(), zip(*rows, strict=True), strict=True
    ):
        group.create_array(name, data=np.array(values, kind))
    for table_name, table in truth.items():
        (part / "truth").mkdir(exist_ok=True)
        table.to_parquet(part / "truth" / f"{table_name}.parquet")
    group.attrs["content"] = open_recording(part).content()


def _layout(
    attributes: Attributes, length: int
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield name, and shape, chunks and type of each array of a recording."""
    pixels = attributes.rows * attributes.columns
    for name, kind in KINDS.items():
        shape = chunk = attributes.size
        width = WIDTH.get(name)
        if width:
            shape = (pixels, width)
            chunk = (min(POINTS_PER_CHUNK, pixels), width)
        yield (
            name,
            {"shape": (length, *shape), "chunks": (1, *chunk), "dtype": np.dtype(kind)},
        )


def _create(
    folder: Path, attributes: Attributes, length: int
) -> tuple[Any, dict[str, Any]]:
    """Return a new, empty group and its arrays, which a group would open without their
    config.
    """
    content = {"format": FORMAT, **asdict(attributes)}
    made = dict[str, Any]()
    group = zarr.open_group(folder, mode="w", zarr_format=3, attributes=content)
    for name, how in _layout(attributes, length):
        how["config"] = {
            "write_empty_chunks": True
        }  # a chunk without a file then is damage
        made[name] = group.create_array(
            name, compressors=ZstdCodec(level=1, checksum=True), **how
        )
    return group, made
