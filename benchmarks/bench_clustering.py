"""Clusters of a frame's point cloud against scikit-learn and the definitions in scipy.

The cloud is one frame of the twin, its depth calibrated by Eq. 2.4.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import sklearn.cluster
from measure import Row, compare
from tests.definitions import clusters

from kilnflight.camera import calibrate_depth
from kilnflight.detection import (
    DBSCAN,
    Clusterer,
    MorphologicalClustering,
    QuasiClusterCenters,
)
from kilnflight.simulated.kiln.scenes import open_scene

WALL = DBSCAN(50.0, 10)
PARTICLES = DBSCAN(15.0, 10)  # of the two passes, sec. 5.1.3


def cloud() -> np.ndarray:
    """Return the points of one frame in mm, about 200,000."""
    points = open_scene("V1").frame(75).xyz.astype(np.float64)
    points[:, 2] = calibrate_depth(points[:, 2])
    return points


def surface(count: int) -> np.ndarray:
    """Return points as dense as a frame's on a wavy wall that grows with their
    number.
    """
    rng = np.random.default_rng(count)
    length = 5.0 * np.sqrt(count)
    x, z = rng.uniform(0, length, (2, count))
    wave = 100 * np.sin(x / 300) * np.sin(z / 300) + rng.normal(0, 3, count)
    return np.stack([x, wave, z], axis=1)


def plain_dbscan(eps: float, points: np.ndarray) -> np.ndarray:
    """Return the labels of scikit-learn."""
    return sklearn.cluster.DBSCAN(eps=eps, min_samples=10).fit(points).labels_


def against(
    step: str, ours: Clusterer, peer: Clusterer, name: str, points: np.ndarray
) -> Row:
    """Return the comparison, the labels checked to be equal."""
    np.testing.assert_array_equal(ours(points), peer(points))
    return compare(
        (step, "points", len(points), name), lambda: ours(points), lambda: peer(points)
    )


def rows() -> list[Row]:
    """Return every comparison."""
    points = cloud()
    found = [
        against(
            "DBSCAN of all points, 50 and 15 mm",
            lambda p: np.stack([WALL(p), PARTICLES(p)]),
            lambda p: np.stack([plain_dbscan(50.0, p), plain_dbscan(15.0, p)]),
            "scikit-learn",
            points,
        )
    ]
    plain = partial(clusters.morphology, grid=400)
    name = "morphological clustering, R 400"
    found.append(
        against(
            name, MorphologicalClustering(400), plain, "definition in scipy", points
        )
    )
    quasi = QuasiClusterCenters()
    sets = partial(clusters.quasi_centers, k=quasi.k, alpha=quasi.alpha)
    found.append(
        against("quasi-cluster centres", quasi, sets, "definition in sets", points)
    )
    return found
