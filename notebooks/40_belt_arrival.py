# %% [markdown]
# # Arrival time: when a particle leaves the belt
#
# The 2020 paper compares six models of when a particle leaves the belt; we run them on the authors'
# tracks and on our own simulated sorter.

# %% tags=["hide-input"]
import numpy as np
import pandas as pd
from IPython.display import Markdown

from kilnflight.belt import recordings
from kilnflight.belt.evaluation import Evaluation
from kilnflight.experiments import belt_2020, belt_claims, belt_motion, belt_plots, belt_sorter
from kilnflight.experiments.belt_2020 import PHASE
from kilnflight.project import claims, figures, style

files = recordings.find_dem()
source = belt_2020.AUTHORS if files else belt_2020.OWN
Markdown(belt_2020.describe_input(files))

# %% [markdown]
# **Published** (2020 paper, sections 4.1, 5.1 and 5.2). A sorter sees particles on a belt
# until 150 mm before its edge and must predict when each leaves. Six models were compared on
# simulated spheres, cuboids and cylinders; identical acceleration (IA) was best everywhere.
#
# **Here.** The same on the tracks that the authors published. They have 100 Hz instead of 1000 Hz
# and end at the edge (788 mm), so target and start lie 15 mm upstream. Our own simulated sorter
# (notebook 43) has the paper's 1000 Hz and goes on beyond the edge. Beside the authors' tracks it
# is predicted to the same target; in the study of the sampling rate, to the edge. The calibration
# with 1 % of the particles is drawn many times. A deviation is prediction minus reference: positive
# means that the particle came earlier than predicted.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 2020  # of the calibration draws and of our own simulation
draws = 0  # calibration draws; 0: 5, 200 or 1000 by scale
jobs = 2  # processes of our own simulation

# %%
style.use_style()
study, draws = belt_2020.ARRIVAL, draws or belt_2020.DRAWS[scale]
setting = {"scale": scale, "draws": draws}
origin = figures.trace("40_belt_arrival", setting, seed=seed, inputs=files.values())
tracks = belt_2020.tracks_by_source(files, seed, belt_2020.PARTICLES[scale], jobs)
observed = {key: PHASE.observe(table) for key, table in tracks.items()}
unlike = belt_sorter.describe_unlike(tracks)
print(f"{draws} draws; predicting from {PHASE.start_mm:.0f} to {PHASE.target_mm:.0f} mm")

# %% [markdown]
# Particles of each data set, how many are evaluated, and why the others are left out:

# %%
belt_2020.count_particles(tracks, observed)

# %% [markdown]
# ## Velocity along the belt

# %%
grid = np.arange(400.0, 751.0, 25.0)  # all particles have observations here
profiles = belt_2020.profiles(tracks, grid)[
    ["source", "data_set", "x_mm", "mean_m_s", "std_m_s", "particles"]
]

# %% tags=["hide-input"]
sources = list(profiles["source"].unique())
picture, (panels,) = style.canvas(1, len(sources), width_mm=88 * len(sources), sharey=True)
looks = dict(zip(belt_2020.DATA_SETS, zip(style.COLOURS, style.MARKERS, strict=True), strict=False))
for axes, name in zip(panels, sources, strict=True):
    axes.axhline(1.5, color="0.6", lw=0.8, ls="-", label="belt")
    axes.set(title=name, xlabel="x along the belt (mm)", ylabel="velocity along the belt (m/s)")
    for data_set, (colour, mark) in looks.items():
        part = profiles.query("source == @name and data_set == @data_set").set_index("x_mm")
        mean, std = part["mean_m_s"], part["std_m_s"]
        axes.plot(mean, color=colour, marker=mark, ls="-", label=data_set)
        spread = pd.concat([mean - std, mean + std])
        axes.plot(spread.index, spread, ".", color=colour, ms=1.5)

# %%
panels[0].legend(loc="lower right", ncols=2)
caption = (
    "Mean velocity along the belt, after Fig. 7 of the 2020 paper. Dots: one standard deviation "
    "above and below. Particles are slower than the belt and still accelerate at the last place "
    "that all reach."
)
options = {"picture": picture, "caption": caption, "provenance": origin}
figures.save("fig-belt20-7-velocity", profiles, **options)

# %% [markdown]
# ## The reference: when a particle passes the line
#
# As in Fig. 5, a straight line between the last observation before the target and the first one
# after it gives place and time.

# %%
track = tracks[source, "spheres"]
one = track[track["particle"] == observed[source, "spheres"].arrival["particle"].iloc[0]]
points = belt_plots.crossing(one, PHASE.target_mm)
caption = (
    "How the reference is made, after Fig. 5 of the 2020 paper. Two observations of one simulated "
    f"sphere of {belt_2020.CALLED[source]} around the target, and the crossing between them. Times "
    "after the first."
)
picture = belt_plots.draw_crossing(points, PHASE.target_mm)
options = {"picture": picture, "caption": caption, "provenance": origin}
figures.save("fig-belt20-5-crossing", points.reset_index(), **options)

# %% [markdown]
# ## Deviation of the arrival time

# %%
arrival = study.compare(observed, draws, seed)
table, caption = study.table(arrival), study.captions["table"] + unlike
figures.save("belt-arrival", table, caption=caption, provenance=origin)

