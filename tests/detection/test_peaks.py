import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kilnflight.checks import InputError
from kilnflight.detection.peaks import Evidence, find_peaks, have_peaks


def hills(rows, cols, places, sigma=2.0):
    row, col = np.indices((rows, cols))
    return sum(
        top * np.exp(-((row - r) ** 2 + (col - c) ** 2) / (2 * sigma**2)) for r, c, top in places
    )


WHOLE = np.array([0, 40, 0, 60])
ROW, COL = np.indices((120, 160))
AREA = np.array([40, 61, 60, 81])


def test_hills_are_counted_highest_first():
    image = hills(40, 60, [(10, 12, 100.0), (25, 40, 50.0), (30, 15, 4.0)])
    peaks = find_peaks(image, WHOLE, 10.0)
    assert peaks[:, :2].tolist() == [[10, 12], [25, 40]]
    assert peaks[:, 2] == pytest.approx([100.0, 50.0], abs=0.1)


def test_a_shoulder_is_no_peak_and_a_shallow_saddle_joins_two():
    twins = hills(40, 60, [(20, 20, 100.0), (20, 25, 90.0)])
    deep = find_peaks(twins, WHOLE, 1.0)
    shallow = find_peaks(twins, WHOLE, 40.0)
    assert (len(deep), len(shallow)) == (2, 1)


def test_the_foot_of_something_outside_is_no_peak():
    slope = np.tile(np.arange(60.0), (40, 1))
    assert len(find_peaks(slope, WHOLE, 1.0)) == 0
    assert len(find_peaks(-slope, WHOLE, 1.0)) == 0


def test_areas_are_clipped_and_kept_apart():
    image = hills(40, 60, [(10, 12, 100.0), (25, 40, 50.0)])
    areas = np.array([[20, 99, 30, 99], [0, 2, 0, 2], [-5, 20, -5, 30], [-9, -3, -9, -3]])
    peaks = [find_peaks(image, area, 10.0)[:, :2].tolist() for area in areas]
    assert peaks == [[[25, 40]], [], [[10, 12]], []]
    assert have_peaks(image, areas, 10.0).tolist() == [True, False, True, False]


def test_a_flat_image_has_no_peaks_and_no_areas_have_none():
    assert find_peaks(np.full((40, 60), 65535, np.uint16), WHOLE, 1.0).shape == (0, 3)
    assert have_peaks(np.zeros((5, 5)), np.empty((0, 4), int), 1.0).shape == (0,)


@pytest.mark.parametrize("prominence", [0.0, -1.0, np.nan])
def test_a_prominence_must_be_positive(prominence):
    with pytest.raises(InputError, match="prominence"):
        find_peaks(np.zeros((5, 5)), WHOLE, prominence)


def test_shapes_are_checked():
    with pytest.raises(InputError, match="areas"):
        find_peaks(np.zeros((5, 5)), np.zeros(3, int), 1.0)
    with pytest.raises(InputError, match="areas"):
        have_peaks(np.zeros((5, 5)), np.zeros((2, 3), int), 1.0)
    with pytest.raises(InputError, match="axes"):
        find_peaks(np.zeros(5), WHOLE, 1.0)


def by_flooding(image, prominence):
    """Each pixel: lower the water until a higher pixel joins; by label at every level."""
    from scipy.ndimage import label

    peaks = {}
    around = np.ones((3, 3))
    for r, c in np.ndindex(image.shape):
        if r in (0, image.shape[0] - 1) or c in (0, image.shape[1] - 1):
            continue
        height = (image[r, c], -(r * image.shape[1] + c))
        edge = np.ones(image.shape, bool)
        edge[1:-1, 1:-1] = False
        best = image[r, c] - np.median(image[edge])
        for level in np.unique(image)[::-1]:
            if level > image[r, c]:
                continue
            parts, _ = label(image >= level, around)
            same = np.argwhere(parts == parts[r, c])
            if any((image[i, j], -(i * image.shape[1] + j)) > height for i, j in same):
                best = image[r, c] - level
                break
        if best >= prominence:
            peaks[r, c] = best
    return peaks


@settings(max_examples=40, deadline=None)
@given(arrays(np.int64, (6, 7), elements=st.integers(0, 6)), st.integers(1, 4))
def test_prominence_is_what_flooding_by_levels_gives(image, prominence):
    peaks = find_peaks(image, np.array([0, 6, 0, 7]), float(prominence))
    assert {(int(r), int(c)): h for r, c, h in peaks} == by_flooding(image, prominence)


def test_the_areas_that_have_peaks_are_those_in_which_peaks_are_found():
    rng = np.random.default_rng(4)
    image = rng.normal(0, 1, (60, 80))
    corner = rng.integers(-4, 70, (200, 2))
    size = rng.integers(1, 12, (200, 2))
    edges = np.stack([corner, corner + size], axis=2)
    areas = edges.reshape(200, 4)
    expected = np.array([len(find_peaks(image, area, 2.0)) > 0 for area in areas])
    assert 20 < expected.sum() < 180
    np.testing.assert_array_equal(have_peaks(image, areas, 2.0), expected)


