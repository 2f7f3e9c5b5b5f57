# %% [markdown]
# # Separation: better models hit more with shorter jets
#
# **The work.** Both belt papers predict particles so that a valve can blow them out.
# "With 1.5 mm a reliable separation is ensured" (2016, section IV.C); how many
# particles are hit is not evaluated.
#
# **Here.** A bar of 32 valves is driven by predictions, from the authors' exact
# positions and from pictures of them. Number of valves, width and time of a jet are our
# choice.
#
# **One number.** Lateral error of most spheres from pictures, here over 150 mm instead
# of 100 mm: 1.5 mm printed, 1.52 mm here.
#
# **What disagrees.** With this error, constant velocity without its bias hits 88 % of
# the spheres, by jets of 5.6 mm and 5 ms. Whether that is "reliable" is open; no claim
# is tested.

# %% tags=["hide-input"]
from dataclasses import replace

import numpy as np
import pandas as pd
from IPython.display import Markdown

from kilnflight import belt
from kilnflight.belt.valves import ValveBar
from kilnflight.experiments.belt import lots, paper_2016, paper_2020
from kilnflight.publication import figures, style
from kilnflight.simulated.belt.bulk import BULKS
from kilnflight.simulated.belt.rendering import Pictures

files = paper_2020.find_dem()
source = paper_2020.AUTHORS if files else paper_2020.OWN
called = "the authors' tracks" if files else "the friction model"
Markdown(paper_2020.INPUT[source])

# %% [markdown]
# The bar is at the edge of the belt. Predictions start 150 mm before it. The first half
# of the particles calibrates the models. The second half passes ten times, and each
# time another tenth is to be blown out.
#
# The valve nearest to the predicted place opens around the predicted time. A particle
# is hit if its centre passes an open valve, even one that was opened for another. Its
# size and the way of the air are neglected.
#
# Most are 95 % here. The printed error is over 100 mm, ours over the 150 mm of the 2020
# paper.
#
# Exact positions have no noise, and no particle is missed: these shares are what the
# models allow. For pictures the tracks are interpolated by cubic splines and rendered
# at 200 frames/s (notebook 42). There, particles that touch may have no prediction. How
# cuboids and cylinders lie is not public; random directions make more of them overlap.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 2020  # of the particles to be blown out, the pictures and the friction model
blown = 0.1  # share of the particles to be blown out
jobs = 2  # processes, one material each

# %%
style.use_style()
count = paper_2016.PARTICLES[scale]  # in the pictures, of each material
setting = {"scale": scale, "count": count, "blown": blown}
origin = figures.trace("45_separation", setting, seed=seed, inputs=files.values())
phase = belt.PredictionPhase()
exact = paper_2020.load_tracks(files, seed, paper_2020.PARTICLES.get(scale))
coarse = paper_2020.load_tracks(files, seed, count)
bodies = {
    name: paper_2020.resample(each, paper_2016.TRUTH_HZ)
    for name, each in coarse.items()
}
pictures = {
    name: Pictures(tracks, BULKS[name], seed) for name, tracks in bodies.items()
}
pictured = paper_2016.track_all(pictures, jobs, phase.start_mm)

# %%
times_ms = (0.5, 1, 2, 3, 5, 7, 10, 15, 20)
bars = [replace(ValveBar(), open_s=time / 1000) for time in times_ms]


def separate(entering, models):
    """Return hits, co-deflections and lateral errors of each model and bar, in percent
    and mm.
    """
    rows = []
    first, second = entering.halves()
    known = second.rows >= 0
    y = second.arrival["y"].to_numpy()[second.rows[known]]
    for name, when, where in first.fit(models):
        predicted = second.predict(when, where)
        drawn = lots.draw_lots(second, predicted, blown, seed)
        off = np.abs(predicted["y"].to_numpy()[known] - y)
        for bar in bars:
            shares = bar(*drawn)
            row = {
                "model": name,
                "valves": bar.valves,
                "valve_mm": bar.width_mm,
                "open_ms": 1000 * bar.open_s,
                "delay_ms": round(1000 * bar.delay_s, 6),
                "hit_percent": 100 * shares.hit_share,
                "inadvertent_percent": 100 * shares.inadvertent_share,
                "lateral_q95_mm": float(np.nanquantile(off, 0.95)),
                "missed_percent": 100 * second.missed_share,
            }
            rows.append(row)
    return pd.DataFrame(rows)


