"""GNN and JPDA in the settings that the thesis does not print (data/reference/trackers.csv)."""

from functools import partial

import pandas as pd

from kilnflight.association import GNN, JPDA
from kilnflight.experiments.tracking import Tracker
from kilnflight.project import paths
from kilnflight.tracking.filter import ConstantVelocity, Gate
from kilnflight.tracking.tracker import Management, track


def chosen(name: str) -> Tracker:
    """Return a tracker by its name in trackers.csv."""
    table = pd.read_csv(paths.reference() / "trackers.csv", index_col="tracker")
    gate_sd, noise, missed_frames = table.loc[name].to_numpy()
    motion = ConstantVelocity(acceleration_noise=float(noise))
    management = Management(invisible=int(missed_frames))
    associator, gate = GNN() if name == "GNN" else JPDA(), Gate(float(gate_sd))
    return partial(track, associator=associator, motion=motion, gate=gate, management=management)
