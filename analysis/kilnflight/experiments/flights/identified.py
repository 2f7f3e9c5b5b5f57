"""Inputs of the simulation that one printed number decides, each as value -> number.

The numbers follow from true paths, true labels and the depth camera's errors, without
detector and tracker.
"""

from collections.abc import Iterable
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.arrays import Array
from kilnflight.detection.region import inside
from kilnflight.detection.wall import crossing
from kilnflight.flight import slices
from kilnflight.regression import fits, regress_all
from kilnflight.simulated.kiln.feeding import LABELLED
from kilnflight.simulated.kiln.laws import LONGEST_S, Law, fly
from kilnflight.simulated.kiln.scene import Scene, Twin
from kilnflight.tracklets.eliminate import Elimination, regularity

WINDOW = 100  # frames of paper shreds in Table 5.15
LASTING = 15  # frames: trajectories "continue for some time" (sec. 5.2.1)
# The limit in the air is 800 mm, and the Gaussians cross at 760 mm (sec. 5.1.4).
BEYOND_CROSSING_MM = 40.0


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
    return _in_view(scene, position_m, particle=particle, frame=frame)


def _in_view(scene: Scene, position_m: Array, **columns: Any) -> pd.DataFrame:
    """Return the places (n, 3) inside the region of interest, with other columns (n,).

    ``position_m`` is in the kiln; ``row``, ``col`` are px, and ``x``, ``y``, ``z`` mm.
    """
    xyz = scene.geometry.to_camera(position_m)
    row, col = scene.geometry.project(xyz)
    table = pd.DataFrame({**columns, "row": row, "col": col})
    table[["x", "y", "z"]] = xyz
    return table[inside(scene.roi, row, col)].reset_index(drop=True)


def regular_share(paths: pd.DataFrame) -> float:
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
    return float((found > Elimination.regularity).mean())


def seen_by_camera(
    paths: pd.DataFrame, scene: Scene, own_mm: npt.ArrayLike, seed: int = 0
) -> pd.DataFrame:
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
    xyz = place.unproject(pixel[:, 0], pixel[:, 1], paths["z"] + error)
    return paths.assign(x=xyz[:, 0], y=xyz[:, 1], z=xyz[:, 2])


def fit_medians(
    paths: pd.DataFrame, exit_point_mm: npt.ArrayLike, rate_hz: float
) -> pd.Series:
    """Return medians of RMSE in mm and of R2 of the fits of paths (Table 5.18).

    ``first_m_s`` is the median velocity in the first metre (Eq. 5.8).
    """
    long = paths[paths.groupby("particle")["frame"].transform("size") >= LASTING]
    table = regress_all(long, exit_point_mm, rate_hz)
    sliced = slices(fits(table))
    medians = table.filter(regex="^(rmse|r2_[xyz])").median()
    medians["first_m_s"] = sliced.loc[sliced["slice_m"] == 1.0, "velocity_m_s"].median()
    return medians


def wall_distances(
    twins: Iterable[Twin], wall_particle_mm: float, seed: int = 0
) -> tuple[pd.Series, pd.Series]:
    """Return the distances from the axis in mm of particles in the air and on the wall.

    They are all within the region of interest of labelled frames, as the depth camera
    sees them with an own error of ``wall_particle_mm`` on the wall.
    """
    every = pd.concat(
        _seen_distances(twin, t, wall_particle_mm, seed + t)
        for twin, t in product(twins, LABELLED)
    )
    distance = every["distance"]
    return distance[~every["wall"]], distance[every["wall"]]


def _seen_distances(
    twin: Twin, t: int, wall_particle_mm: float, seed: int
) -> pd.DataFrame:
    """Return ``wall`` and ``distance`` (mm) of the particles in one frame."""
    scene = twin.scene
    moment = twin.life.at(twin.time_s(t))
    moment = moment.take(~moment.landed | moment.burning)
    errors_mm = twin.life.table["fraction"].map(dict(scene.depth.particle_error_mm))
    flying_mm = errors_mm.to_numpy()[moment.particle]
    own_mm = np.where(moment.landed, wall_particle_mm, flying_mm)
    table = _in_view(scene, moment.position_m, wall=moment.landed, own_mm=own_mm)
    seen = seen_by_camera(table, scene, table["own_mm"], seed)
    kiln = scene.geometry.to_kiln(seen[["x", "y", "z"]].to_numpy())
    return seen.assign(distance=1000 * np.hypot(kiln[:, 1], kiln[:, 2]))


def wall_share(in_air_mm: npt.ArrayLike, wall_mm: npt.ArrayLike) -> float:
    """Return the share of wall particles that count as in the air.

    Table 5.13 has 263 of 838. Both arguments are distances from the kiln's axis. The
    limit is the crossing of their Gaussians plus `BEYOND_CROSSING_MM`.
    """
    limit = crossing(in_air_mm, wall_mm) + BEYOND_CROSSING_MM
    return float((np.asarray(wall_mm) < limit).mean())
