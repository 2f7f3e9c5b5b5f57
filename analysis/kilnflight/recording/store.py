"""Recordings on disk: opened frame by frame, whole or not there at all.

A recording is a Zarr 3 group::

    gray       (frame, row, col)   uint16    one frame, one chunk
    pixels     (frame, point, 2)   int32     row, col of the points
    xyz        (frame, point, 3)   float32   mm, camera coordinates as captured
    labels     (frame, row, col)   uint8     Table 5.1, only of the frames that have any
    index, time_s, points, labelled (frame)  number, time, number of points, labels known
    truth/     <name>.parquet                tables of the truth, where there is one

The second axis of ``pixels`` and ``xyz`` is as long as an image has pixels; only the first
``points[t]`` entries of frame t exist, in chunks of `POINTS_PER_CHUNK`. All is zstd with a
checksum. A recording grows under ``<name>.part`` and gets its name when the last frame is in.
Until then ``journal.txt`` holds how it was begun and one line per finished frame: a kill costs
one frame, never a wrong result.
"""

from __future__ import annotations

import hashlib
import json
import os
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import zarr
from tqdm import tqdm
from zarr.codecs import ZstdCodec

from kilnflight.checks import InputError, check_new
from kilnflight.recording.frames import Attributes, Frame, Recording, check_frame, check_position

FORMAT = "kilnflight recording 2"  # 1 did not say which depth calibration it needs
JOURNAL = "journal.txt"
POINTS_PER_CHUNK = 65_536
KINDS = {"gray": "uint16", "pixels": "int32", "xyz": "float32", "labels": "uint8"}
PER_FRAME = {"index": "int64", "time_s": "float64", "points": "int64", "labelled": "bool"}

Line = list[Any]  # of the journal: the values of PER_FRAME for one frame, and its checksum


@dataclass(frozen=True, eq=False)
class StoredRecording:
    """A recording on disk; `open_recording` gives it."""

    path: Path
    attributes: Attributes
    arrays: Mapping[str, zarr.Array[Any]]
    per_frame: Mapping[str, npt.NDArray[Any]]  # of the names in PER_FRAME

    def __len__(self) -> int:
        return len(self.per_frame["index"])

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0; only its own chunks are read.

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

    def gray(self, t: int) -> npt.NDArray[np.uint16]:
        """Return the grey values (rows, cols) of frame ``t`` alone.

        Errors are as for `frame`.
        """
        check_position(t, len(self), self.attributes.name)
        return self._read("gray", t)

    def _read(self, name: str, t: int, n: int | None = None) -> npt.NDArray[Any]:
        """Return frame ``t`` of an array, of a point array its first ``n`` points."""
        array = self.arrays[name]
        if n == 0:
            return np.empty((0, array.shape[2]), array.dtype)
        chunks = 1 if n is None else -(-n // array.chunks[1])
        folder = self.path / name / "c" / str(t)
        fault = "missing"  # zarr itself would give zeros
        if all((folder / str(k) / "0").is_file() for k in range(chunks)):
            try:
                return np.asarray(array[t, :n])
            except (RuntimeError, ValueError, OSError):  # what codecs raise on broken bytes
                fault = "damaged"
        raise InputError(
            f"{self.path}, frame {t}: its {name} is {fault}. The recording was changed after it "
            "was written; import or export it again."
        )

    def truth(self) -> dict[str, pd.DataFrame]:
        """Return the tables of the truth by name; none for a recording of a real kiln."""
        files = sorted((self.path / "truth").glob("*.parquet"))
        return {file.stem: pd.read_parquet(file) for file in files}

    def content(self) -> str:
        """Return twelve digits that stand for what the recording holds, wherever it lies.

        Every chunk ends in the checksum of its values (zstd), so four bytes of each are read.
        """
        digest = hashlib.sha256(json.dumps(asdict(self.attributes)).encode())
        for values in self.per_frame.values():
            digest.update(values.tobytes())
        for name in ("gray", "pixels", "xyz"):  # a missing chunk is reported when it is read
            for path in sorted(p for p in (self.path / name / "c").rglob("*") if p.is_file()):
                with path.open("rb") as file:
                    end = file.seek(0, os.SEEK_END)
                    file.seek(max(end - 4, 0))
                    label = f"{path.relative_to(self.path).as_posix()} {end} "
                    digest.update(label.encode() + file.read())
        return digest.hexdigest()[:12]


def open_recording(path: Path | str) -> StoredRecording:
    """Open a stored recording; memory does not depend on its length.

    Raises
    ------
    InputError
        If there is none, its writing was cut off, or it is damaged.
    """
    path = Path(path)
    for folder in [path] if path.exists() else [path, _part_of(path)]:
        if (folder / JOURNAL).is_file():
            begun, done = _read_journal(folder)
            total = len(range(*begun["frames"])) if begun else "some"
            raise InputError(
                f"{folder}: the recording was cut off after {len(done)} of {total} frames. Run "
                "what wrote it again with the same target; it goes on where it stopped."
            )
    if not (path / "zarr.json").is_file():
        raise InputError(
            f"{path}: there is no recording (no folder with a zarr.json). Give a folder that "
            "kilnflight import or kilnflight export wrote."
        )
    try:
        group = zarr.open_group(path, mode="r")
        attributes = dict(group.attrs)
        if attributes.pop("format", None) != FORMAT:
            raise InputError(f"{path}: a Zarr group, but not a {FORMAT}. Import it first.")
        per_frame = {name: np.asarray(_array(group, name)[:]) for name in PER_FRAME}
        arrays = {name: _array(group, name) for name in KINDS}
        return StoredRecording(path, Attributes.from_json(attributes), arrays, per_frame)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, RuntimeError, OSError) as error:
        raise InputError(
            f"{path}: damaged recording ({type(error).__name__}: {error}). Import or export it "
            "again."
        ) from error


