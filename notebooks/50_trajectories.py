# %% [markdown]
# # Trajectories: three polynomials through the outlet of the lance
#
# **The work.** Tracks scatter too much in depth for statistics, so the thesis fits each
# with three polynomials in time that pass the outlet at one moment (sections 4.3 and
# 5.2.4, Table 5.18). It finds the largest RMSE in depth and no gain from orders above
# 6.
#
# **Here.** The same fit on all tracks of the simulated campaigns after post-processing.
# An order more is taken if all four measures improve by 1 %. No trajectory is rejected,
# as in the thesis; how many are impossible is counted beside.
#
# **One number.** Median R2 in depth of paper shreds: 0.55 printed, 0.52 here.
#
# **What disagrees.** One trajectory in nine is impossible, which the thesis does not
# mention. It says that the accuracy falls above order 6. Here order 7 still adds
# 0.00045 to adjusted R2, half as much as order 6; the interval contains 0, so the claim
# is open. R2 in depth is 0.84 at order 6, not above 0.9.

# %% tags=["parameters"]
# quick (two campaigns, few frames), standard (four, 200 frames each) or full
scale = "standard"
seed = 0  # random numbers of scenes and bootstrap
jobs = 2  # processes
pictures = 0  # frames in each sum of differences; 0: 5, 30 or 300 by scale

# %%
from functools import partial
from itertools import pairwise, product

import numpy as np
import pandas as pd

from kilnflight.experiments.flights import campaigns, comparison, panels
from kilnflight.experiments.flights.campaigns import KEYS, REASONS
from kilnflight.publication import choices, claims, figures, style
from kilnflight.regression import AXIS_MEASURES, Regression, fits, regress
from kilnflight.tables import TRAJECTORIES

FEW_POINTS = 15  # two for each unknown of Eq. 4.29; our choice
FIT_MEASURES = {  # names in Table 5.18, and columns by axis
    "rmse_mm": "rmse_{}_mm",
    "mape_percent": "mape_{}_percent",
    "r2": "r2_{}",
    "r2_adjusted": "r2_adjusted_{}",
}

# %%
style.use_style()
pictures = pictures or {"quick": 5, "standard": 30, "full": 300}[scale]
parameters = {"scale": scale, "pictures": pictures}
origin = figures.trace("50_trajectories", parameters, seed=seed)
save = partial(figures.save, provenance=origin)
results = campaigns.results(scale, seed, jobs)
tables = results.tables
generator = np.random.default_rng(seed)

# %% [markdown]
# ## Which tracks are fitted
#
# The thesis prints neither how many tracks Table 5.18 holds nor when a trajectory
# starts "from the lance" (sections 4.2.5 and 5.2.1). Here it starts there if its fit
# passes a cone from the outlet in the first metre (`flight.criteria.starts_at_lance`).
# The thesis rejects none: Fig. 5.23 keeps negative velocities. Beside stand those that
# `kilnflight run` would reject: they leave the kiln, turn back behind the lance, or are
# over twice as fast as the lance's air. These limits are ours.


# %%
def count(flags, table):
    """Return the number of rows of a table by campaign for which each flag is set."""
    return pd.DataFrame(flags).groupby([table[key] for key in KEYS]).sum()


every = tables.trajectories
fitted = every[every["outcome"] == "fitted"]
at_bound = fitted["t0_at_bound"]
bounds = {"t0_earliest": at_bound < 0, "t0_at_first_detection": at_bound > 0}
rejecting = campaigns.varied(results, campaigns.rejecting, jobs).tables.flights
points = every[[*KEYS, "particle", "points"]]
starting = rejecting[rejecting["from_lance"]].merge(points)
impossible = starting["refused"] != ""
few = starting["points"] < FEW_POINTS
lance = {
    "from_lance": starting["from_lance"],
    "refused": impossible,
    **{f"refused: {why}": starting["refused"] == why for why in REASONS},
    "few_points": few,
    "few_points_refused": few & impossible,
}
table = every.groupby([*KEYS, "outcome"], sort=False).size().unstack(fill_value=0)
table = table.join([count(bounds, fitted), count(lance, starting)])
outcomes = table.fillna(0).astype(int).reset_index()

