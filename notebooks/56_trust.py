# %% [markdown]
# # How far to trust what was measured
#
# **Published.** Nothing: the thesis could not know how long a particle truly flew. It calls the
# regression "qualified" and compares fractions and pressures by medians without intervals.
#
# **Here.** The twin knows. For dwell time, velocity in the first metre and ignition time: what of
# the measurable was found, bias and spread of measured minus true. Then one step of the chain
# after the other is replaced by the truth, to see where the error comes from. Last, which
# differences between fractions and pressures could be told at all, with our numbers of particles
# and with those of Table 5.15, the only ones printed.

# %% tags=["parameters"]
scale = "standard"  # quick (two campaigns, few frames), standard (250 frames each) or full
seed = 0  # of the scenes, and of the bootstrap
jobs = 2  # processes

# %%
import numpy as np
import pandas as pd

from kilnflight.experiments import accuracy, results
from kilnflight.project import figures, style

style.use_style()

# %%
from kilnflight.experiments import campaigns, confidence, error_budget
from kilnflight.project.parallel import Workers
from kilnflight.scores import flights as findings

origin = figures.trace("56_trust", {"scale": scale}, seed=seed)
wanted = campaigns.campaigns(scale, campaigns.settings_from_labels(scale, seed), seed)
measured = campaigns.measure(wanted, Workers(jobs))
error_budget.prepare_truth(wanted, Workers(jobs))
budget = accuracy.error_budget(wanted, measured, jobs)
keys = ["fraction", "pressure_bar"]
found = results.by_campaign(measured)
generator = np.random.default_rng(seed)

# %% [markdown]
# ## The main table
#
# Found: of the particles whose flight begins and ends within the recording and that a person
# could have followed, how many have a trajectory from the lance. (Notebook 52 counts all flights
# that end on the wall or burnt out, followed or not.)

# %%
whole = budget[budget["way"] == "whole chain"].reset_index(drop=True)
table = whole[keys].copy()
table["found"] = [
    f"{one.found:.0f} of {one.true:.0f} [{one.found_low:.2f}, {one.found_high:.2f}]"
    for one in whole.itertuples()
]
for name, unit in accuracy.QUANTITIES.items():
    short = f"{name.removesuffix('_s').removesuffix('_m')} ({unit})"
    off = whole[[f"{name}_{what}" for what in ("bias", "low", "high", "spread", "n")]].to_numpy()
    told = [f"{b:+.3f} [{low:+.3f}, {high:+.3f}] +- {s:.3f}" for b, low, high, s, _ in off]
    table[short] = ["" if one[-1] == 0 else say for say, one in zip(told, off, strict=True)]

# %%
true = results.true_results(wanted)
cells = [tuple(cell) for cell in whole[keys].to_numpy()]
median = pd.DataFrame(
    {
        name: [findings.quartiles(one[cell].dwell_s)[1] for cell in cells]
        for name, one in (("here", found), ("true", true))
    }
)
table["cell's dwell (s)"] = [f"{a:.3f}, true {b:.3f}" for a, b in median.to_numpy()]
table["nobody's"] = [f"{one.spurious:.0f} of {one.flights:.0f}" for one in whole.itertuples()]
told = {"ignition told, rightly": ("lit_told", "lit")}
told["told of the unlit"] = ("unlit_told", "unlit")
for name, (some, of) in told.items():
    table[name] = [f"{a:.0f} of {b:.0f}" for a, b in whole[[some, of]].to_numpy()]

# %%
parts = ["flights", "found", "duplicates", "cut", "spurious"]
account = whole[[*keys, *parts]].astype(dict.fromkeys(parts, int))
caption = (
    "What became of every flight from the lance: found (one for each particle whose whole flight "
    "is recorded), duplicates, of particles that the recording cuts, and nobody's. They add up."
)
figures.save("trust-account", account, caption=caption, provenance=origin)

