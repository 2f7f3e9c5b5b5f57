# %% [markdown]
# # Simulated kiln: particles fly and burn as printed, so that the method can be checked
#
# **The work.** The thesis prints how fast and how far particles fly, when they ignite,
# and how many a frame shows (sections 5.1 and 5.3). Its campaigns are not public, and
# its 50 labelled frames could not be reached (notebook 12).
#
# **Here.** The printed numbers are put into simulated recordings whose truth is known.
# Nothing is claimed on the fuel. Measured minus true is the error of the method, which
# other notebooks show.
#
# **One number.** First metre of wood chips at 4.5 bar: 13.5 m/s printed, 13.5 m/s here.
#
# **What disagrees.** Printed numbers contradict each other, so some are missed. Of
# paper shreds at 5 bar fewer than 25 % pass 2 m in print, yet most land near 3 m. Here
# they land at 1.34 m (median).

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 0  # of the scenes
jobs = 2  # processes
particles = 0  # flights of each run; 0: 100, 1000 or 4000 by scale

# %%
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
from tqdm import tqdm

from kilnflight.detection.combination import Combination
from kilnflight.experiments.detection import labelled
from kilnflight.experiments.flights import accuracy, campaigns, comparison, identified
from kilnflight.experiments.flights.track_scores import GATE_PX
from kilnflight.publication import choices, claims, figures, style
from kilnflight.scores import score_tracks
from kilnflight.simulated.kiln import scenes, truth
from kilnflight.simulated.kiln.feeding import LABELLED
from kilnflight.simulated.kiln.laws import LAWS
from kilnflight.simulated.kiln.light import Optics
from kilnflight.simulated.kiln.scene import Twin
from kilnflight.store import paths
from kilnflight.tracklets import tracked

sys.path.append(str(paths.root()))
from identify import light as light_fit

style.use_style()
particles = particles or {"quick": 100, "standard": 1000, "full": 4000}[scale]
inputs = [paths.reference() / "twin_inputs.csv"]
origin = figures.trace(
    "10_twin", {"scale": scale, "particles": particles}, seed=seed, inputs=inputs
)

# %% [markdown]
# ## Inputs
#
# These are the main inputs; small ones stand in the code. "Published" ones stand in the
# thesis, "handbook" ones in another source. "Fitted" ones were set by printed numbers:
# flights and errors of depth by sections 5.2 and 5.3, light by Otsu's row of Table 5.5,
# Fig. 5.5 and Fig. 3.12. One printed number alone "identified" an input. No other
# detector took part in a fit, but what it finds was known from trials (notebook 01). An
# assumption has no source.

# %%
table = pd.read_csv(inputs[0], keep_default_na=False)
statuses = table["status"].value_counts()
caption = (
    f"The {len(table)} inputs of the simulated recordings: value, unit, status and "
    "source."
)
figures.save("twin-inputs", table, caption=caption, provenance=origin)

# %% [markdown]
# ## Flights: printed and put in
#
# The laws of flight give these numbers for all particles, seen or not.

# %%
put_in = comparison.put_in(tuple(LAWS), particles, seed).dropna(subset="printed")
put_in = put_in[
    ["fraction", "pressure_bar", "outcome", "printed", "low", "high", "put_in"]
]
caption = (
    f"Printed numbers on flight and ignition beside what {particles} simulated flights "
    "of each run have. Where both differ, print contradicts itself, or few flights "
    "decide."
)
figures.save("twin-flights", put_in.round(4), caption=caption, provenance=origin)

# %% [markdown]
# ## Light: what it was fitted to
#
# Flames are round, larger and brighter than unlit particles, and most are overexposed.
# Wood chips and granules are darker than the wall, papers may be lighter, and the level
# of each varies by tumbling. Six inputs were fitted (identify/light.py) to Otsu's row
# of Table 5.5, the recalls of Fig. 5.5 and the radii of Fig. 3.12. No other detector
# took part.

# %%
seeds = light_fit.SEEDS if scale == "full" else [seed]
prepared = light_fit.prepare(seeds, labelled.SUBSETS[scale])
shown = LABELLED if scale == "full" else LABELLED[5:6]
reached = light_fit.report(light_fit.count(prepared, Optics(), shown))
caption = (
    "What the light was fitted to, printed and reached with each seed of the scenes: "
    "Otsu's precision and recall on labelled frames, recall by class, radii, and the "
    "share of flames in the air whose core is overexposed. The fit itself used one "
    "frame of each subset."
)
figures.save("twin-light", reached.round(4), caption=caption, provenance=origin)

# %% [markdown]
# ## Choices of the light, with the other value of each
#
# Flames that are thin and long (D6), darker chips and granules (D8), no clutter (D9),
# and unlit levels that stay for a whole flight (T7). The last table of this page has
# both values of each.