# %%
caption = (
    "Tracks of all campaigns that were fitted, or why not, and how often t0 lies at an "
    "end of its range. Then trajectories from the lance, which all count in what "
    "follows; those of them that are impossible (refused), and why; and those of few "
    "points: fewer than 15."
)
save("regression-outcomes", outcomes, caption=caption)

# %% [markdown]
# ## Table 5.18
#
# The scatter of the depth is an input of the simulation, so the RMSE in z is no test.

# %%
counted = campaigns.of_counted(every, tables.flights)
printed = claims.published("table_5.18").set_index(["fraction", "axis", "measure"])
printed = printed["value"].rename(lambda name: name.lower().rstrip("s"), level=0)
printed = printed.rename(str.lower, level="measure")
rows = []
for (fraction, part), axis in product(counted.groupby("fraction", sort=False), "xyz"):
    row = {"fraction": fraction, "axis": axis}
    beside = {"tracks": len(part)}
    ends = {}
    for name, column in FIT_MEASURES.items():
        median = comparison.median_columns(part[column.format(axis)], generator)
        row[name] = median["estimate"]
        beside[f"{name}_published"] = printed[fraction.lower(), axis, name]
        ends |= {f"{name}_{side}": median[side] for side in ("low", "high")}
    rows.append(row | beside | ends)
caption = (
    "Medians of the measures of the regression over all trajectories from the lance, "
    "both pressures, after Table 5.18, with 95 % intervals (bootstrap over "
    "trajectories). The RMSE in z is an input of the simulation."
)
save("table-5-18-regression", pd.DataFrame(rows), caption=caption)

# %% [markdown]
# ## Which orders help
#
# Section 4.3 raises the orders from 2 to 6 until "the measures" improve by less than 1
# %: here an order more must improve all four. With orders higher than 6, it says, the
# accuracy "even slightly decreases", and R2 in depth is higher than 0.9 for all. It
# prints no other value. Our medians go on improving beyond order 6. Each of them is of
# all trajectories, so the claim is judged on the gain of single ones: adjusted R2, mean
# over the axes (`order-gains`). It holds if order 7 lowers it, with its whole interval.


# %%
def first_fits(key, most):
    """Return fits and detections of a campaign's first tracks from the lance."""
    flown = campaigns.of_campaign(counted, key).nsmallest(most, "particle")
    first = fits(flown[TRAJECTORIES.names])
    tracks = tables.of(key).tracks.sort_values("particle", kind="stable")
    return first, tracks[tracks["particle"].isin(first)]


methods = {order: Regression(lowest=order, highest=order) for order in range(2, 8)}
rows = []
for campaign in results.campaigns:  # the first forty trajectories that allow order 7
    run = campaign.run
    first, tracks = first_fits(campaign.key, 40)
    long = [k for k, fit in first.items() if fit.points >= methods[7].fewest]
    for particle, order in product(long, methods):
        flown = tracks[tracks["particle"] == particle]
        fit = regress(flown, run.exit_point_mm, run.frame_rate_hz, methods[order])
        for k, axis in enumerate("xyz"):
            row = (*campaign.key, particle, order, axis)
            rows.append((*row, *(getattr(fit, name)[k] for name in AXIS_MEASURES)))
names = [*KEYS, "particle", "order", "axis", *AXIS_MEASURES]
each_order = pd.DataFrame(rows, columns=names)
by_order = each_order.groupby(["order", "axis"], as_index=False)[
    [*AXIS_MEASURES]
].median()

