"""Clusters that spread from the densest points (thesis, section 2.2.6)."""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numba import types
from numba.typed import Dict
from scipy.spatial import cKDTree

from kilnflight.arrays import Array, ArrayLike, Index, Integers
from kilnflight.checks import Count, NotNegative, Settings, check_finite
from kilnflight.compiled import compiled
from kilnflight.detection.dbscan import NOISE
from kilnflight.detection.disjoint import find_root, unite


class QuasiClusterCenters(Settings):
    """Cluster points by spreading from the densest ones.

    Clusters spread from quasi-cluster centres to ever sparser neighbours. The density
    of a point is one over the distance to its k-th neighbour (Eq. 2.37). A centre is at
    least as dense as all its neighbours, or as all points it is a neighbour of (Eqs
    2.38, 2.39). Its cluster is reached from it by steps to neighbours that are not
    denser. Clusters that share more than ``alpha`` k points are merged (Eq. 2.41). A
    point that still is in several clusters goes to that of its exemplar, the densest of
    its neighbours (Eq. 2.40). A centre is its own exemplar. Clusters of fewer than
    ``k`` points are noise.

    Parameters
    ----------
    k
        Neighbours of a point, itself not counted.
    alpha
        Shared points, as a share of ``k``, above which clusters are merged.

    Raises
    ------
    InputError
        If ``k`` is no whole number from 1 or ``alpha`` is negative or not finite.

    Notes
    -----
    Readings of the text. (1) "Greater than the density of all" neighbours leaves two
    equally dense neighbours, which are frequent (each the other's k-th), without a
    centre. 5.1.3 says "maximum", so equal is enough. (2) A neighbour is sparse when it
    is not denser; points of equal density, one of them the other's neighbour, reach
    each other. (3) The similarity is taken again of merged clusters, until no two
    clusters share too much; the result does not depend on the order. (4) Of points at
    exactly the k-th distance the first ones of the cloud count, so that a point has k
    neighbours; of equally dense exemplars the first. (5) In a cloud of at most ``k``
    points none has a density: all noise.

    The thesis prints K = 30, alpha = 0.1 as best, with F1 0.6210. The counts of that
    row give 0.5808, and K = 35 (0.6000) is the best of Table 5.10. For the combined
    method, section 5.1.3 removes the wall with K = 35, alpha = 0.1 and takes K = 20,
    alpha = 0.2 for the rest. Sources: section 2.2.6 and Table 5.10, thesis.

    Compiled: no library has the method, and its definition in sets takes 13 times as
    long on the 187,000 points of a frame (benchmarks.csv).

    Examples
    --------
    >>> line = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [90, 0, 0], [91, 0, 0], [92, 0, 0]]
    >>> QuasiClusterCenters(k=2, alpha=0.1)(line).tolist()
    [0, 0, 0, 1, 1, 1]
    """

    k: Count = 35  # points, best F1 of Table 5.10 by its own counts
    alpha: NotNegative = 0.1  # share of k, best F1 of Table 5.10

    def __call__(self, points: ArrayLike) -> Index:
        """Return the cluster of each point (n, 3) in mm; noise is -1.

        Clusters are numbered in the order of their first point.

        Raises
        ------
        InputError
            If the points are not (n, 3) finite numbers.
        """
        cloud = check_finite(points, "QuasiClusterCenters: points", (None, 3))
        return self.spread(cloud, nearest_neighbors(cloud, self.k))

    def spread(self, cloud: Array, nearest: Integers) -> Index:
        """Return the cluster (n,) of each point of a cloud (n, 3) in mm; noise is -1.

        ``nearest`` (n, at least k) is from `nearest_neighbors`; its first ``k`` columns
        count, so several settings share one search of neighbours.
        """
        count = len(cloud)
        k = self.k
        if count <= k:  # no point has a k-th neighbour
            return np.full(count, NOISE, np.intp)
        neighbors = np.ascontiguousarray(nearest[:, :k])
        sparsity = ((cloud - cloud[neighbors[:, -1]]) ** 2).sum(axis=1)
        centers, groups = _centers(neighbors, sparsity)
        graph = _Graph(
            neighbors=neighbors,
            sparsity=sparsity,
            dense_first=np.argsort(sparsity, kind="stable"),
            centers=centers,
            groups=groups,
        )
        # Disjoint sets: the centre whose cluster each centre's own was merged into.
        clusters = np.arange(count)
        heads, chains = _spread(graph, clusters, float(self.alpha))
        # Until no two clusters share too many points.
        while _merge(heads[graph.groups], chains, clusters, k, float(self.alpha)):
            pass
        labels = _choose(graph, heads, chains, clusters)
        sizes = np.bincount(labels, minlength=count)
        labels[sizes[labels] < k] = NOISE
        kept = labels != NOISE
        labels[kept] = pd.factorize(labels[kept])[0]  # in the order of first points
        return labels


