"""Detection of particles on labelled frames, scored as in section 3.3 of the thesis.

labelled frames -> views x methods (section 5.1.3) -> one row per frame and method -> sums, rates
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from tqdm import tqdm

from kilnflight import kiln
from kilnflight.background import BackgroundModel, Median, TwoFrame
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
    Combination,
    View,
    centers,
    second_pass,
    sort_clusters,
)
from kilnflight.detection.quasi_centers import nearest_neighbors
from kilnflight.detection.sift import Polygon
from kilnflight.detection.wall import Cylinder, distance_to_axis
from kilnflight.project import claims
from kilnflight.recording.frames import Recording, calibrated_cloud
from kilnflight.scores import rates, score_detections, score_in_pixels
from kilnflight.scores.detections import NEAR_GATE_PX, particle_centroids
from kilnflight.twin import scenes, truth

COUNTS = ("tp", "fp", "fn")
WARM_UP_POINTS = 2000  # points of the untimed first call
# Labelled frames per subset by scale; 10 of all five subsets are the thesis's set of 50.
FRAMES = {"quick": 1, "standard": 1, "full": 10}
UNUSED = TwoFrame()  # background where clouds alone are clustered: it needs the fewest frames
# Subsets by scale; the text of section 5.1.3 speaks most of V1 and V4.
SUBSETS: dict[str, tuple[str, ...]] = {
    "quick": ("V4", "V5"),
    "standard": ("V1", "V4", "V5"),
    "full": tuple(scenes.SUBSETS),
}
# The temporal median over 150 frames (section 5.1.2); fewer in a reduced run, to render few.
WINDOWS = {"quick": 12, "standard": 30, "full": Median().window}
BACKGROUNDS = {scale: Median(window=window) for scale, window in WINDOWS.items()}
# Thresholds of DoG that are tried, in grey values: two per octave, from below the noise of one
# frame to beyond the brightest flames. The exposure of the thesis is not known.
THRESHOLDS = tuple(round(100 * 2 ** (k / 2)) for k in range(12))
# First and second pass of the combination (section 5.1.3), as printed; for DBSCAN, 15 points in
# 70 mm would be more precise than the printed first pass (Table 5.8).
PASSES: dict[str, tuple[Clusterer, Clusterer]] = {
    "DBSCAN": (DBSCAN(eps=50.0, min_points=10), DBSCAN(eps=15.0, min_points=10)),
    "MO": (MorphologicalClustering(100), MorphologicalClustering(400)),
    "QCC": (QuasiClusterCenters(35, 0.1), QuasiClusterCenters(20, 0.2)),
}
# Clusterers, the tables that list their settings, and how one is made of a row.
TABLES = {"dbscan": "table_5.8", "mo": "table_5.9", "qcc": "table_5.10"}
MAKERS: dict[str, Callable[[Any], Clusterer]] = {
    "dbscan": lambda row: DBSCAN(row.epsilon_mm, row.minPts),
    "mo": lambda row: MorphologicalClustering(row.R),
    "qcc": lambda row: QuasiClusterCenters(row.K, row.alpha),
}
Method = Callable[[View], npt.NDArray[np.float64]]  # -> (n, 2 or more) row, col


class Subset(NamedTuple):
    """A recording and the particles that a person would mark in some of its frames."""

    name: str
    recording: Recording
    frames: tuple[int, ...]
    particles: pd.DataFrame  # frame, particle, row, col, label; inside the region of interest
    instances: Callable[[int], npt.NDArray[np.integer]]  # frame -> (rows, cols) particle, -1
    background: BackgroundModel
    cache: dict[int, View]  # views of its background, 30 MB each; one needs 150 other frames


def labelled_subsets(
    scale: str, seed: int = 0, frames: int = 0, scenario: str = "base"
) -> list[Subset]:
    """Return the subsets of a scale, each with its first labelled frames.

    Parameters
    ----------
    scale
        A key of `SUBSETS`.
    seed
        Seed of the scenes.
    frames
        Labelled frames of each subset; 0: as many as in `FRAMES`.
    scenario
        One of `kilnflight.twin.scenes.SCENARIOS`, or several joined by +.
    """
    if not 0 <= frames <= (most := len(scenes.LABELLED)):
        raise InputError(f"labelled_subsets: frames={frames}, but {most} are labelled.")
    labelled, subsets = tuple(scenes.LABELLED[: frames or FRAMES[scale]]), []
    for name in SUBSETS[scale]:
        twin = scenes.cached_scene(scenes.scene_name(name, scenario), seed)
        marked, instances = truth.marked(twin, labelled), partial(truth.instances, twin)
        known = twin.scene.name, twin, labelled, marked, instances
        subsets.append(Subset(*known, BACKGROUNDS[scale], {}))
    return subsets


def subset_views(
    subset: Subset, background: BackgroundModel | None = None
) -> Iterator[tuple[int, View]]:
    """Return number and view of each labelled frame; views of another background are not cached."""
    if background not in (None, subset.background):
        return kiln.views(subset.recording, subset.frames, background)
    if any(t not in subset.cache for t in subset.frames):
        subset.cache.update(kiln.views(subset.recording, subset.frames, subset.background))
    return ((t, subset.cache[t]) for t in subset.frames)


def run(
    subsets: Iterable[Subset],
    methods: Mapping[Any, Method],
    background: BackgroundModel | None = None,
) -> pd.DataFrame:
    """Return the counts of each method in each frame, with progress.

    ``methods`` are by name; ``background`` is that of the subset if None.

    Returns
    -------
    DataFrame
        One row per frame and method: ``subset``, ``frame``, ``method``; ``tp``, ``fp``, ``fn``
        with a scoring distance of 45 px (section 3.3), ``tp_near`` ... with a diameter of 45 px,
        ``tp_pixels`` ... within the pixels of a particle (5.1.1); ``tp_2``, ``fn_2`` ... by
        class; ``seconds`` of compiled code: every method is called once before.
    """
    rows: list[dict[str, Any]] = []
    for subset in subsets:
        views = subset_views(subset, background)
        bar = tqdm(views, desc=subset.name, total=len(subset.frames), unit="frame", disable=None)
        for t, view in bar:
            if not rows:
                pixels, xyz = view.pixels[:WARM_UP_POINTS], view.xyz[:WARM_UP_POINTS]
                for method in methods.values():
                    method(view._replace(pixels=pixels, xyz=xyz))
            rows += _frame_rows(subset, t, view, methods)
    return pd.DataFrame(rows)


def _frame_rows(
    subset: Subset, t: int, view: View, methods: Mapping[Any, Method]
) -> list[dict[str, Any]]:
    particles = subset.particles[subset.particles["frame"] == t]
    place, label = particles[["row", "col"]].to_numpy(), particles["label"].to_numpy()
    image, roi = subset.instances(t), subset.recording.attributes.roi  # most pixels: no particle
    visible = particles["particle"][particles["particle"].isin(np.unique(image[image >= 0]))]
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


def from_foreground(detector: Detector2D) -> Method:
    """Return a 2D detector as a method."""
    return lambda view: detector(view.foreground)


def from_thresholds(thresholds: Iterable[float]) -> dict[float, Method]:
    """Return DoG with each threshold in grey values as a method, from one call per view."""
    ascending = sorted(thresholds)
    lowest = DoG(float(ascending[0]))
    graded = remembered(lambda view: lowest.graded(view.foreground))

    def above(threshold: float, view: View) -> npt.NDArray[np.float64]:
        particles = graded(view)
        return particles[particles[:, 3] >= threshold, :3]

    return {threshold: partial(above, float(threshold)) for threshold in ascending}


def from_cloud(clusterer: Callable[[npt.NDArray[np.float64]], Any]) -> Method:
    """Return a clusterer as a method: the centre of each cluster's pixels (section 3.1)."""
    return lambda view: centers(sort_clusters(view.pixels, view.xyz, clusterer(view.xyz)))


