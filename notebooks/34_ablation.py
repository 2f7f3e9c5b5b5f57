# %% [markdown]
# # What detection, association and post-processing each cost
#
# **Published** (thesis, section 5.2.3). Deficiencies of the tracks are "primarily caused by
# detection inaccuracies": missing detections, false ones, duplicates. How much each part costs
# was not measured; on a recording without a known truth it cannot be.
#
# **Here.** One part after the other is replaced by the truth, on windows like those of Table 5.15.
# True positions in place of the detections leave what the association loses. Detections without
# the false ones and duplicates leave what is missed. Links by the truth leave what no tracker
# can mend.

# %% tags=["parameters"]
scale = "standard"  # quick (two fractions), standard or full
seed = 0  # of the scenes
jobs = 2  # processes of the detection

# %%
import pandas as pd

from kilnflight.project import figures, style

style.use_style()

# %%
from kilnflight import association
from kilnflight.experiments import campaigns, tracking
from kilnflight.tracking.tracker import track

origin = figures.trace("34_ablation", {"scale": scale}, seed=seed)
windows = tracking.windows(scale, campaigns.settings_from_labels(scale, seed), seed, jobs=jobs)
trackers = {"GNN": track}
trackers["JPDA"] = lambda seen: track(seen, association.JPDA())
given = {
    "true positions": [tracking.with_true_positions(one) for one in windows],
    "right detections only": [tracking.without_false_detections(one) for one in windows],
    "detections": windows,
}

# %%
parts = [tracking.run(some, trackers).assign(given=name) for name, some in given.items()]
rows = [
    {"fraction": one.fraction, "tracker": "links by the truth"}
    | tracking.measures(one.truth, tracking.linked_by_truth(one))
    for one in windows
]
best = pd.DataFrame(rows).assign(given="detections", postprocessing="without")
table = pd.concat([*parts, best], ignore_index=True)
keys = ["given", "tracker", "postprocessing"]
columns = ["fraction", *keys, *tracking.MEASURES, "jsc_spurious_only"]
caption = (
    "Tracking with one part after the other replaced by the truth, by fraction; trackers at "
    f"their defaults, gate {tracking.GATE_PX:.0f} px."
)
figures.save("tracking-ablation", table[columns], caption=caption, provenance=origin)

# %%
mean = table.groupby(keys, sort=False)[list(tracking.MEASURES)].mean().reset_index()
mean["what"] = mean[keys].agg(", ".join, axis=1)
mean["what"] = mean["what"].str.replace(", without", "").str.replace(", with", " + steps")

# %% tags=["hide-input"]
picture, (panels,) = style.canvas(1, 2, width_mm=style.PAGE_MM, height_mm=80, sharey=True)
for axes, names in zip(panels, (("alpha", "beta"), ("jsc", "jsc_theta")), strict=True):
    for name, marker, face in zip(names, "os", ("black", "white"), strict=True):
        axes.plot(mean[name], mean["what"], marker, color="black", mfc=face, label=name)
    axes.set(xlim=(-0.02, 1.02), xlabel="mean over the fractions")
    axes.grid(axis="y", lw=0.3)
    axes.legend(loc="upper left")
panels[0].invert_yaxis()
caption = "What each part costs: measures with true and with real parts, mean over the fractions."
figures.save("fig-tracking-ablation", mean, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## What limits each fraction
#
# Beta counts false tracks, alpha does not: what false detections cost shows in beta.

# %%
plain = table[(table["postprocessing"] == "without") & (table["tracker"] != "JPDA")]
plain = plain.assign(case=plain["given"] + ", " + plain["tracker"])
limits = plain.pivot(index="fraction", columns="case", values=["alpha", "beta"]).round(3)
limits.columns = [f"{measure}: {case}" for measure, case in limits.columns]
caption = (
    "Alpha and beta of each fraction without post-processing, by what is given: from true "
    "positions to all detections, and links by the truth."
)
table = limits.reset_index()
figures.save("tracking-limits", table, caption=caption, provenance=origin)

# %%
alpha = mean.set_index("what")["alpha"]
result = (
    f"Mean alpha of GNN: {alpha['true positions, GNN']:.2f} with true positions, "
    f"{alpha['right detections only, GNN']:.2f} with the detections that are right, "
    f"{alpha['detections, GNN']:.2f} with all, {alpha['detections, GNN + steps']:.2f} after the "
    f"steps; links by the truth {alpha['detections, links by the truth']:.2f}. No claim is tested."
)
figures.conclude(result, [], origin)
