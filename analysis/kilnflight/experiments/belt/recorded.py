"""Find the recordings of a real belt, and join several into one table."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from kilnflight.belt.recordings import list_recordings
from kilnflight.belt.tracker import Followed
from kilnflight.checks import InputError
from kilnflight.publication import data
from kilnflight.store import paths

PAUSE = 100  # frames between joined recordings, more than between two particles of one


def find_recordings() -> dict[str, list[Path]]:
    """Return the files of measured positions by material, empty if there are none.

    The folder is ``KILNFLIGHT_RECORDINGS``, else ``belt_recordings`` beside the
    authors' other data. Files in the latter must be the published ones (SHA-256), as
    ``make data`` puts them.

    Raises
    ------
    InputError
        If the folder of the variable has none, or a file beside the authors' other data
        is not the published one.
    """
    folder = paths.recordings()
    published = paths.external() / data.RECORDINGS_FOLDER
    files = list_recordings(folder)
    if folder != published and not files:
        raise InputError(f"KILNFLIGHT_RECORDINGS is {folder}, which has no recording.")
    if folder == published:
        for name in data.RECORDINGS:
            for path in (published.parent / name, published.parent / f"{name}.gz"):
                if path.is_file():
                    data.check(path, name)
    return files


def join_recordings(recordings: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Join recordings into one table with unique track numbers, `PAUSE` frames apart.

    Statistics of a material need all its recordings in one table (notebook 44).

    Parameters
    ----------
    recordings
        Measurements with ``frame`` and ``author_track`` (-1: none), from
        `kilnflight.belt.recordings.read_recording`. An empty one adds the pause only.

    Raises
    ------
    InputError
        If there is no recording.
    """
    tables = list(recordings)
    if not tables:
        raise InputError("no recording to join; give at least one.")
    tracks = [1 + max(table["author_track"], default=-1) for table in tables]
    return _joined(tables, frame=_frames(tables), author_track=tracks)


def join_followed(parts: Iterable[tuple[pd.DataFrame, Followed]]) -> Followed:
    """Join the tracks of several recordings to match `join_recordings`.

    ``parts`` holds measurements and tracks of each recording, in the order of
    `join_recordings`. Frames and rows refer to its table, so both functions must shift
    frames equally.
    """
    measured, followed = zip(*parts, strict=True)
    frames = _frames(measured)
    rows = list(map(len, measured))
    states, ends = zip(*followed, strict=True)
    tracks = [1 + max(table["particle"], default=-1) for table in ends]
    return Followed(
        states=_joined(states, frame=frames, particle=tracks, row=rows),
        ends=_joined(ends, frame=frames, particle=tracks),
    )


def _frames(tables: Sequence[pd.DataFrame]) -> list[int]:
    """Return the number of frames of each recording, with the pause after it."""
    return [PAUSE + max(table["frame"], default=0) for table in tables]


def _joined(tables: Sequence[pd.DataFrame], **counts: list[int]) -> pd.DataFrame:
    """Join tables whose named columns count from 0 in each; -1 (none) stays.

    ``counts`` holds, by column, how far each table counts.
    """
    joined = pd.concat(tables, keys=range(len(tables)))
    table = joined.index.get_level_values(0)
    for name, each in counts.items():
        before = np.cumsum([0, *each])[table]
        joined[name] += before * (joined[name] >= 0)
    return joined.reset_index(drop=True)
