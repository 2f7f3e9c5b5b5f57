# %% [markdown]
# # Dwell time: how long particles fly
#
# **Published** (thesis, section 5.3.1, Figs 5.18 and 5.19, A.6). From the lance to landing or
# complete burning out: medians of 0.3 to 0.5 s at 4.5 bar. Wood chips are first at both
# pressures, PE granules longest at 4.5 bar and much shorter at 5 bar.
#
# **Here.** Measured on the twin's eight campaigns with the whole chain, beside the truth of the
# same recordings. A dwell time ends "by landing or complete burning out", and what is not fully
# tracked "cannot be analyzed" (A.1): only complete flights have one. Flights that the camera or
# the tracker lost are known to last longer than they were seen. They are censored in the curves
# of Kaplan and Meier, and in no median or box. Measured minus true is the error of the method,
# true minus published the distance of the twin from the experiment.

# %% tags=["parameters"]
scale = "standard"  # quick (two campaigns, few frames), standard (four, 200 frames each) or full
seed = 0  # of the scenes, and of the bootstrap
jobs = 2  # processes

# %%
import numpy as np

from kilnflight.experiments import (
    accuracy,
    campaigns,
    confidence,
    dwell,
    flight_claims,
    flight_pictures,
)
from kilnflight.project import figures, style

# %%
style.use_style()
origin = figures.trace("52_dwell_time", {"scale": scale}, seed=seed)
results = campaigns.results(scale, seed, jobs)
generator = np.random.default_rng(seed)
both = accuracy.compare_campaigns(results.campaigns, results.tables)
data = dwell.flights_and_particles(results.tables, both)
followed = {each.key: campaigns.followed_values(each) for each in results.campaigns}

# %% [markdown]
# ## Complete, lost, refused
#
# Ours: the thesis does not say how many flights its boxes hold. Refused is what no particle does:
# it leaves the kiln, turns back behind the lance, or is over twice as fast as the lance's air.

# %%
counts = dwell.count_flights(results.tables, results.measured)
caption = (
    "Flights from the lance: complete ones by their end, those that were lost, and those that were "
    "refused, by reason. Only complete flights have a dwell time. Burning and burnt out hang on "
    "our test of grey values, which often errs (notebook 54): a step counts, also of what never "
    "burns."
)
figures.save("dwell-flights", counts, caption=caption, provenance=origin)

# %% [markdown]
# Whom refusing takes, as the truth tells: ours.

# %%
refused = accuracy.compare_refused(results.campaigns, results.tables)
caption = (
    "Flights from the lance that count and that are refused, by fraction: how many, and positions "
    "in each (median). What is true of their particles whose whole flight is recorded: median "
    "dwell time and velocity in the first metre. Where these medians differ, refusing selects."
)
figures.save("dwell-refused", refused.round(4), caption=caption, provenance=origin)

# %% [markdown]
# The thesis refuses no flight: its Fig. 5.23 shows negative velocities. So the medians without our
# refusal stand in a table of their own.

# %%
unrefused = campaigns.values_by_campaign(
    dwell.nothing_refused(results.tables), list(results.measured)
)
table = confidence.median_table(unrefused, results.true, generator)
table = table[~table["outcome"].str.startswith("ignition")]
swings = table[table["outcome"].str.startswith("velocity") & (table["estimate"] > 100)]
most = swings[["number", "estimate"]].max().fillna(0)
caption = (
    "Median dwell time (s) of complete flights and velocity (m/s) in each metre if nothing is "
    "refused. With 95 % intervals of six flights or more, beside the true ones. Velocities beyond "
    f"100 m/s ({len(swings)} medians of up to {most['number']:.0f} flights, the largest "
    f"{most['estimate']:,.0f} m/s) are not physical: polynomials swing where nothing was "
    "detected. Compare the medians below and those of notebook 53."
)
figures.save("medians-unrefused", table.round(4), caption=caption, provenance=origin)

# %% [markdown]
# ## How flights end
#
# Fig. 5.18: landed unlit (a), landed burning (b), burnt out in the air (c); and lost. Ours: the
# thesis has no counts, and could not know how the particles truly ended.

