"""Detection experiment: methods on labelled frames, counted as in section 3.3.

labelled frames -> views x methods (section 5.1.3) -> one row per frame and method -> sums, rates

All that takes long is here; `detection_claims` has tables, intervals and verdicts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from tqdm import tqdm

from kilnflight import kiln
from kilnflight.background import BackgroundModel, Median, StopsAtZero, TwoFrame
from kilnflight.background.difference import Frames, WindowModel, difference
from kilnflight.checks import InputError, check_columns
from kilnflight.detection import (
    DBSCAN,
    Clusterer,
    Detector2D,
    DoG,
    MorphologicalClustering,
    Otsu,
    Polygon,
    QuasiClusterCenters,
)
from kilnflight.detection.combination import Combination, View, second_pass, summarise
from kilnflight.detection.quasi_centers import nearest_neighbors
from kilnflight.detection.wall import Cylinder, distance_to_axis
from kilnflight.project import claims
from kilnflight.recording.frames import Recording, calibrated_cloud
from kilnflight.scores import rates, score_detections, score_in_pixels
from kilnflight.scores.detections import GATE_PX, NEAR_GATE_PX, particle_centroids
from kilnflight.twin import scenes, truth
from kilnflight.twin.scene import Twin

COUNTS = ("tp", "fp", "fn")
# Two readings of the 45 px (`kilnflight.scores.detections`): the largest distance, or a diameter.
GATES = {"": GATE_PX, "_near": NEAR_GATE_PX}
WARM_UP_POINTS = 2000  # of the untimed first call
# Scale of the frames of each draw in notebook 57: all subsets, but few frames.
DRAW = "draw"
# Labelled frames per subset by scale; 10 of all five subsets are the thesis's set of 50.
FRAMES = {"quick": 1, "standard": 1, DRAW: 1, "full": 10}
UNUSED = TwoFrame()  # where clouds alone are clustered: it needs the fewest frames
# Subsets by scale: two of a smoke run, three of a reduced one; the text speaks most of V1 and V4.
SUBSETS: dict[str, tuple[str, ...]] = {
    "quick": ("V4", "V5"),
    "standard": ("V1", "V4", "V5"),
    **dict.fromkeys((DRAW, "full"), tuple(scenes.SUBSETS)),
}
# The temporal median over 150 frames (section 5.1.2); fewer in a reduced run, to render few.
WINDOWS = {"quick": 12, "standard": 30, DRAW: 30, "full": Median().window}
BACKGROUNDS = {scale: Median(window=window) for scale, window in WINDOWS.items()}
# Thresholds of DoG that are tried, in grey values: two per octave, from below the noise of one
# frame to beyond the brightest flames. The exposure of the thesis is not known (twin.md).
THRESHOLDS = tuple(round(100 * 2 ** (k / 2)) for k in range(12))
# First and second pass of the combination (section 5.1.3); DBSCAN's first pass is printed as
# the set of highest precision, which 15 points in 70 mm is (Table 5.8).
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
SEARCH = ("search", 0)  # of neighbours, which all settings of QCC share
Method = Callable[[View], npt.NDArray[np.float64]]  # -> (n, 2 or more) row, col
Foreground = npt.NDArray[np.float32]
Bits = npt.NDArray[np.uint8]  # of `numpy.packbits`
Known = dict[Any, tuple[npt.NDArray[np.float64], npt.NDArray[np.intp]]]  # clouds and labels


class Subset(NamedTuple):
    """A recording and what a person marked in some of its frames."""

    name: str
    recording: Recording
    frames: tuple[int, ...]
    particles: pd.DataFrame  # frame, particle, row, col, label; inside the region of interest
    instances: Callable[[int], npt.NDArray[np.integer]]  # frame -> (rows, cols) particle, -1
    background: BackgroundModel = BACKGROUNDS["full"]
    # Views that were made, 30 MB each: every one needs 150 other frames. None: not held.
    cache: dict[int, View] | None = None
    darker: dict[int, Bits] | None = None  # of those: pixels darker than their background
    known: Known | None = None  # labels of these clouds, that several methods take
    absolute: Subset | None = None  # the same with absolute differences, if these stop at zero


def labelled_subsets(
    scale: str, seed: int = 0, frames: int = 0, scenario: str = "base"
) -> list[Subset]:
    """Return the subsets of the twin, each with its first labelled frames.

    ``scale`` is "quick" (two subsets), "standard" (three), `DRAW` or "full" (all five), ``seed``
    that of the scenes. There are ``frames`` of each; 0: 1, or 10 at full scale. ``scenario`` is
    one of `kilnflight.twin.scenes.SCENARIOS`, or several joined by +.
    """
    if scale not in FRAMES or not 0 <= frames <= len(scenes.LABELLED):
        raise InputError(
            f"labelled_subsets: scale {scale!r} with {frames} frames; there are "
            f"{', '.join(FRAMES)}, and up to {len(scenes.LABELLED)} labelled frames."
        )
    labelled = scenes.LABELLED[: frames or FRAMES[scale]]
    names = [scenes.scene_name(name, scenario) for name in SUBSETS[scale]]
    twins = [scenes.cached_scene(name, seed) for name in names]
    return [labelled_subset(twin, labelled, BACKGROUNDS[scale]) for twin in twins]


def labelled_subset(twin: Twin, frames: Sequence[int], background: BackgroundModel) -> Subset:
    """Return a twin's recording with the particles a person would mark in frames."""
    marked, instances = truth.marked(twin, frames), partial(truth.instances, twin)
    return Subset(twin.scene.name, twin, tuple(frames), marked, instances, background, {}, {}, {})


