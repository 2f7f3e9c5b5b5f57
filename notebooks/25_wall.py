# %% [markdown]
# # The wall: particles in the air differ by their distance from the kiln's axis
#
# **The work.** In the thesis (sections 3.2 and 5.1.4) MLESAC fits a cylinder to the
# wall's points (Table 5.12). Distances of particles from its axis form two Gaussians
# that cross (Fig. 3.11). A threshold of 800 mm classifies particles with F1
# 0.92, detections with 0.88 (Tables 5.13 and 5.14).
#
# **Here.** The same on five simulated recordings, whose axis and radius are known. The
# threshold is the crossing of the Gaussians here plus 40 mm; the printed 800 mm belong
# to another radius.
#
# **One number.** Radius of the fitted cylinder: 772 mm printed, 693 mm here.
#
# **What disagrees.** F1 of marked particles is 0.96 for 0.92 in print. The kiln's true
# radius is 700 mm, which the printed fit misses by far.

# %% tags=["parameters"]
scale = "standard"  # quick, standard or full
seed = 0  # of the scenes and of the fit
frames = 0  # labelled frames per subset; 0: 1, 1 or 10 by scale

# %%
from itertools import product

import numpy as np
import pandas as pd
from scipy.stats import norm

from kilnflight.checks import InputError
from kilnflight.detection import wall as cylinder
from kilnflight.detection.combination import Combination
from kilnflight.experiments import plots
from kilnflight.experiments.detection import labelled, summaries
from kilnflight.experiments.flights import identified
from kilnflight.publication import choices, claims, figures, style
from kilnflight.scores import rates, score_detections
from kilnflight.simulated.kiln.feeding import LABELLED

# %%
style.use_style()
frames = frames or labelled.FRAMES[scale]
origin = figures.trace("25_wall", {"scale": scale, "frames": frames}, seed=seed)
subsets = labelled.labelled_subsets(scale, seed, frames)

# %% [markdown]
# ## The cylinder
#
# The wall is the largest cluster of DBSCAN's first pass, with the burner's flame. Few
# points lie midway along the kiln, so its floor near the camera and its far wall are
# two clusters. The cylinder of the first subset serves all. The true radius is 700 mm.

# %%
walls = {each.name: labelled.wall_points(each) for each in subsets}
geometry = subsets[0].recording.scene.geometry
fits = {}
for name, wall in walls.items():
    try:
        fits[name] = cylinder.fit_cylinder(wall, seed)
    except InputError:  # most points of this subset lie on no cylinder
        continue
fit = fits[subsets[0].name]
table_5_12 = claims.published("table_5.12").set_index("quantity")
printed = float(table_5_12["value_mm"]["Radius"])
rows = []
for name, each in fits.items():
    cosine = abs(np.dot(each.direction, geometry.axes[0]))
    row = {
        "subset": name,
        "radius_mm": each.radius_mm,
        "radius_true_mm": geometry.kiln_radius_mm,
        "radius_published_mm": printed,
        "direction_off_deg": np.degrees(np.arccos(min(cosine, 1.0))),
        "inliers": each.inliers,
        "rms_mm": each.rms_mm,
    }
    rows.append(row)
cylinders = pd.DataFrame(rows)
caption = (
    "Cylinder fitted to the wall's points of one frame per subset, after Table 5.12."
)
figures.save("table-5-12-cylinder", cylinders, caption=caption, provenance=origin)

