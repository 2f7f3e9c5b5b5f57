# %% [markdown]
# # Data association: NN fails in a crowd, GNN does not, and PDA and JPDA lie in between
#
# **The work.** The thesis sketches how NN, GNN, PDA and JPDA link detections to tracks
# (sections 2.3.2 to 2.3.4, 3.3, 4.1.2 and 4.1.3, Figs 2.20 to 2.23, 3.13 and 4.2). JPDA
# sums over joint events, and the gate is an elliptical cylinder.
#
# **Here.** The sketches have no scales. These are hand-made cases of the same kind,
# computed by the functions that track the recordings. No claim is tested.
#
# **One number.** Joint events of the example of Fig. 2.23: 11 printed, 11 here.
#
# **What disagrees.** Nothing that is tested here.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full: nothing here depends on it
seed = 0  # of the scatter of the flight in Fig. 4.2

# %%
from functools import partial
from itertools import pairwise, product

import numpy as np
import pandas as pd
from matplotlib.patches import Ellipse
from scipy.spatial.distance import cdist

from kilnflight.association import ASSOCIATORS, joint_probabilities
from kilnflight.experiments import plots
from kilnflight.publication import figures, style
from kilnflight.scores import score_detections
from kilnflight.tracking import tracker
from kilnflight.tracking.filter import Detected, Gate

style.use_style()
origin = figures.trace("30_association", {"scale": scale}, seed=seed, mark="example")
save = partial(figures.save, provenance=origin)


def draw_gate(axes, place, height, width):
    """Draw the ellipse of a gate; place is (row, col), all in px."""
    axes.add_patch(Ellipse(place[::-1], width, height, fill=False, ec="0.6"))


# %% [markdown]
# ## Three situations, four associators
#
# Two tracks fly to the right, track 1 above track 2. Their next places (row, column, in
# px) are predicted with standard deviations of 4 px across and 6 px along the flight.
# D1 belongs to track 1, D2 to track 2, and N1 is clutter. In the crowd D2 is the
# nearest detection of both tracks. Lines in the picture are as wide as their weights.
# Triangles mark the predictions and detections averaged by their weights (Eq. 2.53). A
# track without a line stays.


# %%
def draw_panel(axes, tracks, detections, beta):
    for i, place in enumerate(tracks):
        draw_gate(axes, place, height=24, width=36)  # three standard deviations
        for weight, detection in zip(beta[i, 1:], detections, strict=True):
            plots.draw_places(axes, [place, detection], "k-", lw=4 * weight)
    means = beta[:, :1] * tracks + beta[:, 1:] @ detections
    plots.draw_places(axes, tracks, "ow", label="predicted")
    plots.draw_places(axes, detections[:2], "sb", label="detected")
    plots.draw_places(axes, detections[2:], "Xr", label="clutter")
    plots.draw_places(axes, means, "^y", label="weighted mean")
    axes.set(aspect="equal", xlim=(-34, 20), ylim=(40, -14))


# %%
situations = {  # row of T2; D1, D2 and N1
    "apart": (26, [[-4, 8], [30, -7]]),
    "crowded": (12, [[-5, 9], [5, -7]]),
    "clutter": (26, [[-5, 9], [30, -7], [5, -6]]),
}
names = ("NN", "GNN", "PDA", "JPDA")
spread = np.diag([16.0, 36.0])
rows = []
picture, grid = style.canvas(
    4, 3, sharex=True, sharey=True, width_mm=110, height_mm=150
)
for panels, (case, (second, places)) in zip(grid.T, situations.items(), strict=True):
    tracks = np.array([[0.0, 0.0], [second, 0.0]])
    detections = np.array(places, float)
    pairs = Gate(distance=3.0)(tracks, np.stack([spread, spread]), Detected(detections))
    for axes, name, associator in zip(panels, names, ASSOCIATORS, strict=True):
        beta = np.zeros((2, 1 + len(places)))  # tracks; none, D1, D2, N1
        beta[pairs.track, 1 + pairs.detection] = associator(pairs)
        beta[:, 0] = 1.0 - beta.sum(axis=1)
        draw_panel(axes, tracks, detections, beta)
        axes.annotate("T1", (-32, 2))
        axes.annotate("T2", (-32, second + 2))
        axes.set_title(f"{name}, {case}")
        for (i, j), weight in np.ndenumerate(beta):
            row = {"situation": case, "associator": name, "track": f"T{i + 1}"}
            row["detection"] = ("none", "D1", "D2", "N1")[j]
            rows.append({**row, "weight": weight})
