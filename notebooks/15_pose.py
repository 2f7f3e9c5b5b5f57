# %% [markdown]
# # Where the camera stands: what the published numbers allow
#
# **Published** (thesis, Tables 5.3, 5.12 and 5.18, Figs 3.11 and 5.11, appendix A.1). The fitted
# wall, the errors of fitted trajectories, what lies in the region of interest, and the first pixels
# of a flight. The pose of the camera and the depth of the lance are nowhere printed.
#
# **Here.** Four numbers as a posterior: height of the axis over the camera, depth of the lance, its
# elevation, and the scale of the published lengths. In its search true flights of the first twin
# stood for those of the kiln. No picture was rendered, no method took part, and no claim is judged.
# R2 of Table 5.18 was not read. All scenes have the mode's pose: a **second look**, made after the
# outcomes of the first twin were known. What is a term here, such as the fitted radius, is no
# result when it comes out again.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 54  # of the flights; another one than the search's
particles = 0  # of each fraction; 0: 20, 60 or 200 by scale

# %%
import pandas as pd

from kilnflight.experiments import pose_pictures, twin_pose
from kilnflight.project import figures, style
from kilnflight.twin import fitted, poses

# %%
style.use_style()
particles = particles or {"quick": 20, "standard": 60, "full": 200}[scale]
setting = {"scale": scale, "particles": particles}
files = [poses.POSE_FILE, fitted.SECOND_FLIGHT_FILE]
origin = figures.trace("15_pose", setting, seed=seed, inputs=files)
record, frozen = twin_pose.read_fit(), poses.read_poses()
scenes = {"base": twin_pose.first_pose(), "pose": frozen.mode}
scenes |= {f"pose-{number:02d}": draw for number, draw in enumerate(frozen.draws)}
flights = twin_pose.library_for(fitted.second_kiln(), scenes.values(), particles, seed)

# %% [markdown]
# ## What a pose must give
#
# Ours: each term with its source, bounds and spread, fixed before the search. Beside them the value
# of the first twin's pose and of the mode, and how many spreads each is off.

# %%
terms = twin_pose.term_table(record).round(2)
caption = (
    "Terms of the likelihood: published bounds, spread (a standard deviation) and where it comes "
    "from. Then the value of the first twin's pose and of the mode, each with its distance from "
    f"the bounds in spreads. Sum of squares {record['cost_inputs_only']:.0f} and "
    f"{record['cost_calibrated']:.0f}."
)
figures.save("twin-pose-terms", terms, caption=caption, provenance=origin)

# %% [markdown]
# ## Posterior
#
# Ours: which of the four numbers the thesis decides, and which it leaves open. By chance
# four of the 16 draws have an elevation over 8.2 degrees, where 0.7 are expected; their seed was
# kept.

# %%
table = pose_pictures.posterior_table(record)
picture = pose_pictures.draw_posterior(table)
numbers = pd.DataFrame(record["numbers"]).T
caption = (
    "Prior and posterior of the four numbers of the pose, with 16 draws, the mode and the first "
    f"twin. {record['evaluations']} poses were tried, worth {record['effective']:.0f} independent "
    "ones. The gas at the lance and the lower edge of the region of interest were drawn along: "
    f"{numbers['first']['gas']:.0%} have the first twin's gas, the others a choked lance."
)
figures.save("twin-pose", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## What the camera sees
#
# Ours: the same lance pixel belongs to very different kilns.

# %%
some = {"first twin": scenes["base"], "mode": scenes["pose"]}
some |= {f"draw {number:02d}": frozen.draws[number] for number in (0, 1)}
picture, table = pose_pictures.draw_views(flights, some)
caption = (
    "The kiln in the picture in four poses: inlet plate, wall at the depth of the lance exit, "
    "lance, and true flights of wood chips at 4.5 bar of the second look up to the wall. The dots "
    "bound the region of interest: of the second look, in the first panel of the first twin."
)
figures.save("twin-pose-view", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## What true flights owe to the pose
#
# Ours: the same flights of the second look in every draw. Lengths are those that the thesis's
# camera would have had: true ones times the scale. "In view": up to where a flight leaves the
# picture.

# %%
values = {name: twin_pose.true_numbers(flights, pose) for name, pose in scenes.items()}
bands = twin_pose.bands(values)
caption = (
    "Numbers of true flights of the second look at 4.5 bar, of all and up to where they leave the "
    "picture. In the first twin's pose (base), in the mode, and least, median and greatest of the "
    "16 draws. Lengths as the thesis's camera would have had them. Left out is what no draw has."
)
shown = bands.reset_index().dropna(subset=["median"])
figures.save("twin-pose-bands", shown, caption=caption, provenance=origin)

# %% [markdown]
# ## Result

# %%
mode = record["inputs"]
chips = bands.loc["wood chip", "in view"]
speed, lands = chips.loc["velocity 0-1 m (m/s)"], chips.loc["lands (%)"]
spread = {name: f"{numbers['mean'][name]:.4g} +- {numbers['sd'][name]:.2g}" for name in mode}
result = (
    f"Axis {spread['axis_height_mm']} mm over the camera, lance at {spread['lance_depth_mm']} mm, "
    f"{spread['elevation_deg']} degrees over the axis, lengths {spread['scale']} times the true "
    f"ones. First speed of chips {speed['low']:.1f} to {speed['high']:.1f} m/s over the draws, and "
    f"{lands['low']:.0f} to {lands['high']:.0f} % of them land in view. No claim is tested here."
)
figures.conclude(result, [], origin)