# %% tags=["hide-input"]
picture, grid = style.canvas(2, 2, width_mm=style.PAGE_MM, height_mm=100, sharex=True)
for axes, name, title in zip(
    grid.flat,
    AXIS_MEASURES,
    ("RMSE (mm)", "MAPE (%)", "R²", "adjusted R²"),
    strict=True,
):
    for axis, look in zip("xyz", ("o-k", "s--b", "^-.g"), strict=True):
        part = by_order[by_order["axis"] == axis]
        axes.plot(part["order"], part[name], look, label=axis)
    axes.set_ylabel(title)
for axes in grid[1]:
    axes.axhspan(0.9, 1, alpha=0.15, color=style.PUBLISHED["color"])  # section 4.3
    axes.set_xlabel("order of the polynomials")
grid[0, 0].set_yscale("log")
grid[0, 0].yaxis.set_major_formatter("{x:g}")
grid[0, 0].legend()
caption = (
    "Medians of the four measures with the same order along all axes, after Fig. 4.23. "
    "Up to 40 trajectories of each campaign that are long enough for all orders. "
    "Shaded: R2 in depth as published, higher than 0.9."
)
save("fig-4-23-orders", by_order, picture=picture, caption=caption)

# %%
accuracy = each_order.groupby([*KEYS, "particle", "order"])["r2_adjusted"].mean()
steps = accuracy.unstack().diff(axis=1)
rows = []
for order in steps.columns[1:]:
    gain = comparison.median_columns(steps[order], generator)
    rows.append({"order": order, **gain})
gains = pd.DataFrame(rows, columns=["order", "number", "estimate", "low", "high"])
caption = (
    "What each order more adds to the adjusted R2 of a trajectory, mean over its axes: "
    "number of trajectories and median with its 95 % interval (bootstrap)."
)
save("order-gains", gains.round(5), caption=caption)

# %% [markdown]
# ## Trajectories in space

# %% tags=["hide-input"]
picture, grid = style.canvas(
    2,
    2,
    width_mm=style.PAGE_MM,
    height_mm=115,
    subplot_kw={"projection": "3d"},
)
picture.set_layout_engine(None)  # else the margins do not apply
picture.subplots_adjust(-0.05, 0.15, 0.97, 0.97, 0)
parts = {}
chosen = [each for each in results.campaigns if each.pressure_bar == 4.5]
for (above, below), campaign in zip(grid.T, chosen, strict=False):
    first, tracks = first_fits(campaign.key, 8)
    for axes, gray in ((above, False), (below, True)):
        panels.draw_fits(axes, tracks, first, campaign.run.exit_point_mm, gray)
        axes.set_title(campaign.fraction, y=0.98)
        axes.locator_params(axis="y", nbins=2)
    parts[campaign.key] = tracks
picture.colorbar(
    below.collections[0],
    picture.add_axes((0.3, 0.09, 0.4, 0.015)),
    location="bottom",
    label="grey value",
)
caption = (
    "Fitted trajectories of up to eight particles each with their detections, above as "
    "thin lines, below as points coloured by grey value (yellow: 30,000 or more). Red "
    "cross: the lance. After Figs 4.22, 4.24 and 5.16."
)
data = campaigns.stack(parts)[["fraction", "particle", "frame", "x", "y", "z", "gray"]]
save("fig-5-16-trajectories", data, picture=picture, caption=caption)

# %% [markdown]
# ## Sums of frame differences and tracks
#
# Wood chips and granules fly in smooth arcs, papers in tangles. The tracks are made
# without the texture term of Eq. 4.24; its frame differences would take 68 GB.

# %% tags=["hide-input"]
flying = campaigns.of_counted(tables.tracks, tables.flights)


def sum_differences(campaign):
    """Return the sum of the differences of neighbouring frames in the middle."""
    first = campaign.frames.start + (len(campaign.frames) - pictures) // 2
    twin = campaigns.twin_of(campaign)
    frames = (twin.gray(t).astype(float) for t in range(first, first + pictures))
    return sum(np.abs(now - before) for before, now in pairwise(frames))


