"""The tracking experiment beside Tables 5.15 and 5.17, and the verdicts on its claims."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from kilnflight.experiments.tracking import MEASURES, Tracker, Window, cost
from kilnflight.project import claims

KEYS = ["fraction", "tracker", "postprocessing"]
SINGULARS = {"Wood chips": "wood chip", "Confetti": "confetti"}
SINGULARS |= {"Paper shreds": "paper shred", "PE granules": "PE granule"}


def window_table(windows: Sequence[Window]) -> pd.DataFrame:
    """Return frames, trajectories, positions and detections of windows beside Table 5.15."""
    printed = claims.published("table_5.15")
    amount = printed["amount_of_trajectories"].set_axis(printed["fraction"].str.lower())
    rows = [
        {
            "fraction": window.fraction,
            "first_frame": window.frames.start,
            "frames": len(window.frames),
            "trajectories": window.truth["particle"].nunique(),
            "positions": len(window.truth),
            "detections": len(window.detections),
            "trajectories_published": amount[window.fraction.lower()],
        }
        for window in windows
    ]
    return pd.DataFrame(rows)


def beside_table_5_17(measured: pd.DataFrame) -> pd.DataFrame:
    """Return every measure of `tracking.run` (``here``) beside that of Table 5.17."""
    printed = claims.published("table_5.17")
    printed = printed.assign(
        fraction=printed["fraction"].map(SINGULARS), measure=printed["measure"].str.lower()
    )
    names = {"algorithm": "tracker", "post_processing": "postprocessing", "value": "published"}
    cells = measured.melt(KEYS, list(MEASURES), "measure", "here")
    return cells.merge(printed.rename(columns=names)[[*KEYS, "measure", "published"]])


def gains(cells: pd.DataFrame) -> pd.Series:
    """Return by how much post-processing raises each measure, from `beside_table_5_17`."""
    keys = ["fraction", "tracker", "measure"]
    wide = cells.pivot(index=keys, columns="postprocessing", values="here")
    return wide["with"] - wide["without"]


def verdicts(
    cells: pd.DataFrame, windows: Sequence[Window], trackers: Mapping[str, Tracker]
) -> list[claims.Verdict]:
    """Return the verdicts on the claims of section 5.2.3.

    Parameters
    ----------
    cells
        Of `beside_table_5_17`.
    windows, trackers
        GNN and JPDA are run again on the windows for their cost.
    """
    keys = ["fraction", "tracker", "measure"]
    wide = cells.pivot(index=keys, columns="postprocessing", values="here")
    gain = gains(cells)
    after = wide["with"].unstack("tracker")
    apart = (after["JPDA"] - after["GNN"]).unstack("measure")
    small = {
        f"{fraction} {name}": abs(value)
        for fraction, row in apart[["alpha", "beta"]].iterrows()
        for name, value in row.items()
    }
    ahead = apart[["alpha", "beta", "jsc"]].mean()
    costs = {name: cost(windows, tracker) for name, tracker in trackers.items()}
    seconds, memory = (costs["JPDA"][k] / costs["GNN"][k] for k in (0, 1))
    found = [
        claims.judge("track-3", pd.Series(small)),
        claims.judge("track-4", float(ahead.mean()), note="mean of alpha, beta and JSC"),
        claims.judge("track-6", seconds, note=f"time; peak of memory {memory:.2f} times"),
    ]
    first = wide["without"].unstack("measure")[["alpha", "beta"]].max(axis="columns")
    rest, highest = (
        first.drop("wood chip", level="fraction"),
        first.groupby("fraction").max().idxmax(),
    )
    ranks = wide["with"].xs("alpha", level="measure").groupby("fraction").mean()
    whole = {
        "track-1": {f"{(gain > 0).sum()} of {len(gain)} cells rise": bool((gain > 0).all())},
        "track-2": {
            f"highest {highest}": highest == "wood chip",
            f"others at most {rest.max():.2f} <= 0.43": bool(rest.max() <= 0.43),
        },
        "track-5": {
            f"lowest {ranks.idxmin()} {ranks.min():.2f}": ranks.idxmin() == "confetti",
            f"highest {ranks.idxmax()} {ranks.max():.2f}": ranks.idxmax() == "wood chip",
        },
    }
    note = "of windows with as many trajectories as Table 5.15"
    for name, conditions in whole.items():
        if len(windows) == 4:
            found.append(claims.judge(name, conditions, note=note))
        else:
            found.append(claims.undecidable(name, "a smoke run has two of four fractions"))
    return found
