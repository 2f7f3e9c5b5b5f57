"""Which detections are particles: assignment, precision, recall, F1 (thesis, section 3.3).

Both criteria of the thesis: within 45 px by the Hungarian method (section 3.3), and within
the pixels of a labelled particle (section 5.1.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from kilnflight.camera import inside
from kilnflight.checks import InputError, check_finite, check_positive, check_shape

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
GATE_PX = 45.0  # three times the largest radius of 15 px, sec. 3.3


def rates(
    true_positives: npt.ArrayLike, false_positives: npt.ArrayLike, false_negatives: npt.ArrayLike
) -> pd.DataFrame:
    """Return precision, recall and F1 of counts.

    ``precision = TP / (TP + FP)``, ``recall = TP / (TP + FN)``,
    ``F1 = 2 TP / (2 TP + FP + FN)``; a ratio without anything below the line is 0,
    so that a detector that finds nothing has no score rather than no number.

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

    def ratio(above: npt.NDArray[np.float64], below: npt.NDArray[np.float64]) -> npt.ArrayLike:
        return np.divide(above, below, out=np.zeros_like(below), where=below > 0)

    return pd.DataFrame(
        {
            "precision": ratio(tp, tp + fp),
            "recall": ratio(tp, tp + fn),
            "f1": ratio(2 * tp, 2 * tp + fp + fn),
        }
    )


