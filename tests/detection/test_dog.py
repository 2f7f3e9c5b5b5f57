import importlib.util
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from kilnflight.checks import InputError
from kilnflight.detection import DoG, dog, scale_space
from kilnflight.twin.scenes import open_scene

_spec = importlib.util.spec_from_file_location("plain_dog", Path(__file__).parent / "plain_dog.py")
plain_dog = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(plain_dog)

BOTH = DoG(double=True, dark=True)


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


def assert_same(found, expected, atol):
    assert len(found) == len(expected)
    near = np.abs(found[:, None] - expected[None]).max(axis=2)
    assert (near.min(axis=1) < atol).all()
    assert (near.min(axis=0) < atol).all()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("detector", [DoG(), DoG(60.0), replace(BOTH, threshold=60.0, layers=2)])
def test_it_is_the_plain_definition(seed, detector):
    shape = [(150, 210), (37, 90), (64, 64), (129, 33), (9, 8), (200, 31)][seed]
    image, _ = scene(seed, shape)
    expected = plain_dog.keypoints(image, detector)
    assert len(expected) > 0 or min(shape) < 10
    assert_same(detector(image), expected, 1e-3)


def test_it_is_the_plain_definition_on_a_frame_of_the_twin():
    frame = foreground_of_the_twin()
    for detector in (DoG(), replace(BOTH, threshold=200.0)):
        assert_same(detector(frame), plain_dog.keypoints(frame, detector), 1e-3)


def foreground_of_the_twin(rows=slice(500, 1000), cols=slice(700, 1300)):
    twin = open_scene("V1")
    frames = np.stack([twin.frame(i).gray[rows, cols] for i in (70, 75, 80, 85, 90)])
    return np.abs(frames[1] - np.median(frames, axis=0))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([20.0, 100.0, 500.0]), st.booleans())
def test_what_is_left_out_changes_nothing(seed, threshold, double):
    """Bit for bit: with and without the bound that spares a block."""
    detector = DoG(threshold, double=double, dark=True)
    image, _ = scene(seed, (90, 120), blobs=5)
    found = detector(image)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scale_space, "reachable", everywhere)
        np.testing.assert_array_equal(detector(image), found)


