# %% [markdown]
# # Tracking: GNN and JPDA on four fractions
#
# **Published** (thesis, sections 5.2.1 to 5.2.3, Tables 5.15 to 5.17). Particles of each fraction
# are tracked in windows in which 7 to 37 trajectories from the lance were followed by hand.
# Post-processing raises all four measures for all fractions and both trackers. GNN and JPDA are
# comparable, JPDA with a slight advantage at a far higher cost.
#
# **Here.** The same on the twin's campaigns at 4.5 bar, in windows with as many trajectories.
# Detections are those of the combined SIFT and DBSCAN that are not known to be on the wall. Noise
# of the filter, gate and the frames that a track may miss are not printed. They are chosen on
# other frames by what is reported: mean beta after post-processing, tracks from the lance. All
# thresholds of Table 5.16 are as printed. The scoring distance is its bare epsilon, 10 px. All
# positions are those detected.

# %% tags=["parameters"]
scale = "standard"  # quick (two fractions), standard or full
seed = 0  # of the scenes
jobs = 2  # processes of the detection

# %%
from kilnflight.experiments import (
    campaigns,
    plots,
    tracker_ranks,
    tracking,
    tracking_scores,
    tuning,
)
from kilnflight.experiments import tracking_claims as table_5_17
from kilnflight.project import figures, style

style.use_style()
origin = figures.trace("32_tracking", {"scale": scale}, seed=seed)
settings = campaigns.settings_from_labels(scale, seed)
windows = tracking.windows(scale, settings, seed, jobs=jobs)

# %%
counted = table_5_17.window_table(windows)
caption = (
    "Windows of the campaigns in which about as many leave the lance and last as Table 5.15 "
    "counts, or their busiest part. The published frames hold other numbers on the twin. "
    "Trajectories: all that a person could follow; trajectories from lance: by the rule of the "
    "scores. Of no particle: detections that are farther than 10 px from all true positions."
)
figures.save("table-5-15-windows", counted, caption=caption, provenance=origin)

# %% [markdown]
# Where most detections are of no particle, tracks of all are mostly false, whatever the tracker.
# So it is with granules: they are recorded with a longer exposure. The burner's flame then grows
# beyond the rectangle that is cut out for it, and the wall flickers (see the limits).

# %% [markdown]
# ## Settings that are not printed
#
# Gate, noise of the acceleration, and how many frames in a row a track may miss. Each has a grid;
# all trackers get the same number of trials (notebook 33: the peers, too). Section 5.2.3 makes
# JPDA's gate smaller than GNN's: so is that of "JPDA" here. "JPDA (any gate)" is free. Whoever
# repeats this needs all that was tried, so it is saved.

# %%
tried = tuning.tried_settings(scale, tuning.OURS, seed, jobs)
trackers = tuning.our_trackers(tried)
picture = tracker_ranks.draw_curves(tried)
ours = tried[tried["chosen"]].set_index("tracker")["setting"]
same = ours.get(tuning.OURS[1]) == ours.get(tuning.OURS[2])
same = " JPDA with any gate is the same tracker." if same else ""
caption = (
    "What was tried for GNN and JPDA on frames that are not reported. Mean beta after "
    "post-processing, tracks from the lance: every setting (grey), the largest at each value "
    "(line), the chosen setting (circle). JPDA's gates end below GNN's by the text (section "
    "5.2.3). Without the texture term, for which these frames have no differences (notebook 31 "
    "asks what it does). "
    f"Chosen: {tuning.describe_chosen(tried)}.{same}"
)
shown = tracker_ranks.filled(tried)
figures.save("tracking-settings", shown, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Table 5.17 in its readings
#
# Beside the print stand tracks and true trajectories that start at the lance and last (sections
# 4.2.5 and 5.2.1), with and without post-processing alike. Two other readings follow: all tracks
# and all trajectories; and direct outcomes whole, since 4.2.5 restricts after post-processing.
# Beside the table of the thesis, a picture of both: 64 numbers do not compare at a glance.

# %%
readings = (*tracking_scores.READINGS, tracking_scores.AFTERWARDS)
tracked = tracking.follow_all(windows, trackers)
cells = {cell.key: cell for cell in tracking.cells(windows, tracked, readings)}
measured = tracking_scores.tabulate(cells.values())
caption = (
    "GNN and JPDA with and without post-processing on windows like those of Table 5.15, "
    f"scoring distance {tracking_scores.GATE_PX:.0f} px; after Table 5.17, with 95 % intervals. "
    "The reading from the lance decides the claims; the others only stand beside it. No interval: "
    "fewer than six true trajectories."
)
table = table_5_17.with_table_5_17(measured)
# What stands beside the print comes first: the picture of the table has no room for all.
table = table.sort_values(
    "reading", key=lambda reading: reading != tracking_scores.FROM_LANCE, kind="stable"
)
figures.save("table-5-17-tracking", table, caption=caption, provenance=origin)

# %%
beside = table_5_17.beside_table_5_17(measured)
picture, grid = style.canvas(2, 2, width_mm=style.PAGE_MM, height_mm=150, sharex=True)
for axes, measure in zip(grid.flat, tracking_scores.MEASURES, strict=True):
    plots.draw_beside_published(axes, beside[beside["measure"] == measure])
    axes.set(title=plots.SYMBOLS[measure], xlim=(-0.02, 1.02))
_ = [axes.set_xlabel("measure") for axes in grid[-1]]
picture.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
caption = (
    "The 64 values of Table 5.17: recomputed from the lance (black, with 95 % intervals), of all "
    "tracks (grey), published (diamonds). From without (open) to with post-processing (filled)."
)
figures.save("tracking-scores", beside, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Trajectories beside the optical and the true ones

# %%
shown = [window for window in windows if window.fraction in ("wood chip", "PE granule")]
tables = tracking.beside_truth(shown, tracked, table_5_17.TRACKERS)
picture = tracking.draw_trajectories(shown, tables)
table = tracking.joined_tables(tables, "tracks")
caption = (
    "Simulated: true trajectories and those of GNN and JPDA, without and with post-processing, on "
    "the sum of frame differences; after Figs 5.12 to 5.15. Black rectangle: where the burner's "
    "flame is cut out."
)
figures.save("fig-5-12-trajectories", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## One frame
#
# What the chain sees in a frame: detections in the air, and the tracks that lead to them.

# %%
window = windows[1]
tracks = tracked[window.fraction, "GNN"][tracking_scores.STAGES[-1]]
picture, table = tracking.draw_one_frame(window, tracks)
caption = (
    "Simulated: the frame of the window in which most particles are tracked. Its detections in "
    "the air (circles), and the tracks of GNN that lead to them, after post-processing."
)
figures.save("tracked-frame", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts

# %%
verdicts = table_5_17.verdicts(cells)
result = f"{table_5_17.describe(beside)} {table_5_17.describe_windows(counted)}"
figures.conclude(result, verdicts, origin)
