"""The combined detector: what the picture shows against what the cloud shows (chapter 3.1).

A 2D detector finds keypoints in the foreground, a clusterer finds clusters among the points
that are left when the wall (the largest cluster of a first pass) is gone. Keypoints and
clusters that overlap in the image are one potential particle; how many of each it has
decides which of five cases it is, and each case asks the grey values another question.

=====  =========  ========  ===========================================================
case   keypoints  clusters  decision
=====  =========  ========  ===========================================================
1      1          1         a particle
2      several    1         as many as grey-value peaks in the cluster's rectangle
3      1          several   as many as peaks where disc and clusters overlap
4      none       1         if a peak or trough is there and in the frame difference
5      1          none      likewise, in the disc's rectangle
=====  =========  ========  ===========================================================

Several keypoints with several clusters are not in the thesis; they are decided as case 2.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.camera import inside
from kilnflight.checks import (
    InputError,
    check_at_least,
    check_count,
    check_finite,
    check_positive,
    check_shape,
)
from kilnflight.detection import DBSCAN, Clusterer, Detector2D, DoG
from kilnflight.detection.correspondence import Clusters, mean_gray, potential_particles, summarise
from kilnflight.detection.evidence import Evidence
from kilnflight.tables import DETECTIONS

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Polygon = tuple[tuple[float, float], ...]


class View(NamedTuple):
    """One frame as a detector sees it; arrays."""

    gray: npt.NDArray[np.uint16]  # (rows, cols)
    previous: npt.NDArray[np.uint16]  # (rows, cols), the frame before
    foreground: npt.NDArray[np.float32]  # (rows, cols), without the flame
    pixels: npt.NDArray[np.integer]  # (n, 2) row and col of the points, without the flame
    xyz: Array  # (n, 3) mm, depth after Eq. 2.4


@dataclass(frozen=True)
class Combination:
    """Any 2D detector with any clusterer.

    Parameters
    ----------
    detector, clusterer
        Of the pictures and of the points without the wall.
    wall
        First pass, with the parameters of highest precision: its largest cluster is the wall.
    prominence
        By how many times the noise a peak must stand out. The thesis does not say; in an
        area of noise alone, of some hundred pixels, the highest stands out by about 3.5.
    share
        A second peak must stand out by this share of the highest: in saturated or flickering
        flames the noise is larger than elsewhere.
    margin_px
        Widens every area, so that its border shows what surrounds the particle.
    largest_px
        A cluster that is wider or higher is no particle and left out; its keypoints are case
        5. Twice the 45 px that section 3.3 derives from the largest radii (Fig. 3.12); the
        thesis does not say what becomes of what is left of the wall.
    """

    detector: Detector2D = field(default_factory=DoG)
    clusterer: Clusterer = field(default_factory=lambda: DBSCAN(eps=15.0, min_points=10))  # 5.1.3
    wall: Clusterer = field(default_factory=lambda: DBSCAN(eps=50.0, min_points=10))  # 5.1.3
    prominence: float = 5.0
    share: float = 0.1
    margin_px: int = 3
    largest_px: int = 90

    def __post_init__(self) -> None:
        """Refuse parameters that decide nothing."""
        check_positive(self.prominence, "Combination: prominence")
        check_at_least(self.share, 0, "Combination: share")
        check_count(self.margin_px, "Combination: margin_px", 0)
        check_count(self.largest_px, "Combination: largest_px")

    def __call__(self, view: View, roi: Polygon | None = None, frame: int = 0) -> pd.DataFrame:
        """Return the particles of a frame.

        Parameters
        ----------
        view
            The frame.
        roi
            Polygon (row, col) outside which nothing is looked at.
        frame
            Number of the frame, for the table.

        Returns
        -------
        DataFrame
            `kilnflight.tables.DETECTIONS`.
        """
        labels = second_pass(view.xyz, self.wall, self.clusterer)
        return self.decide(view, self.detector(view.foreground, roi), labels, roi, frame)

    def decide(
        self,
        view: View,
        keypoints: Array,
        labels: Index,
        roi: Polygon | None = None,
        frame: int = 0,
    ) -> pd.DataFrame:
        """Return the particles, given keypoints (k, 3) and labels (n,) of the points.

        Raises
        ------
        InputError
            If the parts of the view do not belong together, or a keypoint is not finite.
        """
        keypoints = check_finite(keypoints, f"frame {frame}: keypoints")
        check_shape(keypoints, (None, 3), f"frame {frame}: keypoints")
        check_view(view, labels, f"frame {frame}")
        clusters = summarise(view.pixels, view.xyz, labels)
        small = clusters.extent <= self.largest_px
        if roi is not None:
            keypoints = keypoints[inside(roi, keypoints[:, 0], keypoints[:, 1])]
            small &= inside(roi, clusters.row, clusters.col)
        clusters = clusters.take(small)
        evidence = Evidence.of(view.gray, view.previous, self.prominence, self.share)
        moved = evidence.moved(widened(clusters.rectangles, self.margin_px))
        found: list[Particle] = []
        for kind, spots, groups in potential_particles(keypoints, clusters, view.gray.shape):
            if kind == 4 and not moved[groups[0]]:  # most are; asked of all at once for speed
                continue
            found += CASES[kind](keypoints[spots], clusters.take(groups), evidence, self.margin_px)
        table = pd.DataFrame(found, columns=list(Particle._fields))
        disc = table[["row", "col", "radius_px"]].to_numpy(dtype=np.float64)
        table = table.assign(frame=frame, gray=mean_gray(view.gray, disc))
        return table.astype({c.name: c.kind for c in DETECTIONS.columns})[DETECTIONS.names]


def check_view(view: View, labels: Index, where: str) -> None:
    """Raise an `InputError` unless images, points and labels of a view belong together."""
    shape = view.gray.shape
    check_shape(view.previous, shape, f"{where}: the frame before")
    check_shape(view.foreground, shape, f"{where}: foreground")
    check_shape(view.pixels, (len(view.xyz), 2), f"{where}: pixels of the points")
    check_shape(labels, (len(view.xyz),), f"{where}: labels of the points")
    row, col = view.pixels.T  # each for itself: along narrow rows numpy is slow
    if len(labels) and (view.pixels.min() < 0 or row.max() >= shape[0] or col.max() >= shape[1]):
        outside = ((view.pixels < 0) | (view.pixels >= shape)).any(axis=1)
        first = int(np.argmax(outside))
        raise InputError(
            f"{where}: point {first} belongs to pixel {tuple(view.pixels[first].tolist())} of an "
            f"image of {shape[0]} x {shape[1]}. Give row and col of the image, from 0."
        )


def second_pass(xyz: Array, wall: Clusterer, clusterer: Clusterer) -> Index:
    """Return the labels (n,) of the second pass; points of the wall and noise are -1."""
    first = wall(xyz)
    labels = np.full(len(xyz), -1, dtype=np.intp)
    on_wall = np.zeros(len(xyz), dtype=bool)
    if (first >= 0).any():
        on_wall = first == np.bincount(first[first >= 0]).argmax()
    labels[~on_wall] = clusterer(xyz.compress(~on_wall, axis=0))
    return labels


class Particle(NamedTuple):
    """One detection; a row of the table."""

    row: float
    col: float
    radius_px: float
    x: float
    y: float
    z: float
    points: int
    case: int


Place = tuple[float, float, float, int]  # x, y, z in mm, number of points
NOWHERE: Place = (np.nan, np.nan, np.nan, 0)


def _particle(spot: Iterable[float], place: Place, case: int) -> Particle:
    row, col, radius = spot
    return Particle(float(row), float(col), float(radius), *place, case)


def case_1(spots: Array, clusters: Clusters, _: Evidence, __: int) -> list[Particle]:
    """Return one particle: where the keypoint is, as deep as the cluster."""
    return [_particle(spots[0], clusters.place(), 1)]


def case_2(spots: Array, clusters: Clusters, evidence: Evidence, margin: int) -> list[Particle]:
    """Return as many particles as the clusters' rectangle has peaks; at least one."""
    peaks = evidence.peaks(widened(clusters.rectangle(), margin))
    if len(peaks) < 2:
        return [_particle(clusters.center(), clusters.place(), 2)]
    return list(_shared(peaks, clusters, spots, 2))


