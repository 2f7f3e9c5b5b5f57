# %% [markdown]
# # Claims of the three works and their verdicts
#
# **The work.** The thesis and the two belt papers claim how well particles are seen, followed and
# predicted. Each claim here is a sentence that can fail (data/reference/claims.csv).
#
# **Here.** The verdicts of all other notebooks, by chapter. A claim that no test decides is open.
# The causes of a failure are: `twin` (an input of the simulation that no one published), `method`,
# `data` (other recordings than the authors') and `misprint`.
#
# **One number.** None: each notebook has its own.
#
# **What disagrees.** The rows marked "not reproduced". Claims that are not tested any more stand
# with their reasons in docs/limits.md.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full; named in the provenance only
seed = 0  # nothing random happens here

# %% tags=["hide-input"]
import pandas as pd

from kilnflight.project import claims, figures

chapters = {
    "bg": "Background models",
    "otsu": "Otsu's method",
    "sift": "SIFT",
    "cluster": "Clusters in point clouds",
    "combi": "Combined detection",
    "wall": "Particles in the air or on the wall",
    "track": "Tracking",
    "fit": "Trajectories",
    "dwell": "Dwell time",
    "vel": "Velocity",
    "ign": "Ignition",
    "belt16": "Belt paper of 2016",
    "belt20": "Belt paper of 2020",
}

# %% [markdown]
# ## Verdicts by chapter

# %%
origin = figures.trace("00_claims", {"scale": scale}, mark="")
table = claims.collect()
chapter = table["id"].str.split("-").str[0].map(chapters)
counts = pd.crosstab(chapter, table["verdict"]).reindex(list(chapters.values()), fill_value=0)
counts.reindex(columns=list(claims.VERDICTS), fill_value=0)

# %% [markdown]
# ## Why claims are not reproduced

# %%
table.loc[table["verdict"] == "not reproduced", "because"].value_counts()

# %% [markdown]
# ## All claims

# %%
caption = "Every claim with its verdict, what was measured, the notebook that tests it and why."
figures.save("claims", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Result

# %%
total = claims.count(table)
result = (
    f"Of {len(table)} claims {total['reproduced']} are reproduced and {total['not reproduced']} "
    "are not; the others are open."
)
figures.conclude(result, [], origin)