def nearest_neighbors(cloud: Array, k: int) -> Integers:
    """Return the indices (n, k) of each point's nearest points, the nearest first.

    The cloud is (n, 3) in mm; there are n - 1 columns if that is fewer. No point is its
    own neighbour. Equally distant points stand in the order of the cloud, so the first
    columns are those of a search for fewer neighbours.
    """
    k = min(k, max(len(cloud) - 1, 0))
    nearest = np.empty((len(cloud), k), np.int32)
    if not k:
        return nearest
    # Of equal points the first k + 1 are near enough to all others, and to each other.
    copy = pd.DataFrame(cloud).groupby([0, 1, 2], sort=False).cumcount()
    some = np.flatnonzero(copy <= k)
    tree = cKDTree(cloud[some], balanced_tree=False)  # faster by 8 %
    many = min(k + 2, len(some))  # itself and one beyond
    for first in range(0, len(cloud), 20_000):  # saves memory
        rows = np.arange(first, min(first + 20_000, len(cloud)))
        distances, indices = map(np.asarray, tree.query(cloud[rows], many))
        nearest[rows] = some[indices[:, 1 : k + 1]]
        # Where distances may be equal, the neighbours are sorted in the cloud's order.
        tied = (np.diff(distances, axis=1) <= 1e-12 * distances[:, 1:]).any(axis=1)
        for row, reach in zip(rows[tied], distances[tied, -1], strict=True):
            within = some[tree.query_ball_point(cloud[row], reach * (1 + 1e-9))]
            others = np.setdiff1d(within, row)
            squares = ((cloud[others] - cloud[row]) ** 2).sum(axis=1)
            nearest[row] = others[np.argsort(squares, kind="stable")[:k]]
    return nearest


class _Graph(NamedTuple):
    """Points with their neighbours and densities; points are indices in the cloud."""

    neighbors: Any  # (n, k) points, the nearest first
    # (n,) squared distance to the k-th neighbour, mm^2: 1 / density^2 of Eq. 2.37
    sparsity: Any
    dense_first: Any  # (n,) points, the densest first
    centers: Any  # (n,) whether a point is a centre of a cluster
    # (n,) first point of the equally dense ones that are linked as neighbours
    groups: Any


@compiled
def _centers(neighbors: Any, sparsity: Any) -> Any:
    """Return ``centers`` (n,) and ``groups`` (n,) of `_Graph`.

    ``neighbors`` (n, k) and ``sparsity`` (n,) are fields of it, too. A centre is at
    least as dense as all its neighbours (Eq. 2.38), or as all points that have it as a
    neighbour (Eq. 2.39). The first implies the second: a denser point that has it as a
    neighbour lies within its k-th distance, so it is a neighbour. Therefore only the
    second is tested.
    """
    centers = np.ones(len(sparsity), np.bool_)
    groups = np.arange(len(sparsity))
    for i in range(len(sparsity)):
        for j in neighbors[i]:
            if sparsity[j] > sparsity[i]:
                centers[j] = False
            elif sparsity[j] == sparsity[i]:
                unite(groups, i, j)
    for i in range(len(sparsity)):
        groups[i] = find_root(groups, i)
    return centers, groups


@compiled
def _gather(entry: int, chains: Any, clusters: Any, members: Any) -> int:
    """Write the different clusters of a list into ``members``; return how many.

    The list begins at row ``entry`` of ``chains`` (-1: empty); `_spread` describes it.
    ``clusters`` (n,) are the parents of merged clusters, see `find_root`.
    """
    count = 0
    while entry >= 0:
        cluster = find_root(clusters, chains[entry, 0])
        if cluster not in members[:count]:
            members[count] = cluster
            count += 1
        entry = chains[entry, 1]
    return count


