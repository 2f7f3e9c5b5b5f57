"""DoG on blobs of known size, and against its plain definition."""

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from tests.definitions.sift import keypoints

from kilnflight.checks import InputError
from kilnflight.detection import DoG
from kilnflight.detection.region import inside

CORNER = st.tuples(st.floats(-40.0, 220.0), st.floats(-40.0, 280.0))
SEED = st.integers(0, 1000)


def gaussian(shape, place, sigma, height=30_000.0):
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    return height * np.exp(
        -((rows - place[0]) ** 2 + (cols - place[1]) ** 2) / (2 * sigma**2)
    )


@pytest.mark.parametrize("sigma", [2.5, 4.5, 13.0])
@pytest.mark.parametrize("place", [(100.0, 120.0), (100.3, 120.8)])
def test_a_gaussian_blob_gives_its_place_and_size(sigma, place):
    ((*found, radius),) = DoG()(gaussian((200, 240), place, sigma))
    np.testing.assert_allclose(found, place, atol=0.06 * sigma / 2)
    np.testing.assert_allclose(radius, np.sqrt(2) * sigma, rtol=0.06)


def test_a_plateau_is_one_particle_and_holes_and_edges_are_none():
    rows, cols = np.ogrid[:200, :200]
    plateau = np.where((rows - 90) ** 2 + (cols - 110) ** 2 <= 30**2, 65535, 0).astype(
        np.uint16
    )
    np.testing.assert_allclose(DoG()(plateau), [[90, 110, 30]], atol=0.6)
    even = np.zeros((64, 64), dtype=np.uint16)
    even[28:36, 28:36] = 50_000  # four equal samples in the middle
    np.testing.assert_allclose(DoG()(even)[:, :2], [[31.5, 31.5]], atol=0.1)
    edge = np.where(abs(rows - 60) < 2, 30_000.0, 0.0 * cols)
    assert len(DoG()(edge)) == len(DoG()(-gaussian((100, 100), (40, 60), 5.0))) == 0


def scene(seed, shape=(90, 120), blobs=5):
    """A foreground of noise and Gaussian blobs."""
    generator = np.random.default_rng(seed)
    image = np.abs(generator.normal(0, 70.0, shape))
    for _ in range(blobs):
        place, sigma = generator.uniform((0, 0), shape), generator.uniform(1, 12)
        image += gaussian(shape, place, sigma, 10 ** generator.uniform(2.8, 4.6))
    return image.clip(0, 65535).round().astype(np.uint16)


def assert_defined(image, *parameters, atol=1e-3, **edge):
    actual, expected = (
        DoG(*parameters, **edge)(image),
        keypoints(image, *parameters, **edge),
    )
    assert len(actual) == len(expected) > 0
    near = np.abs(actual[:, None] - expected[None]).max(axis=2)
    assert max(near.min(axis=1).max(), near.min(axis=0).max()) < atol


@pytest.mark.parametrize("shape", [(260, 210), (37, 90), (129, 33), (200, 31)])
def test_it_is_the_plain_definition(shape):
    image = scene(shape[0], shape, blobs=12)
    assert_defined(image, 500.0)
    assert_defined(image, 60.0, 1.0)
    assert_defined(image, 60.0, edge=3.0)
    assert_defined(image, 60.0, edge=40.0)
    assert_defined(image, 0.0, atol=5e-3)  # the weakest maxima are flat


@pytest.mark.parametrize("turns", range(4))
def test_keypoints_in_the_first_block_at_each_border_are_the_plain_definition(turns):
    """Smooth noise of these seeds has some within 3 px of its left border."""
    for seed in (22, 28, 69):
        noise = np.random.default_rng(seed).normal(0, 1000, (120, 40))
        image = cv2.GaussianBlur(noise.astype(np.float32), (0, 0), 2.0)
        assert DoG(20.0, edge=30.0)(image)[:, 1].min() < 3
        assert_defined(np.rot90(image, turns), 20.0, edge=30.0)


def test_a_blob_is_found_up_to_its_ratio_of_curvatures():
    """The curvatures of a Gaussian of 4 px by 12 px differ by some nine times in its
    middle.
    """
    row, col = np.ogrid[:120, :160]
    long = 30_000 * np.exp(-((row - 60) ** 2) / 32 - (col - 80) ** 2 / 288)
    counts = [len(DoG(500.0, edge=edge)(long)) for edge in (1.5, 4.0, 30.0)]
    assert counts == [0, 0, 1]


@given(
    SEED,
    st.lists(st.floats(60.0, 3000.0), min_size=1),
    st.sampled_from([0.25, 2.0, 8.0]),
)
def test_one_call_answers_for_every_higher_threshold_and_thresholds_scale(
    seed, thresholds, factor
):
    """Bit for bit, and in the same order."""
    image = scene(seed)
    every = DoG(min(thresholds)).graded(image)
    for threshold in thresholds:
        kept = every[every[:, 3] >= threshold, :3]
        np.testing.assert_array_equal(kept, DoG(threshold)(image))
        np.testing.assert_array_equal(kept, DoG(threshold * factor)(image * factor))


@given(SEED, st.lists(CORNER, min_size=3, max_size=7, unique=True))
def test_all_particles_in_a_polygon_are_found_and_no_others_invented(seed, polygon):
    assume(np.linalg.matrix_rank(np.subtract(polygon, polygon[0])) == 2)
    image = scene(seed, (180, 240))
    every, particles = DoG(60.0)(image), DoG(60.0)(image, polygon)
    found = {tuple(particle) for particle in particles}
    within = every[inside(polygon, *every[:, :2].T)]
    assert {tuple(p) for p in within} <= found <= {tuple(p) for p in every}


@pytest.mark.parametrize(("times", "sigma"), [(2, 1.3), (4, 0.8)])
def test_small_blobs_are_found_in_an_enlarged_image(times, sigma):
    row, col = np.ogrid[:60, :80]
    image = 1000 * np.exp(-((row - 20.3) ** 2 + (col - 50.6) ** 2) / (2 * sigma**2))
    assert len(DoG(20.0)(image)) == 0
    (found,) = DoG(20.0, enlarge=times)(image)
    np.testing.assert_allclose(found, [20.3, 50.6, sigma * np.sqrt(2)], atol=0.3)
    assert len(DoG(20.0, enlarge=times)(image, [(0, 0), (0, 40), (40, 0)])) == 0


@pytest.mark.parametrize("times", [0, 5, 1.5, "2"])
def test_an_image_is_enlarged_one_to_four_times(times):
    with pytest.raises(InputError, match="enlarge"):
        DoG(enlarge=times)


@pytest.mark.parametrize("enlarge", [1, 2])
@pytest.mark.parametrize(
    "polygon",
    [
        [(0, 0), (0, 90), (np.nan, 90)],
        [(0, 0), (0, 90), (np.inf, 90)],
        [(0, 0), (0, 90), (1e12, 90)],
        [(0, 0), (0, 90)],
        [(0, 0), (0, 45), (0, 90)],
        [(0, 0, 0), (0, 90, 0), (90, 90, 0)],
        "square",
    ],
    ids=str,
)
def test_a_polygon_without_extent_or_end_is_refused(enlarge, polygon):
    image = gaussian((90, 90), (40, 60), 3.0)
    with pytest.raises(InputError):
        DoG(enlarge=enlarge)(image, polygon)
    with pytest.raises(InputError):
        inside(polygon, 1.0, 1.0)
