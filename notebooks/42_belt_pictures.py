# %% [markdown]
# # Pictures of the belt: what the tracker measures in them
#
# **The work.** The 2016 paper (sections II.B and IV.B) renders pictures of its
# simulated belt. It finds particles as connected areas, calibrates by the belt's
# corners, and assigns measurements to tracks by a matrix of likelihoods.
#
# **Here.** The authors' public tracks of spheres, rendered at 200 frames/s, are
# measured and tracked in the same way (`paper_2016.track_pictures`: corners,
# calibration, spots, tracker). Places and velocities stand beside the authors' own.
#
# **One number.** Scale of the pictures at the belt: 0.44 mm/px printed, 0.44 mm/px
# here. (It was put in, and tests the calibration alone.)
#
# **What disagrees.** Nothing that is tested here.

# %% tags=["hide-input"]
import numpy as np
import pandas as pd
from IPython.display import Markdown

from kilnflight.belt import tracker
from kilnflight.belt.camera import BELT, Area
from kilnflight.experiments.belt import paper_2016, paper_2020
from kilnflight.publication import figures, style
from kilnflight.simulated.belt.rendering import BULKS, Pictures, at_rate

files = paper_2020.find_dem()
source = "the authors' tracks" if files else "the friction model"
Markdown(paper_2020.INPUT[paper_2020.AUTHORS if files else paper_2020.OWN])

# %% [markdown]
# The public tracks are those of the 2020 paper, whose spheres have another friction
# than those of 2016. They have 100 Hz; a cubic spline through each one gives the
# camera's 200 frames/s. The camera has the printed size, scale and rate. Its height and
# its small tilt are assumptions. The tracker knows neither the camera nor the true
# places.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 2020  # of the noise in the pictures, and of the friction model

# %%
style.use_style()
count = paper_2016.PARTICLES[scale]
end_mm = paper_2016.PHASE_2016.start_mm
setting = {"scale": scale, "count": count}
origin = figures.trace("42_belt_pictures", setting, seed=seed, inputs=files.values())
coarse = paper_2020.load_tracks(files, seed, count)["spheres"]
bodies = paper_2020.resample(coarse, paper_2016.TRUTH_HZ)
pictures = Pictures(bodies, BULKS["spheres"], seed)
pictured = paper_2016.track_pictures(pictures)
calibration, spots, followed = pictured
found = pd.DataFrame({"pictures": [len(pictures)], "spots": [len(spots)]})
found["corners_off_mm"] = calibration.error_mm
found["mm_per_px"] = calibration.mm_per_px
caption = (
    "What the tracker finds: number of pictures and of spots in them, how far the "
    "belt's corners lie from their places after the calibration, and its scale."
)
figures.save("belt-calibration", found, caption=caption, provenance=origin)

# %% [markdown]
# ## One picture
#
# Two particles that touch are one spot, at their common centroid. The paper names the
# case and prints no remedy. A track that follows such a spot may have a wrong velocity
# for some frames. A spot above the belt appears
# farther from the middle than it is: 0.5 mm for a centre at 2.5 mm height and 20 cm
# from the middle.

# %%
busiest = int(spots["frame"].value_counts().sort_index().idxmax())
states = followed.states
shown = states.query("frame == @busiest and valid == 1").set_index("particle")
places = at_rate(bodies, 1 / tracker.BELT_FRAME_S)
pairs = (
    paper_2016.match(states[states["row"] >= 0], places).reindex(shown.index).dropna()
)
near = bodies[bodies["particle"].isin(pairs)]
gradient = near.groupby("particle")["x"].transform(
    lambda x: np.gradient(x, 1 / paper_2016.TRUTH_HZ)
)
now = np.isclose(near["time_s"], busiest * tracker.BELT_FRAME_S)
true = near.assign(velocity=gradient)[now].set_index("particle").loc[pairs]
table = shown.loc[
    pairs.index, ["x", "y", "velocity_x_mm_s", "velocity_y_mm_s"]
].reset_index()
table = table.rename(columns={"x": "x_mm", "y": "y_mm"})
for name, column in {"x_mm": "x", "y_mm": "y", "velocity_x_mm_s": "velocity"}.items():
    table[f"true_{name}"] = true[column].to_numpy()
table["mm_per_px"] = calibration.mm_per_px

# %% tags=["hide-input"]
dots = calibration.pixels(table[["x_mm", "y_mm"]].to_numpy())
lines = {
    BELT.start_mm: "tracking phase",
    end_mm: "prediction phase",
    BELT.end_mm: "edge",
}
edges = calibration.pixels(np.array([[x, BELT.width_mm / 2] for x in lines]))[:, 1]
picture, grid = style.canvas(2, 1, width_mm=style.PAGE_MM, height_mm=140)
axes, below = grid[:, 0]
axes.imshow(pictures[busiest], cmap="gray", vmin=0, vmax=255)
axes.plot(
    dots[:, 1], dots[:, 0], "o", ms=4, mfc="none", mec=style.COLOURS[1], ls="none"
)
for place, text in zip(edges, lines.values(), strict=True):
    axes.axvline(place, color="white", lw=0.8, ls="--")
    axes.text(place + 4, 135, text, color="white", fontsize=7)
axes.set(xlabel="column (px)", ylabel="row (px)", ylim=(600, 110))
for prefix, mark, label in (("true_", "x", source), ("", "o", "tracker")):
    velocity = table[f"{prefix}velocity_x_mm_s"] / 1000
    below.plot(
        table[f"{prefix}x_mm"], velocity, mark, ls="none", mfc="none", label=label
    )
