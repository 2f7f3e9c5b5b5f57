"""Detection experiment: methods on labelled frames, counted as section 3.3 counts."""

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
from kilnflight.background import BackgroundModel, Median
from kilnflight.checks import InputError, check_columns
from kilnflight.detection.combination import Combination, Polygon, View
from kilnflight.experiments.detection_methods import THRESHOLDS, Method, from_thresholds
from kilnflight.recording.frames import PictureRecording
from kilnflight.scores import FrameScore, LabelledPixels, rates, score_detections, total_in_air
from kilnflight.twin import scenes, truth

WARM_UP_POINTS = 2000  # of the untimed first call
# How many of the ten labelled frames of which subsets each scale looks at; 10 of all five are
# the thesis's set of 50.
FRAMES = {"quick": 1, "standard": 1, "full": 10}
SMOKE_SUBSETS = ("V4", "V5")  # of a smoke run
# What is subtracted: the temporal median over 150 frames (section 5.1.2), but in a smoke run
# over few, so that few have to be rendered.
BACKGROUNDS = {"quick": Median(window=12), "standard": Median(), "full": Median()}


class Subset(NamedTuple):
    """A recording and what a person marked in some of its frames."""

    name: str
    recording: PictureRecording
    wanted: tuple[int, ...]  # frames
    particles: pd.DataFrame  # frame, particle, row, col, label; inside the region of interest
    instances: Callable[[int], npt.NDArray[np.integer]]  # frame -> (rows, cols) particle, -1
    background: BackgroundModel = BACKGROUNDS["full"]
    # Views that were looked at, 30 MB each: every one needs 150 other frames. None: not held.
    held: dict[int, View] | None = None


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
            f"ground_truth: scale {scale!r} with {frames} frames; there are {', '.join(FRAMES)}, "
            f"and up to {len(scenes.LABELLED)} labelled frames."
        )
    frames = frames or FRAMES[scale]
    found = []
    for name in SMOKE_SUBSETS if scale == "quick" else scenes.SUBSETS:
        twin, wanted = scenes.cached_scene(name, seed), tuple(scenes.LABELLED[:frames])
        instances = partial(truth.instances, twin)
        marked = truth.marked(twin, wanted)
        found.append(Subset(name, twin, wanted, marked, instances, BACKGROUNDS[scale], {}))
    return found


def run(
    subsets: Iterable[Subset],
    methods: Mapping[Any, Method],
    background: BackgroundModel | None = None,
) -> pd.DataFrame:
    """Return `count` of all subsets, with progress.

    Parameters
    ----------
    subsets
        From `labelled_subsets`.
    methods
        By name.
    background
        That of the subset if None.
    """
    parts: list[pd.DataFrame] = []
    for subset in subsets:
        frames = subset_views(subset, background)
        bar = tqdm(frames, desc=subset.name, total=len(subset.wanted), unit="frame", disable=None)
        roi = subset.recording.attributes.roi
        parts.append(count(bar, subset, methods, roi, compiled=bool(parts)))
    return pd.concat(parts, ignore_index=True)


def subset_views(
    subset: Subset, background: BackgroundModel | None = None
) -> Iterator[tuple[int, View]]:
    """Yield number and view of each wanted frame, held for the next look if the subset holds.

    Parameters
    ----------
    subset
        From `labelled_subsets`.
    background
        That of the subset if None; with another one nothing is held.
    """
    subtracted = background or subset.background
    held = subset.held if subtracted == subset.background else None
    if held is not None and all(t in held for t in subset.wanted):
        yield from ((t, held[t]) for t in subset.wanted)
        return
    for t, view in kiln.views(subset.recording, subset.wanted, subtracted):
        if held is not None:
            held[t] = view
        yield t, view


def compare_thresholds(
    subsets: list[Subset], scale: str, background: BackgroundModel | None = None
) -> pd.DataFrame:
    """Return DoG with every threshold of `THRESHOLDS`, and which one each subset is to use.

    A smoke run tries every fourth one only.

    Returns
    -------
    DataFrame
        Of `count`, the threshold in place of the method; ``chosen`` where the threshold is
        the one that is best on the other subsets (section 5.1.3). Their ``seconds`` are not
        known: one look at a frame answers for all thresholds.
    """
    some = THRESHOLDS[:: 4 if scale == "quick" else 1]
    tried = run(subsets, from_thresholds(some), background).assign(seconds=np.nan)
    return mark_chosen(tried.rename(columns={"method": "threshold"}))