# %% tags=["hide-input"]
saved = {}
for k, name in enumerate(
    dict.fromkeys(each.fraction for each in results.campaigns), start=1
):
    chosen = [each for each in results.campaigns if each.fraction == name]
    columns = len(chosen)
    picture, grid = style.canvas(
        2, columns, sharex=True, sharey=True, width_mm=90 * columns, height_mm=125
    )
    for (above, below), campaign in zip(grid.T, chosen, strict=True):
        panels.draw_stretched(above, sum_differences(campaign), (0.05, 0.999), step=8)
        above.set_title(f"{name}, {campaign.pressure_bar} bar: frame differences")
        tracks = campaigns.of_campaign(flying, campaign.key)
        style.draw_tracks(below, tracks)
        below.set(
            aspect="equal",
            title=f"{tracks['particle'].nunique()} trajectories from the lance",
            xlabel="column (px)",
            ylabel="row (px)",
        )
    caption = (
        f"Flights of {name} at each pressure: sum of the differences of {pictures} "
        f"neighbouring frames, and all trajectories from the lance; after Fig. A.{k}."
    )
    data = flying.loc[
        flying["fraction"] == name, [*KEYS, "particle", "frame", "row", "col"]
    ]
    name = f"fig-a-{k}-tracks"
    saved[name] = save(name, data, picture=picture, caption=caption)
saved.get("fig-a-1-tracks")

# %%
saved.get("fig-a-2-tracks")

# %%
saved.get("fig-a-3-tracks")

# %%
saved.get("fig-a-4-tracks")

# %% [markdown]
# ## What the thesis does not print
#
# Which measures must gain, where the outlet is put and whether flights are rejected:
# the share of the trajectories from the lance that are possible, with each other value
# alone.

# %%
shares = {"as chosen": rejecting}
for name in ("F1", "F2"):
    other = campaigns.varied(results, campaigns.OTHERS[name], jobs)
    shares[name] = campaigns.varied(other, campaigns.rejecting, jobs).tables.flights
parts = []
for name, flown in shares.items():
    here = flown[flown["from_lance"]]
    accepted = here["refused"].eq("").groupby([here[key] for key in KEYS])
    parts.append(accepted.agg(["sum", "size"]).assign(value=name).reset_index())
caption = (
    "Trajectories from the lance (size) and those that are possible (sum): as chosen, "
    "with the outlet at its true place (F1), and with orders that rise by the RMSE "
    "alone (F2)."
)
data = pd.concat(parts)
save("possible-trajectories", data, caption=caption)

# %% [markdown]
# ## Result

# %%
numbers = starting.groupby(KEYS).size()
last = gains[gains["order"] == 7]
falls = claims.all_of(*map(claims.beyond, -last["high"], -last["low"]))
holds = comparison.if_complete(numbers, {"fit-4": falls})
gain = gains.set_index("order")["estimate"].reindex([6, 7])
check = claims.check(
    "fit-4",
    holds["fit-4"],
    f"order 6 {gain[6]:+.4f}, order 7 {gain[7]:+.4f}",
    "Median gain of a trajectory's adjusted R2, mean over its axes. It must be below 0 "
    "at order 7.",
)

# %%
total = data.groupby("value")[["sum", "size"]].sum()
share = total["sum"].astype(str) + " of " + total["size"].astype(str)
compared = [
    choices.compare(
        name,
        "possible trajectories from the lance",
        chosen=share["as chosen"],
        other=share[name],
    )
    for name in ("F1", "F2")
]
compared.append(
    choices.compare(
        "F6",
        "trajectories that count",
        chosen=len(counted),
        other=str(total["sum"]["as chosen"]),
    )
)
result = (
    f"Of {len(starting)} trajectories from the lance {impossible.sum()} are "
    "impossible, which the thesis does not mention. Order 7 instead of 6 changes "
    f"adjusted R2 by {gain[7]:+.4f} (thesis: a loss)."
)
figures.conclude(result, [check], origin, choices=compared)
