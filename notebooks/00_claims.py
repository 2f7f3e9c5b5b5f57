# %% [markdown]
# # The claims and what became of them
#
# **Published.** Three works make claims about how well particles can be seen, followed and
# predicted. Each was turned into something that can fail before it was tested
# (data/reference/claims.csv).
#
# **Here.** The verdicts of all other notebooks, collected. "Not decidable" always has a
# reason: no input that could decide it, or no notebook that tests it yet.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full; handed on to the provenance only
seed = 0  # nothing random happens here

# %%
import pandas as pd

from kilnflight.project import claims, figures

concluded = figures.concluded()
origin = figures.trace("00_claims", {"scale": scale}, inputs=concluded.values())
table = claims.collect(pd.read_csv(path) for path in concluded.values())
counts = claims.count(table)
caption = "Every claim of the three works with verdict, measured value and notebook."
figures.save("claims", table, caption=caption, provenance=origin)
pd.set_option("display.max_colwidth", None)
pd.set_option("display.max_rows", None)

# %% [markdown]
# ## Tested

# %%
tested = table[table["notebook"] != ""]
tested.set_index("id")

# %% [markdown]
# ## Waiting for their input

# %%
table.loc[table["notebook"] == "", ["id", "published", "reason"]].set_index("id")

# %% [markdown]
# ## Verdict

# %%
result = (
    f"{len(tested)} of {len(table)} claims tested: {counts['reproduced']} reproduced, "
    f"{counts['not reproduced']} not reproduced, "
    f"{(tested['verdict'] == claims.NOT_DECIDABLE).sum()} not decidable here."
)
figures.conclude(result, [], origin)
