# %% [markdown]
# # Particles in point clouds: DBSCAN, morphology, quasi-cluster centres
#
# **Published** (thesis, sections 2.2.4 to 2.2.6 and 5.1.3). Clustering the cloud alone finds
# nearly all that burns in the air, but many clusters are no particle: the best F1 is about 0.6
# for all three methods (Tables 5.8 to 5.10), far below the pictures' 0.85.
#
# **Here.** The same parameters on the twin's clouds, without the flame, depth after Eq. 2.4.
# A cluster is a detection at the centre of its pixels. What an in-air particle's points look
# like was put in by published statistics; how wall points scatter follows Fig. 5.7 only.
#
# The morphological method is printed without a stopping rule that can be run: dilating until
# the number of domains stays the same leaves a handful of clusters. One dilation, small domains
# dropped before, was chosen when the numbers of clusters of two frames lay beside Table 5.9, so
# those numbers are no result. A look at two frames afterwards gave F1 between 0.02 and 0.20 for
# other readings at R = 150: the outcome hangs on a rule that is not printed. Where quasi-cluster
# centres share a point, it goes to the cluster of its exemplar, its densest neighbour; the wall
# pass takes the printed 10 points in 50 mm although 15 in 70 mm is more precise in Table 5.8.

# %% tags=["parameters"]
scale = "standard"  # quick (one subset), standard or full
seed = 0  # of the scenes
frames = 0  # labelled frames per subset; 0: 1, 1 or 10 by scale

# %%
import numpy as np
import pandas as pd

from kilnflight.project import claims, figures, style

style.use_style()

# %%
from kilnflight import camera
from kilnflight import detection as detectors
from kilnflight.experiments import detection, detection_methods, detection_pictures
from kilnflight.twin import truth

frames = frames or detection.FRAMES[scale]
origin = figures.trace("22_clouds", {"scale": scale, "frames": frames}, seed=seed)
subsets = detection.labelled_subsets(scale, seed, frames)
subsets = subsets[:1] if scale == "quick" else subsets
names = {"dbscan": "table_5.8", "mo": "table_5.9", "qcc": "table_5.10"}
printed = {name: claims.published(table) for name, table in names.items()}
images = frames * len(subsets)
print(f"{frames} of the ten labelled frames of each of {len(subsets)} subsets")

# %% [markdown]
# ## The sorted k-distance graph
#
# How far each point's neighbours are; the knee suggests eps (Fig. 2.19).

# %%
cloud = camera.calibrate_points(subsets[0].recording.frame(subsets[0].frames[0]).xyz)
counts = (6, 10, 15)  # minPts of Table 5.8
sorted_mm = {k: detectors.k_distances(cloud, k) for k in counts}
some = np.unique(np.geomspace(1, len(cloud), 300).astype(int)) - 1
curves = pd.DataFrame({f"distance_{k}_mm": line[some] for k, line in sorted_mm.items()})
curves.insert(0, "point", some + 1)

