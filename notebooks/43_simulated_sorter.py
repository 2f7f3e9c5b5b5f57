# %% [markdown]
# # A simulated sorter beside the authors'

# %% tags=["hide-input"]
from IPython.display import Markdown

from kilnflight.belt import bodies, evaluation, recordings, sorter
from kilnflight.belt.machine import BULKS
from kilnflight.experiments import belt_2020, belt_calibration
from kilnflight.project import claims, figures, style

files = recordings.find_dem()
there = f"**Input:** {belt_2020.describe_own()}"
missing = f" {bodies.missing()}".rstrip()
beside = (
    " The authors' DEM tracks stand beside it." if files else " The authors' tracks are not here."
)
Markdown(f"{there}.{missing}{beside}")

# %% [markdown]
# **Published** (2016 paper, section III; 2020 paper, section 4). Wooden spheres, cuboids and
# cylinders on a belt of 40 cm x 18 cm at 1.5 m/s, simulated by the discrete element method with
# steps of 0.1 ms, sampled at 1000 Hz. Friction, restitution and the shape of slide and feeder
# were "determined experimentally"; no value is printed. The public tracks have 100 Hz.
#
# **Here.** The same bodies in MuJoCo with steps of 0.2 ms. Seven free values of slide and
# friction were found with the *spheres* of the authors' tracks alone (mean and standard
# deviation of the velocity along the belt, median of the absolute velocity across it) and
# frozen. Cylinders and cuboids have the same values, so theirs is a prediction. Restitution is
# no free value and hangs on the step: spheres part with 0.22 to 0.34 of their closing speed, by
# where within a step they meet, and with 0.28 to 0.31 of it at steps of 0.05 ms.

# %% tags=["parameters"]
scale = "standard"  # quick (120 particles of each material), standard (300) or full (4000)
seed = 2020  # of the simulation
jobs = 2  # processes

# %%
import time
from dataclasses import asdict

import numpy as np
import pandas as pd

from kilnflight.experiments import belt_contacts

style.use_style()
inputs = list(files.values())
origin = figures.trace("43_simulated_sorter", {"scale": scale}, seed=seed, inputs=inputs)
tracks = belt_2020.variants(belt_2020.PARTICLES[scale], seed, jobs)
tracks |= {("authors-dem", name): recordings.read_dem(path) for name, path in files.items()}
pd.Series({key: one["particle"].nunique() for key, one in tracks.items()}, name="particles")

# %% [markdown]
# ## The free values
#
# First what handbooks say ("inputs only"), then what the spheres say. The cost is the mean
# squared misfit in units of 0.01 m/s (along the belt) and 0.002 m/s (across it). What was not
# fitted is assumed and says so; cylinders and cuboids lie on the slide in any direction.
#
# The search stopped at its budget (see the caption), not because it had converged: these are the
# best values that were met, and whether they are the only ones that fit was not asked. The cost
# is that of the same particles.

# %%
found = sorter.fitted_record()
values = belt_calibration.all_values(sorter.fitted_values())
cost = ["cost", found["cost_inputs_only"], found["cost_calibrated"], "misfit to the spheres"]
values.loc[len(values)] = cost
values = values.round(4)
caption = (
    "Values of slide and contacts before and after seven of them were found with the authors' "
    f"spheres ({found['particles']} particles, {found['evaluations']} evaluations, then the search "
    "stopped at its budget), and where the others come from. Costs are on the same particles."
)
figures.save("sorter-friction-values", values, caption=caption, provenance=origin)

# %% [markdown]
# ## Velocities along and across the belt
#
# All at 100 Hz: our 1000 Hz thinned.

# %%
profiles = pd.concat(
    {
        key: evaluation.motion_profile(evaluation.velocities(one), sorter.PLACES_MM)
        for key, one in tracks.items()
    },
    names=["variant", "data_set"],
).reset_index(["variant", "data_set"])
variants = list(dict.fromkeys(profiles["variant"]))
styles = dict(zip(variants, zip(style.COLOURS, style.LINES, strict=True), strict=False))
quantities = {"mean_m_s": "mean along", "std_m_s": "spread along", "lateral_m_s": "median across"}

# %% tags=["hide-input"]
size = {"width_mm": style.PAGE_MM, "height_mm": 130}
picture, grid = style.canvas(3, 3, **size, sharex=True)
for panels, (name, label) in zip(grid, quantities.items(), strict=True):
    panels[0].set_ylabel(f"{label} (m/s)")
    for axes, data_set in zip(panels, belt_2020.DATA_SETS, strict=True):
        axes.set_title(data_set)
        for variant, one in profiles[profiles["data_set"] == data_set].groupby("variant"):
            colour, line = styles[variant]
            axes.plot(one["x_mm"], one[name], color=colour, ls=line, label=variant)
for axes in grid[-1]:
    axes.set_xlabel("x along the belt (mm)")
for axes in grid[0, [0, 2]]:
    axes.legend(loc="lower right")

