# %% [markdown]
# # Detection in point clouds: DBSCAN, morphology, quasi-cluster centres
#
# **Published** (thesis, sections 2.2.4 to 2.2.6 and 5.1.3). Clustering the cloud alone finds
# nearly all that burns in the air, but many clusters are no particle. The best F1 is about 0.6
# for all three methods (Tables 5.8 to 5.10), far below the pictures' 0.85.
#
# **Here.** The same parameters on the twin's clouds, without the flame, depth after Eq. 2.4.
# A cluster is a detection at the centre of its pixels. Which points there are, and how they
# scatter, was fitted to published statistics (Fig. 5.7, Table 5.2, the plate), never to a result
# of clustering. Their number is met; more points than printed have a neighbour nearer than 1 mm
# (notebook 10).
#
# The morphological method is read as section 5.1.3 tells what was run: grid, dilation, labels,
# nearest domain. The rule of sizes in section 2.2.5 (Eq. 2.35) is not named there and is off.
# The number of dilations is not printed; one, the least, is taken. Both readings of both stand
# side by side below.
#
# Section 3.3 calls the 45 px of the scoring distance a diameter: 2 x 15 px, enlarged 1.5 times.
# Eq. 3.4 compares them with a distance. Every table has F1 in both readings; the counts and the
# verdicts are those of Eq. 3.4, and each verdict says what the other would give.
#
# Where quasi-cluster centres share a point, it goes to the cluster of its exemplar, its densest
# neighbour. The wall pass takes the printed 10 points in 50 mm although 15 in 70 mm is more
# precise in Table 5.8. Times are of our own programs; no claim hangs on them.

# %% tags=["parameters"]
scale = "standard"  # quick (one subset), standard or full
seed = 0  # of the scenes
frames = 0  # labelled frames per subset; 0: 1, 1 or 10 by scale

# %%
from kilnflight import detection as detectors
from kilnflight.experiments import (
    cloud_pictures,
    detection,
    detection_claims,
    detection_pictures,
    detection_tables,
)
from kilnflight.project import claims, figures, style
from kilnflight.recording.frames import calibrated_cloud

# %%
style.use_style()
frames = frames or detection.FRAMES[scale]
origin = figures.trace("22_clouds", {"scale": scale, "frames": frames}, seed=seed)
subsets = detection.labelled_subsets(scale, seed, frames)
subsets = subsets[:1] if scale == "quick" else subsets
images = frames * len(subsets)
print(f"Labelled frames used: {frames} of ten in each of {len(subsets)} subsets.")

# %% [markdown]
# ## A cloud in space
#
# What the camera delivers (Fig. 2.12): a tube of points, the kiln, and the particles in it. Only
# some pixels have a depth. See how few points a single particle has, and how far they spread in
# depth.

