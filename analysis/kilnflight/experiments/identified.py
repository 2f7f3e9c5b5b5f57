"""Inputs of the simulation that one printed number decides, each as value -> number.

True paths, true labels and simulated depth are read. No detector and no tracker has a part in it.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from kilnflight.camera import inside
from kilnflight.tracklets.eliminate import Elimination, regularity
from kilnflight.twin.flights import LONGEST_S, Law, fly
from kilnflight.twin.scene import Scene

WINDOW = 100  # frames of paper shreds in Table 5.15
LASTING = 15  # frames: trajectories "continue for some time" (sec. 5.2.1)


def true_paths(law: Law, scene: Scene, count: int = 500, seed: int = 0) -> pd.DataFrame:
    """Return the true places of particles in the air inside the region of interest.

    Parameters
    ----------
    law
        Distribution of the flights.
    scene
        Gives camera, region of interest and frame rate.
    count
        Particles, released at any time of one `WINDOW`.
    seed
        Of the flights and the releases.

    Returns
    -------
    DataFrame
        ``particle``, ``frame``, ``row``, ``col`` in px and ``x``, ``y``, ``z`` in mm, sorted by
        particle and frame.
    """
    generator, place = np.random.default_rng([seed, 61]), scene.geometry
    flights = fly(law, count, place, generator)
    released = WINDOW * generator.random(count)
    frames = np.arange(WINDOW + round(LONGEST_S * scene.frame_rate_hz))
    age = (frames - released[:, None]) / scene.frame_rate_hz
    particle, frame = np.nonzero((age >= 0) & (age < flights.end_s[:, None]))
    position = flights.take(particle).position(age[particle, frame])
    xyz = place.to_camera(position)
    row, col = place.project(xyz)
    table = pd.DataFrame({"particle": particle, "frame": frame, "row": row, "col": col})
    table[["x", "y", "z"]] = xyz
    return table[inside(scene.roi, row, col)].reset_index(drop=True)


def regular_share(paths: pd.DataFrame) -> float:
    """Return the share of true paths that the elimination calls regular (Eq. 4.15).

    Paths are cut into windows of `WINDOW` frames, as the ground truth of Table 5.15 is; those of
    fewer than `LASTING` frames do not count.
    """
    pieces = paths.groupby(["particle", paths["frame"] // WINDOW])
    long = paths[pieces["frame"].transform("size") >= LASTING]
    names = long.groupby(["particle", long["frame"] // WINDOW]).ngroup().to_numpy(np.intp)
    place = long[["row", "col"]].to_numpy()
    found = regularity(names, long["frame"].to_numpy(), place)
    return float((found > Elimination.regularity).mean())
