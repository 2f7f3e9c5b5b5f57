"""Inputs of the simulation that one printed number decides, each as value -> number.

The numbers follow from true paths, true labels and the depth camera's errors, without
detector and tracker.
"""

from typing import Any

import numpy as np
from pandas import DataFrame, Series

from kilnflight.arrays import Array, ArrayLike
from kilnflight.detection.region import inside
from kilnflight.flight import slices
from kilnflight.regression import fits, regress_all
from kilnflight.simulated.kiln.laws import LONGEST_S, Law, fly
from kilnflight.simulated.kiln.scene import Scene
from kilnflight.tracklets.eliminate import Elimination, regularity

WINDOW = 100  # frames of paper shreds in Table 5.15
LASTING = 15  # frames: trajectories "continue for some time" (sec. 5.2.1)
# The limit in the air is 800 mm, and the Gaussians cross at 760 mm (sec. 5.1.4).
BEYOND_CROSSING_MM = 40.0


def true_paths(law: Law, scene: Scene, count: int = 500, seed: int = 0) -> DataFrame:
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
        ``particle``, ``frame``, ``row``, ``col`` in px and ``x``, ``y``, ``z`` in mm,
        sorted by particle and frame.
    """
    generator = np.random.default_rng([seed, 61])
    place = scene.geometry
    flights = fly(law, count, place, generator)
    released = WINDOW * generator.random(count)
    frames = np.arange(WINDOW + round(LONGEST_S * scene.frame_rate_hz))
    age = (frames - released[:, None]) / scene.frame_rate_hz
    particle, frame = np.nonzero((age >= 0) & (age < flights.end_s[:, None]))
    position_m = flights.take(particle).position(age[particle, frame])
    return in_view(scene, position_m, particle=particle, frame=frame)


def in_view(scene: Scene, position_m: Array, **columns: Any) -> DataFrame:
    """Return the places (n, 3) inside the region of interest, with other columns (n,).

    ``position_m`` is in the kiln; ``row``, ``col`` are px, and ``x``, ``y``, ``z`` mm.
    """
    xyz = scene.geometry.to_camera(position_m)
    row, col = scene.geometry.project(xyz)
    table = DataFrame({**columns, "row": row, "col": col})
    table[["x", "y", "z"]] = xyz
    return table[inside(scene.roi, row, col)].reset_index(drop=True)


def regular_share(paths: DataFrame) -> float:
    """Return the share of true paths that the elimination calls regular (Eq. 4.15).

    Paths are cut into windows of `WINDOW` frames, as the ground truth of Table 5.15 is;
    those of fewer than `LASTING` frames do not count.
    """
    piece = ["particle", "window"]
    paths = paths.assign(window=paths["frame"] // WINDOW)
    long = paths[paths.groupby(piece)["frame"].transform("size") >= LASTING]
    names = long.groupby(piece).ngroup()
    found = regularity(
        np.asarray(names, np.intp),
        long["frame"].to_numpy(np.int64),
        long[["row", "col"]].to_numpy(),
    )
    return (found > Elimination.regularity).mean()


def seen_by_camera(
    paths: DataFrame, scene: Scene, own_mm: ArrayLike, seed: int = 0
) -> DataFrame:
    """Return true paths as the depth camera sees them, moved along the rays.

    Parameters
    ----------
    paths
        ``row``, ``col`` in px and ``z`` in mm, of `true_paths`.
    scene
        Gives the depth camera.
    own_mm
        Standard deviation of the particles' own error, one or (n,).
    seed
        Of the errors that are new in each frame.
    """
    place = scene.geometry
    camera = scene.depth
    calibration = camera.calibration(place.rows, place.columns, scene.calibration)
    pixel = paths[["row", "col"]].to_numpy()
    row, col = np.rint(pixel).astype(int).T
    scale = camera.wall_scale(paths["z"])
    anew = np.hypot(own_mm, np.sqrt(1 - camera.fixed) * scale)
    error = calibration[row, col] * scale
    error += anew * np.random.default_rng([seed, 62]).standard_normal(len(paths))
    xyz = place.unproject(paths["row"], paths["col"], paths["z"] + error)
    return paths.assign(**dict(zip("xyz", xyz.T, strict=True)))


def fit_medians(paths: DataFrame, exit_point_mm: ArrayLike, rate_hz: float) -> Series:
    """Return medians of RMSE in mm and of R2 of the fits of paths (Table 5.18).

    ``first_m_s`` is the median velocity in the first metre (Eq. 5.8).
    """
    long = paths[paths.groupby("particle")["frame"].transform("size") >= LASTING]
    table = regress_all(long, exit_point_mm, rate_hz)
    sliced = slices(fits(table))
    medians = table.filter(regex="^(rmse|r2_[xyz])").median()
    medians["first_m_s"] = sliced.loc[sliced["slice_m"] == 1.0, "velocity_m_s"].median()
    return medians
