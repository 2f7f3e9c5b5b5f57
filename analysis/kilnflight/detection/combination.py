"""The combined detector of keypoints and clusters (chapter 3.1).

A 2D detector finds keypoints in the foreground. A clusterer finds clusters among the points
without the wall, which is the largest cluster of a first pass. Keypoints and clusters that share a
pixel of the image are one potential particle. Their numbers decide its case, and each case asks
the grey values another question.

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

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from numba import njit
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from kilnflight.camera import inside
from kilnflight.checks import (
    InputError,
    check_at_least,
    check_count,
    check_finite,
    check_positive,
    check_shape,
)
from kilnflight.detection import DBSCAN, Clusterer, Detector2D, DoG, Polygon
from kilnflight.detection.peaks import Evidence
from kilnflight.tables import DETECTIONS

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
SHORT = 1 << 16  # labels of 16 bits
SMALLEST_DISC_PX = 1.0  # a keypoint covers at least the pixels next to its own
# By how many keypoints and clusters share pixels, 2 for several. The last is not in the thesis.
CASES = {(1, 1): 1, (2, 1): 2, (1, 2): 3, (0, 1): 4, (1, 0): 5, (2, 2): 2}


@dataclass(frozen=True)
class Clusters:
    """Points of several clusters, one cluster after the other."""

    pixels: Index  # (n, 2) row and col, cluster after cluster
    xyz: Array  # (n, 3) mm
    start: Index  # (clusters + 1,) where each begins

    def __len__(self) -> int:
        """Return the number of clusters."""
        return len(self.start) - 1

    @property
    def total(self) -> int:
        """Return the number of points."""
        return len(self.pixels)

    @property
    def centers(self) -> Array:
        """Return mean row and column (clusters, 2) of each cluster."""
        sums = np.add.reduceat(self.pixels.astype(np.float64), self.start[:-1], axis=0)
        return np.asarray(sums / np.diff(self.start)[:, None])

    @property
    def rectangles(self) -> Index:
        """Return the rectangle (clusters, 4) of each cluster.

        Columns are those of `rectangle`.
        """
        low, high = (
            edge.reduceat(self.pixels, self.start[:-1], axis=0) for edge in (np.minimum, np.maximum)
        )
        return np.stack([low[:, 0], high[:, 0] + 1, low[:, 1], high[:, 1] + 1], axis=1)

    @property
    def extent(self) -> Index:
        """Return the larger side of each cluster's rectangle in pixels."""
        top, bottom, left, right = self.rectangles.T
        return np.maximum(bottom - top, right - left)

    def take(self, which: npt.NDArray[np.generic]) -> Clusters:
        """Return the chosen clusters, by indices or a mask."""
        chosen = np.arange(len(self))[which]
        sizes = np.diff(self.start)[chosen]
        start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)
        point = np.repeat(self.start[:-1][chosen] - start[:-1], sizes) + np.arange(start[-1])
        return Clusters(self.pixels.take(point, axis=0), self.xyz.take(point, axis=0), start)

    def only(self, points: npt.NDArray[np.bool_]) -> Clusters:
        """Return one cluster of the chosen points."""
        return Clusters(self.pixels[points], self.xyz[points], np.array([0, points.sum()]))

    def center(self) -> tuple[float, float, float]:
        """Return row, column and radius in pixels of all clusters as one."""
        row, col = self.pixels.mean(axis=0)
        return float(row), float(col), float(np.sqrt(self.total / np.pi))

    def place(self) -> tuple[float, float, float, int]:
        """Return mean x, y, z in mm and the number of all points."""
        x, y, z = self.xyz.mean(axis=0)
        return float(x), float(y), float(z), self.total

    def rectangle(self, disc: Array | None = None) -> Index:
        """Return the rectangle (4,) around all clusters.

        First row, row after the last, first column, column after the last.

        Parameters
        ----------
        disc
            Row, column and radius; only points in it count.
        """
        pixels = self.pixels
        if disc is not None:
            far = np.hypot(pixels[:, 0] - disc[0], pixels[:, 1] - disc[1])
            pixels = pixels[far <= max(disc[2], SMALLEST_DISC_PX)]
        low, high = pixels.min(axis=0), pixels.max(axis=0) + 1
        return np.array([low[0], high[0], low[1], high[1]])

    def nearest(self, spots: Array) -> Index:
        """Return the index of the spot (k, 2) nearest to each point."""
        return np.argmin(((self.pixels[:, None] - spots) ** 2).sum(axis=2), axis=1)


