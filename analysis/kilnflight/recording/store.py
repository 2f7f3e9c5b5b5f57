"""Recordings on disk: opened frame by frame, whole or not there at all.

What lies on disk is told in `kilnflight.recording.storage`. A recording grows under
``<name>.part`` with a journal of its finished frames, and gets its name when the last
one is in: a kill costs one frame, never a wrong result.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import zarr
from tqdm import tqdm

from kilnflight.checks import InputError
from kilnflight.recording import storage
from kilnflight.recording.frames import Attributes, Frame, Recording, check_frame, check_position

__all__ = [
    "Attributes",
    "Frame",
    "Recording",
    "StoredRecording",
    "check_frame",
    "open_recording",
    "write_recording",
]


@dataclass(frozen=True, eq=False)
class StoredRecording:
    """A recording on disk; `open_recording` gives it."""

    path: Path
    attributes: Attributes
    arrays: Mapping[str, zarr.Array[Any]]
    per_frame: Mapping[str, npt.NDArray[Any]]  # index, time_s, points, labelled

    def __len__(self) -> int:
        return len(self.per_frame["index"])

    def frame(self, t: int) -> Frame:
        """Return frame ``t``, counted from 0; only its own chunks are read.

        Raises
        ------
        InputError
            If there is no such frame, or it is damaged on disk.
        """
        check_position(t, len(self), self.attributes.name)
        index, time_s, n, labelled = (self.per_frame[name][t] for name in storage.PER_FRAME)

        def read(name: str, points: int | None = None) -> Any:
            return storage.read_array(self.arrays[name], self.path, t, points)

        return Frame(
            index=int(index),
            time_s=float(time_s),
            gray=read("gray"),
            pixels=read("pixels", int(n)),
            xyz=read("xyz", int(n)),
            labels=read("labels") if labelled else None,
        )

    def gray(self, t: int) -> npt.NDArray[np.uint16]:
        """Return the grey values (rows, cols) of frame ``t`` alone; errors as for `frame`."""
        check_position(t, len(self), self.attributes.name)
        found: npt.NDArray[np.uint16] = storage.read_array(self.arrays["gray"], self.path, t, None)
        return found

    def truth(self) -> dict[str, pd.DataFrame]:
        """Return the tables of the truth by name; none for a recording of a real kiln."""
        files = sorted((self.path / "truth").glob("*.parquet"))
        return {file.stem: pd.read_parquet(file) for file in files}


def open_recording(path: Path | str) -> StoredRecording:
    """Open a stored recording; memory does not depend on its length.

    Raises
    ------
    InputError
        If there is none, its writing was cut off, or it is damaged.
    """
    path = Path(path)
    candidates = [path] if path.exists() else [path, storage.part_of(path)]
    for folder in candidates:
        if (folder / storage.JOURNAL).is_file():
            begun, done = storage.read_journal(folder)
            total = len(range(*begun["frames"])) if begun else "some"
            raise InputError(
                f"{folder}: the recording was cut off after {len(done)} of {total} frames. Run "
                "what wrote it again with the same target; it goes on where it stopped."
            )
    if not (path / "zarr.json").is_file():
        raise InputError(f"{path}: there is no recording (no folder with a zarr.json).")
    try:
        group = zarr.open_group(path, mode="r")
        stored = dict(group.attrs)
        if stored.pop("format", None) != storage.FORMAT:
            raise InputError(f"{path}: a Zarr group, but not a {storage.FORMAT}. Import it first.")
        columns: dict[str, Any] = {name: group[name] for name in storage.PER_FRAME}
        arrays: dict[str, Any] = {name: group[name] for name in storage.ARRAYS}
        per_frame = {name: np.asarray(array[:]) for name, array in columns.items()}
        return StoredRecording(path, Attributes.from_json(stored), arrays, per_frame)
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
    if path.exists():
        raise InputError(f"{path}: exists already. Delete it or choose another target.")
    if not frames:
        raise InputError(f"recording {name}: no frames to write.")
    for t in (frames[0], frames[-1]):
        check_position(t, len(recording), name)
    part = storage.part_of(path)
    group, done = _begin(recording, part, frames)
    with (part / storage.JOURNAL).open("a") as journal:
        todo = list(frames)[len(done) :]
        # disable=None: a bar where somebody watches, nothing in logs and notebooks
        for t in tqdm(todo, desc=name, unit="frame", disable=None):
            frame = check_frame(recording.frame(t), recording.attributes)
            if done:
                _check_order(done[-1], frame, name)
            done.append(storage.write_frame(group, len(done), frame))
            journal.write(json.dumps(done[-1]) + "\n")
            journal.flush()
    storage.finish(group, part, done, truth or {})
    part.rename(path)
    return open_recording(path)


def _begin(
    recording: Recording, part: Path, frames: range
) -> tuple[zarr.Group, list[storage.Line]]:
    """Return the group to write into and the frames it already has."""
    begin = {
        "frames": [frames.start, frames.stop, frames.step],
        "attributes": recording.attributes.to_json(),
    }
    begun, done = storage.read_journal(part) if (part / storage.JOURNAL).is_file() else ({}, [])
    if begun:
        group = zarr.open_group(part, mode="r+")
        same = begun == json.loads(json.dumps(begin))
        if not same or not _same_last_frame(recording, frames, group, done):
            raise InputError(
                f"{part}: begun with another recording than {recording.attributes.name} is now "
                "(attributes, frames or content differ). Delete it to start again."
            )
    else:
        group = storage.create(part, recording.attributes, len(frames))
    storage.write_journal(part, begin, done)  # without a line that was cut
    return group, done


def _same_last_frame(
    recording: Recording, frames: range, group: zarr.Group, done: list[storage.Line]
) -> bool:
    """Return whether the last finished frame is what the recording gives today."""
    if not done:
        return True
    last = len(done) - 1
    frame = recording.frame(frames[last])
    n = len(frame.xyz)
    if done[last] != [frame.index, frame.time_s, n, frame.labels is not None]:
        return False
    arrays: dict[str, Any] = {name: group[name] for name in storage.ARRAYS}
    return all(
        own is None or np.array_equal(arrays[name][last, : len(own)], own)
        for name, own in ((name, getattr(frame, name)) for name in storage.ARRAYS)
    )


def _check_order(before: storage.Line, frame: Frame, name: str) -> None:
    index, time_s = before[:2]
    if frame.index <= index or frame.time_s <= time_s:
        raise InputError(
            f"recording {name}, frame {frame.index} at {frame.time_s} s follows frame {index} "
            f"at {time_s} s. Number and time must grow from frame to frame."
        )
