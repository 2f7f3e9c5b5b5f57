# %% [markdown]
# # Sketches of post-processing: the printed rule also removes a correct position
#
# **The work.** Sketches of the thesis (sections 4.2.2 and 4.2.3, Figs 4.5 to 4.7, 4.9,
# 4.10 and 4.14) show which positions of a tracklet are outliers, and how two tracklets
# are joined.
#
# **Here.** Hand-made cases of the same kind pass our functions with the limits of Table
# 5.16. No claim is tested.
#
# **One number.** Outliers in situation 3 of Fig. 4.5: 1 printed, 1 here.
#
# **What disagrees.** With six positions, the rule as printed also removes a correct
# first position (Fig. 4.6).

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full: nothing here depends on it
seed = 0  # nothing here is drawn at random

# %%
from functools import partial

import numpy as np
import pandas as pd

from kilnflight import tracklets
from kilnflight.experiments import plots
from kilnflight.publication import figures, style
from kilnflight.tracklets import joining
from kilnflight.tracklets.paths import read_paths, turns, velocities

style.use_style()
origin = figures.trace("33_sketches", {"scale": scale}, seed=seed, mark="example")
save = partial(figures.save, provenance=origin)
outliers, connection = tracklets.STEPS[1:3]

# %% [markdown]
# ## Outliers
#
# A position is an outlier where the path turns by more than 30 degrees and the velocity
# changes by more than 18 px/frame (Eqs 4.18 to 4.20). Cases are velocities (row, col)
# in px/frame from each position to the next, and frames. By Eq. 4.17 a missed frame
# alone changes no velocity.

# %%
A = (2, 12)  # straight ahead
cases = {
    "situation 1: it turns": ([(-6, 8), (-5, 8), (4, 8), (6, 8)], [1, 2, 3, 4, 5]),
    "situation 2: it speeds up": ([A, A, (4, 34), (3, 14)], [1, 2, 3, 5, 6]),
    "situation 3: both": ([A, A, (-30, 14), (34, 10), A], [1, 2, 3, 4, 5, 6]),
    "four positions": ([(-30, 12), (34, 12), A], [1, 2, 3, 4]),
    "six positions": ([(-30, 12), (34, 12), A, A, A], [1, 2, 3, 4, 5, 6]),
    "the first position": ([(42, 7), A, A, A, A], [1, 2, 3, 4, 5, 6]),
    "the last position": ([A, A, A, A, (-36, 10)], [1, 2, 3, 4, 5, 6]),
}


# %%
class SecondAlone(tracklets.OutlierRemoval):
    """Eq. 4.20 at the second position alone, not backwards from the last one."""

    def first_outlier(self, frame, place):
        first = super().first_outlier(frame, place)
        speed = velocities(frame, place)
        if first != 0 and self._turned(speed[1:2], speed[2:3]).any():
            return 1
        return first


parts = []
for case, (steps, frames) in cases.items():
    moved = np.array(steps, float) * np.diff(frames)[:, None]
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(moved, axis=0)])
    part = pd.DataFrame(
        {"case": case, "frame": frames, "row": place[:, 0], "col": place[:, 1]}
    )
    speed = velocities(np.array(frames), place)
    angle, change = turns(speed[:-1], speed[1:])
    sharp = np.flatnonzero((angle > outliers.angle_deg) & (change > outliers.change))
    part["turn_deg"] = [np.nan, *angle, np.nan]
    part["change_px_frame"] = [np.nan, *change, np.nan]
    # Eq. 4.18 removes the position after the first turn.
    part["forwards"] = np.isin(np.arange(len(part)), sharp[:1] + 2)
    for column, rule in (("removed", outliers), ("alone", SecondAlone())):
        part[column] = rule(part.assign(particle=0))["particle"] < 0
    parts.append(part)
judged = pd.concat(parts, ignore_index=True)

# %% [markdown]
# In situation 3 only T4 goes in the thesis. The second position is examined backwards
# from the last one: T4 is the first to meet Eq. 4.20, so the second stays. Eq. 4.20
# alone would take T2 and T3 as well. With five positions or more, the first one is
# compared with the mean of the next three velocities before the backward scan, and goes
# too (Fig. 4.6). The caption of Fig. 4.7 speaks of the last velocities instead; the
# forward scan judges those anyway. Numbers in the pictures are the turn and the change
# of velocity.

