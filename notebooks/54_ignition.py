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

from kilnflight.experiments import accuracy, results
from kilnflight.project import claims, figures, style
from kilnflight.scores import flights as findings

style.use_style()

# %%
from kilnflight.experiments import campaigns, confidence, error_budget
from kilnflight.project.parallel import Workers
from kilnflight.scores import intervals

origin = figures.trace("54_ignition", {"scale": scale}, seed=seed)
wanted = campaigns.campaigns(scale, campaigns.settings_from_labels(scale, seed), seed)
measured = campaigns.measure(wanted, Workers(jobs))
error_budget.prepare_truth(wanted, Workers(jobs))
above = measured._replace(flights=error_budget.flights_above_background(wanted, measured))
readings = {"as published": measured, "above background": above}
keys = ["fraction", "pressure_bar"]
names = list(dict.fromkeys(one.fraction for one in wanted))

# %% [markdown]
# ## Who was told to ignite, and who did

# %%
both = {name: accuracy.compare_campaigns(wanted, one) for name, one in readings.items()}
rows = []
for reading, table in both.items():
    for cell, one in table.groupby(keys, sort=False):
        row = {"reading": reading, "fraction": cell[0], "pressure_bar": cell[1]}
        rows.append(row | accuracy.errors(one))

# %%
told = pd.DataFrame(rows)
columns = ["reading", *keys, "found", "lit", "lit_told", "unlit", "unlit_told"]
caption = (
    "Found particles that truly ignite in flight (lit) and that do not (unlit), and of how many "
    "ignition was told, by both readings of the grey values; with bias and spread of its time in s."
)
columns += ["ignition_s_n", "ignition_s_bias", "ignition_s_spread"]
table = told.reindex(columns=columns)
figures.save("ignition-told", table, caption=caption, provenance=origin)

# %%
counted = measured.flights[measured.flights["from_lance"]]
judged = pd.crosstab([counted["fraction"], counted["pressure_bar"]], counted["ignition"])
caption = (
    "What the test says of all flights from the lance, grey values as they are. Flights of too few "
    "points to be judged count as unlit in every share, as do those that burn from their first "
    "detection on: they have no step."
)
table = judged.reset_index()
figures.save("ignition-judged", table, caption=caption, provenance=origin)

# %%
first = both["as published"].rename(columns={"measured_ignition_s": "measured_s"})
first = first.rename(columns={"true_ignition_s": "true_s"})
other = both["above background"]["measured_ignition_s"].to_numpy()
data = first.assign(measured_above_background_s=other, found=first["track"] >= 0)
data = data[[*keys, "particle", "measured_s", "true_s", "measured_above_background_s", "found"]]

# %% [markdown]
# ## Shares in steps of 0.1 s

# %% tags=["hide-input"]
papers = [name for name in ("confetti", "paper shred") if name in names]
bars = sorted({one.pressure_bar for one in wanted})
true = results.true_results(wanted)
kinds = {"true": true} | {name: results.by_campaign(one) for name, one in readings.items()}
picture, grid = style.canvas(2, 2, width_mm=style.PAGE_MM, height_mm=110, sharex=True)
for panels, name in zip(grid, papers, strict=False):
    for axes, bar in zip(panels, bars, strict=False):
        for k, (source, one) in enumerate(kinds.items()):
            bins = findings.ignition_histogram(one[name, bar].ignition_s)
            look = {"hatch": style.HATCHES[k], "color": ("white", "0.7", style.COLOURS[6])[k]}
            place = bins["from_s"] + 0.02 + 0.03 * k
            axes.bar(place, bins["percent"], 0.03, ec="black", lw=0.5, label=source, **look)
        axes.set(title=f"{name}, {bar} bar", ylabel="% of all particles")

# %%
said = {name: results.beside_published(one, true, ["ignited"]) for name, one in kinds.items()}
early = said["as published"].query("outcome == 'ignited < 0.1 s (%)'").set_index(keys)["high"]
for panels, name in zip(grid, papers, strict=False):
    for axes, bar in zip(panels, bars, strict=False):
        share = early.get((name, bar), np.nan)
        axes.plot(0.05, share, "D", color=style.COLOURS[1], label="published, within 0.1 s")
_ = [axes.set_xlabel("time from the lance (s); the last bin holds all later") for axes in grid[1]]
_ = grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels())
caption = (
    "When confetti and paper shreds ignite, in per cent of all particles: true of all flights in "
    "the same frames, and measured by both readings; after Figs 5.25 and 5.26."
)
figures.save("fig-5-25-ignition", data, picture=picture, caption=caption, provenance=origin)

