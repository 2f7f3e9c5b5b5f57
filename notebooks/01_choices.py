# %% [markdown]
# # What the works do not print, and what depends on it
#
# **The work.** A thesis and two papers describe methods. Whoever builds them again has
# to decide what no page says: a unit, a constant, who is scored, how bright a flame is.
#
# **Here.** Each such choice, what decides it, and the result with our value and with
# another one. A verdict that turns with a choice that neither text nor tools decide is
# open.
#
# **One number.** There is no number to compare.
#
# **What disagrees.** No choice was made blind: trials had shown which verdicts turn
# (but for the claim depth-6). So the order was fixed: texts and tools, the simulation,
# values that printed numbers identify, then the tests. What came after tests had been
# seen stands at the end.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full; named in the provenance only
seed = 0  # nothing random happens here

# %% tags=["hide-input"]
from itertools import chain

import pandas as pd

from kilnflight.publication import choices, figures, verdicts
from kilnflight.store import index, paths

# %% [markdown]
# ## How a choice is decided
#
# 1. **Text**: a sentence, a caption or an axis of the work.
# 2. **Tools** of the authors: MATLAB's difference of two uint16 pictures stops at zero.
# 3. **Identified**: the value at which a printed number comes out best, which then
#    tests nothing. It need not fit well: T2 misses its eight numbers by 0.17, and the
#    next values are as near.
# 4. **Assumption**: nothing decides, and the choice is ours.
#
# A text often decides between two values without giving a size. The sizes of D6, D10,
# T6 and F6 are ours: inputs of the simulation (notebook 10), and twice the speed of the
# lance's air.


# %%
# These decide a choice. Sentences and the authors' programs alone are evidence.
DECIDED_BY = ("text", "tools", "identified", "assumption")


def once(names):
    """Return names in one text, each once."""
    return " ".join(dict.fromkeys(names))


def collect():
    """Return every choice with its results, in the order of choices.csv.

    To its columns come ``quantity``, ``result_chosen`` and ``result_other``, one entry
    for each comparison, joined by semicolons; ``verdicts_that_turn``, ids of claims;
    ``notebook``. They are empty where no notebook compared; notebook 12 shows those on
    the authors' frames.
    """
    names = ["id", "quantity", "chosen", "other", "turns", "notebook"]
    rows = [
        each for each in index.rows("choices") if not each["notebook"].startswith("12")
    ]
    by_choice = pd.DataFrame(rows, columns=names).groupby("id")
    results = by_choice.agg(
        quantity=("quantity", "; ".join),
        result_chosen=("chosen", "; ".join),
        result_other=("other", "; ".join),
        verdicts_that_turn=("turns", lambda turns: once(chain(*turns))),
        notebook=("notebook", once),
    )
    return choices.load().join(results).fillna("").reset_index()


# %%
inputs = [paths.reference() / name for name in ("choices.csv", "claims.csv")]
origin = figures.trace("01_choices", {"scale": scale}, inputs=inputs, mark="")
table = collect()
table["decided_by"].value_counts().reindex(list(DECIDED_BY))

# %% [markdown]
# ## All choices
#
# The evidence names lines of the thesis (T:1504) or the printed number that identified
# a value.

# %%
caption = (
    "What no work prints: our choice, other values, what decides, and all results with "
    "either value, in the order of their quantities. The last columns name the claims "
    "whose verdict differs and the notebooks that compare."
)
figures.save("choices", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Results with either value
#
# Each row is computed once, in its notebook.

# %%
place = {name: k for k, name in enumerate(table["id"])}


def in_order(names):
    """Return the place of each choice in choices.csv."""
    return names.map(place)


# %%
columns = {"id": "choice", "quantity": "quantity", "chosen": "ours", "other": "other"}
compared = pd.DataFrame(index.rows("choices"), columns=[*columns, "turns", "notebook"])
results = compared[[*columns, "notebook"]].rename(columns=columns)
results = results.sort_values("choice", key=in_order, kind="stable", ignore_index=True)
caption = (
    "Results with our value of each choice and with the other one, by quantity and "
    "notebook."
)
figures.save("choices-results", results, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts that turn
#
# Each row is a claim whose verdict differs with the other value of a choice.
#
# D10, T6, F3 and F4 were not tried on the whole chain: all campaigns would have to be
# made and measured again, an hour for each. On true paths, as the camera sees them, no
# verdict on velocities turns with D10, F3 or F4 (notebook 10). Choices of detection
# were tried on labelled frames, not on tracks. Eight more settings of the trackers are
# assumptions that were not tried (notebook 32).

# %%
judged = verdicts.collect().set_index("id")
decided_by = choices.load()["decided_by"]
rows = {}
for each in index.rows("choices"):
    if each["notebook"].startswith("12"):  # it shows its own
        continue
    for claim, both in each["turns"].items():
        ours, _, other = both.partition(" -> ")
        rows[each["id"], claim, other] = {
            "choice": each["id"],
            "decided_by": decided_by[each["id"]],
            "claim": claim,
            "ours": ours,
            "other": other,
            "verdict": judged["verdict"][claim],
            "published": judged["published"][claim],
        }
names = ["choice", "decided_by", "claim", "ours", "other", "verdict", "published"]
turning = pd.DataFrame(rows.values(), columns=names)
turning = turning.sort_values("choice", key=in_order, kind="stable", ignore_index=True)
caption = (
    "Claims whose verdict differs: with our value of a choice, with the other, and the "
    "one that stands. Where neither text nor tools decide the choice, the claim is "
    "open."
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
# ## D2 in full
#
# The absolute difference is the most informative alternative: dark particles stay.

# %%
in_full = paths.figures() / "absolute-difference.csv"
shown = "Run notebook 24."
if in_full.is_file():
    shown = pd.read_csv(in_full).query("subset == 'Total'")
shown

# %% [markdown]
# ## Steps of the work
#
# Each step has the commit at which it was fixed, and a checksum of the inputs there.
# The tests ran on step d; notebooks that ran again later carry their own commit in the
# caption. What follows was changed after tests had been seen:
#
# - T8 was decided. T7 and F7 were called assumptions: no sentence gives rate, depth or
#   test.
# - The clutter (D9) was called identified, and F6 got its 32 m/s.
# - The limits of Eq. 4.14 (T2) were tried again with the scores of T8: the same pair is
#   nearest.
# - combi-5 is judged on the mean of all six gains, as its sentence says, for both kinds
#   apart.
# - track-1 counts 24 cells for 32: the raw JSC_theta had become inputs. fit-4 is judged
#   by adjusted R2.

# %%
pd.read_csv(paths.reference() / "freezes.csv")

# %%
count = turning["claim"].nunique()
result = (
    f"{len(table)} choices decide what no work prints, {len(asked)} of them by a "
    f"number or an assumption alone. {count} of {len(judged)} verdicts differ with "
    "another value."
)
figures.conclude(result, [], origin)
