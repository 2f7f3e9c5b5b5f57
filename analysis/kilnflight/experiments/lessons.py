"""What the labelled frames teach for recordings without labels: threshold, wall, limit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from kilnflight.camera import calibrate_points
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.detection.wall import Cylinder, CylinderFit, InAir, crossing, distance_to_axis
from kilnflight.experiments import tallies, trial
from kilnflight.experiments.contenders import PASSES
from kilnflight.project.cache import CachedTable


@dataclass(frozen=True)
class Learned:
    """What the labelled frames say about detection in a campaign, which shares none of them.

    Parameters
    ----------
    threshold
        Of DoG, grey values: the best on all labelled frames together.
    wall
        The cylinder, fitted to the wall in the first of them.
    in_air_mm
        Largest distance from its axis of what is in the air: where the Gaussians of the
        marked particles cross, and 40 mm more, as the thesis goes from 760 to 800 mm.
    """

    threshold: float
    wall: Cylinder
    in_air_mm: float

    def in_air(self, detections: pd.DataFrame) -> pd.DataFrame:
        """Return the detections that are not known to be on the wall (sections 4.1.3, 5.1.4)."""
        on_wall = InAir(self.in_air_mm).on_wall(detections[["x", "y", "z"]], self.wall)
        return detections[~on_wall].reset_index(drop=True)


def learned(scale: str, seed: int = 0, frames: int = 0) -> Learned:
    """Return threshold, wall and limit from the five subsets; see `trial`."""
    depends_on = {"scale": scale, "seed": seed, "frames": frames}
    one = CachedTable("learned", partial(_learn, scale, seed, frames), depends_on)().iloc[0]
    centre, direction = (
        (float(one[f"{name}_x"]), float(one[f"{name}_y"]), float(one[f"{name}_z"]))
        for name in ("centre", "direction")
    )
    wall = Cylinder(centre, direction, float(one["radius_mm"]))
    return Learned(float(one["threshold"]), wall, float(one["in_air_mm"]))


def _learn(scale: str, seed: int, frames: int) -> pd.DataFrame:
    subsets = trial.ground_truth(scale, seed, frames)
    tried = tallies.sums(trial.thresholds(subsets, scale), ["threshold"])
    threshold = float(tried["threshold"].to_numpy()[int(np.argmax(tried["f1"]))])
    first = subsets[0].recording.frame(subsets[0].wanted[0])
    points = calibrate_points(first.xyz)
    labels = PASSES["DBSCAN"][0](points)
    on_wall = labels == np.bincount(labels[labels >= 0]).argmax()
    wall = CylinderFit()(points[on_wall], seed)
    marked = [trial.located(one, Combination(DoG(threshold)))[0] for one in subsets]
    known = pd.concat(marked).dropna(subset="z")
    far = distance_to_axis(known[["x", "y", "z"]], wall)
    flying = (known["label"] != 4).to_numpy()
    place = {f"centre_{axis}": value for axis, value in zip("xyz", wall.centre_mm, strict=True)}
    place |= {f"direction_{axis}": v for axis, v in zip("xyz", wall.direction, strict=True)}
    limit = crossing(far[flying], far[~flying]) + 40.0
    row = {"threshold": threshold, **place, "radius_mm": wall.radius_mm, "in_air_mm": limit}
    return pd.DataFrame([row])
