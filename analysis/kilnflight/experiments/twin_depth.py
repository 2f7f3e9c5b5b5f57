"""Set the depth camera of the second look by published inputs.

Run as ``python -m kilnflight.experiments.twin_depth`` (some minutes); it writes twin/depth.json.
Four printed facts decide as many kinds of numbers, one after the other:

- the share of unlit particles in the air with depth (Table 5.2) the least contrast of a lens,
- about 200,000 points a frame (section 5.1.3) how many of them the wall has,
- RMSE in z of fitted trajectories (Table 5.18) the error of each fraction: true trajectories with
  the points that a person labels are fitted as the thesis fits, and the median is to be the printed
  one, so that the error put in comes out again. Positions with another particle's depth are left
  out, as a tracker's gate would (`without_jumps`),
- the distances of neighbours (Fig. 5.7) were looked at when the rest was chosen by hand.

R2 of Table 5.18 is not read, and no detection takes part. Nothing of this is a result: that these
numbers appear again validates nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from kilnflight import regression
from kilnflight.camera import calibrate_points
from kilnflight.detection import k_distances
from kilnflight.project import cache, claims, parallel
from kilnflight.twin import truth
from kilnflight.twin.camera import DepthCamera
from kilnflight.twin.fitted import DEPTH_FILE, second_depth
from kilnflight.twin.lenses import LensCamera
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scene import SceneView, Twin
from kilnflight.twin.scenes import (
    LABELLED,
    PRESSURES_BAR,
    SUBSETS,
    cached_scene,
    campaign_name,
    tracking_window,
)

POINTS = 200_000  # a frame (section 5.1.3)
UNLIT = 0.7879  # with depth, of those that do not burn in the air (Table 5.2)
EVERY = 3  # of the labelled frames
FOLLOWED = 240  # frames of a campaign in which trajectories are fitted
FEWEST = 15  # positions of a trajectory that is fitted: two for each unknown of Eq. 4.29
ROUNDS = 2  # of the errors
GATE = 3.0  # printed RMSE in z from the running median, beyond which no tracker would associate
AROUND = 9  # frames of that median
NEIGHBOURS_MM = (1.0, 2.0, 4.0)  # Fig. 5.7: a third, two thirds, over nine tenths below
PROCESSES = 2
MARGIN = (0.2, 5.0)  # times the present contrast, between which it is sought


def with_depth(twin: Twin, camera: LensCamera) -> Twin:
    """Return a recording with another depth camera; flights and pictures are shared."""
    other = Twin(replace(twin.scene, depth=camera))
    shared = ("life", "_bodies", "_background", "_fires", "_noise", "_sigma")
    other.__dict__.update({name: getattr(twin, name) for name in shared})
    return other


def shares_with_depth(twins: Sequence[Twin]) -> pd.Series:
    """Return the share of visible particles with depth by label (Table 5.2)."""
    seen = pd.concat([truth.sightings(twin, t) for twin in twins for t in LABELLED[::EVERY]])
    return seen[seen["visible"]].groupby("label")["has_depth"].mean()


def least_contrast(twins: Sequence[Twin], camera: LensCamera) -> float:
    """Return the contrast from which on as many unlit particles have depth as in Table 5.2."""
    sought = [with_depth(twin, camera) for twin in twins]
    views = [(twin, t, twin.view(t)) for twin in sought for t in LABELLED[::EVERY]]

    def more(logarithm: float) -> float:
        camera_then = replace(camera, contrast=float(np.exp(logarithm)))
        known = [_unlit_with_depth(with_depth(twin, camera_then), t, v) for twin, t, v in views]
        return float(np.concatenate(known).mean()) - UNLIT

    low, high = (float(np.log(factor * camera.contrast)) for factor in MARGIN)
    return float(np.exp(brentq(more, low, high, xtol=0.01)))


def _unlit_with_depth(twin: Twin, t: int, view: SceneView) -> Any:
    """Return of each visible unlit particle whether it has depth."""
    unlit = view.blobs.particle[view.visible & (view.kinds == 3)]
    return np.isin(unlit, twin.particles_with_depth(t, view))


def points_on(twin: Twin, t: int) -> pd.DataFrame:
    """Return the place of every visible particle in the air: the median of its points, calibrated.

    Columns ``frame``, ``particle``, ``x``, ``y``, ``z``; NaN where it has no depth.
    """
    view, frame = twin.view(t), twin.frame(t)
    owner = np.full(view.labels.size, -1)
    owner[view.pixels.place[view.shown]] = view.blobs.particle[view.pixels.blob[view.shown]]
    row, column = frame.pixels.T.astype(np.intp)
    table = pd.DataFrame(
        calibrate_points(frame.xyz, twin.attributes.depth_calibration), columns=list("xyz")
    ).assign(particle=owner[row * view.labels.shape[1] + column], frame=t)
    flying = view.blobs.particle[view.visible & (view.kinds != 4)]
    return (
        table[table["particle"].isin(flying)].groupby(["frame", "particle"]).median().reset_index()
    )


def without_jumps(tracks: pd.DataFrame, gate_mm: float) -> pd.DataFrame:
    """Return the positions with depth that lie within a gate of their running median in z.

    A particle that passes before or behind another has the other's depth for a frame or two; a
    tracker's gate keeps such positions out of a trajectory.
    """
    known = tracks.dropna().sort_values(["particle", "frame"])
    middle = known.groupby("particle")["z"].transform(
        lambda z: z.rolling(AROUND, center=True, min_periods=1).median()
    )
    return known[(known["z"] - middle).abs() < gate_mm]


def fitted_error(name: str, twin: Twin) -> float:
    """Return the median RMSE in z in mm of a fraction's fitted true trajectories."""
    window = tracking_window(twin)[:FOLLOWED]
    tracks = pd.concat([points_on(twin, t) for t in window], ignore_index=True)
    begun = twin.life.release_s * twin.scene.frame_rate_hz >= window.start
    tracks = without_jumps(tracks[begun[tracks["particle"]]], GATE * printed_errors()[name])
    long = tracks.groupby("particle")["z"].transform("count") >= FEWEST
    exit_point = np.array(twin.attributes.exit_point_mm, dtype=np.float64)
    fits = regression.regress_all(tracks[long], exit_point, twin.scene.frame_rate_hz)
    return float(fits.loc[fits["outcome"] == regression.FITTED, "rmse_z_mm"].median())