# %%
caption = (
    "Mean and standard deviation of the velocity along the belt, and median of the absolute "
    "velocity across it, of our simulation and of the authors' tracks. The free values were "
    "found with the spheres; cuboids and cylinders are predictions."
)
figures.save("fig-sorter-velocity", profiles, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## How far off
#
# Root mean square over the belt of simulation minus the authors' tracks. Our cylinders roll
# where they lie askew: they lag behind and drift. The authors' cylinders gain as much as
# their cuboids and do not drift, so they hardly roll. With axes within some 20 degrees of the
# belt's direction ("along the belt") ours keep up, but still drift; this was tried after the
# first comparison and stands for no other result. Collisions are fewer here: the authors'
# feed has bursts, and their spread across the belt is larger than ours everywhere.

# %%
misfit = belt_2020.misfits(profiles, belt_2020.AUTHORS).round(5)
caption = "Root mean square over the belt of simulated minus the authors' velocities (m/s)."
if len(misfit):  # without the authors' tracks there is nothing to be off from
    figures.save("sorter-misfit", misfit, caption=caption, provenance=origin)
misfit

# %% [markdown]
# ## What the contacts change
#
# No paper prints how soft a contact is, and neither friction between particles nor at walls was
# fitted. Here the same few particles are simulated with one value changed at a time, in steps of
# 0.1 ms; `other particles` shows what chance alone does.
#
# What bodies do to each other and to walls hardly matters, in spite of restitutions from 0.12 to
# 0.55: most particles touch nobody on the belt. The contact with the belt does matter where a
# particle lands: it comes down at some 0.3 m/s, and how much of that push friction takes part in
# depends on how long the push lasts against the slip time. Twice as soft adds up to 4 mm/s to the
# mean velocity, twice as stiff takes up to 14 mm/s off, and particles catch up with it later, most
# of all what rolls. So these two times have not converged: they are part of the sorter that was
# fitted to the spheres, and the predicted means of cuboids and cylinders are no better than
# these 14 mm/s. Spread along the belt and velocity across it change by 2 to 4 mm/s at most, less
# than by feeding other particles.

# %%
fed = {"quick": 8, "standard": 20, "full": 40}[scale]  # particles of each material
some = belt_2020.DATA_SETS[:1] if scale == "quick" else belt_2020.DATA_SETS
studied = pd.DataFrame()
if bodies.is_installed():
    studied = belt_contacts.study(sorter.calibrated_sorter(), fed, seed, some)
    changed = belt_contacts.changes(studied).round(2)

# %% tags=["hide-input"]
looks = {"mean_mm_s": "mean along", "gain_mm_s": "gain along", "std_mm_s": "spread along"}
looks |= {"lateral_mm_s": "median across"}
size = {"width_mm": style.PAGE_MM, "height_mm": 95, "sharey": True}
picture, (panels,) = style.canvas(1, len(looks), **size) if len(studied) else (None, ((),))
for axes, (name, label) in zip(panels, looks.items(), strict=False):
    for k, (data_set, one) in enumerate(changed.groupby("data_set", sort=False)):
        mark = {"marker": style.MARKERS[k], "color": style.COLOURS[k], "ls": "", "ms": 4}
        axes.plot(one[name], one["setting"], label=data_set, mfc="none", **mark)
    axes.axvline(0, color="0.6", lw=0.8, ls="-")
    axes.set(title=label, xlabel="change (mm/s)")
if len(studied):
    panels[0].invert_yaxis()
    _ = picture.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)

# %%
caption = (
    "Change of the velocity with one contact value changed: mean along the belt, its gain from 425 "
    "to 750 mm, its standard deviation, median size across. As used is "
    f"{belt_contacts.described(sorter.calibrated_sorter())}; {fed} particles of each."
)
part = {"picture": picture, "caption": caption, "provenance": origin}
figures.save("fig-sorter-contacts", changed, **part) if len(studied) else None

# %%
caption = (
    "Velocities (means over the belt) and restitution (two spheres, by where within a step they "
    "meet) for one contact value changed at a time."
)
part = {"caption": caption, "provenance": origin}
figures.save("sorter-contacts", studied.round(4), **part) if len(studied) else None

# %% [markdown]
# ## What a simulated second costs
#
# Of the sorter that is used everywhere, in one process: processor time, so that other work on the
# machine does not count.

# %%
rows, used = [], sorter.calibrated_sorter()
for name, bulk in BULKS.items() if bodies.is_installed() else ():
    start = time.process_time()
    one = used(bulk, 60, np.random.default_rng(seed))
    spent, simulated = time.process_time() - start, one["time_s"].max()
    row = {"data_set": name, "simulated_s": simulated, "particles": one["particle"].nunique()}
    row["most_on_belt"] = one.groupby("frame").size().max()
    rows.append(row | {"cpu_s_per_simulated_s": spent / simulated})
cost = pd.DataFrame(rows).round(2)
caption = "What a simulated second of the calibrated sorter costs: processor time on one core."
figures.save("sorter-cost", cost, caption=caption, provenance=origin) if rows else None

# %% [markdown]
# ## Claim belt20-6 on each source
#
# Notebook 40 gives the verdict; here is what each source says.

# %%
rows = [
    {"variant": variant, **asdict(claims.judge("belt20-6", answer["belt20-6"]))}
    for variant, one in profiles.groupby("variant", sort=False)
    for answer in [belt_2020.speed_answers(one)]
]
slower = pd.DataFrame(rows)[["variant", "verdict", "measured"]]
caption = "Claim belt20-6, slower than the belt and still accelerating, by source."
figures.save("sorter-belt20-6", slower, caption=caption, provenance=origin)

# %%
result = f"Our own simulation is {belt_2020.describe_own()}."
if files and bodies.is_installed():
    off = misfit[misfit["variant"] == "calibrated"].set_index("data_set")["mean_m_s"]
    each = ", ".join(f"{name} {1000 * off[name]:.0f}" for name in belt_2020.DATA_SETS)
    result += f" Its mean velocities are off by (mm/s, root mean square): {each}."
figures.conclude(result, [], origin)
