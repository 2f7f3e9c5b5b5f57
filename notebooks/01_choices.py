# %% [markdown]
# # What the works do not print, and what depends on it
#
# **The work.** A thesis and two papers describe methods. Whoever builds them again has to decide
# what no page says: a unit, a constant, who is scored, how bright a flame is.
#
# **Here.** Each such choice, what decides it, and the result with our value and with another one.
# A verdict that turns with a choice that neither text nor tools decide is open.
#
# **One number.** There is no number to compare.
#
# **What disagrees.** When a choice was made, its effect on a verdict was known from trials, but for
# depth-6. So the order is fixed: texts and tools first, then the simulation, then values that one
# printed number identifies, then the tests (data/reference/freezes.csv). Two changes came after the
# tests of notebook 32 had been seen: T8, and T7 as an assumption.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full; named in the provenance only
seed = 0  # nothing random happens here

# %% tags=["hide-input"]
import pandas as pd

from kilnflight.project import choices, claims, figures, paths

# %% [markdown]
# ## How a choice is decided
#
# 1. **Text**: a sentence, a caption or an axis of the work.
# 2. **Tools** of the authors: MATLAB's difference of two uint16 pictures stops at zero.
# 3. **Identified**: the value at which one printed number comes out, which then tests nothing.
# 4. **Assumption**: nothing decides, and the choice is ours.

# %%
inputs = [paths.reference() / name for name in ("choices.csv", "claims.csv")]
origin = figures.trace("01_choices", {"scale": scale}, inputs=inputs, mark="")
table = choices.collect()
table["decided_by"].value_counts().reindex(list(choices.DECIDED_BY))

# %% [markdown]
# ## All choices
#
# The evidence names lines of the thesis (T:1504) or the printed number that identified a value.
# Results are those of this run.

# %%
caption = (
    "What no work prints: our choice, other values, what decides, and a result with either value. "
    "The last columns name the claims whose verdict differs and the notebook that compares."
)
figures.save("choices", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts that turn
#
# Each row is a claim whose verdict differs with the other value of a choice. Four choices were not
# tried: for D10, T6, F3 and F4 all campaigns would have to be made and measured again, an hour for
# each. Their results are those of true paths, as the camera sees them.

# %%
judged = claims.collect().set_index("id")
turning = table[["id", "decided_by", "verdicts_that_turn"]].rename(columns={"id": "choice"})
turning["claim"] = turning["verdicts_that_turn"].str.split()
turning = turning.explode("claim").dropna(subset=["claim"])
verdicts = judged.loc[turning["claim"], ["verdict", "published"]].reset_index(drop=True)
turning = pd.concat(
    [turning[["choice", "decided_by", "claim"]].reset_index(drop=True), verdicts], axis=1
)
caption = (
    "Claims whose verdict differs with the other value of a choice. Where neither text nor tools "
    "decide the choice, the claim is open."
)
figures.save("choices-verdicts", turning, caption=caption, provenance=origin)

# %% [markdown]
# ## What the authors would have had to print
#
# Choices that only a number or an assumption decides.

# %%
asked = table[table["decided_by"].isin(choices.UNDECIDED)]
asked[["id", "where", "not_printed", "chosen"]]

# %% [markdown]
# ## Steps of the work
#
# Each step has the commit at which it was fixed, and a checksum of the inputs there. Changed later
# were T7, T8, and the status of the clutter (D9).

# %%
pd.read_csv(paths.reference() / "freezes.csv")

# %%
count = turning["claim"].nunique()
result = (
    f"{len(table)} choices decide what no work prints, {len(asked)} of them by a number or an "
    f"assumption alone. {count} of {len(judged)} verdicts differ with another value."
)
figures.conclude(result, [], origin)
