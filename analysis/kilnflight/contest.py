"""Settings that the publications do not print, found for every tracker in the same way.

stretches that are not scored x settings -> mean beta, without post-processing -> the best
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from itertools import product

import pandas as pd
from tqdm import tqdm

from kilnflight.association import GNN, JPDA, Associator
from kilnflight.gating import Gate
from kilnflight.motion import ConstantVelocity
from kilnflight.pursuit import Tracker, Window, quality
from kilnflight.tracking import Management, track

# Tried for both of ours: standard deviations of the gate, px/frame^1.5, and frames.
GATES = (2.0, 3.0, 4.0, 6.0)
NOISES = (0.5, 1.0, 2.0)
INVISIBLE = (3, 5, 8, 12)


def ours(associators: Mapping[str, Associator] | None = None) -> dict[str, dict[str, Tracker]]:
    """Return GNN and JPDA with every setting that is tried, by name and by setting."""
    associators = associators or {"GNN": GNN(), "JPDA": JPDA()}
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
    """Return how each setting does, and which one each tracker is to use.

    Parameters
    ----------
    windows
        Stretches that are not scored, `kilnflight.pursuit.windows` with ``others``.
    trackers
        By name and by setting.

    Returns
    -------
    DataFrame
        ``tracker``, ``setting``, the means of ``alpha`` and ``beta`` over the windows without
        post-processing, and ``chosen``: of each tracker the first with the largest beta.
    """
    windows = list(windows)
    each = [(name, text, one) for name, some in trackers.items() for text, one in some.items()]
    rows = []
    for name, text, tracker in tqdm(each, desc="settings", unit="setting", disable=None):
        found = [quality(one.truth, tracker(one.detections)) for one in windows]
        mean = pd.DataFrame(found)[["alpha", "beta"]].mean()
        rows.append({"tracker": name, "setting": text, **mean.to_dict()})
    table = pd.DataFrame(rows)
    best = table.groupby("tracker")["beta"].idxmax()
    return table.assign(chosen=table.index.isin(best))


def chosen(
    tried: pd.DataFrame, trackers: Mapping[str, Mapping[str, Tracker]]
) -> dict[str, Tracker]:
    """Return each tracker with the setting that `best_setting` chose."""
    best = tried[tried["chosen"]]
    pairs = zip(best["tracker"].astype(str), best["setting"].astype(str), strict=True)
    return {name: trackers[name][setting] for name, setting in pairs}
