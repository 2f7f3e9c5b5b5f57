# %% [markdown]
# # Tracking: whether post-processing helps depends on how unlit particles tumble
#
# **The work.** The thesis tracks four fractions with GNN and JPDA (sections 5.2.1 to
# 5.2.3, Tables 5.15 and 5.17). Post-processing raises all four measures, and JPDA is
# slightly ahead. Alpha is 1 if every true trajectory is tracked exactly, and beta is
# lower by what false tracks cost. JSC is the share of matched positions, JSC_theta that
# of matched tracks, among all that are true or tracked.
#
# **Here.** Simulated campaigns at 4.5 bar, in windows with about as many whole
# trajectories as Table 5.15. The truth is what a person would note. Detections are
# those of SIFT and DBSCAN combined that are not known to be on the wall. Seven choices
# that the thesis does not print (T1 to T5, T7, T8) are shown with both values.
#
# **One number.** Alpha of wood chips, GNN with post-processing: 0.67 printed, 0.17
# here.
#
# **What disagrees.** Alpha and beta change from 0.386 to 0.369 on average, which is
# within chance; print doubles them. JSC_theta doubles to 0.643. If unlit particles do
# not tumble (T7), alpha and beta change from 0.508 to 0.565. They rise by 0.01 if the
# truth has all visible positions (T4), and by 0.02 if windows are chosen by flights
# that start in them (T5).
# Raw tracks of confetti have an alpha of 0.69, 0.05 in print. Chips are tracked worst;
# in print they are best. With post-processing GNN is 0.04 ahead of JPDA, within chance.

# %% tags=["parameters"]
scale = "standard"  # quick (two fractions), standard or full
seed = 0  # of the scenes
jobs = 2  # processes of the detection

# %%
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pandas as pd

from kilnflight import tracklets
from kilnflight.experiments import plots
from kilnflight.experiments.flights import (
    campaigns,
    ignition,
    panels,
    trackers,
    tracking,
)
from kilnflight.experiments.flights import track_scores as scores
from kilnflight.publication import choices, claims, figures, style
from kilnflight.simulated.kiln import scenes

style.use_style()
origin = figures.trace("32_tracking", {"scale": scale}, seed=seed)
save = partial(figures.save, provenance=origin)
detected = partial(
    tracking.windows,
    scale,
    campaigns.settings_from_labels(scale, seed),
    seed,
    jobs=jobs,
)
windows = detected()

# %% [markdown]
# ## Windows
#
# Of each campaign, the frames whose whole flights from the lance are nearest in number
# to the trajectories of Table 5.15. In the 100 frames of shreds few flights can be
# whole, so all that start there count. Scored are also flights that the window cuts, if
# they last 15 frames in it. With chips and granules nearly all detections of no
# particle are clutter (D9), far from any.

# %%
printed = claims.published("table_5.15")
amount = printed["amount_of_trajectories"].set_axis(printed["fraction"].str.lower())
counted = pd.DataFrame([tracking.count_window(window) for window in windows])
counted["trajectories_published"] = counted["fraction"].str.lower().map(amount)
caption = (
    "Windows of the campaigns beside Table 5.15. Trajectories: all that a person would "
    "note; from lance: those scored. Of no particle: detections over 10 px from all "
    "visible positions."
)
save("table-5-15-windows", counted, caption=caption)

# %% [markdown]
# ## Settings
#
# Table 5.16 has the values of post-processing, none of the trackers. Both limits of Eq.
# 4.14 are identified by the eight JSC_theta without post-processing of Table 5.17, so
# these eight numbers test nothing (identify/tracker_limits.py). The fit misses them by
# 0.17, and the next settings are nearly as good. The second table has the misfit of
# each setting that was tried. All other settings are assumptions.

# %%
save(
    "tracker-settings",
    trackers.settings().reset_index(),
    caption="Settings of both trackers and what decides them. No work prints any.",
)

# %%
caption = (
    "Limits of Eq. 4.14 tried on the full windows: sum of squared differences of "
    "JSC_theta without post-processing from Table 5.17, and the eight values."
)
save("tracker-limits", trackers.limits(), caption=caption)

