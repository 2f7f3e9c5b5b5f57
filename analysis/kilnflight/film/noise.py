"""Noise of a picture, for thresholds where no labelled frames exist."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from skimage.util import view_as_blocks

from kilnflight.arrays import Array, Single
from kilnflight.detection.sift import LAYERS, SIGMA_PX, DoG, enlarged
from kilnflight.film.prepared import spread
from kilnflight.recording.frames import Recording

BLOCK_PX = 32  # side of a block in which noise is measured
LEAST_THRESHOLD = 0.5  # grey values; made-up pictures have no noise
PART_PX = (1024, 1536)  # rows and columns of an enlarged picture that are looked at
WHITE_SHARE = 0.7  # of the finest layer: white noise of coarser ones is less
PER_DEVIATION = 1.4826  # standard deviation of Gaussian noise over its median size


def spot_detector(threshold: float, enlarge: int) -> DoG:
    """Return the detector of a film's spots at so many times its size.

    Four times the size, spots of half a pixel are as wide as the narrowest that are
    found, if the blur of a camera is not taken off.
    """
    blur = DoG.camera_blur
    if enlarge > 2:
        blur = 0.0
    return DoG(threshold, blur, enlarge)


def block_noise(foreground: Single, enlarge: int) -> float:
    """Return the noise of a foreground's finest layer of DoG, in a noisy block.

    Parameters
    ----------
    foreground
        (rows, cols).
    enlarge
        The noise is that of the foreground at so many times its size, as
        `spot_detector` enlarges it.
    """
    blocks = next(_layers(foreground, enlarge))
    medians = np.median(np.abs(blocks), axis=(2, 3))
    return float(np.quantile(medians, 0.9)) * PER_DEVIATION


def coarse_noise(foreground: Single, enlarge: int) -> float:
    """Return the noise of a foreground's noisiest layer of DoG but the finest.

    Parameters are those of `block_noise`; the median over blocks counts. Noise that
    goes together in neighbouring pixels is largest in one of these five layers.
    """
    layers = _layers(foreground, enlarge)
    next(layers)
    return max(np.median(blocks.std(axis=(2, 3))) for blocks in layers)


def _layers(foreground: Single, enlarge: int) -> Iterator[Array]:
    """Yield differences of Gaussians in blocks, (rows, cols, side, side), finest first.

    They are those of two octaves, in the middle of a foreground (rows, cols).
    """
    picture = enlarged(middle(foreground, np.array(PART_PX) // enlarge), enlarge)
    blur = min(enlarge * spot_detector(0.0, enlarge).camera_blur, SIGMA_PX)
    scales = SIGMA_PX * 2 ** (np.arange(2 * LAYERS + 1) / LAYERS)
    sigmas = np.sqrt(np.maximum(scales**2 - blur**2, 1e-4))
    rows, cols = picture.shape
    side = min(BLOCK_PX, rows, cols)
    for fine, coarse in pairwise(cv2.GaussianBlur(picture, (0, 0), s) for s in sigmas):
        layer = (fine - coarse)[: rows // side * side, : cols // side * side]
        yield view_as_blocks(layer, (side, side))


def noise_threshold(
    foregrounds: Sequence[Single],
    enlarge: int = 1,
    inverted: Sequence[Single] = (),
) -> float:
    """Return a threshold of DoG in grey values, five times the noise.

    Parameters
    ----------
    foregrounds
        (rows, cols) each.
    enlarge
        Times its size at which spots are searched, as for `spot_detector`.
    inverted
        The foregrounds of the inverted frames, which have the noise without particles.
        Their coarser layers count, too.

    Notes
    -----
    The thesis tunes its threshold on labelled frames; without labels only noise is
    known. The finest difference of Gaussians is measured in some frames, in small
    blocks. The median of its absolute value, times 1.4826, is the standard deviation
    of Gaussian noise; particles cover too little of a block to change it. Noise grows
    with light, so the 90 % quantile over blocks counts, and the median over frames.
    Five times the noise bounds its false alarms. Flicker of a flame is not noise of a
    pixel; a higher threshold may be better there.
    """
    noise = [block_noise(each, enlarge) for each in foregrounds]
    coarse = [coarse_noise(each, enlarge) / WHITE_SHARE for each in inverted]
    times = 5.0
    if enlarge > 2:  # more places have more chances; set on empty films
        times = 6.5
    largest = max(np.median(noise), np.median(coarse or 0.0))
    return float(f"{max(times * largest, LEAST_THRESHOLD):.3g}")


def area_threshold(recording: Recording) -> float:
    """Return a threshold of areas in grey values, four times the noise of a pixel.

    The noise is that of differences of neighbours in a row.
    """
    noise = []
    for t in spread(len(recording), 5):
        steps = np.abs(np.diff(recording.gray(t).astype(float), axis=1))
        noise.append(np.median(steps) * PER_DEVIATION / np.sqrt(2))
    return float(f"{max(4 * np.median(noise), 1.0):.3g}")


def middle(picture: Any, most: Any) -> Any:
    """Return the middle of a picture, ``most`` (rows, cols) of it."""
    top, left = np.maximum(np.subtract(picture.shape, most), 0) // 2
    return picture[top : top + most[0], left : left + most[1]]