# %%
picture = detection_pictures.k_distances(curves, (10, 15, 30, 50, 70))
caption = "Sorted k-distance graph of one frame, after Fig. 2.19; grey: the eps of Table 5.8."
figures.save("fig-2-19-k-distance", curves, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## All published parameters

# %%
clusterers = {}
for one in printed["dbscan"].itertuples():
    clusterers["dbscan", one.Index] = detectors.DBSCAN(one.epsilon_mm, one.minPts)
for one in printed["mo"].itertuples():
    clusterers["mo", one.Index] = detectors.MorphologicalClustering(one.R)
for one in printed["qcc"].itertuples():
    clusterers["qcc", one.Index] = detectors.QuasiClusterCenters(one.K, one.alpha)
methods = {key: detection_methods.from_cloud(one) for key, one in clusterers.items()}
attempts = detection.run(subsets, methods)
attempts["family"] = attempts["method"].str[0]
attempts["row"] = attempts["method"].str[1]

# %%
parameters = {"dbscan": ["minPts", "epsilon_mm"], "mo": ["R"], "qcc": ["K", "alpha"]}
whole = detection.sum_counts(attempts.assign(subset="Total"), ["family", "row", "subset"])
apart = detection.sum_counts(attempts, ["family", "row", "subset"])
tables, totals = {}, {}
for name, columns in parameters.items():
    one = pd.concat([apart, whole])[lambda t, name=name: t["family"] == name]
    one = one.merge(printed[name][columns], left_on="row", right_index=True)
    one = one.merge(printed[name]["f1"].rename("f1_published"), left_on="row", right_index=True)
    one.loc[one["subset"] != "Total", "f1_published"] = np.nan
    tables[name] = one.drop(columns=["family", "row"]).reset_index(drop=True)
    totals[name] = one[one["subset"] == "Total"].set_index("row").sort_index()
order = ["subset", "tp", "fp", "fn", "precision", "recall", "f1", "seconds_per_image"]
order += ["f1_in_pixels", "f1_published"]

# %%
caption = f"DBSCAN on {images} frames, by subset and in total, with the parameters of Table 5.8."
table = tables["dbscan"][["minPts", "epsilon_mm", *order]]
figures.save("table-5-8-dbscan", table, caption=caption, provenance=origin)

# %%
caption = f"Morphological clustering on {images} frames, with the grids of Table 5.9."
table = tables["mo"][["R", *order]]
figures.save("table-5-9-mo", table, caption=caption, provenance=origin)

# %%
caption = f"Quasi-cluster centres on {images} frames, with the parameters of Table 5.10."
table = tables["qcc"][["K", "alpha", *order]]
figures.save("table-5-10-qcc", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Precision against recall, ours and published

# %%
picture = detection_pictures.precision_recall(totals, printed, parameters)
swept = pd.concat(totals.values()).reset_index()
asked = [name for names in parameters.values() for name in names]
swept = swept[["family", *asked, "precision", "recall", "f1", "f1_published"]]
caption = (
    "Precision and recall of the three clusterers over their parameters, beside the tables'. "
    "Numbers: values of the last parameter; lines join what differs in the first only."
)
figures.save("fig-5-8-parameters", swept, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## How the end of MO is read
#
# Section 5.1.3 dilates until the number of domains "remains unchanged"; of hundreds of domains
# some always merge, and the wall takes them all. This work dilates once, the least that the
# method has. Its other parameter as in the best row of Table 5.9.

# %%
ends = {"none": 0, "once (this work)": 1, "twice": 2, "until unchanged": None}
by_end = {name: detectors.MorphologicalClustering(150, n) for name, n in ends.items()}
read = detection.run(
    subsets, {name: detection_methods.from_cloud(one) for name, one in by_end.items()}
)
readings = detection.sum_counts(read, ["method"]).rename(columns={"method": "dilations"})
readings = readings.assign(f1_published=printed["mo"].set_index("R")["f1"][150])
caption = f"Morphological clustering, R = 150, dilated as often as told; {images} frames."
figures.save("mo-readings", readings, caption=caption, provenance=origin)

# %% [markdown]
# ## Which particles are found
#
# With the parameters that the thesis analyses: DBSCAN 10, 50 mm; MO 150; QCC 30, 0.1.

# %%
analysed = {"dbscan": 5, "mo": 1, "qcc": 2}
picked = attempts[attempts["row"] == attempts["family"].map(analysed)]
recall = detection.class_recall(picked, ["family", "subset"])
recall = recall.assign(kind=recall["label"].map(truth.CLASSES))
by_class = recall.pivot(index=["family", "subset"], columns="label", values="recall")

# %%
picture = detection_pictures.class_recall(recall, "family")
caption = "Recall of each class by the three clusterers, after Figs 5.8 to 5.10."
figures.save("fig-5-8-recall", recall, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts

# %%
dbscan = totals["dbscan"].set_index(["minPts", "epsilon_mm"])
mo = totals["mo"].set_index("R")
qcc = totals["qcc"].set_index(["K", "alpha"])
note = f"{images} frames, gate 45 px"
falling, rising = {}, {}
for points, one in dbscan.groupby(level="minPts"):
    falling[f"minPts {points}: FP falls"] = bool(one["fp"].is_monotonic_decreasing)
    rising[f"minPts {points}: FN rises"] = bool(one["fn"].is_monotonic_increasing)

# %%
of_eps = dbscan["f1"].groupby(level="minPts").agg(np.ptp).mean()
of_points = dbscan["f1"].groupby(level="epsilon_mm").agg(np.ptp)[[30, 50, 70]].mean()
seconds = dbscan["seconds_per_image"]
grows = {name: bool(mo[name].is_monotonic_increasing) for name in ("tp", "fp", "seconds_per_image")}
k_down = {
    f"alpha {a}: FP falls with K": bool(one["fp"].is_monotonic_decreasing)
    for a, one in qcc.groupby(level="alpha")
}

# %%
alpha_up = {}
for k in (20, 25, 30):
    low, high = qcc.loc[(k, 0.1)], qcc.loc[(k, 0.2)]
    alpha_up[f"K {k}: recall up with alpha"] = bool(high["recall"] > low["recall"])
    alpha_up[f"K {k}: precision down"] = bool(high["precision"] < low["precision"])
best = {name: one["f1"].max() for name, one in totals.items()}
pooled = detection.class_recall(picked, ["family"]).pivot(
    index="family", columns="label", values="recall"
)

# %%
half = by_class.loc["dbscan", 4].filter(["V1", "V4"])
most = {
    f"{truth.CLASSES[k]}: {pooled[k].round(2).to_dict()}": pooled[k].idxmax() == "qcc"
    for k in (3, 4)
}

# %%
verdicts = [
    claims.judge("cluster-1", falling | rising, note=note),
    claims.judge("cluster-2", of_eps / of_points, note=f"{note}; mean range of F1"),
    claims.judge("cluster-3", seconds[(6, 50)] / seconds[(6, 10)], note="minPts 6, median time"),
    claims.judge("cluster-4", grows, note=note),
    claims.judge("cluster-5", k_down | alpha_up, note=note),
    claims.judge("cluster-7", pooled[2], note=f"{note}; all subsets"),
    claims.judge("cluster-8", half, note=note),
    claims.judge("cluster-9", most, note=note),
]

# %%
result = (
    f"{sum(v.verdict == claims.REPRODUCED for v in verdicts)} of 8 claims reproduced. Best F1: "
    + ", ".join(f"{name} {value:.3f}" for name, value in best.items())
    + " (published 0.616, 0.601, 0.600)."
)
figures.conclude(result, verdicts, origin)
