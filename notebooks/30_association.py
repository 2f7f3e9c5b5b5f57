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
from itertools import pairwise, product

import numpy as np
import pandas as pd
from scipy.sparse import coo_array
from scipy.spatial.distance import cdist

from kilnflight.association import ASSOCIATORS, joint_probabilities
from kilnflight.publication import figures, style
from kilnflight.scores.detections import DETECTION_GATE_PX, score_detections
from kilnflight.tracking import tracker
from kilnflight.tracking.filter import Detected, Gate

style.use_style()
origin = figures.trace("30_association", {"scale": scale}, seed=seed, mark="example")
gate = Gate(distance=3.0)
names = ("NN", "GNN", "PDA", "JPDA")
mark = {"mec": "black", "mew": 0.6, "ls": "", "ms": 5}
text = {"fontsize": 6.5, "va": "center", "ha": "center"}


def ellipse(axes, place, covariance, distance, **line):
    turn = np.linspace(0, 2 * np.pi, 200)
    edge = distance * np.linalg.cholesky(covariance) @ [np.cos(turn), np.sin(turn)]
    axes.plot(
        *(place[:, None] + edge)[::-1], **{"lw": 0.8, "ls": "-", "color": "0.6", **line}
    )


# %% [markdown]
# ## Three situations, four associators
#
# Two tracks fly to the right. Their next places (row, column, in px) are predicted with
# standard deviations of 4 px across and 6 px along the flight. D1 belongs to track 1,
# D2 to track 2, and N1 is clutter. In the crowd D2 is the nearest detection of both
# tracks. Lines in the picture are as wide as their weights. Diamonds mark the
# predictions and detections averaged by their weights (Eq. 2.53). A track without a
# line stays.

# %%
situations = {  # predictions of T1 and T2; D1, D2 and N1
    "apart": (np.array([[0.0, 0], [26, 0]]), np.array([[-4.0, 8], [30, -7]])),
    "crowded": (np.array([[0.0, 0], [12, 0]]), np.array([[-5.0, 9], [5, -7]])),
    "clutter": (
        np.array([[0.0, 0], [26, 0]]),
        np.array([[-5.0, 9], [30, -7], [5, -6]]),
    ),
}
spread = np.diag([16.0, 36.0])
rows = []
weights = {}
for case, (name, associator) in product(
    situations, zip(names, ASSOCIATORS, strict=True)
):
    found = gate(
        situations[case][0], np.stack([spread, spread]), Detected(situations[case][1])
    )
    shares = coo_array((associator(found), found[:2]), (2, found.detections)).toarray()
    weights[name, case] = np.column_stack([1.0 - shares.sum(axis=1), shares])
    for (i, j), weight in np.ndenumerate(weights[name, case]):
        rows.append((case, name, f"T{i + 1}", ["none", "D1", "D2", "N1"][j], weight))
table = pd.DataFrame(
    rows, columns=["situation", "associator", "track", "detection", "weight"]
)

# %% tags=["hide-input"]
picture, grid = style.canvas(
    4, 3, width_mm=132, height_mm=172, sharex=True, sharey=True
)
for axes, ((name, case), beta) in zip(grid.T.flat, weights.items(), strict=True):
    tracks, detections = situations[case]
    for i, place in enumerate(tracks):
        ellipse(axes, place, spread, gate.distance)
        axes.annotate(f"T{i + 1}", (-25, place[0]), **text)
        for weight, detection in zip(beta[i, 1:], detections, strict=True):
            axes.plot(
                *np.transpose([place, detection])[::-1], "-", color="0.3", lw=4 * weight
            )
    mean = beta[:, :1] * tracks + beta[:, 1:] @ detections
    axes.plot(*tracks.T[::-1], "ow", label="predicted", **mark)
    axes.plot(*detections[:2].T[::-1], "sb", label="detected", **mark)
    axes.plot(*detections[2:].T[::-1], "Xr", label="clutter", **mark)
    axes.plot(*mean.T[::-1], "Dy", label="weighted mean", **mark)
    axes.set(aspect="equal", xlim=(-29, 20), ylim=(40, -14), title=f"{name}, {case}")
picture.legend(
    *grid[0, 2].get_legend_handles_labels(), loc="outside upper center", ncols=4
)
picture.supxlabel("column (px)", fontsize=8)
picture.supylabel("row (px)", fontsize=8)
caption = (
    "Two tracks, their gates and four associators, after Figs 2.20 to 2.22; hand-made."
)
figures.save(
    "fig-2-20-associations", table, picture=picture, caption=caption, provenance=origin
)

