"""Scores of detections: precision, recall and F1 (thesis, section 3.3).

Both criteria of the thesis: within 45 px by the Hungarian method (section 3.3), and within
the pixels of a labelled particle (section 5.1.1).

The 45 px have two readings. Section 3.3 takes particles of up to 15 px in radius, enlarges the
diameter 1.5 times, and calls the result a "gating threshold (diameter)": 2 x 15 x 1.5 = 45, so
that nothing is left to be enlarged. A detection would then lie within 22.5 px (`NEAR_GATE_PX`).
Eq. 3.4 however compares that threshold with the distance of two centres: 45 px (`GATE_PX`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import KDTree

from kilnflight.camera import inside
from kilnflight.checks import InputError, check_columns, check_finite, check_positive, check_shape

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Labels = npt.NDArray[np.integer]
GATE_PX = 45.0  # d_epsilon of Eq. 3.4, a distance
NEAR_GATE_PX = GATE_PX / 2  # the same as a diameter, as sec. 3.3 calls it


def rates(
    true_positives: npt.ArrayLike, false_positives: npt.ArrayLike, false_negatives: npt.ArrayLike
) -> pd.DataFrame:
    """Return precision, recall and F1 of counts.

    ``precision = TP / (TP + FP)``, ``recall = TP / (TP + FN)``, ``F1 = 2 TP / (2 TP + FP + FN)``;
    a ratio without a denominator is 0, so that a detector that finds nothing has the score 0.

    Parameters
    ----------
    true_positives, false_positives, false_negatives
        Counts, scalars or arrays of one shape (n,), not negative.

    Returns
    -------
    DataFrame
        Columns ``precision``, ``recall``, ``f1``, one row per entry.

    Examples
    --------
    >>> rates(3256, 76, 1131).round(4).loc[0].tolist()
    [0.9772, 0.7422, 0.8436]
    """
    tp, fp, fn = (
        np.atleast_1d(np.asarray(counts, dtype=np.float64))
        for counts in (true_positives, false_positives, false_negatives)
    )
    if not all((counts >= 0).all() for counts in (tp, fp, fn)):
        raise InputError("counts of detections must be numbers not below 0.")
    below = {"precision": tp + fp, "recall": tp + fn, "f1": tp + (fp + fn) / 2}
    return pd.DataFrame({name: tp / np.where(n > 0, n, 1.0) for name, n in below.items()})


@dataclass(frozen=True, eq=False)
class FrameScore:
    """Pairs of detections and particles of one frame, or of a sum.

    Parameters
    ----------
    pairs
        (tp, 2) rows of truth and detected that belong together, by row of truth.
    missed
        (fn,) rows of truth without a detection.
    spurious
        (fp,) rows of detected without a particle. What lies outside the region of interest
        is in none of the three.
    rows
        Number of particles and of detections passed.
    """

    pairs: Indices
    missed: Indices
    spurious: Indices
    rows: tuple[int, int]

    @property
    def tp(self) -> int:
        """Return the number of particles that were detected."""
        return len(self.pairs)

    @property
    def fp(self) -> int:
        """Return the number of detections that are no particle."""
        return len(self.spurious)

    @property
    def fn(self) -> int:
        """Return the number of particles that were not detected."""
        return len(self.missed)

    @property
    def precision(self) -> float:
        """Return the precision (Eq. 3.1)."""
        return self.tp / max(self.tp + self.fp, 1)

    @property
    def recall(self) -> float:
        """Return the recall (Eq. 3.2)."""
        return self.tp / max(self.tp + self.fn, 1)

    @property
    def f1(self) -> float:
        """Return the F1 score (Eq. 3.3)."""
        return 2 * self.tp / max(2 * self.tp + self.fp + self.fn, 1)


def score_detections(
    truth: npt.ArrayLike,
    detected: npt.ArrayLike,
    gate: float = GATE_PX,
    roi: npt.ArrayLike | None = None,
) -> FrameScore:
    """Assign detections to particles within a gate, and count (Eq. 3.4).

    The assignment is that of the Hungarian method.

    Parameters
    ----------
    truth, detected
        (n, 2) and (m, 2) row, col of the particles and detections of one frame.
    gate
        Largest distance of a pair in px; a pair at the gate counts (Eq. 3.4). Where the 45 px
        are a diameter: `NEAR_GATE_PX`.
    roi
        (k, 2) corners row, col; only what lies inside takes part.

    Notes
    -----
    Eq. 3.4 gives pairs beyond the gate a cost "significantly greater than the Euclidean
    distances". So the number of pairs is first made as large as possible, then the sum of their
    distances as small as possible. Particles and detections beyond the region of interest are left
    out before the assignment (section 3.1), each by its position. So a detection just inside
    cannot be paired with a particle just outside.

    Examples
    --------
    >>> score_detections([(0, 0), (0, 60)], [(0, 40), (9, 0), (300, 0)]).pairs.tolist()
    [[0, 1], [1, 0]]
    """
    check_positive(gate, "score_detections: gate")
    places = [_places(truth, "truth"), _places(detected, "detected")]
    counted = (_within(roi, places[0]), _within(roi, places[1]))
    near = pair(places[0][counted[0]], places[1][counted[1]], gate)
    pairs = np.stack([counted[0][near[:, 0]], counted[1][near[:, 1]]], axis=1)
    return _score(counted, pairs, (len(places[0]), len(places[1])))


def particle_centroids(image: Labels, particles: npt.ArrayLike) -> pd.DataFrame:
    """Return the mean ``row``, ``col`` of each particle's pixels.

    The index is the particle.

    Parameters
    ----------
    image
        (rows, cols) integers: which particle was labelled in each pixel; anything that is not
        in ``particles`` is background.
    particles
        (n,) the particles of the truth, each once.

    Raises
    ------
    InputError
        If numbers are not whole, or a particle is named twice or has no pixel.
    """
    ids = np.asarray(particles).ravel() if np.size(particles) else np.empty(0, np.intp)
    _check_labels(image, "particle_centroids: image")
    if len(np.unique(ids)) < len(ids) or not np.issubdtype(ids.dtype, np.integer):
        raise InputError("particle_centroids: particles must be whole numbers, each once.")
    row, col = np.nonzero(np.isin(image, ids))
    pixels = pd.DataFrame({"row": row, "col": col}, dtype=np.float64)
    centroids = pixels.groupby(image[row, col]).mean().reindex(ids)
    without = ids[centroids["row"].isna()]
    if len(without):
        raise InputError(
            f"particle_centroids: {len(without)} particle(s) have no pixel, the first is "
            f"{without[0]}. Leave out of the truth what was not labelled."
        )
    return centroids


def _check_labels(image: Labels, where: str) -> None:
    """Raise an `InputError` unless an image holds particle numbers."""
    check_shape(np.asarray(image), (None, None), where)
    if not np.issubdtype(np.asarray(image).dtype, np.integer):
        raise InputError(f"{where} is {np.asarray(image).dtype}, expected whole numbers.")


def score_in_pixels(
    image: Labels,
    centroids: pd.DataFrame,
    detected: npt.ArrayLike,
    roi: npt.ArrayLike | None = None,
) -> FrameScore:
    """Count detections within the pixels of a particle (section 5.1.1).

    A detection counts if it "falls within the pixel range of a particle".

    Parameters
    ----------
    image
        (rows, cols) integers, the particle of each pixel.
    centroids
        Of `particle_centroids`: the particles of the truth. Detectors that are compared on a
        frame share it.
    detected
        (m, 2) row, col; a detection belongs to the nearest pixel, and to none outside.
    roi
        (k, 2) corners row, col; only detections and centroids of particles inside take part.

    Notes
    -----
    Each particle is found once: by the detection nearest to the centroid of its pixels;
    others in the same particle are false positives. The thesis does not say which counts.
    A detection inside the region of a particle whose centroid is outside is false as well.

    Raises
    ------
    InputError
        If the image is not one of whole numbers, the centroids are no such table, or a
        detection is not two finite numbers.
    """
    _check_labels(image, "score_in_pixels: image")
    check_columns(centroids, ["row", "col"], "score_in_pixels: centroids")
    places, middle = _places(detected, "detected"), centroids.to_numpy()
    counted = (_within(roi, middle), _within(roi, places))
    nearest = np.floor(places + 0.5)
    on_image = np.flatnonzero(((nearest >= 0) & (nearest < image.shape)).all(axis=1))
    row, col = nearest[on_image].astype(np.intp).T
    hit = np.full(len(places), -1)
    hit[on_image] = centroids.index.get_indexer(image[row, col])
    usable = counted[1][np.isin(hit[counted[1]], counted[0])]
    distance = np.linalg.norm(places[usable] - middle[hit[usable]], axis=1)
    ranked = usable[np.lexsort((usable, distance, hit[usable]))]
    particle, first = np.unique(hit[ranked], return_index=True)
    pairs = np.stack([particle, ranked[first]], axis=1)
    return _score(counted, pairs, (len(middle), len(places)))


def _places(values: npt.ArrayLike, name: str) -> Array:
    """Return row, col as (n, 2), or raise an `InputError`."""
    array = check_finite(values, name)
    if array.size == 0:
        return np.empty((0, 2))
    check_shape(array, (None, 2), name)
    return array


def _within(roi: npt.ArrayLike | None, places: Array) -> Indices:
    """Return the indices of the places in the region of interest."""
    if roi is None:
        return np.arange(len(places))
    return np.flatnonzero(inside(roi, places[:, 0], places[:, 1]))


def _score(counted: tuple[Indices, Indices], pairs: Indices, rows: tuple[int, int]) -> FrameScore:
    """Return the score of pairs among the counted rows."""
    missed, spurious = (np.setdiff1d(*sides) for sides in zip(counted, pairs.T, strict=True))
    return FrameScore(pairs[np.argsort(pairs[:, 0])], missed, spurious, rows)


def pair(first: Array, second: Array, gate: float) -> Indices:
    """Return the rows (k, 2) of two sets of points that belong together.

    ``first`` is (n, d), ``second`` (m, d). As many pairs as possible that are no farther apart
    than ``gate``; of these assignments the one with the smallest sum of distances (Eq. 3.4).
    """
    if not len(first) or not len(second):
        return np.empty((0, 2), dtype=np.intp)
    near = KDTree(first).sparse_distance_matrix(KDTree(second), gate, output_type="ndarray")
    rows, shape = np.arange(len(first)), (len(first), len(second) + len(first))
    # Each row has a dummy of its own, so that everyone can be assigned. It costs C_max: more
    # than all distances together, so that no pair is given up for them. The 1 that every cost
    # holds tells a distance of 0 from no entry.
    missed = np.full(len(first), 2.0 + gate * min(len(first), len(second)))
    cost = np.concatenate([near["v"] + 1.0, missed])
    index = np.append(near["i"], rows), np.append(near["j"], len(second) + rows)
    row, col = min_weight_full_bipartite_matching(coo_array((cost, index), shape=shape).tocsr())
    return np.stack([row, col], axis=1)[col < len(second)].astype(np.intp)


def count_in_air(
    score: FrameScore, truth_in_air: npt.ArrayLike, detected_in_air: npt.ArrayLike
) -> dict[str, int]:
    """Count the detections of a frame classified as in the air.

    As in Tables 5.13 and 5.14, TP is a particle in the air whose detection is classified as such.
    FP is any other detection classified as in the air, be it on the wall or nothing. FN is any
    other particle in the air, classified as on the wall or not detected. For Table 5.13 hand in
    the score of the truth against itself.

    Parameters
    ----------
    score
        Assignment of detections to particles.
    truth_in_air, detected_in_air
        Whether each particle (n,) and each detection (m,) is in the air *and* has 3D. Those
        without 3D are False and so "not taken into consideration" (section 5.1.4).
    """
    flying = [np.asarray(side, dtype=bool) for side in (truth_in_air, detected_in_air)]
    for name, mask, length in zip(("truth", "detected"), flying, score.rows, strict=True):
        check_shape(mask, (length,), f"count_in_air: {name}")
    true, classified = (mask[rows] for mask, rows in zip(flying, score.pairs.T, strict=True))
    tp = np.count_nonzero(true & classified)
    fp = np.count_nonzero(classified) + np.count_nonzero(flying[1][score.spurious]) - tp
    fn = np.count_nonzero(true) + np.count_nonzero(flying[0][score.missed]) - tp
    return {"tp": int(tp), "fp": int(fp), "fn": int(fn)}
