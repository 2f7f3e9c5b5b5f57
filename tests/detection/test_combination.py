from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.detection import CLUSTERERS, DBSCAN, DETECTORS_2D
from kilnflight.detection.combination import (
    Combination,
    View,
    disc_pixels,
    mean_gray,
    potential_particles,
    second_pass,
    summarise,
)
from kilnflight.tables import DETECTIONS

SHAPE = (60, 80)
ROWS, COLS = 120, 160
ROW, COL = np.indices((ROWS, COLS))


@dataclass(frozen=True)
class Given:
    """A detector of given keypoints."""

    spots: tuple = ()

    def __call__(self, foreground, within=None):
        return np.array(self.spots, dtype=float).reshape(-1, 3)


def hill(row, col, top, sigma=2.5):
    return top * np.exp(-((ROW - row) ** 2 + (COL - col) ** 2) / (2 * sigma**2))


def view(now, before=None, groups=(), noise=20.0):
    """A frame of hills, and clusters of points: (row, col, half size, depth in mm)."""
    generator = np.random.default_rng(3)
    before = np.zeros((ROWS, COLS)) if before is None else before
    gray, previous = (
        (5000 + picture + noise * generator.normal(size=picture.shape)).astype(np.uint16)
        for picture in (now, before)
    )
    pixels = [np.empty((0, 2), int)]
    xyz = [np.empty((0, 3))]
    for row, col, half, depth in groups:
        block = np.argwhere((abs(ROW - row) <= half) & (abs(COL - col) <= half))
        pixels.append(block)
        xyz.append(np.column_stack([block[:, ::-1].astype(float), np.full(len(block), depth)]))
    return View(
        gray, previous, gray.astype(np.float32), np.concatenate(pixels), np.concatenate(xyz)
    )


def combine(frame, spots=(), **more):
    """Clusters are 5 mm apart; the wall is the largest cluster of more than 400 points."""
    detector = Combination(
        detector=Given(tuple(spots)), clusterer=DBSCAN(3.0, 4), wall=DBSCAN(1e-3, 2), **more
    )
    return detector(frame)


def test_case_1_is_where_the_keypoint_is_and_as_deep_as_the_cluster():
    detections = combine(
        view(hill(40, 50, 3000), groups=[(41, 51, 2, 6000.0)]), [(40.2, 49.8, 4.0)]
    )
    detection = detections.iloc[0]
    assert detections[["row", "col", "radius_px", "case"]].to_numpy().tolist() == [
        [40.2, 49.8, 4.0, 1]
    ]
    assert (detection.x, detection.y, detection.z, detection.points) == (51.0, 41.0, 6000.0, 25)
    assert detection.gray > 6000


def test_case_2_two_keypoints_on_one_large_particle_are_one():
    frame = view(hill(40, 50, 9000, 5.0), groups=[(40, 50, 6, 6000.0)])
    detections = combine(frame, [(38, 48, 2.0), (43, 52, 2.0)])
    assert detections["case"].tolist() == [2]
    assert detections[["row", "col", "points"]].to_numpy().tolist() == [[40, 50, 169]]


def test_case_2_two_particles_in_one_cluster_are_two():
    frame = view(hill(40, 45, 9000) + hill(40, 57, 7000), groups=[(40, 51, 9, 6000.0)])
    detections = combine(frame, [(40, 45, 3.0), (40, 57, 3.0)])
    assert detections["case"].tolist() == [2, 2]
    assert detections["col"].to_numpy() == pytest.approx([45, 57], abs=1)
    assert detections["points"].sum() == 19 * 19
    assert detections["x"].to_numpy()[0] < 51 < detections["x"].to_numpy()[1]


def test_case_3_an_overexposed_particle_in_two_clusters_is_one():
    groups = [(40, 44, 1, 6000.0), (40, 56, 1, 6100.0)]
    detections = combine(view(hill(40, 50, 9000, 5.0), groups=groups), [(40, 50, 8.0)])
    assert detections[["row", "col", "case", "points"]].to_numpy().tolist() == [[40, 50, 3, 18]]
    assert detections["z"].to_numpy() == pytest.approx(6050.0)


