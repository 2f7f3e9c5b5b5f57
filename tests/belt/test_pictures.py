"""Pictures of particles, and the spots that are measured in them."""

from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from kilnflight.belt.camera import BELT, Area, Calibration
from kilnflight.belt.pictures import MeasureSpots, Spots, average, measure_spots
from kilnflight.checks import InputError
from kilnflight.sorter.bulk import BULKS
from kilnflight.sorter.rendering import CameraView, Pictures, at_rate
from kilnflight.tables import BELT_SPOTS, BELT_TRACKS

LEVEL = CameraView(turned_deg=0.0, tilted_deg=0.0)


def one_track(x=500.0, y=90.0, frames=3, step=5):
    frame = step * np.arange(frames)
    columns = {"frame": frame, "particle": 0, "time_s": frame / 1000.0, "x": x, "y": y}
    return pd.DataFrame(columns)[BELT_TRACKS.names]


def test_a_level_camera_has_the_scale_of_the_paper():
    corners = LEVEL.pixels(np.column_stack([BELT.corners, np.zeros(4)]))
    np.testing.assert_allclose(corners[1] - corners[0], [0.0, 400 / 0.44])
    np.testing.assert_allclose(corners[3] - corners[0], [180 / 0.44, 0.0])
    np.testing.assert_allclose(corners.mean(axis=0), [353.5, 531.5])


def test_the_whole_belt_is_in_view_whatever_the_mounting():
    for turn, tilt in [(0.3, 0.3), (-1.0, 1.0)]:
        view = CameraView(turned_deg=turn, tilted_deg=tilt)
        corners = view.pixels(np.column_stack([BELT.corners, np.zeros(4)]))
        assert ((corners > 10) & (corners < [698, 1054])).all()
        middle = view.pixels(np.array([[588.0, 90.0, 0.0]]))
        np.testing.assert_allclose(middle, [[353.5, 531.5]], atol=1e-9)


@settings(deadline=None)
@given(st.floats(-180, 180), st.floats(-80, 80), st.floats(0.1, 5.0))
def test_what_is_higher_is_seen_farther_from_the_middle(dx, dy, z):
    flat, high = LEVEL.pixels(np.array([[588 + dx, 90 + dy, 0.0], [588 + dx, 90 + dy, z]]))
    middle = np.array([353.5, 531.5])
    np.testing.assert_allclose(high - middle, (flat - middle) * 1000 / (1000 - z), atol=1e-9)


@pytest.mark.parametrize("name", BULKS)
def test_a_particle_has_its_area_and_its_place(name):
    bulk = BULKS[name]
    tracks = one_track(x=520.3, y=60.7).assign(angle_rad=0.6)
    pictures = Pictures(tracks, bulk, 0, LEVEL, belt_gray=0.0, noise_gray=0.0)
    empty = Pictures(one_track(x=10.0), bulk, 0, LEVEL, belt_gray=0.0, noise_gray=0.0)
    window = np.s_[240:340, 330:430]
    share = (pictures[0].astype(float) - empty[0])[window] / 200.0
    flat = {"spheres": np.pi * 2.5**2, "cuboids": 6.0 * 5.0, "cylinders": 9.0 * 3.0}[name]
    assert share.sum() * 0.44**2 == pytest.approx(flat, rel=0.02)
    rows, cols = np.mgrid[window]
    place = [(share * rows).sum() / share.sum(), (share * cols).sum() / share.sum()]
    expected = LEVEL.pixels(np.array([[520.3, 60.7, bulk.rest_mm]]))[0]
    np.testing.assert_allclose(place, expected, atol=0.1)


def test_a_cylinder_lies_in_its_direction():
    for angle in (0.0, np.pi / 2):
        tracks = one_track().assign(angle_rad=angle)
        picture = Pictures(tracks, BULKS["cylinders"], 0, LEVEL, noise_gray=0.0)[0] > 150
        rows, cols = np.nonzero(picture[150:560, 80:980])
        assert (np.ptp(cols) > np.ptp(rows)) == (angle == 0.0)


