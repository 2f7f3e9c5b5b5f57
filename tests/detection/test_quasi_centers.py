"""Quasi-cluster centres against their definition in sets."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from kilnflight.detection import QuasiClusterCenters
from kilnflight.detection.quasi_centers import nearest_neighbors


def squared_distances(points):
    x, y, z = (axis[:, None] - axis for axis in points.T)
    return x * x + y * y + z * z


def neighbors_by_sorting(points, k):
    """The k nearest others, equally distant ones in the order of the cloud."""
    squares = squared_distances(points)
    np.fill_diagonal(squares, -1.0)  # the point itself comes first
    nearest = np.argsort(squares, axis=1, kind="stable")[:, 1 : k + 1]
    return nearest, np.take_along_axis(squares, nearest[:, -1:], axis=1)[:, 0]


def reached_from(center, nearer):
    """All points that steps to sparse neighbours lead to."""
    cluster, todo = {center}, [center]
    while todo:
        new = nearer[todo.pop()] - cluster
        cluster |= new
        todo += new
    return cluster


def merged(clusters, k, alpha):
    """Merge two clusters at a time until none share more than alpha k points."""
    clusters = [(centers, set(points)) for centers, points in clusters]
    for i in range(len(clusters)):
        for j in range(i):
            if len(clusters[i][1] & clusters[j][1]) / k > alpha:
                both = tuple(a | b for a, b in zip(clusters[i], clusters[j], strict=True))
                return merged(
                    [both] + [c for n, c in enumerate(clusters) if n not in (i, j)], k, alpha
                )
    return clusters


def by_definition(points, k, alpha):
    count = len(points)
    if count <= k:
        return [-1] * count
    knn, sparsity = neighbors_by_sorting(points, k)
    rknn = [[i for i in range(count) if j in knn[i]] for j in range(count)]
    centers = [
        i
        for i in range(count)
        if all(sparsity[i] <= sparsity[knn[i]]) or all(sparsity[i] <= sparsity[rknn[i]])
    ]
    sparse = [{int(j) for j in knn[i] if sparsity[j] >= sparsity[i]} for i in range(count)]
    for i in range(count):
        for j in knn[i]:
            if sparsity[i] == sparsity[j]:
                sparse[j].add(i)
    clusters = merged([({c}, reached_from(c, sparse)) for c in centers], k, alpha)
    labels = {}
    for i in np.argsort(sparsity, kind="stable").tolist():
        mine = [n for n, (cluster_centers, _) in enumerate(clusters) if i in cluster_centers]
        mine = mine or [n for n, (_, members) in enumerate(clusters) if i in members]
        exemplar = min(knn[i], key=lambda j: (sparsity[j], j))
        labels[i] = mine[0] if len(mine) == 1 else labels[exemplar]
    sizes = np.bincount(list(labels.values()))
    numbers = {}
    return [
        numbers.setdefault(labels[i], len(numbers)) if sizes[labels[i]] >= k else -1
        for i in range(count)
    ]


@settings(deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 12), st.sampled_from([0.0, 0.1, 0.2, 0.5, 1.0, 3.0])
)
def test_clouds_of_uneven_density(seed, k, alpha):
    rng = np.random.default_rng(seed)
    middles = rng.uniform(0, 30, (5, 3))
    points = middles[rng.integers(0, 5, 90)] + rng.normal(0, 2, (90, 3)) * rng.uniform(
        0, 2, (90, 1)
    )
    labels = QuasiClusterCenters(k, alpha)(points)
    assert labels.tolist() == by_definition(points, k, alpha)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 70), st.integers(1, 6), st.integers(1, 8))
@example(0, 40, 1, 5)
def test_lattices_full_of_ties(seed, count, width, k):
    points = np.random.default_rng(seed).integers(0, width, (count, 3)).astype(float)
    assert QuasiClusterCenters(k, 0.2)(points).tolist() == by_definition(points, k, 0.2)


def test_a_cloud_of_k_points_has_no_density():
    points = np.random.default_rng(0).normal(size=(6, 3))
    assert QuasiClusterCenters(6, 0.1)(points).tolist() == [-1] * 6
    assert QuasiClusterCenters(7, 0.1)(points).tolist() == [-1] * 6


def test_a_cluster_of_fewer_than_k_points_is_noise():
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.normal(0, 1, (40, 3)), rng.normal(1000, 1, (4, 3))])
    labels = QuasiClusterCenters(5, 0.1)(points)
    assert labels[40:].tolist() == [-1] * 4
    assert (labels[:40] >= 0).sum() > 30


def test_a_larger_alpha_never_makes_fewer_clusters_before_the_small_ones_go():
    rng = np.random.default_rng(2)
    points = rng.normal(0, 1, (3000, 3)) ** 3 * 10
    counts = [len(set(QuasiClusterCenters(6, a)(points)) - {-1}) for a in (0.0, 0.5, 2.0)]
    assert counts == sorted(counts)


shapes = st.sampled_from([(1, 1, 1), (1, 1, 1000), (1, 1, 0), (0, 1, 0), (0, 0, 0)])


@given(st.integers(0, 2**32 - 1), st.integers(1, 10), st.floats(0.0, 6.0), shapes, st.booleans())
def test_neighbours_are_the_nearest_the_nearest_first(seed, k, unevenness, shape, ties):
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 1, (150, 3)) * np.exp(rng.normal(0, unevenness, (150, 1))) * shape
    points = np.round(points) if ties else points
    expected, _ = neighbors_by_sorting(points, k)
    np.testing.assert_array_equal(nearest_neighbors(points, k), expected)
    # of a search for more the first columns are the same
    np.testing.assert_array_equal(nearest_neighbors(points, k + 7)[:, :k], expected)


@pytest.mark.parametrize("count", range(4))
def test_a_few_points_have_all_others_as_neighbours(count):
    points = np.random.default_rng(0).normal(size=(count, 3))
    assert nearest_neighbors(points, 5).shape == (count, max(count - 1, 0))
    assert QuasiClusterCenters(5, 0.1)(points).tolist() == [-1] * count


def test_a_long_line_of_equal_steps_is_one_cluster():
    """Nearly all points are centres of one density; they are not compared pair by pair."""
    line = np.outer(np.arange(20_000.0), [1, 0, 0])
    assert set(QuasiClusterCenters(20, 0.1)(line)) == {0}
