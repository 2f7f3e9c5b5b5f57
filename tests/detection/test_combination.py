import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.detection import (
    DBSCAN,
    DoG,
    MorphologicalClustering,
    Otsu,
    QuasiClusterCenters,
    combination,
)
from kilnflight.detection.combination import Combination, Planar, View
from kilnflight.tables import DETECTIONS

ROWS, COLS = np.indices((120, 160))
SHOWN = ["row", "col", "z", "points", "case"]


def hill(row, col, top, sigma=2.5):
    return top * np.exp(-((ROWS - row) ** 2 + (COLS - col) ** 2) / (2 * sigma**2))


def view(now, *groups, before=0):
    """A frame of hills, and clusters of points: (row, col, half size, depth in mm)."""
    noise = 20.0 * np.random.default_rng(3).normal(size=(2, *ROWS.shape))
    gray, previous = (5000 + np.stack([now, before + 0 * now]) + noise).astype(
        np.uint16
    )
    pixels, xyz = [np.empty((0, 2), int)], [np.empty((0, 3))]
    for row, col, half, depth in groups:
        pixels.append(
            np.argwhere((abs(ROWS - row) <= half) & (abs(COLS - col) <= half))
        )
        xyz.append(np.insert(pixels[-1][:, ::-1].astype(float), 2, depth, axis=1))
    points = np.concatenate(pixels), np.concatenate(xyz)
    return View(gray, previous, gray.astype(np.float32), *points)


def found(frame, *spots, roi=None):
    """Detections of given keypoints; the largest cluster of equal points is wall."""
    keypoints = np.array(spots, dtype=float).reshape(-1, 3)
    return Combination(lambda *_: keypoints, DBSCAN(3.0, 4), DBSCAN(1e-3, 2))(
        frame, roi
    )


def test_case_1_is_where_the_keypoint_is_and_as_deep_as_the_cluster():
    table = found(view(hill(40, 50, 3000), (41, 51, 2, 6000.0)), (40.2, 49.8, 4.0))
    assert table[SHOWN].to_numpy().tolist() == [[40.2, 49.8, 6000.0, 25, 1]]
    assert table[["radius_px", "x", "y"]].to_numpy().tolist() == [[4.0, 51.0, 41.0]]
    assert table["gray"].item() > 6000


def test_case_2_counts_peaks_in_the_clusters_rectangle():
    one = view(hill(40, 50, 9000, 5.0), (40, 50, 6, 6000.0))
    table = found(one, (38, 48, 2.0), (43, 52, 2.0))
    assert table[SHOWN].to_numpy().tolist() == [[40, 50, 6000.0, 169, 2]]
    two = view(hill(40, 45, 9000) + hill(40, 57, 7000), (40, 51, 9, 6000.0))
    table = found(two, (40, 45, 3.0), (40, 57, 3.0))
    assert table["case"].tolist() == [2, 2]
    assert table["col"].to_numpy() == pytest.approx([45, 57], abs=1)
    assert table["points"].sum() == 19 * 19
    assert table["x"][0] < 51 < table["x"][1]
    beside = view(
        hill(40, 45, 30_000) + hill(40, 57, 500), (40, 51, 9, 6000.0)
    )  # a small one
    assert len(found(beside, (40, 45, 3.0), (40, 57, 3.0))) == 1


def test_case_3_counts_peaks_under_the_disc():
    groups = (40, 44, 1, 6000.0), (40, 56, 1, 6100.0)
    table = found(view(hill(40, 50, 9000, 5.0), *groups), (40, 50, 8.0))
    assert table[SHOWN].to_numpy().tolist() == [[40, 50, 6050.0, 18, 3]]
    table = found(view(hill(40, 44, 9000) + hill(40, 56, 8000), *groups), (40, 50, 9.0))
    assert table[["case", "z"]].to_numpy().tolist() == [[3, 6000.0], [3, 6100.0]]


