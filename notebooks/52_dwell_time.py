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
import pandas as pd

from kilnflight.experiments import accuracy, plots, results
from kilnflight.project import figures, style

style.use_style()

# %%
from kilnflight import regression
from kilnflight.experiments import campaigns, confidence, error_budget
from kilnflight.project.parallel import Workers

origin = figures.trace("52_dwell_time", {"scale": scale}, seed=seed)
wanted = campaigns.campaigns(scale, campaigns.settings_from_labels(scale, seed), seed)
measured = campaigns.measure(wanted, Workers(jobs))
error_budget.prepare_truth(wanted, Workers(jobs))
both = accuracy.compare_campaigns(wanted, measured)
found, true = results.by_campaign(measured), results.true_results(wanted)
names = list(dict.fromkeys(one.fraction for one in wanted))
bars = sorted({one.pressure_bar for one in wanted})

# %% [markdown]
# ## How flights end
#
# Fig. 5.18: landed unlit (a), landed burning (b), burnt out in the air (c); and lost.

# %%
keys = ["fraction", "pressure_bar"]
counted = measured.flights[measured.flights["from_lance"]]
ending = accuracy.ending_cases(counted["ending"], counted["ignition"].isin(["seen", "before seen"]))
ends = pd.crosstab([counted["fraction"], counted["pressure_bar"]], ending).reset_index()
out = measured.flights.groupby(keys)["from_lance"].agg(lambda good: int((~good).sum()))
out = out.rename("left out: not from the lance").reset_index()
ends = out.merge(ends, how="left", on=keys).fillna(0)
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

# %% tags=["hide-input"]
picture, grid = style.canvas(1, 3, width_mm=style.PAGE_MM, height_mm=62, sharey=True)
some = plots.examples(measured.flights)
for axes, letter, case in zip(grid[0], "abc", accuracy.CASES, strict=True):
    axes.set_title(f"({letter}) {case}" + ("" if case in some else ": none measured"))
    if case in some:
        one, cell = some[case], (some[case]["fraction"], some[case]["pressure_bar"])
        parts = [results.of_campaign(table, cell).drop(columns=keys) for table in measured[:2]]
        track, fit = (part[part["particle"] == one["particle"]] for part in parts)
        plots.dwell_time(axes, regression.fits(fit)[one["particle"]], one, track)
        axes.set_title(f"{axes.get_title()}: {cell[0]}, {cell[1]} bar")
for axes in grid[0, 1:]:
    axes.set_ylabel("")

# %%
handles = {}
for axes in grid[0]:
    handles |= {name: one for one, name in zip(*axes.get_legend_handles_labels(), strict=True)}
_ = picture.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=6)
columns = [*keys, "particle", "t0_s", "ignition_s", "end_s", "dwell_s", "ending"]
data = pd.DataFrame(list(some.values()), columns=columns)
caption = (
    "What dwell time means, after Fig. 5.18, on measured flights from the side: from the lance to "
    "landing or burning out. Of each case the one with the median dwell time."
)
figures.save("fig-5-18-cases", data, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Dwell times, measured and true

# %%
flown = counted.rename(columns={"particle": "track", "dwell_s": "measured_s"})
flown = flown[[*keys, "track", "measured_s", "ending"]]
truth = both[[*keys, "track", "particle", "true_dwell_s", "true_ending"]]
data = flown.merge(truth.rename(columns={"true_dwell_s": "true_s"}), "outer", [*keys, "track"])
data = data.fillna({"particle": -1}).astype({"particle": int})

# %% tags=["hide-input"]
picture, grid = style.canvas(
    1, max(len(bars), 2), width_mm=style.PAGE_MM, height_mm=80, sharey=True
)
for axes, bar in zip(grid[0], bars, strict=False):
    parts = [results.of_campaign(data, (name, bar)) for name in names]
    groups = {"true": [one["true_s"].to_numpy() for one in parts]}
    seen = [one.loc[one["track"] >= 0, "true_s"].to_numpy() for one in parts]
    groups |= {"true, of those measured": seen}
    groups["measured"] = [one["measured_s"].to_numpy() for one in parts]
    plots.grouped_boxes(axes, groups, names)
    axes.axhspan(0.3, 0.5, color=style.COLOURS[1], alpha=0.15 if bar == 4.5 else 0.0)
    axes.set(title=f"{bar} bar", ylim=(-0.1, 1.5))
grid[0, 0].set_ylabel("dwell time (s)")
_ = grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels())

