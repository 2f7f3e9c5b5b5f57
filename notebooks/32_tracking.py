# %% [markdown]
# # GNN and JPDA on four fractions
#
# **Published** (thesis, sections 5.2.1 to 5.2.3, Tables 5.15 to 5.17). Particles of each fraction
# are tracked in windows in which 7 to 37 trajectories were followed by hand. Post-processing
# raises all four measures for all fractions and both trackers; GNN and JPDA are comparable,
# JPDA with a slight advantage at a far higher cost.
#
# **Here.** The same on the twin's campaigns at 4.5 bar, in windows with as many trajectories,
# with detections of the combined SIFT and DBSCAN that are not known to be on the wall. Noise
# of the filter, gate and how long a lost track is kept are not printed: they are set on other
# stretches of the campaigns, for each tracker by its mean beta without post-processing. The gate
# of the scores is the bare epsilon of Table 5.16.

# %% tags=["parameters"]
scale = "standard"  # quick (two fractions), standard or full
seed = 0  # of the scenes
jobs = 2  # processes of the detection

# %%
import pandas as pd

from kilnflight import drawing, figures, provenance, reference

drawing.use_style()

# %%
from kilnflight import lessons, pursuit

made = provenance.trace("32_tracking", {"scale": scale}, seed=seed)
learned = lessons.learned(scale, seed)
windows = pursuit.windows(scale, learned, seed, jobs=jobs)
others = pursuit.windows(scale, learned, seed, others=True, jobs=jobs)
fractions = [one.fraction for one in windows]

# %%
printed = reference.published("table_5.15").set_index("fraction")
counted = pd.DataFrame(
    {
        "fraction": fractions,
        "first_frame": [one.frames.start for one in windows],
        "frames": [len(one.frames) for one in windows],
        "trajectories": [one.truth["particle"].nunique() for one in windows],
        "positions": [len(one.truth) for one in windows],
        "detections": [len(one.detections) for one in windows],
    }
)
counted["trajectories_published"] = counted["fraction"].map(printed["amount_of_trajectories"])
caption = "Windows and their true trajectories, after Table 5.15."
figures.save("table-5-15-windows", counted, caption=caption, provenance=made)