below.set(xlabel="x along the belt (mm)", ylabel="velocity along the belt (m/s)")
_ = below.legend()

# %%
caption = (
    "A frame of the pictures, after Fig. 5 of the 2016 paper (blank space above and "
    "below cut off). Circles: valid tracks at their filtered places. Below: their "
    f"velocity beside that of {source}, {len(table)} spheres."
)
figures.save(
    "fig-belt16-5-picture", table, picture=picture, caption=caption, provenance=origin
)

# %% [markdown]
# ## Where tracks begin and end
#
# The paper draws both curves without a scale. Here they follow from counting: a new
# particle lies within the way of the belt in a frame, and a track is missed where its
# prediction lies outside.

# %%
likelihoods = tracker.Appearance(Area(end_mm=end_mm))
x = np.arange(BELT.start_mm, end_mm + 23.0, 0.5)
along = np.column_stack([x, np.full(len(x), BELT.width_mm / 2)])
new = likelihoods.new(along) * likelihoods.area.square_mm
unobserved, _ = likelihoods.unobserved_likelihood(
    along, np.tile(4.0 * np.eye(2), (len(x), 1, 1))
)
curves = pd.DataFrame(
    {"x_mm": x, "new_per_frame_and_area": new, "not_observed": unobserved}
)

# %% tags=["hide-input"]
picture, (panels,) = style.canvas(1, 2, width_mm=style.PAGE_MM, height_mm=50)
panels[0].semilogy(curves["x_mm"], curves["new_per_frame_and_area"])
panels[0].set(
    ylabel="new tracks, relative to one\nspread over the region", yticks=[0.1, 1, 10]
)
panels[0].yaxis.set_major_formatter("{x:g}")
panels[1].plot(curves["x_mm"], curves["not_observed"])
panels[1].set(ylabel="likelihood that a track\nis not observed", ylim=(0, 1.05))
for axes in panels:
    axes.axvline(end_mm, color="0.6", lw=0.8, ls="-")
    axes.set(xlabel="x along the belt (mm)")

# %%
caption = (
    "Likelihood that a measurement stems from a new track, and that a track is not "
    "observed, after Fig. 2 of the 2016 paper. On the belt's middle line, for a "
    "standard deviation of the prediction of 2 mm. Grey: end of the observed region."
)
save = {"picture": picture, "caption": caption, "provenance": origin}
figures.save("fig-belt16-2-likelihoods", curves, **save)

# %% [markdown]
# ## The matrix of one frame
#
# Rows are tracks, then a new track for each measurement. Columns are measurements, then
# a missing one for each track. The paper leaves the lower right corner open; 0
# (likelihood 1) adds nothing.

# %%
follow = paper_2016.tracker_until(end_mm)
step = max(
    follow.steps(spots),
    key=lambda one: min(5, len(one.pairs.expected), one.pairs.detections),
)
costs = follow.likelihoods(step.detected, step.pairs)
pairs = step.pairs[:2]
n = len(costs.unobserved)  # tracks
m = len(costs.new)  # measurements
whole = np.full((n + m, m + n), np.inf)
whole[pairs] = costs.costs
whole[n:, m:] = 0.0
whole[n + np.arange(m), np.arange(m)] = -np.log(costs.new)
whole[np.arange(n), m + np.arange(n)] = -np.log(costs.unobserved)
whole = np.where(np.isinf(whole), np.nan, whole)

# %% tags=["hide-input"]
picture, ((axes,),) = style.canvas(width_mm=110, height_mm=95)
axes.imshow(whole, cmap="Greys", vmin=-5, vmax=40)
for (i, j), value in np.ndenumerate(whole):
    if np.isfinite(value):
        axes.text(j, i, f"{round(value)}", ha="center", va="center", fontsize=6)
column = m + np.arange(n)
taken = costs.taken(pairs)
column[pairs[0][taken]] = pairs[1][taken]
axes.plot(column, np.arange(n), "s", ms=13, mfc="none", mec="#D55E00")
axes.axhline(n - 0.5, color="black", lw=0.8, ls="-")
axes.axvline(m - 0.5, color="black", lw=0.8, ls="-")
columns = [f"z{k + 1}" for k in range(m)] + ["unobserved"] * n
axes.set_xticks(range(n + m), columns, rotation=90)
names = [f"track {name}" for name in step.tracks["particle"][:n]] + ["new"] * m
_ = axes.set_yticks(range(n + m), names)

# %%
caption = (
    "The matrix of one frame, after Fig. 3 of the 2016 paper: -ln of the likelihoods; "
    "blank is impossible. Rows below the line: new tracks; columns beyond it: tracks "
    "not observed. Squares: the likeliest association."
)
matrix = pd.DataFrame(
    whole.round(2), columns=[f"{name}_{k}" for k, name in enumerate(columns)]
)
figures.save(
    "fig-belt16-3-matrix", matrix, picture=picture, caption=caption, provenance=origin
)

# %%
off = (table["velocity_x_mm_s"] - table["true_velocity_x_mm_s"]).abs().median()
result = (
    f"The belt's corners in the pictures give {calibration.mm_per_px:.4f} mm/px. In "
    f"the busiest frame the tracker follows {len(table)} spheres of {source}; their "
    f"velocities are off by {off:.0f} mm/s (median)."
)
figures.conclude(result, [], origin)
