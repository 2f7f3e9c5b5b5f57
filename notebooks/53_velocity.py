# %% [markdown]
# # How fast particles fly, metre by metre
#
# **Published** (thesis, section 5.3.1, Eq. 5.8, Figs 5.20 to 5.24). The mean velocity in depth
# within each metre from the lance, and the share of particles that pass it: wood chips from
# 13.5 down to 9 m/s, granules above 8 m/s, confetti from 7.4, paper shreds from 5.2 m/s; from
# 4.5 to 5 bar little changes.
#
# **Here.** Measured on the twin's eight campaigns with the whole chain, beside the truth of the
# same recordings. The flights of wood chips and confetti at 4.5 bar were what the twin was
# calibrated on; their truth is no prediction. The measurement of them is.

# %% tags=["parameters"]
scale = "standard"  # quick (two campaigns, few frames), standard (250 frames each) or full
seed = 0  # of the scenes, and of the bootstrap
jobs = 2  # processes

# %%
import numpy as np

from kilnflight.experiments import (
    accuracy,
    campaigns,
    confidence,
    error_budget,
    flight_claims,
    flight_pictures,
    results,
)
from kilnflight.project import figures, style
from kilnflight.project.parallel import Workers

# %%
style.use_style()
origin = figures.trace("53_velocity", {"scale": scale}, seed=seed)
wanted = campaigns.campaigns(scale, campaigns.settings_from_labels(scale, seed), seed)
measured = campaigns.measure(wanted, Workers(jobs))
error_budget.prepare_truth(wanted, Workers(jobs))
found, true = results.by_campaign(measured), results.true_results(wanted)
generator = np.random.default_rng(seed)

# %% [markdown]
# ## What is measured
#
# Eq. 5.8 on the flight that was detected over most metres.

# %%
picture, passed, name = flight_pictures.longest_slices(measured)
caption = (
    f"Space-sliced velocity (Eq. 5.8) of one {name}, after Fig. 5.20: V_n is one metre over the "
    "time between passing metre n - 1 and metre n."
)
figures.save("fig-5-20-slices", passed, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Every particle, every metre

# %%
pairs = accuracy.compare_velocities(wanted, measured)
known = pairs.dropna(subset=["measured_m_s", "true_m_s"])
picture = flight_pictures.velocity_scatter(known)
caption = (
    "Velocity in depth of each particle, measured and true (Eq. 5.8), in the first two metres; the "
    "boxes of Fig. 5.21 are in fig-5-22-velocity-boxes. The table has every metre. Particle: that "
    "of the truth; -1 belongs to none. Empty: not measured, or the metre was not passed."
)
table = pairs[[*results.KEYS, "particle", "slice_m", "measured_m_s", "true_m_s"]]
figures.save("fig-5-21-velocity", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Boxes by metre, after Figs 5.21 to 5.24

# %%
said = results.beside_published(found, true, ["velocity", "remaining", "landed"])
sources = {"true": true, "measured": found}
picture = flight_pictures.velocity_boxes(sources, list(found), said)
caption = (
    "Velocity in depth within each metre from the lance, true of all flights in the same frames "
    "and measured; after Figs 5.21 to 5.24. Orange bars: published medians or their bounds. "
    "Numbers: particles that passed the metre; what lies above 25 m/s is cut off."
)
table = results.by_source(sources)
figures.save("fig-5-22-velocity-boxes", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## The share that remains

# %%
picture = flight_pictures.remaining_shares(sources, said)
caption = (
    "Share of the particles that pass each metre: true of all flights in the same frames, and "
    "measured, where what is lost on the way counts as not remaining. Orange bars: published."
)
table = results.remaining_table(sources, said)
figures.save("fig-5-20-remaining", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## With intervals
#
# The medians answer which differences between fractions are beyond chance; no printed table has
# them. Spreads, shares and every printed number are kept for checks.

# %%
every = confidence.interval_table(
    found, true, ["velocity", "remaining", "landed", "spread"], generator
)
medians = every[every["outcome"].str.startswith("velocity")]
caption = (
    "Median velocity in depth (m/s) within each metre, measured, with the number of particles that "
    "passed it and its 95 % interval (bootstrap over these), and true. Without an interval: of "
    "fewer than six, and no more than those; a metre that was passed before the particle was seen "
    "may come out at any velocity (velocity-unseen)."
)
figures.save("velocity-medians", medians.round(3), caption=caption, provenance=origin)

# %%
others = every.drop(medians.index)
table = confidence.with_intervals(said, every).round(2)
ratios = confidence.ratio_table(found, generator)
behind = results.behind_lance(measured)
checks = {
    "velocity-others": (others.round(3), "Shares (%) and spreads (m/s) with 95 % intervals."),
    "velocity-published": (table, "Every printed number about velocity, with truth and interval."),
    "velocity-ratio": (ratios, "Median velocity in the first metre, 5 bar over 4.5 bar."),
    "velocity-behind": (behind, "Slices behind the lance, in how many flights, their velocities."),
}
for name, (table, caption) in checks.items():
    figures.save_check(name, table, caption=caption, provenance=origin)

# %% [markdown]
# ### Metres passed before the first detection
#
# The polynomials go back to the lance; what they pass before the first detection counts, as
# published. Here how many metres those are, what the medians come to without them, and how many
# are faster than any particle of the twin truly is in that metre.

# %%
unseen = confidence.unseen_metres(measured.slices, true, generator)
caption = (
    "Flights that passed each metre, how many of them before they were first seen (unseen), how "
    "many faster than any true particle there (too fast), and how many of these unseen; median "
    "velocity (m/s) of all, of the seen ones with its 95 % interval, and true."
)
figures.save("velocity-unseen", unseen.round(3), caption=caption, provenance=origin)

# %% [markdown]
# ### Backwards
#
# "Several velocity outliers of the paper shreds are negative". Eq. 5.8 with the first time a metre
# is reached cannot be negative in front of the lance; slices behind it are counted here. A
# trajectory that starts backwards is taken for one that did not come from the lance. One that
# starts forwards and turns back behind it counts, although no particle of the twin flies so: it
# is the polynomials that turn.

# %%
behind

# %% [markdown]
# ## Verdicts
#
# Statements with bounds: within them, or off by less than the unit of notebook 12.

# %%
verdicts = flight_claims.velocity_verdicts(measured, found, said, generator)
first = flight_claims.by_pressure(found, "velocity 0-1 m (m/s)").iloc[:, 0]
parts = [f"{name} {value:.1f}" for name, value in first.items()]
off = (known["measured_m_s"] - known["true_m_s"])[known["slice_m"] == 1.0]
far, near = unseen[unseen["metre"] > 3], unseen[unseen["metre"] < 4]
shift = (near["seen_m_s"] - near["median_m_s"]).abs().max()

# %%
result = (
    f"Median velocity in the first metre at {first.name} bar (m/s): {', '.join(parts)}. Measured "
    f"minus true, particle by particle: median {off.median():+.2f} m/s. Of "
    f"{unseen['number'].sum()} metres {unseen['unseen'].sum()} were passed before the particle was "
    f"seen, beyond 3 m {far['unseen'].sum()} of {far['number'].sum()}; without them no median of "
    f"the first three moves by over {shift:.1f} m/s."
)
figures.conclude(result, verdicts, origin)
