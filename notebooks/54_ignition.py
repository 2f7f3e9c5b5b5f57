# %% [markdown]
# # Ignition: the test finds most of the detected papers that burn
#
# **The work.** The thesis finds no wood chip or PE granule that ignites in flight, as a
# sum of difference images shows (section 5.3.2, Fig. 5.17). Particles whose grey value
# "increases abruptly" have ignited (Figs 5.25 and 5.26).
#
# **Here.** One test, since the thesis prints no rule: the grey value above the kiln
# behind rises by a step (`Ignition`). A particle already bright at first sight has not
# ignited. The test judges one flight after the other. Numbers here are of `make full`;
# a smaller scale leaves every claim open.
#
# **One number.** Confetti that ignites at 4.5 bar: 26 % printed, 19.7 % here. (True:
# 22.9 %.)
#
# **What disagrees.** At 4.5 and 5 bar, 21 and 8 points fewer shreds seem to ignite than
# truly do. Of the confetti that ignite at 5 bar 30 % do so from 0.2 to 0.3 s, truly
# 53 %, so the printed majority is lost. Of the unlit chips and granules 4 % seem to
# ignite, none in print; the interval contains our bound of 5 %.

# %% tags=["parameters"]
# quick (two campaigns, few frames), standard (four, 200 frames each) or full
scale = "standard"
seed = 0  # random numbers of scenes and bootstrap
jobs = 2  # processes
pictures = 0  # frames in each optical picture; 0: 5, 30 or 1000 by scale

# %%
import math

import numpy as np
import pandas as pd

from kilnflight.experiments import plots
from kilnflight.experiments.flights import (
    accuracy,
    campaigns,
    comparison,
    ignition,
    panels,
)
from kilnflight.experiments.flights.campaigns import KEYS
from kilnflight.flight.empty import background_gray
from kilnflight.ignition import Ignition
from kilnflight.publication import choices, claims, figures, style
from kilnflight.scores import intervals
from kilnflight.scores.flights import (
    IGNITED,
    IGNITED_EARLY,
    IGNITION,
    IGNITION_OUTCOMES,
)

# The thesis says "do not combust basically" (section 5.3); the share is ours.
BASICALLY = 0.05  # share of the flights

# %%
style.use_style()
pictures = pictures or {"quick": 5, "standard": 30, "full": 1000}[scale]
parameters = {"scale": scale, "pictures": pictures}
origin = figures.trace("54_ignition", parameters, seed=seed)
results = campaigns.results(scale, seed, jobs)
generator = np.random.default_rng(seed)
keys = list(results.measured)
both = accuracy.compare_campaigns(results)

# %% [markdown]
# ## The optical picture
#
# The thesis sums the differences of all frames. In the simulation the flicker of the
# kiln would sum up to more than one passing particle, so each pixel shows its greatest
# difference. Trajectories of chips are "relatively dark", those of confetti "a mixture
# of light and dark" (section 5.2.4): in the CSV of the picture, too, chips are darker
# than confetti. Granules are exposed 2.4 times as long. White discs are particles that
# burn on the wall, where all ignite.
#
# The loop below tests each flight; a flight whose grey values rise "lights up". The
# claim holds if fewer than 5 % of the unlit chips and granules with enough points to
# judge light up, with the whole interval.


# %%
def before_the_end(tracks, flights):
    """Return the detections up to the end of each flight, in order of frames.

    Later ones do not count, since the wall ignites all that land (5.1.1).
    """
    ended = tracks.merge(flights[["particle", "end_s"]])
    return ended[ended["time_s"] <= ended["end_s"]].sort_values("frame")