def table_5_11_methods(threshold: float, roi: Polygon | None) -> dict[str, Method]:
    """Return the eleven methods of Table 5.11 under their printed names.

    ``threshold`` is of DoG in grey values; the combined detector detects in ``roi`` (row, col).
    Two combinations with one clusterer share its passes: their time is not that of either alone.
    """

    def combined(
        detector: Detector2D, labels: Callable[[View], Any], view: View
    ) -> npt.NDArray[np.float64]:
        found = Combination(detector).decide(view, detector(view.foreground), labels(view), roi)
        return found[["row", "col"]].to_numpy()

    detectors: dict[str, Detector2D] = {"OTSU": Otsu(), "SIFT": DoG(threshold)}
    methods = {f"2D-{name}": from_foreground(detector) for name, detector in detectors.items()}
    methods["3D-DBSCAN Clustering"] = from_cloud(DBSCAN(eps=50.0, min_points=10))
    methods["3D-MO-based Clustering"] = from_cloud(MorphologicalClustering(150))
    methods["3D-QCC Clustering"] = from_cloud(QuasiClusterCenters(30, 0.1))
    for cloud, passes in PASSES.items():
        labels = remembered(partial(_passed, passes))
        for name, detector in detectors.items():
            methods[f"Combi {name}+{cloud}"] = partial(combined, detector, labels)
    return methods


