# %% [markdown]
# # The tracker and the models on a real sorting belt
#
# The authors published positions measured on their real sorter, and no result on them; we track
# them at each recording's own velocity and apply the models of 2020.

# %% tags=["hide-input"]
from functools import partial
from itertools import product

import pandas as pd
from IPython.display import Markdown

from kilnflight.belt import recordings
from kilnflight.belt.evaluation import Evaluation
from kilnflight.belt.phase import PredictionPhase
from kilnflight.belt.velocity import estimate_velocity
from kilnflight.experiments import belt_plots, belt_real
from kilnflight.project import claims, figures, style
from kilnflight.tracking.motion import ConstantAcceleration, ConstantVelocity

# %% tags=["hide-input"]
files = recordings.find_recordings()
absent = "**The authors' recordings are not here**: nothing is shown and nothing concluded. `make "
absent += "data` fetches them, or name their folder in `KILNFLIGHT_RECORDINGS` (with `Kugeln`, "
absent += "`Weizen` or `Zylinder` in it)."
input_note = (
    f"**Input:** {sum(map(len, files.values()))} recordings of a real sorter by the authors."
)
Markdown(input_note if files else absent)

# %% [markdown]
# **Published.** Both belt papers evaluate on simulations. Their authors also published measurements
# on a real sorter (spheres, wheat, cylinders): positions in pixels and their own tracking result.
# No number about these recordings is printed.
#
# **Here.** First the tracker of the 2016 paper on the same positions, compared with the authors'
# links. Then the models of the 2020 paper, predicted over the last quarter of the visible belt and
# compared with the measurements there. Frame rate and scale are not published, so lengths are px
# and times are frames. There is no truth: a position is a measurement, and the camera's perspective
# is not corrected. The claims on the 2020 paper stay with the simulations, but for the one that
# speaks of real data.
#
# No setting is published, either. The belt's velocity is estimated from each recording's own
# measurements: the commonest distance along the belt between measurements of consecutive frames.
# Its spread (8 px per frame), noise, visible area and arrivals are ours, read off these recordings.
# So the agreement of the links depends on them.

# %% tags=["parameters"]
scale = "standard"  # quick (one recording per material), standard or full
seed = 2020  # of the calibration draws
draws = 0  # calibration draws; 0: 2, 50 or 200 by scale

# %%
style.use_style()
draws = draws or {"quick": 2, "standard": 50, "full": 200}[scale]
used = {name: paths[:1] if scale == "quick" else paths for name, paths in files.items()}
inputs = [path for paths in used.values() for path in paths]
setting = {"scale": scale, "draws": draws}
origin = figures.trace("44_real_belt", setting, seed=seed, inputs=inputs, mark="recorded")
tables = {
    (name, path.name.partition(".")[0]): recordings.read_recording(path)
    for name, paths in used.items()
    for path in paths
}
velocities = {key: estimate_velocity(table, key[1]) for key, table in tables.items()}
measured = {
    name: belt_real.join_recordings(part for key, part in tables.items() if key[0] == name)
    for name in used
}
phase = PredictionPhase(1150.0, 1550.0)

# %% [markdown]
# ## The belt's velocity in each recording
#
# The table is ours: neither paper says how fast the real belt ran, or how many frames a second its
# camera took. A recording whose velocity cannot be told is refused. As a plain check, the last
# column is the median step of measurements that the authors' own tracks link.
#
# The authors published 39 recordings, of which 16 are fetched. Others differ more: the spheres 013,
# not among these, move by 62 px (median of the 42 pairs in its last ten frames, 57 to 67 px). So
# one velocity for all would not do.

# %%
by_recording = belt_real.tabulate_velocities(tables, velocities) if files else pd.DataFrame()
caption = (
    "Velocity of particles along the belt in each recording. Median and robust standard deviation "
    "of their distance from frame to frame, and the pairs of measurements it rests on. Then the "
    "share of measurements that have such a pair. Linked: median distance by the authors' own "
    "tracks."
)
options = {"caption": caption, "provenance": origin}
figures.save("belt-real-velocity", by_recording, **options) if files else None

# %% [markdown]
# ## Links shared with the authors
#
# A link is a pair of measurements that follow each other in a track. The table is ours: neither
# paper says how well its tracker does on a real belt.

