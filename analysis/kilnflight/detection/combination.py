"""The combined detector of keypoints and clusters (chapter 3.1).

A 2D detector finds keypoints in the foreground. A clusterer finds clusters among the
points without the wall, which is the largest cluster of a first pass. A keypoint is a
disc, and the area of a cluster the rectangle around its pixels. Those that share a
pixel of the image are one potential particle. Their numbers decide its case, and each
case uses the grey values differently.

=====  =========  ========  ======================================================
case   keypoints  clusters  decision
=====  =========  ========  ======================================================
1      1          1         a particle
2      several    1         as many as grey-value peaks in the cluster's rectangle
3      1          several   as many as peaks in the rectangle around the overlap of
                            disc and clusters
4      none       1         a particle if a peak or trough is in the rectangle, and
                            a peak in the frame difference
5      1          none      the same in the disc's rectangle
=====  =========  ========  ======================================================

Several keypoints with several clusters are not in the thesis; they are decided as case
2.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from pandas import DataFrame
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from kilnflight.arrays import Anything, Array, Index, Integers, Shape, Single
from kilnflight.checks import Positive, Settings
from kilnflight.compiled import compiled
from kilnflight.detection import DBSCAN, Clusterer, Detector2D, DoG, Otsu, Polygon
from kilnflight.detection.peaks import Evidence, disc_pixels, smoothed
from kilnflight.detection.region import within
from kilnflight.tables import DETECTIONS

# Every area is widened, so that its border shows what surrounds the particle; ours.
MARGIN_PX = 3
WALL_PASS = DBSCAN(eps=50.0, min_points=10)  # mm, points; section 5.1.3
PARTICLE_PASS = DBSCAN(eps=15.0, min_points=10)  # mm, points; section 5.1.3
# A wider or higher cluster is a remainder of the wall, a larger keypoint one of its
# flicker; both are left out. Twice the 45 px that section 3.3 derives from the radii,
# nearly all of which are below 15 px (Fig. 3.12). The thesis names no limit.
LARGEST_PX = 90
SMALLEST_DISC_PX = 1.0  # a keypoint covers at least the pixels next to its own
# By how many keypoints and clusters share pixels, 2 for several. The last is not in the
# thesis.
_CASES = {(1, 1): 1, (2, 1): 2, (1, 2): 3, (0, 1): 4, (1, 0): 5, (2, 2): 2}
_COLUMNS = ["row", "col", "radius_px", "x", "y", "z", "points", "case"]


class Clusters(NamedTuple):
    """n points of several clusters, one cluster after the other."""

    pixels: Index  # (n, 2) row and col
    xyz: Array  # (n, 3) mm
    start: Index  # (clusters + 1,) first point of each, and the number of points


def sort_clusters(pixels: Integers, xyz: Array, labels: Index) -> Clusters:
    """Return the clusters of points with ``labels`` (n,), by ascending label.

    ``pixels`` (n, 2) are row and col, ``xyz`` (n, 3) in mm. Points of label -1 are left
    out; a label without points is no cluster.
    """
    labelled = np.flatnonzero(labels >= 0)
    label = labels[labelled]
    sizes = np.bincount(label)
    order = labelled[np.argsort(label, kind="stable")]
    start = np.concatenate([[0], np.cumsum(sizes[sizes > 0])]).astype(np.intp)
    # rows are taken: indexing narrow rows is several times slower
    return Clusters(
        pixels=np.take(pixels, order, axis=0).astype(np.intp),
        xyz=np.take(xyz, order, axis=0).astype(float, copy=False),
        start=start,
    )


def rectangles(clusters: Clusters) -> Index:
    """Return the rectangle in px of each cluster's points, (clusters, 4).

    Columns are first row, row after the last, first column, column after the last.
    """
    start = clusters.start[:-1]
    first = np.minimum.reduceat(clusters.pixels, start)
    last = np.maximum.reduceat(clusters.pixels, start)
    return np.stack([first, last + 1], axis=2).reshape(-1, 4)


def centers(clusters: Clusters) -> Array:
    """Return the mean row and column of each cluster's points, (clusters, 2) in px."""
    sums = np.add.reduceat(clusters.pixels, clusters.start[:-1], axis=0)
    return sums / np.diff(clusters.start)[:, None]