# %% [markdown]
# ## Table 5.17
#
# Scored are tracks that start at the lance, with and without post-processing alike: it
# is the last step of section 4.2.5, and the truth is of such particles. True
# trajectories must also last (section 5.2.1). The distance is the bare epsilon of Table
# 5.16, 10 px, and positions are those detected.

# %%
ours = {name: trackers.chosen(name) for name in scores.TRACKERS}
tracked = {}
for window, (name, tracker) in product(windows, ours.items()):
    tracks = tracker(window.detections)
    # Without and with the four steps of notebook 31.
    tracked[window.fraction, name] = tracking.processed(window, tracks)
cells = tracking.cells(windows, tracked)

# %%
measured = scores.tabulate(cells)
wide = scores.published().pivot(
    index=scores.KEYS, columns="measure", values="published"
)
table = measured.merge(wide.add_suffix("_published").reset_index(), how="left")
caption = (
    "GNN and JPDA with and without post-processing beside Table 5.17: tracks from the "
    "lance, scoring distance 10 px, 95 % intervals (bootstrap over true tracks; none "
    "with fewer than six)."
)
save("table-5-17-tracking", table, caption=caption)

# %% [markdown]
# The same values as a picture. Its CSV also has the differences that section 5.2.3
# speaks of. An entry "A - B" is a difference. Both sides are drawn with the same true
# trajectories, so it is paired.

# %%
beside = scores.beside_published(measured)
table = pd.concat([beside, scores.differences(cells)], ignore_index=True)

# %% tags=["hide-input"]
picture, grid = style.canvas(
    2, 2, sharex=True, sharey=True, width_mm=style.PAGE_MM, height_mm=130
)
for axes, (measure, part) in zip(grid.flat, beside.groupby("measure"), strict=True):
    part = part.pivot(index=["fraction", "tracker"], columns="postprocessing")
    axes.set_title(plots.SYMBOLS[measure])
    place = -np.arange(len(part))
    axes.set_yticks(place, part.index.map(", ".join))
    for stage, shift, face in (("without", 0.2, "white"), ("with", -0.1, None)):
        y = place + shift
        axes.hlines(y, part["low", stage], part["high", stage])
        label = f"recomputed, {stage}"
        axes.plot(part["recomputed", stage], y, "ok", mfc=face, label=label)
        axes.plot(part["published", stage], y, **{**style.PUBLISHED, "mfc": face})
picture.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)
caption = (
    "The values of Table 5.17 recomputed, with 95 % intervals (lines), and published, "
    "without (open) and with post-processing (filled). The CSV adds paired "
    "differences."
)
save("tracking-scores", table, picture=picture, caption=caption)

# %% [markdown]
# ## Tracks beside the true trajectories

# %% tags=["hide-input"]
shown = [window for window in windows if window.fraction in ("wood chip", "PE granule")]
picture, grid = style.canvas(5, len(shown), width_mm=150, height_mm=200)
tables = {}
for window, column in zip(shown, grid.T, strict=True):
    fraction = window.fraction
    drawn = {"truth": window.truth}
    for name in ours:
        for stage, tracks in tracked[fraction, name].items():
            drawn[f"{name} {stage} post-processing"] = tracks
    frames = window.frames
    light = window.differences[frames.start : frames.stop, :, :].sum(axis=0)
    for axes, (name, tracks) in zip(column, drawn.items(), strict=True):
        tables[fraction, name] = tracks
        style.draw_frame(axes, light, 8)
        style.draw_tracks(axes, tracklets.tracked(tracks), "0.55")
        style.draw_tracks(axes, scores.from_lance(tracks, window.lance))
        axes.set_title(f"{fraction}: {name}")
caption = (
    "Trajectories of the truth, of GNN and of JPDA, without and with post-processing, "
    "on the sum of frame differences; after Figs 5.12, 5.14 and 5.15. Colour: tracks "
    "from the lance; grey: others. Black: the burner's flame, cut out."
)
save(
    "fig-5-12-trajectories",
    tracking.joined_tables(tables, "tracks"),
    picture=picture,
    caption=caption,
)

# %% [markdown]
# ## Optical ground truth
#
# Paths become visible in the background plus the greatest difference of each pixel from
# it.

