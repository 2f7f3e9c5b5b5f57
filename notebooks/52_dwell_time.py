# %% [markdown]
# # How long particles fly
#
# **Published** (thesis, section 5.3.1, Figs 5.18 and 5.19, A.6). From the lance to landing or
# complete burning out: medians of 0.3 to 0.5 s at 4.5 bar, wood chips first at both pressures,
# PE granules longest at 4.5 bar and much shorter at 5 bar.
#
# **Here.** Measured on the twin's eight campaigns with the whole chain, beside the truth of the
# same recordings. Flights that end neither on the wall nor in flames were lost by the camera or
# the tracker; they are counted as the thesis counts them, with the time they were seen. The three
# columns are never mixed: measured minus true is the error of the method, true minus published
# how far the twin is from the experiment.

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
origin = figures.trace("52_dwell_time", {"scale": scale}, seed=seed)
wanted = campaigns.campaigns(scale, campaigns.settings_from_labels(scale, seed), seed)
measured = campaigns.measure(wanted, Workers(jobs))
error_budget.prepare_truth(wanted, Workers(jobs))
generator = np.random.default_rng(seed)
found, true = results.by_campaign(measured), results.true_results(wanted)
both = accuracy.compare_campaigns(wanted, measured)

# %% [markdown]
# ## How flights end
#
# Fig. 5.18: landed unlit (a), landed burning (b), burnt out in the air (c); and lost.

# %%
ends = accuracy.count_endings(measured)
caption = (
    "How measured flights end, after Fig. 5.18, and how many trajectories were left out because "
    "they do not start at the lance."
)
figures.save("fig-5-18-endings", ends, caption=caption, provenance=origin)

# %%
known = accuracy.ending_table(both)
caption = (
    "How flights end as measured (columns) by how they truly end (rows), in particles whose whole "
    "flight is recorded; of several tracks of a particle the longest. A step of the grey values "
    "counts as ignition (notebook 54), also of particles that never burn, and what does not land "
    "after one as burnt out."
)
figures.save("fig-5-18-true-endings", known, caption=caption, provenance=origin)

# %%
picture, cases = flight_pictures.dwell_cases(measured)
caption = (
    "What dwell time means, after Fig. 5.18, on measured flights from the side: from the lance to "
    "landing or burning out. Of each case the one with the median dwell time."
)
figures.save("fig-5-18-cases", cases, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Dwell times, measured and true

# %%
data = accuracy.dwell_times(measured, both)
picture = flight_pictures.dwell_boxes(data, list(found))
caption = (
    "Dwell times, after Fig. 5.19: true of all flights that begin and end within the recording, "
    "true of those that were measured, and measured of all flights from the lance. Numbers: "
    "flights. Shaded: where the text puts the medians at 4.5 bar. In the table, particle -1: a "
    "false flight, a further one of its particle, or of one that the recording cuts."
)
figures.save("fig-5-19-dwell-time", data, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# The printed medians have no intervals; those here say which orders of fractions are beyond
# chance. Quartiles, shares and every printed number are kept for checks.

# %%
every = confidence.interval_table(found, true, ["dwell"], generator)
rows = confidence.dwell_medians(every, true)
caption = (
    "Median dwell time in s by fraction and pressure with its 95 % interval (bootstrap over "
    "particles), beside the true median of all flights in the same frames, and whether the "
    "interval covers it."
)
figures.save("dwell-medians", rows, caption=caption, provenance=origin)

# %%
caption = "Quartiles, spread and shares of the dwell time with 95 % intervals, and true."
figures.save_check("dwell-intervals", every.round(4), caption=caption, provenance=origin)
printed = results.beside_published(found, true, ["dwell"])
printed = confidence.with_intervals(printed, every).round(3)
caption = "Every printed number about dwell times, with truth, measurement and its interval."
figures.save_check("dwell-published", printed, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts

# %%
verdicts = flight_claims.dwell_verdicts(measured, found, generator)
first = flight_claims.by_pressure(found, "dwell median (s)").iloc[:, 0]
parts = [f"{name} {value:.2f}" for name, value in first.items()]
result = (
    f"Median dwell time at {first.name} bar (s): {', '.join(parts)}; the intervals of "
    f"{int(rows['covers'].sum())} of {len(rows)} cells cover the true median."
)
figures.conclude(result, verdicts, origin)