# %%
ends = dwell.ending_table(data)
caption = (
    "How flights from the lance end as measured (columns), by how they truly end (rows), after "
    "Fig. 5.18. Particles whose whole flight is recorded; of several tracks of a particle the "
    "longest. No whole flight: further tracks, particles that the recording cuts, false flights. A "
    "step of the grey values counts as ignition, also of particles that never burn: notebook 54 "
    "counts these false alarms. "
    "What does not land after one counts as burnt out."
)
figures.save("fig-5-18-endings", ends, caption=caption, provenance=origin)

# %% [markdown]
# The curves are the fits up to the end of the flight. A burnt out one ends with its last detection.
# One that lands ends where the fit meets the wall, before or after its last detection. Detections
# scatter about the fit in depth, so single ones lie deeper than its end.

# %%
picture, cases = flight_pictures.draw_dwell_cases(results.tables)
caption = (
    "What dwell time means, after Fig. 5.18, on measured flights from the side: from the lance to "
    "landing or burning out. Of each case the one with the median dwell time."
)
figures.save("fig-5-18-cases", cases, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Dwell times, measured and true

# %%
sources = {"true": results.true, "true, as followed": followed, "measured": results.measured}
picture = flight_pictures.draw_dwell_boxes(sources, list(results.measured))
columns = ["track", "measured_s", "seen_s", "ending", "particle", "true_s", "true_ending"]
data = data[["fraction", "pressure_bar", *columns]]
caption = (
    "Dwell times of complete flights, after Fig. 5.19. True of all flights that begin and end "
    "within the recording; true of those that a person sees until they end; measured. Numbers: "
    "flights. Shaded: where the text puts the medians at 4.5 bar. In the table, seen: how long a "
    "lost flight was seen. The axis ends at 1.5 s. Particle -1: a false flight, a further one of "
    "its particle, or of one that the recording cuts."
)
figures.save("fig-5-19-dwell-time", data, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# Ours: what the boxes leave out. Were long flights lost more easily than short ones, medians of
# complete flights alone would be too short. A censored flight counts as flying until it was last
# seen. That holds only where losses do not depend on what comes next: particles are lost where they
# leave the picture or fade, some just before their end, and then the curve overshoots.

# %%
curves = dwell.curves(sources)
picture = flight_pictures.draw_still_flying(curves, list(results.measured))
caption = (
    "Share of the particles that still fly by time from the lance (Kaplan and Meier), lost flights "
    "censored when last seen. True; true as far as a person could follow; measured, with its 95 % "
    "interval (shaded). Orange: where the text has the medians at 4.5 bar."
)
figures.save("fig-5-19-still-flying", curves, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# Ours: the printed medians have no intervals; these say which orders of fractions are beyond
# chance.

# %%
rows = dwell.medians(results.measured, followed, results.true, generator)
caption = (
    "Median dwell time in s by fraction and pressure. Of complete flights with its 95 % interval "
    "(bootstrap over flights), and with lost ones censored (interval from that of the curve). "
    "Beside them the same two of the true flights as a person could follow them. Last: the true "
    "median of all flights in the same frames that land or burn out, and whether the interval of "
    "complete flights covers it, and that with lost ones. Empty: fewer than six flights, or a "
    "curve that ends before one half."
)
figures.save("dwell-medians", rows.round(4), caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts

# %%
verdicts = flight_claims.dwell_verdicts(results, generator)
middle = confidence.medians_in_words(results.measured, "dwell median (s)", digits=2)
with_lost = rows["covers_with_lost"]
result = (
    f"{dwell.describe(counts)} Median dwell time in s of complete flights {middle}. "
    f"Of the {rows['covers'].count()} campaigns with an interval and a truth, "
    f"{rows['covers'].sum()} cover the true median (of complete flights), "
    f"{with_lost.sum()} of {with_lost.count()} with lost flights censored. "
    f"{dwell.describe_refused(refused)}"
)
figures.conclude(result, verdicts, origin)
