"""DBSCAN against scikit-learn, point by point, and the k-distance graph."""

import numpy as np
import pytest
import sklearn.cluster
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kilnflight.camera import calibrate_depth
from kilnflight.checks import InputError
from kilnflight.detection import DBSCAN, ScikitDBSCAN, k_distances


def same_as_scikit_learn(points, eps, min_points):
    peer = sklearn.cluster.DBSCAN(eps=eps, min_samples=min_points).fit(points)
    np.testing.assert_array_equal(DBSCAN(eps, min_points)(points), peer.labels_)
    return peer


lattices = arrays(np.int64, st.tuples(st.integers(1, 60), st.just(3)), elements=st.integers(0, 6))
clouds = arrays(
    np.float64, st.tuples(st.integers(1, 60), st.just(3)), elements=st.floats(-10, 10, width=32)
)


@given(lattices, st.sampled_from([1.0, 2.0, 3.0, 5.0]), st.integers(1, 12))
def test_lattices_with_ties_at_eps(points, eps, min_points):
    same_as_scikit_learn(points.astype(float), eps, min_points)


@given(clouds, st.sampled_from([0.5, 1.0, 2.7, 8.0, 40.0]), st.integers(1, 12))
@example(np.zeros((12, 3)), 1.0, 12)
def test_clouds(points, eps, min_points):
    same_as_scikit_learn(points, eps, min_points)


@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.floats(0.01, 0.4))
def test_larger_clouds_of_uneven_density(seed, min_points, eps):
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 1, (400, 3)) ** 3
    same_as_scikit_learn(points, eps, min_points)


def test_a_border_point_goes_to_the_first_of_its_clusters():
    line = np.zeros((9, 3))
    line[:, 0] = [14.0, 13.0, 12.0, 11.0, 5.5, 0.0, -1.0, -2.0, -3.0]
    labels = DBSCAN(5.5, 4)(line)
    assert labels.tolist() == [0, 0, 0, 0, 0, 1, 1, 1, 1]
    assert DBSCAN(5.5, 4)(line[::-1]).tolist() == [0, 0, 0, 0, 0, 1, 1, 1, 1]


def test_the_point_itself_counts_and_eps_belongs_to_the_neighbourhood():
    pair = np.array([[0.0, 0, 0], [3.0, 0, 0]])
    assert DBSCAN(3.0, 2)(pair).tolist() == [0, 0]
    assert DBSCAN(np.nextafter(3.0, 0), 2)(pair).tolist() == [-1, -1]
    assert DBSCAN(1.0, 1)(pair).tolist() == [0, 1]


@pytest.fixture(scope="module")
def window(kept_scene):
    """The middle of a frame of the twin, calibrated."""
    frame = kept_scene("V4").frame(75)
    inside = (np.abs(frame.pixels - [760, 1000]) < 200).all(axis=1)
    cloud = frame.xyz[inside].astype(np.float64)
    cloud[:, 2] = calibrate_depth(cloud[:, 2])
    assert len(cloud) > 5000
    return cloud


@pytest.mark.parametrize(("eps", "min_points"), [(50.0, 10), (15.0, 10), (70.0, 15), (10.0, 6)])
def test_a_window_of_a_frame(window, eps, min_points):
    same_as_scikit_learn(window, eps, min_points)


def test_the_clusterer_of_scikit_learn_gives_the_same_labels(window):
    for eps, min_points in ((50.0, 10), (15, 10)):
        peer = ScikitDBSCAN(eps, min_points)(window)
        np.testing.assert_array_equal(peer, DBSCAN(eps, min_points)(window))
    assert ScikitDBSCAN()(np.empty((0, 3))).shape == (0,)
    with pytest.raises(InputError, match="eps"):
        ScikitDBSCAN(eps=0.0)


def test_a_cloud_too_long_for_its_cells_is_refused():
    with pytest.raises(InputError, match=r"more than 2000000 cells of 5\.77e-05"):
        DBSCAN(1e-4, 3)([[0.0, 0.0, 0.0], [0.0, 0.0, 9000.0]])


@given(clouds, st.integers(1, 8), st.integers(1, 5))
def test_k_distances_up_to_eps_are_core_points(points, k, radius):
    distances = k_distances(points, min(k, len(points)))
    assert (np.diff(distances) <= 0).all()
    between = np.linalg.norm(points[:, None] - points, axis=2)
    between.sort(axis=1)
    np.testing.assert_allclose(distances, np.sort(between[:, min(k, len(points)) - 1])[::-1])
    core = sklearn.cluster.DBSCAN(eps=radius, min_samples=min(k, len(points))).fit(points)
    ours = np.count_nonzero(distances <= radius)
    assert ours == len(core.core_sample_indices_)


def test_k_distances_of_too_few_points():
    assert k_distances(np.empty((0, 3)), 6).shape == (0,)
    for k in (0, 1.5, 4):
        with pytest.raises(InputError, match=f"k is {k}"):
            k_distances(np.zeros((3, 3)), k)
