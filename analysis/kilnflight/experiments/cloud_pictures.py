"""Pictures of point clouds: in space, and how near their points lie.

Figs 2.12 and 5.7 of the thesis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.figure import Figure

from kilnflight.camera import calibrate_points
from kilnflight.detection import k_distances
from kilnflight.experiments.detection import Subset
from kilnflight.experiments.space import label_camera_space, upright
from kilnflight.project.style import COLOURS, LINES, PAGE_MM, PUBLISHED, canvas
from kilnflight.recording.frames import calibrated_cloud

Array = npt.NDArray[np.float64]
DRAWN = 12_000  # points of kiln and flame; more would hide the particles
WITHIN_MM = (1.0, 2.0, 4.0)  # named in the text of Fig. 5.7
PRINTED = {1.0: 1 / 3, 2.0: 2 / 3}  # shares in the text; of 4 mm it says "more than 0.9"
LEAST = {4.0: 0.9}


def particle_cloud(subset: Subset, t: int) -> pd.DataFrame:
    """Return the calibrated cloud of a labelled frame with the particle of each point.

    Returns
    -------
    DataFrame
        ``row``, ``col``, ``x``, ``y``, ``z`` in mm, ``gray``, and ``particle``, -1 for none. A
        particle is one that was marked: inside the region of interest.
    """
    frame = subset.recording.frame(t)
    xyz = calibrate_points(frame.xyz, subset.recording.attributes.depth_calibration)
    table = pd.DataFrame(frame.pixels, columns=["row", "col"])
    table[["x", "y", "z"]] = xyz
    row, col = frame.pixels.T
    marked = subset.particles.loc[subset.particles["frame"] == t, "particle"]
    particle = np.asarray(subset.instances(t)[row, col])
    particle = np.where(np.isin(particle, marked), particle, -1)
    return table.assign(gray=frame.gray[row, col], particle=particle)


def draw_cloud(cloud: pd.DataFrame, seed: int) -> tuple[Figure, pd.DataFrame]:
    """Draw a cloud of the kiln in space, its particles in colour, one of them marked.

    The marked particle is the one with the most points; it is drawn alone on the right, too, and
    its points come with the picture.

    Parameters
    ----------
    cloud
        From `particle_cloud`.
    seed
        Of the choice of the kiln's points that are drawn.
    """
    others, flying = cloud[cloud["particle"] < 0], cloud[cloud["particle"] >= 0]
    counts = flying["particle"].value_counts(sort=False).sort_index()
    marked = flying[flying["particle"] == (counts.idxmax() if len(counts) else -1)]
    shown = others.sample(min(DRAWN, len(others)), random_state=seed)
    picture = plt.figure(figsize=(PAGE_MM / 25.4, 85 / 25.4), layout="none")
    room: Any = picture.add_axes((-0.05, 0.03, 0.6, 0.97), projection="3d")
    points: dict[str, Any] = {"depthshade": False, "linewidths": 0}
    gray = np.sqrt(shown["gray"])
    look: dict[str, Any] = {"c": gray, "cmap": "gray", "s": 0.8, "vmin": 0}
    look["vmax"] = 1.25 * float(gray.quantile(0.99))  # white points would vanish on paper
    room.scatter(*upright(shown[["x", "y", "z"]]), **look, **points)
    room.scatter(*upright(flying[["x", "y", "z"]]), s=1.2, color=COLOURS[2], **points)
    ring: dict[str, Any] = {"s": 160, "lw": 1.4, "ec": COLOURS[1], "fc": "none"}
    if len(marked):
        middle = upright(marked[["x", "y", "z"]].mean().to_numpy())
        room.scatter(*middle, depthshade=False, **ring)
    label_camera_space(room)
    room.set_box_aspect((1.9, 1, 1), zoom=1.15)
    room.view_init(elev=18, azim=-60)
    alone = picture.add_axes((0.73, 0.2, 0.24, 0.64))
    beside = marked[["x", "y"]] - marked[["x", "y"]].mean()  # short labels
    dots = alone.scatter(beside["x"], beside["y"], c=marked["z"] / 1000, s=9, cmap="viridis")
    alone.set(xlabel="x from its middle (mm)", ylabel="up, y from its middle (mm)")
    alone.set(aspect="equal", title="the marked particle")
    alone.margins(0.15)
    alone.locator_params(axis="x", nbins=3)
    alone.locator_params(axis="y", nbins=5)
    picture.colorbar(dots, ax=alone, label="depth z (m)", location="bottom", pad=0.25, shrink=0.9)
    plt.close(picture)
    return picture, marked.reset_index(drop=True)


def neighbour_distances(subsets: Sequence[Subset]) -> tuple[dict[str, Array], pd.DataFrame]:
    """Return the distance of each point to its nearest neighbour, one frame per subset.

    Returns
    -------
    distances : dict
        By subset: ascending, in mm.
    shares : DataFrame
        ``cloud`` (a subset, or "all"), number of ``points``, and the share of them with a
        neighbour within each of `WITHIN_MM`; the last row is what the text of Fig. 5.7 says.
    """
    distances = {
        subset.name: k_distances(calibrated_cloud(subset.recording, subset.frames[0]), 2)[::-1]
        for subset in subsets
    }
    every = {**distances, "all": np.concatenate(list(distances.values()))}
    rows = [
        {"cloud": name, "points": len(values)}
        | {f"within_{reach:g}_mm": (values <= reach).mean() for reach in WITHIN_MM}
        for name, values in every.items()
    ]
    printed = {f"within_{reach:g}_mm": share for reach, share in {**PRINTED, **LEAST}.items()}
    rows.append({"cloud": "published, about", "points": 1_000_000} | printed)
    return distances, pd.DataFrame(rows)


def draw_neighbour_distances(distances: dict[str, Array]) -> Figure:
    """Draw the share of points with a neighbour within a distance, a line for each cloud."""
    picture, ((axes,),) = canvas(width_mm=120, height_mm=70)
    for (name, values), line in zip(distances.items(), LINES, strict=False):
        shown = np.unique(np.linspace(0, len(values) - 1, 600).astype(int))
        axes.plot(values[shown], (shown + 1) / len(values), ls=line, label=name)
    least = {**PUBLISHED, "marker": "^", "label": "published, at least"}
    axes.plot(list(PRINTED), list(PRINTED.values()), **PUBLISHED)
    axes.plot(list(LEAST), list(LEAST.values()), **least)
    axes.set(xlim=(0, 6), ylim=(0, 1.02), xlabel="distance to the nearest neighbour (mm)")
    axes.set_ylabel("share of the points")
    axes.legend(loc="lower right")
    return picture