# %%
others = {"ours": "base", "D6": "thin-flames", "D8": "dark-bodies"}
others["T7"] = "steady-bodies"
lights = {
    name: scenes.SCENARIOS[scenario](prepared[-1][0].scene).optics
    for name, scenario in others.items()
}
overexposed = {}
flickering = {}
twin, background = prepared[-1]
for name, light in lights.items():
    counts = light_fit.compare(light_fit.count(prepared, light, [80]))
    overexposed[name] = float(counts["ours"].iloc[-1])
    noted = truth.noted(light_fit.with_light(twin, light), range(60, 101, 5))
    unlit = noted[noted["label"] == 3]
    missed = unlit["noted_row"].isna()
    noted_share = unlit["noted_row"].notna().mean()
    share_missed = missed.groupby(unlit["particle"]).mean()
    now_and_then = share_missed.between(0, 1, inclusive="neither").mean()
    flickering[name] = f"{now_and_then:.2f}, {noted_share:.2f}"

# %%
spots = {}
for name, scenario in (("ours", "base"), ("D9", "no-clutter")):
    empty = Twin(scenes.SCENARIOS[scenario](twin.scene))
    frames = np.array([empty.empty(t) for t in range(0, 160, 10)])
    lighter = np.maximum(frames[8] - np.median(frames, axis=0), 0.0)
    spots[name] = len(labelled.sift(500.0)(lighter))
seen = "unlit particles noted now and then; share of sightings noted"
compared = [
    choices.compare(
        "D6",
        "share of flames in the air that are overexposed",
        chosen=overexposed["ours"],
        other=overexposed["D6"],
    ),
    choices.compare("D8", seen, chosen=flickering["ours"], other=flickering["D8"]),
    choices.compare(
        "D9",
        "spots above 500 grey values in a frame without particles",
        chosen=spots["ours"],
        other=spots["D9"],
    ),
    choices.compare("T7", seen, chosen=flickering["ours"], other=flickering["T7"]),
]

# %% [markdown]
# ## Choices of paths and depth, with the other value of each
#
# True paths are fitted as the depth camera sees them; no detector and no tracker takes
# part. The choices are the spread aside (D10), the flutter of shreds (T6), the lance's
# place (F1), one calibration (F3) and errors that come anew in each frame (F4).

# %%
count = {"quick": 5, "standard": 25, "full": 150}[scale]
shred = ("paper shred", 4.5)
chip = ("wood chip", 4.5)
wild = replace(LAWS[shred], flutter_m=0.038)
narrow = replace(LAWS[shred], aside_sd=LAWS[shred].aside_sd / 2.5)
chips = scenes.campaign(*chip, seed)
errors = dict(chips.depth.particle_error_mm)


def fitted(scene, law, exit_mm=None, own_mm=None):
    """Return medians of the fits of one run's paths."""
    if exit_mm is None:
        exit_mm = Twin(scene).attributes.exit_point_mm
    if own_mm is None:
        own_mm = errors[scene.fraction]
    flown = identified.true_paths(law, scene, count, seed)
    flown = identified.seen_by_camera(flown, scene, own_mm, seed)
    return identified.fit_medians(flown, exit_mm, scene.frame_rate_hz)


# %%
rows = {
    name: fitted(scenes.campaign(name, 4.5, seed), LAWS[name, 4.5]) for name in errors
}
spread = pd.DataFrame(rows).T.rename_axis("fraction").reset_index()
known = claims.published("table_5.18").pivot(
    index="fraction", columns=["measure", "axis"], values="value"
)
known.columns = [
    f"{measure.lower().replace('_mm', '')}_{axis}" for measure, axis in known
]
known.index = known.index.str.lower().str.rstrip("s")
spread = spread.set_index(spread["fraction"].str.lower())
known = known[["rmse_x", "rmse_y", "rmse_z", "r2_x"]].add_suffix("_published")
spread = spread.join(known).reset_index(drop=True)
caption = (
    "Fits of true paths at 4.5 bar as the depth camera sees them, beside Table 5.18. "
    "RMSE in z identified the particles' own error of depth; the spread aside follows "
    "the text, not R2 in x."
)
figures.save("twin-paths", spread.round(4), caption=caption, provenance=origin)

# %%
regular = {
    name: identified.regular_share(
        identified.true_paths(law, scenes.campaign(*shred, seed), 10 * count, seed)
    )
    for name, law in (("ours", LAWS[shred]), ("T6", wild))
}
true_exit = fitted(chips, LAWS[chip], exit_mm=chips.geometry.lance_mm)
ours = spread.set_index("fraction").loc

# %% [markdown]
# Whether verdicts on velocities turn is judged by medians of the first metre on these
# paths.

# %%
# RMSE in z of Table 5.18: the particle's own error where nearly all of a pixel's stays
printed_mm = ours[:, "rmse_z_published"]


def variant(choice, key):
    """Return scene, law and own error (mm) with the other value of a choice."""
    scene = scenes.campaign(*key, seed)
    law = LAWS[key]
    if choice == "D10":
        law = replace(law, aside_sd=law.aside_sd / 2.5)
    if choice == "F3":
        scene = scenes.SCENARIOS["own-calibration"](scene)
    if choice == "F4":
        scene = replace(scene, depth=replace(scene.depth, fixed=0.97))
        return scene, law, printed_mm[key[0]]
    return scene, law, None


