"""Settings of trackers, tried on stretches of campaigns: the same objective, the same rule.

A setting's worth is its mean beta over the fractions, without post-processing: beta charges
false tracks, and a tracker of someone else's has no post-processing. Every parameter has a
ladder of values, in steps of about the same ratio. A small grid is tried in full; then the
neighbours of the best setting on each ladder, until none is better. So the best lies inside
of what was tried, or at an end of a ladder, and the table says which.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import product
from time import perf_counter

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.checks import InputError
from kilnflight.experiments.ladders import Ladders, Setting
from kilnflight.experiments.pursuit import MEASURES, Tracker, Window, quality, run


def best_setting(windows: Iterable[Window], trackers: Mapping[str, Ladders]) -> pd.DataFrame:
    """Return what each setting of each tracker gives; the best of each tracker is chosen.

    Parameters
    ----------
    windows
        Stretches that no result is taken from (`pursuit.windows`, ``others``).
    trackers
        Name of the tracker -> its ladders.

    Returns
    -------
    DataFrame
        ``tracker``, ``setting``, the four measures without post-processing, averaged over the
        windows, ``seconds`` in all, ``chosen``, ``at_end`` (of the chosen: its parameters at an
        end of their ladders, "" if it lies inside) and ``note``. A tracker that refuses a
        window (an `InputError`) has no measures for that setting, and the note says why.

    Raises
    ------
    InputError
        If there is no window, or every setting of a tracker refuses one.

    Notes
    -----
    Of settings of equal worth the first is chosen.
    """
    looked_at = list(windows)
    if not looked_at:
        raise InputError("best_setting: no windows to try settings on.")
    parts = [_climbed(looked_at, name, ladders) for name, ladders in trackers.items()]
    names = ["tracker", "setting", *MEASURES, "seconds", "chosen", "at_end", "note"]
    return pd.concat(parts, ignore_index=True)[names] if parts else pd.DataFrame(columns=names)


def beginning(window: Window, frames: int) -> Window:
    """Return the first frames of a stretch, for trackers that are too slow for all of it."""
    part = window.frames[:frames]
    seen, true = (
        table[table["frame"].isin(part)].reset_index(drop=True)
        for table in (window.detections, window.truth)
    )
    return window._replace(frames=part, detections=seen, truth=true)


def _climbed(windows: list[Window], name: str, ladders: Ladders) -> pd.DataFrame:
    """Try the grid, then the neighbours of the best until none is better."""
    tried: dict[Setting, dict[str, object]] = {}
    ahead = ladders.first()
    with tqdm(desc=name, unit="setting", disable=None) as bar:
        while ahead:
            for setting in ahead:
                row = {"tracker": name, "setting": ladders.text(setting)}
                tried[setting] = row | _tried(windows, ladders.build(*setting))
                bar.update()
            table = pd.DataFrame(tried.values())
            if table["beta"].isna().all():
                raise InputError(
                    f"best_setting: {name} refuses every setting: {table['note'].iloc[0]}"
                )
            best = int(table["beta"].argmax())
            setting = list(tried)[best]
            ahead = [one for one in ladders.neighbors(setting) if one not in tried]
    here = np.arange(len(table)) == best
    return table.assign(chosen=here, at_end=np.where(here, ladders.ends(setting), ""))


def chosen(tried: pd.DataFrame, trackers: Mapping[str, Ladders]) -> dict[str, Tracker]:
    """Return each tracker in the setting that `best_setting` chose."""
    best = tried[tried["chosen"]]
    found = {}
    for name, text in zip(best["tracker"], best["setting"], strict=True):
        ladders = trackers[name]
        named = {ladders.text(one): one for one in product(*ladders.rungs.values())}
        found[name] = ladders.build(*named[text])
    return found


def scored(windows: Iterable[Window], trackers: Mapping[str, Tracker]) -> pd.DataFrame:
    """Return `pursuit.run`, with a row without measures where a tracker refuses."""
    parts = []
    for window in windows:
        for name, tracker in trackers.items():
            try:
                parts.append(run([window], {name: tracker}).assign(note=""))
            except InputError as error:
                row = {"fraction": window.fraction, "tracker": name, "note": f"not run: {error}"}
                stages = pd.DataFrame([row, row]).assign(postprocessing=["without", "with"])
                parts.append(stages)
    return pd.concat(parts, ignore_index=True)


def _tried(windows: list[Window], tracker: Tracker) -> dict[str, object]:
    """Return the means over the windows, the seconds of tracking, and why there are none."""
    found, begin = [], perf_counter()
    try:
        tracks = [tracker(window.detections) for window in windows]
    except InputError as error:
        nothing = dict.fromkeys(MEASURES, np.nan)
        return {**nothing, "seconds": perf_counter() - begin, "note": f"not run: {error}"}
    seconds = perf_counter() - begin
    for window, table in zip(windows, tracks, strict=True):
        found.append(quality(window.truth, table))
    means = pd.DataFrame(found)[list(MEASURES)].mean()
    return {**{str(k): float(v) for k, v in means.items()}, "seconds": seconds, "note": ""}