# %% [markdown]
# ## Joint events
#
# The example of Fig. 2.23: D1 and D2 lie in the gate of track 1; D2, D3 and D4 in that
# of track 2. With all detections in both gates there would be 21 events (Eq. 2.62).
# With equal likelihoods each of them is equally probable, and $\beta$ (Eq. 2.64) is
# their mean. The last two panels are each track's probabilities over all joint events,
# and for each track alone.

# %%
spread = 16.0 * np.eye(2)
predicted = np.array([[0.0, 0], [14, 0]])
detections = np.array([[-6.0, 0], [7, -4], [20, 2], [20, -8]])
found = gate(predicted, np.stack([spread, spread]), Detected(detections))
inside = coo_array(
    (np.ones(len(found.track)), found[:2]), (2, 4)
).toarray()  # tracks, detections
choices = product(
    *([0, *np.flatnonzero(column) + 1] for column in inside.T)
)  # 0: no track
events = [event for event in choices if event.count(1) < 2 and event.count(2) < 2]
held = [
    [[t not in event for t in (1, 2)], *([n == 1, n == 2] for n in event)]
    for event in events
]
alone = [joint_probabilities(row[None], [1.0])[0] for row in inside]
table = pd.DataFrame({"track": ["T1", "T2"] * 5})
table["detection"] = np.repeat(["none", "D1", "D2", "D3", "D4"], 2)
table["joint"] = joint_probabilities(inside, np.ones(2)).T.ravel()
table["sum_over_events"] = np.mean(held, axis=0).ravel()
table["independent"] = np.transpose(alone).ravel()
for k, event in enumerate(held, 1):
    table[f"event_{k}"] = np.ravel(event).astype(int)
table["events"] = len(events)

# %% tags=["hide-input"]
picture, grid = style.canvas(3, 5, width_mm=132, height_mm=112)
first, *rest = grid.ravel()
for k, place in enumerate([*predicted, *detections]):
    first.annotate("P1P2D1D2D3D4"[2 * k :][:2], place[::-1], **text)
    ellipse(
        first, place, spread, gate.distance if k < 2 else 0.8, ls="-" if k < 2 else ":"
    )
first.set(aspect="equal", xlabel="column (px)", ylabel="row (px)", ylim=(28, -14))
shown = {"gates": np.vstack([[1, 1], inside.T])}
for name in (
    *(f"event_{k}" for k in range(1, 1 + len(events))),
    "joint",
    "independent",
):
    shown[name] = table[name].to_numpy().reshape(5, 2)
for axes, (name, beta) in zip(rest, shown.items(), strict=True):
    axes.pcolormesh(beta, cmap="gray_r", vmin=0, vmax=1, edgecolors="0.6", lw=0.5)
    axes.set_xticks([0.5, 1.5], ["T1", "T2"])
    axes.set_yticks(np.arange(5) + 0.5, table["detection"][::2])
    axes.set(title=name.replace("_", " "), ylim=(5, 0))
    for (i, j), value in (
        np.ndenumerate(beta) if name in ("joint", "independent") else ()
    ):
        axes.text(j + 0.5, i + 0.5, f"{value:.2f}", **text)
caption = f"Gates and the {len(events)} joint events, after Fig. 2.23. Black: 1."
figures.save(
    "fig-2-23-events", table, picture=picture, caption=caption, provenance=origin
)

# %% [markdown]
# ## The gate in flight
#
# A particle flies through twelve frames and is not detected in three of them (another
# one far away keeps the frames coming). In frame 3 clutter lies within the ellipse, but
# 2.6 m nearer; in frame 10 the particle has no depth. The tracker runs with its
# defaults. In the picture the limit of depth, 1.5 m about the last known one, is grey;
# a detection without depth is drawn there.

# %%
frames = np.arange(12)
random = np.random.default_rng(seed)
flight = pd.DataFrame(
    {"frame": frames, "row": 40.0 + 3 * frames, "col": 20.0 + 26 * frames}
)
flight[["row", "col"]] += random.normal(0, 1.0, (12, 2))
flight["z"] = 5000.0 + 60 * frames + random.normal(0, 200, 12)
flight.loc[10, "z"] = np.nan
other = flight.assign(row=flight["row"] + 500, z=5000.0, origin="other particle")
clutter = (flight[frames == 3] + [0, 6, -7, -2600]).assign(origin="clutter")
flight = flight.drop(index=[5, 6, 7]).assign(origin="particle")
seen = pd.concat([flight, other, clutter], ignore_index=True)
parts = []
for before, step in pairwise(tracker.steps(seen)):
    pairs, (row, col) = step.pairs, step.pairs.expected[0]
    part = seen.iloc[step.detected.rows].assign(expected_row=row, expected_col=col)
    part["expected_z"] = before.tracks["depth_mm"][0]
    flat = Gate(depth_mm=np.inf)(pairs.expected, pairs.residual, step.detected)
    part["in_ellipse"] = np.isin(range(len(part)), flat.detection[flat.track == 0])
    part[["reach_row_px", "reach_col_px"]] = Gate().distance * np.sqrt(
        pairs.residual[0].diagonal()
    )
    parts.append(
        part.assign(
            in_gate=np.isin(range(len(part)), pairs.detection[pairs.track == 0])
        )
    )
