# %% [markdown]
# # Post-processing of single tracklets
#
# **Published** (thesis, sections 4.2.1 to 4.2.3, Figs 4.4 to 4.7, 4.9, 4.10 and 4.12). Sketches
# of tracklets that are dropped, cut or joined: three conditions for a tracklet, three situations
# of an outlier, two ways to join a pair, the part that is judged, and the windows whose texture
# is measured.
#
# **Here.** Where the thesis sketches, a hand-made case of the same make goes through our
# functions. Where it can be a real tracklet, one of the twin's is taken by a stated rule. Table
# 5.16 gives all limits. No claim is tested.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full: frames of the windows
seed = 0  # of the scenes
jobs = 2  # processes of the detection

# %%
from dataclasses import replace

import pandas as pd

from kilnflight import tracklets
from kilnflight.experiments import campaigns, tracking, worked_examples
from kilnflight.experiments import tracklet_pictures as pictures
from kilnflight.project import figures, style
from kilnflight.tracking.tracker import track

style.use_style()
origin = figures.trace("35_worked_examples", {"scale": scale}, seed=seed, mark="example")
simulated = replace(origin, mark="simulated")  # tracklets of the windows
settings = campaigns.settings_from_labels(scale, seed)
windows = tracking.windows(scale, settings, seed, jobs=jobs)
elimination, outliers, connection, _ = tracklets.STEPS

# %% [markdown]
# ## False tracklets
#
# Tracklets of GNN in all windows, before any step (Fig. 4.4). Of those that pass all three
# conditions of Eq. 4.15 the one in the middle by each measure is drawn. So is the one in the
# middle of those that fail this condition alone. See how little the false ones have to show; the
# dashed line is the polynomial of second degree that the regularity is held against.

# %%
by_fraction = {window.fraction: track(window.detections) for window in windows}
tracks = pictures.pooled(by_fraction)
judged = pictures.judge_tracklets(tracks, elimination)
chosen = pictures.chosen_tracklets(judged)
picture = pictures.draw_eligible(tracks, chosen)
fails = judged["fails"].value_counts().rename({"": "none"})
caption = (
    "Eligible and false tracklets by each condition, after Fig. 4.4; all windows, simulated. "
    f"Of {len(judged)} tracklets so many fail, by what: "
    f"{', '.join(f'{name} {count}' for name, count in fails.items())}."
)
figures.save("fig-4-4-eligible", chosen, picture=picture, caption=caption, provenance=simulated)

# %% [markdown]
# ## Outliers
#
# Hand-made tracklets in the three situations of Fig. 4.5. Beside a position stand the turn and the
# change of velocity there; an outlier follows where they exceed 30 degrees and 18 px/frame. By Eq.
# 4.17 a missed frame alone changes no velocity, so in situation 2 the particle does speed up.
#
# See situation 3: in the thesis only T4 goes. The second position "is examined backwards from the
# last one": going back, T4 is the first to meet Eq. 4.20, so the second is not to blame. That is
# our default. Eq. 4.20 alone, without going back, looks at the turn at T3, which T4 causes. It
# takes T2 and then T3 as well.

# %%
table = worked_examples.judge_outliers(worked_examples.SITUATIONS, outliers)
by = {case: (case, "removed") for case in worked_examples.SITUATIONS}
by["situation 3: Eq. 4.20 at the second alone"] = ("situation 3: both", "alone")
picture = worked_examples.draw_outliers(table, by)
caption = (
    "Three situations of an outlier, after Fig. 4.5, and the third in the other reading of Eq. "
    "4.20; hand-made, limits of Table 5.16. Numbers: turn and change of velocity."
)
figures.save("fig-4-5-outliers", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# The second position is off. Forwards only, Eq. 4.18 blames the third; judged backwards (Eq.
# 4.20), the second goes (Fig. 4.6). With five positions or more the text judges the first one
# "before the backward scanning", by the mean of the next three velocities. It goes too, though
# nothing is wrong with it: so the text has it, and no reading of the order spares it.

# %%
table = worked_examples.judge_outliers(worked_examples.SECOND, outliers)
by = {"forwards only": ("four positions", "forwards")}
by |= {
    "backwards too": ("four positions", "removed"),
    "six positions": ("six positions", "removed"),
}
picture = worked_examples.draw_outliers(table, by)
caption = (
    "An outlier in the second position, forwards only and backwards too, after Fig. 4.6. On the "
    "right with two more positions, where the first is judged before it. Hand-made."
)
figures.save("fig-4-6-backwards", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# The first position is held against the mean of the next three velocities, as the text has it. The
# caption of Fig. 4.7 speaks of the last one, which the forward scan judges anyway.

# %%
table = worked_examples.judge_outliers(worked_examples.ENDS, outliers)
by = {case: (case, "removed") for case in worked_examples.ENDS}
picture = worked_examples.draw_outliers(table, by)
caption = "An outlier at the first and at the last position, after Fig. 4.7. Hand-made."
figures.save("fig-4-7-ends", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Joined tracklets
#
# Two pairs with the frames of Fig. 4.10. Without common frames a pair is connected. With common
# frames it is merged, each common position the mean of both. Frames that only one of them has
# stay as they are, so a merged pair that lies apart zigzags (Fig. 4.9).

# %%
frames = {"connection": worked_examples.CONNECTED, "merging": worked_examples.MERGED}
pairs = {name: worked_examples.joined_example(both, connection) for name, both in frames.items()}
table = pd.concat(pairs, names=["pair"]).reset_index("pair")
picture = worked_examples.draw_joined(pairs, parts=False)
caption = "Two tracklets connected over a gap and two merged, after Fig. 4.9. Hand-made."
figures.save("fig-4-9-joined", table, picture=picture, caption=caption, provenance=origin)

# %%
picture = worked_examples.draw_joined(pairs, parts=True)
caption = (
    "The same pairs with frame and, in brackets, time cardinality of each position, after Fig. "
    "4.10. Dashed: the connected part, by which the pair is judged. Hand-made."
)
figures.save("fig-4-10-parts", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Windows of the texture
#
# Pairs that were joined in any window, on the sum of frame differences (Fig. 4.12). Of each kind
# the one with the longest window is drawn. Within the window the energy of Eq. 4.24 is measured:
# see whether a streak runs from the one tracklet to the other.

# %%
before = {name: outliers(elimination(table)) for name, table in by_fraction.items()}
joints = pictures.joined_in(windows, before, connection)
longest = pictures.chosen_joins(joints)
picture = pictures.draw_windows(windows, before, longest, connection.feature)
merged = (joints["kind"] == "merging").sum()
caption = (
    "Windows of the texture on the sum of frame differences, after Fig. 4.12; simulated. Of "
    f"{len(joints)} joints, {merged} of them mergings, the longest of each kind; a kind that did "
    "not occur is not drawn."
)
figures.save("fig-4-12-windows", joints, picture=picture, caption=caption, provenance=simulated)

# %%
result = (
    f"{fails.get('none', 0)} of {len(judged)} tracklets are eligible, "
    f"and {len(joints)} joints are made of them. An outlier in the fourth position goes alone if "
    "the second is examined from the last one back. A wrong second one costs the first as well. "
    "No claim is tested here."
)
figures.conclude(result, [], origin)
