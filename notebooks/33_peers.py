# %% [markdown]
# # Our tracker beside other people's
#
# **Published** (thesis, sections 4.1 and 5.2). GNN and JPDA with a 2.5D gate and a Kalman filter
# of constant velocity, followed by the post-processing of chapter 4.2. They were compared with
# each other, not with trackers that anyone can install.
#
# **Here.** trackpy, laptrack and Stone Soup (GNN and JPDA) get the same detections of the four
# windows at 4.5 bar and the same measures. The settings of every tracker, ours too, are those
# with the largest mean beta on other stretches of the same campaigns, without post-processing,
# which no peer has. Each is then scored as it is, and with our post-processing after it. Ours
# alone look at depth and size. No claim rests on this.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 0  # of the scenes
jobs = 2  # processes of the detection

# %%
from itertools import product

import pandas as pd

from kilnflight import contest, drawing, figures, lessons, peers, provenance, pursuit

drawing.use_style()
made = provenance.trace("33_peers", {"scale": scale}, seed=seed)
missing = sorted(set(peers.PACKAGES) - set(peers.available()))
print(f"peers that are not installed and left out: {', '.join(missing) or 'none'}")

# %%
learned = lessons.learned(scale, seed)
windows = pursuit.windows(scale, learned, seed, jobs=jobs)
others = pursuit.windows(scale, learned, seed, others=True, jobs=jobs)
number = ", ".join(f"{one.fraction} {len(one.frames)}" for one in windows)
print(f"frames: {number}; settings on {len(others[0].frames)} others each")

# %% [markdown]
# ## What is tried
#
# The gate (px, or standard deviations of the filter), how long a particle may be missed, and
# either the noise of the acceleration or whether trackpy predicts. laptrack has no filter.

# %%
contestants = {f"{name}, ours": some for name, some in contest.ours().items()}
steps, soup = list(product((15.0, 20.0, 25.0), (2, 5))), list(product((3.0, 4.0), (1.0,), (5, 8)))
contestants["trackpy"] = {
    f"step {d:g}, unseen {k}{', predicted' * p}": peers.Trackpy(d, k, p)
    for (d, k), p in product(steps[:4], (False, True))
}
contestants["laptrack"] = {
    f"step {d:g}, unseen {k}": peers.LapTrack(d, d, k) for d, k in [*steps, (40.0, 2), (40.0, 5)]
}
contestants["GNN, Stone Soup"] = {
    f"gate {d:g}, noise {n:g}, unseen {k}": peers.StoneSoupGNN(d, n, k) for d, n, k in soup
}

# %% [markdown]
# Joint probabilities of Stone Soup take minutes per frame where many gates overlap. It is tried
# with small gates that are left early, on wood chip alone, and it refuses a window
# in which more than 15 tracks share detections; the tables say so.

# %%
contestants["JPDA, Stone Soup"] = {
    f"gate {d:g}, noise 1, unseen {k}": peers.StoneSoupJPDA(d, 1.0, k)
    for d, k in product((2.0, 2.5, 3.0), (1, 2))
}
package = {"GNN, Stone Soup": "stonesoup", "JPDA, Stone Soup": "stonesoup"}
for name in [one for one in contestants if package.get(one, one) in missing]:
    del contestants[name]

# %%
slow = {name: contestants[name] for name in contestants if name == "JPDA, Stone Soup"}
rest = {name: contestants[name] for name in contestants if name not in slow}
tried = contest.best_setting(others, rest).assign(fractions=len(others))
if slow:
    sparse = contest.best_setting(others[:1], slow).assign(fractions=1)
    tried = pd.concat([tried, sparse], ignore_index=True)
best = contest.chosen(tried, contestants)
caption = (
    "Settings that were tried, with the mean measures on stretches of so many fractions that no "
    "result is taken from, without post-processing; the largest beta is chosen."
)
figures.save("peers-settings", tried, caption=caption, provenance=made)

# %% [markdown]
# ## The same detections, the same measures

# %%
scores = contest.scored(windows, best)
columns = ["fraction", "tracker", "postprocessing", *pursuit.MEASURES, "seconds", "note"]
caption = (
    "Trackers on the same detections of the windows at 4.5 bar, gate 10 px, in the settings "
    "chosen on other stretches. Post-processing is ours, for everyone; seconds are of the "
    "tracking, or of the post-processing after it."
)
figures.save("tracking-peers", scores[columns], caption=caption, provenance=made)

# %% tags=["hide-input"]
fractions = [one.fraction for one in windows]
picture, grid = drawing.canvas(
    2, len(fractions), width_mm=drawing.PAGE_MM, height_mm=95, sharex="row", sharey=True
)
for (row, measure), (k, fraction) in product(enumerate(["alpha", "beta"]), enumerate(fractions)):
    here = scores[scores["fraction"] == fraction]
    drawing.before_after(grid[row, k], here, "tracker", "postprocessing", measure)
    grid[row, k].set(title=fraction if row == 0 else "", xlabel=measure)
grid[0, 0].invert_yaxis()
handles = grid[0, 0].get_legend_handles_labels()
_ = picture.legend(*handles, loc="outside lower center", ncols=2, title="post-processing")

# %%
caption = (
    "alpha and beta of trackers on the same detections: as they are (open circles) and with our "
    "post-processing (filled squares). A tracker without a mark could not be run in bearable time."
)
figures.save("fig-peers", scores[columns], picture=picture, caption=caption, provenance=made)

# %% [markdown]
# ## Result

# %%
done = scores.dropna(subset="beta")
leaders = {}
for (stage, fraction), here in done.groupby(["postprocessing", "fraction"], sort=False):
    ranked = here.set_index("tracker")["beta"].sort_values(ascending=False)
    own = ranked[ranked.index.str.endswith("ours")].max()
    lead = f"{fraction} {ranked.index[0]} {ranked.iloc[0]:.3f}"
    lead += "" if ranked.index[0].endswith("ours") else f" (ours {own:.3f})"
    leaders.setdefault(stage, []).append(lead)
every = done.groupby(["postprocessing", "tracker"])["beta"].agg(["mean", "size"])
every = every.loc[every["size"] == len(windows), "mean"]

# %%
left = scores.loc[scores["beta"].isna(), "tracker"].unique()
parts = []
for stage, found in leaders.items():
    mean = every[stage].sort_values(ascending=False)
    means = ", ".join(f"{name} {value:.3f}" for name, value in mean.items())
    parts.append(f"{stage} post-processing {'; '.join(found)} (means: {means})")
result = f"Largest beta {'. Largest beta '.join(parts)}."
result += f" Not run on every window: {', '.join(left)}." if len(left) else ""
verdicts = []
figures.conclude(result, verdicts, made)
