# %% [markdown]
# # Trajectories of all campaigns in the image
#
# **Published** (thesis, Fig. 5.17 and appendix A.1, Figs A.1 to A.4). Sums of frame differences
# over whole sequences, the "optical ground truth", beside the trajectories that GNN and the
# post-processing found in them. Wood chips and granules fly in smooth arcs, papers in tangles.
#
# **Here.** The same of the twin's eight campaigns. The sums are over frames in the middle (the
# caption says how many), for a look only. Nothing is measured in them. The tracks are made
# without the texture term of Eq. 4.24: its frame differences of eight campaigns would take 68 GB.

# %% tags=["parameters"]
scale = "standard"  # quick (two campaigns, few frames), standard (four, 200 frames each) or full
seed = 0  # of the scenes
jobs = 2  # processes
pictures = 0  # frames in each sum; 0: 5, 30 or 300 by scale

# %%
from kilnflight.experiments import campaigns, confidence, plots
from kilnflight.project import figures, style

# %%
style.use_style()
pictures = pictures or {"quick": 5, "standard": 30, "full": 300}[scale]
origin = figures.trace("51_trajectories", {"scale": scale, "pictures": pictures}, seed=seed)
results = campaigns.results(scale, seed, jobs)

# %% [markdown]
# ## How many
#
# Ours: the thesis does not say how many tracks its pictures show.

# %%
count = campaigns.count_tracks(results)
caption = (
    "Length of the campaigns, detections in the air or without depth, and those in tracks. Then "
    "tracks after post-processing, those that start at the lance, and how many of these are "
    "refused: no particle flies like their trajectories in space (notebook 50 says why)."
)
figures.save("campaign-tracks", count, caption=caption, provenance=origin)

# %% [markdown]
# ## Optical ground truth and tracks

# %%
tracks = campaigns.from_lance(results.tables, "tracks")
sums, by_campaign = {}, {}
for campaign in results.campaigns:
    first = campaign.frames.start + (len(campaign.frames) - pictures) // 2
    frames = range(first, first + pictures)
    sums[campaign.key] = plots.summed_changes(campaigns.twin_of(campaign), frames)
    by_campaign[campaign.key] = campaigns.of_campaign(tracks, campaign.key)

# %%
names = list(dict.fromkeys(name for name, _ in sums))
captions = {
    name: f"{name.capitalize()}s at each pressure: sum of the differences of {pictures} "
    f"neighbouring frames, and trajectories from the lance but the refused; after Fig. A.{k + 1}."
    for k, name in enumerate(names)
}
drawn = {name: plots.draw_sums_and_tracks(name, sums, by_campaign) for name in names}
columns = ["fraction", "pressure_bar", "particle", "frame", "row", "col"]
data = tracks[columns].groupby("fraction")

# %%
saved = []
for k, name in enumerate(names):
    texts = {"caption": captions[name], "provenance": origin}
    table = data.get_group(name) if name in data.groups else data.obj.head(0)
    saved.append(figures.save(f"fig-a-{k + 1}-tracks", table, picture=drawn[name], **texts))
saved[0]

# %%
saved[1]

# %%
saved[min(2, len(saved) - 1)]

# %%
saved[-1]

# %% [markdown]
# ## Result

# %%
rows = [(row.fraction, row.pressure_bar, row.from_lance) for row in count.itertuples()]
result = (
    f"Trajectories from the lance. {confidence.by_fraction(rows)} Of these "
    f"{count['refused'].sum()} are refused and not drawn."
)
figures.conclude(result, [], origin)
