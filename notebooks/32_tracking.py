# %% [markdown]
# # Tracking: post-processing lowers alpha and beta here
#
# **The work.** The thesis tracks four fractions with GNN and JPDA (sections 5.2.1 to 5.2.3, Tables
# 5.15 and 5.17). Post-processing raises all four measures, and JPDA is slightly ahead.
#
# **Here.** Simulated campaigns at 4.5 bar, in windows with about as many trajectories as Table
# 5.15. Detections are those of SIFT and DBSCAN combined that are not known to be on the wall.
#
# **One number.** Alpha of wood chips, GNN with post-processing: 0.67 printed, 0.63 here.
#
# **What disagrees.** Alpha and beta fall, from 0.43 to 0.39 on average. GNN is ahead of JPDA, and
# shreds are tracked far worse than confetti.

# %% tags=["parameters"]
scale = "standard"  # quick (two fractions), standard or full
seed = 0  # of the scenes
jobs = 2  # processes of the detection

# %%
import numpy as np
import pandas as pd

from kilnflight import tracklets
from kilnflight.experiments import campaigns, ignition, plots, trackers, tracking
from kilnflight.experiments import tracking_scores as scores
from kilnflight.project import claims, figures, style
from kilnflight.twin import scenes

style.use_style()
origin = figures.trace("32_tracking", {"scale": scale}, seed=seed)
windows = tracking.windows(scale, campaigns.settings_from_labels(scale, seed), seed, jobs=jobs)

# %% [markdown]
# ## Windows
#
# Of each campaign, the frames in which about as many particles leave the lance as Table 5.15
# counts. Most detections of PE granules belong to no particle: their exposure is longer, the flame
# grows beyond the rectangle that is cut out, and the wall flickers.

# %%
printed = claims.published("table_5.15")
amount = printed["amount_of_trajectories"].set_axis(printed["fraction"].str.lower())
counted = tracking.window_table(windows)
counted["trajectories_published"] = counted["fraction"].str.lower().map(amount)
caption = (
    "Windows of the campaigns beside Table 5.15. Trajectories: all that a person could follow; "
    "from lance: those scored. Of no particle: detections over 10 px from all true positions."
)
figures.save("table-5-15-windows", counted, caption=caption, provenance=origin)

# %% [markdown]
# ## Table 5.17
#
# Scored are tracks that start at the lance and last (sections 4.2.5 and 5.2.1), with and without
# post-processing alike. The distance is the bare epsilon of Table 5.16, 10 px, and positions are
# those detected. Gate, noise and missed frames are not printed. Those used were chosen for the
# largest beta on other frames of an earlier simulation (data/reference/trackers.csv). JPDA has the
# smaller gate, as in section 5.2.3.

# %%
tracked = tracking.follow_all(windows, {name: trackers.chosen(name) for name in scores.TRACKERS})
cells = tracking.cells(windows, tracked)
measured = scores.tabulate(cells.values())
wide = scores.published().pivot(index=scores.KEYS, columns="measure", values="published")
table = measured.merge(wide.add_suffix("_published").reset_index(), how="left")
caption = (
    "GNN and JPDA with and without post-processing beside Table 5.17: tracks from the lance, "
    "scoring distance 10 px, 95 % intervals (bootstrap over true tracks; none with fewer than six)."
)
figures.save("table-5-17-tracking", table, caption=caption, provenance=origin)

# %% [markdown]
# The same values one per row, then the differences that section 5.2.3 speaks of. An entry "A - B"
# is a difference. Both sides are drawn with the same true trajectories, so it is paired.

# %%
beside, apart = scores.beside_published(measured), scores.differences(cells)