@pytest.mark.parametrize("top", [600, -600])
def test_cases_4_and_5_count_if_something_is_there_and_has_moved(top):
    cluster, spot, here = (40, 50, 3, 6000.0), (40, 50, 4.0), hill(40, 50, top)
    there = hill(40, 46, top)
    assert found(view(here, cluster, before=there))["case"].tolist() == [4]
    table = found(view(here, before=there), spot)
    assert table[["case", "points"]].to_numpy().tolist() == [[5, 0]]
    assert table[["x", "y", "z"]].isna().all(axis=None)
    for picture, before in (
        (here, here),
        (1.02 * (5000 + here) - 5000, here),
        (0 * here, 0),
    ):
        assert len(found(view(picture, cluster, before=before))) == 0
        assert len(found(view(picture, before=before), spot)) == 0


def test_particles_outside_the_region_and_remainders_of_the_wall_are_left_out():
    frame = view(hill(40, 50, 3000), (40, 50, 2, 6000.0), (90, 20, 2, 6000.0))
    spots, square = (
        [(40, 50, 4.0), (90, 20, 4.0)],
        [(20, 30), (20, 70), (60, 70), (60, 30)],
    )
    assert found(frame, *spots, roi=square)["col"].tolist() == [50.0]
    assert len(found(frame, *spots)) == 2
    for half, cases in ((44, {2}), (45, {5})):
        frame = view(hill(40, 50, 3000), (60, 60, half, 6000.0))
        assert set(found(frame, (40, 50, 4.0), (90, 100, 4.0))["case"]) == cases


@pytest.mark.parametrize("detector", [Otsu(), DoG()])
@pytest.mark.parametrize(
    "clusterer", [DBSCAN(), MorphologicalClustering(), QuasiClusterCenters()]
)
def test_any_detector_goes_with_any_clusterer_in_any_order_of_points(
    detector, clusterer
):
    picture = hill(40, 50, 9000, 4.0) + hill(80, 100, 9000, 4.0)
    frame = view(
        picture, (40, 50, 6, 6000.0), (80, 100, 6, 7000.0), (100, 20, 9, 8000.0)
    )
    frame = frame._replace(foreground=picture.astype(np.float32))
    combined = Combination(detector, clusterer, clusterer)
    table = DETECTIONS.check(combined(frame, frame=7))
    assert table["frame"].tolist() == [7, 7]
    order = np.random.default_rng(0).permutation(len(frame.pixels))
    mixed = combined(
        frame._replace(pixels=frame.pixels[order], xyz=frame.xyz[order]), frame=7
    )
    np.testing.assert_allclose(
        *(t.sort_values("row").to_numpy() for t in (table, mixed))
    )
    nothing = view(0 * picture)._replace(foreground=0 * frame.foreground)
    assert len(DETECTIONS.check(combined(nothing))) == 0


@given(
    st.lists(
        st.tuples(st.floats(-3, 62), st.floats(-3, 82), st.floats(0.25, 8)), max_size=8
    ),
    st.lists(
        st.tuples(st.integers(0, 14), st.integers(0, 18)), max_size=6, unique=True
    ),
    st.booleans(),
)
def test_two_belong_together_where_disc_and_rectangle_share_a_pixel(
    keypoints, corners, whole
):
    """Each cluster is a cross of five pixels; its rectangle has nine."""
    cross = np.argwhere([[0, 1, 0], [1, 1, 1], [0, 1, 0]])
    blocks = [cross + 4 * np.array(corner) for corner in corners]
    pixels = np.concatenate([np.empty((0, 2), int), *blocks])
    xyz, labels = np.zeros((len(pixels), 3)), np.repeat(np.arange(len(blocks)), 5)
    clusters = combination.sort_clusters(pixels, xyz, labels)
    places = np.reshape(keypoints, (-1, 3))
    together = list(combination.potential_particles(places, clusters, whole))
    assert sorted(k for _, spots, _ in together for k in spots) == list(
        range(len(keypoints))
    )
    assert sorted(c for *_, groups in together for c in groups) == list(
        range(len(corners))
    )
    cases = {(1, 1): 1, (2, 1): 2, (1, 2): 3, (0, 1): 4, (1, 0): 5, (2, 2): 2}
    for case, spots, groups in together:
        assert case == cases[min(len(spots), 2), min(len(groups), 2)]
    square = np.argwhere(np.ones((3, 3)))
    areas = [(square if whole else cross) + 4 * np.array(corner) for corner in corners]
    for k, (row, col, radius) in enumerate(keypoints):
        (mine,) = (groups for _, spots, groups in together if k in spots)
        far = [np.hypot(*(area - (row, col)).T).min() for area in areas]
        sure = np.abs(np.subtract(far, max(radius, 1.0))) > 1e-9
        near = np.less(far, max(radius, 1.0)) & sure
        assert set(np.flatnonzero(near)) <= set(mine)
        alone = [s for _, s, g in together if k in s and len(s) == 1]
        if alone:  # no other keypoint links further clusters
            assert set(mine) <= set(np.flatnonzero(near | ~sure))


