# %% [markdown]
# # Ablation: what detection, association and post-processing cost
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
from kilnflight.experiments import (
    campaigns,
    jpda_ablation,
    plots,
    tracking,
    tracking_scores,
    tuning,
)
from kilnflight.project import figures, style

style.use_style()
origin = figures.trace("34_ablation", {"scale": scale}, seed=seed)
windows = tracking.windows(scale, campaigns.settings_from_labels(scale, seed), seed, jobs=jobs)
tried = tuning.tried_settings(scale, tuning.OURS, seed, jobs)
trackers = tuning.our_trackers(tried)

# %% [markdown]
# ## By fraction
#
# No such table was published; the truth of the twin alone makes it possible. Beta counts false
# tracks, alpha does not: what false detections cost shows in beta.

# %%
table = tracking.ablate(windows, {name: trackers[name] for name in ("GNN", "JPDA")})
keys = ["input", "tracker", "postprocessing"]
columns = ["fraction", *keys, *tracking_scores.MEASURES, "jsc_spurious_only"]
caption = (
    "Tracking with one part after the other replaced by the truth, by fraction. Trackers in "
    f"their chosen settings, scoring distance {tracking_scores.GATE_PX:.0f} px, tracks and "
    "trajectories from the lance."
)
figures.save("tracking-ablation", table[columns], caption=caption, provenance=origin)

# %% [markdown]
# ## On average
#
# The means in one picture, since the order of the parts is what matters.

# %%
mean = table.groupby(keys, sort=False)[list(tracking_scores.MEASURES)].mean().reset_index()
mean["configuration"] = mean[keys].agg(", ".join, axis=1)
mean["configuration"] = (
    mean["configuration"].str.replace(", without", "").str.replace(", with", " + steps")
)

# %% tags=["hide-input"]
picture, (panels,) = style.canvas(1, 2, width_mm=style.PAGE_MM, height_mm=80, sharey=True)
for axes, names in zip(panels, (("alpha", "beta"), ("jsc", "jsc_theta")), strict=True):
    for name, marker, face in zip(names, "os", ("black", "white"), strict=True):
        look = {"color": "black", "mfc": face, "label": plots.SYMBOLS[name]}
        axes.plot(mean[name], mean["configuration"], marker, **look)
    axes.set(xlim=(-0.02, 1.02), xlabel="mean over the fractions")
    axes.grid(axis="y", lw=0.3)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
panels[0].invert_yaxis()
caption = "What each part costs: measures with true and with real parts, mean over the fractions."
figures.save("ablation-means", mean, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Why JPDA differs from GNN
#
# Section 5.2.3 expects a slight advantage of JPDA since it averages. It blames the smaller gate
# and the covariances for what JPDA misses. One part of JPDA after the other is exchanged: what is
# recorded, what moves the filter (joint probabilities pull close tracks together), the gate, the
# noise, the density of clutter and the probability of detection of Eq. 4.12. Post-processing and
# true tracks stay the same, so differences are paired.

# %%
variants = jpda_ablation.variants(trackers["JPDA"], trackers["GNN"], trackers[tuning.ANY_GATE])
exchanged = jpda_ablation.ablate(windows, variants)
picture = jpda_ablation.draw(exchanged)
caption = (
    "What JPDA gains or loses by one exchanged part, mean over the fractions, with 95 % intervals "
    "(bootstrap over true tracks; none with fewer than six in a window). Alpha (black) and beta "
    "(white) after post-processing, all tracks and those from the lance."
)
figures.save("jpda-ablation", exchanged, picture=picture, caption=caption, provenance=origin)

# %%
alpha = mean.set_index("configuration")["alpha"]
result = (
    f"Mean alpha of GNN: {alpha['true positions, GNN']:.2f} with true positions, "
    f"{alpha['right detections only, GNN']:.2f} with the detections that are right, "
    f"{alpha['detections, GNN']:.2f} with all, {alpha['detections, GNN + steps']:.2f} after the "
    f"steps. Links by the truth: {alpha['detections, links by the truth']:.2f}. "
    f"{jpda_ablation.describe(exchanged)} No claim is tested."
)
figures.conclude(result, [], origin)