# %% tags=["hide-input"]
size = {"width_mm": style.PAGE_MM, "height_mm": 130, "sharex": True, "sharey": True}
picture, grid = style.canvas(2, 2, **size)
looks = {"recomputed": {"marker": "o", "color": "black", "ms": 3}, "published": style.PUBLISHED}
for axes, (measure, part) in zip(grid.flat, beside.groupby("measure"), strict=True):
    part = part.pivot(index=scores.KEYS[:2], columns="postprocessing")
    for shift, (source, look) in zip((-0.15, 0.25), looks.items(), strict=True):
        place, line = np.arange(len(part)) + shift, {**look, "ls": ""}
        ends = part[source, "without"], part[source, "with"]
        axes.hlines(place, *ends, look["color"], lw=0.7)
        for stage, face in (("without", "white"), ("with", look["color"])):
            label = f"{source}, {stage} post-processing"
            axes.plot(part[source, stage], place, **{**line, "mfc": face, "label": label})
    for stage, shift in (("without", -0.3), ("with", -0.05)):
        ends = part["low", stage], part["high", stage]
        axes.hlines(np.arange(len(part)) + shift, *ends, color="black", lw=0.4)
    axes.set_yticks(range(len(part)), [", ".join(names) for names in part.index])
    axes.set(title=plots.SYMBOLS[measure], xlim=(-0.02, 1.02), ylim=(len(part) - 0.5, -0.6))
_ = [axes.set_xlabel("measure") for axes in grid[-1]]
_ = picture.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)

