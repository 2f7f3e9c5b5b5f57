"""Which keypoints and which clusters are the same potential particle (chapter 3.1).

Every point of the cloud belongs to a pixel, so a cluster covers an area of the image, and a
keypoint covers a disc; where both cover the same pixel they belong together.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from kilnflight.checks import check_shape

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
SHORT = 1 << 16  # labels of 16 bits
SMALLEST_DISC_PX = 1.0  # a keypoint covers at least the pixels next to its own


@dataclass(frozen=True)
class Clusters:
    """Clusters as stretches of their points; arrays."""

    pixels: Index  # (n, 2) row and col, cluster after cluster
    xyz: Array  # (n, 3) mm
    start: Index  # (clusters + 1,) where each begins

    def __len__(self) -> int:
        """Return how many clusters there are."""
        return len(self.start) - 1

    @property
    def total(self) -> int:
        """Number of points."""
        return len(self.pixels)

    @property
    def row(self) -> Array:
        """Mean row of each cluster."""
        return self._means(self.pixels[:, 0])

    @property
    def col(self) -> Array:
        """Mean column of each cluster."""
        return self._means(self.pixels[:, 1])

    def _means(self, values: npt.NDArray[np.integer]) -> Array:
        if not len(self):
            return np.empty(0)
        return np.add.reduceat(values.astype(np.float64), self.start[:-1]) / np.diff(self.start)

    @property
    def extent(self) -> Index:
        """Larger side of each cluster's rectangle in pixels."""
        top, bottom, left, right = self.rectangles.T
        return np.maximum(bottom - top, right - left)

    @property
    def rectangles(self) -> Index:
        """Rectangle (clusters, 4) of each cluster, as `rectangle` has it of all."""
        if not len(self):
            return np.empty((0, 4), dtype=np.intp)
        low, high = (
            edge.reduceat(self.pixels, self.start[:-1], axis=0) for edge in (np.minimum, np.maximum)
        )
        return np.stack([low[:, 0], high[:, 0] + 1, low[:, 1], high[:, 1] + 1], axis=1)

    def take(self, which: npt.NDArray[np.generic]) -> Clusters:
        """Return some of the clusters (indices or a mask)."""
        chosen = np.arange(len(self))[which]
        sizes = np.diff(self.start)[chosen]
        start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)
        point = np.repeat(self.start[:-1][chosen] - start[:-1], sizes) + np.arange(start[-1])
        return Clusters(self.pixels.take(point, axis=0), self.xyz.take(point, axis=0), start)

    def only(self, points: npt.NDArray[np.bool_]) -> Clusters:
        """Return one cluster of some of the points."""
        return Clusters(self.pixels[points], self.xyz[points], np.array([0, points.sum()]))

    def center(self) -> tuple[float, float, float]:
        """Return row, column and radius in pixels of all clusters as one."""
        row, col = self.pixels.mean(axis=0)
        return float(row), float(col), float(np.sqrt(self.total / np.pi))

    def place(self) -> tuple[float, float, float, int]:
        """Return mean x, y, z in mm of all clusters as one, and the number of points."""
        x, y, z = self.xyz.mean(axis=0)
        return float(x), float(y), float(z), self.total

    def rectangle(self, disc: Array | None = None) -> Index:
        """Return first row, row after the last, first column, column after the last.

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
        """Return for each point which of ``spots`` (k, 2) is nearest in the image."""
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
    """Yield every potential particle: its case, its keypoints and its clusters.

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
    owner = np.full(shape, -1, dtype=np.int32)
    cluster = np.repeat(np.arange(groups, dtype=np.int32), np.diff(clusters.start))
    owner[clusters.pixels[:, 0], clusters.pixels[:, 1]] = cluster
    spot, group = _overlaps(owner, np.ascontiguousarray(keypoints, dtype=np.float64))
    nodes = spots + groups
    links = coo_array((np.ones(len(spot)), (spot, spots + group)), shape=(nodes, nodes))
    _, part = connected_components(links, directed=False)
    order = np.argsort(part, kind="stable")  # of each part the keypoints come first
    end = np.cumsum(np.bincount(part))
    middle = np.concatenate([[0], end[:-1]]) + np.bincount(part[:spots], minlength=len(end))
    begin, group_of = 0, order - spots
    for halfway, stop in zip(middle.tolist(), end.tolist(), strict=True):
        of_spots, of_groups = order[begin:halfway], group_of[halfway:stop]
        yield _case(len(of_spots), len(of_groups)), of_spots, of_groups
        begin = stop


def _case(spots: int, groups: int) -> int:
    """Return the case of chapter 3.1."""
    if spots == 0:
        return 4
    if groups == 0:
        return 5
    if spots > 1:
        return 2
    return 1 if groups == 1 else 3


@numba.njit(cache=True)
def _overlaps(owner: npt.NDArray[np.int32], keypoints: Array) -> tuple[Index, Index]:
    """Return pairs of keypoint and cluster that share a pixel (some pairs more than once)."""
    spots, groups = [np.int64(0) for _ in range(0)], [np.int64(0) for _ in range(0)]
    rows, columns = owner.shape
    for k in range(len(keypoints)):
        row, column = keypoints[k, 0], keypoints[k, 1]
        radius = max(keypoints[k, 2], SMALLEST_DISC_PX)
        last = np.int32(-1)
        for r in range(max(int(np.ceil(row - radius)), 0), min(int(row + radius) + 1, rows)):
            half = np.sqrt(max(radius * radius - (r - row) ** 2, 0.0))
            left, right = int(np.ceil(column - half)), int(np.floor(column + half))
            for c in range(max(left, 0), min(right + 1, columns)):
                here = owner[r, c]
                if here >= 0 and here != last:
                    spots.append(np.int64(k))
                    groups.append(np.int64(here))
                    last = here
    return np.array(spots, dtype=np.int64), np.array(groups, dtype=np.int64)


def mean_gray(gray: npt.NDArray[np.generic], discs: Array) -> Array:
    """Return the mean grey value within each disc, (n, 3) of row, column, radius.

    A disc covers at least the pixel nearest to its centre; pixels outside the image do not
    count.
    """
    return _mean_gray(gray, np.ascontiguousarray(discs, dtype=np.float64).reshape(-1, 3))


@numba.njit(cache=True)
def _mean_gray(gray: npt.NDArray[np.generic], discs: Array) -> Array:
    rows, columns = gray.shape
    means = np.empty(len(discs))
    for k in range(len(discs)):
        row, column, radius = discs[k]
        total, count = 0.0, 0
        for r in range(max(int(np.ceil(row - radius)), 0), min(int(row + radius) + 1, rows)):
            for c in range(
                max(int(np.ceil(column - radius)), 0), min(int(column + radius) + 1, columns)
            ):
                if (r - row) ** 2 + (c - column) ** 2 <= radius * radius:
                    total += gray[r, c]
                    count += 1
        if count == 0:
            r = min(max(int(np.rint(row)), 0), rows - 1)
            c = min(max(int(np.rint(column)), 0), columns - 1)
            total, count = float(gray[r, c]), 1
        means[k] = total / count
    return means
