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
import pandas as pd

from kilnflight.experiments import accuracy, plots, results
from kilnflight.project import claims, figures, style

style.use_style()

# %%
from kilnflight.experiments import campaigns, confidence, error_budget
from kilnflight.project.parallel import Workers
from kilnflight.regression import fits
from kilnflight.scores import flights as findings
from kilnflight.scores import intervals

origin = figures.trace("53_velocity", {"scale": scale}, seed=seed)
wanted = campaigns.campaigns(scale, campaigns.settings_from_labels(scale, seed), seed)
measured = campaigns.measure(wanted, Workers(jobs))
error_budget.prepare_truth(wanted, Workers(jobs))
found, true = results.by_campaign(measured), results.true_results(wanted)
keys = ["fraction", "pressure_bar"]
names = list(dict.fromkeys(one.fraction for one in wanted))

# %% [markdown]
# ## What is measured
#
# Eq. 5.8 on the flight that was seen over most metres.

# %%
front = measured.slices[measured.slices["slice_m"] > 0]
longest = front.groupby([*keys, "particle"])["observed"].agg(["sum", "size"]).reset_index()
chosen = longest.sort_values(["sum", "size"], kind="stable").tail(1)
picture, grid = style.canvas(1, 1, width_mm=style.PAGE_MM, height_mm=75)
name, passed = "flight (no metre was passed)", front.head(0)
for one in chosen.itertuples():  # of a smoke run, none
    cell, name = (one.fraction, one.pressure_bar), f"{one.fraction} at {one.pressure_bar} bar"
    flight, fit, passed = (
        table[table["particle"] == one.particle].drop(columns=keys)
        for table in (
            results.of_campaign(part, cell) for part in (measured.flights, *measured[1::2])
        )
    )
    way, end_s = fits(fit)[one.particle], flight["end_s"].iloc[0]
    plots.space_slices(grid[0, 0], way, passed, end_s)

# %%
_ = grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels(), loc="upper left")
caption = (
    f"Space-sliced velocity (Eq. 5.8) of one {name}, after Fig. 5.20: V_n is one metre over the "
    "time between passing metre n - 1 and metre n."
)
figures.save("fig-5-20-slices", passed, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Every particle, every metre

# %%
pairs = accuracy.compare_velocities(wanted, measured)
caption = (
    "Velocity in depth of each particle, measured and true (Eq. 5.8), in the first two metres; the "
    "boxes of Fig. 5.21 are in fig-5-22-velocity-boxes. The table has every metre. Particle: that "
    "of the truth; -1 belongs to none. Empty: not measured, or the metre was not passed."
)
columns = [*keys, "particle", "slice_m", "measured_m_s", "true_m_s"]
picture, grid = style.canvas(1, 2, width_mm=style.PAGE_MM, height_mm=80)
known = pairs.dropna(subset=["measured_m_s", "true_m_s"])
for axes, metre in zip(grid[0], (1.0, 2.0), strict=True):
    for k, (name, one) in enumerate(known[known["slice_m"] == metre].groupby("fraction")):
        look = {"marker": style.MARKERS[k], "color": style.COLOURS[k], "ls": "", "ms": 2}
        axes.plot(one["true_m_s"], one["measured_m_s"], label=name, alpha=0.6, **look)
    axes.plot([0, 20], [0, 20], color="0.5", lw=0.7, ls="-")

# %%
for axes, metre in zip(grid[0], (1, 2), strict=True):
    out = known[known["slice_m"] == metre]["measured_m_s"]
    cut = f"{((out < -5) | (out > 25)).sum()} of {len(out)} not shown"
    axes.set(title=f"metre {metre} ({cut})", xlim=(0, 20), ylim=(-5, 25))
    axes.set_xlabel("true velocity (m/s)")
grid[0, 0].set_ylabel("measured velocity (m/s)")
_ = grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels())
figures.save(
    "fig-5-21-velocity", pairs[columns], picture=picture, caption=caption, provenance=origin
)

# %% [markdown]
# ## Boxes by metre, after Figs 5.21 to 5.24

