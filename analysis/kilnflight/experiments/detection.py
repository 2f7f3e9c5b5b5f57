"""Detection experiment: methods on labelled frames, counted as section 3.3 counts.

labelled frames -> views x methods (`detection_methods`) -> one row per frame and method
    -> summed counts, rates, recall by class, best parameter, intervals
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from tqdm import tqdm

from kilnflight import kiln
from kilnflight.background import BackgroundModel, Median
from kilnflight.checks import InputError, check_columns
from kilnflight.detection.combination import Combination, Polygon, View
from kilnflight.experiments.detection_methods import THRESHOLDS, Method, from_thresholds
from kilnflight.recording.frames import PictureRecording
from kilnflight.scores import rates, score_detections, score_in_pixels, total_in_air
from kilnflight.scores.detections import FrameScore, particle_centroids
from kilnflight.twin import scenes, truth

WARM_UP_POINTS = 2000  # of the untimed first call
# Labelled frames per subset by scale; 10 of all five subsets are the thesis's set of 50.
FRAMES = {"quick": 1, "standard": 1, "full": 10}
SMOKE_SUBSETS = ("V4", "V5")  # of a smoke run
# The temporal median over 150 frames (section 5.1.2); in a smoke run over few, so that few
# have to be rendered.
BACKGROUNDS = {"quick": Median(window=12), "standard": Median(), "full": Median()}


class Subset(NamedTuple):
    """A recording and what a person marked in some of its frames."""

    name: str
    recording: PictureRecording
    frames: tuple[int, ...]
    particles: pd.DataFrame  # frame, particle, row, col, label; inside the region of interest
    instances: Callable[[int], npt.NDArray[np.integer]]  # frame -> (rows, cols) particle, -1
    background: BackgroundModel = BACKGROUNDS["full"]
    # Views that were made, 30 MB each: every one needs 150 other frames. None: not held.
    cache: dict[int, View] | None = None


def labelled_subsets(scale: str, seed: int = 0, frames: int = 0) -> list[Subset]:
    """Return the subsets of the twin, each with its first labelled frames.

    Parameters
    ----------
    scale
        "quick" (two subsets), "standard" or "full".
    seed
        Of the scenes.
    frames
        How many labelled frames of each; 0: 1, 1 or 10 by scale.
    """
    if scale not in FRAMES or not 0 <= frames <= len(scenes.LABELLED):
        raise InputError(
            f"labelled_subsets: scale {scale!r} with {frames} frames; there are "
            f"{', '.join(FRAMES)}, and up to {len(scenes.LABELLED)} labelled frames."
        )
    labelled = tuple(scenes.LABELLED[: frames or FRAMES[scale]])
    subsets = []
    for name in SMOKE_SUBSETS if scale == "quick" else scenes.SUBSETS:
        twin = scenes.cached_scene(name, seed)
        marked, instances = truth.marked(twin, labelled), partial(truth.instances, twin)
        subsets.append(Subset(name, twin, labelled, marked, instances, BACKGROUNDS[scale], {}))
    return subsets


def run(
    subsets: Iterable[Subset],
    methods: Mapping[Any, Method],
    background: BackgroundModel | None = None,
) -> pd.DataFrame:
    """Return how each method does on each frame of all subsets, with progress.

    Parameters
    ----------
    subsets
        From `labelled_subsets`.
    methods
        By name.
    background
        That of the subset if None.

    Returns
    -------
    DataFrame
        One row per frame and method: ``subset``, ``frame``, ``method``; ``tp``, ``fp``,
        ``fn`` by the gate of 45 px (section 3.3) and ``tp_pixels``, ``fp_pixels``,
        ``fn_pixels`` within the pixels of a particle (5.1.1); ``found_2``, ``marked_2`` ...
        per class; ``seconds``, of compiled code: every method is called once before.
    """
    rows: list[dict[str, Any]] = []
    for subset in subsets:
        check_columns(subset.particles, ["frame", "particle", "row", "col", "label"], subset.name)
        views = subset_views(subset, background)
        bar = tqdm(views, desc=subset.name, total=len(subset.frames), unit="frame", disable=None)
        for t, view in bar:
            if not rows:  # compile on a few of the points, so that no compiling is timed
                for method in methods.values():
                    method(
                        view._replace(
                            pixels=view.pixels[:WARM_UP_POINTS], xyz=view.xyz[:WARM_UP_POINTS]
                        )
                    )
            rows += _frame_rows(subset, t, view, methods)
    return pd.DataFrame(rows)


def _frame_rows(
    subset: Subset, t: int, view: View, methods: Mapping[Any, Method]
) -> list[dict[str, Any]]:
    here = subset.particles[subset.particles["frame"] == t]
    image, roi = subset.instances(t), subset.recording.attributes.roi
    # the particles that have a pixel; most pixels show none
    shown = here["particle"][here["particle"].isin(np.unique(image[image >= 0]))].to_numpy()
    centroids = particle_centroids(image, shown)
    rows = []
    for name, method in methods.items():
        begin = time.perf_counter()
        spots = method(view)[:, :2]
        seconds = time.perf_counter() - begin
        row = {"subset": subset.name, "frame": t, "method": name, "seconds": seconds}
        pixels = score_in_pixels(image, centroids, spots, roi)
        rows.append(row | _counts(here, pixels, spots, roi))
    return rows


def _counts(
    here: pd.DataFrame,
    pixels: FrameScore,
    spots: npt.NDArray[np.float64],
    roi: Polygon | None,
) -> dict[str, int]:
    """Return the counts of a frame; ``pixels`` is the score by the pixels of its particles."""
    gated = score_detections(here[["row", "col"]].to_numpy(), spots, roi=roi)
    label = here["label"].to_numpy()
    found, marked = label[gated.pairs[:, 0]], label[_counted(gated)]
    counts = {"tp": gated.tp, "fp": gated.fp, "fn": gated.fn}
    counts |= {f"{name}_pixels": getattr(pixels, name) for name in ("tp", "fp", "fn")}
    for kind in truth.CLASSES:
        counts[f"found_{kind}"] = int((found == kind).sum())
        counts[f"marked_{kind}"] = int((marked == kind).sum())
    return counts


def _counted(score: FrameScore) -> npt.NDArray[np.intp]:
    """Return which true particles count: those found and those missed inside of the region."""
    return np.concatenate([score.pairs[:, 0], score.missed])


def subset_views(
    subset: Subset, background: BackgroundModel | None = None
) -> Iterator[tuple[int, View]]:
    """Yield number and view of each labelled frame, from the subset's cache if they are there.

    Parameters
    ----------
    subset
        From `labelled_subsets`.
    background
        That of the subset if None; with another one nothing is cached.
    """
    subtracted = background or subset.background
    cache = subset.cache if subtracted == subset.background else None
    if cache is not None and all(t in cache for t in subset.frames):
        yield from ((t, cache[t]) for t in subset.frames)
        return
    for t, view in kiln.views(subset.recording, subset.frames, subtracted):
        if cache is not None:
            cache[t] = view
        yield t, view


def compare_thresholds(
    subsets: list[Subset], scale: str, background: BackgroundModel | None = None
) -> pd.DataFrame:
    """Return DoG with every threshold of `THRESHOLDS`, and which one each subset is to use.

    A smoke run tries every fourth one only.

    Returns
    -------
    DataFrame
        Of `run`, the threshold in place of the method; ``chosen`` where the threshold is
        the one that is best on the other subsets (section 5.1.3). Their ``seconds`` are not
        known: one call answers for all thresholds.
    """
    thresholds = THRESHOLDS[:: 4 if scale == "quick" else 1]
    table = run(subsets, from_thresholds(thresholds), background).assign(seconds=np.nan)
    return mark_chosen(table.rename(columns={"method": "threshold"}))


def mark_chosen(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of `run` by ``threshold`` with ``chosen``; see `compare_thresholds`."""
    best = leave_one_out(table, "threshold").set_index("subset")["threshold"]
    return table.assign(chosen=table["threshold"] == table["subset"].map(best))