weights = pd.DataFrame(rows)

# %%
grid[3, 1].set_xlabel("column (px)")
grid[1, 0].set_ylabel("row (px)")
entries = grid[0, 0].get_legend_handles_labels()
picture.legend(*entries, loc="outside upper center", ncols=4)
caption = (
    "Two tracks T1 and T2, their gates (ellipses) and four associators, after Figs "
    "2.20 to 2.22; hand-made. Lines are as wide as the weight of a detection."
)
save("fig-2-20-associations", weights, picture=picture, caption=caption)

# %% [markdown]
# ## Joint events
#
# The example of Fig. 2.23: D1 and D2 lie in the gate of track 1; D2, D3 and D4 in that
# of track 2. With all detections in both gates there would be 21 events (Eq. 2.62).
# With equal likelihoods each of them is equally probable, and $\beta$ (Eq. 2.64) is
# their mean. The last two columns are each track's probabilities over all joint events,
# and for each track alone.

# %%
inside = np.array([[1.0, 1, 0, 0], [0, 1, 1, 1]])  # tracks, detections
choices = product((0, 1), (0, 1, 2), (0, 2), (0, 2))  # the track of D1 to D4; 0: none
events = [event for event in choices if event.count(1) < 2 and event.count(2) < 2]
owned = np.array(events)[:, :, None] == [1, 2]  # events, detections, tracks
none = ~owned.any(axis=1, keepdims=True)
held = np.concatenate([none, owned], axis=1).astype(int)
alone = [joint_probabilities(row[None], [1.0])[0] for row in inside]
table = pd.DataFrame(
    {
        "track": ["T1", "T2"] * 5,
        "detection": np.repeat(["none", "D1", "D2", "D3", "D4"], 2),
        "joint": joint_probabilities(inside, np.ones(2)).T.ravel(),
        "sum_over_events": held.mean(axis=0).ravel(),
        "independent": np.transpose(alone).ravel(),
    }
)
for k, each in enumerate(held, 1):
    table[f"event_{k}"] = each.ravel()
table["events"] = len(events)

# %% tags=["hide-input"]
picture, ((axes,),) = style.canvas(width_mm=140, height_mm=80)
shares = table[["joint", "independent"]]
shown = table.filter(like="event_").join(shares)
axes.pcolormesh(shown, cmap="gray_r", vmax=1, ec="0.6")
for (k, column), share in np.ndenumerate(shares):
    axes.annotate(f"{share:.2f}", (11.5 + column, k + 0.5), ha="center", va="center")
axes.set_xticks(0.5 + np.arange(13), [*range(1, 12), "joint", "alone"])
axes.set_yticks(0.5 + np.arange(10), table["track"] + ", " + table["detection"])
axes.set_xlabel("joint event; probability")
axes.invert_yaxis()
caption = (
    f"The {len(events)} joint events, after Fig. 2.23. Rows: track and its detection; "
    "black: assigned in this event. Numbers: the probabilities over all events (joint) "
    "and of each track alone."
)
save("fig-2-23-events", table, picture=picture, caption=caption)

# %% [markdown]
# ## The gate in flight
#
# A particle flies through twelve frames and is not detected in three of them (another
# one far away keeps the frames coming). In frame 3 clutter lies within the ellipse, but
# 2.6 m nearer; in frame 10 the particle has no depth. The tracker runs with its
# defaults.

# %%
frame = np.arange(12)
random = np.random.default_rng(seed)
noise = random.normal(0, 1.0, (12, 2))
flight = pd.DataFrame({"frame": frame, "row": 40.0 + 3 * frame + noise[:, 0]})
flight["col"] = 20.0 + 26 * frame + noise[:, 1]
flight["z"] = 5000.0 + 60 * frame + random.normal(0, 200, 12)
flight.loc[10, "z"] = np.nan
other = flight.assign(row=flight["row"] + 500, z=5000.0, origin="other particle")
# Clutter is shifted in frame, row, col (px) and z (mm).
clutter = (flight[frame == 3] + [0, 6, -7, -2600]).assign(origin="clutter")
flight = flight.drop(index=[5, 6, 7]).assign(origin="particle")
seen = pd.concat([flight, other, clutter], ignore_index=True)
parts = []
for before, step in pairwise(tracker.steps(seen)):
    pairs = step.pairs
    plane = Gate(depth_mm=np.inf)(pairs.expected, pairs.residual, step.detected)
    part = seen.iloc[step.detected.rows].copy()
    part[["expected_row", "expected_col"]] = pairs.expected[0]
    part["expected_z"] = before.tracks["depth_mm"][0]
    part["in_ellipse"] = np.isin(range(len(part)), plane.detection[plane.track == 0])
    reach = Gate().distance * np.sqrt(pairs.residual[0].diagonal())
    part[["reach_row_px", "reach_col_px"]] = reach
    part["in_gate"] = np.isin(range(len(part)), pairs.detection[pairs.track == 0])
    parts.append(part)