def summarise(pixels: npt.NDArray[np.integer], xyz: Array, labels: Index) -> Clusters:
    """Return the clusters of labelled points; label -1 belongs to none.

    Parameters
    ----------
    pixels, xyz
        (n, 2) row and col, and (n, 3) mm.
    labels
        (n,) of a clusterer.
    """
    check_shape(np.asarray(pixels), (len(labels), 2), "clusters: pixels")
    check_shape(np.asarray(xyz), (len(labels), 3), "clusters: xyz")
    labelled = np.flatnonzero(labels >= 0)
    label = labels[labelled]
    sizes = np.bincount(label)
    # numpy sorts 16 bits by digits, which is ten times faster
    short = label.astype(np.uint16) if len(sizes) <= SHORT else label
    order = labelled[np.argsort(short, kind="stable")]
    start = np.concatenate([[0], np.cumsum(sizes[sizes > 0])]).astype(np.intp)
    # rows are taken: indexing narrow rows is several times slower
    rows, places = np.take(pixels, order, axis=0), np.take(xyz, order, axis=0)
    return Clusters(rows.astype(np.intp), places.astype(np.float64, copy=False), start)


def potential_particles(
    keypoints: Array, clusters: Clusters, shape: tuple[int, ...]
) -> Iterator[tuple[int, Index, Index]]:
    """Yield case, keypoints and clusters of each potential particle.

    Parameters
    ----------
    keypoints
        (k, 3) row, column and radius.
    clusters
        Of the same frame.
    shape
        Rows and columns of the frame.
    """
    spots, groups = len(keypoints), len(clusters)
    if not spots + groups:
        return
    owner = np.zeros(shape, dtype=np.int32)  # of each pixel: its cluster, counted from 1
    owner[tuple(clusters.pixels.T)] = np.repeat(np.arange(groups) + 1, np.diff(clusters.start))
    spot, row, col = disc_pixels(keypoints, SMALLEST_DISC_PX, shape)
    group = owner[row, col] - 1
    ends = (spot[group >= 0], spots + group[group >= 0])
    links = coo_array((np.ones(len(ends[0])), ends), shape=2 * (spots + groups,))
    _, part = connected_components(links, directed=False)
    order = np.argsort(part, kind="stable")  # of each part the keypoints come first
    clusters_of = order - spots
    sizes = np.bincount(part)
    first, begin = np.bincount(part[:spots], minlength=len(sizes)).tolist(), 0
    for count, size in zip(first, sizes.tolist(), strict=True):
        middle, end = begin + count, begin + size
        case = CASES[min(count, 2), min(size - count, 2)]
        yield case, order[begin:middle], clusters_of[middle:end]
        begin = end


def disc_pixels(
    discs: Array, smallest: float, shape: tuple[int, ...]
) -> tuple[Index, Index, Index]:
    """Return disc, row and column (m,) of each pixel within a disc.

    Parameters
    ----------
    discs
        (n, 3) row, column and radius.
    smallest
        Radius of discs that are smaller.
    shape
        Rows and columns of the image.
    """
    center, radius = discs[:, :2], np.maximum(discs[:, 2:], smallest)
    low = np.maximum(np.ceil(center - radius), 0).astype(np.intp)
    high = np.minimum(np.floor(center + radius) + 1, shape).astype(np.intp)
    height, width = np.maximum(high - low, 0).T
    disc = np.repeat(np.arange(len(discs)), height * width)
    inner = np.arange(len(disc)) - np.repeat(
        np.cumsum(height * width) - height * width, height * width
    )
    row, col = np.divmod(inner, width[disc])
    row, col = row + low[disc, 0], col + low[disc, 1]
    squares = (row - center[disc, 0]) ** 2 + (col - center[disc, 1]) ** 2
    within = squares <= (radius**2)[disc, 0]
    return disc[within], row[within], col[within]


def mean_gray(gray: npt.NDArray[np.generic], discs: Array) -> Array:
    """Return the mean grey value within each disc.

    Discs (n, 3) are row, column and radius. A disc covers at least the pixel nearest to its
    centre; pixels outside the image do not count.
    """
    nearest = np.rint(discs[:, :2]).astype(np.intp).clip(0, np.array(gray.shape) - 1)
    means = gray[tuple(nearest.T)].astype(np.float64)
    half = gray.dtype == np.float16  # numba knows neither float16 nor foreign byte order
    native = gray.astype(np.float32 if half else gray.dtype.newbyteorder("="), copy=False)
    _disc_means(native, np.asarray(discs, np.float64), means)
    return means


@njit(cache=True)
def _disc_means(gray: Any, discs: Any, means: Any) -> None:
    """Write the mean of each disc that covers a pixel into ``means``.

    Compiled: a campaign asks for some ten thousand discs, again for each step that is replaced.
    """
    rows, cols = gray.shape
    for k in range(len(discs)):
        row, col, radius = discs[k]
        top, left = max(int(np.ceil(row - radius)), 0), max(int(np.ceil(col - radius)), 0)
        bottom = min(int(np.floor(row + radius)) + 1, rows)
        right = min(int(np.floor(col + radius)) + 1, cols)
        count, total = 0, 0.0
        for i in range(top, bottom):
            for j in range(left, right):
                if (i - row) ** 2 + (j - col) ** 2 <= radius**2:
                    count += 1
                    total += gray[i, j]
        if count:
            means[k] = total / count


