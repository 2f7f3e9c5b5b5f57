# %% [markdown]
# # Data association on small cases
#
# **Published** (thesis, sections 2.3.2 to 2.3.4, 3.3, 4.1.2 and 4.1.3 with Eqs 4.9 to 4.12; Figs
# 2.20 to 2.23, 3.13 and 4.2). In sketches: the nearest neighbour (NN) fails in a crowd, the global
# one (GNN) does not. Both take clutter that lies nearer. Probabilistic association (PDA, JPDA)
# lands in between. JPDA sums over joint events, eleven in the example. The gate is an elliptical
# cylinder.
#
# **Here.** The sketches have no scales, so these are cases of our own of the same kind. The
# functions that track the recordings compute them. No claim is tested.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full: nothing here depends on it
seed = 0  # of the scatter of the flight in the last figure

# %%
import numpy as np

from kilnflight.experiments import association_cases as cases
from kilnflight.experiments import worked_examples
from kilnflight.project import figures, style
from kilnflight.scores.detections import GATE_PX
from kilnflight.tracking.gate import Detected, Gate, Predicted

style.use_style()
origin = figures.trace("30_association", {"scale": scale}, seed=seed, mark="example")
gate = Gate(distance=3.0)

# %% [markdown]
# ## Three situations, four associators
#
# Two tracks fly to the right. Their next places (row, column, in px) are predicted with
# standard deviations of 4 px across and 6 px along the flight. D1 belongs to track 1, D2 to
# track 2, and N1 is clutter.

# %%
situations = {  # predictions of T1 and T2; D1, D2 and N1
    "apart": ([[0.0, 0], [26, 0]], [[-4.0, 8], [30, -7]]),
    "crowded": ([[0.0, 0], [12, 0]], [[-5.0, 9], [5, -7]]),
    "clutter": ([[0.0, 0], [26, 0]], [[-5.0, 9], [30, -7], [5, -6]]),
}
places = {name: tuple(map(np.array, both)) for name, both in situations.items()}
spread = np.diag([16.0, 36.0])


def gated(places, spread):
    return gate(Predicted(places[0], np.stack([spread, spread])), Detected(places[1]))


# %%
weights, table = cases.weigh({name: gated(both, spread) for name, both in places.items()})

# %%
picture = cases.draw_associations(places, weights, spread, gate.distance)
caption = (
    "Two tracks (T1, T2) with their gates in three situations, after Figs 2.20 to 2.22, and what "
    "four associators make of them. Lines are as wide as their weights; diamonds mark the "
    "predictions and detections averaged by their weights. A track without line stays."
)
figures.save("fig-2-20-associations", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# What the sketches of the thesis say, asked of the weights. In the crowd D2 is the nearest
# detection of both tracks; NN gives it to track 1 and leaves track 2 with nothing. "In between"
# is meant literally: the track is drawn to a place where nothing was seen. The places were
# laid out to show this; it says what can happen, not how often.

# %%
outcomes = cases.sketched_outcomes(weights)
outcomes.to_frame()

# %% [markdown]
# ## Joint events
#
# The example of Fig. 2.23: D1 and D2 lie in the gate of track 1; D2, D3 and D4 in that of
# track 2. Eq. 2.62 bounds the number of feasibility matrices by that of a matrix of ones. With
# equal likelihoods each of them is equally probable, and $\beta$ (Eq. 2.64) is their mean.

# %%
spread = 16.0 * np.eye(2)
places = np.array([[0.0, 0], [14, 0]]), np.array([[-6.0, 0], [7, -4], [20, 2], [20, -8]])
gates = np.isfinite(gated(places, spread).distance_squared).T
omega = np.column_stack([np.ones(len(gates)), gates]).astype(np.uint8)  # Eq. 2.57
events, bound = cases.feasible_events(omega), cases.most_events(2, 4)
table = cases.event_table(omega)
print(omega, f"beta differs by {(table['joint'] - table['sum_over_events']).abs().max():.0e}")

# %%
picture = cases.draw_events(places, spread, gate.distance, omega, table)
printed = [[0, 1, 0], [0, 0, 1], [1, 0, 0], [1, 0, 0]]  # D1 to P1, D2 to P2
third = 1 + int((events == printed).all(axis=(1, 2)).argmax())
caption = (
    f"Gates, validation matrix and its {len(events)} feasibility matrices (black: 1; –: none), "
    f"after Fig. 2.23. Ω{third} is Ω3 of the thesis. Last: each track's probabilities for equal "
    "likelihoods, over all joint events and for each track alone."
)
figures.save("fig-2-23-events", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## The gate in flight
#
# A particle flies through twelve frames and is not detected in three of them (another one far
# away keeps the frames coming). In frame 3 clutter lies within the ellipse, but 2.6 m nearer;
# in frame 10 the particle has no depth. The tracker runs with its defaults.

# %%
table = cases.gate_table(cases.interrupted_flight(seed))

# %%
picture = cases.draw_gate(table, (5, 6, 7), Gate().depth_mm)
reach = table.loc[table["frame"] > 1, "reach_row_px"]
caption = (
    "The gate of a track from frame 2 on, after Fig. 4.2. Above, by frame: the ellipse about the "
    f"prediction (+; a circle, as noise is the same both ways). Its reach is {reach.min():.0f} px "
    f"after a detection, {reach.max():.0f} px in frame 8 after three missed frames (dashed). "
    "Below: the limit of depth, 1.5 m about the last known one; a detection without depth is drawn "
    "there."
)
figures.save("fig-4-2-gate", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Detections and particles
#
# How a frame is scored (Eq. 3.4, Fig. 3.13): five hand-made detections, five particles, 45 px. The
# pairs are those of the least sum: d1 is nearest to p2, but p1 has nothing else. See d4, which no
# particle is near to, a false positive; and p3, which nothing is left for, missed.

# %%
score, costs = worked_examples.score_instance(GATE_PX)
picture = worked_examples.draw_assignment(score, costs, GATE_PX)
caption = (
    "Five detections assigned to five particles, after Fig. 3.13: cost matrix with the pairs "
    "chosen (framed), and their places, with 45 px around each detection. Hand-made."
)
table = costs.reset_index(names="detection")
figures.save("fig-3-13-assignment", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Result

# %%
own = ", ".join(f"{weights['crowded', name][0, 1]:.2f} ({name})" for name in cases.NAMES)
result = (
    f"{outcomes.sum()} of {len(outcomes)} sketched outcomes come out; in the "
    f"crowd track 1 gives its own detection {own}. Fig. 2.23 has {len(events)} joint "
    f"events of at most {bound}."
)
figures.conclude(result, [], origin)  # what recordings say of associators is asked elsewhere
