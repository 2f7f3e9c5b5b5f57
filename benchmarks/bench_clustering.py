"""Clusters of a frame's point cloud against scikit-learn and the definitions in scipy.

The cloud is one frame of the twin, its depth calibrated by Eq. 2.4. scikit-learn and the
plain definitions run once; ours runs once before, so that compiling is not timed.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import sklearn.cluster
from measure import Row, compare
from scipy import ndimage
from scipy.spatial import cKDTree

from kilnflight.camera import calibrate_depth
from kilnflight.detection import DBSCAN, Clusterer, MorphologicalClustering, QuasiClusterCenters
from kilnflight.twin.scenes import open_scene

WALL, PARTICLES = DBSCAN(50.0, 10), DBSCAN(15.0, 10)  # both passes, sec. 5.1.3
CUBE = np.ones((3, 3, 3))


def cloud() -> np.ndarray:
    """Return the points of one frame in mm, about 200,000."""
    points = open_scene("V1").frame(75).xyz.astype(np.float64)
    points[:, 2] = calibrate_depth(points[:, 2])
    return points


def surface(count: int) -> np.ndarray:
    """Return points as dense as a frame's on a wavy wall that grows with their number."""
    rng = np.random.default_rng(count)
    length = 5.0 * np.sqrt(count)
    x, z = rng.uniform(0, length, (2, count))
    wave = 100 * np.sin(x / 300) * np.sin(z / 300) + rng.normal(0, 3, count)
    return np.stack([x, wave, z], axis=1)


def plain_dbscan(eps: float, points: np.ndarray) -> np.ndarray:
    """Return the labels of scikit-learn."""
    return sklearn.cluster.DBSCAN(eps=eps, min_samples=10).fit(points).labels_


def renumbered(labels: np.ndarray) -> np.ndarray:
    """Return labels numbered by their first point; noise stays -1."""
    kept = labels >= 0
    _, first, inverse = np.unique(labels[kept], return_index=True, return_inverse=True)
    found = np.full(len(labels), -1)
    found[kept] = np.argsort(np.argsort(first))[inverse]
    return found


def plain_morphology(grid: int, points: np.ndarray) -> np.ndarray:
    """Return the labels on a full grid as section 5.1.3 runs it: no size rule, one dilation."""
    shifted = points - points.min(axis=0)
    stretched = grid * (shifted / shifted.max(axis=0))
    cell = tuple(np.floor(stretched + 0.5).astype(int).T)
    occupied = np.zeros((grid + 1,) * 3, bool)
    occupied[cell] = True
    labels = ndimage.label(ndimage.binary_dilation(occupied, CUBE), CUBE)[0][cell]
    return renumbered(labels)


def merge_clusters(clusters: dict[int, set[int]], most: float) -> dict[int, int]:
    """Return the centre that stands for each centre when too similar clusters are merged."""
    stands = {center: center for center in clusters}
    merged = True
    while merged:
        merged, at = False, {}
        for center, members in clusters.items():
            for point in members:
                at.setdefault(point, []).append(center)
        shared: dict[tuple[int, int], int] = {}
        for here in at.values():
            for i, one in enumerate(here):
                for other in here[:i]:
                    shared[other, one] = shared.get((other, one), 0) + 1
        for (one, other), count in shared.items():
            a, b = stands[one], stands[other]
            if count > most and a != b:
                merged = True
                clusters[a] |= clusters.pop(b)
                stands = {c: a if s == b else s for c, s in stands.items()}
    return stands


def plain_quasi_centers(k: int, alpha: float, points: np.ndarray) -> np.ndarray:
    """Return the labels by Eqs 2.37 to 2.41 with sets; for points without equal distances."""
    distances, nearest = cKDTree(points).query(points, k + 1)
    knn, sparsity = nearest[:, 1:], distances[:, -1]
    sparser = sparsity[knn] >= sparsity[:, None]
    sparse = [row[chosen].tolist() for row, chosen in zip(knn, sparser, strict=True)]
    center = np.ones(len(points), bool)
    center[knn[sparsity[knn] > sparsity[:, None]]] = False
    clusters: dict[int, set[int]] = {}
    for start in np.flatnonzero(center).tolist():
        todo, members = [start], {start}
        while todo:
            new = [j for j in sparse[todo.pop()] if j not in members]
            members.update(new)
            todo += new
        clusters[start] = members
    stands = merge_clusters(clusters, alpha * k)
    inside: list[list[int]] = [[] for _ in points]
    for one, members in clusters.items():
        for point in members:
            inside[point].append(one)
    labels = np.empty(len(points), int)
    for i in np.argsort(sparsity, kind="stable").tolist():
        exemplar = knn[i][np.argmin(sparsity[knn[i]])]
        one = inside[i][0] if len(inside[i]) == 1 else labels[exemplar]
        labels[i] = stands[i] if center[i] else one
    labels[np.bincount(labels)[labels] < k] = -1
    return renumbered(labels)


def against(step: str, ours: Clusterer, peer: Clusterer, name: str, points: np.ndarray) -> Row:
    """Return the comparison, the labels checked to be equal; the peer runs once."""
    kept: list[np.ndarray] = []
    what = (step, "points", len(points), name)
    ours(points[:1000])
    row = compare(what, lambda: ours(points), lambda: kept.append(peer(points)), repeats=1)
    np.testing.assert_array_equal(ours(points), kept[0])
    again = compare(what, lambda: ours(points), lambda: None, repeats=5).ours_s
    ours_s = min(again, row.ours_s)
    return row._replace(ours_s=ours_s, ratio=row.peer_s / ours_s)


def rows() -> list[Row]:
    """Return every comparison."""
    points = cloud()
    found = [
        against(
            "DBSCAN, both passes",
            lambda p: np.stack([WALL(p), PARTICLES(p)]),
            lambda p: np.stack([plain_dbscan(50.0, p), plain_dbscan(15.0, p)]),
            "scikit-learn",
            points,
        )
    ]
    for grid in (150, 400):
        step, plain = f"morphological clustering, R {grid}", partial(plain_morphology, grid)
        clusterer = MorphologicalClustering(grid)
        found.append(against(step, clusterer, plain, "definition in scipy", points))
    quasi = QuasiClusterCenters()
    sets = partial(plain_quasi_centers, quasi.k, quasi.alpha)
    found.append(against("quasi-cluster centres", quasi, sets, "definition in sets", points))
    return found
