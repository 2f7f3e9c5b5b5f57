# %% [markdown]
# # Other trackers beside ours
#
# **Published** (thesis, sections 4.1 and 5.2). GNN and JPDA with a 2.5D gate and a Kalman filter
# of constant velocity, followed by the post-processing of chapter 4.2. They were compared with
# each other, not with trackers that anyone can install.
#
# **Here.** trackpy, laptrack and Stone Soup (GNN and JPDA) get the same detections of the four
# windows at 4.5 bar and the same measures. The settings of every tracker, ours too, are found by
# one rule on other frames of the same campaigns, in the same number of trials. What decides is what
# is reported: the mean beta after our post-processing, of the tracks from the lance. Each is then
# scored as it is, and with our post-processing after it, in two readings of Table 5.17 (notebook
# 32). Ours alone look at depth and size. No claim rests on this.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 0  # of the scenes
jobs = 2  # processes of the detection

# %%
from kilnflight.experiments import campaigns, tracker_ranks, tracking, tuning
from kilnflight.experiments import other_trackers as peers
from kilnflight.project import figures, style

style.use_style()
origin = figures.trace("33_peers", {"scale": scale}, seed=seed)
missing = sorted(set(peers.PACKAGES) - set(peers.available()))
print(f"peers that are not installed and left out: {', '.join(missing) or 'none'}")

# %%
learned = campaigns.settings_from_labels(scale, seed)
windows = tracking.windows(scale, learned, seed, jobs=jobs)
number = ", ".join(f"{window.fraction} {len(window.frames)}" for window in windows)
print(f"frames: {number}; settings on {tuning.LENGTHS[scale]} others each")

# %% [markdown]
# ## What is tried
#
# The gate (px, or standard deviations of the filter) and how many frames a particle may be
# missed. Then the noise of the acceleration, the step over a gap (laptrack), or whether trackpy
# predicts. Each parameter has a grid of values. Eight settings are tried first, then the
# neighbours of the best ones, until each tracker has had its trials. The table is saved so that
# users of a tracker can judge its settings.
#
# Joint probabilities of Stone Soup take long where many gates overlap. A window in which more
# than 20 tracks share detections is refused, and such a setting is never chosen. Its trials are on
# the first 40 frames of each stretch only. Where settings are refused, its best one may lie beyond
# what our limit of 20 tracks lets run, so its rank is a lower bound. A tracker whose settings are
# all refused is named with the reason and has no measures.

# %%
tried = tuning.tried_settings(scale, tuning.all_grids(), seed, jobs)
best = tuning.chosen_trackers(tried)
picture = tracker_ranks.draw_curves(tried)
caption = (
    "All settings that were tried, the same number for each tracker, on frames that are not "
    "reported (frames: of each stretch). Mean measures after post-processing, tracks from the "
    "lance. Line: the largest at each value; circle: chosen. At end, if any: which parameters of "
    "the chosen one lie at an end of the grid. Untried: how many of its neighbours were not tried."
)
shown = tracker_ranks.filled(tried)
figures.save("peers-settings", shown, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## The same detections, the same measures
#
# Post-processing is ours, for everyone. The picture is the answer that this notebook is for.

# %%
scores, cells = tracker_ranks.score(windows, best)
limits = tracker_ranks.held_back(tried)
picture = tracker_ranks.draw(scores, limits)
caption = (
    "Trackers on the same detections of the windows at 4.5 bar, scoring distance 10 px, in both "
    "readings, with 95 % intervals. Settings were chosen on other frames. Open circles: as "
    "they are; filled squares: with our post-processing. A tracker without a mark refused the "
    "window; one with a star refused settings, of which the best may be one."
)
shown = tracker_ranks.filled(scores)
figures.save("peer-scores", shown, picture=picture, caption=caption, provenance=origin)

# %%
ranks = tracker_ranks.ahead_of_ours(scores, cells, limits)
caption = (
    "Mean beta over the fractions, and by how much it is above that of our best tracker, with the "
    "95 % interval of this difference (none: a window has fewer than six true trajectories). Only "
    "trackers that ran on every window. Held back: settings were refused by our limit of joint "
    "tracks (Stone Soup) or by trackpy's own. The best may be among them. Such a beta is a lower "
    "bound and no rank among equals."
)
figures.save("peers-ranks", ranks, caption=caption, provenance=origin)

# %% [markdown]
# ## Result

# %%
result = tracker_ranks.describe(ranks, scores)
figures.conclude(result, [], origin)