def test_an_exposure_is_the_mean_of_its_moments():
    """A particle at 1500 mm/s along and -90 mm/s across the belt, for 1 ms."""
    quiet = {"view": LEVEL, "noise_gray": 0.0}
    tracks = one_track(x=[500.0, 507.5], y=[60.0, 59.55], frames=2).assign(angle_rad=0.4)
    blurred = Pictures(tracks, BULKS["cuboids"], 0, **quiet)[0]
    moments = []
    for late_s in (np.arange(40) + 0.5) / 40e3 - 0.0005:
        shifted = tracks.assign(x=tracks["x"] + 1500 * late_s, y=tracks["y"] - 90 * late_s)
        moments.append(Pictures(shifted, BULKS["cuboids"], 0, exposure_s=0.0, **quiet)[0])
    assert np.abs(np.mean(moments, axis=0) - blurred).max() < 12  # of 140 grey values
    assert np.abs(moments[20] - blurred.astype(float)).max() > 40


def test_frames_do_not_depend_on_which_others_are_asked_for():
    pictures = Pictures(one_track(frames=4), BULKS["spheres"], 3)
    assert len(pictures) == 4
    assert len(Pictures(BELT_TRACKS.empty(), BULKS["spheres"], 3)) == 0
    backwards = list(pictures.frames([2, 0]))
    np.testing.assert_array_equal(backwards[0], pictures[2])
    np.testing.assert_array_equal(backwards[1], pictures[0])
    assert (pictures[0] != pictures[2]).any()
    other = Pictures(one_track(frames=4), BULKS["spheres"], 4)
    assert (pictures[0] != other[0]).any()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 20), st.sampled_from([200.0, 100.0, 500.0]))
def test_thinning_keeps_times(first, rate):
    frame = first + np.arange(60)
    table = pd.DataFrame(
        {"frame": frame, "particle": 1, "time_s": frame / 1000, "x": 1.0, "y": 2.0}
    )
    slow = at_rate(table, rate)
    np.testing.assert_allclose(slow["time_s"], slow["frame"] / rate)
    assert (slow["frame"].diff().dropna() == 1).all()


def test_every_tenth_frame_stays_with_its_time():
    tracks = one_track(frames=28, step=1)
    late = tracks.assign(frame=tracks["frame"] + 7, time_s=tracks["time_s"] + 0.007)
    less = at_rate(late, 100.0)
    assert less["frame"].tolist() == [1, 2, 3]
    assert less["time_s"].tolist() == pytest.approx([0.01, 0.02, 0.03])
    pd.testing.assert_frame_equal(at_rate(late, 1000.0), late)


def test_what_cannot_be_drawn_is_told():
    slow = one_track(frames=10, step=10)  # 100 Hz
    with pytest.raises(InputError, match="at_rate: frames_per_s"):
        at_rate(slow, 0.0)
    with pytest.raises(InputError, match="no rows 200 times a second"):
        at_rate(slow, 200.0)
    with pytest.raises(InputError, match="not beyond"):
        Area(start_mm=10.0, end_mm=5.0)


@pytest.mark.parametrize("noise_gray", [0.0, 3.0, 400.0])
def test_gray_values_are_rounded_and_cut_off_at_eight_bits(noise_gray):
    pictures = Pictures(BELT_TRACKS.empty(), BULKS["spheres"], 0, noise_gray=noise_gray)
    picture, plain = pictures[0], pictures._empty()  # before noise and rounding
    noise = np.random.default_rng([0, 1, 0]).standard_normal(plain.shape, dtype=np.float32)
    expected = np.clip(np.rint(plain + np.float32(noise_gray) * noise), 0, 255)
    assert picture.dtype == np.uint8
    np.testing.assert_array_equal(picture, expected)
    assert ((picture == 0).mean() > 0.3) == ((picture == 255).mean() > 0.2) == (noise_gray > 3)


EMPTY = np.full((120, 160), 60, dtype=np.uint8)
# Two pixels per mm; the belt's first corner is pixel (0, 0).
HALF = Calibration(np.array([[0.5, 0, 388.0], [0, 0.5, 0], [0, 0, 1]]), 0.0, 0.5, 0)