def stopping_at_zero(subsets: Iterable[Subset]) -> list[Subset]:
    """Return subsets whose differences from the background stop at zero (`StopsAtZero`)."""
    other = []
    for subset in subsets:
        if not isinstance(subset.background, WindowModel):
            raise InputError(f"{subset.name}: {subset.background!r} cannot stop at zero.")
        background = StopsAtZero(subset.background)
        other.append(subset._replace(background=background, cache={}, absolute=subset))
    return other


def subset_views(
    subset: Subset, background: BackgroundModel | None = None
) -> Iterator[tuple[int, View]]:
    """Return number and view of each labelled frame, if possible from the subset's cache.

    With another ``background`` than the subset's nothing is cached.
    """
    subtracted = background or subset.background
    if subset.darker is not None and subtracted == _stopping(subset.background):
        return _stopped(subset)
    if subset.cache is None or subtracted != subset.background:
        return kiln.views(subset.recording, subset.frames, subtracted)
    if any(t not in subset.cache for t in subset.frames):
        subset.cache.update(_made(subset))
    return ((t, subset.cache[t]) for t in subset.frames)


def _stopping(background: BackgroundModel) -> BackgroundModel | None:
    """Return a background whose differences stop at zero; None if its equation has bars."""
    return StopsAtZero(background) if isinstance(background, WindowModel) else None


def _made(subset: Subset) -> Iterator[tuple[int, View]]:
    """Return number and view of each labelled frame, for the subset's cache."""
    absolute = subset.absolute
    if absolute is not None and absolute.cache is not None and absolute.darker is not None:
        return _stopped(absolute._replace(frames=subset.frames))
    subtracted = subset.background
    if subset.darker is not None and isinstance(subtracted, WindowModel):
        subtracted = partial(_noted, subtracted, subset.darker)
    return kiln.views(subset.recording, subset.frames, subtracted)


def _noted(
    model: WindowModel, darker: dict[int, Bits], frames: Frames, indices: Iterable[int]
) -> Iterator[Foreground]:
    """Yield what a background model does; note which pixels are darker than the background."""
    wanted = list(indices)
    for t, background in zip(wanted, model.backgrounds(frames, wanted), strict=True):
        gray = frames[t]
        darker[t] = np.packbits(gray < background)
        yield difference(gray, background)


def _stopped(subset: Subset) -> Iterator[tuple[int, View]]:
    """Yield the views of a subset with differences that stop at zero.

    No frame is read again: an absolute difference is the other one, or its negative where the
    frame is darker than the background.
    """
    for t, view in subset_views(subset):
        size = view.gray.shape
        below = np.unpackbits((subset.darker or {})[t], count=view.gray.size).reshape(size)
        yield t, view._replace(foreground=np.where(below, np.float32(0), view.foreground))


