import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from kilnflight.checks import InputError
from kilnflight.detection import DoG


@pytest.mark.parametrize("sigma", [2.5, 3.0, 4.5, 8.0, 13.0])
@pytest.mark.parametrize("place", [(100.0, 120.0), (100.5, 120.5), (100.3, 120.8)])
def test_a_gaussian_blob_gives_its_place_and_size(sigma, place):
    rows, cols = np.ogrid[:200, :240]
    far = (rows - place[0]) ** 2 + (cols - place[1]) ** 2
    found = DoG()(30_000 * np.exp(-far / (2 * sigma**2)))
    assert len(found) == 1
    np.testing.assert_allclose(found[0, :2], place, atol=0.06 * sigma / 2)
    np.testing.assert_allclose(found[0, 2], np.sqrt(2) * sigma, rtol=0.06)


def test_a_tiny_blob_needs_the_image_at_twice_its_size():
    rows, cols = np.ogrid[:127, :127]
    tiny = 30_000 * np.exp(-((rows / 2 - 30) ** 2 + (cols / 2 - 33) ** 2) / (2 * 1.4**2))
    assert len(DoG()(tiny[::2, ::2])) == 0
    found = DoG(camera_blur=1.0)(tiny) / 2
    np.testing.assert_allclose(found, [[30, 33, np.sqrt(2) * 1.4]], atol=0.15)


@pytest.mark.parametrize("radius", [4.0, 7.0, 12.0, 20.0])
def test_a_disc_gives_its_radius(radius):
    rows, cols = np.ogrid[:1600, :1600]
    fine = (rows - 800) ** 2 + (cols - 800) ** 2 <= (10 * radius) ** 2
    image = 30_000.0 * fine.reshape(160, 10, 160, 10).mean(axis=(1, 3))
    found = DoG()(gaussian_filter(image, 0.4))
    np.testing.assert_allclose(found[0, :2], 79.5, atol=0.1)
    np.testing.assert_allclose(found[0, 2], radius, rtol=0.05)


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
    found = DoG()(image)
    np.testing.assert_allclose(found, [[90, 110, 30]], atol=0.6)


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
def test_parameters_without_meaning_are_told(parameters, message):
    with pytest.raises(InputError, match=message):
        DoG(**parameters)
