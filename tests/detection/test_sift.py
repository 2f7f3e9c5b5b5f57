"""DoG on blobs of known size, against its plain definition, OpenCV and itself."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from kilnflight.camera import inside
from kilnflight.checks import InputError
from kilnflight.detection import DoG, sift

_spec = importlib.util.spec_from_file_location(
    "plain_sift", Path(__file__).parent / "plain_sift.py"
)
plain_sift = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(plain_sift)

CORNER = st.tuples(st.floats(-40.0, 220.0), st.floats(-40.0, 280.0))


@pytest.mark.parametrize("sigma", [2.5, 3.0, 4.5, 8.0, 13.0])
@pytest.mark.parametrize("place", [(100.0, 120.0), (100.5, 120.5), (100.3, 120.8)])
def test_a_gaussian_blob_gives_its_place_and_size(sigma, place):
    rows, cols = np.ogrid[:200, :240]
    far = (rows - place[0]) ** 2 + (cols - place[1]) ** 2
    particles = DoG()(30_000 * np.exp(-far / (2 * sigma**2)))
    assert len(particles) == 1
    np.testing.assert_allclose(particles[0, :2], place, atol=0.06 * sigma / 2)
    np.testing.assert_allclose(particles[0, 2], np.sqrt(2) * sigma, rtol=0.06)


def test_a_tiny_blob_needs_the_image_at_twice_its_size():
    rows, cols = np.ogrid[:64, :64]
    tiny = 30_000 * np.exp(-((rows - 30) ** 2 + (cols - 33) ** 2) / (2 * 1.4**2))
    assert len(DoG()(tiny)) == 0
    np.testing.assert_allclose(doubled(tiny, DoG()), [[30, 33, np.sqrt(2) * 1.4]], atol=0.1)


@pytest.mark.parametrize("radius", [4.0, 7.0, 12.0, 20.0])
def test_a_disc_gives_its_radius(radius):
    rows, cols = np.ogrid[:1600, :1600]
    fine = (rows - 800) ** 2 + (cols - 800) ** 2 <= (10 * radius) ** 2
    image = 30_000.0 * fine.reshape(160, 10, 160, 10).mean(axis=(1, 3))
    particles = DoG()(gaussian_filter(image, 0.4))
    np.testing.assert_allclose(particles[0, :2], 79.5, atol=0.1)
    np.testing.assert_allclose(particles[0, 2], radius, rtol=0.05)


def test_a_dark_blob_is_no_particle():
    rows, cols = np.ogrid[:100, :100]
    hole = 30_000 * (1 - np.exp(-((rows - 40) ** 2 + (cols - 60) ** 2) / 50.0))
    assert len(DoG()(hole)) == 0
    np.testing.assert_allclose(DoG()(-hole)[:, :2], [[40, 60]], atol=0.05)


def test_an_edge_is_no_particle():
    image = np.zeros((120, 120))
    image[:, 58:62] = 30_000
    assert len(DoG()(image)) == 0
    image[58:62, :58] = image[58:62, 62:] = 0
    assert len(DoG(edge=1e9)(image)) >= len(DoG()(image))


def test_a_saturated_plateau_is_one_particle():
    rows, cols = np.ogrid[:200, :200]
    image = np.where((rows - 90) ** 2 + (cols - 110) ** 2 <= 30**2, 65535, 0).astype(np.uint16)
    particles = DoG()(image)
    np.testing.assert_allclose(particles, [[90, 110, 30]], atol=0.6)


def test_of_equal_samples_one_is_taken():
    """Two pixels that mirror each other answer alike; the blob is still one particle."""
    image = np.zeros((64, 64), dtype=np.uint16)
    image[28:36, 28:36] = 50_000
    np.testing.assert_allclose(DoG()(image)[:, :2], [[31.5, 31.5]], atol=0.1)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"threshold": -1.0}, "threshold"),
        ({"threshold": float("nan")}, "threshold"),
        ({"layers": 0}, "layers"),
        ({"layers": 2.5}, "layers"),
        ({"sigma": 0.0}, "sigma"),
        ({"edge": 0.5}, "edge"),
        ({"camera_blur": 2.0}, "camera_blur"),
    ],
)
def test_parameters_without_meaning_are_refused(parameters, message):
    with pytest.raises(InputError, match=message):
        DoG(**parameters)


def scene(seed, shape=(150, 210), blobs=14, noise=70.0):
    """A foreground of noise and Gaussian blobs, and the blobs: row, col, standard deviation."""
    generator = np.random.default_rng(seed)
    image = np.abs(generator.normal(0, noise, shape))
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    truth = []
    for _ in range(blobs):
        row, col = generator.uniform(0, shape[0]), generator.uniform(0, shape[1])
        sigma, height = generator.uniform(1, 12), 10 ** generator.uniform(2.8, 4.6)
        image += height * np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / (2 * sigma**2))
        truth.append((row, col, sigma))
    return image.clip(0, 65535).round().astype(np.uint16), np.array(truth)


def ordered(points):
    return points[np.lexsort(points.T)]


def assert_same(actual, expected, atol):
    assert len(actual) == len(expected)
    if len(actual) == 0:
        return
    near = np.abs(actual[:, None] - expected[None]).max(axis=2)
    assert (near.min(axis=1) < atol).all()
    assert (near.min(axis=0) < atol).all()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("detector", [DoG(), DoG(60.0), DoG(60.0, layers=2, camera_blur=1.0)])
def test_it_is_the_plain_definition(seed, detector):
    shape = [(150, 210), (37, 90), (64, 64), (129, 33), (9, 8), (200, 31)][seed]
    image, _ = scene(seed, shape)
    expected = plain_sift.keypoints(image, detector)
    assert len(expected) > 0 or min(shape) < 10
    assert_same(detector(image), expected, 1e-3)


def test_it_is_the_plain_definition_on_a_frame_of_the_twin(frame):
    for detector in (DoG(), DoG(200.0, camera_blur=1.0)):
        assert_same(detector(frame), plain_sift.keypoints(frame, detector), 1e-3)


@pytest.fixture(scope="module")
def frame(kept_scene):
    """A part of a foreground of the twin."""
    rows, cols = slice(300, 1000), slice(600, 1400)
    twin = kept_scene("V4")
    frames = np.stack([twin.frame(i).gray[rows, cols] for i in (60, 75, 90)])
    return np.abs(frames[1] - np.median(frames, axis=0))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([20.0, 100.0, 500.0]))
def test_what_is_left_out_changes_nothing(seed, threshold):
    """Bit for bit: with and without the bound that spares a block."""
    detector = DoG(threshold)
    image, _ = scene(seed, (90, 120), blobs=5)
    particles = detector(image)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sift, "reachable", everywhere)
        np.testing.assert_array_equal(detector(image), particles)


def everywhere(image, sigmas, level):
    blocks = [-(-n // sift.BLOCK) for n in image.shape]
    return np.ones(blocks, dtype=np.bool_)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.lists(st.floats(60.0, 3000.0), min_size=1))
def test_one_call_answers_for_every_higher_threshold(seed, thresholds):
    """Bit for bit, and in the same order."""
    lowest = DoG(min(thresholds))
    image, _ = scene(seed, (90, 120), blobs=5)
    every = lowest.graded(image)
    for threshold in thresholds:
        kept = every[every[:, 3] >= threshold, :3]
        np.testing.assert_array_equal(kept, replace(lowest, threshold=threshold)(image))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.lists(CORNER, min_size=3, max_size=7, unique=True))
def test_all_particles_in_a_polygon_are_found_and_no_others_invented(seed, polygon):
    assume(np.linalg.matrix_rank(np.subtract(polygon, polygon[0])) == 2)
    detector = DoG(60.0)
    image, _ = scene(seed, (180, 240), blobs=5)
    all_particles, particles = detector(image), detector(image, polygon)
    rows = {tuple(particle) for particle in all_particles}
    assert {tuple(particle) for particle in particles} <= rows
    within = all_particles[inside(polygon, *all_particles[:, :2].T)]
    assert {tuple(particle) for particle in within} <= {tuple(particle) for particle in particles}


def test_blobs_far_from_the_polygon_are_skipped():
    image = np.zeros((300, 400))
    image[46:55, 56:65], image[246:255, 336:345] = 60_000.0, 60_000.0
    particles = DoG(200.0)(image, [(30, 30), (30, 90), (90, 90), (90, 30)])
    assert len(DoG(200.0)(image)) == 2 * len(particles) > 0
    assert particles[:, 0].max() < 100


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([0.25, 0.5, 2.0, 8.0]))
def test_foreground_and_threshold_scale_together(seed, factor):
    image = scene(seed, (90, 120))[0].astype(np.float64)
    scaled = DoG(200 * factor)(image * factor)
    np.testing.assert_array_equal(scaled, DoG(200.0)(image))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_a_higher_threshold_keeps_a_part(seed):
    image, _ = scene(seed, (90, 120))
    low, high = (ordered(DoG(t)(image)) for t in (100.0, 200.0))
    assert {tuple(p) for p in high} <= {tuple(p) for p in low}


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_foreground_has_mirrored_particles(axis):
    image, _ = scene(5, (129, 193))  # 2^n + 1: the octaves keep the same pixels
    particles, other = DoG()(image), DoG()(np.flip(image, axis))
    other[:, axis] = image.shape[axis] - 1 - other[:, axis]
    assert_same(other, particles, 1e-3)


def doubled(image, detector):
    """Keypoints of an image at twice its size, as Lowe and OpenCV begin."""
    size = 2 * np.array(image.shape[::-1]) - 1
    half = np.array([[0.5, 0, 0], [0, 0.5, 0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    fine = cv2.warpAffine(image.astype(np.float32), half, size.tolist(), flags=flags)
    return replace(detector, camera_blur=2 * detector.camera_blur)(fine) / 2


def opencv(image, threshold):
    """OpenCV's SIFT at the same threshold: it divides by layers and by 255."""
    gain = 65535 / 255
    sift = cv2.SIFT_create(
        contrastThreshold=3 * threshold / gain / 255, enable_precise_upscale=True
    )
    keypoints = sift.detect(np.rint(image / gain).astype(np.uint8))
    points = np.array([[p.pt[1], p.pt[0], p.size / 2] for p in keypoints]).reshape(-1, 3)
    return np.unique(points, axis=0)  # one per place, not one per orientation