def write_recording(
    recording: Recording,
    path: Path | str,
    frames: range | None = None,
    truth: Mapping[str, pd.DataFrame] | None = None,
) -> StoredRecording:
    """Write a recording to disk and return it from there.

    Frame after frame goes to ``<path>.part``, which is renamed when it is whole. After a
    kill the same call goes on with the frame that was not finished.

    Parameters
    ----------
    recording
        For example the twin.
    path
        The new folder; ``.zarr`` at its end is a good habit.
    frames
        Which frames, all by default. They keep their index and time.
    truth
        Tables by name, stored beside as they are.

    Raises
    ------
    InputError
        If the target exists, a frame is not as `check_frame` demands, time does not grow,
        or what was begun there is another recording.
    """
    path = Path(path)
    frames = range(len(recording)) if frames is None else frames
    name = recording.attributes.name
    check_new(path)
    if not frames:
        raise InputError(f"recording {name}: no frames to write.")
    for t in (frames[0], frames[-1]):
        check_position(t, len(recording), name)
    part = _part_of(path)
    group, done = _begin(recording, part, frames)
    with (part / JOURNAL).open("a") as journal:
        # disable=None: a bar in a terminal, nothing in logs and notebooks
        for t in tqdm(frames[len(done) :], desc=name, unit="frame", disable=None):
            frame = check_frame(recording.frame(t), recording.attributes)
            if done and (frame.index <= done[-1][0] or frame.time_s <= done[-1][1]):
                index, time_s = done[-1][:2]
                raise InputError(
                    f"recording {name}, frame {frame.index} at {frame.time_s} s follows frame "
                    f"{index} at {time_s} s. Number and time must grow from frame to frame."
                )
            _write_frame(group, len(done), frame)
            done.append(_line(frame))
            journal.write(json.dumps(done[-1]) + "\n")
            journal.flush()
    *columns, _ = zip(*done, strict=True)
    for (column, kind), values in zip(PER_FRAME.items(), columns, strict=True):
        group.create_array(column, data=np.array(values, kind), overwrite=True)
    for table_name, table in (truth or {}).items():
        (part / "truth").mkdir(exist_ok=True)
        table.to_parquet(part / "truth" / f"{table_name}.parquet")
    (part / JOURNAL).unlink()
    part.rename(path)
    return open_recording(path)


