"""Detection experiment: methods on labelled frames, counted as in section 3.3.

labelled frames -> views x methods (`detection_methods`) -> one row per frame and method
    -> summed counts, rates, recall by class, best parameter
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
from kilnflight.detection import Polygon
from kilnflight.detection.combination import Combination, View
from kilnflight.detection.wall import Cylinder, distance_to_axis
from kilnflight.experiments.detection_methods import THRESHOLDS, Method, from_thresholds
from kilnflight.project import claims
from kilnflight.recording.frames import Recording
from kilnflight.scores import count_in_air, rates, score_detections, score_in_pixels
from kilnflight.scores.detections import GATE_PX, NEAR_GATE_PX, FrameScore, particle_centroids
from kilnflight.twin import scenes, truth
from kilnflight.twin.scene import Twin

COUNTS = ("tp", "fp", "fn")
# Two readings of the 45 px (`kilnflight.scores.detections`): the largest distance, or a diameter.
GATES = {"": GATE_PX, "_near": NEAR_GATE_PX}
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
    recording: Recording
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
    labelled = scenes.LABELLED[: frames or FRAMES[scale]]
    names = SMOKE_SUBSETS if scale == "quick" else scenes.SUBSETS
    twins = [scenes.cached_scene(name, seed) for name in names]
    return [labelled_subset(twin, labelled, BACKGROUNDS[scale]) for twin in twins]


def labelled_subset(twin: Twin, frames: Sequence[int], background: BackgroundModel) -> Subset:
    """Return a twin's recording with the particles a person would mark in frames."""
    marked, instances = truth.marked(twin, frames), partial(truth.instances, twin)
    return Subset(twin.scene.name, twin, tuple(frames), marked, instances, background, {})


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
                for method in methods.values():
                    method(view._replace(pixels=pixels, xyz=xyz))
            rows += _frame_rows(subset, t, view, methods)
    return pd.DataFrame(rows)


def _frame_rows(
    subset: Subset, t: int, view: View, methods: Mapping[Any, Method]
) -> list[dict[str, Any]]:
    particles = subset.particles[subset.particles["frame"] == t]
    place, label = particles[["row", "col"]].to_numpy(), particles["label"].to_numpy()
    image, roi = subset.instances(t), subset.recording.attributes.roi
    # the particles that have a pixel; most pixels show none
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
            counts = _counted(score_detections(place, spots, gate, roi), label)
            row |= {name + suffix: count for name, count in counts.items()}
        rows.append(row)
    return rows


def _counted(scored: FrameScore, label: npt.NDArray[np.integer]) -> dict[str, int]:
    counts = {count: getattr(scored, count) for count in COUNTS}
    for kind in truth.CLASSES:
        counts[f"tp_{kind}"] = int((label[scored.pairs[:, 0]] == kind).sum())
        counts[f"fn_{kind}"] = int((label[scored.missed] == kind).sum())
    return counts


def subset_views(
    subset: Subset, background: BackgroundModel | None = None
) -> Iterator[tuple[int, View]]:
    """Return number and view of each labelled frame, if possible from the cache.

    The cache is the subset's.

    Parameters
    ----------
    subset
        From `labelled_subsets`.
    background
        That of the subset if None; with another one nothing is cached.
    """
    subtracted = background or subset.background
    views = kiln.views(subset.recording, subset.frames, subtracted)
    if subset.cache is None or subtracted != subset.background:
        return views
    if any(t not in subset.cache for t in subset.frames):
        subset.cache.update(views)
    return ((t, subset.cache[t]) for t in subset.frames)


def compare_thresholds(
    subsets: list[Subset], scale: str, background: BackgroundModel | None = None
) -> pd.DataFrame:
    """Return DoG with every threshold of `THRESHOLDS`, and each subset's choice.

    A smoke run tries every fourth one only.

    Returns
    -------
    DataFrame
        Of `run`, the threshold in place of the method; ``chosen`` where the threshold is
        the one that is best on the other subsets (section 5.1.3). Their ``seconds`` are not
        known: one call answers for all thresholds.
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
    chosen = table[table["chosen"]].drop_duplicates("subset")
    return chosen.set_index("subset")["threshold"]


def leave_one_out(table: pd.DataFrame) -> dict[str, Any]:
    """Return for each subset the ``threshold`` that is best on the others.

    Section 5.1.3 of the thesis.
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
        delayed does not move; ``f1_in_pixels`` by the pixels of a particle (5.1.1); and
        ``f1_diameter_45_px``, where 45 px are a diameter.
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


