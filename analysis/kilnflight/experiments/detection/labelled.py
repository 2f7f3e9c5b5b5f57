"""Detection of particles on labelled frames, scored as in section 3.3 of the thesis.

Views of labelled frames go through each method (section 5.1.3). `score_methods` gives
one row per frame and method, `sum_counts` their sums and rates.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, cast

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
    QuasiClusterCenters,
)
from kilnflight.detection.combination import (
    LARGEST_PX,
    Combination,
    View,
    no_larger,
    second_pass,
)
from kilnflight.detection.quasi_centers import nearest_neighbors
from kilnflight.detection.wall import Cylinder, distance_to_axis
from kilnflight.recording.frames import Recording, calibrated_cloud
from kilnflight.scores import rates, score_detections, score_in_pixels
from kilnflight.scores.detections import NEAR_GATE_PX, FrameScore, particle_centroids
from kilnflight.simulated.kiln import scenes, truth
from kilnflight.simulated.kiln.feeding import LABELLED

COUNTS = ("tp", "fp", "fn")
WARM_UP_POINTS = 2000  # points of the untimed first call
# Labelled frames per subset by scale; ten of all five subsets are the thesis's 50.
FRAMES = {"quick": 1, "standard": 1, "full": 10}
# Subsets by scale; the text of section 5.1.3 speaks most of V1 and V4.
SUBSETS: dict[str, tuple[str, ...]] = {
    "quick": ("V4", "V5"),
    "standard": ("V1", "V4", "V5"),
    "full": tuple(scenes.SUBSETS),
}
# Window of the temporal median, 150 frames in section 5.1.2; a reduced run renders few.
WINDOWS = {"quick": 12, "standard": 30, "full": Median().window}
BACKGROUNDS = {scale: Median(window=window) for scale, window in WINDOWS.items()}
# Thresholds of DoG that are tried, in grey values: two per octave, from a tenth of the
# thesis's to six times it. The exposure of the thesis is not known.
THRESHOLDS = tuple(round(50 * 2 ** (k / 2)) for k in range(13))
# Largest K of QCC on a whole cloud (Table 5.10); smaller ones use a part of its search
MOST_NEIGHBORS = 35
Passes = tuple[Clusterer, ...]
# First and second pass of the combination (section 5.1.3), as printed; for DBSCAN, 15
# points in 70 mm would be more precise than the printed first pass (Table 5.8).
PASSES: dict[str, Passes] = {
    "DBSCAN": (DBSCAN(eps=50.0, min_points=10), DBSCAN(eps=15.0, min_points=10)),
    "MO": (MorphologicalClustering(100), MorphologicalClustering(400)),
    "QCC": (QuasiClusterCenters(MOST_NEIGHBORS, 0.1), QuasiClusterCenters(20, 0.2)),
}
# r of Eq. 2.28 is "user-defined" (section 2.2.3). The total row of SIFT in Table 5.6
# identifies it (sift_row.csv).
EDGE = 40.0
Method = Callable[[View], Array]  # -> (n, 2 or more): row, col in px first


def sift(threshold: float = DoG.threshold) -> DoG:
    """Build DoG with a threshold in grey values and the identified r, `EDGE`."""
    return DoG(threshold, edge=EDGE)


OURS = Combination(sift())


class Subset(NamedTuple):
    """A recording, and the marked particles in its labelled frames (section 5.1.1).

    Marked are the particles that a person would see; the simulation knows them.

    Attributes
    ----------
    name
        "V1" to "V5", with the scenario behind an @.
    recording
        Grey values and points.
    frames
        Numbers of the labelled frames.
    particles
        ``frame``, ``particle``, ``row``, ``col``, ``label`` of the marked particles
        inside the region of interest.
    instances
        Function of a frame that returns the particle (rows, cols) at each pixel; -1:
        none.
    background
        Background model of the views.
    cache
        Views by frame with this background; 30 MB each, from up to 150 frames.
    """

    name: str
    recording: Recording
    frames: tuple[int, ...]
    particles: pd.DataFrame
    instances: Callable[[int], npt.NDArray[np.integer]]
    background: BackgroundModel
    cache: dict[int, View]


def labelled_subsets(
    scale: str, seed: int = 0, frames: int = 0, scenario: str = "base"
) -> list[Subset]:
    """Open the simulated subsets of a scale with their middle labelled frames.

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
    most = len(LABELLED)
    if not 0 <= frames <= most:
        raise InputError(f"labelled_subsets: frames={frames}, but {most} are labelled.")
    count = frames or FRAMES[scale]
    first = (most - count + 1) // 2
    labelled = tuple(LABELLED[first : first + count])
    subsets = []
    for name in SUBSETS[scale]:
        twin = scenes.cached_scene(scenes.scene_name(name, scenario), seed)
        subset = Subset(
            name=twin.scene.name,
            recording=twin,
            frames=labelled,
            particles=truth.marked(twin, labelled),
            instances=partial(truth.instances, twin),
            background=BACKGROUNDS[scale],
            cache={},
        )
        subsets.append(subset)
    return subsets


