# %% [markdown]
# # Claims and verdicts
#
# **Published.** Three works make claims about how well particles can be seen, followed and
# predicted. Each was turned into something that can fail before it was tested
# (data/reference/claims.csv). A bound that no work prints is named as ours, and decides only where
# bounds half and twice as far would decide alike.
#
# **Here.** The verdicts of all other notebooks, by chapter and by cause. What is not reproduced or
# not decidable has one of five causes:
#
# - **method**: the method itself, or a choice in it that no work prints;
# - **twin**: an input of the twin that nobody published; the claim may fail on its own truth;
# - **chain**: true on the twin, lost by detection, tracking or measuring;
# - **criterion**: the words of the claim allow both outcomes; a bound would be ours;
# - **misprint**: what is printed contradicts itself.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full; handed on to the provenance only
seed = 0  # nothing random happens here

# %% tags=["hide-input"]
import pandas as pd
from IPython.display import HTML, Markdown, display

from kilnflight.project import claims, claims_page, figures, style

style.use_style()
concluded = figures.concluded()
origin = figures.trace("00_claims", {"scale": scale}, inputs=concluded.values(), mark="")
table = claims.collect(pd.read_csv(path) for path in concluded.values())
counts = claims.count(table)
caption = "Every claim of the three works with verdict, measured value, notebook and cause."
short = table[["id", "verdict", "because", "notebook"]]
picture = style.table_picture(short, len(short))
_ = figures.save("claims", table, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Verdicts by chapter and cause

# %%
caption = "Number of claims by chapter, verdict and cause."
by_cause = claims_page.counts_by_cause(table)
figures.save("claims-by-cause", by_cause, caption=caption, provenance=origin)

# %% tags=["hide-input"]
on_truth = table.loc[claims_page.fails_on_truth(table), "id"]
Markdown(
    f"{len(on_truth)} claims fail on the twin's own truth: no measuring chain can reproduce "
    f"them: {', '.join(on_truth) or 'none'}. They are verdicts on the twin."
)

# %% [markdown]
# ## The claims
#
# Each name leads to the notebook that decides, and to the figure where it is drawn. A click on
# what is ours shows the criterion and the reason.

# %% tags=["hide-input"]
saved = {entry.identifier: entry.provenance["notebook"] for entry in figures.entries()}
for chapter, part in claims_page.by_chapter(table).groupby("chapter", sort=False):
    display(HTML(f"<h3>{chapter}</h3>" + claims_page.page_table(part, saved)))

# %% [markdown]
# ## Verdict

# %%
tested = table[table["notebook"] != ""]
causes = table.loc[table["verdict"] == claims.NOT_REPRODUCED, "because"].value_counts()
result = (
    f"{len(tested)} of {len(table)} claims tested: {counts['reproduced']} reproduced, "
    f"{counts['not reproduced']} not reproduced "
    f"({', '.join(f'{name} {number}' for name, number in causes.items())}), "
    f"{(tested['verdict'] == claims.NOT_DECIDABLE).sum()} not decidable here."
)
figures.conclude(result, [], origin)
