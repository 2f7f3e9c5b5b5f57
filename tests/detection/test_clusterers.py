"""The three clusterers against their definitions, and what they have in common."""

from dataclasses import asdict, replace

import numpy as np
import pytest
import sklearn.cluster
from hypothesis import example, given
from hypothesis import strategies as st
from tests.definitions import clusters as plain

from kilnflight.detection import (
    DBSCAN,
    MorphologicalClustering,
    QuasiClusterCenters,
)
from kilnflight.detection.dbscan import k_distances
from kilnflight.detection.quasi_centers import nearest_neighbors
from kilnflight.publication import claims

SMALL = (DBSCAN(3.0, 5), MorphologicalClustering(22), QuasiClusterCenters(5, 0.1))
seeds = st.integers(0, 2**32 - 1)


def lattice(seed, count, width):
    """Points on a lattice: many distances are equal, and some points coincide."""
    return np.random.default_rng(seed).integers(0, width, (count, 3)).astype(float)


def uneven(seed, count=150):
    """Balls of uneven density and scattered points."""
    rng = np.random.default_rng(seed)
    middles = rng.uniform(0, 30, (5, 3))
    spread = rng.normal(0, 2, (count, 3)) * rng.uniform(0, 2, (count, 1))
    return np.concatenate(
        [middles[rng.integers(0, 5, count)] + spread, rng.uniform(0, 30, (9, 3))]
    )


def same_as_scikit_learn(points, eps, min_points):
    peer = sklearn.cluster.DBSCAN(eps=eps, min_samples=min_points).fit(points)
    np.testing.assert_array_equal(DBSCAN(eps, min_points)(points), peer.labels_)
    distances = k_distances(points, min(min_points, len(points)))
    assert (np.diff(distances) <= 0).all()
    if min_points <= len(points):
        assert np.count_nonzero(distances <= eps) == len(peer.core_sample_indices_)


@given(seeds, st.integers(1, 60), st.integers(1, 7), st.integers(1, 30))
def test_dbscan_with_ties_at_eps_and_on_clouds_of_uneven_density(
    seed, count, width, min_points
):
    """Of two clusters, a border point goes to the first, as in scikit-learn."""
    for eps in (1, 2, 5):
        same_as_scikit_learn(lattice(seed, count, width), eps, 1 + min_points % 12)
    for eps in (0.5, 2.7, 8.0, 40.0):
        same_as_scikit_learn(uneven(seed, 400), eps, min_points)


@given(seeds, st.integers(1, 40))
def test_morphology_is_the_dilation_of_a_full_grid(seed, grid):
    for points in (uneven(seed) * [1, 1, 10], lattice(seed, 1 + seed % 60, 17) / 2):
        labels = MorphologicalClustering(grid)(points)
        np.testing.assert_array_equal(labels, plain.morphology(points, grid))


@given(seeds, st.integers(1, 12))
@example(0, 5)
def test_quasi_centers_are_the_definition_in_sets(seed, k):
    for points in (uneven(seed, 90), lattice(seed, 1 + seed % 70, 1 + seed % 6)):
        for shape in ((1, 1, 1), (1, 1, 1000), (0, 1, 0), (0, 0, 0)):
            neighbors = plain.neighbors_by_sorting(
                points * shape, k
            )  # ties in the cloud's order
            found = nearest_neighbors(points * shape, k + 7)
            np.testing.assert_array_equal(found[:, :k], neighbors)
        neighbors = plain.neighbors_by_sorting(points, k)
        for alpha in (0.0, 0.1, 0.5, 1.0, 3.0):
            expected = plain.quasi_centers(points, k, alpha, neighbors)
            np.testing.assert_array_equal(
                QuasiClusterCenters(k, alpha)(points), expected
            )


def test_a_long_line_of_equal_steps_is_one_cluster():
    """Nearly all points are centres of one density; pairs are not compared."""
    line = np.outer(np.arange(5000.0), [1, 0, 0])
    assert set(QuasiClusterCenters(20, 0.1)(line)) == {0}


@pytest.mark.parametrize("clusterer", SMALL, ids=lambda one: type(one).__name__)
@given(seed=seeds, shift=st.tuples(*3 * [st.integers(-10_000, 10_000)]))
def test_the_order_of_points_and_a_shift_change_nothing(clusterer, seed, shift):
    points = uneven(seed)
    exact = np.round(points * 8) / 8  # eighths of a millimetre: differences are exact
    np.testing.assert_array_equal(clusterer(exact), clusterer(exact + np.array(shift)))
    if isinstance(clusterer, DBSCAN):
        clusterer = replace(
            clusterer, min_points=1
        )  # without border points there are no ties
    order = np.random.default_rng(seed).permutation(len(points))
    expected = plain.renumbered(clusterer(points)[order])
    np.testing.assert_array_equal(plain.renumbered(clusterer(points[order])), expected)


@pytest.mark.parametrize(
    ("clusterer", "table", "columns"),
    [
        (DBSCAN(), "table_5.8", {"epsilon_mm": "eps", "minPts": "min_points"}),
        (MorphologicalClustering(), "table_5.9", {"R": "grid"}),
        (QuasiClusterCenters(), "table_5.10", {"K": "k", "alpha": "alpha"}),
    ],
)
def test_defaults_are_the_best_published_parameters(clusterer, table, columns):
    rows = claims.published(table)
    best = rows.loc[(rows.TP / (rows.TP + (rows.FP + rows.FN) / 2)).idxmax()]
    assert {columns[name]: best[name] for name in columns}.items() <= asdict(
        clusterer
    ).items()


@pytest.mark.parametrize("k", [1, 5, 9])
@pytest.mark.parametrize("copies", [1, 6, 12])
def test_points_there_many_times_are_neighbours_in_the_order_of_the_cloud(k, copies):
    rng = np.random.default_rng(k)
    points = rng.permutation(np.repeat(lattice(copies, 40, 3), copies, axis=0))
    knn = plain.neighbors_by_sorting(points, k)
    np.testing.assert_array_equal(nearest_neighbors(points, k), knn)
    np.testing.assert_array_equal(
        QuasiClusterCenters(k, 0.1)(points), plain.quasi_centers(points, k, 0.1, knn)
    )


def test_equal_points_are_one_cluster_and_are_not_compared_with_each_other():
    """Each of the points had all others as candidates: 20 s."""
    points = np.full((5000, 3), 7.0)
    assert set(QuasiClusterCenters()(points)) == {0}
    expected = np.tile(np.arange(35), (2, 1))
    expected[0] += 1
    expected[1, 1:] += 1
    np.testing.assert_array_equal(nearest_neighbors(points, 35)[:2], expected)