def run(
    subsets: Iterable[Subset],
    methods: Mapping[Any, Method],
    background: BackgroundModel | None = None,
) -> pd.DataFrame:
    """Return how each method does on each frame of all subsets, with progress.

    ``methods`` are by name; ``background`` is that of the subset if None.

    Returns
    -------
    DataFrame
        One row per frame and method: ``subset``, ``frame``, ``method``; ``tp``, ``fp``,
        ``fn`` by the gate of 45 px (section 3.3) and ``tp_pixels``, ``fp_pixels``,
        ``fn_pixels`` within the pixels of a particle (5.1.1); ``tp_2``, ``fn_2`` ... by
        class; all but those in pixels also with ``_near``, where 45 px are a diameter;
        ``seconds``, of compiled code: every method is called once before.
    """
    rows: list[dict[str, Any]] = []
    for subset in subsets:
        check_columns(subset.particles, ["frame", "particle", "row", "col", "label"], subset.name)
        views = subset_views(subset, background)
        bar = tqdm(views, desc=subset.name, total=len(subset.frames), unit="frame", disable=None)
        for t, view in bar:
            if not rows:  # compile on a few of the points, so that no compiling is timed
                pixels, xyz = view.pixels[:WARM_UP_POINTS], view.xyz[:WARM_UP_POINTS]
                few = view._replace(pixels=pixels, xyz=xyz)
                for method in methods.values():
                    method(few)
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
        within = score_in_pixels(image, centroids, spots, roi)
        row |= {f"{count}_pixels": getattr(within, count) for count in COUNTS}
        for suffix, gate in GATES.items():
            scored = score_detections(place, spots, gate, roi)
            row |= {count + suffix: getattr(scored, count) for count in COUNTS}
            for kind in truth.CLASSES:
                row[f"tp_{kind}{suffix}"] = int((label[scored.pairs[:, 0]] == kind).sum())
                row[f"fn_{kind}{suffix}"] = int((label[scored.missed] == kind).sum())
        rows.append(row)
    return rows


def from_foreground(detector: Detector2D) -> Method:
    """Return a 2D detector as a method."""
    return lambda view: detector(view.foreground)


def from_thresholds(
    thresholds: Iterable[float], change: Callable[[Foreground], Foreground] = lambda image: image
) -> dict[float, Method]:
    """Return DoG with each threshold in grey values as a method, from one call for each view.

    ``change`` is what is done to a foreground before.
    """
    ascending = sorted(thresholds)
    lowest = DoG(float(min(ascending, default=0.0)))
    graded = remembered(lambda view: lowest.graded(change(view.foreground)))

    def above(threshold: float, view: View) -> npt.NDArray[np.float64]:
        particles = graded(view)
        return particles[particles[:, 3] >= threshold, :3]

    return {threshold: partial(above, float(threshold)) for threshold in ascending}


def eight_bits(foreground: Foreground) -> Foreground:
    """Return a foreground rounded to 256 levels, which is what OpenCV's SIFT takes."""
    step = np.float32(65_535 / 255)
    return np.rint(foreground / step) * step


def from_cloud(clusterer: Clusterer) -> Method:
    """Return a clusterer as a method: the centre of each cluster's pixels (section 3.1)."""
    return lambda view: summarise(view.pixels, view.xyz, clusterer(view.xyz)).centers


