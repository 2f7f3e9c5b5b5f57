"""Detectors on labelled frames, counted as chapter 3.3 counts: the detection experiment.

views of labelled frames x methods -> one row per frame and method -> sums, rates, intervals
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from tqdm import tqdm

from kilnflight.background import BackgroundModel, Median, TwoFrame
from kilnflight.background.window import Frames
from kilnflight.checks import InputError, check_columns
from kilnflight.combination import Combination, Polygon, View, second_pass
from kilnflight.correspondence import summarise
from kilnflight.detection import (
    DBSCAN,
    Clusterer,
    Detector2D,
    DoG,
    MorphologicalClustering,
    Otsu,
    QuasiClusterCenters,
)
from kilnflight.frames import PictureRecording
from kilnflight.kiln import views
from kilnflight.scores import FrameScore, rates, score_detections, score_in_pixels, total_in_air
from kilnflight.twin import truth
from kilnflight.twin.scenes import open_scene

# Thresholds of DoG that are tried, in grey values: two per octave, from below the noise of one
# frame to beyond the brightest flames. The exposure of the thesis is not known (twin.md).
THRESHOLDS = tuple(round(100 * 2 ** (k / 2)) for k in range(12))
POINTS = 2000  # of the untimed first call
Method = Callable[[View], npt.NDArray[np.float64]]  # -> (n, 2 or more) row, col


class Subset(NamedTuple):
    """A recording and what a person marked in some of its frames."""

    name: str
    recording: PictureRecording
    wanted: tuple[int, ...]  # frames
    particles: pd.DataFrame  # frame, particle, row, col, label; inside the region of interest
    instances: Callable[[int], npt.NDArray[np.integer]]  # frame -> (rows, cols) particle, -1


# How many of the ten labelled frames of which subsets each scale looks at; 10 of all five are
# the thesis's set of 50.
FRAMES = {"quick": 1, "standard": 2, "full": 10}
FEWER = ("V4", "V5")  # of a smoke run


def ground_truth(scale: str, seed: int = 0, frames: int = 0) -> list[Subset]:
    """Return the subsets of the twin, each with its first labelled frames.

    Parameters
    ----------
    scale
        "quick" (two subsets), "standard" or "full".
    seed
        Of the scenes.
    frames
        How many labelled frames of each; 0: 1, 2 or 10 by scale.
    """
    if scale not in FRAMES or not 0 <= frames <= len(truth.LABELLED):
        raise InputError(
            f"ground_truth: scale {scale!r} with {frames} frames; there are {', '.join(FRAMES)}, "
            f"and up to {len(truth.LABELLED)} labelled frames."
        )
    frames = frames or FRAMES[scale]
    found = []
    for name in FEWER if scale == "quick" else truth.SUBSETS:
        twin, wanted = open_scene(name, seed), tuple(truth.LABELLED[:frames])
        instances = partial(truth.instances, twin)
        found.append(Subset(name, twin, wanted, truth.marked(twin, wanted), instances))
    return found


def by_picture(detector: Detector2D) -> Method:
    """Return a 2D detector as a method."""
    return lambda view: detector(view.foreground)


def by_cloud(clusterer: Clusterer) -> Method:
    """Return a clusterer as a method: the centre of each cluster's pixels (section 3.1)."""

    def centers(view: View) -> npt.NDArray[np.float64]:
        clusters = summarise(view.pixels, view.xyz, clusterer(view.xyz))
        return np.column_stack([clusters.row, clusters.col])

    return centers


def by_both(combination: Combination, roi: Polygon | None) -> Method:
    """Return a combined detector as a method; it looks at the region of interest only."""
    return lambda view: combination(view, roi)[["row", "col"]].to_numpy()


# First and second pass of the combination (section 5.1.3); DBSCAN's first pass is printed as
# the set of highest precision, which 15 points in 70 mm is (Table 5.8).
PASSES: dict[str, tuple[Clusterer, Clusterer]] = {
    "DBSCAN": (DBSCAN(eps=50.0, min_points=10), DBSCAN(eps=15.0, min_points=10)),
    "MO": (MorphologicalClustering(100), MorphologicalClustering(400)),
    "QCC": (QuasiClusterCenters(35, 0.1), QuasiClusterCenters(20, 0.2)),
}


