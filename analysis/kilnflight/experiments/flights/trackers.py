"""GNN and JPDA in the settings that the thesis does not print
(data/reference/trackers.csv).

Both limits of Eq. 4.14 are identified by the eight JSC_theta without post-processing of
Table 5.17, and by nothing else: these eight numbers then test nothing.
``identify/tracker_limits.py`` tries all settings on the full windows and writes
data/reference/tracker_limits.csv.
"""

from functools import partial

import pandas as pd

from kilnflight.association import GNN, JPDA, Associator
from kilnflight.experiments.flights import track_scores as scores
from kilnflight.experiments.flights.tracking import Tracker
from kilnflight.store import paths
from kilnflight.tracking.filter import ConstantVelocity, Gate
from kilnflight.tracking.tracker import Management, track


def limits() -> pd.DataFrame:
    """Return tracker_limits.csv: settings that were tried, the best first."""
    return pd.read_csv(paths.reference() / "tracker_limits.csv")


def settings() -> pd.DataFrame:
    """Return trackers.csv: one row per setting with its value for each tracker.

    ``decided_by`` is "identified" or "assumption". What is identified has its value
    from `limits`.
    """
    table = pd.read_csv(paths.reference() / "trackers.csv", index_col="setting")
    for name, value in limits().loc[0, ["visibility", "missed_frames"]].items():
        table.loc[name, list(scores.TRACKERS)] = value
    return table


def chosen(name: str, **changes: float) -> Tracker:
    """Return the tracker "GNN" or "JPDA" in its settings from trackers.csv.

    ``changes`` replace some of the settings.
    """
    value = {**settings()[name], **changes}
    associator: Associator
    if name == "GNN":
        associator = GNN(value["size_weight"], value["nonassignment_cost"])
    else:
        associator = JPDA(value["detection_probability"], value["size_weight"])
    return partial(
        track,
        associator=associator,
        motion=ConstantVelocity(
            velocity_sd=value["velocity_sd"],
            acceleration_noise=value["acceleration_noise"],
            measurement_sd=value["measurement_sd"],
        ),
        gate=Gate(value["gate"], value["depth_gate"]),
        management=Management(value["visibility"], value["missed_frames"]),
    )