# %%
cloud = cloud_pictures.particle_cloud(subsets[0], subsets[0].frames[0])
picture, marked = cloud_pictures.draw_cloud(cloud, seed)
known = subsets[0].recording.attributes
caption = (
    f"Point cloud of the kiln (grey) and of particles (blue), after Fig. 2.12; simulated, subset "
    f"{subsets[0].name}: {len(cloud):,} points of {known.rows * known.columns:,} pixels. Circle, "
    f"and right: the particle with the most points, {len(marked)}."
)
figures.save("fig-2-12-cloud", marked, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## How near the points lie
#
# Fig. 5.7: the distance of each point to its nearest neighbour, a frame from each subset. In the
# text a third is nearer than 1 mm, another third nearer than 2 mm, and nine in ten nearer than 4.

# %%
distances, table = cloud_pictures.neighbour_distances(subsets)
picture = cloud_pictures.draw_neighbour_distances(distances)
caption = (
    f"Share of points whose nearest neighbour is within a distance, {len(distances)} simulated "
    "clouds, beside what the text says of Fig. 5.7."
)
figures.save("fig-5-7-neighbours", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## The sorted k-distance graph
#
# How far each point's neighbours are; the knee suggests eps (Fig. 2.19).

# %%
cloud = calibrated_cloud(subsets[0].recording, subsets[0].frames[0])
picture, curves = detection_pictures.draw_k_distances(cloud)
caption = (
    "Sorted k-distance graph of one simulated frame, after Fig. 2.19; grey: the eps of Table 5.8."
)
figures.save("fig-2-19-k-distance", curves, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## All published parameters

# %%
attempts = detection.compare_clusterers(subsets)
tables = {family: detection_tables.cluster_table(attempts, family) for family in detection.TABLES}

# %%
scored = (
    f"on {images} frames, by subset and in total. Scoring distance 45 px, F1 also with a diameter"
)
caption = f"DBSCAN with the parameters of Table 5.8 {scored} of 45 px."
figures.save("table-5-8-dbscan", tables["dbscan"], caption=caption, provenance=origin)

# %%
caption = f"Morphological clustering with the grids of Table 5.9 {scored} of 45 px."
figures.save("table-5-9-mo", tables["mo"], caption=caption, provenance=origin)

# %%
caption = (
    f"Quasi-cluster centres with the parameters of Table 5.10 {scored} of 45 px. Seconds: with the "
    "search of neighbours, one for all rows, as many as the largest K asks for."
)
figures.save("table-5-10-qcc", tables["qcc"], caption=caption, provenance=origin)

# %% [markdown]
# scikit-learn's DBSCAN with the same parameters gives the same labels; ours is there for speed.

# %%
cloud = cloud[:: 4 if scale == "quick" else 1]
ours, peer = detectors.DBSCAN()(cloud), detectors.ScikitDBSCAN()(cloud)
same = f"{(ours == peer).mean():.2%} of scikit-learn's labels are the same"
print(f"{len(cloud)} points, {ours.max() + 1} clusters; {same}")

# %% [markdown]
# ## Precision against recall, ours and published
#
# The thesis prints these numbers in three tables. Our picture of them shows at a glance how far
# every setting is from its published place.

# %%
totals = detection_tables.cluster_totals(tables)
picture, table = detection_pictures.draw_precision_recall(totals)
caption = (
    "Precision and recall of the three clusterers over their parameters, beside those of Tables "
    "5.8 to 5.10; scoring distance 45 px. Some settings are numbered, the table has them all."
)
figures.save("cluster-parameters", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Two readings of MO
#
# Section 5.1.3 dilates until the number of domains "remains unchanged"; of hundreds of domains
# some always merge, and the wall takes them all. Section 2.2.5 drops small domains (Eq. 2.35),
# 5.1.3 does not. Our table has all combinations, with R of the best row of Table 5.9, and F1 in
# both readings of the 45 px.

# %%
readings = detection.morphology_readings(subsets)
caption = f"Morphological clustering with R = 150 in other readings, on {images} frames."
figures.save("mo-readings", readings, caption=caption, provenance=origin)

# %% [markdown]
# ## Which particles are detected
#
# With the parameters that the thesis analyses: DBSCAN 10, 50 mm; MO 150; QCC 30, 0.1.

# %%
recall = detection_tables.analysed_recall(attempts, ["family", "subset"])
picture = detection_pictures.draw_class_recall(recall, "family")
caption = (
    "Simulated recall of each class by the three clusterers, after Figs 5.8 to 5.10. No bar: fewer "
    "than ten sightings."
)
figures.save("fig-5-8-recall", recall, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts

# %%
note = f"{images} frames, scoring distance 45 px"
verdicts = detection_claims.cluster_verdicts(attempts, note)
others = detection_claims.cluster_verdicts(detection_tables.as_diameter(attempts), note)
verdicts = detection_claims.beside(verdicts, others, *detection_claims.DISTANCES)
best = ", ".join(f"{name} {table['f1'].max():.3f}" for name, table in totals.items())
reproduced = claims.count_reproduced(verdicts)
printed = "published 0.616, 0.601, 0.621; the last by its printed counts 0.600"
result = f"{reproduced} of 8 claims reproduced. Best F1: {best} ({printed})."
figures.conclude(result, verdicts, origin)
