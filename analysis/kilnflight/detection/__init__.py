r"""Detectors: from a foreground or a point cloud to particles.

Sections 2.2.2 to 2.2.6 of the thesis.

    (rows, cols) foreground -> detector -> (n, 3) row, col, radius in px
    (n, 3) points in mm, calibrated -> clusterer -> (n,) labels: 0, 1, ...; noise -1

=========================  ============  ==========================  =====================
detector                   equation      default                     source
=========================  ============  ==========================  =====================
`Otsu`                     2.11 to 2.20  none; particles from 5 px   sec. 2.2.2, Table 5.5
`DoG`                      2.21 to 2.28  local maximum of DoG 500    sec. 2.2.3, 5.1.2
=========================  ============  ==========================  =====================

=========================  ============  ==========================  =====================
clusterer                  equation      default                     source
=========================  ============  ==========================  =====================
`DBSCAN`                   none          eps 50 mm, min_points 10    sec. 2.2.4, Table 5.8
`MorphologicalClustering`  2.31 to 2.36  grid 150                    sec. 2.2.5, Table 5.9
`QuasiClusterCenters`      2.37 to 2.41  k 35, alpha 0.1             sec. 2.2.6, Table 5.10
=========================  ============  ==========================  =====================

Defaults are the best F1 of the tables, recomputed from their counts; the threshold of DoG is
the thesis's and belongs to its exposure. Clusters are numbered in the order of their first
point (`DBSCAN`: first core point, as scikit-learn does).
"""

from typing import Protocol

import numpy as np
import numpy.typing as npt

from kilnflight.detection.dbscan import DBSCAN, ScikitDBSCAN, k_distances
from kilnflight.detection.morphology import MorphologicalClustering
from kilnflight.detection.otsu import Otsu, otsu_threshold
from kilnflight.detection.quasi_centers import QuasiClusterCenters
from kilnflight.detection.sift import DoG, Polygon


class Detector2D(Protocol):
    """Find particles in a foreground."""

    def __call__(
        self, foreground: npt.NDArray[np.generic], within: Polygon | None = None, /
    ) -> npt.NDArray[np.float64]:
        """Return the particles (n, 3): row, col and radius in px.

        A foreground of one grey value has none. Where a polygon (row, col) is given, particles
        outside it need not be found.
        """


class Clusterer(Protocol):
    """Group the points of a cloud in clusters."""

    def __call__(self, points: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Return the label of each point (n, 3) in mm.

        Clusters are 0, 1, ...; noise is -1.
        """


DETECTORS_2D: tuple[Detector2D, ...] = (Otsu(), DoG(threshold=500.0))
CLUSTERERS: tuple[Clusterer, ...] = (DBSCAN(), MorphologicalClustering(), QuasiClusterCenters())

__all__ = [
    "CLUSTERERS",
    "DBSCAN",
    "DETECTORS_2D",
    "Clusterer",
    "Detector2D",
    "DoG",
    "MorphologicalClustering",
    "Otsu",
    "Polygon",
    "QuasiClusterCenters",
    "ScikitDBSCAN",
    "k_distances",
    "otsu_threshold",
]