def with_discs(*places, radius=5):
    picture = EMPTY.copy()
    for row, col in places:
        cv2.circle(picture, (col, row), radius, 200, -1)
    return picture


def test_the_background_is_the_mean():
    pictures = [EMPTY, EMPTY + 10, EMPTY + 20]
    assert (average(pictures) == 70).all()
    with pytest.raises(InputError, match="at least one"):
        average([])
    with pytest.raises(InputError, match="picture 1"):
        average([EMPTY, EMPTY[1:]])


def test_centroids_of_discs_are_their_centres():
    measured = Spots()(with_discs((30, 40), (80, 100)), EMPTY)
    np.testing.assert_allclose(measured[:, :2], [[30, 40], [80, 100]])
    assert (measured[:, 2] == measured[0, 2]).all()


def test_particles_that_touch_are_one_spot_and_marked():
    apart, touching = with_discs((30, 40), (80, 100)), with_discs((30, 40), (38, 46), (80, 100))
    spots = Spots().calibrated([apart], EMPTY)
    assert spots(apart, EMPTY)[:, 3].tolist() == [0, 0]
    measured = spots(touching, EMPTY)
    assert measured[:, 3].tolist() == [1, 0]
    np.testing.assert_allclose(measured[0, :2], [34, 43], atol=0.1)  # their common centroid
    assert Spots()(touching, EMPTY)[:, 3].tolist() == [0, 0]  # not calibrated: marks none


CHAINS = [
    [(30, 40), (38, 46)],
    [(30, 40), (38, 46), (30, 52)],
    [(40, 30), (40, 40), (40, 50), (50, 50)],
]


@pytest.mark.parametrize("centres", CHAINS)
def test_a_spot_of_several_is_split_at_the_centres(centres):
    alone, touching = with_discs((80, 100)), with_discs(*centres, (80, 100))
    spots = Spots(split=True).calibrated([alone], EMPTY)
    np.testing.assert_array_equal(spots(alone, EMPTY), replace(spots, split=False)(alone, EMPTY))
    measured = spots(touching, EMPTY)
    assert measured[:, 3].tolist() == [0] + [1] * len(centres)
    parts = measured[1:][np.lexsort(measured[1:, 1::-1].T)]
    np.testing.assert_allclose(parts[:, :2], sorted(centres), atol=0.5)
    whole = replace(spots, split=False)(touching, EMPTY)[:, 2].max()
    assert parts[:, 2].sum() == whole
    np.testing.assert_array_equal(spots(touching, EMPTY), measured)  # no chance in it
    assert len(Spots(split=True)(touching, EMPTY)) == 2  # not calibrated: splits none


@settings(max_examples=20, deadline=None)
@given(st.floats(0, np.pi), st.floats(0, 5), st.floats(0, 5))
def test_rectangles_side_by_side_are_split_where_no_neck_is(angle, right, down):
    """Two of 14 x 12 px that share a long side: the outline is one rectangle."""
    picture, place = EMPTY.copy(), np.array([80 + right, 60 + down])
    across = 6.0 * np.array([-np.sin(angle), np.cos(angle)])
    for size, middle in (((14, 24), place), ((14, 12), np.array([20, 20]))):
        box = cv2.boxPoints((tuple(middle.tolist()), size, np.degrees(angle)))
        cv2.fillPoly(picture, [np.rint(16 * box).astype(np.int32)], 200, shift=4)
    spots = replace(Spots(split=True), single_px=Spots()(picture, EMPTY)[:, 2].min())
    parts = spots(picture, EMPTY)
    parts = parts[parts[:, 3] == 1, 1::-1]
    expected = np.array([place - across, place + across])
    away = np.hypot(*(parts[:, None] - expected).transpose(2, 0, 1))
    assert away.shape == (2, 2)
    assert (
        np.diag(away if away[0, 0] < away[0, 1] else away[::-1]).max() < 1.5
    )  # the outline is rounded to pixels


