# %% [markdown]
# # A film of one's own: what a run without settings finds
#
# **The work.** The thesis asks for one tool for recordings of one's own (section 6.2).
#
# **Here.** All steps on a film without depth: background, detection, tracking. The film
# is one of 8 bits that the simulation renders, so its true positions are known. `make
# film RECORDING=path` makes this page of another film; these sentences still speak of
# the simulated one. Numbers here are of `make full`.
#
# **One number.** F1 of the detections, with no setting given: not printed, 0.4208 here.
#
# **What disagrees.** Of burning particles 96 % are found, of unlit ones 15 %. Many
# unlit shreds are darker than the kiln, or long streaks; the search is for bright round
# spots. With depth 71 % of the unlit are found (other recordings, notebook 24). Nearly
# all false detections are faint lights on the wall that come and go but do not move.

# %% tags=["parameters"]
scale = "standard"  # quick (20 frames), standard (60) or full (150)
seed = 0  # of the simulated film
recording = ""  # film, folder, pattern or array of yours; empty: the simulated film
detector = "dog"  # round spots, or "otsu" for areas of any form

# %%
import io
from contextlib import redirect_stdout
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import trackpy
from matplotlib.colors import to_rgb

import kilnflight
from kilnflight.checks import InputError
from kilnflight.film.pictures import pictures
from kilnflight.film.spreading import (
    fit_spreading,
    followed,
    speeds,
    square_displacements,
)
from kilnflight.publication import figures, style
from kilnflight.scores import rates, score_detections, score_tracks
from kilnflight.simulated.kiln import scenes, truth
from kilnflight.store import paths
from kilnflight.store.cache import make_whole

style.use_style()
FIRST = 600  # of 3,000 frames; there the air is full of shreds
frames = range(FIRST, FIRST + {"quick": 20, "standard": 60, "full": 150}[scale])
used = {"scale": scale, "recording": recording, "detector": detector}
mark = "" if recording else "simulated"
origin = figures.trace("60_own_film", used, seed=seed, mark=mark)

# %% [markdown]
# ## The film
#
# The simulated film shows paper shreds, burning and unlit, cut to a part without the
# burner. The upper 8 of 16 bits are kept.

# %%
ROWS = (110, 1070)  # px, first and one past the last row of the part
COLUMNS = (640, 1640)  # px, the same of its columns
NEAR_PX = 20.0  # farthest distance of a hit
BURNING = 2  # classes of particles in the air (Table 5.1 of the thesis)
UNLIT = 3
source = recording
if not recording:
    twin = scenes.open_scene("paper-shred-4.5-bar", seed=seed)
    part = slice(*ROWS), slice(*COLUMNS)
    source = np.stack([(twin.gray(t)[part] >> 8).astype(np.uint8) for t in frames])
film = kilnflight.open(source)

# %% [markdown]
# ## Five thresholds
#
# The threshold is estimated from the noise. A lower one finds more of the background, a
# higher one loses particles.

# %%
picture = kilnflight.preview(film, detector=detector)
titles = pd.Series([axes.get_title() for axes in picture.axes])
shown = titles.str.extract(
    r"frame (?P<frame>\d+), threshold (?P<threshold>\S+): (?P<detections>\d+)"
)
caption = (
    "Detections in three frames of a film, with half, once, twice, four and eight "
    "times the threshold that a run takes. Circles have the estimated radius; "
    "thresholds are in grey values."
)
figures.save(
    "own-film-preview", shown, caption=caption, provenance=origin, picture=picture
)

# %% [markdown]
# ## All steps
#
# The summary says which settings were taken, and why.

# %%
kept = paths.derived() / f"own-film-{film.content()}"  # one folder for each film
with redirect_stdout(io.StringIO()):  # the summary is shown below
    tables = kilnflight.run(film, kept, detector=detector)
detections = tables["detections"]
tracks = tables["tracks"]
index = np.array([film.frame(t).index for t in range(len(film))])  # frames from 0
drawn = dict(pictures(film, tables, index - index[0]))
caption = "Settings and results of a run on a film, with the reason of each setting."
figures.save("own-film-summary", tables["summary"], caption=caption, provenance=origin)

# %%
counts = detections.groupby("frame").size().rename("detections").reset_index()
caption = "Detections in each frame of a film."
figures.save(
    "own-film-detections",
    counts,
    caption=caption,
    provenance=origin,
    picture=drawn["detections"],
)

# %%
linked = followed(tracks)  # a single detection is no track
lines = (
    linked[["particle", "frame", "row", "col"]]
    .sort_values(["particle", "frame"])
    .round(1)
)
caption = (
    "Tracks on the first frame of a film, each in a colour of its own; positions in px."
)
figures.save(
    "own-film-tracks",
    lines,
    caption=caption,
    provenance=origin,
    picture=drawn["tracks"],
)