def table_5_11_methods(
    threshold: float, roi: Polygon | None, known: Known | None = None
) -> dict[str, Method]:
    """Return the eleven methods of Table 5.11 under their printed names.

    ``threshold`` is of DoG in grey values; the combined detector detects in ``roi`` (row, col). Two
    combinations with one clusterer share its passes: their time is not that of either alone. Those
    that are ``known`` are not made again.
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
        labels = remembered(partial(_labels, passes, {} if known is None else known))
        for name, detector in detectors.items():
            methods[f"Combi {name}+{cloud}"] = partial(combined, detector, labels)
    return methods


def _labels(passes: tuple[Clusterer, Clusterer], known: Known, view: View) -> npt.NDArray[np.intp]:
    """Return the labels of both passes; equal clouds are one array, which is held with them."""
    key = passes, id(view.xyz)
    if key not in known:
        known[key] = view.xyz, second_pass(view.xyz, *passes)
    return known[key][1]


def remembered(function: Callable[[View], Any]) -> Callable[[View], Any]:
    """Return a function that keeps its last view's value, for several methods."""
    last: list[Any] = [None, None]

    def value(view: View) -> Any:
        if last[0] is not view:
            last[:] = view, function(view)
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
    """Return `run` of DoG with every threshold tried, which stands in place of the method.

    ``chosen`` is where the threshold is the one that is best on the other subsets (section
    5.1.3). ``seconds`` are not known: one call answers for all thresholds.
    """
    thresholds = tried_thresholds(scale)
    table = run(subsets, from_thresholds(thresholds), background).assign(seconds=np.nan)
    table = table.rename(columns={"method": "threshold"})
    return table.assign(chosen=table["threshold"] == table["subset"].map(leave_one_out(table)))


def tried_thresholds(scale: str) -> tuple[int, ...]:
    """Return DoG thresholds that a scale tries: all, or every fourth in a smoke run."""
    return THRESHOLDS[:: 4 if scale == "quick" else 1]


def chosen_thresholds(table: pd.DataFrame) -> pd.Series:
    """Return each subset's chosen threshold, from a table of `compare_thresholds`."""
    return table[table["chosen"]].drop_duplicates("subset").set_index("subset")["threshold"]


def leave_one_out(table: pd.DataFrame) -> dict[str, Any]:
    """Return for each subset the ``threshold`` that is best on the others (section 5.1.3).

    ``table`` is of `run`, with ``threshold`` beside; among equals the smallest is best.
    """
    subsets = list(table["subset"].unique())
    if len(subsets) < 2:
        raise InputError(f"leave_one_out: needs two subsets or more, got {subsets}.")
    chosen = {}
    for subset in subsets:
        others = sum_counts(table[table["subset"] != subset], ["threshold"])
        others = others.sort_values("threshold").set_index("threshold")
        chosen[subset] = others["f1"].idxmax()
    return chosen


