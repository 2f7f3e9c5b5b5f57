"""Detection of particles on labelled frames, scored as in section 3.3 of the thesis.

Views of labelled frames go through each method (section 5.1.3). `score_methods` gives
one row per frame and method, `sum_counts` their sums and rates.
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self, cast

import cv2
import numpy as np
import pandas as pd
from pandas import DataFrame, Series
from tqdm import tqdm

from kilnflight import chain
from kilnflight.arrays import Array, Facts, Index, Integers, Picture, Shape
from kilnflight.background import BackgroundModel, Median
from kilnflight.checks import InputError
from kilnflight.detection import (
    Clusterer,
    Detector2D,
    DoG,
    MorphologicalClustering,
    QuasiClusterCenters,
)
from kilnflight.detection.combination import (
    LARGEST_PX,
    PARTICLE_PASS,
    WALL_PASS,
    Combination,
    View,
    largest_cluster,
    no_larger,
    second_pass,
)
from kilnflight.detection.quasi_centers import nearest_neighbors
from kilnflight.detection.region import inside
from kilnflight.detection.wall import Cylinder, distance_to_axis
from kilnflight.recording.files import open_subsets
from kilnflight.recording.frames import Recording, calibrated_cloud
from kilnflight.recording.survey import check_frame_fits
from kilnflight.scores import rates, score_detections, score_in_pixels
from kilnflight.scores.detections import NEAR_GATE_PX, FrameScore, particle_centroids
from kilnflight.simulated.kiln import scenes, truth
from kilnflight.simulated.kiln.feeding import LABELLED
from kilnflight.simulated.kiln.scene import Twin

COUNTS = ["tp", "fp", "fn"]
WARM_UP_POINTS = 2000  # points of the untimed first call
# Labelled frames per subset by scale; ten of all five subsets are the thesis's 50.
FRAMES = {"quick": 1, "standard": 1, "full": 10}
# Subsets by scale; the text of section 5.1.3 speaks most of V1 and V4.
SUBSETS = {
    "quick": ("V4", "V5"),
    "standard": ("V1", "V4", "V5"),
    "full": scenes.SUBSETS,
}
# Window of the temporal median, 150 frames in section 5.1.2; a reduced run renders few.
BACKGROUNDS = {"quick": Median(12), "standard": Median(30), "full": Median()}
# Thresholds of DoG that are tried, in grey values: two per octave, from a tenth of the
# thesis's to six times it. The exposure of the thesis is not known.
THRESHOLDS = tuple(round(50 * 2 ** (k / 2)) for k in range(13))
# Largest K of QCC on a whole cloud (Table 5.10); smaller ones use a part of its search
MOST_NEIGHBORS = 35
# First and second pass of the combination (section 5.1.3), as printed; for DBSCAN, 15
# points in 70 mm would be more precise than the printed first pass (Table 5.8).
PASSES: dict[str, tuple[Clusterer, Clusterer]] = {
    "DBSCAN": (WALL_PASS, PARTICLE_PASS),
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
    frames: Shape
    particles: DataFrame
    instances: Callable[[int], Integers]
    background: BackgroundModel
    cache: dict[int, View]

    @classmethod
    def of_labels(cls, name: str, recording: Recording, frames: Sequence[int]) -> Self:
        """Mark the particles that the labels of a recording show.

        Pixels of one class that touch, corners included, are a particle. The background
        is the median of the up to 150 frames around, or of those there are.
        """
        shown = {recording.frame(t).index: t for t in frames}

        def marks(number: int) -> tuple[Integers, DataFrame]:
            labels = recording.frame(shown[number]).labels
            assert labels is not None  # these frames are labelled
            return mark_labels(labels)

        parts = [marks(number)[1].assign(frame=number) for number in shown]
        particles = pd.concat(parts, ignore_index=True)
        roi = recording.attributes.roi
        if roi is not None:
            particles = particles[inside(roi, particles["row"], particles["col"])]
        return cls(
            name=name,
            recording=recording,
            frames=tuple(frames),
            particles=particles,
            instances=lambda number: marks(number)[0],
            background=Median(),
            cache={},
        )

    @classmethod
    def of(cls, twin: Twin, frames: Shape, background: BackgroundModel) -> Self:
        """Mark the visible particles in some frames of a simulated recording."""
        return cls(
            name=twin.scene.name,
            recording=twin,
            frames=frames,
            particles=truth.marked(twin, frames),
            instances=partial(truth.instances, twin),
            background=background,
            cache={},
        )

    def with_background(self, background: BackgroundModel) -> Self:
        """Subtract another background model in the views."""
        return self._replace(background=background, cache={})

    def views(self) -> list[View]:
        """Return the views of the labelled frames, which are computed once."""
        if not self.cache.keys() >= set(self.frames):
            self.cache.update(chain.views(self.recording, self.frames, self.background))
        return [self.cache[t] for t in self.frames]


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
        twin = scenes.open_scene(scenes.scene_name(name, scenario), seed)
        subsets.append(Subset.of(twin, labelled, BACKGROUNDS[scale]))
    return subsets


def mark_labels(labels: Picture) -> tuple[Integers, DataFrame]:
    """Return the particle (rows, cols) at each pixel (-1: none), and all particles.

    Returns
    -------
    image
        Number of the particle.
    table
        ``particle``, ``row``, ``col`` (of its centroid), ``label``.
    """
    image = np.full(labels.shape, -1, np.int32)
    parts = []
    first = 0
    for kind in truth.CLASSES:
        count, spots, _, places = cv2.connectedComponentsWithStats(
            (labels == kind).astype(np.uint8)
        )
        spot = spots > 0
        image[spot] = spots[spot] - 1 + first
        part = DataFrame({"row": places[1:, 1], "col": places[1:, 0]})
        parts.append(part.assign(label=kind))
        first += count - 1
    table = pd.concat(parts, ignore_index=True)
    return image, table.rename_axis("particle").reset_index()


def open_labelled(path: Path) -> list[Subset]:
    """Open the labelled frames of a manifest, such as the authors' 50, by subset.

    Raises
    ------
    InputError
        If a recording cannot be read, has no labels, or a labelled frame has no points
        or contradicts the manifest; or if there is one subset.
    """
    subsets = []
    for name, recording in open_subsets(path).items():
        if not recording.labelled:
            raise InputError(f"{path}: subset {name} has no labels. Add [labels].")
        for t in recording.labelled:
            frame = recording.frame(t)
            where = f"{path}, subset {name}, frame {frame.index}"
            if not len(frame.xyz):
                raise InputError(f"{where} has no points. Add or mend [coordinates].")
            check_frame_fits(frame, where)
        subsets.append(Subset.of_labels(name, recording, recording.labelled))
    if len(subsets) < 2:
        raise InputError(
            f"{path}: one subset; the threshold of one is found on others (section "
            "5.1.3). Write {subset} in the patterns."
        )
    return subsets


def score_methods(
    subsets: Iterable[Subset],
    methods: Mapping[Any, Method],
) -> DataFrame:
    """Count true, false and missed detections of each method in each labelled frame.

    Parameters
    ----------
    subsets
        Recordings with marked particles.
    methods
        By name; each returns the positions of detections in a view.

    Returns
    -------
    DataFrame
        One row per frame and method: ``subset``, ``frame``, ``method``; ``seconds`` of
        one call, without compilation; ``tp``, ``fp``, ``fn`` with a scoring distance of
        45 px (section 3.3); ``tp_near`` ... within 22.5 px, which reads the 45 px as a
        diameter; ``tp_pixels`` ... within the pixels of a particle (5.1.1); ``tp_2``,
        ``fn_2`` ... with 45 px by class of Table 5.1 (2, 3, 4).
    """
    rows: list[Facts] = []
    for subset in subsets:
        for view in tqdm(subset.views(), subset.name, unit="frame", disable=None):
            if not rows:  # untimed, so that each is compiled
                points = slice(WARM_UP_POINTS)
                few = view._replace(pixels=view.pixels[points], xyz=view.xyz[points])
                for method in methods.values():
                    method(few)
            rows += _frame_rows(subset, view, methods)
    return DataFrame(rows)


def _frame_rows(
    subset: Subset, view: View, methods: Mapping[Any, Method]
) -> list[Facts]:
    """Return a row of `score_methods` for each method in one frame.

    Only the method itself is timed.
    """
    particles = subset.particles[subset.particles["frame"] == view.number]
    places = particles[["row", "col"]].to_numpy()
    image = subset.instances(view.number)
    # NaN where other particles hide one
    centroids = particle_centroids(image, particles["particle"].to_numpy()).dropna()
    roi = subset.recording.attributes.roi
    rows = []
    for name, method in methods.items():
        begin = time.perf_counter()
        spots = method(view)[:, :2]
        seconds = time.perf_counter() - begin
        row = {"subset": subset.name, "frame": view.number, "method": name}
        scores = {
            "": score_detections(places, spots, roi=roi),
            "_near": score_detections(places, spots, NEAR_GATE_PX, roi),
            "_pixels": score_in_pixels(image, centroids, spots, roi),
        }
        for suffix, score in scores.items():
            row |= {count + suffix: getattr(score, count) for count in COUNTS}
        row |= class_counts(scores[""], particles["label"].to_numpy())
        rows.append(row | {"seconds": seconds})
    return rows


def class_counts(score: FrameScore, labels: Integers) -> Facts:
    """Count found and missed particles of each class; ``labels`` (n,) are of all."""
    found = labels[score.pairs[:, 0]]
    missed = labels[score.missed]
    counts = {}
    for kind in truth.CLASSES:
        counts[f"tp_{kind}"] = np.count_nonzero(found == kind)
        counts[f"fn_{kind}"] = np.count_nonzero(missed == kind)
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

    return {threshold: partial(above, threshold) for threshold in thresholds}


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


search_neighbors = remembered(lambda xyz: nearest_neighbors(xyz, MOST_NEIGHBORS))


def cluster_cloud(clusterer: Clusterer, xyz: Array) -> Index:
    """Cluster a whole cloud (n, 3); all settings of QCC share one search."""
    if isinstance(clusterer, QuasiClusterCenters):
        return clusterer.spread(xyz, search_neighbors(xyz))
    return clusterer(xyz)


class SharedClusters:
    """Clusters of the views of one recording, found once for all methods.

    Views are told apart by number and size. ``known`` holds the labels by passes,
    number and size.
    """

    def __init__(self) -> None:
        self.known: dict[tuple[Any, ...], Index] = {}

    def __call__(self, view: View, first: Clusterer, *second: Clusterer) -> Index:
        """Return the labels (n,) of a view's points after one pass or two."""
        key = (first, second, view.number, len(view.xyz))
        if key not in self.known:
            wall = partial(cluster_cloud, first)
            if second:
                self.known[key] = second_pass(view.xyz, wall, *second)
            else:
                self.known[key] = wall(view.xyz)
        return self.known[key]