def subset_views(
    subset: Subset, background: BackgroundModel | None = None
) -> Iterator[tuple[int, View]]:
    """Yield number and view of each labelled frame of a subset.

    Views with the subset's own background are cached in it, those with another are not.
    """
    if background not in (None, subset.background):
        yield from chain.views(subset.recording, subset.frames, background)
        return
    if not subset.cache.keys() >= set(subset.frames):
        views = chain.views(subset.recording, subset.frames, subset.background)
        subset.cache.update(views)
    for t in subset.frames:
        yield t, subset.cache[t]


def score_methods(
    subsets: Iterable[Subset],
    methods: Mapping[Any, Method],
    background: BackgroundModel | None = None,
) -> pd.DataFrame:
    """Count true, false and missed detections of each method in each labelled frame.

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
        One row per frame and method: ``subset``, ``frame``, ``method``; ``seconds`` of
        one call, without compilation; ``tp``, ``fp``, ``fn`` with a scoring distance of
        45 px (section 3.3); ``tp_near`` ... within 22.5 px, which reads the 45 px as a
        diameter; ``tp_pixels`` ... within the pixels of a particle (5.1.1); ``tp_2``,
        ``fn_2`` ... with 45 px by class of Table 5.1 (2, 3, 4).
    """
    rows: list[dict[str, Any]] = []
    for subset in subsets:
        views = subset_views(subset, background)
        count = len(subset.frames)
        for t, view in tqdm(views, subset.name, count, unit="frame", disable=None):
            if not rows:
                _warm_up(methods, view)
            rows += _frame_rows(subset, t, view, methods)
    return pd.DataFrame(rows)


def _warm_up(methods: Mapping[Any, Method], view: View) -> None:
    """Call each method untimed on few points, so that it is compiled."""
    pixels = view.pixels[:WARM_UP_POINTS]
    xyz = view.xyz[:WARM_UP_POINTS]
    few = view._replace(pixels=pixels, xyz=xyz)  # one view, as methods share steps
    for method in methods.values():
        method(few)


def _frame_rows(
    subset: Subset, t: int, view: View, methods: Mapping[Any, Method]
) -> list[dict[str, Any]]:
    """Return a row of `score_methods` for each method in frame ``t``.

    Only the method itself is timed.
    """
    particles = subset.particles[subset.particles["frame"] == t]
    places = particles[["row", "col"]].to_numpy()
    labels = particles["label"].to_numpy()
    image = subset.instances(t)
    shown = np.unique(image[image >= 0])  # most pixels show no particle
    visible = particles["particle"][particles["particle"].isin(shown)]
    centroids = particle_centroids(image, visible.to_numpy())
    roi = subset.recording.attributes.roi
    rows = []
    for name, method in methods.items():
        begin = time.perf_counter()
        spots = method(view)[:, :2]
        seconds = time.perf_counter() - begin
        row = {"subset": subset.name, "frame": t, "method": name, "seconds": seconds}
        scores = {
            "": score_detections(places, spots, roi=roi),
            "_near": score_detections(places, spots, NEAR_GATE_PX, roi),
            "_pixels": score_in_pixels(image, centroids, spots, roi),
        }
        for suffix, score in scores.items():
            row |= {count + suffix: getattr(score, count) for count in COUNTS}
        rows.append(row | _class_counts(scores[""], labels))
    return rows