# %%
rows = []
for source, cells in kinds.items():
    for (name, bar), one in cells.items():
        row = {"source": source, "fraction": name, "pressure_bar": bar}
        for within in (0.1, 0.2, np.inf):
            lit = int((one.ignition_s <= within).sum())
            found = confidence.interval_columns(intervals.share(lit, len(one.ignition_s)))
            limit = "" if np.isinf(within) else within
            rows.append({**row, "within_s": limit, **found})
shares = pd.DataFrame(rows)
caption = (
    "Share of the particles that ignite in flight with its 95 % interval (Wilson): true of all "
    "flights in the same frames, and measured by both readings."
)
figures.save("ignition-shares", shares.round(4), caption=caption, provenance=origin)

# %%
generator = np.random.default_rng(seed)
parts = {}
for name in readings:
    parts[name] = confidence.interval_table(kinds[name], true, ["ignition", "ignited"], generator)
caption = (
    "Shares of the particles that ignite, or of those that do, and the median time in s, by both "
    "readings, with 95 % intervals (Wilson; bootstrap over particles), and true."
)
table = pd.concat(parts, names=["reading"]).reset_index("reading").round(3)
figures.save("ignition-intervals", table, caption=caption, provenance=origin)

# %%
beside = said["as published"].rename(columns={"measured": "as_published"})
beside.insert(8, "above_background", said["above background"]["measured"])
for name, part in parts.items():
    beside = confidence.with_intervals(beside, part, name.replace(" ", "_"))
caption = (
    "Every printed number about ignition with its bounds, the truth and both readings with their "
    "95 % intervals."
)
figures.save("ignition-published", beside.round(3), caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts
#
# On the reading as published; the other one is told beside it.

# %%
numbers = {name: results.outcome_table(one).set_index(keys) for name, one in kinds.items()}
share = {name: one["ignited (%)"] for name, one in numbers.items()}
ours, better = share["as published"], share["above background"]
middle = numbers["as published"]["ignition median (s)"]
others = ours[~ours.index.get_level_values(0).isin(papers)]
never = (others / 100).set_axis([f"{a} {b} bar" for a, b in others.index])
table = said["as published"]
table = table[table["outcome"].isin(["ignited (%)", "ignited < 0.1 s (%)"])]
given = {"ign-1": never}
for claim, name in (("ign-2", "confetti"), ("ign-3", "paper shred")):
    given[claim] = results.conditions(table, (name, 4.5)) | results.conditions(table, (name, 5.0))

# %%
more = {}
for bar in bars:
    one, two = ((name, bar) for name in ("confetti", "paper shred"))
    more[f"shreds more often at {bar} bar"] = bool(ours.get(two, 0) > ours.get(one, 0))
    more[f"shreds earlier at {bar} bar"] = bool(middle.get(two, 9) < middle.get(one, 0))
for name in papers:
    fewer, later = (one.unstack().loc[name] for one in (ours, middle))
    more[f"{name}: fewer at 5 bar"] = bool(fewer.iloc[-1] < fewer.iloc[0])
    more[f"{name}: later at 5 bar"] = bool(later.iloc[-1] > later.iloc[0])
given["ign-4"] = more

# %%
pairs = [(("paper shred", bar), ("confetti", bar)) for bar in bars]
pairs += [((name, 5.0), (name, 4.5)) for name in papers]
times = {cell: one.ignition_s for cell, one in kinds["as published"].items()}
lit = {cell: results.ignited(one) for cell, one in kinds["as published"].items()}
parts = [confidence.in_words(confidence.resolved_share_differences(lit, pairs), "shares")]
parts += [
    confidence.in_words(confidence.resolved_differences(times, pairs, generator), "median times")
]
apart = {"ign-4": "; ".join(parts)}

# %%
other = ", ".join(f"{a} {b} bar {v:.0f} %" for (a, b), v in better.items())
note = f"grey values as they are; above the background: {other}"
verdicts = results.judge_all(measured, given, note, apart)
fit = "the twin was fitted to the share of confetti at 4.5 bar"
verdicts = [claims.fitted(one, fit) if one.id == "ign-2" else one for one in verdicts]
parts = [f"{a} {b} bar {v:.0f} % (true {share['true'][a, b]:.0f} %)" for (a, b), v in ours.items()]
result = f"Told to ignite by grey values as they are: {', '.join(parts)}."
figures.conclude(result, verdicts, origin)
