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

from kilnflight.experiments import blind_tests
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
# ## First twin and second look
#
# The twin was made twice. The second look was made after the outcomes of the first twin were known,
# so a verdict that became another one is labelled. Claims on the belt, and those that the thesis's
# own tables decide, do not hang on it.

# %%
beside = claims.beside_first_twin(table)
caption = (
    "Verdicts on the claims about the kiln that the first twin gave, at full scale, beside those "
    "of the second look. Labelled: the verdict is another one."
)
figures.save("claims-first-twin", beside, caption=caption, provenance=origin)

# %% tags=["hide-input"]
before = beside["first_twin"].value_counts()
Markdown(
    f"The first twin, of {len(beside)} claims about the kiln: "
    + ", ".join(f"{before.get(verdict, 0)} {verdict}" for verdict in claims.VERDICTS)
    + f". Another verdict in the second look: {', '.join(beside.loc[beside['label'] != '', 'id'])}."
)

# %% [markdown]
# ## Blind tests of the second look
#
# No input of the twin was fitted to Tables 5.8 to 5.11 and 5.17, nor to R2 of Table 5.18. Left out
# is Otsu's row of Table 5.11: it is the total of Table 5.5, to which the light was fitted. The RMSE
# of Table 5.18 in depth is an input, too, and R2 in depth hangs on it. The diagonal is print.
# Tracks are those from the lance. Of two readings of a background's difference it is the absolute.

# %%
numbers = blind_tests.compare()
caption = (
    "Blind tests: each number of Tables 5.8 to 5.11 and 5.17, and R2 of Table 5.18, as printed, "
    "and as measured on the first twin (full scale) and on the second look."
)
picture = blind_tests.draw(numbers)
figures.save("blind-tests", numbers, picture=picture, caption=caption, provenance=origin)

# %%
summary = blind_tests.by_table(numbers)
caption = "Blind tests by table: median of the absolute difference from print, for both twins."
figures.save("blind-tests-summary", summary, caption=caption, provenance=origin)

# %% tags=["hide-input"]
clusters = blind_tests.false_clusters()
Markdown(blind_tests.describe(summary, clusters))

# %%
caption = (
    "False clusters of DBSCAN per labelled frame (Table 5.8), printed and of both twins. They fall "
    "with epsilon, as more points of the wall join. Over print: the second look's number over it."
)
figures.save("blind-tests-clusters", clusters.round(3), caption=caption, provenance=origin)

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
