"""Detection of particles on labelled frames, scored as in section 3.3 of the thesis.

labelled frames -> views x methods (section 5.1.3) -> one row per frame and method ->
sums, rates
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from tqdm import tqdm

from kilnflight import chain
from kilnflight.arrays import Array, Index
from kilnflight.background import BackgroundModel, Median
from kilnflight.checks import InputError
from kilnflight.detection import (
    DBSCAN,
    Clusterer,
    Detector2D,
    DoG,
    MorphologicalClustering,
    Otsu,
    QuasiClusterCenters,
)
from kilnflight.detection.combination import (
    LARGEST_PX,
    Combination,
    View,
    centers,
    no_larger,
    second_pass,
    sort_clusters,
)
from kilnflight.detection.quasi_centers import nearest_neighbors
from kilnflight.detection.sift import Polygon
from kilnflight.detection.wall import Cylinder, distance_to_axis
from kilnflight.recording.frames import Recording, calibrated_cloud
from kilnflight.scores import rates, score_detections, score_in_pixels
from kilnflight.scores.detections import NEAR_GATE_PX, particle_centroids
from kilnflight.simulated.kiln import scenes, truth
from kilnflight.simulated.kiln.feeding import LABELLED

COUNTS = ("tp", "fp", "fn")
WARM_UP_POINTS = 2000  # points of the untimed first call
# Labelled frames per subset by scale; 10 of all five subsets are the thesis's set of
# 50.
FRAMES = {"quick": 1, "standard": 1, "full": 10}
# Subsets by scale; the text of section 5.1.3 speaks most of V1 and V4.
SUBSETS: dict[str, tuple[str, ...]] = {
    "quick": ("V4", "V5"),
    "standard": ("V1", "V4", "V5"),
    "full": tuple(scenes.SUBSETS),
}
# The temporal median over 150 frames (section 5.1.2); fewer in a reduced run, to render
# few.
WINDOWS = {"quick": 12, "standard": 30, "full": Median().window}
BACKGROUNDS = {scale: Median(window=window) for scale, window in WINDOWS.items()}
# Thresholds of DoG that are tried, in grey values: two per octave, from a tenth of the
# thesis's to six times it. The exposure of the thesis is not known.
THRESHOLDS = tuple(round(50 * 2 ** (k / 2)) for k in range(13))
MOST_NEIGHBORS = (
    35  # K of QCC's first pass; no method of Table 5.11 has more on a whole cloud
)
Passes = tuple[Clusterer, ...]
# First and second pass of the combination (section 5.1.3), as printed; for DBSCAN, 15
# points in 70 mm would be more precise than the printed first pass (Table 5.8).
PASSES: dict[str, Passes] = {
    "DBSCAN": (DBSCAN(eps=50.0, min_points=10), DBSCAN(eps=15.0, min_points=10)),
    "MO": (MorphologicalClustering(100), MorphologicalClustering(400)),
    "QCC": (QuasiClusterCenters(MOST_NEIGHBORS, 0.1), QuasiClusterCenters(20, 0.2)),
}
# r of Eq. 2.28 is "user-defined" (section 2.2.3): SIFT's total row of Table 5.6
# identifies it (sift_row.csv)
EDGE = 40.0
Method = Callable[[View], Array]  # -> (n, 2 or more): row, col in px first


def sift(threshold: float = DoG.threshold) -> DoG:
    """Return DoG with a threshold in grey values and the identified r, `EDGE`."""
    return DoG(threshold, edge=EDGE)


OURS = Combination(sift())


class Subset(NamedTuple):
    """A recording, and the marked particles in its labelled frames (section 5.1.1).

    Marked are the particles that a person would see; the simulation knows them.
    """

    name: str
    recording: Recording
    frames: tuple[int, ...]
    particles: (
        pd.DataFrame
    )  # frame, particle, row, col, label; inside the region of interest
    instances: Callable[
        [int], npt.NDArray[np.integer]
    ]  # frame -> (rows, cols) particle; -1: none
    background: BackgroundModel
    cache: dict[
        int, View
    ]  # by frame, with this background; 30 MB each, from up to 150 frames


def labelled_subsets(
    scale: str, seed: int = 0, frames: int = 0, scenario: str = "base"
) -> list[Subset]:
    """Return the simulated subsets of a scale with their middle labelled frames.

    Parameters
    ----------
    scale
        "quick" (two subsets), "standard" (three) or "full" (five).
    seed
        Seed of the scenes.
    frames
        Number of labelled frames of each subset; 0: as many as in `FRAMES`.
    scenario
        One of `kilnflight.simulated.kiln.scenes.SCENARIOS`, or several joined by +.
    """
    if not 0 <= frames <= (most := len(LABELLED)):
        raise InputError(f"labelled_subsets: frames={frames}, but {most} are labelled.")
    count = frames or FRAMES[scale]
    subsets = []
    labelled = tuple(LABELLED[(most - count + 1) // 2 :][:count])
    for name in SUBSETS[scale]:
        twin = scenes.cached_scene(scenes.scene_name(name, scenario), seed)
        marked = truth.marked(twin, labelled)
        instances = partial(truth.instances, twin)
        known = twin.scene.name, twin, labelled, marked, instances
        subsets.append(Subset(*known, BACKGROUNDS[scale], {}))
    return subsets


def subset_views(
    subset: Subset, background: BackgroundModel | None = None
) -> Iterator[tuple[int, View]]:
    """Return number and view of each labelled frame of a subset.

    Views with the subset's own background are cached in it, those with another are not.
    """
    if background not in (None, subset.background):
        return chain.views(subset.recording, subset.frames, background)
    if any(t not in subset.cache for t in subset.frames):
        subset.cache.update(
            chain.views(subset.recording, subset.frames, subset.background)
        )
    return ((t, subset.cache[t]) for t in subset.frames)


def run(
    subsets: Iterable[Subset],
    methods: Mapping[Any, Method],
    background: BackgroundModel | None = None,
) -> pd.DataFrame:
    """Return the counts of each detection method in each labelled frame.

    Parameters
    ----------
    subsets
        Recordings with marked particles.
    methods
        By name; each returns the positions of detections in a view.
    background
        Background model of the views; None: that of each subset.

    Returns
    -------
    DataFrame
        One row per frame and method: ``subset``, ``frame``, ``method``; ``tp``, ``fp``,
        ``fn`` with a scoring distance of 45 px (section 3.3); ``tp_near`` ... within
        22.5 px, which reads the 45 px as a diameter; ``tp_pixels`` ... within the
        pixels of a particle (5.1.1); ``tp_2``, ``fn_2`` ... with 45 px by class of
        Table 5.1 (2, 3, 4); ``seconds`` of one call, without compilation.
    """
    rows: list[dict[str, Any]] = []
    for subset in subsets:
        views = subset_views(subset, background)
        bar = tqdm(
            views,
            desc=subset.name,
            total=len(subset.frames),
            unit="frame",
            disable=None,
        )
        for t, view in bar:
            if not rows:
                pixels = view.pixels[:WARM_UP_POINTS]
                xyz = view.xyz[:WARM_UP_POINTS]
                few = view._replace(
                    pixels=pixels, xyz=xyz
                )  # one for all, as they share steps
                for method in methods.values():
                    method(few)
            rows += _frame_rows(subset, t, view, methods)
    return pd.DataFrame(rows)


def _frame_rows(
    subset: Subset, t: int, view: View, methods: Mapping[Any, Method]
) -> list[dict[str, Any]]:
    """Return a row of `run` for each method in frame ``t``.

    Only the method itself is timed. The truth is the marked particles of the frame.
    """
    particles = subset.particles[subset.particles["frame"] == t]
    place = particles[["row", "col"]].to_numpy()
    label = particles["label"].to_numpy()
    image = subset.instances(t)
    roi = subset.recording.attributes.roi  # most pixels: no particle
    visible = particles["particle"][
        particles["particle"].isin(np.unique(image[image >= 0]))
    ]
    centroids = particle_centroids(image, visible.to_numpy())
    rows = []
    for name, method in methods.items():
        begin = time.perf_counter()
        spots = method(view)[:, :2]
        seconds = time.perf_counter() - begin
        row = {"subset": subset.name, "frame": t, "method": name, "seconds": seconds}
        scored = score_detections(place, spots, roi=roi)
        scores = {
            "": scored,
            "_near": score_detections(place, spots, NEAR_GATE_PX, roi),
            "_pixels": score_in_pixels(image, centroids, spots, roi),
        }
        for suffix, score in scores.items():
            row |= {count + suffix: getattr(score, count) for count in COUNTS}
        for kind in truth.CLASSES:
            row[f"tp_{kind}"] = int((label[scored.pairs[:, 0]] == kind).sum())
            row[f"fn_{kind}"] = int((label[scored.missed] == kind).sum())
        rows.append(row)
    return rows


def from_foreground(detector: Detector2D, largest_px: float = LARGEST_PX) -> Method:
    """Return a 2D detector of a view's foreground as a method.

    Keypoints above ``largest_px`` in diameter are left out.
    """
    return lambda view: no_larger(detector(view.foreground), largest_px)


def from_thresholds(
    thresholds: Sequence[float], rule: Combination = OURS
) -> dict[float, Method]:
    """Return DoG as a method by threshold in grey values, with one call for all.

    DoG runs with the smallest threshold and grades its keypoints. For a larger
    threshold, those of a lower grade are dropped. The methods share that call, so their
    times mean nothing. Edge and largest keypoint are those of ``rule``.
    """
    sift: Any = rule.detector
    lowest = replace(sift, threshold=float(min(thresholds)))
    graded = remembered(
        lambda view: no_larger(lowest.graded(view.foreground), rule.largest_px)
    )

    def above(threshold: float, view: View) -> Array:
        particles = graded(view)
        return particles[particles[:, 3] >= threshold, :3]

    return {threshold: partial(above, float(threshold)) for threshold in thresholds}


def table_5_11_methods(
    rule: Combination, roi: Polygon | None, known: dict[Any, Any]
) -> dict[str, Method]:
    """Return the eleven detection methods of Table 5.11 by their printed names.

    Methods share keypoints and clusters, so their times mean nothing.

    Parameters
    ----------
    rule
        Combination of SIFT; the others have the same rules.
    roi
        Region of interest of the combinations: corners (row, col); None: the whole
        frame.
    known
        Clusters that are found are kept here, for other rules on the same recording.
    """
    search = remembered(lambda xyz: nearest_neighbors(xyz, MOST_NEIGHBORS))

    def first_pass(clusterer: Clusterer, xyz: Array) -> Index:
        if isinstance(clusterer, QuasiClusterCenters):
            return clusterer.spread(xyz, search(xyz))
        return clusterer(xyz)

    def labels(passes: Passes, view: View) -> Index:
        key = passes, view.number, len(view.xyz)
        if key not in known:
            first, *second = passes
            wall = partial(first_pass, first)
            known[key] = (
                second_pass(view.xyz, wall, *second) if second else wall(view.xyz)
            )
        return known[key]

    def alone(clusterer: Clusterer, view: View) -> Array:
        return centers(sort_clusters(view.pixels, view.xyz, labels((clusterer,), view)))

    def combined(keypoints: Method, passes: Passes, view: View) -> Array:
        found = rule.decide(view, keypoints(view), labels(passes, view), roi)
        return found[["row", "col"]].to_numpy()

    detectors: dict[str, Detector2D] = {"OTSU": Otsu(), "SIFT": rule.detector}
    keypoints = {
        name: remembered(from_foreground(each, rule.largest_px))
        for name, each in detectors.items()
    }
    methods: dict[str, Method] = {
        f"2D-{name}": each for name, each in keypoints.items()
    }
    methods["3D-DBSCAN Clustering"] = partial(alone, DBSCAN(eps=50.0, min_points=10))
    methods["3D-MO-based Clustering"] = partial(alone, MorphologicalClustering(150))
    methods["3D-QCC Clustering"] = partial(alone, QuasiClusterCenters(30, 0.1))
    for cloud, both in PASSES.items():
        for name, each in keypoints.items():
            methods[f"Combi {name}+{cloud}"] = partial(combined, each, both)
    return methods


def remembered(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a function that keeps the result for its last argument.

    The argument is compared by identity. Methods that are called in turn on one view or
    cloud share its result, such as clusters or neighbours.
    """
    last: list[Any] = [None, None]

    def value(of: Any) -> Any:
        if last[0] is not of:
            last[:] = of, function(of)
        return last[1]

    return value


