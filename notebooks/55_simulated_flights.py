# %% [markdown]
# # Measured flights beside simulated ones
#
# **Published** (thesis, appendix A.2, Figs A.5 to A.7). Measured dwell times and velocities at 5
# bar are compared with CFD simulations of another group: "a satisfactory agreement". But the
# simulated chips and granules penetrate more than 4 m and papers land at 3 m. The measured ones
# do so rarely or never.
#
# **Here.** The twin's own flights play the role of the simulation. Gas and particles are the
# same, but another batch; every particle counts from release to its end. Measured is what the
# camera and the whole chain make of the recording at 5 bar. Agreement is asked of the
# distributions (Kolmogorov and Smirnov's distance) and of the share that passes each metre.

# %% tags=["parameters"]
scale = "standard"  # quick (two campaigns, few frames), standard (250 frames each) or full
seed = 0  # of the scenes
jobs = 2  # processes
particles = 0  # simulated per fraction; 0: 50, 400 or 2000 by scale

# %%
import pandas as pd

from kilnflight.experiments import campaigns, confidence, flight_pictures, plots, statements
from kilnflight.project import figures, style
from kilnflight.scores import flights
from kilnflight.twin import truth
from kilnflight.twin.fitted import flight_inputs
from kilnflight.twin.flight import ENDS, Flight
from kilnflight.twin.gas import Gas

# %%
style.use_style()
particles = particles or {"quick": 50, "standard": 400, "full": 2000}[scale]
origin = figures.trace("55_simulated_flights", {"scale": scale, "particles": particles}, seed=seed)
results = campaigns.results(scale, seed, jobs)
bar = max(pressure for _, pressure in results.true)
names = list(dict.fromkeys(name for name, _ in results.true))

# %%
inputs = flight_inputs().applied(Flight(), Gas())
flown = {name: truth.released(name, bar, inputs, particles, seed + 55) for name in names}
simulated = {(name, bar): truth.true_flight_values(each) for name, each in flown.items()}
measured = {key: results.measured[key] for key in simulated}
by_source = {"simulated": simulated, "measured": measured}

# %% [markdown]
# ## Simulated trajectories

# %%
picture = flight_pictures.draw_simulated_in_space(flown, 30, bar)
ends = [(name, ENDS[end]) for name in names for end in sorted(flown[name].end)]
data = pd.DataFrame(ends, columns=["fraction", "end"]).groupby(["fraction", "end"], sort=False)
data = data.size().reset_index(name="particles")
caption = "Thirty simulated flights each, dots 1 m apart, after Fig. A.5; the table: how all end."
figures.save("fig-a-5-simulated", data, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Dwell times

# %%
shown = 40  # flights of each fraction
times = {name: each.end_s for name, each in flown.items()}
picture = flight_pictures.draw_simulated_paths(flown, times, shown, "dwell time (s)", bar)
parts = {
    name: pd.DataFrame({"end_s": times[name], "depth_m": each.end_position_m[:, 0]}).head(shown)
    for name, each in flown.items()
}
data = pd.concat(parts, names=["fraction", "flight"]).reset_index()

# %%
caption = (
    f"{shown} simulated flights of each fraction from the side, coloured by dwell time (5 to 95 % "
    "of all), after the left part of Fig. A.6. The table says when and how far from the lance each "
    "ends."
)
figures.save("fig-a-6-paths", data, picture=picture, caption=caption, provenance=origin)

# %%
picture, ((axes,),) = style.canvas(1, 1, width_mm=style.PAGE_MM, height_mm=75)
groups = {kind: [values[name, bar].dwell_s for name in names] for kind, values in by_source.items()}
plots.draw_grouped_boxes(axes, groups, names)
axes.set(ylabel="dwell time (s)", ylim=(0, 1.5), title=f"{bar} bar")
_ = axes.legend(*axes.get_legend_handles_labels())
data = pd.DataFrame(
    {"source": source, "fraction": name} | flights.box(times)
    for source, group in groups.items()
    for name, times in zip(names, group, strict=True)
)

# %%
caption = "Dwell times, simulated and measured; after the right part of Fig. A.6."
figures.save("fig-a-6-dwell", data, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Velocity in depth

# %%
speeds = {name: each.velocity_m_s[:, :, 0] for name, each in flown.items()}
picture = flight_pictures.draw_simulated_paths(flown, speeds, shown, "velocity in depth (m/s)", bar)
parts = {
    name: pd.DataFrame(each.velocity_m_s, columns=flights.METRES).head(shown)
    for (name, _), each in simulated.items()
}
data = pd.concat(parts, names=["fraction", "flight"]).reset_index()
columns = {"var_name": "metre", "value_name": "velocity_m_s"}
data = data.melt(["fraction", "flight"], **columns, ignore_index=False).sort_index(kind="stable")
caption = (
    "The same flights coloured by their velocity in depth (scale: 5 to 95 % of all moments), after "
    "the left part of Fig. A.7; the table has the mean velocity in each metre (Eq. 5.8), empty "
    "where it was not passed."
)
figures.save("fig-a-7-paths", data, picture=picture, caption=caption, provenance=origin)

# %%
picture = flight_pictures.draw_velocity_boxes(by_source, list(simulated))
caption = (
    "Velocity in depth within each metre, simulated and measured, with the number of particles "
    "that passed it; after the right part of Fig. A.7."
)
data = campaigns.by_source(by_source)
figures.save("fig-a-7-velocity", data, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Do they agree?
#
# Ours: "satisfactory agreement" is made a number; nothing printed says how far apart they are.

# %%
agree = confidence.distribution_distances(simulated, measured)
caption = (
    "Kolmogorov and Smirnov's distance between simulated and measured distributions, and the "
    "probability of one as large if they were the same."
)
figures.save("simulated-agreement", agree, caption=caption, provenance=origin)

# %% [markdown]
# Ours: the one number that the appendix prints about the simulation, beside by_source.

# %%
reach = statements.beside_published(measured, simulated, ["penetration"])
reach = reach.rename(columns={"true": "twin"}).round(2)
caption = (
    "How far from the lance the flights of the thesis's CFD end, those simulated here, and those "
    "measured here (m)."
)
figures.save("simulated-penetration", reach, caption=caption, provenance=origin)

# %% [markdown]
# ## Result
#
# The thesis calls box plots that overlap an agreement. Distances between distributions are a
# harder test; with enough particles the measuring error alone fails it.

# %%
far = agree.dropna(subset="p")
result = (
    "Simulated and measured distributions differ beyond chance in "
    f"{(far['p'] < 0.05).sum()} of {len(far)} cases; "
    f"distances {far['distance'].min():.2f} to {far['distance'].max():.2f}."
)
figures.conclude(result, [], origin)