class View(NamedTuple):
    """Images and points of one frame, as a detector uses them."""

    gray: npt.NDArray[np.uint16]  # (rows, cols)
    previous: npt.NDArray[np.uint16]  # (rows, cols), the frame before
    foreground: npt.NDArray[np.float32]  # (rows, cols), without the flame
    pixels: npt.NDArray[np.integer]  # (n, 2) row and col of the points, without the flame
    xyz: Array  # (n, 3) mm, depth after Eq. 2.4


@dataclass(frozen=True)
class Combination:
    """Combine any 2D detector with any clusterer.

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
        A cluster that is wider or higher is no particle and left out; its keypoints are case 5.
        Twice the 45 px that section 3.3 derives from the largest radii (Fig. 3.12). The thesis
        does not say what happens to remains of the wall.
    """

    detector: Detector2D = field(default_factory=DoG)
    clusterer: Clusterer = field(default_factory=lambda: DBSCAN(eps=15.0, min_points=10))  # 5.1.3
    wall: Clusterer = field(default_factory=lambda: DBSCAN(eps=50.0, min_points=10))  # 5.1.3
    prominence: float = 5.0
    share: float = 0.1
    margin_px: int = 3
    largest_px: int = 90

    def __post_init__(self) -> None:
        """Refuse parameters out of range."""
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
            Polygon (row, col); particles outside are left out.
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
        """Return the particles of keypoints (k, 3) and point labels (n,).

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
            small &= inside(roi, *clusters.centers.T)
        clusters = clusters.take(small)
        evidence = Evidence.of(view.gray, view.previous, self.prominence, self.share)
        moved = evidence.moved(widened(clusters.rectangles, self.margin_px))
        particles: list[Particle] = []
        for case, spots, groups in potential_particles(keypoints, clusters, view.gray.shape):
            if case == 4 and not moved[groups[0]]:  # most; tested at once for speed
                continue
            parts = keypoints[spots], clusters.take(groups)
            particles += decide_case(case, *parts, evidence, self.margin_px)
        return _table(particles, frame, view.gray)


def _table(
    particles: Sequence[Particle], frame: int, gray: npt.NDArray[np.generic]
) -> pd.DataFrame:
    """Return `kilnflight.tables.DETECTIONS` of a frame's particles, column by column."""
    values = np.array(particles, np.float64).reshape(-1, len(Particle._fields))
    columns = dict(zip(Particle._fields, values.T, strict=True))
    columns |= {"frame": np.full(len(values), frame), "gray": mean_gray(gray, values[:, :3])}
    return pd.DataFrame({c.name: columns[c.name].astype(c.kind) for c in DETECTIONS.columns})


def check_view(view: View, labels: Index, where: str) -> None:
    """Raise an `InputError` unless the parts of a view fit together."""
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
    """Return the labels (n,) of the second pass; wall and noise are -1."""
    first = wall(xyz)
    labels = np.full(len(xyz), -1, dtype=np.intp)
    on_wall = np.zeros(len(xyz), dtype=bool)
    if (first >= 0).any():
        on_wall = first == np.bincount(first[first >= 0]).argmax()
    labels[~on_wall] = clusterer(xyz.compress(~on_wall, axis=0))
    return labels


class Particle(NamedTuple):
    """One row of the table of detections."""

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


def decide_case(
    case: int, spots: Array, clusters: Clusters, evidence: Evidence, margin: int
) -> list[Particle]:
    """Return the particles of a potential particle by its case.

    Parameters
    ----------
    case, spots, clusters
        Its case, its keypoints (k, 3) and its clusters.
    evidence
        Peaks and changes of the grey values.
    margin
        Widens every area, in px.
    """
    if case == 1:
        return [_particle(spots[0], clusters.place(), 1)]
    if case in (2, 3):
        area = clusters.rectangle() if case == 2 else clusters.rectangle(disc=spots[0])
        peaks = evidence.peaks(widened(area, margin))
        if len(peaks) > 1:
            return list(_shared(peaks, clusters, spots, case))
        return [_particle(clusters.center() if case == 2 else spots[0], clusters.place(), case)]
    if case == 4:
        area, spot, place = clusters.rectangle(), clusters.center(), clusters.place()
    else:
        row, col, radius = spot = spots[0]
        around = np.array([row - radius, row + radius + 1, col - radius, col + radius + 1])
        area, place = np.round(around).astype(np.intp), NOWHERE
    return [_particle(spot, place, case)] if evidence.real(widened(area, margin)) else []


def widened(area: Index, margin: int) -> Index:
    """Return the rectangle (4,) with a margin on every side."""
    return area + margin * np.array([-1, 1, -1, 1])


def _shared(peaks: Array, clusters: Clusters, spots: Array, case: int) -> Iterator[Particle]:
    """Yield one particle per peak, with the points nearest to it."""
    owner = clusters.nearest(peaks[:, :2])
    smallest = float(spots[:, 2].min())
    for number, (row, col) in enumerate(peaks[:, :2]):
        part = clusters.only(owner == number)
        radius = max(part.center()[2], smallest) if part.total else smallest
        yield _particle((row, col, radius), part.place() if part.total else NOWHERE, case)
