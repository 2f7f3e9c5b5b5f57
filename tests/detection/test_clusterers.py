"""What the three clusterers have in common."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.detection import CLUSTERERS, DBSCAN, MorphologicalClustering, QuasiClusterCenters
from kilnflight.project import claims

SMALL = (DBSCAN(3.0, 5), MorphologicalClustering(22), QuasiClusterCenters(5, 0.1))
each = pytest.mark.parametrize("clusterer", SMALL, ids=lambda one: type(one).__name__)


def blobs(seed=0, size=60):
    """Three balls of 2 mm, alike and 40 mm apart, shuffled, and the ball of each point."""
    rng = np.random.default_rng(seed)
    ball = np.repeat(np.arange(3), size)
    middles = np.array([[0.0, 0.0, 5000.0], [40.0, 0.0, 5000.0], [0.0, 40.0, 5040.0]])
    around = np.round(rng.uniform(-2, 2, (size, 3)) * 1024) / 1024
    around[:2] = [[-2, -2, -2], [2, 2, 2]]
    order = rng.permutation(3 * size)
    return (middles[ball] + np.tile(around, (3, 1)))[order], ball[order]


def partition(labels):
    """Labels renumbered by their first point; noise stays."""
    numbers = {-1: -1}
    return [numbers.setdefault(label, len(numbers) - 1) for label in labels.tolist()]


@each
def test_blobs_are_found_and_numbered_by_their_first_point(clusterer):
    points, ball = blobs()
    labels = clusterer(points)
    assert labels.dtype == np.intp
    np.testing.assert_array_equal(labels, partition(ball))


@pytest.mark.parametrize("clusterer", CLUSTERERS + SMALL, ids=repr)
def test_empty_is_normal(clusterer):
    for nothing in (np.empty((0, 3)), np.empty((0, 3), np.float32), []):
        labels = clusterer(nothing)
        assert labels.shape == (0,)
        assert labels.dtype == np.intp


@each
def test_one_point(clusterer):
    expected = 0 if isinstance(clusterer, MorphologicalClustering) else -1
    assert clusterer([[1.0, 2.0, 3.0]]).tolist() == [expected]


@each
def test_many_points_at_one_place_are_one_cluster(clusterer):
    assert set(clusterer(np.full((400, 3), 7.5)).tolist()) == {0}


@each
@pytest.mark.parametrize("flat", [[1, 1, 0], [1, 0, 0], [0, 0, 1]])
def test_planes_and_lines(clusterer, flat):
    points, ball = blobs()
    both = ball < 2 if flat != [0, 0, 1] else ball != 1
    labels = clusterer(points[both] * flat)
    mixed = {*zip(labels[labels >= 0], ball[both][labels >= 0], strict=True)}
    assert len(mixed) == labels.max() + 1  # no cluster of two balls
    if not isinstance(clusterer, QuasiClusterCenters):  # which cuts balls where they are thin
        np.testing.assert_array_equal(labels, partition(ball[both]))


@each
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_permutation_of_the_points_permutes_the_labels(clusterer, seed):
    rng = np.random.default_rng(seed)
    points = np.concatenate([blobs(seed, 30)[0] - [0, 0, 5000], rng.uniform(-10, 50, (60, 3))])
    if isinstance(clusterer, DBSCAN):
        clusterer = replace(clusterer, min_points=1)  # without border points there are no ties
    order = rng.permutation(len(points))
    assert partition(clusterer(points)[order]) == partition(clusterer(points[order]))


@each
@settings(max_examples=25)
@given(shift=st.tuples(*3 * [st.integers(-10_000, 10_000)]), seed=st.integers(0, 1000))
def test_a_shift_of_the_cloud_changes_nothing(clusterer, shift, seed):
    # eighths of a millimetre: sums and differences are exact
    points = np.round(np.random.default_rng(seed).uniform(0, 30, (150, 3)) * 8) / 8
    np.testing.assert_array_equal(clusterer(points), clusterer(points + np.array(shift)))


@each
def test_float32_is_taken_at_its_value(clusterer):
    points = blobs()[0].astype(np.float32)
    np.testing.assert_array_equal(clusterer(points), clusterer(points.astype(np.float64)))


@each
@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0.0, np.nan, 0.0]], "not finite, the first .nan. at index .0, 1."),
        ([[0.0, np.inf, 0.0]], "not finite"),
        (np.zeros((5, 2)), r"shape \(5, 2\), expected \(n, 3\)"),
        (np.zeros(3), r"shape \(3,\), expected \(n, 3\)"),
        ("cloud", "not made of numbers"),
        (1e300 * np.eye(3), "beyond"),
    ],
)
def test_points_that_cannot_be_used_are_refused(clusterer, points, message):
    with pytest.raises(ValueError, match=message):
        clusterer(points)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: DBSCAN(0.0, 5), "eps in mm: must be"),
        (lambda: DBSCAN(np.nan, 5), "eps in mm"),
        (lambda: DBSCAN(1.0, 0), "min_points: must be"),
        (lambda: DBSCAN(1.0, 2.5), "min_points: must be"),
        (lambda: MorphologicalClustering(0), "grid: must be"),
        (lambda: MorphologicalClustering(1.5), "grid: must be"),
        (lambda: MorphologicalClustering(10, -1), "dilations: must be"),
        (lambda: QuasiClusterCenters(0, 0.1), "k: must be"),
        (lambda: QuasiClusterCenters(5, -0.1), "alpha: must be"),
        (lambda: QuasiClusterCenters(5, np.inf), "alpha: must be"),
        (lambda: DBSCAN(1.0, np.nan), "min_points: must be"),
        (lambda: MorphologicalClustering(np.inf), "grid: must be"),
        (lambda: MorphologicalClustering(10, np.nan), "dilations: must be"),
        (lambda: QuasiClusterCenters(np.nan, 0.1), "k: must be"),
    ],
)
def test_parameters_that_cannot_be_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()


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
