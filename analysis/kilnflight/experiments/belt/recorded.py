"""Find the recordings of a real belt, and join several into one table."""

from collections.abc import Iterable
from pathlib import Path

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
    parts = []
    frame = 0
    track = 0
    for table in recordings:
        parts.append(_shifted(table, frame=frame, author_track=track))
        frame += PAUSE + _greatest(table["frame"], 0)
        track += 1 + _greatest(table["author_track"], -1)
    if not parts:
        raise InputError("no recording to join; give at least one.")
    return pd.concat(parts, ignore_index=True)


def join_followed(parts: Iterable[tuple[pd.DataFrame, Followed]]) -> Followed:
    """Join the tracks of several recordings to match `join_recordings`.

    ``parts`` holds measurements and tracks of each recording, in the order of
    `join_recordings`. Frames and rows refer to its table, so both functions must shift
    frames equally.
    """
    states = []
    ends = []
    frame = 0
    row = 0
    track = 0
    for measured, followed in parts:
        states.append(_shifted(followed.states, frame=frame, particle=track, row=row))
        ends.append(_shifted(followed.ends, frame=frame, particle=track))
        frame += PAUSE + _greatest(measured["frame"], 0)
        row += len(measured)
        track += 1 + _greatest(followed.ends["particle"], -1)
    return Followed(
        states=pd.concat(states, ignore_index=True),
        ends=pd.concat(ends, ignore_index=True),
    )


def _shifted(table: pd.DataFrame, **offsets: int) -> pd.DataFrame:
    """Return a table with an offset added to each named column; -1 (none) stays."""
    for name, offset in offsets.items():
        table = table.assign(**{name: table[name] + offset * (table[name] >= 0)})
    return table


def _greatest(numbers: pd.Series, if_none: int) -> int:
    return int(numbers.max()) if len(numbers) else if_none