# %%
caption = (
    "Dwell times, after Fig. 5.19: true of all flights that begin and end within the recording, "
    "true of those that were measured, and measured of all flights from the lance. Numbers: "
    "flights. Shaded: where the text puts the medians at 4.5 bar. In the table, particle -1: the "
    "flight is nobody's, a further one of its particle, or of one that the recording cuts."
)
figures.save("fig-5-19-dwell-time", data, picture=picture, caption=caption, provenance=origin)

# %%
every = confidence.interval_table(found, true, ["dwell"], np.random.default_rng(seed))
rows = every[every["outcome"] == "dwell median (s)"].drop(columns="outcome")
rows = rows.rename(columns={"estimate": "measured_s", "true": "true_s"}).reset_index(drop=True)
rows["true_number"] = [len(true[cell].dwell_s) for cell in found]
rows["covers"] = (rows["low"] <= rows["true_s"]) & (rows["true_s"] <= rows["high"])
caption = (
    "Median dwell time in s by fraction and pressure with its 95 % interval (bootstrap over "
    "particles), beside the true median of all flights in the same frames, and whether the "
    "interval covers it."
)
figures.save("dwell-medians", rows, caption=caption, provenance=origin)

# %%
caption = (
    "Quartiles of the dwell time in s, their distance (spread) and shares of the flights that last "
    "so long, measured, with 95 % intervals (bootstrap over particles; shares: Wilson), and true. "
    "The longest has no interval. The thesis calls PE granules the most dispersed at 4.5 bar."
)
figures.save("dwell-intervals", every.round(4), caption=caption, provenance=origin)

# %% [markdown]
# ## Every printed number

# %%
said = confidence.with_intervals(results.beside_published(found, true, ["dwell"]), every)
caption = (
    "What is printed about dwell times, with its bounds, the truth, and the measurement with its "
    "95 % interval."
)
figures.save("dwell-published", said.round(3), caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts

# %%
median = rows.set_index(keys)["measured_s"].unstack("pressure_bar")
first, ranks = median[bars[0]], {}
for bar in bars:
    quickest = median[bar].dropna().sort_values().index[:1].tolist()
    ranks[f"{bar} bar: {quickest}"] = quickest == ["wood chip"]
longest = first.dropna().sort_values().index[-1:].tolist()
shorter = median.loc[names[-1], bars[-1]] / median.loc[names[-1], bars[0]]
fly = {f"longest at 4.5 bar: {longest}": longest == ["PE granule"]}
fly[f"{names[-1]} at 5 bar {shorter:.2f} of that"] = bool(shorter < 0.9)

# %%
numbers, most = results.outcome_table(found).set_index(keys), {}
for name, limits in zip(names, ["0.3-0.4", "> 0.4", "> 0.4", "0.3-0.4"], strict=False):
    share = numbers[f"dwell {limits} s (%)"].get((name, 5.0), np.nan)
    most[f"{name} {limits} s {share:.0f} %"] = bool(share > 50)

# %%
others, last = [name for name in names if name != "wood chip"], ("PE granule", 4.5)
pairs = {"dwell-2": [(("wood chip", bar), (name, bar)) for bar in bars for name in others]}
pairs["dwell-3"] = [(last, (name, 4.5)) for name in names if name != "PE granule"]
pairs["dwell-3"] += [(last, ("PE granule", 5.0))]
times = {cell: one.dwell_s for cell, one in found.items()}
generator, apart = np.random.default_rng(seed), {}
for claim, some in pairs.items():
    apart[claim] = confidence.in_words(
        confidence.resolved_differences(times, some, generator), "medians"
    )

# %%
given = {"dwell-1": first, "dwell-2": ranks, "dwell-3": fly, "dwell-4": most}
note = "lost flights count with the time they were seen; much shorter: by over a tenth, a reading"
verdicts = results.judge_all(measured, given, note, apart)

# %%
parts = [f"{name} {value:.2f}" for name, value in first.items()]
covered = f"{int(rows['covers'].sum())} of {len(rows)}"
result = (
    f"Median dwell time at {bars[0]} bar (s): {', '.join(parts)}; the intervals of {covered} cells "
    "cover the true median."
)
figures.conclude(result, verdicts, origin)
