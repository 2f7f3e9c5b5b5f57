"""Keypoints of SIFT in plain code (thesis, 2.2.3; Lowe 2004): float64, no shortcut."""

import numpy as np
from scipy.ndimage import correlate1d, maximum_filter

LAYERS, SIGMA = 3, 1.6


def blur(image, sigma):
    if sigma < 1e-9:
        return image
    offset = np.arange(-np.ceil(4 * sigma), np.ceil(4 * sigma) + 1)
    weight = np.exp(-(offset**2) / (2 * sigma**2))
    for axis in (0, 1):
        image = correlate1d(image, weight / weight.sum(), axis=axis, mode="mirror")
    return image


def fit(cube):
    """Gradient and Hessian of a 3 x 3 x 3 neighbourhood by central differences."""
    at = lambda d: cube[tuple(1 + d)]  # noqa: E731
    unit, hessian = np.eye(3, dtype=int), np.empty((3, 3))
    for i, e in enumerate(unit):
        hessian[i, i] = at(e) + at(-e) - 2 * at(0 * e)
        for j, f in enumerate(unit[:i]):
            cross = (at(e + f) - at(e - f) - at(f - e) + at(-e - f)) / 4
            hessian[i, j] = hessian[j, i] = cross
    return np.array([(at(e) - at(-e)) / 2 for e in unit]), hessian


def localised(stack, sample, threshold, edge):
    """Follow Eqs 2.25 to 2.28 from a sample; None if the keypoint is dropped."""
    i, y, x = sample
    for step in range(3):
        gradient, hessian = fit(stack[i - 1 : i + 2, y - 1 : y + 2, x - 1 : x + 2])
        if np.linalg.det(hessian) == 0:
            return None
        offset = np.linalg.solve(hessian, -gradient)
        move = np.where(np.abs(offset[1:]) > 0.6, np.sign(offset[1:]), 0).astype(int)
        goal = np.add([y, x], move)
        goal = np.where(
            (goal >= 1) & (goal < np.array(stack.shape[1:]) - 1), goal, [y, x]
        )
        if step == 2 or (goal == [y, x]).all():
            break
        y, x = (int(g) for g in goal)
    curvature = hessian[1:, 1:]
    strong = stack[i, y, x] + gradient @ offset / 2 >= threshold
    bent = np.linalg.det(curvature) > 0 and (
        np.trace(curvature) ** 2 / np.linalg.det(curvature) < (edge + 1) ** 2 / edge
    )
    return (i, y, x, *offset) if strong and bent and np.abs(offset).max() < 1 else None


def octave(image, threshold, edge):
    sigmas = SIGMA * 2.0 ** (np.arange(LAYERS + 3) / LAYERS)
    gauss = np.stack([blur(image, np.sqrt(s**2 - SIGMA**2)) for s in sigmas])
    stack = gauss[:-1] - gauss[1:]
    around = np.ones((3, 3, 3), dtype=bool)
    around[1, 1, 1] = False
    peak = stack > maximum_filter(stack, footprint=around)
    peak &= (stack >= threshold / 2) & (stack > 0)
    samples = np.argwhere(peak[1:-1, 1:-1, 1:-1]) + 1
    found = {localised(stack, sample, threshold, edge) for sample in samples}
    found = np.array(sorted(found - {None})).reshape(-1, 6)
    k = 2 ** (1 / LAYERS)
    disc = k * np.sqrt(2 * np.log(k**2) / (k**2 - 1))
    scale = SIGMA * k ** (found[:, 0] + found[:, 3])
    return np.column_stack([found[:, 1:3] + found[:, 4:], disc * scale])


def keypoints(foreground, threshold, camera_blur=0.5, edge=10.0):
    """Row, col and radius (n, 3) of the keypoints."""
    image, spacing, found = foreground.astype(np.float64), 1.0, [np.empty((0, 3))]
    image = blur(image, np.sqrt(SIGMA**2 - camera_blur**2))
    while min(image.shape) >= 3:
        found.append(spacing * octave(image, threshold, edge))
        image = blur(image, np.sqrt(3.0) * SIGMA)[::2, ::2]
        spacing *= 2
    return np.concatenate(found)