def _part_of(path: Path) -> Path:
    """Return the folder in which a recording grows before it gets its name."""
    return path.with_name(path.name + ".part")


def _read_journal(folder: Path) -> tuple[dict[str, Any], list[Line]]:
    """Return how a recording was begun and its finished frames.

    A last line that was cut by a kill is none; without a whole first line, nothing was
    begun and the dictionary is empty.
    """
    lines = (folder / JOURNAL).read_text().split("\n")[:-1]
    begun, *done = [json.loads(line) for line in lines] or [{}]
    return begun, done


def _begin(recording: Recording, part: Path, frames: range) -> tuple[zarr.Group, list[Line]]:
    """Return the group to write into and the frames it already has."""
    span = [frames.start, frames.stop, frames.step]
    begin = {"frames": span, "attributes": asdict(recording.attributes)}
    begun, done = _read_journal(part) if (part / JOURNAL).is_file() else ({}, [])
    if begun:
        group = zarr.open_group(part, mode="r+")
        same = begun == json.loads(json.dumps(begin))
        if not same or (done and done[-1] != _line(recording.frame(frames[len(done) - 1]))):
            raise InputError(
                f"{part}: begun with another recording than {recording.attributes.name} is now "
                "(attributes, frames or content differ). Delete it to start again."
            )
    else:
        group = _create(part, recording.attributes, len(frames))
    lines = [json.dumps(line) + "\n" for line in (begin, *done)]
    (part / JOURNAL).write_text("".join(lines))  # without a line that was cut
    return group, done


def _create(folder: Path, attributes: Attributes, length: int) -> zarr.Group:
    """Return a new, empty group; what was in the folder is gone."""
    pixels = attributes.rows * attributes.columns
    points = min(POINTS_PER_CHUNK, pixels)
    content = {"format": FORMAT, **asdict(attributes)}
    group = zarr.open_group(folder, mode="w", zarr_format=3, attributes=content)
    codec = ZstdCodec(level=1, checksum=True)
    for name, kind in KINDS.items():
        width = {"pixels": 2, "xyz": 3}.get(name)
        shape = (length, pixels, width) if width else (length, *attributes.size)
        chunks = (1, points, width) if width else (1, *attributes.size)
        group.create_array(name, shape=shape, chunks=chunks, dtype=kind, compressors=codec)
    return group


def _write_frame(group: zarr.Group, position: int, frame: Frame) -> None:
    with zarr.config.set({"array.write_empty_chunks": True}):  # no file then means damage
        arrays = {name: _array(group, name) for name in KINDS}
    n = len(frame.xyz)
    arrays["gray"][position] = frame.gray
    for name in ("pixels", "xyz") if n else ():
        points, chunk = getattr(frame, name), arrays[name].chunks[1]
        # whole chunks, so that nothing a kill left behind is read and merged
        length = min(-(-n // chunk) * chunk, arrays[name].shape[1])
        arrays[name][position, :length] = np.pad(points, ((0, length - n), (0, 0)))
    if frame.labels is not None:
        arrays["labels"][position] = frame.labels


def _line(frame: Frame) -> Line:
    """Return the line of a frame in the journal."""
    arrays = [array for name in KINDS if (array := getattr(frame, name)) is not None]
    checksum = zlib.crc32(b"".join(array.tobytes() for array in arrays))
    labelled = frame.labels is not None
    return [int(frame.index), float(frame.time_s), len(frame.xyz), labelled, checksum]


def _array(group: zarr.Group, name: str) -> Any:
    return group[name]