def test_the_overlap_is_the_rectangle_around_all_shared_pixels():
    areas = np.array([(10, 20, 10, 20), (14, 17, 30, 40), (39, 40, 20, 21)])
    disc = np.array([15.0, 25.0, 6.5])  # columns 19 to 31, of 20 x 20 only the last
    assert combination.overlap(disc, areas, (60, 80)).tolist() == [13, 18, 19, 32]
    assert combination.overlap(disc, areas[:1], (60, 80)).tolist() == [13, 18, 19, 20]
    point = np.array([39.4, 20.4, 0.1])  # smaller than a pixel
    assert combination.overlap(point, areas, (60, 80)).tolist() == [39, 40, 20, 21]


def test_a_keypoint_in_the_rectangle_only_belongs_to_the_cluster():
    """A ring of points around a keypoint: with its pixels the two are cases 4 and 5."""
    frame = view(hill(40, 50, 3000), (40, 50, 9, 6000.0))
    far = abs(frame.pixels - (40, 50)).max(axis=1)
    ring = frame._replace(pixels=frame.pixels[far > 7], xyz=frame.xyz[far > 7])
    keypoints = np.array([(40.0, 50.0, 3.0)])

    def cases(rectangular):
        rule = Combination(
            lambda *_: keypoints,
            DBSCAN(3.0, 4),
            DBSCAN(1e-3, 2),
            rectangular=rectangular,
        )
        return rule.decide(ring, keypoints, np.zeros(len(ring.pixels), int))[
            "case"
        ].tolist()

    assert cases(True) == [1]
    assert sorted(cases(False)) == [4, 5]


def test_a_keypoint_wider_than_the_largest_cluster_is_left_out():
    frame = view(hill(40, 50, 3000))
    assert found(frame, (40, 50, 45.0))["case"].tolist() == [5]
    assert len(found(frame, (40, 50, 45.1))) == 0
    spots = np.array([(40, 50, 45.1)])
    wide = Combination(
        lambda *_: spots, DBSCAN(3.0, 4), DBSCAN(3.0, 4), largest_px=200.0
    )
    assert wide(frame)["radius_px"].tolist() == [pytest.approx(45.1)]


def test_the_mean_grey_value_is_that_of_the_disc():
    image, (row, col) = np.arange(60 * 80).reshape(60, 80) % 999, np.indices((60, 80))
    discs = np.random.default_rng(2).uniform((-3, -3, 0), (63, 83, 9), (1200, 3))
    exact = image[tuple(np.rint(discs[:, :2]).astype(int).clip(0, [59, 79]).T)].astype(
        float
    )
    for k, (r, c, radius) in enumerate(discs):
        if (disc := (row - r) ** 2 + (col - c) ** 2 <= radius**2).any():
            exact[k] = image[disc].mean()
    for kind in (np.uint16, ">f4", np.float16):
        assert combination.mean_gray(image.astype(kind), discs) == pytest.approx(exact)


def test_in_pictures_alone_the_size_decides_and_the_stronger_of_two():
    row, col = np.ogrid[:100, :160]
    image = np.zeros((100, 160))
    for at, radius in ((30, 4), (110, 14)):
        image += 500 / (1 + np.exp(np.hypot(row - 50, col - at) - radius))
    view = View(
        image.astype(np.uint16), image, image.astype(np.float32), np.empty((0, 2)), None
    )
    assert {30, 110} <= set(Planar(DoG(10.0))(view)["col"].round())
    found = DETECTIONS.check(Planar(DoG(10.0), 8.0)(view, frame=3))
    assert (found["frame"].tolist(), found["col"].round().tolist()) == ([3], [30])
    assert found["z"].isna().all()
    assert Planar(Otsu())(view, [(0, 80), (0, 160), (100, 160), (100, 80)])[
        "col"
    ].tolist() == [110]
