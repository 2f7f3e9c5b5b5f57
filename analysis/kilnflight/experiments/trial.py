"""Detectors on labelled frames, counted as chapter 3.3 counts: the detection experiment.

labelled frames -> views x methods (`contenders`) -> one row per frame and method
    -> sums, rates, intervals (`kilnflight.experiments.tallies`)
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

from kilnflight.background import BackgroundModel, Median
from kilnflight.checks import InputError, check_columns
from kilnflight.detection.combination import Combination, Polygon, View
from kilnflight.experiments.contenders import THRESHOLDS, Method, by_threshold
from kilnflight.experiments.tallies import marked_best
from kilnflight.kiln import views
from kilnflight.recording.frames import PictureRecording
from kilnflight.scores import FrameScore, LabelledPixels, score_detections, total_in_air
from kilnflight.twin import truth
from kilnflight.twin.prepared import prepared_scene

POINTS = 2000  # of the untimed first call
# How many of the ten labelled frames of which subsets each scale looks at; 10 of all five are
# the thesis's set of 50.
FRAMES = {"quick": 1, "standard": 1, "full": 10}
FEWER = ("V4", "V5")  # of a smoke run
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


def ground_truth(scale: str, seed: int = 0, frames: int = 0) -> list[Subset]:
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
    if scale not in FRAMES or not 0 <= frames <= len(truth.LABELLED):
        raise InputError(
            f"ground_truth: scale {scale!r} with {frames} frames; there are {', '.join(FRAMES)}, "
            f"and up to {len(truth.LABELLED)} labelled frames."
        )
    frames = frames or FRAMES[scale]
    found = []
    for name in FEWER if scale == "quick" else truth.SUBSETS:
        twin, wanted = prepared_scene(name, seed), tuple(truth.LABELLED[:frames])
        instances = partial(truth.instances, twin)
        marked = truth.marked(twin, wanted)
        found.append(Subset(name, twin, wanted, marked, instances, BACKGROUNDS[scale], {}))
    return found


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
        That of the subset if None.
    """
    parts: list[pd.DataFrame] = []
    for subset in subsets:
        frames = look(subset, background)
        bar = tqdm(frames, desc=subset.name, total=len(subset.wanted), unit="frame", disable=None)
        roi = subset.recording.attributes.roi
        parts.append(attempt(bar, subset, methods, roi, compiled=bool(parts)))
    return pd.concat(parts, ignore_index=True)


def look(subset: Subset, background: BackgroundModel | None = None) -> Iterator[tuple[int, View]]:
    """Yield number and view of each wanted frame, held for the next look if the subset holds.

    Parameters
    ----------
    subset
        From `ground_truth`.
    background
        That of the subset if None; with another one nothing is held.
    """
    subtracted = background or subset.background
    held = subset.held if subtracted == subset.background else None
    if held is not None and all(t in held for t in subset.wanted):
        yield from ((t, held[t]) for t in subset.wanted)
        return
    for t, view in views(subset.recording, subset.wanted, subtracted):
        if held is not None:
            held[t] = view
        yield t, view


def thresholds(
    subsets: list[Subset], scale: str, background: BackgroundModel | None = None
) -> pd.DataFrame:
    """Return DoG with every threshold of `THRESHOLDS`, and which one each subset is to use.

    A smoke run tries every fourth one only.

    Returns
    -------
    DataFrame
        Of `attempt`, the threshold in place of the method; ``chosen`` where the threshold is
        the one that is best on the other subsets (section 5.1.3). Their ``seconds`` are not
        known: one look at a frame answers for all thresholds.
    """
    some = THRESHOLDS[:: 4 if scale == "quick" else 1]
    tried = run(subsets, by_threshold(some), background).assign(seconds=np.nan)
    return marked_best(tried.rename(columns={"method": "threshold"}))


def attempt(
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
    some = view._replace(pixels=view.pixels[:POINTS], xyz=view.xyz[:POINTS])
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
    for t, view in look(subset, background):
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