def test_opencv_finds_the_same_blobs_at_the_same_scale():
    rows, cols = np.ogrid[:256, :320]
    truth = [(60.0, 70.3, 3.0), (60.4, 200.0, 5.0), (180.2, 80.6, 8.0), (170.0, 230.0, 12.0)]
    image = sum(
        50_000 * np.exp(-((rows - r) ** 2 + (cols - c) ** 2) / (2 * s**2)) for r, c, s in truth
    )
    ours, peer = doubled(image, DoG()) / [1, 1, sift.disc_radius(3)], opencv(image, 500.0)
    assert len(ours) == 4
    for points in (ours, peer):  # OpenCV has a blob between four pixels twice
        nearest = np.abs(points[:, None, :2] - np.array(truth)[None, :, :2]).max(axis=2)
        assert set(nearest.argmin(axis=1)) == {0, 1, 2, 3}
        assert (nearest.min(axis=1) < 0.1).all()
    same = np.abs(ours[None, :, :2] - peer[:, None, :2]).max(axis=2)
    assert (same.min(axis=1) < 0.05).all()
    np.testing.assert_allclose(ours[same.argmin(axis=1), 2], peer[:, 2], rtol=0.03)


def test_opencv_finds_the_same_on_a_frame_in_8_bits(frame):
    """OpenCV's keypoints are ours; it drops some whose fit swings between two samples."""
    eight = np.rint(frame / 257) * 257
    ours = np.concatenate([doubled(eight, DoG()), doubled(-eight, DoG())])
    peer = opencv(eight, 500.0)
    assert len(ours) > 20
    inside = [
        p[(p[:, :2] > 10).all(axis=1) & (p[:, 0] < 690) & (p[:, 1] < 790)] for p in (ours, peer)
    ]
    apart = np.hypot(*(inside[0][:, None, :2] - inside[1][None, :, :2]).transpose(2, 0, 1))
    assert (apart.min(axis=0) < 1.0).mean() > 0.95
    assert (apart.min(axis=1) < 1.0).mean() > 0.8
    assert np.median(apart.min(axis=0)) < 1e-3


def test_8_bits_lose_what_16_bits_show():
    """Blobs of 120 to 1200 grey values: 8 bits are steps of 257 and begin to see at 129."""
    rows, cols = np.ogrid[:128, :640]
    image = sum(
        height * np.exp(-((rows - 60) ** 2 + (cols - 64 - 128 * n) ** 2) / (2 * 4.0**2))
        for n, height in enumerate([120, 250, 400, 800, 1200])
    )
    eight = np.rint(image / 257) * 257
    fine, coarse = DoG(10.0)(image), DoG(10.0)(eight)
    np.testing.assert_allclose(np.sort(fine[:, 1]), [64, 192, 320, 448, 576], atol=0.01)
    np.testing.assert_allclose(fine[:, 2], np.sqrt(2) * 4, rtol=0.02)
    assert not (np.abs(coarse[:, 1] - 64) < 10).any()
    assert not (np.abs(opencv(image, 10.0)[:, 1] - 64) < 10).any()


def test_a_threshold_of_zero_takes_every_maximum():
    image, _ = scene(2, (60, 70))
    assert_same(DoG(0.0)(image), plain_sift.keypoints(image, DoG(0.0)), 5e-3)