def sum_counts(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return counts and rates of a table of `run`, summed over frames; columns ``by`` stay apart.

    ``tp``, ``fp``, ``fn``, ``precision``, ``recall``, ``f1`` are by the gate of 45 px (section
    3.3), ``f1_in_pixels`` by the pixels of a particle (5.1.1); in ``f1_diameter_45_px`` 45 px are
    a diameter. ``seconds_per_image`` is a median, which one delayed frame does not move.
    """
    groups = table.groupby(by, sort=False)
    counts = groups[list(COUNTS)].sum().reset_index()
    inside, near = (
        rates(*groups[[count + kind for count in COUNTS]].sum().to_numpy().T)["f1"].to_numpy()
        for kind in ("_pixels", "_near")
    )
    shares = rates(*(counts[count] for count in COUNTS)).assign(
        seconds_per_image=groups["seconds"].median().to_numpy(),
        f1_in_pixels=inside,
        f1_diameter_45_px=near,
    )
    return pd.concat([counts, shares], axis=1)


def compare_backgrounds(
    subsets: list[Subset], models: Mapping[str, BackgroundModel], scale: str
) -> pd.DataFrame:
    """Return chosen rows of `compare_thresholds` by background, with ``model``."""
    parts = []
    for name, model in models.items():
        table = compare_thresholds(subsets, scale, model)
        parts.append(table[table["chosen"]].assign(model=name))
    return pd.concat(parts, ignore_index=True)


def compare_pictures(subsets: list[Subset], scale: str) -> pd.DataFrame:
    """Return `run` of Otsu, and of DoG on foregrounds of 16 and of eight bits.

    ``method`` is Otsu, SIFT or 8 bits. ``threshold`` is that of DoG in grey values, ``chosen`` as
    in `compare_thresholds`, by what SIFT is best with on 16 bits.
    """
    thresholds = tried_thresholds(scale)
    fine, coarse = from_thresholds(thresholds), from_thresholds(thresholds, eight_bits)
    methods: dict[tuple[str, float], Method] = {("Otsu", 0): from_foreground(Otsu())}
    methods |= {("SIFT", threshold): fine[threshold] for threshold in thresholds}
    methods |= {("8 bits", threshold): coarse[threshold] for threshold in thresholds}
    table = run(subsets, methods)
    table[["method", "threshold"]] = table["method"].to_list()
    best = leave_one_out(table[table["method"] == "SIFT"])
    return table.assign(chosen=table["threshold"] == table["subset"].map(best))


def time_thresholds(subsets: list[Subset], scale: str) -> pd.DataFrame:
    """Return `run` of DoG with one threshold at a time, on every fifth frame.

    ``threshold`` stands in place of the method: those of `tried_thresholds` and of Table 5.7.
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
    settings = {
        (family, row.Index): make(row)
        for family, make in MAKERS.items()
        for row in claims.published(TABLES[family]).itertuples()
    }
    most = max(each.k for each in settings.values() if isinstance(each, QuasiClusterCenters))
    search = remembered(lambda view: nearest_neighbors(view.xyz, int(most)))
    # It detects nothing: a method for its time.
    methods: dict[Any, Method] = {SEARCH: lambda view: search(view)[:0, :2]}
    for name, each in settings.items():
        if isinstance(each, QuasiClusterCenters):
            methods[name] = partial(_spread, each, search)
        else:
            methods[name] = from_cloud(each)
    table = run(subsets, methods, UNUSED)
    table[["family", "row"]] = table["method"].to_list()
    keys, searched = ["subset", "frame"], table["method"] == SEARCH
    spent = table[searched].set_index(keys)["seconds"]
    table = table[~searched].join(spent.rename("search"), on=keys)
    table["seconds"] += table.pop("search").where(table["family"] == "qcc", 0.0)
    return table.reset_index(drop=True)


def _spread(
    clusterer: QuasiClusterCenters, search: Callable[[View], Any], view: View
) -> npt.NDArray[np.float64]:
    """Return the centres of clusters that spread among neighbours found before."""
    labels = clusterer.spread(view.xyz, search(view))
    return summarise(view.pixels, view.xyz, labels).centers


def compare_methods(
    subsets: list[Subset], thresholds: pd.Series, clouds_alone: bool = True
) -> pd.DataFrame:
    """Return `run` of the methods of Table 5.11, with each subset's DoG threshold.

    They are eleven; without those that see no picture (``clouds_alone``) eight.
    """
    parts = []
    for subset in subsets:
        threshold, roi = float(thresholds[subset.name]), subset.recording.attributes.roi
        methods = table_5_11_methods(threshold, roi, subset.known)
        if not clouds_alone:
            methods = {name: methods[name] for name in methods if not name.startswith("3D")}
        parts.append(run([subset], methods))
    return pd.concat(parts, ignore_index=True)


def morphology_readings(subsets: list[Subset], grid: int = 150) -> pd.DataFrame:
    """Return counts of morphological clustering by number of dilations and size rule.

    ``grid`` is R, by default of the best row of Table 5.9, thesis.
    """
    ends = {"none": 0, "once (this work)": 1, "twice": 2, "until unchanged": None}
    methods = {
        (name, size_rule): from_cloud(MorphologicalClustering(grid, end, size_rule))
        for size_rule in (False, True)
        for name, end in ends.items()
    }
    table = sum_counts(run(subsets, methods, UNUSED), ["method"])
    names = pd.DataFrame(table.pop("method").tolist(), columns=["dilations", "size_rule"])
    published = claims.published("table_5.9").set_index("R")["f1"][grid]
    return pd.concat([names, table.assign(f1_published=published)], axis=1)


def positions(
    subsets: Iterable[Subset], detectors: Mapping[str, Combination], wall: Cylinder | None = None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return where marked particles and detections of each subset's detector are in space.

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
        if wall:
            table["distance_mm"] = pd.Series(distance_to_axis(known, wall), known.index)
    return both
