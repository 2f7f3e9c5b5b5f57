"""The three clusterers against their definitions, and what they have in common."""

from dataclasses import asdict, replace

import numpy as np
import pytest
import sklearn.cluster
from hypothesis import example, given
from hypothesis import strategies as st
from tests.definitions import clusters as plain

from kilnflight.detection import (
    CLUSTERERS,
    DBSCAN,
    MorphologicalClustering,
    QuasiClusterCenters,
    k_distances,
)
from kilnflight.detection.quasi_centers import nearest_neighbors
from kilnflight.project import claims

SMALL = (DBSCAN(3.0, 5), MorphologicalClustering(22), QuasiClusterCenters(5, 0.1))
each = pytest.mark.parametrize("clusterer", SMALL, ids=lambda one: type(one).__name__)
seeds = st.integers(0, 2**32 - 1)


def lattice(seed, count, width):
    """Points on a lattice: many distances are equal, and some points coincide."""
    return np.random.default_rng(seed).integers(0, width, (count, 3)).astype(float)


def uneven(seed, count=150):
    """Balls of uneven density and scattered points."""
    rng = np.random.default_rng(seed)
    middles = rng.uniform(0, 30, (5, 3))
    spread = rng.normal(0, 2, (count, 3)) * rng.uniform(0, 2, (count, 1))
    return np.concatenate([middles[rng.integers(0, 5, count)] + spread, rng.uniform(0, 30, (9, 3))])


def same_as_scikit_learn(points, eps, min_points):
    peer = sklearn.cluster.DBSCAN(eps=eps, min_samples=min_points).fit(points)
    np.testing.assert_array_equal(DBSCAN(eps, min_points)(points), peer.labels_)
    distances = k_distances(points, min(min_points, len(points)))
    assert (np.diff(distances) <= 0).all()
    if min_points <= len(points):
        assert np.count_nonzero(distances <= eps) == len(peer.core_sample_indices_)


@given(seeds, st.integers(1, 60), st.integers(1, 7), st.sampled_from([1, 2, 5]), st.integers(1, 12))
def test_dbscan_on_lattices_with_ties_at_eps(seed, count, width, eps, min_points):
    same_as_scikit_learn(lattice(seed, count, width), eps, min_points)


@given(seeds, st.sampled_from([0.5, 2.7, 8.0, 40.0]), st.integers(1, 30))
def test_dbscan_on_clouds_of_uneven_density(seed, eps, min_points):
    same_as_scikit_learn(uneven(seed, 400), eps, min_points)


@pytest.mark.parametrize(("eps", "min_points"), [(50.0, 10), (15.0, 10)])
def test_dbscan_on_a_window_of_a_frame(kept_scene, eps, min_points):
    frame = kept_scene("V4").frame(75)
    inside = (np.abs(frame.pixels - [760, 1000]) < 200).all(axis=1)
    assert np.count_nonzero(inside) > 5000
    same_as_scikit_learn(frame.xyz[inside].astype(np.float64), eps, min_points)


def test_a_border_point_goes_to_the_first_of_its_clusters():
    line = np.zeros((9, 3))
    line[:, 0] = [14.0, 13.0, 12.0, 11.0, 5.5, 0.0, -1.0, -2.0, -3.0]
    for points in (line, line[::-1]):
        assert DBSCAN(5.5, 4)(points).tolist() == [0, 0, 0, 0, 0, 1, 1, 1, 1]


def test_the_point_itself_counts_and_eps_belongs_to_the_neighbourhood():
    pair = np.array([[0.0, 0, 0], [3.0, 0, 0]])
    assert DBSCAN(3.0, 2)(pair).tolist() == [0, 0]
    assert DBSCAN(np.nextafter(3.0, 0), 2)(pair).tolist() == [-1, -1]


@given(seeds, st.integers(1, 40))
def test_morphology_is_the_dilation_of_a_full_grid(seed, grid):
    for points in (uneven(seed) * [1, 1, 10], lattice(seed, 1 + seed % 60, 17) / 2):
        labels = MorphologicalClustering(grid)(points)
        np.testing.assert_array_equal(labels, plain.morphology(points, grid))


@pytest.mark.parametrize(("gap", "found"), [(2, 2), (3, 2), (4, 3)])
def test_one_dilation_closes_two_empty_cells(gap, found):
    cells = np.concatenate([np.arange(start, start + 5) for start in (0, 4 + gap, 36)])
    points = np.stack([cells, 0 * cells, 0 * cells], axis=1)
    assert len(set(MorphologicalClustering(40)(points))) == found


