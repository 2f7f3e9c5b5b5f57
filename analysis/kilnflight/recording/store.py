"""Recordings on disk, read frame by frame.

A recording is a Zarr 3 group::

    gray       (frame, row, col)   uint16    one frame, one chunk
    pixels     (frame, point, 2)   int32     row, col of the points
    xyz        (frame, point, 3)   float32   mm, camera coordinates as captured
    labels     (frame, row, col)   uint8     Table 5.1, only of the frames that have any
    index, time_s, points, labelled (frame)  number, time, number of points, labels known
    truth/     <name>.parquet                tables of the truth, where there is one

The second axis of ``pixels`` and ``xyz`` is as long as an image has pixels; only the first
``points[t]`` entries of frame t exist, in chunks of `POINTS_PER_CHUNK`. All is zstd with a
checksum. A recording grows in a folder ``<name>.*.part`` and is moved out after its last frame.
"""

from __future__ import annotations

import glob
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import zarr
from tqdm import tqdm
from zarr.codecs import ZstdCodec

from kilnflight.checks import InputError, check_new
from kilnflight.recording.frames import LABELS, Attributes, Frame, Gray, Recording, check_position

FORMAT = "kilnflight recording 2"  # 1 did not say which depth calibration it needs
POINTS_PER_CHUNK = 65_536
KINDS = {"gray": "uint16", "pixels": "int32", "xyz": "float32", "labels": "uint8"}
PER_FRAME = {"index": "int64", "time_s": "float64", "points": "int64", "labelled": "bool"}
PLAUSIBLE_DEPTH_MM = 100.0, 50_000.0