table = pd.concat(parts, ignore_index=True)

# %% tags=["hide-input"]
picture, ((flat,), (deep,)) = style.canvas(2, height_mm=84)
gates = table.drop_duplicates("frame")
for gate in gates.itertuples():
    place = (gate.expected_row, gate.expected_col)
    draw_gate(flat, place, 2 * gate.reach_row_px, 2 * gate.reach_col_px)
    flat.annotate(gate.frame, (gate.expected_col, 125), ha="center")
depth = gates["expected_z"]
deep.fill_between(gates["frame"], depth - 1500, depth + 1500, step="mid", color="0.88")
for kind, look in (("particle", "sb"), ("clutter", "Xr")):
    part = table[table["origin"] == kind]
    plots.draw_places(flat, part[["row", "col"]], look)
    plots.draw_places(deep, part[["z", "frame"]], look)
flat.set(aspect="equal", ylim=(-25, 130))
plots.label_pixels(flat)
deep.set(xlabel="frame", ylabel="depth z (mm)")
caption = (
    "Gates of a track in frames 1 to 11 (numbers), in the picture (circles) and in "
    "depth (grey: 1.5 m about the last known one), after Fig. 4.2. Squares: the "
    "particle, missed in frames 5 to 7 and without depth in frame 10. Cross: clutter, "
    "refused by its depth."
)
save("fig-4-2-gate", table, picture=picture, caption=caption)

# %% [markdown]
# ## Detections and particles
#
# How a frame is scored (Eq. 3.4, Fig. 3.13): five hand-made detections, five particles,
# 45 px. The pairs are those of the least sum: d1 is nearest to p2, but p1 has nothing
# else. No particle is near d4, a false positive; p3 is missed.

# %%
detected = np.array([[40.0, 60], [90, 70], [45, 210], [150, 150], [140, 250]])
particles = np.array([[20.0, 50], [62, 62], [100, 150], [50, 222], [150, 262]])
costs = pd.DataFrame(cdist(detected, particles), columns=["p1", "p2", "p3", "p4", "p5"])
costs = costs.where(costs <= 45.0)
costs.insert(0, "detection", ["d1", "d2", "d3", "d4", "d5"])

# %% tags=["hide-input"]
picture, ((axes,),) = style.canvas()
for particle, detection in score_detections(particles, detected).pairs:
    plots.draw_places(axes, [particles[particle], detected[detection]], "k-")
beside = {"textcoords": "offset points"}
for k in range(5):
    draw_gate(axes, detected[k], height=90, width=90)
    axes.annotate(f"p{k + 1}", particles[k, ::-1], (5, 0), **beside)
    axes.annotate(f"d{k + 1}", detected[k, ::-1], (-5, 0), ha="right", **beside)
plots.draw_places(axes, particles, "ow")
plots.draw_places(axes, detected, "sb")
axes.set_aspect("equal")
plots.label_pixels(axes)
caption = (
    "Five particles (p, white) and five detections (d, blue), after Fig. 3.13. Lines: "
    "assigned pairs; grey circles: 45 px around each detection. The CSV has the "
    "distances within 45 px."
)
save("fig-3-13-assignment", costs, picture=picture, caption=caption)

# %% [markdown]
# ## Result

# %%
own = weights.query("situation == 'crowded' and track == 'T1' and detection == 'D1'")
nn, gnn, pda, jpda = own["weight"]
result = (
    f"In the crowd the own detection of track 1 has the weight {nn:.2f} (NN), "
    f"{pda:.2f} (PDA), {jpda:.2f} (JPDA) and {gnn:.2f} (GNN)."
)
figures.conclude(result, [], origin)