# %% [markdown]
# ## The tracks as a movie
#
# The movie own-film-tracks.mp4 shows each track with a tail of 20 frames.

# %%
TAIL = 20  # frames
MOST_FRAMES = 150
FRAMES_A_SECOND = 20  # slower than the film, so that one can follow
WIDTH_PX = 500
palette = [tuple(255 * np.array(to_rgb(each))[::-1]) for each in style.COLOURS[1:]]
dark, light = np.percentile(film.gray(0), (0.1, 99.9))


def with_tails(t: int) -> np.ndarray:
    """Return a frame in colours (blue, green, red) with the ends of its tracks."""
    gray = np.interp(film.gray(t), (dark, light), (0, 255)).astype(np.uint8)
    view = cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)
    near = linked[linked["frame"].between(t - TAIL, t)]
    for particle, tail in near.groupby("particle"):
        line = tail[["col", "row"]].to_numpy().round().astype(np.int32)
        colour = palette[particle % len(palette)]
        cv2.polylines(view, [line], False, colour, thickness=3, lineType=cv2.LINE_AA)
    cv2.putText(
        view, mark, (10, len(view) - 15), cv2.FONT_HERSHEY_SIMPLEX, 1, 3 * [255]
    )
    height = round(WIDTH_PX * view.shape[0] / view.shape[1])
    return cv2.resize(view, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)


def write_movie(path: Path) -> None:
    """Write the movie as VP9 in MP4, which browsers show."""
    views = [with_tails(t) for t in range(min(len(film), MOST_FRAMES))]
    size = views[0].shape[1::-1]
    codec = cv2.VideoWriter_fourcc(*"vp09")
    movie = cv2.VideoWriter(str(path), codec, FRAMES_A_SECOND, size)
    if not movie.isOpened():
        raise InputError(f"{path.name}: this OpenCV has no VP9; run make setup.")
    for view in views:
        movie.write(view)
    movie.release()


make_whole(paths.figures() / "own-film-tracks.mp4", write_movie)

# %%
lengths = linked["particle"].value_counts()
steps = speeds(linked)
facts = {"tracks": len(lengths), "median_length_frames": lengths.median()}
if len(steps):
    for q in (25, 50, 75):
        facts[f"speed_q{q}_px_frame"] = np.quantile(steps, q / 100)
caption = "Lengths of the tracks of a film, and speeds of their steps."
figures.save(
    "own-film-lengths",
    pd.DataFrame([facts]),
    caption=caption,
    provenance=origin,
    picture=drawn["lengths-and-speeds"],
)

# %% [markdown]
# ## Mean square displacement
#
# The mean drift is subtracted. Diffusion makes a straight line (exponent 1), flight a
# steeper curve (exponent 2). No line is drawn where the exponent is not near 1. Bars
# are standard errors; lags share displacements.

# %%
spreading = square_displacements(linked)
name = "mean-square-displacement"
shown = "Too few links for a mean square displacement."
if name in drawn:
    caption = (
        "Mean square displacement of the tracks of a film, without the common drift. "
        "A line through the first ten lags shows diffusion. There is none where the "
        "exponent is not near 1, as for flight. Bars are standard errors."
    )
    known = {"caption": caption, "provenance": origin}
    shown = figures.save(
        "own-film-displacement", spreading, **known, picture=drawn[name]
    )
shown

# %% [markdown]
# ## How right D is
#
# Walks of 60 frames with a common drift have a diffusion constant of 0.5 px² a frame.
# In the last rows 30 % of their positions are missing. trackpy takes the mean step of a
# frame for its drift, which also takes 1/n of the walk of n particles off.

# %%
DIFFUSION = 0.5  # px²/frame
DRIFT = (0.3, -1.0)  # px/frame
rng = np.random.default_rng(seed)
trackpy.quiet()


def walk(particles: int, seen: float) -> pd.DataFrame:
    """Return a random walk of each particle, of which a share is seen."""
    steps = rng.normal(DRIFT, np.sqrt(2 * DIFFUSION), (60, particles, 2))
    frame, particle = np.indices(steps.shape[:2]).reshape(2, -1)
    row, col = steps.cumsum(axis=0).reshape(-1, 2).T
    table = {"frame": frame, "particle": particle, "row": row, "col": col}
    return pd.DataFrame(table)[rng.random(len(frame)) < seen]