# %% tags=["hide-input"]
points = walls[subsets[0].name]
points = points[:: max(1, len(points) // 8000)]
picture, ((left, right),) = style.canvas(1, 2, width_mm=style.PAGE_MM, height_mm=75)
depth, across, up = plots.upright(points)
left.plot(across, up, ",", color="black")
right.plot(depth, cylinder.distance_to_axis(points, fit), ",", color="black")
around = np.linspace(0, 2 * np.pi, 200)
reach = (points[:, 2].mean() - fit.centre_mm[2]) / fit.direction[2]
middle = np.array(fit.centre_mm) + reach * np.array(fit.direction)
ring = np.array([np.cos(around), np.sin(around), np.zeros(len(around))]).T
_, across, up = plots.upright(middle + fit.radius_mm * ring)
left.plot(across, up, "-", color=style.COLOURS[2], label=f"fit, {fit.radius_mm:.0f} mm")
left.set(xlabel="x (m)", ylabel="up, y (m)", aspect="equal")
left.legend(loc="center")  # within the circle
levels = (
    ("fit", fit.radius_mm, "-", style.COLOURS[2]),
    ("true", geometry.kiln_radius_mm, ":", "black"),
)
for text, level, line, colour in levels:
    right.axhline(level, color=colour, ls=line, label=f"{text}, {level:.0f} mm")
known = {**style.PUBLISHED, "label": f"published, {printed:.0f} mm"}
right.plot(depth.min(), printed, **known)
right.set(xlabel="depth z (m)", ylabel="distance from the axis (mm)", ylim=(450, 850))
_ = right.legend(loc="lower left")

# %%
caption = (
    "The wall of a simulated frame (dots) and the fitted cylinder, after Fig. 3.10. "
    "Left: seen along the axis. Right: distance of the points from the fitted axis by "
    "depth; lines: fitted and true radius, diamond: the printed one."
)
table = pd.DataFrame(points, columns=["x_mm", "y_mm", "z_mm"])
figures.save(
    "fig-3-10-cylinder", table, picture=picture, caption=caption, provenance=origin
)

# %% [markdown]
# ## Distances of particles from the axis (Fig. 3.11)
#
# All marked particles with 3D, placed at the mean of their points.

# %%
chosen = labelled.score_at_chosen(subsets, scale).groupby("subset")["threshold"]
detectors = {
    name: Combination(labelled.sift(float(threshold)))
    for name, threshold in chosen.first().items()
}
marked = labelled.place_marked(subsets, fit)
parts = []
for subset in subsets:
    roi = subset.recording.attributes.roi
    for view in subset.views():
        found = detectors[subset.name](view, roi, view.number)
        parts.append(found.assign(subset=subset.name))
detected = labelled.with_distance(pd.concat(parts, ignore_index=True), fit)
placed = marked.dropna(subset="distance_mm")
on_wall = placed["label"] == 4
distance = placed["distance_mm"]
crossing = cylinder.crossing(distance[~on_wall], distance[on_wall])
thresholds = {
    "crossing_plus_40": crossing + 40.0,
    "crossing": crossing,
    "printed_800": 800.0,
}

# %% tags=["hide-input"]
picture, ((axes,),) = style.canvas(width_mm=120, height_mm=65)
bins = np.arange(0, 1001, 25)
shown = np.linspace(0, 1000, 400)
kinds = (
    ("in the air", distance[~on_wall], style.COLOURS[2], "-"),
    ("on the wall", distance[on_wall], style.COLOURS[4], "--"),
)
for name, values, colour, line in kinds:
    gaussian = norm.pdf(shown, values.mean(), values.std())
    axes.hist(values, bins, color=colour, alpha=0.35, density=True, label=name)
    axes.plot(shown, gaussian, ls=line, color=colour)
for text, level, line in (
    ("crossing", crossing, ":"),
    ("+ 40 mm", crossing + 40, "-."),
):
    axes.axvline(level, color="black", lw=0.8, ls=line, label=f"{text}: {level:.0f} mm")
known = {**style.PUBLISHED, "label": "published: 760 and 800 mm"}
axes.plot([760, 800], [0.03, 0.03], transform=axes.get_xaxis_transform(), **known)
axes.set(xlabel="distance from the fitted axis (mm)", ylabel="density (1/mm)")
axes.set_xlim(0, 1000)
axes.legend(loc="upper left")
caption = (
    f"Distance of {len(placed)} simulated particles with 3D from the fitted axis, "
    "after Fig. 3.11. Curves: Gaussians of the same mean and standard deviation; black "
    "lines: their crossing, and 40 mm more. Diamonds: printed crossing (760 mm) and "
    "threshold (800 mm)."
)
table = placed[["subset", "frame", "label", "distance_mm"]]
figures.save(
    "fig-3-11-distances", table, picture=picture, caption=caption, provenance=origin
)

# %% [markdown]
# ## Classification
#
# A true positive is a particle in the air that is classified as such (section 5.1.4).
# Only particles and detections with 3D count; detections are those of SIFT with DBSCAN.
# Four thresholds stand beside print. The last one calls all of them airborne: nearly
# all particles fly, so F1 is high without any rule.

# %%
thresholds["all_in_air"] = 10_000.0  # mm from the axis: no particle is as far
roi = subsets[0].recording.attributes.roi


def count_in_air(score, truth_in_air, detected_in_air):
    """Return TP, FP and FN of one frame's classification as in the air.

    As in Tables 5.13 and 5.14, TP is a particle in the air whose detection is
    classified as such. FP is any other detection classified as in the air, on the wall
    or spurious. FN is any other particle in the air, classified as on the wall or not
    detected. Table 5.13 takes the score of the truth against itself.

    Parameters
    ----------
    score
        Assignment of detections to particles.
    truth_in_air, detected_in_air
        Whether each particle (n,) and each detection (m,) is in the air *and* has 3D,
        in the rows of the arrays that were scored. Those without 3D are False and so
        "not taken into consideration" (section 5.1.4).

    Returns
    -------
    dict
        Counts by "tp", "fp", "fn"; the input of `rates`.
    """
    flies = np.asarray(truth_in_air, dtype=bool)
    classified = np.asarray(detected_in_air, dtype=bool)
    particle, detection = score.pairs.T
    tp = np.count_nonzero(flies[particle] & classified[detection])
    positives = np.append(detection, score.spurious)
    particles = np.append(particle, score.missed)
    fp = np.count_nonzero(classified[positives]) - tp
    fn = np.count_nonzero(flies[particles]) - tp
    return {"tp": tp, "fp": fp, "fn": fn}


# %%
def count_frame(spots, particles, subset, frame, limit):
    """Return the counts of a frame with a limit of the distance from the axis in mm."""
    found = spots[(spots["subset"] == subset) & (spots["frame"] == frame)]
    score = score_detections(particles[["row", "col"]], found[["row", "col"]], roi=roi)
    flying = (particles["label"] != 4) & particles["distance_mm"].notna()
    return count_in_air(score, flying, found["distance_mm"] <= limit)


def classify(spots):
    """Return the rates of telling air from wall, by threshold and subset."""
    rows = []
    frames = list(marked.groupby(["subset", "frame"], sort=False))
    for (name, limit), (place, particles) in product(thresholds.items(), frames):
        row = {"threshold": name, "threshold_mm": limit, "subset": place[0]}
        rows.append(row | count_frame(spots, particles, *place, limit))
    table = pd.DataFrame(rows)
    both = pd.concat([table, table.assign(subset="Total")])
    keys = ["threshold", "threshold_mm", "subset"]
    counts = both.groupby(keys, sort=False)[list(labelled.COUNTS)].sum().reset_index()
    return counts.join(rates(counts["tp"], counts["fp"], counts["fn"]))


exact = classify(marked)  # as in Table 5.13
measured = classify(detected)  # as in Table 5.14

# %%
table = summaries.beside_published(exact, "table_5.13")
caption = (
    "Marked particles with 3D classified as in the air, after Table 5.13, with three "
    "thresholds of the distance from the fitted axis, and with all called airborne "
    "(all in air)."
)
figures.save("table-5-13-classification", table, caption=caption, provenance=origin)

# %%
table = summaries.beside_published(measured, "table_5.14")
caption = (
    "Detections of SIFT with DBSCAN classified as in the air, after Table 5.14, "
    "scoring distance 45 px; thresholds as in Table 5.13."
)
figures.save("table-5-14-classification", table, caption=caption, provenance=origin)

# %% [markdown]
# ## The error of depth on the wall (D11)
#
# Along the wall an error of depth hardly changes the distance from the axis. The own
# error of a particle on the wall is the one with which 31 % of them count as in the air
# (Table 5.13). True places are moved by it here; the other value is the error of a
# particle in flight. With it both Gaussians are narrow and cross closer to the wall, so
# that 40 mm more reach beyond it. The last table of this page has the share for both.


# %%
def seen_distances(twin, t, own_mm, seed):
    """Return the particles of a frame as the depth camera sees them.

    ``distance`` is that from the axis in mm, ``wall`` tells which lie on the wall;
    these have the own error ``own_mm``.
    """
    scene = twin.scene
    moment = twin.life.at(twin.time_s(t))
    moment = moment.take(~moment.landed | moment.burning)
    flying_mm = twin.life.table["fraction"].map(dict(scene.depth.particle_error_mm))
    flying_mm = flying_mm.to_numpy()[moment.particle]
    every_mm = np.where(moment.landed, own_mm, flying_mm)
    table = identified.in_view(
        scene, moment.position_m, wall=moment.landed, own_mm=every_mm
    )
    seen = identified.seen_by_camera(table, scene, table["own_mm"], seed)
    kiln = scene.geometry.to_kiln(seen[["x", "y", "z"]].to_numpy())
    return seen.assign(distance=1000 * np.hypot(kiln[:, 1], kiln[:, 2]))


def wall_distances(twins, own_mm, seed):
    """Return the distances in mm in labelled frames: in the air, and on the wall."""
    parts = [
        seen_distances(twin, t, own_mm, seed + t)
        for twin, t in product(twins, LABELLED)
    ]
    every = pd.concat(parts)
    distance = every["distance"]
    return distance[~every["wall"]], distance[every["wall"]]


def wall_share(in_air_mm, wall_mm):
    """Return the share of wall particles that count as in the air."""
    limit = cylinder.crossing(in_air_mm, wall_mm) + identified.BEYOND_CROSSING_MM
    return (wall_mm < limit).mean()


# %%
twins = [each.recording for each in subsets]
on_wall_mm = twins[0].scene.depth.wall_particle_mm
shares = {
    own: wall_share(*wall_distances(twins, own, seed)) for own in (on_wall_mm, 130.0)
}
compared = [
    choices.compare(
        "D11",
        "share of particles on the wall that count as in the air",
        chosen=shares[on_wall_mm],
        other=shares[130.0],
    )
]

# %% [markdown]
# ## Result
#
# The radius was put in. The printed crossing, and the share of particles beyond 800 mm,
# decided inputs of the simulation. Agreement with them proves nothing, so nothing is
# judged here.

# %%
total = exact.set_index(["threshold", "subset"])["f1"].unstack()["Total"]
result = (
    f"The fitted radius is {fit.radius_mm:.0f} mm (true 700 mm). Classification in the "
    f"air has F1 {total['crossing']:.2f} at the crossing, "
    f"{total['crossing_plus_40']:.2f} with 40 mm more; calling all airborne has "
    f"{total['all_in_air']:.2f}."
)
figures.conclude(result, [], origin, choices=compared)