@compiled
def _share(members: Any, clusters: Any, shared: Any, k: int, alpha: float) -> bool:
    """Count a point for each pair of its clusters; return whether a pair was merged.

    A pair is merged if it shares more than ``alpha`` times ``k`` points (Eq. 2.41).
    ``members`` (c,) are the clusters of the point, ``clusters`` (n,) the parents of
    merged ones. ``shared`` maps a pair, lower cluster times n plus the higher, to its
    number of shared points.
    """
    merged = False
    for i in range(len(members)):
        for j in range(i):
            low = min(members[i], members[j])
            high = max(members[i], members[j])
            pair = low * len(clusters) + high
            shared[pair] = shared.get(pair, 0) + 1
            if shared[pair] / k > alpha:  # Eq. 2.41
                merged |= unite(clusters, low, high)
    return merged


@compiled
def _spread(graph: _Graph, clusters: Any, alpha: float) -> Any:
    """Return the clusters that reach each group, as linked lists.

    ``heads`` (n,) is the first row in ``chains`` of the list of each group (-1: none).
    A row of ``chains`` is a cluster, by the index of its centre, and the next row of
    the same list. ``clusters`` (n,), the parents of merged clusters, is changed in
    place. Clusters spread in order of decreasing density. They are merged as soon as
    enough shared points are counted, which keeps the lists short. This is never too
    early, as a merged cluster shares no fewer points than its parts. `_merge` finds the
    rest.
    """
    sparsity = graph.sparsity
    groups = graph.groups
    count, k = graph.neighbors.shape
    heads = np.full(count, -1)
    chains = np.empty((2 * count, 2), np.int64)
    used = 0
    members = np.empty(np.count_nonzero(graph.centers), np.int64)
    shared = Dict.empty(types.int64, types.int64)
    sizes = np.bincount(groups)
    for i in np.flatnonzero(graph.centers):
        group = groups[i]
        if heads[group] >= 0 and sizes[group] / k > alpha:
            # Both centres share at least the points of the group.
            unite(clusters, int(i), chains[heads[group], 0])
        else:
            chains[used, 0] = i
            chains[used, 1] = heads[group]
            heads[group] = used
            used += 1
    for i in graph.dense_first:
        count = _gather(heads[groups[i]], chains, clusters, members)
        _share(members[:count], clusters, shared, k, alpha)
        if used + count * k > len(chains):
            chains = np.concatenate((chains, np.empty_like(chains)))
        for j in graph.neighbors[i]:
            if sparsity[j] > sparsity[i]:
                for cluster in members[:count]:
                    root = find_root(clusters, cluster)
                    entry = heads[groups[j]]
                    while entry >= 0 and find_root(clusters, chains[entry, 0]) != root:
                        entry = chains[entry, 1]
                    if entry < 0:
                        chains[used, 0] = root
                        chains[used, 1] = heads[groups[j]]
                        heads[groups[j]] = used
                        used += 1
    return heads, chains


@compiled
def _merge(entries: Any, chains: Any, clusters: Any, k: int, alpha: float) -> bool:
    """Merge clusters that share too many points; return whether any did.

    ``entries`` (n,) is the first row in ``chains`` of each point's list of clusters.
    ``clusters`` (n,), the parents of merged clusters, is changed in place.
    """
    members = np.empty(len(entries), np.int64)
    shared = Dict.empty(types.int64, types.int64)
    merged = False
    for entry in entries:  # one for each point
        count = _gather(entry, chains, clusters, members)
        merged |= _share(members[:count], clusters, shared, k, alpha)
    return merged


@compiled
def _choose(graph: _Graph, heads: Any, chains: Any, clusters: Any) -> Any:
    """Return the cluster (n,) of each point, by the index of its centre.

    A point in several clusters takes that of its exemplar, its densest neighbour (Eq.
    2.40). The other arguments are those of `_spread` and `_merge`.
    """
    rank = np.argsort(graph.dense_first)  # the first of equally dense points leads
    labels = np.full(len(rank), NOISE)
    members = np.empty(np.count_nonzero(graph.centers), np.int64)
    for i in graph.dense_first:
        count = _gather(heads[graph.groups[i]], chains, clusters, members)
        if graph.centers[i]:
            labels[i] = find_root(clusters, i)
        elif count == 1:
            labels[i] = members[0]
        else:
            near = graph.neighbors[i]
            labels[i] = labels[near[rank[near].argmin()]]
    return labels