# %%
third = "situation 3: both"
situations = [  # panels: title, case, column of what is removed
    *((title, title, "removed") for title in list(cases)[:3]),
    ("Eq. 4.20 at the second alone", third, "alone"),
]
backwards = [
    ("Eq. 4.18 forwards alone", "four positions", "forwards"),
    ("four positions", "four positions", "removed"),
    ("six positions", "six positions", "removed"),
]
ends = [
    ("the first position", "the first position", "removed"),
    ("the last position", "the last position", "removed"),
]


# %% tags=["hide-input"]
def draw_case(axes, part, out):
    plots.draw_places(axes, part[["row", "col"]], "k-", lw=0.6)
    plots.draw_places(axes, part.loc[~out, ["row", "col"]], "og", label="inlier")
    plots.draw_places(axes, part.loc[out, ["row", "col"]], "Xr", label="outlier")
    row = part["row"]
    near = np.fmin(row.shift(1), row.shift(-1)) - row
    odd = np.arange(len(part)) % 2 == 1
    above = (near > 0) | (odd & (near > -15))  # labels keep off the lines
    way = np.sign(row.diff()) + np.sign(row.shift(-1) - row)
    sides = way.map({-2: "right", 2: "left"}).fillna("center")
    points = zip(range(1, 7), part.itertuples(), above, sides, strict=False)
    for k, point, up, side in points:
        text = f"T{k}"
        if point.frame != k:
            text += f", frame {point.frame}"
        if point.change_px_frame > 0:
            text += f"\n{point.turn_deg:.0f}°, {point.change_px_frame:.0f} px/frame"
        look = {"xytext": (0, -7), "va": "top", "ha": "center"}
        if up:
            look = {"xytext": (0, 7), "va": "bottom", "ha": side}
        look |= {"textcoords": "offset points", "fontsize": 6}
        axes.annotate(text, (point.col, point.row), **look)
    axes.margins(0.2, 0.3)
    plots.label_pixels(axes)