def chosen_thresholds(table: pd.DataFrame) -> pd.Series:
    """Return the chosen threshold of each subset, from a table of `compare_thresholds`."""
    chosen = table[table["chosen"]].drop_duplicates("subset")
    return chosen.set_index("subset")["threshold"]


def leave_one_out(table: pd.DataFrame, parameter: str) -> pd.DataFrame:
    """Return for each subset the parameter that is best on the others (section 5.1.3).

    Parameters
    ----------
    table
        Of `run`, with a column ``parameter`` beside.

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
        others = sum_counts(table[table["subset"] != subset], [parameter]).sort_values(parameter)
        best = others[parameter].to_numpy()[int(np.argmax(others["f1"].to_numpy()))]
        chosen.append({"subset": subset, parameter: best})
    return pd.DataFrame(chosen)


def sum_counts(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return counts and rates summed over frames.

    Parameters
    ----------
    table
        Of `run`.
    by
        Columns that stay apart.

    Returns
    -------
    DataFrame
        ``by``, ``tp``, ``fp``, ``fn``, ``precision``, ``recall``, ``f1`` by the gate of 45 px
        (section 3.3); the median ``seconds_per_image``, which one frame that a busy machine
        delayed does not move; and ``f1_in_pixels`` by the pixels of a particle (5.1.1).
    """
    groups = table.groupby(by, sort=False)
    counts = groups[["tp", "fp", "fn"]].sum().reset_index()
    inside = groups[["tp_pixels", "fp_pixels", "fn_pixels"]].sum()
    together = rates(counts["tp"], counts["fp"], counts["fn"]).assign(
        seconds_per_image=groups["seconds"].median().to_numpy(),
        f1_in_pixels=rates(*(inside[name] for name in inside.columns))["f1"].to_numpy(),
    )
    return pd.concat([counts, together], axis=1)