def take_clusters(clusters: Clusters, which: Anything) -> Clusters:
    """Return the clusters chosen by indices (k,), in that order, or by a mask."""
    first = clusters.start[:-1][which]
    sizes = np.diff(clusters.start)[which]
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)
    point = np.repeat(first - start[:-1], sizes) + np.arange(start[-1])
    return Clusters(
        pixels=clusters.pixels.take(point, axis=0),
        xyz=clusters.xyz.take(point, axis=0),
        start=start,
    )


def areas_of(clusters: Clusters, rectangular: bool) -> tuple[Index, Index]:
    """Return areas (n, 4) of clusters in px, and the cluster (n,) of each.

    ``rectangular``: one rectangle for each cluster, its "cluster area" in chapter 3.1.
    False: its pixels, which do not fill it.
    """
    owner = np.arange(len(clusters.start) - 1)
    if rectangular:
        return rectangles(clusters), owner
    single = clusters.pixels[:, [0, 0, 1, 1]] + np.array([0, 1, 0, 1])
    return single, np.repeat(owner, np.diff(clusters.start))


def potential_particles(
    keypoints: Array, clusters: Clusters, rectangular: bool = True
) -> Iterator[tuple[int, Index, Index]]:
    """Yield case, keypoints (s,) and clusters (c,) of each potential particle.

    Both are indices. A keypoint and a cluster are linked if its disc shares a pixel
    with an area of the cluster. A potential particle is all that is linked, directly or
    through others.

    Parameters
    ----------
    keypoints
        (k, 3) row, column and radius in px.
    clusters
        Clusters of the same frame.
    rectangular
        Whether the area of a cluster is its rectangle, or else its pixels.
    """
    spots = len(keypoints)
    groups = len(clusters.start) - 1
    if not spots + groups:
        return
    areas, owner = areas_of(clusters, rectangular)
    discs = np.ascontiguousarray(keypoints)
    spot, area = np.nonzero(_touching(discs, areas, SMALLEST_DISC_PX))
    links = np.ones(len(spot)), (spot, spots + owner[area])
    graph = coo_array(links, shape=(spots + groups, spots + groups))
    _, part = connected_components(graph, directed=False)
    order = np.argsort(part, kind="stable")  # keypoints come first in each part
    sizes = np.bincount(part)
    later = np.bincount(part[spots:], minlength=part.max() + 1)
    last = np.cumsum(sizes)
    bounds = np.stack([last - sizes, last - later, last], axis=1)
    for first, middle, end in bounds.tolist():
        case = _CASES[min(middle - first, 2), min(end - middle, 2)]
        yield case, order[first:middle], order[middle:end] - spots


@compiled
def _touching(discs: Any, areas: Any, smallest: float) -> Any:
    """Return whether each disc shares a pixel with each area, (n, m).

    ``discs`` (n, 3) are row, column and radius in px, ``areas`` (m, 4) as in
    `rectangles`; smaller discs get the radius ``smallest``. Compiled: some hundred
    discs meet a thousand rectangles.
    """
    touching = np.empty((len(discs), len(areas)), np.bool_)
    for i in range(len(discs)):
        row, col, radius = discs[i]
        for j in range(len(areas)):
            top, bottom, left, right = areas[j]
            # Distance from the keypoint to the nearest pixel of the area.
            down = min(max(np.rint(row), top), bottom - 1) - row
            across = min(max(np.rint(col), left), right - 1) - col
            touching[i, j] = down**2 + across**2 <= max(radius, smallest) ** 2
    return touching


def overlap(disc: Array, areas: Index, shape: Shape) -> Index:
    """Return the rectangle (4,) around the pixels that a disc shares with areas (n, 4).

    ``disc`` (3,) is row, column and radius in px; it shares a pixel of the image, of
    ``shape``, with one area at least.
    """
    _, row, col = disc_pixels(disc[None], SMALLEST_DISC_PX, shape)
    top, bottom, left, right = areas.T[..., None]
    shared = ((top <= row) & (row < bottom) & (left <= col) & (col < right)).any(axis=0)
    return around(np.stack([row, col], axis=1)[shared])


