# %% [markdown]
# # The wall: particles in the air or on it
#
# **Published** (thesis, sections 3.2 and 5.1.4). MLESAC fits a cylinder to the wall's points
# (radius 772 mm where 700 are nominal, Table 5.12). Distances of particles from its axis form two
# Gaussians that cross near 760 mm (Fig. 3.11). With 800 mm, to keep what flies, particles are
# classified with F1 0.92 (Table 5.13), detections with 0.88 (Table 5.14).
#
# **Here.** The same on the twin, whose axis and radius are known. Printed radius, crossing and the
# share of what flies beyond 800 mm were used to place the camera (notebook 15): agreement with
# these three validates nothing. A threshold in millimetres belongs to a radius. So the printed 800
# mm stand beside the thesis's procedure on our distances: the crossing, raised by 40 mm. That
# procedure decides the claims. The wall is clustered with the burner's flame still in; the fit of
# the first subset serves all. Detections are paired with particles within 45 px; Table 5.14 is
# also there with 45 px as a diameter (notebook 22), and wall-4 says what that would give.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 0  # of the scenes and of the fit
frames = 0  # labelled frames per subset; 0: 1, 1 or 10 by scale

# %%
import pandas as pd

from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination
from kilnflight.experiments import detection, detection_claims, detection_pictures, detection_tables
from kilnflight.project import claims, figures, style
from kilnflight.scores.detections import NEAR_GATE_PX

# %%
style.use_style()
frames = frames or detection.FRAMES[scale]
origin = figures.trace("25_wall", {"scale": scale, "frames": frames}, seed=seed)
subsets = detection.labelled_subsets(scale, seed, frames)
print(f"Labelled frames used: {frames} of ten in each of {len(subsets)} subsets.")

# %% [markdown]
# ## The cylinder
#
# The wall is the largest cluster of DBSCAN's first pass, with the true axis beside the fit. Few
# points lie midway along the kiln, so that its floor near the camera and its far wall are two
# clusters. Where the floor is the larger one, it covers a small arc.

# %%
walls = {
    subset.name: detection.wall_points(subset.recording, subset.frames[0]) for subset in subsets
}
fits = detection_tables.fitted_walls(walls, seed)
fit, wall = fits[subsets[0].name], walls[subsets[0].name]
cylinders = detection_tables.cylinder_table(fits, subsets[0].recording.scene.geometry)
caption = (
    "Cylinder fitted to the wall's points of one frame per subset, after Table 5.12. Empty: the "
    "largest cluster is a flat strip of the floor near the camera, and holds no cylinder."
)
figures.save("table-5-12-cylinder", cylinders, caption=caption, provenance=origin)

# %%
points = wall[:: max(1, len(wall) // 8000)]
picture = detection_pictures.draw_fitted_wall(points, fit)
caption = (
    "The simulated wall and the fitted cylinder, after Fig. 3.10: along the axis, and by depth."
)
table = pd.DataFrame(points, columns=["x_mm", "y_mm", "z_mm"])
figures.save("fig-3-10-cylinder", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## How far particles are from the axis
#
# Every marked particle with 3D, by where its points are; detections of SIFT with DBSCAN. The
# thesis fits a radius of 772 mm to a kiln of 700 mm. Notebook 15 takes that for a scale of the
# thesis's lengths. The twin's own camera is calibrated to true lengths.

# %%
best = detection.chosen_thresholds(detection.compare_thresholds(subsets, scale))
detectors = {name: Combination(DoG(float(threshold))) for name, threshold in best.items()}
marked, detected = detection.positions(subsets, detectors, fit)
placed = marked.dropna(subset="distance_mm")
thresholds = detection_tables.axis_thresholds(placed)

# %%
drawn = {name: level for name, level in thresholds.items() if name != "all_in_air"}
picture = detection_pictures.draw_axis_distances(placed, drawn)
caption = (
    "Distance of simulated particles with 3D from the kiln's axis, after Fig. 3.11, with Gaussians "
    "of the same mean and standard deviation. Dotted: their crossing, plus 40 mm, and 800 mm."
)
table = placed[["subset", "frame", "label", "distance_mm"]]
figures.save("fig-3-11-distances", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Classified
#
# TP is a particle in the air that is classified as there (section 5.1.4; only what has 3D).

# %%
roi = subsets[0].recording.attributes.roi
exact, measured = (
    detection_tables.classification_table(marked, spots, thresholds, roi)
    for spots in (marked, detected)
)

# %%
table = detection_tables.beside_published(exact, "table_5.13")
caption = (
    "Marked particles with 3D classified as in the air, after Table 5.13, with three thresholds of "
    "the distance from the fitted axis, and with all called airborne (all in air)."
)
figures.save("table-5-13-classification", table, caption=caption, provenance=origin)

# %%
table = detection_tables.beside_published(measured, "table_5.14")
near = detection_tables.classification_table(marked, detected, thresholds, roi, NEAR_GATE_PX)
table = table.assign(f1_diameter_45_px=near["f1"])
caption = (
    "Detections of SIFT with DBSCAN classified as in the air, after Table 5.14, scoring distance "
    "45 px; F1 also with 45 px as a diameter."
)
figures.save("table-5-14-classification", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts

# %%
crossing = thresholds["crossing"]
verdicts = detection_claims.wall_verdicts(cylinders, crossing, exact, measured)
others = detection_claims.wall_verdicts(cylinders, crossing, exact, near)
others = [verdict for verdict in others if verdict.id == "wall-4"]
verdicts = detection_claims.beside(verdicts, others, *detection_claims.DISTANCES)
reproduced = claims.count_reproduced(verdicts)
total = exact.set_index(["subset", "threshold"])["f1"]["Total"]
result = (
    f"{reproduced} of 5 claims reproduced; what agrees with what was fitted is not counted. Radius "
    f"{fit.radius_mm:.0f} mm (true 700, published 772); crossing {crossing:.0f} mm (published "
    "about 760); in the air or not with F1 "
    f"{total['crossing_plus_40']:.3f} (published 0.921), with all called airborne "
    f"{total['all_in_air']:.3f}."
)
figures.conclude(result, verdicts, origin)