def everywhere(image, taps, level, sign):
    blocks = [-(-n // scale_space.BLOCK) for n in image.shape]
    return np.ones(blocks, dtype=np.bool_)


@pytest.mark.parametrize("sigma", [2.0, 3.0, 4.5, 8.0, 13.0])
@pytest.mark.parametrize("place", [(100.0, 120.0), (100.5, 120.5), (100.3, 120.8)])
def test_a_gaussian_blob_gives_its_place_and_size(sigma, place):
    rows, cols = np.ogrid[:200, :240]
    far = (rows - place[0]) ** 2 + (cols - place[1]) ** 2
    found = DoG()(30_000 * np.exp(-far / (2 * sigma**2)))
    assert len(found) == 1
    np.testing.assert_allclose(found[0, :2], place, atol=0.06 * sigma / 2)
    np.testing.assert_allclose(found[0, 2], np.sqrt(2) * sigma, rtol=0.06)


@pytest.mark.parametrize("radius", [4.0, 7.0, 12.0, 20.0])
def test_a_disc_gives_its_radius(radius):
    rows, cols = np.ogrid[:1600, :1600]
    fine = (rows - 800) ** 2 + (cols - 800) ** 2 <= (10 * radius) ** 2
    image = 30_000.0 * fine.reshape(160, 10, 160, 10).mean(axis=(1, 3))
    found = DoG()(gaussian_filter(image, 0.4))
    np.testing.assert_allclose(found[0, :2], 79.5, atol=0.1)
    np.testing.assert_allclose(found[0, 2], radius, rtol=0.05)


def test_a_dark_blob_is_a_particle_only_if_asked_for():
    rows, cols = np.ogrid[:100, :100]
    hole = 30_000 * (1 - np.exp(-((rows - 40) ** 2 + (cols - 60) ** 2) / 50.0))
    assert len(DoG()(hole)) == 0
    np.testing.assert_allclose(DoG(dark=True)(hole)[:, :2], [[40, 60]], atol=0.05)


def test_an_edge_is_no_particle():
    image = np.zeros((120, 120))
    image[:, 58:62] = 30_000
    assert len(DoG()(image)) == 0
    image[58:62, :58] = image[58:62, 62:] = 0
    assert len(DoG(edge=1e9)(image)) >= len(DoG()(image))


def test_a_saturated_plateau_is_one_particle():
    rows, cols = np.ogrid[:200, :200]
    image = np.where((rows - 90) ** 2 + (cols - 110) ** 2 <= 30**2, 65535, 0).astype(np.uint16)
    found = DoG()(image)
    np.testing.assert_allclose(found, [[90, 110, 30]], atol=0.6)


def test_of_equal_samples_one_is_taken():
    """Two pixels that mirror each other answer alike; the blob is still one particle."""
    image = np.zeros((64, 64), dtype=np.uint16)
    image[30:34, 30:34] = 50_000
    np.testing.assert_allclose(DoG()(image)[:, :2], [[31.5, 31.5]], atol=1e-3)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([0.25, 0.5, 2.0, 8.0]))
def test_foreground_and_threshold_scale_together(seed, factor):
    image = scene(seed, (90, 120))[0].astype(np.float64)
    scaled = replace(BOTH, threshold=200 * factor)(image * factor)
    np.testing.assert_array_equal(scaled, replace(BOTH, threshold=200.0)(image))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_a_higher_threshold_keeps_a_part(seed):
    image, _ = scene(seed, (90, 120))
    low, high = (ordered(DoG(t)(image)) for t in (100.0, 200.0))
    assert {tuple(p) for p in high} <= {tuple(p) for p in low}


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_foreground_has_mirrored_particles(axis):
    image, _ = scene(5, (129, 193))  # 2^n + 1: the octaves keep the same pixels
    found, other = DoG()(image), DoG()(np.flip(image, axis))
    other[:, axis] = image.shape[axis] - 1 - other[:, axis]
    assert_same(other, found, 1e-3)


def opencv(image, threshold):
    """OpenCV's SIFT at the same threshold: it divides by layers and by 255."""
    gain = 65535 / 255
    sift = cv2.SIFT_create(
        contrastThreshold=3 * threshold / gain / 255, enable_precise_upscale=True
    )
    found = sift.detect(np.rint(image / gain).astype(np.uint8))
    points = np.array([[p.pt[1], p.pt[0], p.size / 2] for p in found]).reshape(-1, 3)
    return np.unique(points, axis=0)  # one per place, not one per orientation


def test_opencv_finds_the_same_blobs_at_the_same_scale():
    rows, cols = np.ogrid[:256, :320]
    truth = [(60.0, 70.3, 3.0), (60.4, 200.0, 5.0), (180.2, 80.6, 8.0), (170.0, 230.0, 12.0)]
    image = sum(
        50_000 * np.exp(-((rows - r) ** 2 + (cols - c) ** 2) / (2 * s**2)) for r, c, s in truth
    )
    ours, peer = ordered(DoG(double=True)(image)), ordered(opencv(image, 500.0))
    assert len(ours) == len(peer) == 4
    np.testing.assert_allclose(ours[:, :2], peer[:, :2], atol=0.1)
    np.testing.assert_allclose(ours[:, 2] / dog.disc_radius(3), peer[:, 2], rtol=0.03)


def test_opencv_finds_the_same_on_a_frame_in_8_bits():
    """On what 8 bits leave, nine tenths of the keypoints are OpenCV's, and the reverse."""
    frame = np.rint(foreground_of_the_twin() / 257) * 257
    ours, peer = BOTH(frame), opencv(frame, 500.0)
    inside = [
        p[(p[:, :2] > 10).all(axis=1) & (p[:, 0] < 490) & (p[:, 1] < 590)] for p in (ours, peer)
    ]
    apart = np.hypot(*(inside[0][:, None, :2] - inside[1][None, :, :2]).transpose(2, 0, 1))
    for axis in (0, 1):
        assert (apart.min(axis=axis) < 1.0).mean() > 0.9


def test_8_bits_lose_what_16_bits_show():
    """Two grey values of 8 bits are 514 of 16: faint blobs are lost or torn to steps."""
    rows, cols = np.ogrid[:128, :128]
    faint = 600 * np.exp(-((rows - 60) ** 2 + (cols - 60) ** 2) / (2 * 4.0**2))
    eight = np.rint(faint / 257) * 257
    fine, coarse = DoG(60.0)(faint), DoG(60.0)(eight)
    np.testing.assert_allclose(fine[:, 2], [np.sqrt(2) * 4], rtol=0.05)
    assert len(coarse) == 0 or abs(coarse[0, 2] / fine[0, 2] - 1) > 0.02
    assert len(DoG(12.0)(faint / 5)) == 1
    assert len(DoG(12.0)(np.rint(faint / 5 / 257) * 257)) == 0


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
        ({"camera_blur": 1.0, "double": True}, "blur of 2.0 px"),
    ],
)
def test_parameters_without_meaning_are_told(parameters, message):
    with pytest.raises(InputError, match=message):
        DoG(**parameters)


def test_a_threshold_of_zero_takes_every_maximum():
    image, _ = scene(2, (60, 70))
    assert_same(DoG(0.0)(image), plain_dog.keypoints(image, DoG(0.0)), 5e-3)
