"""Recordings on disk, read frame by frame.

A recording is a Zarr 3 group::

    gray       (frame, row, col)   uint16    one frame, one chunk
    pixels     (frame, point, 2)   int32     row, col of the points
    xyz        (frame, point, 3)   float32   mm, camera coordinates as captured
    labels     (frame, row, col)   uint8     Table 5.1, only of the frames that have any
    index, time_s, points, labelled (frame)  number, time, number of points, labels?
    truth/     <name>.parquet                tables of the truth, where there is one

The second axis of ``pixels`` and ``xyz`` is as long as an image has pixels; only the
first ``points[t]`` entries of frame t exist, in chunks of `POINTS_PER_CHUNK`. All is
zstd with a checksum. A recording grows in a folder ``<name>.*.part`` and is moved out
after its last frame.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from pandas import DataFrame
from tqdm import tqdm
from zarr.codecs import ZstdCodec

from kilnflight.arrays import Anything, Tables
from kilnflight.checks import InputError
from kilnflight.recording.frames import (
    Attributes,
    Frame,
    Gray,
    Recording,
    check_position,
)
from kilnflight.store.cache import clear_parts, hidden, locked, make_whole

FORMAT = "kilnflight recording 2"  # 1 did not say which depth calibration it needs
POINTS_PER_CHUNK = 65_536
AGAIN = "Write it again; a copy in parts can be deleted."
KINDS = {"gray": "uint16", "pixels": "int32", "xyz": "float32", "labels": "uint8"}
POINT_NUMBERS = {"pixels": 2, "xyz": 3}
PER_FRAME = {
    "index": "int64",
    "time_s": "float64",
    "points": "int64",
    "labelled": "bool",
}


@dataclass(frozen=True, eq=False)
class StoredRecording:
    """A recording on disk, made by `open_recording`.

    Parameters
    ----------
    path
        Its folder.
    attributes
        Facts about the whole recording.
    arrays
        Arrays by name, those of `KINDS`.
    per_frame
        Columns (frames,) by name, those of `PER_FRAME`.
    stated
        Its `content` when it was written; None in recordings that do not state it.
    """

    path: Path
    attributes: Attributes
    arrays: Mapping[str, zarr.Array[Any]]
    per_frame: Mapping[str, Anything]
    stated: str | None

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
        known = {name: values[t].item() for name, values in self.per_frame.items()}
        labels = None
        if known["labelled"]:
            labels = self._read("labels", t, self.attributes.rows)
        return Frame(
            index=known["index"],
            time_s=known["time_s"],
            gray=gray,
            pixels=self._read("pixels", t, known["points"]),
            xyz=self._read("xyz", t, known["points"]),
            labels=labels,
        )

    def gray(self, t: int) -> Gray:
        """Return the grey values (rows, cols) of frame ``t``; errors as for `frame`."""
        check_position(t, len(self), self.attributes.name)
        return self._read("gray", t, self.attributes.rows)

    def _read(self, name: str, t: int, n: int) -> Anything:
        """Return the first ``n`` rows or points of frame ``t`` of an array."""
        array = self.arrays[name]
        folder = self.path / name / "c" / str(t)
        try:
            for k in range(-(-n // array.chunks[1])):
                if not (folder / str(k) / "0").is_file():  # zarr would return zeros
                    raise OSError("a chunk is missing")
            return np.asarray(array[t, :n])
        # Codecs raise RuntimeError and ValueError on damaged bytes.
        except (RuntimeError, ValueError, OSError) as error:
            raise InputError(
                f"{self.path}, frame {t}: its {name} is lost or damaged. {AGAIN}"
            ) from error

    def content(self) -> str:
        """Return a hash (12 hex digits) of attributes and frames.

        Its place does not count, nor do hidden files, such as those of a file browser.
        Every chunk ends in the checksum of its values (zstd), so only the end of each
        file is read.

        Raises
        ------
        InputError
            If the recording was changed after it was written.
        """
        digest = hashlib.sha256(self.attributes.stated.encode())
        for values in self.per_frame.values():
            digest.update(values.tobytes())
        for name in KINDS:  # a missing chunk is reported when it is read
            found = (self.path / name).rglob("[!.]*")
            for path in sorted(filter(Path.is_file, found)):
                with path.open("rb") as file:
                    end = file.seek(max(path.stat().st_size - 4096, 0))
                    digest.update(f"{path.relative_to(self.path)} {end} ".encode())
                    digest.update(file.read())
        content = digest.hexdigest()[:12]
        if self.stated not in (None, content):
            raise InputError(f"{self.path}: was changed after it was written. {AGAIN}")
        return content


def open_recording(path: Path | str) -> StoredRecording:
    """Open a stored recording; memory does not depend on its length.

    Parameters
    ----------
    path
        Folder that `write_recording` wrote.

    Returns
    -------
    StoredRecording
        Frames are read from disk when they are needed.

    Raises
    ------
    InputError
        If there is none, its writing was cut off, or it is damaged or was changed.

    Examples
    --------
    >>> import tempfile
    >>> from kilnflight.recording.files import open_any
    >>> folder = Path(tempfile.mkdtemp())
    >>> film = open_any(np.full((3, 24, 32), 7, np.uint16), frame_rate_hz=330.0)
    >>> _ = write_recording(film, folder / "film.zarr")
    >>> stored = open_recording(folder / "film.zarr")
    >>> len(stored), stored.attributes.size, int(stored.gray(2).max())
    (3, (24, 32), 7)
    """
    path = Path(path)
    try:
        group: Any = zarr.open_group(path, mode="r")
        given = dict(group.attrs)
        if given.pop("format", None) != FORMAT:
            raise InputError(f"a Zarr group, but not a {FORMAT}")
        content = given.pop("content", None)
        attributes = Attributes.from_json(given)
        per_frame = {name: group[name][:] for name in PER_FRAME}
        arrays = {name: group[name] for name in KINDS}
        for name, right in _create({}, attributes, len(per_frame["index"])).items():
            if group[name].metadata != right.metadata:
                raise InputError(f"its {name} is not as stated in size or layout")
    except Exception as error:  # zarr raises anything on damaged bytes
        raise InputError(
            f"{path}: no such file, or no whole recording ({error})."
        ) from error
    recording = StoredRecording(
        path=path,
        attributes=attributes,
        arrays=arrays,
        per_frame=per_frame,
        stated=content,
    )
    recording.content()
    return recording


def write_recording(
    recording: Recording,
    path: Path | str,
    frames: range | None = None,
    truth: Tables | None = None,
) -> StoredRecording:
    """Write a recording to disk and return it from there.

    Parameters
    ----------
    recording
        Recording of any kind, such as from `kilnflight.open`.
    path
        The new folder, usually named ``.zarr``.
    frames
        Positions of the frames to write, all by default. They keep their index and
        time.
    truth
        Tables by name, stored as Parquet.

    Returns
    -------
    StoredRecording
        The recording on disk.

    Raises
    ------
    InputError
        If the target exists, or the numbers or times of the frames do not grow.

    Examples
    --------
    >>> import tempfile
    >>> from kilnflight.recording.files import open_any
    >>> film = open_any(np.arange(4 * 24 * 32).reshape(4, 24, 32))
    >>> path = Path(tempfile.mkdtemp(), "part.zarr")
    >>> stored = write_recording(film, path, frames=range(2, 4))
    >>> [stored.frame(t).index for t in range(2)]
    [2, 3]
    """
    path = Path(path)
    if frames is None:
        frames = range(len(recording))
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path.with_name(f"{hidden(path)}lock")):  # another process waits
        if path.exists() or not frames or frames[0] < 0 or frames[-1] >= len(recording):
            raise InputError(
                f"{path}: exists already, or the recording has no such frames."
            )
        clear_parts(path)
        make_whole(path, partial(_write, recording, frames, truth or {}))
    return open_recording(path)


def _write(
    recording: Recording,
    frames: range,
    truth: Tables,
    folder: Path,
) -> None:
    """Write a recording to a new folder; arguments as for `write_recording`."""
    where = f"recording {recording.attributes.name}"
    rows = []
    arrays = _create(folder, recording.attributes, len(frames))
    # disable=None shows a bar in a terminal and nothing in logs and notebooks.
    for position, t in enumerate(tqdm(frames, desc=where, unit="frame", disable=None)):
        frame = recording.frame(t)
        for name in KINDS:
            values = getattr(frame, name)
            if values is not None and len(values):
                arrays[name][position, : len(values)] = values
        rows.append(
            (
                frame.index,
                frame.time_s,
                len(frame.xyz),
                frame.labels is not None,
                hash(frame.gray.tobytes()),
            )
        )
    table = DataFrame(rows, columns=[*PER_FRAME, "picture"])
    if (np.diff(table[["index", "time_s"]], axis=0) <= 0).any():
        raise InputError(f"{where}: number and time must grow from frame to frame.")
    for name in PER_FRAME:
        arrays[name][:] = table[name].to_numpy()
    for name, rows_of_truth in truth.items():
        (folder / "truth").mkdir(exist_ok=True)
        rows_of_truth.to_parquet(folder / "truth" / f"{name}.parquet")
    again = sum(table["picture"].diff() == 0)
    group = zarr.open_group(folder)
    if again:
        group.attrs["notes"] = [
            *recording.attributes.notes,
            f"{again} of {len(rows)} frames are equal to the one before",
        ]
    group.attrs["content"] = open_recording(folder).content()


def _create(
    store: Any, attributes: Attributes, length: int
) -> dict[str, zarr.Array[Any]]:
    """Return the arrays of a new, empty group."""
    stated = {"format": FORMAT, **asdict(attributes)}
    group = zarr.open_group(store, mode="w", zarr_format=3, attributes=stated)
    arrays = {
        name: group.create_array(name, shape=(length,), dtype=kind)
        for name, kind in PER_FRAME.items()
    }
    for name, kind in KINDS.items():
        rows, columns = attributes.size
        if name in POINT_NUMBERS:
            rows *= columns
            columns = POINT_NUMBERS[name]
        arrays[name] = group.create_array(
            name,
            shape=(length, rows, columns),
            chunks=(1, min(rows, POINTS_PER_CHUNK), columns),
            dtype=kind,
            compressors=ZstdCodec(level=1, checksum=True),
            config={"write_empty_chunks": True},  # a chunk without a file is damage
        )
    return arrays
