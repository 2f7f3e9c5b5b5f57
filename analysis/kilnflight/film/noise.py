"""Noise of a picture, for thresholds where no labelled frames exist."""

from collections.abc import Sequence

import cv2
import numpy as np
from skimage.util import view_as_blocks

from kilnflight.arrays import Integers, Single
from kilnflight.detection.sift import LAYERS, SIGMA_PX, DoG, enlarged
from kilnflight.film.prepared import spread
from kilnflight.recording.frames import Recording

BLOCK_PX = 32  # side of a block in which noise is measured
LEAST_NOISE = 0.1  # grey values of the finest layer; made-up pictures have no noise
MIDDLE_PX = (2048, 3072)  # rows and columns of an enlarged picture that are looked at
PER_DEVIATION = 1.4826  # standard deviation of Gaussian noise over its median size


def block_noise(foreground: Single, enlarge: int) -> float:
    """Return the noise of a foreground's finest layer of DoG, in a noisy block.

    Parameters
    ----------
    foreground
        (rows, cols).
    enlarge
        The noise is that of the foreground at so many times its size, as `DoG`
        enlarges it.
    """
    picture = enlarged(foreground, enlarge)
    blur = min(enlarge * DoG().camera_blur, SIGMA_PX)
    fine = _blurred(picture, blur, SIGMA_PX)
    coarse = _blurred(picture, blur, SIGMA_PX * 2 ** (1 / LAYERS))
    rows, cols = picture.shape
    size = min(BLOCK_PX, rows, cols)
    response = np.abs(fine - coarse)[: rows // size * size, : cols // size * size]
    middle = np.median(view_as_blocks(response, (size, size)), axis=(2, 3))
    return float(np.quantile(middle, 0.9)) * PER_DEVIATION


def _blurred(picture: Single, blur: float, scale: float) -> Single:
    """Return a picture that has a blur, blurred to a scale; both in px."""
    sigma = np.sqrt(max(scale**2 - blur**2, 1e-4))
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma), np.float32)


def pixel_noise(gray: Integers) -> float:
    """Return the noise of a pixel in grey values, from neighbours in a row."""
    steps = np.abs(np.diff(gray.astype(np.float64), axis=1))
    return float(np.median(steps)) * PER_DEVIATION / np.sqrt(2)


def noise_threshold(foregrounds: Sequence[Single], enlarge: int = 1) -> float:
    """Return a threshold of DoG in grey values, five times the noise.

    Notes
    -----
    The thesis tunes its threshold on labelled frames; without labels only noise is
    known. The finest difference of Gaussians is measured in five frames, in small
    blocks. The median of its absolute value, times 1.4826, is the standard deviation
    of Gaussian noise; particles cover too little of a block to change it. Noise grows
    with light, so the 90 % quantile over blocks counts, and the median over frames.
    Five times the noise bounds its false alarms. Flicker of a flame is not noise of a
    pixel; a higher threshold may be better there.
    """
    noise = [block_noise(middle(each, enlarge), enlarge) for each in foregrounds]
    return float(f"{5.0 * max(np.median(noise), LEAST_NOISE):.3g}")


def area_threshold(recording: Recording) -> float:
    """Return a threshold of areas in grey values, four times the noise of a pixel."""
    frames = spread(len(recording), 5)
    noise = [pixel_noise(recording.gray(t)) for t in frames]
    return float(f"{max(4 * np.median(noise), 1.0):.3g}")


def middle(picture: Single, enlarge: int) -> Single:
    """Return the middle of a picture that is `MIDDLE_PX` at most when enlarged."""
    rows, cols = (most // enlarge for most in MIDDLE_PX)
    top = max(picture.shape[0] - rows, 0) // 2
    left = max(picture.shape[1] - cols, 0) // 2
    return np.ascontiguousarray(picture[top : top + rows, left : left + cols])