def eleven(threshold: float, roi: Polygon | None) -> dict[str, Method]:
    """Return the eleven methods of Table 5.11 under their printed names.

    Parameters
    ----------
    threshold
        Of DoG, in grey values.
    roi
        Polygon (row, col) that the combined detector looks at.

    Notes
    -----
    The two combinations with one clusterer share its passes over a frame; their time is not
    that of either alone.
    """
    pictures: dict[str, Detector2D] = {"OTSU": Otsu(), "SIFT": DoG(threshold)}
    methods = {f"2D-{name}": by_picture(one) for name, one in pictures.items()}
    methods["3D-DBSCAN Clustering"] = by_cloud(DBSCAN(eps=50.0, min_points=10))
    methods["3D-MO-based Clustering"] = by_cloud(MorphologicalClustering(150))
    methods["3D-QCC Clustering"] = by_cloud(QuasiClusterCenters(30, 0.1))
    for cloud, passes in PASSES.items():
        share = _Shared(*passes)
        for name, detector in pictures.items():
            methods[f"Combi {name}+{cloud}"] = partial(_combined, detector, share, roi)
    return methods


class _Shared:
    """Labels of the last view that was asked for."""

    def __init__(self, wall: Clusterer, clusterer: Clusterer) -> None:
        self.passes = (wall, clusterer)
        self.last: tuple[View, npt.NDArray[np.intp]] | None = None

    def __call__(self, view: View) -> npt.NDArray[np.intp]:
        if self.last is None or self.last[0] is not view:
            self.last = (view, second_pass(view.xyz, *self.passes))
        return self.last[1]


def _combined(
    detector: Detector2D, share: _Shared, roi: Polygon | None, view: View
) -> npt.NDArray[np.float64]:
    found = Combination(detector).decide(view, detector(view.foreground), share(view), roi)
    return found[["row", "col"]].to_numpy()


def run(
    subsets: Iterable[Subset],
    methods: Mapping[Any, Method],
    background: BackgroundModel | None = None,
) -> pd.DataFrame:
    """Return `attempt` of all subsets, with progress.

    Parameters
    ----------
    subsets
        From `ground_truth`.
    methods
        By name.
    background
        The temporal median over 150 frames if None.
    """
    parts = []
    for subset in subsets:
        frames = views(subset.recording, subset.wanted, background)
        bar = tqdm(frames, desc=subset.name, total=len(subset.wanted), unit="frame", disable=None)
        parts.append(attempt(bar, subset, methods, subset.recording.attributes.roi))
    return pd.concat(parts, ignore_index=True)


@dataclass(frozen=True)
class Unsigned:
    """A background subtracted as unsigned integers are: what is darker than it becomes 0.

    Not in the thesis, which prints absolute differences (Eqs 2.5 and 2.10). Subtraction of
    16-bit images in MATLAB, which it used, stops at 0, and an absolute value taken afterwards
    changes nothing; this shows what that would do.
    """

    model: TwoFrame | Median

    def __call__(self, frames: Frames, indices: Iterable[int]) -> Iterator[npt.NDArray[np.float32]]:
        """Yield the foreground (rows, cols) of each wanted frame."""
        wanted = list(indices)
        behind: Iterable[npt.NDArray[Any]]
        if isinstance(self.model, TwoFrame):
            step = self.model.interval
            behind = (frames[t - step if t >= step else t + step] for t in wanted)
        else:
            behind = self.model.backgrounds(frames, wanted)
        for t, background in zip(wanted, behind, strict=True):
            difference = np.asarray(frames[t], dtype=np.float32) - background
            yield np.maximum(difference, 0.0).astype(np.float32, copy=False)


def thresholds(
    subsets: list[Subset], scale: str, background: BackgroundModel | None = None
) -> pd.DataFrame:
    """Return DoG with every threshold of `THRESHOLDS`, and which one each subset is to use.

    A smoke run tries every fourth one only.

    Returns
    -------
    DataFrame
        Of `attempt`, the threshold in place of the method; ``chosen`` where the threshold is
        the one that is best on the other subsets (section 5.1.3).
    """
    some = THRESHOLDS[:: 4 if scale == "quick" else 1]
    methods = {threshold: by_picture(DoG(float(threshold))) for threshold in some}
    return marked_best(run(subsets, methods, background).rename(columns={"method": "threshold"}))


def marked_best(tried: pd.DataFrame) -> pd.DataFrame:
    """Return a table of `attempt` by ``threshold`` with ``chosen``; see `thresholds`."""
    best = leave_one_out(tried, "threshold").set_index("subset")["threshold"]
    return tried.assign(chosen=tried["threshold"] == tried["subset"].map(best))