@given(seeds, st.integers(1, 12), st.sampled_from([0.0, 0.1, 0.5, 1.0, 3.0]))
@example(0, 5, 0.1)
def test_quasi_centers_are_the_definition_in_sets(seed, k, alpha):
    for points in (uneven(seed, 90), lattice(seed, 1 + seed % 70, 1 + seed % 6)):
        expected = plain.quasi_centers(points, k, alpha, plain.neighbors_by_sorting(points, k))
        np.testing.assert_array_equal(QuasiClusterCenters(k, alpha)(points), expected)


@given(seeds, st.integers(1, 10), st.sampled_from([(1, 1, 1), (1, 1, 1000), (0, 1, 0), (0, 0, 0)]))
def test_neighbours_are_the_nearest_first_ties_in_the_order_of_the_cloud(seed, k, shape):
    for points in (uneven(seed) * shape, lattice(seed, 90, 6) * shape):
        expected = plain.neighbors_by_sorting(points, k)
        np.testing.assert_array_equal(nearest_neighbors(points, k), expected)
        # the first columns of a search for more are the same
        np.testing.assert_array_equal(nearest_neighbors(points, k + 7)[:, :k], expected)


@pytest.mark.parametrize("count", range(4))
def test_a_few_points_have_all_others_as_neighbours_and_no_density(count):
    points = uneven(0)[:count]
    assert nearest_neighbors(points, 5).shape == (count, max(count - 1, 0))
    assert QuasiClusterCenters(5, 0.1)(points).tolist() == [-1] * count
    assert QuasiClusterCenters(9, 0.1)(uneven(0)[:9]).tolist() == [-1] * 9


def test_a_long_line_of_equal_steps_is_one_cluster():
    """Nearly all points are centres of one density; they are not compared pair by pair."""
    line = np.outer(np.arange(5000.0), [1, 0, 0])
    assert set(QuasiClusterCenters(20, 0.1)(line)) == {0}


def blobs(seed=0, size=60):
    """Three balls of 2 mm, alike and 40 mm apart, shuffled, and the ball of each point."""
    rng = np.random.default_rng(seed)
    ball = np.repeat(np.arange(3), size)
    middles = np.array([[0.0, 0.0, 5000.0], [40.0, 0.0, 5000.0], [0.0, 40.0, 5040.0]])
    around = np.round(rng.uniform(-2, 2, (size, 3)) * 1024) / 1024
    around[:2] = [[-2, -2, -2], [2, 2, 2]]
    order = rng.permutation(3 * size)
    return (middles[ball] + np.tile(around, (3, 1)))[order], ball[order]


@each
def test_blobs_are_found_and_numbered_by_their_first_point(clusterer):
    points, ball = blobs()
    for cloud in (points, points.astype(np.float32)):
        labels = clusterer(cloud)
        assert labels.dtype == np.intp
        np.testing.assert_array_equal(labels, plain.renumbered(ball))


@each
@given(seed=seeds)
def test_a_permutation_of_the_points_permutes_the_labels(clusterer, seed):
    points = uneven(seed)
    if isinstance(clusterer, DBSCAN):
        clusterer = replace(clusterer, min_points=1)  # without border points there are no ties
    order = np.random.default_rng(seed).permutation(len(points))
    expected = plain.renumbered(clusterer(points)[order])
    np.testing.assert_array_equal(plain.renumbered(clusterer(points[order])), expected)


@each
@given(shift=st.tuples(*3 * [st.integers(-10_000, 10_000)]), seed=seeds)
def test_a_shift_of_the_cloud_changes_nothing(clusterer, shift, seed):
    points = np.round(uneven(seed) * 8) / 8  # eighths of a millimetre: differences are exact
    np.testing.assert_array_equal(clusterer(points), clusterer(points + np.array(shift)))


@pytest.mark.parametrize(
    ("clusterer", "table", "columns"),
    [
        (CLUSTERERS[0], "table_5.8", {"epsilon_mm": "eps", "minPts": "min_points"}),
        (CLUSTERERS[1], "table_5.9", {"R": "grid"}),
        (CLUSTERERS[2], "table_5.10", {"K": "k", "alpha": "alpha"}),
    ],
)
def test_defaults_are_the_best_published_parameters(clusterer, table, columns):
    rows = claims.published(table)
    best = rows.loc[(rows.TP / (rows.TP + (rows.FP + rows.FN) / 2)).idxmax()]
    assert {columns[name]: best[name] for name in columns}.items() <= asdict(clusterer).items()
