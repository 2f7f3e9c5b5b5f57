# %% [markdown]
# # Particles in pictures: Otsu and SIFT
#
# **Published** (thesis, sections 2.2.2, 2.2.3 and 5.1.3). On 50 labelled frames, after the
# median background, Otsu's threshold finds nearly all that burns and little that does not
# (F1 0.8436, Table 5.5); SIFT finds about half of what does not burn (0.8749, Table 5.6) and
# is the faster the higher its threshold (Table 5.7).
#
# **Here.** The same on the twin. Otsu's row is what the picture's few free inputs (exposure,
# contrast, flicker) were fitted to, on two frames of each subset, so its agreement is no
# result; everything else is a prediction. SIFT's threshold is found on four subsets and used
# on the fifth; the published 450 to 550 belong to an exposure that nobody printed.

# %% tags=["parameters"]
scale = "standard"  # quick (two subsets), standard or full
seed = 0  # of the scenes
frames = 0  # labelled frames per subset; 0: 1, 1 or 10 by scale

# %%
import numpy as np
import pandas as pd

from kilnflight.detection import DoG, Otsu
from kilnflight.experiments import (
    detection,
    detection_methods,
    detection_pictures,
    twin_exposure,
)
from kilnflight.project import claims, figures, style
from kilnflight.twin import scenes, truth
from kilnflight.twin.fitted import LIGHT_FILE

style.use_style()
frames = frames or detection.FRAMES[scale]
setting = {"scale": scale, "frames": frames}
origin = figures.trace("21_pictures", setting, seed=seed, inputs=[LIGHT_FILE])

# %%
subsets = detection.labelled_subsets(scale, seed, frames)
images = frames * len(subsets)
print(f"{frames} of the ten labelled frames of each of {len(subsets)} subsets")

# %% [markdown]
# ## Both detectors

# %%
step = np.float32(65_535 / 255)  # of eight bits, which is what OpenCV's SIFT takes


def coarse(foreground):
    return np.rint(foreground / step) * step


# %%
some = detection_methods.THRESHOLDS[:: 4 if scale == "quick" else 1]
matlab = claims.published("table_5.7").rename(columns={"dog_local_max": "threshold"})
ways = {
    "16 bits": detection_methods.from_thresholds(some),
    "8 bits": detection_methods.from_thresholds(some, coarse),
}
methods = {("Otsu", 0): detection_methods.from_foreground(Otsu())}
methods |= {(way, t): method for way, every in ways.items() for t, method in every.items()}
attempts = detection.run(subsets, methods)
attempts[["what", "threshold"]] = attempts["method"].to_list()
attempts["method"] = attempts["what"].replace("16 bits", "SIFT")
otsu = attempts[attempts["what"] == "Otsu"].drop(columns="threshold")

# %% [markdown]
# One look at a frame answers for all thresholds. What a single threshold costs is timed on
# every fifth of the frames.

# %%
few = [one._replace(frames=one.frames[::5]) for one in subsets]
single = {
    t: detection_methods.from_foreground(DoG(float(t))) for t in {*some, *matlab["threshold"]}
}
times = detection.run(few, single).rename(columns={"method": "threshold"})
cost = times.groupby(["subset", "threshold"])["seconds"].median().rename("seconds")
dogs = attempts[attempts["what"] == "16 bits"].drop(columns="seconds")
dogs = detection.mark_chosen(dogs.join(cost, on=["subset", "threshold"]))
sift = dogs[dogs["chosen"]]
threshold = detection.chosen_thresholds(dogs)

# %%
tables = {
    "table-5-5-otsu": detection.with_total(otsu, ["subset"]),
    "table-5-6-sift": detection.with_total(sift, ["threshold", "subset"]),
}
order = ["subset", "tp", "fp", "fn", "precision", "recall", "f1", "seconds_per_image"]
tables["table-5-6-sift"] = tables["table-5-6-sift"][["threshold", *order, "f1_in_pixels"]]

# %%
printed = claims.published("table_5.5").set_index("subset")["f1"]
caption = (
    f"Otsu's method by subset, after Table 5.5; {frames} labelled frames of each within the "
    "region of interest, gate 45 px."
)
otsu_table = tables["table-5-5-otsu"].merge(printed.rename("f1_published").reset_index())
figures.save("table-5-5-otsu", otsu_table, caption=caption, provenance=origin)

# %%
printed = claims.published("table_5.6").set_index("test_set")["f1"].rename_axis("subset")
caption = (
    f"SIFT by subset, after Table 5.6; {frames} labelled frames of each within the region of "
    "interest, gate 45 px; threshold of DoG in grey values found on the other four subsets."
)
sift_table = tables["table-5-6-sift"].merge(printed.rename("f1_published").reset_index())
figures.save("table-5-6-sift", sift_table, caption=caption, provenance=origin)

