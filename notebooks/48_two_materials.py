# %% [markdown]
# # Two materials on one belt
#
# A sorter has to see what to blow out; we tell two materials by size and shape of their spots and
# count what both errors cost.

# %% tags=["hide-input"]
from dataclasses import replace

import numpy as np
import pandas as pd
from IPython.display import Markdown

from kilnflight.belt import recordings
from kilnflight.belt.tracker import BELT_FRAME_S
from kilnflight.belt.valves import ValveBar
from kilnflight.experiments import belt_camera, belt_mixture, belt_sorter, belt_valves
from kilnflight.project import figures, style
from kilnflight.sorter.bodies import is_installed, missing_reason
from kilnflight.sorter.machine import BULKS
from kilnflight.sorter.rendering import Pictures, at_rate

engine = "the simulated sorter (MuJoCo)" if is_installed() else "the friction model"
Markdown(f"**Own simulation**: {engine}. {missing_reason()}".rstrip())

# %% [markdown]
# **Published** (2016 paper). "More useful data for classification purposes can be obtained directly
# by using multiple observations of each particle" (section II). Neither paper classifies, and
# neither evaluates a mixture.
#
# **Here.** Cuboids are good, cylinders are bad and to be blown out. They come as one feed: entry
# times are drawn once, and the class of each particle with them. Both are simulated apart and
# joined in the pictures. So contacts between the two are neglected, and where they overlap a
# cylinder hides a cuboid. Pictures of each material alone calibrate a quadratic rule: area and
# elongation (ratio of the axes of a spot, by its second moments), medians over a track. Spots
# marked as several particles count only where a track has no other.
#
# The simulated particles of one material are all of one size, so classes are easy here. Real
# materials vary; their classes overlap more. Pictures of each material alone have the usual feed.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 2020  # of the simulation and the pictures
bad_share = 0.2  # of the particles; assumption
jobs = 2  # processes of the simulation and of the pictures

# %%
style.use_style()
count = {"quick": 60, "standard": 200, "full": 1500}[scale]  # particles of the mixture
labelled = {"quick": 30, "standard": 100, "full": 500}[scale]  # of each material alone
files = recordings.find_dem()
setting = {"scale": scale, "count": count}
origin = figures.trace("48_two_materials", setting, seed=seed, inputs=files.values())
kinds = {"good": "cuboids", "bad": "cylinders"}
alone = {
    kind: belt_valves.simulate_feed(name, labelled, seed, 1.0, jobs) for kind, name in kinds.items()
}
mixed, first_bad = belt_mixture.simulate_mixture(
    kinds["good"], kinds["bad"], count, bad_share, seed + 1, jobs
)
pictures = {kind: Pictures(tracks, BULKS[kinds[kind]], seed) for kind, tracks in alone.items()}
pictures["mixture"] = belt_mixture.MixedPictures(
    mixed, BULKS["cuboids"], seed, bad=BULKS["cylinders"], first_bad=first_bad
)
tracked = belt_valves.track_all(pictures, jobs)
sources = {(belt_sorter.OWN, kinds[kind]): tracks for kind, tracks in alone.items()}
sources |= {
    (belt_sorter.AUTHORS, name): recordings.read_dem(files[name])
    for name in kinds.values()
    if name in files
}
unlike = belt_sorter.describe_unlike(sources)

# %% [markdown]
# ## Classes
#
# Particles by their true class and what was decided at even odds. A missed particle has no track
# and stays, whatever it is. The rule takes both classes as equally frequent. Particles that ever
# shared a spot with another are counted apart.

# %%
features = {
    kind: belt_mixture.features(tracked[kind], belt_mixture.shapes(pictures[kind], tracked[kind]))
    for kind in pictures
}
rule = belt_mixture.fit_classes(features["good"], features["bad"])
log_odds = belt_mixture.odds_bad(rule, features["mixture"])
entering = belt_valves.of_pictures(tracked["mixture"], mixed)
blow = belt_mixture.decide(entering, log_odds)
touched = belt_camera.particles_in_shared_spots(
    tracked["mixture"].spots, at_rate(mixed, 1 / BELT_FRAME_S)
)
table_of_classes = belt_mixture.confusion_by_touch(entering, first_bad, blow, touched)
caption = (
    "Particles of a mixture by true class and decision at even odds, by size and shape of their "
    "spots in pictures; by whether they ever shared a spot. Missed: without a track, so it stays. "
    "Cuboids are good, cylinders bad; simulated apart and joined in the pictures."
) + unlike
figures.save("belt-mixture-confusion", table_of_classes, caption=caption, provenance=origin)

# %% [markdown]
# ## What the valves make of it
#
# Model, time, delay and width of jets are set by the first half of the mixture, for at most 5 %
# good particles hit; the second half is reported. Cylinders do not move as cuboids do. So the
# models are calibrated with cylinders alone, and for comparison with the mixture's first half.

