"""Noise of a picture, for thresholds where no labelled frames exist."""

import cv2
import numpy as np
from skimage.util import view_as_blocks

from kilnflight.arrays import Integers, Single
from kilnflight.detection.sift import LAYERS, SIGMA_PX, DoG, enlarged


def block_noise(foreground: Single, enlarge: int = 1) -> float:
    """Return the noise of a foreground's finest difference of Gaussians, in a noisy
    block.

    ``enlarge``: of the foreground (rows, cols) at so many times its size, as `DoG`
    enlarges it.
    """
    picture = enlarged(foreground, enlarge)
    blur = min(enlarge * DoG().camera_blur, SIGMA_PX)
    fine, coarse = (
        cv2.GaussianBlur(picture, (0, 0), np.sqrt(max(scale**2 - blur**2, 1e-4)))
        for scale in (SIGMA_PX, SIGMA_PX * 2 ** (1 / LAYERS))
    )
    rows, cols = picture.shape
    size = min(32, rows, cols)
    response = np.abs(fine - coarse)[: rows // size * size, : cols // size * size]
    middle = np.median(view_as_blocks(response, (size, size)), axis=(2, 3))
    return float(np.quantile(middle, 0.9)) * 1.4826


def pixel_noise(gray: Integers) -> float:
    """Return the noise of a pixel in grey values, from the differences of neighbours in
    a row.
    """
    steps = np.abs(np.diff(gray.astype(np.float64), axis=1))
    return float(np.median(steps)) * 1.4826 / np.sqrt(2)