# %% [markdown]
# ## Which particles are found
#
# Recall of each class; for Otsu the values that section 5.1.3 states (about 1, 0.9, and as
# drawn for non-burning ones). Bars: this work; diamonds: published.

# %%
both = pd.concat([otsu, sift], ignore_index=True)
recall = detection.class_recall(both, ["method", "subset"])
recall = recall.assign(kind=recall["label"].map(truth.CLASSES))
each = [one.name for one in subsets]
unlit = dict(zip(scenes.SUBSETS, twin_exposure.UNLIT_RECALL, strict=True))

# %%
picture = detection_pictures.class_recall(recall, "method", [unlit[name] for name in each])
caption = "Recall of each class by Otsu's method and by SIFT, after Figs 5.5 and 5.6."
figures.save("fig-5-5-recall", recall, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## What eight bits would lose, and what a threshold costs
#
# OpenCV's SIFT takes 8 bits. The same foregrounds rounded to 256 levels, same thresholds.

# %%
both = attempts[attempts["what"].isin(["16 bits", "8 bits"])]
both = both.merge(threshold.reset_index())  # of each subset
eight = detection.sum_counts(both, ["what"]).drop(columns="seconds_per_image")
faint = detection.class_recall(both, ["what"])
faint = faint[faint["label"] == 3].set_index("what")["recall"]
eight = eight.assign(recall_non_burning=eight["what"].map(faint))
caption = "SIFT on foregrounds of 16 and of 8 bits, with the thresholds chosen for 16."
figures.save("dog-eight-bits", eight, caption=caption, provenance=origin)

# %%
seconds = times.groupby("threshold")["seconds"].median()
speed = matlab.assign(measured_s=matlab["threshold"].map(seconds))
caption = "Time of SIFT for one frame against its threshold, after Table 5.7 (MATLAB), and ours."
figures.save("table-5-7-sift-time", speed, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts

# %%
rows = {name: table.set_index("subset") for name, table in tables.items()}
of_otsu, of_sift = rows["table-5-5-otsu"], rows["table-5-6-sift"]
by_class = recall.pivot(index=["method", "subset"], columns="label", values="recall")
faint_otsu, faint_sift = by_class.loc["Otsu", 3], by_class.loc["SIFT", 3]
note = f"{images} frames, gate 45 px"
aim = "the picture was fitted to Otsu's row (notebook 13)"
least = of_otsu.loc[each, "f1"].idxmin()
worst = {f"last is {least}": least == "V5"}

# %%
verdicts = [
    claims.fitted(claims.judge("otsu-1", of_otsu.loc[each, "precision"], note=note), aim),
    claims.judge("otsu-2", by_class.loc["Otsu", 2], note=note),
    claims.judge(
        "otsu-3",
        {f"{v} {r:.2f} <= 0.5": bool(r <= 0.5) for v, r in faint_otsu.items()}
        | {"V4 lowest": faint_otsu.idxmin() == "V4" or bool(faint_otsu["V4"] == faint_otsu.min())},
        note=f"{note}; although {aim}",
    ),
    claims.fitted(claims.judge("otsu-4", {f"last is {least}": least == "V5"}, note=note), aim),
]

# %%
faint_note = {f"{v} {faint_sift[v]:.2f} in 0.35..0.75": 0.35 <= faint_sift[v] <= 0.75 for v in each}
more = {f"{v} above Otsu {faint_otsu[v]:.2f}": faint_sift[v] > faint_otsu[v] for v in each}
f1_otsu, f1_sift = of_otsu["f1"], of_sift["f1"]
ahead = f"{f1_sift['Total']:.4f} > {f1_otsu['Total']:.4f}"
gap = f1_sift["V5"] - f1_otsu["V5"]
last = f1_sift[each].idxmin()

# %%
verdicts += [
    claims.judge("sift-1", {ahead: f1_sift["Total"] > f1_otsu["Total"]}, note=note),
    claims.judge("sift-2", {**faint_note, **more}, note=note),
    claims.judge(
        "sift-3",
        {f"last is {last}": last == "V5", f"V5 {gap:+.3f} >= 0.05": gap >= 0.05},
        note=note,
    ),
    claims.judge("sift-4", seconds[400] / seconds[1000], note="median time of a frame"),
]

# %%
reproduced = sum(one.verdict == claims.REPRODUCED for one in verdicts)
result = (
    f"{reproduced} of 8 claims reproduced; two more agree only as far as they were fitted. F1 of "
    f"Otsu {f1_otsu['Total']:.4f} (published 0.8436), of SIFT {f1_sift['Total']:.4f} (0.8749)."
)
figures.conclude(result, verdicts, origin)