@dataclass(frozen=True, eq=False)
class StoredRecording:
    """A recording on disk, made by `open_recording`."""

    path: Path
    attributes: Attributes
    arrays: Mapping[str, zarr.Array[Any]]
    per_frame: Mapping[str, npt.NDArray[Any]]  # of the names in PER_FRAME

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
        """Return the grey values (rows, cols) of frame ``t`` alone; errors as for `frame`."""
        check_position(t, len(self), self.attributes.name)
        return self._read("gray", t)

    def _read(self, name: str, t: int, n: int | None = None) -> npt.NDArray[Any]:
        """Return frame ``t`` of an array, of a point array its first ``n`` points."""
        array, folder = self.arrays[name], self.path / name / "c" / str(t)
        if n == 0:
            return np.empty((0, array.shape[2]), array.dtype)
        chunks, fault = range(1 if n is None else -(-n // array.chunks[1])), "missing"
        if all((folder / str(k) / "0").is_file() for k in chunks):  # else zarr gives zeros
            try:
                return np.asarray(array[t, :n])
            except (RuntimeError, ValueError, OSError):  # what codecs raise on broken bytes
                fault = "damaged"
        raise InputError(f"{self.path}, frame {t}: its {name} is {fault}. Write it again.")

    def truth(self) -> dict[str, pd.DataFrame]:
        """Return the tables of the truth by name; none for a recording of a real kiln."""
        files = sorted((self.path / "truth").glob("*.parquet"))
        return {file.stem: pd.read_parquet(file) for file in files}

    def content(self) -> str:
        """Return a hash (12 hex digits) of attributes and frames, independent of the place.

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
    if not (path / "zarr.json").is_file():
        cut = any(path.parent.glob(f"{glob.escape(path.name)}.*.part"))
        fault = "its writing was cut off" if cut else "there is no recording"
        raise InputError(f"{path}: {fault}. Give what kilnflight import or export wrote, or files.")
    try:
        group: Any = zarr.open_group(path, mode="r")
        attributes = dict(group.attrs)
        if attributes.pop("format", None) != FORMAT:
            raise InputError(f"a Zarr group, but not a {FORMAT}")
        per_frame = {name: np.asarray(group[name][:]) for name in PER_FRAME}
        arrays = {name: group[name] for name in KINDS}
        return StoredRecording(path, Attributes.from_json(attributes), arrays, per_frame)
    except (KeyError, TypeError, ValueError, RuntimeError, OSError) as error:
        raise InputError(f"{path}: damaged recording ({type(error).__name__}: {error}).") from error


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
        Positions of the frames to write, all by default. They keep their index and time.
    truth
        Tables by name, stored as Parquet.

    Raises
    ------
    InputError
        If the target exists, or the numbers or times of the frames do not grow.
    """
    path, name = Path(path), recording.attributes.name
    frames = range(len(recording)) if frames is None else frames
    check_new(path)
    if not frames:
        raise InputError(f"recording {name}: no frames to write.")
    for t in (frames[0], frames[-1]):
        check_position(t, len(recording), name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(".part", f"{path.name}.", path.parent) as folder:
        part, rows = Path(folder, path.name), []
        group = _create(part, recording.attributes, len(frames))
        # disable=None: a bar in a terminal, nothing in logs and notebooks
        for position, t in enumerate(tqdm(frames, desc=name, unit="frame", disable=None)):
            frame = recording.frame(t)
            _write_frame(group, position, frame)
            rows.append((frame.index, frame.time_s, len(frame.xyz), frame.labels is not None))
        per_frame = pd.DataFrame(rows, columns=list(PER_FRAME)).astype(PER_FRAME)
        if not (per_frame[["index", "time_s"]].diff()[1:] > 0).all(axis=None):
            raise InputError(f"recording {name}: number and time must grow from frame to frame.")
        for column, values in per_frame.items():
            group.create_array(str(column), data=values.to_numpy())
        for table_name, table in (truth or {}).items():
            (part / "truth").mkdir(exist_ok=True)
            table.to_parquet(part / "truth" / f"{table_name}.parquet")
        part.rename(path)
    return open_recording(path)


def _create(folder: Path, attributes: Attributes, length: int) -> zarr.Group:
    """Return a new, empty group."""
    pixels = attributes.rows * attributes.columns
    content = {"format": FORMAT, **asdict(attributes)}
    group = zarr.open_group(folder, mode="w", zarr_format=3, attributes=content)
    codec = ZstdCodec(level=1, checksum=True)
    for name, kind in KINDS.items():
        width = {"pixels": 2, "xyz": 3}.get(name)
        shape = (pixels, width) if width else attributes.size
        chunks = (1, min(POINTS_PER_CHUNK, pixels), width) if width else (1, *attributes.size)
        group.create_array(
            name, shape=(length, *shape), chunks=chunks, dtype=kind, compressors=codec
        )
    return group


def _write_frame(group: Any, position: int, frame: Frame) -> None:
    n = len(frame.xyz)
    with zarr.config.set({"array.write_empty_chunks": True}):  # no file then means damage
        group["gray"][position] = frame.gray
        if n:
            group["pixels"][position, :n] = frame.pixels
            group["xyz"][position, :n] = frame.xyz
        if frame.labels is not None:
            group["labels"][position] = frame.labels


def summarise_recording(recording: Recording) -> pd.DataFrame:
    """Read every frame once; return rows of ``what`` and ``value``, both texts."""
    rows, labels, attributes = [], np.zeros(len(LABELS), int), recording.attributes
    for t in tqdm(range(len(recording)), desc="checking", unit="frame", disable=None):
        frame = recording.frame(t)
        gray, z = frame.gray, frame.xyz[:, 2]
        top, ends = gray.max(), (z.min(initial=np.inf), z.max(initial=-np.inf))
        rows.append((gray.min(), top, np.count_nonzero(gray == top), len(z), *ends))
        if frame.labels is not None:
            labels += np.bincount(frame.labels.ravel(), minlength=len(LABELS))
    table = pd.DataFrame(rows, columns=["low", "top", "at_top", "points", "near", "far"])
    top, points, pixels = int(table["top"].max()), table["points"], len(rows) * gray.size
    saturated = table.loc[table["top"] == top, "at_top"].sum() / pixels
    facts = [
        ("recording", attributes.name),
        ("frames", f"{len(rows)} of {attributes.rows} x {attributes.columns} pixels"),
        *(("", note) for note in attributes.notes),
        ("gray", f"{table['low'].min()} to {top} ({top.bit_length()} bits)"),
    ]
    if top & (top + 1) == 0 and saturated > 0.001:  # all bits of the largest are 1
        facts.append(("warning", f"{100 * saturated:.2f} % of the pixels are {top}: saturated?"))
    if points.any():
        near, far, calibration = (
            table["near"].min(),
            table["far"].max(),
            attributes.depth_calibration,
        )
        per_frame = "{min:g} to {max:g} per frame, median {50%:g}".format(**points.describe())
        true = "taken as true: no depth_calibration is stated"
        if calibration is not None:
            true = "{:.0f} and {:.0f} mm by its depth_calibration".format(*calibration([near, far]))
        depth = f"{near:.0f} to {far:.0f} mm, as captured"
        facts += [("points", per_frame), ("depth", depth), ("", true)]
        if (points == 0).any():
            facts.append(("warning", f"{(points == 0).sum()} frames without points"))
        if near < PLAUSIBLE_DEPTH_MM[0] or far > PLAUSIBLE_DEPTH_MM[1]:
            facts.append(("warning", "depths: is the unit right, is the invalid value?"))
    if labels.any():
        counts = zip(labels, LABELS, strict=True)
        facts.append(("labels", ", ".join(f"{count} px {name}" for count, name in counts)))
    return pd.DataFrame(facts, columns=["what", "value"])


def aligned(rows: pd.DataFrame) -> str:
    """Return rows of ``what`` and ``value`` as text, one a line."""
    width = max(10, rows["what"].str.len().max())
    return "\n".join(f"{what:<{width}}  {value}" for what, value in rows.to_numpy().tolist())