# %%
caption = (
    "What the whole chain finds, with the 95 % interval of the share, and how far it is off, "
    "particle by particle: median of measured minus true with its 95 % interval (nan: of fewer "
    "than six) +- half the range that holds 68 % of it. Cell's dwell: the median that would be "
    "published, of all flights that were measured, and of all true ones; who is found and where "
    "tracks break is in it, too. Nobody's: flights from the lance of no particle. Of those "
    "found, how many were told to ignite of the truly lit, and, wrongly, of the unlit ones."
)
figures.save("trust", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Where the error comes from
#
# True positions come without scatter, without false ones, and with grey values of two levels,
# unlit and lit: what is told about ignition from them is as good as it can be. True links are
# by place in the image; a depth farther off than the tracker's gate lets pass is left out, as
# it is what is behind the particle. Each row is of the particles that were found that way, which
# differ. True trajectories are those through the true
# positions of the particle that a track belongs to, in place of what the regression makes of
# the track. Two rows have another regression on our own tracks: axes weighted by the RMSE of
# Table 5.18, and also a robust loss; the printed one has no weights.

# %%
columns = [*keys, "way", "true", "found", "spurious"]
what = ("n", "bias", "low", "high", "spread")
columns += [f"{name}_{one}" for name in accuracy.QUANTITIES for one in what]
caption = (
    "Bias and spread with steps of the chain replaced by the truth: what remains with true "
    "positions and links is due to regression, landing and the test of ignition; true depth has "
    "our tracks with depths without scatter, true trajectories our tracks without regression."
)
figures.save("trust-steps", budget[columns], caption=caption, provenance=origin)

# %% tags=["hide-input"]
labels = {"dwell_s": "dwell time (s)", "velocity_m_s": "velocity 0-1 m (m/s)"}
labels |= {"ignition_s": "ignition time (s)"}
names = list(dict.fromkeys(one.fraction for one in wanted))
picture, grid = style.canvas(3, 1, width_mm=style.PAGE_MM, height_mm=150, sharex=True)
mean = budget.groupby(["way", "fraction"])
for axes, (quantity, label) in zip(grid[:, 0], labels.items(), strict=True):
    bias, spread = (mean[f"{quantity}_{what}"].mean().unstack() for what in ("bias", "spread"))
    for k, way in enumerate(error_budget.STEPS):
        place = np.arange(len(names)) + 0.11 * (k - 3.5)
        one = {"color": [*style.COLOURS, "0.5"][k], "marker": [*style.MARKERS, "*"][k], "ms": 3}
        values = bias.loc[way].reindex(names), spread.loc[way].reindex(names)
        axes.errorbar(place, values[0], yerr=values[1], ls="", lw=0.8, label=way, **one)
    axes.axhline(0, color="0.6", lw=0.6, ls="-")
    axes.set(ylabel=label, xticks=range(len(names)), xticklabels=names)

# %%
picture.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
caption = (
    "Measured minus true, by what was replaced by the truth: median (mark) and half the range that "
    "holds 68 % (bar), means over both pressures."
)
data = budget[columns]
figures.save("fig-trust-steps", data, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Do the intervals cover the truth?

# %%
cover = confidence.coverage(found, true, generator)
known = cover.dropna(subset=["low", "true"])
caption = (
    "Medians of each cell with their 95 % intervals (bootstrap over particles) and the true median "
    "of all flights in the same frames: an interval knows of chance, not of bias."
)

figures.save("trust-coverage", cover, caption=caption, provenance=origin)

# %% [markdown]
# ## Which differences can be told

# %%
pairs = results.pairs_to_compare(found)
rows = []
for quantity in ("dwell_s", "velocity_m_s"):
    first = [one if quantity == "dwell_s" else results.in_metre(one, 1) for one in (found, true)]
    values, truth = ({cell: getattr(f, quantity) for cell, f in one.items()} for one in first)
    rows.append(
        confidence.resolved_differences(values, pairs, generator, truth).assign(quantity=quantity)
    )
lit, truly = ({cell: results.ignited(f) for cell, f in one.items()} for one in (found, true))
rows.append(
    confidence.resolved_share_differences(lit, pairs, truly).assign(quantity="ignited share")
)

# %%
apart = pd.concat(rows, ignore_index=True)
for side in ("first", "second"):
    apart[side] = [f"{name}, {bar} bar" for name, bar in apart[side]]
caption = (
    "Differences of medians and of ignited shares between fractions at one pressure and between "
    "pressures of one fraction, with 95 % intervals, the true difference, and whether they are "
    "beyond chance with our numbers of particles and with those of Table 5.15. Beyond chance "
    "is not right: an interval knows nothing of bias."
)
order = ["quantity", "first", "second", "number", "estimate", "low", "high", "true", "resolved"]
table = apart[[*order, "resolved_with_table_5_15"]]
figures.save("trust-resolved", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Result

# %%
ours, theirs = int(apart["resolved"].sum()), int(apart["resolved_with_table_5_15"].sum())
share = 100 * whole["found"].sum() / max(whole["true"].sum(), 1)
off = [one.dropna() for one in (whole["dwell_s_bias"], median["here"] - median["true"])]
span, of_cells = (f"{s.min():+.3f} to {s.max():+.3f} s" if len(s) else "unknown" for s in off)
covered = f"{int(known['covers'].sum())} of {len(known)}"
told = apart[apart["resolved"]]
nothing = int((told["true"] == 0).sum())
wrong = int((np.sign(told["estimate"]) * np.sign(told["true"]) < 0).sum())
result = (
    f"Of the measurable particles {share:.0f} % are found; their dwell times are off by {span} "
    f"(median over the particles of a cell), the medians of the cells by {of_cells}; intervals "
    f"cover the truth in {covered} cases; {ours} of {len(apart)} differences are resolved ({wrong} "
    f"with the wrong sign, {nothing} where there is none), {theirs} with Table 5.15's numbers."
)
figures.conclude(result, [], origin)
