"""Settings of trackers, tried on stretches of campaigns: the same objective for all.

A setting's worth is its mean beta over the fractions, without post-processing: beta charges
false tracks, and a tracker of someone else's has no post-processing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from itertools import product
from time import perf_counter

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.association import GNN, JPDA, Associator
from kilnflight.checks import InputError
from kilnflight.gating import Gate
from kilnflight.motion import ConstantVelocity
from kilnflight.pursuit import MEASURES, Tracker, Window, quality, run
from kilnflight.tracking import Management, track

# Tried for both of ours: standard deviations of the gate, px/frame^1.5, and frames.
GATES = (2.0, 3.0, 4.0, 6.0)
NOISES = (0.5, 1.0, 2.0)
INVISIBLE = (3, 5, 8, 12)


def ours() -> dict[str, dict[str, Tracker]]:
    """Return GNN and JPDA with every setting that is tried, by name and by setting."""
    associators: dict[str, Associator] = {"GNN": GNN(), "JPDA": JPDA()}
    tried: dict[str, dict[str, Tracker]] = {name: {} for name in associators}
    for name, associator in associators.items():
        for gate, noise, lost in product(GATES, NOISES, INVISIBLE):
            tried[name][f"gate {gate:g}, noise {noise:g}, lost {lost}"] = partial(
                track,
                associator=associator,
                motion=ConstantVelocity(acceleration_noise=noise),
                gate=Gate(gate),
                management=Management(invisible=lost),
            )
    return tried


def best_setting(
    windows: Iterable[Window], trackers: Mapping[str, Mapping[str, Tracker]]
) -> pd.DataFrame:
    """Return what each setting of each tracker gives; the best of each tracker is chosen.

    Parameters
    ----------
    windows
        Stretches that no result is taken from (`kilnflight.pursuit.windows`, ``others``).
    trackers
        Name of the tracker -> name of the setting -> the tracker, set.

    Returns
    -------
    DataFrame
        ``tracker``, ``setting``, the four measures without post-processing, averaged over the
        windows, ``seconds`` in all, ``chosen`` and ``note``. A tracker that refuses a window
        (an `InputError`) has no measures for that setting, and the note says why.

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
    each = [(name, text, one) for name, some in trackers.items() for text, one in some.items()]
    rows = [
        {"tracker": name, "setting": setting, **_tried(looked_at, tracker)}
        for name, setting, tracker in tqdm(each, desc="settings", unit="setting", disable=None)
    ]
    names = ["tracker", "setting", *MEASURES, "seconds", "note"]
    table = pd.DataFrame(rows, columns=names).assign(chosen=False)
    for name, mine in table.groupby("tracker", sort=False):
        if mine["beta"].isna().all():
            raise InputError(f"best_setting: {name} refuses every setting: {mine['note'].iloc[0]}")
        table.loc[mine["beta"].idxmax(), "chosen"] = True
    return table


def chosen(
    tried: pd.DataFrame, trackers: Mapping[str, Mapping[str, Tracker]]
) -> dict[str, Tracker]:
    """Return each tracker in the setting that `best_setting` chose."""
    best = tried[tried["chosen"]]
    return {
        name: trackers[name][setting]
        for name, setting in zip(best["tracker"], best["setting"], strict=True)
    }


def scored(windows: Iterable[Window], trackers: Mapping[str, Tracker]) -> pd.DataFrame:
    """Return `kilnflight.pursuit.run`, with a row without measures where a tracker refuses."""
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