@dataclass(frozen=True, eq=False)
class FrameScore:
    """The detections of one frame (or of one sum) held against its particles.

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
        """True positives: particles that were detected."""
        return len(self.pairs)

    @property
    def fp(self) -> int:
        """False positives: detections that are no particle."""
        return len(self.spurious)

    @property
    def fn(self) -> int:
        """False negatives: particles that were not detected."""
        return len(self.missed)

    @property
    def precision(self) -> float:
        """Eq. 3.1."""
        return self._rate("precision")

    @property
    def recall(self) -> float:
        """Eq. 3.2."""
        return self._rate("recall")

    @property
    def f1(self) -> float:
        """Eq. 3.3."""
        return self._rate("f1")

    def _rate(self, name: str) -> float:
        return float(rates(self.tp, self.fp, self.fn)[name].to_numpy()[0])


def score_detections(
    truth: npt.ArrayLike,
    detected: npt.ArrayLike,
    gate: float = GATE_PX,
    roi: npt.ArrayLike | None = None,
) -> FrameScore:
    """Assign detections to particles by the Hungarian method (Eq. 3.4) and count.

    Parameters
    ----------
    truth, detected
        (n, 2) and (m, 2) row, col of the particles and detections of one frame.
    gate
        Largest distance of a pair in px; a pair at the gate counts (Eq. 3.4).
    roi
        (k, 2) corners row, col; only what lies inside takes part.

    Notes
    -----
    Eq. 3.4 gives pairs beyond the gate a cost "significantly greater than the Euclidean
    distances": first the number of pairs is as large as possible, then the sum of their
    distances as small as possible. Particles and detections beyond the region of interest
    are left out before the assignment (section 3.1), each by its own position, so a
    detection just inside cannot be paired with a particle just outside.

    Examples
    --------
    >>> score_detections([(0, 0), (0, 60)], [(0, 40), (9, 0), (300, 0)]).pairs.tolist()
    [[0, 1], [1, 0]]
    """
    check_positive(gate, "score_detections: gate")
    places = [_places(truth, "truth"), _places(detected, "detected")]
    kept = (_within(roi, places[0]), _within(roi, places[1]))
    near = pair(places[0][kept[0]], places[1][kept[1]], gate)
    pairs = np.stack([kept[0][near[:, 0]], kept[1][near[:, 1]]], axis=1)
    return _score(kept, pairs, (len(places[0]), len(places[1])))


def score_in_pixels(
    particle_of_pixel: npt.NDArray[np.integer],
    particles: npt.ArrayLike,
    detected: npt.ArrayLike,
    roi: npt.ArrayLike | None = None,
) -> FrameScore:
    """Count a detection if it "falls within the pixel range of a particle" (section 5.1.1).

    Parameters
    ----------
    particle_of_pixel
        (rows, cols) integers: which particle was labelled there; anything that is not in
        ``particles`` is background.
    particles
        (n,) the particles of the truth, each once.
    detected
        (m, 2) row, col; a detection belongs to the nearest pixel, and to none outside.
    roi
        (k, 2) corners row, col; only detections and centroids of particles inside take part.

    Notes
    -----
    Each particle is found once: by the detection nearest to the centroid of its pixels;
    others in the same particle are false positives. The thesis does not say which counts.
    A detection inside the region of a particle whose centroid is outside is false as well.
    """
    return LabelledPixels.of(particle_of_pixel, particles).score(detected, roi)


@dataclass(frozen=True, eq=False)
class LabelledPixels:
    """What `score_in_pixels` knows of a frame before any detection; `of` makes it.

    Detectors that are compared on a frame share it: the whole image is read once.

    Parameters
    ----------
    image
        (rows, cols) integers, particle of each pixel.
    particles
        (n,) the particles of the truth.
    centroids
        (n, 2) mean row, col of each particle's pixels.
    """

    image: npt.NDArray[np.integer]
    particles: npt.NDArray[np.generic]
    centroids: Array

    @classmethod
    def of(
        cls, particle_of_pixel: npt.NDArray[np.integer], particles: npt.ArrayLike
    ) -> LabelledPixels:
        """Return the labelled pixels of a frame; arguments and errors of `score_in_pixels`."""
        image = np.asarray(particle_of_pixel)
        ids = np.asarray(particles).ravel() if np.size(particles) else np.empty(0, np.intp)
        check_shape(image, (None, None), "score_in_pixels: particle_of_pixel")
        return cls(image, ids, _centroids(image, ids))

    def score(self, detected: npt.ArrayLike, roi: npt.ArrayLike | None = None) -> FrameScore:
        """Return the score of detections (m, 2), as `score_in_pixels`."""
        place = _places(detected, "detected")
        kept = (_within(roi, self.centroids), _within(roi, place))
        nearest = np.floor(place + 0.5)
        at = np.flatnonzero(((nearest >= 0) & (nearest < self.image.shape)).all(axis=1))
        row, col = nearest[at].astype(np.intp).T
        row_of_id = pd.Series(np.arange(len(self.particles)), index=self.particles)
        hit = np.full(len(place), -1)
        hit[at] = row_of_id.reindex(self.image[row, col], fill_value=-1)
        usable = kept[1][np.isin(hit[kept[1]], kept[0])]
        distance = np.linalg.norm(place[usable] - self.centroids[hit[usable]], axis=1)
        ranked = usable[np.lexsort((usable, distance, hit[usable]))]
        particle, first = np.unique(hit[ranked], return_index=True)
        rows = (len(self.particles), len(place))
        return _score(kept, np.stack([particle, ranked[first]], axis=1), rows)


def _centroids(image: npt.NDArray[np.integer], ids: npt.NDArray[np.generic]) -> Array:
    """Return the mean row, col (n, 2) of each particle's pixels, or raise an `InputError`."""
    unique, row_of = np.unique(ids, return_index=True)
    if len(unique) < len(ids) or not np.issubdtype(ids.dtype, np.integer):
        raise InputError("score_in_pixels: particles must be whole numbers, each once.")
    if not np.issubdtype(image.dtype, np.integer):
        raise InputError(
            f"score_in_pixels: particle_of_pixel is {image.dtype}, expected whole numbers."
        )
    row, col = np.nonzero(np.isin(image, unique))
    which = row_of[np.searchsorted(unique, image[row, col])] if len(unique) else row
    size = np.bincount(which, minlength=len(ids))
    if len(ids) and not size.all():
        raise InputError(
            f"score_in_pixels: {np.count_nonzero(size == 0)} particle(s) have no pixel, the first "
            f"is {ids[np.argmin(size)]}. Leave out of the truth what was not labelled."
        )
    sums = [np.bincount(which, weights=axis, minlength=len(ids)) for axis in (row, col)]
    return np.stack(sums, axis=1)[: len(ids)] / np.maximum(size, 1)[: len(ids), None]


def _places(values: npt.ArrayLike, what: str) -> Array:
    """Return row, col as (n, 2), or raise an `InputError`; nothing has the shape (0, 2)."""
    array = check_finite(values, what)
    if array.size == 0:
        return np.empty((0, 2))
    check_shape(array, (None, 2), what)
    return array


def _within(roi: npt.ArrayLike | None, places: Array) -> Indices:
    """Return the rows of the places that take part."""
    if roi is None:
        return np.arange(len(places))
    return np.flatnonzero(inside(roi, places[:, 0], places[:, 1]))