# %% tags=["hide-input"]
metres = [f"{m - 1}-{m} m" for m in findings.METRES]
bars = sorted({one.pressure_bar for one in wanted})
size = {"width_mm": style.PAGE_MM, "height_mm": 55 * len(names)}
picture, grid = style.canvas(len(names), 2, **size, sharex=True, sharey=True)
boxes = {}
for panels, name in zip(grid, names, strict=True):
    for axes, bar in zip(panels, bars, strict=False):
        both = {"true": true[name, bar], "measured": found[name, bar]}
        groups = {k: list(one.velocity_m_s.T) for k, one in both.items()}
        plots.grouped_boxes(axes, groups, metres)
        axes.set(title=f"{name}, {bar} bar", ylim=(-5, 25))
        boxes[name, bar] = axes
    panels[0].set_ylabel("velocity in depth (m/s)")

# %%
said = results.beside_published(found, true, ["velocity", "remaining", "landed"])
marks = said[said["outcome"].str.contains(r"velocity \d")].copy()
marks["at"] = marks["outcome"].str.extract(r"velocity (\d)").astype(float)
for cell, axes in boxes.items():
    plots.published(axes, results.of_campaign(marks, cell))
_ = grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels())
caption = (
    "Velocity in depth within each metre from the lance, true of all flights in the same frames "
    "and measured; after Figs 5.21 to 5.24. Orange bars: published medians or their bounds. "
    "Numbers: particles that passed the metre; what lies above 25 m/s is cut off."
)
both = {"true": results.outcome_table(true), "measured": results.outcome_table(found)}
data = pd.concat(both, names=["source"]).reset_index("source")
figures.save("fig-5-22-velocity-boxes", data, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## The share that remains

# %% tags=["hide-input"]
picture, grid = style.canvas(2, 2, width_mm=style.PAGE_MM, height_mm=110, sharex=True)
left = said[said["outcome"].str.startswith("remaining")].copy()
left["at"] = left["outcome"].str.extract(r"remaining (\d)").astype(float)

# %% tags=["hide-input"]
for axes, name in zip(grid.flat, names, strict=False):
    axes.set(title=name, ylim=(0, 105), xlim=(0.5, 5.5))
    for k, bar in enumerate(bars):
        for source, one in (("true", true), ("measured", found)):
            share = findings.remaining(one[name, bar].velocity_m_s)
            look = {"color": style.COLOURS[2 - k], "marker": style.MARKERS[k]}
            look |= {"ls": "-" if source == "true" else "--", "label": f"{source}, {bar} bar"}
            axes.plot(findings.METRES, share, **look)
        printed = results.of_campaign(left, (name, bar))
        plots.published(axes, printed.assign(at=printed["at"] + 0.1 * k))

# %%
_ = [axes.set_ylabel("share that passes (%)") for axes in grid[:, 0]]
_ = [axes.set_xlabel("distance from the lance (m)") for axes in grid[1]]
_ = grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels())
caption = (
    "Share of the particles that pass each metre: true of all flights in the same frames, and "
    "measured, where what is lost on the way counts as not remaining. Orange bars: published."
)
parts = {"true": results.outcome_table(true), "measured": results.outcome_table(found)}
drawn = pd.concat([findings.along(one).assign(source=name) for name, one in parts.items()])
drawn = pd.concat([drawn[drawn["quantity"] == "remaining"], left.assign(source="published")])
figures.save("fig-5-20-remaining", drawn, picture=picture, caption=caption, provenance=origin)

# %%
generator = np.random.default_rng(seed)
quantities = ["velocity", "remaining", "landed", "spread"]
every = confidence.interval_table(found, true, quantities, generator)
wide = every["outcome"].str.startswith("spread")
wide, every = every[wide], every[~wide]
passes = every["outcome"].str.startswith("velocity")
caption = (
    "Median velocity in depth (m/s) within each metre, measured, with the number of particles that "
    "passed it and its 95 % interval (bootstrap over these), and true. Without an interval: of "
    "fewer than six, and no more than those; a metre that was passed before the particle was seen "
    "may come out at any velocity (velocity-unseen)."
)
table = every[passes].round(3)
figures.save("velocity-medians", table, caption=caption, provenance=origin)

# %%
caption = (
    "Share (%) of the particles that passes each metre, or lands before the first, measured, with "
    "its 95 % interval (Wilson), and true."
)
table = every[~passes].round(2)
figures.save("velocity-remaining", table, caption=caption, provenance=origin)