def test_case_3_two_particles_under_one_keypoint_are_two():
    groups = [(40, 44, 2, 6000.0), (40, 58, 2, 6100.0)]
    detections = combine(
        view(hill(40, 44, 9000) + hill(40, 58, 8000), groups=groups), [(40, 51, 9.0)]
    )
    assert detections["case"].tolist() == [3, 3]
    assert detections["z"].to_numpy() == pytest.approx([6000.0, 6100.0])


@pytest.mark.parametrize(("top", "count"), [(600, 1), (-600, 1), (0, 0)])
def test_case_4_a_cluster_counts_if_something_is_there_and_has_moved(top, count):
    frame = view(hill(40, 50, top), hill(40, 46, top), groups=[(40, 50, 3, 6000.0)])
    detections = combine(frame)
    assert detections["case"].tolist() == [4] * count
    still = view(hill(40, 50, top), hill(40, 50, top), groups=[(40, 50, 3, 6000.0)])
    assert len(combine(still)) == 0


def test_case_5_a_keypoint_counts_likewise_and_has_no_place_in_space():
    detections = combine(view(hill(40, 50, 600), hill(40, 46, 600)), [(40, 50, 4.0)])
    assert detections["case"].tolist() == [5]
    assert detections["points"].tolist() == [0]
    assert detections[["x", "y", "z"]].isna().all(axis=None)
    assert len(combine(view(hill(40, 50, 600), hill(40, 50, 600)), [(40, 50, 4.0)])) == 0
    assert len(combine(view(np.zeros((ROWS, COLS))), [(40, 50, 4.0)])) == 0


def test_particles_outside_the_region_are_left_out():
    frame = view(hill(40, 50, 3000), groups=[(40, 50, 2, 6000.0), (90, 20, 2, 6000.0)])
    detector = Combination(
        Given(((40.0, 50.0, 4.0), (90.0, 20.0, 4.0))), DBSCAN(3.0, 4), DBSCAN(1e-3, 2)
    )
    square = ((20.0, 30.0), (20.0, 70.0), (60.0, 70.0), (60.0, 30.0))
    assert detector(frame, square)["col"].tolist() == [50.0]
    assert len(detector(frame)) == 2


def test_an_empty_frame_gives_an_empty_table_that_passes():
    nothing = view(np.zeros((ROWS, COLS)), noise=0.0)
    table = Combination()(nothing._replace(foreground=np.zeros((ROWS, COLS), np.float32)))
    assert len(DETECTIONS.check(table)) == 0


@pytest.mark.parametrize("detector", DETECTORS_2D)
@pytest.mark.parametrize("clusterer", CLUSTERERS)
def test_any_detector_goes_with_any_clusterer(detector, clusterer):
    picture = hill(40, 50, 9000, 4.0) + hill(80, 100, 9000, 4.0)
    frame = view(picture, groups=[(40, 50, 6, 6000.0), (80, 100, 6, 7000.0)])
    frame = frame._replace(foreground=picture.astype(np.float32))
    table = Combination(detector, clusterer, clusterer)(frame, frame=7)
    assert len(DETECTIONS.check(table)) == 2
    assert set(table["frame"]) == {7}


def test_the_largest_cluster_of_the_first_pass_is_the_wall():
    wall = np.random.default_rng(0).uniform(0, 40, (500, 3))
    particle = np.random.default_rng(1).uniform(0, 4, (30, 3)) + 200.0
    labels = second_pass(np.concatenate([wall, particle]), DBSCAN(20.0, 4), DBSCAN(20.0, 4))
    assert (labels[:500] == -1).all()
    assert (labels[500:] == 0).all()
    assert second_pass(np.empty((0, 3)), DBSCAN(20.0, 4), DBSCAN(20.0, 4)).shape == (0,)


def test_bad_parameters_and_frames_of_two_sizes_are_refused():
    with pytest.raises(InputError, match="prominence"):
        Combination(prominence=0.0)
    frame = view(np.zeros((ROWS, COLS)))
    with pytest.raises(InputError, match="the frame before: shape"):
        combine(frame._replace(previous=frame.previous[:-1]))