table = pd.concat(parts, ignore_index=True)

# %% tags=["hide-input"]
picture, ((flat,), (deep,)) = style.canvas(2, height_mm=84, height_ratios=[0.8, 1.2])
gates = table.drop_duplicates("frame").set_index("frame").loc[2:]
for frame, each in gates.iterrows():
    place = each[["expected_row", "expected_col"]].to_numpy(float)
    reach = np.diag(each[["reach_row_px", "reach_col_px"]].to_numpy(float) ** 2)
    ellipse(flat, place, reach, 1.0, ls="--" if frame in (5, 6, 7) else "-")
    flat.annotate(str(frame), (place[1], 24), **text)
centre = gates["expected_z"] / 1000
deep.fill_between(
    gates.index, centre - 1.5, centre + 1.5, step="mid", color="0.88", label="gate"
)
near = table.query("frame > 1 and origin != 'other particle'")
depth = near["z"].fillna(near["expected_z"]) / 1000
known = near["z"].notna()
passed = near["in_gate"]
kinds = {"in gate": known & passed, "refused by depth": ~passed, "no depth": ~known}
for (label, some), look in zip(kinds.items(), ("sb", "Xr", "vy"), strict=True):
    flat.plot(near["col"][some], near["row"][some], look, **mark)
    deep.plot(near["frame"][some], depth[some], look, label=label, **mark)
flat.set(aspect="equal", ylabel="row (px)", xlabel="column (px)", ylim=(98, 10))
deep.set(xlabel="frame", ylabel="depth z (m)", xticks=gates.index, ylim=(2, 8.6))
deep.legend(loc="upper left", ncols=2)
caption = (
    "Gate of a track by frame, in the picture and in depth, after Fig. 4.2. Dashed: "
    "missed."
)
figures.save("fig-4-2-gate", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Detections and particles
#
# How a frame is scored (Eq. 3.4, Fig. 3.13): five hand-made detections, five particles,
# 45 px. The pairs are those of the least sum: d1 is nearest to p2, but p1 has nothing
# else. No particle is near d4, a false positive; p3 is missed.

# %%
detected = np.array([[40.0, 60], [90, 70], [45, 210], [150, 150], [140, 250]])
particles = np.array([[20.0, 50], [62, 62], [100, 150], [50, 222], [150, 262]])
pairs = score_detections(particles, detected, DETECTION_GATE_PX).pairs
costs = pd.DataFrame(cdist(detected, particles), columns=["p1", "p2", "p3", "p4", "p5"])
costs = costs.where(costs <= DETECTION_GATE_PX)
costs.insert(0, "detection", ["d1", "d2", "d3", "d4", "d5"])

# %% tags=["hide-input"]
picture, ((left, right),) = style.canvas(1, 2, width_mm=style.PAGE_MM, height_mm=75)
for (row, col), value in np.ndenumerate(costs.iloc[:, 1:]):
    box = {"fc": "white", "ec": "C4" if [col, row] in pairs.tolist() else "white"}
    left.text(col, row, f"{value:.1f}".replace("nan", "C max"), bbox=box, **text)
left.set(
    xticks=range(5), xticklabels=costs.columns[1:], xlim=(-0.6, 4.6), title="cost (px)"
)
left.set(yticks=range(5), yticklabels=costs["detection"], ylim=(4.6, -0.6))
for name, places, colour in (("p", particles, "C2"), ("d", detected, "C1")):
    for k, place in enumerate(places, 1):
        right.annotate(f"{name}{k}", place[::-1], color=colour, **text)
        ellipse(
            right, place, np.eye(2), DETECTION_GATE_PX if name == "d" else 1.0, ls=":"
        )
for particle, detection in pairs:
    right.plot(
        *np.transpose([particles[particle], detected[detection]])[::-1], "-", color="C4"
    )
right.set(xlabel="column (px)", ylabel="row (px)", aspect="equal", ylim=(215, -40))
caption = (
    "Five detections (d) assigned to five particles (p), 45 px around each, after "
    "Fig. 3.13."
)
figures.save(
    "fig-3-13-assignment", costs, picture=picture, caption=caption, provenance=origin
)

# %%
gnn, jpda = (weights[name, "crowded"][0, 1] for name in ("GNN", "JPDA"))
result = (
    f"In the crowd track 1 takes its own detection with {gnn:.2f} (GNN) and "
    f"{jpda:.2f} (JPDA)."
)
figures.conclude(result, [], origin)
