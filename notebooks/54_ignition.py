# %% [markdown]
# # When particles ignite
#
# **Published** (thesis, section 5.3.2, Figs 5.25 and 5.26). Where the grey value along a
# trajectory rises abruptly, a particle has ignited: 26 % of the confetti at 4.5 bar and under 20 %
# at 5 bar, 71 % and about 40 % of the paper shreds, none of the wood chips and granules.
#
# **Here.** A change point in the grey values of each trajectory from the lance, upward, abrupt and
# beyond chance (`kilnflight.ignition` states the test). Two readings: the grey values as they are,
# as published; and above the background, the median picture of the recording, because a
# small particle that passes from the dark inlet plate to the bright wall also rises. Both stand
# beside the truth. The share of confetti that ignites at 4.5 bar is what the twin was fitted to.

# %% tags=["parameters"]
scale = "standard"  # quick (two campaigns, few frames), standard (250 frames each) or full
seed = 0  # of the scenes, and of the bootstrap
jobs = 2  # processes

# %%
import numpy as np
import pandas as pd

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
origin = figures.trace("54_ignition", {"scale": scale}, seed=seed)
wanted = campaigns.campaigns(scale, campaigns.settings_from_labels(scale, seed), seed)
measured = campaigns.measure(wanted, Workers(jobs))
error_budget.prepare_truth(wanted, Workers(jobs))
generator = np.random.default_rng(seed)
above = measured._replace(flights=error_budget.flights_above_background(wanted, measured))
readings = {"as published": measured, "above background": above}
true = results.true_results(wanted)
found = {name: results.by_campaign(one) for name, one in readings.items()}
kinds = {"true": true} | found

# %% [markdown]
# ## In which particles ignition was detected

# %%
both = {name: accuracy.compare_campaigns(wanted, one) for name, one in readings.items()}
table = accuracy.ignition_errors(both)
caption = (
    "Found particles that truly ignite in flight (lit) and that do not (unlit), and in how many of "
    "them ignition was detected (told), by both readings of the grey values; with bias and spread "
    "of its time in s."
)
figures.save("ignition-told", table, caption=caption, provenance=origin)

# %%
flights = measured.flights[measured.flights["from_lance"]]
judged = pd.crosstab([flights[key] for key in results.KEYS], flights["ignition"]).reset_index()
caption = "Outcome of the test of ignition for all flights from the lance, grey values as they are."
figures.save_check("ignition-judged", judged, caption=caption, provenance=origin)

# %% [markdown]
# Flights of too few points to be judged count as unlit in every share, as do those that burn from
# their first detection on: they have no step.
#
# ## Shares in steps of 0.1 s

# %%
published = {name: results.beside_published(one, true, ["ignited"]) for name, one in kinds.items()}
early = published["as published"].query("outcome == 'ignited < 0.1 s (%)'")
early = early.set_index(results.KEYS)["high"].to_dict()
papers = [key for key in true if key[0] in flight_claims.PAPERS]
picture = flight_pictures.ignition_bars(kinds, papers, early)
caption = (
    "When confetti and paper shreds ignite, in per cent of all particles: true of all flights in "
    "the same frames, and measured by both readings; after Figs 5.25 and 5.26."
)
data = accuracy.ignition_times(both)
figures.save("fig-5-25-ignition", data, picture=picture, caption=caption, provenance=origin)

# %%
shares = confidence.ignited_shares(kinds)
caption = (
    "Share of the particles that ignite in flight with its 95 % interval (Wilson): true of all "
    "flights in the same frames, and measured by both readings."
)
figures.save("ignition-shares", shares.round(4), caption=caption, provenance=origin)

# %%
words = ["ignition", "ignited"]
parts = {
    name: confidence.interval_table(one, true, words, generator) for name, one in found.items()
}
table = pd.concat(parts, names=["reading"]).reset_index("reading").round(3)
caption = "Shares that ignite and the median time in s, by both readings, with 95 % intervals."
figures.save_check("ignition-intervals", table, caption=caption, provenance=origin)

# %%
beside = published["as published"].rename(columns={"measured": "as_published"})
beside.insert(8, "above_background", published["above background"]["measured"])
for name, part in parts.items():
    beside = confidence.with_intervals(beside, part, name.replace(" ", "_"))
caption = "Every printed number about ignition with its bounds, the truth and both readings."
figures.save_check("ignition-published", beside.round(3), caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts
#
# On the reading as published; the other one stands in the note.

# %%
printed = published["as published"]
verdicts = flight_claims.ignition_verdicts(measured, found, printed, generator)
share = {name: results.outcome_table(one)["ignited (%)"] for name, one in kinds.items()}
parts = [
    f"{name} {bar} bar {ours:.0f} % (true {real:.0f} %)"
    for (name, bar), ours, real in zip(true, share["as published"], share["true"], strict=True)
]
result = f"Ignition detected by grey values as they are: {', '.join(parts)}."
figures.conclude(result, verdicts, origin)