# %%
tables = {}
for name, tracks in exact.items():
    entering = lots.of_bodies(tracks, phase)
    tables[source, name] = separate(entering, lots.VALVE_MODELS)
for name, seen in pictured.items():
    entering = lots.of_pictures(seen, bodies[name], phase)
    tables["pictures", name] = separate(entering, lots.OF_VELOCITY)
table = pd.concat(tables, names=["source", "data_set"]).droplevel(-1).reset_index()

# %% [markdown]
# ## Hits by model
#
# Above: exact positions, over the time that a valve is open. Below: from pictures, hits
# against co-deflections. Each point of a curve is one of the same times; longer ones
# hit more of both. CV-CV is late by its bias and is left out there. CA-CA needs an
# acceleration, which the filter of the pictures does not have. The figure is ours: it
# turns errors of prediction into what a sorter is built for.

# %% tags=["hide-input"]
shown = ["IV-Straight", "CV-CV", "CVBC-CV", "CA-CA", "IA-Ratio"]
looks = list(zip(style.COLOURS, style.LINES, style.MARKERS, strict=True))
picture, grid = style.canvas(
    2, len(exact), width_mm=style.PAGE_MM, height_mm=110, sharey="row"
)
for name, (above, below) in zip(exact, grid.T, strict=True):
    for model, (colour, line, mark) in zip(shown, looks, strict=False):
        rows = table[(table["data_set"] == name) & (table["model"] == model)]
        look = {"color": colour, "ls": line, "marker": mark, "label": model}
        first, second = (rows[rows["source"] == kind] for kind in (source, "pictures"))
        above.plot(first["open_ms"], first["hit_percent"], **look)
        if model != "CV-CV":
            below.plot(second["inadvertent_percent"], second["hit_percent"], **look)
    above.set(title=f"{name}, exact positions", xlabel="time that a valve is open (ms)")
    below.set(title=f"{name}, from pictures", xlabel="other particles that are hit (%)")
for axes in grid[:, 0]:
    axes.set(ylabel="particles to be blown out\nthat are hit (%)", ylim=(0, 103))
_ = picture.legend(
    *grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5
)

# %%
caption = (
    f"Hits of a bar of 32 valves by model (arrival, then lateral) on {called}; one "
    "particle in ten is to be blown out. Above: exact positions. Below: pictures of "
    f"{count} particles each; a point for each time that a valve is open, 0.5 to 20 "
    "ms. IV-Straight is what a line-scan camera assumes."
)
figures.save(
    "belt-separation", table, picture=picture, caption=caption, provenance=origin
)

# %% [markdown]
# With jets of 5 ms, in percent:

# %%
five = table[table["open_ms"] == 5].set_index(["source", "data_set", "model"])
columns = ["hit_percent", "inadvertent_percent", "lateral_q95_mm", "missed_percent"]
five.loc[(slice(None), slice(None), shown), columns].round(2)

# %%
hit = five["hit_percent"]
result = (
    f"On exact positions of {called} jets of 5 ms hit "
    f"{hit[source, 'spheres', 'IV-Straight']:.0f} % of the spheres by the old model "
    f"(IV-Straight) and {hit[source, 'spheres', 'IA-Ratio']:.0f} % by IA-Ratio; from "
    f"pictures IA-Ratio hits {hit['pictures', 'spheres', 'IA-Ratio']:.0f} %."
)
figures.conclude(result, [], origin)
