r"""Detection of particles in a point cloud (thesis, sections 2.2.4 to 2.2.6).

    (n, 3) points in mm, calibrated -> clusterer -> (n,) labels: 0, 1, ...; noise -1

=========================  ============  ==========================  =====================
clusterer                  equation      default                     source
=========================  ============  ==========================  =====================
`DBSCAN`                   none          eps 50 mm, min_points 10    sec. 2.2.4, Table 5.8
`MorphologicalClustering`  2.31 to 2.36  grid 150                    sec. 2.2.5, Table 5.9
`QuasiClusterCenters`      2.37 to 2.41  k 35, alpha 0.1             sec. 2.2.6, Table 5.10
=========================  ============  ==========================  =====================

Defaults are the best F1 of the tables, recomputed from their counts. Clusters are numbered
in the order of their first point (`DBSCAN`: first core point, as scikit-learn does).
"""

from typing import Protocol

import numpy as np
import numpy.typing as npt

from kilnflight.detection.dbscan import DBSCAN, k_distances
from kilnflight.detection.morphology import MorphologicalClustering
from kilnflight.detection.quasi_centers import QuasiClusterCenters


class Clusterer(Protocol):
    """What groups the points of a cloud."""

    def __call__(self, points: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Return the label of each of (n, 3) points in mm; noise is -1."""


CLUSTERERS: tuple[Clusterer, ...] = (DBSCAN(), MorphologicalClustering(), QuasiClusterCenters())

__all__ = [
    "CLUSTERERS",
    "DBSCAN",
    "Clusterer",
    "MorphologicalClustering",
    "QuasiClusterCenters",
    "k_distances",
]