def trace_shares(test):
    """Return how many flights light up by a test, one row per campaign."""
    rows = {}
    for campaign in results.campaigns:
        tables = results.tables.of(campaign.key)
        flights = campaigns.counted_flights(tables.flights)
        tracks = tables.tracks.merge(flights["particle"])
        source = campaign.run.detection.source
        tracks = tracks.assign(
            background=background_gray(tracks, source, campaign.frames),
            time_s=tracks["frame"] / campaign.run.frame_rate_hz,
        )
        known = campaigns.of_campaign(both, campaign.key)
        known = known.query("track >= 0 and particle >= 0").set_index("track")
        ignites = known["true_ignition_s"].notna()
        flying = before_the_end(tracks, flights)
        outcomes = {
            particle: test(each["time_s"], each["gray"], each["background"]).outcome
            for particle, each in flying.groupby("particle")
        }
        rows[campaign.key] = ignition.count_lit(flights, flying, outcomes, ignites)
    return campaigns.rows_by_campaign(rows)


traces = trace_shares(Ignition())

# %% tags=["hide-input"]
chosen = [each for each in results.campaigns if each.pressure_bar == 4.5]
down = math.ceil(len(chosen) / 2)
picture, grid = style.canvas(down, 2, width_mm=style.PAGE_MM, height_mm=62.0 * down)
shown = []
for axes, campaign in zip(grid.flat, chosen, strict=False):
    count = min(pictures, len(campaign.frames))
    first = campaign.frames.start + (len(campaign.frames) - count) // 2
    shown.append(range(first, first + count))
    total = ignition.optical_picture(campaigns.twin_of(campaign), shown[-1])
    panels.draw_stretched(axes, total, (0.01, 0.998), step=4)
    axes.set_title(f"{campaign.fraction}, 4.5 bar")
    axes.label_outer()
caption = (
    f"Background plus the greatest difference from it in up to {max(map(len, shown))} "
    "frames, at 4.5 bar, after Fig. 5.17. CSV: flights that light up (share with "
    "95 % interval, Wilson), are bright at first, have too few points. Of the others, "
    "truly unlit or lit: number, how many light up (up), light up or are bright at "
    "first (light); grey value."
)
figures.save(
    "fig-5-17-optical",
    traces.round(4),
    picture=picture,
    caption=caption,
    provenance=origin,
)

# %% [markdown]
# ## Hits, false alarms and shares
#
# A flight of too few points counts as unlit. So does one that burns from its first
# detection on: it has no step.


# %%
def percents(name, number, counted):
    """Return a share in per cent with its interval (Wilson), as columns of a name."""
    ends = comparison.interval_columns(intervals.share(number, counted))
    return {
        f"{name}_percent": round(100 * ends["estimate"], 2),
        f"{name}_percent_low": round(100 * ends["low"], 2),
        f"{name}_percent_high": round(100 * ends["high"], 2),
    }


# Flights of chips and granules are tested above; dwell times take them as unlit.
papers = [key for key in keys if key[0] in comparison.PAPERS]
rows = {}
for key in papers:
    error = accuracy.errors(campaigns.of_campaign(both, key))
    lit = error["lit"]
    lit_detected = error["lit_detected"]
    unlit = error["unlit"]
    unlit_detected = error["unlit_detected"]
    rows[key] = {
        "detected_particles": error["detected_particles"],
        "lit": lit,
        "lit_detected": lit_detected,
        **percents("hit", lit_detected, lit),
        "unlit": unlit,
        "unlit_detected": unlit_detected,
        **percents("false_alarm", unlit_detected, unlit),
        "time_error_n": error["ignition_s_n"],
        "time_error_median_s": error["ignition_s_bias"],
        "time_error_spread_s": error["ignition_s_spread"],
    }
