"""Methods compared in section 5.1.3: their inputs and their parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from kilnflight.detection import (
    DBSCAN,
    Clusterer,
    Detector2D,
    DoG,
    MorphologicalClustering,
    Otsu,
    Polygon,
    QuasiClusterCenters,
)
from kilnflight.detection.combination import Combination, View, second_pass, summarise
from kilnflight.recording.frames import Recording, calibrated_cloud

# Thresholds of DoG that are tried, in grey values: two per octave, from below the noise of one
# frame to beyond the brightest flames. The exposure of the thesis is not known (twin.md).
THRESHOLDS = tuple(round(100 * 2 ** (k / 2)) for k in range(12))


Method = Callable[[View], npt.NDArray[np.float64]]  # -> (n, 2 or more) row, col
Foreground = npt.NDArray[np.float32]


# First and second pass of the combination (section 5.1.3); DBSCAN's first pass is printed as
# the set of highest precision, which 15 points in 70 mm is (Table 5.8).
PASSES: dict[str, tuple[Clusterer, Clusterer]] = {
    "DBSCAN": (DBSCAN(eps=50.0, min_points=10), DBSCAN(eps=15.0, min_points=10)),
    "MO": (MorphologicalClustering(100), MorphologicalClustering(400)),
    "QCC": (QuasiClusterCenters(35, 0.1), QuasiClusterCenters(20, 0.2)),
}


def from_foreground(detector: Detector2D) -> Method:
    """Return a 2D detector as a method."""
    return lambda view: detector(view.foreground)


def from_thresholds(
    thresholds: Iterable[float], change: Callable[[Foreground], Foreground] = lambda image: image
) -> dict[float, Method]:
    """Return DoG with each threshold as a method, from one call for each view.

    Parameters
    ----------
    thresholds
        In grey values.
    change
        What is done to a foreground before.
    """
    ascending = sorted(thresholds)
    lowest = DoG(float(min(ascending, default=0.0)))
    graded = _Remembered(lambda view: lowest.graded(change(view.foreground)))

    def above(threshold: float, view: View) -> npt.NDArray[np.float64]:
        particles = graded(view)
        return particles[particles[:, 3] >= threshold, :3]

    return {threshold: partial(above, float(threshold)) for threshold in ascending}


def eight_bits(foreground: Foreground) -> Foreground:
    """Return a foreground rounded to 256 levels, which is what OpenCV's SIFT takes."""
    step = np.float32(65_535 / 255)
    return np.rint(foreground / step) * step


def from_cloud(clusterer: Clusterer) -> Method:
    """Return a clusterer as a method: the centre of each cluster's pixels.

    Section 3.1 of the thesis.
    """

    def centers(view: View) -> npt.NDArray[np.float64]:
        clusters = summarise(view.pixels, view.xyz, clusterer(view.xyz))
        return clusters.centers

    return centers


def table_5_11_methods(threshold: float, roi: Polygon | None) -> dict[str, Method]:
    """Return the eleven methods of Table 5.11 under their printed names.

    Parameters
    ----------
    threshold
        Of DoG, in grey values.
    roi
        Polygon (row, col) in which the combined detector detects.

    Notes
    -----
    The two combinations with one clusterer share its passes over a frame; their time is not
    that of either alone.
    """
    detectors: dict[str, Detector2D] = {"OTSU": Otsu(), "SIFT": DoG(threshold)}
    methods = {f"2D-{name}": from_foreground(detector) for name, detector in detectors.items()}
    methods["3D-DBSCAN Clustering"] = from_cloud(DBSCAN(eps=50.0, min_points=10))
    methods["3D-MO-based Clustering"] = from_cloud(MorphologicalClustering(150))
    methods["3D-QCC Clustering"] = from_cloud(QuasiClusterCenters(30, 0.1))
    for cloud, passes in PASSES.items():
        labels = _Remembered(partial(_labels, passes))
        for name, detector in detectors.items():
            methods[f"Combi {name}+{cloud}"] = partial(_combined, detector, labels, roi)
    return methods


def _labels(passes: tuple[Clusterer, Clusterer], view: View) -> npt.NDArray[np.intp]:
    return second_pass(view.xyz, *passes)


def _combined(
    detector: Detector2D, labels: Callable[[View], Any], roi: Polygon | None, view: View
) -> npt.NDArray[np.float64]:
    table = Combination(detector).decide(view, detector(view.foreground), labels(view), roi)
    return table[["row", "col"]].to_numpy()


class _Remembered:
    """A function of a view that keeps its last view's value, for several methods."""

    def __init__(self, function: Callable[[View], Any]) -> None:
        self.function = function
        self.last: tuple[View, Any] | None = None

    def __call__(self, view: View) -> Any:
        if self.last is None or self.last[0] is not view:
            self.last = (view, self.function(view))
        return self.last[1]


def wall_points(recording: Recording, frame: int) -> npt.NDArray[np.float64]:
    """Return the calibrated points on the wall: DBSCAN's largest cluster, first pass."""
    points = calibrated_cloud(recording, frame)
    labels = PASSES["DBSCAN"][0](points)
    return points[labels == np.bincount(labels[labels >= 0]).argmax()]