def attempt(
    frames: Iterable[tuple[int, View]],
    subset: Subset,
    methods: Mapping[Any, Method],
    roi: Polygon | None,
) -> pd.DataFrame:
    """Return how each method does on each frame.

    Parameters
    ----------
    frames
        Number and view of each, from `kilnflight.kiln.views`.
    subset
        The truth about them.
    methods
        By name.
    roi
        Polygon (row, col) outside which nothing counts (section 5.1.2).

    Returns
    -------
    DataFrame
        One row per frame and method: ``subset``, ``frame``, ``method``; ``tp``, ``fp``,
        ``fn`` by the gate of 45 px (section 3.3) and ``tp_pixels``, ``fp_pixels``,
        ``fn_pixels`` within the pixels of a particle (5.1.1); ``found_2``, ``marked_2`` ...
        per class; ``seconds``, of compiled code: every method is called once before.
    """
    check_columns(subset.particles, ["frame", "particle", "row", "col", "label"], subset.name)
    rows: list[dict[str, Any]] = []
    for t, view in frames:
        if not rows:
            _compile(methods.values(), view)
        here = subset.particles[subset.particles["frame"] == t]
        image = subset.instances(t)
        for name, method in methods.items():
            begin = time.perf_counter()
            spots = method(view)[:, :2]
            seconds = time.perf_counter() - begin
            row = {"subset": subset.name, "frame": t, "method": name, "seconds": seconds}
            rows.append(row | _counts(here, image, spots, roi))
    return pd.DataFrame(rows)


def _compile(methods: Iterable[Method], view: View) -> None:
    """Call every method on a few of a view's points, so that no compiling is timed."""
    some = view._replace(pixels=view.pixels[:POINTS], xyz=view.xyz[:POINTS])
    for method in methods:
        method(some)


def _counts(
    here: pd.DataFrame,
    image: npt.NDArray[np.integer],
    spots: npt.NDArray[np.float64],
    roi: Polygon | None,
) -> dict[str, int]:
    gated = score_detections(here[["row", "col"]].to_numpy(), spots, roi=roi)
    shown = here["particle"][here["particle"].isin(np.unique(image))].to_numpy()
    within = score_in_pixels(image, shown, spots, roi=roi)
    label = here["label"].to_numpy()
    hit = label[gated.pairs[:, 0]]
    counts = {"tp": gated.tp, "fp": gated.fp, "fn": gated.fn}
    counts |= {f"{name}_pixels": getattr(within, name) for name in ("tp", "fp", "fn")}
    for kind in truth.CLASSES:
        counts[f"found_{kind}"] = int((hit == kind).sum())
        counts[f"marked_{kind}"] = int((label[_taking_part(gated)] == kind).sum())
    return counts


def _taking_part(score: FrameScore) -> npt.NDArray[np.intp]:
    return np.concatenate([score.pairs[:, 0], score.missed])


def measured_places(
    view: View, image: npt.NDArray[np.integer], particles: npt.ArrayLike
) -> npt.NDArray[np.float64]:
    """Return where the cloud has marked particles: mean of the points in their pixels.

    Parameters
    ----------
    view
        One frame.
    image
        (rows, cols) which particle each pixel shows.
    particles
        (n,) wanted.

    Returns
    -------
    ndarray
        (n, 3) mm; a row of NaN where a particle has no point, so no 3D (section 5.1.1).
    """
    shown = image[view.pixels[:, 0], view.pixels[:, 1]]
    points = pd.DataFrame(view.xyz, columns=list("xyz"))
    means = points.groupby(shown).mean()
    return means.reindex(np.asarray(particles)).to_numpy()


