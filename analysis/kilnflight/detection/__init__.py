"""Detectors: from a foreground or a point cloud to particles.

Sections 2.2.2 to 2.2.6 of the thesis.

    (rows, cols) foreground -> detector -> (n, 3) row, col, radius in px
    (n, 3) points in mm, calibrated -> clusterer -> (n,) labels: 0, 1, ...; noise -1

=====================  ============  ========================  =================
detector               equation      default                   source
=====================  ============  ========================  =================
`Otsu`                 2.11 to 2.20  particles from 5 px       2.2.2, Table 5.5
`DoG`                  2.21 to 2.28  local maximum of DoG 500  2.2.3, 5.1.2
=====================  ============  ========================  =================

=========================  ============  =====================  =================
clusterer                  equation      default                source
=========================  ============  =====================  =================
`DBSCAN`                   none          50 mm, 10 points       2.2.4, Table 5.8
`MorphologicalClustering`  2.31 to 2.36  grid 150               2.2.5, Table 5.9
`QuasiClusterCenters`      2.37 to 2.41  k 35, alpha 0.1        2.2.6, Table 5.10
=========================  ============  =====================  =================

Defaults are the best F1 of the tables, recomputed from their counts; the threshold of
DoG is the thesis's and belongs to its exposure. Clusters are numbered in the order of
their first point (`DBSCAN`: first core point, as scikit-learn does).
"""

from collections.abc import Callable

from kilnflight.arrays import Array, ArrayLike, Index
from kilnflight.detection.dbscan import DBSCAN, k_distances
from kilnflight.detection.morphology import MorphologicalClustering
from kilnflight.detection.otsu import Otsu
from kilnflight.detection.quasi_centers import QuasiClusterCenters
from kilnflight.detection.sift import DoG, Polygon

Clusterer = Callable[[ArrayLike], Index]
# Takes a foreground and, if not all of it is searched, a polygon; returns row, col and
# radius (n, 3) in px.
Detector2D = Callable[..., Array]