def case_3(spots: Array, clusters: Clusters, evidence: Evidence, margin: int) -> list[Particle]:
    """Return as many particles as there are peaks where the disc overlaps the clusters."""
    overlap = clusters.rectangle(disc=spots[0])
    peaks = evidence.peaks(widened(overlap, margin))
    if len(peaks) < 2:
        return [_particle(spots[0], clusters.place(), 3)]
    return list(_shared(peaks, clusters, spots, 3))


def case_4(_: Array, clusters: Clusters, evidence: Evidence, margin: int) -> list[Particle]:
    """Return the cluster as a particle if it stands out in the frame and has moved."""
    if not evidence.real(widened(clusters.rectangle(), margin)):
        return []
    return [_particle(clusters.center(), clusters.place(), 4)]


def case_5(spots: Array, _: Clusters, evidence: Evidence, margin: int) -> list[Particle]:
    """Return the keypoint as a particle if it stands out in the frame and has moved."""
    row, col, radius = spots[0]
    around = np.array([row - radius, row + radius + 1, col - radius, col + radius + 1])
    if not evidence.real(widened(np.round(around).astype(np.intp), margin)):
        return []
    return [_particle(spots[0], NOWHERE, 5)]


CASES = {1: case_1, 2: case_2, 3: case_3, 4: case_4, 5: case_5}


def widened(area: Index, margin: int) -> Index:
    """Return the rectangle (4,) with a margin on every side."""
    return area + margin * np.array([-1, 1, -1, 1])


def _shared(peaks: Array, clusters: Clusters, spots: Array, case: int) -> Iterator[Particle]:
    """Yield a particle per peak; each point of the clusters belongs to the nearest peak."""
    owner = clusters.nearest(peaks[:, :2])
    smallest = float(spots[:, 2].min())
    for number, (row, col) in enumerate(peaks[:, :2]):
        own = clusters.only(owner == number)
        radius = max(own.center()[2], smallest) if own.total else smallest
        yield _particle((row, col, radius), own.place() if own.total else NOWHERE, case)
