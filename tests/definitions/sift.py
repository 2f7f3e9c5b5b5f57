"""Keypoints as maxima of a plain difference of Gaussians (thesis, 2.2.3; Lowe 2004)."""

import cv2
import numpy as np
from scipy.ndimage import maximum_filter

LAYERS, SIGMA = 3, 1.6
K = 2.0 ** (1 / LAYERS)
AROUND = np.ones((3, 3, 3), bool)
AROUND[1, 1, 1] = False


def blur(image, sigma):
    side = 2 * int(np.ceil(4 * sigma)) + 1
    border = cv2.BORDER_REFLECT_101
    return cv2.GaussianBlur(image, (side, side), sigma, borderType=border)


def fit(stack, i, y, x):
    """Value, gradient and Hessian of a sample by central differences."""
    cube = stack[i - 1 : i + 2, y - 1 : y + 2, x - 1 : x + 2]
    slopes = np.gradient(cube)
    hessian = np.empty((3, 3))
    for axis in range(3):
        hessian[axis] = [slope[1, 1, 1] for slope in np.gradient(slopes[axis])]
        hessian[axis, axis] = np.diff(cube.swapaxes(0, axis)[:, 1, 1], 2)[0]
    return cube[1, 1, 1], np.array([slope[1, 1, 1] for slope in slopes]), hessian


def localised(stack, sample, threshold, edge):
    """Follow Eqs 2.25 to 2.28 from a sample; None if the keypoint is dropped."""
    place = np.array(sample)
    last = np.array(stack.shape[1:]) - 2
    for step in range(3):
        value, gradient, hessian = fit(stack, *place)
        if np.linalg.det(hessian) == 0:
            return None
        offset = -np.linalg.solve(hessian, gradient)
        move = np.sign(offset[1:]) * (np.abs(offset[1:]) > 0.6)
        if step < 2:  # a step over the border is not made
            goal = place[1:] + move.astype(int)
            place[1:] = np.where((goal >= 1) & (goal <= last), goal, place[1:])
    trace, area = np.trace(hessian[1:, 1:]), np.linalg.det(hessian[1:, 1:])
    blob = area > 0 and trace**2 / area < (edge + 1) ** 2 / edge
    strong = value + gradient @ offset / 2 >= threshold
    return (*place, *offset) if blob and strong and abs(offset).max() < 1 else None


def keypoints(foreground, threshold, camera_blur=0.5, edge=10.0):
    """Row, col and radius (n, 3) of the keypoints, octave by octave."""
    image = blur(foreground.astype(np.float64), np.sqrt(SIGMA**2 - camera_blur**2))
    disc, spacing, found = K * np.sqrt(2 * np.log(K**2) / (K**2 - 1)), 1, []
    while min(image.shape) >= 3:
        wider = [blur(image, SIGMA * np.sqrt(K ** (2 * i) - 1)) for i in range(1, 6)]
        stack = -np.diff([image, *wider], axis=0)
        peak = (stack > maximum_filter(stack, footprint=AROUND)) & (stack > 0)
        peak &= stack >= threshold / 2
        samples = np.argwhere(peak[1:-1, 1:-1, 1:-1]) + 1
        places = {localised(stack, sample, threshold, edge) for sample in samples}
        for i, y, x, up, down, right in sorted(places - {None}):
            radius = disc * SIGMA * K ** (i + up)
            found.append(spacing * np.array([y + down, x + right, radius]))
        image, spacing = blur(image, SIGMA * np.sqrt(3))[::2, ::2], 2 * spacing
    return np.reshape(found, (-1, 3))