def wall_points(subset: Subset) -> Array:
    """Return the points (n, 3) on the wall in mm, to fit the cylinder (Table 5.12).

    They are the largest cluster of DBSCAN's first pass in the first labelled frame,
    after depth calibration.
    """
    points = calibrated_cloud(subset.recording, subset.frames[0])
    labels = WALL_PASS(points)
    return points[labels == largest_cluster(labels)]


def score_at_chosen(
    subsets: list[Subset], scale: str, rule: Combination = OURS
) -> DataFrame:
    """Count the detections of DoG at the threshold chosen for each subset.

    The `tried_thresholds` of the scale are compared on two or more subsets (Tables 5.6
    and 5.7). ``rule`` is as in `from_thresholds`, the table that of `at_chosen`.
    """
    methods = from_thresholds(tried_thresholds(scale), rule)
    return at_chosen(score_methods(subsets, methods))


def at_chosen(table: DataFrame) -> DataFrame:
    """Take the threshold of each subset that is best on the other subsets.

    Parameters
    ----------
    table
        From `score_methods` of thresholds.

    Returns
    -------
    DataFrame
        Rows of the threshold with the best F1 on the *other* subsets (section 5.1.3);
        ties go to the highest, with the fewest false detections in frames without
        labels. ``threshold`` (grey values) stands in place of ``method``. ``seconds``
        are NaN, since one call serves all thresholds.
    """
    best = {}
    for subset in table["subset"].unique():
        best[subset] = best_threshold(table[table["subset"] != subset])
    chosen = table[table["method"] == table["subset"].map(best)]
    return chosen.rename(columns={"method": "threshold"}).assign(seconds=np.nan)


