"""How a recording lies on disk: the arrays of its Zarr 3 group, and the journal of its writing.

::

    gray       (frame, row, col)   uint16    one frame, one chunk
    pixels     (frame, point, 2)   int32     row, col of the points
    xyz        (frame, point, 3)   float32   mm, camera coordinates as captured
    labels     (frame, row, col)   uint8     Table 5.1, only of the frames that have any
    index, time_s, points, labelled (frame)  number, time, number of points, labels known
    truth/     <name>.parquet                tables of the truth, where there is one

The second axis of ``pixels`` and ``xyz`` is as long as an image has pixels; only the
first ``points[t]`` entries of frame t exist, in chunks of `POINTS_PER_CHUNK`. All is
zstd with a checksum. While a recording is written, ``journal.txt`` holds how it was
begun and one line per finished frame; a recording with a journal is not whole.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import zarr
from zarr.codecs import ZstdCodec

from kilnflight.checks import InputError
from kilnflight.recording.frames import Attributes, Frame

FORMAT = "kilnflight recording 1"
JOURNAL = "journal.txt"
POINTS_PER_CHUNK = 65_536
ARRAYS = ("gray", "pixels", "xyz", "labels")
PER_FRAME = {"index": "int64", "time_s": "float64", "points": "int64", "labelled": "bool"}

Line = list[Any]  # of the journal: the values of PER_FRAME for one frame


def part_of(path: Path) -> Path:
    """Return the folder in which a recording grows before it gets its name."""
    return path.with_name(path.name + ".part")


def read_journal(folder: Path) -> tuple[dict[str, Any], list[Line]]:
    """Return how a recording was begun and its finished frames.

    A last line that was cut by a kill is none; without a whole first line, nothing was
    begun and the dictionary is empty.
    """
    lines = (folder / JOURNAL).read_text().split("\n")[:-1]
    begun, *done = [json.loads(line) for line in lines] or [{}]
    return begun, done


def write_journal(folder: Path, begun: Mapping[str, Any], done: Sequence[Line]) -> None:
    """Write the journal afresh."""
    lines = [json.dumps(line) + "\n" for line in (begun, *done)]
    (folder / JOURNAL).write_text("".join(lines))


def create(folder: Path, attributes: Attributes, length: int) -> zarr.Group:
    """Return a new, empty group; what was in the folder is gone."""
    rows, columns = attributes.rows, attributes.columns
    points = min(POINTS_PER_CHUNK, rows * columns)
    group = zarr.open_group(
        folder, mode="w", zarr_format=3, attributes={"format": FORMAT, **attributes.to_json()}
    )
    for name, kind, shape, chunk in (
        ("gray", "uint16", (rows, columns), (rows, columns)),
        ("pixels", "int32", (rows * columns, 2), (points, 2)),
        ("xyz", "float32", (rows * columns, 3), (points, 3)),
        ("labels", "uint8", (rows, columns), (rows, columns)),
    ):
        group.create_array(
            name,
            shape=(length, *shape),
            chunks=(1, *chunk),
            dtype=kind,
            compressors=ZstdCodec(level=1, checksum=True),
        )
    return group


def write_frame(group: zarr.Group, position: int, frame: Frame) -> Line:
    """Write one frame and return its line of the journal."""
    n = len(frame.xyz)
    with zarr.config.set({"array.write_empty_chunks": True}):  # no file then means damage
        arrays: dict[str, Any] = {name: group[name] for name in ARRAYS}
    arrays["gray"][position] = frame.gray
    for name, points in (("pixels", frame.pixels), ("xyz", frame.xyz)):
        _, length, _ = arrays[name].shape
        chunk = arrays[name].chunks[1]
        # whole chunks, so that nothing a kill left behind is read and merged
        padded = np.zeros((min(-(-n // chunk) * chunk, length), points.shape[1]), points.dtype)
        padded[:n] = points
        if n:
            arrays[name][position, : len(padded)] = padded
    if frame.labels is not None:
        arrays["labels"][position] = frame.labels
    return [int(frame.index), float(frame.time_s), n, frame.labels is not None]


def read_array(
    array: zarr.Array[Any], folder: Path, t: int, n: int | None = None
) -> npt.NDArray[Any]:
    """Return frame ``t`` of an array, of a point array its first ``n`` points.

    Raises
    ------
    InputError
        If a chunk is missing (zarr itself would give zeros) or its checksum is wrong.
    """
    if n == 0:
        return np.empty((0, array.shape[2]), array.dtype)
    chunks = 1 if n is None else -(-n // array.chunks[1])
    files = [folder / array.basename / "c" / str(t) / str(k) / "0" for k in range(chunks)]
    fault = "missing"
    if all(file.is_file() for file in files):
        try:
            return np.asarray(array[t, :n])
        except (RuntimeError, ValueError, OSError):  # what codecs raise on broken bytes
            fault = "damaged"
    raise InputError(
        f"{folder}, frame {t}: its {array.basename} is {fault}. The recording was changed after "
        "it was written; import or export it again."
    )


def content(folder: Path, frames: int) -> str:
    """Return twelve digits that stand for what a finished recording holds, wherever it lies.

    Every chunk ends in the checksum of its values (zstd), so four bytes of each are read.
    """
    digest = hashlib.sha256((folder / "zarr.json").read_bytes())
    for name in PER_FRAME:
        for file in sorted((folder / name).rglob("*")):
            digest.update(file.read_bytes() if file.is_file() else b"")
    for name in ("gray", "pixels", "xyz"):
        for t in range(frames):
            here = folder / name / "c" / str(t)  # a missing one is told when it is read
            for path in sorted(one for one in here.rglob("*") if one.is_file()):
                with path.open("rb") as opened:
                    end = opened.seek(0, os.SEEK_END)
                    opened.seek(max(end - 4, 0))
                    label = f"{path.relative_to(folder).as_posix()} {end} "
                    digest.update(label.encode() + opened.read())
    return digest.hexdigest()[:12]


def finish(
    group: zarr.Group, folder: Path, done: Sequence[Line], truth: Mapping[str, pd.DataFrame]
) -> None:
    """Add what only stands at the end, and close the journal."""
    for (name, kind), values in zip(PER_FRAME.items(), zip(*done, strict=True), strict=True):
        group.create_array(name, data=np.array(values, kind), overwrite=True)
    for name, table in truth.items():
        (folder / "truth").mkdir(exist_ok=True)
        table.to_parquet(folder / "truth" / f"{name}.parquet")
    (folder / JOURNAL).unlink()