# %% tags=["hide-input"]
count = {"quick": 5, "standard": 50, "full": 300}[scale]
rows = len(windows)
picture, grid = style.canvas(
    rows, 2, sharex=True, sharey=True, width_mm=style.PAGE_MM, height_mm=62.5 * rows
)
parts = []
for window, (left, right) in zip(windows, grid, strict=True):
    name = window.fraction
    twin = window.differences.source.recording()
    frames = scenes.tracking_window(twin)[:count]
    image = ignition.optical_picture(twin, frames)
    panels.draw_stretched(left, image, (0.01, 0.998), step=4)
    left.set_title(name)
    path = tracking.flying_paths(twin, frames)
    style.draw_tracks(right, plots.broken_at_gaps(path), "black")
    right.set(aspect="equal", xlabel="column (px)")
    parts.append(path.assign(fraction=name))
caption = (
    f"Background plus the greatest difference from it in up to {count} frames, after "
    "Fig. 5.13, beside the true paths of particles in the air. Made like Fig. 5.17 "
    "(notebook 54)."
)
save("fig-5-13-optical-truth", pd.concat(parts), picture=picture, caption=caption)

# %% [markdown]
# ## How claims are judged
#
# An order holds if all differences are positive. It fails if the upper end of an
# interval is at or below zero. Where a claim has one difference, its whole interval
# must lie on one side of zero. A smoke run has two fractions and decides nothing. The
# comments name the differences behind each claim; `tracking-scores` has them all.


# %%
def decide(holds, fails):
    """Return True if all hold, False if any fails, else None: open."""
    if len(windows) < 4:
        return None
    if np.all(holds):
        return True
    return False if np.any(fails) else None


def above_zero(part):
    return decide(part["recomputed"] > 0, part["high"] <= 0)


def beyond_chance(part):
    return decide(part["low"] > 0, part["high"] < 0)


def means(cells, measures):
    """Return the mean without and the mean with post-processing."""
    stages = scores.tabulate(cells).groupby("postprocessing")
    mean = stages[measures].mean().mean(axis=1)
    return mean["without"], mean["with"]


# %%
def judge(cells):
    by = dict(iter(scores.differences(cells).groupby("claim")))
    gains = by["track-1"].query("measure != 'jsc_theta'")  # with - without
    rising = f"{(gains['recomputed'] > 0).sum()} of {len(gains)} values rise"
    reason = "JSC_theta is left out, since its raw values are inputs."
    yield claims.check("track-1", above_zero(gains), rising, reason)
    largest = 0.43  # of all fractions but chips, in print
    raw = scores.beside_published(scores.tabulate(cells)).query(
        "postprocessing == 'without' and measure in ['alpha', 'beta'] "
        "and fraction != 'wood chip'"
    )
    others_low = decide(raw["recomputed"] <= largest, raw["low"] > largest)
    low = claims.all_of(above_zero(by["track-2"]), others_low)  # chips - others
    reason = "The largest value but for wood chips."
    yield claims.check("track-2", low, raw["recomputed"].max(), reason)
    apart = by["track-3"]  # JPDA - GNN: alpha and beta of each fraction
    far = (apart["low"] > 0.05) | (apart["high"] < -0.05)
    comparable = decide(False, far)  # "comparable" has no number: it never holds
    farthest = apart["recomputed"].abs().max()
    reason = "Largest absolute difference; fails if an interval is beyond 0.05 (ours)."
    yield claims.check("track-3", comparable, farthest, reason)
    ahead = by["track-4"]  # JPDA - GNN: mean of fractions and measures
    gain = f"{ahead['recomputed'].item():+.2f}"
    reason = "JPDA - GNN, mean of alpha, beta, JSC."
    yield claims.check("track-4", beyond_chance(ahead), gain, reason)
    ranks = by["track-5"].set_index("fraction")  # alpha: chips - others - confetti
    least = ranks["recomputed"].round(2).nsmallest(1)
    reason = "The smallest difference, mean of both trackers."
    yield claims.check("track-5", above_zero(ranks), least, reason)
    # with - without: mean of fractions, trackers, alpha and beta
    _, after = means(cells, ["alpha", "beta"])
    in_range = 0.5 <= after <= 0.6
    lifted = claims.all_of(beyond_chance(by["track-9"]), decide(in_range, not in_range))
    reason = "The mean must be in 0.5 to 0.6, with a gain."
    yield claims.check("track-9", lifted, after, reason)
    more = by["track-10"]  # JPDA - GNN: false tracks of paper shreds
    reason = "Difference of counts, JPDA minus GNN."
    yield claims.check(
        "track-10", beyond_chance(more), more["recomputed"].item(), reason
    )


