"""Joint events of tracks and detections, one by one (Eqs 2.57 to 2.64 of the
thesis).
"""

from itertools import product

import numpy as np


def joint_events(tracks, detections):
    """Yield every joint event: the detection of each track, or -1."""
    for event in product(range(-1, detections), repeat=tracks):
        used = [detection for detection in event if detection >= 0]
        if len(set(used)) == len(used):
            yield event


def joint_probabilities(likelihood, nonassignment):
    """Return Eq. 2.64 as it stands, a sum over joint events."""
    tracks, detections = likelihood.shape
    factors = np.column_stack([likelihood, nonassignment])  # index -1: missed
    sums = np.zeros((tracks, 1 + detections))
    for event in joint_events(tracks, detections):
        sums[range(tracks), np.array(event) + 1] += factors[range(tracks), event].prod()
    return sums / sums.sum(axis=1, keepdims=True)