def best_threshold(table: DataFrame) -> float:
    """Return the threshold of the best F1, of equal ones the highest.

    ``table`` is from `score_methods` of thresholds.
    """
    ranked = sum_counts(table, ["method"]).sort_values(["f1", "method"])
    return ranked["method"].iloc[-1]


def tried_thresholds(scale: str) -> Shape:
    """Return the DoG thresholds (grey values) of a scale: every fourth for "quick"."""
    if scale == "quick":
        return THRESHOLDS[::4]
    return THRESHOLDS


def sum_counts(table: DataFrame, by: list[str]) -> DataFrame:
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
    sums = groups.sum(numeric_only=True)
    pixels = rates(sums["tp_pixels"], sums["fp_pixels"], sums["fn_pixels"])
    shares = rates(sums["tp"], sums["fp"], sums["fn"]).assign(
        seconds_per_image=groups["seconds"].median().to_numpy(),
        f1_in_pixels=pixels["f1"],
    )
    return pd.concat([sums[COUNTS].reset_index(), shares], axis=1)


def place_marked(subsets: Iterable[Subset], wall: Cylinder) -> DataFrame:
    """Place marked particles, with their distance from the axis of the kiln.

    Fig. 3.11 shows these distances. The threshold between air and wall follows from
    them, and Tables 5.13 and 5.14 test it.

    Parameters
    ----------
    subsets
        Recordings with marked particles in their labelled frames.
    wall
        Cylinder that gives the axis.

    Returns
    -------
    DataFrame
        A row per marked particle and frame: ``subset``, ``frame``, ``particle``,
        ``row``, ``col``, ``label`` (class of Table 5.1; 4: on the wall); ``x``, ``y``,
        ``z`` in mm, the mean of the points in its pixels; ``distance_mm`` from the
        axis. The last four are NaN without a point ("no 3D", section 5.1.1).
    """
    columns = ["frame", "particle", "row", "col", "label"]
    parts = []
    for subset in subsets:
        for view in subset.views():
            here = subset.particles["frame"] == view.number
            row, col = view.pixels.T
            shown = subset.instances(view.number)[row, col]
            means = DataFrame(view.xyz, columns=list("xyz")).groupby(shown).mean()
            particles = subset.particles.loc[here, columns].assign(subset=subset.name)
            parts.append(particles.join(means, on="particle"))
    return with_distance(pd.concat(parts, ignore_index=True), wall)


def with_distance(table: DataFrame, wall: Cylinder) -> DataFrame:
    """Add ``distance_mm`` from the axis to places in mm, NaN without depth."""
    known = table.dropna(subset="z")[["x", "y", "z"]]
    distance = Series(distance_to_axis(known, wall), known.index)
    return table.assign(distance_mm=distance)
