"""Recordings of a real belt: joined into one table, and their links compared with the
authors'.
"""

from __future__ import annotations

from collections.abc import Iterable
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
    for name in data.RECORDINGS if folder == published else ():
        plain = published.parent / name
        for path in (plain, plain.with_name(f"{plain.name}.gz")):
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
        pd.concat(states, ignore_index=True), pd.concat(ends, ignore_index=True)
    )


def _shifted(table: pd.DataFrame, **offsets: int) -> pd.DataFrame:
    """Return a table with an offset added to each named column; -1 (none) stays."""
    moved = {
        name: table[name] + by * (table[name] >= 0) for name, by in offsets.items()
    }
    return table.assign(**moved)


def _greatest(numbers: pd.Series, if_none: int) -> int:
    return int(numbers.max()) if len(numbers) else if_none


def links(table: pd.DataFrame, column: str) -> pd.MultiIndex:
    """Return the links of tracks: pairs (links, 2) of row numbers, earlier and later.

    ``column`` of ``table`` holds each measurement's track (-1: none); rows are ordered
    by ``frame``.
    """
    track = table[column].to_numpy()
    frame = table["frame"].to_numpy()
    order = np.lexsort((frame, track))
    same = (np.diff(track[order]) == 0) & (track[order][:-1] >= 0)
    return pd.MultiIndex.from_arrays([order[:-1][same], order[1:][same]])


def compare_links(measured: pd.DataFrame, followed: Followed) -> dict[str, float]:
    """Compare a tracker's links with the authors' (notebook 44).

    A link is a pair of measurements that follow each other in a track.

    Parameters
    ----------
    measured
        From `join_recordings`, a row per measurement.
    followed
        Tracks of these measurements, from `join_followed`.

    Returns
    -------
    dict
        Numbers ``links_authors``, ``links_tracker``; ``recall_percent``: share of the
        authors' links that the tracker found; ``agreed_percent``: share of the
        tracker's links that the authors have.
    """
    states = followed.states[followed.states["row"] >= 0]
    track = pd.Series(states["particle"].to_numpy(), states["row"])
    track = track.reindex(range(len(measured)), fill_value=-1)
    tracker = links(measured.assign(track=track.to_numpy()), "track")
    authors = links(measured, "author_track")
    shared = 100 * len(tracker.intersection(authors))
    counts = {"links_authors": len(authors), "links_tracker": len(tracker)}
    shares = (shared / len(authors), shared / len(tracker))
    return counts | dict(zip(["recall_percent", "agreed_percent"], shares, strict=True))
