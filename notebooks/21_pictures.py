# %% [markdown]
# # Detection in pictures: Otsu and SIFT
#
# **Published** (thesis, sections 2.2.2, 2.2.3 and 5.1.3). On 50 labelled frames, after the median
# background, Otsu's threshold finds nearly all that burns and little that does not (F1 0.8436,
# Table 5.5). SIFT finds about half of what does not burn (0.8749, Table 5.6). The higher its
# threshold, the faster it is (Table 5.7).
#
# **Here.** The same on the twin. The picture's few free inputs (exposure, soot, light on particles,
# flicker) were fitted to Otsu's row, within bounds of physics. Where it agrees is no result. Within
# those bounds the fit misses the row (notebook 13), and what follows here starts from that. SIFT's
# threshold is found on four subsets and used on the
# fifth; the published 450 to 550 belong to an exposure that nobody printed.
#
# Whether the difference from the median is absolute or stops at zero is open (notebook 20). Both
# readings stand in every table. The picture was fitted with absolute differences.

# %% tags=["parameters"]
scale = "standard"  # quick (two subsets), standard or full
seed = 0  # of the scenes
frames = 0  # labelled frames per subset; 0: 1, 1 or 10 by scale

# %%
import pandas as pd

from kilnflight.experiments import (
    detection,
    detection_claims,
    detection_pictures,
    detection_tables,
)
from kilnflight.project import claims, figures, style

style.use_style()
frames = frames or detection.FRAMES[scale]
setting = {"scale": scale, "frames": frames}
origin = figures.trace("21_pictures", setting, seed=seed)
subsets = detection.labelled_subsets(scale, seed, frames)
print(f"Labelled frames used: {frames} of ten in each of {len(subsets)} subsets.")

# %% [markdown]
# ## Both detectors
#
# DoG is called once for each frame and answers for all thresholds. What a single threshold
# costs is timed on every fifth of the frames.

# %%
attempts = detection.compare_pictures(subsets, scale)
times = detection.time_thresholds(subsets, scale)
otsu = attempts[attempts["method"] == "Otsu"]
sift = detection_tables.chosen_sift(attempts, times)

# %%
# the same with differences that stop at zero; single thresholds are timed once only
cut = detection.compare_pictures(detection.stopping_at_zero(subsets), scale)
cut = cut[(cut["method"] == "Otsu") | (cut["chosen"] & (cut["method"] == "SIFT"))]
cut = cut.assign(seconds=cut["seconds"].where(cut["method"] == "Otsu"))
absolute, stops = detection_tables.ABSOLUTE, detection_tables.STOPS
both = pd.concat([otsu, sift]).assign(reading=absolute)
both = pd.concat([both, cut.assign(reading=stops)], ignore_index=True)

# %%
of_otsu = detection_tables.with_total(both[both["method"] == "Otsu"], ["subset", "reading"])
caption = (
    f"Otsu's method by subset, after Table 5.5; {frames} labelled frames of each within the "
    "region of interest, scoring distance 45 px. Reading: of the difference from the median."
)
table = detection_tables.reading_last(detection_tables.beside_published(of_otsu, "table_5.5"))
figures.save("table-5-5-otsu", table, caption=caption, provenance=origin)

# %%
of_sift = both[both["method"] == "SIFT"]
of_sift = detection_tables.with_total(of_sift, ["threshold", "subset", "reading"])
caption = (
    f"SIFT by subset, after Table 5.6; {frames} labelled frames of each within the region of "
    "interest, scoring distance 45 px. Threshold of DoG in grey values found on the other four "
    "subsets. Reading: of the difference from the median."
)
table = detection_tables.reading_last(detection_tables.beside_published(of_sift, "table_5.6"))
figures.save("table-5-6-sift", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Which particles are detected
#
# Recall of each class; for Otsu the values that section 5.1.3 states (about 1, 0.9, and as
# drawn for non-burning ones). Bars: this work; diamonds: published.

# %%
panels = both["method"].where(both["reading"] == absolute, both["method"] + ", " + both["reading"])
recall = detection_tables.class_recall(both.assign(method=panels), ["method", "subset"])
unlit = {"V1": 0.16, "V2": 0.16, "V3": 0.16, "V4": 0.0, "V5": 0.35}  # section 5.1.3
printed = [unlit[subset.name] for subset in subsets]
picture = detection_pictures.draw_class_recall(recall, "method", printed)
caption = (
    "Simulated recall of each class by Otsu's method and by SIFT, after Figs 5.5 and 5.6. With "
    "absolute differences, and with differences that stop at zero. No bar: fewer than "
    "ten sightings."
)
figures.save("fig-5-5-recall", recall, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## What eight bits would lose, and what a threshold costs
#
# OpenCV's SIFT takes 8 bits, ours all 16. Our one table that is not in the thesis shows that this
# explains no difference to it. It has the same foregrounds rounded to 256 levels, with the same
# thresholds.

# %%
depths = attempts[attempts["chosen"]]
depths = depths.assign(bit_depth=depths["method"].replace("SIFT", "16 bits"))
table = detection_tables.sum_with_unlit(depths, ["bit_depth"])
caption = "SIFT on foregrounds of 16 and of 8 bits, with the thresholds chosen for 16."
figures.save("dog-eight-bits", table, caption=caption, provenance=origin)

# %%
time_table = detection_tables.time_table(times)
caption = "Time of SIFT for one frame against its threshold, after Table 5.7 (MATLAB), and ours."
figures.save("table-5-7-sift-time", time_table, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts

# %%
note = f"{frames * len(subsets)} frames, scoring distance 45 px"
verdicts = detection_claims.picture_verdicts(pd.concat([otsu, sift]), time_table, seed, note)
others = detection_claims.picture_verdicts(cut, time_table.iloc[:0], seed, note)
verdicts = detection_claims.beside(verdicts, others, *detection_claims.DIFFERENCES)
reproduced = claims.count_reproduced(verdicts)
total = both.assign(name=panels.to_numpy())
total = detection.sum_counts(total, ["name"]).set_index("name")["f1"]
result = (
    f"{reproduced} of 8 claims reproduced; what agrees with what was fitted is not counted. F1 of "
    f"Otsu {total['Otsu']:.3f} (published 0.844), of SIFT {total['SIFT']:.3f} (0.875); with "
    f"differences that stop at zero {total[f'Otsu, {stops}']:.3f} and "
    f"{total[f'SIFT, {stops}']:.3f}."
)
figures.conclude(result, verdicts, origin)
