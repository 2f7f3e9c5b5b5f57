# %% [markdown]
# # Every input of the twin
#
# **Published** (thesis, sections 2.1.1, 2.1.4, 5.1 and 5.2). Size, temperatures and air of the
# kiln, the camera, and a few bounds. Not printed: masses and sizes of particles, the pose of the
# camera, the light, and the flow at the lance.
#
# **Here.** All that decides a recording of the second look, read from the code itself: value, unit,
# status, bounds and what is said of it. Who doubts a verdict can start here. "Fitted" are the
# inputs of four declared fits: flights, light and pose, with the limits fixed before (notebooks 12,
# 13 and 15 show how), and depth, to Tables 5.2 and 5.18 and the number of points (twin/depth.json).
# No claim is judged.

# %% tags=["parameters"]
scale = "standard"  # the same at every scale: nothing is computed
seed = 0  # nothing is drawn

# %%
from kilnflight.experiments import twin_inputs
from kilnflight.project import figures
from kilnflight.twin import fitted, poses, scenes

# %%
inputs = [fitted.SECOND_FLIGHT_FILE, fitted.SECOND_LIGHT_FILE, poses.POSE_FILE]
origin = figures.trace("16_inputs", {"scale": scale}, seed=seed, inputs=inputs)
campaign = scenes.campaign_name("confetti", scenes.PRESSURES_BAR[0])
table = twin_inputs.input_table(scenes.open_scene(campaign, seed).scene)

# %% [markdown]
# ## Inputs
#
# Ours: a twin can be believed only as far as its inputs can be checked.

# %%
caption = (
    "Inputs of a recording of confetti at 4.5 bar, second look, and of the four fractions. Bounds: "
    "of a fit, or where the source names them. Not said: steps of the computation, and values "
    "without a source. What the first look needs and the second replaces is listed as well."
)
figures.save("twin-inputs", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Result

# %%
counts = table["status"].value_counts()
listed = ", ".join(f"{number} {status}" for status, number in counts.items())
figures.conclude(f"The twin has {len(table)} inputs: {listed}.", [], origin)