@pytest.mark.parametrize("seed", range(40))
def test_areas_have_peaks_exactly_where_peaks_are_found_in_pictures_of_all_scales(seed):
    generator = np.random.default_rng(seed)
    shape = (60, 80) if seed % 4 else (180, 220)  # wider than the search around a pixel
    image = cv2.GaussianBlur(
        generator.normal(size=shape), (0, 0), shape[0] / 60 * generator.uniform(0.3, 4)
    )
    image = np.round(20 * image / image.std() / 5) if seed % 3 == 0 else image
    rows, cols = (np.sort(generator.integers(-3, n + 4, (30, 2)), axis=1) for n in shape)
    areas = np.hstack([rows, cols])
    prominence = max(float(image.std()), 0.1) * generator.uniform(0.3, 4)
    expected = [len(find_peaks(image, area, prominence)) > 0 for area in areas]
    assert have_peaks(image, areas, prominence).tolist() == expected


def hill(row, col, top, sigma=3.0):
    return top * np.exp(-((ROW - row) ** 2 + (COL - col) ** 2) / (2 * sigma**2))


def frames(now, before, seed=0, noise=20.0):
    generator = np.random.default_rng(seed)
    return tuple(
        np.clip(5000 + picture + noise * generator.normal(size=ROW.shape), 0, 65535).astype(
            np.uint16
        )
        for picture in (now, before)
    )


def evidence(now, before, seed=0):
    return Evidence.of(*frames(now, before, seed), prominence=5.0, share=0.1)


def test_the_noise_sets_the_threshold():
    noise = evidence(np.zeros(ROW.shape), np.zeros(ROW.shape))
    smoothed = 20.0 / (2 * np.sqrt(np.pi))  # white noise under a Gaussian of 1 px
    assert noise.threshold == pytest.approx(5 * smoothed, rel=0.05)
    assert noise.change_threshold == pytest.approx(5 * smoothed * np.sqrt(2), rel=0.05)


def test_noise_alone_is_hardly_ever_real():
    nothing = np.zeros(ROW.shape)
    assert sum(evidence(nothing, nothing, seed).real(AREA) for seed in range(20)) <= 1


@pytest.mark.parametrize("top", [600.0, -600.0])
def test_what_has_moved_is_real_bright_or_dark(top):
    assert evidence(hill(50, 70, top), hill(53, 70, top)).real(AREA)


def test_what_stays_is_not_real():
    assert not evidence(hill(50, 70, 600.0), hill(50, 70, 600.0)).real(AREA)


def test_brighter_light_moves_nothing():
    still = hill(50, 70, 600.0)
    assert not evidence(1.02 * (5000 + still) - 5000, still).real(AREA)


def test_peaks_are_counted_and_small_ones_beside_a_large_one_are_not():
    pair = evidence(hill(46, 66, 3000.0) + hill(55, 75, 2000.0), np.zeros(ROW.shape))
    assert pair.peaks(AREA)[:, :2].round().tolist() == [[46, 66], [55, 75]]
    small = evidence(hill(46, 66, 30_000.0) + hill(55, 76, 500.0), np.zeros(ROW.shape))
    assert len(small.peaks(AREA)) == 1
    assert evidence(np.zeros(ROW.shape), np.zeros(ROW.shape)).peaks(AREA).shape == (0, 3)


def test_a_constant_picture_has_no_evidence():
    flat = np.full((30, 40), 65535, np.uint16)
    constant = Evidence.of(flat, flat, 5.0, 0.1)
    assert not constant.real(np.array([5, 20, 5, 20]))
    assert not constant.real(np.array([-4, 3, 38, 55]))


def test_frames_of_two_sizes_are_refused():
    with pytest.raises(InputError, match="one size"):
        Evidence.of(np.zeros((4, 5)), np.zeros((4, 6)), 5.0, 0.1)


def test_a_frame_that_was_changed_in_place_is_looked_at_anew():
    generator = np.random.default_rng(3)
    first, frame = (generator.normal(1000, 5, (80, 90)).astype(np.uint16) for _ in range(2))
    Evidence.of(frame, first, 5.0, 0.5)
    frame[30:40, 30:40] += 500
    changed = Evidence.of(frame, first, 5.0, 0.5)
    again = Evidence.of(frame.copy(), first.copy(), 5.0, 0.5)
    np.testing.assert_array_equal(changed.gray, again.gray)
    np.testing.assert_array_equal(changed.change, again.change)


def test_of_frames_that_cannot_change_evidence_is_the_same():
    generator = np.random.default_rng(4)
    frames = [generator.normal(1000, 5, (80, 90)).astype(np.uint16) for _ in range(3)]
    kept = [frame.copy() for frame in frames]
    for frame in kept:
        frame.flags.writeable = False
    for k in (1, 2):
        plain, of_kept = (Evidence.of(each[k], each[k - 1], 5.0, 0.5) for each in (frames, kept))
        np.testing.assert_array_equal(plain.change, of_kept.change)
        assert plain.threshold == of_kept.threshold
