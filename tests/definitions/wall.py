"""Likelihood of a cylinder in plain code (Torr and Zisserman 2000), one point at a time."""

import numpy as np


def likelihood(points, centre, direction, radius, sigma, width):
    """Return negative log likelihood and mixing."""
    ways = [point - centre for point in points]
    distances = [np.linalg.norm(way - (way @ direction) * direction) - radius for way in ways]
    gauss = [np.exp(-(d**2) / (2 * sigma**2)) / np.sqrt(2 * np.pi * sigma**2) for d in distances]
    mixing = 0.5
    for _ in range(5):
        mixing = np.mean([mixing * g / (mixing * g + (1 - mixing) / width) for g in gauss])
    return -sum(np.log(mixing * g + (1 - mixing) / width) for g in gauss), mixing