# %%
table = pd.concat([beside, apart], ignore_index=True)
caption = (
    "The 64 values of Table 5.17 recomputed (black, with 95 % intervals) and published (diamonds), "
    "from without (open) to with post-processing (filled). The table adds paired differences."
)
figures.save("tracking-scores", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Tracks beside the true trajectories

# %%
shown = [window for window in windows if window.fraction in ("wood chip", "PE granule")]
tables = {window.fraction: {"truth": window.truth} for window in shown}
for (fraction, name), stages in tracked.items():
    if fraction in tables:
        tables[fraction] |= {f"{name} {stage} steps": each for stage, each in stages.items()}

# %% tags=["hide-input"]
picture, grid = style.canvas(5, len(shown), width_mm=130, height_mm=200)
for window, column in zip(shown, grid.T, strict=True):
    _, height, width = window.differences.shape
    first, last = window.frames.start, window.frames.stop - 1
    light = window.differences(first, last, 0, 0, height, width)
    for axes, (name, each) in zip(column, tables[window.fraction].items(), strict=True):
        style.draw_frame(axes, light, 8)
        tracks = tracklets.tracked(each)
        near = tracks["particle"].isin(scores.from_lance(tracks, window.lance)["particle"])
        style.draw_tracks(axes, tracks[~near], "0.55")
        style.draw_tracks(axes, tracks[near])
        axes.set(title=f"{window.fraction}: {name}", ylabel="row (px)", xlabel="")
    column[-1].set_xlabel("column (px)")

# %%
caption = (
    "Simulated: true trajectories and those of GNN and JPDA, without and with post-processing, on "
    "the sum of frame differences; after Figs 5.12, 5.14 and 5.15. Colour: tracks from the lance; "
    "grey: others. Black: where the burner's flame is cut out."
)
table = tracking.joined_tables(tables, "tracks")
figures.save("fig-5-12-trajectories", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Optical ground truth
#
# Paths become visible in the background plus the greatest difference of each pixel from it.

# %%
optical, paths, frames = {}, [], {"quick": 5, "standard": 50, "full": 300}[scale]
for name in counted["fraction"]:
    twin = scenes.cached_scene(scenes.campaign_name(name, 4.5), seed)
    window = scenes.tracking_window(twin)[:frames]
    optical[name] = ignition.optical_picture(twin, window)
    height, width = twin.attributes.rows, twin.attributes.columns
    for t in window:
        moment, place = twin.life.at(twin.time_s(t)), twin.scene.geometry
        row, col = place.project(place.to_camera(moment.position_m))
        each = pd.DataFrame({"particle": moment.particle, "frame": t, "row": row, "col": col})
        inside = (row >= 0) & (row < height) & (col >= 0) & (col < width)
        paths.append(each[~moment.landed & inside].assign(fraction=name))
paths = pd.concat(paths)

# %% tags=["hide-input"]
size = {"width_mm": style.PAGE_MM, "height_mm": 62.5 * len(optical)}
picture, grid = style.canvas(len(optical), 2, **size)
for panels, (name, image) in zip(grid, optical.items(), strict=True):
    low, high = np.quantile(image, [0.01, 0.998])
    style.draw_frame(panels[0], np.clip((image - low) / max(high - low, 1.0), 0, 1), 4)
    panels[0].set(title=f"{name}: optical picture", ylabel="row (px)")
    for _, path in plots.broken_at_gaps(paths[paths["fraction"] == name]).groupby("particle"):
        panels[1].plot(path["col"], path["row"], "-", color="black", lw=0.5)
    panels[1].set(title=f"{name}: true paths", xlim=(0, 2047), ylim=(1535, 0), aspect="equal")
_ = [axes.set_xlabel("column (px)") for axes in grid[-1]]

# %%
caption = (
    f"Background plus the greatest difference from it in up to {frames} frames, after Fig. 5.13, "
    "beside the true paths of particles in the air. Made like Fig. 5.17 (notebook 54)."
)
figures.save("fig-5-13-optical-truth", paths, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Claims
#
# An order holds if all differences are positive. It fails if an interval ends at or below zero. A
# smoke run has two fractions and decides nothing.


# %%
def decide(every, fails):
    answer = True if np.all(every) else False if np.any(fails) else None
    return answer if len(windows) == 4 else None


by = {int(claim.split("-")[1]): part for claim, part in apart.groupby("claim")}
rises = {k: decide(part["recomputed"] > 0, part["high"] <= 0) for k, part in by.items()}
clear = {k: decide(part["low"] > 0, part["high"] < 0) for k, part in by.items()}
value = {k: part.set_index("fraction")["recomputed"].round(2) for k, part in by.items()}
risen = f"{(by[1]['recomputed'] > 0).sum()} of {len(by[1])} values rise"
raw = beside[(beside["postprocessing"] == "without") & beside["measure"].isin(["alpha", "beta"])]
raw = raw[raw["fraction"] != "wood chip"]
low = claims.all_of(rises[2], decide(raw["recomputed"] <= 0.43, raw["low"] > 0.43))
far = (by[3]["low"] > 0.05) | (by[3]["high"] < -0.05)  # "comparable" has no number: never True
after = measured.loc[measured["postprocessing"] == "with", ["alpha", "beta"]].mean().mean()
before = measured.loc[measured["postprocessing"] == "without", ["alpha", "beta"]].mean().mean()
lifted = claims.all_of(clear[9], decide(0.5 <= after <= 0.6, not 0.5 <= after <= 0.6))

gain, least = value[4].item(), value[5].nsmallest(1)

# %%
checks = [
    claims.check(
        "track-1", rises[1], risen, f"Without it alpha and beta are {before:.2f} on average."
    ),
    claims.check("track-2", low, raw["recomputed"].max(), "The largest value but for wood chips."),
    claims.check(
        "track-3", decide(False, far), value[3].min(), "Comparable has no number; 0.05 is ours."
    ),
    claims.check("track-4", clear[4], f"{gain:+.2f}", "JPDA - GNN, mean of alpha, beta, JSC."),
    claims.check("track-5", rises[5], least, "The smallest difference, mean of both trackers."),
    claims.check("track-9", lifted, after, "The mean must be in 0.5 to 0.6, the gain above zero."),
    claims.check("track-10", clear[10], value[10].item(), "Difference of counts, JPDA minus GNN."),
]
result = (
    f"Post-processing changes the track scores alpha and beta from {before:.2f} to {after:.2f} on "
    f"average (thesis: from 0.30 to 0.58). JPDA scores {gain:+.2f} beside GNN."
)
figures.conclude(result, checks, origin)
