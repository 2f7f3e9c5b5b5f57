"""Gated pairs as tables of all tracks and detections."""

import numpy as np


def table(pairs, values, outside=0.0):
    """Return values (p,) of gated pairs as a table (n, m)."""
    dense = np.full((len(pairs.expected), pairs.detections), outside)
    dense[pairs.track, pairs.detection] = values
    return dense


def weighed(associator, pairs):
    """Return weights (n, 1 + m), column 0 = missed."""
    weights = table(pairs, associator(pairs))
    return np.column_stack([1.0 - weights.sum(axis=1), weights])