def mean_gray(gray: Anything, discs: Array) -> Array:
    """Return the mean grey value (n,) within each disc.

    ``gray`` is (rows, cols), ``discs`` (n, 3) are row, column and radius in px. A disc
    covers at least the pixel nearest to its centre; pixels outside the image do not
    count.
    """
    nearest = np.rint(discs[:, :2]).astype(np.intp).clip(0, np.array(gray.shape) - 1)
    means = gray[tuple(nearest.T)].astype(float)
    for first in range(0, len(discs), 1000):  # 20 MB at a time for discs of 15 px
        part = discs[first : first + 1000]
        disc, row, col = disc_pixels(np.ascontiguousarray(part), 0.0, gray.shape)
        count = np.bincount(disc, minlength=len(part))
        sums = np.bincount(disc, gray[row, col], minlength=len(part))
        np.divide(sums, count, out=means[first : first + 1000], where=count > 0)
    return means


class View(NamedTuple):
    """Images and points of one frame, as `Combination` takes them."""

    gray: Integers  # (rows, cols)
    previous: Integers  # (rows, cols), the frame before
    foreground: Single  # (rows, cols), without the flame
    pixels: Integers  # (n, 2) row and col of the points, without the flame
    xyz: Array  # (n, 3) mm, depth after Eq. 2.4
    smooth: Callable[[Integers], Single] = smoothed  # or a `peaks.Smoother`
    number: int = 0  # that of the frame in its recording


class Combination(Settings):
    """Find particles by any 2D detector combined with any clusterer (chapter 3.1).

    Parameters
    ----------
    detector
        Finds keypoints in the foreground.
    clusterer
        Finds clusters among the points without the wall.
    wall
        Clusterer of the first pass; its largest cluster is the wall. Section 5.1.3
        takes the parameters of highest precision.
    rectangular
        Whether a keypoint and a cluster belong together where its disc meets the
        rectangle of the cluster (chapter 3.1, case 2); False: where it meets a pixel of
        it.
    largest_px
        Diameter of the largest keypoint, in px; larger ones are left out.

    Examples
    --------
    A bright square of 7 x 7 pixels appears, 6 m away in front of a wall. Its keypoint
    and its cluster are one particle, case 1.

    >>> gray = np.full((60, 80), 500, np.uint16)
    >>> gray[20:27, 30:37] = 9000
    >>> pixels = np.argwhere(gray)
    >>> depth = np.where(gray.ravel() > 500, 6000.0, 9000.0)
    >>> view = View(gray, 0 * gray, gray - 500.0, pixels, np.c_[5.0 * pixels, depth])
    >>> found = Combination()(view)
    >>> found[["row", "col", "z", "points", "case"]].round().to_numpy().tolist()
    [[23.0, 33.0, 6000.0, 49.0, 1.0]]
    """

    detector: Detector2D = DoG()
    clusterer: Clusterer = PARTICLE_PASS
    wall: Clusterer = WALL_PASS
    rectangular: bool = True
    largest_px: Positive = LARGEST_PX

    def __call__(
        self, view: View, roi: Polygon | None = None, frame: int = 0
    ) -> DataFrame:
        """Return the particles of a frame.

        Parameters
        ----------
        view
            Images and points of the frame.
        roi
            Corners (row, col) of a polygon in px; particles outside are left out. None:
            all stay.
        frame
            Number of the frame, for the table.

        Returns
        -------
        DataFrame
            `kilnflight.tables.DETECTIONS`.
        """
        keypoints = self.detector(view.foreground, roi)
        labels = second_pass(view.xyz, self.wall, self.clusterer)
        return self.decide(view, keypoints, labels, roi, frame)

    def decide(
        self,
        view: View,
        keypoints: Array,
        labels: Index,
        roi: Polygon | None = None,
        frame: int = 0,
    ) -> DataFrame:
        """Return the particles of a frame with given keypoints and clusters.

        So several combinations can share one detection and one clustering.

        Parameters
        ----------
        view
            Images and points of the frame.
        keypoints
            (k, 3) row, col and radius in px.
        labels
            (n,) cluster of each point of the view; -1: wall or noise.
        roi
            Corners (row, col) of a polygon in px; particles outside are left out. None:
            all stay.
        frame
            Number of the frame, for the table.

        Returns
        -------
        DataFrame
            `kilnflight.tables.DETECTIONS`.
        """
        # Remainders of the wall have most points, and each has a pixel of its own.
        many = np.bincount(labels + 1) > LARGEST_PX**2
        labels = np.where(many[labels + 1], -1, labels)
        clusters = sort_clusters(view.pixels, view.xyz, labels)
        keypoints = no_larger(keypoints, self.largest_px)
        keypoints = keypoints[within(roi, keypoints)]
        clusters = take_clusters(clusters, widths(clusters) <= LARGEST_PX)
        clusters = take_clusters(clusters, within(roi, centers(clusters)))
        evidence = Evidence.of(view.gray, view.previous, view.smooth)
        moved = evidence.moved(widened(rectangles(clusters)))
        parts = [np.empty((0, len(_COLUMNS)))]
        for case, spots, groups in potential_particles(
            keypoints, clusters, self.rectangular
        ):
            if case == 4 and not moved[groups[0]]:  # most; tested at once for speed
                continue
            members = take_clusters(clusters, groups)
            parts.append(
                decide_case(case, keypoints[spots], members, evidence, self.rectangular)
            )
        return _table(np.concatenate(parts), view.gray, frame)


