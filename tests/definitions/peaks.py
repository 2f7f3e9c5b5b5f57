"""Prominence of peaks in plain code: lower the water until a higher pixel joins."""

import numpy as np
from scipy.ndimage import label


def peaks(image, prominence):
    """Return the prominence of each peak by row and col; of equal pixels the first is
    higher.
    """
    found, edge = {}, np.ones(image.shape, bool)
    edge[1:-1, 1:-1] = False
    for r, c in np.argwhere(~edge).tolist():
        height = (image[r, c], -r, -c)
        best = image[r, c] - np.median(image[edge])
        for level in np.unique(image)[::-1]:
            parts, _ = label(image >= level, np.ones((3, 3)))
            same = np.argwhere(parts == parts[r, c]).tolist() if parts[r, c] else []
            if any((image[i, j], -i, -j) > height for i, j in same):
                best = image[r, c] - level
                break
        if best >= prominence:
            found[r, c] = best
    return found