def wall_points(recording: Recording, frame: int) -> Array:
    """Return the points (n, 3) on the wall in mm, to fit the cylinder (Table 5.12).

    These are the largest cluster of DBSCAN's first pass in one frame, after depth
    calibration.
    """
    points = calibrated_cloud(recording, frame)
    labels = PASSES["DBSCAN"][0](points)
    return points[labels == np.bincount(labels[labels >= 0]).argmax()]


def compare_thresholds(
    subsets: list[Subset], scale: str, rule: Combination = OURS
) -> pd.DataFrame:
    """Return the counts of DoG by threshold, on two or more subsets.

    The thresholds are the `tried_thresholds` of the scale (Tables 5.6 and 5.7).
    ``rule`` is as in `from_thresholds`; the table is that of `mark_chosen`.
    """
    methods = from_thresholds(tried_thresholds(scale), rule)
    return mark_chosen(run(subsets, methods))


def mark_chosen(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table of `run` of ascending thresholds with the chosen ones.

    Returns
    -------
    DataFrame
        ``threshold`` (grey values) is in place of ``method``. ``chosen`` marks a
        subset's threshold with the best F1 on the *other* subsets (section 5.1.3); ties
        go to the highest, with the fewest false detections in frames without labels.
        ``seconds`` are NaN, since one call serves all thresholds.
    """
    table = table.rename(columns={"method": "threshold"})
    best = {}
    for subset in table["subset"].unique():
        others = sum_counts(table[table["subset"] != subset], ["threshold"]).set_index(
            "threshold"
        )
        best[subset] = others["f1"][::-1].idxmax()
    return table.assign(
        seconds=np.nan, chosen=table["threshold"] == table["subset"].map(best)
    )


def tried_thresholds(scale: str) -> tuple[int, ...]:
    """Return the DoG thresholds (grey values) that a scale tries.

    All; every fourth for "quick".
    """
    return THRESHOLDS[::4] if scale == "quick" else THRESHOLDS


def chosen_thresholds(table: pd.DataFrame) -> pd.Series:
    """Return the chosen threshold (grey values) by subset, from `compare_thresholds`."""
    return (
        table[table["chosen"]]
        .drop_duplicates("subset")
        .set_index("subset")["threshold"]
    )


def sum_counts(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return the counts of `run` summed over frames, with precision, recall and F1.

    Parameters
    ----------
    table
        From `run`.
    by
        Columns that stay apart, such as ``subset`` and ``method``.

    Returns
    -------
    DataFrame
        ``by``, ``tp``, ``fp``, ``fn``, ``precision``, ``recall``, ``f1`` with 45 px;
        ``seconds_per_image``, a median that one delayed frame does not move;
        ``f1_in_pixels``, scored within the pixels of a particle.
    """
    groups = table.groupby(by, sort=False)
    counts = groups[list(COUNTS)].sum().reset_index()
    inside = rates(*groups[[f"{count}_pixels" for count in COUNTS]].sum().to_numpy().T)
    shares = rates(*(counts[count] for count in COUNTS)).assign(
        seconds_per_image=groups["seconds"].median().to_numpy(),
        f1_in_pixels=inside["f1"].to_numpy(),
    )
    return pd.concat([counts, shares], axis=1)


def positions(
    subsets: Iterable[Subset], detectors: Mapping[str, Combination], wall: Cylinder
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return marked particles and detections with their distance from the axis.

    Fig. 3.11 shows these distances. The threshold between air and wall follows from
    them, and Tables 5.13 and 5.14 test it.

    Parameters
    ----------
    subsets
        Recordings with marked particles in their labelled frames.
    detectors
        Combined detector by name of the subset.
    wall
        Cylinder that gives the axis.

    Returns
    -------
    marked : DataFrame
        A row per marked particle and frame: ``subset``, ``frame``, ``particle``,
        ``row``, ``col``, ``label`` (class of Table 5.1; 4: on the wall); ``x``, ``y``,
        ``z`` in mm, the mean of the points in its pixels; ``distance_mm`` from the
        axis. The last four are NaN without a point ("no 3D", section 5.1.1).
    detected : DataFrame
        `kilnflight.tables.DETECTIONS` with ``subset`` and ``distance_mm`` (NaN without
        depth).
    """
    marked = []
    detected = []
    for subset in subsets:
        columns = subset.particles[["frame", "particle", "row", "col", "label"]]
        for t, view in subset_views(subset):
            particles = columns[columns["frame"] == t].assign(subset=subset.name)
            shown = subset.instances(t)[view.pixels[:, 0], view.pixels[:, 1]]
            means = pd.DataFrame(view.xyz, columns=list("xyz")).groupby(shown).mean()
            marked.append(particles.join(means, on="particle"))
            detections = detectors[subset.name](
                view, subset.recording.attributes.roi, t
            )
            detected.append(detections.assign(subset=subset.name))
    both = pd.concat(marked, ignore_index=True), pd.concat(detected, ignore_index=True)
    for table in both:
        known = table.dropna(subset="z")[["x", "y", "z"]]
        table["distance_mm"] = pd.Series(distance_to_axis(known, wall), known.index)
    return both