def test_what_is_much_larger_than_particles_is_left_whole():
    hand = with_discs((60, 80), radius=40)
    spots = replace(Spots(split=True), single_px=80.0)
    assert spots(hand, EMPTY)[:, 3].tolist() == [1]
    np.testing.assert_allclose(spots(hand, EMPTY)[:, :2], [[60, 80]])


def test_a_calibration_of_another_camera_shows_no_belt():
    with pytest.raises(InputError, match="shows nothing of the belt"):
        MeasureSpots(EMPTY[:2, :2], Spots(), replace_start(HALF, 5000.0))


def replace_start(calibration, start):
    matrix = calibration.matrix.copy()
    matrix[0, 2] -= start
    return calibration._replace(matrix=matrix)


def test_an_empty_belt_has_no_spots():
    assert Spots()(EMPTY, EMPTY).shape == (0, 4)
    table = measure_spots([EMPTY, EMPTY], EMPTY, Spots(), HALF)
    assert table.columns.tolist() == BELT_SPOTS.names
    assert len(BELT_SPOTS.check(table)) == 0
    assert len(measure_spots([], EMPTY, Spots(), HALF)) == 0
    with pytest.raises(InputError, match="no particle in the pictures"):
        Spots().calibrated([EMPTY], EMPTY)


def test_a_particle_that_rests_in_all_pictures_is_background():
    still = [with_discs((30, 40), (80, 20 + 30 * k)) for k in range(4)]
    measured = measure_spots(still, average(still), Spots(), HALF)
    assert not ((measured["row"] - 30).abs() < 3).any()


@pytest.mark.parametrize(
    ("share", "lying", "ghost"), [(0.2, True, False), (0.5, True, True), (0.9, False, True)]
)
def test_a_particle_that_rests_for_a_while_is_found_or_leaves_a_ghost(share, lying, ghost):
    """The contrast is 140, the threshold 40 grey values."""
    rests = round(20 * share)
    pictures = [with_discs((30, 40))] * rests + [EMPTY] * (20 - rests)
    measured = measure_spots(pictures, average(pictures), Spots(), HALF)
    before = list(range(rests)) if lying else []
    after = list(range(rests, 20)) if ghost else []
    assert measured["frame"].tolist() == before + after
    np.testing.assert_allclose(measured[["row", "col"]], [[30, 40]] * len(measured), atol=0.1)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_spots_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    places = rng.integers(0, [120, 160], (rng.integers(0, 12), 2))
    picture = with_discs(*places.tolist(), radius=int(rng.integers(1, 8)))
    labels, count = ndimage.label(picture != EMPTY, np.ones((3, 3)))
    index = np.arange(1, count + 1)
    area = ndimage.sum_labels(labels > 0, labels, index)
    centres = np.array(ndimage.center_of_mass(labels > 0, labels, index)).reshape(-1, 2)
    expected = np.column_stack([centres, area])[area >= 12]
    measured = Spots()(picture, EMPTY)[:, :3]
    order, other = np.lexsort(measured.T), np.lexsort(expected.T)
    np.testing.assert_allclose(measured[order], expected[other])


def test_places_are_millimetres_and_outside_is_left_out():
    pictures = [with_discs((30, 40)), EMPTY, with_discs((30, 40), (90, 140))]
    table = BELT_SPOTS.check(measure_spots(pictures, EMPTY, Spots(), HALF, BELT))
    assert table["frame"].tolist() == [0, 2, 2]
    np.testing.assert_allclose(table[["x", "y"]].iloc[2], [388 + 70, 45])
    narrow = replace(BELT, end_mm=428.0)
    assert measure_spots(pictures, EMPTY, Spots(), HALF, narrow)["frame"].tolist() == [0, 2]


def test_cutting_the_picture_changes_nothing():
    rng = np.random.default_rng(0)
    pictures = [with_discs(*rng.integers(0, [120, 160], (6, 2)).tolist()) for _ in range(5)]
    area = replace(BELT, end_mm=430.0, width_mm=40.0)
    cut = measure_spots(pictures, EMPTY, Spots(), HALF, area)
    whole = measure_spots(pictures, EMPTY, Spots(), HALF, BELT)
    inside = whole[area.contains(whole[["x", "y"]].to_numpy())].reset_index(drop=True)
    np.testing.assert_allclose(cut.sort_values(["frame", "x"]), inside.sort_values(["frame", "x"]))