def fitted_errors(camera: LensCamera) -> dict[str, float]:
    """Return `fitted_error` of each fraction's campaign at the first pressure with a camera."""
    pieces = [(name, camera) for name in FRACTIONS]
    return dict(zip(FRACTIONS, parallel.run_all(_error_with, pieces, PROCESSES), strict=True))


def _error_with(name: str, camera: LensCamera) -> float:
    twin = cached_scene(campaign_name(name, PRESSURES_BAR[0]))
    return fitted_error(name, with_depth(twin, camera))


def printed_errors() -> dict[str, float]:
    """Return RMSE in z in mm by fraction, as Table 5.18 prints it."""
    return dict(DepthCamera().particle_error_mm)


def errors_that_return(camera: LensCamera) -> tuple[LensCamera, dict[str, float]]:
    """Return the camera whose trajectories have the printed errors, and what they then are."""
    printed = printed_errors()
    for _ in range(ROUNDS):
        measured = fitted_errors(camera)
        put_in = dict(camera.particle_error_mm)
        # variances add: what else scatters stays
        square = {n: printed[n] ** 2 - measured[n] ** 2 + put_in[n] ** 2 for n in printed}
        least = {n: (0.1 * put_in[n]) ** 2 for n in printed}
        error = {n: round(float(np.sqrt(max(square[n], least[n]))), 1) for n in printed}
        camera = replace(camera, particle_error_mm=tuple(error.items()))
    return camera, fitted_errors(camera)


def wall_points(twins: Sequence[Twin], camera: LensCamera) -> int:
    """Return how many points of the wall make `POINTS` on average, with those of particles."""
    total = []
    for twin in (with_depth(each, camera) for each in twins):
        total.append(len(twin.frame(LABELLED[0]).pixels))
    return int(round(camera.wall_points + POINTS - float(np.mean(total)), -2))


def neighbours(twins: Sequence[Twin]) -> dict[str, float]:
    """Return the shares of points with a neighbour nearer than `NEIGHBOURS_MM` (Fig. 5.7)."""
    near = []
    for twin in twins:
        cloud = calibrate_points(twin.frame(LABELLED[0]).xyz, twin.attributes.depth_calibration)
        near.append(k_distances(cloud, 2))
    every = np.concatenate(near)
    return {f"below {mm:g} mm": round(float((every < mm).mean()), 3) for mm in NEIGHBOURS_MM}


def calibrate(camera: LensCamera) -> dict[str, Any]:
    """Return the content of depth.json; what is chosen by hand is that of ``camera``."""
    twins = [cached_scene(name) for name in SUBSETS]
    camera = replace(camera, contrast=float(f"{least_contrast(twins, camera):.3g}"))
    camera = replace(camera, wall_points=int(wall_points(twins, camera)))
    camera, errors = errors_that_return(camera)
    final = [with_depth(twin, camera) for twin in twins]
    inputs = {
        "contrast": camera.contrast,
        "wall_points": camera.wall_points,
        "particle_error_mm": dict(camera.particle_error_mm),
    }
    return {
        "inputs": inputs,
        "targets": targets(),
        "targets_sha256": cache.content_hash(targets()),
        "rmse_z_mm": {name: round(error, 1) for name, error in errors.items()},
        "with_depth": {str(k): round(float(v), 4) for k, v in shares_with_depth(final).items()},
        "points": [len(twin.frame(LABELLED[0]).pixels) for twin in final],
        "neighbours": neighbours(final),
    }


def targets() -> list[dict[str, Any]]:
    """Return what decides, as published."""
    table = claims.published("table_5.2").iloc[:3]
    shares = dict(table[["class", "percentage_with_3d_info"]].itertuples(index=False, name=None))
    return [shares, {"points": POINTS}, printed_errors()]


def read_fit(path: Path = DEPTH_FILE) -> dict[str, Any]:
    """Return the calibration's content; it must have been made for today's targets.

    Raises
    ------
    InputError
        If the file is missing or damaged, or was made for other targets than published.
    """
    return cache.read_calibration(path, targets(), "kilnflight.experiments.twin_depth")


def main() -> int:
    """Set the camera, write the file, and print the result."""
    print(cache.write_calibration(DEPTH_FILE, calibrate(second_depth())))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