def count(
    frames: Iterable[tuple[int, View]],
    subset: Subset,
    methods: Mapping[Any, Method],
    roi: Polygon | None,
    *,
    compiled: bool = False,
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
    compiled
        The methods have been called before, on another subset.

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
        if not rows and not compiled:
            _compile(methods.values(), view)
        here = subset.particles[subset.particles["frame"] == t]
        image = subset.instances(t)
        # the particles that have a pixel; most pixels show none
        shown = here["particle"][here["particle"].isin(np.unique(image[image >= 0]))].to_numpy()
        labelled = LabelledPixels.of(image, shown)
        for name, method in methods.items():
            begin = time.perf_counter()
            spots = method(view)[:, :2]
            seconds = time.perf_counter() - begin
            row = {"subset": subset.name, "frame": t, "method": name, "seconds": seconds}
            rows.append(row | _counts(here, labelled, spots, roi))
    return pd.DataFrame(rows)


def _compile(methods: Iterable[Method], view: View) -> None:
    """Call every method on a few of a view's points, so that no compiling is timed."""
    some = view._replace(pixels=view.pixels[:WARM_UP_POINTS], xyz=view.xyz[:WARM_UP_POINTS])
    for method in methods:
        method(some)


def _counts(
    here: pd.DataFrame,
    labelled: LabelledPixels,
    spots: npt.NDArray[np.float64],
    roi: Polygon | None,
) -> dict[str, int]:
    """Return the counts of a frame; ``labelled`` are its particles that have a pixel."""
    gated = score_detections(here[["row", "col"]].to_numpy(), spots, roi=roi)
    within = labelled.score(spots, roi)
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


def measured_positions(
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


def positions(
    subset: Subset, detector: Combination, background: BackgroundModel | None = None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return where a subset's marked particles and its detections are in space.

    Returns
    -------
    marked : DataFrame
        ``subset``, ``frame``, ``row``, ``col``, ``label`` and, from the cloud, ``x``, ``y``,
        ``z`` in mm (`measured_positions`).
    detected : DataFrame
        ``subset`` and `kilnflight.tables.DETECTIONS`.
    """
    marked, detected = [], []
    for t, view in subset_views(subset, background):
        here = subset.particles[subset.particles["frame"] == t]
        place = measured_positions(view, subset.instances(t), here["particle"])
        one = here[["frame", "row", "col", "label"]].reset_index(drop=True)
        marked.append(one.join(pd.DataFrame(place, columns=list("xyz"))))
        detected.append(detector(view, subset.recording.attributes.roi, t))
    tables = (pd.concat(parts, ignore_index=True) for parts in (marked, detected))
    first, second = (table.assign(subset=subset.name) for table in tables)
    return first, second


def classify_in_air(
    marked: pd.DataFrame, spots: pd.DataFrame, threshold_mm: float, roi: Polygon | None
) -> pd.DataFrame:
    """Return how well spots of a subset are told to be in the air (Tables 5.13 and 5.14).

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
    scores, flying, told = [], [], []
    for frame, here in marked.groupby("frame"):
        found = spots[spots["frame"] == frame]
        scores.append(score_detections(here[["row", "col"]], found[["row", "col"]], roi=roi))
        flying.append(((here["label"] != 4) & here["distance_mm"].notna()).to_numpy())
        told.append((found["distance_mm"] <= threshold_mm).to_numpy())
    return total_in_air(scores, flying, told)


def sum_counts(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return counts and rates summed over frames.

    Parameters
    ----------
    table
        Of `count`.
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
    f1 = rates(*(inside[name] for name in inside.columns))["f1"].to_numpy()
    median = groups["seconds"].median().to_numpy()
    more = {"seconds_per_image": median, "f1_in_pixels": f1}
    together = rates(counts["tp"], counts["fp"], counts["fn"]).assign(**more)
    return pd.concat([counts, together], axis=1)


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
        Of `count`, with a column ``parameter`` beside.

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


def mark_chosen(tried: pd.DataFrame) -> pd.DataFrame:
    """Return a table of `count` by ``threshold`` with ``chosen``; see `compare_thresholds`."""
    best = leave_one_out(tried, "threshold").set_index("subset")["threshold"]
    return tried.assign(chosen=tried["threshold"] == tried["subset"].map(best))


def resampled_f1(
    table: pd.DataFrame, generator: np.random.Generator, draws: int = 2000
) -> pd.DataFrame:
    """Return F1 of every method over draws of frames with replacement, subset by subset.

    Parameters
    ----------
    table
        Of `count`; every method on the same frames.
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