# %% tags=["hide-input"]
def draw_cases(panels):
    """Draw panels; return the picture and their table."""
    rows = 1 + len(panels) // 4
    size = {"width_mm": style.PAGE_MM, "height_mm": 16 + 50 * rows}
    picture, grid = style.canvas(rows, len(panels) // rows, **size)
    for axes, (title, case, column) in zip(grid.flat, panels, strict=True):
        part = judged[judged["case"] == case]
        draw_case(axes, part, part[column])
        axes.set_title(title)
    entries = grid[-1, -1].get_legend_handles_labels()
    picture.legend(*entries, loc="outside lower center", ncols=2)
    table = judged[judged["case"].isin([case for _, case, _ in panels])]
    return {"table": table, "picture": picture}


caption = (
    "Three situations of an outlier, after Fig. 4.5: turn and change of velocity at "
    "each position. Hand-made, with the limits of Table 5.16."
)
save("fig-4-5-outliers", **draw_cases(situations), caption=caption)

# %%
caption = (
    "Outlier in second position, after Fig. 4.6: the rule forwards alone, and the "
    "whole rule with four and with six positions. Hand-made, with the limits of "
    "Table 5.16."
)
save("fig-4-6-backwards", **draw_cases(backwards), caption=caption)

# %%
caption = (
    "Outlier in first and in last position, after Fig. 4.7. Hand-made, with the limits "
    "of Table 5.16."
)
save("fig-4-7-ends", **draw_cases(ends), caption=caption)

# %% [markdown]
# ## Joined tracklets
#
# Two pairs with the frames of Fig. 4.10. Without common frames a pair is connected.
# With common frames it is merged, and each common position is the mean of both. Frames
# that only one of them has stay as they are, so a merged pair that lies apart zigzags
# (Fig. 4.9).

# %%
pairs = {
    "connection": ((1, 3, 4, 5, 7, 8), (11, 13, 14, 15, 16)),
    "merging": ((1, 3, 4, 5, 7, 9, 10, 11), (8, 9, 11, 13, 14, 15, 16)),
}
parts = []
for name, frames in pairs.items():
    particle = np.repeat([0, 1], [len(each) for each in frames])
    time = np.concatenate(frames)
    both = pd.DataFrame({"pair": name, "frame": time, "particle": particle})
    both["tracklet"] = np.where(particle, "Tk", "Ti")
    both["row"] = 40.0 + 0.35 * (time - 8.0) ** 2 + 9.0 * particle
    both["col"] = 10.0 * time
    paths = read_paths(both, name)
    first = np.array([0])
    ends = joining.overlap_in_time(paths, 0, 1)
    overlap = joining.Overlap(*np.transpose(ends[1:]))
    _, frame, place = joining.connected_parts(paths, first, first + 1, overlap)
    inside = pd.MultiIndex.from_arrays([frame, *place[:, :2].T])
    both["connected"] = both.set_index(["frame", "row", "col"]).index.isin(inside)
    joined = tracklets.tracked(connection(both)).assign(tracklet="Tj", connected=False)
    parts += [both, joined.sort_values("frame")]
table = pd.concat(parts, ignore_index=True)
table["cardinality"] = table.groupby(["pair", "tracklet"]).cumcount() + 1
table = table[["pair", "tracklet", "frame", "cardinality", "row", "col", "connected"]]


# %% tags=["hide-input"]
def draw_joined(axes, both):
    joined = both[both["tracklet"] == "Tj"]
    plots.draw_places(axes, joined[["row", "col"]], "^-k", mfc="white", label="Tj")


def draw_parts(axes, both):
    for point in both[both["tracklet"] != "Tj"].itertuples():
        shift = {"Ti": 8, "Tk": -30}[point.tracklet]
        look = {"xytext": (0, shift), "ha": "center", "fontsize": 6}
        look |= {"textcoords": "offset points", "rotation": 90}
        text = f"{point.frame} ({point.cardinality})"
        axes.annotate(text, (point.col, point.row), **look)
    connected = both.loc[both["connected"], ["row", "col"]]
    plots.draw_places(axes, connected, "ok", ms=11, mfc="none")


joined_caption = (
    "An earlier tracklet Ti and a later one Tk, connected over a gap and merged into "
    "Tj, after Fig. 4.9."
)
parts_caption = (
    "The same pairs with frame (time cardinality), after Fig. 4.10. Circled: the "
    "connected part, by which a pair is judged."
)
for identifier, draw, caption in (
    ("fig-4-9-joined", draw_joined, joined_caption),
    ("fig-4-10-parts", draw_parts, parts_caption),
):
    picture, (panels,) = style.canvas(1, 2, width_mm=style.PAGE_MM)
    for axes, (name, both) in zip(panels, table.groupby("pair"), strict=True):
        for tracklet, look in (("Ti", "ob"), ("Tk", "sr")):
            places = both.loc[both["tracklet"] == tracklet, ["row", "col"]]
            plots.draw_places(axes, places, look, label=tracklet)
        draw(axes, both)
        axes.margins(0.08, 0.55)
        axes.set_title(name)
        plots.label_pixels(axes)
    panels[0].legend()
    save(identifier, table, picture=picture, caption=caption)

# %% [markdown]
# ## Which pairs are joined first
#
# Dual nearest neighbours join what is cheapest for both. The Hungarian method gives up
# the cheapest pair for the least sum (Fig. 4.14).

# %%
earlier, later = np.array([[0, 0, 1, 1], [2, 3, 2, 3]])
possible = joining.Candidates(earlier, later, np.array([4.0, 2.0, 9.0, 3.0]))
instance = pd.DataFrame(possible._asdict())
instance[["earlier", "later"]] += 1
instance["dual_nearest"] = np.isin(np.arange(4), joining.dual_nearest(possible))
instance["hungarian"] = np.isin(np.arange(4), joining.hungarian(possible))
caption = (
    "Which of four possible pairs are joined first, in a case like that of Fig. 4.14."
)
save("fig-4-14-instance", instance, caption=caption)

# %% [markdown]
# ## Result

# %%
lost = judged.groupby("case")["removed"].sum()
one = lost[third]
two = lost["six positions"]
result = (
    f"Situation 3 has {one} outlier (printed 1). Of six positions with one outlier "
    f"the rule removes {two}."
)
figures.conclude(result, [], origin)