def _score(kept: tuple[Indices, Indices], pairs: Indices, rows: tuple[int, int]) -> FrameScore:
    """Return the score of pairs among the rows that take part."""
    missed, spurious = (np.setdiff1d(one, pairs[:, k]) for k, one in enumerate(kept))
    return FrameScore(pairs[np.argsort(pairs[:, 0])], missed, spurious, rows)


def pair(first: Array, second: Array, gate: float) -> Indices:
    """Return the rows (k, 2) of ``first`` (n, d) and ``second`` (m, d) that belong together.

    As many pairs as possible that are no farther apart than ``gate``; of these assignments
    the one with the smallest sum of distances. Clusters that no gate connects are assigned
    one by one: the best of the whole is the best of each.
    """
    if not len(first) or not len(second):
        return np.empty((0, 2), dtype=np.intp)
    near = KDTree(first).sparse_distance_matrix(KDTree(second), gate, output_type="ndarray")
    one, other, cost = near["i"].astype(np.intp), near["j"].astype(np.intp), near["v"]
    size = len(first) + len(second)
    links = coo_array((np.ones(len(one)), (one, other + len(first))), shape=(size, size))
    cluster = connected_components(links, directed=False)[1][one]
    lonely = np.bincount(cluster, minlength=size)[cluster] == 1
    pairs = [np.stack([one[lonely], other[lonely]], axis=1)]
    crowded = np.flatnonzero(~lonely)
    crowded = crowded[np.argsort(cluster[crowded], kind="stable")]
    cuts = np.flatnonzero(np.diff(cluster[crowded])) + 1
    pairs += [_hungarian(one[k], other[k], cost[k]) for k in np.split(crowded, cuts) if len(k)]
    return np.concatenate(pairs)


def _hungarian(one: Indices, other: Indices, cost: Array) -> Indices:
    """Return the best assignment of one cluster of allowed pairs."""
    rows, row = np.unique(one, return_inverse=True)
    columns, column = np.unique(other, return_inverse=True)
    # C_max: more than all allowed distances together, so that no pair is given up for them.
    forbidden = 1.0 + cost.max() * min(len(rows), len(columns))
    matrix = np.full((len(rows), len(columns)), forbidden)
    matrix[row, column] = cost
    row, column = linear_sum_assignment(matrix)
    allowed = matrix[row, column] < forbidden
    return np.stack([rows[row[allowed]], columns[column[allowed]]], axis=1)


def total_in_air(
    scores: Sequence[FrameScore],
    truth_in_air: Sequence[npt.ArrayLike],
    detected_in_air: Sequence[npt.ArrayLike],
) -> pd.DataFrame:
    """Return how well detections were classified as in the air, summed over frames.

    As Tables 5.13 and 5.14: TP is a particle in the air whose detection is classified as such;
    FP any other detection classified as in the air, be it on the wall or nothing; FN any other
    particle in the air, classified as on the wall or not detected. For Table 5.13 hand in
    the score of the truth against itself.

    Parameters
    ----------
    scores
        Per frame the assignment of detections to particles.
    truth_in_air, detected_in_air
        Per frame whether each particle (n,) and each detection (m,) is in the air *and* has
        3D; those without 3D are False and so "not taken into consideration" (section 5.1.4).
    """
    if not len(scores) == len(truth_in_air) == len(detected_in_air):
        raise InputError(
            f"{len(scores)} scores, but {len(truth_in_air)} and {len(detected_in_air)} frames of "
            "truth and detections; give one of each per frame."
        )
    counts = []
    frames = zip(scores, truth_in_air, detected_in_air, strict=True)
    for frame, (score, *both) in enumerate(frames):
        flying = [np.asarray(one, dtype=bool) for one in both]
        for side in range(2):
            where = f"total_in_air: {('truth', 'detected')[side]} of frame {frame}"
            check_shape(flying[side], (score.rows[side],), where)
        there = [flying[side][score.pairs[:, side]] for side in range(2)]
        tp = int(np.count_nonzero(there[0] & there[1]))
        fp = int(there[1].sum() + flying[1][score.spurious].sum()) - tp
        fn = int(there[0].sum() + flying[0][score.missed].sum()) - tp
        counts.append((tp, fp, fn))
    tp, fp, fn = np.array(counts, dtype=np.intp).reshape(-1, 3).sum(axis=0)
    summed = pd.DataFrame({"tp": [tp], "fp": [fp], "fn": [fn]})
    return pd.concat([summed, rates(tp, fp, fn)], axis=1)