def by_trackpy(tracks: pd.DataFrame) -> float:
    """Return a quarter of the slope of trackpy's ensemble over ten lags."""
    still = trackpy.subtract_drift(tracks.rename(columns={"row": "y", "col": "x"}))
    squares = trackpy.emsd(still, mpp=1, fps=1, max_lagtime=10)
    return float(np.polyfit(squares.index, squares, 1)[0] / 4)


# %%
rows = []
for seen in (1.0, 0.7):
    for particles in (5, 10, 60):
        draws = [walk(particles, seen) for _ in range(300 // particles)]
        apart = [
            each + {"frame": 120 * k, "particle": particles * k, "row": 0, "col": 0}
            for k, each in enumerate(draws)
        ]
        fit = fit_spreading(square_displacements(pd.concat(apart)))
        row = {"particles": particles, "seen": seen, "draws": len(draws)}
        row |= {"d": fit.diffusion, "d_error": fit.diffusion_error}
        rows.append(row | {"d_trackpy": np.mean([by_trackpy(each) for each in draws])})
caption = (
    "Diffusion constant (px²/frame, true 0.5) of walks with a drift, ours with its "
    "standard error and trackpy's, over draws. seen: share of positions."
)
figures.save(
    "own-film-diffusion", pd.DataFrame(rows), caption=caption, provenance=origin
)

# %% [markdown]
# ## How right the detections are
#
# Of the simulated film the positions that a person would mark are known. A detection
# within 20 px of one in the air is right.


# %%
def score(marked: pd.DataFrame) -> pd.DataFrame:
    """Return one row of scores; note which positions are found, which detections right.

    Both are noted as a column: of ``marked``, and of ``detections``.
    """
    for t, true in marked.groupby("frame"):
        here = detections.loc[detections["frame"] == t, ["row", "col"]]
        places = true[["row", "col"]].to_numpy()
        pairs = score_detections(places, here.to_numpy(), NEAR_PX).pairs
        marked.loc[true.index[pairs[:, 0]], "found"] = 1.0
        detections.loc[here.index[pairs[:, 1]], "right"] = True
    hits = int(detections["right"].sum())
    row = rates(hits, len(detections) - hits, len(marked) - hits)
    recall = marked.groupby("label")["found"].mean()
    row = row.assign(recall_burning=recall.get(BURNING), recall_unlit=recall.get(UNLIT))
    of_tracks = score_tracks(marked, linked, NEAR_PX)
    return row.assign(
        alpha=of_tracks.alpha, jsc=of_tracks.jsc, jsc_theta=of_tracks.jsc_theta
    )


# %%
result = f"{len(lengths)} tracks hold {len(linked)} of {len(detections)} detections."
shown = None
if not recording:
    marked = truth.marked(twin, frames).assign(found=0.0)
    first = {"frame": frames[0], "row": ROWS[0], "col": COLUMNS[0]}
    marked[list(first)] -= pd.Series(first)
    within = marked["row"].between(0, ROWS[1] - ROWS[0]) & marked["col"].between(
        0, COLUMNS[1] - COLUMNS[0]
    )
    flying = within & marked["label"].isin([BURNING, UNLIT])
    detections["right"] = False
    scores = score(marked[flying].reset_index(drop=True))
    found = scores.iloc[0]
    result = (
        f"With no setting given, {100 * found['recall_burning']:.0f}% of the burning "
        f"particles are detected and {100 * found['recall_unlit']:.0f}% of the unlit "
        f"ones; {100 - 100 * found['precision']:.0f}% of the detections are false. F1 "
        f"is {found['f1']:.2f}. {result}"
    )
    caption = (
        "Scores of a run without settings on the simulated film: detections within 20 "
        "px of a marked position, recall by class, tracks against the marked ones "
        "(gate 20 px)."
    )
    shown = figures.save("own-film-scores", scores, caption=caption, provenance=origin)
shown

# %% [markdown]
# ## Which detections are false
#
# Detections in tracks, by whether the track stays within 3 px. Nearly all that are
# false rest: they are faint lights on the wall, which belong to no particle (choice D9
# in notebook 01), and a few particles that burn there.

# %%
shown = None
if not recording:
    right = detections.set_index(["frame", "row", "col"])["right"]
    judged = linked.join(right, on=["frame", "row", "col"])
    extent = judged.groupby("particle")[["row", "col"]].transform(np.ptp).max(axis=1)
    kinds = pd.crosstab(
        (extent < 3).map({True: "rests", False: "moves"}),
        judged["right"].map({True: "right", False: "false"}),
        rownames=["track"],
        colnames=["detections"],
    ).reset_index()
    caption = "Detections in tracks that move or rest (within 3 px), right or false."
    shown = figures.save("own-film-resting", kinds, caption=caption, provenance=origin)
shown

# %%
figures.conclude(result, [], origin)