# %%
truths = belt_valves.of_pictures(tracked["bad"], alone["bad"])
calibrations = {"bad material alone": truths, "mixture": entering.halves()[0]}
settings = {
    name: belt_mixture.set_up(known, entering, log_odds, first_bad, ValveBar())
    for name, known in calibrations.items()
}
rows = [
    belt_mixture.costs(setting, first_bad, log_odds, [setting.bar], [0.0], [1.0]).assign(
        calibrated_with=name, model=setting.model, valve_mm=setting.bar.width_mm
    )
    for name, setting in settings.items()
]
pd.concat(rows).set_index("calibrated_with").drop(columns=["ratio", "log_odds"]).round(3)

# %% [markdown]
# ## Costs of both errors
#
# A good particle that is blown out costs 1. A bad one that is left costs 1, 5 or 25 times as much.
# Both count as they come out at the valves: missed tracks and co-deflections are among them. This
# figure is ours: it turns both errors into a threshold and a time.
#
# The time varies at even odds, whatever a bad one costs. The odds are over-confident: a quadratic
# rule takes features as normal, and their tails are longer. So the cheapest threshold lies far
# from that by Bayes. Times up to 20 ms were tried.

# %%
setting, ratios = settings["bad material alone"], (1, 5, 25)
quantiles = np.quantile(log_odds, np.linspace(0, 1, 41))  # nearly all lie far from even odds
thresholds = np.unique(np.concatenate([quantiles, np.linspace(-10, 10, 41)]))
by_odds = belt_mixture.costs(setting, first_bad, log_odds, [setting.bar], thresholds, ratios)
bars = [replace(setting.bar, open_s=time / 1000) for time in belt_valves.OPEN_MS]
by_time = belt_mixture.costs(setting, first_bad, log_odds, bars, [0.0], ratios)
bayes = {ratio: belt_mixture.bayes_threshold(ratio, bad_share) for ratio in ratios}
reported = by_time.iloc[0]

# %% tags=["hide-input"]
labels = {"log_odds": "log odds from which a track is blown out"}
labels |= {"open_ms": "time that a valve is open (ms)"}
picture, (panels,) = style.canvas(1, 2, width_mm=style.PAGE_MM, height_mm=65, sharey=True)
for axes, (axis, label), costs in zip(panels, labels.items(), (by_odds, by_time), strict=True):
    for ratio, colour, line in zip(ratios, style.COLOURS, style.LINES, strict=False):
        part = costs[costs["ratio"] == ratio].set_index(axis)["cost_per_particle"]
        axes.plot(part, color=colour, ls=line, label=f"a bad one left costs {ratio}")
        if axis == "log_odds":
            axes.plot(bayes[ratio], np.interp(bayes[ratio], part.index, part), "o", color=colour)
    axes.set(xlabel=label, yscale="log")
    axes.yaxis.set(major_formatter="{x:g}")
panels[0].set_xscale("symlog", linthresh=10)
panels[0].xaxis.set(major_formatter="{x:g}")
panels[0].set_ylabel("cost per particle\n(good ones blown out)")
_ = panels[1].legend()

# %%
caption = (
    "Cost per particle fed, in good particles blown out, over the threshold of the class (left; "
    f"dots: by Bayes, for a feed with {100 * bad_share:.0f} % bad) and over the time that a valve "
    f"is open (right). The second half of a mixture from pictures: {reported.bad:.0f} of "
    f"{reported.bad + reported.good:.0f} particles are bad."
) + unlike
parts = {"threshold": by_odds, "time": by_time}
table = pd.concat(parts, names=["varied"]).reset_index("varied")
options = {"picture": picture, "caption": caption, "provenance": origin}
figures.save("belt-mixture-cost", table, **options)

# %%
confused = belt_mixture.confusion(entering, first_bad, blow)
wrong = table_of_classes.query("shared_spot == 'never'").set_index("particle")
now = by_time.query("open_ms == 1000 * @setting.bar.open_s and ratio == 1").iloc[0]
best = belt_mixture.cheapest(by_time, "open_ms")
result = (
    f"Of {entering.counts()['particles']} particles {confused['missed'].sum()} have no track; "
    f"{confused.loc['good', 'blown out']} good ones are taken for bad, "
    f"{confused.loc['bad', 'left']} bad ones for good. Of those that never shared a spot, "
    f"{wrong['blown out']['good']} and {wrong['left']['bad']}. Of the second half "
    f"{now['bad_left']:.0f} of {now['bad']:.0f} bad ones pass the valves, and "
    f"{now['good_blown_out']:.0f} of {now['good']:.0f} good ones are blown out. "
    f"Cheapest of {belt_valves.OPEN_MS[0]:g} to {belt_valves.OPEN_MS[-1]:g} ms is {best[1]} ms if "
    f"both cost the same, {best[25]} ms at 25 to 1. No claim is tested."
) + unlike
figures.conclude(result, [], origin)
