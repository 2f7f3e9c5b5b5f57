# %% [markdown]
# # Particles in pictures: Otsu and SIFT
#
# **Published** (thesis, sections 2.2.2, 2.2.3 and 5.1.3). On 50 labelled frames, after the median
# background, Otsu's threshold finds nearly all that burns and little that does not (F1 0.8436,
# Table 5.5). SIFT finds about half of what does not burn (0.8749, Table 5.6). The higher its
# threshold, the faster it is (Table 5.7).
#
# **Here.** The same on the twin. Otsu's row is what the picture's few free inputs (exposure,
# contrast, flicker) were fitted to, on two frames of each subset. So its agreement is no result;
# everything else is a prediction. SIFT's threshold is found on four subsets and used on the
# fifth; the published 450 to 550 belong to an exposure that nobody printed.

# %% tags=["parameters"]
scale = "standard"  # quick (two subsets), standard or full
seed = 0  # of the scenes
frames = 0  # labelled frames per subset; 0: 1, 1 or 10 by scale

# %%
import pandas as pd

from kilnflight.experiments import detection, detection_claims, detection_pictures, twin_exposure
from kilnflight.project import claims, figures, style
from kilnflight.twin.fitted import LIGHT_FILE

style.use_style()
frames = frames or detection.FRAMES[scale]
setting = {"scale": scale, "frames": frames}
origin = figures.trace("21_pictures", setting, seed=seed, inputs=[LIGHT_FILE])
subsets = detection.labelled_subsets(scale, seed, frames)
print(f"{frames} of the ten labelled frames of each of {len(subsets)} subsets")

# %% [markdown]
# ## Both detectors
#
# DoG is called once for each frame and answers for all thresholds. What a single threshold
# costs is timed on every fifth of the frames.

# %%
attempts = detection_claims.compare_pictures(subsets, scale)
times = detection_claims.time_thresholds(subsets, scale)
otsu = attempts[attempts["method"] == "Otsu"]
sift = detection_claims.chosen_sift(attempts, times)

# %%
of_otsu = detection.with_total(otsu, ["subset"])
caption = (
    f"Otsu's method by subset, after Table 5.5; {frames} labelled frames of each within the "
    "region of interest, scoring distance 45 px."
)
table = detection.beside_published(of_otsu, "table_5.5")
figures.save("table-5-5-otsu", table, caption=caption, provenance=origin)

# %%
of_sift = detection.with_total(sift, ["threshold", "subset"])
caption = (
    f"SIFT by subset, after Table 5.6; {frames} labelled frames of each within the region of "
    "interest, scoring distance 45 px. Threshold of DoG in grey values found on the other four "
    "subsets."
)
table = detection.beside_published(of_sift, "table_5.6")
figures.save("table-5-6-sift", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Which particles are detected
#
# Recall of each class; for Otsu the values that section 5.1.3 states (about 1, 0.9, and as
# drawn for non-burning ones). Bars: this work; diamonds: published.

# %%
recall = detection.class_recall(pd.concat([otsu, sift]), ["method", "subset"])
printed = [twin_exposure.UNLIT_RECALL[subset.name] for subset in subsets]
picture = detection_pictures.draw_class_recall(recall, "method", printed)
caption = "Recall of each class by Otsu's method and by SIFT, after Figs 5.5 and 5.6."
figures.save("fig-5-5-recall", recall, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## What eight bits would lose, and what a threshold costs
#
# OpenCV's SIFT takes 8 bits, ours all 16. Our one table that is not in the thesis shows that this
# explains no difference to it. It has the same foregrounds rounded to 256 levels, with the same
# thresholds.

# %%
both = attempts[attempts["chosen"]].assign(bit_depth=attempts["method"].replace("SIFT", "16 bits"))
table = detection.sum_with_unlit(both, ["bit_depth"])
caption = "SIFT on foregrounds of 16 and of 8 bits, with the thresholds chosen for 16."
figures.save("dog-eight-bits", table, caption=caption, provenance=origin)

# %%
time_table = detection_claims.time_table(times)
caption = "Time of SIFT for one frame against its threshold, after Table 5.7 (MATLAB), and ours."
figures.save("table-5-7-sift-time", time_table, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts

# %%
note = f"{frames * len(subsets)} frames, scoring distance 45 px"
verdicts = detection_claims.picture_verdicts(of_otsu, of_sift, recall, time_table, note)
reproduced = claims.count_reproduced(verdicts)
totals = [table.set_index("subset")["f1"]["Total"] for table in (of_otsu, of_sift)]
result = (
    f"{reproduced} of 8 claims reproduced; two more agree only as far as they were fitted. F1 of "
    f"Otsu {totals[0]:.4f} (published 0.8436), of SIFT {totals[1]:.4f} (0.8749)."
)
figures.conclude(result, verdicts, origin)
