# %% [markdown]
# # In the air or on the wall
#
# **Published** (thesis, sections 3.2 and 5.1.4). MLESAC fits a cylinder to the wall's points
# (radius 772 mm where 700 are nominal, Table 5.12). Distances of particles from its axis form
# two Gaussians that cross near 760 mm (Fig. 3.11); with 800 mm, to keep what flies, particles
# are classified with F1 0.92 (Table 5.13), detections with 0.88 (Table 5.14).
#
# **Here.** The same on the twin, whose axis and radius are known. A threshold in millimetres
# belongs to a radius, and ours comes out smaller than the printed one; so the printed 800 mm
# stand beside the thesis's procedure on our distances: the crossing, raised by 40 mm. That
# procedure decides the claims. The wall is clustered with the burner's flame still in; the fit
# of the first subset serves all.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 0  # of the scenes and of the fit
frames = 0  # labelled frames per subset; 0: 1, 1 or 10 by scale

# %%

import numpy as np
import pandas as pd

from kilnflight.detection import DoG
from kilnflight.detection import wall as cylinder
from kilnflight.detection.combination import Combination
from kilnflight.experiments import detection, detection_methods, detection_pictures
from kilnflight.project import claims, figures, style

# %%
style.use_style()
frames = frames or detection.FRAMES[scale]
origin = figures.trace("25_wall", {"scale": scale, "frames": frames}, seed=seed)
subsets = detection.labelled_subsets(scale, seed, frames)
images = frames * len(subsets)
print(f"{frames} of the ten labelled frames of each of {len(subsets)} subsets")

# %% [markdown]
# ## The cylinder
#
# The wall is the largest cluster of DBSCAN's first pass, with the true axis beside the fit.

# %%
geometry = subsets[0].recording.scene.geometry
fits, walls = [], []
for subset in subsets:
    cloud = subset.recording.frame(subset.frames[0])
    walls.append(detection_methods.wall_points(cloud.xyz))
    fits.append(cylinder.CylinderFit()(walls[-1], seed))
fit = fits[0]
true = cylinder.Cylinder(
    tuple(geometry.origin_mm), tuple(geometry.axes[0]), geometry.kiln_radius_mm
)

# %%
along = [abs(np.dot(one.direction, true.direction)) for one in fits]
off_deg = np.degrees(np.arccos(np.minimum(along, 1.0)))
table = pd.DataFrame(
    {
        "subset": [one.name for one in subsets],
        "radius_mm": [one.radius_mm for one in fits],
        "radius_true_mm": geometry.kiln_radius_mm,
        "radius_published_mm": 772.1827,
        "direction_off_deg": off_deg,
        "inliers": [one.inliers for one in fits],
        "rms_mm": [one.rms_mm for one in fits],
    }
)

# %%
caption = "Cylinder fitted to the wall's points of one frame per subset, after Table 5.12."
figures.save("table-5-12-cylinder", table, caption=caption, provenance=origin)

# %%
some = walls[0][:: max(1, len(walls[0]) // 8000)]
picture = detection_pictures.fitted_wall(some, fit)
caption = (
    "The wall's points and the fitted cylinder, after Fig. 3.10: along the axis, and by depth."
)
points = pd.DataFrame(some, columns=["x_mm", "y_mm", "z_mm"])
figures.save("fig-3-10-cylinder", points, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## How far particles are from the axis
#
# Every marked particle with 3D, by where its points are; detections of SIFT with DBSCAN.

# %%
tried = detection.compare_thresholds(subsets, scale)
best = detection.chosen_thresholds(tried)
known, found = [], []
for subset in subsets:
    both = detection.positions(subset, Combination(DoG(float(best[subset.name]))))
    for table, one in zip((known, found), both, strict=True):
        distance = np.full(len(one), np.nan)
        has = one["z"].notna().to_numpy()
        distance[has] = cylinder.distance_to_axis(one.loc[has, ["x", "y", "z"]], fit)
        table.append(one.assign(distance_mm=distance))

# %%
everyone = pd.concat(known, ignore_index=True).dropna(subset="distance_mm")
on_wall = everyone["label"] == 4
air_mm, wall_mm = everyone["distance_mm"][~on_wall], everyone["distance_mm"][on_wall]
crossing = cylinder.crossing(air_mm, wall_mm)
thresholds = {"crossing_plus_40": crossing + 40.0, "crossing": crossing, "printed_800": 800.0}

# %%
picture = detection_pictures.axis_distances(air_mm, wall_mm, thresholds)
caption = (
    "Distance of marked particles with 3D from the kiln's axis, after Fig. 3.11, with Gaussians of "
    "the same mean and standard deviation. Dotted: their crossing, the same plus 40 mm, and 800 mm."
)
saved = everyone[["subset", "frame", "label", "distance_mm"]]
figures.save("fig-3-11-distances", saved, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Classified
#
# TP is a particle in the air that is classified as there (sections 5.1.4; only what has 3D).

# %%
roi, totals = subsets[0].recording.attributes.roi, {}
for which, spots in (("table_5.13", known), ("table_5.14", found)):
    table = detection.classification_table(known, spots, thresholds, roi)
    f1 = claims.published(which).set_index("subset")["f1"].rename("f1_published").reset_index()
    totals[which] = table.merge(f1, how="left")

# %%
caption = (
    "Marked particles with 3D classified as in the air, after Table 5.13, with three thresholds of "
    "the distance from the fitted axis."
)
figures.save("table-5-13-classification", totals["table_5.13"], caption=caption, provenance=origin)

# %%
caption = "Detections of SIFT with DBSCAN classified as in the air, after Table 5.14."
figures.save("table-5-14-classification", totals["table_5.14"], caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts


# %%
whole = {
    (which, row.threshold): row
    for which, table in totals.items()
    for row in table[table["subset"] == "Total"].itertuples()
}
exact = whole["table_5.13", "crossing_plus_40"]
seen = whole["table_5.14", "crossing_plus_40"]
printed = whole["table_5.13", "printed_800"]

# %%
note = f"crossing + 40 mm = {crossing + 40:.0f} mm; with 800 mm F1 {printed.f1:.3f}"
lower = {f"{seen.f1:.4f} < {exact.f1:.4f}": seen.f1 < exact.f1}
radii = pd.Series(
    {
        s.name: one.radius_mm / geometry.kiln_radius_mm - 1
        for s, one in zip(subsets, fits, strict=True)
    }
)

# %%
verdicts = [
    claims.judge("wall-1", radii, note="one frame of each subset, against the true 700 mm"),
    claims.judge("wall-2", crossing - fit.radius_mm, note=f"crossing {crossing:.0f} mm"),
    claims.judge("wall-3", exact.f1, note=note),
    claims.judge("wall-4", lower | {"at least 0.8": seen.f1 >= 0.8}, note=note),
    claims.judge("wall-5", exact.fn / (exact.tp + exact.fn), note=note),
]

# %%
result = (
    f"{sum(v.verdict == claims.REPRODUCED for v in verdicts)} of 5 claims reproduced. Radius "
    f"{fit.radius_mm:.0f} mm (true 700, published 772); crossing {crossing:.0f} mm (published "
    f"about 760); in the air or not with F1 {exact.f1:.3f} (published 0.921)."
)
figures.conclude(result, verdicts, origin)
