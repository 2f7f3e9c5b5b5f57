# %% [markdown]
# # In the air or on the wall
#
# **Published** (thesis, sections 3.2 and 5.1.4). MLESAC fits a cylinder to the wall's points
# (radius 772 mm where 700 are nominal, Table 5.12). Distances of particles from its axis form
# two Gaussians that cross near 760 mm (Fig. 3.11); with 800 mm, to keep what flies, particles
# are told apart with F1 0.92 (Table 5.13), detections with 0.88 (Table 5.14).
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
from itertools import product

import numpy as np
import pandas as pd
from scipy.stats import norm

from kilnflight import camera, scores
from kilnflight.detection import DBSCAN, DoG
from kilnflight.detection import wall as cylinder
from kilnflight.detection.combination import Combination
from kilnflight.experiments import detection
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
    cloud = subset.recording.frame(subset.wanted[0])
    points = camera.calibrate_points(cloud.xyz)
    labels = DBSCAN(eps=50.0, min_points=10)(points)
    walls.append(points[labels == np.bincount(labels[labels >= 0]).argmax()])
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

# %% tags=["hide-input"]
picture, (panels,) = style.canvas(1, 2, width_mm=style.PAGE_MM, height_mm=75)
some = walls[0][:: max(1, len(walls[0]) // 8000)]
panels[0].plot(some[:, 0], some[:, 1], ",", color="black")
depth_m = some[:, 2] / 1000
_ = panels[1].plot(depth_m, cylinder.distance_to_axis(some, fit), ",", color="black")

# %% tags=["hide-input"]
around = np.linspace(0, 2 * np.pi, 200)
reach = (some[:, 2].mean() - fit.centre_mm[2]) / fit.direction[2]
middle = np.array(fit.centre_mm) + reach * np.array(fit.direction)
ring = middle[:2, None] + fit.radius_mm * np.array([np.cos(around), np.sin(around)])
panels[0].plot(*ring, "-", color="#D55E00", label=f"fit, {fit.radius_mm:.0f} mm")
panels[0].set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
_ = panels[0].legend(loc="upper right")

# %% tags=["hide-input"]
for level, line, text in (
    (fit.radius_mm, "-", "fit"),
    (700.0, ":", "true"),
    (772.2, "--", "published"),
):
    panels[1].axhline(level, color="#D55E00", ls=line, label=f"{text}, {level:.0f} mm")
panels[1].set(xlabel="z (m)", ylabel="distance from the axis (mm)", ylim=(300, 1100))
panels[1].legend(loc="lower left")
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
best = tried[tried["chosen"]].drop_duplicates("subset").set_index("subset")["threshold"]
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

# %% tags=["hide-input"]
picture, ((axes,),) = style.canvas(width_mm=120, height_mm=65)
bins = np.arange(0, 1201, 25)
shown = np.linspace(0, 1200, 400)
for values, colour, line, name in (
    (air_mm, "#0072B2", "-", "in the air"),
    (wall_mm, "#D55E00", "--", "on the wall"),
):
    axes.hist(values, bins, color=colour, alpha=0.35, density=True, label=name)
    axes.plot(shown, norm.pdf(shown, values.mean(), values.std()), ls=line, color=colour)
for level in thresholds.values():
    axes.axvline(level, color="black", lw=0.8, ls=":")
    axes.annotate(f"{level:.0f}", (level, axes.get_ylim()[1]), fontsize=6, rotation=90, va="top")

# %% tags=["hide-input"]
axes.set(xlabel="distance from the fitted axis (mm)", ylabel="density (1/mm)")
_ = axes.legend(loc="upper left")
caption = (
    "Distance of marked particles with 3D from the kiln's axis, after Fig. 3.11, with Gaussians of "
    "the same mean and standard deviation. Dotted: their crossing, the same plus 40 mm, and 800 mm."
)
saved = everyone[["subset", "frame", "label", "distance_mm"]]
figures.save("fig-3-11-distances", saved, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Told apart
#
# TP is a particle in the air that is told to be there (sections 5.1.4; only what has 3D).

# %%
tables = {"table_5.13": [], "table_5.14": []}
roi = subsets[0].recording.attributes.roi
for (name, level), k in product(thresholds.items(), range(len(subsets))):
    where = {"threshold": name, "threshold_mm": level, "subset": subsets[k].name}
    for which, spots in (("table_5.13", known[k]), ("table_5.14", found[k])):
        row = detection.classify_in_air(known[k], spots, level, roi).iloc[0]
        tables[which].append(where | row[["tp", "fp", "fn"]].astype(int).to_dict())
by_subset = {which: pd.DataFrame(rows) for which, rows in tables.items()}

# %%
totals = {}
for which, rows in by_subset.items():
    both = pd.concat([rows, rows.assign(subset="Total")])
    keys = ["threshold", "threshold_mm", "subset"]
    counts = both.groupby(keys, sort=False)[["tp", "fp", "fn"]].sum().reset_index()
    counts = pd.concat([counts, scores.rates(counts["tp"], counts["fp"], counts["fn"])], axis=1)
    f1 = claims.published(which).set_index("subset")["f1"].rename("f1_published").reset_index()
    totals[which] = counts.merge(f1, how="left")

# %%
caption = (
    "Marked particles with 3D told to be in the air, after Table 5.13, with three thresholds of "
    "the distance from the fitted axis."
)
figures.save("table-5-13-classification", totals["table_5.13"], caption=caption, provenance=origin)

# %%
caption = "Detections of SIFT with DBSCAN told to be in the air, after Table 5.14."
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