def test_the_order_of_points_and_keypoints_does_not_matter():
    frame = view(
        hill(40, 45, 9000) + hill(40, 57, 7000) + hill(90, 30, 800),
        groups=[(40, 51, 9, 6000.0), (90, 30, 2, 5000.0), (20, 120, 2, 5500.0)],
    )
    spots = [(40, 45, 3.0), (40, 57, 3.0), (90, 30, 3.0), (100, 140, 3.0)]
    order = np.random.default_rng(0).permutation(len(frame.pixels))
    mixed = replace_points(frame, order)
    columns = ["row", "col", "case", "points"]
    first = combine(frame, spots)[columns].sort_values(columns).to_numpy()
    other = combine(mixed, spots[::-1])[columns].sort_values(columns).to_numpy()
    np.testing.assert_allclose(first, other)


def replace_points(frame, order):
    return frame._replace(pixels=frame.pixels[order], xyz=frame.xyz[order])


def test_a_cluster_larger_than_any_particle_is_left_out():
    frame = view(hill(40, 50, 3000), groups=[(50, 60, 40, 6000.0)])
    spots = [(40, 50, 4.0), (90, 100, 4.0)]
    assert combine(frame, spots, largest_px=80)["case"].tolist() == [5]
    assert set(combine(frame, spots, largest_px=81)["case"]) == {2}


def test_a_view_whose_parts_do_not_belong_together_is_refused():
    frame = view(hill(40, 45, 9000), groups=[(40, 45, 3, 6000.0)])
    far = frame.pixels.copy()
    far[0] = (ROWS, 0)
    with pytest.raises(InputError, match=r"point 0 belongs to pixel \(120, 0\)"):
        combine(frame._replace(pixels=far))
    with pytest.raises(InputError, match="foreground: shape"):
        combine(frame._replace(foreground=frame.foreground[:, 1:]))
    labels = np.zeros(len(frame.xyz), np.intp)
    with pytest.raises(InputError, match="keypoints: 1 value"):
        Combination().decide(frame, np.array([[1.0, np.nan, 2.0]]), labels)
    with pytest.raises(InputError, match="labels of the points"):
        Combination().decide(frame, np.empty((0, 3)), labels[1:])


def block(row, col, size=3):
    return np.argwhere(np.ones((size, size))) + np.array([row, col])


def clusters_at(*places):
    pixels = np.concatenate([block(*place) for place in places] + [np.empty((0, 2), int)])
    labels = np.repeat(np.arange(len(places)), 9)
    xyz = np.column_stack([pixels, np.full(len(pixels), 7000.0)])
    return summarise(pixels.astype(int), xyz, labels)


def cases(keypoints, clusters):
    points = np.array(keypoints, float).reshape(-1, 3)
    return sorted(
        (case, spots.tolist(), groups.tolist())
        for case, spots, groups in potential_particles(points, clusters, SHAPE)
    )


def test_each_case_is_recognised():
    clusters = clusters_at((10, 10), (30, 10), (50, 10), (52, 16), (10, 40))
    keypoints = [
        (11, 11, 2.0),  # on the first cluster alone
        (30, 10, 1.5),  # two on the second
        (32, 12, 1.5),
        (52, 14, 4.0),  # one on the third and fourth
        (40, 60, 3.0),  # alone
    ]
    assert cases(keypoints, clusters) == [
        (1, [0], [0]),
        (2, [1, 2], [1]),
        (3, [3], [2, 3]),
        (4, [], [4]),
        (5, [4], []),
    ]


def test_several_of_both_are_case_2():
    assert cases([(11, 12, 4.0), (11, 18, 4.0)], clusters_at((10, 10), (10, 14))) == [
        (2, [0, 1], [0, 1])
    ]


def test_nothing_is_no_particle():
    assert cases([], clusters_at()) == []
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
    rng = np.random.default_rng(2)
    discs = rng.uniform((-3, -3, 0), (63, 83, 9), (300, 3))  # some beyond the border
    disc, row, col = disc_pixels(discs, 0.0, SHAPE)
    many = np.unique(disc)
    assert len(many) > 250
    exact = [image[row[disc == k], col[disc == k]].mean() for k in many]
    for picture in (image, image.astype(np.float64), image.T.copy().T):
        assert mean_gray(picture, discs)[many] == pytest.approx(exact)
    for kind in (">u2", ">f4", np.float16, np.uint8):
        picture = (image % 200).astype(kind)
        exact = [(image % 200)[row[disc == k], col[disc == k]].mean() for k in many]
        assert mean_gray(picture, discs)[many] == pytest.approx(exact)