def judge(first):
    """Return the verdicts on velocities from medians of the first metre by run."""
    by_bar = [
        {name: first[name, bar] for name in errors} for bar in scenes.PRESSURES_BAR
    ]
    faster = all(
        each[heavy] > each[paper]
        for each in by_bar
        for heavy in comparison.HEAVY
        for paper in comparison.PAPERS
    )
    slower = all(each["paper shred"] < each["confetti"] for each in by_bar)
    return [claims.check("vel-1", faster), claims.check("vel-7", slower)]


# %%
metres = {}
for choice in ("ours", "D10", "F3", "F4"):
    for key in LAWS:
        scene, law, own_mm = variant(choice, key)
        metres.setdefault(choice, {})[key] = fitted(scene, law, own_mm=own_mm)[
            "first_m_s"
        ]
turns = {
    name: choices.turned(judge(metres["ours"]), judge(each))
    for name, each in metres.items()
}
table = pd.DataFrame(metres).rename_axis(["fraction", "pressure_bar"]).reset_index()
caption = (
    "Median velocity in the first metre in m/s of true paths as the depth camera sees "
    "them, with the other value of three choices: spread aside (D10), a calibration "
    "error for each campaign (F3), errors that stay (F4)."
)
change = {name: each["wood chip", 5.0] / each[chip] for name, each in metres.items()}
figures.save("twin-first-metres", table.round(3), caption=caption, provenance=origin)

# %%
metre = "median first metre of chips at 4.5 bar (m/s)"
compared += [
    choices.compare(
        "D10",
        "R2 in x of true paths of shreds",
        chosen=ours[shred[0], "r2_x"],
        other=fitted(scenes.campaign(*shred, seed), narrow)["r2_x"],
        turns=turns["D10"],
    ),
    choices.compare(
        "T6",
        "share of shreds' true paths with R above 0.9",
        chosen=regular["ours"],
        other=regular["T6"],
    ),
    choices.compare(
        "F1",
        metre,
        chosen=ours[chip[0], "first_m_s"],
        other=true_exit["first_m_s"],
    ),
    choices.compare(
        "F3",
        "first metre of chips, 5 over 4.5 bar",
        chosen=change["ours"],
        other=change["F3"],
        turns=turns["F3"],
    ),
    choices.compare(
        "F4",
        metre,
        chosen=metres["ours"][chip],
        other=metres["F4"][chip],
        turns=turns["F4"],
    ),
]

# %% [markdown]
# ## Results of the methods with other errors of depth
#
# A second seed, in a full run, shows the size of chance. A smoke run stops at the base.

# %%
reduced = {"quick": "quick", "standard": "quick", "full": "standard"}[scale]


def watched(scenario, chance):
    """Return results of the methods in one scenario; papers fly at 4.5 bar."""
    settings = campaigns.settings_from_labels(reduced, chance, scenario)
    subsets = labelled.labelled_subsets(reduced, chance, scenario=scenario)
    roi = subsets[0].recording.attributes.roi
    detector = Combination(labelled.sift(settings.threshold))
    methods = {"": lambda view: detector(view, roi, 0)[["row", "col"]].to_numpy()}
    found = labelled.sum_counts(labelled.score_methods(subsets, methods), ["method"])
    papers = [(name, 4.5) for name in comparison.PAPERS]
    results = campaigns.results(reduced, chance, jobs, scenario, papers)
    alphas = []
    for campaign in results.campaigns:
        tracks = tracked(results.tables.of(campaign.key).tracks)
        true = campaigns.true_positions(campaign)
        alphas.append(score_tracks(true, tracks, GATE_PX).alpha)
    error = accuracy.errors(accuracy.compare_campaigns(results), chance)
    false = error["unlit_detected"] / max(error["unlit"], 1.0)
    return {
        "f1": found["f1"].iloc[0],
        "alpha": np.mean(alphas),
        "dwell_bias_s": error["dwell_s_bias"],
        "velocity_bias_m_s": error["velocity_m_s_bias"],
        "false_ignitions_percent": 100 * false,
    }


# %%
cases = [("base", seed, "none", "")]
if scale != "quick":
    cases.append(("scattered-depth", seed, "errors of depth", "times 1.5"))
if scale == "full":
    cases.append(("base", seed + 1, "seed", "a second one"))
rows = []
for scenario, chance, what, how in tqdm(cases, "changed inputs", disable=None):
    rows.append({"input": what, "change": how, **watched(scenario, chance)})
changed = pd.DataFrame(rows)
caption = (
    "With other errors of depth and another seed: F1 of SIFT with DBSCAN; for papers "
    "at 4.5 bar alpha of GNN with post-processing against all visible positions, "
    "biases of dwell time and first metre, and false ignitions, of a handful that stay "
    f"unlit. On the frames of scale {reduced}."
)
figures.save("twin-sensitivity", changed, caption=caption, provenance=origin)

# %% [markdown]
# ## Result

# %%
result = (
    f"{statuses['published']} of {statuses.sum()} inputs are published, "
    f"{statuses['fitted']} were fitted to printed numbers, {statuses['identified']} "
    f"are identified by one, {statuses['handbook']} are from other sources, "
    f"{statuses['assumption']} are assumptions."
)
figures.conclude(result, [], origin, choices=compared)