def test_pictures_that_do_not_fit_are_told():
    with pytest.raises(InputError, match="must be"):
        Spots()(EMPTY[1:], EMPTY)
    with pytest.raises(InputError, match="frame 1"):
        measure_spots([EMPTY, EMPTY[1:]], EMPTY, Spots(), HALF)
    for wrong in ({"threshold": 0}, {"least_px": 0}, {"touching_from": 0.5}, {"single_px": -1}):
        with pytest.raises(InputError, match=f"Spots: {next(iter(wrong))}"):
            Spots(**wrong)


@pytest.mark.parametrize("wrong", [None, [[1, 2]], "a.png", np.zeros((4, 4, 3), np.uint8)])
def test_what_is_no_picture_is_refused(wrong):
    right = np.zeros((4, 4), np.uint8)
    with pytest.raises(InputError, match=r"picture 1: .*uint8"):
        average([right, wrong])
    for pair in ((wrong, right), (right, wrong)):
        with pytest.raises(InputError, match="uint8"):
            Spots()(*pair)
    for threshold in (255.0, 300.0):
        with pytest.raises(InputError, match="Spots: threshold"):
            Spots(threshold=threshold)


def plainly_drawn(picture, outline, soft_px, gray):
    """The plain definition of a particle: mean over its places, distance to a round rectangle."""
    row, col, angle, length, width, corner, down, ahead = outline.tolist()
    count = max(1, int(np.ceil(np.hypot(down, ahead))))
    moved = ((np.arange(count) + 0.5) / count - 0.5)[:, None, None]
    below, right = np.ogrid[: picture.shape[0], : picture.shape[1]]
    below = (below - row - down * moved).astype(np.float32)
    right = (right - col - ahead * moved).astype(np.float32)
    c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    u = np.abs(right * c + below * s) - (length - corner)
    v = np.abs(below * c - right * s) - (width - corner)
    outside = np.hypot(np.maximum(u, 0.0), np.maximum(v, 0.0))
    distance = outside + np.minimum(np.maximum(u, v), 0.0) - corner
    share = (0.5 - distance / soft_px).clip(0.0, 1.0).mean(axis=0).clip(0.0, 1.0)
    picture += share * (gray - picture.astype(np.float64))


@pytest.mark.parametrize("name", BULKS)
def test_particles_are_drawn_as_the_plain_definition_has_it_to_the_bit(name):
    rng = np.random.default_rng(3)
    number = np.arange(12)
    places = {"x": rng.uniform(395, 780, 12), "y": rng.uniform(5, 175, 12)}
    turned = {"angle_rad": rng.uniform(0, np.pi, 12)}
    now = pd.DataFrame({"frame": 0, "particle": number, "time_s": 0.0} | places | turned)
    ahead = {"x": now["x"] + 7.0, "y": now["y"] + rng.normal(0, 0.45, 12)}
    later = now.assign(frame=1, time_s=0.005, **ahead)
    pictures = Pictures(pd.concat([now, later], ignore_index=True), BULKS[name], 4)
    visible = at_rate(pictures.tracks, 200.0)
    outlines = pictures._outlines(visible)[(visible["frame"] == 0).to_numpy()]
    drawn = pictures._empty()
    plain = drawn.copy()
    pictures._draw(drawn, outlines)
    for outline in outlines:
        plainly_drawn(plain, outline, pictures.soft_px, pictures.particle_gray)
    np.testing.assert_array_equal(drawn, plain)
    noise = np.random.default_rng([4, 1, 0]).standard_normal(plain.shape, dtype=np.float32)
    plain += noise * np.float32(3.0)
    np.testing.assert_array_equal(pictures[0], np.rint(plain).clip(0, 255).astype(np.uint8))
