"""Particles in the foreground of a frame of the twin, against OpenCV, numpy and
scipy.
"""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
from measure import Row, compare
from scipy import ndimage
from scipy.spatial import KDTree

from kilnflight.detection import DoG, Otsu
from kilnflight.detection.otsu import SMALLEST_PX, otsu_threshold
from kilnflight.simulated.kiln.scenes import open_scene

GAIN = 65535 / 255  # 16-bit grey values per grey value of 8 bits


def foreground() -> np.ndarray:
    """Return |frame - median of 15 frames| of scene V4, the one with most particles."""
    scene = open_scene("V4")
    frames = np.stack([scene.frame(i).gray for i in range(40, 115, 5)])
    return np.abs(frames[7] - np.median(frames, axis=0)).round().astype(np.uint16)


def eight_bits(image: np.ndarray) -> np.ndarray:
    """Return the image in 8 bits, as OpenCV's SIFT needs it."""
    return np.rint(image / GAIN).astype(np.uint8)


def sift(image: np.ndarray, threshold: float, sigma: float = 1.6) -> np.ndarray:
    """Return row and col of OpenCV's keypoints; ``threshold`` in grey values of 16
    bits.

    ``sigma`` is the first blur of an octave, in px.
    """
    contrast = 3 * threshold / 65535  # it divides by 3 layers and by 255
    detector = cv2.SIFT_create(
        contrastThreshold=contrast, sigma=sigma, enable_precise_upscale=True
    )
    return np.array([point.pt[::-1] for point in detector.detect(image)]).reshape(-1, 2)


def doubled(image: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray]:
    """Return our keypoints (row, col), bright and dark, of the image at twice its size.

    That is what OpenCV's SIFT does.
    """
    size = 2 * np.array(image.shape[::-1]) - 1
    half = np.array([[0.5, 0, 0], [0, 0.5, 0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    fine = cv2.warpAffine(image.astype(np.float32), half, size.tolist(), flags=flags)
    detect = DoG(threshold, camera_blur=1.0)
    return detect(fine)[:, :2] / 2, detect(-fine)[:, :2] / 2


def check_keypoints(image: np.ndarray, threshold: float) -> None:
    """Check on the same 8 bits that keypoints are OpenCV's and OpenCV's ours, but for
    the border.

    OpenCV drops a keypoint whose fit lies over half a sample away, ours over one. So
    those count, too, that it finds when its octaves begin half a layer later.
    """
    eight = eight_bits(image)
    last = np.array(image.shape) - 10
    found = (
        sift(eight, threshold),
        sift(eight, threshold, sigma=1.6 * 2 ** (1 / 6)),
        *doubled(eight * GAIN, threshold),
    )
    theirs, later, bright, dark = (
        each[((each > 10) & (each < last)).all(axis=1)] for each in found
    )
    known = KDTree(np.vstack([theirs, later]))
    ours = np.vstack([bright, dark])
    shares = {
        "OpenCV's that are ours": near(KDTree(ours), theirs),
        "ours that are OpenCV's": near(known, ours),
        "our bright ones that are OpenCV's": near(known, bright),
    }
    least = (0.95, 0.9, 0.95)
    if any(share < bound for share, bound in zip(shares.values(), least, strict=True)):
        raise AssertionError(f"keypoints at {threshold:g}: {shares}, at least {least}")


def near(known: KDTree, points: np.ndarray) -> float:
    """Return the share of points (n, 2) in px within 1 px of a known one."""
    return float((known.query(points)[0] < 1.0).mean())


def numpy_threshold(image: np.ndarray) -> int:
    """Return Otsu's threshold by numpy over all 65,536 levels."""
    p = np.bincount(image.ravel(), minlength=65536) / image.size
    omega = np.cumsum(p)[:-1]
    mu = np.cumsum(p * np.arange(65536))
    with np.errstate(divide="ignore", invalid="ignore"):
        eta = (mu[-1] * omega - mu[:-1]) ** 2 / (omega * (1 - omega))
    return int(np.nanargmax(np.where(np.isfinite(eta), eta, -1)))


def scipy_particles(image: np.ndarray) -> np.ndarray:
    """Return Otsu's particles by numpy and scipy.ndimage."""
    regions, count = ndimage.label(image > numpy_threshold(image), np.ones((3, 3)))
    index = np.arange(1, count + 1)
    area = ndimage.sum_labels(regions > 0, regions, index)
    centre = np.array(ndimage.center_of_mass(regions > 0, regions, index))
    particles = np.column_stack([centre, np.sqrt(area / np.pi)])[area >= SMALLEST_PX]
    return particles[np.lexsort((particles[:, 1], particles[:, 0]))]


def rows() -> list[Row]:
    """Return every comparison on one core, the results checked first."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        return _rows(foreground())
    finally:
        cv2.setNumThreads(threads)


def _rows(image: np.ndarray) -> list[Row]:
    eight = eight_bits(image)
    found = []
    for threshold in (500.0, 60.0):
        check_keypoints(image, threshold)
        what = ("pixels", image.size, "OpenCV SIFT, 8 bits")
        peer = partial(sift, eight, threshold)
        name = f"DoG keypoints at {threshold:g}"
        found.append(compare((name, *what), partial(DoG(threshold), image), peer))
        name += ", doubled picture, dark ones too"
        found.append(
            compare((name, *what), partial(doubled, eight * GAIN, threshold), peer)
        )
    assert otsu_threshold(image) == numpy_threshold(image)
    np.testing.assert_allclose(Otsu()(image), scipy_particles(image))
    what = ("Otsu's particles", "pixels", image.size, "scipy.ndimage")
    found.append(compare(what, lambda: Otsu()(image), lambda: scipy_particles(image)))
    return found