def located(
    subset: Subset, detector: Combination, background: BackgroundModel | None = None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return where a subset's marked particles and its detections are in space.

    Returns
    -------
    marked : DataFrame
        ``subset``, ``frame``, ``row``, ``col``, ``label`` and, from the cloud, ``x``, ``y``,
        ``z`` in mm (`measured_places`).
    detected : DataFrame
        ``subset`` and `kilnflight.tables.DETECTIONS`.
    """
    marked, detected = [], []
    for t, view in views(subset.recording, subset.wanted, background):
        here = subset.particles[subset.particles["frame"] == t]
        place = measured_places(view, subset.instances(t), here["particle"])
        one = here[["frame", "row", "col", "label"]].reset_index(drop=True)
        marked.append(one.join(pd.DataFrame(place, columns=list("xyz"))))
        detected.append(detector(view, subset.recording.attributes.roi, t))
    tables = (pd.concat(parts, ignore_index=True) for parts in (marked, detected))
    first, second = (table.assign(subset=subset.name) for table in tables)
    return first, second


def told_apart(
    marked: pd.DataFrame, spots: pd.DataFrame, threshold_mm: float, roi: Polygon | None
) -> pd.DataFrame:
    """Return how well spots of a subset are told to be in the air (Tables 5.13 and 5.14).

    Parameters
    ----------
    marked
        Of `located`, with ``distance_mm`` from the axis (NaN: no 3D, not considered).
    spots
        Detections with the same columns; for Table 5.13 the marked particles themselves.
    threshold_mm
        Up to which distance a spot is in the air.
    roi
        Polygon (row, col) outside which nothing counts.

    Returns
    -------
    DataFrame
        One row: ``tp``, ``fp``, ``fn``, ``precision``, ``recall``, ``f1``.
    """
    scores, flying, told = [], [], []
    for frame, here in marked.groupby("frame"):
        found = spots[spots["frame"] == frame]
        scores.append(score_detections(here[["row", "col"]], found[["row", "col"]], roi=roi))
        flying.append(((here["label"] != 4) & here["distance_mm"].notna()).to_numpy())
        told.append((found["distance_mm"] <= threshold_mm).to_numpy())
    return total_in_air(scores, flying, told)


def sums(table: pd.DataFrame, by: list[str], criterion: str = "") -> pd.DataFrame:
    """Return counts and rates summed over frames.

    Parameters
    ----------
    table
        Of `attempt`.
    by
        Columns that stay apart.
    criterion
        "" for the gate of 45 px, "_pixels" for the pixels of a particle.

    Returns
    -------
    DataFrame
        ``by``, ``tp``, ``fp``, ``fn``, ``precision``, ``recall``, ``f1``, and the mean
        ``seconds_per_image``.
    """
    names = {f"{name}{criterion}": name for name in ("tp", "fp", "fn")}
    groups = table.groupby(by, sort=False)
    counts = groups[list(names)].sum().rename(columns=names).reset_index()
    mean = groups["seconds"].mean().to_numpy()
    together = rates(counts["tp"], counts["fp"], counts["fn"])
    return pd.concat([counts, together], axis=1).assign(seconds_per_image=mean)


def class_recall(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return the recall of each class: ``by``, ``label``, ``tp``, ``fn``, ``recall``."""
    parts = []
    for label in truth.CLASSES:
        names = {f"found_{label}": "tp", f"marked_{label}": "marked"}
        one = table.groupby(by, sort=False)[list(names)].sum().rename(columns=names).reset_index()
        missed = one["marked"] - one["tp"]
        recall = rates(one["tp"], 0 * missed, missed)["recall"].where(one["marked"] > 0)
        parts.append(
            one.drop(columns="marked").assign(label=label, fn=missed, recall=recall.to_numpy())
        )
    return pd.concat(parts, ignore_index=True)[[*by, "label", "tp", "fn", "recall"]]


def leave_one_out(table: pd.DataFrame, parameter: str) -> pd.DataFrame:
    """Return for each subset the parameter that is best on the others (section 5.1.3).

    Parameters
    ----------
    table
        Of `attempt`, with a column ``parameter`` beside.

    Returns
    -------
    DataFrame
        ``subset`` and ``parameter``; among equals the smallest.
    """
    subsets = list(table["subset"].unique())
    if len(subsets) < 2:
        raise InputError(f"leave_one_out: needs two subsets or more, got {subsets}.")
    chosen = []
    for subset in subsets:
        others = sums(table[table["subset"] != subset], [parameter]).sort_values(parameter)
        best = others[parameter].to_numpy()[int(np.argmax(others["f1"].to_numpy()))]
        chosen.append({"subset": subset, parameter: best})
    return pd.DataFrame(chosen)


def resampled_f1(
    table: pd.DataFrame, generator: np.random.Generator, draws: int = 2000
) -> pd.DataFrame:
    """Return F1 of every method over draws of frames with replacement, subset by subset.

    Parameters
    ----------
    table
        Of `attempt`; every method on the same frames.
    generator
        Of the draws; all methods see the same draws, so that differences are paired.

    Returns
    -------
    DataFrame
        (draws, methods), a column per method.
    """
    wide = table.pivot(index=["subset", "frame"], columns="method", values=["tp", "fp", "fn"])
    if wide.isna().to_numpy().any():
        raise InputError("resampled_f1: a method lacks a frame; give all methods all frames.")
    position = wide.reset_index().groupby("subset", sort=False).indices
    picked = np.concatenate(
        [generator.choice(rows, (draws, len(rows))) for rows in position.values()], axis=1
    )
    tp, fp, fn = (wide[name].to_numpy()[picked].sum(axis=1) for name in ("tp", "fp", "fn"))
    return pd.DataFrame(2 * tp / np.maximum(2 * tp + fp + fn, 1), columns=wide["tp"].columns)