class Planar(Settings):
    """Find particles in pictures alone, for recordings without depth.

    Sections 2.2.2 and 2.2.3 of the thesis. No frame difference is needed, so particles
    that rest are found, too.

    Parameters
    ----------
    detector
        Finds particles in the foreground.
    size_px
        Diameter of the particles. Only discs of half to twice this size are kept, and
        of two that are nearer than half of it the stronger one. None: all sizes, 1 px
        apart.
    """

    detector: DoG | Otsu
    size_px: Positive | None = None

    def __call__(
        self, view: View, roi: Polygon | None = None, frame: int = 0
    ) -> DataFrame:
        """Return the particles of a frame (`kilnflight.tables.DETECTIONS`), ``case`` 0.

        ``roi`` are corners (row, col) of a polygon in px; particles outside are left
        out.
        """
        if isinstance(self.detector, Otsu):
            spots = self.detector(view.foreground)
        else:
            graded = self.detector.graded(view.foreground, roi)
            apart = 1.0  # DoG may find one spot in two octaves
            if self.size_px:
                apart = self.size_px / 2
                graded = graded[np.abs(np.log(graded[:, 2] / apart)) < np.log(2)]
            spots = _strongest(graded, apart)
        spots = spots[within(roi, spots)]
        unknown = np.full((len(spots), 3), np.nan)
        none = np.zeros((len(spots), 2))
        return _table(np.column_stack([spots, unknown, none]), view.gray, frame)


def _strongest(graded: Array, apart: float) -> Array:
    """Return row, col and radius (k, 3) of spots (n, 4) without a stronger one near by.

    The last column of ``graded`` is the strength; near is below ``apart`` px.
    """
    spots = graded[np.argsort(-graded[:, 3], kind="stable")]
    kept = np.ones(len(spots), bool)
    for i, k in sorted(KDTree(spots[:, :2]).query_pairs(apart)):
        kept[k] &= not kept[i]
    return spots[kept, :3]


def _table(values: Array, gray: Integers, frame: int) -> DataFrame:
    """Return `DETECTIONS` of one frame from rows (n, 8) of `_COLUMNS`."""
    columns = dict(zip(_COLUMNS, values.T, strict=True))
    columns["frame"] = np.full(len(values), frame)
    columns["gray"] = mean_gray(gray, values[:, :3])
    # Changing the types of a table instead would take 3 ms of each frame.
    return DataFrame(
        {name: columns[name].astype(kind) for name, kind in DETECTIONS.dtypes.items()}
    )


def second_pass(xyz: Array, wall: Clusterer, clusterer: Clusterer) -> Index:
    """Return the cluster (n,) of each point without the wall; wall and noise are -1.

    ``xyz`` (n, 3) is in mm. The first pass, ``wall``, finds the wall as its largest
    cluster; the second, ``clusterer``, takes the other points.
    """
    first = wall(xyz)
    labels = np.full(len(xyz), -1, np.intp)
    off_wall = first != largest_cluster(first)
    labels[off_wall] = clusterer(xyz.compress(off_wall, axis=0))
    return labels