# %%
plotted = arrival[arrival["model"].isin(belt_claims.PLOTTED)]
picture = belt_plots.boxes_by_source(plotted, "predicted minus true arrival (ms)", 52)
options = {"picture": picture, "caption": study.captions["boxes"] + unlike, "provenance": origin}
figures.save("fig-belt20-9-arrival", study.labelled(arrival), **options)

# %% [markdown]
# ## What the target and the sampling rate change
#
# The reference is a straight line between two observations 10 ms apart, and the target is our
# choice. So the models are also compared at other targets, the phase always 150 mm long.
#
# The paper evaluated at 1000 Hz, the public tracks have 100 Hz. Velocity and acceleration come from
# the last three positions: 20 ms at 100 Hz, 2 ms at 1000 Hz. Our thinned simulation shows the
# effect of the rate alone, with the same particles in the same draws. They are predicted over the
# last 150 mm to the edge (638 to 788 mm), as in the paper. This figure is ours: no publication
# shows how much the rate matters to the models.

# %%
share = 0.02 if scale == "quick" else 0.01  # 1 % of a smoke run's particles may be none
by_target, by_rate = study.vary(tracks, Evaluation(share, min(draws, 20)), seed)
label = "mean absolute error (ms)"
picture = belt_plots.lines_by_rate(by_rate, belt_claims.PLOTTED, study.measure, label)
columns = ["sampling_hz", "source", "data_set", "model", "n", "iqr", "mae"]
table = study.labelled(by_rate[columns])
options = {"picture": picture, "caption": study.captions["rates"] + unlike, "provenance": origin}
figures.save("belt-arrival-rate", table, **options)

# %%
lowest = belt_2020.describe_lowest(by_rate)
rate_effect = f"{belt_2020.describe_changes(by_rate, study.answers)}. {lowest}."
Markdown(rate_effect)

# %% [markdown]
# ## The phase itself
#
# Sections 4.1, 5 and 5.2 also say how long the phase takes, and who is predicted faster than the
# belt. They say, too, what identical delay (ID), the old implicit model, is: IV where all are last
# observed at one place. The table is ours. Carried on to the start all are at one place; the delay
# is a median, as the velocity of IV is (section 5). Beside it: a mean delay, and states as
# observed.

# %%
phases = belt_motion.summarise_phase(observed, PHASE)
caption = (
    "The prediction phase: share of particles that constant acceleration predicts beyond the "
    "belt's velocity, also of states carried to the start, and median and mean time in the phase. "
    "Then by how much identical delay differs at most from identical velocity (IV): with the "
    "median delay from one place, with a mean delay, and as observed."
) + unlike
figures.save("belt-phase", belt_motion.shown_phase(phases), caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts
#
# By the authors' tracks if they are here. The paper names no measure. A sentence counts as
# reproduced where mean absolute error and interquartile range both agree with it beyond chance, and
# as not reproduced where both contradict it; else it is open. For belt20-2 the mean absolute error
# decides alone, since the paper names the bias.
#
# At 100 Hz the last observation lies up to 14 mm before the phase, at the paper's 1000 Hz up to
# 1.4 mm. So each particle is carried on to the start by its own last three points, and these states
# decide. That was settled with the outcomes of both known: the rate is the paper's. Numbers
# are mean absolute error and interquartile range as sampled, then both of carried states.
#
# The first table has the differences of both, with 95 % intervals over particles. The second has
# what point values alone say, as sampled, by every source and by our simulation at every rate (to
# the edge). Both tables are ours.

# %%
answers, deciding = study.answer(observed, source, scale, seed)
caption = (
    "Differences between models that decide claims, by measure, in ms. By how much the right ones "
)
caption += "exceed the left ones, with 95 % interval over particles (paired bootstrap)."
table = study.labelled(deciding)
figures.save("belt-arrival-differences", table, caption=caption, provenance=origin)

# %%
fastest = by_rate["sampling_hz"].max()
motion = belt_2020.by_source(phases, belt_motion.phase_answers, fastest)
table = belt_2020.verdicts_by_source(arrival, by_rate, study.answers, motion)
caption = study.captions["verdicts"] + unlike
figures.save("belt-arrival-verdicts", table, caption=caption, provenance=origin)

# %%
judged = arrival[arrival["source"] == source]
answers |= belt_claims.speed_answers(profiles[profiles["source"] == source])
sampling_hz = 100.0 if files else fastest
here = phases[phases["source"] == source]
of_source = {name: table for (key, name), table in tracks.items() if key == source}
details = belt_motion.phase_details(here, of_source, PHASE)
verdicts = study.judge(answers | motion[source, sampling_hz], by_target, sampling_hz, details)

# %%
mae = belt_claims.by_model(judged, "mae")
reproduced = claims.count_reproduced(verdicts)
result = (
    f"{reproduced} of {len(verdicts)} claims reproduced on {belt_2020.CALLED[source]}. "
    "Identical acceleration is off "
    f"by {mae['IA'].min():.2f} to {mae['IA'].max():.2f} ms on average, identical velocity by "
    f"{mae['IV'].min():.2f} to {mae['IV'].max():.2f} ms. {rate_effect}"
)
figures.conclude(result, verdicts, origin)