def with_total(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return `sum_counts` by subset, and below them those of all subsets, "Total"."""
    total = sum_counts(table.assign(subset="Total"), [name for name in by if name != "threshold"])
    return pd.concat([sum_counts(table, by), total], ignore_index=True)


def precision_by_case(
    subsets: Iterable[Subset], detectors: Mapping[str, Combination]
) -> pd.DataFrame:
    """Return how many detections of each case are paired with a marked particle.

    Parameters
    ----------
    subsets
        From `labelled_subsets`.
    detectors
        The combined detector of each subset.

    Returns
    -------
    DataFrame
        ``case``, ``detections``, ``right``, ``precision``.
    """
    parts = []
    for subset in subsets:
        roi = subset.recording.attributes.roi
        for t, view in subset_views(subset):
            here = subset.particles[subset.particles["frame"] == t]
            table = detectors[subset.name](view, roi, t)
            score = score_detections(here[["row", "col"]], table[["row", "col"]], roi=roi)
            right = np.isin(np.arange(len(table)), score.pairs[:, 1])
            parts.append(table[["case"]].assign(right=right))
    groups = pd.concat(parts).groupby("case")["right"]
    counts = groups.agg(detections="size", right="sum")
    return counts.assign(precision=counts["right"] / counts["detections"]).reset_index()


def background_traces(
    subset: Subset,
    t: int,
    backgrounds: Mapping[str, npt.NDArray[np.floating]],
    clean: npt.NDArray[np.floating],
) -> dict[str, float]:
    """Return how far backgrounds of frame t are from the scene without any particle, ``clean``.

    Root mean square in grey values over pixels that hold a particle in one of the frames
    around, but not now.
    """
    around = range(t - 25, t + 26, 5)
    marked = np.any([subset.instances(k) >= 0 for k in around], axis=0)
    trace = marked & ~(subset.instances(t) >= 0)
    return {
        name: float(np.sqrt(np.mean((image - clean)[trace] ** 2)))
        for name, image in backgrounds.items()
    }


def class_recall(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return the recall of each class: ``by``, ``label``, ``tp``, ``fn``, ``recall``."""
    parts = []
    for label in truth.CLASSES:
        names = {f"found_{label}": "tp", f"marked_{label}": "marked"}
        part = table.groupby(by, sort=False)[list(names)].sum().rename(columns=names).reset_index()
        missed = part["marked"] - part["tp"]
        recall = rates(part["tp"], 0 * missed, missed)["recall"].where(part["marked"] > 0)
        parts.append(part.assign(label=label, fn=missed, recall=recall.to_numpy()))
    return pd.concat(parts, ignore_index=True)[[*by, "label", "tp", "fn", "recall"]]


def resampled_f1(
    table: pd.DataFrame, generator: np.random.Generator, draws: int = 2000
) -> pd.DataFrame:
    """Return F1 of every method over draws of frames with replacement, subset by subset.

    Parameters
    ----------
    table
        Of `run`; every method on the same frames.
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


def positions(
    subset: Subset, detector: Combination, background: BackgroundModel | None = None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return where a subset's marked particles and its detections are in space.

    Returns
    -------
    marked : DataFrame
        ``subset``, ``frame``, ``row``, ``col``, ``label`` and ``x``, ``y``, ``z`` in mm: the
        mean of the points in the particle's pixels; NaN without a point, so no 3D (5.1.1).
    detected : DataFrame
        ``subset`` and `kilnflight.tables.DETECTIONS`.
    """
    marked, detected = [], []
    for t, view in subset_views(subset, background):
        here = subset.particles[subset.particles["frame"] == t]
        shown = subset.instances(t)[view.pixels[:, 0], view.pixels[:, 1]]
        means = pd.DataFrame(view.xyz, columns=list("xyz")).groupby(shown).mean()
        part = here[["frame", "row", "col", "label"]].reset_index(drop=True)
        marked.append(part.join(means.reindex(here["particle"].to_numpy()).reset_index(drop=True)))
        detected.append(detector(view, subset.recording.attributes.roi, t))
    tables = (pd.concat(parts, ignore_index=True) for parts in (marked, detected))
    first, second = (table.assign(subset=subset.name) for table in tables)
    return first, second


def classification_table(
    marked: Sequence[pd.DataFrame],
    spots: Sequence[pd.DataFrame],
    thresholds: Mapping[str, float],
    roi: Polygon | None,
) -> pd.DataFrame:
    """Return `classify_in_air` of all subsets and in total, with each threshold.

    Returns
    -------
    DataFrame
        ``threshold``, ``threshold_mm``, ``subset``, ``tp``, ``fp``, ``fn``, ``precision``,
        ``recall``, ``f1``.
    """
    rows = []
    for (name, level), (labelled, detected) in product(
        thresholds.items(), zip(marked, spots, strict=True)
    ):
        counts = classify_in_air(labelled, detected, level, roi)[["tp", "fp", "fn"]].astype(int)
        subset = labelled["subset"].iloc[0]
        rows.append(counts.assign(threshold=name, threshold_mm=level, subset=subset))
    table = pd.concat(rows, ignore_index=True)
    both, keys = pd.concat([table, table.assign(subset="Total")]), ["threshold", "threshold_mm"]
    counts = both.groupby([*keys, "subset"], sort=False)[["tp", "fp", "fn"]].sum().reset_index()
    return pd.concat([counts, rates(counts["tp"], counts["fp"], counts["fn"])], axis=1)


def classify_in_air(
    marked: pd.DataFrame, spots: pd.DataFrame, threshold_mm: float, roi: Polygon | None
) -> pd.DataFrame:
    """Return how well spots of a subset are classified as in the air (Tables 5.13 and 5.14).

    Parameters
    ----------
    marked
        Of `positions`, with ``distance_mm`` from the axis (NaN: no 3D, not considered).
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
    scores, flying, classified = [], [], []
    for frame, here in marked.groupby("frame"):
        there = spots[spots["frame"] == frame]
        scores.append(score_detections(here[["row", "col"]], there[["row", "col"]], roi=roi))
        flying.append(((here["label"] != 4) & here["distance_mm"].notna()).to_numpy())
        classified.append((there["distance_mm"] <= threshold_mm).to_numpy())
    return total_in_air(scores, flying, classified)
