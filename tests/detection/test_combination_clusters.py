import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.detection.combination import mean_gray, potential_particles, summarise

SHAPE = (60, 80)


def block(row, col, size=3):
    return np.argwhere(np.ones((size, size))) + np.array([row, col])


def clusters_at(*places):
    pixels = np.concatenate([block(*place) for place in places] + [np.empty((0, 2), int)])
    labels = np.repeat(np.arange(len(places)), 9)
    xyz = np.column_stack([pixels, np.full(len(pixels), 7000.0)])
    return summarise(pixels.astype(int), xyz, labels)


def found(keypoints, clusters):
    points = np.array(keypoints, float).reshape(-1, 3)
    return sorted(
        (case, spots.tolist(), groups.tolist())
        for case, spots, groups in potential_particles(points, clusters, SHAPE)
    )


def test_each_case_is_told():
    clusters = clusters_at((10, 10), (30, 10), (50, 10), (52, 16), (10, 40))
    keypoints = [
        (11, 11, 2.0),  # on the first cluster alone
        (30, 10, 1.5),  # two on the second
        (32, 12, 1.5),
        (52, 14, 4.0),  # one on the third and fourth
        (40, 60, 3.0),  # alone
    ]
    assert found(keypoints, clusters) == [
        (1, [0], [0]),
        (2, [1, 2], [1]),
        (3, [3], [2, 3]),
        (4, [], [4]),
        (5, [4], []),
    ]


def test_several_of_both_are_case_2():
    assert found([(11, 12, 4.0), (11, 18, 4.0)], clusters_at((10, 10), (10, 14))) == [
        (2, [0, 1], [0, 1])
    ]


def test_nothing_is_no_particle():
    assert found([], clusters_at()) == []
    assert len(clusters_at()) == 0
    assert clusters_at().centers.shape == (0, 2)


def test_a_cluster_knows_its_rectangle_center_and_place():
    cluster = clusters_at((10, 10), (10, 20)).take(np.array([1]))
    assert cluster.rectangle().tolist() == [10, 13, 20, 23]
    assert clusters_at((10, 10), (10, 20)).extent.tolist() == [3, 3]
    assert clusters_at().extent.shape == (0,)
    assert cluster.center() == pytest.approx((11.0, 21.0, np.sqrt(9 / np.pi)))
    assert cluster.place() == (11.0, 21.0, 7000.0, 9)
    assert cluster.rectangle(disc=np.array([11.0, 20.0, 1.0])).tolist() == [10, 13, 20, 22]


def test_points_go_to_the_nearest_spot():
    cluster = clusters_at((10, 10))
    owner = cluster.nearest(np.array([[10.0, 9.0], [12.0, 13.0]]))
    assert owner.tolist() == [0, 0, 1, 0, 0, 1, 0, 1, 1]


def test_noise_belongs_to_no_cluster_and_labels_need_not_be_sorted():
    pixels = np.array([[1, 1], [5, 5], [1, 2], [9, 9]])
    clusters = summarise(pixels, np.zeros((4, 3)), np.array([7, -1, 7, 3]))
    assert len(clusters) == 2
    assert clusters.centers[:, 0].tolist() == [9.0, 1.0]
    assert clusters.total == 3


def test_lengths_must_fit():
    with pytest.raises(InputError, match="pixels"):
        summarise(np.zeros((3, 2), int), np.zeros((4, 3)), np.zeros(4, int))


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-3, 62), st.floats(-3, 82), st.floats(0.2, 8)), min_size=1, max_size=8
    ),
    st.lists(st.tuples(st.integers(0, 14), st.integers(0, 18)), max_size=6, unique=True),
)
def test_two_belong_together_where_they_share_a_pixel(keypoints, corners):
    clusters = clusters_at(*((4 * r, 4 * c) for r, c in corners))
    together = [
        (set(spots.tolist()), set(groups.tolist()))
        for _, spots, groups in potential_particles(np.array(keypoints), clusters, SHAPE)
    ]
    assert sorted(k for spots, _ in together for k in spots) == list(range(len(keypoints)))
    assert sorted(c for _, groups in together for c in groups) == list(range(len(corners)))
    for k, (row, col, radius) in enumerate(keypoints):
        for c in range(len(corners)):
            pixels = clusters.take(np.array([c])).pixels
            far = np.hypot(pixels[:, 0] - row, pixels[:, 1] - col)
            if (far <= max(radius, 1.0) - 1e-9).any():
                assert any(k in spots and c in groups for spots, groups in together)


def test_the_mean_grey_value_is_that_of_the_disc():
    image = np.arange(60 * 80, dtype=np.uint16).reshape(SHAPE)
    row, col = np.indices(SHAPE)
    disc = (row - 20.3) ** 2 + (col - 30.7) ** 2 <= 4.2**2
    discs = np.array([[20.3, 30.7, 4.2], [5.5, 5.5, 0.1], [59.4, 79.4, 0.2]])
    assert mean_gray(image, discs) == pytest.approx(
        [image[disc].mean(), image[6, 6], image[59, 79]]
    )
    assert mean_gray(image, np.empty((0, 3))).shape == (0,)