table = campaigns.rows_by_campaign(rows)
caption = (
    "Detected papers that truly ignite in flight (lit) and that do not (unlit), and in "
    "how many of them ignition is detected, with 95 % intervals (Wilson). Last: "
    "number, median and spread of the error of its time in s."
)
figures.save("ignition-detected", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Is what was put in measured?
#
# Shares are of all flights that count, also of false and doubled ones; the table above
# has those of true particles. A share is recovered if the 95 % interval of measured
# minus true lies within 5 points. It is biased if the interval lies outside, else open.


# %%
def recover(measured):
    """Return the recovery of the ignition of papers."""
    every = comparison.recovery(measured, results.true, IGNITION_OUTCOMES, generator)
    return every[every["fraction"].isin(comparison.PAPERS)]


recovery = recover(results.measured)
caption = (
    "Ignition of papers in flight: printed, put in, true in the recordings and "
    "measured; measured minus true with its 95 % interval (Wilson; bootstrap for the "
    "median)."
)
figures.save("ignition-recovery", recovery.round(3), caption=caption, provenance=origin)

# %% [markdown]
# ## When papers ignite

# %%
names = {"measured_ignition_s": "measured_s", "true_ignition_s": "true_s"}
data = both.rename(columns=names).assign(detected=both["track"] >= 0)
data = data[[*KEYS, "particle", "measured_s", "true_s", "detected"]]
printed = comparison.printed_numbers()

# %% tags=["hide-input"]
sources = {"true": results.true, "measured": results.measured}
down = math.ceil(len(papers) / 2)
picture, grid = style.canvas(
    down, 2, sharex=True, width_mm=style.PAGE_MM, height_mm=55.0 * down
)
places = {IGNITED_EARLY.label: 0.05, IGNITED.label: 0.95}
bounds = printed.assign(at=printed["outcome"].map(places)).dropna(subset="at")
edges = [-np.inf, *0.1 * np.arange(1, 8), np.inf]  # s; width of section 5.3.2
for axes, key in zip(grid.flat, papers, strict=False):
    for k, (source, values) in enumerate(sources.items()):
        times = pd.Series(values[key].ignition_s)
        counts = pd.cut(times, edges).value_counts(sort=False)
        heights = 100 * np.array([*counts, counts.sum()]) / max(len(times), 1)
        at = np.array([*0.1 * np.arange(8) + 0.05, 0.95]) + 0.045 * (k - 0.5)
        look = {"color": ("w", "0.7")[k], "hatch": style.HATCHES[k], "label": source}
        axes.bar(at, heights, 0.045, ec="black", lw=0.5, **look)
    plots.draw_published(axes, campaigns.of_campaign(bounds, key))
    axes.set(title=f"{key[0]}, {key[1]} bar", ylabel="% of all particles")
for axes in grid.flat[len(papers) :]:
    axes.axis("off")
for axes in grid[-1]:
    axes.set_xlabel("time from the lance (s)")
    axes.set_xticks(
        [0, 0.2, 0.4, 0.6, 0.75, 0.95], ["0", "0.2", "0.4", "0.6", "later", "any"]
    )
grid[0, 0].legend(*grid[0, 0].get_legend_handles_labels())
caption = (
    "When confetti and paper shreds ignite, in per cent of all particles, after Figs "
    "5.25 and 5.26: true of all flights in the same frames, and measured. Narrow bar: "
    'the published "less than 20 %". In the CSV a time is below 0 where the fit '
    "leaves the lance later than the step was seen."
)
figures.save(
    "fig-5-25-ignition", data, picture=picture, caption=caption, provenance=origin
)

# %% [markdown]
# ## Who ignites more often, and earlier?

# %%
bars = (4.5, 5.0)
kinds = [(("paper shred", bar), ("confetti", bar)) for bar in bars]
pressure = [((name, 4.5), (name, 5.0)) for name in comparison.PAPERS]
more = kinds + pressure
later = [(second, first) for first, second in more]


def differ(measured):
    """Return differences of the share that ignites and of the median time.

    All are above 0 in print.
    """
    parts = [
        comparison.differences(measured, results.true, outcome, pairs, generator)
        for outcome, pairs in ((IGNITED, more), (IGNITION, later))
    ]
    return pd.concat(parts)


orders = differ(results.measured)
caption = (
    "Differences of the share that ignites (%) and of the median ignition time (s): "
    "shreds and confetti, 4.5 and 5 bar; measured with 95 % intervals (Newcombe), and "
    "true. The thesis has all above 0."
)
figures.save("ignition-orders", orders.round(3), caption=caption, provenance=origin)


# %%
def false_share(traces, what):
    """Return the share of unlit chips and granules that seem to burn, an interval."""
    heavy = traces[traces["fraction"].isin(comparison.HEAVY)]
    return intervals.share(int(heavy[what].sum()), int(heavy["unlit"].sum()))


# %%
def judge(false, recovery, orders):
    """Return the verdicts on saved tables of one choice."""
    confetti = recovery["fraction"] == "confetti"
    ignited = recovery["outcome"] == IGNITED.label
    early = recovery["outcome"] == IGNITED_EARLY.label
    answers = {
        "ign-1": claims.beyond(BASICALLY - false.high, BASICALLY - false.low),
        "ign-2": comparison.recovered(recovery[confetti & ignited]),
        "ign-3": comparison.recovered(recovery[~confetti & (ignited | early)]),
        "ign-4": comparison.all_above(orders),
    }
    numbers = [len(each.ignition_s) for each in results.measured.values()]
    holds = comparison.if_complete(numbers, answers)
    ends = f"{100 * false.low:.1f} to {100 * false.high:.1f}"
    percent = "no such flight in this run"
    if false.number:
        percent = f"{100 * false.estimate:.1f} % of {false.number} ({ends})"
    above = f"{(orders['low'] > 0).sum()} of {len(orders)} differences"
    off = recovery["error"].map("{:+.0f}".format)
    confetti_off = ", ".join(off[confetti & ignited])
    shreds_off = ", ".join(off[~confetti & ignited])
    unlit = "Unlit ones that the test calls burning."
    points = (
        "Measured minus true shares that ignite, in points, at 4.5 and 5 bar. Fails if "
        "a 95 % interval lies beyond 5 points, open if it crosses."
    )
    all_above = "All must be above 0 with their intervals."
    return [
        claims.check("ign-1", holds["ign-1"], percent, unlit),
        claims.check("ign-2", holds["ign-2"], confetti_off, points),
        claims.check("ign-3", holds["ign-3"], shreds_off, points),
        claims.check("ign-4", holds["ign-4"], above, all_above),
    ]


false = false_share(traces, "unlit_up")
checks = judge(false, recovery, orders)

# %% [markdown]
# ## Result
#
# Verdicts, and what two choices change:
#
# - F7: the grey value itself rises, not the value above the kiln behind.
# - F8: chips and granules that are light at first sight count as burning, too. (This
#   was not tried on papers.)

# %%
alone = campaigns.varied(results, campaigns.gray_alone, jobs)
gray = trace_shares(Ignition(above_background=False))
gray_false = false_share(gray, "unlit_up")
gray_recovery = recover(alone.measured)
gray_checks = judge(gray_false, gray_recovery, differ(alone.measured))
light_false = false_share(traces, "unlit_light")
light_checks = judge(light_false, recovery, orders)


def furthest(recovery):
    """Return the largest error of the share of papers that ignites, in points."""
    off = recovery.loc[recovery["outcome"] == IGNITED.label, "error"]
    return off.abs().max().round(1)


seem = "share of the unlit chips and granules that lights up (%)"
compared = [
    choices.compare(
        "F7",
        seem,
        chosen=round(100 * false.estimate, 1),
        other=round(100 * gray_false.estimate, 1),
        turns=choices.turned(checks, gray_checks),
    ),
    choices.compare(
        "F8",
        seem,
        chosen=round(100 * false.estimate, 1),
        other=round(100 * light_false.estimate, 1),
        turns=choices.turned(checks, light_checks),
    ),
    choices.compare(
        "F7",
        "largest error of the share of papers that ignites (points)",
        chosen=furthest(recovery),
        other=furthest(gray_recovery),
        turns=choices.turned(checks, gray_checks),
    ),
]

# %%
sums = table.sum(numeric_only=True)


def part(number, counted):
    """Return a share as text; of none it is "none"."""
    if not counted:
        return "none"
    return f"{number / counted:.0%}"


result = (
    f"Of {false.number} unlit wood chips and PE granules "
    f"{part(false.estimate * false.number, false.number)} seem to ignite (thesis: "
    f"none). Of the papers the test finds {part(sums['lit_detected'], sums['lit'])} "
    f"of the burning and calls {part(sums['unlit_detected'], sums['unlit'])} of the "
    "unlit burning."
)
figures.conclude(result, checks, origin, choices=compared)
