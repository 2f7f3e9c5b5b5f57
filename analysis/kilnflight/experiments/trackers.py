"""GNN and JPDA in the settings that the thesis does not print (data/reference/trackers.csv)."""

from functools import partial

import pandas as pd

from kilnflight.association import GNN, JPDA
from kilnflight.experiments.tracking import Tracker
from kilnflight.project import paths
from kilnflight.tracking.filter import ConstantVelocity, Gate
from kilnflight.tracking.tracker import Management, track


def chosen(name: str) -> Tracker:
    """Return a tracker, "GNN" or "JPDA", in its settings from trackers.csv.

    The file holds, in this order, the gate in standard deviations, the acceleration noise in
    px/frame^1.5, and the number of missed frames after which a track ends. The values give the
    largest beta on other frames than those of Table 5.17.
    """
    table = pd.read_csv(paths.reference() / "trackers.csv", index_col="tracker")
    gate_sd, noise, missed_frames = table.loc[name].to_numpy()
    motion = ConstantVelocity(acceleration_noise=float(noise))
    management = Management(invisible=int(missed_frames))
    associator, gate = GNN() if name == "GNN" else JPDA(), Gate(float(gate_sd))
    return partial(track, associator=associator, motion=motion, gate=gate, management=management)