# %%
caption = (
    "How dispersed velocities are: distance between the quartiles (m/s) within each metre, "
    "measured, with its 95 % interval (bootstrap over particles; empty: fewer than eleven), and "
    "true. The thesis sees it fall along the way of wood chips and rise in the end."
)
figures.save("velocity-spread", wide.round(3), caption=caption, provenance=origin)

# %% [markdown]
# ### Metres that nobody saw
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
behind = measured.slices[measured.slices["slice_m"] < 0]
told = {"slices": ("velocity_m_s", "size"), "flights": ("particle", "nunique")}
behind = behind.groupby(keys).agg(**told, median_m_s=("velocity_m_s", "median")).reset_index()
caption = "Slices behind the lance, in how many flights, and the median of their velocities."
figures.save("velocity-behind", behind, caption=caption, provenance=origin)

# %%
caption = (
    "Every printed number about velocity and remaining share with its bounds, the truth, the "
    "measurement with its 95 % interval, and whether the twin was calibrated on it."
)
table = confidence.with_intervals(said, every).round(2)
figures.save("velocity-published", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts
#
# Statements with bounds: within them, or off by less than the unit of notebook 12.

# %%
numbers = results.outcome_table(found).set_index(keys)
first = numbers["velocity 0-1 m (m/s)"]
order = {}
for bar, one in first.groupby("pressure_bar"):
    speed = one.droplevel("pressure_bar").reindex(["wood chip", "PE granule", *names])
    heavy, light = speed.iloc[:2].min(), speed.drop(["wood chip", "PE granule"]).max()
    order[f"{bar} bar: heavy {heavy:.1f}, papers {light:.1f} m/s"] = bool(heavy > light)
change = first.unstack("pressure_bar")
ratio = (change[bars[-1]] / change[bars[0]]).rename("ratio")

# %%
rows = []
for name in names:
    pair = [found[name, bar].velocity_m_s[:, 0] for bar in (bars[-1], bars[0])]
    pair = [values[np.isfinite(values)] for values in pair]
    one = intervals.Bootstrap()(intervals.ratio_of_medians, pair, generator)
    rows.append({"fraction": name, **confidence.interval_columns(one)})
caption = "Median velocity in the first metre at 5 bar over that at 4.5 bar, 95 % interval."
table = pd.DataFrame(rows)
figures.save("velocity-ratio", table, caption=caption, provenance=origin)

# %%
heavy = ["wood chip", "PE granule"]
light = [name for name in names if name not in heavy]
pairs = {"vel-1": [((a, bar), (b, bar)) for bar in bars for a in heavy for b in light]}
pairs["vel-6"] = [((name, 5.0), (name, 4.5)) for name in names]
speeds, apart = {cell: one.velocity_m_s[:, 0] for cell, one in found.items()}, {}
for claim, some in pairs.items():
    apart[claim] = confidence.in_words(
        confidence.resolved_differences(speeds, some, generator), "medians"
    )

# %%
given = {"vel-1": order, "vel-6": ratio}
sentences = {
    "vel-2": "wood chip",
    "vel-3": "confetti",
    "vel-4": "paper shred",
    "vel-5": "PE granule",
}
given |= {claim: results.conditions(said, (name, 4.5)) for claim, name in sentences.items()}
note = "medians measured on the twin; bounds of the printed sentences"
verdicts = results.judge_all(measured, given, note, apart)
aims = {"vel-2", "vel-3"}
fit = "the twin's flights were fitted to this cell"
verdicts = [claims.fitted(one, fit) if one.id in aims else one for one in verdicts]

# %%
parts = [f"{name} {value:.1f}" for name, value in change[bars[0]].items()]
off = (known["measured_m_s"] - known["true_m_s"])[known["slice_m"] == 1.0]
passed, hidden = unseen["number"].sum(), unseen["unseen"].sum()
far = unseen[unseen["metre"] > 3]
shift = (unseen["seen_m_s"] - unseen["median_m_s"])[unseen["metre"] < 4].abs().max()
result = (
    f"Median velocity in the first metre at {bars[0]} bar (m/s): {', '.join(parts)}. Measured "
    f"minus true, particle by particle: median {off.median():+.2f} m/s. Of {passed} metres "
    f"{hidden} were passed before the particle was seen, beyond 3 m {far['unseen'].sum()} of "
    f"{far['number'].sum()}; without them no median of the first three moves by over {shift:.1f} "
    "m/s."
)
figures.conclude(result, verdicts, origin)
