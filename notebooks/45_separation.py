# %% [markdown]
# # What better predictions mean for a bar of valves

# %% tags=["hide-input"]
from dataclasses import replace

import pandas as pd
from IPython.display import Markdown

from kilnflight import belt
from kilnflight.belt import recordings
from kilnflight.belt.valves import MODELS, ValveBar, shares
from kilnflight.experiments import belt_2020
from kilnflight.project import figures, style

files = recordings.find_dem()
source = belt_2020.AUTHORS if files else belt_2020.OWN
own = f"**Own simulation**, {belt_2020.describe_own()}; no tracks of the authors (`make data`)."
Markdown("**Input:** the authors' DEM tracks at 100 Hz." if files else own)

# %% [markdown]
# **Published** (both belt papers). Predictions serve to open the right valve at the right time.
# With 1.5 mm "a reliable separation is ensured for commonly used separation mechanisms" (2016,
# section IV.C); how many particles are hit was not evaluated.
#
# **Here.** A bar of evenly spaced valves at the end of the prediction phase (773 mm, 15 mm before
# the edge, for every source: the authors' tracks end at the edge). One particle in ten is to be
# blown out: the valve nearest to its predicted place opens around its predicted time. A particle
# is hit if its centre passes an open valve, whoever that was opened for; its size and the way of
# the air are neglected. Number of valves, width and time are ours to vary; no claim is tested.
#
# Predictions start from the simulation's exact positions. No camera takes part: no noise of
# pictures, no particle that is missed, nor two seen as one (notebook 42). So these shares are what
# the models allow, not what a sorter with a camera reaches.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 2020  # of who calibrates, who is blown out, and of our own simulation
blown = 0.1  # share of the particles to be blown out
jobs = 2  # processes of our own simulation

# %%
style.use_style()
draws = {"quick": 1, "standard": 5, "full": 20}[scale]
setting = {"scale": scale, "draws": draws, "blown": blown}
origin = figures.trace("45_separation", setting, seed=seed, inputs=files.values())
phase = belt.PredictionPhase()
loaded = belt_2020.load_tracks(files, seed, belt_2020.PARTICLES[scale], jobs)
observed = {
    name: phase.observe(tracks) for (given, name), tracks in loaded.items() if given == source
}
times_ms = (0.5, 1, 2, 3, 5, 7, 10, 15, 20)
widths_mm = (1, 2, 3, 4, 7.5, 10, 15, 20)
usual = ValveBar()  # 32 valves, each as wide as its pitch, open for 5 ms
bars = [usual, *(replace(usual, open_s=time / 1000) for time in times_ms if time != 5)]
bars += [replace(usual, valve_mm=float(width)) for width in widths_mm]
bars += [replace(usual, valves=count) for count in (8, 16, 64, 128)]

# %%
parts = {
    (name, draw): shares(part, phase, bars, seed + draw, blown)
    for name, part in observed.items()
    for draw in range(draws)
}
every = pd.concat(parts, names=["data_set", "draw"]).droplevel(-1).reset_index()
keys = ["data_set", "model", "valves", "valve_mm", "open_ms"]
table = every.drop(columns="draw").groupby(keys, sort=False).mean().reset_index()
table.insert(0, "source", source)
as_wide = table["valve_mm"] == usual.belt_mm / table["valves"]
usual_time, usual_count = table["open_ms"] == 1000 * usual.open_s, table["valves"] == usual.valves
varied = {"open_ms": table[usual_count & as_wide], "valve_mm": table[usual_count & usual_time]}

# %% [markdown]
# ## Over the time that a valve is open
#
# 32 valves of 5.6 mm each, about the size of a particle. This figure and the next are ours: they
# turn errors of prediction into what a sorter is built for, which neither paper does.

# %% tags=["hide-input"]
shown = ["IV-Straight", "CV-CV", "CVBC-CV", "CA-CA", "IA-Ratio"]
styles = list(zip(style.COLOURS, style.LINES, style.MARKERS, strict=True))
labels = {"open_ms": "time that a valve is open (ms)", "valve_mm": "width of a valve's jet (mm)"}
share = ["particles to be blown out\nthat are hit (%)", "other particles\nthat are hit (%)"]
size = {"width_mm": style.PAGE_MM, "height_mm": 95, "sharex": True, "sharey": "row"}
drawn = {along: style.canvas(2, len(observed), **size) for along in varied}

# %% tags=["hide-input"]
for along, (_, grid) in drawn.items():
    for (name, part), column in zip(varied[along].groupby("data_set"), grid.T, strict=True):
        for model, (colour, line, mark) in zip(shown, styles, strict=False):
            rows = part[part["model"] == model].sort_values(along).set_index(along)
            look = {"color": colour, "ls": line, "marker": mark}
            column[0].plot(rows["hit_percent"], label=model, **look)
            column[1].plot(rows["inadvertent_percent"], **look)
        column[0].set_title(name)
        column[1].set_xlabel(labels[along])
    grid[0, 0].set(ylabel=share[0], ylim=(0, 103))
    grid[1, 0].set_ylabel(share[1])
    _ = grid[1, 0].legend(*grid[0, 0].get_legend_handles_labels(), loc="upper left")

# %%
caption = (
    "Hits and inadvertent hits over the time that a valve is open, by model: 32 valves, one "
    f"particle in ten to be blown out ({source}, exact positions, no camera). IV-Straight is what "
    "a line-scan camera assumes; arrival model, then lateral model."
)
part = {"picture": drawn["open_ms"][0], "caption": caption, "provenance": origin}
figures.save("fig-belt-separation", varied["open_ms"], **part)

# %% [markdown]
# ## Over the width of a valve
#
# The same 32 valves, their jets narrower than the pitch of 5.6 mm (gaps between them) or wider
# (they overlap); each is open for 5 ms. The valve is chosen as before, by the predicted place. A
# particle's centre lies anywhere in its pitch, so that a narrow jet misses it however good the
# prediction; beyond the pitch a jet makes up for bad predictions across and hits more others.

# %%
caption = (
    "Hits and inadvertent hits over the width of a valve's jet, by model: 32 valves at a pitch of "
    f"5.6 mm, each open for 5 ms, one particle in ten to be blown out ({source})."
)
part = {"picture": drawn["valve_mm"][0], "caption": caption, "provenance": origin}
figures.save("fig-belt-separation-width", varied["valve_mm"], **part)

# %% [markdown]
# ## By the number of valves
#
# Each valve is open for 5 ms. Narrower valves hit fewer others and need better predictions. In
# percent, by model and number of valves across 180 mm:

# %%
five = table[usual_time & as_wide]
values = ["hit_percent", "inadvertent_percent"]
wide = five.pivot(index=["data_set", "model"], columns="valves", values=values)
wide.reindex([name for name, _, _ in MODELS], level="model").round(1)

# %%
at = table[usual_count & usual_time & as_wide].set_index(["model", "data_set"])["hit_percent"]
first, best = at["IV-Straight"], at["IA-Ratio"]
result = (
    f"32 valves open for 5 ms hit {first.min():.0f} to {first.max():.0f} % of the particles by the "
    f"old model (IV-Straight), {best.min():.0f} to {best.max():.0f} % by IA-Ratio ({source}, exact "
    "positions, no camera). No claim is tested."
)
figures.conclude(result, [], origin)
