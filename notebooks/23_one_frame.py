# %% [markdown]
# # The combined detector in one frame
#
# **Published** (thesis, section 3.1). Keypoints of a picture and clusters of a cloud are held
# against each other. Local grey-value peaks and the difference to the frame before decide five
# cases (Figs 3.1 to 3.9).
#
# **Here.** The same steps on one frame of the twin, with pictures, and what the truth says about
# each case. Three rules are not in the thesis. A peak stands out from the noise of the frame by
# five times. Several keypoints with several clusters are decided as case 2. A cluster wider than
# 90 px is a remainder of the wall.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full: frames of the table at the end
seed = 0  # of the scene
frames = 0  # labelled frames per subset for that table; 0: 1, 1 or 10 by scale

# %%
import numpy as np
import pandas as pd

from kilnflight import camera
from kilnflight.detection import DoG, combination
from kilnflight.detection.combination import potential_particles, summarise
from kilnflight.detection.flame import segment_flame
from kilnflight.detection.peaks import Evidence
from kilnflight.experiments import detection, detection_pictures, detection_tables
from kilnflight.project import figures, style

# %%
style.use_style()
frames = frames or detection.FRAMES[scale]
origin = figures.trace("23_one_frame", {"scale": scale, "frames": frames}, seed=seed)
subsets = detection.labelled_subsets(scale, seed, frames)

# %%
subset = {subset.name: subset for subset in subsets}["V4"]  # the most particles
known = subset.recording.attributes
t, view = next(detection.subset_views(subset))
# each subset takes what is best on the others
threshold = detection.chosen_thresholds(detection.compare_thresholds(subsets, scale)).astype(float)

# %% [markdown]
# ## The flame is taken out
#
# Otsu's threshold in the burner's rectangle (Fig. 3.4).

# %%
flame = segment_flame(view.gray, known.flame_roi)
picture = detection_pictures.draw_flame(view.gray, flame.mask, known.flame_roi)
size = pd.DataFrame({"frame": [t], "flame_px": [int(flame.mask.sum())], "of_px": [flame.mask.size]})
caption = "The simulated flame segmented by Otsu's threshold in a rectangle, after Fig. 3.4."
figures.save("fig-3-4-flame", size, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Keypoints and clusters
#
# The wall is the largest cluster of the first pass; the second pass gives what may be particles.

# %%
labels = combination.second_pass(view.xyz, *detection.PASSES["DBSCAN"])
keypoints = DoG(threshold[subset.name])(view.foreground)
keypoints = keypoints[camera.inside(known.roi, keypoints[:, 0], keypoints[:, 1])]
clusters = summarise(view.pixels, view.xyz, labels)
clusters = clusters.take(clusters.extent <= combination.Combination().largest_px)
clusters = clusters.take(camera.inside(known.roi, *clusters.centers.T))
cases = list(potential_particles(keypoints, clusters, view.gray.shape))
print(f"{len(keypoints)} keypoints, {len(clusters)} clusters: {len(cases)} potential particles")

# %%
size = {"width_mm": style.PAGE_MM, "height_mm": 135}
picture = detection_pictures.draw_keypoints_and_clusters(
    view.gray, keypoints, clusters, known.roi, **size
)
table = pd.DataFrame(keypoints, columns=["row", "col", "radius_px"])
caption = (
    "Keypoints of SIFT (circles) and clusters of DBSCAN (dots, one colour each) in a simulated "
    "frame, with the region of interest. After Figs 3.1 and 3.2."
)
figures.save("fig-3-2-both", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## The five cases
#
# Up to three examples of each. Circles: keypoints; dots: points of clusters; crosses: what
# the detector decides. No cross: nothing.

# %%
rule = combination.Combination()
evidence = Evidence.of(view.gray, view.previous, rule.prominence, rule.share)
examples = {case: [] for case in range(1, 6)}
for case, spots, groups in cases:
    parts = (keypoints[spots], clusters.take(groups))
    particles = combination.decide_case(case, *parts, evidence, rule.margin_px)
    examples[case].append((*parts, particles))
picture = detection_pictures.draw_cases(view.gray, examples)

# %%
counts = pd.DataFrame(
    [
        {"case": case, "potential": len(rows), "particles": sum(len(row[2]) for row in rows)}
        for case, rows in examples.items()
    ]
)
caption = "Examples of the five cases in one simulated frame, after Figs 3.5 to 3.9; see the text."
figures.save("fig-3-5-cases", counts, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# **Questions to the grey values.** Case 2 counts peaks in the cluster's rectangle. Cases 4 and 5
# look at the frame and at its difference to the frame before (Figs 3.7 to 3.9).

# %%
several = max(examples[2], key=lambda row: len(row[2]))[1]
alone = max(examples[4], key=lambda row: (len(row[2]), -row[1].total))[1]
change = np.abs(view.gray.astype(float) - view.previous)
peaks = evidence.peaks(combination.widened(several.rectangle(), rule.margin_px))
first, second = (combination.widened(cluster.rectangle(), 3) for cluster in (several, alone))
images = {"case 2: peaks": (view.gray, first), "case 4: frame": (view.gray, second)}
images["case 4: difference"] = (change, second)
picture = detection_pictures.draw_cuts(images, peaks)
table = pd.DataFrame(peaks[:, :2], columns=["row", "col"])
caption = (
    "Peaks counted in a cluster's rectangle (crosses); a cluster alone, in the frame and in its "
    "difference to the frame before. After Figs 3.7 to 3.9."
)
figures.save("fig-3-7-evidence", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## How often each case is right
#
# All subsets, each with its threshold. A detection is right if it is paired with a marked
# particle. The thesis does not count this; our table shows which case errs.

# %%
detectors = {name: combination.Combination(DoG(value)) for name, value in threshold.items()}
marked, detected = detection.positions(subsets, detectors)
by_case = detection_tables.precision_by_case(marked, detected, known.roi)

# %%
caption = (
    f"Detections of SIFT with DBSCAN by their case, {frames * len(subsets)} labelled frames: "
    "how many are paired with a marked particle."
)
figures.save("detection-cases", by_case, caption=caption, provenance=origin)

# %%
parts = [f"case {row.case} {row.precision:.0%} of {row.detections}" for row in by_case.itertuples()]
result = "Right by case: " + ", ".join(parts) + ". No claim is tested here."
figures.conclude(result, [], origin)
