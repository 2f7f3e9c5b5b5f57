# %% [markdown]
# # Pictures of the kiln: optical ground truth and wall temperature
#
# **Published** (thesis, sections 2.1.1 and 5.2.3). Paths of particles become visible when the
# differences of adjacent frames from a background image are added to it. This is an optical
# ground truth to judge trajectories by eye (Figs 5.13 and 5.17). An infrared camera gives the
# temperature along the wall: a trapezoid of the picture becomes a rectangle, its row means the
# profile (Fig. 2.4).
#
# **Here.** The same pictures of the twin, with the true paths beside them. The infrared frame
# is simulated with a known profile. No claim is tested here.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 0  # of the scenes
frames = 0  # frames summed per fraction; 0: 5, 50 or 300 by scale

# %%
import numpy as np
import pandas as pd

from kilnflight import camera, kiln
from kilnflight.detection.flame import segment_flame
from kilnflight.experiments import detection, plots, tracking
from kilnflight.project import figures, style
from kilnflight.twin import scenes
from kilnflight.twin.fitted import second_kiln

style.use_style()
frames = frames or {"quick": 5, "standard": 50, "full": 300}[scale]
origin = figures.trace("11_kiln_pictures", {"scale": scale, "frames": frames}, seed=seed)
print(f"{frames} frames of each fraction at 4.5 bar")

# %% [markdown]
# ## Optical ground truth

# %%
sums, paths, windows = {}, [], {}
for name in tracking.SMOKE_FRACTIONS if scale == "quick" else scenes.WINDOWS:
    twin = scenes.cached_scene(scenes.campaign_name(name, 4.5), seed)
    window = scenes.tracking_window(twin)  # as many leave the lance as in Table 5.15
    windows[name] = window[: min(frames, len(window))]
    foregrounds = detection.BACKGROUNDS[scale](kiln.GrayFrames(twin), windows[name])
    total = np.zeros((twin.attributes.rows, twin.attributes.columns), dtype=np.float32)
    for t, foreground in zip(windows[name], foregrounds, strict=True):
        clear = segment_flame(twin.gray(t), twin.attributes.flame_roi).cover(foreground)
        least = 8 * np.median(foreground[::4, ::4])  # flicker and noise out
        total += np.where(clear > least, clear, 0)
    sums[name] = total

# %%
for name, window in windows.items():
    twin = scenes.cached_scene(scenes.campaign_name(name, 4.5), seed)
    for t in window:
        moment = twin.life.at(twin.time_s(t))
        row, col = twin.scene.geometry.project(twin.scene.geometry.to_camera(moment.position_m))
        places = pd.DataFrame({"particle": moment.particle, "frame": t, "row": row, "col": col})
        height, width = twin.attributes.rows, twin.attributes.columns
        shown = ~moment.landed & (row >= 0) & (row < height) & (col >= 0) & (col < width)
        paths.append(places[shown].assign(fraction=name))
tracks = pd.concat(paths)

# %% tags=["hide-input"]
height = 62.5 * len(sums)
picture, grid = style.canvas(len(sums), 2, width_mm=style.PAGE_MM, height_mm=height)
for panels, (name, image) in zip(grid, sums.items(), strict=True):
    top = max(np.quantile(image[image > 0], 0.9), 1) if image.any() else 1
    panels[0].imshow(np.clip(image / top, 0, 1) ** 0.5, cmap="gray", interpolation="bilinear")
    panels[0].set(title=f"{name}: summed differences", ylabel="row (px)")
    for _, track in plots.broken_at_gaps(tracks[tracks["fraction"] == name]).groupby("particle"):
        panels[1].plot(track["col"], track["row"], "-", color="black", lw=0.5)
    panels[1].set(title=f"{name}: true paths", xlim=(0, 2047), ylim=(1535, 0), aspect="equal")
for axes in grid[-1]:
    axes.set_xlabel("column (px)")

# %%
caption = (
    f"Differences of up to {frames} frames from the sliding median, summed, after Figs 5.13 and "
    "5.17. Beside them the true paths of the same particles in the air, inside the picture. "
    "The segmented flame of the burner is left out (the flicker around it stays), and so is what "
    "lies below eight times a frame's median difference."
)
figures.save("fig-5-13-optical-truth", tracks, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Temperature profile of the wall

# %%
place = second_kiln().geometry
row, column = np.indices((place.rows, place.columns), dtype=float)
wall = place.to_kiln(place.unproject(row, column, place.wall_depth(row, column)))
noise = np.random.default_rng(seed).normal(0, 4, row.shape)
infrared = 1423.0 - 9.0 * (wall[..., 0] - 1.0) ** 2 + noise  # K: hottest 1 m before the lance
along = np.linspace(-2.0, 2.5, 100)  # m, on the bottom of the wall
corners = []  # of a strip so narrow that the round wall is flat in it
for s, x in ((along[0], -0.05), (along[0], 0.05), (along[-1], 0.05), (along[-1], -0.05)):
    spot = place.to_camera(np.array([s, x, -np.sqrt(0.7**2 - x**2)]))
    corners.append(tuple(float(v) for v in place.project(spot)))
profile = camera.wall_profile(infrared, tuple(corners), rows=len(along))
truth = 1423.0 - 9.0 * (along - 1.0) ** 2

# %% tags=["hide-input"]
picture, ((left, right),) = style.canvas(1, 2, width_mm=style.PAGE_MM, height_mm=62)
shown = left.imshow(infrared, cmap="inferno", vmin=1340, vmax=1430)
picture.colorbar(shown, ax=left, label="temperature (K)", shrink=0.8)
outline = np.array([*corners, corners[0]])
left.plot(outline[:, 1], outline[:, 0], "-", color="white", lw=1)
left.set(xlabel="column (px)", ylabel="row (px)", xlim=(0, 2047), ylim=(1535, 0))
right.plot(along, truth, "-", color="0.6", lw=2.5, label="put in")
right.plot(along, profile, "--", color="black", label="profile")
right.set(xlabel="distance from the lance exit along the kiln (m)", ylabel="temperature (K)")
right.legend(loc="lower center")
caption = (
    "Temperature profile of the wall, after Fig. 2.4. Left: simulated infrared frame with the "
    "trapezoid. Right: row means of the equalised trapezoid beside what was put in."
)

# %%
table = pd.DataFrame({"along_m": along, "true_k": truth, "profile_k": profile})
off = float(np.abs(profile - truth).max())
figures.save("fig-2-4-wall-profile", table, picture=picture, caption=caption, provenance=origin)

# %%
crowd = tracks.groupby("fraction")["particle"].nunique().reindex(list(sums), fill_value=0)
result = (
    f"Particles in the air during up to {frames} frames of the tracking windows: "
    + ", ".join(f"{name} {count}" for name, count in crowd.items())
    + f". The wall's temperature profile is recovered within {off:.0f} K, "
    f"on average {np.mean(profile - truth):+.0f} K."
)
figures.conclude(result, [], origin)
