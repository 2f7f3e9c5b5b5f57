"""Scores of detections: precision, recall and F1 (thesis, section 3.3).

Both criteria of the thesis: within 45 px by the Hungarian method (section 3.3), and
within the pixels of a labelled particle (section 5.1.1).

The 45 px have two readings. Section 3.3 takes particles of up to 15 px in radius,
enlarges the diameter 1.5 times, and calls the result a "gating threshold (diameter)": 2
x 15 x 1.5 = 45. A detection would then lie within 22.5 px (`NEAR_GATE_PX`). But Eq. 3.4
compares that threshold with the distance of two centres: 45 px (`DETECTION_GATE_PX`).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pandas import DataFrame
from scipy.spatial import KDTree

from kilnflight.arrays import Array, ArrayLike, Index, Integers
from kilnflight.association import assign
from kilnflight.checks import InputError, check_finite, check_number, check_shape
from kilnflight.detection.region import within

DETECTION_GATE_PX = 45.0  # d_epsilon of Eq. 3.4, a distance
NEAR_GATE_PX = DETECTION_GATE_PX / 2  # the same as a diameter, as sec. 3.3 calls it


def rates(
    true_positives: ArrayLike,
    false_positives: ArrayLike,
    false_negatives: ArrayLike,
) -> DataFrame:
    """Compute precision, recall and F1 of counts, one row per entry.

    ``precision = TP / (TP + FP)``, ``recall = TP / (TP + FN)``, ``F1 = 2 TP / (2 TP +
    FP + FN)`` (Eqs 3.1 to 3.3); a ratio without a denominator is 0.

    Parameters
    ----------
    true_positives, false_positives, false_negatives
        Counts, scalars or arrays of one shape (n,), not negative.

    Returns
    -------
    DataFrame
        Columns ``precision``, ``recall`` and ``f1``, 0 to 1.

    Raises
    ------
    InputError
        If shapes differ or a count is no whole number from 0.

    Examples
    --------
    >>> rates(3256, 76, 1131).round(4).loc[0].tolist()
    [0.9772, 0.7422, 0.8436]
    """
    where = "rates: counts"
    first = check_finite(true_positives, where)
    others = (false_positives, false_negatives)
    checked = [check_finite(each, where, first.shape) for each in others]
    tp, fp, fn = np.atleast_1d(first, *checked)
    check_shape(tp, (None,), where)
    if np.less([tp, fp, fn], 0).any() or np.mod([tp, fp, fn], 1).any():
        raise InputError(f"{where}: must be whole numbers from 0.")
    below = {"precision": tp + fp, "recall": tp + fn, "f1": tp + (fp + fn) / 2}
    table = {name: tp / np.where(n > 0, n, 1.0) for name, n in below.items()}
    return DataFrame(table)


@dataclass(frozen=True, eq=False)
class FrameScore:
    """Scores of the detections of one frame (Eqs 3.1 to 3.3).

    Particles and detections outside the region of interest are not counted. Rows are
    those of the arrays that were scored.
    """

    tp: int
    fp: int
    fn: int
    precision: float
    recall: float
    f1: float
    # (tp, 2) rows of truth and detected that belong together, by row of truth
    pairs: Index
    missed: Index  # (fn,) rows of truth without a detection
    spurious: Index  # (fp,) rows of detected without a particle


def score_detections(
    truth: ArrayLike,
    detected: ArrayLike,
    gate: float = DETECTION_GATE_PX,
    roi: ArrayLike | None = None,
) -> FrameScore:
    """Count the detections of one frame within a gate of a particle (Eq. 3.4).

    The Hungarian method assigns detections to particles.

    Parameters
    ----------
    truth, detected
        (n, 2) and (m, 2) row, col in px of the particles and detections of one frame.
    gate
        Largest distance of a pair in px; a pair at the gate counts (Eq. 3.4).
    roi
        (k, 2) corners row, col in px; only points inside take part.

    Returns
    -------
    FrameScore
        Counts, rates, and the rows that belong together.

    Raises
    ------
    InputError
        If an array has another shape or holds a value that is not finite, or the gate
        is not above 0.

    Notes
    -----
    Eq. 3.4 gives pairs beyond the gate a cost "significantly greater than the Euclidean
    distances". So the number of pairs is maximal, and among these assignments the sum
    of their distances is minimal. Particles and detections beyond the region of
    interest are left out before the assignment (section 3.1), each by its position.

    Examples
    --------
    >>> score_detections([(0, 0), (0, 60)], [(0, 40), (9, 0), (300, 0)]).pairs.tolist()
    [[0, 1], [1, 0]]
    """
    check_number(gate, "score_detections: gate", above=0)
    particles = check_finite(truth, "truth", (None, 2))
    places = check_finite(detected, "detected", (None, 2))
    true = within(roi, particles)
    found = within(roi, places)
    near = pair(particles[true], places[found], gate)
    return _score(true, found, np.stack([true[near[:, 0]], found[near[:, 1]]], axis=1))


def particle_centroids(image: Integers, particles: Integers) -> DataFrame:
    """Return the mean ``row``, ``col`` in px of each particle's pixels, by particle.

    `score_in_pixels` takes them as the truth.

    Parameters
    ----------
    image
        (rows, cols) integers: the particle labelled in each pixel; other numbers are
        background.
    particles
        (n,) the particles of the truth, each once; NaN for one without pixels.
    """
    row, col = np.nonzero(np.isin(image, particles))
    pixels = DataFrame({"row": row, "col": col}, dtype=np.float64)
    return pixels.groupby(image[row, col]).mean().reindex(particles)


def score_in_pixels(
    image: Integers,
    centroids: DataFrame,
    detected: ArrayLike,
    roi: ArrayLike | None,
) -> FrameScore:
    """Count the detections of one frame within the pixels of a particle.

    In section 5.1.1 a detection counts if it "falls within the pixel range of a
    particle".

    Parameters
    ----------
    image
        (rows, cols) integers, the particle of each pixel.
    centroids
        Of `particle_centroids`, one row per particle of the truth.
    detected
        (m, 2) row, col in px; a detection belongs to the nearest pixel, and to none
        outside.
    roi
        (k, 2) corners row, col in px; only detections and centroids inside take part.

    Notes
    -----
    Each particle is found once: by the detection nearest to the centroid of its pixels.
    Others in the same particle are false positives. The thesis does not say which one
    counts. A detection inside the region of a particle whose centroid is outside is
    false as well.
    """
    places = check_finite(detected, "detected", (None, 2))
    middle = centroids.to_numpy()
    true = within(roi, middle)
    found = within(roi, places)
    nearest = np.floor(places + 0.5)
    on_image = np.flatnonzero(((nearest >= 0) & (nearest < image.shape)).all(axis=1))
    row, col = nearest[on_image].astype(np.intp).T
    hit = np.full(len(places), -1)
    hit[on_image] = centroids.index.get_indexer(image[row, col])
    usable = found[np.isin(hit[found], true)]
    distance = np.linalg.norm(places[usable] - middle[hit[usable]], axis=1)
    ranked = usable[np.lexsort((usable, distance, hit[usable]))]
    particle, first = np.unique(hit[ranked], return_index=True)
    return _score(true, found, np.stack([particle, ranked[first]], axis=1))


def _score(true: Index, found: Index, pairs: Index) -> FrameScore:
    """Return the score of pairs among the rows inside the region of interest.

    ``true`` (n,) and ``found`` (m,) are the row numbers inside, ``pairs`` (tp, 2) the
    row numbers of truth and detection that belong together.
    """
    missed = np.setdiff1d(true, pairs[:, 0])
    spurious = np.setdiff1d(found, pairs[:, 1])
    shares: Any = rates(len(pairs), len(spurious), len(missed)).loc[0].to_dict()
    return FrameScore(
        tp=len(pairs),
        fp=len(spurious),
        fn=len(missed),
        **shares,
        pairs=pairs[np.argsort(pairs[:, 0])],
        missed=missed,
        spurious=spurious,
    )


def pair(first: Array, second: Array, gate: float) -> Index:
    """Return the rows (k, 2) of two sets of points that belong together (Eq. 3.4).

    ``first`` is (n, d), ``second`` (m, d). As many pairs as possible that are no
    farther apart than ``gate``, in the unit of the points; of these assignments the one
    with the smallest sum of distances.
    """
    near = KDTree(first).sparse_distance_matrix(
        KDTree(second), gate, output_type="ndarray"
    )
    near.sort(order=["i", "j"])
    # No pair is given up: a miss costs more than all distances together.
    missed = np.full(len(first), 1.0 + gate * min(len(first), len(second)))
    taken = near[assign(near["i"], near["j"], near["v"], missed)]
    return np.stack([taken["i"], taken["j"]], axis=1)