def with_total(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return `sum_counts` by subset, and below them those of all subsets, "Total"."""
    total = sum_counts(table.assign(subset="Total"), [name for name in by if name != "threshold"])
    return pd.concat([sum_counts(table, by), total], ignore_index=True)


def beside_published(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return counts by subset with ``f1_published``, from a table of the thesis."""
    printed = claims.published(name).rename(columns={"test_set": "subset", "f1": "f1_published"})
    return table.merge(printed[["subset", "f1_published"]], how="left")


def sum_with_unlit(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return `sum_counts` without times, and ``recall_non_burning``, that of class 3."""
    unlit = class_recall(table, by).query("label == 3")[[*by, "recall"]]
    unlit = unlit.rename(columns={"recall": "recall_non_burning"})
    return sum_counts(table, by).drop(columns="seconds_per_image").merge(unlit)


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
            particles = subset.particles[subset.particles["frame"] == t]
            table = detectors[subset.name](view, roi, t)
            score = score_detections(particles[["row", "col"]], table[["row", "col"]], roi=roi)
            right = np.isin(np.arange(len(table)), score.pairs[:, 1])
            parts.append(table[["case"]].assign(right=right))
    groups = pd.concat(parts).groupby("case")["right"]
    counts = groups.agg(detections="size", right="sum")
    return counts.assign(precision=counts["right"] / counts["detections"]).reset_index()


def class_recall(table: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    """Return the recall of each class.

    Columns: ``by``, ``label``, ``tp``, ``fn``, ``recall``, ``kind``.
    """
    groups, parts = table.groupby(by, sort=False), []
    for label, kind in truth.CLASSES.items():
        counts = groups[[f"tp_{label}", f"fn_{label}"]].sum().set_axis(["tp", "fn"], axis=1)
        counts.insert(0, "label", label)
        recall = counts["tp"] / (counts["tp"] + counts["fn"])  # NaN where none is marked
        parts.append(counts.assign(recall=recall, kind=kind).reset_index())
    return pd.concat(parts, ignore_index=True)


def positions(
    subsets: Iterable[Subset], detectors: Mapping[str, Combination], wall: Cylinder
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return where marked particles and detections are in space.

    Parameters
    ----------
    subsets
        From `labelled_subsets`.
    detectors
        The combined detector of each subset.
    wall
        Whose axis ``distance_mm`` is from.

    Returns
    -------
    marked : DataFrame
        ``subset``, ``frame``, ``row``, ``col``, ``label``, ``distance_mm`` and ``x``, ``y``,
        ``z`` in mm: the mean of the points in the particle's pixels; NaN without a point, so
        no 3D (5.1.1).
    detected : DataFrame
        ``subset``, ``distance_mm`` and `kilnflight.tables.DETECTIONS`.
    """
    marked, detected = [], []
    for subset in subsets:
        for t, view in subset_views(subset):
            particles = subset.particles[subset.particles["frame"] == t]
            shown = subset.instances(t)[view.pixels[:, 0], view.pixels[:, 1]]
            means = pd.DataFrame(view.xyz, columns=list("xyz")).groupby(shown).mean()
            part = particles[["frame", "particle", "row", "col", "label"]].assign(
                subset=subset.name
            )
            marked.append(part.join(means, on="particle"))
            detections = detectors[subset.name](view, subset.recording.attributes.roi, t)
            detected.append(detections.assign(subset=subset.name))
    tables = [pd.concat(parts, ignore_index=True) for parts in (marked, detected)]
    for table in tables:
        known = table.dropna(subset="z")[["x", "y", "z"]]
        table["distance_mm"] = pd.Series(distance_to_axis(known, wall), known.index)
    return tables[0], tables[1]


def classification_table(
    marked: pd.DataFrame,
    spots: pd.DataFrame,
    thresholds: Mapping[str, float],
    roi: Polygon | None,
    gate: float = GATE_PX,
) -> pd.DataFrame:
    """Return how well spots are classified as in the air (Tables 5.13 and 5.14).

    Parameters
    ----------
    marked
        Of `positions`; what has no distance from the axis is not considered.
    spots
        Detections of `positions`; for Table 5.13 the marked particles themselves.
    thresholds
        By name: up to which distance in mm a spot is in the air.
    roi
        Polygon (row, col) outside which nothing counts.
    gate
        Largest distance in px between a particle and its detection.

    Returns
    -------
    DataFrame
        ``threshold``, ``threshold_mm``, ``subset``, ``tp``, ``fp``, ``fn``, ``precision``,
        ``recall``, ``f1``; by subset, and below them those of all subsets, "Total".
    """
    rows, frames = [], marked.groupby(["subset", "frame"], sort=False)
    for (name, level), ((subset, frame), particles) in product(thresholds.items(), frames):
        detections = spots[(spots["subset"] == subset) & (spots["frame"] == frame)]
        places = particles[["row", "col"]]
        score = score_detections(places, detections[["row", "col"]], gate, roi)
        flying = (particles["label"] != 4) & particles["distance_mm"].notna()
        row = {"threshold": name, "threshold_mm": level, "subset": str(subset)}
        rows.append(row | count_in_air(score, flying, detections["distance_mm"] <= level))
    table = pd.DataFrame(rows)
    keys = ["threshold", "threshold_mm", "subset"]
    both = pd.concat([table, table.assign(subset="Total")]).groupby(keys, sort=False)
    counts = both[list(COUNTS)].sum().reset_index()
    return pd.concat([counts, rates(*(counts[count] for count in COUNTS))], axis=1)