def largest_cluster(labels: Index) -> int:
    """Return the label of most points (n,); without a cluster, one that none has."""
    # The last 0 stands for no cluster at all.
    sizes = np.append(np.bincount(labels + 1)[1:], 0)
    return int(sizes.argmax())


def decide_case(
    case: int,
    spots: Array,
    clusters: Clusters,
    evidence: Evidence,
    rectangular: bool = True,
) -> Array:
    """Return the particles (k, 8) of a potential particle by its case; k may be 0.

    Columns are row, column, radius in px, mean x, y, z in mm, number of points, and
    case.

    Parameters
    ----------
    case
        1 to 5, as in the module's table.
    spots
        (s, 3) row, column and radius in px of its keypoints; none in case 4, one in 1,
        3 and 5.
    clusters
        Its clusters; none in case 5.
    evidence
        Peaks and changes of the grey values of the frame.
    rectangular
        As in `potential_particles`; case 3 looks where disc and areas overlap.
    """
    if case == 1:
        return _particle(spots[0], clusters.xyz, case)
    spot = _middle(clusters.pixels) if case in (2, 4) else spots[0]
    # The rectangle in which the case looks at grey values.
    if case == 3:
        areas, _ = areas_of(clusters, rectangular)
        area = overlap(spots[0], areas, evidence.gray.shape)
    elif case == 5:
        row, col, radius = spots[0]
        sides = [row - radius, row + radius + 1, col - radius, col + radius + 1]
        area = np.round(sides).astype(np.intp)
    else:
        area = around(clusters.pixels)
    area = widened(area)
    if case in (4, 5):
        particle = _particle(spot, clusters.xyz, case)
        return particle if evidence.real(area) else particle[:0]
    peaks = evidence.peaks(area)
    if len(peaks) < 2:
        return _particle(spot, clusters.xyz, case)
    return _divided(case, peaks, spots[:, 2].min(), clusters)


def _divided(case: int, peaks: Array, smallest: float, clusters: Clusters) -> Array:
    """Return a particle of the nearest points for each peak, (peaks, 8).

    ``peaks`` (k, 3) begin with row and column in px; ``smallest`` is the least radius
    in px. Columns are those of `decide_case`.
    """
    apart = clusters.pixels[:, None] - peaks[:, :2]
    owner = np.argmin((apart**2).sum(axis=2), axis=1)
    particles = []
    for number, (row, col, _) in enumerate(peaks):
        mine = owner == number
        radius = max(np.sqrt(mine.sum() / np.pi), smallest)
        particles.append(_particle((row, col, radius), clusters.xyz[mine], case))
    return np.concatenate(particles)


def _particle(spot: Sequence[float], xyz: Array, case: int) -> Array:
    """Return the row (1, 8) of one particle, columns as in `decide_case`.

    ``spot`` is row, column and radius in px; ``xyz`` (n, 3) are its points in mm.
    Without points x, y, z are NaN.
    """
    place = xyz.mean(axis=0) if len(xyz) else np.full(3, np.nan)
    return np.array([[*spot, *place, len(xyz), case]])


def _middle(pixels: Index) -> tuple[float, float, float]:
    """Return mean row and column of pixels (n, 2), and radius of a disc as large."""
    row, col = pixels.mean(axis=0)
    return row, col, np.sqrt(len(pixels) / np.pi)


def around(pixels: Index) -> Index:
    """Return first row, end row, first col and end col (4,) of pixels (n, 2)."""
    return np.stack([pixels.min(axis=0), pixels.max(axis=0) + 1], axis=1).ravel()


def no_larger(keypoints: Array, largest_px: float = LARGEST_PX) -> Array:
    """Return the keypoints (n, 3) whose discs have at most a diameter in px."""
    return keypoints[2 * keypoints[:, 2] <= largest_px]


def widened(areas: Index) -> Index:
    """Return rectangles (..., 4) in px with `MARGIN_PX` more on every side."""
    return areas + MARGIN_PX * np.array([-1, 1, -1, 1])


def widths(clusters: Clusters) -> Index:
    """Return the larger side (clusters,) in px of each cluster's rectangle."""
    top, bottom, left, right = rectangles(clusters).T
    return np.maximum(bottom - top, right - left)