def _passed(passes: tuple[Clusterer, Clusterer], view: View) -> npt.NDArray[np.intp]:
    return second_pass(view.xyz, *passes)


def remembered(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a function that keeps its value for the last view or cloud, for several methods."""
    last: list[Any] = [None, None]

    def value(of: Any) -> Any:
        if last[0] is not of:
            last[:] = of, function(of)
        return last[1]

    return value


def wall_points(recording: Recording, frame: int) -> npt.NDArray[np.float64]:
    """Return the calibrated points on the wall: DBSCAN's largest cluster, first pass."""
    points = calibrated_cloud(recording, frame)
    labels = PASSES["DBSCAN"][0](points)
    return points[labels == np.bincount(labels[labels >= 0]).argmax()]


def compare_thresholds(
    subsets: list[Subset], scale: str, background: BackgroundModel | None = None
) -> pd.DataFrame:
    """Return `run` of DoG with every threshold tried; ``threshold`` replaces ``method``.

    ``chosen`` marks the threshold that is best on the other subsets (section 5.1.3), the smallest
    of equal ones. ``seconds`` are NaN: one call serves all thresholds.
    """
    methods = from_thresholds(tried_thresholds(scale))
    table = run(subsets, methods, background).rename(columns={"method": "threshold"})
    best = {}
    for subset in table["subset"].unique():
        others = sum_counts(table[table["subset"] != subset], ["threshold"]).set_index("threshold")
        best[subset] = others["f1"].idxmax()
    return table.assign(seconds=np.nan, chosen=table["threshold"] == table["subset"].map(best))


def tried_thresholds(scale: str) -> tuple[int, ...]:
    """Return the DoG thresholds that a scale tries: all, or every fourth in a smoke run."""
    return THRESHOLDS[:: 4 if scale == "quick" else 1]


def chosen_thresholds(table: pd.DataFrame) -> pd.Series:
    """Return each subset's chosen threshold, from a table of `compare_thresholds`."""
    return table[table["chosen"]].drop_duplicates("subset").set_index("subset")["threshold"]


def sum_counts(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return counts and rates of a table of `run`, summed over frames; columns ``by`` stay apart.

    ``f1_in_pixels`` scores within the pixels of a particle. ``seconds_per_image`` is a median,
    which one delayed frame does not move.
    """
    groups = table.groupby(by, sort=False)
    counts = groups[list(COUNTS)].sum().reset_index()
    inside = rates(*groups[[f"{count}_pixels" for count in COUNTS]].sum().to_numpy().T)
    shares = rates(*(counts[count] for count in COUNTS)).assign(
        seconds_per_image=groups["seconds"].median().to_numpy(),
        f1_in_pixels=inside["f1"].to_numpy(),
    )
    return pd.concat([counts, shares], axis=1)


def time_thresholds(subsets: list[Subset], scale: str) -> pd.DataFrame:
    """Return `run` of DoG with one threshold at a time, on every fifth frame.

    ``threshold`` replaces ``method``: those of `tried_thresholds` and of Table 5.7.
    """
    thresholds = {*tried_thresholds(scale), *claims.published("table_5.7")["dog_local_max"]}
    methods = {threshold: from_foreground(DoG(float(threshold))) for threshold in thresholds}
    few = [subset._replace(frames=subset.frames[::5]) for subset in subsets]
    return run(few, methods).rename(columns={"method": "threshold"})


def compare_clusterers(subsets: list[Subset]) -> pd.DataFrame:
    """Return `run` of all settings of Tables 5.8 to 5.10, with ``family`` and ``row``.

    Neighbours are searched once for all settings of QCC. The time of that search, for the largest
    ``k`` of them, is part of each setting's ``seconds``.
    """
    most = int(claims.published(TABLES["qcc"])["K"].max())
    search = remembered(lambda cloud: nearest_neighbors(cloud, most))
    # It detects nothing: a method for its time.
    methods: dict[Any, Method] = {("search", 0): lambda view: search(view.xyz)[:0, :2]}
    for family, make in MAKERS.items():
        for row in claims.published(TABLES[family]).itertuples():
            each: Any = make(row)
            if family == "qcc":
                each = partial(lambda qcc, cloud: qcc.spread(cloud, search(cloud)), each)
            methods[family, row.Index] = from_cloud(each)
    table = run(subsets, methods, UNUSED)
    table[["family", "row"]] = table["method"].to_list()
    keys, searched = ["subset", "frame"], table["family"] == "search"
    spent = table[searched].set_index(keys)["seconds"].rename("search")
    table = table[~searched].join(spent, on=keys)
    table["seconds"] += table.pop("search").where(table["family"] == "qcc", 0.0)
    return table.reset_index(drop=True)


def positions(
    subsets: Iterable[Subset], detectors: Mapping[str, Combination], wall: Cylinder
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the positions of labelled particles and of detections (Fig. 3.11).

    ``detectors`` has one for each subset, by its name.

    Returns
    -------
    marked : DataFrame
        ``subset``, ``frame``, ``row``, ``col``, ``label``, ``distance_mm`` from the wall's axis
        and ``x``, ``y``, ``z`` in mm: the mean of the points in the particle's pixels; NaN
        without a point, so no 3D (5.1.1).
    detected : DataFrame
        ``subset``, ``distance_mm`` and `kilnflight.tables.DETECTIONS`.
    """
    marked, detected = [], []
    for subset in subsets:
        columns = subset.particles[["frame", "particle", "row", "col", "label"]]
        for t, view in subset_views(subset):
            particles = columns[columns["frame"] == t].assign(subset=subset.name)
            shown = subset.instances(t)[view.pixels[:, 0], view.pixels[:, 1]]
            means = pd.DataFrame(view.xyz, columns=list("xyz")).groupby(shown).mean()
            marked.append(particles.join(means, on="particle"))
            detections = detectors[subset.name](view, subset.recording.attributes.roi, t)
            detected.append(detections.assign(subset=subset.name))
    both = pd.concat(marked, ignore_index=True), pd.concat(detected, ignore_index=True)
    for table in both:
        known = table.dropna(subset="z")[["x", "y", "z"]]
        table["distance_mm"] = pd.Series(distance_to_axis(known, wall), known.index)
    return both