def _class_counts(score: FrameScore, labels: npt.NDArray[Any]) -> dict[str, int]:
    """Count found and missed particles of each class; ``labels`` (n,) are of all."""
    found = labels[score.pairs[:, 0]]
    missed = labels[score.missed]
    counts = {}
    for kind in truth.CLASSES:
        counts[f"tp_{kind}"] = int((found == kind).sum())
        counts[f"fn_{kind}"] = int((missed == kind).sum())
    return counts


def from_foreground(detector: Detector2D, largest_px: float = LARGEST_PX) -> Method:
    """Apply a 2D detector to a view's foreground.

    Keypoints above ``largest_px`` in diameter are left out.
    """
    return lambda view: no_larger(detector(view.foreground), largest_px)


def from_thresholds(
    thresholds: Sequence[float], rule: Combination = OURS
) -> dict[float, Method]:
    """Build a method with DoG for each threshold in grey values; all share one call.

    DoG runs with the smallest threshold and grades its keypoints. A larger threshold
    drops those of a lower grade. So the times of single methods mean nothing. Edge and
    largest keypoint are those of ``rule``.
    """
    finest = replace(cast(DoG, rule.detector), threshold=float(min(thresholds)))
    graded = remembered(from_foreground(finest.graded, rule.largest_px))

    def above(threshold: float, view: View) -> Array:
        particles = graded(view)
        return particles[particles[:, 3] >= threshold, :3]

    return {threshold: partial(above, float(threshold)) for threshold in thresholds}


class SharedClusters:
    """Clusters of the views of one recording, found once for all methods.

    Views are told apart by number and size. ``known`` holds the labels by passes,
    number and size.
    """

    def __init__(self) -> None:
        self.known: dict[tuple[Passes, int, int], Index] = {}
        self._search = remembered(lambda xyz: nearest_neighbors(xyz, MOST_NEIGHBORS))

    def __call__(self, view: View, *passes: Clusterer) -> Index:
        """Return the labels (n,) of a view's points after one pass or two."""
        key = (passes, view.number, len(view.xyz))
        if key not in self.known:
            self.known[key] = self._labels(view.xyz, *passes)
        return self.known[key]

    def _labels(self, xyz: Array, first: Clusterer, *second: Clusterer) -> Index:
        """Return the labels (n,) of points (n, 3) after one pass or two."""
        wall = partial(self._first_pass, first)
        if second:
            return second_pass(xyz, wall, *second)
        return wall(xyz)

    def _first_pass(self, clusterer: Clusterer, xyz: Array) -> Index:
        """Cluster a whole cloud (n, 3); all settings of QCC share one search."""
        if isinstance(clusterer, QuasiClusterCenters):
            return clusterer.spread(xyz, self._search(xyz))
        return clusterer(xyz)