# %% [markdown]
# ## Choices
#
# The other value of each choice, on the same detections where the frames are the same.
# T1: the energy of a streak is divided by the pixels. T2: the limits that gave the
# largest beta on other frames, 5 (GNN) and 27 (JPDA) missed frames. T3: short tracks
# are dropped before they are scored. T4: all visible positions are true ones. T8: gaps
# of the truth are straight lines. In a full run alone, detected anew: windows by the
# flights that start in them (T5), and unlit particles that do not tumble (T7).
# `tracking.follow_all` is the loop of Table 5.17 with other trackers or windows.


# %%
elimination, outliers, *joining = tracklets.STEPS
steps = [elimination, outliers, *(replace(step, average=True) for step in joining)]
averaged = {}
long = {}
for window, name in product(windows, ours):
    key = (window.fraction, name)
    stages = tracked[key]
    averaged[key] = tracking.processed(window, stages["without"], steps)
    long[key] = {stage: scores.lasting(tracks) for stage, tracks in stages.items()}
earlier = {
    name: trackers.chosen(name, visibility=0.4, missed_frames=most)
    for name, most in (("GNN", 5), ("JPDA", 27))
}
every = [each._replace(truth=each.visible) for each in windows]
bridged = [each._replace(truth=tracking.without_gaps(each.truth)) for each in windows]
others = {
    "T1": tracking.cells(windows, averaged),
    "T2": tracking.cells(windows, tracking.follow_all(windows, earlier)),
    "T3": tracking.cells(windows, long),
    "T4": tracking.cells(every, tracked),
    "T8": tracking.cells(bridged, tracked),
}
if scale == "full":
    anew = {"T5": detected(by_starts=True), "T7": detected(scenario="steady-bodies")}
    for choice, other in anew.items():
        others[choice] = tracking.cells(other, tracking.follow_all(other, ours))

# %% [markdown]
# What a person notes (T4): by fraction, the visible positions of true trajectories and
# those noted, and the measures of GNN with post-processing against both.


# %%
def of_gnn(cells):
    rows = scores.tabulate(cells).query("tracker == 'GNN' and postprocessing == 'with'")
    return rows.set_index("fraction")[list(scores.MEASURES)]


notes = counted[["fraction", "positions_visible", "positions"]].rename(
    columns={"positions": "positions_noted"}
)
notes["share_not_noted"] = 1 - notes["positions_noted"] / notes["positions_visible"]
both = of_gnn(cells).join(of_gnn(others["T4"]).add_suffix("_all"))
caption = (
    "True positions that a person notes, lighter than the kiln by 4 of 255 steps, of "
    "all that are visible. Measures of GNN with post-processing against those noted, "
    "and against all."
)
save("tracking-notes", notes.join(both, on="fraction"), caption=caption)


# %%
def rise(cells, measures):
    """Return the means without and with post-processing as text."""
    before, after = means(cells, measures)
    return f"{before:.3f} -> {after:.3f}".replace("nan -> nan", "-")


checks = list(judge(cells))
quantities = {
    "alpha and beta without -> with post-processing, mean": ["alpha", "beta"],
    "JSC_theta without -> with post-processing, mean": ["jsc_theta"],
}
compared = []
for choice, other in others.items():
    turns = choices.turned(checks, judge(other))
    for quantity, measures in quantities.items():
        compared.append(
            choices.compare(
                choice,
                quantity,
                chosen=rise(cells, measures),
                other=rise(other, measures),
                turns=turns,
            )
        )

# %% [markdown]
# ## Result

# %%
before, after = means(cells, ["alpha", "beta"])
result = (
    "Post-processing changes alpha and beta, agreement with true tracks from 0 to 1, "
    f"from {before:.2f} to {after:.2f} on average (thesis: from 0.30 to 0.58)."
)
if "T7" in others:
    raw, joined = means(others["T7"], ["alpha", "beta"])
    result += (
        " If unlit particles do not tumble, it changes them from "
        f"{raw:.2f} to {joined:.2f}."
    )
figures.conclude(result, checks, origin, choices=compared)