#
# Uncertainties are ours, too: 8 px per frame of velocity, 1 px of a measurement.

# %%
filters = {
    "CV filter": partial(ConstantVelocity, velocity_sd=8.0, measurement_sd=1.0),  # px, frames
    "CA filter": partial(ConstantAcceleration, velocity_sd=8.0, measurement_sd=1.0),
}
followed = {
    (name, kind): belt_real.track_recordings(tables, velocities, name, motion)
    for name, (kind, motion) in product(measured, filters.items())
}
rows = [
    {"material": name, "filter": kind} | belt_real.compare_links(measured[name], tracks)
    for (name, kind), tracks in followed.items()
]
links = pd.DataFrame(rows).fillna(0)
# %%
caption = (
    "Links of the authors' tracks and of the tracker. Recall: share of the authors' links that "
    "the tracker has. Agreed: share of its links that the authors have. Then how its tracks ended."
)
figures.save("belt-real-links", links, caption=caption, provenance=origin) if files else None

# %% [markdown]
# ## Predicted over the last quarter of the belt
#
# From x = 1150 px to x = 1550 px, four to five frames. Position, velocity and acceleration are
# the filter's at the last measurement before. CALV needs the belt's velocity, which is not
# known here, so it and LV-DSC are left out.
#
# A track is left out for one of three reasons, counted by the first that applies:
#
# - A frame is missing in it: velocity and arrival need frames on both sides.
# - It has fewer than three measurements before 1150 px: dirt, pieces of a broken track, or
#   particles that came into view late.
# - It is not seen at 1550 px: lost, over the side, or still under way when a recording ended.
#
# Tracks over all recordings, and how many are left out by reason:

# %%
evaluation = Evaluation(draws=draws)
models, omitted = belt_real.compare_on_recordings(followed, measured, phase, evaluation, seed)
omitted

# %% [markdown]
# The figure is ours: it is the only place where the models meet a real belt.

# %%
labels = {"arrival_frames": "arrival (frames)", "lateral_px": "place (px)"}
labels = {name: f"predicted minus observed\n{label}" for name, label in labels.items()}
names = ("quantity", "data_set", "model")
plotted = models[models["filter"] == "CV filter"]
plotted = plotted[~plotted["model"].isin(["CA", "CA-CA", "IA-CA"])]  # this filter has none
picture = belt_plots.boxes(plotted, names, labels, 105, rotation=60) if files else None
caption = (
    "Deviations on real recordings with the constant-velocity filter: box plots without outliers. "
    "The numbers are the widths of the boxes. After Figs 9 and 10 of the 2020 paper, which show "
    "simulations. Axes differ between panels. Left out are tracks with a gap, too short, or not "
    "seen at the target."
)
part = {"picture": picture, "caption": caption, "provenance": origin}
figures.save("belt-real-models", models, **part) if files else None

# %% [markdown]
# ## The sentences of the 2020 paper on this data
#
# With the filter that fits each model: constant velocity for IV, CV, CVBC and IA, constant
# acceleration for CA. A sentence is open where mean absolute error and interquartile range differ.
# This table is no verdict: the sentences are about other data. That CV is better than Straight
# is said of real data (section 5.3), though of another sorter, an industrial one (its reference 8).
# That sentence is judged (belt20-22), with tracks resampled.

# %%
belt_real.hold_on_recordings(models) if files else None

# %%
result, verdicts = "The authors' recordings are not here; nothing is concluded.", []
if files:
    verdicts = [belt_real.judge_straight(models, followed, measured, phase, scale, seed)]
    steps = by_recording["px_per_frame"]
    recall, agreed = links["recall_percent"], links["agreed_percent"]
    result = (
        f"The tracker finds {recall.min():.2f} to {recall.max():.2f} % of the authors' links on "
        f"real recordings, and {agreed.min():.2f} to {agreed.max():.2f} % of its own are theirs. "
        f"Particles move by {steps.min():.1f} to {steps.max():.1f} px per frame. "
        f"{claims.count_reproduced(verdicts)} of {len(verdicts)} claims reproduced."
    )
figures.conclude(result, verdicts, origin)
