# %% [markdown]
# # Accuracy of the measured flights
#
# **Published.** Nothing: the thesis could not know how long a particle truly flew. It calls the
# regression "qualified" and compares fractions and pressures by medians without intervals.
#
# **Here.** The twin knows. It gives the share of the measurable particles that were detected.
# Errors, measured minus true, are those of dwell time, velocity in the first metre and ignition
# time. Then one step of the chain after the other is replaced by the truth, to see where the
# error comes from. Last, which differences between fractions and pressures are beyond chance,
# with our numbers of particles and with those of Table 5.15, the only ones printed.

# %% tags=["parameters"]
scale = "standard"  # quick (two campaigns, few frames), standard (four, 200 frames each) or full
seed = 0  # of the scenes, and of the bootstrap
jobs = 2  # processes

# %%
import numpy as np

from kilnflight.experiments import accuracy, campaigns, confidence, flight_pictures
from kilnflight.project import figures, style

# %%
style.use_style()
origin = figures.trace("56_accuracy", {"scale": scale}, seed=seed)
results = campaigns.results(scale, seed, jobs)
generator = np.random.default_rng(seed)
budget = accuracy.error_budget(results, jobs)
whole = budget[budget["replaced_step"] == "whole chain"].reset_index(drop=True)

# %% [markdown]
# ## The main table
#
# Ours: what the numbers of notebooks 52 to 54 are worth, in one row for each campaign. Measurable
# are the particles whose flight begins and ends within the recording and that a person could have
# followed. Detected are those with a trajectory from the lance that is not refused. Errors of dwell
# time are those of complete flights, as a lost one has no dwell time.

# %%
table = accuracy.accuracy_in_words(whole, results)
caption = (
    "Particles that the whole chain detects, with the 95 % interval of the share, and the errors "
    "particle by particle. An error is the median of measured minus true with its 95 % interval. "
    "Scatter: half the range that holds 68 %. Campaign dwell: the median that would be published, "
    "of complete flights, and of all true ones. It also depends on which particles are detected "
    "and which flights are lost. False flights: those from the lance of no particle, of all that "
    "count; refused: those that count nowhere. Of those detected, in how many ignition was "
    "detected: of the truly lit, and, wrongly, of the unlit ones."
)
figures.save("accuracy", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Where the error comes from
#
# Ours: it shows which step to better first. True positions come without scatter, without false
# ones, and with grey values of two levels, unlit and lit. Detection of ignition from them is as
# good as it can be. True links are by place in the image. A depth outside of the tracker's gate
# is left out, as it is what is behind the particle. Each row counts the particles that were
# detected in that case, which differ. True trajectories pass the true positions of the particle
# that a track belongs to, in place of what the regression makes of the track. Two rows have
# another regression on our own tracks: axes weighted by the RMSE of Table 5.18, and also a robust
# loss. The printed one has no weights.

# %%
columns = ["fraction", "pressure_bar", "replaced_step", "measurable_particles"]
columns += ["detected_particles", "false_flights"]
kinds = ("n", "bias", "low", "high", "spread")
columns += [f"{name}_{kind}" for name in accuracy.QUANTITIES for kind in kinds]
data = budget[columns]
picture = flight_pictures.draw_budget_steps(data)
caption = (
    "Measured minus true, by what was replaced by the truth: median (mark) and half the range that "
    "holds 68 % (bar), means over both pressures. What remains with true positions and links is "
    "due to regression, landing and the test of ignition. True depth has our tracks with depths "
    "without scatter, true trajectories our tracks without regression."
)
figures.save("accuracy-steps", data, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Result
#
# Do the intervals cover the truth? Of the medians of dwell time, ignition time and velocity in
# the first three metres: an interval knows of chance, not of bias. Which differences are
# resolved? Compared are fractions at one pressure and pressures of one fraction, by medians and
# ignited shares. The numbers of particles are ours and those of Table 5.15. Beyond chance is not
# right: an interval knows nothing of bias.

# %%
medians = confidence.median_table(results.measured, results.true, generator)
apart = confidence.all_differences(results.measured, results.true, generator)

# %%
share = 100 * whole["detected_particles"].sum() / max(whole["measurable_particles"].sum(), 1)
dwell = medians[medians["outcome"] == "dwell median (s)"]
off = [each.dropna() for each in (whole["dwell_s_bias"], dwell["estimate"] - dwell["true"])]
span, of_campaigns = (f"{s.min():+.3f} to {s.max():+.3f} s" if len(s) else "unknown" for s in off)

# %%
result = (
    f"Of the measurable particles {share:.0f} % are detected. Dwell times of complete flights are "
    f"off by {span} (medians over the particles of each campaign). The medians of the campaigns "
    f"are off by {of_campaigns}. "
    f"{confidence.describe_coverage(medians)} {confidence.describe_resolved(apart)}"
)
figures.conclude(result, [], origin)