def remembered(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Wrap a function so that it keeps the result for its last argument.

    The argument is compared by identity. Methods that are called in turn on one view or
    cloud share its result, such as clusters or neighbours.
    """
    last: list[Any] = [None, None]

    def value(of: Any) -> Any:
        if last[0] is not of:
            last[:] = [of, function(of)]
        return last[1]

    return value


def timed(function: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """Call a function twice; return its result and the seconds of the second call."""
    function(*arguments)
    begin = time.perf_counter()
    result = function(*arguments)
    return result, time.perf_counter() - begin


def wall_points(recording: Recording, frame: int) -> Array:
    """Return the points (n, 3) on the wall in mm, to fit the cylinder (Table 5.12).

    They are the largest cluster of DBSCAN's first pass in one frame, after depth
    calibration.
    """
    points = calibrated_cloud(recording, frame)
    first, _ = PASSES["DBSCAN"]
    labels = first(points)
    return points[labels == np.bincount(labels[labels >= 0]).argmax()]


def compare_thresholds(
    subsets: list[Subset], scale: str, rule: Combination = OURS
) -> pd.DataFrame:
    """Count the detections of DoG by threshold, on two or more subsets.

    The thresholds are the `tried_thresholds` of the scale (Tables 5.6 and 5.7).
    ``rule`` is as in `from_thresholds`, the table that of `mark_chosen`.
    """
    methods = from_thresholds(tried_thresholds(scale), rule)
    return mark_chosen(score_methods(subsets, methods))


def mark_chosen(table: pd.DataFrame) -> pd.DataFrame:
    """Mark the threshold of each subset that is best on the other subsets.

    Parameters
    ----------
    table
        From `score_methods` of ascending thresholds.

    Returns
    -------
    DataFrame
        ``threshold`` (grey values) in place of ``method``. ``chosen`` marks the
        threshold with the best F1 on the *other* subsets (section 5.1.3); ties go to
        the highest, with the fewest false detections in frames without labels.
        ``seconds`` are NaN, since one call serves all thresholds.
    """
    table = table.rename(columns={"method": "threshold"})
    best = {}
    for subset in table["subset"].unique():
        others = sum_counts(table[table["subset"] != subset], ["threshold"])
        f1 = others.set_index("threshold")["f1"]
        best[subset] = f1[::-1].idxmax()
    chosen = table["threshold"] == table["subset"].map(best)
    return table.assign(seconds=np.nan, chosen=chosen)


def tried_thresholds(scale: str) -> tuple[int, ...]:
    """Return the DoG thresholds (grey values) of a scale: every fourth for "quick"."""
    if scale == "quick":
        return THRESHOLDS[::4]
    return THRESHOLDS


def chosen_thresholds(table: pd.DataFrame) -> pd.Series:
    """Return the chosen threshold in grey values by subset."""
    chosen = table[table["chosen"]].drop_duplicates("subset")
    return chosen.set_index("subset")["threshold"]


def sum_counts(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Sum the counts of `score_methods` over frames, with precision, recall and F1.

    Parameters
    ----------
    table
        From `score_methods`.
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
    pixels = groups[[f"{count}_pixels" for count in COUNTS]].sum()
    shares = rates(counts["tp"], counts["fp"], counts["fn"]).assign(
        seconds_per_image=groups["seconds"].median().to_numpy(),
        f1_in_pixels=rates(*pixels.to_numpy().T)["f1"],
    )
    return pd.concat([counts, shares], axis=1)


def positions(
    subsets: Iterable[Subset], detectors: Mapping[str, Combination], wall: Cylinder
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Place marked particles and detections, with their distance from the axis.

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
        detector = detectors[subset.name]
        roi = subset.recording.attributes.roi
        for t, view in subset_views(subset):
            marked.append(_mean_places(subset, t, view))
            detected.append(detector(view, roi, t).assign(subset=subset.name))
    return _with_distance(marked, wall), _with_distance(detected, wall)


def _mean_places(subset: Subset, t: int, view: View) -> pd.DataFrame:
    """Return the marked particles of a frame with the mean of their points in mm."""
    columns = ["frame", "particle", "row", "col", "label"]
    particles = subset.particles.loc[subset.particles["frame"] == t, columns]
    shown = subset.instances(t)[view.pixels[:, 0], view.pixels[:, 1]]
    means = pd.DataFrame(view.xyz, columns=list("xyz")).groupby(shown).mean()
    return particles.assign(subset=subset.name).join(means, on="particle")


def _with_distance(parts: Sequence[pd.DataFrame], wall: Cylinder) -> pd.DataFrame:
    """Join tables and add ``distance_mm`` from the axis, NaN without depth."""
    table = pd.concat(parts, ignore_index=True)
    known = table.dropna(subset="z")[["x", "y", "z"]]
    distance = pd.Series(distance_to_axis(known, wall), known.index)
    return table.assign(distance_mm=distance)
