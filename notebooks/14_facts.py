# %% [markdown]
# # What the twin can and cannot do, by facts
#
# **Published** (thesis, sections 5.3.1, 5.3.2 and A.2). Sentences on four fractions at two
# pressures: first speed, reach, dwell time, share that ignites, time of ignition. These are five
# facts of eight campaigns, and the orders of fractions are counted apart.
#
# **Here.** Second look: the first twin's outcomes had been seen when the second was built. Both are
# counted by one rule. Bounds, tolerance and what counts were fixed from the text before an outcome
# of the second twin was known. A fact holds within two standard deviations of its bounds. What is
# compared with print is measured by the whole chain; the truth stands beside it.
#
# Two null models say what a count is worth. In one all fractions fly alike. In the other the
# inputs are drawn from the limits of the second look's fit. The twin has skill only where it beats
# both. No claim is judged.

# %% tags=["parameters"]
scale = "standard"  # quick (two campaigns measured), standard (four, 200 frames each) or full
seed = 0  # of the scenes, of the true flights and of the draws
particles = 0  # true flights per campaign; 0: 10, 100 or 4000 by scale (of a draw at most 300)
draws = 0  # of the inputs; 0: 1, 4 or 30 by scale
jobs = 2  # processes

# %%
from functools import partial

from kilnflight.experiments import campaigns, flight_pictures, twin_flight, twin_statements
from kilnflight.project import figures, paths, style
from kilnflight.project.parallel import run_all
from kilnflight.twin import fitted, poses

# %%
style.use_style()
particles = particles or {"quick": 10, "standard": 100, "full": twin_statements.PARTICLES}[scale]
draws = draws or {"quick": 1, "standard": 4, "full": 30}[scale]
setting = {"scale": scale, "particles": particles, "draws": draws}
inputs = [paths.reference() / "facts.csv", paths.reference() / "rankings.csv"]
inputs += [fitted.FLIGHT_FILE, fitted.SECOND_FLIGHT_FILE]
origin = figures.trace("14_facts", setting, seed=seed, inputs=inputs)

# %%
measured = campaigns.results(scale, seed, jobs).measured
runs = [(kiln, particles, seed) for kiln in (fitted.first_kiln(), fitted.second_kiln())]
first, second = run_all(twin_statements.true_values, runs, jobs)
kiln_of = partial(twin_flight.coarse_kiln, pose=poses.read_poses().mode)
few = min(particles, twin_statements.DRAWN)
drawn = twin_statements.prior_values(twin_flight.SEARCH, kiln_of, draws, few, seed, jobs)

# %% [markdown]
# ## Every fact
#
# Ours: only fact by fact can be seen what the twin is worth as a prediction.

# %%
table = twin_statements.statement_table(measured, second, drawn)
caption = (
    "Facts of the thesis and the twin, second look: bounds as printed, tolerance (a standard "
    f"deviation), measured by the whole chain, and true of {particles} flights. Distance z from "
    "the bounds in tolerances, and whether it holds, of what is measured. Null models: whether it "
    f"holds with all fractions alike, and in which share of {draws} draws of the inputs ({few} "
    "flights each). Shares and times of ignition are measured by a test of grey values that takes "
    "about every second sheet and three in ten chips and granules for lit, whether they are or not "
    "(notebook 54), so that such a fact says nothing where it holds as measured."
)
figures.save("twin-statements", table, caption=caption, provenance=origin)

# %% [markdown]
# A fact with a wide tolerance holds whatever the inputs are. It cannot fail, so it says nothing.

# %%
can_fail = twin_statements.facts_that_can_fail(table)
caption = (
    "Facts that hold in every draw of the inputs, and those that can fail: how many of these hold "
    "as measured, and in a draw on average."
)
figures.save("twin-facts-that-can-fail", can_fail, caption=caption, provenance=origin)

# %% [markdown]
# ## What is left out
#
# Speeds farther along are no first speeds, and few particles are left there. What changes from 4.5
# to 5 bar cannot be identified: the printed differences are not monotone, and no single state of
# the kiln gives them. Sentences that contradict each other or are garbled give no bound.
# Simulations by others are no measurement. What has no number of one fraction is no fact of it.

# %%
twin_statements.left_out()

# %% [markdown]
# ## The first twin beside the second
#
# Ours: the count is the result, and the null models are its measure. The last columns keep the
# count that was used before: statements that no fit read, without tolerance.

# %%
versions = dict(zip(twin_statements.VERSIONS, (first, second, measured), strict=False))
*_, same, prior = twin_statements.VERSIONS
runs = {name: [values] for name, values in versions.items()}
runs |= {same: [twin_statements.all_alike(second)], prior: drawn}
counts = twin_statements.count_holding(runs)
caption = (
    "Facts, cells (all sentences of a campaign and fact) and orders of fractions that hold. Held "
    "out: what neither fit read. Of draws: the mean and the range of 90 %. Measured at scale "
    f"{scale} in {len(measured)} of 8 campaigns; what is not measured fails. Last: the old count "
    "of held-out statements about these campaigns, without tolerance, and their median misfit."
)
figures.save("twin-count", counts, caption=caption, provenance=origin)

# %%
every = twin_statements.side_by_side(versions)
picture = flight_pictures.draw_facts(every, list(versions))
caption = (
    "Which facts hold, by campaign: of the first twin's true flights, of the second's, and as "
    "measured on the second. Filled: all sentences hold. Half: some. Open and crossed: none. No "
    "mark: not measured. The numbers are of sentences."
)
figures.save("twin-facts", every, picture=picture, caption=caption, provenance=origin)

# %% [markdown]
# ## Result

# %%
result = twin_statements.describe_counts(counts, can_fail)
figures.conclude(result, [], origin)
